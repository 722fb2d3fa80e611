"""`reduce`: a part of a model as matrices that other decks include."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ringtrue.api.reduction import reduce_model
from ringtrue.cli.model import Deck
from ringtrue.cli.show import Json, out, progress, rows, write_json
from ringtrue.reduction.part import ReductionSettings
from ringtrue.study.summary import finite


def reduce(
    deck: Deck,
    keep: Annotated[
        list[str],
        typer.Option(
            help="Points to join the part by, such as 101,102, or single DOFs such as 101+Z."
        ),
    ],
    below: Annotated[
        float, typer.Option(metavar="HZ", help="The error is stated for modes up to here.")
    ],
    target: Annotated[
        Path, typer.Option("--out", metavar="STEM", help="Write STEM.asm and STEM.pch.")
    ],
    method: Annotated[
        str, typer.Option(help="craig-bampton, guyan, or dynamic (exact at --at).")
    ] = "craig-bampton",
    n: Annotated[
        int | None,
        typer.Option("-n", help="Component modes; else all up to twice --below.", min=0),
    ] = None,
    at: Annotated[
        float | None, typer.Option(metavar="HZ", help="Frequency of the dynamic condensation.")
    ] = None,
    number: Annotated[int, typer.Option(help="Of the superelement.", min=1, max=999)] = 1,
    op4: Annotated[
        bool,
        typer.Option("--op4", help="The matrices in STEM.op4, in full precision, not as DMIG."),
    ] = False,
    json: Json = None,
) -> int:
    """Reduce a part to some of its points, and say what that does to each of its modes.

    The files are those of EXTSEOUT: INCLUDE the one in the bulk data of the whole, the other before
    its ENDDATA.

    Example: ringtrue reduce wing.bdf --keep 101,102 --below 50 --out wing
    """
    settings = ReductionSettings(below=below, method=method, modes=n, at=at)  # type: ignore[arg-type]
    with progress("reduce") as show:
        show(0.1, f"reducing {deck}")
        part = reduce_model(deck, keep, settings, number=number)
    written = part.write(target, op4=op4)
    if json:
        names = ("frequencies", "reduced", "deviations", "captured")
        numbers = {name: getattr(part, name).tolist() for name in names}
        write_json(finite({"kept": part.kept, "bound": part.bound, **numbers}), json)
    if json != "-":
        body = [
            (i + 1, f"{f:.5g}", _text(r, ".5g"), _text(d, ".2g"), f"{100 * c:.4g}")
            for i, (f, r, d, c) in enumerate(
                zip(part.frequencies, part.reduced, part.deviations, part.captured, strict=True)
            )
        ]
        heads = ("#", "f [Hz]", "reduced [Hz]", "off [%]", "energy captured [%]")
        rows(f"{deck}: {len(part.kept)} of its degrees of freedom", heads, body)
        others = "lower ones by less" if at is None else f"one at {at:g} Hz not at all"
        out.print(
            f"in any whole, a mode at {below:g} Hz moves by at most {part.bound:.2g} %, {others}"
        )
        out.print(f"written: {' '.join(map(str, written))}", soft_wrap=True)
        if op4:
            unit = part.external.unit
            out.print(f"above SOL: ASSIGN INPUTT4='{written[-1]}', UNIT={unit}", soft_wrap=True)
    return 0


def _text(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "missing"
