"""CTRIA3, CTRIAR: constant curvature, the residual bending flexibility of each side as a beam,
constant membrane strain, drilling.

PARAM,RESBEND,NO takes discrete Kirchhoff bending (DKT; Batoz, Bathe and Ho 1980) instead. Where the
section asks for it (laminates, and PSHELL with a shear material other than that of bending) its
transverse shear is that of the DKMT (Katili 1993), which is the DKT in the limit. A homogeneous
plate is without it: its bending stiffness is then exactly proportional to t³.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.fem.elements.curved_shell import drilling as director_drilling
from ringtrue.fem.elements.curved_shell import (
    flat_and_curved,
    joined_to_plane,
    law,
    node_normals,
    plane_strains,
    tied_shear,
)
from ringtrue.fem.elements.elasticity import gram, jacobian
from ringtrue.fem.elements.shape_functions import TRIA3
from ringtrue.fem.elements.shell_material import contract
from ringtrue.fem.elements.shell_section import (
    ShellSection,
    drilling,
    finish,
    in_series,
    neutral_bending,
    oriented,
    place,
    section,
    to_nodes,
)
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    arm,
    congruent,
    nodal,
    taken,
    unit,
)
from ringtrue.model.cards import TRIANGLE

_P = TRIA3.points
_L, _DLP = TRIANGLE.functions(1, _P)
_DL = _DLP[0]
_SIDES = TRIANGLE.edges


def flatten(x: Any_) -> tuple[Any_, Any_, Any_]:
    """Axes (e, 3, 3), plane coordinates (e, 3, 2) and areas (e,) of nodes (e, 3, 3)."""
    e1 = unit(x[:, 1] - x[:, 0])
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.sqrt((n * n).sum(axis=1)) / 2
    n = n / np.where(area == 0, 1.0, 2 * area)[:, None]
    axes = np.stack([e1, np.cross(n, e1), n], axis=1)
    return (
        axes,
        np.einsum("eij,ekj->eki", axes, x - x.mean(axis=1, keepdims=True))[..., :2],
        area,
    )


def _sides(xy: Any_) -> tuple[Any_, Any_]:
    """Unit vectors (e, 3, 2) and lengths (e, 3) of the sides."""
    i, j = np.array(_SIDES).T
    d = xy[:, j] - xy[:, i]
    length = np.sqrt((d * d).sum(axis=2))
    return d / length[..., None], length


def _turns(t: Any_, length: Any_) -> Any_:
    """(wj - wi)/l + (βsi + βsj)/2 of each side over (w, θx, θy) of each node: (e, side, 3, 3).

    It is zero where the slope along a side is that of its ends.
    """
    R = np.zeros((len(t), 3, 3, 3), dtype=t.dtype)
    for s, (i, j) in enumerate(_SIDES):
        R[:, s, i, 0] = -1 / length[:, s]
        R[:, s, j, 0] = 1 / length[:, s]
        for node in (i, j):  # βs = θy tx - θx ty
            R[:, s, node, 1] = -t[:, s, 1] / 2
            R[:, s, node, 2] = t[:, s, 0] / 2
    return R


def _corner_slopes(e: int) -> Any_:
    """(βx, βy) at the corners over (w, θx, θy) of each node: (e, 3, 2, 3, 3)."""
    H = np.zeros((e, 3, 2, 3, 3))
    for k in range(3):
        H[:, k, 0, k, 2] = 1.0
        H[:, k, 1, k, 1] = -1.0
    return H


def _slopes(t: Any_, R: Any_, phi: Any_) -> Any_:
    """(βx, βy) at corners and mid-sides over (w, θx, θy) of each node: (e, 6, 2, 3, 3).

    At a mid-side the slope is the mean of its ends, and along it -3/2 R/(1 + φ) more (R of
    `_turns`): that of a cubic w for φ = 0 (Batoz, Bathe and Ho 1980), with the shear of the side
    for φ > 0 (Katili 1993, eq. 31).
    """
    H = np.zeros((len(t), 6, 2, 3, 3), dtype=np.result_type(R, phi))
    H[:, :3] = _corner_slopes(len(t))
    for s, (i, j) in enumerate(_SIDES):
        more = (-1.5 / (1 + phi[:, s]))[:, None, None] * R[:, s]
        H[:, 3 + s] = (H[:, i] + H[:, j]) / 2 + t[:, s, :, None, None] * more[:, None]
    return H


def _shear_flexibility(t: Any_, length: Any_, s: ShellSection) -> Any_:
    """φ = 12 D/(S l²) along each side (e, 3), D and S of that direction; 0 where the shear is
    rigid.
    """
    c = t[..., 0]
    n = t[..., 1]
    q = np.stack([c * c, n * n, 2 * c * n], axis=-1)
    D = np.einsum("esi,eij,esj->es", q, s.bending, q)
    S = np.einsum("esi,eij,esj->es", t, s.shear, t)
    follow = s.flexible[:, None] & (S != 0)
    return np.where(follow, 12 * D / (np.where(S == 0, 1.0, S) * length**2), 0.0)


def _of_sides(t: Any_, s: ShellSection, w: Any_) -> Any_:
    """Stiffness (e, side, side) of the transverse shear strains along the sides, carried to the
    corners, linear between; w (e, gp) are the weights.
    """
    corner = np.zeros((len(t), 3, 2, 3), dtype=t.dtype)
    for k, pair in enumerate(([2, 0], [0, 1], [1, 2])):
        corner[:, k][:, :, pair] = np.linalg.inv(t[:, pair])
    rows = np.einsum("gk,ekis->egis", _L, corner)
    return np.asarray(
        np.einsum("egis,eij,egjr,eg->esr", rows, s.shear, rows, w, optimize=True)
    )


def _bending_flexibility(t: Any_, length: Any_, area: Any_, s: ShellSection) -> Any_:
    """The residual bending flexibility (e, side, side): l²/(12 A) over the bending stiffness of
    each side as a beam (MacNeal 1978); none where there is no bending stiffness.
    """
    D = neutral_bending(s)
    bends = (np.diagonal(D, axis1=1, axis2=2) != 0).all(axis=1)
    D = np.where(bends[:, None, None], D, np.eye(3))
    c = t[..., 0]
    n = t[..., 1]
    q = np.stack([c * c, n * n, c * n], axis=-1)
    beam = np.einsum("esi,eij,esj->es", q, np.linalg.inv(D), q) * bends[:, None]
    return np.asarray((length**2 * beam / (12 * area[:, None]))[:, :, None] * np.eye(3))


def kernel(xy: Any_, area: Any_, s: ShellSection, residual: bool) -> Any_:
    """Local stiffness (e, 3, 6, 3, 6) of triangles with corners xy (e, 3, 2); `residual` is
    PARAM,RESBEND.
    """
    e = len(xy)
    back = np.linalg.inv(np.einsum("nr,ena->era", _DL, xy))
    g1 = np.broadcast_to(np.einsum("ear,nr->ena", back, _DL)[:, None], (e, 3, 3, 2))
    w = np.repeat(area[:, None] / 3, 3, axis=1)
    w1, w2, w3 = (s.weights(w, _L, p) for p in (1, 2, 3))
    t, length = _sides(xy)
    R = _turns(t, length)
    across = _of_sides(t, s, w1)
    if residual:
        H = _corner_slopes(e)
        g2 = g1
        across = in_series(across, _bending_flexibility(t, length, area, s))
    else:
        phi = _shear_flexibility(t, length, s)
        H = _slopes(t, R, phi)
        g2 = np.einsum("ear,gnr->egna", back, TRIANGLE.functions(2, _P)[1])
        share = phi / (1 + phi)
        across = share[:, :, None] * across * share[:, None]
    H = H.reshape(e, 2 * H.shape[1], 9)
    R = R.reshape(e, 3, 9)
    bend = H.swapaxes(1, 2) @ contract(gram(g2, w3), s.bending) @ H
    bend = bend + R.swapaxes(1, 2) @ across @ R
    stretch = contract(gram(g1, w1), s.membrane)
    K = np.zeros(
        (e, 3, 6, 3, 6), dtype=np.result_type(stretch, s.coupling, bend, s.drill)
    )
    place(K, [0, 1], stretch)
    place(K, [2, 3, 4], bend)
    if np.any(s.coupling):
        cross = gram(np.concatenate([g1, g2], axis=2), w2)[:, :3, :, 3:]
        mixed = contract(cross, s.coupling) @ H
        place(K, [0, 1], mixed, [2, 3, 4])
        place(K, [2, 3, 4], mixed.swapaxes(1, 2), [0, 1])
    place(K, [0, 1, 5], s.drill[:, None, None] * drilling(_L, g1, w1))
    return K


def curved_kernel(x: Any_, normals: Any_, axes: Any_, s: ShellSection) -> Any_:
    """Stiffness (e, 18, 18) in basic of elements with nodes x (e, 3, 3) and normals (e, 3, 3) of a
    curved surface; each node is joined to the offset plane by a rigid arm along its normal.
    """
    e = len(x)
    arms, x, xy = joined_to_plane(x, normals, axes, s.offset[:, None])
    J, det, _ = jacobian(_DLP, xy)
    w = det * TRIA3.weights
    rows = plane_strains(TRIA3, x, normals, np.linalg.inv(J))
    loaded = law(s, w, _L)[..., :6, :6] @ rows
    K = rows.reshape(e, 18, 18).swapaxes(1, 2) @ loaded.reshape(e, 18, 18)
    t, length = _sides(xy)
    across = _of_sides(t, s, s.weights(w, _L, 1))
    across = in_series(across, _bending_flexibility(t, length, w.sum(axis=1), s))
    turns = tied_shear(TRIA3, x, normals) / length[:, :, None]
    K = K + turns.swapaxes(1, 2) @ across @ turns
    K = K + director_drilling(TRIA3, x, s, points=_P, weights=TRIA3.weights)
    return congruent(nodal(arm(arms)), K)


def measure(t: CardRows) -> Any_:
    """Areas (e,)."""
    return flatten(t.mesh.xyz[t.nodes("G1", "G2", "G3")])[2]


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CTRIA3 or CTRIAR.

    Raises
    ------
    DeckError
        If an element has no area.
    """
    nodes = t.nodes("G1", "G2", "G3")
    x = t.mesh.xyz[nodes]
    axes, xy, area = flatten(x)
    t.refuse(area == 0, "it has no area; check its nodes")
    s = oriented(t, section(t, 3), axes, x)
    mass = s.masses(np.repeat(area[:, None] / 3, 3, axis=1), _L) @ _L
    residual = t.mesh.model.param("RESBEND", 1.0) > 0
    own = np.broadcast_to(axes[:, None, 2], x.shape)
    normals = node_normals(t.mesh, nodes, axes[:, 2]) if residual else own

    def curved(at: Int) -> Any_:
        return curved_kernel(x[at], normals[at], axes[at], taken(s, at))

    def plane(at: Bool | slice) -> Any_:
        part = taken(s, at)
        flat = kernel(xy[at], area[at], part, residual)
        return to_nodes(flat, part, axes[at], np.zeros(xy[at].shape[:2]))

    K = flat_and_curved(normals, axes, plane, curved)
    return finish(t, nodes, K, section=s, axes=axes, mass=mass)
