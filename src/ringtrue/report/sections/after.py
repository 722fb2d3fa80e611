"""Damping and FRFs of the final model."""

from __future__ import annotations

import numpy as np

from ringtrue.core.modes import ModeSet
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.plots import identification, signals
from ringtrue.report.parts import Block, Heading, Plot, Section, Table, fixed
from ringtrue.report.stages import Stages


def section(data: Stages) -> Section | None:
    """What the final model answers with: damping, FRFs before and after."""
    f = data.final
    if f is None:
        return None
    blocks: list[Block] = [Heading("Damping"), _damping_plot(data), _damping_table(data)]
    if len(f.frf_channels):
        unit = signals.FRF_UNITS["accelerance"]
        if data.identify is not None and data.identify.frfs is not None:
            unit = signals.FRF_UNITS[data.identify.frfs.kind]
        blocks.append(Heading("FRFs before and after"))
        caption = "FRF (response / force) measured, of the initial and of the final model."
        blocks += [Plot(signals.frf_pair(f, k, unit), caption) for k in range(len(f.frf_channels))]
    return Section("response", "Damping and response", blocks)


def _damping_plot(data: Stages) -> Plot:
    sets: list[tuple[str, ModeSet, Uncertainty | None]] = []
    if data.identify is not None:
        i = data.identify
        sets += [("ambient", i.ambient, i.ambient_uncertainty)] if len(i.ambient) else []
        sets += [("hammer", i.hammer, i.hammer_uncertainty)] if i.hammer is not None else []
    assert data.final is not None
    used = (data.final.modes.frequencies, data.final.damping)
    text = "Damping ratios identified, with one standard deviation, and those the final model carries."
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
    return Table(("FE #", "f, Hz", "ζ, %", "|Taken from"), rows, "Damping of the final model.", scroll=len(rows) > 16)
