"""Frequency response of one and two oscillators in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.errors import InputError
from ringtrue.fem.response import frf

F = np.array([0.5, 1.0, 3.0])
ONE = np.ones((1, 1))


def test_one_oscillator() -> None:
    """m = 4, f = 1 Hz, ζ = 2 %: H = 1/(m(ω0² - ω² + 2iζω0ω)), at resonance 1/(2iζk)."""
    w, w0 = 2 * np.pi * F, 2 * np.pi
    exact = 1 / (4 * (w0**2 - w**2 + 2j * 0.02 * w0 * w))
    for n, kind in enumerate(("receptance", "mobility", "accelerance")):
        H = frf(F, np.array([1.0]), np.array([0.02]), ONE / 2, ONE / 2, kind)
        np.testing.assert_allclose(H[:, 0, 0], exact * (1j * w) ** n, rtol=1e-13)


def test_rigid_body_is_a_mass_down_to_zero() -> None:
    H = frf(
        np.array([0.0, 5.0]), np.zeros(1), np.zeros(1), ONE / 2, ONE / 2, "accelerance"
    )
    np.testing.assert_allclose(H[:, 0, 0], 0.25)
    with pytest.raises(InputError, match="0 Hz"):
        frf(np.array([0.0]), np.zeros(1), np.zeros(1), ONE, ONE, "receptance")


def test_residual_flexibility() -> None:
    """A mode far above the band is as good as its static flexibility."""
    f, z = np.array([1.0, 1e5]), np.array([0.01, 0.01])
    phi = np.array([[1.0, 300.0]])
    both = frf(F, f, z, phi, phi, "accelerance")
    flexibility = phi[:, 1:] @ phi[:, 1:].T / (2 * np.pi * 1e5) ** 2
    one = frf(
        F, f[:1], z[:1], phi[:, :1], phi[:, :1], "accelerance", residual=flexibility
    )
    np.testing.assert_allclose(one, both, rtol=1e-5)


def test_unknown_kind() -> None:
    with pytest.raises(InputError, match="did you mean 'mobility'"):
        frf(F, F, F, ONE, ONE, "mobilty")
