"""Cards with a pattern of their own: how each becomes a table, and where a field of one is on its
lines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran import lists as added_mass
from ringtrue.decks.nastran.beams import (
    BETWEEN,
    beam_stations,
    bend_places,
    cweld,
    dimension_place,
    pbarl,
    pbcomp,
    pbeam,
    pbeaml,
    pbend,
)
from ringtrue.decks.nastran.lexer import Card, Files, Reader, places, ragged
from ringtrue.decks.nastran.lists import (
    BUSH,
    PLY,
    VALUE,
    dmig,
    genel,
    pcomp,
    pcompg,
    ply_places,
    rbe1,
    rspline,
)
from ringtrue.errors import InputError
from ringtrue.model.cards import CARDS, END_A, END_B, MADE, columns
from ringtrue.model.edit import ply_field
from ringtrue.model.model import Ragged, Table


def _spc(cards: Sequence[Card], files: Files) -> Table:
    rows: list[tuple[int, int, str, float]] = []
    from_card = []
    for c in cards:
        r = Reader(c, files)
        sid = r.whole(0, "SID")
        for i, g in ((1, "G1"), (4, "G2")):
            if r.text(i):
                rows.append((sid, r.whole(i, g), r.text(i + 1) or "0", r.real(i + 2, "D", 0.0)))
                from_card.append(c)
    sid_, g_, c_, d_ = zip(*rows, strict=True) if rows else ((), (), (), ())
    cols: dict[str, NDArray[Any] | Ragged] = {
        "SID": np.array(sid_, dtype=np.int64),
        "G": np.array(g_, dtype=np.int64),
        "C": np.array(c_, dtype=np.str_),
        "D": np.array(d_, dtype=np.float64),
    }
    return Table("SPC", cols, *places(from_card))


def _several(
    card: str, id_name: str, names: Sequence[str], pitch: int = 0, *, whole: bool = False
) -> Callable[[Sequence[Card], Files], Table]:
    """A card that holds several rows of 1 + len(names) fields, real or `whole` numbers, at every
    `pitch`-th field.
    """

    def read(cards: Sequence[Card], files: Files) -> Table:
        ids: list[int] = []
        values: list[list[float]] = []
        of = []
        width = pitch or 1 + len(names)
        for c in cards:
            r = Reader(c, files)
            for i in range(0, max(len(c.fields), 1), width):
                if i == 0 or r.text(i):
                    ids.append(r.whole(i, id_name))
                    read_ = r.whole if whole else r.real
                    values.append([read_(i + 1 + k, name, 0) for k, name in enumerate(names)])
                    of.append(c)
        data = np.array(values, dtype=np.int64 if whole else np.float64).reshape(-1, len(names))
        made: dict[str, NDArray[Any]] = {id_name: np.array(ids, dtype=np.int64)}
        made |= {name: data[:, k] for k, name in enumerate(names)}
        return Table(card, made, *places(of))

    return read


def _mpc(cards: Sequence[Card], files: Files) -> Table:
    sid = []
    g = []
    comp = []
    a = []
    for c in cards:
        r = Reader(c, files)
        sid.append(r.whole(0, "SID"))
        # two terms on a line of eight fields, the first field of a continuation is blank
        at = [i for k in range(0, len(c.fields), 8) for i in (k + 1, k + 4) if r.text(i)]
        g.append([r.whole(i, "G") for i in at])
        comp.append([r.whole(i + 1, "C", 0) for i in at])
        a.append([r.real(i + 2, "A", 0.0) for i in at])
    cols: dict[str, NDArray[Any] | Ragged] = {
        "SID": np.array(sid, dtype=np.int64),
        "G": ragged(g, np.int64),
        "C": ragged(comp, np.int64),
        "A": ragged(a, np.float64),
    }
    return Table("MPC", cols, *places(cards))


def _rbe3(cards: Sequence[Card], files: Files) -> Table:
    eid = []
    ref = []
    refc = []
    g = []
    comp = []
    w = []
    gm = []
    cm = []
    for c in cards:
        r = Reader(c, files)
        eid.append(r.whole(0, "EID"))
        ref.append(r.whole(2, "REFGRID"))
        refc.append(r.text(3))
        nodes, comps, weights = _rbe3_groups(r)
        g.append(nodes)
        comp.append(comps)
        w.append(weights)
        gm.append([r.whole(i, "GM") for i in _rbe3_um(r)[::2]])
        cm.append([r.text(i) for i in _rbe3_um(r)[1::2]])
        if len(gm[-1]) != len(cm[-1]):
            raise r.fail("CM", "UM lists pairs of a node and its components; one is missing")
    cols: dict[str, NDArray[Any] | Ragged] = {
        "EID": np.array(eid, dtype=np.int64),
        "REFGRID": np.array(ref, dtype=np.int64),
        "REFC": np.array(refc, dtype=np.str_),
        "G": ragged(g, np.int64),
        "C": ragged(comp, np.str_),
        "WT": ragged(w, np.float64),
        "GM": ragged(gm, np.int64),
        "CM": ragged(cm, np.str_),
    }
    return Table("RBE3", cols, *places(cards))


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


def _pbush(cards: Sequence[Card], files: Files) -> Table:
    blank = {s.name: float(s.default) for s in columns("PBUSH")[1:]}
    cols: dict[str, list[float]] = {n: [] for n in blank}
    pid = []
    for c in cards:
        r = Reader(c, files)
        pid.append(r.whole(0, "PID"))
        row = dict(blank)
        for start in range(1, len(c.fields), 8):
            flag = r.text(start).upper()
            if "RIGID" in (r.text(i).upper() for i in range(start, start + 7)):
                raise r.fail("K", "RIGID is not supported; use RBE2")
            if flag and flag not in (*BUSH, "RCV", "T", "D"):
                raise r.fail("flag", f"{flag!r}: allowed are K, B, GE, M, RCV")
            for k, name in enumerate(BUSH.get(flag, [])):
                row[name] = r.real(start + 1 + k, name, blank[name])
        for name, value in row.items():
            cols[name].append(value)
    data = {"PID": np.array(pid, dtype=np.int64)} | {
        n: np.array(v, dtype=np.float64) for n, v in cols.items()
    }
    return Table("PBUSH", data, *places(cards))


EXPAND: Mapping[str, Callable[[Sequence[Card], Files], Table]] = MappingProxyType(
    {
        "SPC": _spc,
        "MPC": _mpc,
        "RBE1": rbe1,
        "RBE3": _rbe3,
        "RSPLINE": rspline,
        "GENEL": genel,
        "CWELD": cweld,
        **{
            f"CORD1{k}": _several(f"CORD1{k}", "CID", ("G1", "G2", "G3"), whole=True) for k in "RCS"
        },
        "PELAS": _several("PELAS", "PID", ("K", "GE", "S")),
        "PMASS": _several("PMASS", "PID", ("M",)),
        "PDAMP": _several("PDAMP", "PID", ("B",)),
        "PVISC": _several("PVISC", "PID", ("CE", "CR"), 4),
        "PCOMP": pcomp,
        "PCOMPG": pcompg,
        "DMIG": dmig,
        "PBUSH": _pbush,
        **dict.fromkeys(added_mass.PAIRS, added_mass.pairs),
        **dict.fromkeys(added_mass.LISTS, added_mass.lists),
        "PBEAM": pbeam,
        "PBCOMP": pbcomp,  # the table is of PBEAM
        "PBEND": pbend,
        "PBARL": pbarl,  # the table is of PBAR
        "PBEAML": pbeaml,  # the table is of PBEAM
    }
)
_SEVERAL = {
    **dict.fromkeys(("CORD1R", "CORD1C", "CORD1S"), ("G1", "G2", "G3")),
    "PELAS": ("K", "GE", "S"),
    "PMASS": ("M",),
    "PDAMP": ("B",),
    "PVISC": ("CE", "CR", ""),
}
_BEAM = (
    "K1",
    "K2",
    "S1",
    "S2",
    "NSIA",
    "NSIB",
    "CWA",
    "CWB",
    "M1A",
    "M2A",
    "M1B",
    "M2B",
    "N1A",
    "N2A",
    "N1B",
    "N2B",
)


def field_place(name: str, fields: Sequence[str], id: int, field: str) -> int | None:
    """Number (from 0) of a data field of a card with the data fields `fields`; None where it has no
    place.

    Raises
    ------
    InputError
        If the field is no single field of that card.
    """
    if name in _SEVERAL:
        names = ("PID", *_SEVERAL[name])
        starts = range(0, len(fields), len(names))
        return next((i + names.index(field) for i in starts if fields[i] == str(id)), None)
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
    return places[number], next((fields[i] for i in reversed(places[:number]) if fields[i]), "")


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
    return behind + _BEAM.index(field)
