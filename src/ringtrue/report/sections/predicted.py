"""What the validated model says of running the rotor."""

from __future__ import annotations

import numpy as np

from ringtrue.plots import predicted as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Plot,
    Section,
    Table,
    Tabs,
    Text,
    number,
    plain,
    sentence,
)
from ringtrue.report.stages import Stages
from ringtrue.study.results import PredictStage
from ringtrue.study.words import validated
from ringtrue.updating.prediction import Bands


def section(data: Stages) -> Section | None:
    """Peaks, curves with bands, and where the validated band ends."""
    p = data.predict
    if p is None:
        return None
    blocks: list[Block] = [Text(_lead(p), "lead"), _peaks(p)]
    tabs = [(name, [_curves(p, name, at)]) for name, at in _groups(p).items()]
    blocks.append(Tabs(tabs) if len(tabs) > 1 else tabs[0][1][0])
    blocks.append(Text(_basis(p), "note"))
    blocks += [Text(sentence(f), "note") for f in p.flags]
    return Section("prediction", "Running the rotor", blocks)


def _lead(p: PredictStage) -> str:
    u = p.unbalance
    text = (
        f"A rotor of {number(u.mass, 4)} kg at node {p.rotor}, turning about {p.axis} and "
        "balanced to G "
    )
    text += (
        f"{plain(u.grade)} for {plain(u.service)} Hz, has an unbalance of "
        f"{number(u.moment, 3)} kg m. "
    )
    text += f"It is run up to {plain(float(p.run_up.freqs[-1]))} Hz. "
    return text + sentence(validated(p.run_up.validated))


def _peaks(p: PredictStage) -> Table:
    r = p.run_up
    level = f"{100 * r.peak.level:.0f} %"
    at = int(np.argmin(np.abs(r.freqs - p.unbalance.service)))
    heads = (
        "|Quantity",
        "|Unit",
        "Peak",
        f"{level} band",
        "Speed, Hz",
        f"{level} band",
        "|",
        "At service",
        f"{level} band",
    )
    rows: list[list[str | Cell]] = []
    for i, name in enumerate(r.names):
        factor, unit = plots.shown(r.units[i])
        speed = float(r.peak_speed.median[i])
        inside = r.validated[0] <= speed <= r.validated[1]
        mark = (
            Cell("validated", "good")
            if inside
            else Cell("beyond", "warn", "no test has checked the model there")
        )
        now = Bands(
            r.amplitude.low[:, at],
            r.amplitude.median[:, at],
            r.amplitude.high[:, at],
            r.amplitude.level,
        )
        served = _banded(now, i, factor) if r.freqs[-1] >= p.unbalance.service else ["–", "–"]
        rows.append(
            [name, unit, *_banded(r.peak, i, factor), *_banded(r.peak_speed, i, 1.0), mark, *served]
        )
    return Table(
        heads,
        rows,
        "Largest amplitudes of the run-up, and those at service speed; medians and bands.",
    )


def _banded(values: Bands, i: int, factor: float) -> list[str]:
    """Median and band."""
    low, median, high = (
        number(factor * float(x[i])) for x in (values.low, values.median, values.high)
    )
    return [median, f"{low} to {high}"]


def _groups(p: PredictStage) -> dict[str, list[int]]:
    """Outputs by what they belong to: the rotor, and each group of springs."""
    out: dict[str, list[int]] = {}
    for i, name in enumerate(p.run_up.names):
        out.setdefault(name.rpartition(", ")[0], []).append(i)
    return out


def _curves(p: PredictStage, name: str, at: list[int]) -> Plot:
    names = [p.run_up.names[i].rpartition(", ")[2] for i in at]
    text = f"Run-up, {name}: median and {100 * p.run_up.amplitude.level:.0f} % band at each speed. "
    return Plot(
        plots.run_up(p.run_up, at, names, p.unbalance.service),
        text + "Grey: outside the validated band.",
    )


def _basis(p: PredictStage) -> str:
    text = (
        "The bands come from the uncertainty of the updated parameters, from a discrepancy of "
        "each frequency of "
    )
    text += (
        f"{100 * p.discrepancy:.1f} % that no parameter removes, and from the damping "
        f"({p.damping}). "
    )
    return (
        text
        + f"Residual of the reduced model at the worst speed: {100 * p.residual:.1f} % of the load."
    )
