"""Cards with a pattern of their own: how each becomes a table, and where a field of one is on its
lines.

Among them are cards that are lists: the plies of PCOMP and PCOMPG, the nodes of RBE1 and RSPLINE,
the terms of DMIG and GENEL, non-structural mass (NSM, NSML: pairs of an id and a value; NSM1,
NSML1: a value and ids).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran.beams import (
    BETWEEN,
    beam_stations,
    beam_tail_place,
    bend_places,
    cweld,
    dimension_place,
    pbcomp,
    pbeam,
    pbend,
    section_properties,
)
from ringtrue.decks.nastran.lexer import (
    Card,
    Files,
    Reader,
    Row,
    integers,
    reals,
    table_of_rows,
)
from ringtrue.errors import InputError
from ringtrue.model.cards import CARDS, END_A, END_B, MADE, columns
from ringtrue.model.edit import ply_field
from ringtrue.model.model import Ragged, Table

BUSH = {  # lines of a PBUSH
    **{flag: [f"{flag}{i}" for i in range(1, 7)] for flag in "KB"},
    "GE": ["GE", *(f"GE{i}" for i in range(2, 7))],
    "M": ["M"],
}
PLY = {
    "PCOMP": ("MID", "T", "THETA", "SOUT"),
    "PCOMPG": ("GPLYID", "MID", "T", "THETA", "SOUT"),
}
_PLY_PITCH = {"PCOMP": 4, "PCOMPG": 8}  # fields from ply to ply
_FIRST = 8


def ply_places(name: str, fields: Sequence[str]) -> list[int]:
    """Where on a PCOMP or PCOMPG the fields of each ply begin; a ply is there if one of its fields
    is.
    """
    size = len(PLY[name])
    return [
        i
        for i in range(_FIRST, len(fields), _PLY_PITCH[name])
        if any(fields[i : i + size])
    ]


def laminate(r: Reader) -> Iterator[Row]:
    """PCOMP or PCOMPG: an entry of the ragged columns a ply; a blank MID or T is that of the ply
    before.
    """
    name = r.card.name
    head, plies = (
        [s for s in columns(name) if s.tail is tail] for tail in (False, True)
    )
    row: dict[str, Any] = {"PID": r.whole(0, "PID")}
    for i, spec in enumerate(head[1:], start=1):
        real = spec.kind == "f"
        row[spec.name] = (
            r.real(i, spec.name, float(spec.default)) if real else r.text(i)
        )
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


# what opens a line, and where its entries begin
_BLOCKS = {"": 2, "UD": 2, "K": 1, "Z": 1, "S": 1}


def _genel_blocks(r: Reader) -> dict[str, range]:
    """Fields of each block of a GENEL, that of UI under ""."""
    texts = [(i, r.text(i).upper()) for i in range(8, len(r.card.fields), 8)]
    marks = [(i, text) for i, text in texts if text and text in _BLOCKS]
    found = [name for _, name in marks]
    if len(set(found)) < len(found) or found.count("K") + found.count("Z") != 1:
        raise r.fail("K", "one block K or Z is needed, and each block once")
    ends = [*(i for i, _ in marks[1:]), len(r.card.fields)]
    blocks = {
        name: range(i + _BLOCKS[name], end)
        for (i, name), end in zip(marks, ends, strict=True)
    }
    return {"": range(2, marks[0][0]), **blocks}


def _genel_reals(r: Reader, name: str, at: range, count: int) -> list[float]:
    """The reals of a block, a blank for 0 among them."""
    given = [r.real(i, name, 0.0) for i in at]
    if any(given[count:]) or len(given) + 7 < count:
        raise r.fail(
            name, f"{sum(bool(r.text(i)) for i in at)} numbers, {count} are needed"
        )
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
    cells = np.array(
        [(text or "0").encode("latin-1") for _, text in texts], dtype=np.bytes_
    )
    real = key in ("A", "B")
    values, good = (reals if real else integers)(cells)
    if not good.all():
        card, text = texts[int(good.argmin())]
        kind = "a real" if real else "an integer"
        raise Reader(card, files).fail(key, f"{text!r} is not {kind}")
    return values


NSM_PAIRS = ("NSM", "NSML")
NSM_LISTS = ("NSM1", "NSML1")
VALUE = {"NSM": 3, "NSML": 3, "NSM1": 2, "NSML1": 2}  # its place where a card has one


def nsm_pairs(r: Reader) -> Iterator[Row]:
    """NSM or NSML: a row a pair."""
    head = _list_head(r)
    for i in range(2, len(r.card.fields), 2):
        if r.text(i) or r.text(i + 1):
            yield {**head, "ID": r.whole(i, "ID"), "VALUE": r.real(i + 1, "VALUE")}


def nsm_lists(r: Reader) -> Iterator[Row]:
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


def _spc(r: Reader) -> Iterator[Row]:
    sid = r.whole(0, "SID")
    for i, name in ((1, "G1"), (4, "G2")):
        if r.text(i):
            node = r.whole(i, name)
            components = r.text(i + 1) or "0"
            yield {"SID": sid, "G": node, "C": components, "D": r.real(i + 2, "D", 0.0)}


# fields from row to row of a card that holds several rows
_PITCH = {
    **dict.fromkeys(("CORD1R", "CORD1C", "CORD1S", "PELAS", "PVISC"), 4),
    **dict.fromkeys(("PMASS", "PDAMP", "ASET", "OMIT", "QSET", "EXTRN"), 2),
}


def _several(r: Reader) -> Iterator[Row]:
    """A card that holds several rows, each as its table has it."""
    first, *others = columns(r.card.name)
    for i in range(0, max(len(r.card.fields), 1), _PITCH[r.card.name]):
        if i == 0 or r.text(i):
            row: dict[str, Any] = {first.name: r.whole(i, first.name)}
            for k, spec in enumerate(others, start=i + 1):
                if spec.kind == "c":
                    row[spec.name] = r.text(k) or "0"
                    continue
                read = r.whole if spec.kind == "i" else r.real
                row[spec.name] = read(k, spec.name, 0)
            yield row


def _mpc(r: Reader) -> Iterator[Row]:
    # two terms on a line of eight fields, the first field of a continuation is blank
    starts = range(0, len(r.card.fields), 8)
    at = [i for k in starts for i in (k + 1, k + 4) if r.text(i)]
    yield {
        "SID": r.whole(0, "SID"),
        "G": [r.whole(i, "G") for i in at],
        "C": [r.whole(i + 1, "C", 0) for i in at],
        "A": [r.real(i + 2, "A", 0.0) for i in at],
    }


def _seconct(r: Reader) -> Iterator[Row]:
    """SECONCT: pairs of points, and pairs of ranges `a THRU b c THRU d` of as many points each."""
    texts = [i for i in range(8, len(r.card.fields)) if r.text(i)]
    points: list[int] = []
    others: list[int] = []
    while texts:
        many = len(texts) > 1 and r.text(texts[1]) == "THRU"
        size = 6 if many else 2
        if len(texts) < size:
            raise r.fail("GIDB", "points are joined in pairs; one is missing")
        ends = [r.whole(i, "GIDA") for i in texts[:size] if r.text(i) != "THRU"]
        half = len(ends) // 2
        first = [*range(ends[0], ends[half - 1] + 1)]
        second = [*range(ends[half], ends[-1] + 1)]
        if len(first) != len(second):
            raise r.fail("GIDA", f"{len(first)} points are joined to {len(second)}")
        points += first
        others += second
        texts = texts[size:]
    yield {
        "SEIDA": r.whole(0, "SEIDA"),
        "SEIDB": r.whole(1, "SEIDB", 0),
        "TOL": r.real(2, "TOL", 1e-5),
        "LOC": r.text(3),
        "GIDA": points,
        "GIDB": others,
    }


def _rbe3(r: Reader) -> Iterator[Row]:
    eid = r.whole(0, "EID")
    reference = r.whole(2, "REFGRID")
    nodes, components, weights = _rbe3_groups(r)
    um = _rbe3_um(r)
    if len(um) % 2:
        raise r.fail(
            "CM", "UM lists pairs of a node and its components; one is missing"
        )
    yield {
        "EID": eid,
        "REFGRID": reference,
        "REFC": r.text(3),
        "G": nodes,
        "C": components,
        "WT": weights,
        "GM": [r.whole(i, "GM") for i in um[::2]],
        "CM": [r.text(i) for i in um[1::2]],
    }


def _rbe3_um(r: Reader) -> list[int]:
    """The fields behind UM that are not blank, up to ALPHA."""
    names = [r.text(i).upper() for i in range(len(r.card.fields))]
    if "UM" not in names:
        return []
    end = names.index("ALPHA") if "ALPHA" in names else len(names)
    return [i for i in range(names.index("UM") + 1, end) if names[i]]


def _rbe3_groups(r: Reader) -> tuple[list[int], list[str], list[float]]:
    nodes: list[int] = []
    comps: list[str] = []
    weights: list[float] = []
    i = 4
    weight = 1.0
    comp = ""
    fresh = False
    while i < len(r.card.fields):
        t = r.text(i).upper()
        if t in ("UM", "ALPHA"):
            break
        if not t:
            i += 1
        elif t == "THRU" and nodes and not fresh:
            more = range(nodes[-1] + 1, r.whole(i + 1, "G") + 1)
            nodes.extend(more)
            comps.extend([comp] * len(more))
            weights.extend([weight] * len(more))
            i += 2
        elif not t.lstrip("+-").isdigit():
            weight = r.real(i, "WT")
            comp = r.text(i + 1)
            fresh = True
            i += 2
        else:
            if not comp:
                raise r.fail("C", "a node stands before its weight and components")
            nodes.append(r.whole(i, "G"))
            comps.append(comp)
            weights.append(weight)
            fresh = False
            i += 1
    if not nodes or fresh:
        raise r.fail("G", "no independent node")
    return nodes, comps, weights


def _pbush(r: Reader) -> Iterator[Row]:
    row: dict[str, Any] = {"PID": r.whole(0, "PID")}
    blank = {s.name: s.default for s in columns("PBUSH")}
    for start in range(1, len(r.card.fields), 8):
        flag = r.text(start).upper()
        if "RIGID" in (r.text(i).upper() for i in range(start, start + 7)):
            raise r.fail("K", "RIGID is not supported; use RBE2")
        if flag and flag not in (*BUSH, "RCV", "T", "D"):
            raise r.fail("flag", f"{flag!r}: allowed are K, B, GE, M, RCV")
        for k, name in enumerate(BUSH.get(flag, []), start=start + 1):
            row[name] = r.real(k, name, float(blank[name]))
    yield row


_ROWS: Mapping[str, Callable[[Reader], Iterable[Row]]] = {
    "SPC": _spc,
    "MPC": _mpc,
    "SECONCT": _seconct,
    "RBE1": rbe1,
    "RBE3": _rbe3,
    "RSPLINE": rspline,
    "GENEL": genel,
    "CWELD": cweld,
    **dict.fromkeys(_PITCH, _several),
    **dict.fromkeys(PLY, laminate),
    "PBUSH": _pbush,
    **dict.fromkeys(NSM_PAIRS, nsm_pairs),
    **dict.fromkeys(NSM_LISTS, nsm_lists),
    "PBEAM": pbeam,
    "PBCOMP": pbcomp,
    "PBEND": pbend,
    **dict.fromkeys(MADE, section_properties),
}
SPECIAL = frozenset({*_ROWS, "DMIG"})
_TABLE_OF = {"PBCOMP": "PBEAM", **MADE}  # cards whose table is that of another


def special_table(name: str, cards: Sequence[Card], files: Files) -> Table:
    """The table that cards of one name make.

    Raises
    ------
    DeckError
        On a malformed field.
    UnsupportedCard
        If a card is of a form that is not supported.
    """
    if name == "DMIG":
        return dmig(cards, files)
    rows = [(c, row) for c in cards for row in _ROWS[name](Reader(c, files))]
    return table_of_rows(_TABLE_OF.get(name, name), rows)


def field_place(name: str, fields: Sequence[str], id: int, field: str) -> int | None:
    """Number (from 0) of a data field of a card with the data fields `fields`; None where it has no
    place.

    Raises
    ------
    InputError
        If the field is no single field of that card.
    """
    if name in _PITCH:
        place = _by_schema(name, field)
        starts = range(0, len(fields), _PITCH[name])
        return next((i + place for i in starts if fields[i] == str(id)), None)
    if name in VALUE and field == "VALUE":
        return VALUE[name]
    if name in CARDS:
        return _by_schema(name, field)
    if name in PLY:
        return _of_laminate(name, fields, field)
    if name in MADE:
        return dimension_place(fields, field)
    if field in ("PID", "MID"):
        return ("PID", "MID").index(field)
    if name == "PBUSH":
        return _of_bush(fields, field)
    if name == "PBEND":
        return bend_places(fields).get(field)
    if name == "PBEAM":
        return _of_beam(fields, field)
    raise InputError(f"fields of {name} cannot be changed in place")


def _by_schema(name: str, field: str) -> int:
    for i, spec in enumerate(columns(name)):
        if field in (spec.name, spec.other) and not spec.tail and not spec.blank:
            return i
    raise InputError(f"{name} field {field} cannot be changed in place")


def _of_laminate(name: str, fields: Sequence[str], field: str) -> int | None:
    head = [s.name for s in columns(name) if not s.tail]
    if field in head:
        return head.index(field)
    key, number = ply_field(field) or ("", 0)
    plies = ply_places(name, fields)
    return (
        plies[number - 1] + PLY[name].index(key)
        if key in PLY[name] and 1 <= number <= len(plies)
        else None
    )


def inherited(name: str, fields: Sequence[str], field: str) -> tuple[int, str] | None:
    """The blank field of the next ply that takes its MID or T from this one: its place, and the
    text it stands for.
    """
    key, number = ply_field(field) or ("", 0)
    if name not in PLY or key not in ("MID", "T"):
        return None
    places = [i + PLY[name].index(key) for i in ply_places(name, fields)]
    if not 1 <= number < len(places) or fields[places[number]]:
        return None
    return places[number], next(
        (fields[i] for i in reversed(places[:number]) if fields[i]), ""
    )


def bush_flag(field: str) -> str:
    """K, B, GE, ...: what the line of a PBUSH begins with that holds the field."""
    return next(flag for flag, names in BUSH.items() if field in names)


def _of_bush(fields: Sequence[str], field: str) -> int | None:
    flag = bush_flag(field)
    at = next((i for i in range(1, len(fields), 8) if fields[i] == flag), None)
    return None if at is None else at + 1 + BUSH[flag].index(field)


def _of_beam(fields: Sequence[str], field: str) -> int | None:
    if field in END_A:
        return 2 + END_A.index(field)
    stations, behind = beam_stations(Reader(Card("PBEAM", list(fields), 0, 0), ("",)))
    if field in END_B:
        return next((p + END_B.index(field) for x, p in stations if x == 1.0), None)
    key, number = ply_field(field) or ("", 0)
    if key in ("X", *BETWEEN):
        between = [p for x, p in stations if x < 1.0]
        return (
            between[number - 1] + ("X", *BETWEEN).index(key) - 1
            if 1 <= number <= len(between)
            else None
        )
    return behind + beam_tail_place(field)
