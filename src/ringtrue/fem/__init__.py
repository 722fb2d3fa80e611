"""Model to matrices, and their derivatives.

Matrices: `mesh` resolves what elements need, `elements` holds their kernels, `element_cards` which
card has which, `assembly` sums them; `nonstructural_mass` of lists, `negative_stiffness` refused;
`algebra` of small matrices.

Constraints: `constraint_equations` and `rigid_elements`, which `constraints` makes one elimination;
`autospc` and `massless_rotations` hold what nothing stiffens.

Parameters: `parametrisation` changes a model and gives the derivatives of its matrices, and K and M
as functions of all parameters.

Answers: `loads` at nodes, frequency `response`.
"""
