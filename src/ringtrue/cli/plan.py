"""`plan`: where to measure and to strike, for how long, and what such a test will find."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.studies import ALONE, TestPlan, plan_test
from ringtrue.cli.show import (
    Json,
    one_of,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.errors import ConfigError
from ringtrue.io.foreign.parsers import read_toml
from ringtrue.planning.exciters import reciprocity_pairs
from ringtrue.planning.virtual_test import VirtualTest, rarely_found_modes
from ringtrue.study.messages import lost_points_sentence, missed_modes, setup_sentences
from ringtrue.study.results import PlanStage
from ringtrue.study.summary import setups_json


def plan(
    deck: Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes.")],
    folder: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the test sheet goes."),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A study.toml whose \\[plan] holds; options take the place of its keys.",
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="Target modes from F0 to F1, Hz.")
    ] = None,
    modes: Annotated[
        str,
        typer.Option(metavar="LIST", help="Target modes by number, such as 7-12,15."),
    ] = "",
    points: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Measurement points; sensors, unless triaxial.",
            min=1,
            show_default=str(ALONE["sensors"]),
        ),
    ] = None,
    references: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Excitation points.",
            min=1,
            show_default=str(ALONE["references"]),
        ),
    ] = None,
    strike_at: Annotated[
        str,
        typer.Option(
            metavar="LIST", help="Nodes that can be hit; any point if not given."
        ),
    ] = "",
    damping: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO",
            help="Expected damping ratio.",
            min=1e-6,
            max=0.5,
            show_default="0.01",
        ),
    ] = None,
    trials: Annotated[
        int | None, typer.Option(metavar="N", help="Virtual tests of the plan.", min=0)
    ] = None,
    units: Annotated[
        str, one_of("--units", UNIT_SYSTEMS, "Unit system of the deck")
    ] = "SI",
    json: Json = None,
) -> int:
    """Plan a modal test of a deck: a test sheet as CSV, universal file and HTML.

    Example: ringtrue plan frame.bdf --band 5 80 --points 24 --references 3 --trials 10 --out
    frame-test
    """
    given = {
        "modes": numbers(modes, "--modes") or None,
        "sensors": points,
        "references": references,
        "strike_at": numbers(strike_at, "--strike-at") or None,
        "damping": damping,
        "trials": trials,
    }
    section = plan_of(settings) | {k: v for k, v in given.items() if v is not None}
    with progress("test plan") as show:
        done = plan_test(
            deck, folder, band=band, units=units, settings=section, progress=show
        )
    warn_of_units(done.model, units)
    summary = _summary(done)
    if json:
        write_json(summary, json)
    if json != "-":
        _print(deck, done.stage, summary)
    return 1 if summary["missed"] else 0


def plan_of(path: Path | None) -> dict[str, Any]:
    """[plan] of a study, by its keys.

    Raises
    ------
    ConfigError
        If the file has none.
    """
    if path is None:
        return {}
    section = read_toml(path).get("plan")
    if not isinstance(section, dict):
        raise ConfigError(f"--settings {path}: it has no table [plan]")
    return section


def numbers(text: str, where: str) -> list[int]:
    """`7-9,12` as 7 8 9 12.

    Raises
    ------
    ConfigError
        If it is not a list of numbers and ranges.
    """
    found: list[int] = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        ends = part.split("-")
        if (
            len(ends) > 2
            or not all(e.strip().isdigit() for e in ends)
            or int(ends[0]) > int(ends[-1])
        ):
            raise ConfigError(
                f"{where} {text!r}: {part!r} must be a number or a range such as 7-12"
            )
        found += range(int(ends[0]), int(ends[-1]) + 1)
    return found


def _summary(plan: TestPlan) -> dict[str, Any]:
    stage = plan.stage
    names = [str(k + 1) for k in stage.target_modes.tolist()]
    document: dict[str, Any] = {
        "candidates": stage.sensors.candidates,
        "points": stage.sensors.test.points.tolist(),
        "channels": list(stage.sensors.test.channels),
        "references": list(stage.excitation.references),
        "reference_sets": [
            {"references": list(s), "worst_reach": r, "missed": [names[i] for i in m]}
            for s, r, m in zip(
                stage.excitation.sets,
                stage.excitation.least_reach.tolist(),
                stage.excitation.missed_by_sets,
                strict=True,
            )
        ],
        "reciprocity": [
            list(p)
            for p in reciprocity_pairs(
                stage.excitation.references, stage.sensors.test.channels
            )
        ],
        "rule": stage.rule,
        "modes": _modes(stage),
        "missed": [names[i] for i in np.flatnonzero(stage.excitation.missed).tolist()],
        "worst_auto_mac": stage.sensors.worst_auto_mac,
        "lost_points": stage.sensors.lost,
        "left_by_loss": stage.sensors.left_by_loss,
        "frequency_step_hz": stage.acquisition.frequency_step,
        "block_s": stage.acquisition.block,
        "averages": stage.acquisition.averages,
        "record_length_s": stage.acquisition.record_length,
        "ambient_averages": stage.acquisition.segments,
        "notes": list(stage.notes),
        "files": [str(p) for p in plan.files],
    }
    if (hung := stage.suspension) is not None:
        document["suspension"] = {
            "nodes": list(hung.nodes),
            "motion": hung.motion,
            "steady": hung.steady,
        }
    if stage.sensors.setups is not None:
        document["setups"] = setups_json(stage)
    if stage.virtual_test is not None:
        document["virtual_test"] = {
            "trials": stage.virtual_test.trials,
            "force_n": stage.virtual_test.force,
            "background_n_per_sqrt_hz": stage.virtual_test.background,
            "invented_per_trial": stage.virtual_test.invented,
            "doubtful": list(rarely_found_modes(stage.virtual_test, names)),
        }
    if (r := stage.virtual_ambient_test) is not None:
        names = [str(k + 1) for k in stage.acquisition.modes.tolist()]
        columns = {
            "mode": stage.acquisition.modes + 1,
            "frequency_hz": r.frequencies,
        } | _found(r)
        document["virtual_ambient_test"] = {
            "trials": r.trials,
            "force_n_per_sqrt_hz": r.force,
            "invented_per_trial": r.invented,
            "modes": _table(columns),
            "doubtful": [f"ambient: {m}" for m in rarely_found_modes(r, names)],
        }
    return document


def _found(r: VirtualTest) -> dict[str, Any]:
    """What virtual tests found, by column."""
    found = {
        "found": r.found,
        "found_at_least": r.at_least,
        "frequency_std": r.frequency_std,
    }
    return found | {"damping_std": r.damping_std, "mac": r.mac}


def _table(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row a mode; what is not known is null."""
    lists = {k: v.tolist() for k, v in columns.items()}
    count = len(lists["mode"])
    return [
        {k: (v[i] if np.isfinite(v[i]) else None) for k, v in lists.items()}
        for i in range(count)
    ]


def _modes(stage: PlanStage) -> list[dict[str, Any]]:
    """A row a target mode; what was not asked for is absent."""
    columns: dict[str, Any] = {
        "mode": stage.target_modes + 1,
        "frequency_hz": stage.target_frequencies,
        "reach": stage.excitation.reach,
        "shown": stage.sensors.shown,
        "loaded": stage.sensors.loaded,
    }
    if (r := stage.virtual_test) is not None:
        columns |= _found(r)
    return _table({k: v for k, v in columns.items() if v.size})


HEADS = {
    "mode": ("mode", "{}"),
    "frequency_hz": ("f [Hz]", "{:.5g}"),
    "reach": ("reach", "{:.2f}"),
    "shown": ("shown", "{:.2f}"),
    "loaded": ("mass shift", "{:.1e}"),
    "found": ("found", "{:.2f}"),
    "frequency_std": ("σf/f", "{:.1e}"),
    "damping_std": ("σζ/ζ", "{:.1e}"),
    "mac": ("MAC", "{:.3f}"),
}


def _print_modes(title: str, modes: list[dict[str, Any]]) -> None:
    here = [k for k in HEADS if k in modes[0]]
    body = [
        [HEADS[k][1].format(r[k]) if r[k] is not None else "-" for k in here]
        for r in modes
    ]
    rows(title, [HEADS[k][0] for k in here], body)


def _best(stage: PlanStage) -> dict[int, float]:
    """Number of points struck -> least reach of the best set of so many."""
    least = {
        len(s): r
        for s, r in zip(
            stage.excitation.sets[::-1],
            stage.excitation.least_reach[::-1].tolist(),
            strict=True,
        )
    }
    return dict(sorted(least.items()))  # of sets of one size the first is the best


def _print(deck: Path, stage: PlanStage, document: dict[str, Any]) -> None:
    _print_modes(f"{deck}: {len(document['modes'])} target modes", document["modes"])
    if ambient := document.get("virtual_ambient_test"):
        _print_modes(f"{ambient['trials']} virtual ambient tests", ambient["modes"])
    best = _best(stage)
    sensors = stage.sensors
    timing = stage.acquisition
    lines = [
        f"{len(sensors.test.channels)} channels at {sensors.test.points.size} points, of "
        f"{sensors.candidates} candidates: "
        f"{' '.join(map(str, document['points']))}",
        f"strike at {' '.join(stage.excitation.references)}; least reach of the best "
        f"{', '.join(map(str, best))} points: "
        f"{', '.join(f'{100 * r:.0f}' for r in best.values())} %",
        f"worst auto-MAC {sensors.worst_auto_mac:.2f}; {lost_points_sentence(stage)}",
        f"frequency step {timing.frequency_step:.3g} Hz, block {timing.block:.3g} s, "
        f"{timing.averages} averages; "
        f"ambient record {timing.record_length / 60:.3g} min, {timing.segments} blocks",
    ]
    lines += setup_sentences(stage)
    if stage.suspension is not None:
        lines.append(f"hang at {' '.join(map(str, stage.suspension.nodes))}")
    lines += [*missed_modes(stage), *stage.notes]
    for test in ("virtual_test", "virtual_ambient_test"):
        lines += document.get(test, {}).get("doubtful", [])
    lines.append("test sheet: " + " ".join(document["files"]))
    tell(lines)
