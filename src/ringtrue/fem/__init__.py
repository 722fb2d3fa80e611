"""Model to matrices, and their derivatives.

Matrices: `mesh` resolves what elements need, `elements` holds their kernels, `element_cards` which
card has which, `assembly` sums them; `nonstructural_mass` of lists, `negative_stiffness` refused.

Constraints: `rigid_elements` and other equations, which `constraints` makes one elimination; it
holds what nothing stiffens, `assembly` what has no mass either.

Parameters: `parametrisation` changes a model and gives the derivatives of its matrices, and K and M
as functions of all parameters.

Answers: `loads` at nodes, frequency `response`.
"""
