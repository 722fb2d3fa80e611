"""CSHEAR: a panel that carries shear between the stringers on its edges, flat or warped.

The stress is that of Garvey (The quadrilateral shear panel, Aircraft Engineering 23, 1951; NASTRAN
Theoretical Manual section 5.3): every line through the intersection of two opposite edges carries
shear alone. With the distances ρ1, ρ2 from the two intersections and p from the line that joins
them, that is σ = (ρ1 ρ2ᵀ + ρ2 ρ1ᵀ) / p³, which is in equilibrium on any quadrilateral. In
homogeneous coordinates parallel edges, whose intersection is at infinity, need no case of their
own. The forces of the corners act along the diagonals, so that a warped panel is in equilibrium,
too.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.elements import rod
from ringtrue.fem.mesh import CardRows, ElementMatrices, isotropic, node_dofs, unit
from ringtrue.model.cards import QUADRILATERAL

# eight digits where the panel is tapered 8 : 1
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_EDGES = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
_CORNERS = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]])
FULL = 1.01  # an F up to this is a share of the panel, over it a width in thicknesses


def flat(x: Float) -> tuple[Float, Float]:
    """Corners in the mean plane with edge 1-2 along x, (e, 4, 2), and the projected area (e,); x
    (e, 4, 3).
    """
    normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    area = np.linalg.norm(normal, axis=1) / 2
    k = normal / np.where(area == 0, 1.0, 2 * area)[:, None]
    side = x[:, 1] - x[:, 0]
    i = side - np.einsum("ei,ei->e", side, k)[:, None] * k
    i = unit(np.where((i == 0).all(axis=1, keepdims=True), 1.0, i))
    plane = np.stack([i, np.cross(k, i)], axis=1)
    return np.einsum("eij,enj->eni", plane, x - x[:, :1]), area


def _turned(a: Float, b: Float) -> Float:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def is_convex(x: Float) -> Any_:
    """Whether all inner angles are less than 180 degrees in the mean plane, (e,) bool; x (e, 4,
    3).
    """
    xy, area = flat(x)
    side = np.roll(xy, -1, axis=1) - xy
    return (_turned(side, np.roll(side, -1, axis=1)) > 1e-9 * area[:, None]).all(
        axis=1
    ) & (area > 0)


def _from(P: Float, at: Float) -> Float:
    """Directions (e, n, 2) from homogeneous points P (e, 3) to points (e, n, 2), in units that each
    P has.
    """
    return P[:, None, 2:] * at - P[:, None, :2]


def _shear_flow(xy: Float, P: Float, Q: Float, line: Float) -> Float:
    """Mean shear on edge 1-2 of the stress (ρ1 ρ2ᵀ + ρ2 ρ1ᵀ) / p³, (e,).

    On that edge ρ1 and p are proportional, and the mean of 1/p² between two points is 1/(p1 p2).
    """
    ends = xy[:, :2]
    p = np.einsum("enj,ej->en", ends, line[:, :2]) + line[:, 2:]
    nearer = np.abs(p).argmax(axis=1)
    row = np.arange(len(xy))
    ratio = _from(P, ends)[row, nearer, 0] / p[row, nearer]
    return np.asarray(ratio * _from(Q, ends)[:, 0, 1] / (p[:, 0] * p[:, 1]))


def flexibility(x: Float) -> tuple[Float, Float]:
    """Geometry of the strain energy q²/(2 G t) (A1 + A2 / (1 + ν)) under a mean flow q on edge 1-2.

    Parameters
    ----------
    x : (e, 4, 3) float64

    Returns
    -------
    A1, A2 : (e,) float64
        A1 is the area for a rectangle, A2 is 0 there.
    """
    xy, area = flat(x)
    size = np.sqrt(area)[:, None, None]
    xy = xy / size
    h = np.concatenate([xy, np.ones((len(xy), 4, 1))], axis=2)
    sides = np.cross(h, np.roll(h, -1, axis=1))
    P = np.cross(sides[:, 0], sides[:, 2])
    Q = np.cross(sides[:, 1], sides[:, 3])
    line = np.cross(P, Q)
    r, s = (g.ravel() for g in np.meshgrid(_POINTS, _POINTS))
    N, dN = QUADRILATERAL.functions(1, np.stack([r, s], axis=1))
    at = N @ xy
    jacobian = _turned(dN[..., 0] @ xy, dN[..., 1] @ xy)
    a = _from(P, at)
    b = _from(Q, at)
    p = np.einsum("enj,ej->en", at, line[:, :2]) + line[:, 2:]
    w = np.outer(_WEIGHTS, _WEIGHTS).ravel() * jacobian * size[:, :, 0] ** 2 / p**6
    cosine = np.einsum("eni,eni->en", a, b)
    sine = _turned(a, b)  # |ρ1 ρ2| sin², and twice the energy: sin² + 2 cos² / (1 + ν)
    q = _shear_flow(xy, P, Q, line) ** 2
    return (w * sine**2).sum(axis=1) / q, 2 * (w * cosine**2).sum(axis=1) / q


def kernel(x: Float, G: Any_, nu: Any_, thickness: Any_) -> Any_:
    """Stiffness in basic: x (e, 4, 3), G, ν and t (e,) -> (e, 12, 12)."""
    xy, _ = flat(x)
    v = xy[:, 1:] - xy[:, :1]
    back = xy - xy[:, 1:2]
    # of edge 1-2 in the diagonals 1-3 and 4-2
    along = _turned(v[:, 0], v[:, 2]) / _turned(v[:, 1], v[:, 2])
    across = _turned(-v[:, 0], back[:, 2]) / _turned(back[:, 3], back[:, 2])
    first = along[:, None] * (x[:, 2] - x[:, 0]) / 2
    second = across[:, None] * (x[:, 3] - x[:, 1]) / 2
    forces = np.concatenate([first, -second, -first, second], axis=1)
    plain, skew = flexibility(x)
    c = G * thickness / (plain + skew / (1 + nu))
    return np.asarray(np.einsum("e,ei,ej->eij", c, forces, forces))


def stringers(x: Float, E: Any_, F1: Any_, F2: Any_, thickness: Any_) -> Any_:
    """Stiffness (e, 12, 12) of the rods on the edges that stand for the panel's extension.

    F1 and F2 give their areas on two opposite edges each (MSC Nastran Quick Reference Guide,
    PSHEAR).
    """
    length = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    area = flat(x)[1]
    K = np.zeros((len(x), 4, 3, 4, 3), dtype=np.result_type(E, F1, F2, thickness))
    for i, edge in enumerate(_EDGES):
        F = (F1, F2)[i % 2]
        opposite = length[:, i] + length[:, (i + 2) % 4]
        shared = F * thickness * area / opposite
        EA = E * np.where(np.real(F) <= FULL, shared, 0.5 * F * thickness**2)
        one = rod.kernel(x[:, edge], EA, np.zeros_like(EA)).reshape(-1, 2, 6, 2, 6)[
            :, :, :3, :, :3
        ]
        K[:, edge[:, None], :, edge[None, :], :] += one.transpose(1, 3, 0, 2, 4)
    return K.reshape(-1, 12, 12)


def corner_areas(x: Float) -> Float:
    """Share of the area (e, 4) that each corner carries: thirds of four triangles that cover the
    panel twice.
    """
    t = x[:, _CORNERS]
    triangle = (
        np.linalg.norm(
            np.cross(t[:, :, 1] - t[:, :, 0], t[:, :, 2] - t[:, :, 0]), axis=2
        )
        / 2
    )
    out = np.zeros((len(x), 4))
    for k, corners in enumerate(_CORNERS):
        out[:, corners] += triangle[:, k, None] / 6
    return out


def _points(t: CardRows) -> tuple[Int, Float]:
    nodes = t.nodes("G1", "G2", "G3", "G4")
    x = t.mesh.xyz[nodes]
    why = "its nodes do not go round a panel with inner angles under 180 degrees"
    t.refuse(~is_convex(x), why)
    return nodes, x


def measure(t: CardRows) -> Float:
    """Areas (e,) in the mean plane."""
    return flat(_points(t)[1])[1]


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CSHEAR.

    Raises
    ------
    DeckError
        If the panel is folded or not convex, its thickness is 0, or a node, property or MAT1 is
        absent.
    """
    nodes, x = _points(t)
    p = t.named("PSHEAR")
    iso = isotropic(p.named("MAT1", "MID"))
    T = p["T"]
    p.refuse(T == 0, "T is 0 or blank; a shear panel has a thickness")
    K = kernel(x, iso.G, iso.nu, T) + stringers(
        x, iso.E, p["F1"], F2=p["F2"], thickness=T
    )
    lumped = (iso.rho * T + p["NSM"] + t.listed_mass)[:, None] * corner_areas(x)
    return ElementMatrices(
        dofs=node_dofs(nodes, 3),
        stiffness=K,
        mass=np.repeat(lumped, 3, axis=1),
        loss=iso.loss,
    )
