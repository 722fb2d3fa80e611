"""The MPI solver: found or named as missing, and the same answers as the embedded one."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study
from scipy import sparse

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
import constrained_plate
from eigen_shell import parameters as shell_parameters
from eigen_shell import shell

import ringtrue as rt
from ringtrue.api.models import open_model
from ringtrue.core.iterate import quiet
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.correlation.sensor_mapping import at_dofs
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.eigen.shift import low_shift
from ringtrue.errors import (
    ConfigError,
    DeckError,
    SolverFailed,
    SolverMissing,
    UnsupportedError,
)
from ringtrue.fem.assembly import Sum
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.parametrisation.derivatives import quadratic_forms
from ringtrue.io.modes import write_modes
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation, ModesRequest
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.parametric import KnownModes, reduced_model
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.observed import FullModel
from ringtrue.solvers.registry import solver
from ringtrue.solvers.slepc import PYTHON, SlepcSolver, find_slepc
from ringtrue.study.config import read_config
from ringtrue.study.config_sections import ModelSection
from ringtrue.study.direct import direct_problem, read_target
from ringtrue.study.opened import Opened
from ringtrue.study.run import run_study
from ringtrue.study.session import Session
from ringtrue.study.stages import localise
from ringtrue.testing import check_modal_solver

DEBIAN = "/usr/bin/python3"
CANDIDATES = "".join(
    f'[[candidate]]\nname = "storey {i}"\ntargets = ["MAT1 {i} E"]\n'
    for i in small_study.TRUTH
)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """SLEPc of RINGTRUE_SLEPC_PYTHON, else that of Debian, without variables that name its
    folders.
    """
    monkeypatch.setenv(PYTHON, os.environ.get(PYTHON, DEBIAN))
    monkeypatch.delenv("PETSC_DIR", raising=False)
    monkeypatch.delenv("SLEPC_DIR", raising=False)
    # of Open MPI, in containers
    for asked in ("ALLOW_RUN_AS_ROOT", "ALLOW_RUN_AS_ROOT_CONFIRM"):
        monkeypatch.setenv(f"OMPI_{asked}", "1")
    monkeypatch.setenv("OMPI_MCA_rmaps_base_oversubscribe", "1")
    try:
        find_slepc()
    except SolverMissing as e:
        pytest.skip(str(e))


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_two_ranks_of_a_launcher() -> None:
    model = shell(6, 4)
    result = check_modal_solver(SlepcSolver(launcher="mpiexec -n 2"), model, count=10)
    assert result.complete
    assert "by inertia" in result.proof
    assert "2 ranks" in result.proof
    with EmbeddedSolver().open(model) as analysis:
        ours = analysis.modes(ModesRequest(10)).modes
    np.testing.assert_allclose(
        result.modes.frequencies, ours.frequencies, rtol=1e-7, atol=2e-3
    )
    assert result.residuals.max() < 1e-7


@pytest.fixture
def plate(tmp_path: Path) -> Model:
    return constrained_plate.deck(tmp_path)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_modes_assembled_on_ranks_are_those_of_the_whole_matrices(plate: Model) -> None:
    with SlepcSolver(ranks=2).open(plate) as analysis:
        found = analysis.modes(ModesRequest(12))
        band = analysis.modes(ModesRequest(band=(20.0, 100.0)))
        assert not len(analysis.modes(ModesRequest(band=(1.0, 5.0))).modes)
    assert found.complete
    with EmbeddedSolver().open(plate) as ours:
        assert found.autospc.labels() == ours.modes(ModesRequest(12)).autospc.labels()
        K, M = ours.system.stiffness, ours.system.mass
        phi = np.asarray(ours.system.local @ found.modes.shapes)
        full = ours.system.transform @ phi
    lam = (2 * np.pi * found.modes.frequencies) ** 2
    gram = phi.T @ (M @ phi)
    np.testing.assert_allclose(gram, np.eye(12), atol=1e-10)
    np.testing.assert_allclose(phi.T @ (K @ phi), np.diag(lam), atol=1e-10 * lam[-1])
    np.testing.assert_allclose(
        full, found.modes.shapes, atol=1e-12 * np.abs(full).max()
    )
    inside = found.modes.frequencies[(found.modes.frequencies > 20) & (lam < lam[-1])]
    inside = inside[inside < 100]
    np.testing.assert_allclose(band.modes.frequencies, inside, rtol=1e-9)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("free", [True, False])
def test_derivatives(plate: Model, *, free: bool) -> None:
    """Of all DOFs, of more channels than parameters and, by adjoint motions, of fewer."""
    if free:
        model, parameters = shell(8, 5), shell_parameters()
    else:
        model, parameters = plate, constrained_plate.parameters()
    with SlepcSolver(ranks=2).open(model) as analysis:
        modes = analysis.modes(ModesRequest(9)).modes
        d_lambda, d_phi = analysis.derivatives(modes, parameters)
        every = sparse.csr_array(sparse.eye_array(len(analysis.dofs)))
        rows = [every[2 : 6 * n : 6] for n in (2, 40)]
        seen = [analysis.observed_derivatives(modes, parameters, r) for r in rows]
    with EmbeddedSolver().open(model) as ours:
        want_lambda, want_phi = ours.derivatives(modes, parameters)
    size = np.abs(want_lambda).max()
    np.testing.assert_allclose(d_lambda, want_lambda, rtol=1e-6, atol=1e-8 * size)
    size = np.linalg.norm(want_phi, axis=0).max()
    np.testing.assert_allclose(d_phi, want_phi, atol=1e-6 * size)
    for r, (d, at_channels) in zip(rows, seen, strict=True):
        np.testing.assert_array_equal(d, d_lambda)
        want = np.einsum("cf,fmp->cmp", r.toarray(), d_phi)
        np.testing.assert_allclose(at_channels, want, atol=1e-8 * size)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_an_updating_is_linearised_through_it(plate: Model) -> None:
    parameters = constrained_plate.parameters().take(range(5))  # those on fields
    observation = at_dofs(("14+Z", "33+Z", "50+Z", "902+X"), mesh(plate).dofs)
    x = np.linspace(-0.2, 0.2, len(parameters))
    asked = ModesRequest(6)
    theirs = FullModel(
        plate, parameters, observation, asked, SlepcSolver(ranks=2)
    ).linearise(x)
    ours = FullModel(plate, parameters, observation, asked).linearise(x)
    np.testing.assert_allclose(theirs.d_lambda, ours.d_lambda, rtol=1e-6, atol=1e-3)
    sign = np.sign(np.sum(theirs.shapes * ours.shapes, axis=0))
    assert np.abs(ours.d_shapes).max() > 0
    np.testing.assert_allclose(
        theirs.d_shapes * sign[:, None],
        ours.d_shapes,
        atol=1e-6 * np.abs(ours.d_shapes).max(),
    )


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_a_model_is_reduced_where_its_matrices_are() -> None:
    """The same basis, so that also away from x = 0 all is the same; and changes along vectors."""
    model = shell(12, 8)
    parameters = shell_parameters()
    observation = at_dofs(("5+Z", "33+Z", "70+X", "90+Z"), mesh(model).dofs)
    count, fmax = 12, 60.0
    with SlepcSolver(ranks=2).open(model) as analysis:
        theirs = analysis.reduced(parameters, observation.matrix, count, fmax)
        zero = np.zeros(len(parameters))
        found = theirs.along(parameters.parameters, theirs.coordinates(zero)[1])
    with EmbeddedSolver().open(model) as embedded:
        system = embedded.system
        affine = observed_system(model, system, parameters, observation)
        known = KnownModes(embedded.pencil, shift=low_shift(embedded.pencil, fmax))
        ours = reduced_model(affine, count, known=known)
    assert theirs.basis.size == ours.basis.size
    for x in (zero, np.linspace(-0.3, 0.3, len(parameters))):
        a, b = theirs.linearise(x), ours.linearise(x)
        np.testing.assert_allclose(a.frequencies[6:], b.frequencies[6:], rtol=1e-6)
        sign = np.sign(np.sum(a.shapes * b.shapes, axis=0))
        d_shapes = a.d_shapes * sign[:, None]
        for got, want in ((a.d_lambda, b.d_lambda), (d_shapes, b.d_shapes)):
            size = np.abs(want[..., 6:, :]).max()
            np.testing.assert_allclose(
                got[..., 6:, :], want[..., 6:, :], atol=1e-6 * size
            )
    _, phi = ours.vectors(zero)
    changes = quadratic_forms(model, parameters.parameters, system, phi)
    for got, want in zip(found, changes, strict=True):
        size = np.abs(want).max()
        elastic = np.einsum("pmm->mp", got)[6:]  # the others turn
        np.testing.assert_allclose(elastic, want[6:], atol=1e-6 * size)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_localise_on_ranks_is_that_of_the_embedded_solver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And this process makes no matrix of the model."""
    asked = '[localise]\nkinds = ["material"]\npool = 4\nmost = 3\n'
    toml = small_study.MODEL + small_study.TEST + small_study.SETTINGS + asked
    study = small_study.write_study(tmp_path, toml, ambient=False)
    ours = run_study(study, until="localise").results["localise"]
    session = Session.of(study)
    session.engine = SlepcSolver(ranks=2)
    with monkeypatch.context() as barred:
        barred.setattr(Sum, "__init__", lambda *_: pytest.fail("a matrix of the model"))
        theirs = localise.run(session, quiet)
    assert theirs is not None
    assert ours.proposal.members
    assert theirs.candidates.parameters.names == ours.candidates.parameters.names
    assert theirs.pool.dropped == ours.pool.dropped
    np.testing.assert_allclose(
        theirs.candidates.effect, ours.candidates.effect, rtol=1e-5
    )
    for a, b in zip(theirs.proposal.members, ours.proposal.members, strict=True):
        assert a.name == b.name
        assert a.factor == pytest.approx(b.factor, rel=1e-5)
    assert theirs.reduced_by == "slepc"
    assert not theirs.indicators.modes.size


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_an_updating_makes_no_matrix_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deck, study, test = (
        tmp_path / name for name in ("frame.bdf", "study.toml", "test.json")
    )
    deck.write_text(small_study.deck())
    study.write_text(f'[model]\ndeck = "frame.bdf"\n{CANDIDATES}')
    ours = open_model(read_deck(deck))
    seen = rt.solve_modes(ours.model, count=9).at(
        [f"{i}+X" for i in ours.model["GRID"].ids[::3]]
    )
    write_modes(test, replace(seen, damping=np.full(9, 0.01)))

    def linearised(opened: Opened) -> Linearisation:
        config, aim, modes, _ = read_target(read_config(study), opened, test)
        problem, _, _ = direct_problem(opened, config, aim, modes, tmp_path, None)
        return problem.evaluate(np.full(3, 0.1)).points[0].now

    want = linearised(ours)
    monkeypatch.setattr(
        Sum, "__init__", lambda *_: pytest.fail("a matrix of the model")
    )
    found = linearised(replace(ours, engine=SlepcSolver(ranks=2)))
    np.testing.assert_allclose(found.frequencies[:9], want.frequencies[:9], rtol=1e-6)
    np.testing.assert_allclose(found.d_lambda[:9], want.d_lambda[:9], rtol=1e-4)


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_a_time_limit_ends_the_ranks(plate: Model) -> None:
    with SlepcSolver(ranks=2, timeout=0.1).open(plate) as analysis:
        with pytest.raises(SolverFailed, match="did not end within"):
            analysis.modes(ModesRequest(4))
        assert analysis._ranks is not None
        assert analysis._ranks.process.poll() is not None


@pytest.mark.solver
@pytest.mark.usefixtures("installed")
def test_errors_of_the_model_are_those_of_the_embedded_solver(plate: Model) -> None:
    held = replace(
        plate,
        tables={
            k: t for k, t in plate.tables.items() if k not in ("PSHELL", "RBE2", "RBE3")
        },
    )
    missing = "CQUAD4 [0-9]+: PSHELL [12] is not in the deck"
    with pytest.raises(DeckError, match=missing):
        EmbeddedSolver().open(held)
    with (
        SlepcSolver(ranks=2).open(held) as analysis,
        pytest.raises(DeckError, match=missing) as told,
    ):
        analysis.modes(ModesRequest(4))
    assert told.value.line
    moving = ParameterSet((Parameter("x", (CardField("GRID", 902, "X1"),)),))
    with SlepcSolver(ranks=2).open(plate) as analysis:
        modes = ModeSet(
            np.ones(1), np.zeros(1), np.zeros((len(analysis.dofs), 1)), analysis.dofs
        )
        with pytest.raises(UnsupportedError, match="moves nodes"):
            analysis.derivatives(modes, moving)


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
