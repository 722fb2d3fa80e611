"""CQUAD4: membrane and bending with incompatible modes, shear with residual bending flexibility,
drilling, flat with rigid arms to the nodes.

Taylor, Beresford and Wilson (1976) for the incompatible modes; MacNeal (1978) for the residual
bending flexibility, with which one element bends as a beam does. All are those of MSC Nastran, to
the digits of recorded element matrices.

PARAM,RESBEND,NO takes the bending and shear of the MITC4 (Bathe and Dvorkin 1985) instead. Every
part is then linear in E and in t or t³.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements.curved_shell import drilling as director_drilling
from ringtrue.fem.elements.curved_shell import (
    flat_and_curved,
    joined_to_plane,
    law,
    node_normals,
    plane_strains,
    tied_shear,
)
from ringtrue.fem.elements.elasticity import determinants, gram, incompatible, jacobian
from ringtrue.fem.elements.shape_functions import QUAD4
from ringtrue.fem.elements.shell_material import contract
from ringtrue.fem.elements.shell_section import (
    TURN,
    ShellSection,
    condensed,
    drilling,
    finish,
    in_series,
    neutral_bending,
    of_rotations,
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
    scaled,
    taken,
    unit,
)
from ringtrue.model.cards import QUADRILATERAL

_SIGNS = QUADRILATERAL.nodes(1)
_POINTS = _SIGNS / np.sqrt(3)
# weights of the drilling at the corners: each counts as the whole element
_WHOLE = np.full(4, 4.0)


_N, _DN = QUADRILATERAL.functions(1, _POINTS)
_BUBBLES = -2 * _POINTS[:, :, None] * np.eye(2)
_SLOPES = QUADRILATERAL.functions(1, _SIGNS)[1]
_CENTRE = QUADRILATERAL.functions(1, np.zeros((1, 2)))[1]
# of the sides η = ∓1, ξ = ∓1
_MID = QUADRILATERAL.functions(
    1, np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]])
)
# where γx, γx, γy, γy are taken
_STATIONS = np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]]) / np.sqrt(3)
_FIRST = np.array([True, True, False, False])
_NS, _DNS = QUADRILATERAL.functions(1, _STATIONS)
# of the residual flexibility of a square, against a γx that is linear in y
_PART = 0.025


def flatten(x: Any_) -> tuple[Any_, Any_, Any_]:
    """Axes (e, 3, 3), plane coordinates (e, 4, 2) and heights (e, 4) of nodes (e, 4, 3).

    The first axis bisects the diagonals, so that another first node turns the axes by 90 degrees.
    """
    first = x[:, 2] - x[:, 0]
    second = x[:, 3] - x[:, 1]
    n = unit(np.cross(first, second))
    e1 = unit(unit(first) - unit(second))
    axes = np.stack([e1, np.cross(n, e1), n], axis=1)
    local = np.einsum("eij,ekj->eki", axes, x - x.mean(axis=1, keepdims=True))
    return axes, local[..., :2], local[..., 2]


def _tied_shear(xy: Any_) -> Any_:
    """Rows (e, side, 12) of the covariant shear strains over (w, θx, θy) of each node."""
    N, d = _MID
    cov = np.empty((len(xy), 4, 4, 3), dtype=xy.dtype)  # e, side, node, (w, θx, θy)
    for side, r in enumerate((0, 0, 1, 1)):
        tangent = d[side, :, r] @ xy
        cov[:, side, :, 0] = d[side, :, r]
        cov[:, side, :, 1:] = N[side, :, None] * (tangent @ TURN)[:, None]
    return cov.reshape(-1, 4, 12)


def _carried(points: Float) -> Float:
    """What the strains along the sides are at points (p, 2): (p, direction, side)."""
    xi, eta = points.T
    out = np.zeros((len(points), 2, 4))
    out[:, 0, 0] = (1 - eta) / 2
    out[:, 0, 1] = (1 + eta) / 2
    out[:, 1, 2] = (1 - xi) / 2
    out[:, 1, 3] = (1 + xi) / 2
    return out


def _mitc(xy: Any_, s: ShellSection) -> Any_:
    """Stiffness (e, side, side) of the covariant strains along the sides, without residual bending
    flexibility.
    """
    J, det, _ = jacobian(_DN, xy)
    rows = np.linalg.solve(J, np.broadcast_to(_carried(_POINTS), (len(xy), 4, 2, 4)))
    w = s.weights(det, _N, 1)[..., None, None]
    return np.asarray((rows.swapaxes(2, 3) @ (s.shear[:, None] * w) @ rows).sum(axis=1))


def _residual(xy: Any_, s: ShellSection) -> Any_:
    """Stiffness (e, side, side) of the covariant strains along the sides, with the residual bending
    flexibility.

    γx at two stations and γy at two others follow from the strains along the sides. To the
    flexibility of the shear itself comes what a cubic w has more than the element: Δx²/(12 D11) for
    a constant γx (MacNeal 1978), and of a γx linear in y a part that depends on the sides.
    """
    mix = _carried(_STATIONS)
    tangent = np.stack([_MID[1][side, :, side // 2] @ xy for side in range(4)], axis=1)
    length = np.sqrt((tangent * tangent).sum(axis=2))
    along = np.einsum("prs,esa->epra", mix, tangent / length[..., None])
    # γx and γy of the strains along two directions
    turn = np.where(_FIRST[:, None], along[:, :, ::-1, 1], along[:, :, ::-1, 0])
    turn = turn * np.where(_FIRST, 1, -1)[:, None] * [1, -1]
    across = (
        along[:, :, 0, 0] * along[:, :, 1, 1] - along[:, :, 0, 1] * along[:, :, 1, 0]
    )
    rows = np.einsum("epr,prs->eps", turn / across[..., None], mix) / length[:, None]
    det = determinants(_DNS, xy)
    root = np.sqrt(s.weights(2 * det, _NS, 1))
    direction = np.where(_FIRST, 0, 1)
    share = np.where(_FIRST[:, None] == _FIRST, np.eye(4), 0.5)
    G = (
        s.shear[:, direction[:, None], direction]
        * share
        * root[:, :, None]
        * root[:, None]
    )
    soft = _bending_flexibility(xy, 2 * det[:, :2].sum(axis=1), s)
    return np.asarray(rows.swapaxes(1, 2) @ in_series(G, soft) @ rows)


def _bending_flexibility(xy: Any_, area: Any_, s: ShellSection) -> Any_:
    """The residual bending flexibility (e, 4, 4) of γx, γx, γy, γy at the stations; none where
    there is no bending stiffness.
    """
    D = neutral_bending(s)
    x, y = np.moveaxis(xy, 2, 0)
    span = np.stack([x @ [-0.5, 0.5, 0.5, -0.5], y @ [-0.5, -0.5, 0.5, 0.5]], axis=1)
    square = span * span
    other = square[:, ::-1]
    part = _PART * other / (_PART * other + (1 - _PART) * square)
    own = D[:, [0, 1], [0, 1]]
    mean = square / (12 * area[:, None] * np.where(own == 0, 1.0, own))
    mean = np.where(own == 0, 0.0, mean)
    out = np.zeros((len(xy), 4, 4), dtype=mean.dtype)
    for i in range(2):
        pair = slice(2 * i, 2 * i + 2)
        out[:, pair, pair] = scaled(mean[:, i], np.ones((2, 2)))
        out[:, pair, pair] += scaled(
            mean[:, i] * part[:, i], np.array([[1, -1], [-1, 1]])
        )
    return out


def kernel(xy: Any_, s: ShellSection, residual: bool) -> Any_:
    """Local stiffness (e, 4, 6, 4, 6) of flat elements with corners xy (e, 4, 2); `residual` is
    PARAM,RESBEND.
    """
    _, det, g = jacobian(_DN, xy)
    J0, det0, _ = jacobian(_CENTRE, xy)
    soft = incompatible(_BUBBLES, J0[:, 0], det0[:, 0], det=det, weights=det)
    stretch, mixed, bend = _plane(np.concatenate([g, soft], axis=2), det, s, residual)
    tied = _tied_shear(xy)
    across = tied.swapaxes(1, 2) @ (_residual if residual else _mitc)(xy, s) @ tied
    K = np.zeros(
        (len(xy), 4, 6, 4, 6),
        dtype=np.result_type(stretch, mixed, bend, across, s.drill),
    )
    place(K, [0, 1], stretch)
    place(K, [2, 3, 4], across)
    place(K, [3, 4], of_rotations(of_rotations(bend).swapaxes(1, 2)).swapaxes(1, 2))
    if mixed.size:
        mixed = of_rotations(mixed)
        place(K, [0, 1], mixed, [3, 4])
        place(K, [3, 4], mixed.swapaxes(1, 2), [0, 1])
    _, corner, slopes = jacobian(_SLOPES, xy)
    turning = s.drill[:, None] * s.weights(corner, np.eye(4), 1) * _WHOLE
    place(K, [0, 1, 5], drilling(np.eye(4), slopes, turning))
    return K


def curved_kernel(
    x: Any_, heights: Any_, normals: Any_, axes: Any_, s: ShellSection, residual: bool
) -> Any_:
    """Stiffness (e, 24, 24) in basic of elements with nodes x (e, 4, 3) and normals (e, 4, 3) of a
    curved surface.

    The element stays flat: each node is joined to the plane (or the offset plane) by a rigid arm
    along its normal.
    """
    e = len(x)
    arms, x, xy = joined_to_plane(x, normals, axes, s.offset[:, None] - heights)
    J, det, _ = jacobian(_DN, xy)
    J0, det0, _ = jacobian(_CENTRE, xy)
    soft = incompatible(
        _BUBBLES, J0[:, 0], det0[:, 0], det=det, weights=s.weights(det, _N, 1)
    )
    modes = 8 if residual else 4
    rows = np.zeros((e, 4, 6, 24 + modes), dtype=np.result_type(x, normals, soft))
    rows[..., :24] = plane_strains(QUAD4, x, normals, np.linalg.inv(J))
    for m in range(modes):
        first = 3 * (m // 4)  # of the strains, and of the curvatures
        g = soft[:, :, m % 4 // 2]
        rows[:, :, first + m % 2, 24 + m] = g[..., m % 2]
        rows[:, :, first + 2, 24 + m] = g[..., 1 - m % 2]
    loaded = (law(s, det, _N)[..., :6, :6] @ rows).reshape(e, -1, 24 + modes)
    K = _without_modes(rows.reshape(e, -1, 24 + modes).swapaxes(1, 2) @ loaded, modes)
    tied = tied_shear(QUAD4, x, normals)
    K = K + tied.swapaxes(1, 2) @ (_residual if residual else _mitc)(xy, s) @ tied
    K = K + director_drilling(QUAD4, x, s, points=_SIGNS, weights=_WHOLE)
    return congruent(nodal(arm(arms)), K)


def _without_modes(K: Any_, modes: int) -> Any_:
    """Condense the incompatible modes out, of the bending and of the membrane, either of which may
    have no stiffness.
    """
    for _ in range(modes // 4):
        K = condensed(K, 4)
    return K


def _plane(
    g: Any_, det: Any_, s: ShellSection, residual: bool
) -> tuple[Any_, Any_, Any_]:
    """Membrane, membrane-bending (empty if there is none) and bending stiffness, (e, 8, 8), the
    incompatible modes condensed; bending has them if `residual`.
    """
    grams = [gram(g, s.weights(det, _N, 1))]
    grams += (
        [grams[0]] * 2
        if (s.profile == 1).all()
        else [gram(g, s.weights(det, _N, p)) for p in (2, 3)]
    )
    n = 6 if residual else 4
    stretch = contract(grams[0], s.membrane)
    bend = contract(grams[2][:, :n, :, :n], s.bending)
    if not np.any(s.coupling):
        return condensed(stretch, 4), np.empty((0, 8, 8)), condensed(bend, 2 * n - 8)
    mixed = contract(grams[1][:, :, :, :n], s.coupling)
    K = np.concatenate(
        [
            np.concatenate([stretch, mixed], axis=2),
            np.concatenate([mixed.swapaxes(1, 2), bend], axis=2),
        ],
        axis=1,
    )
    order = np.r_[:8, 12:20, 8:12, 20 : 12 + 2 * n]
    K = _without_modes(K[:, order[:, None], order], 2 * n - 4)
    return K[:, :8, :8], K[:, :8, 8:], K[:, 8:, 8:]


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
    residual = t.mesh.model.param("RESBEND", 1.0) > 0

    def curved(at: Int) -> Any_:
        return curved_kernel(
            x[at],
            heights[at],
            normals[at],
            axes=axes[at],
            s=taken(s, at),
            residual=residual,
        )

    def plane(at: Bool | slice) -> Any_:
        part = taken(s, at)
        return to_nodes(kernel(xy[at], part, residual), part, axes[at], heights[at])

    K = flat_and_curved(normals, axes, plane, curved)
    return finish(t, nodes, K, section=s, axes=axes, mass=mass)
