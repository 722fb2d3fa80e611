"""Parameters of a model: how K and M depend on them.

`changed_model` puts factors into the fields of a model. `element_derivatives` and `derivatives` are
exact at the nominal model; `derivatives` also writes K and M of all parameters together as fixed
matrices times functions of the factors: `parameter_groups` are the elements that each parameter
acts on, `polynomials` the exact terms, `interpolation` the others.
"""
