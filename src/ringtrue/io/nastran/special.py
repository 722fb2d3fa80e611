"""Cards with a pattern of their own: SPC, MPC, RBE3, PELAS, PMASS, PDAMP, PVISC, PBUSH, PBEAM, PBARL, PBEAML."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.errors import UnsupportedCard
from ringtrue.io.nastran.fields import Card, Files, Reader, places, ragged
from ringtrue.io.nastran.lists import dmig, pcomp, pcompg, rbe1
from ringtrue.io.nastran.sections import SECTIONS
from ringtrue.model.cards import columns
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


def _several(card: str, id_name: str, names: Sequence[str], pitch: int = 0) -> Callable[[Sequence[Card], Files], Table]:
    """A card that holds several rows of 1 + len(names) fields, `pitch` fields apart."""

    def read(cards: Sequence[Card], files: Files) -> Table:
        ids, values, of = [], [], []
        width = pitch or 1 + len(names)
        for c in cards:
            r = Reader(c, files)
            for i in range(0, max(len(c.fields), 1), width):
                if i == 0 or r.text(i):
                    ids.append(r.whole(i, id_name))
                    values.append([r.real(i + 1 + k, name, 0.0) for k, name in enumerate(names)])
                    of.append(c)
        data = np.array(values, dtype=np.float64).reshape(-1, len(names))
        made: dict[str, NDArray[Any]] = {id_name: np.array(ids, dtype=np.int64)}
        made |= {name: data[:, k] for k, name in enumerate(names)}
        return Table(card, made, *places(of))

    return read


def _mpc(cards: Sequence[Card], files: Files) -> Table:
    sid, g, comp, a = [], [], [], []
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
    eid, ref, refc, g, comp, w, gm, cm = [], [], [], [], [], [], [], []
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
    i, weight, comp, fresh = 4, 1.0, "", False
    while i < len(r.card.fields):
        t = r.text(i).upper()
        if t in ("UM", "ALPHA"):
            break
        if not t:
            i += 1
        elif not t.lstrip("+-").isdigit():
            weight, comp, fresh = r.real(i, "WT"), r.text(i + 1), True
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


FLAGS = {"K": [f"K{i}" for i in range(1, 7)], "B": [f"B{i}" for i in range(1, 7)], "GE": ["GE"], "M": ["M"]}


def _pbush(cards: Sequence[Card], files: Files) -> Table:
    names = [n for f in FLAGS.values() for n in f]
    cols: dict[str, list[float]] = {n: [] for n in names}
    pid = []
    for c in cards:
        r = Reader(c, files)
        pid.append(r.whole(0, "PID"))
        row = dict.fromkeys(names, 0.0)
        for start in range(1, len(c.fields), 8):
            flag = r.text(start).upper()
            if flag == "RIGID":
                raise r.fail("K", "RIGID is not supported; use RBE2")
            if flag and flag not in (*FLAGS, "RCV", "T", "D"):
                raise r.fail("flag", f"{flag!r}: allowed are K, B, GE, M, RCV")
            for k, name in enumerate(FLAGS.get(flag, [])):
                row[name] = r.real(start + 1 + k, name, 0.0)
        for name, value in row.items():
            cols[name].append(value)
    data = {"PID": np.array(pid, dtype=np.int64)} | {n: np.array(v, dtype=np.float64) for n, v in cols.items()}
    return Table("PBUSH", data, *places(cards))


END_A = ("A", "I1", "I2", "I12", "J", "NSM")
END_B = ("AB", "I1B", "I2B", "I12B", "JB", "NSMB")
_TAIL = ("K1", "K2", "S1", "S2", "NSIA", "NSIB", "CWA", "CWB")
_TAIL2 = ("M1A", "M2A", "M1B", "M2B", "N1A", "N2A", "N1B", "N2B")
_CENTRE = ("N1", "N2")  # of a section: neutral axis from shear centre, which a PBARL leaves out
_STATION = ("YES", "YESA", "NO")


def _pbeam(cards: Sequence[Card], files: Files) -> Table:
    rows: list[dict[str, float]] = []
    head: list[tuple[int, int]] = []
    for c in cards:
        r = Reader(c, files)
        head.append((r.whole(0, "PID"), r.whole(1, "MID")))
        rows.append(_beam_row(r))
    names = list(rows[0]) if rows else []
    data: dict[str, NDArray[Any]] = {
        "PID": np.array([h[0] for h in head], dtype=np.int64),
        "MID": np.array([h[1] for h in head], dtype=np.int64),
    }
    data |= {n: np.array([row[n] for row in rows], dtype=np.float64) for n in names}
    return Table("PBEAM", data, *places(cards))


def _stations(r: Reader) -> tuple[list[tuple[float, int]], int]:
    """(x / length, place of its A) of the stations behind end A, and where the fields behind the stations begin."""
    at = 8 if r.text(8).upper() in _STATION else 16  # the stress points may be left out
    found = []
    while (flag := r.text(at).upper()) in _STATION:
        found.append((r.real(at + 1, "X/XB", 1.0), at + 2))
        at += 16 if flag == "YES" and r.text(at + 8).upper() not in _STATION else 8  # YESA and NO: no stress points
    return found, at


def beam_stations(card: Card, files: Files) -> tuple[list[tuple[float, int]], int]:
    """Stations behind end A of a PBEAM: x / length with the place of A, and the field behind the stations."""
    return _stations(Reader(card, files))


def _straight(r: Reader, name: str, x: float, value: float, a: float, b: float) -> None:
    """Refuse a station at `x` whose value is not on the straight line from end A to end B."""
    if abs(value - a - x * (b - a)) > 1e-6 * max(abs(a), abs(b)):
        why = f"{name} at the station {x} is not on the straight line between the ends"
        raise UnsupportedCard(r.card.name, path=r.files[r.card.file], line=r.card.line, why=why)


def _beam_row(r: Reader) -> dict[str, float]:
    row = {n: r.real(2 + k, n, 0.0) for k, n in enumerate(END_A)}
    row |= dict(zip(END_B, row.values(), strict=True))
    stations, at = _stations(r)
    for x, place in stations:
        if x == 1.0:
            row |= {b: r.real(place + k, b, row[a]) for k, (a, b) in enumerate(zip(END_A, END_B, strict=True))}
    for x, place in stations:
        for k, (a, b) in enumerate(zip(END_A, END_B, strict=True)):
            _straight(r, a, x, r.real(place + k, a, row[a] + x * (row[b] - row[a])), row[a], row[b])
    row |= {n: r.real(at + k, n, 1.0 if n in ("K1", "K2") else 0.0) for k, n in enumerate(_TAIL)}
    row |= {n: r.real(at + 8 + k, n, 0.0) for k, n in enumerate(_TAIL2)}
    if not r.text(at + 5):
        row["NSIB"] = row["NSIA"]
    for a, b in (("M1A", "M1B"), ("M2A", "M2B"), ("N1A", "N1B"), ("N2A", "N2B")):
        if not r.text(at + 8 + _TAIL2.index(b)):
            row[b] = row[a]
    return row


def _section(r: Reader, at: int) -> tuple[dict[str, float], int]:
    """Properties of the section whose dimensions begin at field `at`, NSM among them, and the field behind."""
    c, kind = r.card, r.text(3).upper()
    if kind not in SECTIONS:
        why = f"section {kind!r}; supported are {', '.join(sorted(SECTIONS))}"
        raise UnsupportedCard(c.name, path=r.files[c.file], line=c.line, why=why)
    count, section = SECTIONS[kind]
    dims = [r.real(at + k, f"DIM{k + 1}") for k in range(count)]
    try:
        values = section(*dims)
    except ValueError as e:
        raise r.fail("DIM1", str(e)) from None
    return {**values, "NSM": r.real(at + count, "NSM", 0.0)}, at + count + 1


def _bar_row(r: Reader) -> dict[str, float]:
    return _section(r, 8)[0]


def _tapered_row(r: Reader) -> dict[str, float]:
    row, at = _section(r, 8)
    row |= {f"{n}A": row.get(n, 0.0) for n in _CENTRE} | {f"{n}B": row.get(n, 0.0) for n in _CENTRE}
    row |= {b: row.get(a, 0.0) for a, b in zip(END_A, END_B, strict=True)}
    between: list[tuple[float, dict[str, float]]] = []
    while r.text(at).upper() in _STATION:
        x = r.real(at + 1, "X/XB", 1.0)
        if not r.text(at + 2):  # a blank section is that of end A
            break
        section, at = _section(r, at + 2)
        if x != 1.0:
            between.append((x, section))
            continue
        row |= {b: section.get(a, 0.0) for a, b in zip(END_A, END_B, strict=True)}
        row |= {f"{n}B": section.get(n, 0.0) for n in _CENTRE}
    for x, section in between:
        for a, b in zip(END_A, END_B, strict=True):
            _straight(r, a, x, section.get(a, 0.0), row.get(a, 0.0), row[b])
    return row


def _from_sections(card: str, read: Callable[[Reader], dict[str, float]], cards: Sequence[Card], files: Files) -> Table:
    rows = []
    for c in cards:
        r = Reader(c, files)
        rows.append({"PID": r.whole(0, "PID"), "MID": r.whole(1, "MID"), **read(r)})
    made = {}
    for spec in columns(card):
        if not spec.blank:
            kind = np.int64 if spec.kind == "i" else np.float64
            made[spec.name] = np.array([row.get(spec.name, spec.default) for row in rows], dtype=kind)
    return Table(card, made, *places(cards))


EXPAND: Mapping[str, Callable[[Sequence[Card], Files], Table]] = MappingProxyType(
    {
        "SPC": _spc,
        "MPC": _mpc,
        "RBE1": rbe1,
        "RBE3": _rbe3,
        "PELAS": _several("PELAS", "PID", ("K", "GE", "S")),
        "PMASS": _several("PMASS", "PID", ("M",)),
        "PDAMP": _several("PDAMP", "PID", ("B",)),
        "PVISC": _several("PVISC", "PID", ("CE", "CR"), 4),
        "PCOMP": pcomp,
        "PCOMPG": pcompg,
        "DMIG": dmig,
        "PBUSH": _pbush,
        "PBEAM": _pbeam,
        "PBARL": partial(_from_sections, "PBAR", _bar_row),  # the table is of PBAR
        "PBEAML": partial(_from_sections, "PBEAM", _tapered_row),  # the table is of PBEAM
    }
)
