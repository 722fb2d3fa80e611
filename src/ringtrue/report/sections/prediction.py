"""Uncertainty of the parameters, and the run-up of the rotor."""

from __future__ import annotations

import math

import numpy as np

from ringtrue.core.arrays import Bool
from ringtrue.plots import predicted, updating
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fact,
    Facts,
    Fold,
    Heading,
    Items,
    Plot,
    ReportTable,
    Section,
    Stages,
    Tabs,
    Text,
    fixed,
    number,
    plain,
    sentence,
)
from ringtrue.study.messages import validity_sentence
from ringtrue.study.results import PredictStage, UncertaintyStage
from ringtrue.updating.prediction import Bands, RunUp


def uncertainty(data: Stages) -> Section | None:
    """Posterior of the parameters, bands of the frequencies, the modes left out in turn."""
    s = data.uncertainty
    if s is None:
        return None
    percent = f"{100 * s.level:g} %"
    blocks: list[Block] = [
        _facts(s),
        Text(_lead(s), "lead"),
        Heading("Predicted frequencies"),
    ]
    caption = (
        f"Deviation of the final model from the test, with the {percent} band of the prediction: "
        "the parameters, "
        "the model and the test. A band that reaches the zero line holds the measured frequency."
    )
    blocks += [
        Plot(updating.bands(s), caption),
        Fold("The bands mode by mode", [_modes(s)]),
    ]
    blocks += [Heading("Modes left out in turn"), _folds(s), Heading("Parameters")]
    band_plot = Plot(
        updating.parameters(s),
        f"The parameters before and after the test, {percent} intervals.",
    )
    trade = Plot(
        updating.correlation(s),
        "Correlation of the parameters: near ±1 two of them trade for each other.",
    )
    blocks.append(
        Columns([[band_plot], [trade]])
        if len(s.posterior.parameters) > 1
        else band_plot
    )
    blocks.append(_parameters(s))
    if s.flags:
        blocks.append(
            Items([sentence(f.text) for f in s.flags], "To be looked at by an engineer")
        )
    return Section("uncertainty", "Uncertainty and left-out modes", blocks)


def _share(inside: Bool, which: Bool) -> str:
    return f"{int((inside & which).sum())} of {int(which.sum())}"


def _facts(s: UncertaintyStage) -> Facts:
    there = np.isfinite(s.bands.predicted)
    percent = f"{100 * s.level:g} %"
    facts = [
        Fact("Model discrepancy, frequency", fixed(100 * s.discrepancy[0], 2), "%")
    ]
    left_out = there & ~s.bands.used
    if left_out.any():
        inside = _share(s.bands.inside, left_out)
        facts.append(Fact(f"Left-out modes in their {percent} bands", inside))
    inside = _share(s.held.inside(s.level), s.held.in_turn)
    facts.append(Fact("Used modes, left out in turn, in theirs", inside))
    moved = s.posterior.moved
    determined = f"{int(moved.sum())} of {moved.size}"
    return Facts([*facts, Fact("Parameters that the test has determined", determined)])


def _lead(s: UncertaintyStage) -> str:
    f, m = (100 * float(x) for x in s.discrepancy)
    assumed = [100 * float(x) for x in s.assumed]
    scatter = 100 * float(np.median(s.bands.parts[:, 1]))
    exact = ""
    if 0 < 2 * scatter < f:  # a test without standard deviations says nothing of it
        exact = (
            f"; the test is about {float(f'{f / scatter:.1g}'):.0f} times more exact"
        )
    found = f"{fixed(f, 2)} % of a frequency"
    before = number(assumed[0], 2)
    if np.isfinite(m):
        found += f" and {fixed(m, 1)} % of MAC"
        before += f" and {number(assumed[1], 2)}"
    return (
        "What no parameter can explain is the discrepancy of the model. Estimated from modes "
        f"predicted unseen it is {found} (the updating assumed {before} %){exact}. "
        "It is part of every interval and band below."
    )


def _modes(s: UncertaintyStage) -> ReportTable:
    heads = ["#", "f test, Hz", "f FE, Hz", "Δf, %", "Band, ± %"]
    heads += ["Parameters, %", "Test, %", "Model, %", "|Updating", "|"]
    b = s.bands
    rows: list[list[str | Cell]] = []
    for i in np.flatnonzero(np.isfinite(b.predicted)):
        f = b.test[i]
        g = b.predicted[i]
        row: list[str | Cell] = [
            str(i + 1),
            fixed(f, 3),
            fixed(g, 3),
            fixed(100 * (g / f - 1), 2, sign=True),
            fixed(100 * (b.band[i, 1] - g) / f, 2),
            *(number(100 * x, 2) for x in b.parts[i]),
            "used" if b.used[i] else Cell("left out", "chip"),
            Cell("inside", "good") if b.inside[i] else Cell("outside", "bad"),
        ]
        rows.append(row)
    text = (
        "Predicted frequencies and their bands; standard deviations from the parameters, the "
        "test and the model."
    )
    return ReportTable(heads, rows, text, scroll=len(rows) > 16)


def _folds(s: UncertaintyStage) -> ReportTable:
    h = s.held
    rows = []
    inside = h.inside(s.level)
    band = h.band(s.level)
    for k in range(int(h.fold.max(initial=-1)) + 1):
        for j, i in enumerate(np.flatnonzero(h.fold == k)):
            row: list[str | Cell] = [
                str(k + 1) if j == 0 else "",
                str(i + 1),
                fixed(h.test[i], 3),
            ]
            if not np.isfinite(h.predicted[i]):
                rows.append([*row, "–", "–", "–", "–", Cell("no partner", "warn")])
                continue
            reach = 100 * (band[i, 1] - h.predicted[i]) / h.test[i]
            row += [
                fixed(h.predicted[i], 3),
                fixed(100 * h.error[i], 2, sign=True),
                fixed(reach, 2),
                fixed(100 * h.mac[i], 1),
                Cell("inside", "good") if inside[i] else Cell("outside", "bad"),
            ]
            rows.append(row)
    heads = (
        "Fold",
        "Test #",
        "f test, Hz",
        "Predicted, Hz",
        "Δf, %",
        "Band, ± %",
        "MAC, %",
        "|",
    )
    seen = h.in_turn
    off = fixed(100 * float(np.abs(h.error[seen]).mean()), 2)
    text = (
        "The model is updated again without the modes of each fold, which it then predicts: "
        f"{int(seen.sum())} modes, mean |Δf| {off} %; {fixed(100 * h.coverage(s.level), 0)} % "
        "are in their "
        f"{100 * s.level:g} % bands. The discrepancy of a band comes from all other modes that "
        "were predicted unseen."
    )
    text += "" if h.converged else " Not every updating converged."
    return ReportTable(heads, rows, text, scroll=len(rows) > 12).without_blank("MAC")


def _parameters(s: UncertaintyStage) -> ReportTable:
    sampled = len(s.chains.sampled) > 0
    heads = ["|Parameter", "Factor", f"{100 * s.level:g} % after the test", "before it"]
    heads += ["σ after / before", "Change kept, %"]
    heads += ["sampled"] if sampled else []
    rows: list[list[str | Cell]] = []
    p = s.posterior
    for i, name in enumerate(p.parameters.names):
        row: list[str | Cell] = [
            name,
            fixed(p.factor[i], 3),
            _span(p.interval[i]),
            _span(p.prior[i]),
            number(p.ratio[i], 2),
            fixed(100 * s.kept[i], 0),
        ]
        row += [_span(s.chains.sampled[i])] if sampled else []
        chip: str | Cell = Cell("not proven", "warn") if s.unproven[i] else ""
        rows.append(
            [*row, chip if p.moved[i] else Cell("the test says little", "warn")]
        )
    text = (
        "Intervals of the factors, around the final values, with the discrepancy of the model as "
        "the error and the "
        "candidates that were not chosen as wide as their priors. Change kept: the least that is "
        "left of a change that "
        "is not slight when a fold of modes is left out. Where the interval holds 1, or less "
        "than half is kept, the "
        "parameter may take up an error of the model's form, or the test determines it only "
        "together with others."
    )
    if sampled:
        text += (
            f" Sampled by {len(s.chains.draws)} stored draws of an ensemble "
            "(Goodman and Weare 2010): "
            "as good as "
            f"{number(s.chains.independent, 2)} independent ones, "
            f"{fixed(100 * s.chains.acceptance, 0)} % of "
            "the moves accepted"
            f"{'' if s.chains.converged else '; too short to rest on'}."
        )
    return ReportTable([*heads, "|"], rows, text)


def _span(low_high: np.ndarray) -> str:
    low, high = low_high
    # three digits would not distinguish the ends
    narrow = 0 < high - low < 0.02 * abs(high)
    digits = 1 + math.ceil(math.log10(abs(high) / (high - low))) if narrow else 3
    return f"{number(low, digits)} to {number(high, digits)}"


def prediction(data: Stages) -> Section | None:
    """Peaks, curves with bands, and where the validated band ends."""
    p = data.predict
    if p is None:
        return None
    blocks: list[Block] = [Text(_run_up_lead(p), "lead"), _peaks(p)]
    # outputs of the rotor, and of each group of springs
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(p.run_up.names):
        groups.setdefault(name.rpartition(", ")[0], []).append(i)
    tabs = [(name, [_curves(p, name, at)]) for name, at in groups.items()]
    blocks.append(Tabs(tabs) if len(tabs) > 1 else tabs[0][1][0])
    blocks.append(Text(_basis(p), "note"))
    blocks += [Text(sentence(f), "note") for f in p.flags]
    return Section("prediction", "Running the rotor", blocks)


def _run_up_lead(p: PredictStage) -> str:
    u = p.unbalance
    return (
        f"A rotor of {number(u.mass, 4)} kg at node {p.rotor}, turning about {p.axis} and "
        f"balanced to G {plain(u.grade)} for {plain(u.service)} Hz, has an unbalance of "
        f"{number(u.moment, 3)} kg m. It is run up to {plain(p.run_up.freqs[-1])} Hz. "
        f"{sentence(validity_sentence(p.run_up.validated))}"
    )


def _peaks(p: PredictStage) -> ReportTable:
    r = p.run_up
    level = f"{100 * r.peak.level:.0f} %"
    at = int(np.argmin(np.abs(r.freqs - p.unbalance.service)))
    band = f"{level} band"
    served_at = r.validated[0] <= p.unbalance.service <= r.validated[1]
    service = f"At {number(p.unbalance.service, 3)} Hz" + (
        "" if served_at else ", beyond"
    )
    heads = ("|Quantity", "|Unit", "Peak", band, "Speed, Hz", band, "|", service, band)
    rows: list[list[str | Cell]] = []
    for i, name in enumerate(r.names):
        factor, unit = predicted.shown(r.units[i])
        mark = _mark(r, i)
        now = Bands(
            r.amplitude.low[:, at],
            r.amplitude.median[:, at],
            r.amplitude.high[:, at],
            r.amplitude.level,
        )
        served = (
            _banded(now, i, factor)
            if r.freqs[-1] >= p.unbalance.service
            else ["–", "–"]
        )
        rows.append(
            [
                name,
                unit,
                *_banded(r.peak, i, factor),
                *_banded(r.peak_speed, i, 1.0),
                mark,
                *served,
            ]
        )
    return ReportTable(
        heads,
        rows,
        "Largest amplitudes of the run-up, and those at service speed; medians and bands. A peak "
        "is validated where the whole band of its speed is in the validated band.",
    )


def _mark(r: RunUp, i: int) -> Cell:
    """Whether the peak of an output is in the validated band."""
    if r.checked_peaks[i]:
        return Cell("validated", "good")
    if r.validated[0] <= r.peak_speed.median[i] <= r.validated[1]:
        return Cell(
            "may be beyond", "warn", "the band of its speed leaves the validated band"
        )
    return Cell("beyond", "warn", "no test has checked the model there")


def _banded(values: Bands, i: int, factor: float) -> list[str]:
    """Median and band."""
    low, median, high = (
        number(factor * x[i]) for x in (values.low, values.median, values.high)
    )
    return [median, f"{low} to {high}"]


def _curves(p: PredictStage, name: str, at: list[int]) -> Plot:
    names = [p.run_up.names[i].rpartition(", ")[2] for i in at]
    text = f"Run-up, {name}: median and {100 * p.run_up.amplitude.level:.0f} % band at each speed. "
    return Plot(
        predicted.run_up(p.run_up, at, names, p.unbalance.service),
        text + "Grey: outside the validated band.",
    )


def _basis(p: PredictStage) -> str:
    return (
        "The bands come from the uncertainty of the updated parameters, from a discrepancy of "
        f"each frequency of {100 * p.discrepancy:.1f} % that no parameter removes, and from the "
        f"damping ({p.damping}). Residual of the reduced model at the worst speed: "
        f"{100 * p.residual:.1f} % of the load."
    )
