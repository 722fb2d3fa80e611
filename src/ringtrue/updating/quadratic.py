"""The quadratic model of J: its minimum inside linear limits, its Hessian beyond Gauss-Newton,
roots of covariances.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from ringtrue.core.arrays import Float


def least_distance(hessian: Float, gradient: Float, rows: Float, limits: Float) -> Float:
    """d (q,) of least ½dᵀHd + gᵀd with rows d <= limits; 0 where no d fulfils them.

    H = RᵀR; with e = Rd + R⁻ᵀg the problem is least ‖e‖ inside inequalities, whose dual is a
    non-negative least-squares problem (Lawson and Hanson 1974, eq. 23.27).

    Parameters
    ----------
    hessian : (q, q) float64, positive definite
    gradient : (q,) float64
    rows, limits : (c, q), (c,) float64
    """
    size = 1 / np.sqrt(np.diag(hessian))
    r = linalg.cholesky(hessian * np.outer(size, size))
    free = linalg.solve_triangular(r, gradient * size, trans="T")
    plain = -linalg.solve_triangular(r, free) * size
    if (rows @ plain <= limits).all():
        return np.asarray(plain)
    length = np.linalg.norm(rows * size, axis=1)
    keep = length > 0
    a = linalg.solve_triangular(r, (rows[keep] * size / length[keep, None]).T, trans="T").T
    b = limits[keep] / length[keep] + a @ free
    scale = max(float(np.abs(b).max()), 1e-300)  # the dual is solved at unit size
    u, gap = nnls(
        np.vstack([-a.T, -b[None] / scale]),
        np.append(np.zeros(free.size), 1.0),
        maxiter=50 * b.size,
    )
    if gap == 0.0:
        return np.zeros_like(plain)
    # the constraints that hold as equations are known now, the point itself has lost digits to the
    # dual
    e = linalg.lstsq(a[u > 0], b[u > 0])[0]
    return np.asarray(linalg.solve_triangular(r, e - free) * size)


def positive(normal: Float, curvature: Float, safe: float = 1e-3) -> Float:
    """`normal` + `curvature` if that is safely positive definite, else `normal` (q, q)."""
    if not curvature.any():
        return normal
    both, size = normal + curvature, np.sqrt(np.diag(normal))
    return (
        both
        if float(np.linalg.eigvalsh(both / np.outer(size, size)).min(initial=1.0)) > safe
        else normal
    )


def secant(
    kept: Float,
    s: Float,
    old: tuple[Float, Float],
    new: tuple[Float, Float],
    precision: Float,
    near: float = 0.3,
) -> Float:
    """Σ r ∂²r (q, q) updated from one step s; 0 for a long one. Dennis, Gay and Welsch (1981), eq.
    2.11 and 3.1.

    Parameters
    ----------
    kept : (q, q) float64
    s : (q,) float64
    old, new : residual (r,) and ∂z/∂y (r, q) before and after the step
    precision : (q, q) float64
    """
    (r0, g0), (r, g) = old, new
    part = -(g - g0).T @ r
    change = g0.T @ r0 - g.T @ r + precision @ s
    along = float(change @ s)
    if along <= 0 or float(np.abs(s).max(initial=0.0)) > near:
        return np.zeros_like(kept)
    own = float(s @ kept @ s)
    sized = kept * (min(1.0, abs(float(s @ part) / own)) if own else 0.0)
    miss = part - sized @ s
    update = (np.outer(miss, change) + np.outer(change, miss)) / along
    return np.asarray(sized + update - float(miss @ s) / along**2 * np.outer(change, change))


def covariance_root(covariance: Float) -> Float:
    """L (q, q) with L Lᵀ = covariance (q, q), which may be singular: the symmetric root of the
    correlation, scaled.

    Draws L z of standard normal z are then the same whatever signs and rotations the eigenvectors
    come out with, which differ from processor to processor.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(size > 0, size, 1.0)
    value, turn = linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * ((turn * np.sqrt(np.maximum(value, 0.0))) @ turn.T))
