"""`update`: the candidates of a study, fitted to a file of test modes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.study_update import SIDES, UpdateRequest, update_json, update_study
from ringtrue.cli.model import TimeLimit
from ringtrue.cli.show import (
    Json,
    SideBySide,
    err,
    out,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.core.digits import number, with_error
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.messages import discrepancy_sentence, misfit_sentence, worse_frequencies

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
    rows(f"{study}: parameters", ("parameter", "factor", "± [%]", "posterior/prior"), body)
    body = []
    for i, m in enumerate(summary["modes"], start=1):
        cells = [_cell(m[name], ".2f") for name in COLUMNS]
        body.append((i, f"{m['frequency_hz']:.5g}", *cells, "" if m["used"] else "left out"))
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
    study: Annotated[Path, typer.Argument(help="study.toml with a deck and candidates.")],
    test: Annotated[
        Path,
        typer.Argument(
            help="Test modes, .json, .h5, .uff, .csv or .xlsx; channels of the study's sheet, or "
            "DOFs such as 101+Z."
        ),
    ],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where the updated deck goes.")
    ] = None,
    leave_out: Annotated[
        str, typer.Option(metavar="LIST", help="Test modes to judge by, from 1: 3,7.")
    ] = "",
    seed: Annotated[int | None, typer.Option(metavar="N", help="Seed of starts.", min=0)] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Keep the last iterate here; go on from it if it is there."
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
