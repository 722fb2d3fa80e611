"""CHEXA with 8 nodes and three incompatible modes (Wilson; Taylor, Beresford and Wilson 1976)."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.elements.solid import Rule, assemble, refuse_midside
from ringtrue.fem.mesh import Matrices, Mesh

_SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=float,
)


def _shape(p: Float) -> tuple[Float, Float]:
    """Values (gp, 8) and derivatives (gp, 8, 3) at points (gp, 3)."""
    f = 1 + p[:, None, :] * _SIGNS
    d = [_SIGNS[:, a] * f[..., b] * f[..., c] for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    return f.prod(axis=2) / 8, np.stack(d, axis=2) / 8


_POINTS = _SIGNS / np.sqrt(3)
RULE = Rule(*_shape(_POINTS), np.ones(8))
BUBBLES = -2 * _POINTS[:, :, None] * np.eye(3)
CENTRE = _shape(np.zeros((1, 3)))[1]


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CHEXA."""
    refuse_midside(m, card, at, 9, 20)
    return assemble(m, card, at, [f"G{i}" for i in range(1, 9)], (RULE, RULE), BUBBLES, CENTRE)
