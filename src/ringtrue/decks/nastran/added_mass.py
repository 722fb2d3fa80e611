"""Non-structural mass of chosen lists: NSM, NSML (pairs of an id and a value), NSM1, NSML1 (a value
and ids).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran.fields import Card, Files, Reader, places, ragged
from ringtrue.errors import UnsupportedCard
from ringtrue.model.model import Ragged, Table

PAIRS, LISTS = ("NSM", "NSML"), ("NSM1", "NSML1")
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
        last, step = r.whole(at.pop(0), "ID"), 1
        if len(at) > 1 and r.text(at[0]) == "BY":
            step = r.whole(at[1], "ID")
            at = at[2:]
        if last < out[-1] or step < 1:
            raise r.fail(
                "ID", f"a THRU b BY c needs a <= b and c >= 1, got {out[-1]} THRU {last} BY {step}"
            )
        out += range(out[-1] + step, last + 1, step)
    return out
