"""CQUAD4: MITC4 bending and shear, membrane with incompatible modes, drilling, flat with rigid arms
to the nodes.

Bathe and Dvorkin (1985) for the transverse shear; Taylor, Beresford and Wilson (1976) for the
membrane. Every part is linear in E and in t or t³, so that the parts of a thickness parameter are
exact. Membrane and drilling are those of MSC Nastran, to all digits of recorded element matrices.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool
from ringtrue.fem.elements.curved_shell import drilling as director_drilling
from ringtrue.fem.elements.curved_shell import law, node_normals, strains
from ringtrue.fem.elements.elasticity import determinants, gram, incompatible, jacobian
from ringtrue.fem.elements.shape_functions import QUAD4
from ringtrue.fem.elements.shell_material import contract
from ringtrue.fem.elements.shell_section import (
    ShellSection,
    condensed,
    drilling,
    finish,
    in_spans,
    of_rotations,
    oriented,
    place,
    section,
    to_nodes,
)
from ringtrue.fem.mesh import CardRows, ElementMatrices, arm, congruent, nodal, taken, unit
from ringtrue.model.cards import QUADRILATERAL

_SIGNS = QUADRILATERAL.nodes(1)
_POINTS = _SIGNS / np.sqrt(3)
_WHOLE = np.full(4, 4.0)  # weights of the drilling at the corners: each counts as the whole element


_N, _DN = QUADRILATERAL.functions(1, _POINTS)
_BUBBLES = -2 * _POINTS[:, :, None] * np.eye(2)
_SLOPES = QUADRILATERAL.functions(1, _SIGNS)[1]
_CENTRE = QUADRILATERAL.functions(1, np.zeros((1, 2)))[1]
# of the sides η = ∓1, ξ = ∓1
_MID = QUADRILATERAL.functions(1, np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]]))


def flatten(x: Any_) -> tuple[Any_, Any_, Any_]:
    """Axes (e, 3, 3), plane coordinates (e, 4, 2) and heights (e, 4) of nodes (e, 4, 3)."""
    n = unit(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]))
    e1 = x[:, 1] + x[:, 2] - x[:, 0] - x[:, 3]
    e1 = unit(e1 - np.einsum("ei,ei->e", e1, n)[:, None] * n)
    axes = np.stack([e1, np.cross(n, e1), n], axis=1)
    local = np.einsum("eij,ekj->eki", axes, x - x.mean(axis=1, keepdims=True))
    return axes, local[..., :2], local[..., 2]


def _assumed_shear(xy: Any_, J: Any_) -> Any_:
    """Rows (e, gp, 2, 12) of the Cartesian shear strains over (w, βx, βy) of each node."""
    _, d = _MID
    N = _MID[0]
    tangent = np.einsum("gnr,ena->egra", d, xy)
    cov = np.empty((len(xy), 4, 4, 3), dtype=xy.dtype)  # e, side, node, (w, βx, βy)
    for side, r in enumerate((0, 0, 1, 1)):
        cov[:, side, :, 0] = d[side, :, r]
        cov[:, side, :, 1:] = N[side, :, None] * tangent[:, side, r, None, :]
    xi = _POINTS[:, 0]
    eta = _POINTS[:, 1]
    mix = np.zeros((4, 2, 4))
    mix[:, 0, 0] = (1 - eta) / 2
    mix[:, 0, 1] = (1 + eta) / 2
    mix[:, 1, 2] = (1 - xi) / 2
    mix[:, 1, 3] = (1 + xi) / 2
    rows = np.einsum("grs,esnc->egrnc", mix, cov).reshape(len(xy), 4, 2, 12)
    return np.linalg.solve(J, rows)


def kernel(xy: Any_, s: ShellSection) -> Any_:
    """Local stiffness (e, 4, 6, 4, 6) of flat elements with corners xy (e, 4, 2)."""
    J, det, g = jacobian(_DN, xy)
    J0, det0, _ = jacobian(_CENTRE, xy)
    soft = incompatible(_BUBBLES, J0[:, 0], det0[:, 0], det=det, weights=det)
    stretch, mixed, bend = _plane(np.concatenate([g, soft], axis=2), det, s)
    w = s.weights(det, _N, 1)
    rows = _assumed_shear(xy, J)
    loaded = (rows.swapaxes(2, 3) @ s.shear[:, None]).swapaxes(2, 3) * w[..., None, None]
    across = loaded.reshape(-1, 8, 12).swapaxes(1, 2) @ rows.reshape(-1, 8, 12)
    K = np.zeros((len(xy), 4, 6, 4, 6), dtype=np.result_type(stretch, mixed, bend, across, s.drill))
    place(K, [0, 1], stretch)
    place(K, [2, 3, 4], _turn_shear(across))
    turned = of_rotations(of_rotations(bend).swapaxes(1, 2)).swapaxes(1, 2)
    place(K, [3, 4], turned)
    if mixed.size:
        mixed = of_rotations(mixed)
        place(K, [0, 1], mixed, [3, 4])
        place(K, [3, 4], mixed.swapaxes(1, 2), [0, 1])
    _, corner, slopes = jacobian(_SLOPES, xy)
    turning = s.drill[:, None] * s.weights(corner, np.eye(4), 1) * _WHOLE
    place(K, [0, 1, 5], drilling(np.eye(4), slopes, turning))
    return K


def curved_kernel(x: Any_, heights: Any_, normals: Any_, axes: Any_, s: ShellSection) -> Any_:
    """Stiffness (e, 24, 24) in basic of elements with nodes x (e, 4, 3) and normals (e, 4, 3) of a
    curved surface.

    The element stays flat: each node is joined to the plane (or the offset plane) by a rigid arm
    along its normal.
    """
    e = len(x)
    arms = ((s.offset[:, None] - heights) / np.einsum("eka,ea->ek", normals, axes[:, 2]))[
        ..., None
    ] * normals
    x = x + arms
    xy = np.einsum("eij,ekj->eki", axes[:, :2], x - x.mean(axis=1, keepdims=True))
    J, det, _ = jacobian(_DN, xy)
    J0, det0, _ = jacobian(_CENTRE, xy)
    soft = incompatible(_BUBBLES, J0[:, 0], det0[:, 0], det=det, weights=s.weights(det, _N, 1))
    rows = np.zeros((e, 4, 8, 28), dtype=np.result_type(x, normals, soft))
    rows[..., :24] = strains(QUAD4, x, normals, np.linalg.inv(J))
    for b in range(2):
        g = soft[:, :, b]
        rows[:, :, 0, 24 + 2 * b] = g[..., 0]
        rows[:, :, 2, 24 + 2 * b] = g[..., 1]
        rows[:, :, 1, 25 + 2 * b] = g[..., 1]
        rows[:, :, 2, 25 + 2 * b] = g[..., 0]
    loaded = (law(s, det, _N) @ rows).reshape(e, -1, 28)
    K = condensed(rows.reshape(e, -1, 28).swapaxes(1, 2) @ loaded, 4)
    K = K + director_drilling(QUAD4, x, s, points=_SIGNS, weights=_WHOLE)
    return congruent(nodal(arm(arms)), K)


def _plane(g: Any_, det: Any_, s: ShellSection) -> tuple[Any_, Any_, Any_]:
    """Membrane, membrane-bending (empty if there is none) and bending stiffness, (e, 8, 8), the
    bubbles condensed.
    """
    grams = [gram(g, s.weights(det, _N, 1))]
    grams += (
        [grams[0]] * 2
        if (s.profile == 1).all()
        else [gram(g, s.weights(det, _N, p)) for p in (2, 3)]
    )
    stretch = contract(grams[0], s.membrane)
    bend = contract(grams[2][:, :4, :, :4], s.bending)
    if not np.any(s.coupling):
        return condensed(stretch, 4), np.empty((0, 8, 8)), bend
    mixed = contract(grams[1][:, :, :, :4], s.coupling)
    K = np.concatenate(
        [
            np.concatenate([stretch, mixed], axis=2),
            np.concatenate([mixed.swapaxes(1, 2), bend], axis=2),
        ],
        axis=1,
    )
    order = np.r_[:8, 12:20, 8:12]
    K = condensed(K[:, order[:, None], order], 4)
    return K[:, :8, :8], K[:, :8, 8:], K[:, 8:, 8:]


def _turn_shear(K: Any_) -> Any_:
    """(w, βx, βy) of each node to (w, θx, θy), both sides."""
    turn = np.kron(np.eye(4), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return turn.T @ K @ turn


def measure(t: CardRows) -> Any_:
    """Areas (e,) in the mean planes."""
    xy = flatten(t.mesh.xyz[t.nodes("G1", "G2", "G3", "G4")])[1]
    return np.asarray(jacobian(_DN, xy)[1].sum(axis=1))


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CQUAD4 or CQUADR.

    Raises
    ------
    DeckError
        If an element is not convex.
    """
    nodes = t.nodes("G1", "G2", "G3", "G4")
    x = t.mesh.xyz[nodes]
    axes, xy, heights = flatten(x)
    bent = ~(determinants(_SLOPES, xy.real) > 0).all(axis=1)
    why = "a corner of 180 degrees or more, or sides that cross; check its node order"
    t.refuse(bent, why)
    s = oriented(t, section(t, 4), axes, x)
    mass = s.masses(jacobian(_DN, xy)[1], _N) @ _N
    normals = node_normals(t.mesh, nodes, axes[:, 2])
    flat = (normals == axes[:, None, 2]).all(axis=(1, 2))

    def curved(i: slice) -> Any_:
        at = np.flatnonzero(~flat)[i]
        return curved_kernel(x[at], heights[at], normals[at], axes=axes[at], s=taken(s, at))

    def plane(at: Bool | slice) -> Any_:
        part = taken(s, at)
        return to_nodes(kernel(xy[at], part), part, axes[at], heights[at])

    if flat.all():
        K = plane(slice(None))
    else:
        of_curved = in_spans(int((~flat).sum()), curved)
        of_plane = plane(flat)
        K = np.empty((len(t), 24, 24), dtype=np.result_type(of_plane, of_curved))
        K[flat] = of_plane
        K[~flat] = of_curved
    return finish(t, nodes, K, section=s, axes=axes, mass=mass)
