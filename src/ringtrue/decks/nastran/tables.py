"""One table a card from its columns of fields, and what a deck leaves open in it: default values,
damping and orientations. Numbers beyond doubles are refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Int, frozen
from ringtrue.decks.nastran.cards import Cards
from ringtrue.decks.nastran.case import modal_damping_set
from ringtrue.decks.nastran.lexer import Card, Reader, integers, is_real, reals
from ringtrue.errors import DeckError
from ringtrue.model.cards import FieldSpec, columns
from ringtrue.model.case_control import METHODS, ModalDamping
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Ragged, Table, card_error, stacked

Cells = NDArray[np.bytes_]
_KINDS = {"i": "an integer", "f": "a real"}
_OWN_PROPERTY = {  # a blank PID is the element's own number
    "CROD",
    "CTUBE",
    "CBAR",
    "CBEAM",
    "CVISC",
    "CBUSH",
    "CTRIA3",
    "CQUAD4",
    "CTRIAR",
    "CQUADR",
    "CTRIA6",
    "CQUAD8",
    "CELAS1",
    "CELAS3",
    "CMASS1",
    "CMASS3",
    "CDAMP1",
    "CDAMP3",
    "CSHEAR",
    "CBUSH1D",
    "CGAP",
    "CBEND",
    "CFAST",
}
_SURPLUS = {
    "PSHELL": "; give THETA, ZOFFS and the like of Autodesk and OptiStruct on the elements"
}


def fault(cards: Cards, card: int, message: str, field: str = "") -> DeckError:
    """The error of a card, at its place."""
    path, line = cards.place(card)
    return DeckError(
        message, path=path, line=line, card=cards.name[card].decode(), field=field
    )


def make_table(cards: Cards, name: str, there: Int | None = None) -> Table:
    """All cards of one name by the schema of `model.cards`.

    Parameters
    ----------
    there : (n,) int64, optional
        What a `THRU` may name; the rest of its range is left out.

    Raises
    ------
    DeckError
        On a malformed number.
    """
    groups = list(cards.cells(name))
    every = np.concatenate([rows for rows, _ in groups])
    order = np.argsort(every, kind="stable")
    parts = [_parse(cards, name, rows, cells, there) for rows, cells in groups]
    made = {key: _joined([p[key] for p in parts], order) for key in parts[0]}
    file, line = cards.places(every[order])
    return Table(name, made, file, line)


def empty(name: str) -> Table:
    """A table without rows of a card that has no list."""
    kinds = {"i": np.int64, "f": np.float64, "s": np.str_, "c": np.str_}
    specs = [s for s in columns(name) if not s.blank]
    none = np.empty(0, dtype=np.int64)
    return Table(
        name, {s.name: np.empty(0, dtype=kinds[s.kind]) for s in specs}, none, none
    )


def _joined(
    parts: Sequence[NDArray[Any] | Ragged], order: Int
) -> NDArray[Any] | Ragged:
    plain = [p for p in parts if not isinstance(p, Ragged)]
    if plain:
        sorted_ = len(plain) == 1 and bool((order[1:] > order[:-1]).all())
        return frozen(plain[0] if sorted_ else np.concatenate(plain)[order])
    ragged = [p for p in parts if isinstance(p, Ragged)]
    values = np.concatenate([p.values for p in ragged])
    count = np.concatenate([p.sizes for p in ragged])
    start = np.cumsum(count) - count
    offsets = np.concatenate([[0], np.cumsum(count[order])])
    take = np.repeat(start[order] - offsets[:-1], count[order]) + np.arange(offsets[-1])
    return Ragged(frozen(values[take]), frozen(offsets))


def _parse(
    cards: Cards, name: str, rows: Int, cells: Cells, there: Int | None
) -> dict[str, NDArray[Any] | Ragged]:
    specs = columns(name)
    _refuse_surplus(cards, specs, rows, cells)
    made: dict[str, NDArray[Any] | Ragged] = {}
    for j, spec in enumerate(specs):
        if spec.blank:
            continue
        if spec.tail:
            made[spec.name] = _tail(cards, spec, rows, cells[:, j:], there)
            continue
        cell = (
            cells[:, j] if j < cells.shape[1] else np.full(rows.size, b"", dtype="S1")
        )
        if spec.other:
            whole = ~is_real(cell) & (cell != b"")
            made[spec.other] = _column(
                cards,
                FieldSpec(spec.other, default=spec.other_default),
                rows,
                np.where(whole, cell, b""),
            )
            cell = np.where(whole, b"", cell)
        made[spec.name] = _column(cards, spec, rows, cell)
    if name in _OWN_PROPERTY:
        eid = integers(cells[:, 0])[0]
        made["PID"] = np.where(cells[:, 1] == b"", eid, np.asarray(made["PID"]))
    return made


def _refuse_surplus(
    cards: Cards, specs: Sequence[FieldSpec], rows: Int, cells: Cells
) -> None:
    """An element with more fields than it has is a card of another make: never cut it short in
    silence.
    """
    card = cards.name[rows[0]].decode()
    if (
        specs[-1].tail
        or cells.shape[1] <= len(specs)
        or not (specs[0].name == "EID" or card in _SURPLUS)
    ):
        return
    extra = (cells[:, len(specs) :] != b"").any(axis=1)
    if extra.any():
        what = f"more than {len(specs)} data fields{_SURPLUS.get(card, '')}"
        raise fault(cards, int(rows[extra.argmax()]), what)


def _column(cards: Cards, spec: FieldSpec, rows: Int, cell: Cells) -> NDArray[Any]:
    if spec.kind in "sc":
        if not (cell != b"").any():
            return np.full(rows.size, str(spec.default))
        return np.where(cell == b"", str(spec.default), np.char.decode(cell, "latin-1"))
    given = cell != b""
    full = bool(given.all())
    values, good = (integers if spec.kind == "i" else reals)(
        cell if full else cell[given]
    )
    if not good.all():
        at = np.flatnonzero(given)[~good][0]
        text = cell[at].decode("latin-1")
        raise fault(
            cards, int(rows[at]), f"{text!r} is not {_KINDS[spec.kind]}", spec.name
        )
    if full:
        return values
    out = np.full(rows.size, spec.default, dtype=values.dtype)
    out[given] = values
    return out


def _tail(
    cards: Cards, spec: FieldSpec, rows: Int, cells: Cells, there: Int | None
) -> Ragged:
    """Integers to the end of the card; `THRU` and `BY` expanded, a final real (ALPHA of RBE2) left
    out.
    """
    given: Bool = cells != b""
    words = cells == b"THRU"
    special = (words | is_real(cells.reshape(-1)).reshape(cells.shape)).any(axis=1)
    values, good = integers(cells[given & ~special[:, None]])
    owner = np.broadcast_to(np.arange(rows.size)[:, None], cells.shape)[
        given & ~special[:, None]
    ]
    if not good.all():
        at = int(np.flatnonzero(~good)[0])
        text = cells[given & ~special[:, None]][at].decode("latin-1")
        raise fault(
            cards, int(rows[owner[at]]), f"{text!r} is not an integer", spec.name
        )
    which = np.flatnonzero(special)
    lists = [np.empty(0, dtype=np.int64)]
    for i in which.tolist():
        file, line = cards.places(rows[i])
        fields = np.char.decode(cells[i], "latin-1").tolist()
        card = Card(cards.name[rows[i]].decode(), fields, int(file), int(line))
        found = Reader(card, cards.deck.files).integers(0, spec.name, there)
        lists.append(np.array(found, dtype=np.int64))
    values = np.concatenate([values, *lists])
    owner = np.concatenate([owner, np.repeat(which, [x.size for x in lists[1:]])])
    count = np.bincount(owner, minlength=rows.size)
    return Ragged(
        values[np.argsort(owner, kind="stable")],
        np.concatenate([[0], np.cumsum(count)]),
    )


# of any unit: the product of six fields stays below 1.8e308, the largest double; 1/LARGEST the
# smallest
LARGEST = 1e50
_ALLOWED = (
    "is beyond what can be computed with; allowed are 0 and "
    f"{1 / LARGEST:g} to {LARGEST:g} in size"
)
# allowable stresses, in which a large number stands for none; no matrix uses them
_LIMITS = {
    "MAT1": ("ST", "SC", "SS"),
    "MAT2": ("ST", "SC", "SS"),
    "MAT8": ("XT", "XC", "YT", "YC", "S"),
}


def refuse_magnitudes(tables: Iterable[Table], files: tuple[str, ...]) -> None:
    """Refuse reals above `LARGEST` or, but for 0, below its inverse.

    Raises
    ------
    DeckError
        With file, line, card and field.
    """
    for table in tables:
        if table.card in METHODS:  # a large limit of the band stands for none
            continue
        for spec in columns(table.card):
            allowable = spec.name in _LIMITS.get(table.card, ())
            if spec.kind != "f" or spec.name not in table.columns or allowable:
                continue
            values, owner = table.entries(spec.name)
            size = np.abs(values)
            wild = np.flatnonzero(
                (size > LARGEST) | ((size < 1 / LARGEST) & (size > 0))
            )
            if not wild.size:
                continue
            row = int(owner[wild[0]])
            raise DeckError(
                f"{values[wild[0]]:g} {_ALLOWED}",
                path=files[table.file[row]],
                line=int(table.line[row]),
                card=f"{table.card} {table.ids[row]}",
                field=spec.name,
            )


def refuse_parameter(name: str, value: object, path: str, line: int) -> None:
    """Refuse a real PARAM beyond `LARGEST`, as `refuse_magnitudes` does."""
    if isinstance(value, float) and value and not 1 / LARGEST <= abs(value) <= LARGEST:
        raise DeckError(
            f"{value:g} {_ALLOWED}",
            path=path,
            line=line,
            card=f"PARAM {name}",
        )


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
        where = {
            "path": found.deck.files[made[1].file],
            "line": made[1].line,
            "card": default,
        }
        raise DeckError("there are two of them; one is allowed", **where)  # type: ignore[arg-type]
    table = tables[card]
    if made:
        r = Reader(made[0], found.deck.files)
        for name, at in _PLAIN[card].items():
            if r.text(at):
                value: int | str = (
                    r.text(at) if name in ("PS", "OFFT") else r.whole(at, name)
                )
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
            table = table.with_column(
                name, np.where(mine, r.real(at, name), table[name])
            )
    return table


def _blank(found: Cards, card: str, field: int) -> Bool:
    """Which cards leave a data field blank, in reading order, (n,)."""
    groups = [(rows, cells[:, field] == b"") for rows, cells in found.cells(card)]
    order = np.argsort(np.concatenate([rows for rows, _ in groups]), kind="stable")
    return np.concatenate([blank for _, blank in groups])[order]


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
    bare = (
        (table["G0"] == 0)
        & (table["CID"] < 0)
        & ~table.stack("X1", "X2", "X3").any(axis=1)
    )
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
