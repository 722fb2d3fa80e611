"""`localise`: where a deck is wrong, from the modes of a test."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy import sparse

from ringtrue.backends.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.cli.show import json_target, out, progress, rows, unit_length, write_json
from ringtrue.core.observation import Observation
from ringtrue.io.modes_json import read_modes
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.reduce.parametric import ReducedModel
from ringtrue.shapes.scale import realise_modes
from ringtrue.study.placing import placed
from ringtrue.update.candidates import Candidate, CandidateSettings, membership
from ringtrue.update.effects import Dropped, effective, reduced_candidates
from ringtrue.update.generate import generate
from ringtrue.update.localise import element_errors
from ringtrue.update.objective import Target, match
from ringtrue.update.pool import conflicts
from ringtrue.update.proposal import Proposal, propose

EXTRA = 1.5  # modes of the model, as a multiple of those of the test


def localise(
    deck: Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes beside it.")],
    test: Annotated[Path, typer.Argument(help="Modes of the test: .json, .h5 or .uff")],
    sensors: Annotated[
        Path | None, typer.Option(help="Sensor sheet; without it, channels are DOFs of the deck such as 101+Z.")
    ] = None,
    units: Annotated[str, typer.Option(help="Unit system of the deck.")] = "SI",
    tolerance: Annotated[float, typer.Option(metavar="M", help="Largest distance of a sensor from a node.")] = 0.05,
    most: Annotated[int, typer.Option(help="Most parameters that are proposed.", min=1)] = 8,
    json: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write JSON; - is standard output.", callback=json_target),
    ] = None,
) -> int:
    """Which parameters to update: candidates from the deck, ranked and explained, and what cannot be told from them.

    Example: ringtrue localise wing.bdf test.json --sensors sensors.csv --units mm-t-s
    """
    metres = unit_length(units)
    with progress("localise") as show:
        show(0.0, f"reading {deck}")
        model, seen = read_deck(deck), realise_modes(read_modes(test))
        seen = seen.take(np.flatnonzero(seen.frequencies > 0))
        analysis = EmbeddedSolver().open(model)
        bridge = placed(model, analysis.dofs, seen.channels, sensors, unit=metres, tolerance=tolerance)
        aim = Target(seen.frequencies, seen.shapes, np.zeros(len(seen)), np.ones(len(seen), dtype=bool))
        count = int(EXTRA * len(seen)) + 4
        modes = analysis.eigen(ModesRequest(count))
        every = generate(model, CandidateSettings(units=units))
        keep, lost = effective(model, analysis.system, every, modes.values, modes.vectors)
        reduced = reduced_candidates(
            model, analysis.system, keep, bridge, count, progress=lambda f, t: show(0.1 + 0.3 * f, t)
        )
        errors = _errors(analysis, reduced, bridge, aim, keep)
        words = [c.what for c in keep]
        found = propose(
            reduced,
            aim,
            most=most,
            apart=conflicts(model, keep),
            errors=errors,
            words=words,
            progress=lambda f, t: show(0.4 + 0.6 * f, t),
        )
    if json:
        write_json(_table(found, keep, lost), json)
    if json != "-":
        _print(deck, found, len(every), len(lost))
    return 0


def _errors(
    analysis: EmbeddedAnalysis, reduced: ReducedModel, bridge: Observation, aim: Target, keep: tuple[Candidate, ...]
) -> dict[str, Any]:
    """Concentration of the local errors on each candidate."""
    pairs, _, _ = match(aim, reduced.modes(np.zeros(len(keep))))
    if not len(pairs):
        return {}
    seen = sparse.csr_array(bridge.matrix @ analysis.system.transform)
    modes = analysis.eigen(ModesRequest(reduced.count)).vectors
    found = element_errors(analysis.model, analysis.system, seen, aim.frequencies, aim.shapes, modes, pairs)
    return dict(found.concentration(membership(analysis.model, keep)))


def _table(found: Proposal, keep: tuple[Candidate, ...], lost: tuple[Dropped, ...]) -> dict[str, Any]:
    what = {c.name: c for c in keep}
    return {
        "proposed": [
            {
                "name": m.name,
                "what": what[m.name].what,
                "elements": list(what[m.name].elements),
                "factor": m.factor,
                "std": m.std,
                "worth": m.worth,
                "alike": list(m.alike),
                "rivals": list(m.rivals),
                "because": m.because,
            }
            for m in found.members
        ],
        "aicc": dict(zip(map(str, found.sizes.tolist()), found.criteria.tolist(), strict=True)),
        "mean_deviation_percent": [100 * found.before, 100 * found.after],
        "mean_mac_percent": (100 * found.mac).tolist(),
        "insensitive": list(found.insensitive),
        "left_out": [{"name": d.name, "reason": d.reason} for d in lost],
        "other_rules": {k: list(v) for k, v in found.orders.items()},
    }


def _print(deck: Path, found: Proposal, every: int, lost: int) -> None:
    body = [
        (i, m.name, f"{m.factor:.3g}", f"{100 * m.std:.1f}", f"{m.worth:.1f}", len(m.alike) + len(m.rivals))
        for i, m in enumerate(found.members, start=1)
    ]
    heads = ("#", "parameter", "factor", "± [%]", "worth (AICc)", "not told from it")
    rows(f"{deck}: {every} candidates, {lost} of them change no mode", heads, body)
    out.print(found.text(), markup=False, highlight=False, soft_wrap=True)
