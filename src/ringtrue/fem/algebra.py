"""Algebra of small matrices, batched over elements and generic in dtype (a complex step passes)."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Int


def skew(r: Any_) -> Any_:
    """[r]x with [r]x v = r x v; (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*r.shape, 3), dtype=r.dtype)
    out[..., 0, 1] = -r[..., 2]
    out[..., 0, 2] = r[..., 1]
    out[..., 1, 2] = -r[..., 0]
    out[..., 1, 0] = r[..., 2]
    out[..., 2, 0] = -r[..., 1]
    out[..., 2, 1] = r[..., 0]
    return out


def unit(v: Any_) -> Any_:
    """Vectors (..., 3) divided by their length, analytic; one without length stays 0."""
    length = np.sqrt((v * v).sum(axis=-1, keepdims=True))
    return np.asarray(v / np.where(length == 0, 1.0, length))


def arm(r: Any_) -> Any_:
    """Motion (6) of a point at r from a node, by that of the node: (..., 3) -> (..., 6, 6)."""
    out = np.zeros((*r.shape[:-1], 6, 6), dtype=r.dtype)
    out[...] = np.eye(6)
    out[..., :3, 3:] = -skew(r)
    return out


def congruent(A: Any_, K: Any_) -> Any_:
    """AᵀKA for A (e, i, j) and K (e, i, i)."""
    return A.swapaxes(-1, -2) @ K @ A


def nodal(blocks: Any_) -> Any_:
    """Block-diagonal matrices of nodal blocks (e, k, 6, 6) -> (e, 6k, 6k)."""
    e, k = blocks.shape[:2]
    out = np.zeros((e, k, 6, k, 6), dtype=blocks.dtype)
    at = np.arange(k)
    out[:, at, :, at, :] = blocks.swapaxes(0, 1)
    return out.reshape(e, 6 * k, 6 * k)


def rotation(R: Any_, k: int) -> Any_:
    """Basic motion (6k) to local: local axes R (e, 3, 3) as rows -> (e, 6k, 6k)."""
    e = len(R)
    out = np.zeros((e, 2 * k, 3, 2 * k, 3), dtype=R.dtype)
    at = np.arange(2 * k)
    out[:, at, :, at, :] = R
    return out.reshape(e, 6 * k, 6 * k)


def condense(K: Any_, keep: Int | slice, drop: Int | slice) -> Any_:
    """Static condensation K_kk - K_kd K_dd⁻¹ K_dk, (e, d, d) -> (e, k, k); without it where K_dd is
    zero.
    """
    rows = K[:, keep]
    Kkk = rows[:, :, keep]
    Kkd = rows[:, :, drop]
    Kdd = K[:, drop][:, :, drop]
    live = np.abs(Kdd).max(axis=(1, 2), initial=0) > 0
    if live.all():
        return Kkk - Kkd @ np.linalg.solve(Kdd, Kkd.swapaxes(1, 2))
    out = np.array(Kkk)
    out[live] -= Kkd[live] @ np.linalg.solve(Kdd[live], Kkd[live].swapaxes(1, 2))
    return out


def scaled(c: Any_, K: Any_) -> Any_:
    """c (e,) times K (e, ...)."""
    return np.asarray(c.reshape(-1, *(1,) * (K.ndim - 1)) * K)


def applied(A: Any_, x: Any_) -> Any_:
    """Matrices (e, d, d), or diagonals (e, d), times motions (e, d, m)."""
    return A[:, :, None] * x if A.ndim == 2 else A @ x


def add_at(out: Any_, dofs: Int, values: Any_) -> None:
    """Add what elements have at their DOFs, (e, d) each, -1 for none, to that of all, (dof,)."""
    np.add.at(out, dofs[dofs >= 0], values[dofs >= 0])


def scatter(e: int, d: int, *blocks: tuple[list[int], Any_]) -> Any_:
    """The sum of blocks (rows, (e, r, r)) placed into (e, d, d)."""
    out = np.zeros((e, d, d), dtype=np.result_type(float, *(b.dtype for _, b in blocks)))
    for rows, block in blocks:
        out[:, np.array(rows)[:, None], rows] += block
    return out
