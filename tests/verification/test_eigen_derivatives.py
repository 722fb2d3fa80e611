"""Derivatives of modes: Taylor remainders of slope 2, dense solutions, repeated roots."""

from __future__ import annotations

import numpy as np
import pytest
from eigen_plate import held, plate
from eigen_shell import shell
from fem_cases import cards, ragged
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, ParameterSet, Shape
from ringtrue.eigen.derivatives import (
    MatrixDerivatives,
    eigenvector_derivatives,
    modal_coefficients,
)
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError, NotConverged
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

N, M = 14, 8


def _case(
    clamped: bool,
) -> tuple[sparse.csr_array, sparse.csr_array, list[MatrixDerivatives]]:
    """A plate whose first half changes stiffness or mass."""
    half = (np.arange(N) < N // 2).astype(float)
    k, m = plate(N, N, ly=1.13)
    dk, dm = plate(N, N, ly=1.13, weight=half)
    pick = held(k, N, N) if clamped else np.arange(k.shape[0])
    k, m, dk, dm = (sparse.csr_array(a[pick][:, pick]) for a in (k, m, dk, dm))
    return k, m, [MatrixDerivatives(dk, 0 * dm), MatrixDerivatives(0 * dk, dm)]


def _remainders(k, m, slope, base, d_lambda, d_phi, h):
    got = solve_modes(Pencil(k + h * slope.stiffness, m + h * slope.mass), M + 6)
    phi = got.vectors[:, :M] * np.sign(
        np.einsum("fm,fm->m", base.vectors[:, :M], m @ got.vectors[:, :M])
    )
    r_lambda = (
        np.abs(got.values[:M] - base.values[:M] - h * d_lambda) / base.values[:M].max()
    )
    return r_lambda.max(), np.linalg.norm(
        phi - base.vectors[:, :M] - h * d_phi, axis=0
    ).max()


@pytest.mark.parametrize("which", [0, 1])
def test_taylor_remainder(which):
    k, m, slopes = _case(clamped=True)
    pencil = Pencil(k, m)
    base = solve_modes(pencil, M + 6)
    phi, slope = base.vectors[:, :M], slopes[which]
    load = slope.stiffness @ phi - (slope.mass @ phi) * base.values[:M]
    d_lambda = np.einsum("fm,fm->m", phi, load)
    d_phi = eigenvector_derivatives(pencil, base, slopes, count=M)[:, :, which]
    steps = (1e-2, 1e-3)
    r = np.array(
        [_remainders(k, m, slopes[which], base, d_lambda, d_phi, h) for h in steps]
    )
    order = np.log(r[0] / r[1]) / np.log(steps[0] / steps[1])
    # cubic terms bend it by about the larger step
    assert np.allclose(order, 2, atol=0.1)


def test_against_full_modal_expansion():
    k, m, slopes = _case(clamped=False)
    pencil = Pencil(k, m)
    some = solve_modes(pencil, M + 6)
    got = eigenvector_derivatives(pencil, some, slopes, count=M)
    for i, s in enumerate(slopes):  # the equation itself and the normalisation
        phi, lam = some.vectors[:, 3:M], some.values[3:M]
        load = s.stiffness @ phi - (s.mass @ phi) * lam
        d_lambda = np.einsum("fm,fm->m", phi, load)
        d = got[:, 3:M, i]
        rest = k @ d - (m @ d) * lam + load - (m @ phi) * d_lambda
        assert np.abs(rest).max() < 1e-6 * np.abs(load).max()
        norm = 2 * np.einsum("fm,fm->m", phi, m @ d) + np.einsum(
            "fm,fm->m", phi, s.mass @ phi
        )
        assert np.abs(norm).max() < 1e-9


def test_the_solution_meets_its_tolerance() -> None:
    """Relative residual of the eigenvector equation, 2-norm, at the tolerance asked for."""
    k, m, slopes = _case(clamped=True)
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
                np.linalg.norm(rest, axis=0)
                <= 3 * tolerance * np.linalg.norm(load, axis=0)
            ).all()


def test_subspace_of_a_repeated_root_moves_as_told():
    """φ' of a double root, rotation-free: the projector's derivative is φ'φᵀ + φφ'ᵀ, whatever the
    basis.

    The change keeps the square's symmetry, so the root stays double and the subspace is smooth.
    """
    k, m = plate(N, N)
    ring = np.minimum(np.arange(N), np.arange(N)[::-1]) < 3
    weight = ring.astype(float)
    dk = plate(N, N, weight=weight)[0]
    turn = (
        np.arange(k.shape[0]).reshape(N + 1, 2, N + 1, 2).transpose(2, 3, 0, 1).ravel()
    )
    dk = sparse.csr_array(dk + dk[turn][:, turn])
    pencil = Pencil(k, m)
    base = solve_modes(pencil, 14)
    d = eigenvector_derivatives(pencil, base, [MatrixDerivatives(dk, 0 * m)], count=6)[
        :, 4:6, 0
    ]
    phi, h = base.vectors[:, 4:6], 1e-4
    ends = [solve_modes(Pencil(k + s * h * dk, m), 8).vectors[:, 4:6] for s in (1, -1)]
    probe = m @ np.random.default_rng(3).standard_normal((k.shape[0], 3))
    moved = (ends[0] @ (ends[0].T @ probe) - ends[1] @ (ends[1].T @ probe)) / (2 * h)
    told = d @ (phi.T @ probe) + phi @ (d.T @ probe)
    assert (
        np.abs(moved - told).max() < 1e-4 * np.abs(told).max()
    )  # h² of a central difference, twisted by h


def test_requests_that_cannot_be_met():
    k, m, slopes = _case(clamped=True)
    pencil = Pencil(k, m)
    base = solve_modes(pencil, 4)
    with pytest.raises(InputError, match="4 are given"):
        eigenvector_derivatives(pencil, base, slopes, count=5)


def test_missing_lower_mode_is_refused():
    """The complement is not definite when a lower mode is not given."""
    k, m, slopes = _case(clamped=True)
    pencil = Pencil(k, m)
    band = solve_modes(pencil, band=(100.0, 400.0))
    with pytest.raises(NotConverged, match="compute more modes"):
        eigenvector_derivatives(pencil, band, slopes)


def _hub() -> Model:
    """The shell with a mass on a rigid arm, its displacements in a cylindrical frame."""
    m = shell(8, 5, clamped=True)
    place = {"ID": 99, "X1": 1.1, "X2": 0.4, "X3": 0.5}
    where = {name: np.append(m["GRID"][name], value) for name, value in place.items()}
    tables = {
        "GRID": cards("GRID", **where, CD=np.where(where["ID"] == 99, 7, 0)),
        "CORD2C": cards("CORD2C", CID=[7], B3=1.0, C1=1.0),
        "CONM2": cards("CONM2", EID=[901], G=99, M=20.0),
        "RBE2": cards("RBE2", EID=[900], GN=27, CM="123456", GM=ragged([99])),
    }
    return Model({**m.tables, **tables}, case=m.case)


@pytest.mark.parametrize(
    ("m", "nodes"), [(shell(8, 5, clamped=True), (20, 27)), (_hub(), (20, 99))]
)
def test_vectors_where_nodes_move_across_a_shell(
    m: Model, nodes: tuple[int, ...]
) -> None:
    """The forces of such a move are large and move next to nothing: the residual must be small
    beside what is left.

    A dependent node that moves has other shapes for the same motion of the free ones.
    """
    p = Parameter("p", shapes=(Shape(nodes, ((0.02, 0.01, 0.05), (0.0, 0.0, 0.04))),))
    with EmbeddedSolver().open(m) as analysis:
        found = analysis.modes(ModesRequest(4)).modes
        _, got = analysis.derivatives(found, ParameterSet((p,)))

    def shapes(a: float) -> Float:
        with EmbeddedSolver().open(scaled(m, p, a)) as there:
            x = there.modes(ModesRequest(4)).modes.shapes
        return np.asarray(x * np.sign((x * found.shapes).sum(axis=0)))

    h = 1e-2
    near = {j: shapes(1 + j * h) for j in (-2, -1, 1, 2)}
    want = (8 * (near[1] - near[-1]) - near[2] + near[-2]) / (12 * h)
    np.testing.assert_allclose(got[:, :, 0], want, atol=1e-4 * np.abs(want).max())


def test_a_light_node_far_above_does_not_join_low_modes() -> None:
    """Suspension modes at 11 to 25 Hz, elastic ones to 550 Hz, and a node nearly without mass at
    1e9 Hz.
    """
    rng = np.random.default_rng(11)
    low = np.array([5178.0, 5272.0, 10807.0, 10873.0, 15945.0, 23926.0, 5e5, 1.2e7])
    values = np.append(low, 4e19)
    k = rng.standard_normal((9, 9))
    k, m = 1e4 * (k + k.T)[:, :8], np.zeros((9, 8))
    c = modal_coefficients(k, m, values)
    apart = ~np.eye(9, 8, dtype=bool)
    gap = np.where(apart, low - values[:, None], 1.0)
    np.testing.assert_allclose(c[apart], (k / gap)[apart], rtol=1e-12)
