"""Bare matrices behind the solver's port: modes, derivatives, and exact recovery on a published
frame.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from eigen_plate import held, plate
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.errors import InputError
from ringtrue.io.matrices import read_matrices
from ringtrue.model.ports import ModesRequest, ObservedModel
from ringtrue.solvers.matrices import MatrixModel
from ringtrue.testing import check_modal_solver
from ringtrue.updating.problem import single
from ringtrue.updating.solver import solve
from ringtrue.updating.target import Target, Weights

FRAME = (
    Path(__file__).parents[3]
    / "shared"
    / "data"
    / "updating"
    / "concrete_frame"
    / "ConcreteBuildingFrame.mat"
)
TRUE = np.array(
    [0.05, 0.05, -0.05, -0.1, 0.1, -0.15, 0.15, -0.05, -0.1, 0.2, -0.2, 0.1]
)


def _plate(n: int = 8) -> MatrixModel:
    half = (np.arange(n) < n // 2).astype(float)
    k, m = plate(n, n, ly=1.13)
    dk, dm = plate(n, n, ly=1.13, weight=half)
    pick = held(k, n, n)
    k, m, dk, dm = (sparse.csr_array(a[pick][:, pick]) for a in (k, m, dk, dm))
    return MatrixModel(k, m, 1e-5 * k, stiffness=[dk], mass=[dm], damping=[1e-5 * dk])


def test_contract() -> None:
    model = _plate()
    assert model.parameters().names == ("K1", "M1", "D1")
    solver = SimpleNamespace(name="matrices", open=MatrixModel.open)
    check_modal_solver(solver, model, count=6, parameters=model.parameters())  # type: ignore[arg-type]


def test_equation_one() -> None:
    """K(α) = K + Σ α K_i: the modes at α are those of the sum, and the derivatives those of
    differences.
    """
    model = _plate()
    p = model.parameters().take([0, 1])
    observed: ObservedModel = model.observed(
        model.observe(np.arange(0, model.size, 7)), request=ModesRequest(5)
    )
    x = np.array([0.3, -0.2, 0.0])
    at = observed.linearise(x)
    k, m = model.K + 0.3 * model.stiffness[0], model.M - 0.2 * model.mass[0]
    assert np.allclose(
        MatrixModel(k, m).open().modes(ModesRequest(5)).modes.frequencies,
        at.frequencies,
        rtol=1e-10,
    )
    h = 1e-5
    for i in range(len(p)):
        e = h * np.eye(3)[i]
        up, down = observed.modes(x + e), observed.modes(x - e)
        lam = [(2 * np.pi * q.frequencies) ** 2 for q in (up, down)]
        assert np.allclose((lam[0] - lam[1]) / (2 * h), at.d_lambda[:, i], rtol=1e-6)
        sign = [np.sign(np.einsum("cm,cm->m", q.shapes, at.shapes)) for q in (up, down)]
        moved = (up.shapes * sign[0] - down.shapes * sign[1]) / (2 * h)
        assert (
            np.abs(moved - at.d_shapes[:, :, i]).max()
            < 1e-5 * np.abs(at.d_shapes).max()
        )
    assert not at.d_lambda[:, 2].any()  # damping does not change natural modes


def test_damping_is_used() -> None:
    """Stiffness-proportional damping D = βK: ζ = βω/2."""
    with _plate().open() as analysis:
        f = analysis.modes(ModesRequest(4)).modes.frequencies
        zeta = analysis.complex_modes(ModesRequest(4)).modes.damping
    assert np.allclose(zeta, 1e-5 * 2 * np.pi * f / 2, rtol=1e-6)


def test_what_is_no_model_is_refused() -> None:
    eye = sparse.eye_array(3, format="csr")
    with pytest.raises(InputError, match="not symmetric"):
        MatrixModel(np.triu(np.ones((3, 3))), eye)
    with pytest.raises(InputError, match=r"stiffness 2 is \(2, 2\)"):
        MatrixModel(eye, eye, stiffness=[eye, np.eye(2)])
    with pytest.raises(InputError, match="complex"):
        MatrixModel(eye * 1j, eye)
    other = ParameterSet((Parameter("x", (CardField("STIFFNESS", 2, "FACTOR"),)),))
    with pytest.raises(InputError, match="there are 0"):
        MatrixModel(eye, eye).slopes(other)


@pytest.mark.data
@pytest.mark.skipif(
    not FRAME.is_file(), reason=f"needs {FRAME.name} of the shared data"
)
def test_published_frame_is_recovered() -> None:
    """Twelve stiffness parameters of a 2302-DOF frame from six noise-free modes at 43 sensors, from
    nominal.
    """
    data = read_matrices(FRAME)
    model = MatrixModel(
        data["K0"], data["M0"], stiffness=[data[f"E_{i}"] for i in range(1, 13)]
    )
    rows = data.arrays["measDOFs"].ravel().astype(np.int64) - 1
    # hardly a prior: it would hold the parameters back
    parameters = model.parameters(std=1e3)
    observed = model.observed(
        model.observe(rows), parameters=parameters, request=ModesRequest(8)
    )
    truth = observed.modes(TRUE)
    n = 6
    aim = Target(
        truth.frequencies[:n],
        truth.shapes[:, :n],
        np.zeros(n),
        np.ones(n, dtype=bool),
        Weights(1e-4, 1e-4, 1.0),
    )
    found = solve(single(observed, aim), iterations=40)
    assert found.outcome.name == "CONVERGED"
    assert np.abs(found.x - TRUE).max() < 1e-6
