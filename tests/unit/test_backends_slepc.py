"""The MPI solver: found or named as missing, and the same answers as the embedded one."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
from eigen_shell import shell

from ringtrue.errors import ConfigError, SolverMissing
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.registry import solver
from ringtrue.solvers.slepc import PYTHON, SlepcSolver, find_slepc
from ringtrue.study.config_sections import ModelSection
from ringtrue.testing import check_modal_solver

DEBIAN = "/usr/bin/python3"


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """SLEPc of RINGTRUE_SLEPC_PYTHON, else that of Debian, without variables that name its
    folders.
    """
    monkeypatch.setenv(PYTHON, os.environ.get(PYTHON, DEBIAN))
    monkeypatch.delenv("PETSC_DIR", raising=False)
    monkeypatch.delenv("SLEPC_DIR", raising=False)
    for asked in ("ALLOW_RUN_AS_ROOT", "ALLOW_RUN_AS_ROOT_CONFIRM"):  # of Open MPI, in containers
        monkeypatch.setenv(f"OMPI_{asked}", "1")
    monkeypatch.setenv("OMPI_MCA_rmaps_base_oversubscribe", "1")
    try:
        find_slepc()
    except SolverMissing as e:
        pytest.skip(str(e))


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("given", [{"ranks": 2}, {"launcher": "mpiexec -n 2"}])
def test_two_ranks(given: dict[str, Any]) -> None:
    model = shell(6, 4)
    result = check_modal_solver(SlepcSolver(**given), model, count=10)
    assert result.complete
    assert "by inertia" in result.proof
    assert "2 ranks" in result.proof
    with EmbeddedSolver().open(model) as analysis:
        ours = analysis.modes(ModesRequest(10)).modes
    np.testing.assert_allclose(result.modes.frequencies, ours.frequencies, rtol=1e-7, atol=2e-3)
    assert result.residuals.max() < 1e-7


def test_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RINGTRUE_SLEPC_PYTHON", str(tmp_path / "python"))
    (tmp_path / "mpiexec").write_text("")
    with pytest.raises(SolverMissing, match="dolfinx-solver-real"):
        SlepcSolver().open(shell(3, 2))


def test_a_launcher_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(SolverMissing, match="no srun on the PATH"):
        SlepcSolver(launcher="srun -n 64").open(shell(3, 2))


def test_ranks_are_for_slepc() -> None:
    assert isinstance(solver("slepc", ranks=3), SlepcSolver)
    with pytest.raises(ConfigError, match="runs in one process"):
        solver("embedded", ranks=2)
    with pytest.raises(ConfigError, match="runs in one process"):
        solver("mystran", launcher="srun")
    with pytest.raises(ConfigError, match="0 ranks"):
        SlepcSolver(ranks=0)
    with pytest.raises(ConfigError, match="leave one of the two out"):
        SlepcSolver(ranks=2, launcher="srun")


def test_a_study_names_ranks_or_a_launcher() -> None:
    asked = ModelSection(deck="a.bdf", solver="slepc", launcher="srun -n 64").engine()
    assert isinstance(asked, SlepcSolver)
    assert asked.launcher == "srun -n 64"
    four = ModelSection(deck="a.bdf", solver="slepc", ranks=4)
    made = four.engine()
    assert isinstance(made, SlepcSolver)
    assert made.ranks == 4
    assert four.engine("embedded") is None
    with pytest.raises(ConfigError, match="runs in one process"):
        ModelSection(deck="a.bdf", ranks=4).engine()
