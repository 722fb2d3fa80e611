"""Non-structural mass by lists: NSM, NSM1, NSML, NSML1 and NSMADD, chosen by NSM in case control.

NSM and NSM1 give a mass a length or area. NSML gives the whole mass of all elements of each id,
NSML1 that of the whole list; it is spread evenly over their length or area (MSC Nastran Quick
Reference Guide). All add to each other and to the NSM of the property.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.fem.elements import bar, curved_shell, rod, shear, shell3, shell4
from ringtrue.fem.mesh import CardRows, Mesh, Rows, union
from ringtrue.model.model import Model, Table

log = logging.getLogger(__name__)
Measure = Callable[[CardRows], Any_]
LINES: Mapping[str, Measure] = {
    **dict.fromkeys(("CROD", "CONROD", "CTUBE"), rod.measure),
    **dict.fromkeys(("CBAR", "CBEAM"), bar.measure),
}
SHELLS: Mapping[str, Measure] = {
    **dict.fromkeys(("CQUAD4", "CQUADR"), shell4.measure),
    **dict.fromkeys(("CTRIA3", "CTRIAR"), shell3.measure),
    **dict.fromkeys(("CQUAD8", "CTRIA6"), curved_shell.measure),
}
AREAS = {**SHELLS, "CSHEAR": shear.measure}
MEASURES = {**LINES, **AREAS}
PROPERTIES: Mapping[
    str, tuple[tuple[str, ...], tuple[str, ...]]
] = {  # TYPE: property cards, element cards
    "PSHELL": (("PSHELL",), tuple(SHELLS)),
    "PCOMP": (("PCOMP", "PCOMPG"), tuple(SHELLS)),
    "PSHEAR": (("PSHEAR",), ("CSHEAR",)),
    **dict.fromkeys(("PBAR", "PBARL"), (("PBAR",), ("CBAR",))),
    **dict.fromkeys(("PBEAM", "PBEAML"), (("PBEAM",), ("CBEAM",))),
    "PROD": (("PROD",), ("CROD",)),
    "PTUBE": (("PTUBE",), ("CTUBE",)),
}
TYPES = (*PROPERTIES, "CONROD", "ELEMENT")
CARDS = ("NSM", "NSM1", "NSML", "NSML1")


@dataclass(frozen=True, slots=True, eq=False)
class Lists:
    """Chosen lists of one card and one TYPE.

    Attributes
    ----------
    row : (n,) int64
        Row of each list in the table of the card.
    of, ids : (k,) int64
        Lists and the ids that stand on them, 0 for all.
    """

    table: Table
    kind: str
    row: Int
    of: Int
    ids: Int

    def rows(self, m: Mesh) -> CardRows:
        """The cards of the lists."""
        return CardRows(m, self.table, self.row)


def chosen(model: Model) -> Iterator[Lists]:
    """The lists of the set that case control names, or of the sets that its NSMADD unites.

    Raises
    ------
    DeckError, UnsupportedCard
        If there is no such set; if a TYPE is not one of `TYPES`.
    """
    sid = model.case.nsm
    sids = np.array([sid])
    if (
        "NSMADD" in model
        and (rows := np.flatnonzero(model["NSMADD"]["SID"] == sid)).size
    ):
        sids = np.concatenate([model["NSMADD"].ragged("S").row(int(i)) for i in rows])
    tables = [model[c] for c in CARDS if c in model]
    for s in sids.tolist():
        if not any((t["SID"] == s).any() for t in tables):
            raise DeckError(
                f"NSM = {sid} in case control: no NSM, NSM1, NSML or NSML1 has the number {s}"
            )
    for t in tables:
        use = np.isin(t["SID"], sids)
        ids, owner = t.entries("ID")
        for kind in np.unique(t["TYPE"][use]).tolist():
            rows = np.flatnonzero(use & (t["TYPE"] == kind))
            if kind not in TYPES:
                raise UnsupportedCard(
                    t.card, why=f"TYPE {kind}; allowed are {', '.join(TYPES)}"
                )
            mine = np.isin(owner, rows)
            of = np.searchsorted(rows, owner[mine])
            yield Lists(table=t, kind=kind, row=rows, of=of, ids=ids[mine])


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """Rows (n,) of an element card that stand on lists `of` (n,)."""

    card: str
    at: Int
    of: Int


def members(model: Model, lists: Lists) -> list[Member]:
    """The elements on the lists, each once a list."""
    known = _properties(model, lists.kind)
    family = tuple(MEASURES) if lists.kind == "ELEMENT" else ("CONROD",)
    key = "EID"
    if known is not None:
        family = PROPERTIES[lists.kind][1]
        key = "PID"
    made = []
    for card in (c for c in family if c in model):
        mine = model[card][key]
        able = np.ones(mine.size, dtype=bool) if known is None else np.isin(mine, known)
        at, of = _joined(mine, able, lists)
        if at.size:
            made.append(Member(card, at, of))
    return made


def _properties(model: Model, kind: str) -> Int | None:
    if kind not in PROPERTIES:
        return None
    none: Int = np.zeros(0, dtype=np.int64)
    return np.concatenate(
        [none, *(model[c].ids for c in PROPERTIES[kind][0] if c in model)]
    )


def _joined(mine: Int, able: Bool, lists: Lists) -> tuple[Int, Int]:
    """Rows and lists of all pairs of a row of `mine` and a list that names it, each once."""
    named = np.unique(mine[able])
    every = lists.of[lists.ids == 0]
    ids = np.concatenate([lists.ids, np.tile(named, every.size)])
    of = np.concatenate([lists.of, np.repeat(every, named.size)])
    ids, of = np.unique(np.stack([ids, of]), axis=1)
    first = np.searchsorted(ids, mine)
    count = np.where(able, np.searchsorted(ids, mine, side="right") - first, 0)
    row = np.repeat(np.arange(mine.size), count)
    entry = np.repeat(first - np.cumsum(count) + count, count) + np.arange(row.size)
    return row, of[entry]


def sharers(model: Model, rows: Rows, sid: Int | None = None) -> Rows:
    """Rows of element cards, and those that share a whole mass (NSML, NSML1) with them and feel
    their sizes.

    With `sid` (s,): all that stand on the lists of these sets.
    """
    if not model.case.nsm:
        return rows
    out = [rows]
    for lists in chosen(model):
        found = members(model, lists)
        hit = np.zeros(lists.row.size, dtype=bool)
        if sid is not None:
            hit = np.isin(lists.table["SID"][lists.row], sid)
        elif lists.table.card in ("NSML", "NSML1"):
            for part in found:
                hit[part.of[np.isin(part.at, rows.get(part.card, ()))]] = True
        for part in found:
            at = part.at[hit[part.of]]
            if at.size:
                out.append({part.card: at})
    return union(out)


def nonstructural_mass(m: Mesh) -> dict[str, Any_]:
    """Mass a length or area (rows,) that the chosen lists add, by element card.

    Raises
    ------
    DeckError
        If a list names nothing that carries non-structural mass, or one value is for lines and
        areas.
    """
    out: dict[str, Any_] = {}
    for lists in chosen(m.model):
        found = members(m.model, lists)
        _check(m, lists, found)
        value = lists.table["VALUE"][lists.row]
        if lists.table.card in ("NSML", "NSML1"):
            value = value / _totals(m, lists, found)
        for part in found:
            old = out.get(part.card, np.zeros(len(m.model[part.card])))
            out[part.card] = old.astype(np.result_type(old, value))
            np.add.at(out[part.card], part.at, value[part.of])
    return out


def _totals(m: Mesh, lists: Lists, found: list[Member]) -> Any_:
    """Length or area (n,) of each list."""
    total = np.zeros(lists.row.size)
    kinds = np.zeros((2, lists.row.size), dtype=bool)
    for part in found:
        rows, back = np.unique(part.at, return_inverse=True)
        np.add.at(total, part.of, MEASURES[part.card](m.rows(part.card, rows))[back])
        kinds[int(part.card in AREAS), part.of] = True
    why = "one mass for lines and areas together; give a list to each"
    lists.rows(m).refuse(kinds.all(axis=0), why)
    return np.where(total == 0, 1.0, total)


def _check(m: Mesh, lists: Lists, found: list[Member]) -> None:
    """Ids that are not in the deck are passed over, as in Nastran, but for a list with nothing
    else.
    """
    known = _properties(m.model, lists.kind)
    if known is None:
        parts = [m.model[p.card].ids[p.at] for p in found]
        known = np.concatenate([lists.ids[:0], *parts])
    there = np.isin(lists.ids, known) | ((lists.ids == 0) & (known.size > 0))
    whole = np.bincount(lists.of, weights=there, minlength=lists.row.size) == 0
    what = f"none of its {lists.kind} ids is in the deck"
    if lists.kind == "ELEMENT":
        what = f"none of its elements carries it; allowed are {', '.join(MEASURES)}"
    lists.rows(m).refuse(whole, what)
    lost = np.unique(lists.ids[~there])
    if lost.size:
        log.warning(
            "%s: %d ids are not there: %s",
            lists.table.card,
            lost.size,
            lost[:5].tolist(),
        )
