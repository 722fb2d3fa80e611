"""Pressures on shells and on faces of solids as forces at their nodes, by the shape functions of
the face.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import InputError
from ringtrue.fem.algebra import unit
from ringtrue.fem.elements.shell_curved import length
from ringtrue.fem.elements.shell_rule import QUAD8, TRIA6
from ringtrue.fem.elements.solid_rule import triangle
from ringtrue.fem.kinds import SHELLS, SOLIDS

SURFACES = (*SHELLS, "CSHEAR")
FACES = {  # corner positions of each face, counter-clockwise seen from outside
    "CHEXA": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "CPENTA": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "CPYRAM": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "CTETRA": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
}


def face(card: str, nodes: Sequence[int], first: int, other: int) -> list[int]:
    """The face of a solid that PLOAD4 names: its corners from `first` on, seen from outside, and
    its mid-side nodes.

    Parameters
    ----------
    card : str
    nodes : sequence of int
        Of the solid; 0 for a mid-side node that is not there.
    first : int
        G1, a corner of the face.
    other : int
        G3 or G4: the opposite corner of a quadrilateral, for a triangle 0 or the other end of its
        side on the base of a pyramid, and the corner of a tetrahedron off the face.

    Raises
    ------
    InputError
        If they mean no one face.
    """
    solid = SOLIDS[card]
    corners = list(nodes[: solid.corners])
    a, b = (corners.index(g) if g in corners else -1 for g in (first, other))
    found = [f for f in FACES[card] if a in f and _meant(card, f, f.index(a), b, bool(other))]
    if len(found) != 1:
        raise InputError(f"G1 = {first} and G3/G4 = {other or 'blank'} mean no face of the {card}")
    at = found[0].index(a)
    turned = found[0][at:] + found[0][:at]
    middle = {frozenset(ends): solid.corners + k for k, ends in enumerate(solid.edges)}
    every = [*turned, *(middle[frozenset(side)] for side in pairwise([*turned, a]))]
    return [nodes[i] if i < len(nodes) else 0 for i in every]


def _meant(card: str, f: tuple[int, ...], at: int, other: int, named: bool) -> bool:
    """Whether G1 at position `at` of a face and corner `other` mean this face."""
    if card == "CTETRA":
        return other >= 0 and other not in f
    if len(f) == 4:
        return f[(at + 2) % 4] == other or (card == "CPYRAM" and not named)
    return other in f if card == "CPYRAM" else not named


def face_forces(x: Float, p: Float, towards: Callable[[Float], Float] | None = None) -> Float:
    """Forces (e, 2c, 3) of pressures at the corners of faces: ∫ N p n dA.

    Parameters
    ----------
    x : (e, 2c, 3) float64
        The c corners, 3 or 4, then the mid-side nodes, nan where there is none: the side is linear
        there.
    p : (e, c) float64
    towards : callable, optional
        Directions (e, p, 3) at points (e, p, 3); without it pressures act along the normal by the
        right-hand rule.
    """
    c = x.shape[1] // 2
    rule = TRIA6 if c == 3 else QUAD8
    points, weights = triangle(5) if c == 3 else (QUAD8.points, QUAD8.weights)
    absent = np.isnan(x[:, c:])
    x = np.concatenate(
        [x[:, :c], np.where(absent, x[:, rule.sides].mean(axis=2), x[:, c:])], axis=1
    )
    N, slopes = rule.shapes(points)
    area = np.cross(*np.einsum("pkr,eka->repa", slopes, x))
    if towards is not None:
        area = length(area)[..., None] * unit(towards(np.einsum("pk,eka->epa", N, x)))
    force = np.einsum("p,ep,epa,pk->eka", weights, p @ rule.corner_shapes(points).T, area, N)
    of_absent = np.where(absent, force[:, c:], 0.0)
    force[:, c:] -= of_absent
    for end in (0, 1):  # half to each end of the side; each corner is that end of one side
        force[:, rule.sides[:, end]] += of_absent / 2
    return np.asarray(force)
