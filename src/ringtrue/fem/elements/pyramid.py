"""CPYRAM with 5 nodes, or 6 to 13: the pyramid as a hexahedron with a face drawn together
(Bedrosian 1992).

On the natural pyramid with base [-1, 1]² and apex (0, 0, 1), ξ = a (1 - ζ) and η = b (1 - ζ). In
(a, b, ζ) the rational shape functions are polynomials, and the quadrature is a product that keeps
off the apex.
"""

from __future__ import annotations

import numpy as np
from scipy.special import roots_jacobi

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.solid import Linear, Quadratic, Shape
from ringtrue.fem.elements.solid_material import between
from ringtrue.fem.elements.solid_rule import Rule, line, over

_SIGNS = np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
_MIDDLES = np.array([[0.0, -1.0], [1, 0], [0, 1], [-1, 0]])
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))


def _faces(p: Float, signs: Float) -> tuple[Float, Float]:
    """Products over a and b of 1 + s a, or of 1 - a² where s is 0: (gp, 4), and derivatives (gp, 4,
    2).
    """
    q = p[:, None, :2]
    f = np.where(signs == 0, 1 - q**2, 1 + q * signs)
    df = np.where(signs == 0, -2 * q, np.broadcast_to(signs, f.shape))
    return f.prod(axis=2), np.stack([df[..., 0] * f[..., 1], df[..., 1] * f[..., 0]], axis=2)


def _times(base: tuple[Float, Float], h: Float, dh: Float) -> tuple[Float, Float]:
    """Functions of (a, b) times h(ζ) (gp,): values (gp, 4), derivatives (gp, 4, 3) by (a, b, ζ)."""
    f, df = base
    return f * h[:, None], np.concatenate(
        [df * h[:, None, None], (f * dh[:, None])[..., None]], axis=2
    )


def _linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 5) and derivatives (gp, 5, 3) at points (a, b, ζ)."""
    z = p[:, 2]
    value, d = _times(_faces(p, _SIGNS), (1 - z) / 4, np.full(len(p), -0.25))
    apex = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(p), 1, 3))
    return np.concatenate([value, z[:, None]], axis=1), np.concatenate([d, apex], axis=1)


def quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 13) and derivatives (gp, 13, 3) by (a, b, ζ) at points (a, b, ζ)."""
    z = p[:, 2]
    base, d_base = _times(_faces(p, _MIDDLES), (1 - z) ** 2 / 2, z - 1)
    rise, d_rise = _times(_faces(p, _SIGNS), z * (1 - z), 1 - 2 * z)
    middle, d_middle = (
        np.concatenate([base, rise], axis=1),
        np.concatenate([d_base, d_rise], axis=1),
    )
    return over(EDGES, *_linear(p), middle, d_middle)


def _conical(n: int) -> tuple[Float, Float]:
    """Gauss points (a, b, ζ) and weights on the pyramid; the factor (1 - ζ)² is left to the
    Jacobian.
    """
    x, w = line(n)
    t, v = roots_jacobi(n, 2, 0)
    z = (t + 1) / 2
    points = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.einsum("i,j,k->ijk", w, w, v / 8 / (1 - z) ** 2).ravel()


def _axes(x: Any_) -> Any_:
    """z from the middle of the base to the apex, y normal to it and to the line from edge G1-G4 to
    G2-G3.
    """
    z, r = between(x, [0, 1, 2, 3], [4]), between(x, [0, 3], [1, 2])
    y = np.cross(z, r)
    rows = np.stack([np.cross(y, z), y, z], axis=1)
    return np.asarray(rows / np.sqrt((rows * rows).sum(axis=2, keepdims=True)))


_P, _W = _conical(2)
RULE = Rule(*_linear(_P), _W)
_FINE, _FINE_W = _conical(3)
FULL = Rule(*quadratic(_FINE), _FINE_W)
_RISE = 1 - _FINE[:, 2]
PYRAMID = Shape(
    "CPYRAM",
    Linear(RULE, RULE, pressure=np.ones((len(_P), 1))),
    Quadratic(
        FULL,
        FULL,
        np.column_stack(
            [np.ones(len(_RISE)), _FINE[:, 0] * _RISE, _FINE[:, 1] * _RISE, _FINE[:, 2]]
        ),
    ),
    EDGES,
    _axes,
)
build = PYRAMID.build
