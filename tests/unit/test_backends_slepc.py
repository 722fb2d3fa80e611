"""The MPI solver: found or named as missing, and the same answers as the embedded one."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from eigen_shell import shell

from ringtrue.errors import ConfigError, SolverMissing
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.registry import solver
from ringtrue.solvers.slepc import SlepcSolver, find_slepc
from ringtrue.testing import check_modal_solver


@pytest.fixture
def installed() -> None:
    try:
        find_slepc()
    except SolverMissing as e:
        pytest.skip(str(e))


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_two_ranks() -> None:
    model = shell(6, 4)
    result = check_modal_solver(SlepcSolver(ranks=2), model, count=10)
    assert result.complete
    assert "by inertia" in result.proof
    with EmbeddedSolver().open(model) as analysis:
        ours = analysis.modes(ModesRequest(10)).modes
    np.testing.assert_allclose(result.modes.frequencies, ours.frequencies, rtol=1e-7, atol=2e-3)
    assert result.residuals.max() < 1e-7


def test_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RINGTRUE_SLEPC_PYTHON", str(tmp_path / "python"))
    (tmp_path / "mpiexec").write_text("")
    with pytest.raises(SolverMissing, match="dolfinx-solver-real"):
        SlepcSolver().open(shell(3, 2))


def test_ranks_are_for_slepc() -> None:
    assert isinstance(solver("slepc", ranks=3), SlepcSolver)
    with pytest.raises(ConfigError, match="runs in one process"):
        solver("embedded", ranks=2)
    with pytest.raises(ConfigError, match="0 ranks"):
        SlepcSolver(ranks=0)
