"""HDF5 results of MSC Nastran (MDLPRM,HDF5,0): modes, and the frames of the nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.decks.nastran.results.recorded import RecordedModes, gathered
from ringtrue.errors import DataError, about
from ringtrue.io.foreign.hdf5 import open_hdf5

_RESULT = "NASTRAN/RESULT"
_MODES = 2  # ANALYSIS of a domain of real modes
_COMPONENTS = ("X", "Y", "Z", "RX", "RY", "RZ")


def is_nastran_h5(path: str | Path) -> bool:
    """Whether an HDF5 file holds Nastran's groups."""
    try:
        with open_hdf5(path) as file:
            return _RESULT in file
    except DataError:
        return False


def read_nastran_h5(path: str | Path) -> RecordedModes:
    """Modes of the first subcase that has them, of the residual structure.

    Raises
    ------
    DataError
        If the file is missing, cut off or holds no real modes.
    """
    with open_hdf5(path, "HDF5 file of Nastran") as file, about(path):
        return _read(file)


def _read(file: h5py.File) -> RecordedModes:
    at = f"{_RESULT}/NODAL/EIGENVECTOR"
    if at not in file:
        raise DataError(f"no {at}: ask for DISPLACEMENT = ALL and MDLPRM,HDF5,0")
    shapes = file[at][()]
    domains = _domains(file[f"{_RESULT}/DOMAINS"][()], shapes["DOMAIN_ID"])
    rows = []
    scalar_points = _scalar_points(file)
    for domain in domains["ID"].tolist():
        part = shapes[shapes["DOMAIN_ID"] == domain]
        motion = np.stack([part[c] for c in _COMPONENTS], axis=1).astype(np.float64)
        rows.append((part["ID"].astype(np.int64), np.isin(part["ID"], scalar_points), motion))
    lam = domains["TIME_FREQ_EIGR"].astype(np.float64)
    return gathered(lam, _masses(file, domains["MODE"], lam), rows, _frames(file))


def _domains(domains: Any, used: Int) -> Any:
    """The rows of real modes of one subcase and superelement, by mode."""
    found = domains[
        (domains["ANALYSIS"] == _MODES) & np.isin(domains["ID"], used) & (domains["MODE"] > 0)
    ]
    if not found.size:
        raise DataError("no domain of real modes")
    found = found[found["SUBCASE"] == found["SUBCASE"].min()]
    found = found[found["SE"] == found["SE"].min()]
    found = found[np.argsort(found["MODE"], kind="stable")]
    if np.unique(found["MODE"]).size != found.size:
        raise DataError("a mode occurs twice in one subcase")
    return found


def _masses(file: h5py.File, modes: Int, lam: Any) -> Any:
    at = f"{_RESULT}/SUMMARY/EIGENVALUE"
    mass = np.full(modes.size, np.nan)
    if at in file:
        table = file[at][()]
        for k, (mode, value) in enumerate(zip(modes.tolist(), lam.tolist(), strict=True)):
            same = table[
                (table["MODE"] == mode) & np.isclose(table["EIGEN"], value, rtol=1e-6, atol=1e-12)
            ]
            mass[k] = same["MASS"][0] if same.size else np.nan
    return mass


def _frames(file: h5py.File) -> dict[int, int]:
    at = "NASTRAN/INPUT/NODE/GRID"
    if at not in file:
        return {}
    grid = file[at][()]
    return dict(zip(grid["ID"].tolist(), grid["CD"].tolist(), strict=True))


def _scalar_points(file: h5py.File) -> Int:
    at = "NASTRAN/INPUT/NODE/SPOINT"
    return file[at][()]["ID"].astype(np.int64) if at in file else np.empty(0, dtype=np.int64)
