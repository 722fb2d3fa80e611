"""The system, its tests, the deck, the signals and the FRFs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.notes import Note
from ringtrue.core.notes import sentence as note_sentence
from ringtrue.core.testmodel import TestModel
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.plots import scene
from ringtrue.plots import signals as plots
from ringtrue.report.parts import (
    MISSING,
    Block,
    Cell,
    Columns,
    Fold,
    Heading,
    Items,
    Picture,
    Plot,
    ReportTable,
    Scene3D,
    Section,
    Stages,
    Tabs,
    Text,
    fixed,
    number,
    plain,
    sentence,
    signs,
)
from ringtrue.study.config_sections import InstrumentSection
from ringtrue.study.hammer_records import rejected_hits
from ringtrue.study.results import ModelStage, RecordSummary


def survey(data: Stages) -> Section | None:
    """The system in words and numbers, the tests in a table."""
    blocks: list[Block] = [
        Text(p.strip()) for p in data.info.system.split("\n\n") if p.strip()
    ]
    if data.model is not None:
        blocks.append(_system(data.model, data.computed))
    if data.identify is not None and data.identify.records:
        blocks += [Heading("Tests"), *_tests(data.identify.records)]
    if instruments := data.info.instrument:
        blocks.append(_instruments(instruments))
    blocks += [Picture(p) for p in data.photos]
    return Section("survey", "System and tests", blocks) if blocks else None


def _instruments(listed: Sequence[InstrumentSection]) -> ReportTable:
    heads = (
        "|Instrument",
        "|Serial number",
        "|Channels",
        "|Sensitivity",
        "|Calibrated",
    )
    rows: list[list[str | Cell]] = [
        [
            i.name,
            i.serial or MISSING,
            ", ".join(i.channels) or MISSING,
            i.sensitivity or MISSING,
            i.calibrated or Cell("not stated", "warn"),
        ]
        for i in listed
    ]
    return ReportTable(
        heads, rows, "The instruments of the tests and their calibration."
    )


def _system(model: ModelStage, computed: Float) -> ReportTable:
    length, (mass, unit) = UNIT_SYSTEMS[model.units].length, weight(model)
    x, y, z = (fixed(v * length, 2) for v in model.mass.cg)
    scale = mass / model.mass.mass if model.mass.mass else 1.0
    inertia = np.diag(model.mass.inertia) * length**2 * scale
    span = "0"
    if computed.size:
        span = f"{computed.size}, {number(computed[0], 3)} to {number(computed[-1], 4)}"
    rows = [
        *([("Model", model.title, "")] if model.title else []),
        ("Mass", number(mass, 4), unit),
        ("Centre of gravity x, y, z", f"{x}, {y}, {z}", "m"),
        (
            "Moments of inertia xx, yy, zz",
            ", ".join(number(v, 4) for v in inertia),
            f"{unit}·m²",
        ),
        (
            "Nodes; degrees of freedom",
            f"{model.nodes:,}; {model.dof:,}".replace(",", "\u202f"),
            "",
        ),
        ("Modes computed", span, "Hz"),
    ]
    return ReportTable(
        ("|Quantity", "|Value", "|Unit"), rows, "The system as modelled."
    )


def weight(model: ModelStage) -> tuple[float, str]:
    """The mass in t, or in kg below one."""
    kg = model.mass.mass * UNIT_SYSTEMS[model.units].kilograms
    return (kg / 1000, "t") if kg >= 1000 else (kg, "kg")


DRAWN = 4  # records of one test
HEADS = (
    "|Test",
    "|Record",
    "|Excitation",
    "Channels",
    "Rate, Hz",
    "Length, min",
    "Hits kept",
)
FEW = 3  # channels with the same note that have a line each


def _tests(records: tuple[RecordSummary, ...]) -> list[Block]:
    """All records; those of a roving test by setup, and one by one in a fold."""
    setups: dict[tuple[str, str], list[RecordSummary]] = {}
    for r in records:
        setups.setdefault((r.test, r.setup or r.name), []).append(r)
    roving = [[r] for mine in setups.values() if len(mine) > 1 for r in mine]
    out = _listed(list(setups.values()), "The records of the tests.")
    if roving:
        every = _listed(roving, "Records one by one.")
        out.append(Fold(f"The {len(roving)} records of the setups", every))
    return out


def _listed(parts: list[list[RecordSummary]], caption: str) -> list[Block]:
    """A row a part, one record or a setup of several, and below what is to be said of which: notes
    are long.
    """
    described: dict[str, list[str]] = {}
    for mine in parts:
        count = Counter(n for r in mine for n in (*grouped(r.channel_notes), *r.notes))
        for note in (n if k == 1 else f"{n} ({k} records)" for n, k in count.items()):
            described.setdefault(note, []).append(_name(mine))
    notes = [f"{'; '.join(names)}: {note}" for note, names in described.items()]
    table = ReportTable(HEADS, [_test_row(mine) for mine in parts], caption)
    table = table.without_blank("Hits")
    return [table, Items([signs(n) for n in notes])] if notes else [table]


def grouped(notes: Sequence[Note]) -> list[str]:
    """Sentences of notes on channels; what is said of more than `FEW` is said once and counted."""
    by_code: dict[str, list[Note]] = {}
    for note in notes:
        by_code.setdefault(note.code, []).append(note)
    out: list[str] = []
    for same in by_code.values():
        if len(same) <= FEW:
            out += map(note_sentence, same)
            continue
        first, *rest = same
        others = ", ".join(note.subject for note in rest)
        out.append(f"{note_sentence(first)} (also {len(rest)} more: {others})")
    return out


def _test_row(mine: list[RecordSummary]) -> tuple[str, ...]:
    first = mine[0]
    minutes = sum(r.duration for r in mine) / 60
    kept, hits = (sum(counts) for counts in zip(*(r.hits for r in mine), strict=True))
    return (
        first.test,
        _name(mine),
        first.excitation,
        str(first.channels),
        plain(first.rate),
        fixed(minutes, 1),
        f"{kept} of {hits}" if hits else "",
    )


def _name(mine: list[RecordSummary]) -> str:
    name = (
        mine[0].name
        if len(mine) == 1
        else f"setup {mine[0].setup}, {len(mine)} records"
    )
    return name.replace("-", "\u2011")


def model(data: Stages) -> Section | None:
    """Deck, 3D view with the sensors, modes."""
    if data.model is None:
        return None
    m = data.model
    test = data.test
    kinds = {}
    if data.plan is not None:
        kinds = scene.channel_kinds(
            data.plan.excitation.references, data.plan.sensors.ambient
        )
    blocks: list[Block] = [Scene3D(scene.model(m.scene, test, kinds), _caption(test))]
    counts = [(k, str(v)) for k, v in sorted(m.cards.items())]
    cards = ReportTable(("|Card", "Count"), counts, "Cards of the deck.", scroll=True)
    blocks.append(Columns([[_mode_table(data.computed, m.residuals)], [cards]]))
    files = ", ".join(Path(f).name for f in m.files)
    blocks.append(
        Text(f"Files: {files} (units {m.units}). {sentence(m.proof)}", "note")
    )
    if m.findings:
        findings = [_by_name(f, m.files) for f in m.findings]
        blocks.append(Items(findings, "Findings of the deck check"))
    title = (
        "Finite element model and sensors"
        if test is not None
        else "Finite element model"
    )
    return Section("model", title, blocks)


def _by_name(finding: str, files: Sequence[str]) -> str:
    """A finding with the name of its file in place of the whole path."""
    for f in files:
        finding = finding.replace(f"{f}:", f"{Path(f).name}:")
    return finding


def _caption(test: TestModel | None) -> str:
    text = "The model by part"
    if test is not None:
        text += f", with {len(test.channels)} channels at {test.points.size} points"
        text += "; arrows point in the positive reading"
    return text + ". Drag to turn, shift-drag to move, click and use the wheel to zoom."


def _mode_table(frequencies: Float, residuals: Float) -> ReportTable:
    described = [
        *(number(r, 2) for r in residuals),
        *["–"] * (frequencies.size - residuals.size),
    ]
    rows = [(str(i + 1), number(f, 4), described[i]) for i, f in enumerate(frequencies)]
    return ReportTable(
        ("#", "Frequency, Hz", "Residual"),
        rows,
        "Modes of the initial deck, relative residual norm.",
        scroll=True,
    )


def signal_section(data: Stages) -> Section | None:
    """Time previews and spectra of every record; of a roving test those of the first setup."""
    if data.identify is None or not data.identify.records:
        return None
    groups: dict[str, list[RecordSummary]] = {}
    for r in data.identify.records:
        groups.setdefault(r.test, []).append(r)
    tabs = [(name, _test(records)) for name, records in groups.items()]
    return Section("signals", "Signals", tabs[0][1] if len(tabs) == 1 else [Tabs(tabs)])


def _test(records: list[RecordSummary]) -> list[Block]:
    out: list[Block] = []
    previews = [r for r in records if r.preview is not None]
    drawn = _telling(previews)
    for r in drawn:
        if (p := r.preview) is not None:
            shown = len(p.channels)
            some = f", {shown} of {r.channels} channels" if shown < r.channels else ""
            text = f"{r.name}, {r.excitation}: time preview and power spectral density{some}."
            out.append(Plot(plots.record(p, p.unit.replace("^2", "²")), text))
    if left := [r.name for r in previews if r not in drawn]:
        out.append(Text(f"Not drawn: {', '.join(left)}.", "note"))
    setups = list(dict.fromkeys(r.setup for r in records))
    if len(setups) > 1:
        described = (
            f"Setup {setups[0]} of {', '.join(setups[:-1])} and {setups[-1]}; all of them are "
            "in the list of tests."
        )
        return [Text(described, "note"), *out]
    return out


def _telling(records: list[RecordSummary]) -> list[RecordSummary]:
    """The records to draw, in their order: the first of each excitation, and those with the most
    notes on channels.
    """
    first = {r.excitation: k for k, r in reversed(tuple(enumerate(records)))}
    opening = set(first.values())
    rank = sorted(
        range(len(records)),
        key=lambda k: (k not in opening, -len(records[k].channel_notes), k),
    )
    return [records[k] for k in sorted(rank[:DRAWN])]


def frf_section(data: Stages) -> Section | None:
    """All FRFs and the CMIF."""
    ident = data.identify
    if ident is None or ident.frfs is None:
        return None
    frfs = ident.frfs
    marks = ident.hammer.modes.frequencies if ident.hammer is not None else np.empty(0)
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
    if notes := [*grouped(ident.channel_notes), *ident.frf_notes]:
        blocks.append(Items([sentence(n) for n in notes], "Notes"))
    if ident.synthesis_error.size:
        middle = np.nanmedian(ident.synthesis_error)
        worst = np.nanmax(ident.synthesis_error)
        text = (
            "The FRFs synthesised from the identified modes differ from the measured ones by "
            f"{100 * middle:.1f} % in the median and {100 * worst:.1f} % at worst (relative norm "
            "over the band)."
        )
        blocks.append(Text(text))
    if hits := rejected_hits(ident.hits):
        blocks.append(
            Fold(f"Rejected hits ({len(hits)})", [Items([signs(h) for h in hits])])
        )
    return Section("frfs", "Frequency response functions", blocks)
