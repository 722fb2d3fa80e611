"""CPENTA with 6 nodes and incompatible modes 1 - ζ² and the three edge bubbles of the triangle."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.elements.solid import Rule, assemble, refuse_midside
from ringtrue.fem.mesh import Matrices, Mesh

_DL = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # of the area coordinates by (r, s)


def _shape(p: Float) -> tuple[Float, Float]:
    """Values (gp, 6) and derivatives (gp, 6, 3) at points (r, s, ζ)."""
    L = np.stack([1 - p[:, 0] - p[:, 1], p[:, 0], p[:, 1]], axis=1)
    low, high = (1 - p[:, 2, None]) / 2, (1 + p[:, 2, None]) / 2
    values = np.concatenate([L * low, L * high], axis=1)
    d = np.empty((len(p), 6, 3))
    d[:, :3, :2], d[:, 3:, :2] = _DL * low[..., None], _DL * high[..., None]
    d[:, :3, 2], d[:, 3:, 2] = -L / 2, L / 2
    return values, d


def _bubbles(p: Float) -> Float:
    L = np.stack([1 - p[:, 0] - p[:, 1], p[:, 0], p[:, 1]], axis=1)
    d = np.zeros((len(p), 4, 3))
    d[:, 0, 2] = -2 * p[:, 2]
    for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        d[:, 1 + k, :2] = L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i]
    return d


def _points() -> tuple[Float, Float]:
    tri = np.array([[1, 1], [4, 1], [1, 4]]) / 6
    z = np.array([-1.0, 1.0]) / np.sqrt(3)
    p = np.concatenate([np.column_stack([tri, np.full(3, zi)]) for zi in z])
    return p, np.full(6, 1 / 6)


_P, _W = _points()
RULE = Rule(*_shape(_P), _W)
BUBBLES = _bubbles(_P)
CENTRE = _shape(np.array([[1 / 3, 1 / 3, 0.0]]))[1]


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CPENTA."""
    refuse_midside(m, card, at, 7, 15)
    return assemble(m, card, at, [f"G{i}" for i in range(1, 7)], (RULE, RULE), BUBBLES, CENTRE)
