"""CHEXA: 8 nodes with three incompatible modes (Wilson; Taylor, Beresford and Wilson 1976), 9 to 20
serendipity.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.solid import Linear, Quadratic, Shape
from ringtrue.fem.elements.solid_material import between, nearest
from ringtrue.fem.elements.solid_rule import Rule, cube, over

_SIGNS = np.array(
    [
        [-1, -1, -1],
        [1, -1, -1],
        [1, 1, -1],
        [-1, 1, -1],
        [-1, -1, 1],
        [1, -1, 1],
        [1, 1, 1],
        [-1, 1, 1],
    ],
    dtype=float,
)
EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
)
_I, _J = np.array(EDGES).T
_MIDDLES = (_SIGNS[_I] + _SIGNS[_J]) / 2  # natural coordinates of the midside nodes


def _linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 8) and derivatives (gp, 8, 3) at points (gp, 3)."""
    f = 1 + p[:, None, :] * _SIGNS
    d = [_SIGNS[:, a] * f[..., b] * f[..., c] for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    return f.prod(axis=2) / 8, np.stack(d, axis=2) / 8


def quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 20) and derivatives (gp, 20, 3) of the serendipity functions at points (gp,
    3).
    """
    along = _MIDDLES == 0
    f = np.where(along, 1 - p[:, None, :] ** 2, 1 + p[:, None, :] * _MIDDLES)
    df = np.where(along, -2 * p[:, None, :], np.broadcast_to(_MIDDLES, f.shape))
    d = [df[..., a] * f[..., b] * f[..., c] for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    return over(EDGES, *_linear(p), f.prod(axis=2) / 4, np.stack(d, axis=2) / 4)


def _axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the centres of opposite faces (Quick Reference
    Guide, CHEXA).
    """
    R = between(x, [0, 3, 4, 7], [1, 2, 5, 6])
    S = between(x, [0, 1, 4, 5], [2, 3, 6, 7])
    T = between(x, [0, 1, 2, 3], [4, 5, 6, 7])
    return nearest(np.stack([R, S, T], axis=1))


_POINTS = _SIGNS / np.sqrt(3)
RULE = Rule(*_linear(_POINTS), np.ones(8))
BUBBLES = -2 * _POINTS[:, :, None] * np.eye(3)
CENTRE = _linear(np.zeros((1, 3)))[1]
_P, _W = cube(3)
FULL = Rule(*quadratic(_P), _W)
HEXA = Shape(
    "CHEXA",
    Linear(RULE, RULE, BUBBLES, CENTRE),
    Quadratic(FULL, FULL, _linear(_P)[0]),
    EDGES,
    _axes,
)
build = HEXA.build
