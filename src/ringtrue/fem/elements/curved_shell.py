"""Normals at the nodes of flat shells on a curved surface: the mean of the elements around, as
PARAM,SNORM has it.

Between flat elements at an angle a twist turns into a rotation about the normal of the next one,
which only the drilling stiffness holds (Raasch's hook: refinement makes it worse; MacNeal, Wilson,
Harder and Hoff 1998). Elements that share one normal at a node have no such mechanism.

Strains of a curved shell from its nodes and the normals there, with assumed strains; basic axes,
six DOFs a node.

The shell is x = Σ N_i (x_i + z n_i), its motion u = Σ N_i (u_i + z θ_i x n_i); strains are taken to
first order in z, so that the section's A, B, D and S apply. With x,d and u,d along a natural
direction d, the normal field n and the turn ψ = Σ N_i θ_i x n_i:

    membrane   e_d = x,d · u,d
    curvature  k_d = x,d · ψ,d + n,d · u,d
    shear      γ_d = x,d · ψ   + n   · u,d

A rigid motion has no strain, in any shape and with any normals.

CQUAD8 and CTRIA6: curved shells of second order with assumed strains, six DOFs a node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements.shape_functions import QUAD8, TRIA6, Samples, ShellRule
from ringtrue.fem.elements.shell_section import (
    ShellSection,
    SurfacePoints,
    condensed,
    directed,
    in_spans,
    masses,
    material_axis,
    section,
)
from ringtrue.fem.mesh import (
    FLAT_SHELLS,
    CardRows,
    ElementMatrices,
    Mesh,
    Rows,
    arm,
    congruent,
    matrix,
    nodal,
    node_dofs,
    taken,
    union,
    unit,
)
from ringtrue.model.model import Model

SNORM = 20.0  # degrees
SAME = 1e-10  # a normal so near to the element's own is its own
_SPAN = {4: (0, 2, 1, 3), 3: (0, 1, 0, 2)}  # the normal is ab x cd


def node_normals(m: Mesh, nodes: Int, own: Any_) -> Any_:
    """Normals (e, k, 3) at the nodes (e, k) of elements with normals `own` (e, 3).

    The mean of the unit normals of all flat shells at the node, if each of them is within
    PARAM,SNORM degrees of it (20 unless given; 0 is off); else the element's own.
    """
    out = np.broadcast_to(own[:, None], (*nodes.shape, 3))
    limit = m.model.param("SNORM", SNORM)
    if limit <= 0:
        return out
    total = np.zeros((len(m.xyz), 3), dtype=m.xyz.dtype)
    around = list(_around(m, nodes))
    for corners, n in around:
        for c in corners.T:
            np.add.at(total, c, n)
    used = np.unique(nodes)
    total[used] = unit(total[used])
    sharp = np.zeros(len(m.xyz), dtype=bool)
    for corners, n in around:
        folded = np.einsum("eka,ea->ek", total[corners], n).real < np.cos(
            np.radians(limit)
        )
        sharp[corners[folded]] = True
    mean = total[nodes]
    keep: Any_ = sharp[nodes]
    if not np.iscomplexobj(mean):  # a complex step is small, but not nothing
        keep = keep | (np.abs(mean - out).max(axis=2) < SAME)
    return np.where(keep[..., None], out, mean)


def _around(m: Mesh, nodes: Int) -> Iterable[tuple[Int, Any_]]:
    """Corner nodes (., k) and unit normals (., 3) of the flat shells that share one of the
    nodes.
    """
    mine = m.model["GRID"].ids[np.unique(nodes)]
    for card, k in FLAT_SHELLS.items():
        if card not in m.model:
            continue
        ids = _corners(m.model, card)
        near = np.flatnonzero(np.isin(ids, mine).any(axis=1))
        # copies of an element (`parameter_groups.Copies`) have its number: it counts once
        _, first = np.unique(m.model[card].ids[near], return_index=True)
        corners = m.model["GRID"].find(ids[near[np.sort(first)]])
        # the builder of the element names a node that is absent
        corners = corners[(corners >= 0).all(axis=1)]
        x, (a, b, c, d) = m.xyz[corners], _SPAN[k]
        n = np.cross(x[:, b] - x[:, a], x[:, d] - x[:, c])
        there = (n != 0).any(axis=1)
        yield corners[there], unit(n[there])


def _corners(model: Model, card: str) -> Int:
    return model[card].stack(*(f"G{i + 1}" for i in range(FLAT_SHELLS[card])))


def flat_and_curved(
    normals: Any_,
    axes: Any_,
    plane: Callable[[Bool | slice], Any_],
    curved: Callable[[Int], Any_],
) -> Any_:
    """Stiffness (e, d, d) of flat elements with axes (e, 3, 3) and normals (e, k, 3) at the nodes:
    by `plane` where these are their own, else by `curved`; each gets which elements.
    """
    flat = (normals == axes[:, None, 2]).all(axis=(1, 2))
    if flat.all():
        return plane(slice(None))
    at = np.flatnonzero(~flat)
    of_curved = in_spans(at.size, lambda i: curved(at[i]))
    of_plane = plane(flat)
    K = np.empty((flat.size, *of_curved.shape[1:]), np.result_type(of_plane, of_curved))
    K[flat] = of_plane
    K[at] = of_curved
    return K


def joined_to_plane(
    x: Any_, normals: Any_, axes: Any_, lift: Any_
) -> tuple[Any_, Any_, Any_]:
    """Rigid arms (e, k, 3) along the normals at the nodes x (e, k, 3) to a plane that is `lift` (e,
    k) above them; where they end, and that in the element's plane, (e, k, 2).
    """
    arms = (lift / np.einsum("eka,ea->ek", normals, axes[:, 2]))[..., None] * normals
    x = x + arms
    xy = np.einsum("eij,ekj->eki", axes[:, :2], x - x.mean(axis=1, keepdims=True))
    return arms, x, xy


def with_neighbours(model: Model, rows: Rows) -> Rows:
    """Rows of element cards, and the flat shells whose node normals depend on those among them."""
    flat = [card for card in FLAT_SHELLS if card in rows]
    if model.param("SNORM", SNORM) <= 0 or not flat:
        return rows
    touched = np.concatenate(
        [_corners(model, card)[rows[card]].ravel() for card in flat]
    )
    found = [rows]
    for card in FLAT_SHELLS:
        if card in model:
            also = np.isin(_corners(model, card), touched).any(axis=1)
            found.append({card: np.flatnonzero(also)})
    return union(found)


def tangents(d: Any_, x: Any_) -> tuple[Any_, Any_]:
    """Tangents (e, p, 2, 3) and their cross product (e, p, 3) from natural derivatives (p, k,
    2).
    """
    g = np.einsum("pnr,ena->epra", d, x)
    return g, np.cross(g[:, :, 0], g[:, :, 1])


def length(v: Any_) -> Any_:
    return np.asarray(np.sqrt((v * v).sum(axis=-1)))


def law(s: ShellSection, w: Any_, corner: Any_) -> Any_:
    """Section matrices (e, p, 8, 8) over (ε, κ, γ) times the weights w (e, p); corner shapes (p,
    corners).
    """
    w1, w2, w3 = (s.weights(w, corner, p)[..., None, None] for p in (1, 2, 3))
    C = np.zeros(
        (*w.shape, 8, 8),
        dtype=np.result_type(s.membrane, s.coupling, s.bending, s.shear, w1),
    )
    C[..., :3, :3] = s.membrane[:, None] * w1
    C[..., 3:6, 3:6] = s.bending[:, None] * w3
    C[..., :3, 3:6] = C[..., 3:6, :3] = s.coupling[:, None] * w2
    C[..., 6:, 6:] = s.shear[:, None] * w1
    return C


def strains(rule: ShellRule, x: Any_, n: Any_, back: Any_) -> Any_:
    """Rows (e, p, 8, 6k) of (ε, κ, γ) in the local axes over (u, θ) of each node."""
    shear = back @ _carried(rule.shear, tied_shear(rule, x, n))
    return np.concatenate([plane_strains(rule, x, n, back), shear], axis=2)


def plane_strains(rule: ShellRule, x: Any_, n: Any_, back: Any_) -> Any_:
    """Rows (e, p, 6, 6k) of (ε, κ) in the local axes over (u, θ) of each node."""
    plane = rule.plane
    _, d, xd, arms = _along(rule, plane, x, n)
    nd = np.einsum("kn,ena->eka", d, n)
    u, bent, turn = (d[..., None] * v for v in (xd[:, :, None], nd[:, :, None], arms))
    membrane, curvature = (_rows(u, 0 * u), _rows(bent, turn))
    (p1, p2), (q1, q2) = np.moveaxis(back, (-2, -1), (0, 1))
    T = matrix(
        (p1**2, p2**2, p1 * p2),
        (q1**2, q2**2, q1 * q2),
        (2 * p1 * q1, 2 * p2 * q2, p1 * q2 + p2 * q1),
    )
    return np.concatenate(
        [T @ _carried(plane, rows) for rows in (membrane, curvature)], axis=2
    )


def tied_shear(rule: ShellRule, x: Any_, n: Any_) -> Any_:
    """Rows (e, k, 6k) of the covariant transverse shear where it is sampled, over (u, θ) of each
    node.
    """
    N, d, _, arms = _along(rule, rule.shear, x, n)
    across = np.einsum("kn,ena->eka", N, n)
    return _rows(d[..., None] * across[:, :, None], N[..., None] * arms)


def _carried(s: Samples, rows: Any_) -> Any_:
    """Sampled rows (e, k, d) to the integration points (e, p, c, d)."""
    p, c, k = s.carry.shape
    return (s.carry.reshape(p * c, k) @ rows).reshape(len(rows), p, c, -1)


def _along(
    rule: ShellRule, s: Samples, x: Any_, n: Any_
) -> tuple[Any_, Any_, Any_, Any_]:
    """N (k, n), N,d (k, n), x,d (e, k, 3) and the normals' arms n_i x x,d (e, k, n, 3)."""
    N, d = rule.shapes(s.points)
    d = np.einsum("knr,kr->kn", d, s.direction)
    xd = np.einsum("kn,ena->eka", d, x)
    return N, d, xd, np.cross(n[:, None], xd[:, :, None])


def _rows(u: Any_, theta: Any_) -> Any_:
    """Rows over (u, θ) of each node: (e, k, n, 3) twice -> (e, k, 6n)."""
    return np.concatenate([u, theta], axis=-1).reshape(*u.shape[:2], -1)


def missing_mean(rows: Any_, gradients: Any_, frame: Any_, n: Any_, w: Any_) -> Any_:
    """What the mean (ε, κ) of the displacements themselves is more than that of `rows`: (e, 1, 6,
    6k).

    With it a constant stress does the right work on every motion: the patch test holds on any
    distortion.
    """
    slope = np.einsum("epni,ena->epia", gradients, n)
    first = gradients[..., 0, None]
    second = gradients[..., 1, None]
    e1, e2, n1, n2 = (v[:, :, i, None] for v in (frame, slope) for i in (0, 1))
    stretch = [first * e1, second * e2, second * e1 + first * e2]
    bent = [first * n1, second * n2, second * n1 + first * n2]
    turn = [np.cross(n[:, None], v) for v in stretch]
    exact = [_rows(v, 0 * v) for v in stretch] + [
        _rows(u, v) for u, v in zip(bent, turn, strict=True)
    ]
    missing = np.stack(exact, axis=2) - rows[:, :, :6]
    return np.asarray(
        np.einsum("ep,epcd->ecd", w / w.sum(axis=1, keepdims=True), missing)[:, None]
    )


def drilling(
    rule: ShellRule, x: Any_, s: ShellSection, points: Float, weights: Float
) -> Any_:
    """G t K6ROT 1e-6 ∫ (θ·n - (∂u2/∂x1 - ∂u1/∂x2)/2)² by points (p, 2) and weights (p,): (e, 6k,
    6k).
    """
    N, d = rule.shapes(points)
    g, up = tangents(d, x)
    size = length(up)
    normal = up / size[..., None]
    # ∂u1/∂x2 - ∂u2/∂x1 is (g_r · u,s - g_s · u,r) over the area, in any axes of the plane
    u = (
        d[None, :, :, 1, None] * g[:, :, None, 0]
        - d[None, :, :, 0, None] * g[:, :, None, 1]
    ) / size[..., None, None]
    rows = _rows(u / 2, N[..., None] * normal[:, :, None])
    w = s.weights(size * weights, rule.corner_shapes(points), 1) * s.drill[:, None]
    return np.asarray((rows * w[..., None]).swapaxes(1, 2) @ rows)


_RULES = {"CQUAD8": QUAD8, "CTRIA6": TRIA6}


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CQUAD8 or CTRIA6; a mid-side node may be blank: its side is linear.

    Raises
    ------
    DeckError
        If an element is folded or without area.
    """
    rule = _RULES[t.card]
    nodes, absent, x = _nodes(t)
    # its normal must not turn over between its integration points and nodes
    n = tangents(rule.shapes(np.vstack([rule.points, rule.nodes]))[1], x.real)[1]
    size = length(n)
    ahead = np.einsum("ega,ea->eg", n, n[:, : len(rule.points)].sum(axis=1))
    bad = (size.min(axis=1) <= 1e-10 * size.max(axis=1)) | (ahead <= 0).any(axis=1)
    t.refuse(bad, "it is folded; check its nodes and their order")
    s = section(t, rule.corners)
    K = in_spans(len(t), lambda i: kernel(t.take(i), x=x[i], s=taken(s, i)))
    M = _mass(t.mesh.coupled_mass, rule, x, s)
    dofs = np.where(np.repeat(absent, 6, axis=1), -1, node_dofs(nodes))
    if absent.any():
        K, M = _without(rule, absent, K, M)
    return ElementMatrices(dofs=dofs, stiffness=K, mass=M, loss=s.loss)


def measure(t: CardRows) -> Any_:
    """Areas (e,)."""
    rule = _RULES[t.card]
    return length(tangents(rule.shapes(rule.points)[1], _nodes(t)[2])[1]) @ rule.weights


def _nodes(t: CardRows) -> tuple[Int, Bool, Any_]:
    """Rows of GRID (e, k), which nodes are absent, and places (e, k, 3), those of absent ones amid
    their sides.
    """
    rule = _RULES[t.card]
    k = rule.corners
    ids = t.stack(*(f"G{i + 1}" for i in range(len(rule.nodes))))
    absent = ids <= 0
    absent[:, :k] = False  # a blank corner is an error
    nodes = t.nodes_of(np.where(absent, ids[:, :1], ids))
    x = t.mesh.xyz[nodes]
    x[:, k:] = np.where(absent[:, k:, None], x[:, rule.sides].mean(axis=2), x[:, k:])
    return nodes, absent, x


def kernel(t: CardRows, x: Any_, s: ShellSection) -> Any_:
    """Stiffness (e, 6k, 6k) in basic over (u, θ) of each node, with nodes x (e, k, 3); the offset
    is in it.
    """
    rule = _RULES[t.card]
    e = len(x)
    n = unit(tangents(rule.shapes(rule.nodes)[1], x)[1])
    arms = s.offset[:, None, None] * n
    x = x + arms
    N, d = rule.shapes(rule.points)
    g, up = tangents(d, x)
    w = length(up) * rule.weights
    points = SurfacePoints(np.einsum("pn,ena->epa", N, x), unit(g[:, :, 0]), unit(up))
    frame = _frames(t, points, directed(s))
    # ∂ξ_r/∂x_i, (e, p, i, r)
    back = np.linalg.inv(np.einsum("epra,epia->epri", g, frame))
    rows = strains(rule, x, n, back)
    if rule.corners == 4:
        rows[:, :, :6] += missing_mean(
            rows, np.einsum("epir,pnr->epni", back, d), frame, n=n, w=w
        )
    else:
        rows = np.concatenate([rows, _bubbles(rule, x, frame, back)], axis=3)
    loaded = (law(s, w, rule.corner_shapes(rule.points)) @ rows).reshape(
        e, -1, rows.shape[-1]
    )
    K = rows.reshape(e, -1, rows.shape[-1]).swapaxes(1, 2) @ loaded
    K = condensed(K, rows.shape[-1] - 6 * x.shape[1])
    K = K + drilling(rule, x, s, points=rule.points, weights=rule.weights)
    return congruent(nodal(arm(arms)), K) if np.any(s.offset) else K


def _bubbles(rule: ShellRule, x: Any_, frame: Any_, back: Any_) -> Any_:
    """Rows (e, p, 8, 2) of two turns with the bubble 27 L1 L2 L3, about the local axes: the MITC7
    without its centre.

    Without them the shear at the centre locks a thin triangle.
    """
    r, s = rule.points.T
    d = 27 * np.stack([s * (1 - 2 * r - s), r * (1 - r - 2 * s)], axis=1)
    slope = np.einsum("epir,pr->epi", back, d)
    centre = tangents(rule.shapes(np.full((1, 2), 1 / 3))[1], x)[0][:, 0]
    across = np.einsum("pck,eka,epia->epci", rule.shear.carry[:, :, 6:], centre, frame)
    out = np.zeros((*slope.shape[:2], 8, 2), dtype=across.dtype)
    out[:, :, 3, 0] = slope[..., 0]
    out[:, :, 4, 1] = slope[..., 1]
    out[:, :, 5, 0] = slope[..., 1]
    out[:, :, 5, 1] = slope[..., 0]
    out[:, :, 6:] = back @ across
    return out


def _frames(t: CardRows, points: SurfacePoints, turned: Bool) -> Any_:
    """Material axes in the tangent plane of each point (e, p) as rows, (e, p, 2, 3); THETA is from
    the tangent along r.
    """
    e, p = points.x.shape[:2]
    each = np.repeat(np.arange(e), p)
    flat = (v.reshape(-1, 3) for v in (points.x, points.tangent, points.normal))
    one = material_axis(t.take(each), SurfacePoints(*flat), turned[each]).reshape(
        e, p, 3
    )
    return np.stack([one, np.cross(points.normal, one)], axis=2)


def _mass(coupled: bool, rule: ShellRule, x: Any_, s: ShellSection) -> Any_:
    """Lumped by the diagonal of the consistent mass (Hinton, Rock and Zienkiewicz 1976), or
    consistent.
    """
    N, d = rule.shapes(rule.points)
    w = s.masses(
        length(tangents(d, x)[1]) * rule.weights, rule.corner_shapes(rule.points)
    )
    full = np.einsum("eg,gi,gj->eij", w, N, N, optimize=True)
    total = w.sum(axis=1)[:, None]
    share = np.einsum("eii->ei", full)
    share = share / share.sum(axis=1, keepdims=True)
    n = unit(tangents(rule.shapes(rule.nodes)[1], x)[1])
    pattern = full / np.where(total == 0, 1.0, total)[..., None] if coupled else None
    return masses(s.offset[:, None, None] * n, total * share, pattern)


def _without(rule: ShellRule, absent: Bool, K: Any_, M: Any_) -> tuple[Any_, Any_]:
    """Replace the motion of absent mid-side nodes by the mean of the ends of their sides."""
    e, k = absent.shape
    T = np.broadcast_to(np.eye(k), (e, k, k)).copy()
    element, node = np.nonzero(absent)
    T[element, node, node] = 0.0
    for end in rule.sides[node - rule.corners].T:
        T[element, node, end] = 0.5
    wide = np.kron(T, np.eye(6))
    if M.ndim == 2:
        M = (M.reshape(e, k, 6).swapaxes(1, 2) @ T).swapaxes(1, 2).reshape(e, -1)
        return congruent(wide, K), M
    return congruent(wide, K), congruent(wide, M)
