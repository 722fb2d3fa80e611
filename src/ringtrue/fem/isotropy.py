"""Isotropic elasticity from one Gram matrix of shape function gradients, in two or three
dimensions.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float


def gram(gradients: Float, weights: Float) -> Float:
    """A[i,a,j,b] = ∫ ∂aNi ∂bNj; gradients (e, gp, n, d), weights (e, gp) -> (e, n, d, n, d)."""
    e, g, n, d = gradients.shape
    flat = gradients.reshape(e, g, n * d)
    return np.asarray(((flat * weights[:, :, None]).swapaxes(1, 2) @ flat).reshape(e, n, d, n, d))


def elastic(A: Float, c11: Any_, c12: Any_, G: Any_) -> Any_:
    """Stiffness (e, n d, n d) with σaa = c11 εaa + c12 εbb, τab = G γab from the Gram matrix A; c,
    G (e,).
    """
    e, n, d = A.shape[:3]
    c11, c12, G = (c.reshape(-1, 1, 1, 1, 1) for c in (c11, c12, G))
    K = c12 * A + G * A.transpose(0, 1, 4, 3, 2)
    trace = np.einsum("eiaja->eij", A)
    for a in range(d):
        K[:, :, a, :, a] += G[..., 0, 0] * trace + (c11 - c12 - 2 * G)[..., 0, 0] * A[:, :, a, :, a]
    return K.reshape(e, n * d, n * d)


def plane_stress(E: Any_, nu: Any_) -> tuple[Any_, Any_]:
    """c11, c12 of plane stress."""
    c = E / (1 - nu * nu)
    return c, nu * c


def solid(E: Any_, nu: Any_) -> tuple[Any_, Any_]:
    """c11, c12 of a three-dimensional body."""
    c = E / ((1 + nu) * (1 - 2 * nu))
    return (1 - nu) * c, nu * c


def determinants(derivatives: Float, x: Float) -> Float:
    """(e, gp), of the map from natural derivatives (gp, n, d) at nodes x (e, n, d); 0 where it is
    singular.
    """
    return np.asarray(np.linalg.det(np.einsum("gnr,ena->egra", derivatives, x)))


def jacobian(derivatives: Float, x: Float) -> tuple[Float, Float, Float]:
    """Of the map from natural derivatives (gp, n, d) at nodes x (e, n, d).

    Returns
    -------
    J : (e, gp, d, d), J[r, a] = ∂x_a/∂ξ_r
    det : (e, gp)
    gradients : (e, gp, n, d)
    """
    J = np.einsum("gnr,ena->egra", derivatives, x)
    det = np.linalg.det(J)
    gradients = np.linalg.solve(
        J, np.broadcast_to(derivatives.swapaxes(1, 2), (*J.shape[:2], *derivatives.shape[:0:-1]))
    )
    return J, det, gradients.swapaxes(2, 3)


def incompatible(derivatives: Float, J0: Float, det0: Float, det: Float, weights: Float) -> Float:
    """Gradients of bubble modes with zero mean: the patch test holds on any distortion.

    Taken at the centre's Jacobian and scaled by det0/det (Taylor, Beresford and Wilson 1976); what
    mean is left is removed (Ibrahimbegovic and Wilson 1991). `derivatives` (gp, m, d), J0 (e, d,
    d), weights (e, gp) with det in them -> (e, gp, m, d).
    """
    g = np.einsum("era,gmr->egma", np.linalg.inv(J0).swapaxes(1, 2), derivatives)
    g = g * (det0[:, None] / det)[:, :, None, None]
    mean = np.einsum("eg,egma->ema", weights, g) / weights.sum(1)[:, None, None]
    return np.asarray(g - mean[:, None])
