"""Records to spectra, correlations and FRFs; what is wrong with records, and what machines put into
them.

Preparation: `preprocess`, `levels`, `sensors` (transfer functions), `windows`, `faults`, `gaps`,
`overlaps`, `overloads`.

Recorders: `align`, `phases` and `drifts` of their clocks.

Spectra of ambient records: `psd`; `pyramid`, `stream`, `listened` and `threads` for records larger
than memory.

FRFs: `hits` and `earlier` find blows, `frf` their FRFs, `spectra` those of shakers, `periodic` and
`local_rational` without leakage; `setups` and `reciprocal` join them, `frf_checks` judges them.

Machines and events: `harmonics`, `lines`, `locked`, `sweeps`, `strokes`, `echoes`, `events`;
`prediction` what signals could not foresee.
"""
