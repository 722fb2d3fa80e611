"""`localise` and `update`: where a deck is wrong, and its parameters fitted to a test."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.improvement import localise as find_regions
from ringtrue.api.measurements import read_modes
from ringtrue.api.models import read_deck
from ringtrue.api.study_update import SIDES, UpdateRequest, update_json, update_study
from ringtrue.cli.model import TimeLimit
from ringtrue.cli.show import (
    Json,
    SideBySide,
    Tolerance,
    Units,
    err,
    out,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.core.display import number, with_error
from ringtrue.core.notes import sentence
from ringtrue.io.files import atomic_write
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.config_sections import LocaliseSection, target_words
from ringtrue.study.direct import DirectProposal
from ringtrue.study.messages import (
    discrepancy_sentence,
    misfit_sentence,
    worse_frequencies,
)
from ringtrue.study.placing import seats_json
from ringtrue.updating.selection.candidates import CandidateSettings
from ringtrue.updating.selection.form import FormFindings
from ringtrue.updating.selection.missing_members import member_cards

POOL: int = LocaliseSection.model_fields["pool"].default


def localise(
    deck: Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes.")],
    test: Annotated[
        Path, typer.Argument(help="Modes of the test: .json, .h5, .uff, .csv or .xlsx")
    ],
    sensors: Annotated[
        Path | None,
        typer.Option(
            help="Sensor sheet; without it, channels are DOFs of the deck such as 101+Z."
        ),
    ] = None,
    units: Units = "SI",
    tolerance: Tolerance = None,
    most: Annotated[
        int, typer.Option(help="Most parameters that are proposed.", min=1)
    ] = 8,
    pool: Annotated[
        int,
        typer.Option(
            help="Candidates that are looked at closely: those that explain most of the misfit.",
            min=1,
        ),
    ] = POOL,
    members: Annotated[
        Path | None,
        typer.Option(
            help="Write the missing member that is ranked first as cards ([[remodel]] adds them), "
            "the others as comments."
        ),
    ] = None,
    json: Json = None,
) -> int:
    """Which parameters to update: candidates from the deck, ranked and explained, and what cannot
    be distinguished from them.

    Example: ringtrue localise wing.bdf test.json --sensors sensors.csv --units mm-t-s
    """
    with progress("localise") as show:
        show(0.0, f"reading {deck}")
        model = read_deck(deck, units=units)
        warn_of_units(model, units)
        done = find_regions(
            model,
            read_modes(test),
            sensors=sensors,
            tolerance=tolerance,
            most=most,
            pool=pool,
            progress=show,
        )
    found = done.found
    unit = CandidateSettings(units=units).unit("stiffness")
    if members is not None:
        text = member_cards(found.model, found.members, unit)
        with atomic_write(members) as path:
            path.write_text(text, encoding="utf-8")
    if json:
        sensed = {"sensors": seats_json(done.seats)} if done.seats else {}
        said = {"form": _form(done.form), "notes": done.notes}
        write_json(_table(found) | said | sensed, json)
    if json != "-":
        tell(sentence(n) for n in done.form.notes)
        _print(deck, found, unit)
        tell([*done.notes, *_tables(found)])
    return 0


def _table(localised: DirectProposal) -> dict[str, Any]:
    found = localised.proposal
    what = {c.name: c for c in localised.candidates}
    return {
        "proposed": [
            {
                "name": m.name,
                "what": what[m.name].what,
                "elements": list(what[m.name].elements),
                "targets": target_words(what[m.name].parameter),
                "factor": m.factor,
                "std": m.std,
                **({"added": m.added} if m.lump else {}),
                "worth": m.worth,
                "alike": list(m.collinear),
                "rivals": list(m.rivals),
                "because": m.because,
            }
            for m in found.members
        ],
        "aicc": dict(
            zip(map(str, found.sizes.tolist()), found.criteria.tolist(), strict=True)
        ),
        "mean_deviation_percent": [100 * found.before, 100 * found.after],
        "mean_mac_percent": (100 * found.mac).tolist() if found.seen else [None, None],
        "pairs": found.paired.tolist(),
        "insensitive": list(found.insensitive),
        "looked_at": list(what),
        "screened_out": list(localised.screened),
        "left_out": [{"name": d.name, "reason": d.reason} for d in localised.dropped],
        "other_rules": {k: list(v) for k, v in found.orders.items()},
        "missing_members": [{"name": m.name} | asdict(m) for m in localised.members],
    }


def _form(found: FormFindings) -> list[dict[str, Any]]:
    """Patterns of form, the best first."""
    named = {p.name for p in found.named}
    return [
        {
            "pattern": p.pattern,
            "cause": p.cause,
            "unknowns": p.unknowns,
            "amounts": p.amounts.tolist(),
            "explained": p.explained,
            "evidence": p.evidence,
            "named": p.name in named,
            "fields": list(p.fields),
            "modes": [m + 1 for m in p.modes],
        }
        for p in found.patterns
    ]


def _tables(found: DirectProposal) -> list[str]:
    """What is proposed as tables of study.toml."""
    by = {c.name: c.parameter for c in found.candidates}
    missing = [m for m in found.proposal.members if m.lump]
    out = (
        ["cards for what is missing in the deck ([[remodel]] adds a file of them):"]
        if missing
        else []
    )
    for m in missing:
        masses = found.model["CONM2"]
        eid = by[m.name].targets[0].id
        node = int(masses["G"][masses.find(np.array([eid]))[0]])
        out.append(f"CONM2,{eid},{node},,{m.added:.4g}")
    factors = [m for m in found.proposal.members if not m.lump]
    out += ["as candidates of study.toml:"] if factors else []
    for p in (by[m.name] for m in factors):
        if not (words := target_words(p)):
            out.append(
                f'# {p.name}: by [update] propose = true and [localise] kinds = ["region"]'
            )
            continue
        listed = ", ".join(f'"{w}"' for w in words)
        out += ["[[candidate]]", f'name = "{p.name}"', f"targets = [{listed}]"]
        out.append(f"lower = {p.lower:.4g}\nupper = {p.upper:.4g}\nstd = {p.std:.4g}")
    return out


def _print(deck: Path, found: DirectProposal, unit: str) -> None:
    body = [
        (i, m.name, *m.digits(), f"{m.worth:.1f}", len(m.collinear) + len(m.rivals))
        for i, m in enumerate(found.proposal.members, start=1)
    ]
    heads = (
        "#",
        "parameter",
        "factor, or added",
        "±",
        "worth (AICc)",
        "not distinguishable",
    )
    remaining = (
        f", {len(found.screened)} are not looked at closely" if found.screened else ""
    )
    rows(
        f"{deck}: {found.made} candidates, {len(found.dropped)} of them change no mode{remaining}",
        heads,
        body,
    )
    out.print(found.proposal.text())
    if found.members:
        out.print(
            "members that the deck may lack, each judged by itself (--members writes cards):"
        )
    for i, m in enumerate(found.members, start=1):
        out.print(f"{i}. {m.text(unit)}")


HEADS = (
    "#",
    "f test [Hz]",
    "Δf before [%]",
    "MAC",
    "subspace",
    "Δf after [%]",
    "MAC",
    "subspace",
    "",
)
COLUMNS = tuple(
    f"{what}{when}_percent"
    for when in ("_before", "")
    for what in ("deviation", "mac", "subspace_mac")
)


def show_summary(study: Path, summary: dict[str, Any]) -> None:
    """Print the JSON of an updating as tables."""
    body: list[tuple[object, ...]] = []
    for p in summary["parameters"]:
        std = p["relative_std"]
        factor, _ = with_error(p["factor"], p["factor"] * std)
        ratio = f"{p['posterior_over_prior']:.2f}"
        body.append((p["name"], factor, number(100 * std, 2), ratio))
    rows(
        f"{study}: parameters",
        ("parameter", "factor", "± [%]", "posterior/prior"),
        body,
    )
    body = []
    for i, m in enumerate(summary["modes"], start=1):
        cells = [_cell(m[name], ".2f") for name in COLUMNS]
        body.append(
            (i, f"{m['frequency_hz']:.5g}", *cells, "" if m["used"] else "left out")
        )
    rows("modes", HEADS, body)
    if measured := summary.get("measured"):
        body = []
        for m in measured:
            values = [_cell(m[side], ".4g") for side in SIDES]
            body.append((m["name"], m["what"], m["unit"], *values))
        rows("besides the modes", ("", "what", "unit", *SIDES), body)
    _show_notes(summary)


def _show_notes(summary: dict[str, Any]) -> None:
    errors = [(value or 0.0) / 100 for value in summary["discrepancy_percent"].values()]
    before = "deviation_before_percent"
    after = "deviation_percent"
    used = [m for m in summary["modes"] if m["used"]]
    both = [m for m in used if m[before] is not None and m[after] is not None]
    worse = worse_frequencies(
        np.array([m[before] for m in both]), np.array([m[after] for m in both])
    )
    lines = [*summary["notes"], summary["why"], discrepancy_sentence(errors), worse]
    lines += [*summary["flags"], *(f"deck: {path}" for path in summary["deck"])]
    tell(line for line in lines if line)
    count = summary["full_solutions"]
    if summary["solver"] != EMBEDDED:
        out.print(f"{count} runs of {summary['solver']}")
        return
    plural = "s" if count != 1 else ""
    out.print(
        f"{count} full solution{plural}; the largest frequency error of the reduced model is "
        f"{summary['basis_error']:.1e}"
    )


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def update(
    study: Annotated[
        Path, typer.Argument(help="study.toml with a deck and candidates.")
    ],
    test: Annotated[
        Path,
        typer.Argument(
            help="Test modes, .json, .h5, .uff, .csv or .xlsx; channels of the study's sheet, or "
            "DOFs such as 101+Z."
        ),
    ],
    folder: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the updated deck goes."),
    ] = None,
    leave_out: Annotated[
        str, typer.Option(metavar="LIST", help="Test modes to judge by, from 1: 3,7.")
    ] = "",
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of starts.", min=0)
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Keep the last iterate here; go on from it if it is there.",
        ),
    ] = None,
    solver_name: Annotated[
        str | None,
        typer.Option(
            "--solver",
            help="That of the study, or embedded, mystran, nastran, slepc, a plug-in: solved at "
            "each point.",
        ),
    ] = None,
    time_limit: TimeLimit = None,
    workers: SideBySide = None,
    json: Json = None,
) -> int:
    """Update a model to test modes: factors with their uncertainty, deviations before and after,
    the deck edited.

    What is compared, how it is weighed and where it begins stand in the study, in its sections
    update and residual.

    Example: ringtrue update study.toml modes.json --leave-out 3,7 --out updated
    """
    asked = UpdateRequest(
        leave_out=leave_out,
        folder=folder,
        seed=seed,
        checkpoint=checkpoint,
        engine=solver_name or "",
        time_limit=time_limit,
        workers=workers,
    )
    with progress("updating") as show:
        show(0.0, "reading")
        found = update_study(
            study,
            test,
            asked,
            on_deck=lambda deck: warn_of_units(deck, deck.units),
            progress=show,
        )
    summary = update_json(found)
    if json:
        write_json(summary, json)
    if json != "-":
        show_summary(study, summary)
    if not found.solved:
        err.print(f"not to be trusted: {summary['why']}")
    for misfit in found.misfits:
        err.print(misfit_sentence(misfit))
    return 0 if found.ok else 1
