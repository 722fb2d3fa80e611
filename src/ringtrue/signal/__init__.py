"""Records to spectra, correlations and FRFs; what is wrong with records, and what machines put into
them.

Preparation: `channel_checks`, `gaps`, `decimation` (trends, filters, bands), `sensor_response`.

Recorders: `clock_alignment` of channels whose clocks differ.

Spectra: `spectra` of ambient records, `band_correlations` of records larger than memory.

FRFs: `impacts` and their `frf`, `shaker_frf`, `local_rational` (without leakage); `frf_sets` joins,
exchanges and checks them.

Machines: `tonal_lines` and `run_ups` are taken out, `harmonic_evidence` marks poles, and
`order_tracking` follows a speed.

Transients: `transients` finds impacts in responses, `echoes` a force that comes again.
"""
