"""Derivatives of MAC, frequency, complex modes and FRFs on a damped chain and a plate, against
central differences.
"""

from __future__ import annotations

import numpy as np
import pytest
from eigen_plate import held, plate
from scipy import sparse

from ringtrue.eigen.damped import DynamicStiffness, complex_modes
from ringtrue.eigen.derivatives import (
    MatrixDerivatives,
    branch_derivatives,
    eigenvalue_derivatives,
    eigenvector_derivatives,
)
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.eigen.response_derivatives import (
    adjoint,
    complex_mode_derivatives,
    frequency_derivatives,
    frf_derivatives,
    mac_gradient,
    modal_frf_derivatives,
    pole_derivatives,
)

N, M = 12, 6
H = 1e-4  # of central differences; what is left is H² of the third derivative
CLOSE = 1e-6


def _plate() -> tuple[sparse.csr_array, sparse.csr_array, list[MatrixDerivatives]]:
    half = (np.arange(N) < N // 3).astype(float)
    k, m = plate(N, N, ly=1.13)
    dk, dm = plate(N, N, ly=1.13, weight=half)
    pick = held(k, N, N)
    k, m, dk, dm = (sparse.csr_array(a[pick][:, pick]) for a in (k, m, dk, dm))
    return k, m, [MatrixDerivatives(dk, 0 * dm), MatrixDerivatives(0 * dk, dm)]


def test_mac_and_frequency_by_adjoints_and_directly() -> None:
    k, m, slopes = _plate()
    pencil = Pencil(k, m)
    base = solve_modes(pencil, M + 4)
    rng = np.random.default_rng(2)
    pick = rng.choice(k.shape[0], 15, replace=False)
    reference = (
        base.vectors[pick, :M]
        + 0.02 * rng.standard_normal((15, M)) * np.abs(base.vectors[pick, :M]).max()
    )
    gradient = np.zeros((k.shape[0], M))
    gradient[pick] = mac_gradient(reference, base.vectors[pick, :M])[1]
    by_adjoint = adjoint(pencil, base, gradient).contract(slopes)
    d_phi = eigenvector_derivatives(pencil, base, slopes, count=M)
    direct = np.einsum("fm,fmp->mp", gradient, d_phi)
    d_f = frequency_derivatives(base.values, eigenvalue_derivatives(base, slopes))[:M]
    for i, s in enumerate(slopes):
        ends = [solve_modes(Pencil(k + x * s.stiffness, m + x * s.mass), M) for x in (H, -H)]
        macs = [mac_gradient(reference, e.vectors[pick])[0] for e in ends]
        want = (macs[0] - macs[1]) / (2 * H)
        size = np.abs(want).max()
        assert np.abs(by_adjoint[:, i] - want).max() < 1e-4 * size
        assert np.abs(by_adjoint[:, i] - direct[:, i]).max() < 1e-6 * size
        assert np.allclose(
            (ends[0].frequencies - ends[1].frequencies) / (2 * H), d_f[:, i], rtol=1e-5
        )


def test_the_solution_meets_its_tolerance() -> None:
    """Relative residual of the eigenvector equation, 2-norm, at the tolerance asked for."""
    k, m, slopes = _plate()
    pencil = Pencil(k, m)
    base = solve_modes(pencil, M + 1)
    phi, lam = base.vectors[:, :M], base.values[:M]
    for tolerance in (1e-4, 1e-6):
        d = eigenvector_derivatives(pencil, base, slopes, count=M, tolerance=tolerance)
        for i, s in enumerate(slopes):
            load = s.stiffness @ phi - (s.mass @ phi) * lam
            rest = (
                k @ d[:, :, i]
                - (m @ d[:, :, i]) * lam
                + load
                - (m @ phi) * np.einsum("fm,fm->m", phi, load)
            )
            assert (
                np.linalg.norm(rest, axis=0) <= 3 * tolerance * np.linalg.norm(load, axis=0)
            ).all()


def test_branches_of_a_double_root_have_derivatives() -> None:
    """A square plate, one half stiffer: the vectors that leave the double root, and their
    derivatives.
    """
    k, m = plate(N, N)
    dk, _ = plate(N, N, weight=(np.arange(N) < N // 3).astype(float))
    slope = MatrixDerivatives(dk, 0 * m)
    pencil = Pencil(k, m)
    base = solve_modes(pencil, 12)
    at, d_lambda, d_phi = branch_derivatives(pencil, base, slope, [4, 5])
    assert np.isclose(base.values[4], base.values[5], rtol=1e-8)
    h = 1e-4
    ends = [solve_modes(Pencil(k + x * dk, m), 8) for x in (h, -h)]
    up, down = ends[0].vectors[:, 4:6], ends[1].vectors[:, 5:3:-1]  # the branches cross at 0
    up, down = (v * np.sign(np.einsum("fm,fm->m", at, m @ v)) for v in (up, down))
    assert np.allclose(
        (ends[0].values[4:6] - ends[1].values[5:3:-1]) / (2 * h), d_lambda, rtol=1e-4
    )
    moved = (up - down) / (2 * h)
    assert (
        np.abs(moved - d_phi).max() < 1e-3 * np.abs(d_phi).max()
    )  # lost digits of the double root: ε/gap


def _chain() -> tuple[DynamicStiffness, list[MatrixDerivatives]]:
    """Eight masses on springs, a dashpot at one end: not proportional."""
    n = 8
    k = sparse.csr_array(
        sparse.diags_array([2.0 * np.ones(n), -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    )
    m = sparse.csr_array(sparse.diags_array(1.0 + 0.1 * np.arange(n)))
    d, h = (
        sparse.csr_array((n, n)) + sparse.coo_array(([c], ([r], [r])), shape=(n, n))
        for c, r in ((0.3, 0), (0.02, 5))
    )
    one = sparse.csr_array(sparse.coo_array(([1.0], ([2], [2])), shape=(n, n)))
    zero = sparse.csr_array((n, n))
    slopes = [
        MatrixDerivatives(one, zero, zero, zero),
        MatrixDerivatives(zero, one, zero, zero),
        MatrixDerivatives(zero, zero, one, zero),
    ]
    slopes.append(MatrixDerivatives(one, zero, zero, one))
    return DynamicStiffness(*(sparse.csr_array(a) for a in (k * 100, m, d, h * 100))), slopes


def _moved(s: DynamicStiffness, slope: MatrixDerivatives, x: float) -> DynamicStiffness:
    parts = zip((s.stiffness, s.mass, s.viscous, s.structural), _parts(slope), strict=True)
    return DynamicStiffness(*(sparse.csr_array(a + x * b) for a, b in parts))


def _parts(s: MatrixDerivatives) -> tuple[sparse.csr_array, ...]:
    assert s.viscous is not None
    assert s.structural is not None
    return s.stiffness, s.mass, s.viscous, s.structural


def _solved(s: DynamicStiffness) -> tuple[np.ndarray, np.ndarray]:
    lam, phi = np.linalg.eigh(s.stiffness.toarray() / np.sqrt(np.outer(*[s.mass.diagonal()] * 2)))
    phi = phi / np.sqrt(s.mass.diagonal())[:, None]
    found = complex_modes(lam, phi.T @ (s.viscous @ phi), phi.T @ (s.structural @ phi))
    return found.poles, phi @ found.shapes


def test_complex_modes() -> None:
    system, slopes = _chain()
    poles, shapes = _solved(system)
    d_poles, d_shapes = complex_mode_derivatives(system, poles, shapes, slopes)
    assert np.allclose(pole_derivatives(poles, shapes, slopes), d_poles)
    for i, s in enumerate(slopes):
        (s1, v1), (s2, v2) = (_solved(_moved(system, s, x)) for x in (H, -H))
        v1, v2 = (v * np.sign((v * shapes.conj()).sum(axis=0).real) for v in (v1, v2))
        assert np.allclose(
            (s1 - s2) / (2 * H), d_poles[:, i], atol=CLOSE * np.abs(d_poles[:, i]).max()
        )
        assert (
            np.abs((v1 - v2) / (2 * H) - d_shapes[:, :, i]).max() < CLOSE * np.abs(d_shapes).max()
        )


def test_frfs_directly_and_by_modes() -> None:
    system, slopes = _chain()
    pick = sparse.csr_array(np.eye(8)[[0, 3]])
    freqs = np.array([0.0, 0.6, 1.7])
    h, d_h = frf_derivatives(system, pick, pick[:1], freqs, slopes)
    assert h.shape == (3, 2, 1)
    for i, s in enumerate(slopes):
        ends = [
            frf_derivatives(_moved(system, s, x), pick, pick[:1], freqs, [])[0] for x in (H, -H)
        ]
        assert (
            np.abs((ends[0] - ends[1]) / (2 * H) - d_h[..., i]).max()
            < CLOSE * np.abs(d_h[..., i]).max()
        )
    undamped = DynamicStiffness(
        system.stiffness, system.mass, 0 * system.viscous, 0 * system.structural
    )
    pencil = Pencil(system.stiffness, system.mass)
    base = solve_modes(pencil, 8)
    some = [MatrixDerivatives(s.stiffness, s.mass) for s in slopes[:2]]
    d_phi, phi = eigenvector_derivatives(pencil, base, some), base.vectors
    rows = pick.toarray()
    d_out, out = np.einsum("of,fmp->omp", rows, d_phi), rows @ phi
    d_lambda = eigenvalue_derivatives(base, some)
    modal = modal_frf_derivatives(
        freqs, base.values, np.zeros(8), out, out[:1], d_lambda, d_out, d_out[:1]
    )
    want = frf_derivatives(undamped, pick, pick[:1], freqs, some)[1]
    assert np.abs(modal - want).max() < 1e-8 * np.abs(want).max()


def test_rigid_bodies_have_no_frequency_derivative() -> None:
    got = frequency_derivatives(np.array([1e-9, 400.0]), np.array([[1.0], [80.0]]))
    assert np.isnan(got[0, 0])
    assert got[1, 0] == pytest.approx(80.0 / (4 * np.pi * 20))
