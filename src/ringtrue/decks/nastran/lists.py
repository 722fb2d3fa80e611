"""Cards that are lists: the plies of PCOMP and PCOMPG, the nodes of RBE1 and RSPLINE, the terms of
DMIG and GENEL, non-structural mass (NSM, NSML: pairs of an id and a value; NSM1, NSML1: a value and
ids).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran.lexer import Card, Files, Reader, Row, integers, reals, table_of_rows
from ringtrue.model.cards import columns
from ringtrue.model.model import Ragged, Table

BUSH = {  # lines of a PBUSH
    **{flag: [f"{flag}{i}" for i in range(1, 7)] for flag in "KB"},
    "GE": ["GE", *(f"GE{i}" for i in range(2, 7))],
    "M": ["M"],
}
PLY = {"PCOMP": ("MID", "T", "THETA", "SOUT"), "PCOMPG": ("GPLYID", "MID", "T", "THETA", "SOUT")}
_PITCH = {"PCOMP": 4, "PCOMPG": 8}  # fields from ply to ply
_FIRST = 8


def ply_places(name: str, fields: Sequence[str]) -> list[int]:
    """Where on a PCOMP or PCOMPG the fields of each ply begin; a ply is there if one of its fields
    is.
    """
    size = len(PLY[name])
    return [i for i in range(_FIRST, len(fields), _PITCH[name]) if any(fields[i : i + size])]


def laminate(r: Reader) -> Iterator[Row]:
    """PCOMP or PCOMPG: an entry of the ragged columns a ply; a blank MID or T is that of the ply
    before.
    """
    name = r.card.name
    head, plies = ([s for s in columns(name) if s.tail is tail] for tail in (False, True))
    row: dict[str, Any] = {"PID": r.whole(0, "PID")}
    for i, spec in enumerate(head[1:], start=1):
        real = spec.kind == "f"
        row[spec.name] = r.real(i, spec.name, float(spec.default)) if real else r.text(i)
    row |= {spec.name: [] for spec in plies}
    for number, at in enumerate(ply_places(name, r.card.fields), 1):
        for i, spec in enumerate(plies, start=at):
            values = row[spec.name]
            before = values[-1] if values and spec.name in ("MID", "T") else None
            if spec.kind == "s":
                values.append(r.text(i) or "NO")
            elif spec.kind == "i":
                values.append(r.whole(i, f"{spec.name}{number}", before))
            else:
                default = 0.0 if spec.name == "THETA" else before
                values.append(r.real(i, f"{spec.name}{number}", default))
    if not row["MID"]:
        raise r.fail("MID1", "the laminate has no ply")
    yield row


def rbe1(r: Reader) -> Iterator[Row]:
    """RBE1: its independent pairs (GN, CN) and, behind UM, its dependent ones (GM, CM)."""
    row: dict[str, Any] = {"EID": r.whole(0, "EID")}
    size = len(r.card.fields)
    um = next((i for i in range(8, size, 8) if r.text(i).upper() == "UM"), None)
    if um is None:
        why = "the dependent DOFs are missing: write UM in field 2 of a continuation before them"
        raise r.fail("UM", why)
    for kind, starts in (("N", range(0, um, 8)), ("M", range(um, size, 8))):
        # three pairs on a line of eight fields, behind its first
        every = [k + pair for k in starts for pair in (1, 3, 5)]
        at = [i for i in every if r.text(i) and r.text(i + 1)]
        row[f"G{kind}"] = [r.whole(i, f"G{kind}") for i in at]
        row[f"C{kind}"] = [r.text(i + 1) for i in at]
        if not at:
            raise r.fail(f"G{kind}", "no node with components")
    yield row


def rspline(r: Reader) -> Iterator[Row]:
    """RSPLINE: its nodes in order, each with its dependent components; the first and the last have
    none.
    """
    size = len(r.card.fields)
    at = [2, *(i for i in range(3, size, 2) if r.text(i))]
    if len(at) < 2:
        raise r.fail("G", "a spline has two nodes or more")
    if any(r.text(i) for i in range(at[-1] + 1, size)):
        raise r.fail("G", "the last node is independent: no components stand behind it")
    yield {
        "EID": r.whole(0, "EID"),
        "DL": r.real(1, "D/L", 0.1),
        "G": [r.whole(i, "G") for i in at],
        "C": ["", *(r.text(i + 1) for i in at[1:])],
    }


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


def genel(r: Reader) -> Iterator[Row]:
    """GENEL: pairs (UI, CI) and (UD, CD), the lower triangle of K or Z by columns, and S by
    rows.
    """
    blocks = _genel_blocks(r)
    form = "Z" if "Z" in blocks else "K"
    row: dict[str, Any] = {"EID": r.whole(0, "EID"), "FORM": form}
    for kind, block in (("I", ""), ("D", "UD")):
        at = [i for i in blocks.get(block, range(0))[::2] if r.text(i)]
        row[f"U{kind}"] = [r.whole(i, f"U{kind}") for i in at]
        row[f"C{kind}"] = [r.whole(i + 1, f"C{kind}", 0) for i in at]
    n = len(row["UI"])
    if not n:
        raise r.fail("UI", "no component")
    row["KZ"] = _genel_reals(r, form, blocks[form], n * (n + 1) // 2)
    if "S" in blocks:
        row["S"] = _genel_reals(r, "S", blocks["S"], n * len(row["UD"]))
    yield row


def dmig(cards: Sequence[Card], files: Files) -> Table:
    """DMIG: a row a matrix, numbered in the order of their headers; an entry of the ragged columns
    a term.
    """
    heads = [c for c in cards if c.fields[1] == "0"]
    number: dict[str, int] = {}
    rows: list[tuple[Card, Row]] = []
    for i, c in enumerate(heads):
        r = Reader(c, files)
        name = r.text(0)
        if name in number:
            raise r.fail("NAME", f"{name} has two headers")
        number[name] = i
        row: dict[str, Any] = {"ID": i + 1, "NAME": name}
        for k, key in ((2, "IFO"), (3, "TIN"), (4, "TOUT"), (5, "POLAR"), (7, "NCOL")):
            row[key] = r.whole(k, key, 0)
        rows.append((c, row))
    table = table_of_rows("DMIG", rows)
    terms: list[tuple[Card, int]] = []
    for c in cards:
        if c.fields[1] == "0":
            continue
        if c.fields[0] not in number:
            why = f"{c.fields[0]!r} has no header (0 in field 3)"
            raise Reader(c, files).fail("NAME", why)
        terms += [(c, i) for i in range(4, len(c.fields), 4) if c.fields[i]]
    owner = np.array([number[c.fields[0]] for c, _ in terms], dtype=np.int64)
    order = np.argsort(owner, kind="stable")
    offsets = np.cumsum([0, *np.bincount(owner, minlength=len(heads)).tolist()])
    made = dict(table.columns)
    for k, key in enumerate(("GJ", "CJ")):
        values = _numbers([(c, c.fields[1 + k]) for c, _ in terms], key, files)
        made[key] = Ragged(values[order], offsets)
    for k, key in enumerate(("GI", "CI", "A", "B")):
        values = _numbers([(c, c.fields[i + k]) for c, i in terms], key, files)
        made[key] = Ragged(values[order], offsets)
    return replace(table, columns=made)


def _numbers(texts: Sequence[tuple[Card, str]], key: str, files: Files) -> NDArray[Any]:
    """The fields `key` (n,) of terms, all at once as there are many; a blank is 0."""
    cells = np.array([(text or "0").encode("latin-1") for _, text in texts], dtype=np.bytes_)
    real = key in ("A", "B")
    values, good = (reals if real else integers)(cells)
    if not good.all():
        card, text = texts[int(good.argmin())]
        kind = "a real" if real else "an integer"
        raise Reader(card, files).fail(key, f"{text!r} is not {kind}")
    return values


PAIRS = ("NSM", "NSML")
LISTS = ("NSM1", "NSML1")
VALUE = {"NSM": 3, "NSML": 3, "NSM1": 2, "NSML1": 2}  # its place where a card has one


def pairs(r: Reader) -> Iterator[Row]:
    """NSM or NSML: a row a pair."""
    head = _list_head(r)
    for i in range(2, len(r.card.fields), 2):
        if r.text(i) or r.text(i + 1):
            yield {**head, "ID": r.whole(i, "ID"), "VALUE": r.real(i + 1, "VALUE")}


def lists(r: Reader) -> Iterator[Row]:
    """NSM1 or NSML1: a row a card; the id 0 stands for ALL."""
    yield {**_list_head(r), "VALUE": r.real(2, "VALUE"), "ID": _ids(r)}


def _list_head(r: Reader) -> Row:
    if "DISTR" in r.card.fields:
        raise r.unsupported("DISTR; leave it out")
    return {"SID": r.whole(0, "SID"), "TYPE": r.text(1)}


def _ids(r: Reader) -> list[int]:
    """Integers from field 4 on; the id 0 for ALL."""
    if "ALL" in r.card.fields[3:]:
        return [0]
    ids = r.integers(3, "ID")
    if not ids:
        raise r.fail("ID", "the list is empty; allowed are ids, THRU, BY and ALL")
    return ids
