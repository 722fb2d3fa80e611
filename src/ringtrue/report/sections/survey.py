"""System survey and survey of the tests."""

from __future__ import annotations

from ringtrue.report.parts import Block, Heading, Section, Table, Text, fixed, number, plain
from ringtrue.report.stages import Stages
from ringtrue.study.results import ModelStage, RecordSummary


def section(data: Stages) -> Section | None:
    """The system in words and numbers, the tests in a table."""
    blocks: list[Block] = [Text(p.strip()) for p in data.system_text.split("\n\n") if p.strip()]
    if data.model is not None:
        blocks.append(_system(data.model))
    if data.identify is not None and data.identify.records:
        blocks += [Heading("Tests"), _tests(data.identify.records)]
    return Section("survey", "System and tests", blocks) if blocks else None


def _system(model: ModelStage) -> Table:
    x, y, z = (fixed(float(v), 2) for v in model.cg)
    rows = [
        ("Model", model.title or "–", ""),
        ("Mass", number(model.mass / 1000, 4), "t"),
        ("Centre of gravity x, y, z", f"{x}, {y}, {z}", "m"),
        ("Moments of inertia xx, yy, zz", _inertia(model), "t·m²"),
        ("Nodes; degrees of freedom", f"{model.nodes:,}; {model.dof:,}".replace(",", "\u202f"), ""),
        ("Modes computed", _span(model), "Hz"),
    ]
    return Table(("|Quantity", "|Value", "|Unit"), rows, "The system as modelled.")


def _inertia(model: ModelStage) -> str:
    return ", ".join(number(float(model.inertia[i, i]) / 1000, 4) for i in range(3))


def _span(model: ModelStage) -> str:
    f = model.modes.frequencies
    return f"{f.size}, {number(float(f[0]), 3)} to {number(float(f[-1]), 4)}" if f.size else "0"


def _tests(records: tuple[RecordSummary, ...]) -> Table:
    heads = ("|Test", "|Record", "|Excitation", "Channels", "Rate, Hz", "Length, min", "|Notes")
    rows = [
        (
            r.test,
            r.name,
            r.excitation,
            str(r.channels),
            plain(r.rate),
            fixed(r.duration / 60, 1),
            "; ".join(r.notes),
        )
        for r in records
    ]
    return Table(heads, rows, "The records of the tests.")
