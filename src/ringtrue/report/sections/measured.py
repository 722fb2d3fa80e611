"""Signals and frequency response functions."""

from __future__ import annotations

import numpy as np

from ringtrue.plots import signals as plots
from ringtrue.report.parts import Block, Items, Plot, Section, Tabs, Text, number, plain, signs
from ringtrue.report.stages import Stages
from ringtrue.study.results import RecordSummary


def signals(data: Stages) -> Section | None:
    """Time previews and spectra of every record; of a roving test those of the first setup."""
    if data.identify is None or not data.identify.records:
        return None
    groups: dict[str, list[RecordSummary]] = {}
    for r in data.identify.records:
        groups.setdefault(r.test, []).append(r)
    tabs = [(name, _test(records)) for name, records in groups.items()]
    return Section("signals", "Signals", tabs[0][1] if len(tabs) == 1 else [Tabs(tabs)])


def _test(records: list[RecordSummary]) -> list[Block]:
    out = [_record(r) for r in records if r.preview_channels]
    setups = list(dict.fromkeys(r.setup for r in records))
    if len(setups) > 1:
        told = (
            f"Setup {setups[0]} of {', '.join(setups[:-1])} and {setups[-1]}; all of them are "
            "in the list of tests."
        )
        return [Text(told, "note"), *out]
    return out


def _record(r: RecordSummary) -> Block:
    text = f"{r.name}, {r.excitation}: time preview and power spectral density."
    return Plot(plots.record(r, r.unit.replace("^2", "²")), text)


def functions(data: Stages) -> Section | None:
    """All FRFs and the CMIF."""
    ident = data.identify
    if ident is None or ident.frfs is None:
        return None
    frfs = ident.frfs
    marks = ident.hammer.frequencies if ident.hammer is not None else np.empty(0)
    count = f"{len(frfs.outputs)} responses × {len(frfs.inputs)} references"
    top = 1.6 * float(marks.max()) if marks.size else float(frfs.freqs[-1])
    caption = (
        f"Imaginary parts of all {len(frfs.outputs) * len(frfs.inputs)} FRFs ({count}) and the "
        "complex mode "
        "indicator function; dotted: identified modes."
    )
    if top < frfs.freqs[-1]:
        caption += f" Measured to {plain(float(frfs.freqs[-1]))} Hz, drawn to {number(top, 3)} Hz."
    blocks: list[Block] = [Plot(plots.frfs(frfs, ident.cmif, marks, top), caption)]
    if ident.frf_notes:
        blocks.append(Items(ident.frf_notes, "Notes"))
    if ident.synthesis_error.size:
        middle, worst = np.nanmedian(ident.synthesis_error), np.nanmax(ident.synthesis_error)
        text = (
            "The FRFs synthesised from the identified modes differ from the measured ones by "
            f"{100 * middle:.1f} % "
        )
        blocks.append(
            Text(
                text
                + f"in the median and {100 * worst:.1f} % at worst (relative norm over the band)."
            )
        )
    if ident.rejected_hits:
        blocks.append(
            Items(
                [signs(h) for h in ident.rejected_hits],
                f"Rejected hits ({len(ident.rejected_hits)})",
            )
        )
    return Section("frfs", "Frequency response functions", blocks)
