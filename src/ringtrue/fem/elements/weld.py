"""CWELD: a short round beam between two shell patches, between a patch and a node, or between two nodes.

The end on a patch follows its corners: u = Σ N u_I, and the rotation is that of the surface, θ = Σ (∇N × n)(n·u_I) +
n (n·(∇N × u_I))/2 (MSC Nastran Linear Static Analysis User's Guide, connector elements: Kirchhoff shell, only the
translations of the patch). About its middle a uniform beam is six springs: EA/Le, GJ/Le, EI/Le, and across
1/(Le/kGA + L² Le/12EI), which holds for a length of 0, too. Le is the length, not less than LDMIN and not more than
LDMAX diameters (PWELD).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.algebra import arm, congruent, rotation, skew, unit
from ringtrue.fem.mesh import Matrices, Mesh, error, isotropic, lookup
from ringtrue.fem.place import any_triad, node_dofs

SHEAR = 0.9  # shear area of a round section over its area
SHELLS = {"CQUAD4": 4, "CQUADR": 4, "CTRIA3": 3, "CTRIAR": 3}
_STEPS = 12  # Newton steps to the foot of a point on a patch; two suffice on a flat one
_SLACK = 1e-3  # by which a foot may lie outside of its patch, in natural coordinates


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """One end of the welds.

    Attributes
    ----------
    nodes : (e, 4) int64
        Rows of GRID, -1 for none.
    place, normal : (e, 3) float64
    follow : (e, 6, 24) float64
        Motion of the end by that of the nodes, in basic.
    """

    nodes: Int
    place: Float
    normal: Float
    follow: Float


def _shapes(r: Float, s: Float, triangle: Bool) -> tuple[Float, Float]:
    """Shape functions (e, 4) and their derivatives (e, 2, 4) of quadrilaterals (-1 to 1) and triangles (0 to 1)."""
    one, none = np.ones_like(r), np.zeros_like(r)
    quad = np.stack([(1 - r) * (1 - s), (1 + r) * (1 - s), (1 + r) * (1 + s), (1 - r) * (1 + s)], axis=1) / 4
    dr, ds = np.stack([s - 1, 1 - s, 1 + s, -1 - s], axis=1) / 4, np.stack([r - 1, -1 - r, 1 + r, 1 - r], axis=1) / 4
    flat = np.stack([1 - r - s, r, s, none], axis=1)
    slope = np.stack([np.stack([-one, one, none, none], 1), np.stack([-one, none, one, none], 1)], axis=1)
    pick = triangle[:, None]
    return np.where(pick, flat, quad), np.where(pick[:, None], slope, np.stack([dr, ds], axis=1))


def _foot(x: Float, point: Float, triangle: Bool) -> tuple[Float, Float, Float, Float]:
    """Natural coordinates (e,) of the feet of points (e, 3) on patches (e, 4, 3), with shapes and derivatives there."""
    r = np.where(triangle, 1 / 3, 0.0)
    s = r.copy()
    for _ in range(_STEPS):
        N, dN = _shapes(r, s, triangle)
        tangent = dN @ x
        off = point - np.einsum("ei,eij->ej", N, x)
        metric = tangent @ tangent.swapaxes(1, 2)
        step = np.linalg.solve(metric, np.einsum("ekj,ej->ek", tangent, off)[..., None])[..., 0]
        r, s = r + step[:, 0], s + step[:, 1]
    return r, s, *_shapes(r, s, triangle)


def on_patch(m: Mesh, card: str, at: Int, nodes: Int, point: Float) -> End:
    """Ends on patches of corner nodes (e, 4), the fourth -1 for triangles, at the feet of points (e, 3)."""
    t = m.model[card]
    triangle = nodes[:, 3] < 0
    x = m.xyz[nodes]
    x[triangle, 3] = 0.0
    area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    if (flat := (area == 0).all(axis=1)).any():
        raise error(m.model, t, int(at[flat][0]), "the corners of a patch lie on one line")
    r, s, N, dN = _foot(x, point, triangle)
    outside = np.where(triangle, np.minimum(np.minimum(r, s), 1 - r - s), 1 - np.maximum(np.abs(r), np.abs(s)))
    if (outside < -_SLACK).any():
        raise error(m.model, t, int(at[outside < -_SLACK][0]), "the foot of its point lies outside of a patch")
    tangent = dN @ x
    n = unit(np.cross(tangent[:, 0], tangent[:, 1]))
    g = np.linalg.solve(tangent @ tangent.swapaxes(1, 2), dN).swapaxes(1, 2) @ tangent
    turn = np.einsum("eni,ej->enij", np.cross(g, n[:, None]), n)
    turn += 0.5 * np.einsum("ei,ek,enkj->enij", n, n, skew(g))
    follow = np.zeros((at.size, 6, 4, 6))
    follow[:, :3, :, :3] = np.einsum("en,ij->einj", N, np.eye(3))
    follow[:, 3:, :, :3] = turn.swapaxes(1, 2)
    return End(nodes, np.einsum("ei,eij->ej", N, x), n, follow.reshape(-1, 6, 24))


def on_node(m: Mesh, node: Int) -> End:
    """Ends that are nodes (e,)."""
    nodes = np.full((node.size, 4), -1)
    nodes[:, 0] = node
    follow = np.zeros((node.size, 6, 24))
    follow[:, :, :6] = np.eye(6)
    return End(nodes, m.xyz[node], np.tile([0.0, 0.0, 1.0], (node.size, 1)), follow)


def _merged(size: int, parts: list[tuple[Int, End]]) -> End:
    names = ("nodes", "place", "normal", "follow")
    out = {n: np.zeros((size, *getattr(parts[0][1], n).shape[1:]), dtype=getattr(parts[0][1], n).dtype) for n in names}
    for rows, part in parts:
        for n in names:
            out[n][rows] = getattr(part, n)
    return End(**out)


def patches(m: Mesh, card: str, at: Int, side: str) -> tuple[Int, Bool]:
    """Corner nodes (e, 4) of patch A or B by GRIDID or ELEMID, -1 for none, and which rows have such a patch."""
    t = m.model[card]
    ids = t.stack(*(f"G{side}{i}" for i in range(1, 5)))[at]
    shell = t[f"SHID{side}"][at]
    left = shell > 0
    for name, count in SHELLS.items():
        if name in m.model:
            row = m.model[name].find(shell)
            hit = left & (row >= 0)
            ids[hit, :count] = m.model[name].stack(*(f"G{i}" for i in range(1, count + 1)))[row[hit]]
            left = left & ~hit
    if left.any():
        why = f"SHID{side} {shell[left][0]} is none of {', '.join(SHELLS)}"
        raise error(m.model, t, int(at[left][0]), why)
    there = ids[:, 0] > 0
    out = np.full(ids.shape, -1)
    used = ids > 0
    out[used] = m.nodes(ids[used], t, np.broadcast_to(at[:, None], ids.shape)[used])
    return out, there


def ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,): on a patch below GS (or GA, GB), else at GS; by ALIGN at GA and GB."""
    t = m.model[card]
    align = t["TYPE"][at] == "ALIGN"
    made = []
    for side in "AB":
        corners, there = patches(m, card, at, side)
        given = t[f"G{side}"][at]
        own = np.where(align, given, t["GS"][at])
        if (bare := ~there & (own == 0)).any():
            raise error(m.model, t, int(at[bare][0]), f"end {side} has neither a patch nor a node")
        point = np.where(there & (given > 0), given, own)
        if (bare := point == 0).any():
            raise error(m.model, t, int(at[bare][0]), f"no GS or G{side} says where it pierces patch {side}")
        node = m.nodes(point, t, at)
        p = np.flatnonzero(there)
        q = np.flatnonzero(~there)
        parts = [(p, on_patch(m, card, at[p], corners[p], m.xyz[node[p]]))] if p.size else []
        made.append(_merged(at.size, [*parts, *([(q, on_node(m, node[q]))] if q.size else [])]))
    return made[0], made[1]


def springs(L: Float, D: Any_, E: Any_, G: Any_, least: Float, most: Float) -> Any_:
    """Stiffness (e, 6) about the middle: along, across twice, of torsion, of bending twice."""
    area, second = np.pi / 4 * D**2, np.pi / 64 * D**4
    low, high = least * D, most * D
    length = np.where(np.real(low) > L, low, np.where(np.real(high) < L, high, L))
    across = 1 / (length / (SHEAR * G * area) + L**2 * length / (12 * E * second))
    bending = E * second / length
    return np.stack([E * area / length, across, across, 2 * G * second / length, bending, bending], axis=1)


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CWELD; half the mass at each end.

    Raises
    ------
    DeckError
        If an end is not determined, a foot lies outside of its patch, or a node, property or material is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PWELD", t["PID"][at], t, at)
    p = m.model["PWELD"]
    iso, D = isotropic(m.model, p["MID"][row], p, row), p["D"][row]
    if (bad := (np.real(D) <= 0) | (np.real(iso.G) == 0)).any():
        raise error(m.model, p, int(row[bad][0]), "D must be greater than 0, and its MAT1 have a shear modulus")
    a, b = ends(m, card, at)
    d = b.place - a.place
    L = np.linalg.norm(d, axis=1)
    axis = np.where((L > 0)[:, None], d / np.where(L > 0, L, 1.0)[:, None], a.normal)
    middle = (a.place + b.place) / 2
    local = rotation(any_triad(axis), 1)
    move = [local @ arm(middle - end.place) @ end.follow for end in (a, b)]
    k = springs(L, D, iso.E, iso.G, p["LDMIN"][row], p["LDMAX"][row])
    K = congruent(np.concatenate([-move[0], move[1]], axis=2), k[:, :, None] * np.eye(6))
    half = (iso.rho * np.pi / 8 * D**2 * L)[:, None, None]
    M = np.zeros((at.size, 48, 48), dtype=half.dtype)
    for i, end in enumerate((a, b)):
        shift = end.follow[:, :3]
        M[:, 24 * i : 24 * i + 24, 24 * i : 24 * i + 24] = half * (shift.swapaxes(1, 2) @ shift)
    nodes = np.concatenate([a.nodes, b.nodes], axis=1)
    dofs = np.where(np.repeat(nodes, 6, axis=1) >= 0, node_dofs(nodes), -1)
    return Matrices(dofs, K, M, iso.loss, np.empty((0, 48, 48)))
