"""HDF5 files for reading; links and storage outside of them are refused, unless
`RINGTRUE_HDF5_OUTSIDE=1` is set.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from ringtrue.errors import DataError
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import EXPORT_AGAIN, door
from ringtrue.io.foreign.process import need_not_try, tried_apart

OUTSIDE = "RINGTRUE_HDF5_OUTSIDE"  # environment variable
_PARSER = "hdf5"


@contextmanager
def open_hdf5(
    path: str | Path, kind: str = "HDF5 file", advice: str = EXPORT_AGAIN
) -> Iterator[h5py.File]:
    """The file for reading; all that HDF5 raises on damage within the block names it.

    Raises
    ------
    DataError
        If the file is missing, damaged, or has data in other files: one that was sent could else
        show what stands in any file that its reader may open.
    """
    path = existing(path)
    with door(path, kind, advice=advice):
        outside = tried_apart(_PARSER, path, kind, advice)
        if outside and os.environ.get(OUTSIDE) != "1":
            raise DataError(
                f"{path}: {outside}, outside of the file; if you trust it, set {OUTSIDE}=1"
            )
        with h5py.File(path, "r") as file:
            yield file


def trust_hdf5(path: str | Path) -> None:
    """Note that this process has written the file as it stands: it is not tried before it is
    opened.
    """
    need_not_try(_PARSER, Path(path), "")


def is_hdf5(path: str | Path) -> bool:
    """Whether a file begins as HDF5 files do."""
    return bool(h5py.is_hdf5(path))
