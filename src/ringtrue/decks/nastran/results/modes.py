"""Modes of any results file of a Nastran-like program."""

from __future__ import annotations

from pathlib import Path

from ringtrue.core.modes import ModeSet
from ringtrue.decks.nastran.results.f06 import read_f06
from ringtrue.decks.nastran.results.hdf5 import read_nastran_h5
from ringtrue.decks.nastran.results.op2 import read_op2
from ringtrue.decks.nastran.results.punch import read_punch
from ringtrue.decks.nastran.results.recorded import RecordedModes, to_mode_set
from ringtrue.errors import DataError, did_you_mean
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Model

READERS = {
    ".op2": read_op2,
    ".f06": read_f06,
    ".out": read_f06,  # of Autodesk Nastran and others
    ".pch": read_punch,
    ".h5": read_nastran_h5,
}


def read_recorded(path: str | Path) -> RecordedModes:
    """Modes as the file gives them, by its ending: .op2, .f06 (.out), .pch or .h5.

    Raises
    ------
    DataError
        If the file is missing, damaged or holds no real modes.
    """
    path = Path(path)
    ext = path.suffix.lower()
    if ext not in READERS:
        raise DataError(f"{path}: format {ext!r}{did_you_mean(ext, READERS)}")
    return READERS[ext](path)


def read_nastran_modes(
    path: str | Path, model: Model | None = None, *, mass_normalised: bool = False
) -> ModeSet:
    """Modes of a results file in the basic frame.

    Parameters
    ----------
    path : path
        .op2, .f06 (.out), .pch or .h5 (of MSC Nastran).
    model : Model, optional
        The deck of the run: turns shapes from the displacement frames (CD) and knows how they were
        scaled.
    mass_normalised : bool
        The shapes have unit modal mass although the file does not say so.

    Raises
    ------
    DataError
        If the file is missing, damaged, holds no real modes or is of another model.
    """
    found = read_recorded(path)
    try:
        known = mass_normalised or (model is not None and asks_for_unit_mass(model))
        return to_mode_set(found, model, mass_normalised=known, source=str(path))
    except DataError as e:
        raise DataError(f"{path}: {e}") from e


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
