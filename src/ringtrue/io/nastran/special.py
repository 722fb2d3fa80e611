"""Cards with a pattern of their own: SPC, MPC, RBE3, PELAS, PMASS, PBUSH, PBEAM, PBARL, PBEAML."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.io.nastran.lexer import integers, real
from ringtrue.io.nastran.sections import SECTIONS
from ringtrue.model.cards import columns
from ringtrue.model.model import Ragged, Table

Files = Sequence[str]


@dataclass(frozen=True, slots=True)
class Card:
    """One card: its name, data fields as text, and where its first line stands."""

    name: str
    fields: list[str]
    file: int
    line: int


def whole(text: str) -> int:
    """One integer; `ValueError` if malformed."""
    value, good = integers(np.array([text.encode("latin-1")]))
    if not good[0]:
        raise ValueError(text)
    return int(value[0])


class _Reader:
    """Reads fields of one card, blaming the right place."""

    def __init__(self, card: Card, files: Files) -> None:
        self.card, self.files = card, files

    def text(self, i: int) -> str:
        return self.card.fields[i] if i < len(self.card.fields) else ""

    def fail(self, name: str, why: str) -> DeckError:
        c = self.card
        return DeckError(why, path=self.files[c.file], line=c.line, card=c.name, field=name)

    def whole(self, i: int, name: str, default: int | None = None) -> int:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return whole(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not an integer") from None

    def real(self, i: int, name: str, default: float | None = None) -> float:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return real(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not a real") from None


def _place(rows: Sequence[Card]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.array([c.file for c in rows], dtype=np.int64), np.array([c.line for c in rows], dtype=np.int64)


def _ragged(rows: Sequence[Sequence[Any]], dtype: Any) -> Ragged:
    values = [v for r in rows for v in r]
    return Ragged(np.array(values, dtype=dtype), np.cumsum([0, *map(len, rows)]).astype(np.int64))


def _spc(cards: Sequence[Card], files: Files) -> Table:
    rows: list[tuple[int, int, str, float]] = []
    from_card = []
    for c in cards:
        r = _Reader(c, files)
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
    return Table("SPC", cols, *_place(from_card))


def _several(card: str, id_name: str, names: Sequence[str]) -> Callable[[Sequence[Card], Files], Table]:
    """A card that holds several rows of 1 + len(names) fields."""

    def read(cards: Sequence[Card], files: Files) -> Table:
        ids, values, of = [], [], []
        width = 1 + len(names)
        for c in cards:
            r = _Reader(c, files)
            for i in range(0, max(len(c.fields), 1), width):
                if i == 0 or r.text(i):
                    ids.append(r.whole(i, id_name))
                    values.append([r.real(i + 1 + k, name, 0.0) for k, name in enumerate(names)])
                    of.append(c)
        data = np.array(values, dtype=np.float64).reshape(-1, len(names))
        made: dict[str, NDArray[Any]] = {id_name: np.array(ids, dtype=np.int64)}
        made |= {name: data[:, k] for k, name in enumerate(names)}
        return Table(card, made, *_place(of))

    return read


def _mpc(cards: Sequence[Card], files: Files) -> Table:
    sid, g, comp, a = [], [], [], []
    for c in cards:
        r = _Reader(c, files)
        sid.append(r.whole(0, "SID"))
        # two terms on a line of eight fields, the first field of a continuation is blank
        at = [i for k in range(0, len(c.fields), 8) for i in (k + 1, k + 4) if r.text(i)]
        g.append([r.whole(i, "G") for i in at])
        comp.append([r.whole(i + 1, "C", 0) for i in at])
        a.append([r.real(i + 2, "A", 0.0) for i in at])
    cols: dict[str, NDArray[Any] | Ragged] = {
        "SID": np.array(sid, dtype=np.int64),
        "G": _ragged(g, np.int64),
        "C": _ragged(comp, np.int64),
        "A": _ragged(a, np.float64),
    }
    return Table("MPC", cols, *_place(cards))


def _rbe3(cards: Sequence[Card], files: Files) -> Table:
    eid, ref, refc, g, comp, w = [], [], [], [], [], []
    for c in cards:
        r = _Reader(c, files)
        eid.append(r.whole(0, "EID"))
        ref.append(r.whole(2, "REFGRID"))
        refc.append(r.text(3))
        nodes, comps, weights = _rbe3_groups(r)
        g.append(nodes)
        comp.append(comps)
        w.append(weights)
    cols: dict[str, NDArray[Any] | Ragged] = {
        "EID": np.array(eid, dtype=np.int64),
        "REFGRID": np.array(ref, dtype=np.int64),
        "REFC": np.array(refc, dtype=np.str_),
        "G": _ragged(g, np.int64),
        "C": _ragged(comp, np.str_),
        "WT": _ragged(w, np.float64),
    }
    return Table("RBE3", cols, *_place(cards))


def _rbe3_groups(r: _Reader) -> tuple[list[int], list[str], list[float]]:
    nodes: list[int] = []
    comps: list[str] = []
    weights: list[float] = []
    i, weight, comp, fresh = 4, 1.0, "", False
    while i < len(r.card.fields):
        t = r.text(i).upper()
        if t in ("UM", "ALPHA"):
            if t == "UM":
                raise r.fail("UM", "an explicit set of dependent DOFs is not supported; leave UM out")
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
        r = _Reader(c, files)
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
    return Table("PBUSH", data, *_place(cards))


END_A = ("A", "I1", "I2", "I12", "J", "NSM")
END_B = ("AB", "I1B", "I2B", "I12B", "JB", "NSMB")
_TAIL = ("K1", "K2", "S1", "S2", "NSIA", "NSIB", "CWA", "CWB")
_TAIL2 = ("M1A", "M2A", "M1B", "M2B", "N1A", "N2A", "N1B", "N2B")
_STATION = ("YES", "YESA", "NO")


def _pbeam(cards: Sequence[Card], files: Files) -> Table:
    rows: list[dict[str, float]] = []
    head: list[tuple[int, int]] = []
    for c in cards:
        r = _Reader(c, files)
        head.append((r.whole(0, "PID"), r.whole(1, "MID")))
        rows.append(_beam_row(r))
    names = list(rows[0]) if rows else []
    data: dict[str, NDArray[Any]] = {
        "PID": np.array([h[0] for h in head], dtype=np.int64),
        "MID": np.array([h[1] for h in head], dtype=np.int64),
    }
    data |= {n: np.array([row[n] for row in rows], dtype=np.float64) for n in names}
    return Table("PBEAM", data, *_place(cards))


def _stations(r: _Reader) -> tuple[list[tuple[float, int]], int]:
    """(x / length, place of its A) of the stations behind end A, and where the fields behind the stations begin."""
    at = 8 if r.text(8).upper() in _STATION else 16  # the stress points may be left out
    found = []
    while (flag := r.text(at).upper()) in _STATION:
        found.append((r.real(at + 1, "X/XB", 1.0), at + 2))
        at += 16 if flag == "YES" and r.text(at + 8).upper() not in _STATION else 8  # YESA and NO: no stress points
    return found, at


def beam_stations(card: Card, files: Files) -> tuple[list[tuple[float, int]], int]:
    """Stations behind end A of a PBEAM: x / length with the place of A, and the field behind the stations."""
    return _stations(_Reader(card, files))


def _beam_row(r: _Reader) -> dict[str, float]:
    row = {n: r.real(2 + k, n, 0.0) for k, n in enumerate(END_A)}
    row |= dict(zip(END_B, row.values(), strict=True))
    stations, at = _stations(r)
    for x, place in stations:
        if x == 1.0:
            row |= {b: r.real(place + k, b, row[a]) for k, (a, b) in enumerate(zip(END_A, END_B, strict=True))}
    for x, place in stations:
        for k, (a, b) in enumerate(zip(END_A, END_B, strict=True)):
            straight = row[a] + x * (row[b] - row[a])
            if abs(r.real(place + k, a, straight) - straight) > 1e-6 * max(abs(row[a]), abs(row[b])):
                why = f"{a} at the station {x} is not on the straight line between the ends"
                raise UnsupportedCard("PBEAM", path=r.files[r.card.file], line=r.card.line, why=why)
    row |= {n: r.real(at + k, n, 1.0 if n in ("K1", "K2") else 0.0) for k, n in enumerate(_TAIL)}
    row |= {n: r.real(at + 8 + k, n, 0.0) for k, n in enumerate(_TAIL2)}
    if not r.text(at + 5):
        row["NSIB"] = row["NSIA"]
    for a, b in (("M1A", "M1B"), ("M2A", "M2B"), ("N1A", "N1B"), ("N2A", "N2B")):
        if not r.text(at + 8 + _TAIL2.index(b)):
            row[b] = row[a]
    return row


def _section(r: _Reader, at: int) -> tuple[dict[str, float], int]:
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


def _bar_row(r: _Reader) -> dict[str, float]:
    return _section(r, 8)[0]


def _tapered_row(r: _Reader) -> dict[str, float]:
    row, at = _section(r, 8)
    row |= {b: row.get(a, 0.0) for a, b in zip(END_A, END_B, strict=True)}
    while r.text(at).upper() in _STATION:
        if r.real(at + 1, "X/XB", 1.0) != 1.0:
            c = r.card
            raise UnsupportedCard("PBEAML", path=r.files[c.file], line=c.line, why="a station between the ends")
        if not r.text(at + 2):  # a blank section is that of end A
            break
        end, at = _section(r, at + 2)
        row |= {b: end.get(a, 0.0) for a, b in zip(END_A, END_B, strict=True)}
    return row


def _from_sections(
    card: str, read: Callable[[_Reader], dict[str, float]], cards: Sequence[Card], files: Files
) -> Table:
    rows = []
    for c in cards:
        r = _Reader(c, files)
        rows.append({"PID": r.whole(0, "PID"), "MID": r.whole(1, "MID"), **read(r)})
    made = {}
    for spec in columns(card):
        if not spec.blank:
            kind = np.int64 if spec.kind == "i" else np.float64
            made[spec.name] = np.array([row.get(spec.name, spec.default) for row in rows], dtype=kind)
    return Table(card, made, *_place(cards))


EXPAND: Mapping[str, Callable[[Sequence[Card], Files], Table]] = MappingProxyType(
    {
        "SPC": _spc,
        "MPC": _mpc,
        "RBE3": _rbe3,
        "PELAS": _several("PELAS", "PID", ("K", "GE", "S")),
        "PMASS": _several("PMASS", "PID", ("M",)),
        "PBUSH": _pbush,
        "PBEAM": _pbeam,
        "PBARL": partial(_from_sections, "PBAR", _bar_row),  # the table is of PBAR
        "PBEAML": partial(_from_sections, "PBEAM", _tapered_row),  # the table is of PBEAM
    }
)
