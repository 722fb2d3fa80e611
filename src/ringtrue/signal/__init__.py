"""Records to spectra, correlations and FRFs; what is wrong with records, and what machines put into
them.

Preparation: `channel_checks` and gaps.

Recorders: `clock_alignment` of channels whose clocks differ.

Spectra: `spectra` of ambient records (trends, filters, bands, geophones), `band_correlations` of
records larger than memory.

FRFs: `impacts`, `frf` of hammers and shakers, `local_rational` (without leakage); `frf_sets` joins,
exchanges and checks them, also setup against setup.

Machines: `tonal_lines`, steady or in run-ups, are taken out, `harmonic_evidence` marks poles.

Transients: `transients` finds impacts in responses.
"""
