"""`frf` and `static`: how a deck answers to forces."""

from __future__ import annotations

from csv import writer
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.cli.ema import Motion
from ringtrue.cli.model import Deck
from ringtrue.cli.show import Json, Units, err, file_to, progress, rows, write_json
from ringtrue.cli.stated import stated, warn_of_units
from ringtrue.core.arrays import Complex, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.motions import FRF_KIND, channel
from ringtrue.core.progress import part
from ringtrue.core.signals import Channel, FrfKind, FrfSet
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.reader import read_damped_deck, read_deck, read_loaded_deck
from ringtrue.errors import ConfigError, InputError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.frfs import write_frfs
from ringtrue.io.statics import COLUMNS
from ringtrue.model.case_control import ModalDamping, responding
from ringtrue.model.ports import ModesRequest
from ringtrue.plots.responses import frf_page
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.study.loads import load_vectors, refuse_displaced, support_motions

_SIDES = ("metre", "radian")
ABOVE = 2.0  # modes up to here over the highest line; residual vectors stand for the rest


def frf(
    deck: Deck,
    fmax: Annotated[float, typer.Option("--fmax", metavar="HZ", help="The highest line.")],
    force: Annotated[
        list[str],
        typer.Option(
            "--force", metavar="POINT", help="Node and direction (3+Z) of a force; repeat it."
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
            "--fmin", metavar="HZ", help="The lowest line; if not given: one step above 0."
        ),
    ] = None,
    lines: Annotated[int, typer.Option(help="Lines, in equal steps.", min=3)] = 800,
    damping: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO", help="Of all modes (0.01), in place of the damping of the deck."
        ),
    ] = None,
    quantity: Annotated[Motion, typer.Option(help="Of the responses.")] = Motion.ACCELERATION,
    direct: Annotated[
        bool, typer.Option("--direct", help="Solve the full model at each line, without modes.")
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
        raise ConfigError(f"--fmin {lowest:g} --fmax {fmax:g}: must be 0 <= fmin < fmax")
    if direct and damping is not None:
        raise ConfigError("--direct has the damping of the deck; --damping is for modes")
    if damping is not None and not 0 < damping < 1:
        raise ConfigError(f"--damping {damping:g}: must be a ratio between 0 and 1, such as 0.01")
    into, heard = points("--force", force), points("--at", at or force)
    unit, freqs = UNIT_SYSTEMS[units], np.linspace(lowest, fmax, lines)
    with progress("frf") as show:
        show(0.0, f"reading {deck}")
        model, modal = read_damped_deck(deck)
        model = stated(model, units)
        if modal:
            modal = replace(modal, frequencies=modal.frequencies / unit.time)
        with EmbeddedSolver(progress=part(show, 0.2, 1.0)).open(responding(model)) as analysis:
            if damping is None and not (analysis.has_damping or (modal and not direct)):
                own = "the deck has no damping of its own (dashpots, GE, PARAM G"
                lost = (
                    f"--direct: {own}): leave --direct out"
                    if direct
                    else f"{own}, SDAMPING): give --damping 0.01"
                )
                raise ConfigError(lost)
            if direct and modal:
                err.print("warning: SDAMPING is of modes: --direct leaves it out, as SOL 108 does")
            _warn_of_held(analysis, heard, into)
            ratios = modal if damping is None else damping
            h = (
                _responses(analysis, (heard, into), freqs, ratios, FRF_KIND[quantity], direct)
                / unit.kilograms
            )
            h = h * np.outer(heard.per_length(unit.length), into.per_length(unit.length))
    found = FrfSet(
        h,
        freqs,
        tuple(channel(c, quantity.value) for c in heard.labels()),
        tuple(channel(c, "force") for c in into.labels()),
        kind=FRF_KIND[quantity],
        source=str(deck),
        sharp=True,
    )
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


def points(option: str, given: list[str]) -> DofSet:
    """Points such as 101+Z or, of rotations and moments, 101+RZ as DOFs.

    Raises
    ------
    ConfigError
        If one is no DOF, has no direction or is given twice.
    """
    try:
        dofs = DofSet.parse(p for text in given for p in text.split(","))
    except InputError as e:
        raise ConfigError(f"{option}: {e}") from e
    if (bare := np.flatnonzero(dofs.direction == 0)).size:
        raise ConfigError(
            f"{option} {dofs.labels()[bare[0]]}: must be a node and a direction, such as 101+Z "
            "or 101+RZ"
        )
    return dofs


def _responses(
    analysis: EmbeddedAnalysis,
    ends: tuple[DofSet, DofSet],
    freqs: Float,
    damping: float | ModalDamping | None,
    kind: FrfKind,
    direct: bool,
) -> Complex:
    heard, into = ends
    if direct:
        return analysis.frf_direct(heard, into, freqs, kind=kind)
    basis = ModesRequest(band=(0.0, ABOVE * float(freqs[-1])))
    return analysis.frf(heard, into, freqs, basis, damping=damping, kind=kind)


def _warn_of_held(analysis: EmbeddedAnalysis, *ends: DofSet, moved: Float | None = None) -> None:
    free = np.diff(analysis.system.transform.indptr) > 0
    free |= False if moved is None else moved.any(axis=1)
    points = [c for end in ends for c in end.labels()]
    row = np.concatenate([analysis.dofs.find(end.node, end.direction) for end in ends])
    if lost := [c for c, r in zip(points, row, strict=True) if r < 0]:
        raise ConfigError(f"the deck has no {' '.join(dict.fromkeys(lost))}")
    held = [c for c, ok in zip(points, free[row], strict=True) if not ok]
    for c in dict.fromkeys(held):
        err.print(f"warning: {c} is held: it does not move, and a force there moves nothing")


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
    rows(f"{deck}: {found.kind}, {found.freqs[0]:.4g} to {found.freqs[-1]:.4g} Hz", heads, body)


def _unit(response: Channel, force: Channel) -> str:
    under = f"({force.unit})" if "*" in force.unit else force.unit
    return f"({response.unit})/{under}"


def _frf_json(found: FrfSet) -> dict[str, object]:
    return {
        "kind": found.kind,
        "unit": ", ".join(dict.fromkeys(_unit(c, f) for c in found.outputs for f in found.inputs)),
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
        raise ConfigError("--at: name the points whose deflections are wanted, such as 101+Z")
    if table and not force:
        raise ConfigError("--csv: a static test has forces at points; give --force")
    given = dict(_load(text) for text in force or [])
    into, heard = points("--force", list(given)), points("--at", at or list(given))
    newtons = np.array(list(given.values()))
    unit = UNIT_SYSTEMS[units]
    with progress("static") as show:
        show(0.0, f"reading {deck}")
        model, cases = (read_deck(deck), ()) if force else read_loaded_deck(deck)
        warn_of_units(model, units)
        show(0.3, "solving")
        with EmbeddedSolver().open(model) as analysis:
            if force:
                refuse_displaced(model)
                newton = into.per_length(unit.length) / unit.force
                acting, carried = (
                    _unit_loads(analysis, into) * (newtons * newton),
                    np.zeros((len(analysis.dofs), 1)),
                )
            else:
                drawn, carried = support_motions(model, analysis.dofs, cases)
                acting = load_vectors(model, analysis.dofs, cases) + drawn
            _warn_of_held(analysis, heard, into, moved=carried)
            found = analysis.static(acting) + carried
            moved = (_unit_loads(analysis, heard).T @ found).T * (
                unit.length * heard.per_length(unit.length)
            )
    names = [f"{p}={n:g}" for p, n in zip(into.labels(), newtons, strict=True)] or [
        c.name for c in cases
    ]
    if table:
        _write_static(
            table,
            list(zip(into.labels(), newtons.tolist(), moved.tolist(), strict=True)),
            heard.labels(),
        )
    told = [_deflections(name, heard, u) for name, u in zip(names, moved, strict=True)]
    if json:
        write_json({"deck": str(deck), "cases": told}, json)
    if json != "-":
        every = [
            (c["case"], p, f"{x:.6g}", unit)
            for c in told
            for unit in _SIDES
            for p, x in c[unit].items()
        ]
        heads = ("case", "at", "deflection", "unit")
        rows(f"{deck}: {len(names)} load case{'s' if len(names) > 1 else ''}", heads, every)
    return 0


def _deflections(case: str, heard: DofSet, moved: Float) -> dict[str, Any]:
    """A load case with the deflections at translations and at rotations."""
    about = np.abs(heard.direction) > 3
    found = list(zip(heard.labels(), moved.tolist(), about.tolist(), strict=True))
    sides = {side: {p: x for p, x, a in found if a == (side == "radian")} for side in _SIDES}
    return {"case": case, **sides}


def _unit_loads(analysis: EmbeddedAnalysis, at: DofSet) -> Float:
    """A column (dof, k) for each DOF, 1 or -1 there."""
    row, sign = analysis.dofs.align(at)
    out = np.zeros((len(analysis.dofs), len(at)))
    out[row, np.arange(len(at))] = sign
    return out


def _load(text: str) -> tuple[str, float]:
    """Point and force, N, of `3+Z=250` or `3+Z`."""
    point, given, value = text.partition("=")
    try:
        size = float(value) if given else 1.0
    except ValueError:
        size = 0.0
    if not (np.isfinite(size) and size):
        raise ConfigError(f"--force {text}: the form is 101+Z or 101+Z=250, with a force in N")
    return point, size


def _write_static(
    path: Path, cases: list[tuple[str, float, list[float]]], heard: tuple[str, ...]
) -> None:
    """A row a case and channel, as `io.statics.read_statics` reads them."""
    with atomic_write(path) as part_, part_.open("w", newline="", encoding="utf-8") as file:
        sheet = writer(file)
        sheet.writerow(COLUMNS)
        for point, newton, deflections in cases:
            if point not in heard:
                sheet.writerow((point, point, f"{newton:.9g}", ""))
            for channel, deflection in zip(heard, deflections, strict=True):
                sheet.writerow(
                    (
                        point,
                        channel,
                        f"{newton:.9g}" if channel == point else "",
                        f"{deflection:.9g}",
                    )
                )
