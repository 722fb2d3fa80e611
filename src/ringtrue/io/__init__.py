"""Files to dataclasses and back.

`uff` universal files.

Records: `records` of any format: `record_texts` (delimited), `labview` (.lvm, TDMS),
`record_arrays` (.npy, HDF5, MATLAB, WAVE), `record_layout` (our own). `record_table` samples of any
of them; `delimited` columns of text; `times` and `si` what their cells hold.

FRFs: `frfs` of any format, `frf_tables` of text, `frf_lines` that have values. `modes` of any
format. Matrices: `matrices`, `op4`.

Tests: `sheets` of sensors, `statics`, `choices` by hand.

For all: `foreign`, the one door to parsers of others, `files` that are read and written, `hdf5`
dataclasses in HDF5.
"""
