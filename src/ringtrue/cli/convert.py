"""`convert`: modes from one file format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ringtrue.api.measurements import read_modes, read_sensors, write_modes
from ringtrue.api.models import read_deck
from ringtrue.cli.show import out
from ringtrue.decks.nastran.results.modes import is_solver_result
from ringtrue.errors import DataError, InputError


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="Modes: .op2 .f06 (.out) .pch .h5 of a solver, or .json .h5 .uff .csv .xlsx; "
            "or study.h5: the modes merged in a study."
        ),
    ],
    target: Annotated[Path, typer.Argument(help="What to write: .h5 .json .uff .csv.")],
    deck: Annotated[
        Path | None,
        typer.Option(
            help="The deck of the run: turns displacement frames (CD) to the basic frame."
        ),
    ] = None,
    sensors: Annotated[
        Path | None,
        typer.Option(help="Sensor sheet: its points and lines go into a .uff with the modes."),
    ] = None,
) -> int:
    """Modes from one format to another: results of Nastran or MYSTRAN to a mode set.

    Example: ringtrue convert modes.op2 modes.h5 --deck wing.bdf
    """
    if deck is not None and (not is_solver_result(source)):
        raise InputError(f"--deck {deck}: {source} is no results file of a solver")
    found = read_modes(source, deck=read_deck(deck) if deck else None)
    if not len(found):
        raise DataError(f"{source}: no modes")
    modes = write_modes(target, found, sensors=read_sensors(sensors) if sensors else None)
    f = modes.frequencies
    span = f"{f.min():.5g} to {f.max():.5g} Hz"
    out.print(f"{target}: {len(modes)} modes, {span}, {len(modes.labels)} rows, scale {modes.norm}")
    return 0
