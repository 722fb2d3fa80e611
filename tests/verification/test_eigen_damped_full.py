"""The full quadratic problem, residual vectors and direct responses, against closed forms and each
other.

A clamped shell with dashpots at its free corner, and chains of oscillators small enough for a dense
solution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from eigen_shell import shell
from scipy import linalg, sparse

from ringtrue.core.dofs import DofSet
from ringtrue.eigen import damped as damped_problem
from ringtrue.eigen.damped import DynamicStiffness, full_modes, project
from ringtrue.eigen.eigenpairs import residual_vectors
from ringtrue.eigen.engines import installed
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError, SingularModel
from ringtrue.fem.assembly import assemble
from ringtrue.fem.response import CoupledModes, coupled, direct
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedAnalysis

ENGINES = installed()


def chain(n: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Masses 1 between springs 100, both ends held."""
    side = -100 * np.ones(n - 1)
    k = sparse.diags_array(
        [200 * np.ones(n), side, side], offsets=[0, 1, -1], format="csr"
    )
    return sparse.csr_array(k), sparse.csr_array(sparse.eye_array(n, format="csr"))


def at(n: int, *entries: tuple[int, float]) -> sparse.csr_array:
    """A diagonal matrix with a few entries."""
    d = np.zeros(n)
    for i, value in entries:
        d[i] = value
    return sparse.csr_array(sparse.diags_array(d, format="csr"))


@pytest.fixture(scope="module")
def held() -> EmbeddedAnalysis:
    """Dashpots of a tenth of critical at a corner, loss factor 1 %."""
    model = shell(8, 6, clamped=True)
    system = assemble(model)
    row = np.flatnonzero(
        (system.free.node == 63) & (np.abs(system.free.direction) <= 3)
    )
    d = np.zeros(system.stiffness.shape[0])
    d[row] = 400.0
    viscous = sparse.csr_array(sparse.diags_array(d, format="csr"))
    viscous.eliminate_zeros()
    damped = replace(
        system, viscous=viscous, structural=sparse.csr_array(0.01 * system.stiffness)
    )
    return EmbeddedAnalysis(model, damped)


@pytest.mark.parametrize("method", ENGINES)
def test_full_problem_is_that_of_the_dense_companion(method, monkeypatch):
    monkeypatch.setattr(damped_problem, "choose", lambda *_: method)
    n = 40
    k, m = chain(n)
    d, h = at(n, (3, 6.0), (20, 2.0)), at(n, (9, 15.0))
    full = full_modes(DynamicStiffness(k, m, d, h), 12.0)
    zero, eye = np.zeros((n, n)), np.eye(n)
    s = linalg.eigvals(np.block([[zero, eye], [-(k + 1j * h).toarray(), -d.toarray()]]))
    want = s[(s.imag > 0.01 * np.abs(s)) & (np.abs(s) <= 12.0)]
    want = want[np.argsort(np.abs(want))]
    assert want.size > 8
    assert np.allclose(full.modes.poles, want, rtol=1e-9)
    assert full.residuals.max() < 1e-9
    phi = full.modes.shapes
    assert np.allclose(
        np.einsum("fm,fm->m", phi, 2 * full.modes.poles * (m @ phi) + d @ phi), 1
    )


def test_proportional_damping_in_closed_form():
    """D = αM + βK: s² + (α + βλ)s + λ = 0, λ_k = 400 sin²(kπ/2(n + 1))."""
    n = 120
    k, m = chain(n)
    alpha, beta = 0.05, 0.002
    full = full_modes(
        DynamicStiffness(k, m, sparse.csr_array(alpha * m + beta * k)), 6.0
    )
    lam = 400 * np.sin(np.arange(1, n + 1) * np.pi / 2 / (n + 1)) ** 2
    lam = lam[lam <= 36.0]
    decay = (alpha + beta * lam) / 2
    assert np.allclose(
        full.modes.poles, -decay + 1j * np.sqrt(lam - decay**2), rtol=1e-9
    )


def test_bad_upper_end():
    with pytest.raises(InputError, match="must be positive"):
        full_modes(DynamicStiffness(*chain(5)), 0.0)


def test_modes_of_a_band_are_those_of_a_count(held):
    full = held.complex_modes(ModesRequest(8))
    assert full.residuals.max() < 1e-6  # of a thin shell's lowest modes: rounding of Kφ
    assert full.modes.damping.max() > 0.2
    ends = tuple(full.modes.frequencies[[2, 5]] * [0.999, 1.001])
    band = held.complex_modes(ModesRequest(band=ends))
    assert np.allclose(band.modes.frequencies, full.modes.frequencies[2:6], rtol=1e-9)


def test_complex_modes_of_a_free_structure_are_elastic():
    """Rigid-body motions do not oscillate: they are left out, and as many others are given as are
    asked for.
    """
    model = shell(6, 4)
    system = assemble(model)
    damped = replace(system, structural=sparse.csr_array(0.02 * system.stiffness))
    analysis = EmbeddedAnalysis(model, damped)
    real = analysis.modes(ModesRequest(12)).modes.frequencies[6:]
    modes = analysis.complex_modes(ModesRequest(6)).modes
    assert np.allclose(modes.frequencies, real * (1 + 0.02**2) ** 0.25, rtol=1e-6)
    assert np.allclose(modes.damping, np.sin(np.arctan(0.02) / 2), rtol=1e-4)


@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
def test_superposition_with_residual_vectors_is_the_direct_solution(held, kind):
    """From 0 Hz to the 15th of 24 modes, dashpots and loss factor included."""
    out, into = DofSet.parse(["63+Z", "40-Z", "30+X"]), DofSet.parse(["63+Z", "38+Z"])
    f = np.linspace(0, held.modes(ModesRequest(15)).modes.frequencies[-1], 9)
    exact = held.frf_direct(out, into, f, kind=kind)
    near = held.frf(out, into, f, ModesRequest(24), damping=None, kind=kind)
    modes = held.eigen(ModesRequest(24))
    shapes = held.system.transform @ modes.vectors
    ends = [
        shapes[at] * sign[:, None] for at, sign in map(held.dofs.align, (out, into))
    ]
    damping = project(modes.vectors, held.system.viscous, held.system.structural)
    bare = coupled(f, CoupledModes(modes.values, *damping), *ends, kind=kind)
    size = np.abs(exact).max(axis=0)
    assert (np.abs(near - exact) <= 2e-3 * size).all()
    assert np.abs(near - exact).max() < 0.2 * np.abs(bare - exact).max()


@pytest.mark.parametrize("method", ENGINES)
def test_direct_response_of_a_chain_in_closed_form(method, monkeypatch):
    """H at the first mass of a held chain of two, dashpot c on it: (2k − mω²)/det."""
    monkeypatch.setattr(damped_problem, "choose", lambda *_: method)
    k, m = chain(2)
    c, f = 3.0, np.array([0.0, 1.0, 2.2, 5.0])
    w = 2 * np.pi * f
    row = sparse.csr_array(np.array([[1.0, 0.0]]))
    got = direct(DynamicStiffness(k, m, at(2, (0, c))), f, row, row, kind="receptance")
    a, b = 200 - w**2 + 1j * w * c, 200 - w**2
    assert np.allclose(got[:, 0, 0], b / (a * b - 100.0**2), rtol=1e-10)


def test_direct_response_on_an_undamped_pole_is_refused():
    k, m = chain(2)  # λ = 100
    with pytest.raises(SingularModel):
        DynamicStiffness(k, m).solve(10j, np.ones((2, 1)))


def test_residual_vectors_hold_the_static_answer():
    """Free chain: modes and pseudo-modes together answer a load at the shift exactly."""
    k, m = chain(450)
    k = k - at(450, (0, 100.0), (449, 100.0))
    pencil = Pencil(k, m)
    modes = solve_modes(pencil, 6)
    load = np.zeros((450, 2))
    load[[7, 300], [0, 1]] = 1.0
    values, vectors = residual_vectors(pencil, modes, load)
    assert values.size == modes.values.size + 2
    assert np.allclose(vectors.T @ (m @ vectors), np.eye(values.size), atol=1e-9)
    exact = pencil.at(modes.shift).solve(load)
    near = vectors @ ((vectors.T @ load) / (values - modes.shift)[:, None])
    assert np.allclose(near, exact, atol=1e-9 * np.abs(exact).max())
