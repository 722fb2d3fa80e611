"""`convert`: modes from one file format to another, and what else a results file holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from csv import writer
from pathlib import Path
from typing import Annotated

import typer

from ringtrue.api.measurements import read_modes, read_sensors, write_modes
from ringtrue.api.models import read_deck, read_deflections
from ringtrue.cli.show import out
from ringtrue.decks.nastran.results.geometry import read_recorded_model
from ringtrue.decks.nastran.results.modes import (
    NastranResponse,
    is_solver_result,
    read_nastran_responses,
    read_recorded_deflections,
)
from ringtrue.errors import DataError, InputError
from ringtrue.io.files import atomic_write
from ringtrue.model.model import Model

DECKS = (".bdf", ".dat", ".nas")


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="Modes: .op2 .f06 (.out) .pch .h5 of a solver, or .json .h5 .uff .csv .xlsx; "
            "or study.h5: the modes merged in a study."
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            help="What to write: .h5 .json .uff .csv; .bdf .dat .nas: the deck in an .op2; .csv of "
            "statics: the deflections; of frequency responses in an .op2: these."
        ),
    ],
    deck: Annotated[
        Path | None,
        typer.Option(
            help="The deck of the run: turns displacement frames (CD) to the basic frame."
        ),
    ] = None,
    sensors: Annotated[
        Path | None,
        typer.Option(
            help="Sensor sheet: its points and lines go into a .uff with the modes."
        ),
    ] = None,
) -> int:
    """Modes from one format to another: results of Nastran or MYSTRAN to a mode set; or the deck
    that an OP2 holds, or the deflections of a static run or the frequency responses of an OP2 (in
    the units of the run).

    Example: ringtrue convert modes.op2 modes.h5
    """
    if deck is not None and (not is_solver_result(source)):
        raise InputError(f"--deck {deck}: {source} is no results file of a solver")
    if target.suffix.lower() in DECKS:
        if deck is not None or sensors is not None:
            raise InputError(
                f"{target}: --deck and --sensors belong to modes, and this is a deck"
            )
        return _deck(source, target)
    model = read_deck(deck) if deck else None
    try:
        found = read_modes(source, deck=model)
    except DataError:
        if target.suffix.lower() != ".csv" or not is_solver_result(source):
            raise
        if read_recorded_deflections(source) is not None:
            return _deflections(source, target, model)
        if responses := read_nastran_responses(source, model):
            return _responses(responses, target)
        raise
    if not len(found):
        raise DataError(f"{source}: no modes")
    modes = write_modes(
        target, found, sensors=read_sensors(sensors) if sensors else None
    )
    f = modes.frequencies
    span = f"{f.min():.5g} to {f.max():.5g} Hz"
    out.print(
        f"{target}: {len(modes)} modes, {span}, {len(modes.labels)} rows, scale {modes.norm}"
    )
    return 0


def _deflections(source: Path, target: Path, deck: Model | None) -> int:
    found = read_deflections(source, deck=deck)
    with (
        atomic_write(target) as new,
        new.open("w", newline="", encoding="utf-8") as file,
    ):
        table = writer(file)
        table.writerow(("case", "at", "deflection"))
        for case, values in zip(found.cases, found.values, strict=True):
            table.writerows(
                (case, at, f"{moved:.9g}")
                for at, moved in zip(found.points, values.tolist(), strict=True)
            )
    cases = len(found.cases)
    out.print(
        f"{target}: {cases} case{'s' * (cases > 1)}, {len(found.points)} deflections each"
    )
    return 0


def _responses(found: Sequence[NastranResponse], target: Path) -> int:
    with (
        atomic_write(target) as new,
        new.open("w", newline="", encoding="utf-8") as file,
    ):
        table = writer(file)
        table.writerow(("case", "quantity", "frequency", "at", "real", "imaginary"))
        for one in found:
            at = one.dofs.labels()
            for frequency, values in zip(one.frequencies, one.values, strict=True):
                head = (one.case, one.quantity, f"{frequency:.9g}")
                table.writerows(
                    (*head, point, f"{v.real:.9g}", f"{v.imag:.9g}")
                    for point, v in zip(at, values.tolist(), strict=True)
                )
    first = found[0]
    cases = len({one.case for one in found})
    what = ", ".join(dict.fromkeys(one.quantity for one in found))
    f = first.frequencies
    out.print(
        f"{target}: {what}, {cases} case{'s' * (cases > 1)}, {f.size} frequencies, "
        f"{f.min():.5g} to {f.max():.5g} Hz, {len(first.dofs)} rows each"
    )
    return 0


def _deck(source: Path, target: Path) -> int:
    found = read_recorded_model(source)
    text = found.deck()
    with atomic_write(target) as new:
        new.write_text(text, encoding="ascii")
    counts = Counter({card: len(table) for card, table in found.model.tables.items()})
    counts.update(card.split(maxsplit=1)[0].rstrip("*") for card in found.texts)
    out.print(f"{target}: {', '.join(f'{n} {card}' for card, n in counts.items())}")
    for name, words in found.missing.items():
        out.print(f"not rebuilt: {name}, {words} words")
    return 0
