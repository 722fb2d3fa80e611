"""`plan`: where to measure and to strike, for how long, and what such a test will find."""

from __future__ import annotations

import json as text_json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from ringtrue.cli.show import Json, one_of, progress, rows, tell, write_json
from ringtrue.cli.stated import stated
from ringtrue.core.modes import elastic
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError
from ringtrue.io.atomic import atomic_write, writes
from ringtrue.model.ports import ModesRequest
from ringtrue.planning.exciters import reciprocity_pairs
from ringtrue.planning.plan_files import NAMES, reach_of, write_test_sheet
from ringtrue.planning.virtual_test import VirtualTest, missed_modes
from ringtrue.report.deliver import deliver
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config_plan import Directions, Method, Strike
from ringtrue.study.results import PlanStage
from ringtrue.study.run import StudyRun, run_study
from ringtrue.study.summary import setups_json
from ringtrue.study.words import left_by_loss, missed, setups
from ringtrue.virtual.sensors import ICP

METHODS, STRIKES, DIRECTIONS = (get_args(kind) for kind in (Method, Strike, Directions))
ABOVE = 1.3  # modes up to here over the band take part in the virtual test


def plan(
    deck: Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes beside it.")],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where the test sheet goes.")
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="Target modes from F0 to F1, Hz.")
    ] = None,
    modes: Annotated[
        str, typer.Option(metavar="LIST", help="Target modes by number, such as 7-12,15.")
    ] = "",
    effective_mass: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Of the band, modes with such a share of the mass.",
            min=0,
            max=0.99,
        ),
    ] = 0.0,
    kinetic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=SHARE",
            help="Or with such a share of kinetic energy in a --region; repeat it.",
        ),
    ] = None,
    points: Annotated[
        int, typer.Option(help="Measuring points; sensors, unless triaxial.", min=1)
    ] = 20,
    at_hand: Annotated[
        int,
        typer.Option(
            metavar="N", help="Sensors recorded at once: more points are measured in setups.", min=0
        ),
    ] = 0,
    directions: Annotated[str, one_of("--directions", DIRECTIONS, "Of a sensor")] = DIRECTIONS[0],
    references: Annotated[int, typer.Option(help="Points to strike.", min=1)] = 3,
    strike_at: Annotated[
        str, typer.Option(metavar="LIST", help="Nodes that can be struck; any point if not given.")
    ] = "",
    strike: Annotated[
        str, one_of("--strike", STRIKES, "How points to strike are chosen")
    ] = STRIKES[0],
    method: Annotated[
        str, one_of("--method", METHODS, "How measuring points are chosen")
    ] = METHODS[0],
    region: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LIST", help="Points are among these nodes; repeat it."),
    ] = None,
    cost: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=COST",
            help="Of a point of a --region, else 1; with qr and information; repeat it.",
        ),
    ] = None,
    weigh: Annotated[
        bool, typer.Option("--weigh", help="Points that carry kinetic energy come first.")
    ] = False,
    box: Annotated[
        list[str] | None,
        typer.Option(
            "--box", metavar="'X0 Y0 Z0 X1 Y1 Z1'", help="Points lie in it, m; repeat it."
        ),
    ] = None,
    keep_out: Annotated[
        list[str] | None,
        typer.Option(metavar="'X0 Y0 Z0 X1 Y1 Z1'", help="No point lies in it, m; repeat it."),
    ] = None,
    exclude: Annotated[
        str, typer.Option(metavar="LIST", help="Nodes that cannot be measured.")
    ] = "",
    fixed: Annotated[
        str, typer.Option(metavar="LIST", help="Nodes that are measured in any case.")
    ] = "",
    distance: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Least distance of two points; else from the structure.", min=0
        ),
    ] = None,
    redundancy: Annotated[int, typer.Option(help="Points that may fail.", min=0)] = 0,
    hang: Annotated[int, typer.Option(help="Points to hang the structure from.", min=0)] = 0,
    sensor_mass: Annotated[
        float, typer.Option(metavar="KG", help="Mass of a sensor.", min=0)
    ] = 0.0,
    damping: Annotated[
        float, typer.Option(help="Expected damping ratio.", min=1e-6, max=0.5)
    ] = 0.01,
    error: Annotated[
        float, typer.Option(help="Wanted random error of an FRF.", min=1e-4, max=1)
    ] = 0.05,
    coherence: Annotated[
        float, typer.Option(help="Expected coherence.", min=0.01, max=0.9999)
    ] = 0.98,
    precision: Annotated[
        float,
        typer.Option(
            help="Wanted error of the lowest damping, of an ambient record.", min=1e-3, max=1
        ),
    ] = 0.1,
    trials: Annotated[int, typer.Option(help="Virtual tests of the plan.", min=0)] = 0,
    background: Annotated[
        float | None,
        typer.Option(
            metavar="N/√HZ",
            help="Noise force at each reference; else what leaves the coherence.",
            min=0,
        ),
    ] = None,
    ambient_force: Annotated[
        float,
        typer.Option(
            metavar="N/√HZ",
            help="Virtual ambient tests, too, under such a force at each channel.",
            min=0,
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the virtual tests.", min=0)] = 0,
    units: Annotated[str, one_of("--units", UNIT_SYSTEMS, "Unit system of the deck")] = "SI",
    json: Json = None,
) -> int:
    """Plan a modal test of a deck: a test sheet as CSV, universal file and HTML.

    Example: ringtrue plan frame.bdf --band 5 80 --points 24 --references 3 --trials 10 --out
    frame-test
    """
    folder = folder or deck.with_name(f"{deck.stem}-test")
    if (folder / "study.toml").exists():
        raise ConfigError(f"--out {folder}: holds a study.toml; name a folder for the plan alone")
    writes(*(folder / name for name in ("plan.toml", *NAMES)))
    section: dict[str, Any] = {
        "sensors": points,
        "at_hand": at_hand,
        "min_distance": "even" if distance is None else distance,
        "ambient": False,
        "strike": strike,
        "strike_at": numbers(strike_at, "--strike-at"),
        "directions": directions,
        "references": references,
        "method": method,
        "modes": numbers(modes, "--modes"),
        "effective_mass": effective_mass,
        "kinetic": {
            name: _number("--kinetic", name, text) for name, text in _named("--kinetic", kinetic)
        },
        "candidates": {
            name: numbers(text, "--region") for name, text in _named("--region", region)
        },
        "cost": {name: _number("--cost", name, text) for name, text in _named("--cost", cost)},
        "weigh": weigh,
        "boxes": [_box("--box", b) for b in box or []],
        "keep_out": [_box("--keep-out", b) for b in keep_out or []],
        "exclude": numbers(exclude, "--exclude"),
        "fixed": numbers(fixed, "--fixed"),
        "redundancy": redundancy,
        "suspension": hang,
        "sensor_mass": sensor_mass,
        "damping": damping,
        "error": error,
        "coherence": coherence,
        "precision": precision,
        "lines": "mesh",
        "trials": trials,
        "ambient_force": ambient_force,
    }
    section |= {} if background is None else {"background": background}
    with progress("test plan") as show:
        show(0.0, f"reading {deck}")
        section |= _from_deck(deck, units, band, section["modes"])
        study = _write_study(folder, deck, units, section, seed)
        run = run_study(study, out=folder, until="plan", progress=show)
        deliver(run)
    stage: PlanStage = run.results["plan"]
    told = _told(run)
    files = write_test_sheet(
        folder,
        stage.test,
        stage.references,
        frequencies=stage.target_frequencies,
        reach=_reach(run),
        sensor=ICP,
        setups=stage.setups,
    )
    told["files"] = [str(p) for p in (*files, folder / "report.html")]
    if json:
        write_json(told, json)
    if json != "-":
        _print(deck, stage, told)
    return 1 if told["missed"] else 0


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


def _named(option: str, texts: Sequence[str] | None) -> list[tuple[str, str]]:
    """NAME=VALUE, parted; each name once."""
    out: dict[str, str] = {}
    for text in texts or ():
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise ConfigError(f"{option} {text!r}: must be NAME=...")
        if name in out:
            raise ConfigError(f"{option} {text!r}: {name} is given twice; put all in one")
        out[name] = value
    return list(out.items())


def _number(option: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{option} {name}={text}: {text!r} is not a number")
    return value


def _box(option: str, text: str) -> list[float]:
    try:
        values = [float(v) for v in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != 6 or not all(map(math.isfinite, values)):
        raise ConfigError(f"{option} {text!r}: must be six numbers, X0 Y0 Z0 X1 Y1 Z1")
    return values


def _from_deck(
    deck: Path, units: str, band: tuple[float, float] | None, modes: list[int]
) -> dict[str, float]:
    """The band, taken from the deck where it is not given."""
    if band is not None and not 0 <= band[0] < band[1]:
        raise ConfigError(f"--band {band[0]} {band[1]}: must be 0 <= F0 < F1")
    model = stated(read_deck(deck), units)
    if band is None:
        with EmbeddedSolver().open(model) as analysis:
            f = analysis.modes(ModesRequest(max([21, *(m + 1 for m in modes)]))).modes.frequencies
        flexible = f[elastic(f)]
        if not flexible.size:
            raise ConfigError(f"{deck}: none of the {f.size} lowest modes is elastic; give --band")
        last = (
            f[max(modes) - 1]
            if modes and max(modes) <= f.size
            else flexible[-2 if flexible.size > 1 else -1]
        )
        band = (0.5 * float(flexible[0]), 1.001 * float(last))
    return {k: float(f"{v:.6g}") for k, v in zip(("fmin", "fmax"), band, strict=True)}


def _write_study(folder: Path, deck: Path, units: str, section: dict[str, Any], seed: int) -> Path:
    """plan.toml: the settings of this plan, a study that `ringtrue run` takes."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "plan.toml"
    place = Path(os.path.relpath(deck.resolve(), folder.resolve())).as_posix()
    tables = {
        "study": {"title": f"Test plan of {deck.name}", "seed": seed},
        "model": {"deck": place, "units": units, "fmax": float(f"{ABOVE * section['fmax']:.6g}")},
        "plan": section,
    }
    lines = [
        f"[{name}]\n" + "".join(f"{k} = {_toml(v)}\n" for k, v in table.items())
        for name, table in tables.items()
    ]
    with atomic_write(path) as part:
        part.write_text("\n".join(lines), encoding="utf-8")
    return path


def _toml(value: Any) -> str:
    """JSON's texts, numbers and lists are TOML's too."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    return text_json.dumps(value, ensure_ascii=False)


def _reach(run: StudyRun) -> Any:
    """Driving-point residue of each reference over the best of all channels, (r, target)."""
    stage: PlanStage = run.results["plan"]
    found = run.desk.initial.modes(run.desk.first_fmax).modes.take(stage.target_modes)
    seen = run.desk.initial.seen(found, stage.test)
    at = [stage.test.channels.index(r) for r in stage.references]
    return reach_of(np.asarray(seen.shapes), at)


def _told(run: StudyRun) -> dict[str, Any]:
    stage: PlanStage = run.results["plan"]
    names = [str(k + 1) for k in stage.target_modes.tolist()]
    told: dict[str, Any] = {
        "candidates": stage.candidates,
        "points": stage.test.points.tolist(),
        "channels": list(stage.test.channels),
        "references": list(stage.references),
        "reference_sets": [
            {"references": list(s), "worst_reach": r, "missed": [names[i] for i in m]}
            for s, r, m in zip(
                stage.sets, stage.least_reach.tolist(), stage.missed_by_sets, strict=True
            )
        ],
        "reciprocity": [list(p) for p in reciprocity_pairs(stage.references, stage.test.channels)],
        "rule": stage.rule,
        "modes": _modes(stage),
        "missed": [names[i] for i in np.flatnonzero(stage.missed).tolist()],
        "worst_auto_mac": stage.worst_off_diagonal,
        "lost_points": stage.lost,
        "left_by_loss": stage.left_by_loss,
        "frequency_step_hz": stage.frequency_step,
        "block_s": stage.block,
        "averages": stage.averages,
        "record_length_s": stage.record_length,
        "ambient_averages": stage.segments,
        "notes": list(stage.notes),
    }
    if stage.suspension:
        told["suspension"] = {
            "nodes": list(stage.suspension),
            "motion": stage.suspension_motion,
            "steady": stage.steady,
        }
    if stage.setups is not None:
        told["setups"] = setups_json(stage)
    if stage.rehearsal is not None:
        told["virtual_test"] = {
            "trials": stage.rehearsal.trials,
            "force_n": stage.rehearsal.force,
            "background_n_per_sqrt_hz": stage.rehearsal.background,
            "invented_per_trial": stage.rehearsal.invented,
            "doubtful": list(missed_modes(stage.rehearsal, names)),
        }
    if (r := stage.ambient_rehearsal) is not None:
        names = [str(k + 1) for k in stage.expected_modes.tolist()]
        columns = {"mode": stage.expected_modes + 1, "frequency_hz": r.frequencies} | _found(r)
        told["virtual_ambient_test"] = {
            "trials": r.trials,
            "force_n_per_sqrt_hz": r.force,
            "invented_per_trial": r.invented,
            "modes": _table(columns),
            "doubtful": [f"ambient: {m}" for m in missed_modes(r, names)],
        }
    return told


def _found(r: VirtualTest) -> dict[str, Any]:
    """What virtual tests found, by column."""
    found = {"found": r.found, "found_at_least": r.at_least, "frequency_std": r.frequency_std}
    return found | {"damping_std": r.damping_std, "mac": r.mac}


def _table(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row a mode; what is not known is null."""
    lists = {k: v.tolist() for k, v in columns.items()}
    count = len(lists["mode"])
    return [
        {k: (v[i] if np.isfinite(v[i]) else None) for k, v in lists.items()} for i in range(count)
    ]


def _modes(stage: PlanStage) -> list[dict[str, Any]]:
    """A row a target mode; what was not asked for is absent."""
    columns: dict[str, Any] = {
        "mode": stage.target_modes + 1,
        "frequency_hz": stage.target_frequencies,
        "reach": stage.reach,
        "shown": stage.shown,
        "loaded": stage.loaded,
    }
    if (r := stage.rehearsal) is not None:
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
    body = [[HEADS[k][1].format(r[k]) if r[k] is not None else "-" for k in here] for r in modes]
    rows(title, [HEADS[k][0] for k in here], body)


def _best(stage: PlanStage) -> dict[int, float]:
    """Number of points struck -> least reach of the best set of so many."""
    least = {
        len(s): r for s, r in zip(stage.sets[::-1], stage.least_reach[::-1].tolist(), strict=True)
    }
    return dict(sorted(least.items()))  # of sets of one size the first is the best


def _print(deck: Path, stage: PlanStage, told: dict[str, Any]) -> None:
    _print_modes(f"{deck}: {len(told['modes'])} target modes", told["modes"])
    if ambient := told.get("virtual_ambient_test"):
        _print_modes(f"{ambient['trials']} virtual ambient tests", ambient["modes"])
    best = _best(stage)
    lines = [
        f"{len(stage.test.channels)} channels at {stage.test.points.size} points, of "
        f"{stage.candidates} candidates: "
        f"{' '.join(map(str, told['points']))}",
        f"strike at {' '.join(stage.references)}; least reach of the best "
        f"{', '.join(map(str, best))} points: "
        f"{', '.join(f'{100 * r:.0f}' for r in best.values())} %",
        f"worst auto-MAC {stage.worst_off_diagonal:.2f}; {left_by_loss(stage)}",
        f"frequency step {stage.frequency_step:.3g} Hz, block {stage.block:.3g} s, "
        f"{stage.averages} averages; "
        f"ambient record {stage.record_length / 60:.3g} min, {stage.segments} blocks",
    ]
    lines += setups(stage)
    if stage.suspension:
        lines.append(f"hang at {' '.join(map(str, stage.suspension))}")
    lines += [*missed(stage), *stage.notes]
    for test in ("virtual_test", "virtual_ambient_test"):
        lines += told.get(test, {}).get("doubtful", [])
    lines.append("test sheet: " + " ".join(told["files"]))
    tell(lines)
