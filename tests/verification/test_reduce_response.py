"""A basis for the response to loads: a free plate under forces at one corner and one edge, against
the direct solution.

Clamped along one edge, 20 x 12 Hermite elements; lines from below the first to above the 20th mode.
"""

from __future__ import annotations

import numpy as np
import pytest
from eigen_plate import held, plate
from scipy import linalg, sparse

from ringtrue.eigen.damped import DynamicStiffness
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError
from ringtrue.reduction.response import ResponseBasis, ResponseSearch, response_basis

LOSS, TOLERANCE = 0.02, 1e-3
NX, NY = 20, 12


@pytest.fixture(scope="module")
def system() -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray, np.ndarray]:
    """K, M, all λ, and loads (f, 2) on the deflection at the free edge."""
    k, m = plate(NX, NY)
    at = held(k, NX, NY)
    k, m = sparse.csr_array(k[at][:, at]), sparse.csr_array(m[at][:, at])
    loads = np.zeros((k.shape[0], 2))
    loads[-2 * (2 * NY + 2), 0] = 1.0
    loads[-2 * (2 * NY + 2) + 2 * (NY // 2), 1] = 1.0
    return k, m, linalg.eigvalsh(k.toarray(), m.toarray()), loads


def basis(
    k: sparse.csr_array,
    m: sparse.csr_array,
    loads: np.ndarray,
    lines: np.ndarray,
    start: np.ndarray,
    loss: float = LOSS,
    **search: float,
) -> ResponseBasis:
    return response_basis(
        Pencil(k, m), loads, lines, start, ResponseSearch(loss, **search)
    )  # type: ignore[arg-type]


def response(
    k: sparse.csr_array, m: sparse.csr_array, v: np.ndarray, loads: np.ndarray, f: float
) -> np.ndarray:
    z = v.T @ (k @ v) * (1 + 1j * LOSS) - (2 * np.pi * f) ** 2 * (v.T @ (m @ v))
    return np.asarray(v @ np.linalg.solve(z, v.T @ loads))


def test_response_is_that_of_the_full_model(system: tuple[np.ndarray, ...]) -> None:
    k, m, lam, loads = system
    hertz = np.sqrt(lam) / (2 * np.pi)
    lines = np.linspace(0.5 * hertz[0], hertz[20], 60)
    found = basis(k, m, loads, lines, loads, tolerance=TOLERANCE, steps=6)
    assert found.residual.shape == (60,)
    assert found.residual.max() <= TOLERANCE
    np.testing.assert_allclose(
        found.vectors.T @ (m @ found.vectors), np.eye(found.vectors.shape[1]), atol=1e-8
    )
    full = DynamicStiffness(k, m, structural=sparse.csr_array(LOSS * k))
    between = (lines[:-1] + lines[1:])[::7] / 2  # not at the lines that were watched
    for f in [*between.tolist(), float(hertz[3]), float(hertz[10])]:
        true = full.solve(2j * np.pi * f, loads.astype(complex))
        got = response(k, m, found.vectors, loads, f)
        assert np.linalg.norm(got - true) < 5 * TOLERANCE * np.linalg.norm(true)


def test_modes_that_the_loads_do_not_excite_cost_nothing(
    system: tuple[np.ndarray, ...],
) -> None:
    """A force on the line of symmetry: half of the modes have a node there."""
    k, m, lam, loads = system
    hertz = np.sqrt(lam) / (2 * np.pi)
    lines = np.linspace(0.5 * hertz[0], hertz[20], 60)
    both, one = (basis(k, m, f, lines, f, steps=4) for f in (loads, loads[:, 1:]))
    assert one.vectors.shape[1] < 0.7 * both.vectors.shape[1]


def test_modes_known_beforehand_are_used(system: tuple[np.ndarray, ...]) -> None:
    k, m, lam, loads = system
    hertz = np.sqrt(lam) / (2 * np.pi)
    _, phi = linalg.eigh(k.toarray(), m.toarray(), subset_by_index=(0, 29))
    known = basis(
        k, m, loads, np.linspace(0.5 * hertz[0], hertz[10], 40), phi, tolerance=0.05
    )
    assert known.lines == ()
    assert 30 < known.vectors.shape[1] <= 32  # and the static answers


def test_a_limit_on_the_vectors_is_told_by_the_residual(
    system: tuple[np.ndarray, ...],
) -> None:
    k, m, lam, loads = system
    lines = np.linspace(1.0, np.sqrt(lam[60]) / (2 * np.pi), 60)
    found = basis(k, m, loads, lines, loads, steps=4, most=10)
    assert len(found.lines) == 1
    assert found.residual.max() > 0.02


def test_input_is_checked(system: tuple[np.ndarray, ...]) -> None:
    k, m, _, loads = system
    for freqs, f, loss in (
        ([0.0, 1.0], loads, LOSS),
        ([], loads, LOSS),
        ([1.0], 0 * loads, LOSS),
        ([1.0], loads, 0.0),
    ):
        with pytest.raises(InputError, match="response basis"):
            basis(k, m, f, np.array(freqs), loads, loss=loss)
