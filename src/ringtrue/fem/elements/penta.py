"""CPENTA: 6 nodes with incompatible modes 1 - ζ² and the three edge bubbles of the triangle; 7 to
15 serendipity.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.solid import Linear, Quadratic, Shape
from ringtrue.fem.elements.solid_material import between, by_normal
from ringtrue.fem.elements.solid_rule import Rule, line, over, triangle

_DL = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # of the area coordinates by (r, s)
_TRIANGLE = ((0, 1), (1, 2), (2, 0))
EDGES = (*_TRIANGLE, (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3))


def _area(p: Float) -> Float:
    return np.stack([1 - p[:, 0] - p[:, 1], p[:, 0], p[:, 1]], axis=1)


def _linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 6) and derivatives (gp, 6, 3) at points (r, s, ζ)."""
    L = _area(p)
    low, high = (1 - p[:, 2, None]) / 2, (1 + p[:, 2, None]) / 2
    values = np.concatenate([L * low, L * high], axis=1)
    d = np.empty((len(p), 6, 3))
    d[:, :3, :2], d[:, 3:, :2] = _DL * low[..., None], _DL * high[..., None]
    d[:, :3, 2], d[:, 3:, 2] = -L / 2, L / 2
    return values, d


def quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 15) and derivatives (gp, 15, 3) of the serendipity functions at points (r, s,
    ζ).
    """
    L, z = _area(p), p[:, 2, None]
    (low, high), (d_low, d_high) = ((1 - z) / 2, (1 + z) / 2), (-0.5, 0.5)
    i, j = np.array(_TRIANGLE).T
    edge = 4 * L[:, i] * L[:, j]
    d_edge = 4 * (L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i])
    middle = np.concatenate([edge * low, L * (1 - z**2), edge * high], axis=1)
    d_middle = np.empty((len(p), 9, 3))
    d_middle[:, :3, :2], d_middle[:, :3, 2] = d_edge * low[..., None], edge * d_low
    d_middle[:, 3:6, :2], d_middle[:, 3:6, 2] = _DL * (1 - z**2)[..., None], -2 * z * L
    d_middle[:, 6:, :2], d_middle[:, 6:, 2] = d_edge * high[..., None], edge * d_high
    return over(EDGES, *_linear(p), middle, d_middle)


def _bubbles(p: Float) -> Float:
    L = _area(p)
    d = np.zeros((len(p), 4, 3))
    d[:, 0, 2] = -2 * p[:, 2]
    for k, (i, j) in enumerate(_TRIANGLE):
        d[:, 1 + k, :2] = L[:, i, None] * _DL[j] + L[:, j, None] * _DL[i]
    return d


def _product(flat: tuple[Float, Float], along: tuple[Float, Float]) -> tuple[Float, Float]:
    """Points (gp, 3) and weights of a triangle's times a line's."""
    (p, w), (z, v) = flat, along
    points = np.concatenate([np.column_stack([p, np.full(len(p), zi)]) for zi in z])
    return points, (v[:, None] * w).ravel()


def _axes(x: Any_) -> Any_:
    """x and y in the middle surface, x from the middle of G1-G4 to that of G2-G5 (Quick Reference
    Guide, CPENTA).
    """
    return by_normal(between(x, [0, 3], [1, 4]), between(x, [0, 3], [2, 5]))


_P, _W = _product(triangle(2), line(2))
RULE = Rule(*_linear(_P), _W)
BUBBLES = _bubbles(_P)
CENTRE = _linear(np.array([[1 / 3, 1 / 3, 0.0]]))[1]
_FINE, _FINE_W = _product(triangle(5), line(3))
FULL = Rule(*quadratic(_FINE), _FINE_W)
PENTA = Shape(
    "CPENTA",
    Linear(RULE, RULE, BUBBLES, CENTRE),
    Quadratic(FULL, FULL, np.column_stack([np.ones(len(_FINE)), _FINE])),
    EDGES,
    _axes,
)
build = PENTA.build
