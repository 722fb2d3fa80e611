"""A model with its mesh refined once: every element in halves along each of its sides, on the same
geometry.

The parts that elements are split into, in halves along each of their sides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Float, Int, frozen
from ringtrue.errors import UnsupportedError
from ringtrue.model.cards import (
    HEXAHEDRON,
    NONSTRUCTURAL,
    QUADRILATERAL,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
)
from ringtrue.model.case_control import taken_sets
from ringtrue.model.edit import BOTH_ENDS
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, Ragged, Table, stacked, table

# whose middle a node of a part is; one where it is that corner
Corners = tuple[int, ...]
Part = tuple[Corners, ...]

LINES = ("CBAR", "CBEAM")
_OFFSETS = ("W1A", "W2A", "W3A", "W1B", "W2B", "W3B")  # of their ends
RODS = ("CROD", "CTUBE")
# kinds of elements with all their midside nodes: card, and that of their corners alone
CURVED = {
    "CTRIA6": ("CTRIA6", "CTRIA3"),
    "CQUAD8": ("CQUAD8", "CQUAD4"),
    "CTETRA10": ("CTETRA", "CTETRA"),
    "CPENTA15": ("CPENTA", "CPENTA"),
    "CHEXA20": ("CHEXA", "CHEXA"),
}
_SHAPES = {  # of elements of the second order
    "CTRIA6": TRIANGLE,
    "CQUAD8": QUADRILATERAL,
    "CTETRA10": TETRAHEDRON,
    "CPENTA15": WEDGE,
    "CHEXA20": HEXAHEDRON,
}
_TRIANGLE = ("0 01 02", "01 1 12", "02 12 2", "12 02 01")
_TETRA = ("0 01 02 03", "01 1 12 13", "02 12 2 23", "03 13 23 3",
          "13 02 01 03", "13 02 03 23", "13 02 23 12", "13 02 12 01")  # fmt: skip
_SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
_HALVES = ((0,), (0, 1), (1,))
NODES = {
    **dict.fromkeys(LINES, ("GA", "GB")),
    **dict.fromkeys(RODS, ("G1", "G2")),
    **dict.fromkeys(("CTRIA3", "CTRIAR"), ("G1", "G2", "G3")),
    **dict.fromkeys(("CQUAD4", "CQUADR", "CTETRA"), ("G1", "G2", "G3", "G4")),
    "CPENTA": tuple(f"G{k}" for k in range(1, 7)),
    "CHEXA": tuple(f"G{k}" for k in range(1, 9)),
    **{
        kind: tuple(f"G{k + 1}" for k in range(len(_SHAPES[kind].nodes(2))))
        for kind in CURVED
    },
}


@cache
def parts(card: str) -> tuple[Part, ...]:
    """The parts that an element is split into, each by the nodes of the whole between which its
    nodes are midway.
    """
    if card in CURVED:
        curved = []
        for part in parts(CURVED[card][1]):
            corners = [
                np.eye(len(_SHAPES[card].corners))[list(c)].mean(axis=0) for c in part
            ]
            middles = [(corners[i] + corners[j]) / 2 for i, j in _SHAPES[card].edges]
            curved.append(tuple(_midway(card, place) for place in (*corners, *middles)))
        return tuple(curved)
    if card in ("CTRIA3", "CTRIAR", "CTETRA"):
        return _read(_TETRA if card == "CTETRA" else _TRIANGLE)
    if card == "CPENTA":
        layers = [
            [tuple(c + 3 * z for z in _HALVES[k] for c in corner) for corner in p]
            for p in _read(_TRIANGLE)
            for k in range(3)
        ]
        return tuple(
            (*layers[i], *layers[i + 1]) for i in range(len(layers)) if i % 3 < 2
        )
    brick = {
        2: ((0,), (1,)),
        4: _SQUARE,
        8: tuple((*c, z) for z in (0, 1) for c in _SQUARE),
    }[len(NODES[card])]
    return tuple(tuple(_between(brick, o, c) for c in brick) for o in brick)


def _midway(kind: str, place: Float) -> Corners:
    """Nodes midway between which a place is, by its shares (c,) of the corners; the same seen from
    all elements about.

    Such are a node, the corners of a side, or the corners that are nearest and the midside nodes
    from there; on triangles the latter alone.
    """
    nodes = _shares(kind)
    if (same := np.flatnonzero((nodes == place).all(axis=1))).size:
        return (int(same[0]),)
    near = np.flatnonzero(place == place.max())
    leaving = [
        len(place) + k
        for k, (i, j) in enumerate(_SHAPES[kind].edges)
        if place[i] * place[j] > 0 and place[i] != place[j]
    ]
    leaving = [k for k in leaving if (nodes[k, near] > 0).any()]
    tried = [np.flatnonzero(place).tolist(), [*near.tolist(), *leaving], leaving]
    return next(tuple(c) for c in tried if c and (nodes[c].mean(axis=0) == place).all())


@cache
def _shares(kind: str) -> Float:
    """What share of each corner is in the place of each node, (n, c)."""
    corners = np.eye(len(_SHAPES[kind].corners))
    return np.array(
        [*corners, *((corners[i] + corners[j]) / 2 for i, j in _SHAPES[kind].edges)]
    )


def corner_shares(kind: str, between: Corners) -> Float:
    """Shares (c,) of the corners of an element in the place midway between some of its nodes."""
    if kind in CURVED:
        return np.asarray(_shares(kind)[list(between)].mean(axis=0))
    return np.isin(np.arange(len(NODES[kind])), between) / len(between)


def weights(kind: str, between: Corners) -> Float:
    """Of the nodes of an element (n,), for the place midway between some: by its shape functions,
    straight or not.
    """
    if kind not in CURVED:
        return corner_shares(kind, between)
    shape = _SHAPES[kind]
    place = corner_shares(kind, between) @ np.array(shape.corners)
    return np.asarray(shape.functions(2, place[None])[0][0])


def _read(text: Sequence[str]) -> tuple[Part, ...]:
    """`"0 01"` as ((0,), (0, 1))."""
    return tuple(
        tuple(tuple(int(c) for c in corner) for corner in part.split()) for part in text
    )


def _between(corners: Sequence[Corners], origin: Corners, corner: Corners) -> Corners:
    """Corners of a brick about the corner of the part that lies at `origin`, in halves of the
    sides.
    """
    allowed = [_HALVES[o + c] for o, c in zip(origin, corner, strict=True)]
    return tuple(
        i
        for i, x in enumerate(corners)
        if all(v in a for v, a in zip(x, allowed, strict=True))
    )


_ALL = "123456"


def _rows(model: Model, kind: str) -> tuple[str, Int]:
    """The card of a kind of `NODES`, and the rows of it that are of this kind."""
    card = CURVED[kind][0] if kind in CURVED else kind
    if card not in model:
        return card, np.empty(0, dtype=np.int64)
    return card, np.flatnonzero(_midsides(model, card).any(axis=1) == (kind in CURVED))


def _midsides(model: Model, card: str) -> Bool:
    """Which midside nodes the elements of a card have, (e, k)."""
    kind = next((k for k, (c, _) in CURVED.items() if c == card), card)
    straight = CURVED[kind][1] if kind in CURVED else card
    names = NODES[kind][len(NODES[straight]) :]
    return (
        model[card].stack(*names) > 0
        if names
        else np.zeros((len(model[card]), 1), dtype=bool)
    )


@dataclass(frozen=True, eq=False)
class _Middles:
    """New nodes: ids (n,), those between which they are (n, 8), ascending and padded in front with
    0; places (n, 3).
    """

    ids: Int
    of: Int
    xyz: Float

    def corners(self, nodes: Int, pieces: Sequence[Part]) -> list[Int]:
        """Nodes of the parts of elements of nodes (e, c), (e, k) a part; 0 where there is no such
        middle.
        """
        wanted = list(dict.fromkeys(c for part in pieces for c in part if len(c) > 1))
        keys = [_key(nodes[:, list(c)]) for c in wanted]
        _, same = np.unique(np.vstack([self.of, *keys]), axis=0, return_inverse=True)
        ids = np.zeros(same.size, dtype=np.int64)
        ids[same[: self.ids.size]] = self.ids
        found = dict(
            zip(
                wanted, ids[same[self.ids.size :]].reshape(len(wanted), -1), strict=True
            )
        )
        return [
            np.stack([found.get(c, nodes[:, c[0]]) for c in part], axis=1)
            for part in pieces
        ]

    @cached_property
    def _about(self) -> tuple[Int, Int]:
        """Nodes about new ones, ascending, and the position of the new one (s,)."""
        new, column = np.nonzero(self.of)
        nodes = self.of[new, column]
        order = np.argsort(nodes, kind="stable")
        return nodes[order], new[order]

    def within(self, members: Int) -> Int:
        """Positions (k,) of those that lie between members only."""
        nodes, new = self._about
        mine = np.unique(members)
        first = np.searchsorted(nodes, mine, side="left").tolist()
        last = np.searchsorted(nodes, mine, side="right").tolist()
        about = [new[a:b] for a, b in zip(first, last, strict=True)]
        found, count = np.unique(np.concatenate(about), return_counts=True)
        return np.asarray(found[count == (self.of[found] > 0).sum(axis=1)])


def _key(nodes: Int) -> Int:
    return np.pad(np.sort(nodes, axis=1), ((0, 0), (8 - nodes.shape[1], 0)))


def refined(model: Model) -> Model:
    """The model with its mesh refined once.

    Bars, beams, shells and solids of the first and second order are split in halves along each
    side, rods where they lie along such a side (by itself a rod in halves is a mechanism), tapered
    beams not. A new node lies midway on a side; it is held where all the nodes about it are, and
    belongs to the RBE2 or RBE3 that all of these belong to; edges joined node by node, rigidly or
    by MPC, stay joined. Springs, masses and other connectors stay at their nodes, all of which keep
    their ids.

    Raises
    ------
    UnsupportedError
        If it has elements without some of their midside nodes, pyramids, or welds and masses that
        name elements.
    """
    _refuse(model)
    middles = _middles(model)
    if not middles.ids.size:
        return model
    tables = dict(model.tables)
    tables["GRID"] = stacked(model["GRID"], _grids(model, middles))
    first = 1 + max(
        int(t.ids.max(initial=0))
        for c, t in tables.items()
        if c.startswith(("C", "R")) and "EID" in t.columns
    )
    for card in (c for c in NODES if c in model and len(model[c])):
        tables[card] = _split(model, card, middles, first)
        first += len(tables[card])
    tables |= dict(_held(model, middles)) | dict(_rigid(model, middles))
    seams = _seams(model, middles, first)
    if len(seams):
        tables["RBE2"] = stacked(tables["RBE2"], seams) if "RBE2" in tables else seams
    return replace(model, tables=tables)


def _refuse(model: Model) -> None:
    """Raise on what is not split."""
    cards = dict.fromkeys(card for card, _ in CURVED.values() if card in model)
    there = {card: _midsides(model, card) for card in cards}
    names = [
        f"{card} without some midside nodes"
        for card, m in there.items()
        if (m.any(axis=1) & ~m.all(axis=1)).any()
    ]
    names += [
        card
        for card in ("CTRIA6", "CQUAD8")
        if card in there and not there[card].any(axis=1).all()
    ]
    if "CPYRAM" in model:
        names = names or ["CPYRAM"]
    if names:
        raise UnsupportedError(
            f"{', '.join(names)}: not refined; elements with all midside nodes or none are"
        )
    if "CWELD" in model and model["CWELD"]["SHIDA"].any():
        raise UnsupportedError(
            "CWELD by the ids of shells (ELEMID) is not refined: give properties (PARTPAT)"
        )
    for card in (c for c in NONSTRUCTURAL if c in model and "TYPE" in model[c].columns):
        if "ELEMENT" in model[card]["TYPE"].tolist():
            raise UnsupportedError(
                "non-structural mass by the ids of elements is not refined: give it by properties"
            )


def _middles(model: Model) -> _Middles:
    """The nodes that the parts need besides those that are there; rods make none."""
    grid = model["GRID"]
    x = positions(model)
    keys = [np.empty((0, 8), dtype=np.int64)]
    places = [np.empty((0, 3))]
    for kind, names in NODES.items():
        card, rows = _rows(model, kind)
        if rows.size and card not in RODS:
            nodes = model[card].stack(*names)[rows[~_whole(model, card)[rows]]]
            for c in {c for p in parts(kind) for c in p if len(c) > 1}:
                keys.append(_key(nodes[:, list(c)]))
                places.append(
                    np.einsum("k,ekj->ej", weights(kind, c), x[grid.find(nodes)])
                )
    of, first = np.unique(np.concatenate(keys), axis=0, return_index=True)
    last = max(int(grid.ids.max()), *(_scalars(model) or [0]))
    return _Middles(last + 1 + np.arange(len(of)), of, np.concatenate(places)[first])


def _scalars(model: Model) -> list[int]:
    points = [model["SPOINT"].ragged("ID").values] if "SPOINT" in model else []
    points += [
        t[e]
        for c, t in model.tables.items()
        if c[-1] in "34"
        for e in ("S1", "S2")
        if e in t.columns
    ]
    return [int(p.max(initial=0)) for p in points]


def _grids(model: Model, middles: _Middles) -> Table:
    """Rows of GRID for the new nodes, held where all of those about them are."""
    grid = model["GRID"]
    at = grid.find(middles.of.ravel()).reshape(middles.of.shape)
    there = middles.of > 0
    x = middles.xyz
    last = at[:, -1]
    columns: dict[str, NDArray[Any]] = {
        n: np.asarray(c)[last] for n, c in grid.columns.items()
    }
    held = []
    for row, ok in zip(at, there, strict=True):
        common = set.intersection(*(set(str(p)) for p in grid["PS"][row[ok]]))
        held.append("".join(sorted(common)))
    columns |= {"ID": middles.ids, "CP": np.zeros_like(last)}
    columns |= {f"X{k + 1}": x[:, k] for k in range(3)}
    columns["PS"] = np.array(held, dtype=grid["PS"].dtype)
    return replace(
        grid,
        columns=columns,
        file=np.full(last.size, -1),
        line=np.zeros(last.size, dtype=np.int64),
    )


def _split(model: Model, card: str, middles: _Middles, first: int) -> Table:
    """The table of a card with its elements split, the first part with the id of the whole."""
    whole = model[card]
    firsts = list[Table]()
    others = list[Table]()
    for kind in (k for k in NODES if _rows(model, k)[0] == card):
        rows = _rows(model, kind)[1]
        pieces = parts(kind)
        nodes = whole.stack(*NODES[kind])[rows]
        ends = middles.corners(nodes, pieces)
        able = (
            np.all([(e > 0).all(axis=1) for e in ends], axis=0)
            & ~_whole(model, card)[rows]
        )
        first_ends = np.where(able[:, None], ends[0], nodes)
        firsts.append(
            _part(model, kind, pieces[0], nodes=first_ends, at=rows, able=able)
        )
        at = np.flatnonzero(able)
        others += [
            _part(model, kind, p, nodes=e[at], at=rows[at], able=able[at])
            for p, e in zip(pieces[1:], ends[1:], strict=True)
        ]
    out = reduce(stacked, firsts + others)
    made = len(out) - len(whole)
    return out.with_column(
        "EID", np.concatenate([out.ids[: len(whole)], first + np.arange(made)])
    )


def _part(
    model: Model, kind: str, part: Part, nodes: Int, at: Int, able: Bool
) -> Table:
    """One part of each of the rows `at`; where these are not split, the whole."""
    card, _ = _rows(model, kind)
    t = model[card]
    columns = {n: np.array(c)[at] for n, c in t.columns.items()}
    columns |= dict(zip(NODES[kind], nodes.T, strict=True))
    thick = [f"T{k + 1}" for k in range(len(part)) if f"T{k + 1}" in columns]
    if thick:
        corners = t.stack(*thick)[at]
        columns |= {
            n: corners @ corner_shares(kind, c)
            for n, c in zip(thick, part, strict=False)
        }
    piece = replace(
        t,
        columns={n: frozen(c) for n, c in columns.items()},
        file=t.file[at],
        line=t.line[at],
    )
    return _bars(model, piece, part, at=at, able=able) if card in LINES else piece


def _bars(model: Model, piece: Table, part: Part, at: Int, able: Bool) -> Table:
    """Halves of bars: pins at outer ends only, the offset of the middle midway, the orientation in
    basic.
    """
    t = model[piece.card]
    grid = model["GRID"]
    row = grid.find(t.stack("GA", "GB")[at])
    x = positions(model)[row]
    frame = axes(model, grid["CD"][row].ravel(), x.reshape(-1, 3)).reshape(-1, 2, 3, 3)
    # of rows (e, k) of GRID, those of the highest ids (e,)
    last = np.take_along_axis(row, grid.ids[row].argmax(axis=1)[:, None], axis=1)[:, 0]
    between = axes(model, grid["CD"][last], x.mean(axis=1))
    w = np.einsum("eki,ekij->ekj", t.stack(*_OFFSETS)[at].reshape(-1, 2, 3), frame)
    middle = np.einsum("eij,ej->ei", between, w.mean(axis=1))
    offt = np.char.upper(t["OFFT"][at].astype(str))
    v = t.stack("X1", "X2", "X3")[at]
    basic = np.char.startswith(offt, "B")
    v = np.where(basic[:, None], v, np.einsum("ei,eij->ej", v, frame[:, 0]))
    side = "B" if len(part[0]) == 1 else "A"
    new = {f"W{k + 1}{side}": middle[:, k] for k in range(3)}
    new |= {f"X{k + 1}": v[:, k] for k in range(3)}
    new[f"P{side}"] = np.zeros_like(piece[f"P{side}"])
    new["OFFT"] = np.full(at.size, "BGG", dtype=offt.dtype)
    changed = {n: frozen(np.where(able, c, piece[n])) for n, c in new.items()}
    return replace(piece, columns={**piece.columns, **changed})


def _whole(model: Model, card: str) -> Bool:
    """Elements (n,) that stay whole: beams with ends that differ, offsets in the frame of the
    element.
    """
    t = model[card]
    whole = np.zeros(len(t), dtype=bool)
    if card in LINES:
        offt = np.char.ljust(np.char.upper(t["OFFT"].astype(str)), 3)
        whole |= (np.char.find(offt, "O") >= 0) & (t.stack(*_OFFSETS) != 0).any(axis=1)
    if card == "CBEAM" and "PBEAM" in model:
        p = model["PBEAM"]
        differ = [
            ~np.isclose(p[a], p[b]) for a, b in BOTH_ENDS.items() if a in p.columns
        ]
        tapered = np.any(differ, axis=0)
        whole |= np.isin(t["PID"], p.ids[tapered | (p.ragged("X").sizes > 0)])
    return whole


def _held(model: Model, middles: _Middles) -> Iterator[tuple[str, Table]]:
    """SPC1 with the new nodes between held ones, one row a set and component more."""
    held: dict[tuple[int, str], list[Int]] = {}
    for sid, c, g in _constraints(model):
        for letter in str(c):
            held.setdefault((sid, letter), []).append(np.atleast_1d(g))
    rows = []
    for (sid, letter), groups in sorted(held.items()):
        grounded = model["GRID"].ids[
            np.char.find(model["GRID"]["PS"].astype(str), letter) >= 0
        ]
        new = middles.ids[middles.within(np.concatenate([*groups, grounded]))]
        if new.size:
            rows.append((sid, letter, new))
    if rows:
        sets, letters, nodes = zip(*rows, strict=True)
        more = table("SPC1", SID=sets, C=np.array(letters), G=Ragged.of(nodes))
        yield "SPC1", stacked(model["SPC1"], more) if "SPC1" in model else more


def _constraints(model: Model) -> Iterator[tuple[int, str, Any]]:
    """Set, components and nodes of each row of SPC1 and SPC."""
    if "SPC1" in model:
        t = model["SPC1"]
        nodes = map(t.ragged("G").row, range(len(t)))
        yield from zip(t["SID"].tolist(), t["C"].tolist(), nodes, strict=True)
    if "SPC" in model:
        t = model["SPC"]
        yield from zip(t["SID"].tolist(), t["C"].tolist(), t["G"], strict=True)


def _rigid(model: Model, middles: _Middles) -> Iterator[tuple[str, Table]]:
    """RBE2 and RBE3 with the new nodes between those that they join, with the mean of the weights
    about them.
    """
    for card, name, more in (("RBE2", "GM", ()), ("RBE3", "G", ("C", "WT"))):
        if card not in model:
            continue
        t = model[card]
        lists = {n: [t.ragged(n).row(i) for i in range(len(t))] for n in (name, *more)}
        for i, nodes in enumerate(lists[name]):
            hub = [t["GN"][i]] if card == "RBE2" else []
            new = middles.within(np.concatenate([nodes, np.array(hub, dtype=np.int64)]))
            lists[name][i] = np.concatenate([nodes, middles.ids[new]])
            for n in more:
                common = _common(nodes, lists[n][i], middles.of[new])
                lists[n][i] = np.concatenate([lists[n][i], common])
        made = {n: Ragged.of(v) for n, v in lists.items()}
        yield card, replace(t, columns={**t.columns, **made})


def _joints(model: Model) -> tuple[Int, Int, NDArray[np.str_]]:
    """Nodes that move as others do, ascending, those others and the components, (k,), by a card for
    each.

    RBE2 of one dependent node, RBAR and RBAR1, MPC of equal motions of nodes at one place.
    """
    found = list[tuple[int, int, str]]()
    if "RBE2" in model:
        t = model["RBE2"]
        nodes = map(t.ragged("GM").row, range(len(t)))
        found += [
            (int(d[0]), int(g), str(c))
            for d, g, c in zip(nodes, t["GN"], t["CM"], strict=True)
            if d.size == 1
        ]
    for card, components in (("RBAR", "CMB"), ("RBAR1", "CB")):
        if card in model:
            t = model[card]
            at_a = t["CNA"] if card == "RBAR" else np.full(len(t), _ALL)
            each = zip(
                t["GA"].tolist(), t["GB"].tolist(), at_a, t[components], strict=True
            )
            found += [(b, a, str(c) or _ALL) for a, b, n, c in each if n == _ALL]
    found += _ties(model)
    found.sort()
    dependent, hub = (np.array([f[k] for f in found], dtype=np.int64) for k in (0, 1))
    return dependent, hub, np.array([f[2] for f in found], dtype="<U6")


def _ties(model: Model) -> list[tuple[int, int, str]]:
    """Node, the one at its place that it moves with, and the components in which MPC say so."""
    if "MPC" not in model or not model.case.mpc:
        return []
    t = model["MPC"]
    x = positions(model)
    grid = model["GRID"]
    joined = dict[tuple[int, int], str]()
    for i in np.flatnonzero(np.isin(t["SID"], taken_sets(model, "MPC"))).tolist():
        g, c, a = (t.ragged(n).row(i) for n in "GCA")
        at = grid.find(g)
        equal = g.size == 2 and a[0] == -a[1] and c[0] == c[1] > 0
        if equal and (at >= 0).all() and np.allclose(x[at[0]], x[at[1]]):
            pair = int(g[0]), int(g[1])
            joined[pair] = joined.get(pair, "") + str(int(c[0]))
    return [(d, h, "".join(sorted(c))) for (d, h), c in joined.items()]


def _seams(model: Model, middles: _Middles, first: int) -> Table:
    """RBE2 between new nodes of two edges or faces that are joined node by node."""
    dependent, hubs_of, named = _joints(model)
    hubs = [np.empty(0, dtype=np.int64)]
    more = [np.empty(0, dtype=np.int64)]
    like = [np.empty(0, dtype=np.int64)]
    for size in (2, 4) if dependent.size else ():
        new = np.flatnonzero((middles.of > 0).sum(axis=1) == size)
        nodes = middles.of[new, -size:]
        at = np.searchsorted(dependent, nodes).clip(max=dependent.size - 1)
        joined = (dependent[at] == nodes).all(axis=1) & (
            named[at] == named[at[:, :1]]
        ).all(axis=1)
        opposite = hubs_of[at[joined]]
        (hub,) = middles.corners(opposite, [(tuple(range(size)),)])
        common = np.where(
            (opposite == opposite[:, :1]).all(axis=1), opposite[:, 0], hub[:, 0]
        )
        hubs.append(common[common > 0])
        more.append(middles.ids[new[joined]][common > 0])
        like.append(at[joined, 0][common > 0])
    gn, gm, row = (np.concatenate(x) for x in (hubs, more, like))
    each = Ragged(gm, np.arange(gm.size + 1))
    return table("RBE2", EID=first + np.arange(gn.size), GN=gn, CM=named[row], GM=each)


def _common(nodes: Int, values: NDArray[Any], of: Int) -> NDArray[Any]:
    """Values (k,) of the middles of nodes: the mean of numbers, else the first."""
    order = np.argsort(nodes, kind="stable")
    at = order[np.searchsorted(nodes[order], of).clip(max=nodes.size - 1)]
    there = of > 0
    if values.dtype.kind == "f":
        return np.asarray(
            np.where(there, values[at], 0.0).sum(axis=1) / there.sum(axis=1)
        )
    return np.asarray(values[at[:, -1]])
