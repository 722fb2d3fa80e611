"""What a deck leaves open: default values, damping and orientations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from ringtrue.core.arrays import Bool
from ringtrue.decks.nastran.cards import Cards
from ringtrue.decks.nastran.case import modal_damping_set
from ringtrue.decks.nastran.lexer import Card, Reader, is_real
from ringtrue.errors import DeckError
from ringtrue.model.case_control import ModalDamping
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Ragged, Table, card_error, stacked

DEFAULTS: Mapping[str, str] = MappingProxyType(
    {"GRDSET": "GRID", "BAROR": "CBAR", "BEAMOR": "CBEAM"}
)
_PLAIN = {  # places of the data fields, from 0
    "GRID": {"CP": 1, "CD": 5, "PS": 6},
    "CBAR": {"PID": 1, "OFFT": 7},
    "CBEAM": {"PID": 1, "OFFT": 7},
}
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
        for name, at in _PLAIN[card].items():
            if r.text(at):
                value: int | str = r.text(at) if name in ("PS", "OFFT") else r.whole(at, name)
                blank = _blank(found, card, at)
                table = table.with_column(name, np.where(blank, value, table[name]))
        if card != "GRID":
            table = _oriented(table, r, found)
    if card == "GRID":
        table = table.with_column("PS", np.where(table["PS"] == "0", "", table["PS"]))
    return {card: table}


def _oriented(table: Table, r: Reader, found: Cards) -> Table:
    """An orientation is taken field by field, a node G0 only where all three are blank."""
    blank = {name: _blank(found, table.card, at) for name, at in _VECTOR.items()}
    text = r.text(4)
    if text and not is_real(np.array([text.encode("latin-1")]))[0]:
        none = np.all(list(blank.values()), axis=0)
        return table.with_column("G0", np.where(none, r.whole(4, "G0"), table["G0"]))
    for name, at in _VECTOR.items():
        if r.text(at):
            mine = blank[name] & (table["G0"] == 0)
            table = table.with_column(name, np.where(mine, r.real(at, name), table[name]))
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
    named = [tables[card] for card in _SCALAR if card in tables]
    if not named:
        return {}
    every = np.concatenate([t[name] for t in named for name in ("S1", "S2")])
    file, line = (
        np.concatenate([getattr(t, name) for t in named for _ in range(2)])
        for name in ("file", "line")
    )
    points, at = np.unique(every, return_index=True)
    new = points > 0
    if "GRID" in tables:
        new &= ~np.isin(points, tables["GRID"].ids)
    old = tables.get("SPOINT")
    if old:
        new &= ~np.isin(points, old.ragged("ID").values)
    if not new.any():
        return {}
    at = at[new]
    ids = Ragged(points[new], np.arange(at.size + 1))
    implied = Table("SPOINT", {"ID": ids}, file[at], line[at])
    return {"SPOINT": stacked(old, implied) if old else implied}


_RATIO = {"": 0.5, "G": 0.5, "CRIT": 1.0, "Q": 0.5}  # of a value, of Q of its inverse


def modal_damping(found: Cards, *, structural: bool = False) -> ModalDamping | None:
    """The table that SDAMPING names; None where case control has none.

    Raises
    ------
    DeckError
        If the table is not in the deck, or its frequencies fall.
    """
    number = modal_damping_set(found.deck.top)
    if not number:
        return None
    for r in (Reader(c, found.deck.files) for c in written_out(found, "TABDMP1")):
        if r.whole(0, "TID") == number:
            return _table(r, structural)
    raise DeckError(
        f"case control has SDAMPING = {number}: the deck has no such TABDMP1",
        path=found.deck.files[0],
    )


def _table(r: Reader, structural: bool) -> ModalDamping:
    """TABDMP1: TID TYPE FLAT, then f1 g1 f2 g2 ... ENDT; a pair with SKIP does not count."""
    kind = r.text(1).upper()
    if kind not in _RATIO:
        raise r.fail("TYPE", f"{kind!r}: allowed are G, CRIT and Q")
    pairs = []
    for i in range(8, len(r.card.fields), 2):
        texts = {r.text(i).upper(), r.text(i + 1).upper()}
        if "ENDT" in texts:
            break
        if "SKIP" not in texts and texts != {""}:
            pairs.append((r.real(i, "f"), r.real(i + 1, "g")))
    f, g = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    if not f.size or (np.diff(f) < 0).any():
        raise r.fail("f", "frequencies must be given, and rise")
    if kind == "Q" and (g <= 0).any():
        raise r.fail("g", "Q must be above 0")
    return ModalDamping(
        f, _RATIO[kind] * (1 / g if kind == "Q" else g), r.text(2) == "1", structural
    )


_ACROSS = (
    ("K2", "K3"),
    ("K5", "K6"),
    ("B2", "B3"),
    ("B5", "B6"),
)  # equal, the axes across the line do not matter


def open_bushes(model: Model) -> Iterator[DeckError]:
    """The first CBUSH of some length without orientation and CID whose springs across it are not
    equal.
    """
    if not all(card in model for card in ("CBUSH", "PBUSH", "GRID")):
        return
    table = model["CBUSH"]
    p = model["PBUSH"]
    grid = model["GRID"]
    unlike = np.any([p[a] != p[b] for a, b in _ACROSS], axis=0)
    row = p.find(table["PID"])
    a = grid.find(table["GA"])
    b = grid.find(table["GB"])
    bare = (table["G0"] == 0) & (table["CID"] < 0) & ~table.stack("X1", "X2", "X3").any(axis=1)
    at = np.flatnonzero(bare & (row >= 0) & (a >= 0) & (b >= 0))
    at = at[unlike[row[at]]]
    if at.size:
        xyz = positions(model)
        at = at[(xyz[a[at]] != xyz[b[at]]).any(axis=1)]
    if at.size:
        more = f" ({at.size - 1} more like it)" if at.size > 1 else ""
        why = (
            "its springs across the line of its ends are not equal, and no CID, G0 or X1-X3 "
            f"orients them{more}"
        )
        yield card_error(model, table, int(at[0]), why)
