"""`convert`: modes from one file format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ringtrue.cli.show import out
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.hdf5 import is_nastran_h5
from ringtrue.decks.nastran.results.modes import READERS, read_nastran_modes
from ringtrue.errors import DataError, InputError
from ringtrue.io.modes_json import read_modes, read_std, write_modes

_TRANSLATIONS_ONLY = (".uff", ".unv", ".55")


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="Modes: .op2 .f06 (.out) .pch .h5 of a solver, or .json .h5 .uff .csv .xlsx."
        ),
    ],
    target: Annotated[Path, typer.Argument(help="What to write: .h5 .json .uff .csv.")],
    deck: Annotated[
        Path | None,
        typer.Option(
            help="The deck of the run: turns displacement frames (CD) to the basic frame."
        ),
    ] = None,
) -> int:
    """Modes from one format to another: results of Nastran or MYSTRAN to a mode set.

    Example: ringtrue convert modes.op2 modes.h5 --deck wing.bdf
    """
    modes, spread = _read(source, deck)
    write_modes(target, writable(modes, target), spread)
    f = modes.frequencies
    span = f"{f.min():.5g} to {f.max():.5g} Hz"
    out.print(f"{target}: {len(modes)} modes, {span}, {len(modes.labels)} rows, scale {modes.norm}")
    return 0


def _read(source: Path, deck: Path | None) -> tuple[ModeSet, Uncertainty | None]:
    """Modes, and the standard deviations of a test."""
    ext, spread = source.suffix.lower(), None
    if ext in READERS and (ext != ".h5" or is_nastran_h5(source)):
        modes = read_nastran_modes(source, read_deck(deck) if deck else None)
    elif deck:
        raise InputError(f"--deck {deck}: {source} is no results file of a solver")
    else:
        modes, std = read_modes(source), read_std(source)
        if np.isfinite(std).any():
            spread = Uncertainty.independent(*std, np.full(modes.shapes.shape, np.nan))
    if not len(modes):
        raise DataError(f"{source}: no modes")
    return modes, spread


def writable(modes: ModeSet, target: Path) -> ModeSet:
    """The rows that a file of that ending holds: of data set 55, translations of grid points."""
    if target.suffix.lower() not in _TRANSLATIONS_ONLY:
        return modes
    labels = modes.labels if isinstance(modes.labels, DofSet) else DofSet.parse(modes.labels)
    keep = np.flatnonzero((np.abs(labels.direction) >= 1) & (np.abs(labels.direction) <= 3))
    return modes.rows([modes.channels[i] for i in keep.tolist()])
