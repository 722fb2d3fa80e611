"""CTETRA with 4 nodes (constant strain) or 10 (isoparametric, four points)."""

from __future__ import annotations

import numpy as np
from scipy.special import roots_jacobi

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.elements.solid import Rule, assemble
from ringtrue.fem.mesh import Matrices, Mesh

_DL = np.array([[-1.0, -1.0, -1.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def _coordinates(p: Float) -> Float:
    return np.concatenate([1 - p.sum(1, keepdims=True), p], axis=1)


def _linear(p: Float) -> tuple[Float, Float]:
    return _coordinates(p), np.broadcast_to(_DL, (len(p), 4, 3))


def _quadratic(p: Float) -> tuple[Float, Float]:
    L = _coordinates(p)
    corner, d_corner = L * (2 * L - 1), (4 * L - 1)[..., None] * _DL
    i, j = np.array(_EDGES).T
    d_edge = 4 * (L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i])
    return np.concatenate([corner, 4 * L[:, i] * L[:, j]], axis=1), np.concatenate([d_corner, d_edge], axis=1)


def _conical(n: int) -> tuple[Float, Float]:
    """Gauss-Jacobi product rule on the unit tetrahedron, exact to degree 2n - 1 (Stroud 1971)."""
    x, wx = roots_jacobi(n, 2, 0)
    y, wy = roots_jacobi(n, 1, 0)
    z, wz = roots_jacobi(n, 0, 0)
    a, b, c = (g.ravel() for g in np.meshgrid((x + 1) / 2, (y + 1) / 2, (z + 1) / 2, indexing="ij"))
    w = np.einsum("i,j,k->ijk", wx / 8, wy / 4, wz / 2).ravel()
    return np.stack([a, b * (1 - a), c * (1 - a) * (1 - b)], axis=1), w


_A, _B = (5 - np.sqrt(5)) / 20, (5 + 3 * np.sqrt(5)) / 20
_FOUR = np.full((4, 3), _A) + (_B - _A) * np.eye(4)[:, :3]
_ONE = np.full((1, 3), 0.25)
_FINE, _FINE_W = _conical(3)
LINEAR = (Rule(*_linear(_ONE), np.array([1 / 6])), Rule(*_linear(_FOUR), np.full(4, 1 / 24)))
QUADRATIC = (Rule(*_quadratic(_FOUR), np.full(4, 1 / 24)), Rule(*_quadratic(_FINE), _FINE_W))


def build4(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CTETRA that have 4 nodes."""
    return assemble(m, card, at, [f"G{i}" for i in range(1, 5)], LINEAR)


def build10(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CTETRA that have 10 nodes.

    Raises
    ------
    UnsupportedCard
        If only some of the midside nodes are given.
    """
    t = m.model[card]
    some = (t.stack(*(f"G{i}" for i in range(5, 11)))[at] == 0).any(axis=1)
    if some.any():
        raise UnsupportedCard(card, why=f"{t.ids[at[some][0]]} has some of its midside nodes; give all six or none")
    return assemble(m, card, at, [f"G{i}" for i in range(1, 11)], QUADRATIC)
