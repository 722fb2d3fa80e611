"""Files to dataclasses and back.

`uff` universal files.

Records: `records` of any format: `record_texts` (delimited, .lvm, TDMS), `record_arrays` (.npy,
HDF5, MATLAB, WAVE), `record_table` (our own, and the samples of any of them); `delimited` columns
of text; `times` and units of what their cells hold.

FRFs: `frfs` of any format, `frf_tables` of text with the `frf_headers` of analysers. `modes` of any
format. Sparse `matrices`.

Tests: `sheets` of sensors, `campaign_tables` of setups and static tests, `choices` by hand.

For all: `recognition` of a format by content, `foreign`, the one door to parsers of others, `files`
that are read and written, `hdf5` dataclasses in HDF5.
"""
