"""A free plate on springs far softer than itself, and bands far from zero: rigid-body modes in
closed form.
"""

from __future__ import annotations

import numpy as np
import pytest
from eigen_plate import plate
from scipy import linalg, sparse

from ringtrue.eigen.engines import installed
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil

COUNTING = [m for m in installed() if m != "dense"]


@pytest.fixture(scope="module")
def free() -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray]:
    """K, M and all eigenvalues of the free plate, 484 DOFs."""
    k, m = plate(10, 10)
    return k, m, linalg.eigh(k.toarray(), m.toarray(), eigvals_only=True)


@pytest.mark.parametrize("method", COUNTING)
@pytest.mark.parametrize("spring", [1e-2, 1e2])
def test_plate_on_a_soft_foundation(free, method, spring):
    """K + sM/m: every eigenvalue of the free plate moves by s/m exactly, the three rigid ones to
    s/m.
    """
    k, m, lam = free
    soft = sparse.csr_array(k + spring / 80.0 * m)
    got = solve_modes(Pencil(soft, m, method=method), 12)
    assert np.allclose(
        got.values[:3], spring / 80.0, rtol=1e-4, atol=1e-9 * lam[3]
    )  # rounding of K
    assert np.allclose(got.values[3:], lam[3:12] + spring / 80.0, rtol=1e-7)
    assert got.complete


@pytest.mark.parametrize("method", COUNTING)
def test_band_far_above_the_first_modes(free, method):
    """Around the 150th mode; two thirds of the spectrum below the band stay untouched."""
    k, m, lam = free
    f = np.sqrt(np.maximum(lam, 0)) / (2 * np.pi)
    gap = np.flatnonzero(np.diff(f[140:165]) > 1e-3 * f[140:164]) + 140
    low, high = (f[gap[0]] + f[gap[0] + 1]) / 2, (f[gap[-1]] + f[gap[-1] + 1]) / 2
    want = f[(f >= low) & (f <= high)]
    got = solve_modes(Pencil(k, m, method=method), band=(low, high))
    assert got.values.size == want.size >= 8
    assert np.allclose(got.frequencies, want, rtol=1e-7)
    assert got.residuals.max() < 1e-8
    assert got.orthogonality < 1e-9
    assert got.complete
