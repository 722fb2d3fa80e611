"""Strains of a curved shell from its nodes and the normals there, with assumed strains; basic axes,
six DOFs a node.

The shell is x = Σ N_i (x_i + z n_i), its motion u = Σ N_i (u_i + z θ_i x n_i); strains are taken to
first order in z, so that the section's A, B, D and S apply. With x,d and u,d along a natural
direction d, the normal field n and the turn ψ = Σ N_i θ_i x n_i:

    membrane   e_d = x,d · u,d
    curvature  k_d = x,d · ψ,d + n,d · u,d
    shear      γ_d = x,d · ψ   + n   · u,d

A rigid motion has no strain, in any shape and with any normals.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.shell_rule import Rule, Samples
from ringtrue.fem.elements.shell_section import Section


def tangents(d: Any_, x: Any_) -> tuple[Any_, Any_]:
    """Tangents (e, p, 2, 3) and their cross product (e, p, 3) from natural derivatives (p, k,
    2).
    """
    g = np.einsum("pnr,ena->epra", d, x)
    return g, np.cross(g[:, :, 0], g[:, :, 1])


def length(v: Any_) -> Any_:
    return np.asarray(np.sqrt((v * v).sum(axis=-1)))


def law(s: Section, w: Any_, corner: Any_) -> Any_:
    """Section matrices (e, p, 8, 8) over (ε, κ, γ) times the weights w (e, p); corner shapes (p,
    corners).
    """
    w1, w2, w3 = (s.weights(w, corner, p)[..., None, None] for p in (1, 2, 3))
    C = np.zeros(
        (*w.shape, 8, 8), dtype=np.result_type(s.membrane, s.coupling, s.bending, s.shear, w1)
    )
    C[..., :3, :3], C[..., 3:6, 3:6] = s.membrane[:, None] * w1, s.bending[:, None] * w3
    C[..., :3, 3:6] = C[..., 3:6, :3] = s.coupling[:, None] * w2
    C[..., 6:, 6:] = s.shear[:, None] * w1
    return C


def strains(rule: Rule, x: Any_, n: Any_, back: Any_) -> Any_:
    """Rows (e, p, 8, 6k) of (ε, κ, γ) in the local axes over (u, θ) of each node."""
    plane, shear = rule.plane, rule.shear
    membrane, curvature = _plane_samples(rule, plane, x, n)
    p, q = back[..., 0, :], back[..., 1, :]
    T = np.stack(
        [
            np.stack([p[..., 0] ** 2, p[..., 1] ** 2, p[..., 0] * p[..., 1]], axis=-1),
            np.stack([q[..., 0] ** 2, q[..., 1] ** 2, q[..., 0] * q[..., 1]], axis=-1),
            np.stack(
                [
                    2 * p[..., 0] * q[..., 0],
                    2 * p[..., 1] * q[..., 1],
                    p[..., 0] * q[..., 1] + p[..., 1] * q[..., 0],
                ],
                axis=-1,
            ),
        ],
        axis=-2,
    )
    inside = [T @ _carried(plane, rows) for rows in (membrane, curvature)]
    return np.concatenate(
        [*inside, back @ _carried(shear, _shear_samples(rule, shear, x, n))], axis=2
    )


def _carried(s: Samples, rows: Any_) -> Any_:
    """Sampled rows (e, k, d) to the integration points (e, p, c, d)."""
    p, c, k = s.carry.shape
    return np.asarray((s.carry.reshape(p * c, k) @ rows).reshape(len(rows), p, c, -1))


def _along(rule: Rule, s: Samples, x: Any_, n: Any_) -> tuple[Any_, Any_, Any_, Any_]:
    """N (k, n), N,d (k, n), x,d (e, k, 3) and the normals' arms n_i x x,d (e, k, n, 3)."""
    N, d = rule.shapes(s.points)
    d = np.einsum("knr,kr->kn", d, s.direction)
    xd = np.einsum("kn,ena->eka", d, x)
    return N, d, xd, np.cross(n[:, None], xd[:, :, None])


def _plane_samples(rule: Rule, s: Samples, x: Any_, n: Any_) -> tuple[Any_, Any_]:
    _, d, xd, arms = _along(rule, s, x, n)
    nd = np.einsum("kn,ena->eka", d, n)
    u, bent, turn = (d[..., None] * v for v in (xd[:, :, None], nd[:, :, None], arms))
    return _rows(u, 0 * u), _rows(bent, turn)


def _shear_samples(rule: Rule, s: Samples, x: Any_, n: Any_) -> Any_:
    N, d, _, arms = _along(rule, s, x, n)
    across = np.einsum("kn,ena->eka", N, n)
    return _rows(d[..., None] * across[:, :, None], N[..., None] * arms)


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
    first, second = gradients[..., 0, None], gradients[..., 1, None]
    e1, e2, n1, n2 = (v[:, :, i, None] for v in (frame, slope) for i in (0, 1))
    stretch = [first * e1, second * e2, second * e1 + first * e2]
    bent = [first * n1, second * n2, second * n1 + first * n2]
    turn = [np.cross(n[:, None], v) for v in stretch]
    exact = [_rows(v, 0 * v) for v in stretch] + [
        _rows(u, v) for u, v in zip(bent, turn, strict=True)
    ]
    missing = np.stack(exact, axis=2) - rows[:, :, :6]
    return np.asarray(np.einsum("ep,epcd->ecd", w / w.sum(axis=1, keepdims=True), missing)[:, None])


def drilling(rule: Rule, x: Any_, s: Section, points: Float, weights: Float) -> Any_:
    """G t K6ROT 1e-6 ∫ (θ·n - (∂u2/∂x1 - ∂u1/∂x2)/2)² by points (p, 2) and weights (p,): (e, 6k,
    6k).
    """
    N, d = rule.shapes(points)
    g, up = tangents(d, x)
    size = length(up)
    normal = up / size[..., None]
    # ∂u1/∂x2 - ∂u2/∂x1 is (g_r · u,s - g_s · u,r) over the area, in any axes of the plane
    u = (
        d[None, :, :, 1, None] * g[:, :, None, 0] - d[None, :, :, 0, None] * g[:, :, None, 1]
    ) / size[..., None, None]
    rows = _rows(u / 2, N[..., None] * normal[:, :, None])
    w = s.weights(size * weights, rule.corner_shapes(points), 1) * s.drill[:, None]
    return np.asarray((rows * w[..., None]).swapaxes(1, 2) @ rows)
