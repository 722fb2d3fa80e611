"""The finite element model and the sensors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ringtrue.core.arrays import Float
from ringtrue.core.testmodel import TestModel
from ringtrue.plots import scene
from ringtrue.report.parts import (
    Block,
    Columns,
    Items,
    Scene3D,
    Section,
    Table,
    Text,
    number,
    sentence,
)
from ringtrue.report.stages import Stages


def section(data: Stages) -> Section | None:
    """Deck, 3D view with the sensors, modes."""
    if data.model is None:
        return None
    m, test = data.model, data.test
    kinds = (
        scene.channel_kinds(data.plan.references, data.plan.ambient)
        if data.plan is not None
        else {}
    )
    blocks: list[Block] = [Scene3D(scene.model(m.scene, test, kinds), _caption(test))]
    cards = Table(
        ("|Card", "Count"),
        [(k, str(v)) for k, v in sorted(m.cards.items())],
        "Cards of the deck.",
        scroll=True,
    )
    blocks.append(Columns([[_modes(data.computed, m.residuals)], [cards]]))
    blocks.append(
        Text(
            f"Files: {', '.join(Path(f).name for f in m.files)} (units {m.units}). "
            f"{sentence(m.proof)}",
            "note",
        )
    )
    if m.findings:
        blocks.append(
            Items([_by_name(f, m.files) for f in m.findings], "Findings of the deck check")
        )
    title = "Finite element model and sensors" if test is not None else "Finite element model"
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


def _modes(frequencies: Float, residuals: Float) -> Table:
    told = [
        *(number(r, 2) for r in residuals.tolist()),
        *["–"] * (frequencies.size - residuals.size),
    ]
    rows = [(str(i + 1), number(f, 4), told[i]) for i, f in enumerate(frequencies.tolist())]
    return Table(
        ("#", "Frequency, Hz", "Residual"),
        rows,
        "Modes of the initial deck, relative residual norm.",
        scroll=True,
    )
