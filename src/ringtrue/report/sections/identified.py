"""Identification: the modes found, their diagram and what else is in the spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.display import with_error
from ringtrue.core.notes import sentence as note_sentence
from ringtrue.identification.common.diagram import (
    IdentificationDiagram,
    SpectrumAccount,
)
from ringtrue.plots import diagram as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fold,
    Items,
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
from ringtrue.study.results import IdentifiedModes, IdentifyStage

TONES = {"natural": "", "doubtful": "warn", "harmonic": "chip"}  # of cells, by class
DRAWN = 1500  # poles of one kind in a diagram: a report has several
PEAKS = 15  # unexplained peaks in a table


def section(data: Stages) -> Section | None:
    """The modes of each test, of all classes."""
    ident = data.identify
    if ident is None:
        return None
    blocks = [
        b for caption, found in _tests(ident) for b in _modes(found, caption, data)
    ]
    if ident.merge_notes:
        blocks.append(
            Items(
                [sentence(n) for n in ident.merge_notes],
                "Channels undone before merging",
            )
        )
    if len(ident.ambient_records) > 1:
        blocks.append(_by_record(data))
    if data.conditions is not None and data.conditions.notes:
        between = [sentence(note_sentence(n)) for n in data.conditions.notes]
        blocks.append(Items(between, "Days, temperatures and levels"))
    return Section("identification", "Identified modes", blocks)


def _tests(ident: IdentifyStage) -> list[tuple[str, IdentifiedModes]]:
    """What was found in each test, with its caption."""
    tests: list[tuple[str, IdentifiedModes]] = []
    if len(ident.ambient) or len(ident.ambient.others):
        merged = ", merged over the records" if len(ident.ambient_records) > 1 else ""
        tests.append((f"Ambient modes{merged}", ident.ambient))
    if ident.hammer is not None:
        tests.append((f"Modes of the {ident.source}", ident.hammer))
    return tests


def diagrams(data: Stages) -> Section | None:
    """The diagram of each record, what its spectrum holds besides modes, and the MAC among them."""
    ident = data.identify
    if ident is None:
        return None
    records: list[tuple[str, IdentifiedModes]] = [
        (r.record, r) for r in ident.ambient_records
    ]
    if ident.hammer is not None:
        records.append((ident.source.removesuffix(" test"), ident.hammer))
    tabs = [(name, _diagram(name, found)) for name, found in records if found.diagrams]
    blocks: list[Block] = []
    if tabs:
        blocks += tabs[0][1] if len(tabs) == 1 else [Tabs(tabs)]
    drawn: list[list[Block]] = [
        [Plot(plots.auto_mac(found.diagram), f"{caption}: the MAC among them.")]
        for caption, found in _tests(ident)
        if len(found) + len(found.others) > 1 and not found.modes.frequency_only
    ]
    if drawn:
        blocks.append(Columns(drawn) if len(drawn) > 1 else drawn[0][0])
    return Section("diagrams", "Stabilisation diagrams", blocks) if blocks else None


def _diagram(name: str, found: IdentifiedModes) -> list[Block]:
    """The whole band in one view, and what is neither a pole nor a mode."""
    text = (
        f"{name}: poles by model order over singular values of the spectrum, and their damping. "
        "Filled marks: natural modes; open ones: doubtful modes and harmonics."
    )
    if not len(found) + len(found.others):
        return [Text(f"{name}: no mode found."), *_account(found.account)]
    figure = plots.identification_figure(found.diagram, most=DRAWN, height=600)
    return [Plot(figure, text), *_account(found.account)]


def _account(account: SpectrumAccount) -> list[Block]:
    """Machines, and the peaks that nothing explains."""
    rows: list[Sequence[str | Cell]] = []
    for m in account.machines:
        speed = f"{number(60 * m.frequency, 4)} rpm, wanders by {number(100 * m.wander, 2)} %"
        last = m.harmonics.max(initial=1)
        orders = f"{m.harmonics.size} harmonics up to the {last}th are taken out"
        rows.append((number(m.frequency, 5), "machine", f"{speed}; {orders}"))
    rows += [(number(h.frequency, 5), "line", h.why) for h in account.harmonics]
    out: list[Block] = []
    if rows:
        heads = ("Frequency, Hz", "|What", "|Remark")
        out.append(ReportTable(heads, rows, "Machines in the record."))
    peaks = sorted(account.unexplained, key=lambda p: -p.prominence)
    if peaks:
        cells = [
            (number(p.frequency, 5), number(p.prominence, 2), str(p.value))
            for p in peaks[:PEAKS]
        ]
        lower = len(peaks) - len(cells)
        rest = f"; {lower} lower ones are not listed" if lower else ""
        caption = (
            f"Peaks of the spectrum that nothing explains, the highest first{rest}."
        )
        table = ReportTable(
            ("Frequency, Hz", "Height, dB", "Singular value"),
            cells,
            caption,
            scroll=True,
        )
        out.append(Fold(f"Unexplained peaks ({len(peaks)})", [table]))
    return out


def _modes(found: IdentifiedModes, caption: str, data: Stages) -> list[Block]:
    """A row a mode of any class, ascending in frequency, and why some are not natural.

    No frequency is known better than one test repeats another.
    """
    repeats = data.repeats
    shown = found.diagram
    unnamed = [""] * (len(found) - len(found.reasons))
    natural = iter(enumerate([*found.reasons, *unnamed], start=1))
    rows: list[Sequence[str | Cell]] = []
    for k, kind in enumerate(shown.classes):
        count, why = next(natural) if kind == "natural" else ("–", "")
        mark = Cell(f"{plots.GLYPHS[kind]} {kind}", TONES[kind])
        rows.append(
            (str(count), *_numbers(shown, k, why, repeats), mark, shown.remarks[k])
        )
    heads = (
        "#",
        "f, Hz",
        "σ, Hz",
        "ζ, %",
        "σ, %",
        "MPC",
        "Confidence, %",
        "|Class",
        "|Remark",
    )
    text = f"{caption}. {_scatter(found, repeats)}"
    table = ReportTable(heads, rows, text.strip())
    if not any(shown.remarks) and not len(found.others):
        table = replace(table, heads=heads[:-2], rows=[row[:-2] for row in rows])
    names = data.names
    words = [names.get(f, "") for f in shown.modes.frequencies.tolist()]
    if any(words):
        named = [
            [r[0], word, *r[1:]] for r, word in zip(table.rows, words, strict=True)
        ]
        table = replace(table, heads=["#", "|Mode", *table.heads[1:]], rows=named)
    for head in ("σ", "ζ", "MPC"):  # of a file of frequencies alone
        table = table.without_blank(head)
    out: list[Block] = [table]
    if notes := found.others.notes:
        both = zip(found.others.modes.frequencies.tolist(), notes, strict=True)
        reasons = [f"{number(f, 4)} Hz: {sentence(note_sentence(n))}" for f, n in both]
        out.append(Items(reasons, "Why these are not among the natural modes"))
    return out


def _scatter(found: IdentifiedModes, repeats: float) -> str:
    """What the standard deviations of the frequencies hold."""
    if np.isfinite(repeats):
        least = number(100 * repeats, 2)
        return (
            f"σ of a frequency is at least {least} %: so far the two tests repeat it."
        )
    if np.isfinite(found.uncertainty.frequency).any():
        return "σ is the scatter inside this test; another test, day or level may differ by more."
    return ""


def _numbers(
    shown: IdentificationDiagram, k: int, why: str, repeats: float
) -> list[str | Cell]:
    modes = shown.modes
    std = shown.uncertainty
    confidence = float(modes.confidence[k])
    frequency = float(modes.frequencies[k])
    return [
        *with_error(
            frequency, float(np.fmax(std.frequency[k], repeats * frequency)), 5
        ),
        *with_error(100 * float(modes.damping[k]), 100 * float(std.damping[k]), 3),
        fixed(None if modes.frequency_only else float(shown.mpc[k]), 2),
        Cell(fixed(100 * confidence, 0), "warn" if confidence < 0.5 else "", why),
    ]


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
