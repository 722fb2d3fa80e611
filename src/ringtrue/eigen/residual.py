"""Residual vectors: the static answer of the modes that are left out, as pseudo-modes behind the
modes.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes

RANK = 1e-10  # relative size under which a direction adds nothing


def residual_vectors(pencil: Pencil, modes: EigenModes, loads: Float) -> tuple[Float, Float]:
    """The modes, and one pseudo-mode for each independent load, M- and K-orthogonal to them and to
    each other.

    The space of (K − σM)⁻¹F without its part in the modes (Dickens, Nakagawa and Wittbrodt 1997; σ
    is the shift of the modes, so that free structures need no inertia relief).

    Parameters
    ----------
    pencil : Pencil
    modes : EigenModes
        All modes from the lowest up.
    loads : (f, k) float64

    Returns
    -------
    values (n,), vectors (f, n) float64, mass-normalised
        The m modes first, then the pseudo-modes in ascending order.
    """
    phi = modes.vectors
    x = pencil.at(modes.shift).solve(np.ascontiguousarray(loads, dtype=np.float64))
    whole = np.sqrt(np.abs(np.einsum("ij,ij->j", x, pencil.mass @ x)))
    loaded = pencil.mass @ phi
    for _ in range(2):  # twice is enough
        x = x - phi @ (loaded.T @ x)
    left = np.sqrt(np.abs(np.einsum("ij,ij->j", x, pencil.mass @ x)))
    x = x[:, left > RANK * whole] / left[left > RANK * whole]
    k, m = x.T @ (pencil.stiffness @ x), x.T @ (pencil.mass @ x)
    share, turn = linalg.eigh((m + m.T) / 2)
    keep = share > RANK * share.max(initial=0.0)
    basis = turn[:, keep] / np.sqrt(share[keep])
    k = basis.T @ k @ basis
    values, y = linalg.eigh((k + k.T) / 2)
    return np.concatenate([modes.values, values]), np.hstack([phi, x @ (basis @ y)])
