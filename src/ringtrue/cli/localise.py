"""`localise`: where a deck is wrong, from the modes of a test."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy import sparse

from ringtrue.backends.embedded import EmbeddedAnalysis
from ringtrue.cli.show import Json, Units, out, progress, rows, tell, unit_length, write_json
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.errors import DataError
from ringtrue.io.modes_json import read_modes
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.reduce.condense import condensed
from ringtrue.reduce.parametric import ReducedModel, modes_of
from ringtrue.shapes.scale import realise_modes
from ringtrue.study.config import LocaliseSection, target_words
from ringtrue.study.opened import Opened
from ringtrue.study.placing import placed
from ringtrue.update.candidates import Candidate, CandidateSettings, membership
from ringtrue.update.effects import Dropped, effective, reduced_candidates
from ringtrue.update.generate import generate
from ringtrue.update.identifiable import ALIKE
from ringtrue.update.localise import reduced_errors
from ringtrue.update.objective import Target, match
from ringtrue.update.pool import SMALL, conflicts, drawn
from ringtrue.update.proposal import Proposal, propose
from ringtrue.update.screening import screened

EXTRA = 1.5  # modes of the model, as a multiple of those of the test
POOL: int = LocaliseSection.model_fields["pool"].default


def localise(
    deck: Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes beside it.")],
    test: Annotated[Path, typer.Argument(help="Modes of the test: .json, .h5 or .uff")],
    sensors: Annotated[
        Path | None, typer.Option(help="Sensor sheet; without it, channels are DOFs of the deck such as 101+Z.")
    ] = None,
    units: Units = "SI",
    tolerance: Annotated[float, typer.Option(metavar="M", help="Largest distance of a sensor from a node.")] = 0.05,
    most: Annotated[int, typer.Option(help="Most parameters that are proposed.", min=1)] = 8,
    pool: Annotated[
        int,
        typer.Option(help="Candidates that are looked at closely: those that explain most of the misfit.", min=1),
    ] = POOL,
    json: Json = None,
) -> int:
    """Which parameters to update: candidates from the deck, ranked and explained, and what cannot be told from them.

    Example: ringtrue localise wing.bdf test.json --sensors sensors.csv --units mm-t-s
    """
    metres = unit_length(units)
    with progress("localise") as show:
        show(0.0, f"reading {deck}")
        model, seen = read_deck(deck), realise_modes(read_modes(test))
        if not seen.channels:
            raise DataError(f"{test}: frequencies without shapes cannot be localised; `ringtrue update` takes them")
        seen = seen.take(np.flatnonzero(seen.frequencies > 0))
        opened = Opened(model, metres)
        analysis, bridge = opened.analysis, placed(opened, seen.channels, sensors, tolerance=tolerance)
        aim = Target(seen.frequencies, seen.shapes, np.zeros(len(seen)), np.ones(len(seen), dtype=bool))
        count = int(EXTRA * len(seen)) + 4
        modes = analysis.eigen(ModesRequest(modes_of(count)), part(show, 0.1, 0.2))
        every = generate(model, CandidateSettings(units=units))
        show(0.2, f"energies of {len(every)} candidates")
        moved, lost = effective(model, analysis.system, every, modes.values, modes.vectors)

        def reduced_to(some: tuple[Candidate, ...], progress: Progress = quiet) -> ReducedModel:
            return reduced_candidates(
                model, analysis.system, some, bridge, count, pencil=analysis.pencil, modes=modes, progress=progress
            )

        def small(whole: ReducedModel, some: tuple[Candidate, ...]) -> ReducedModel:
            points = drawn(whole.parameters, conflicts(model, some), np.random.default_rng(0))
            return condensed(whole, points, max(SMALL, 2 * count))

        def look(some: tuple[Candidate, ...]) -> tuple[ReducedModel, ReducedModel]:
            whole = reduced_to(some)
            return small(whole, some), whole

        show(0.22, f"what {len(moved)} candidates explain")
        keep = screened(
            model,
            analysis.system,
            moved,
            aim,
            sparse.csr_array(bridge.matrix @ analysis.system.transform),
            (modes.values, modes.vectors),
            look,
            pool=pool,
            most=most,
            alike=ALIKE,
            progress=part(show, 0.25, 0.45),
        )
        reduced = reduced_to(keep, part(show, 0.45, 0.6))
        show(0.6, "error indicators")
        errors = _errors(analysis, reduced, aim, keep)
        found = propose(
            small(reduced, keep),
            aim,
            most=most,
            apart=conflicts(model, keep),
            errors=errors,
            words=[c.what for c in keep],
            passed_over=len(moved) - len(keep),
            progress=part(show, 0.6, 1.0),
        )
    if json:
        write_json(_table(found, keep, lost, moved), json)
    if json != "-":
        _print(deck, found, len(every), len(lost), len(moved) - len(keep))
        tell(_tables(found, keep))
    return 0


def _errors(
    analysis: EmbeddedAnalysis, reduced: ReducedModel, aim: Target, keep: tuple[Candidate, ...]
) -> dict[str, Any]:
    """Concentration of the local errors on each candidate."""
    pairs, _, _ = match(aim, reduced.modes(np.zeros(len(keep))))
    if not len(pairs):
        return {}
    f, shapes = aim.frequencies[pairs[:, 0]], aim.shapes[:, pairs[:, 0]]
    rows = np.arange(len(reduced.basis.observe))
    found, _ = reduced_errors(analysis.model, analysis.system, reduced, rows, f, shapes, pairs[:, 1])
    return dict(found.concentration(membership(analysis.model, keep)))


def _table(
    found: Proposal, keep: tuple[Candidate, ...], lost: tuple[Dropped, ...], moved: tuple[Candidate, ...]
) -> dict[str, Any]:
    what = {c.name: c for c in keep}
    return {
        "proposed": [
            {
                "name": m.name,
                "what": what[m.name].what,
                "elements": list(what[m.name].elements),
                "targets": target_words(what[m.name].parameter),
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
        "pairs": found.paired.tolist(),
        "insensitive": list(found.insensitive),
        "looked_at": list(what),
        "screened_out": [c.name for c in moved if c.name not in what],
        "left_out": [{"name": d.name, "reason": d.reason} for d in lost],
        "other_rules": {k: list(v) for k, v in found.orders.items()},
    }


def _tables(found: Proposal, keep: tuple[Candidate, ...]) -> list[str]:
    """What is proposed as tables of study.toml."""
    by = {c.name: c.parameter for c in keep}
    out = ["as candidates of study.toml:"] if found.members else []
    for p in (by[m.name] for m in found.members):
        if not (words := target_words(p)):
            out.append(f'# {p.name}: by [update] propose = true and [localise] kinds = ["region"]')
            continue
        listed = ", ".join(f'"{w}"' for w in words)
        out += ["[[candidate]]", f'name = "{p.name}"', f"targets = [{listed}]"]
        out.append(f"lower = {p.lower:.4g}\nupper = {p.upper:.4g}\nstd = {p.std:.4g}")
    return out


def _print(deck: Path, found: Proposal, every: int, lost: int, aside: int) -> None:
    body = [
        (i, m.name, f"{m.factor:.3g}", f"{100 * m.std:.1f}", f"{m.worth:.1f}", len(m.alike) + len(m.rivals))
        for i, m in enumerate(found.members, start=1)
    ]
    heads = ("#", "parameter", "factor", "± [%]", "worth (AICc)", "not told from it")
    told = f", {aside} tell less than those looked at closely" if aside else ""
    rows(f"{deck}: {every} candidates, {lost} of them change no mode{told}", heads, body)
    out.print(found.text())
