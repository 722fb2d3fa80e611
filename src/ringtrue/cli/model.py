"""`modes` and `check`: what a deck holds and how it vibrates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.backends.registry import solver
from ringtrue.checks.deck import check_deck
from ringtrue.checks.mass import mass_properties
from ringtrue.cli.show import out, progress, rows, write_json
from ringtrue.fem.assembly import assemble
from ringtrue.io.modes_json import modes_to_json
from ringtrue.io.nastran.reader import read_deck, survey
from ringtrue.model.ports import ModesRequest

Deck = Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes beside it.")]
Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Write JSON; - is standard output.")]


def modes(
    deck: Deck,
    n: Annotated[int, typer.Option("-n", help="The lowest N modes.", min=1)] = 20,
    band: Annotated[tuple[float, float] | None, typer.Option(help="All modes from F0 to F1, Hz.")] = None,
    solver_name: Annotated[str, typer.Option("--solver", help="The engine.")] = "embedded",
    json: Json = None,
) -> int:
    """Natural modes of a deck, with the proof that none is missing.

    Example: ringtrue modes wing.bdf --band 0 50 --json modes.json
    """
    with progress("modes") as show:
        show(0.0, f"reading {deck}")
        model = read_deck(deck)
        show(0.2, "solving")
        with solver(solver_name).open(model) as analysis:
            result = analysis.modes(ModesRequest(n, band))
    if json:
        write_json(modes_to_json(result.modes) | {"complete": result.complete, "proof": result.proof}, json)
    if json != "-":
        body = [
            (i + 1, f"{f:.5g}", f"{r:.1e}")
            for i, (f, r) in enumerate(zip(result.modes.frequencies, result.residuals, strict=True))
        ]
        rows(f"{deck}: {len(body)} modes", ("#", "f [Hz]", "residual"), body)
        out.print(result.proof, markup=False)
    return 0 if result.complete else 1


def check(deck: Deck, json: Json = None) -> int:
    """What a deck holds: cards, mass, centre of gravity, inertia and findings.

    Example: ringtrue check wing.bdf
    """
    found = survey(deck)
    summary: dict[str, Any] = {"deck": str(deck), "unsupported": found.unsupported}
    findings = []
    if not found.unsupported:
        report = check_deck(found.model)
        findings = [{"severity": f.severity, "text": f.text, "file": f.file, "line": f.line} for f in report.findings]
        mass = mass_properties(assemble(found.model))
        summary |= {"mass": mass.mass, "centre_of_gravity": mass.cg.tolist(), "inertia": mass.inertia.tolist()}
    summary |= {"cards": found.cards, "kept": dict(found.model.kept), "findings": findings}
    if json:
        write_json(summary, json)
    if json != "-":
        _print_check(deck, summary)
    bad = bool(found.unsupported) or any(f["severity"] == "error" for f in findings)
    return 1 if bad else 0


def _print_check(deck: Path, summary: dict[str, Any]) -> None:
    rows(f"{deck}: cards", ("card", "number"), sorted(summary["cards"].items()))
    if "mass" in summary:
        cg = ", ".join(f"{x:.4g}" for x in summary["centre_of_gravity"])
        out.print(f"mass {summary['mass']:.6g}, centre of gravity ({cg})", markup=False)
        for row in np.asarray(summary["inertia"]):
            out.print("inertia  " + "  ".join(f"{x: .5e}" for x in row), markup=False)
    for card, place in summary["unsupported"].items():
        out.print(f"unsupported {card}: {place}", markup=False)
    for f in summary["findings"]:
        place = f"{f['file']}:{f['line']}: " if f["file"] else ""
        out.print(f"{f['severity']}: {place}{f['text']}", markup=False)
    if not summary["findings"] and not summary["unsupported"]:
        out.print("no findings")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(modes)
    app.command()(check)
