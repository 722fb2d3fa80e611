"""Every solver meets the public contract; the embedded one answers the rest of the port, too."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from eigen_shell import parameters, shell

from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import Norm
from ringtrue.errors import ConfigError, SingularModel, SolverMissing
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.registry import names, solver
from ringtrue.testing import check_modal_solver


@pytest.mark.parametrize("clamped", [False, True])
def test_embedded_meets_the_contract(clamped):
    result = check_modal_solver(
        EmbeddedSolver(),
        shell(6, 4, clamped=clamped),
        count=10,
        parameters=parameters(),
    )
    assert result.complete
    rigid = np.abs(result.modes.frequencies) < 1e-2
    assert rigid.sum() == (0 if clamped else 6)


@pytest.mark.solver
@pytest.mark.parametrize("clamped", [False, True])
@pytest.mark.parametrize("name", [n for n in names() if n != "embedded"])
def test_other_solvers_meet_the_contract(name, clamped):
    """Run for real where they are installed; Nastran itself is met by a stand-in in its unit
    test.
    """
    model = shell(6, 4, clamped=clamped)
    try:
        solver(name).open(model).__exit__(None, None, None)
    except SolverMissing as e:
        pytest.skip(str(e))
    result = check_modal_solver(solver(name), model, count=10, parameters=parameters())
    rigid = np.abs(result.modes.frequencies) < 1e-2
    assert rigid.sum() == (0 if clamped else 6)
    assert (
        result.complete
        or "not proved" in result.proof
        or "no Sturm count" in result.proof
    )


def test_registry():
    assert "embedded" in names()
    assert solver("embedded").name == "embedded"
    with pytest.raises(ConfigError, match="did you mean 'embedded'"):
        solver("embeded")


def test_static_and_frf_agree_at_zero_frequency():
    with EmbeddedSolver().open(shell(6, 4, clamped=True)) as analysis:
        tip = DofSet.parse(["35-Z", "34+Z", "30+X"])
        load = np.zeros(len(analysis.dofs))
        load[analysis.dofs.find(tip.node[:1], tip.direction[:1])] = 1.0
        at, sign = analysis.dofs.align(tip)
        u = analysis.static(load)[at, 0] * sign
        h = analysis.frf(
            tip,
            DofSet.parse(["35+Z"]),
            np.array([0.0, 1.0]),
            ModesRequest(20),
            damping=0.01,
        )
    assert h.shape == (2, 3, 1)
    assert u[0] < 0 < u[1]
    assert np.allclose(
        h[0, :, 0].real, u, rtol=1e-3, atol=1e-3 * abs(u[0])
    )  # the residual is that at the shift


def test_static_of_a_free_model_is_refused():
    with EmbeddedSolver().open(shell(6, 4)) as analysis, pytest.raises(SingularModel):
        analysis.static(np.ones(len(analysis.dofs)))


def test_complex_modes_of_proportional_damping():
    """PARAM,G alone: every mode has the loss factor g, s² = −λ(1 + ig)."""
    model = shell(6, 4, clamped=True)
    g = 0.04
    damped = type(model)(model.tables, {"G": g}, model.case)
    with EmbeddedSolver().open(damped) as analysis:
        modes = analysis.complex_modes(ModesRequest(6)).modes
        real = analysis.modes(ModesRequest(6)).modes
        request = ModesRequest(band=(0.0, float(real.frequencies[3]) * 1.01))
        band = analysis.complex_modes(request).modes
    s = 1j * 2 * np.pi * real.frequencies * np.sqrt(1 + 1j * g)
    assert modes.norm is Norm.MODAL_A
    assert np.allclose(modes.frequencies, np.abs(s) / (2 * np.pi))
    assert np.allclose(modes.damping, -s.real / np.abs(s))
    assert len(band) == 4
