"""Model to matrices, and their derivatives.

Matrices: `kinds` the element cards, `mesh`, `place` and `rows` what elements need, `elements` their
kernels, `assembly` the sum, `added_mass`, `negative` stiffness refused; `algebra` and `isotropy` in
small.

Constraints: `equations`, `rigid`, `average`, `constraints` all of them as one
elimination; what nothing stiffens: `autospc`, `spins`.

Parameters: `change` a model with other fields, `slopes` and `derivatives` of matrices.

All parameters together: `dependence` fixed matrices times `functions`; `powers` and `products`
where these are polynomials, `regions`, `nodes`, `interpolation` and `series` where not.

Answers: `response`; loads of surfaces: `pressure`, of beams: `line_loads`, of masses: `body_loads`,
of heat: `thermal`.
"""
