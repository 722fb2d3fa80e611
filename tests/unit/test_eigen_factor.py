"""The factorisation port: solves and inertia against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from ringtrue.eigen.factor import Pencil, factorise
from ringtrue.errors import InputError, SingularModel


def chain(n: int) -> sparse.csr_array:
    """Fixed chain of springs: eigenvalues 2 − 2 cos(kπ/(n + 1))."""
    side = -np.ones(n - 1)
    return sparse.csr_array(sparse.diags_array([2 * np.ones(n), side, side], offsets=[0, 1, -1]))


@pytest.mark.parametrize("method", ["pardiso", "dense", "superlu"])
def test_solve_many_right_hand_sides(method):
    k = chain(200)
    x = np.random.default_rng(1).standard_normal((200, 5))
    assert np.allclose(factorise(k, method=method).solve(k @ x), x, atol=1e-9)
    assert np.allclose(factorise(k, method=method).solve(k @ x[:, 0]), x[:, 0], atol=1e-9)


@pytest.mark.parametrize("method", ["pardiso", "dense"])
def test_inertia_counts_eigenvalues_below_the_shift(method):
    n = 120
    pencil = Pencil(chain(n), sparse.csr_array(sparse.eye_array(n)), method=method)
    exact = 2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1))
    for below in (0, 1, 17, 119, 120):  # refactorises on the same pattern
        shift = exact[below - 1] + 1e-6 if below else -0.1
        assert pencil.at(float(shift)).negatives == below
    pencil.close()


def test_superlu_has_no_inertia():
    assert factorise(chain(10), method="superlu").negatives == -1


@pytest.mark.parametrize("method", ["pardiso", "dense", "superlu"])
def test_singular_matrix_is_named(method):
    k = chain(400).tolil()
    k[7, :] = 0
    k[:, 7] = 0
    with pytest.raises(SingularModel, match="row 7"):
        factorise(sparse.csr_array(k), method=method)


def test_bad_input():
    with pytest.raises(InputError, match="allowed are auto"):
        factorise(chain(3), method="qr")
    with pytest.raises(InputError, match="not finite"):
        factorise(chain(3) * np.nan)
    with pytest.raises(InputError, match="square"):
        factorise(sparse.csr_array(np.ones((2, 3))))
