"""Cards that are lists: the plies of PCOMP and PCOMPG, the nodes of RBE1 and RSPLINE, the terms of
DMIG and GENEL, non-structural mass (NSM, NSML: pairs of an id and a value; NSM1, NSML1: a value and
ids).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Int
from ringtrue.decks.nastran.lexer import Card, Files, Reader, integers, places, ragged, reals
from ringtrue.errors import UnsupportedCard
from ringtrue.model.model import Ragged, Table

_LAMINATE: tuple[tuple[str, float | str], ...] = (
    ("Z0", np.nan),
    ("NSM", 0.0),
    ("SB", 0.0),
    ("FT", ""),
    ("TREF", 0.0),
    ("GE", 0.0),
    ("LAM", ""),
)
BUSH = {  # lines of a PBUSH
    **{flag: [f"{flag}{i}" for i in range(1, 7)] for flag in "KB"},
    "GE": ["GE", *(f"GE{i}" for i in range(2, 7))],
    "M": ["M"],
}
PLY = {"PCOMP": ("MID", "T", "THETA", "SOUT"), "PCOMPG": ("GPLYID", "MID", "T", "THETA", "SOUT")}
_KIND: dict[str, Any] = {
    "GPLYID": np.int64,
    "MID": np.int64,
    "T": np.float64,
    "THETA": np.float64,
    "SOUT": np.str_,
}
_PITCH = {"PCOMP": 4, "PCOMPG": 8}  # fields from ply to ply
_FIRST = 8


def ply_places(name: str, fields: Sequence[str]) -> list[int]:
    """Where on a PCOMP or PCOMPG the fields of each ply begin; a ply is there if one of its fields
    is.
    """
    size = len(PLY[name])
    return [i for i in range(_FIRST, len(fields), _PITCH[name]) if any(fields[i : i + size])]


def _plies(r: Reader) -> dict[str, list[Any]]:
    name = r.card.name
    out: dict[str, list[Any]] = {key: [] for key in PLY[name]}
    for number, at in enumerate(ply_places(name, r.card.fields), 1):
        where = {key: at + k for k, key in enumerate(PLY[name])}
        for key in PLY[name]:
            if key in ("GPLYID", "MID"):
                before = out[key][-1] if number > 1 and key == "MID" else None
                out[key].append(r.whole(where[key], f"{key}{number}", before))
            elif key == "SOUT":
                out[key].append(r.text(where[key]) or "NO")
            else:
                before = 0.0 if key == "THETA" else out["T"][-1] if number > 1 else None
                out[key].append(r.real(where[key], f"{key}{number}", before))
    if not out["MID"]:
        raise r.fail("MID1", "the laminate has no ply")
    return out


def _laminate(name: str, cards: Sequence[Card], files: Files) -> Table:
    head: dict[str, list[Any]] = {"PID": [], **{key: [] for key, _ in _LAMINATE}}
    plies: dict[str, list[list[Any]]] = {key: [] for key in PLY[name]}
    for c in cards:
        r = Reader(c, files)
        head["PID"].append(r.whole(0, "PID"))
        for i, (key, default) in enumerate(_LAMINATE, 1):
            head[key].append(r.text(i) if isinstance(default, str) else r.real(i, key, default))
        for key, values in _plies(r).items():
            plies[key].append(values)
    cols: dict[str, NDArray[Any] | Ragged] = {key: np.array(values) for key, values in head.items()}
    cols |= {key: ragged(values, _KIND[key]) for key, values in plies.items()}
    return Table(name, cols, *places(cards))


def pcomp(cards: Sequence[Card], files: Files) -> Table:
    """PCOMP: a row a laminate, an entry of the ragged columns a ply; a blank MID or T is that of
    the ply before.
    """
    return _laminate("PCOMP", cards, files)


def pcompg(cards: Sequence[Card], files: Files) -> Table:
    """PCOMPG: as PCOMP, with the global number of each ply."""
    return _laminate("PCOMPG", cards, files)


def rbe1(cards: Sequence[Card], files: Files) -> Table:
    """RBE1: its independent pairs (GN, CN) and, behind UM, its dependent ones (GM, CM)."""
    eid: list[int] = []
    pairs: dict[str, list[list[Any]]] = {key: [] for key in ("GN", "CN", "GM", "CM")}
    for c in cards:
        r = Reader(c, files)
        eid.append(r.whole(0, "EID"))
        marks = [i for i in range(8, len(c.fields), 8) if r.text(i).upper() == "UM"]
        if not marks:
            raise r.fail(
                "UM",
                "the dependent DOFs are missing: write UM in field 2 of a continuation before them",
            )
        for (g, comp), first, last in (
            (("GN", "CN"), 0, marks[0]),
            (("GM", "CM"), marks[0], len(c.fields)),
        ):
            # three pairs on a line of eight fields, behind its first
            at = [
                i
                for k in range(first, last, 8)
                for i in (k + 1, k + 3, k + 5)
                if r.text(i) and r.text(i + 1)
            ]
            pairs[g].append([r.whole(i, g) for i in at])
            pairs[comp].append([r.text(i + 1) for i in at])
            if not at:
                raise r.fail(g, "no node with components")
    cols: dict[str, NDArray[Any] | Ragged] = {"EID": np.array(eid, dtype=np.int64)}
    cols |= {
        key: ragged(values, np.int64 if key[0] == "G" else np.str_) for key, values in pairs.items()
    }
    return Table("RBE1", cols, *places(cards))


def rspline(cards: Sequence[Card], files: Files) -> Table:
    """RSPLINE: its nodes in order, each with its dependent components; the first and the last have
    none.
    """
    cols: dict[str, NDArray[Any] | Ragged] = {}
    readers = [Reader(c, files) for c in cards]
    cols["EID"] = np.array([r.whole(0, "EID") for r in readers], dtype=np.int64)
    cols["DL"] = np.array([r.real(1, "D/L", 0.1) for r in readers])
    places_ = [[2, *(i for i in range(3, len(r.card.fields), 2) if r.text(i))] for r in readers]
    for r, at in zip(readers, places_, strict=True):
        if len(at) < 2:
            raise r.fail("G", "a spline has two nodes or more")
        if any(r.text(i) for i in range(at[-1] + 1, len(r.card.fields))):
            raise r.fail("G", "the last node is independent: no components stand behind it")
    g = [[r.whole(i, "G") for i in at] for r, at in zip(readers, places_, strict=True)]
    c = [["", *(r.text(i + 1) for i in at[1:])] for r, at in zip(readers, places_, strict=True)]
    return Table(
        "RSPLINE", cols | {"G": ragged(g, np.int64), "C": ragged(c, np.str_)}, *places(cards)
    )


_BLOCKS = {"": 2, "UD": 2, "K": 1, "Z": 1, "S": 1}  # what opens a line, and where its entries begin


def _genel_blocks(r: Reader) -> dict[str, range]:
    """Fields of each block of a GENEL, that of UI under ""."""
    texts = [(i, r.text(i).upper()) for i in range(8, len(r.card.fields), 8)]
    marks = [(i, text) for i, text in texts if text and text in _BLOCKS]
    found = [name for _, name in marks]
    if len(set(found)) < len(found) or found.count("K") + found.count("Z") != 1:
        raise r.fail("K", "one block K or Z is needed, and each block once")
    ends = [*(i for i, _ in marks[1:]), len(r.card.fields)]
    blocks = {
        name: range(i + _BLOCKS[name], end) for (i, name), end in zip(marks, ends, strict=True)
    }
    return {"": range(2, marks[0][0]), **blocks}


def _genel_reals(r: Reader, name: str, at: range, count: int) -> list[float]:
    """The reals of a block, a blank for 0 among them."""
    given = [r.real(i, name, 0.0) for i in at]
    if any(given[count:]) or len(given) + 7 < count:
        raise r.fail(name, f"{sum(bool(r.text(i)) for i in at)} numbers, {count} are needed")
    return (given + [0.0] * 7)[:count]


def genel(cards: Sequence[Card], files: Files) -> Table:
    """GENEL: pairs (UI, CI) and (UD, CD), the lower triangle of K or Z by columns, and S by
    rows.
    """
    head: dict[str, list[Any]] = {"EID": [], "FORM": []}
    lists: dict[str, list[list[Any]]] = {key: [] for key in ("UI", "CI", "UD", "CD", "KZ", "S")}
    for c in cards:
        r = Reader(c, files)
        blocks = _genel_blocks(r)
        head["EID"].append(r.whole(0, "EID"))
        head["FORM"].append("Z" if "Z" in blocks else "K")
        for kind, block in (("I", ""), ("D", "UD")):
            at = [i for i in blocks.get(block, range(0))[::2] if r.text(i)]
            lists[f"U{kind}"].append([r.whole(i, f"U{kind}") for i in at])
            lists[f"C{kind}"].append([r.whole(i + 1, f"C{kind}", 0) for i in at])
        n = len(lists["UI"][-1])
        d = len(lists["UD"][-1])
        if not n:
            raise r.fail("UI", "no component")
        form = head["FORM"][-1]
        lists["KZ"].append(_genel_reals(r, form, blocks[form], n * (n + 1) // 2))
        lists["S"].append(_genel_reals(r, "S", blocks["S"], n * d) if "S" in blocks else [])
    cols: dict[str, NDArray[Any] | Ragged] = {key: np.array(values) for key, values in head.items()}
    cols |= {
        key: ragged(v, np.float64 if key in ("KZ", "S") else np.int64) for key, v in lists.items()
    }
    return Table("GENEL", cols, *places(cards))


_HEAD = ("IFO", "TIN", "TOUT", "POLAR")
_TERM = ("GI", "CI", "A", "B")


def dmig(cards: Sequence[Card], files: Files) -> Table:
    """DMIG: a row a matrix, numbered in the order of their headers; an entry of the ragged columns
    a term.
    """
    heads = [c for c in cards if len(c.fields) > 1 and c.fields[1] == "0"]
    number: dict[str, int] = {}
    for i, c in enumerate(heads):
        number.setdefault(c.fields[0], i)
    if len(number) < len(heads):
        again = next(c for i, c in enumerate(heads) if number[c.fields[0]] != i)
        raise Reader(again, files).fail("NAME", f"{again.fields[0]} has two headers")
    columns = [c for c in cards if not (len(c.fields) > 1 and c.fields[1] == "0")]
    for c in columns:
        if not c.fields or c.fields[0] not in number:
            raise Reader(c, files).fail(
                "NAME", f"{c.fields[0] if c.fields else ''!r} has no header (0 in field 3)"
            )
    readers = [Reader(c, files) for c in heads]
    cols: dict[str, NDArray[Any] | Ragged] = {"ID": np.arange(1, len(heads) + 1)}
    cols["NAME"] = np.array([c.fields[0] for c in heads], dtype=np.str_)
    for i, key in enumerate(_HEAD, 2):
        cols[key] = np.array([r.whole(i, key, 0) for r in readers], dtype=np.int64)
    cols["NCOL"] = np.array([r.whole(7, "NCOL", 0) for r in readers], dtype=np.int64)
    owner = np.array([number[c.fields[0]] for c in columns], dtype=np.int64)
    return Table("DMIG", cols | _terms(columns, owner, len(heads), files), *places(heads))


def _terms(
    cards: Sequence[Card], owner: Int, rows: int, files: Files
) -> dict[str, NDArray[Any] | Ragged]:
    """All terms of column cards at once: GJ, CJ of the card, GI, CI, A, B of the term."""
    starts = [range(4, len(c.fields), 4) for c in cards]
    at = [[i for i in s if c.fields[i]] for c, s in zip(cards, starts, strict=True)]
    count = np.array([len(a) for a in at], dtype=np.int64)
    of = np.repeat(np.arange(len(cards)), count)
    order = np.argsort(owner[of], kind="stable")
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner[of], minlength=rows))]).astype(
        np.int64
    )
    out: dict[str, NDArray[Any] | Ragged] = {}
    for k, key in enumerate(("GJ", "CJ")):
        values = _numbers(
            [c.fields[1 + k] if len(c.fields) > 1 + k else "" for c in cards], cards, key, files
        )
        out[key] = Ragged(values[of][order].astype(np.int64), offsets)
    for k, key in enumerate(_TERM):
        text = [
            c.fields[i + k] if i + k < len(c.fields) else ""
            for c, a in zip(cards, at, strict=True)
            for i in a
        ]
        values = _numbers(text, [cards[i] for i in of.tolist()], key, files)
        out[key] = Ragged(values[order], offsets)
    return out


def _numbers(text: Sequence[str], cards: Sequence[Card], key: str, files: Files) -> NDArray[Any]:
    """The fields `key` (n,) of the cards (n,); a blank is 0."""
    cells = np.array([t.encode("latin-1") for t in text] or [b""], dtype=np.bytes_)[: len(text)]
    cells = np.where(cells == b"", b"0", cells)
    real = key in ("A", "B")
    values, good = (reals if real else integers)(cells)
    if not good.all():
        i = int(np.flatnonzero(~good)[0])
        kind = "a real" if real else "an integer"
        raise Reader(cards[i], files).fail(key, f"{text[i]!r} is not {kind}")
    return values


PAIRS = ("NSM", "NSML")
LISTS = ("NSM1", "NSML1")
VALUE = {"NSM": 3, "NSML": 3, "NSM1": 2, "NSML1": 2}  # its place where a card has one


def pairs(cards: Sequence[Card], files: Files) -> Table:
    """NSM or NSML: a row a pair."""
    rows: list[tuple[int, str, int, float]] = []
    of = []
    for c in cards:
        r = _reader(c, files)
        head = r.whole(0, "SID"), r.text(1)
        for i in range(2, len(c.fields), 2):
            if r.text(i) or r.text(i + 1):
                rows.append((*head, r.whole(i, "ID"), r.real(i + 1, "VALUE")))
                of.append(c)
    sid, kind, ids, value = zip(*rows, strict=True) if rows else ((), (), (), ())
    columns: dict[str, NDArray[Any] | Ragged] = {
        "SID": np.array(sid, dtype=np.int64),
        "TYPE": np.array(kind, dtype=np.str_),
        "ID": np.array(ids, dtype=np.int64),
        "VALUE": np.array(value, dtype=np.float64),
    }
    return Table(cards[0].name, columns, *places(of))


def lists(cards: Sequence[Card], files: Files) -> Table:
    """NSM1 or NSML1: a row a card; the id 0 stands for ALL."""
    readers = [_reader(c, files) for c in cards]
    columns: dict[str, NDArray[Any] | Ragged] = {
        "SID": np.array([r.whole(0, "SID") for r in readers], dtype=np.int64),
        "TYPE": np.array([r.text(1) for r in readers], dtype=np.str_),
        "VALUE": np.array([r.real(2, "VALUE") for r in readers], dtype=np.float64),
        "ID": ragged([_ids(r) for r in readers], np.int64),
    }
    return Table(cards[0].name, columns, *places(cards))


def _reader(card: Card, files: Files) -> Reader:
    r = Reader(card, files)
    if "DISTR" in card.fields:
        raise UnsupportedCard(
            card.name, path=files[card.file], line=card.line, why="DISTR; leave it out"
        )
    return r


def _ids(r: Reader) -> list[int]:
    """Integers from field 4 on, `a THRU b` and `a THRU b BY c` expanded."""
    at = [i for i in range(3, len(r.card.fields)) if r.text(i)]
    if not at:
        raise r.fail("ID", "the list is empty; allowed are ids, THRU, BY and ALL")
    out: list[int] = []
    while at:
        i = at.pop(0)
        if r.text(i) == "ALL":
            return [0]
        if r.text(i) != "THRU" or not out or not at:
            out.append(r.whole(i, "ID"))
            continue
        last = r.whole(at.pop(0), "ID")
        step = 1
        if len(at) > 1 and r.text(at[0]) == "BY":
            step = r.whole(at[1], "ID")
            at = at[2:]
        if last < out[-1] or step < 1:
            raise r.fail(
                "ID", f"a THRU b BY c needs a <= b and c >= 1, got {out[-1]} THRU {last} BY {step}"
            )
        out += range(out[-1] + step, last + 1, step)
    return out
