"""Hermitian systems in augmented unknowns (x, conj x) against complex algebra."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.identification.frf.refinement import (
    augmented_form,
    pseudo_inverse,
    real_form,
)

ROUNDING = 1e-12


def hermitian(k: int, rank: int) -> np.ndarray:
    """(2 k, 2 k) sum of `rank` squares, its second half the conjugate of the first."""
    rng = np.random.default_rng(k + rank)
    x = rng.standard_normal((k, rank)) + 1j * rng.standard_normal((k, rank))
    both = np.concatenate([x, x.conj()])
    return np.asarray(both @ both.conj().T)


@pytest.mark.parametrize("rank", [40, 9])
def test_inverse_is_that_of_the_complex_matrix(rank: int) -> None:
    """Of full rank and of less, where it is the pseudoinverse."""
    k = 6
    h = hermitian(k, rank)
    v, w = augmented_form(pseudo_inverse(real_form(h[:k, :k], h[:k, k:]), 1e-8))
    want = np.linalg.pinv(h, rcond=1e-8, hermitian=True)
    np.testing.assert_allclose(
        np.block([[v, w], [w.conj(), v.conj()]]),
        want,
        atol=ROUNDING * np.abs(want).max(),
    )
