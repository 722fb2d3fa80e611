"""Bushes whose axes the deck leaves open."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.errors import DeckError
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, card_error

_ACROSS = (
    ("K2", "K3"),
    ("K5", "K6"),
    ("B2", "B3"),
    ("B5", "B6"),
)  # alike, the axes across the line do not matter


def open_bushes(model: Model) -> Iterator[DeckError]:
    """The first CBUSH of some length without orientation and CID whose springs across it are not
    alike.
    """
    if not all(card in model for card in ("CBUSH", "PBUSH", "GRID")):
        return
    table, p, grid = model["CBUSH"], model["PBUSH"], model["GRID"]
    unlike = np.any([p[a] != p[b] for a, b in _ACROSS], axis=0)
    row, a, b = p.find(table["PID"]), grid.find(table["GA"]), grid.find(table["GB"])
    bare = (table["G0"] == 0) & (table["CID"] < 0) & ~table.stack("X1", "X2", "X3").any(axis=1)
    at = np.flatnonzero(bare & (row >= 0) & (a >= 0) & (b >= 0))
    at = at[unlike[row[at]]]
    if at.size:
        xyz = positions(model)
        at = at[(xyz[a[at]] != xyz[b[at]]).any(axis=1)]
    if at.size:
        more = f" ({at.size - 1} more like it)" if at.size > 1 else ""
        why = (
            "its springs across the line of its ends are not alike, and no CID, G0 or X1-X3 "
            f"orients them{more}"
        )
        yield card_error(model, table, int(at[0]), why)
