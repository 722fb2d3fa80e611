"""Elements that stand twice in a deck, under two numbers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.edges import CORNERS
from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Int
from ringtrue.fem.element_cards import SOLIDS
from ringtrue.model.model import Model

_CORNERS = CORNERS | {card: solid.corners for card, solid in SOLIDS.items()}
_NODES = {card: tuple(f"G{i + 1}" for i in range(count)) for card, count in _CORNERS.items()} | {
    "CROD": ("G1", "G2"),
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
}
_OFFSETS = (
    "ZOFFS",
    "W1A",
    "W2A",
    "W3A",
    "W1B",
    "W2B",
    "W3B",
)  # skins and stiffeners may share nodes at offsets


def double_findings(model: Model) -> Iterator[Finding]:
    """Elements with the nodes, property and offsets of another of their card."""
    for card in (c for c in _NODES if c in model):
        if (rows := _again(model, card)).size:
            what = "it has the nodes, the property and the offsets of another element; both count"
            yield at_rows(model, card, rows, "warning", what)


def _again(model: Model, card: str) -> Int:
    table = model[card]
    nodes = np.sort(table.stack(*_NODES[card]), axis=1)
    offsets = [np.nan_to_num(table[name]) for name in _OFFSETS if name in table.columns]
    key = np.column_stack([table["PID"], nodes, *offsets])
    first = np.unique(key, axis=0, return_index=True)[1]
    return np.setdiff1d(np.arange(len(table)), first)
