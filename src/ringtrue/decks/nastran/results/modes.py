"""Modes, static deflections and frequency responses of files of results, by their content."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.decks.nastran.results.geometry import held_model
from ringtrue.decks.nastran.results.op2_motions import (
    read_op2,
    read_op2_deflections,
    read_op2_responses,
)
from ringtrue.decks.nastran.results.printed import read_f06, read_punch
from ringtrue.decks.nastran.results.recorded import (
    RecordedDeflections,
    RecordedModes,
    deflections,
    gathered,
    motions,
    to_deflections,
    to_mode_set,
    to_responses,
)
from ringtrue.errors import DataError, about
from ringtrue.io.foreign.parsers import open_hdf5
from ringtrue.io.recognition import SOLVER_RESULTS, Format, format_of, refuse_format
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Model

_RESULT = "NASTRAN/RESULT"
_COMPONENTS = ("X", "Y", "Z", "RX", "RY", "RZ")


class _Analysis(IntEnum):
    """ANALYSIS of a domain."""

    STATICS = 1
    MODES = 2


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
    lam = domains["TIME_FREQ_EIGR"].astype(np.float64)
    rows = _node_rows(file, shapes, domains["ID"])
    return gathered(lam, _masses(file, domains["MODE"], lam), rows, _node_frames(file))


def _deflections(file: h5py.File) -> RecordedDeflections | None:
    at = f"{_RESULT}/NODAL/DISPLACEMENT"
    if at not in file:
        return None
    moved = file[at][()]
    domains = file[f"{_RESULT}/DOMAINS"][()]
    here = (domains["ANALYSIS"] == _Analysis.STATICS) & np.isin(
        domains["ID"], moved["DOMAIN_ID"]
    )
    domains = domains[here & (domains["SE"] == 0)]
    if not domains.size:
        return None
    m = motions(_node_rows(file, moved, domains["ID"]), _node_frames(file))
    return deflections(m, tuple(domains["SUBCASE"].tolist()))


def _node_rows(file: h5py.File, table: Any, domains: Int) -> list[tuple[Any, Any, Any]]:
    spoint = "NASTRAN/INPUT/NODE/SPOINT"
    scalar_points = (
        file[spoint][()]["ID"] if spoint in file else np.empty(0, dtype=np.int64)
    )
    rows = []
    for domain in domains.tolist():
        part = table[table["DOMAIN_ID"] == domain]
        motion = np.stack([part[c] for c in _COMPONENTS], axis=1).astype(np.float64)
        rows.append(
            (part["ID"].astype(np.int64), np.isin(part["ID"], scalar_points), motion)
        )
    return rows


def _node_frames(file: h5py.File) -> dict[int, int]:
    grid = file.get("NASTRAN/INPUT/NODE/GRID")
    if grid is None:
        return {}
    return dict(zip(grid["ID"].tolist(), grid["CD"].tolist(), strict=True))


def _domains(domains: Any, used: Int) -> Any:
    """The rows of real modes of one subcase and superelement, by mode."""
    found = domains[
        (domains["ANALYSIS"] == _Analysis.MODES)
        & np.isin(domains["ID"], used)
        & (domains["MODE"] > 0)
    ]
    if not found.size:
        raise DataError("no domain of real modes")
    # each superelement may have a subcase of its own: the residual structure is 0
    found = found[found["SE"] == found["SE"].min()]
    found = found[found["SUBCASE"] == found["SUBCASE"].min()]
    found = found[np.argsort(found["MODE"], kind="stable")]
    if np.unique(found["MODE"]).size != found.size:
        raise DataError("a mode occurs twice in one subcase")
    return found


def _masses(file: h5py.File, modes: Int, lam: Any) -> Any:
    at = f"{_RESULT}/SUMMARY/EIGENVALUE"
    mass = np.full(modes.size, np.nan)
    if at in file:
        table = file[at][()]
        for k, (mode, value) in enumerate(
            zip(modes.tolist(), lam.tolist(), strict=True)
        ):
            same = table[
                (table["MODE"] == mode)
                & np.isclose(table["EIGEN"], value, rtol=1e-6, atol=1e-12)
            ]
            mass[k] = same["MASS"][0] if same.size else np.nan
    return mass


_READERS = {
    Format.OP2: read_op2,
    Format.F06: read_f06,
    Format.PUNCH: read_punch,
    Format.HDF5: read_nastran_h5,
}


def is_solver_result(path: str | Path) -> bool:
    """Whether a file holds results of Nastran or MYSTRAN."""
    held = format_of(path)
    return held in SOLVER_RESULTS or (held is Format.HDF5 and is_nastran_h5(path))


def read_recorded(path: str | Path) -> RecordedModes:
    """Modes as the file gives them: OP2, F06, punch or HDF5.

    Raises
    ------
    DataError
        If the file is missing, damaged or holds no real modes.
    """
    path = Path(path)
    held = format_of(path)
    if held not in _READERS:
        refuse_format(path, "results of a solver", tuple(_READERS))
    return _READERS[held](path)


def read_nastran_modes(
    path: str | Path, model: Model | None = None, *, mass_normalised: bool = False
) -> ModeSet:
    """Modes of a results file in the basic frame.

    Parameters
    ----------
    path : path
        OP2, F06, punch or HDF5 (of MSC Nastran).
    model : Model, optional
        The deck of the run: turns shapes from the displacement frames (CD) and knows how they were
        scaled. Without it the one that an OP2 holds (GEOM1, DYNAMICS) counts.
    mass_normalised : bool
        The shapes have unit modal mass although the file does not say so.

    Raises
    ------
    DataError
        If the file is missing, damaged, holds no real modes or is of another model.
    """
    found = read_recorded(path)
    if model is None and format_of(path) is Format.OP2:
        model = held_model(path, found.nodes[~found.scalar])
    try:
        known = mass_normalised or (model is not None and asks_for_unit_mass(model))
        return to_mode_set(found, model, mass_normalised=known, source=str(path))
    except DataError as e:
        raise DataError(f"{path}: {e}") from e


def read_recorded_deflections(path: str | Path) -> RecordedDeflections | None:
    """Displacements of the static subcases as the file gives them: OP2 or HDF5; None of a file
    without.

    Raises
    ------
    DataError
        If the file is missing or damaged.
    """
    path = Path(path)
    held = format_of(path)
    if held is Format.OP2:
        return read_op2_deflections(path)
    if held is Format.HDF5 and is_nastran_h5(path):
        with open_hdf5(path, "HDF5 file of Nastran") as file, about(path):
            return _deflections(file)
    return None


def read_nastran_deflections(
    path: str | Path, model: Model | None = None
) -> tuple[tuple[str, ...], DofSet, Float]:
    """Names of the static subcases, DOFs, and deflections (case, dof) in the basic frame.

    Parameters
    ----------
    path : path
        OP2 or HDF5 (of MSC Nastran).
    model : Model, optional
        The deck of the run: turns motions from the displacement frames (CD). Without it the one
        that an OP2 holds counts.

    Raises
    ------
    DataError
        If the file is missing, damaged, holds no static deflections or is of another model.
    """
    found = read_recorded_deflections(path)
    if found is None:
        raise DataError(
            f"{path}: no static deflections; allowed is an OP2 or HDF5 file of a run with "
            "DISPLACEMENT(PLOT) = ALL and PARAM,POST,-1 or MDLPRM,HDF5,0"
        )
    if model is None and format_of(path) is Format.OP2:
        model = held_model(path, found.nodes[~found.scalar])
    with about(path):
        dofs, moved = to_deflections(found, model)
    return tuple(f"subcase {case}" for case in found.cases), dofs, moved


@dataclass(frozen=True, slots=True, eq=False)
class NastranResponse:
    """A frequency response of a subcase, in the basic frame and the units of the run.

    Attributes
    ----------
    case : str
    quantity : str
        "displacements", "velocities" or "accelerations".
    frequencies : (f,) float64, Hz
    dofs : DofSet
    values : (f, dof) complex128
    """

    case: str
    quantity: str
    frequencies: Float
    dofs: DofSet
    values: Complex


def read_nastran_responses(
    path: str | Path, model: Model | None = None
) -> tuple[NastranResponse, ...]:
    """Frequency responses of an OP2 file, in SORT1 or SORT2; none of a file without.

    Parameters
    ----------
    path : path
    model : Model, optional
        The deck of the run: turns motions from the displacement frames (CD). Without it the one
        that the file holds counts.

    Raises
    ------
    DataError
        If the file is missing, damaged, or of another model.
    """
    found = read_op2_responses(path) if format_of(path) is Format.OP2 else ()
    out = []
    for response in found:
        own = model or held_model(path, response.nodes[~response.scalar])
        with about(path):
            dofs, values = to_responses(response, own)
        case = f"subcase {response.case}"
        frequencies = response.frequencies
        out.append(NastranResponse(case, response.quantity, frequencies, dofs, values))
    return tuple(out)


def asks_for_unit_mass(model: Model) -> bool:
    """Whether the deck's EIGRL, EIGRA or EIGR scales the shapes to unit modal mass, as it does if
    it says nothing.
    """
    tables = [model[card] for card in METHODS if card in model]
    named = [
        t["NORM"][(t["SID"] == model.case.method) | (model.case.method == 0)].tolist()
        for t in tables
    ]
    chosen = [str(n).upper() for names in named for n in names]
    return bool(chosen) and all(n in ("", "MASS") for n in chosen)
