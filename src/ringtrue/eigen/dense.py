"""Dense eigensolution of small matrices, in the inverted form that keeps the low modes exact."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float
from ringtrue.errors import SingularModel

DENSE_SIZE = 400  # rows up to which the dense solution is used


def spectrum(stiffness: sparse.csr_array, mass: sparse.csr_array, shift: float) -> tuple[Float, Float]:
    """All finite eigenpairs of K φ = λ M φ from M φ = θ (K − σM) φ, λ = σ + 1/θ; M may be singular.

    Parameters
    ----------
    stiffness, mass : (f, f) csr_array float64
    shift : float
        σ below every λ, so that K − σM is positive definite.

    Returns
    -------
    values : (k,) float64, ascending
    vectors : (f, k) float64, M-orthonormal

    Raises
    ------
    SingularModel
        If K − σM is not positive definite.
    """
    k, m = stiffness.toarray(), mass.toarray()
    a = k - shift * m
    d = 1 / np.sqrt(np.where(np.diag(a) > 0, np.diag(a), 1.0))  # scaled first: units differ by decades
    scale = d * d[:, None]
    try:
        theta, y = linalg.eigh(m * scale, a * scale)
    except linalg.LinAlgError:
        rows = [f"row {i}" for i in np.argsort(np.diag(a))[:3]]
        raise SingularModel(rows, f"K - ({shift:.3g}) M is not positive definite") from None
    theta, y = theta[::-1], y[:, ::-1]
    finite = theta > 1e-13 * theta[0]
    theta, y = theta[finite], y[:, finite]
    vectors = d[:, None] * y
    return shift + 1 / theta, vectors / np.sqrt(np.einsum("ij,ij->j", vectors, m @ vectors))
