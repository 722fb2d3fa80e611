"""Signals and FRFs to modes with their standard deviations.

Ambient records: `ambient` is the call; `ambient_record` what a record allows, `bands` and
`stretches` what is kept of it, `ambient_band` the modes of one band, `ambient_verdict` the verdict
on those of all; `ambient_methods` by another method.

Blows, shakers, FRFs: `hammer` is the call; `frf_input` what is refused, `frf_band` the band,
`condense` fewer lines, `bands_hammer` the candidates, `deflate` what they miss, `refine` the fit in
`augmented` unknowns, `lsfd` and `scale` residues and modal masses, `reciprocity` what the points
struck tell of sensors and hammer, `normal` real shapes; `leakage` of Hann windows; `split` and
`local` responses and setups that disagree, `linearity` several force levels; `frf_methods` by
another method.

Methods: `ssi`, `ssi_data`, `era`, `half_spectra`, `fdd`, `bayes` (ambient); `plscf`, `lsce`, `rfp`,
`peaks` (FRFs), `definite` their normal matrices; `opinion` asks one of them for a second opinion.

From poles to modes: `poles` of all orders, `stabilise` and `cluster` or `pick`, `judge` with
reasons, `variance` their scatter, `whittle` their maximum likelihood, `repeated` and
`repeated_hammer` roots nearer than the data tell, `mixing` shapes of close modes; `choice` and
`choice_hammer` by hand.

What is no mode, or no steady one: `forced`, `struck`, `wander`, `ripples` of echoes.

Several records: `same_setup` of their sensors, `setups` as one, `merge` one by one, `common` their
channels; `tracking` through time, `gains` of replaced sensors, `environment` and `inertia` (of
heat) why frequencies change.
"""
