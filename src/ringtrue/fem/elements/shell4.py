"""CQUAD4: MITC4 bending and shear, membrane with incompatible modes, drilling, flat with rigid arms
to the nodes.

Bathe and Dvorkin (1985) for the transverse shear; Taylor, Beresford and Wilson (1976) for the
membrane. Every part is linear in E and in t or t³, so that the parts of a thickness parameter are
exact. Membrane and drilling are those of MSC Nastran, to all digits of recorded element matrices.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Int
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
from ringtrue.fem.mesh import ElementMatrices, Mesh, arm, congruent, nodal, unit
from ringtrue.model.cards import QUADRILATERAL
from ringtrue.model.model import card_error

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
    return np.asarray(np.linalg.solve(J, rows))


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
    K = _turn_columns(K)
    return _turn_columns(K.swapaxes(1, 2)).swapaxes(1, 2)


def _turn_columns(K: Any_) -> Any_:
    parts = K.reshape(len(K), -1, 4, 3)
    return np.stack([parts[..., 0], -parts[..., 2], parts[..., 1]], axis=-1).reshape(K.shape)


def measure(m: Mesh, card: str, at: Int) -> Any_:
    """Areas (e,) of the rows `at` in their mean planes."""
    t = m.model[card]
    xy = flatten(m.xyz[m.nodes(t.stack("G1", "G2", "G3", "G4")[at], t, at)])[1]
    return np.asarray(jacobian(_DN, xy)[1].sum(axis=1))


def build(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CQUAD4 or CQUADR.

    Raises
    ------
    DeckError
        If an element is not convex.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2", "G3", "G4")[at], t, at)
    axes, xy, heights = flatten(m.xyz[nodes])
    bent = ~(determinants(_SLOPES, xy.real) > 0).all(axis=1)
    if bent.any():
        bad = int(at[np.flatnonzero(bent)[0]])
        raise card_error(
            m.model,
            t,
            bad,
            "a corner of 180 degrees or more, or sides that cross; check its node order",
        )
    s = oriented(m, card, at, s=section(m, card, at, 4), axes=axes, x=m.xyz[nodes])
    mass = np.einsum("eg,gn->en", s.masses(jacobian(_DN, xy)[1], _N), _N)
    K = _stiffness(
        m.xyz[nodes], xy, heights, normals=node_normals(m, nodes, axes[:, 2]), axes=axes, s=s
    )
    return finish(m, nodes, K, section=s, axes=axes, mass=mass)


def _stiffness(
    x: Any_, xy: Any_, heights: Any_, normals: Any_, axes: Any_, s: ShellSection
) -> Any_:
    """Stiffness (e, 24, 24) in basic: of a curved surface where normals at the nodes are not the
    element's own.
    """
    flat = (normals == axes[:, None, 2]).all(axis=(1, 2))
    if flat.all():
        return to_nodes(kernel(xy, s), s, axes, heights)
    x = x[~flat]
    up = heights[~flat]
    n = normals[~flat]
    R = axes[~flat]
    part = s.take(~flat)
    curved = in_spans(len(x), lambda i: curved_kernel(x[i], up[i], n[i], axes=R[i], s=part.take(i)))
    if not flat.any():
        return curved
    plane = to_nodes(kernel(xy[flat], s.take(flat)), s.take(flat), axes[flat], heights[flat])
    K = np.empty((flat.size, *curved.shape[1:]), dtype=np.result_type(plane, curved))
    K[flat] = plane
    K[~flat] = curved
    return K
