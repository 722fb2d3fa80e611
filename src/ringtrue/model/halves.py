"""The parts that elements are split into, in halves along each of their sides."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product

import numpy as np

from ringtrue.core.arrays import Float

Corners = tuple[int, ...]  # whose middle a node of a part is; one where it is that corner
Part = tuple[Corners, ...]

LINES = ("CBAR", "CBEAM")
RODS = ("CROD", "CTUBE")
_RING = ((0, 1), (1, 2), (2, 3), (3, 0))
_SQUARES = ((-1, -1), (1, -1), (1, 1), (-1, 1))
_POINTS = ((0, 0), (1, 0), (0, 1))
_SIDES: dict[
    str, tuple[tuple[int, int], ...]
] = {  # of elements of the second order, in the order of their midside nodes
    "CTRIA6": ((0, 1), (1, 2), (2, 0)),
    "CQUAD8": _RING,
    "CTETRA10": ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    "CPENTA15": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)),
    "CHEXA20": (*_RING, (0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 6), (6, 7), (7, 4)),
}
_PLACES: dict[str, tuple[tuple[int, ...], ...]] = {  # of their corners, in natural coordinates
    "CTRIA6": _POINTS,
    "CQUAD8": _SQUARES,
    "CTETRA10": (*((*p, 0) for p in _POINTS), (0, 0, 1)),
    "CPENTA15": tuple((*p, z) for z in (-1, 1) for p in _POINTS),
    "CHEXA20": tuple((*p, z) for z in (-1, 1) for p in _SQUARES),
}
CURVED = {  # kinds of elements with all their midside nodes: card, and that of their corners alone
    "CTRIA6": ("CTRIA6", "CTRIA3"),
    "CQUAD8": ("CQUAD8", "CQUAD4"),
    "CTETRA10": ("CTETRA", "CTETRA"),
    "CPENTA15": ("CPENTA", "CPENTA"),
    "CHEXA20": ("CHEXA", "CHEXA"),
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
        kind: tuple(f"G{k + 1}" for k in range(len(_PLACES[kind]) + len(_SIDES[kind])))
        for kind in CURVED
    },
}


@cache
def parts(card: str) -> tuple[Part, ...]:
    """The parts that an element is split into, each by the nodes of the whole between which its
    nodes are midway.
    """
    if card in CURVED:
        return tuple(_with_midsides(card, part) for part in parts(CURVED[card][1]))
    if card in ("CTRIA3", "CTRIAR", "CTETRA"):
        return _read(_TETRA if card == "CTETRA" else _TRIANGLE)
    if card == "CPENTA":
        layers = [
            [tuple(c + 3 * z for z in _HALVES[k] for c in corner) for corner in p]
            for p in _read(_TRIANGLE)
            for k in range(3)
        ]
        return tuple((*layers[i], *layers[i + 1]) for i in range(len(layers)) if i % 3 < 2)
    corners = {
        2: ((0,), (1,)),
        4: _SQUARE,
        8: tuple((*c, z) for z in (0, 1) for c in _SQUARE),
    }[len(NODES[card])]
    return tuple(tuple(_between(corners, o, c) for c in corners) for o in corners)


def _with_midsides(kind: str, part: Part) -> Part:
    """A part of an element of the second order, from that of its corners."""
    corners = [np.eye(len(_PLACES[kind]))[list(c)].mean(axis=0) for c in part]
    middles = [(corners[i] + corners[j]) / 2 for i, j in _SIDES[kind]]
    return tuple(_midway(kind, place) for place in (*corners, *middles))


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
        for k, (i, j) in enumerate(_SIDES[kind])
        if place[i] * place[j] > 0 and place[i] != place[j]
    ]
    leaving = [k for k in leaving if (nodes[k, near] > 0).any()]
    tried = [np.flatnonzero(place).tolist(), [*near.tolist(), *leaving], leaving]
    return next(tuple(c) for c in tried if c and (nodes[c].mean(axis=0) == place).all())


@cache
def _shares(kind: str) -> Float:
    """What share of each corner is in the place of each node, (n, c)."""
    corners = np.eye(len(_PLACES[kind]))
    return np.array([*corners, *((corners[i] + corners[j]) / 2 for i, j in _SIDES[kind])])


def corner_shares(kind: str, between: Corners) -> Float:
    """Shares (c,) of the corners of an element in the place midway between some of its nodes."""
    if kind in CURVED:
        return np.asarray(_shares(kind)[list(between)].mean(axis=0))
    return np.asarray(np.isin(np.arange(len(NODES[kind])), between) / len(between))


def weights(kind: str, between: Corners) -> Float:
    """Of the nodes of an element (n,), for the place midway between some: by its shape functions,
    straight or not.
    """
    if kind not in CURVED:
        return corner_shares(kind, between)
    nodes, place = (
        _monomials(kind, x @ np.array(_PLACES[kind]))
        for x in (_shares(kind), corner_shares(kind, between))
    )
    return np.asarray(np.linalg.solve(nodes.T, place))


def _monomials(kind: str, x: Float) -> Float:
    """Terms of the shape functions at natural coordinates (..., d), as many as nodes.

    Of bricks those of serendipity: squares times what is linear in the others (Arnold and Awanou
    2011).
    """
    d = x.shape[-1]
    powers = [p for p in product(range(3), repeat=d) if _is_term(kind, p)]
    return np.stack([np.prod(x ** np.array(p), axis=-1) for p in powers], axis=-1)


def _is_term(kind: str, powers: tuple[int, ...]) -> bool:
    if kind in ("CTRIA6", "CTETRA10"):
        return sum(powers) <= 2
    if kind == "CPENTA15":
        return sum(powers[:2]) <= (2 if powers[2] < 2 else 1)
    return sum(p for p in powers if p > 1) <= 2


def _read(text: Sequence[str]) -> tuple[Part, ...]:
    """`"0 01"` as ((0,), (0, 1))."""
    return tuple(tuple(tuple(int(c) for c in corner) for corner in part.split()) for part in text)


def _between(corners: Sequence[Corners], origin: Corners, corner: Corners) -> Corners:
    """Corners of a brick about the corner of the part that lies at `origin`, in halves of the
    sides.
    """
    allowed = [_HALVES[o + c] for o, c in zip(origin, corner, strict=True)]
    return tuple(
        i for i, x in enumerate(corners) if all(v in a for v, a in zip(x, allowed, strict=True))
    )
