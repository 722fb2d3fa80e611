"""The parts that elements are split into, in halves along each of their sides."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ringtrue.core.arrays import Float

Corners = tuple[int, ...]  # whose middle a node of a part is; one where it is that corner
Part = tuple[Corners, ...]

LINES, RODS = ("CBAR", "CBEAM"), ("CROD", "CTUBE")
CURVED = "CTETRA10"  # tetrahedra with all their midside nodes
_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
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
    CURVED: tuple(f"G{k}" for k in range(1, 11)),
}


@cache
def parts(card: str) -> tuple[Part, ...]:
    """The parts that an element is split into, each by the nodes of the whole between which its nodes are midway."""
    if card == CURVED:
        return tuple(_with_midsides(part) for part in parts("CTETRA"))
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


def _with_midsides(part: Part) -> Part:
    """A part of a CTETRA of ten nodes, whose corners are all nodes of the whole."""
    corners = [c if len(c) == 1 else (4 + _EDGES.index(c),) for c in part]
    return (*corners, *((*corners[i], *corners[j]) for i, j in _EDGES))


def weights(card: str, between: Corners) -> Float:
    """Of the nodes of an element (n,), for the place midway between some: by its shape functions, straight or not."""
    count = len(NODES[card])
    if card != CURVED:
        return np.asarray(np.isin(np.arange(count), between) / len(between))
    at = np.array([*np.eye(4), *(np.eye(4)[list(e)].mean(axis=0) for e in _EDGES)])[list(between)].mean(axis=0)
    return np.array([*(at * (2 * at - 1)), *(4 * at[i] * at[j] for i, j in _EDGES)])


def _read(text: Sequence[str]) -> tuple[Part, ...]:
    """`"0 01"` as ((0,), (0, 1))."""
    return tuple(tuple(tuple(int(c) for c in corner) for corner in part.split()) for part in text)


def _between(corners: Sequence[Corners], origin: Corners, corner: Corners) -> Corners:
    """Corners of a brick about the corner of the part that lies at `origin`, in halves of the sides."""
    allowed = [_HALVES[o + c] for o, c in zip(origin, corner, strict=True)]
    return tuple(i for i, x in enumerate(corners) if all(v in a for v, a in zip(x, allowed, strict=True)))
