"""Hermitian systems in augmented unknowns (x, conj x), in real numbers: a quarter of the time and
of the memory.

With H of blocks V = R + iS at (x, x) and W = P + iQ at (x, conj x), the other two their conjugates,
the form in (Re x, Im x) is [[R + P, Q − S], [Q + S, R − P]], of the same eigenvalues (van den Bos
1994, IEE Proc. 141).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ringtrue.core.arrays import Complex, Float


def real_form(v: Complex, w: Complex) -> Float:
    """(2 k, 2 k) form in (Re x, Im x) of the blocks (k, k) at (x, x) and (x, conj x)."""
    return np.block([[v.real + w.real, w.imag - v.imag], [w.imag + v.imag, v.real - w.real]])


def augmented_form(c: Float) -> tuple[Complex, Complex]:
    """Blocks (k, k) at (x, x) and (x, conj x) of a form in (Re x, Im x): `real_form` turned
    round.
    """
    k = c.shape[0] // 2
    a, b, d = c[:k, :k], c[:k, k:], c[k:, k:]
    return np.asarray(0.5 * (a + d + 1j * (b.T - b))), np.asarray(0.5 * (a - d + 1j * (b.T + b)))


def pseudo_inverse(a: Float, least: float) -> Float:
    """Of a symmetric matrix without the eigenvalues below `least` of the largest: by Cholesky where
    none is.
    """
    low, fails = lapack.dpotrf(a, lower=True)
    if not fails and lapack.dpocon(low, np.linalg.norm(a, 1), uplo="L")[0] > least:
        half = np.tril(lapack.dpotri(low, lower=True)[0])
        return np.asarray(half + np.tril(half, -1).T)
    return np.asarray(np.linalg.pinv(a, rcond=least, hermitian=True))
