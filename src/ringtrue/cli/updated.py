"""What `update` has found: as JSON and in tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.cli.show import out, rows, tell
from ringtrue.core.arrays import Float
from ringtrue.shapes.mac import paired_mac
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.config import StudyConfig
from ringtrue.study.measured_data import Data
from ringtrue.study.messages import discrepancy_sentence, worse_frequencies
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.problem import Evaluated, Problem
from ringtrue.updating.residuals.modal import Point
from ringtrue.updating.strategy import Verified, kept
from ringtrue.updating.target import Target

SIDES = ("measured", "before", "after")


def _sides(problem: Problem, done: Verified) -> tuple[Evaluated, Evaluated]:
    """The deck and the end on the verified model, paired by the gates and weighed as assumed."""
    model, y = done.problem.configurations[0].model, done.solution.y
    same = replace(problem, configurations=(replace(problem.configurations[0], model=model),))
    return same.evaluate(0 * y), same.evaluate(y)


def summary_of(
    config: StudyConfig,
    problem: Problem,
    done: Verified,
    data: Sequence[Data],
    solver: str,
    seen: bool,
) -> dict[str, Any]:
    """The updating of a problem as JSON has it; `seen`: shapes were measured."""
    sides, end, parameters = _sides(problem, done), done.solution, config.candidates()
    std = end.std * parameters.derivative(end.x) / end.factors
    flags = plausibility(parameters, end.x, end.identifiability)
    return {
        "outcome": end.outcome.value,
        "why": end.why if end.outcome.ok else f"{end.outcome.value} ({end.why})",
        "objective": [s.cost for s in sides],
        "discrepancy_percent": dict(
            zip(("frequency", "mac"), map(_number, 100 * kept(done.problem)), strict=True)
        ),
        "solver": solver,
        "basis_error": done.error,
        "full_solutions": done.full_solutions,
        "parameters": [
            {
                "name": n,
                "factor": float(a),
                "relative_std": float(s),
                "posterior_over_prior": float(t),
            }
            for n, a, s, t in zip(
                parameters.names, end.factors, std, end.identifiability, strict=True
            )
        ],
        "flags": [f.text for f in flags],
        "modes": _modes(
            problem.configurations[0].target, (sides[0].points[0], sides[1].points[0]), seen
        ),
    } | _measured(data, sides)


def _measured(data: Sequence[Data], sides: tuple[Evaluated, Evaluated]) -> dict[str, Any]:
    """What was measured beside the modes, by the model before and after."""
    if not data:
        return {}
    (before, after), found = (s.points[0] for s in sides), list[dict[str, Any]]()
    for d in data:
        columns = (d.measured, d.shown(d.term(before)), d.shown(d.term(after)))
        for label, unit, *values in zip(d.labels, d.units, *columns, strict=True):
            told = map(_number, values)
            found.append(
                {"name": d.name, "what": label, "unit": unit} | dict(zip(SIDES, told, strict=True))
            )
    return {"measured": found}


def _modes(target: Target, sides: tuple[Point, Point], seen: bool) -> list[dict[str, Any]]:
    """Deviation and MAC of each test mode, before and after; null without a partner, or shapes that
    were `seen`.
    """
    f, k = target.frequencies, target.frequencies.size
    found: Float = np.full((6, k), np.nan)
    for i, at in enumerate(sides):
        t, j = at.every.T
        deviation, single, subspace = found[3 * i : 3 * i + 3]
        deviation[t] = 100 * (at.now.frequencies[j] / f[t] - 1)
        if seen:
            single[t] = 100 * paired_mac(target.shapes[:, t], at.now.shapes[:, j])
            subspace[t] = 100 * at.mac
    names = tuple(
        f"{what}{when}_percent"
        for when in ("_before", "")
        for what in ("deviation", "mac", "subspace_mac")
    )
    return [
        {"frequency_hz": float(f[i]), "used": bool(target.used[i])}
        | dict(zip(names, map(_number, found[:, i].tolist()), strict=True))
        for i in range(k)
    ]


def show_summary(study: Path, summary: dict[str, Any]) -> None:
    """Print it."""
    body: list[tuple[object, ...]] = [
        (
            p["name"],
            f"{p['factor']:.4f}",
            f"{100 * p['relative_std']:.1f}",
            f"{p['posterior_over_prior']:.2f}",
        )
        for p in summary["parameters"]
    ]
    rows(f"{study}: parameters", ("parameter", "factor", "± [%]", "posterior/prior"), body)
    body = [
        (
            i + 1,
            f"{m['frequency_hz']:.5g}",
            *(_cell(v) for v in list(m.values())[2:]),
            "" if m["used"] else "left out",
        )
        for i, m in enumerate(summary["modes"])
    ]
    heads = (
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
    rows("modes", heads, body)
    if summary.get("measured"):
        body = [
            (m["name"], m["what"], m["unit"], *(_short(m[k]) for k in SIDES))
            for m in summary["measured"]
        ]
        rows("beside the modes", ("", "what", "unit", *SIDES), body)
    weighed = discrepancy_sentence(
        [(v or 0.0) / 100 for v in summary["discrepancy_percent"].values()]
    )
    deviations = [f"deviation{when}_percent" for when in ("_before", "")]
    both = [m for m in summary["modes"] if m["used"] and all(m[d] is not None for d in deviations)]
    worsened = worse_frequencies(*(np.array([m[d] for m in both]) for d in deviations))
    lines = (
        *summary["notes"],
        summary["why"],
        weighed,
        worsened,
        *summary["flags"],
        *(f"deck: {p}" for p in summary["deck"]),
    )
    tell(line for line in lines if line)
    if summary["solver"] == EMBEDDED:
        error = summary["basis_error"]
        count = summary["full_solutions"]
        told = (
            f"{count} full solution{'s' if count != 1 else ''}; the reduced model is off by "
            f"{error:.1e} at most"
        )
    else:
        told = f"{summary['full_solutions']} runs of {summary['solver']}"
    out.print(told)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
