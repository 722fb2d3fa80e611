"""Damping of a chain with known loss factors and dashpots, from its poles.

|-k1,η1-m1-k2,η1-m2- ... -k5,η2-m5- ... -kn-mn      a dashpot c to the ground at the fourth mass
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from ringtrue.eigen.damped import complex_modes
from ringtrue.errors import InputError
from ringtrue.updating.damping import Mechanism, assembled, fit_poles

N = 8
TRUTH = np.array([0.02, 0.05, 3.0])  # two loss factors, N s/m

NONE = (np.zeros((N, N)), np.zeros((N, N)))


def loss_factor(name: str, matrix: np.ndarray) -> Mechanism:
    return Mechanism(name, "structural", (matrix + matrix.T) / 2, upper=1.0)


def dashpot(name: str, matrix: np.ndarray) -> Mechanism:
    return Mechanism(name, "viscous", (matrix + matrix.T) / 2)


def system() -> tuple[np.ndarray, np.ndarray, tuple[Mechanism, ...]]:
    """λ, mass-normalised shapes and the three mechanisms."""
    halves = np.zeros((2, N, N))
    for i in range(N):
        v = np.zeros(N)
        v[[i - 1, i] if i else [0]] = [-1, 1] if i else [1]
        halves[i * 2 // N] += 4e4 * np.outer(v, v)
    lam, phi = linalg.eigh(halves.sum(axis=0), np.diag(1 + 0.1 * np.arange(N)))
    ground = np.zeros((N, N))
    ground[3, 3] = 1.0
    parts = [
        loss_factor(f"half {i + 1}", phi.T @ k @ phi) for i, k in enumerate(halves)
    ]
    return lam, phi, (*parts, dashpot("dashpot", phi.T @ ground @ phi))


def test_poles_give_loss_factors_and_dashpots() -> None:
    lam, _, parts = system()
    true = complex_modes(lam, *assembled(parts, TRUTH, NONE))
    found = fit_poles(lam, parts, true.damping, np.full(N, 1e-5), np.arange(N))
    np.testing.assert_allclose(found.coefficients, TRUTH, rtol=1e-6)
    assert (
        np.abs(found.start / TRUTH - 1).max() > 1e-5
    )  # first order only: the refinement has worked
    np.testing.assert_allclose(found.modes(lam).poles, true.poles, rtol=1e-7)
    assert not found.at_bound.any()


def test_standard_deviation_from_poles_covers_the_scatter() -> None:
    lam, _, parts = system()
    rng, true = (
        np.random.default_rng(0),
        complex_modes(lam, *assembled(parts, TRUTH, NONE)).damping,
    )
    std = 0.03 * true
    fits = [
        fit_poles(lam, parts, true + std * rng.standard_normal(N), std, np.arange(N))
        for _ in range(100)
    ]
    scatter = np.std([f.coefficients for f in fits], axis=0)
    told = np.mean([f.std for f in fits], axis=0)
    assert (told > 0.85 * scatter).all()  # 7 % is the scatter of the scatter
    # s² is not believed below 1: wider by 15 % on average
    assert (told < 1.5 * scatter).all()


def test_a_mechanism_that_is_not_there_ends_at_its_bound() -> None:
    lam, phi, parts = system()
    absent = np.zeros((N, N))
    absent[6, 6] = 1.0
    true = complex_modes(lam, *assembled(parts, TRUTH, NONE)).damping
    less = true - 1e-4 * phi[6] ** 2  # as if it took energy out of the others
    every = (*parts, dashpot("absent", phi.T @ absent @ phi))
    found = fit_poles(lam, every, less, np.full(N, 1e-4), np.arange(N))
    assert found.at_bound.tolist() == [False, False, False, True]
    assert found.coefficients[3] == pytest.approx(0.0, abs=1e-3)


def test_input_is_checked() -> None:
    lam, _, parts = system()
    with pytest.raises(InputError, match="no mechanism"):
        fit_poles(lam, (), np.ones(1), np.ones(1), np.zeros(1, dtype=int))
    blind = Mechanism("blind", "viscous", np.zeros((N, N)))
    with pytest.raises(InputError, match="no datum depends on 'blind'"):
        fit_poles(
            lam, (*parts, blind), np.full(N, 0.01), np.full(N, 1e-3), np.arange(N)
        )
