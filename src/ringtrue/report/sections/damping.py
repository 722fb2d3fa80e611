"""Damping by region: loss factors and dashpots, the damping of each mode, the FRFs around the
resonances.
"""

from __future__ import annotations

import math

import numpy as np

from ringtrue.plots import damping as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Heading,
    Plot,
    Section,
    Table,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.report.sections.correlation import changes
from ringtrue.report.stages import Stages
from ringtrue.study.results import DampedModes, DampedRegions, DampingStage

TOLD = 0.8  # standard deviation after over before: above, the data said little


def section(data: Stages) -> Section | None:
    """Regions, modes, FRFs."""
    d = data.damping
    if d is None:
        return None
    if d.regions is None or d.modes is None:
        return Section("damping", "Damping by region", [Text(sentence(d.why), "note")])
    blocks: list[Block] = [Text(_lead(d, d.modes), "lead"), _regions(d.regions)]
    if any(n != "dashpot" for n in d.regions.natures):
        blocks.append(
            Plot(
                plots.regions(d.regions),
                "Loss factors of the regions; grey: what was expected beforehand.",
            )
        )
    blocks += [Text(sentence(f), "note") for f in d.flags]
    blocks += [Heading("Damping of the modes"), *_modes(d, d.modes)]
    for o in d.others:
        blocks += [Heading(f"Damping of the modes: {o.name}"), *_modes(d, o.modes)]
    if d.files:
        blocks += [Heading("The damped deck"), *changes(d.files, d.changes)]
    return Section("damping", "Damping by region", blocks)


def _lead(d: DampingStage, modes: DampedModes) -> str:
    """What came out, in two sentences."""
    (before, after), (blind_before, blind) = modes.spread(True), modes.spread(False)
    text = (
        "Loss factors and dashpots of the regions, fitted to the damping ratios of the "
        "identified modes. "
    )
    text += (
        f"The ratios of the modes used deviate by {_percent(after)} from the test (root mean "
        "square; "
    )
    text += f"{_percent(before)} with {d.before})"
    if math.isfinite(blind):
        text += (
            f"; those of the modes left out, a prediction, by {_percent(blind)} "
            f"({_percent(blind_before)})"
        )
    return text + "."


def _percent(x: float) -> str:
    return f"{100 * x:.0f} %"


def _regions(r: DampedRegions) -> Table:
    heads = ("|Region", "|Fields", "|", "Value", "σ", "Expected", "σ after / before")
    unit = {"material": "loss\u00a0factor", "joint": "loss\u00a0factor", "dashpot": "dashpot"}
    rows = []
    for i, name in enumerate(r.names):
        ratio = float(r.std[i] / r.expected_std[i]) if math.isfinite(r.expected_std[i]) else 0.0
        told = (
            Cell(fixed(ratio, 2), "warn", "the test says little about it")
            if ratio > TOLD
            else fixed(ratio, 2)
        )
        known = f"{number(float(r.expected[i]), 2)} ± {number(float(r.expected_std[i]), 2)}"
        values = [number(float(x), 3 - k) for k, x in enumerate((r.coefficients[i], r.std[i]))]
        rows.append([name, Cell(r.targets[i], "muted"), unit[r.natures[i]], *values, known, told])
    text = (
        "Regions; loss factors are 2ζ of a mode that had all its strain there, dashpots in "
        "force over velocity of "
    )
    text += "the deck's units. σ after / before near 1: the data say nothing about it."
    return Table(heads, rows, text)


def _modes(d: DampingStage, m: DampedModes) -> list[Block]:
    order = np.argsort(m.hertz).tolist()
    heads = [
        "|Test",
        "FE #",
        "f, Hz",
        "ζ test, %",
        "σ, %",
        "ζ before, %",
        "ζ by regions, %",
        "σ, %",
        "Δζ, %",
    ]
    rows = [
        [
            m.test[i],
            str(int(m.fe[i]) + 1),
            fixed(float(m.hertz[i]), 3),
            *(
                fixed(100 * float(x[i]), 3)
                for x in (m.measured, m.measured_std, m.before, m.after, m.after_std)
            ),
            fixed(100 * float(m.after[i] / m.measured[i] - 1), 0, sign=True),
            *(fixed(100 * float(x[i]), 0) for x in (m.frf_before, m.frf_after)),
            "used" if m.used[i] else Cell("left out", "chip"),
        ]
        for i in order
    ]
    heads += ["FRFs before, %", "after, %", "|Fit"]
    text = (
        f"Damping ratios of the paired modes, before with {d.before}. FRFs: root mean square "
        "error over all measured "
        "FRFs around the resonance, the model's mode at the frequency of the test: what is left "
        "is shape, and the "
        "sharper a resonance, the more it shows."
    )
    out: list[Block] = [
        Plot(plots.modes(m), "Damping ratios by mode; open marks were left out of the fit.")
    ]
    out.append(Table(heads, rows, text, scroll=len(rows) > 16))
    if np.isfinite(m.frf_after).any():
        out.append(Plot(plots.frfs(m), "Error of the FRFs around each resonance before and after."))
    return out
