"""CHEXA: 8 nodes with three incompatible modes (Wilson; Taylor, Beresford and Wilson 1976), 9 to 20
serendipity.

CPENTA: 6 nodes with incompatible modes 1 - ζ² and the three edge bubbles of the triangle; 7 to
15 serendipity.

CPYRAM with 5 nodes, or 6 to 13: the pyramid as a hexahedron with a face drawn together
(Bedrosian 1992).

On the natural pyramid with base [-1, 1]² and apex (0, 0, 1), ξ = a (1 - ζ) and η = b (1 - ζ). In
(a, b, ζ) the rational shape functions are polynomials, and the quadrature is a product that keeps
off the apex.

CTETRA with 4 nodes (constant strain) or 5 to 10 (isoparametric, four points).
"""

from __future__ import annotations

import numpy as np
from scipy.special import roots_jacobi

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.elements.elasticity import between, by_normal, nearest
from ringtrue.fem.elements.shape_functions import SolidRule, cube, line, over, triangle
from ringtrue.fem.elements.solid import Linear, Quadratic, Shape

_HEXA_SIGNS = np.array(
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
HEXA_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
)
_HEXA_I, _HEXA_J = np.array(HEXA_EDGES).T
_HEXA_MIDDLES = (
    _HEXA_SIGNS[_HEXA_I] + _HEXA_SIGNS[_HEXA_J]
) / 2  # natural coordinates of the midside nodes


def _hexa_linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 8) and derivatives (gp, 8, 3) at points (gp, 3)."""
    f = 1 + p[:, None, :] * _HEXA_SIGNS
    d = [_HEXA_SIGNS[:, a] * f[..., b] * f[..., c] for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    return f.prod(axis=2) / 8, np.stack(d, axis=2) / 8


def hexa_quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 20) and derivatives (gp, 20, 3) of the serendipity functions at points (gp,
    3).
    """
    along = _HEXA_MIDDLES == 0
    f = np.where(along, 1 - p[:, None, :] ** 2, 1 + p[:, None, :] * _HEXA_MIDDLES)
    df = np.where(along, -2 * p[:, None, :], np.broadcast_to(_HEXA_MIDDLES, f.shape))
    d = [df[..., a] * f[..., b] * f[..., c] for a, b, c in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    return over(HEXA_EDGES, *_hexa_linear(p), f.prod(axis=2) / 4, np.stack(d, axis=2) / 4)


def _hexa_axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the centres of opposite faces (Quick Reference
    Guide, CHEXA).
    """
    R = between(x, [0, 3, 4, 7], [1, 2, 5, 6])
    S = between(x, [0, 1, 4, 5], [2, 3, 6, 7])
    T = between(x, [0, 1, 2, 3], [4, 5, 6, 7])
    return nearest(np.stack([R, S, T], axis=1))


_HEXA_POINTS = _HEXA_SIGNS / np.sqrt(3)
HEXA_RULE = SolidRule(*_hexa_linear(_HEXA_POINTS), np.ones(8))
HEXA_BUBBLES = -2 * _HEXA_POINTS[:, :, None] * np.eye(3)
HEXA_CENTRE = _hexa_linear(np.zeros((1, 3)))[1]
_HEXA_P, _HEXA_W = cube(3)
HEXA_FULL = SolidRule(*hexa_quadratic(_HEXA_P), _HEXA_W)
HEXA = Shape(
    card="CHEXA",
    linear=Linear(HEXA_RULE, HEXA_RULE, HEXA_BUBBLES, HEXA_CENTRE),
    quadratic=Quadratic(HEXA_FULL, HEXA_FULL, _hexa_linear(_HEXA_P)[0]),
    edges=HEXA_EDGES,
    axes=_hexa_axes,
)
hexa_build = HEXA.build


_PENTA_DL = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])  # of the area coordinates by (r, s)
_PENTA_TRIANGLE = ((0, 1), (1, 2), (2, 0))
PENTA_EDGES = (*_PENTA_TRIANGLE, (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3))


def _penta_area(p: Float) -> Float:
    return np.stack([1 - p[:, 0] - p[:, 1], p[:, 0], p[:, 1]], axis=1)


def _penta_linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 6) and derivatives (gp, 6, 3) at points (r, s, ζ)."""
    L = _penta_area(p)
    low = (1 - p[:, 2, None]) / 2
    high = (1 + p[:, 2, None]) / 2
    values = np.concatenate([L * low, L * high], axis=1)
    d = np.empty((len(p), 6, 3))
    d[:, :3, :2] = _PENTA_DL * low[..., None]
    d[:, 3:, :2] = _PENTA_DL * high[..., None]
    d[:, :3, 2] = -L / 2
    d[:, 3:, 2] = L / 2
    return values, d


def penta_quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 15) and derivatives (gp, 15, 3) of the serendipity functions at points (r, s,
    ζ).
    """
    L = _penta_area(p)
    z = p[:, 2, None]
    (low, high), (d_low, d_high) = ((1 - z) / 2, (1 + z) / 2), (-0.5, 0.5)
    i, j = np.array(_PENTA_TRIANGLE).T
    edge = 4 * L[:, i] * L[:, j]
    d_edge = 4 * (L[:, i, None] * _PENTA_DL[j] + L[:, j, None] * _PENTA_DL[i])
    middle = np.concatenate([edge * low, L * (1 - z**2), edge * high], axis=1)
    d_middle = np.empty((len(p), 9, 3))
    d_middle[:, :3, :2] = d_edge * low[..., None]
    d_middle[:, :3, 2] = edge * d_low
    d_middle[:, 3:6, :2] = _PENTA_DL * (1 - z**2)[..., None]
    d_middle[:, 3:6, 2] = -2 * z * L
    d_middle[:, 6:, :2] = d_edge * high[..., None]
    d_middle[:, 6:, 2] = edge * d_high
    return over(PENTA_EDGES, *_penta_linear(p), middle, d_middle)


def _penta_bubbles(p: Float) -> Float:
    L = _penta_area(p)
    d = np.zeros((len(p), 4, 3))
    d[:, 0, 2] = -2 * p[:, 2]
    for k, (i, j) in enumerate(_PENTA_TRIANGLE):
        d[:, 1 + k, :2] = L[:, i, None] * _PENTA_DL[j] + L[:, j, None] * _PENTA_DL[i]
    return d


def _penta_product(flat: tuple[Float, Float], along: tuple[Float, Float]) -> tuple[Float, Float]:
    """Points (gp, 3) and weights of a triangle's times a line's."""
    (p, w), (z, v) = flat, along
    points = np.concatenate([np.column_stack([p, np.full(len(p), zi)]) for zi in z])
    return points, (v[:, None] * w).ravel()


def _penta_axes(x: Any_) -> Any_:
    """x and y in the middle surface, x from the middle of G1-G4 to that of G2-G5 (Quick Reference
    Guide, CPENTA).
    """
    return by_normal(between(x, [0, 3], [1, 4]), between(x, [0, 3], [2, 5]))


_PENTA_P, _PENTA_W = _penta_product(triangle(2), line(2))
PENTA_RULE = SolidRule(*_penta_linear(_PENTA_P), _PENTA_W)
PENTA_BUBBLES = _penta_bubbles(_PENTA_P)
PENTA_CENTRE = _penta_linear(np.array([[1 / 3, 1 / 3, 0.0]]))[1]
_PENTA_FINE, _PENTA_FINE_W = _penta_product(triangle(5), line(3))
PENTA_FULL = SolidRule(*penta_quadratic(_PENTA_FINE), _PENTA_FINE_W)
PENTA = Shape(
    card="CPENTA",
    linear=Linear(PENTA_RULE, PENTA_RULE, PENTA_BUBBLES, PENTA_CENTRE),
    quadratic=Quadratic(
        PENTA_FULL, PENTA_FULL, np.column_stack([np.ones(len(_PENTA_FINE)), _PENTA_FINE])
    ),
    edges=PENTA_EDGES,
    axes=_penta_axes,
)
penta_build = PENTA.build


_PYRAMID_SIGNS = np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
_PYRAMID_MIDDLES = np.array([[0.0, -1.0], [1, 0], [0, 1], [-1, 0]])
PYRAMID_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))


def _pyramid_faces(p: Float, signs: Float) -> tuple[Float, Float]:
    """Products over a and b of 1 + s a, or of 1 - a² where s is 0: (gp, 4), and derivatives (gp, 4,
    2).
    """
    q = p[:, None, :2]
    f = np.where(signs == 0, 1 - q**2, 1 + q * signs)
    df = np.where(signs == 0, -2 * q, np.broadcast_to(signs, f.shape))
    return f.prod(axis=2), np.stack([df[..., 0] * f[..., 1], df[..., 1] * f[..., 0]], axis=2)


def _pyramid_times(base: tuple[Float, Float], h: Float, dh: Float) -> tuple[Float, Float]:
    """Functions of (a, b) times h(ζ) (gp,): values (gp, 4), derivatives (gp, 4, 3) by (a, b, ζ)."""
    f, df = base
    return f * h[:, None], np.concatenate(
        [df * h[:, None, None], (f * dh[:, None])[..., None]], axis=2
    )


def _pyramid_linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 5) and derivatives (gp, 5, 3) at points (a, b, ζ)."""
    z = p[:, 2]
    value, d = _pyramid_times(
        _pyramid_faces(p, _PYRAMID_SIGNS), (1 - z) / 4, np.full(len(p), -0.25)
    )
    apex = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(p), 1, 3))
    return np.concatenate([value, z[:, None]], axis=1), np.concatenate([d, apex], axis=1)


def pyramid_quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 13) and derivatives (gp, 13, 3) by (a, b, ζ) at points (a, b, ζ)."""
    z = p[:, 2]
    base, d_base = _pyramid_times(_pyramid_faces(p, _PYRAMID_MIDDLES), (1 - z) ** 2 / 2, z - 1)
    rise, d_rise = _pyramid_times(_pyramid_faces(p, _PYRAMID_SIGNS), z * (1 - z), 1 - 2 * z)
    middle = np.concatenate([base, rise], axis=1)
    d_middle = np.concatenate([d_base, d_rise], axis=1)
    return over(PYRAMID_EDGES, *_pyramid_linear(p), middle, d_middle)


def _pyramid_conical(n: int) -> tuple[Float, Float]:
    """Gauss points (a, b, ζ) and weights on the pyramid; the factor (1 - ζ)² is left to the
    Jacobian.
    """
    x, w = line(n)
    t, v = roots_jacobi(n, 2, 0)
    z = (t + 1) / 2
    points = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.einsum("i,j,k->ijk", w, w, v / 8 / (1 - z) ** 2).ravel()


def _pyramid_axes(x: Any_) -> Any_:
    """z from the middle of the base to the apex, y normal to it and to the line from edge G1-G4 to
    G2-G3.
    """
    z = between(x, [0, 1, 2, 3], [4])
    r = between(x, [0, 3], [1, 2])
    y = np.cross(z, r)
    rows = np.stack([np.cross(y, z), y, z], axis=1)
    return np.asarray(rows / np.sqrt((rows * rows).sum(axis=2, keepdims=True)))


_PYRAMID_P, _PYRAMID_W = _pyramid_conical(2)
PYRAMID_RULE = SolidRule(*_pyramid_linear(_PYRAMID_P), _PYRAMID_W)
_PYRAMID_FINE, _PYRAMID_FINE_W = _pyramid_conical(3)
PYRAMID_FULL = SolidRule(*pyramid_quadratic(_PYRAMID_FINE), _PYRAMID_FINE_W)
_PYRAMID_RISE = 1 - _PYRAMID_FINE[:, 2]
PYRAMID = Shape(
    card="CPYRAM",
    linear=Linear(PYRAMID_RULE, PYRAMID_RULE, pressure=np.ones((len(_PYRAMID_P), 1))),
    quadratic=Quadratic(
        PYRAMID_FULL,
        PYRAMID_FULL,
        np.column_stack(
            [
                np.ones(len(_PYRAMID_RISE)),
                _PYRAMID_FINE[:, 0] * _PYRAMID_RISE,
                _PYRAMID_FINE[:, 1] * _PYRAMID_RISE,
                _PYRAMID_FINE[:, 2],
            ]
        ),
    ),
    edges=PYRAMID_EDGES,
    axes=_pyramid_axes,
)
pyramid_build = PYRAMID.build


_TETRA_DL = np.array([[-1.0, -1.0, -1.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRA_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def _tetra_coordinates(p: Float) -> Float:
    return np.concatenate([1 - p.sum(1, keepdims=True), p], axis=1)


def _tetra_linear(p: Float) -> tuple[Float, Float]:
    return _tetra_coordinates(p), np.broadcast_to(_TETRA_DL, (len(p), 4, 3))


def tetra_quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 10) and derivatives (gp, 10, 3) at points (gp, 3)."""
    L = _tetra_coordinates(p)
    corner = L * (2 * L - 1)
    d_corner = (4 * L - 1)[..., None] * _TETRA_DL
    i, j = np.array(TETRA_EDGES).T
    d_edge = 4 * (L[:, i, None] * _TETRA_DL[j] + L[:, j, None] * _TETRA_DL[i])
    return np.concatenate([corner, 4 * L[:, i] * L[:, j]], axis=1), np.concatenate(
        [d_corner, d_edge], axis=1
    )


def _tetra_conical(n: int) -> tuple[Float, Float]:
    """Gauss-Jacobi product rule on the unit tetrahedron, exact to degree 2n - 1 (Stroud 1971)."""
    x, wx = roots_jacobi(n, 2, 0)
    y, wy = roots_jacobi(n, 1, 0)
    z, wz = roots_jacobi(n, 0, 0)
    a, b, c = (g.ravel() for g in np.meshgrid((x + 1) / 2, (y + 1) / 2, (z + 1) / 2, indexing="ij"))
    w = np.einsum("i,j,k->ijk", wx / 8, wy / 4, wz / 2).ravel()
    return np.stack([a, b * (1 - a), c * (1 - a) * (1 - b)], axis=1), w


def _tetra_axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the middles of opposite edges (Quick Reference
    Guide, CTETRA).
    """
    lines = (([0, 1], [2, 3]), ([0, 2], [1, 3]), ([0, 3], [1, 2]))
    return nearest(np.stack([between(x, a, b) for a, b in lines], axis=1))


_TETRA_A = (5 - np.sqrt(5)) / 20
_TETRA_B = (5 + 3 * np.sqrt(5)) / 20
_TETRA_FOUR = np.full((4, 3), _TETRA_A) + (_TETRA_B - _TETRA_A) * np.eye(4)[:, :3]
_TETRA_FOUR_W = np.full(4, 1 / 24)
_TETRA_ONE = np.full((1, 3), 0.25)
_TETRA_FINE, _TETRA_FINE_W = _tetra_conical(3)
TETRA = Shape(
    card="CTETRA",
    linear=Linear(
        SolidRule(*_tetra_linear(_TETRA_ONE), np.array([1 / 6])),
        SolidRule(*_tetra_linear(_TETRA_FOUR), _TETRA_FOUR_W),
    ),
    quadratic=Quadratic(
        SolidRule(*tetra_quadratic(_TETRA_FOUR), _TETRA_FOUR_W),
        SolidRule(*tetra_quadratic(_TETRA_FINE), _TETRA_FINE_W),
        np.eye(4),
    ),
    edges=TETRA_EDGES,
    axes=_tetra_axes,
)
tetra_build = TETRA.build
