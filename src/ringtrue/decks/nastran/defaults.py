"""What cards leave blank and others say: GRDSET, BAROR, BEAMOR, and scalar points named by elements
only.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool
from ringtrue.decks.nastran.fields import Card, Reader
from ringtrue.decks.nastran.gather import Cards
from ringtrue.decks.nastran.lexer import is_real
from ringtrue.errors import DeckError
from ringtrue.model.model import Ragged, Table

DEFAULTS: Mapping[str, str] = MappingProxyType(
    {"GRDSET": "GRID", "BAROR": "CBAR", "BEAMOR": "CBEAM"}
)
_GRID = {"CP": 1, "CD": 5, "PS": 6}  # places of the data fields, from 0
_VECTOR = {"X1": 4, "X2": 5, "X3": 6}
_SCALAR = tuple(f"C{kind}{i}" for kind in ("ELAS", "MASS", "DAMP") for i in (3, 4))


def written_out(found: Cards, name: str) -> list[Card]:
    """All cards of one name as text, in reading order."""
    made = []
    for rows, cells in found.cells(name):
        file, line = found.places(rows)
        text = np.char.decode(cells, "latin-1").tolist()
        made += [
            (row, Card(name, fields, f, at))
            for row, fields, f, at in zip(
                rows.tolist(), text, file.tolist(), line.tolist(), strict=True
            )
        ]
    return [card for _, card in sorted(made, key=lambda m: m[0])]


def fill(default: str, tables: Mapping[str, Table], found: Cards) -> dict[str, Table]:
    """The table that a GRDSET, BAROR or BEAMOR speaks of, its blanks filled.

    Raises
    ------
    DeckError
        If there are two of them, or one is malformed.
    """
    card = DEFAULTS[default]
    if card not in tables:
        return {}
    made = written_out(found, default)
    if len(made) > 1:
        where = {"path": found.deck.files[made[1].file], "line": made[1].line, "card": default}
        raise DeckError("there are two of them; one is allowed", **where)  # type: ignore[arg-type]
    table = tables[card]
    if made:
        r = Reader(made[0], found.deck.files)
        table = _grid(table, r, found) if card == "GRID" else _bars(table, r, found)
    if card == "GRID":
        table = table.with_column("PS", np.where(table["PS"] == "0", "", table["PS"]))
    return {card: table}


def _grid(table: Table, r: Reader, found: Cards) -> Table:
    for name, at in _GRID.items():
        if r.text(at):
            value: int | str = r.text(at) if name == "PS" else r.whole(at, name)
            table = table.with_column(name, np.where(_blank(found, "GRID", at), value, table[name]))
    return table


def _bars(table: Table, r: Reader, found: Cards) -> Table:
    """PID, orientation and OFFT; an orientation is taken field by field, a node G0 only where all
    three are blank.
    """
    card = table.card
    if r.text(1):
        table = table.with_column(
            "PID", np.where(_blank(found, card, 1), r.whole(1, "PID"), table["PID"])
        )
    blank = {name: _blank(found, card, at) for name, at in _VECTOR.items()}
    text = r.text(4)
    if text and not is_real(np.array([text.encode("latin-1")]))[0]:
        none = np.all(list(blank.values()), axis=0)
        table = table.with_column("G0", np.where(none, r.whole(4, "G0"), table["G0"]))
    else:
        for name, at in _VECTOR.items():
            if r.text(at):
                mine = blank[name] & (table["G0"] == 0)
                table = table.with_column(name, np.where(mine, r.real(at, name), table[name]))
    if r.text(7):
        table = table.with_column(
            "OFFT", np.where(_blank(found, card, 7), r.text(7), table["OFFT"])
        )
    return table


def _blank(found: Cards, card: str, field: int) -> Bool:
    """Which cards leave a data field blank, in reading order, (n,)."""
    groups = [(rows, cells[:, field] == b"") for rows, cells in found.cells(card)]
    order = np.argsort(np.concatenate([rows for rows, _ in groups]), kind="stable")
    return np.asarray(np.concatenate([blank for _, blank in groups])[order])


def implied_points(tables: Mapping[str, Table]) -> dict[str, Table]:
    """SPOINT with a row for each scalar point that only a scalar element names; it needs no card of
    its own.
    """
    ids, file, line = (
        [np.empty(0, dtype=np.int64)],
        [np.empty(0, dtype=np.int64)],
        [np.empty(0, dtype=np.int64)],
    )
    for card in _SCALAR:
        if card in tables:
            t = tables[card]
            ids += [t["S1"], t["S2"]]
            file += [t.file, t.file]
            line += [t.line, t.line]
    every = np.concatenate(ids)
    named: list[NDArray[np.int64]] = [tables["GRID"].ids] if "GRID" in tables else []
    named += [tables["SPOINT"].ragged("ID").values] if "SPOINT" in tables else []
    points, at = np.unique(every, return_index=True)
    new = (points > 0) & ~np.isin(points, np.concatenate([*named, np.empty(0, dtype=np.int64)]))
    if not new.any():
        return {}
    points, at = points[new], at[new]
    old = tables.get("SPOINT")
    before = (
        old.ragged("ID")
        if old
        else Ragged(np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64))
    )
    offsets = np.concatenate([before.offsets, before.offsets[-1] + np.arange(1, points.size + 1)])
    where = [np.concatenate(x)[at] for x in (file, line)]
    if old:
        where = [np.concatenate([a, b]) for a, b in zip((old.file, old.line), where, strict=True)]
    return {
        "SPOINT": Table(
            "SPOINT", {"ID": Ragged(np.concatenate([before.values, points]), offsets)}, *where
        )
    }
