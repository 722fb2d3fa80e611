"""A free thin plate (Poisson's ratio 0) from Hermite beams, tensor product: w, w_x, w_y, w_xy at
each node.

D(w_xx² + 2 w_xy² + w_yy²)/2 gives K = D (K2⊗M + 2 K1⊗K1 + M⊗K2), M = m M⊗M; regions along x scale
separately.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse


def _element(h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """∫N''N'', ∫N'N', ∫NN of the cubic Hermite functions on a length h."""
    k2 = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h]])
    k2 = np.vstack([k2, -k2[0], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3
    k1 = np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h * h, -3 * h, -h * h]])
    k1 = np.vstack([k1, -k1[0], [3 * h, -h * h, -3 * h, 4 * h * h]]) / (30 * h)
    k0 = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h]])
    k0 = (
        np.vstack(
            [k0, [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
        )
        * h
        / 420
    )
    return k2, k1, k0


def line(
    n: int, length: float, weight: np.ndarray | None = None
) -> list[sparse.csr_array]:
    """The three matrices of n elements, each weighted, (2n+2, 2n+2)."""
    weight = np.ones(n) if weight is None else weight
    at = 2 * np.arange(n)[:, None] + np.arange(4)
    row, col = np.repeat(at, 4, axis=1).ravel(), np.tile(at, (1, 4)).ravel()
    return [
        sparse.csr_array(
            ((weight[:, None] * k.ravel()).ravel(), (row, col)), shape=(2 * n + 2,) * 2
        )
        for k in _element(length / n)
    ]


def plate(
    nx: int,
    ny: int,
    *,
    lx: float = 1.0,
    ly: float = 1.0,
    d: float = 2e4,
    m: float = 80.0,
    weight: np.ndarray | None = None,
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """K and M of a free plate; `weight` (nx,) scales the elements along x (0 leaves a region
    out).
    """
    x, y = line(nx, lx, weight), line(ny, ly)
    k = sparse.kron(x[0], y[2]) + 2 * sparse.kron(x[1], y[1]) + sparse.kron(x[2], y[0])
    return sparse.csr_array(d * k), sparse.csr_array(m * sparse.kron(x[2], y[2]))


def held(k: sparse.csr_array, nx: int, ny: int) -> np.ndarray:
    """Free DOFs (f,) of the plate clamped along its first edge."""
    return np.arange(2 * (2 * ny + 2), k.shape[0])
