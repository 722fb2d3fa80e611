"""The one door to parsers of others: openpyxl, scipy.io, NumPy's files, tomllib, json, h5py,
nptdms, pyuff.

Nothing else in ringtrue imports or calls them to read (tests/architecture). `door`: limits, errors
and the process for parsers that can end theirs; `child`: what runs in that process. `parsers`:
JSON, TOML, HDF5, Excel, TDMS, WAVE, .npy, .npz, sparse matrices from their parts.
"""
