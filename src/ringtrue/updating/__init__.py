"""Which parameters of a model are wrong, by how much, and how sure that is.

Candidates: `catalogue` what is tried, `generate` by property and material, `regions` by region,
`lumps` masses that the deck lacks, `candidates` one of them, `effects` those no mode sees, `alike`
errors that go together.

Choice: `localise` indicators by element, `screening` and `pool` which are looked at closely,
`choose`, `subsets`, `sparse` and `search` which are taken, `joint` what other data say,
`identifiable` what cannot be told apart, `lacking` whether masses are left out, `claims` how far
members may be off, `proposal` all of it explained.

Objective: `objective` and `several` (configurations), of `residuals`, `residuals_frf` and
`residuals_static`, close modes as `spans`, weighed by `weights` and `robust`.

Methods: `trust` is the driver, with `gauss_newton` and `quadratic`; `multistart` many starts,
`verified` ends on full solutions, `settle` from the first pairs to the last weights, `unmoved` what
is not written, `best` a yardstick.

Models small enough for it: `dense`, `rigid_body`.

Damping and suspension: `damping` (ratios), `damping_frf`, `damping_regions`; `suspension`.

How sure: `posterior`, `mcmc`, `kfold`, `plausible`. What follows: `predict`, `harmonic`.
"""
