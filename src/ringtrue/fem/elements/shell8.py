"""CQUAD8 and CTRIA6: curved shells of second order with assumed strains, six DOFs a node (see
`shell_curved`).
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Int
from ringtrue.fem.algebra import arm, congruent, nodal, unit
from ringtrue.fem.elements.curved_shell import (
    drilling,
    law,
    length,
    missing_mean,
    strains,
    tangents,
)
from ringtrue.fem.elements.shape_functions import QUAD8, TRIA6, ShellRule
from ringtrue.fem.elements.shell_section import (
    Section,
    condensed,
    directed,
    in_spans,
    masses,
    material_axis,
    section,
)
from ringtrue.fem.mesh import Matrices, Mesh, node_dofs
from ringtrue.model.model import card_error

_RULES = {"CQUAD8": QUAD8, "CTRIA6": TRIA6}


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CQUAD8 or CTRIA6; a mid-side node may be blank: its side is
    linear.

    Raises
    ------
    DeckError
        If an element is folded or without area.
    """
    rule = _RULES[card]
    nodes, absent, x = _nodes(m, card, at, rule)
    _check(m, card, at, rule=rule, x=x)
    s = section(m, card, at, rule.corners)
    K = in_spans(len(at), lambda i: kernel(m, card, at[i], x=x[i], s=s.take(i)))
    M = _mass(m, rule, x, s)
    dofs = np.where(np.repeat(absent, 6, axis=1), -1, node_dofs(nodes))
    if absent.any():
        K, M = _without(rule, absent, K, M)
    return Matrices(
        dofs=dofs, stiffness=K, mass=M, loss=s.loss, viscous=np.empty((0, *K.shape[1:]))
    )


def measure(m: Mesh, card: str, at: Int) -> Any_:
    """Areas (e,) of the rows `at`."""
    rule = _RULES[card]
    x = _nodes(m, card, at, rule)[2]
    return length(tangents(rule.shapes(rule.mass_points)[1], x)[1]) @ rule.mass_weights


def _nodes(m: Mesh, card: str, at: Int, rule: ShellRule) -> tuple[Int, Bool, Any_]:
    """Rows of GRID (e, k), which nodes are absent, and places (e, k, 3), those of absent ones amid
    their sides.
    """
    t = m.model[card]
    ids = t.stack(*(f"G{i + 1}" for i in range(len(rule.nodes))))[at]
    absent = ids <= 0
    absent[:, : rule.corners] = False  # a blank corner is an error
    nodes = m.nodes(np.where(absent, ids[:, :1], ids), t, at)
    x = m.xyz[nodes]
    middle = x[:, rule.sides].mean(axis=2)
    middle = np.where(absent[:, rule.corners :, None], middle, x[:, rule.corners :])
    return nodes, absent, np.concatenate([x[:, : rule.corners], middle], axis=1)


def _check(m: Mesh, card: str, at: Int, rule: ShellRule, x: Any_) -> None:
    """Refuse an element whose normal turns over between its integration points and nodes."""
    p = np.vstack([rule.points, rule.nodes])
    n = np.cross(*np.einsum("gnr,ena->rega", rule.shapes(p)[1], x.real))
    size = np.linalg.norm(n, axis=2)
    ahead = np.einsum("ega,ea->eg", n, n[:, : len(rule.points)].sum(axis=1))
    bad = (size.min(axis=1) <= 1e-10 * size.max(axis=1)) | (ahead <= 0).any(axis=1)
    if bad.any():
        row = int(at[np.flatnonzero(bad)[0]])
        raise card_error(
            m.model, m.model[card], row, "it is folded; check its nodes and their order"
        )


def kernel(m: Mesh, card: str, at: Int, x: Any_, s: Section) -> Any_:
    """Stiffness (e, 6k, 6k) in basic over (u, θ) of each node, with nodes x (e, k, 3); the offset
    is in it.
    """
    rule = _RULES[card]
    e = len(x)
    n = unit(tangents(rule.shapes(rule.nodes)[1], x)[1])
    x = x + s.offset[:, None, None] * n
    N, d = rule.shapes(rule.points)
    g, up = tangents(d, x)
    w = length(up) * rule.weights
    frame = _frames(
        m,
        card,
        at,
        x=np.einsum("pn,ena->epa", N, x),
        tangent=unit(g[:, :, 0]),
        normal=unit(up),
        turned=directed(s),
    )
    back = np.linalg.inv(np.einsum("epra,epia->epri", g, frame))  # ∂ξ_r/∂x_i, (e, p, i, r)
    rows = strains(rule, x, n, back)
    if rule.corners == 4:
        rows[:, :, :6] += missing_mean(rows, np.einsum("epir,pnr->epni", back, d), frame, n=n, w=w)
    else:
        rows = np.concatenate([rows, _bubbles(rule, x, frame, back)], axis=3)
    loaded = (law(s, w, rule.corner_shapes(rule.points)) @ rows).reshape(e, -1, rows.shape[-1])
    K = rows.reshape(e, -1, rows.shape[-1]).swapaxes(1, 2) @ loaded
    K = condensed(K, rows.shape[-1] - 6 * x.shape[1]) + drilling(
        rule, x, s, points=rule.mass_points, weights=rule.mass_weights
    )
    if not np.any(s.offset):
        return K
    return congruent(nodal(arm(s.offset[:, None, None] * n)), K)


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


def _frames(
    m: Mesh, card: str, at: Int, x: Any_, tangent: Any_, normal: Any_, turned: Bool
) -> Any_:
    """Material axes in the tangent plane of each point as rows, (e, p, 2, 3); THETA is from the
    tangent along r.
    """
    e, p = x.shape[:2]
    x, along, up = (v.reshape(-1, 3) for v in (x, tangent, normal))
    one = material_axis(
        m, card, np.repeat(at, p), x=x, tangent=along, normal=up, turned=np.repeat(turned, p)
    ).reshape(e, p, 3)
    return np.stack([one, np.cross(normal, one)], axis=2)


def _mass(m: Mesh, rule: ShellRule, x: Any_, s: Section) -> Any_:
    """Lumped by the diagonal of the consistent mass (Hinton, Rock and Zienkiewicz 1976), or
    consistent.
    """
    N, d = rule.shapes(rule.mass_points)
    w = s.masses(
        length(tangents(d, x)[1]) * rule.mass_weights, rule.corner_shapes(rule.mass_points)
    )
    full = np.einsum("eg,gi,gj->eij", w, N, N, optimize=True)
    total = w.sum(axis=1)[:, None]
    share = np.einsum("eii->ei", full)
    share = share / share.sum(axis=1, keepdims=True)
    n = unit(tangents(rule.shapes(rule.nodes)[1], x)[1])
    whole = np.where(total == 0, 1.0, total)[..., None]
    return masses(m, s.offset[:, None, None] * n, total * share, full / whole)


def _without(rule: ShellRule, absent: Bool, K: Any_, M: Any_) -> tuple[Any_, Any_]:
    """Replace the motion of absent mid-side nodes by the mean of the ends of their sides."""
    e, k = absent.shape
    T = np.broadcast_to(np.eye(k), (e, k, k)).copy()
    element, node = np.nonzero(absent)
    T[element, node, node] = 0.0
    for end in rule.sides[node - rule.corners].T:
        T[element, node, end] = 0.5
    wide = np.einsum("eij,ab->eiajb", T, np.eye(6)).reshape(e, 6 * k, 6 * k)
    if M.ndim == 2:
        M = (M.reshape(e, k, 6).swapaxes(1, 2) @ T).swapaxes(1, 2).reshape(e, -1)
        return congruent(wide, K), M
    return congruent(wide, K), congruent(wide, M)
