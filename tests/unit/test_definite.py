"""Cholesky factors of matrices that rounding has left just short of definite."""

import numpy as np
import pytest

from ringtrue.identification.frf.plscf import lower_factor


@pytest.mark.parametrize("least", [-1e-9, -1e-16, 0.0, 1e-6])
@pytest.mark.parametrize("complex_", [False, True])
def test_the_factor_is_that_of_the_matrix_up_to_what_it_lacks(
    least: float, complex_: bool
) -> None:
    rng = np.random.default_rng(3)
    a = rng.standard_normal((12, 12)) + (
        1j * rng.standard_normal((12, 12)) if complex_ else 0
    )
    q = np.linalg.qr(a)[0]
    normal = (q * np.append(np.linspace(1, 2, 11), least)) @ q.conj().T
    normal = 0.5 * (normal + normal.conj().T)
    low = lower_factor(normal, 1e-15)
    assert np.allclose(low, np.tril(low))
    assert np.abs(low @ low.conj().T - normal).max() <= max(
        20 * abs(min(least, 0)), 1e-14
    )


def test_no_data_at_all_have_a_factor() -> None:
    assert np.abs(lower_factor(np.zeros((3, 3)), 0.0)).max() < 1e-100
