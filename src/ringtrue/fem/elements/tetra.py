"""CTETRA with 4 nodes (constant strain) or 5 to 10 (isoparametric, four points)."""

from __future__ import annotations

import numpy as np
from scipy.special import roots_jacobi

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.solid import Linear, Quadratic, Shape
from ringtrue.fem.elements.solid_material import between, nearest
from ringtrue.fem.elements.solid_rule import Rule

_DL = np.array([[-1.0, -1.0, -1.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def _coordinates(p: Float) -> Float:
    return np.concatenate([1 - p.sum(1, keepdims=True), p], axis=1)


def _linear(p: Float) -> tuple[Float, Float]:
    return _coordinates(p), np.broadcast_to(_DL, (len(p), 4, 3))


def quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 10) and derivatives (gp, 10, 3) at points (gp, 3)."""
    L = _coordinates(p)
    corner, d_corner = L * (2 * L - 1), (4 * L - 1)[..., None] * _DL
    i, j = np.array(EDGES).T
    d_edge = 4 * (L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i])
    return np.concatenate([corner, 4 * L[:, i] * L[:, j]], axis=1), np.concatenate(
        [d_corner, d_edge], axis=1
    )


def _conical(n: int) -> tuple[Float, Float]:
    """Gauss-Jacobi product rule on the unit tetrahedron, exact to degree 2n - 1 (Stroud 1971)."""
    x, wx = roots_jacobi(n, 2, 0)
    y, wy = roots_jacobi(n, 1, 0)
    z, wz = roots_jacobi(n, 0, 0)
    a, b, c = (g.ravel() for g in np.meshgrid((x + 1) / 2, (y + 1) / 2, (z + 1) / 2, indexing="ij"))
    w = np.einsum("i,j,k->ijk", wx / 8, wy / 4, wz / 2).ravel()
    return np.stack([a, b * (1 - a), c * (1 - a) * (1 - b)], axis=1), w


def _axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the middles of opposite edges (Quick Reference
    Guide, CTETRA).
    """
    lines = (([0, 1], [2, 3]), ([0, 2], [1, 3]), ([0, 3], [1, 2]))
    return nearest(np.stack([between(x, a, b) for a, b in lines], axis=1))


_A, _B = (5 - np.sqrt(5)) / 20, (5 + 3 * np.sqrt(5)) / 20
_FOUR = np.full((4, 3), _A) + (_B - _A) * np.eye(4)[:, :3]
_FOUR_W = np.full(4, 1 / 24)
_ONE = np.full((1, 3), 0.25)
_FINE, _FINE_W = _conical(3)
TETRA = Shape(
    "CTETRA",
    Linear(Rule(*_linear(_ONE), np.array([1 / 6])), Rule(*_linear(_FOUR), _FOUR_W)),
    Quadratic(Rule(*quadratic(_FOUR), _FOUR_W), Rule(*quadratic(_FINE), _FINE_W), np.eye(4)),
    EDGES,
    _axes,
)
build = TETRA.build
