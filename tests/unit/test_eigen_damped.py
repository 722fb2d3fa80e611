"""Complex modes against closed forms and the direct solution of the quadratic problem."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.eigen.damped import complex_modes, project
from ringtrue.errors import InputError


def test_one_oscillator():
    w, zeta = 12.0, 0.03
    got = complex_modes(np.array([w**2]), np.array([[2 * zeta * w]]))
    s = w * complex(-zeta, np.sqrt(1 - zeta**2))
    assert np.isclose(got.poles[0], s)
    assert np.isclose(got.damping[0], zeta)
    assert np.isclose(got.frequencies[0], w / (2 * np.pi))
    assert np.isclose(got.shapes[0, 0] ** 2 * (2 * s + 2 * zeta * w), 1)


@pytest.mark.parametrize("structural", [False, True])
def test_quadratic_eigenproblem(structural):
    rng = np.random.default_rng(2)
    n = 7
    lam = np.sort(rng.uniform(1e3, 1e5, n))
    root = rng.standard_normal((n, n))
    d, h = 0.5 * root @ root.T, 20 * root.T @ root * structural
    got = complex_modes(lam, d, h)
    assert len(got.poles) == n
    assert (got.poles.imag > 0).all()
    assert (np.diff(np.abs(got.poles)) > 0).all()
    stiff = np.diag(lam) + 1j * h
    rest = got.shapes * got.poles**2 + d @ got.shapes * got.poles + stiff @ got.shapes
    assert np.abs(rest).max() < 1e-9 * np.abs(stiff @ got.shapes).max()
    scale = np.einsum(
        "nm,nm->m", got.shapes, (2 * got.shapes * got.poles + d @ got.shapes)
    )
    assert np.allclose(scale, 1)


def test_residues_sum_to_the_receptance():
    """Σ ψψᵀ/(s − s_k) + conj = (Λ + s²I + sD)⁻¹, a repeated pole included."""
    lam = np.array([100.0, 400.0, 400.0])
    d = np.diag([0.2, 0.4, 0.4])
    d[0, 1] = d[1, 0] = 0.05
    got = complex_modes(lam, d)
    s = 17j
    direct = np.linalg.inv(np.diag(lam) + s**2 * np.eye(3) + s * d)
    psi = got.shapes
    modal = (psi / (s - got.poles)) @ psi.T + (
        psi.conj() / (s - got.poles.conj())
    ) @ psi.conj().T
    assert np.allclose(modal, direct)


def test_overdamped_modes_have_no_pole_above_the_axis():
    got = complex_modes(np.array([1.0, 100.0]), np.diag([10.0, 0.1]))
    assert len(got.poles) == 1


def test_projection_and_sizes():
    phi = np.random.default_rng(0).standard_normal((5, 2))
    d, h = project(phi, None, None)
    assert not d.any()
    assert not h.any()
    with pytest.raises(InputError, match="sizes differ"):
        complex_modes(np.ones(3), d)
