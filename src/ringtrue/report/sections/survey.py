"""System survey and survey of the tests."""

from __future__ import annotations

from collections import Counter

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.report.parts import (
    Block,
    Fold,
    Heading,
    Items,
    Section,
    Table,
    Text,
    fixed,
    number,
    plain,
)
from ringtrue.report.stages import Stages
from ringtrue.study.results import ModelStage, RecordSummary


def section(data: Stages) -> Section | None:
    """The system in words and numbers, the tests in a table."""
    blocks: list[Block] = [Text(p.strip()) for p in data.system_text.split("\n\n") if p.strip()]
    if data.model is not None:
        blocks.append(_system(data.model, data.computed))
    if data.identify is not None and data.identify.records:
        blocks += [Heading("Tests"), *_tests(data.identify.records)]
    return Section("survey", "System and tests", blocks) if blocks else None


def _system(model: ModelStage, computed: Float) -> Table:
    length, (mass, unit) = UNIT_SYSTEMS[model.units].length, weight(model)
    x, y, z = (fixed(float(v) * length, 2) for v in model.cg)
    inertia = np.diag(model.inertia) * length**2 * (mass / model.mass if model.mass else 1.0)
    rows = [
        *([("Model", model.title, "")] if model.title else []),
        ("Mass", number(mass, 4), unit),
        ("Centre of gravity x, y, z", f"{x}, {y}, {z}", "m"),
        (
            "Moments of inertia xx, yy, zz",
            ", ".join(number(float(v), 4) for v in inertia),
            f"{unit}·m²",
        ),
        ("Nodes; degrees of freedom", f"{model.nodes:,}; {model.dof:,}".replace(",", "\u202f"), ""),
        ("Modes computed", _span(computed), "Hz"),
    ]
    return Table(("|Quantity", "|Value", "|Unit"), rows, "The system as modelled.")


def weight(model: ModelStage) -> tuple[float, str]:
    """The mass in t, or in kg below one."""
    kg = model.mass * UNIT_SYSTEMS[model.units].kilograms
    return (kg / 1000, "t") if kg >= 1000 else (kg, "kg")


def _span(f: Float) -> str:
    return f"{f.size}, {number(float(f[0]), 3)} to {number(float(f[-1]), 4)}" if f.size else "0"


HEADS = ("|Test", "|Record", "|Excitation", "Channels", "Rate, Hz", "Length, min")


def _tests(records: tuple[RecordSummary, ...]) -> list[Block]:
    """All records; those of a roving test by setup, and one by one in a fold."""
    setups: dict[tuple[str, str], list[RecordSummary]] = {}
    for r in records:
        setups.setdefault((r.test, r.setup or r.name), []).append(r)
    roving = [[r] for mine in setups.values() if len(mine) > 1 for r in mine]
    out = _listed(list(setups.values()), "The records of the tests.")
    if roving:
        out.append(
            Fold(f"The {len(roving)} records of the setups", _listed(roving, "Records one by one."))
        )
    return out


def _listed(parts: list[list[RecordSummary]], caption: str) -> list[Block]:
    """A row a part, one record or a setup of several, and below what is to be said of which: notes
    are long.
    """
    told: dict[str, list[str]] = {}
    for mine in parts:
        for note in _notes(mine):
            told.setdefault(note, []).append(_name(mine))
    notes = [f"{'; '.join(names)}: {note}" for note, names in told.items()]
    table = Table(HEADS, [_row(mine) for mine in parts], caption)
    return [table, Items(notes)] if notes else [table]


def _row(mine: list[RecordSummary]) -> tuple[str, ...]:
    first, minutes = mine[0], sum(r.duration for r in mine) / 60
    return (
        first.test,
        _name(mine),
        first.excitation,
        str(first.channels),
        plain(first.rate),
        fixed(minutes, 1),
    )


def _name(mine: list[RecordSummary]) -> str:
    name = mine[0].name if len(mine) == 1 else f"setup {mine[0].setup}, {len(mine)} records"
    return name.replace("-", "\u2011")


def _notes(mine: list[RecordSummary]) -> list[str]:
    notes = Counter(n for r in mine for n in r.notes)
    return [n if k == 1 else f"{n} ({k} records)" for n, k in notes.items()]
