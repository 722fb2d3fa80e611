"""The model that an OP2 file holds: cards of its data blocks GEOM1 to GEOM4, EPT, MPT and DYNAMICS,
PARAMs of PVT and choices of CASECC; points and frames of BGPDT and CSTM where GEOM1 has none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float, Int
from ringtrue.decks.nastran.beams import BEAM_TAIL, BETWEEN
from ringtrue.decks.nastran.lexer import Card, Row, table_of_rows
from ringtrue.decks.nastran.loads import LINE_KINDS, LINE_SCALES
from ringtrue.decks.nastran.results.op2 import Op2Table, read_tables
from ringtrue.decks.nastran.results.records import (
    LISTED,
    OTHERS,
    POINT_BLOCKS,
    Key,
    Layout,
    frames,
    grids,
    layouts,
)
from ringtrue.decks.nastran.writer import Value, large_card, write_bulk
from ringtrue.errors import DataError, about
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import door
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.model.cards import CARDS, END_A, END_B, MADE, SPECIAL, columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Model, Table, stacked, table
from ringtrue.model.sections import SECTIONS

_WANTED = ("GEOM", "EPT", "MPT", "DYNAMIC", "PVT", "CASECC", *POINT_BLOCKS)
_BLOCK = re.compile(r"(GEOM[1-4]|EPT|MPT|DYNAMICS?)[SN]?")
_END = 65535
_BLANK = 0x22002739  # a real field that is blank
# numbers, also those that Nastran gives itself, are below; reals above
_MOST = 499_999_999
_SMALLEST = 1e-35  # a word below, but for 0, is an integer and no real
_OWN = 99_999_999  # above are numbers that Nastran gives
_LEFT_OUT = ("POST", "OGEOM", "OUGCORD")  # PARAMs of output
_SINGLE = 2e-7  # relative error of single precision
_MCID = 512  # THETA holds 512 (MCID + 1)


@dataclass(frozen=True, slots=True)
class Subcase:
    """Sets that a subcase chooses; 0 for none."""

    id: int
    mpc: int
    spc: int
    load: int
    method: int


@dataclass(frozen=True, slots=True, eq=False)
class RecordedModel:
    """What an OP2 file holds of its deck.

    Attributes
    ----------
    model : Model
    texts : tuple of str
        Cards of sections (PBARL, PBEAML) and of static loads.
    subcases : tuple of Subcase
        Empty where the file has no CASECC.
    missing : mapping of str to int
        Records that are not rebuilt, "GEOM4 USET", and their words.
    """

    model: Model
    texts: tuple[str, ...]
    subcases: tuple[Subcase, ...]
    missing: dict[str, int]

    def deck(self) -> str:
        """The deck: executive and case control, and the cards."""
        method = any(s.method for s in self.subcases) or any(
            c in self.model for c in METHODS
        )
        lines = [
            f"SOL {103 if method else 101}",
            "CEND",
            *self._case(method),
            "BEGIN BULK",
        ]
        if self.missing:
            lines += ["$ in the file and not rebuilt:"]
            lines += [
                f"$ {name}, {words} words" for name, words in self.missing.items()
            ]
        bulk = write_bulk(self.model, without=_LEFT_OUT)
        return "\n".join(lines) + "\n" + bulk + "".join(self.texts) + "ENDDATA\n"

    def _case(self, method: bool) -> list[str]:
        out = []
        for s in self.subcases or (self._only(),):
            chosen = {"SPC": s.spc, "MPC": s.mpc, "METHOD": s.method}
            if not method:
                chosen["LOAD"] = s.load
            out += [
                f"SUBCASE {s.id}",
                *(f"  {k} = {v}" for k, v in chosen.items() if v),
            ]
        return out

    def _only(self) -> Subcase:
        """The only set of each kind, of a file without case control."""
        tables = self.model.tables

        def only(*cards: str) -> int:
            for names in cards:
                ids = [
                    t.ids
                    for c in names.split()
                    if (t := tables.get(c)) is not None and len(t)
                ]
                found = (
                    np.unique(np.concatenate(ids))
                    if ids
                    else np.empty(0, dtype=np.int64)
                )
                if found.size:
                    return int(found[0]) if found.size == 1 else 0
            return 0

        cards = [(text[:8].rstrip(" *"), int(text[8:24])) for text in self.texts]
        loads = [(card, sid) for card, sid in cards if card not in MADE]
        sets = {s for c, s in loads if c == "LOAD"} or {s for _, s in loads}
        return Subcase(
            1,
            only("MPCADD", "MPC"),
            only("SPCADD", "SPC SPC1"),
            sets.pop() if len(sets) == 1 else 0,
            only(" ".join(METHODS)),
        )


def read_recorded_model(path: str | Path) -> RecordedModel:
    """The model of the data blocks of an OP2 file.

    Reals of single precision are the shortest decimals that name them, as a deck has them.

    Raises
    ------
    DataError
        If the file is missing, damaged or holds no cards.
    """
    path = existing(path)
    if format_of(path) is not Format.OP2:
        refuse_format(path, "deck in results", (Format.OP2,))
    with about(path), door(path, "OP2 file"):
        return _read(path)


def held_model(path: str | Path, nodes: Int) -> Model | None:
    """The model of an OP2 file if it has all these nodes (n,), else None.

    Raises
    ------
    DataError
        If one of them moves in a frame that the file does not define.
    """
    with about(path), door(path, "OP2 file"):
        model = _read(Path(path), refuse=False).model
    at = model["GRID"].find(nodes) if "GRID" in model else np.full(nodes.size, -1)
    if (at < 0).any():
        return None
    frames = model["GRID"]["CD"][at]
    defined = [t.ids for card, t in model.tables.items() if card.startswith("CORD")]
    lost = np.flatnonzero(~np.isin(frames, np.concatenate([[0], *defined])))
    if lost.size:
        raise DataError(
            f"{path}: node {nodes[lost[0]]} moves in displacement frame {frames[lost[0]]}, which "
            "the file does not define; name the deck, too, to turn its shapes to the basic frame"
        )
    return model


def _read(path: Path, refuse: bool = True) -> RecordedModel:
    found = _RecordedDeck()
    held: list[str] = []
    places: dict[str, Op2Table] = {}
    for block in read_tables(path, lambda name: name.startswith(_WANTED)):
        held.append(block.name)
        kind = _BLOCK.fullmatch(block.name)
        if kind and kind[1] not in found.blocks:
            found.blocks.add(kind[1])
            for body in block.bodies():
                found.record(kind[1], _Words(block, body))
        elif block.name.startswith("PVT") and not found.params:
            for body in block.bodies():
                found.params |= _params(_Words(block, body))
        elif block.name.startswith("CASECC") and not found.subcases:
            for body in block.bodies():
                id_, mpc, spc, load, method = block.ints(body)[:5].tolist()
                found.subcases.append(Subcase(id_, mpc, spc, load, method))
        elif block.name.startswith(POINT_BLOCKS):
            places.setdefault(block.name.rstrip("S"), block)
    if "GRID" not in found.tables:
        found.tables |= grids(places)
    found.tables |= frames(places, found.tables)
    given = found.given()
    if not given and refuse:
        names = ", ".join(dict.fromkeys(held)) or "nothing"
        raise DataError(
            f"no cards of a deck in the file; it holds {names}; "
            "ask for GEOM1 to GEOM4, EPT and MPT by PARAM,POST,-1 and PARAM,OGEOM,YES"
        )
    model = Model(given, found.params, files=(str(path),))
    subcases = tuple(s for s in found.subcases if s.id <= _MOST)
    return RecordedModel(model, tuple(found.texts), subcases, found.missing)


class _Words:
    """The words of a record, as integers, reals and texts."""

    def __init__(self, block: Op2Table, body: bytes) -> None:
        self.block = block
        self.body = body
        self.ints = block.ints(body)

    @cached_property
    def reals(self) -> Float:
        """The words as reals, nan for blank ones."""
        return self.decimals(self.block.floats(self.body), self.ints)

    def decimals(self, values: Float, words: Int) -> Float:
        """Reals as a deck has them, nan for those whose words are blank; all (k,)."""
        return np.where(words == _BLANK, np.nan, self.block.decimals(values))

    def text(self, at: int, count: int = 1) -> str:
        """The text of words."""
        size = self.block.word
        words = (self.body[i * size : i * size + 4] for i in range(at, at + count))
        return b"".join(words).decode("ascii").strip("\x00 ")


class _RecordedDeck:
    def __init__(self) -> None:
        self.blocks: set[str] = set()
        self.tables: dict[str, Table] = {}
        self.params: dict[str, int | float | str] = {}
        self.subcases: list[Subcase] = []
        self.texts: list[str] = []
        self.missing: dict[str, int] = {}
        self.through: list[Row] = []  # SPC1 of a range
        self.sections: dict[str, list[int]] = {}

    def record(self, block: str, words: _Words) -> None:
        """Take a record in, or name it."""
        if words.ints.size < 3 or words.ints[0] == _END:
            return
        key = (block, int(words.ints[0]), int(words.ints[1]))
        card = LISTED.get(key, "")
        try:
            if card in _LISTS:
                self._rows(card, list(_LISTS[card](words)))
                return
            if self._fixed(key, words):
                return
        except (IndexError, ValueError):
            pass  # of a form that is not known: named below
        known = layouts().get(key)
        name = card or (known[0].card if known else "") or OTHERS.get(key, "")
        named = f"{block} {name or 'record'} {tuple(words.ints[:3].tolist())}"
        self.missing[named] = self.missing.get(named, 0) + words.ints.size - 3

    def _rows(self, card: str, rows: list[Row]) -> None:
        if card in MADE or card == "LOAD":
            self.texts += [large_card(card, row["FIELDS"]) for row in rows]
            if card in MADE:
                self.sections[MADE[card]] = [row["PID"] for row in rows]
        elif rows:
            self.through += [row for row in rows if "THRU" in row]
            rows = [row for row in rows if "THRU" not in row]
            place = Card(card, [], -1, 0)
            self._add(table_of_rows(card, [(place, row) for row in rows]))

    def _add_ranges(self) -> None:
        """SPC1 from a first to a last number, of the points that are there."""
        known = [
            self.tables[c].entries("ID")[0]
            for c in ("GRID", "SPOINT")
            if c in self.tables
        ]
        points = np.concatenate([np.empty(0, dtype=np.int64), *known])
        for row in self.through:
            first, last = row["G"]
            held = points[(points >= first) & (points <= last)].tolist()
            made = {"SID": row["SID"], "C": row["C"], "G": held}
            self._add(table_of_rows("SPC1", [(Card("SPC1", [], -1, 0), made)]))

    def given(self) -> dict[str, Table]:
        """The tables without what Nastran makes itself: PBAR and PBEAM of sections, PSHELL and MAT2
        of laminates, PCOMP of PCOMPG, GRID and CORD2R of aerodynamic boxes.
        """
        self._add_ranges()
        out = dict(self.tables)
        made = dict(self.sections)
        laminates = [out[c].ids for c in ("PCOMP", "PCOMPG") if c in out]
        of_nastran = {"GRID": ("ID", "CP", "CD"), "CORD2R": ("CID",)}
        if laminates:
            made["PSHELL"] = np.concatenate(laminates).tolist()
            of_nastran["MAT2"] = ("MID",)
        for card, fields in of_nastran.items():
            if card in out:
                own = (out[card].stack(*fields) > _OWN).any(axis=1)
                made[card] = out[card].ids[own].tolist()
        if "PCOMPG" in out:
            made["PCOMP"] = out["PCOMPG"].ids.tolist()
        for card, ids in made.items():
            if card in out:
                out[card] = out[card].take(np.flatnonzero(~np.isin(out[card].ids, ids)))
        return {card: t for card, t in out.items() if len(t)}

    def _fixed(self, key: Key, words: _Words) -> bool:
        for layout in layouts().get(key, ()):
            made = _columns(layout, words)
            if made is None:
                continue
            if layout.card in CARDS or layout.card in SPECIAL:
                self._add(_of_columns(layout.card, made))
            else:
                self.texts += _loads(layout.card, made)
            return True
        return False

    def _add(self, new: Table) -> None:
        old = self.tables.get(new.card)
        self.tables[new.card] = new if old is None else stacked(old, new)


Columns = dict[str, NDArray[Any]]


def _columns(layout: Layout, words: _Words) -> Columns | None:
    """Columns of the rows of a record; None where its words are not those of the layout."""
    ints = words.ints[3:]
    double = (
        _double(layout, words) if layout.card.startswith(("GRID", "CORD2")) else None
    )
    if double is not None:
        return double
    width = len(layout.words)
    if not ints.size or ints.size % width:
        return None
    whole = ints.reshape(-1, width)
    real = words.block.floats(words.body)[3:].reshape(-1, width)
    if (whole[:, 0] <= 0).any() or (whole[:, 0] > _MOST).any():
        return None
    made: Columns = {}
    for k, word in enumerate(layout.words):
        if word.kind == "f":
            if not _are_reals(real[:, k]) and word.name != "X1":
                return None
            made[word.name] = words.decimals(real[:, k], whole[:, k])
        elif word.kind == "t":
            rows = range(whole.shape[0])
            made[word.name] = np.array([words.text(3 + i * width + k) for i in rows])
        elif word.name != "_":
            if (np.abs(whole[:, k]) > _MOST).any():
                return None
            made[word.name] = whole[:, k]
    if "X1" in made and "F" in made:
        at = [w.name for w in layout.words].index("X1")
        return _oriented(made, whole[:, at])
    return made


def _are_reals(values: Float) -> bool:
    size = np.abs(values)
    return bool((np.isfinite(values) & ((size == 0) | (size > _SMALLEST))).all())


def _double(layout: Layout, words: _Words) -> Columns | None:
    """Columns of a GRID or CORD2 whose coordinates are of double precision, two words each."""
    if words.block.word == 8:
        return None
    kinds = [w.kind for w in layout.words]
    fields = [(w.name, "i4" if w.kind != "f" else "f8") for w in layout.words]
    fields = [(n if n != "_" else f"_{k}", kind) for k, (n, kind) in enumerate(fields)]
    record = np.dtype([(n, words.block.order + kind) for n, kind in fields])
    body = words.body[12:]
    single = 4 * len(kinds)
    if not body or len(body) % record.itemsize:
        return None
    rows = np.frombuffer(body, record)
    made = {w.name: rows[w.name] for w in layout.words if w.name != "_"}
    real = all(_are_reals(made[w.name]) for w in layout.words if w.kind == "f")
    first = made[layout.words[0].name]
    numbers = (first > 0).all() and (first <= _MOST).all()
    if not real or not numbers or np.unique(first).size != first.size:
        return None
    # both widths fit: the one whose other integers are numbers counts
    if not len(body) % single:
        others = [made[w.name] for w in layout.words if w.kind != "f" and w.name != "_"]
        if any((np.abs(v) > _MOST).any() for v in others):
            return None
        if words.ints[3:].reshape(-1, len(kinds))[:, 0].min() > 0:
            return None
    return {
        n: v.astype(np.float64 if v.dtype.kind == "f" else np.int64)
        for n, v in made.items()
    }


def _oriented(made: Columns, node: Int) -> Columns | None:
    """X1 is a node where F is 2; F 0 says that the vector is in the basic frame."""
    flag = made.pop("F")
    if not np.isin(flag, (-1, 0, 1, 2)).all():
        return None
    by_node = flag == 2
    if not _are_reals(made["X1"][~by_node]):
        return None
    made["G0"] = np.where(by_node, node, 0)
    for name in ("X1", "X2", "X3"):
        made[name] = np.where(by_node, 0.0, made[name])
    if "W1A" in made:
        vector = (made["X1"] != 0) | (made["X2"] != 0) | (made["X3"] != 0)
        made["OFFT"] = np.where((flag == 0) & vector, "BGG", "GGG")
    return made


_NEGATIVE_IS_BLANK = frozenset({"T1", "T2", "T3", "T4"})
_ZERO_IS_BLANK = frozenset({"K1", "K2", "Z1", "Z2"})


def _of_columns(card: str, made: Columns) -> Table:
    """A table of the columns of a record, as a deck has them."""
    n = next(iter(made.values())).size
    out: dict[str, Any] = {}
    if "THETA" in made:
        theta = made["THETA"]
        coded = (theta >= _MCID) & (theta % _MCID == 0)
        made["MCID"] = np.where(coded, theta // _MCID - 1, -1).astype(np.int64)
        made["THETA"] = np.where(coded, 0.0, theta)
    for spec in columns(card):
        if spec.blank:
            continue
        if spec.other:
            none = np.full(n, spec.other_default)
            out[spec.other] = made.get(spec.other, none)
        given = made.get(spec.name)
        out[spec.name] = (
            np.full(n, spec.default) if given is None else _typed(spec.kind, given)
        )
        if spec.kind == "f":
            out[spec.name] = np.where(
                np.isnan(out[spec.name]), spec.default, out[spec.name]
            )
        if (
            spec.kind == "f"
            and card.startswith("C")
            and spec.name in _NEGATIVE_IS_BLANK
        ):
            out[spec.name] = np.where(out[spec.name] < 0, np.nan, out[spec.name])
        if card in ("PBAR", "PSHELL") and spec.name in _ZERO_IS_BLANK:
            out[spec.name] = np.where(out[spec.name] == 0, np.nan, out[spec.name])
        if spec.kind == "i" and spec.default == 0:
            out[spec.name] = np.maximum(out[spec.name], 0)
    if card == "MAT1":  # Nastran gives the third modulus, too
        e, g, nu = (out[name] for name in ("E", "G", "NU"))
        implied = np.isclose(g, e / (2 * (1 + nu)), rtol=_SINGLE, atol=0)
        out["G"] = np.where(implied, np.nan, g)
    return table(card, **out)


def _typed(kind: str, values: NDArray[Any]) -> NDArray[Any]:
    if kind in "cs" and values.dtype.kind == "i":
        return np.where(values > 0, values.astype(str), "")
    return np.where(values == "SMEC", "", values) if kind == "s" else values


def _parts(ints: Int, start: int = 3) -> Iterator[tuple[int, int]]:
    """First and last place of the runs that -1 ends."""
    for end in np.flatnonzero(ints == -1).tolist():
        if end >= start:
            yield start, end
            start = end + 1
    if start != ints.size:
        raise ValueError("a row without its end")


def _spoint(w: _Words) -> Iterator[Row]:
    yield {"ID": w.ints[3:].tolist()}


def _spc1(w: _Words) -> Iterator[Row]:
    at = 3
    while at < w.ints.size:
        sid, components, through = w.ints[at : at + 3].tolist()
        at += 3
        end = at + 2 if through == 1 else at + int(np.flatnonzero(w.ints[at:] == -1)[0])
        row: dict[str, Any] = {
            "SID": sid,
            "C": str(components),
            "G": w.ints[at:end].tolist(),
        }
        if through == 1:
            row["THRU"] = True
        yield row
        at = end if through == 1 else end + 1


def _united(w: _Words) -> Iterator[Row]:
    for start, end in _parts(w.ints):
        yield {"SID": int(w.ints[start]), "S": w.ints[start + 1 : end].tolist()}


def _mpc(w: _Words) -> Iterator[Row]:
    at = 3
    while at < w.ints.size:
        row: dict[str, Any] = {"SID": int(w.ints[at]), "G": [], "C": [], "A": []}
        at += 1
        while w.ints[at] != -1:
            row["G"].append(int(w.ints[at]))
            row["C"].append(int(w.ints[at + 1]))
            row["A"].append(float(w.reals[at + 2]))
            at += 3
        at += 3
        yield row


def _rbe2(w: _Words) -> Iterator[Row]:
    """ALPHA (and TREF) may follow the -1."""
    at = 3
    ends = np.flatnonzero(w.ints == -1)
    tail = 0
    while at < w.ints.size:
        end = int(ends[ends > at + 2][0])
        yield {
            "EID": int(w.ints[at]),
            "GN": int(w.ints[at + 1]),
            "CM": str(w.ints[at + 2]),
            "GM": w.ints[at + 3 : end].tolist(),
        }
        at = end + 1
        tail = 0
        while at < w.ints.size and tail < 2 and not 0 < w.ints[at] <= _MOST:
            at += 1
            tail += 1


def _rbe3(w: _Words) -> Iterator[Row]:
    """Groups of weight, components and nodes, each up to -1, and all up to -2; UM up to -3, and
    ALPHA (and TREF) may follow.
    """
    at = 3
    while at < w.ints.size:
        eid, reference, components = w.ints[at : at + 3].tolist()
        row: dict[str, Any] = {
            "EID": eid,
            "REFGRID": reference,
            "REFC": str(components),
        }
        row |= {"G": [], "C": [], "WT": [], "GM": [], "CM": []}
        at += 3
        while w.ints[at] != -2:
            weight = float(w.reals[at])
            component = str(w.ints[at + 1])
            at += 2
            while w.ints[at] > 0:
                row["G"].append(int(w.ints[at]))
                row["C"].append(component)
                row["WT"].append(weight)
                at += 1
            at += int(w.ints[at] == -1)
        at += 1
        while w.ints[at] != -3:
            row["GM"].append(int(w.ints[at]))
            row["CM"].append(str(w.ints[at + 1]))
            at += 2
        at += 1
        while at < w.ints.size and not 0 < w.ints[at] <= _MOST:
            at += 1
        yield row


def _laminate(w: _Words, at: int) -> Row:
    """Z0, NSM, SB, FT, TREF and GE of a laminate."""
    z0, nsm, sb = w.reals[at : at + 3].tolist()
    failure = ("", "HILL", "HOFF", "TSAI", "STRN")
    tref, ge = w.reals[at + 4 : at + 6].tolist()
    ft = int(w.ints[at + 3])
    return {"Z0": z0, "NSM": nsm, "SB": sb, "FT": failure[ft], "TREF": tref, "GE": ge}


def _plies(w: _Words, starts: Iterable[int]) -> Row:
    row: dict[str, Any] = {"MID": [], "T": [], "THETA": [], "SOUT": []}
    for at in starts:
        row["MID"].append(int(w.ints[at]))
        row["T"].append(float(w.reals[at + 1]))
        row["THETA"].append(float(w.reals[at + 2]))
        row["SOUT"].append("YES" if w.ints[at + 3] == 1 else "NO")
    return row


def _pcomp(w: _Words) -> Iterator[Row]:
    at = 3
    while at < w.ints.size:
        pid, count = w.ints[at : at + 2].tolist()
        plies = range(at + 8, at + 8 + 4 * abs(count), 4)
        lam = "SYM" if count < 0 else ""
        yield {"PID": pid, "LAM": lam, **_laminate(w, at + 2), **_plies(w, plies)}
        at = plies.stop


def _pcompg(w: _Words) -> Iterator[Row]:
    at = 3
    while at < w.ints.size:
        pid, option = w.ints[at : at + 2].tolist()
        lam = ("", "SYM", "MEM", "BEND", "SMEAR", "SMCORE")[option]
        head = _laminate(w, at + 2)
        at += 8
        starts = []
        while w.ints[at] != -1:
            starts.append(at)
            at += 5
        at += 5
        numbers = [int(w.ints[k]) for k in starts]
        yield {
            "PID": pid,
            "LAM": lam,
            **head,
            "GPLYID": numbers,
            **_plies(w, (k + 1 for k in starts)),
        }


def _pbarl(w: _Words) -> Iterator[Row]:
    for start, end in _parts(w.ints):
        pid, mid = w.ints[start : start + 2].tolist()
        values = w.reals[start + 6 : end].tolist()
        yield {
            "PID": pid,
            "FIELDS": [pid, mid, None, w.text(start + 4, 2), *[None] * 4, *values],
        }


def _pbeaml(w: _Words) -> Iterator[Row]:
    """Stations: SO, X, dimensions, NSM; of those between the ends blank ones have X 0."""
    for start, end in _parts(w.ints):
        pid, mid = w.ints[start : start + 2].tolist()
        kind = w.text(start + 4, 2)
        if kind not in SECTIONS:
            raise ValueError(f"section {kind}")
        size = SECTIONS[kind][0] + 3
        if (end - start - 6) % size:
            raise ValueError("a station cut short")
        fields: list[Value] = [pid, mid, None, kind, *[None] * 4]
        for at in range(start + 6, end, size):
            x, *values = w.reals[at + 1 : at + size].tolist()
            if at == start + 6:
                fields += values
            elif x > 0:
                fields += ["YES", x, *values]
        yield {"PID": pid, "FIELDS": fields}


def _pbeam(w: _Words) -> Iterator[Row]:
    """Eleven stations of sixteen words, two of them the ends; blank ones hold zeros."""
    size = 5 + 11 * 16 + 16
    if (w.ints.size - 3) % size:
        raise ValueError("not of eleven stations")
    for at in range(3, w.ints.size, size):
        stations = w.reals[at + 5 : at + 5 + 176].reshape(11, 16)[:, 1:8]
        given = stations[(stations[:, 1:] != 0).any(axis=1)]
        first = given[given[:, 0] == 0][0]
        last = given[given[:, 0] == 1]
        inside = given[(given[:, 0] > 0) & (given[:, 0] < 1)]
        tail = w.reals[at + 5 + 176 : at + size]
        row: dict[str, Any] = {"PID": int(w.ints[at]), "MID": int(w.ints[at + 1])}
        row |= dict(zip(END_A, first[1:].tolist(), strict=True))
        row |= dict(
            zip(END_B, (last[0] if last.size else first)[1:].tolist(), strict=True)
        )
        row |= dict(zip(("X", *BETWEEN), inside.T.tolist(), strict=True))
        row |= dict(zip(BEAM_TAIL, tail.tolist(), strict=True))
        yield row


def _eigrl(w: _Words) -> Iterator[Row]:
    """Words: SID, V1, V2, ND, MSGLVL, MAXSET, SHFSCL, two flags that are -1 where V1 and V2 are
    blank, NORM.
    """
    at = 3
    while at < w.ints.size:
        v = [float(x) for x in w.reals[at + 1 : at + 3]]
        flags = w.ints[at + 7 : at + 9].tolist()
        limits = [
            np.nan if x == 0 and f < 0 else x for x, f in zip(v, flags, strict=True)
        ]
        row: dict[str, Any] = {"SID": int(w.ints[at]), "V1": limits[0], "V2": limits[1]}
        row |= {"ND": max(int(w.ints[at + 3]), 0), "NORM": w.text(at + 9)}
        yield row
        at += 18 + 9
        if at > w.ints.size:
            raise ValueError("EIGRL of another length")


def _load(w: _Words) -> Iterator[Row]:
    at = 3
    while at < w.ints.size:
        fields: list[Value] = [int(w.ints[at]), float(w.reals[at + 1])]
        at += 2
        while w.ints[at] != -1:
            fields += [float(w.reals[at]), int(w.ints[at + 1])]
            at += 2
        at += 2
        yield {"FIELDS": fields}


_LISTS: dict[str, Callable[[_Words], Iterator[Row]]] = {
    "SPOINT": _spoint,
    "SPC1": _spc1,
    "SPCADD": _united,
    "MPCADD": _united,
    "MPC": _mpc,
    "RBE2": _rbe2,
    "RBE3": _rbe3,
    "PCOMP": _pcomp,
    "PCOMPG": _pcompg,
    "PBARL": _pbarl,
    "PBEAML": _pbeaml,
    "PBEAM": _pbeam,
    "EIGRL": _eigrl,
    "LOAD": _load,
}


def _loads(card: str, made: Columns) -> list[str]:
    """Load cards as text."""
    rows = zip(*(column.tolist() for column in made.values()), strict=True)
    out = []
    for values in rows:
        row: dict[str, Any] = dict(zip(made, values, strict=True))
        fields: list[Value] = list(values)
        if card == "PLOAD1":
            fields[2:4] = LINE_KINDS[row["KIND"] - 1], LINE_SCALES[row["SCALE"] - 1]
        elif card == "PLOAD4":
            corner = [row["G1"] or None, row["G3"] or None]
            vector = [row["CID"], row["N1"], row["N2"], row["N3"]]
            fields = [*values[:6], *corner, *(vector if any(vector[1:]) else [])]
        blank = [isinstance(v, float) and np.isnan(v) for v in fields]
        fields = [None if b else v for v, b in zip(fields, blank, strict=True)]
        out.append(large_card(card, fields))
    return out


def _params(w: _Words) -> dict[str, int | float | str]:
    """PARAMs: a name of two words, a type, a value; 1 integer, 2 real, 3 text of two words, 4
    double.
    """
    out: dict[str, int | float | str] = {}
    at = 0
    while at + 4 <= w.ints.size:
        name = w.text(at, 2)
        kind = int(w.ints[at + 2])
        if kind == 1:
            out[name] = int(w.ints[at + 3])
        elif kind == 2:
            out[name] = float(w.reals[at + 3])
        elif kind == 3:
            out[name] = w.text(at + 3, 2)
        elif kind == 4:
            start = (at + 3) * w.block.word
            out[name] = float(w.block.doubles(w.body[start : start + 8])[0])
        else:
            break
        at += 4 if kind in (1, 2) else 5
    return out
