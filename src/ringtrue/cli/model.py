"""`modes` and `check`: what a deck holds and how it vibrates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.measurements import write_modes
from ringtrue.api.models import read_deck, solve_modes
from ringtrue.checks import Finding
from ringtrue.checks.deck import check_deck, readable
from ringtrue.checks.elements import free_edges_in_words, shell_edges
from ringtrue.checks.materials import (
    DIRECTIONS,
    autospc_findings,
    ground_check,
    ground_findings,
    mass_properties,
    unconstrained,
)
from ringtrue.checks.mesh import MeshErrors, mesh_errors
from ringtrue.cli.show import Json, file_to, json_file, one_of, out, progress, rows, write_json
from ringtrue.core.arrays import Float
from ringtrue.core.iterate import part
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.reader import Survey, survey
from ringtrue.errors import ConfigError, DeckError, RingtrueError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.io.modes import WRITTEN, dump_modes
from ringtrue.model.cards import effects
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesResult
from ringtrue.model.superelements import condenses
from ringtrue.solvers.registry import EMBEDDED, solver, time_limits

ROUNDING = 1e-12  # of the largest value: below is 0

Deck = Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes.")]

TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time-limit",
        metavar="SECONDS",
        help="Longest run of a --solver that is another program.",
        min=1e-3,
        show_default=", ".join(f"{name} {limit:g}" for name, limit in time_limits().items()),
    ),
]


def modes(
    deck: Deck,
    n: Annotated[
        int | None,
        typer.Option(
            "-n", help="The lowest N modes; else what EIGRL or EIGR asks for, else 20.", min=1
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="All modes from F0 to F1, Hz.")
    ] = None,
    solver_name: Annotated[
        str,
        typer.Option(
            "--solver", help="The engine: embedded, mystran, nastran, slepc or a plug-in."
        ),
    ] = "embedded",
    time_limit: TimeLimit = None,
    ranks: Annotated[int | None, typer.Option(help="Processes of the slepc engine.", min=1)] = None,
    launcher: Annotated[
        str,
        typer.Option(
            help="What starts them, in place of --ranks, such as 'srun -n 64'.",
            metavar="COMMAND",
        ),
    ] = "",
    damped: Annotated[
        bool,
        typer.Option(
            "--complex", help="Complex modes, by the dashpots, GE, PARAM G and DMIG of the deck."
        ),
    ] = False,
    mesh: Annotated[
        bool,
        typer.Option(
            "--mesh-error", help="How far the mesh puts each frequency off, by refining it once."
        ),
    ] = False,
    target: Annotated[Path | None, file_to("--out", "Write the modes", *WRITTEN)] = None,
    json: Json = None,
) -> int:
    """Natural modes of a deck, with the proof that none is missing; or its complex modes
    (--complex).

    Example: ringtrue modes wing.bdf --band 0 50 --json modes.json
    """
    if mesh and (damped or solver_name != EMBEDDED):
        raise ConfigError(
            "--mesh-error is for natural modes of the embedded engine: leave out --complex and "
            "--solver"
        )
    with progress("modes") as show:
        show(0.0, f"reading {deck}")
        model = read_deck(deck)
        if mesh and condenses(model):
            raise ConfigError(
                "--mesh-error refines whole meshes; this deck is condensed (ASET, superelements)"
            )
        found = solve_modes(
            model,
            band=band,
            count=n,
            engine=solver_name,
            damped=damped,
            ranks=ranks,
            launcher=launcher,
            time_limit=time_limit,
            progress=part(show, 0.2, 0.6 if mesh else 1.0),
        )
        result = found.result
        refined = solver(EMBEDDED, progress=part(show, 0.6, 1.0))
        errors = mesh_errors(model, result.modes, refined) if mesh else None
    if json:
        extra: dict[str, Any] = {"complete": result.complete, "proof": result.proof}
        extra["autospc"] = result.autospc.by_components()
        if errors:
            extra["mesh_error"] = [None if np.isnan(e) else e for e in errors.relative.tolist()]
        with json_file(json) as file:
            dump_modes(file, result.modes, more=extra)
    if target:
        write_modes(target, result.modes)
    if json != "-":
        _print_modes(deck, result, damped, errors)
        if loose := found.loose:
            more = f" and {len(loose) - 6} more" if len(loose) > 6 else ""
            out.print(f"held by AUTOSPC, without stiffness: {' '.join(loose[:6])}{more}")
    # a program that hands back no matrices, and may count nothing
    unproved = bool(np.isnan(result.residuals).all())
    return 0 if result.complete or unproved else 1


def _print_modes(deck: Path, result: ModesResult, damped: bool, errors: MeshErrors | None) -> None:
    """A line a mode, of complex ones with the damping ratio, and with the error of the mesh where
    it was asked for.
    """
    columns = {"f [Hz]": [f"{f:.5g}" for f in result.modes.frequencies]}
    if damped:
        columns["damping [%]"] = [f"{100 * z:.4g}" for z in result.modes.damping]
    if errors:
        columns["mesh error [%]"] = [
            "-" if np.isnan(e) else f"{100 * e:+.2f}" for e in errors.relative
        ]
    columns["residual"] = ["-" if np.isnan(r) else f"{r:.1e}" for r in result.residuals]
    body = [(i + 1, *row) for i, row in enumerate(zip(*columns.values(), strict=True))]
    rows(f"{deck}: {len(body)} {'complex ' if damped else ''}modes", ("#", *columns), body)
    out.print(result.proof)
    if damped:
        out.print("motions that do not oscillate, rigid-body ones among them, are not listed")
    if errors:
        out.print(errors.in_words())


def check(
    deck: Deck,
    units: Annotated[
        str,
        one_of(
            "--units",
            UNIT_SYSTEMS,
            "Unit system of the deck, to judge moduli, densities and size by",
        ),
    ] = "",
    json: Json = None,
) -> int:
    """What a deck holds: cards, mass, centre of gravity, inertia, ground check, free edges and
    findings.

    Example: ringtrue check wing.bdf --units mm-t-s
    """
    found = survey(deck)
    findings = _findings(found, units)
    unsupported = dict(found.unsupported)
    model = readable(found.model) if unsupported else found.model
    rigid: dict[str, Any] = {}
    if "GRID" in model and len(model["GRID"]):
        rigid = _rigid_of_readable(model, findings, unsupported)
    summary: dict[str, Any] = {
        "deck": str(deck),
        "cards": dict(found.cards),
        "kept": dict(found.model.kept),
        "unsupported": unsupported,
        "missing": {card: list(effects(card)) for card in unsupported},
        **rigid,
    }
    summary["findings"] = [
        {"severity": f.severity, "text": f.text, "file": f.file, "line": f.line} for f in findings
    ]
    if json:
        write_json(summary, json)
    if json != "-":
        _print_check(deck, summary)
    sound = not unsupported and not any(f.severity == "error" for f in findings)
    return 0 if sound else 1


def _findings(found: Survey, units: str) -> list[Finding]:
    """What is wrong with the deck, as far as it is read."""
    partial = bool(found.unsupported)
    findings = list(check_deck(found.model, units, partial=partial).findings)
    extra = {(f.file, f.line) for f in findings}
    return [_lost(f) for f in found.faults if (str(f.path), f.line) not in extra] + findings


def _lost(fault: DeckError) -> Finding:
    place = f"{fault.path}:{fault.line}: " if fault.line else f"{fault.path}: "
    return Finding("error", str(fault).removeprefix(place), str(fault.path), fault.line or 0)


def _rigid_of_readable(
    model: Model, findings: list[Finding], unsupported: dict[str, str]
) -> dict[str, Any]:
    """`_rigid` without the cards that assembly refuses, which are added to the unsupported; nothing
    where it is not possible, with a finding of the reason unless others say what is wrong.
    """
    try:
        return _rigid(model, findings, partial=bool(unsupported))
    except UnsupportedCard as e:
        if e.card not in model:
            findings.append(Finding("error", str(e)))
            return {}
        place = f"{e.path}:{e.line}" if e.line else ""
        unsupported[e.card] = ": ".join(t for t in (place, e.why) if t)
        rest = {card: t for card, t in model.tables.items() if card != e.card}
        return _rigid_of_readable(readable(replace(model, tables=rest)), findings, unsupported)
    except RingtrueError as e:  # the rest of the check is worth more than the mass
        if not any(f.severity == "error" for f in findings):
            findings.append(Finding("error", str(e)))
        return {}


def _rigid(model: Model, findings: list[Finding], *, partial: bool) -> dict[str, Any]:
    """Mass properties, ground check, free edges and what AUTOSPC holds; findings of these are added
    to the findings, but of what cards that are not read may hold.
    """
    held = assemble(model)
    system = assemble(unconstrained(model))
    ground = ground_check(system)
    mass = mass_properties(system)
    findings += [] if partial else autospc_findings(held)
    findings += ground_findings(model, ground)
    free = "" if partial else free_edges_in_words(shell_edges(model))
    energy = dict(zip(DIRECTIONS, ground.energy.tolist(), strict=True))
    return {
        "mass": mass.mass,
        "centre_of_gravity": mass.cg.tolist(),
        "inertia": mass.inertia.tolist(),
        "ground_check": {
            "strain_energy": energy,
            "relative": ground.relative.tolist(),
            "ok": ground.ok,
        },
        "free_edges": free,
        "autospc": held.autospc.by_components(),
    }


def _clean(values: list[Any], scale: float = 0.0) -> Float:
    """With 0 for what is rounding against the largest, and against `scale`."""
    x = np.asarray(values, dtype=np.float64)
    return np.asarray(np.where(np.abs(x) > ROUNDING * np.abs(x).max(initial=scale), x, 0.0))


def _print_check(deck: Path, summary: dict[str, Any]) -> None:
    rows(f"{deck}: cards", ("card", "number"), sorted(summary["cards"].items()))
    if "mass" in summary:
        cg = ", ".join(f"{x:.4g}" for x in _clean(summary["centre_of_gravity"]))
        read = " of what is read" if summary["unsupported"] else ""
        out.print(f"mass{read} {summary['mass']:.6g}, centre of gravity ({cg})")
        # what is taken off to be about it
        moved = summary["mass"] * sum(x * x for x in summary["centre_of_gravity"])
        for row in _clean(summary["inertia"], moved):
            out.print("inertia  " + "  ".join(f"{x: .5e}" for x in row))
        if summary["ground_check"]["ok"]:
            out.print("ground check: rigid-body motion takes no strain energy")
        if summary["free_edges"]:
            out.print(f"edges    {summary['free_edges']}")
    for card, place in summary["unsupported"].items():
        missing = ", ".join(summary["missing"][card])
        out.print(f"unsupported {card}: {place}; missing without it: {missing}")
    for f in summary["findings"]:
        out.print(str(Finding(**f)))
    if not summary["findings"] and not summary["unsupported"]:
        out.print("no findings")
