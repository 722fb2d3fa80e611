"""The one door to parsers of others: openpyxl, scipy.io, NumPy's files, tomllib, json, h5py,
nptdms, pyuff.

Nothing else in ringtrue imports or calls them to read (tests/architecture). Each parser has limits
of size and depth, and what it raises on a damaged file becomes an `InputError` that names the file
(`door`). A parser in C that can end the process or never come back runs in a process of its own
(`process`, `child`). `texts`: JSON and TOML. `hdf5`: links and storage outside of the file are
refused. `arrays`: .npy, .npz, sparse matrices from their parts. `workbooks`: Excel. `tdms`:
National Instruments. `wave`: RIFF. `universal`: pyuff writes.
"""
