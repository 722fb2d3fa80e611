"""Files to dataclasses and back.

`uff` universal files.

Records: `records` of any format: `record_texts` (delimited), `labview` (.lvm, TDMS),
`record_arrays` (.npy, HDF5, MATLAB, WAVE), `record_table` (our own, and the samples of any of
them); `delimited` columns of text; `times` and units of what their cells hold.

FRFs: `frfs` of any format, `frf_tables` of text. `modes` of any
format. Matrices: `matrices`, `op4`.

Tests: `sheets` of sensors, `statics`, `choices` by hand.

For all: `foreign`, the one door to parsers of others, `files` that are read and written, `hdf5`
dataclasses in HDF5.
"""
