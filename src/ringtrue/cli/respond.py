"""`frf` and `static`: how a deck answers to forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from csv import writer
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.models import (
    Deflections,
    FrfRequest,
    in_units,
    parse_points,
    responses_of,
)
from ringtrue.api.models import static as deflect
from ringtrue.cli.model import Deck
from ringtrue.cli.show import (
    Json,
    Units,
    err,
    file_to,
    progress,
    rows,
    warn_of_units,
    write_json,
)
from ringtrue.core.arrays import Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.decks.nastran.reader import read_damped_deck
from ringtrue.errors import ConfigError
from ringtrue.io.campaign_tables import STATICS
from ringtrue.io.files import atomic_write
from ringtrue.io.frfs import write_frfs
from ringtrue.plots.signals import frf_page

_SIDES = ("metre", "radian")


class Motion(StrEnum):
    """What responses measure."""

    ACCELERATION = "acceleration"
    VELOCITY = "velocity"
    DISPLACEMENT = "displacement"


def frf(
    deck: Deck,
    fmax: Annotated[
        float, typer.Option("--fmax", metavar="HZ", help="The highest line.")
    ],
    force: Annotated[
        list[str],
        typer.Option(
            "--force",
            metavar="POINT",
            help="Node and direction (3+Z) of a force; repeat it.",
        ),
    ],
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="POINT",
            help="Of a response; repeat it. If not given: where forces act.",
        ),
    ] = None,
    fmin: Annotated[
        float | None,
        typer.Option(
            "--fmin",
            metavar="HZ",
            help="The lowest line; if not given: one step above 0.",
        ),
    ] = None,
    lines: Annotated[int, typer.Option(help="Lines, in equal steps.", min=3)] = 800,
    damping: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO",
            help="Of all modes (0.01), in place of the damping of the deck.",
        ),
    ] = None,
    quantity: Annotated[
        Motion, typer.Option(help="Of the responses.")
    ] = Motion.ACCELERATION,
    direct: Annotated[
        bool,
        typer.Option(
            "--direct", help="Solve the full model at each line, without modes."
        ),
    ] = False,
    units: Units = "SI",
    target: Annotated[
        Path | None,
        file_to("--out", "Write the FRFs", ".h5", ".uff", ".csv"),
    ] = None,
    plot: Annotated[
        Path | None,
        file_to("--plot", "Write the curves as a page", ".html"),
    ] = None,
    json: Json = None,
) -> int:
    """Frequency responses of a deck: its modes with residual vectors, or the full model line by
    line.

    Directions are those of the basic frame, results in SI, of moments and rotations (3+RZ) too.
    Without --damping that of the deck counts: dashpots, GE, PARAM G, SDAMPING.

    Example: ringtrue frf wing.bdf --force 101+Z --at 205+Z --fmax 200 --damping 0.01 --out frf.h5
    --plot frf.html
    """
    lowest = fmax / lines if fmin is None else fmin
    if not 0 <= lowest < fmax:
        raise ConfigError(
            f"--fmin {lowest:g} --fmax {fmax:g}: must be 0 <= fmin < fmax"
        )
    asked = FrfRequest(
        frequencies=np.linspace(lowest, fmax, lines),
        forces=parse_points(force, "--force"),
        responses=parse_points(at or force, "--at"),
        quantity=quantity.value,
        damping=damping,
        direct=direct,
    )
    with progress("frf") as show:
        show(0.0, f"reading {deck}")
        model, modal = read_damped_deck(deck)
        warn_of_units(model, units)
        if direct and modal:
            err.print(
                "warning: SDAMPING is of modes: --direct leaves it out, as SOL 108 does"
            )
        found, held = responses_of(in_units(model, units), modal, asked, show)
    _warn_of_held(held)
    if target:
        write_frfs(target, found)
    if plot:
        with atomic_write(plot) as path:
            path.write_text(frf_page(str(deck), found), encoding="utf-8")
    if json:
        write_json(_frf_json(found), json)
    if json != "-":
        _print_frfs(deck, found)
    return 0


def _warn_of_held(held: Sequence[str]) -> None:
    for c in held:
        err.print(
            f"warning: {c} is held: it does not move, and a force there moves nothing"
        )


def _print_frfs(deck: Path, found: FrfSet) -> None:
    size = np.abs(found.data)
    body = [
        (
            c.id,
            f.id,
            f"{size[:, i, j].max():.4g}",
            _unit(c, f),
            f"{found.freqs[size[:, i, j].argmax()]:.5g}",
        )
        for j, f in enumerate(found.inputs)
        for i, c in enumerate(found.outputs)
    ]
    heads = ("response", "force", "largest", "unit", "at Hz")
    rows(
        f"{deck}: {found.kind}, {found.freqs[0]:.4g} to {found.freqs[-1]:.4g} Hz",
        heads,
        body,
    )


def _unit(response: Channel, force: Channel) -> str:
    under = f"({force.unit})" if "*" in force.unit else force.unit
    return f"({response.unit})/{under}"


def _frf_json(found: FrfSet) -> dict[str, object]:
    return {
        "kind": found.kind,
        "unit": ", ".join(
            dict.fromkeys(_unit(c, f) for c in found.outputs for f in found.inputs)
        ),
        "frequencies_hz": found.freqs.tolist(),
        "frfs": [
            {
                "response": c.id,
                "force": f.id,
                "unit": _unit(c, f),
                "re": h.real.tolist(),
                "im": h.imag.tolist(),
            }
            for i, c in enumerate(found.outputs)
            for j, f in enumerate(found.inputs)
            for h in [found.data[:, i, j]]
        ],
    }


def static(
    deck: Deck,
    force: Annotated[
        list[str] | None,
        typer.Option(
            "--force",
            metavar="POINT[=N]",
            help="A load case: 3+Z=250 is 250 N, 3+RZ=2 2 N m; repeat it. If not given: the "
            "loads of the deck.",
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="POINT",
            help="Of a deflection; repeat it. If not given: where --force acts.",
        ),
    ] = None,
    units: Units = "SI",
    table: Annotated[
        Path | None,
        file_to("--csv", "Write the table that a static test of a study has", ".csv"),
    ] = None,
    json: Json = None,
) -> int:
    """Deflections of a deck under its own loads, or under single forces, each a load case of its
    own.

    Directions are those of the basic frame, results in SI, of moments (3+RZ=2, N m) and rotations
    too. Of the deck forces, moments, pressures, PLOAD1 on beams, GRAV and displaced supports (SPCD,
    SPC) are read.

    Example: ringtrue static frame.bdf --force 101-Z=1000 --at 101+Z --at 205+X --units mm-t-s
    """
    if not (at or force):
        raise ConfigError(
            "--at: name the points whose deflections are wanted, such as 101+Z"
        )
    if table and not force:
        raise ConfigError("--csv: a static test has forces at points; give --force")
    given = dict(_load(text) for text in force or [])
    with progress("static") as show:
        show(0.0, f"reading {deck}")
        found = deflect(deck, forces=given, responses=at, units=units, progress=show)
    if found.model:
        warn_of_units(found.model, units)
    _warn_of_held(found.held)
    if table:
        _write_static(table, given, found)
    load_cases = [
        _case_json(name, found.points, u)
        for name, u in zip(found.cases, found.values, strict=True)
    ]
    if json:
        write_json({"deck": str(deck), "cases": load_cases}, json)
    if json != "-":
        every = [
            (c["case"], p, f"{x:.6g}", unit)
            for c in load_cases
            for unit in _SIDES
            for p, x in c[unit].items()
        ]
        heads = ("case", "at", "deflection", "unit")
        rows(
            f"{deck}: {len(load_cases)} load case{'s' if len(load_cases) > 1 else ''}",
            heads,
            every,
        )
    return 0


def _case_json(case: str, points: Sequence[str], moved: Float) -> dict[str, Any]:
    """A load case with the deflections at translations and at rotations."""
    about = np.abs(DofSet.parse(points).direction) > 3
    found = list(zip(points, moved.tolist(), about.tolist(), strict=True))
    sides = {
        side: {p: x for p, x, a in found if a == (side == "radian")} for side in _SIDES
    }
    return {"case": case, **sides}


def _load(text: str) -> tuple[str, float]:
    """Point and force, N, of `3+Z=250` or `3+Z`."""
    point, given, value = text.partition("=")
    try:
        size = float(value) if given else 1.0
    except ValueError:
        size = 0.0
    if not (np.isfinite(size) and size):
        raise ConfigError(
            f"--force {text}: the form is 101+Z or 101+Z=250, with a force in N"
        )
    return point, size


def _write_static(path: Path, forces: Mapping[str, float], found: Deflections) -> None:
    """A row a case and channel, as `io.campaign_tables.read_statics` reads them."""
    with (
        atomic_write(path) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        sheet = writer(file)
        sheet.writerow(STATICS)
        labels = DofSet.parse(forces).labels()
        for point, newton, values in zip(
            labels, forces.values(), found.values, strict=True
        ):
            load = f"{newton:.9g}"
            if point not in found.points:
                sheet.writerow((point, point, load, ""))
            for channel, deflection in zip(found.points, values.tolist(), strict=True):
                acting = load if channel == point else ""
                sheet.writerow((point, channel, acting, f"{deflection:.9g}"))
