"""Static loads of a deck, as LOAD adds them up for the subcases."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.decks.nastran.cards import Cards
from ringtrue.decks.nastran.case import load_sets
from ringtrue.decks.nastran.lexer import Reader
from ringtrue.decks.nastran.parts import Numbers
from ringtrue.decks.nastran.tables import written_out
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.cards import PRELOADS

log = logging.getLogger(__name__)
LINE_KINDS = tuple(
    f"{what}{axis}{own}" for own in ("", "E") for what in "FM" for axis in "XYZ"
)
LINE_SCALES = ("LE", "FR", "LEPR", "FRPR")
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Load:
    """A force or moment at `node`, or an acceleration of all masses (GRAV, node 0), in frame `cid`;
    deck units.

    With `ends`, two nodes, only the size of the vector counts: its direction is from the one to the
    other (FORCE1), of four nodes across both pairs (FORCE2). At a scalar point (SLOAD) the vector
    is its size alone.
    """

    card: str
    node: int
    cid: int
    vector: Vector
    ends: tuple[int, ...] = ()

    def times(self, factor: float) -> Load:
        """The load multiplied."""
        x, y, z = self.vector
        return replace(self, vector=(factor * x, factor * y, factor * z))


@dataclass(frozen=True, slots=True)
class Pressure:
    """A pressure `sizes` at the corners of elements or, for PLOAD, of the face between `nodes`;
    deck units.

    `first` to `last` are the elements, `nodes` what names a face of a solid (G1 and G3 or G4, 0 for
    none). It acts along `vector` in frame `cid`, or without one along the normal, into a solid.
    """

    card: str
    place: tuple[str, int]
    sizes: tuple[float, ...]
    first: int = 0
    last: int = 0
    nodes: tuple[int, ...] = (0, 0)
    cid: int = 0
    vector: Vector | None = None

    def times(self, factor: float) -> Pressure:
        """The pressure multiplied."""
        return replace(self, sizes=tuple(factor * p for p in self.sizes))

    def error(self, why: str) -> DeckError:
        """An error at the place of the card."""
        return DeckError(why, path=self.place[0], line=self.place[1], card=self.card)


@dataclass(frozen=True, slots=True)
class LineLoad:
    """A force or moment (PLOAD1) on the beam `element`; deck units.

    `kind` is its TYPE, such as FZ (basic) or MYE (axes of the element). It acts from `ends[0]` to
    `ends[1]`, lengths or with `fraction` shares of the length, with sizes a length that are linear
    between, or where the two are one as a single load `sizes[0]`. `projected`: a length is that
    which a view along the load sees.
    """

    place: tuple[str, int]
    element: int
    kind: str
    ends: tuple[float, float]
    sizes: tuple[float, float]
    fraction: bool
    projected: bool

    def times(self, factor: float) -> LineLoad:
        """The load multiplied."""
        return replace(self, sizes=(factor * self.sizes[0], factor * self.sizes[1]))

    def error(self, why: str) -> DeckError:
        """An error at the place of the card."""
        return DeckError(why, path=self.place[0], line=self.place[1], card="PLOAD1")


@dataclass(frozen=True, slots=True)
class Moved:
    """A held component of `node` displaced by `size` (SPCD), in its displacement frame; deck
    units.
    """

    place: tuple[str, int]
    node: int
    component: int
    size: float

    def times(self, factor: float) -> Moved:
        """The displacement multiplied."""
        return replace(self, size=factor * self.size)

    def error(self, why: str) -> DeckError:
        """An error at the place of the card."""
        return DeckError(why, path=self.place[0], line=self.place[1], card="SPCD")


AnyLoad = Load | Pressure | LineLoad | Moved


@dataclass(frozen=True, slots=True)
class LoadCase:
    """What acts in a subcase."""

    name: str
    loads: tuple[AnyLoad, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PartCards:
    """The cards of a superelement with bulk data of its own, and the numbers that its points,
    frames and elements have in the whole.
    """

    cards: Cards
    numbers: Mapping[str, Numbers]


def load_cases(found: Cards, parts: Sequence[PartCards] = ()) -> tuple[LoadCase, ...]:
    """The load cases of a deck: its subcases with a LOAD, in order.

    Raises
    ------
    DeckError
        If there is none, or none of which the set is in the deck, a field is no number, or
        subcases have other SPC or MPC; if a subcase loads a superelement alone, or gravity acts on
        some parts only.
    UnsupportedCard
        If a set has loads of other cards, such as ACCEL1 or RFORCE.
    """
    if not (asked := load_sets(found.deck.top)):
        raise DeckError(
            "case control has no LOAD: give one, or --force", path=found.deck.files[0]
        )
    for part in parts:
        if alone := [
            name
            for name, of in load_sets(part.cards.deck.top)
            if (name, of) not in asked
        ]:
            raise DeckError(
                f"{alone[0]} loads a superelement alone: give loads in subcases without SUPER",
                path=found.deck.files[0],
            )
    out = []
    absent = list[_AbsentSet]()
    for name, number in asked:
        try:
            out.append(LoadCase(name, _of_sections(found, parts, number)))
        except _AbsentSet as e:
            absent.append(e)
            log.warning("%s is left out: %s", name, e)
    if not out:
        raise absent[0]
    return tuple(out)


def _of_sections(
    found: Cards, parts: Sequence[PartCards], number: int
) -> tuple[AnyLoad, ...]:
    """The loads of a set in the main bulk data and in those of all parts; gravity counts once."""
    if not parts:
        return _of_set(found, number)
    out = list[AnyLoad]()
    gravity = []
    for part in (PartCards(found, {}), *parts):
        try:
            loads = _of_set(part.cards, number)
        except _AbsentSet:
            loads = ()
        gravity.append([ld for ld in loads if _is_gravity(ld)])
        out += [_placed(ld, part.numbers) for ld in loads if not _is_gravity(ld)]
    if any(own != gravity[1] for own in gravity[2:]) or gravity[0] not in (
        [],
        gravity[1],
    ):
        raise DeckError(
            f"load set {number}: GRAV acts on some parts only: give it in the bulk data of each",
            path=found.deck.files[0],
        )
    if not (out or gravity[1]):
        raise _AbsentSet(
            f"load set {number} is not in the deck", path=found.deck.files[0]
        )
    return (*out, *gravity[1])


def _is_gravity(load: AnyLoad) -> bool:
    return isinstance(load, Load) and load.card == "GRAV"


def _placed(load: AnyLoad, numbers: Mapping[str, Numbers]) -> AnyLoad:
    """A load by the numbers that its points, frames and elements have in the whole."""
    points, frames, elements = (
        numbers.get(k, {}) for k in ("point", "frame", "element")
    )
    if isinstance(load, Load):
        ends = tuple(points.get(p, p) for p in load.ends)
        node = points.get(load.node, load.node)
        return replace(load, node=node, cid=frames.get(load.cid, load.cid), ends=ends)
    if isinstance(load, Moved):
        return replace(load, node=points.get(load.node, load.node))
    if isinstance(load, LineLoad):
        return replace(load, element=elements.get(load.element, load.element))
    first, last = (elements.get(e, e) for e in (load.first, load.last))
    nodes = tuple(points.get(p, p) for p in load.nodes)
    cid = frames.get(load.cid, load.cid)
    return replace(load, first=first, last=last, nodes=nodes, cid=cid)


class _AbsentSet(DeckError):
    """A load set that is not in the deck: its subcase is left out, the others are not."""


def _of_set(found: Cards, number: int) -> tuple[AnyLoad, ...]:
    for r in (Reader(c, found.deck.files) for c in written_out(found, "LOAD")):
        if r.whole(0, "SID") == number:
            every = r.real(1, "S", 0.0)
            last = len(r.card.fields) - 1
            pairs = [
                (every * r.real(i, "Si", 0.0), r.whole(i + 1, "Li"))
                for i in range(2, last, 2)
                if r.text(i + 1)
            ]
            return tuple(ld.times(f) for f, of in pairs for ld in _alone(found, of))
    return _alone(found, number)


def _alone(found: Cards, number: int) -> tuple[AnyLoad, ...]:
    """The loads of a set, without LOAD."""
    out = list[AnyLoad]()
    for name in (n.decode() for n in found.kinds()[0].tolist()):
        if name == "LOAD" or name.startswith("TEMP") or not name.startswith(PRELOADS):
            continue
        # over the loads, which are fewer than the elements
        for c in written_out(found, name):
            r = Reader(c, found.deck.files)
            if r.text(0) != str(number):
                continue
            if name not in _READ:
                why = f"of a static load, {', '.join(_READ)} are read"
                raise UnsupportedCard(
                    name, path=found.deck.files[c.file], line=c.line, why=why
                )
            out += _READ[name](r)
    if not out:
        raise _AbsentSet(
            f"load set {number} is not in the deck", path=found.deck.files[0]
        )
    return tuple(out)


def _vector(r: Reader, at: int) -> Vector:
    return r.real(at, "N1", 0.0), r.real(at + 1, "N2", 0.0), r.real(at + 2, "N3", 0.0)


def _node(r: Reader) -> int:
    node = r.whole(1, "G")
    if node < 1:
        raise r.fail("G", f"{node} is no node")
    return node


def _force(r: Reader) -> list[AnyLoad]:
    """FORCE and MOMENT: SID G CID F N1 N2 N3; GRAV: SID CID A N1 N2 N3."""
    at = 1 if r.card.name == "GRAV" else 2
    node = 0 if at == 1 else _node(r)
    cid = r.whole(at, "CID", 0)
    return [
        Load(r.card.name, node, cid, _vector(r, at + 2)).times(
            r.real(at + 1, "the size", 0.0)
        )
    ]


def _between(r: Reader) -> list[AnyLoad]:
    """FORCE1 and MOMENT1: SID G F G1 G2; FORCE2 and MOMENT2: SID G F G1 G2 G3 G4."""
    ends = tuple(
        r.whole(i, f"G{i - 2}") for i in range(3, 7 if r.card.name.endswith("2") else 5)
    )
    return [Load(r.card.name[:-1], _node(r), 0, (r.real(2, "F"), 0.0, 0.0), ends)]


def _sload(r: Reader) -> list[AnyLoad]:
    """SLOAD: SID S1 F1 S2 F2 S3 F3."""
    return [
        Load("SLOAD", r.whole(i, "S"), 0, (r.real(i + 1, "F"), 0.0, 0.0))
        for i in (1, 3, 5)
        if r.text(i)
    ]


def _place(r: Reader) -> tuple[str, int]:
    return r.files[r.card.file], r.card.line


def _pload(r: Reader) -> list[AnyLoad]:
    """PLOAD: SID P G1 G2 G3 G4."""
    nodes = tuple(r.whole(i, f"G{i - 1}", 0) for i in (2, 3, 4, 5))
    if min(nodes[:3]) < 1:
        raise r.fail("G1", "three or four nodes span a face")
    return [Pressure("PLOAD", _place(r), (r.real(1, "P"),) * 4, nodes=nodes)]


def _pload2(r: Reader) -> list[AnyLoad]:
    """PLOAD2: SID P and elements, or a range of them."""
    size = (r.real(1, "P"),) * 4
    if r.text(3).upper() == "THRU":
        ranges = [(r.whole(2, "EID1"), r.whole(4, "EID2"))]
    else:
        ranges = [
            (r.whole(i, "EID"),) * 2 for i in range(2, len(r.card.fields)) if r.text(i)
        ]
    return [Pressure("PLOAD2", _place(r), size, a, b) for a, b in ranges]


def _pload4(r: Reader) -> list[AnyLoad]:
    """PLOAD4: SID EID P1 P2 P3 P4 and G1 G3, or THRU EID2; CID N1 N2 N3 SORL LDIR."""
    first = r.real(2, "P1", 0.0)
    sizes = tuple(r.real(i, f"P{i - 1}", first) for i in (2, 3, 4, 5))
    eid = r.whole(1, "EID")
    ranged = r.text(6).upper() == "THRU"
    last, nodes = (
        (r.whole(7, "EID2"), (0, 0))
        if ranged
        else (eid, (r.whole(6, "G1", 0), r.whole(7, "G3", 0)))
    )
    vector = _vector(r, 9) if any(r.text(i) for i in (9, 10, 11)) else None
    if r.text(12).upper() not in ("", "SURF") or r.text(13).upper() not in ("", "NORM"):
        raise r.fail(
            "SORL", "loads along edges (LINE) and LDIR are not read; give FORCE"
        )
    if vector is not None and not np.any(vector):
        raise r.fail("N1", "a direction without length")
    pressure = Pressure(
        card="PLOAD4",
        place=_place(r),
        sizes=sizes,
        first=eid,
        last=last,
        nodes=nodes,
        cid=r.whole(8, "CID", 0),
        vector=vector,
    )
    return [pressure]


def _pload1(r: Reader) -> list[AnyLoad]:
    """PLOAD1: SID EID TYPE SCALE X1 P1 X2 P2; a blank P2 is 0."""
    kind = r.text(2).upper()
    scale = r.text(3).upper()
    if kind not in LINE_KINDS:
        raise r.fail("TYPE", f"{kind or 'blank'}; allowed are {' '.join(LINE_KINDS)}")
    if scale not in LINE_SCALES:
        raise r.fail(
            "SCALE", f"{scale or 'blank'}; allowed are {' '.join(LINE_SCALES)}"
        )
    first = r.real(4, "X1")
    size = r.real(5, "P1")
    single = not r.text(6)
    last = first if single else r.real(6, "X2")
    if not 0 <= first <= last:
        raise r.fail("X1", f"from {first:g} to {last:g}; must be 0 <= X1 <= X2")
    single = single or last == first
    projected = scale.endswith("PR")
    if projected and not single and (kind.endswith("E") or kind[0] == "M"):
        raise r.fail(
            "SCALE", f"{scale} is read with FX, FY and FZ; for {kind} give {scale[:2]}"
        )
    sizes = (size, size if single else r.real(7, "P2", 0.0))
    eid = r.whole(1, "EID")
    load = LineLoad(
        place=_place(r),
        element=eid,
        kind=kind,
        ends=(first, last),
        sizes=sizes,
        fraction=scale[:2] == "FR",
        projected=projected,
    )
    return [load]


def _spcd(r: Reader) -> list[AnyLoad]:
    """SPCD: SID G1 C1 D1 G2 C2 D2; components as in SPC, 0 or blank for a scalar point."""
    out = list[AnyLoad]()
    for at in (i for i in (1, 4) if r.text(i)):
        node = r.whole(at, "G")
        size = r.real(at + 2, "D", 0.0)
        out += [Moved(_place(r), node, int(c), size) for c in r.text(at + 1) or "0"]
    return out


_READ: Mapping[str, Callable[[Reader], list[AnyLoad]]] = {
    **dict.fromkeys(("FORCE", "MOMENT", "GRAV"), _force),
    **dict.fromkeys(("FORCE1", "MOMENT1", "FORCE2", "MOMENT2"), _between),
    "SLOAD": _sload,
    "PLOAD": _pload,
    "PLOAD1": _pload1,
    "PLOAD2": _pload2,
    "PLOAD4": _pload4,
    "SPCD": _spcd,
}
STATIC_LOADS = frozenset((*_READ, "LOAD"))  # cards of static loads that are read
