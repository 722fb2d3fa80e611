"""Damping and responses of the final model, and damping by region."""

from __future__ import annotations

import math

import numpy as np

from ringtrue.core.display import plus_minus, with_error
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.correlation.frf import InputSummary
from ringtrue.plots import correlation, diagram, signals
from ringtrue.plots import predicted as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fold,
    Heading,
    Plot,
    ReportTable,
    Section,
    Stages,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.report.sections.correlation import changes
from ringtrue.study.results import DampedModes, DampedRegions, DampingStage, FrfEvidence


def response(data: Stages) -> Section | None:
    """What the final model answers with: damping, FRFs before and after."""
    f = data.final
    if f is None:
        return None
    blocks: list[Block] = [
        Heading("Damping"),
        _damping_plot(data),
        _damping_table(data),
    ]
    if not _has_damping(data):
        taken = " and ".join(dict.fromkeys(f.damping_from)) or "none"
        blocks = [
            Text(
                f"The test has no damping ratios. Damping of the final model: {taken}."
            )
        ]
    if f.evidence is not None and f.evidence.frfs is not None:
        blocks += [
            Heading("Measured against computed responses"),
            *_agreement(f.evidence.frfs),
        ]
    if f.frfs is not None:
        measured = data.identify.frfs if data.identify is not None else None
        unit = signals.frf_unit(measured) if measured is not None else "(m/s²)/N"
        blocks.append(Heading("FRFs at the excitation points"))
        known = _at_points(f.evidence.frfs) if f.evidence and f.evidence.frfs else {}
        for k, name in enumerate(f.frfs.channels):
            caption = f"FRF {name} (response / force), measured and of both models. "
            caption += known.get(name, "")
            blocks.append(Plot(signals.frf_pair(f.frfs, k, unit), caption))
    return Section("response", "Damping and response", blocks)


def _has_damping(data: Stages) -> bool:
    """Whether the test has damping ratios."""
    if data.identify is None:
        return False
    found = [data.identify.ambient, data.identify.hammer]
    return any(np.isfinite(x.modes.damping).any() for x in found if x is not None)


def _agreement(e: FrfEvidence) -> list[Block]:
    """FRFs reference by reference, over frequency, and line against line."""
    span = f"{number(e.final.freqs[0], 3)} to {number(e.final.freqs[-1], 3)} Hz"
    rows = [
        _reference(a, b)
        for a, b in zip(e.initial.by_input(), e.final.by_input(), strict=True)
    ]
    heads = (
        "|Reference",
        "FRAC, %",
        "Level, dB",
        "Shape, %",
        "Amplitude, %",
        "|Least FRAC of the final model",
        "|Verdict",
    )
    caption = (
        f"All FRFs of each reference from {span}, initial → final model. FRAC and level "
        "difference (root mean square): "
        "medians of the responses; global shape and amplitude correlation: means over the lines."
    )
    over = (
        "Shape and amplitude correlation of all responses at each line, mean of the references "
        "(100 %: equal; the "
        "shape is blind to scale)."
    )
    out: list[Block] = [ReportTable(heads, rows, caption)]
    if e.worse:
        text = "The final model is in part worse than the initial one for forces at "
        out.append(Text(f"{text}{', '.join(e.worse)}."))
    out.append(Plot(correlation.frf_agreement(e), over))
    ridge = (
        "FDAC of all responses, {} model: a ridge on the diagonal means that every response "
        "comes at its frequency."
    )
    both = (("initial", e.fdac_initial), ("final", e.fdac_final))
    out.append(
        Columns(
            [
                [Plot(correlation.fdac(v, e.lines, f"{k} model"), ridge.format(k))]
                for k, v in both
            ]
        )
    )
    each = [
        (o.name, fixed(100 * o.frac, 1), fixed(o.deviation, 1))
        for o in e.final.by_output()
    ]
    text = "Responses of the final model, the worst first: medians over the references."
    table = ReportTable(
        ("|Response", "FRAC, %", "Level difference, dB"), each, text, scroll=True
    )
    return [*out, Fold(f"All {len(each)} responses", [table])]


def _at_points(e: FrfEvidence) -> dict[str, str]:
    """What each FRF, named "response / force", says of the final model."""
    out: dict[str, str] = {}
    for i, response in enumerate(e.final.outputs):
        for j, force in enumerate(e.final.inputs):
            frac = e.initial.frac[i, j], e.final.frac[i, j]
            level = e.initial.deviation[i, j], e.final.deviation[i, j]
            better = frac[1] >= frac[0], level[1] <= level[0]
            verdict = (
                "better" if all(better) else "in part worse" if any(better) else "worse"
            )
            percent = " → ".join(fixed(100 * x, 1) for x in frac)
            decibel = " → ".join(fixed(x, 1) for x in level)
            out[f"{response} / {force}"] = (
                f"FRAC {percent} %, level difference {decibel} dB: the final model is {verdict}."
            )
    return out


def _reference(before: InputSummary, after: InputSummary) -> tuple[str | Cell, ...]:
    def both(one: float, two: float) -> str:
        return f"{fixed(one, 1)} → {fixed(two, 1)}"

    worse = after.worse_than(before)
    verdict = Cell("better", "good")
    if worse:
        verdict = Cell(
            f"worse: {', '.join(worse)}", "warn" if len(worse) < 4 else "bad"
        )
    return (
        before.name,
        both(100 * before.frac, 100 * after.frac),
        both(before.deviation, after.deviation),
        both(100 * before.shape, 100 * after.shape),
        both(100 * before.amplitude, 100 * after.amplitude),
        f"{after.worst_output}, {fixed(100 * after.least_frac, 1)} %",
        verdict,
    )


def _damping_plot(data: Stages) -> Plot:
    sets: list[tuple[str, ModeSet, Uncertainty | None]] = []
    if data.identify is not None:
        i = data.identify
        if len(i.ambient):
            sets.append(("ambient", i.ambient.modes, i.ambient.uncertainty))
        if i.hammer is not None:
            name = i.source.removesuffix(" test")
            sets.append((name, i.hammer.modes, i.hammer.uncertainty))
    assert data.final is not None
    used = (data.final.modes.frequencies, data.final.damping)
    text = (
        "Damping ratios identified, with one standard deviation, and those the "
        "final model carries."
    )
    return Plot(diagram.damping(sets, used), text)


def _damping_table(data: Stages) -> ReportTable:
    f = data.final
    assert f is not None
    rows = [
        (
            str(k + 1),
            fixed(f.modes.frequencies[k], 3),
            number(100 * float(f.damping[k])),
            f.damping_from[k],
        )
        for k in range(int(np.size(f.damping)))
    ]
    return ReportTable(
        ("FE #", "f, Hz", "ζ, %", "|Taken from"),
        rows,
        "Damping of the final model.",
        scroll=len(rows) > 16,
    )


TOLD = 0.8  # standard deviation after over before: above, the data said little


def damping(data: Stages) -> Section | None:
    """Regions, modes, FRFs."""
    d = data.damping
    if d is None:
        return None
    if d.regions is None or d.modes is None:
        if not _has_damping(data):
            return None  # the section above says so
        return Section("damping", "Damping by region", [Text(sentence(d.why), "note")])
    blocks: list[Block] = [Text(_lead(d, d.modes), "lead"), _regions(d.regions)]
    if d.why:
        blocks.insert(0, Text(sentence(f"Refused: {d.why}")))
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
    before, after = modes.spread(True)
    blind_before, blind = modes.spread(False)
    text = (
        "Loss factors and dashpots of the regions, fitted to the damping ratios of the "
        f"identified modes. The ratios of the modes used deviate by {100 * after:.0f} % from the "
        f"test (root mean square; {100 * before:.0f} % with {d.before})"
    )
    if math.isfinite(blind):
        text += (
            f"; those of the modes left out, a prediction, by {100 * blind:.0f} % "
            f"({100 * blind_before:.0f} %)"
        )
    return f"{text}."


def _regions(r: DampedRegions) -> ReportTable:
    heads = ("|Region", "|Fields", "|", "Value", "σ", "Expected", "σ after / before")
    unit = {
        "material": "loss\u00a0factor",
        "joint": "loss\u00a0factor",
        "dashpot": "dashpot",
    }
    rows = []
    for i, name in enumerate(r.names):
        ratio = (
            float(r.std[i] / r.expected_std[i])
            if math.isfinite(r.expected_std[i])
            else 0.0
        )
        described = (
            Cell(fixed(ratio, 2), "warn", "the test says little about it")
            if ratio > TOLD
            else fixed(ratio, 2)
        )
        known = plus_minus(r.expected[i], r.expected_std[i])
        values = with_error(r.coefficients[i], r.std[i])
        rows.append(
            [
                name,
                Cell(r.targets[i], "muted"),
                unit[r.natures[i]],
                *values,
                known,
                described,
            ]
        )
    text = (
        "Regions; loss factors are 2ζ of a mode that had all its strain there, dashpots in "
        "force over velocity of "
    )
    text += "the deck's units. σ after / before near 1: the data say nothing about it."
    return ReportTable(heads, rows, text)


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
            fixed(m.hertz[i], 3),
            *with_error(100 * m.measured[i], 100 * m.measured_std[i], 3),
            number(100 * m.before[i]),
            *with_error(100 * m.after[i], 100 * m.after_std[i], 3),
            fixed(100 * float(m.after[i] / m.measured[i] - 1), 0, sign=True),
            *(fixed(100 * x[i], 0) for x in (m.frf_before, m.frf_after)),
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
        Plot(
            plots.modes(m),
            "Damping ratios by mode; open marks were left out of the fit.",
        )
    ]
    out.append(ReportTable(heads, rows, text, scroll=len(rows) > 16))
    if np.isfinite(m.frf_after).any():
        out.append(
            Plot(
                plots.frfs(m),
                "Error of the FRFs around each resonance before and after.",
            )
        )
    return out
