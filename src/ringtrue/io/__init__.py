"""Files to dataclasses and back.

`uff` universal files.

Records: `records` of any format: `delimited`, `lvm`, `matfile`, `plain`, `tdms`, `wav`,
`record_layout` (our own); `clock`, `times`, `complex_cells` and `si` what stands in their cells,
`logger_lines` among their lines.

FRFs: `frfs` of any format: `frf_arrays`, `frf_tables`; `frf_lines` that have values. Modes:
`modes_json`, `mode_tables`. Matrices: `matrices`, `op4`.

Tests: `sheets` of sensors, `statics`, `choices` by hand.

For all: `foreign`, the one door to parsers of others, `files` that are read, `contents` of those
that a command cannot use, `atomic` writes, `codec` dataclasses in HDF5, `magnitudes` of what is
measured.
"""
