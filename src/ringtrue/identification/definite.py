"""Cholesky factors of normal matrices from which rounding may have taken that they are definite."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cholesky

Entry = TypeVar("Entry", np.float64, np.complex128)


def lower_factor(normal: NDArray[Entry], ridge: float) -> NDArray[Entry]:
    """Lower Cholesky factor of normal + ridge·I, with the least ridge that does.

    Exact data make a normal matrix singular, and one that is a difference of two has the rounding
    of both, which hangs on the machine. The ridge grows by tens until the matrix is definite.

    Parameters
    ----------
    normal : (n, n) float64 or complex128, symmetric or Hermitian, finite
    ridge : float
        The least, in the unit of `normal`.

    Returns
    -------
    (n, n), of the type of `normal`
    """
    eye, ridge = np.eye(len(normal)), max(ridge, np.finfo(float).tiny)
    while True:
        try:
            return np.asarray(cholesky(normal + ridge * eye, lower=True))
        except LinAlgError:
            ridge *= 10.0
