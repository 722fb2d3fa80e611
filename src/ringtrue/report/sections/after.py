"""Damping and FRFs of the final model."""

from __future__ import annotations

import numpy as np

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.correlation.frf import InputSummary
from ringtrue.plots import correlation, identification, signals
from ringtrue.report.parts import Block, Columns, Fold, Heading, Plot, Section, Table, fixed, number
from ringtrue.report.stages import Stages
from ringtrue.study.results import FrfEvidence


def section(data: Stages) -> Section | None:
    """What the final model answers with: damping, FRFs before and after."""
    f = data.final
    if f is None:
        return None
    blocks: list[Block] = [Heading("Damping"), _damping_plot(data), _damping_table(data)]
    if f.evidence is not None and f.evidence.frfs is not None:
        blocks += [Heading("Measured against computed responses"), *_agreement(f.evidence.frfs)]
    if len(f.frf_channels):
        measured = data.identify.frfs if data.identify is not None else None
        unit = signals.frf_unit(measured) if measured is not None else "(m/s²)/N"
        blocks.append(Heading("FRFs at the driving points"))
        caption = "FRF (response / force) measured, of the initial and of the final model."
        blocks += [Plot(signals.frf_pair(f, k, unit), caption) for k in range(len(f.frf_channels))]
    return Section("response", "Damping and response", blocks)


def _agreement(e: FrfEvidence) -> list[Block]:
    """FRFs reference by reference, over frequency, and line against line."""
    span = f"{number(float(e.final.freqs[0]), 3)} to {number(float(e.final.freqs[-1]), 3)} Hz"
    rows = [_reference(a, b) for a, b in zip(e.initial.by_input(), e.final.by_input(), strict=True)]
    heads = (
        "|Reference",
        "FRAC, %",
        "Level, dB",
        "Shape, %",
        "Amplitude, %",
        "|Least FRAC of the final model",
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
    out: list[Block] = [Table(heads, rows, caption), Plot(correlation.frf_agreement(e), over)]
    ridge = (
        "FDAC of all responses, {} model: a ridge on the diagonal means that every response "
        "comes at its frequency."
    )
    both = (("initial", e.fdac_initial), ("final", e.fdac_final))
    out.append(
        Columns(
            [[Plot(correlation.fdac(v, e.lines, f"{k} model"), ridge.format(k))] for k, v in both]
        )
    )
    each = [(o.name, fixed(100 * o.frac, 1), fixed(o.deviation, 1)) for o in e.final.by_output()]
    text = "Responses of the final model, the worst first: medians over the references."
    table = Table(("|Response", "FRAC, %", "Level difference, dB"), each, text, scroll=True)
    return [*out, Fold(f"All {len(each)} responses", [table])]


def _reference(before: InputSummary, after: InputSummary) -> tuple[str, ...]:
    def both(one: float, two: float) -> str:
        return f"{fixed(one, 1)} → {fixed(two, 1)}"

    return (
        before.name,
        both(100 * before.frac, 100 * after.frac),
        both(before.deviation, after.deviation),
        both(100 * before.shape, 100 * after.shape),
        both(100 * before.amplitude, 100 * after.amplitude),
        f"{after.worst_output}, {fixed(100 * after.least_frac, 1)} %",
    )


def _damping_plot(data: Stages) -> Plot:
    sets: list[tuple[str, ModeSet, Uncertainty | None]] = []
    if data.identify is not None:
        i = data.identify
        sets += [("ambient", i.ambient, i.ambient_uncertainty)] if len(i.ambient) else []
        sets += (
            [(i.source.removesuffix(" test"), i.hammer, i.hammer_uncertainty)]
            if i.hammer is not None
            else []
        )
    assert data.final is not None
    used = (data.final.modes.frequencies, data.final.damping)
    text = (
        "Damping ratios identified, with one standard deviation, and those the final model carries."
    )
    return Plot(identification.damping(sets, used), text)


def _damping_table(data: Stages) -> Table:
    f = data.final
    assert f is not None
    rows = [
        (
            str(k + 1),
            fixed(float(f.modes.frequencies[k]), 3),
            fixed(100 * float(f.damping[k]), 2),
            f.damping_from[k],
        )
        for k in range(int(np.size(f.damping)))
    ]
    return Table(
        ("FE #", "f, Hz", "ζ, %", "|Taken from"),
        rows,
        "Damping of the final model.",
        scroll=len(rows) > 16,
    )
