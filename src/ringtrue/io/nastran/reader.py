"""A Nastran deck to a `Model`: case control, parameters and one table a card."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.io.nastran.expand import EXPAND
from ringtrue.io.nastran.lexer import Card, Lexed, lex
from ringtrue.io.nastran.refs import check_references
from ringtrue.io.nastran.writer import parse_real
from ringtrue.model.cards import CARDS, columns
from ringtrue.model.model import CaseControl, Model, Ragged, Table

# cards that carry stiffness, mass or constraint and are not read: the deck would be wrong without them
_CARRYING = """
CQUAD8 CTRIA6 CQUAD CQUADR CTRIAR CSHEAR CBEND CGAP CWELD CFAST CSEAM CPYRAM CELAS3 CELAS4 CMASS1 CMASS2 CMASS3
CMASS4 CONM1 RBE1 RBAR RBAR1 RROD RTRPLT RSPLINE RSSCON GENEL DMIG CVISC CDAMP1 CDAMP2 CDAMP3 CDAMP4 PCOMP PCOMPG
PBARL PBEAML PBCOMP PBEAM3 CBEAM3 MAT2 MAT8 MAT9 MAT3 CTRIAX6 CTRIAX CQUADX CINTC SESET SEELT SECONCT RJOINT
CBUSH1D CBUSH2D
"""
CARRYING = frozenset(_CARRYING.split())
)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a deck holds, without refusing any of it.

    Attributes
    ----------
    model : Model
        Of the supported cards.
    cards : dict of str to int
        Every card and how many.
    unsupported : dict of str to str
        Cards that would stop `read_deck`, with the first place of each.
    """

    model: Model
    cards: dict[str, int]
    unsupported: dict[str, str]


def read_deck(path: str | Path) -> Model:
    """Read a deck with its includes.

    Raises
    ------
    DeckError
        On anything malformed or missing, with file, line, card and field.
    UnsupportedCard
        On a card that carries stiffness, mass or constraint and is not supported.
    """
    lexed = lex(Path(path))
    for card in lexed.cards:
        if card.name in CARRYING:
            raise UnsupportedCard(card.name, path=lexed.files[card.file], line=card.line)
    model = _model(lexed)
    check_references(model)
    return model


def survey(path: str | Path) -> Survey:
    """Read what can be read and list the rest.

    Raises
    ------
    DeckError
        On anything malformed or missing.
    """
    lexed = lex(Path(path))
    number: dict[str, int] = {}
    lost: dict[str, str] = {}
    for card in lexed.cards:
        number[card.name] = number.get(card.name, 0) + 1
        if card.name in CARRYING:
            lost.setdefault(card.name, f"{lexed.files[card.file]}:{card.line}")
    model = _model(replace_cards(lexed, [c for c in lexed.cards if c.name not in CARRYING]))
    if not lost:
        check_references(model)
    return Survey(model, number, lost)


def replace_cards(lexed: Lexed, cards: list[Card]) -> Lexed:
    """The same deck with other cards."""
    return Lexed(lexed.files, lexed.control, cards)


def _model(lexed: Lexed) -> Model:
    groups: dict[str, list[Card]] = {}
    for card in lexed.cards:
        groups.setdefault(card.name, []).append(card)
    files = lexed.files
    params = dict(_param(c, files) for c in groups.pop("PARAM", []))
    defaults = groups.pop("GRDSET", [])
    tables = {}
    kept = {}
    for name, cards in groups.items():
        if name in EXPAND:
            tables[name] = EXPAND[name](cards, files)
        elif name in CARDS:
            tables[name] = make_table(name, cards, files)
        else:
            kept[name] = len(cards)
    if defaults and "GRID" in tables:
        tables["GRID"] = _grdset(tables["GRID"], defaults[0])
    for name, table in tables.items():
        if name not in _MANY:
            tables[name] = _unique(name, table, files)
    return Model(tables, params, _case(lexed), tuple(str(f) for f in files), kept)


_MANY = {"SPC", "SPC1", "MPC", "SPOINT", "SPCADD", "MPCADD"}  # several cards of one id belong together


def _param(card: Card, files: Sequence[Path]) -> tuple[str, int | float | str]:
    name, text = card.fields[0].upper(), card.fields[1]
    if not name:
        raise DeckError("a PARAM without a name", path=files[card.file], line=card.line, card="PARAM", field="N")
    if re.fullmatch(r"[+-]?\d+", text):
        return name, int(text)
    try:
        return name, parse_real(text)
    except ValueError:
        return name, text.upper()


def _case(lexed: Lexed) -> CaseControl:
    found: dict[str, str] = {}
    for _, _, text in lexed.control:
        line = text.split("$")[0]
        m = re.match(r"\s*(TITLE|METHOD|SPC|MPC)\s*(?:\([^)]*\))?\s*=\s*(.+?)\s*$", line, re.I)
        if m:
            found.setdefault(m[1].upper(), m[2])
    number = {k: int(v) for k, v in found.items() if v.isdigit()}
    return CaseControl(found.get("TITLE", ""), number.get("METHOD", 0), number.get("SPC", 0), number.get("MPC", 0))


def _grdset(grid: Table, card: Card) -> Table:
    f = [*card.fields, *[""] * 8]
    cp, cd, ps = int(f[1] or 0), int(f[5] or 0), f[6]
    grid = grid.with_column("CP", np.where(grid["CP"] == 0, cp, grid["CP"]))
    grid = grid.with_column("CD", np.where(grid["CD"] == 0, cd, grid["CD"]))
    return grid.with_column("PS", np.where(grid["PS"] == "", ps, grid["PS"])) if ps else grid


def _unique(name: str, table: Table, files: Sequence[Path]) -> Table:
    ids = table.ids
    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    if first.size == ids.size:
        return table
    again = np.flatnonzero(first[inverse] != np.arange(ids.size))
    if name == "GRID":
        x = table.stack("X1", "X2", "X3")
        again = again[(x[again] != x[first[inverse[again]]]).any(axis=1)]
    if again.size:
        i = int(again[0])
        raise DeckError(
            f"{int(ids[i])} stands twice, first at line {int(table.line[first[inverse[i]]])}",
            path=files[int(table.file[i])],
            line=int(table.line[i]),
            card=name,
        )
    keep = np.sort(first)
    cols: dict[str, Any] = {k: v[keep] for k, v in table.columns.items() if not isinstance(v, Ragged)}
    return replace(table, columns=cols, file=table.file[keep], line=table.line[keep])


def make_table(name: str, cards: Sequence[Card], files: Sequence[Path]) -> Table:
    """A table by the schema of its card."""
    spec = columns(name)
    cols: dict[str, NDArray[Any] | Ragged] = {}
    for j, f in enumerate(spec):
        if f.tail:
            cols[f.name] = _tail(f.name, f.kind, [c.fields[j:] for c in cards], cards, files)
            continue
        text = [c.fields[j] if j < len(c.fields) else "" for c in cards]
        if f.blank:
            continue
        if f.other:
            whole = [t if t and _is_int(t) else "" for t in text]
            cols[f.other] = _convert(whole, "i", 0, cards, files, f.other)
            text = ["" if w else t for w, t in zip(whole, text, strict=True)]
        cols[f.name] = _convert(text, f.kind, f.default, cards, files, f.name)
    if name == "SPOINT":
        every = cols["ID"]
        assert isinstance(every, Ragged)
        at = np.repeat(np.arange(len(cards)), np.diff(every.offsets))
        return Table(name, {"ID": every.values}, _files(cards)[at], _line(cards)[at])
    return Table(name, cols, _files(cards), _line(cards))


def _files(cards: Sequence[Card]) -> NDArray[np.int64]:
    return np.array([c.file for c in cards], dtype=np.int64)


def _line(cards: Sequence[Card]) -> NDArray[np.int64]:
    return np.array([c.line for c in cards], dtype=np.int64)


def _is_int(text: str) -> bool:
    return text.lstrip("+-").isdigit()


_READ: dict[str, Callable[[str], Any]] = {"i": int, "f": parse_real, "s": str}
_DTYPE = {"i": np.int64, "f": np.float64, "s": np.str_}


def _convert(
    text: list[str], kind: str, default: Any, cards: Sequence[Card], files: Sequence[Path], name: str
) -> NDArray[Any]:
    read = _READ[kind]
    try:
        return np.array([read(t) if t else default for t in text], dtype=_DTYPE[kind])
    except ValueError:
        return _blame(text, read, cards, files, name)


def _blame(
    text: list[str], read: Callable[[str], Any], cards: Sequence[Card], files: Sequence[Path], name: str
) -> NDArray[Any]:
    for t, c in zip(text, cards, strict=True):
        try:
            read(t) if t else None
        except ValueError:
            what = "an integer" if read is int else "a real"
            raise DeckError(
                f"{t!r} is not {what}", path=files[c.file], line=c.line, card=c.name, field=name
            ) from None
    raise DeckError(f"field {name} of {cards[0].name} cannot be read", path=files[0])


def _tail(name: str, kind: str, rows: list[list[str]], cards: Sequence[Card], files: Sequence[Path]) -> Ragged:
    values: list[Any] = []
    offsets = [0]
    for row, c in zip(rows, cards, strict=True):
        try:
            values += expand_thru(row) if kind == "i" else [r for r in row if r]
        except ValueError as e:
            raise DeckError(str(e), path=files[c.file], line=c.line, card=c.name, field=name) from None
        offsets.append(len(values))
    return Ragged(np.array(values, dtype=_DTYPE[kind]), np.array(offsets, dtype=np.int64))


def expand_thru(fields: Sequence[str]) -> list[int]:
    """Integers with `a THRU b [BY c]` expanded; an entry that is not an integer ends the list (ALPHA of RBE2).

    Raises
    ------
    ValueError
        On text that is neither.
    """
    words = [f for f in fields if f]
    out: list[int] = []
    i = 0
    while i < len(words):
        word = words[i].upper()
        if word == "THRU":
            step = int(words[i + 3]) if i + 3 < len(words) and words[i + 2].upper() == "BY" else 1
            out += range(out[-1] + step, int(words[i + 1]) + 1, step)
            i += 4 if step != 1 or (i + 2 < len(words) and words[i + 2].upper() == "BY") else 2
            continue
        if not _is_int(word):
            parse_real(word)
            break
        out.append(int(word))
        i += 1
    return out
