"""Pressures on shells and faces of solids, and loads between the nodes of CBAR and CBEAM, as forces
at their nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.errors import InputError
from ringtrue.fem.element_cards import SHELLS, SOLIDS
from ringtrue.fem.elements import bar
from ringtrue.fem.elements.curved_shell import length
from ringtrue.fem.elements.shape_functions import QUAD8, TRIA6, triangle
from ringtrue.fem.mesh import CardRows, Isotropic, arm, node_dofs, unit

SURFACES = (*SHELLS, "CSHEAR")
FACES = {  # corner positions of each face, counter-clockwise seen from outside
    "CHEXA": (
        (0, 3, 2, 1),
        (4, 5, 6, 7),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
    ),
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
    found = [
        f
        for f in FACES[card]
        if a in f and _meant(card, f, f.index(a), other=b, named=bool(other))
    ]
    if len(found) != 1:
        raise InputError(
            f"G1 = {first} and G3/G4 = {other or 'blank'} mean no face of the {card}"
        )
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


def face_forces(
    x: Float, p: Float, towards: Callable[[Float], Float] | None = None
) -> Float:
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
    force = np.einsum(
        "p,ep,epa,pk->eka", weights, p @ rule.corner_shapes(points).T, area, N
    )
    of_absent = np.where(absent, force[:, c:], 0.0)
    force[:, c:] -= of_absent
    # half to each end of the side; each corner is that end of one side
    for end in (0, 1):
        force[:, rule.sides[:, end]] += of_absent / 2
    return np.asarray(force)


# five do for a uniform beam
_POINTS = np.stack(np.polynomial.legendre.leggauss(8), axis=1) / 2 + [0.5, 0.0]
NEAREST = 1e-12  # share of the length: a load nearer to end A moves as end A does
NOTHING = 1e-9  # share of a load that is rounding
SINGULAR = 1e-12  # of released ends: a mechanism


@dataclass(frozen=True, slots=True, eq=False)
class LineLoads:
    """Loads along beams, one a row.

    Attributes
    ----------
    ends : (e, 2) float64
        Where on the axis x of the beam the load begins and ends; a single load has them equal.
    sizes : (e, 2) float64
        At the two, a length, linear between them; the first of a single load.
    along : (e, 6) float64
        The force and moment of unit size.
    own : (e,) bool
        `along` is in the axes of the element, not of basic.
    fraction : (e,) bool
        `ends` are shares of the length.
    projected : (e,) bool
        `sizes` are for a length as a view along the load, a force, sees it.
    """

    ends: Float
    sizes: Float
    along: Float
    own: Bool
    fraction: Bool
    projected: Bool


def line_forces(t: CardRows, loads: LineLoads) -> Float:
    """Forces (dof,) float64 at the full DOFs, in basic, that do the work of loads on beams.

    A load does as much work in a motion of the ends as they do together, and how a beam moves when
    its ends do is what its stiffness says of the part up to the load: exact for any section, as the
    stiffness is. Released ends carry nothing.

    Parameters
    ----------
    t : CardRows
        Rows (e,) of CBAR or CBEAM, one for each load.
    loads : LineLoads

    Raises
    ------
    DeckError
        As `ringtrue.fem.elements.bar.build` does, and if a beam has no stiffness against its load.
    """
    placed = bar.place(t)
    iso, s = bar.section(t)
    K = np.asarray(bar.stiffness(placed.L, iso, s), dtype=np.float64)
    turned = (loads.along.reshape(-1, 2, 3) @ placed.axes.swapaxes(1, 2)).reshape(-1, 6)
    local = np.where(loads.own[:, None], loads.along, turned)
    share = loads.ends / np.where(loads.fraction, 1.0, placed.L)[:, None]
    wide = share[:, 1] - share[:, 0]
    seen = np.where(loads.projected, np.linalg.norm(local[:, 1:3], axis=1), 1.0)
    span = np.where(wide > 0, wide * placed.L * seen, 1.0)
    first, last = loads.sizes.T
    work = np.zeros((len(t), 12))
    # a fixed number of points; all stand at one where the load is single
    for point, weight in _POINTS.tolist():
        size = weight * span * (first + point * (last - first))
        motion = _motion(K, placed.L, iso, s=s, x=share[:, 0] + point * wide)
        work += np.einsum("eij,ei->ej", motion, local * size[:, None])
    work, carried = _released(K, placed.released, work)
    soft = (np.abs(local) > NOTHING) & (np.einsum("eii->ei", K)[:, 6:] <= 0)
    why = "cannot carry its PLOAD1: no stiffness along it, or both ends released"
    t.refuse(~carried | soft.any(axis=1), why)
    out = np.zeros(t.mesh.size)
    np.add.at(out, node_dofs(placed.nodes), np.einsum("eij,ei->ej", placed.local, work))
    return out


def _motion(K: Float, L: Float, iso: Isotropic, s: bar.BeamSection, x: Float) -> Float:
    """Motion (e, 6) at places of the axis by that of the ends: (e, 6, 12)."""
    x = np.maximum(x, NEAREST)
    to_x = np.stack([x * L, 0 * L, 0 * L], axis=1)
    part = np.asarray(bar.stiffness(x * L, iso, _up_to(s, x)), dtype=np.float64)[
        :, 6:, 6:
    ]
    # the force with which the rest pulls at the part up to the load
    cut = -arm(-to_x).swapaxes(1, 2) @ K[:, :6]
    # K⁻¹b, 0 along DOFs without stiffness; scaled first
    d = _scale(part)
    scaled = part * d[..., None] * d[..., None, :]
    scaled += (np.einsum("...ii->...i", part) <= 0)[..., None] * np.eye(part.shape[-1])
    moved = np.asarray(d[..., None] * np.linalg.solve(scaled, d[..., None] * cut))
    moved[:, :, :6] += arm(to_x)
    return moved


def _up_to(s: bar.BeamSection, end: Float) -> bar.BeamSection:
    """The sections from end A to the places `end` (e,), which become end B; the masses are not
    cut.
    """
    k = np.clip((s.x <= end[:, None]).sum(axis=1) - 1, 0, s.x.shape[1] - 2)[:, None]
    a, b = (np.take_along_axis(s.x, i, axis=1) for i in (k, k + 1))
    t = (end[:, None] - a) / np.where(b > a, b - a, 1.0)

    def cut(v: Any_) -> Any_:
        at_a, at_b = (np.take_along_axis(v, i, axis=1) for i in (k, k + 1))
        return np.where(s.x < end[:, None], v, at_a + t * (at_b - at_a))

    A, I1, I2, I12, J = (cut(v) for v in (s.A, s.I1, s.I2, s.I12, s.J))
    last = s.neutral[:, 0] + end[:, None] * (s.neutral[:, 1] - s.neutral[:, 0])
    neutral = np.stack([s.neutral[:, 0], last], axis=1)
    x = np.minimum(s.x / end[:, None], 1.0)
    return replace(s, x=x, A=A, I1=I1, I2=I2, I12=I12, J=J, neutral=neutral)


def _released(K: Float, pins: Bool, ends: Float) -> tuple[Float, Bool]:
    """Forces (e, 12) at ends of which some DOFs (e, 12) are free: they are passed on to the others,
    where these can carry them, (e,) bool.
    """
    ends, carried = ends.copy(), np.ones(len(ends), dtype=bool)
    # few beams between nodes are loaded and have joints
    for i in np.flatnonzero(pins.any(axis=1)):
        drop = np.flatnonzero(pins[i])
        keep = np.flatnonzero(~pins[i])
        d = _scale(K[i][np.ix_(drop, drop)])
        free = K[i][np.ix_(drop, drop)] * d * d[:, None]
        given = d * ends[i, drop]
        moved = np.linalg.lstsq(free, given, rcond=SINGULAR)[0]
        carried[i] = (
            np.abs(free @ moved - given).max()
            <= NOTHING * d.max() * np.abs(ends[i]).max()
        )
        ends[i, keep] -= K[i][np.ix_(keep, drop)] @ (d * moved)
        ends[i, drop] = 0.0
    return ends, carried


def _scale(K: Float) -> Float:
    """By which rows and columns of K (..., d, d) get a diagonal of ones."""
    size = np.einsum("...ii->...i", K)
    return 1 / np.sqrt(np.where(size > 0, size, 1.0))
