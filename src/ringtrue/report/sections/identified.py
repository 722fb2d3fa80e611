"""Identification: stabilisation diagrams and the modes found."""

from __future__ import annotations

from collections.abc import Sequence

from ringtrue.core.modes import ModeSet
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.plots import identification as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Heading,
    Items,
    Key,
    Plot,
    ReportTable,
    Section,
    Stages,
    Tabs,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.study.results import IdentifiedModes


def section(data: Stages) -> Section | None:
    """Diagrams behind tabs, a table of modes for each test."""
    ident = data.identify
    if ident is None:
        return None
    tabs = [
        (r.record, _diagrams(r.record, r.diagrams, r.modes))
        for r in ident.ambient_records
        if r.diagrams
    ]
    hammer = ident.hammer
    if hammer is not None and hammer.diagrams:
        name = ident.source.removesuffix(" test")
        tabs.append((name, _diagrams(name, hammer.diagrams, hammer.modes)))
    blocks: list[Block] = (
        [Heading("Stabilisation diagrams"), Key(plots.POLE_COLORS), Tabs(tabs)] if tabs else []
    )
    sides: list[list[Block]] = []
    if len(ident.ambient):
        sides.append([_modes(ident.ambient, "Ambient modes, merged over the records.")])
    if hammer is not None:
        sides.append([_modes(hammer, f"Modes of the {ident.source}.")])
    if sides:
        blocks.append(Columns(sides) if len(sides) > 1 else sides[0][0])
    if ident.merge_notes:
        blocks.append(
            Items([sentence(n) for n in ident.merge_notes], "Channels undone before merging")
        )
    if len(ident.ambient_records) > 1:
        blocks.append(_by_record(data))
    return Section("identification", "Identification", blocks)


def _diagrams(name: str, diagrams: Sequence[StableDiagram], modes: ModeSet) -> list[Block]:
    telling = [d for d in diagrams if (d.cluster >= 0).any()] or list(diagrams)
    drawn: list[Block] = [
        Plot(plots.stabilisation(d, modes), f"{name}, {_span(d)}.") for d in telling
    ]
    out: list[Block] = [
        Columns([drawn[k : k + 1], drawn[k + 1 : k + 2]]) for k in range(0, len(drawn), 2)
    ]
    if len(telling) < len(diagrams):
        rest = ", ".join(_span(d) for d in diagrams if not (d.cluster >= 0).any())
        out.append(Text(f"Not drawn, without a mode: {rest}.", "note"))
    return out


def _span(d: StableDiagram) -> str:
    return "{} to {} Hz".format(*(number(f, 3) for f in plots.pole_span(d)))


def _modes(found: IdentifiedModes, caption: str) -> ReportTable:
    modes = found.modes
    std = found.uncertainty
    rows = []
    for k in range(len(modes)):
        why = found.reasons[k] if k < len(found.reasons) else ""
        confidence = float(modes.confidence[k])
        sf = float(std.frequency[k])
        sz = float(std.damping[k])
        rows.append(
            (
                str(k + 1),
                fixed(modes.frequencies[k], 3),
                number(sf, 2),
                fixed(100 * modes.damping[k], 2),
                number(100 * sz, 2),
                Cell(fixed(100 * confidence, 0), "warn" if confidence < 0.5 else "", why),
            )
        )
    return ReportTable(("#", "f, Hz", "σ, Hz", "ζ, %", "σ, %", "Confidence, %"), rows, caption)


def _by_record(data: Stages) -> Block:
    assert data.identify is not None
    rows = [
        (
            r.record,
            str(len(r.modes)),
            "  ".join(fixed(f, 2) for f in r.modes.frequencies) or "–",
        )
        for r in data.identify.ambient_records
    ]
    table = ReportTable(
        ("|Record", "Modes", "|Frequencies, Hz"),
        rows,
        "Modes by excitation record, before merging.",
    )
    return table if rows else Text("")
