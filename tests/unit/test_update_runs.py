"""`ringtrue update --solver`: the frame's factors by modes that another solver finds anew at each
point.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pytest
import small_study

from ringtrue.cli.main import run
from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.correlation.sensor_mapping import at_dofs
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import SolverFailed, SolverMissing
from ringtrue.io.modes import write_modes
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest, ModesResult
from ringtrue.solvers import registry
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver, find_mystran
from ringtrue.solvers.observed import FullModel
from ringtrue.study.run import run_study
from ringtrue.virtual.measurements import write_sheet

TRUTH = small_study.TRUTH
STUDY = '[model]\ndeck = "frame.bdf"\n' + "".join(
    f'[[candidate]]\nname = "storey {i}"\ntargets = ["MAT1 {i} E"]\nstd = 1.0\n'
    for i in TRUTH
)

Capture = pytest.CaptureFixture[str]


@dataclass
class Outside:
    """An engine of modes alone, whose runs numbered in `failing` fail."""

    failing: range = range(0)
    runs: int = 0
    name: str = "outside"

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> Handed:
        return Handed(self, EmbeddedSolver().open(model))


@dataclass
class Handed:
    engine: Outside
    inner: EmbeddedAnalysis
    capabilities: frozenset[str] = field(default=frozenset({"modes"}))

    def __post_init__(self) -> None:
        self.dofs = self.inner.dofs

    def modes(self, request: ModesRequest) -> ModesResult:
        self.engine.runs += 1
        if self.engine.runs in self.engine.failing:
            raise SolverFailed("no licence left")
        return self.inner.modes(request)

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
        raise AssertionError("it has none")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.inner.__exit__(kind, error, trace)


def frame(factors: dict[int, float] | None = None) -> str:
    """The deck with CBAR for CBEAM, which MYSTRAN does not have."""
    deck = small_study.deck(factors).replace("CBEAM", "CBAR").replace("PBEAM", "PBAR")
    return deck.replace("2.2867-5,1.1667-5,0.0,2.8-5", "2.2867-5,1.1667-5,2.8-5")


def case(folder: Path, engine: ModalSolver, study: str = STUDY) -> tuple[str, str]:
    """A study of the frame, and the modes of the true one by the engine."""
    (folder / "frame.bdf").write_text(frame())
    (folder / "truth.bdf").write_text(frame(TRUTH))
    (folder / "study.toml").write_text(study)
    with engine.open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(9)).modes
    seen = modes.rows(small_study.test_model().channels)
    write_modes(folder / "test.json", replace(seen, damping=np.full(9, 0.01)))
    return str(folder / "study.toml"), str(folder / "test.json")


def update(capsys: Capture, *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run(["update", *words])
    out, err = capsys.readouterr()
    return status, out, err


@pytest.fixture
def outside(monkeypatch: pytest.MonkeyPatch) -> Outside:
    engine = Outside()
    monkeypatch.setitem(registry.BUILT_IN, "outside", lambda: engine)
    return engine


def test_slopes_by_differences_are_the_derivatives(tmp_path: Path) -> None:
    (tmp_path / "frame.bdf").write_text(frame())
    model = read_deck(tmp_path / "frame.bdf")
    every = ParameterSet(
        tuple(Parameter(f"E{i}", (CardField("MAT1", i, "E"),)) for i in TRUTH)
    )
    with EmbeddedSolver().open(model) as analysis:
        seen = at_dofs(small_study.test_model().channels, analysis.dofs)
    # the last one steps back from its bound
    x, asked = np.log([0.9, 1.3, 9.99]), ModesRequest(9)
    exact = FullModel(model, every, seen, asked).linearise(x)
    near = FullModel(model, every, seen, asked, Outside()).linearise(x)
    assert near.d_lambda.shape == exact.d_lambda.shape
    sign = np.sign(np.sum(exact.shapes * near.shapes, axis=0))
    for a, b in (
        (near.d_lambda, exact.d_lambda),
        (near.d_shapes * sign[:, None], exact.d_shapes),
    ):
        assert np.abs(a - b).max() < 5e-3 * np.abs(b).max()


def test_differences_of_repeated_and_rigid_body_modes(tmp_path: Path) -> None:
    """A free steel bar of equal inertias, 10 elements, the modulus of each half a parameter.

    λ is homogeneous in the two: ∂λ/∂x summed is λ, and the shapes stay. No inertia about the axis:
    5 rigid-body modes.
    """
    lines = [
        "SOL 103",
        "CEND",
        "BEGIN BULK",
        "MAT1,1,2.1+11,,0.3,7850.",
        "MAT1,2,2.1+11,,0.3,7850.",
    ]
    lines += [f"PBAR,{i},{i},1.-3,1.-7,1.-7,2.-7" for i in (1, 2)]
    lines += [f"GRID,{i + 1},,{0.1 * i:.1f},0.,0." for i in range(11)]
    lines += [f"CBAR,{i + 1},{1 + i // 5},{i + 1},{i + 2},0.,1.,0." for i in range(10)]
    (tmp_path / "bar.bdf").write_text("\n".join([*lines, "ENDDATA"]) + "\n")
    model = read_deck(tmp_path / "bar.bdf")
    halves = ParameterSet(
        tuple(Parameter(f"E{i}", (CardField("MAT1", i, "E"),)) for i in (1, 2))
    )
    with EmbeddedSolver().open(model) as analysis:
        seen = at_dofs(
            tuple(f"{n}+{d}" for n in range(1, 12) for d in "YZ"), analysis.dofs
        )
    at = FullModel(model, halves, seen, ModesRequest(10), Outside()).linearise(
        np.zeros(2)
    )
    lam, free = (2 * np.pi * at.frequencies) ** 2, at.frequencies > 1.0
    assert free.tolist() == 5 * [False] + 4 * [
        True
    ]  # the tenth mode, half of a pair, cannot be followed
    assert lam[free][1] == pytest.approx(lam[free][0], rel=1e-6)
    np.testing.assert_allclose(at.d_lambda.sum(axis=1)[free], lam[free], rtol=3e-3)
    moved = at.d_shapes[:, free]
    assert np.abs(moved.sum(axis=-1)).max() < 1e-2 * np.abs(moved).max()


def test_a_study_ends_where_differences_tell_no_better(
    tmp_path: Path, outside: Outside
) -> None:
    """Noise leaves residuals; slopes that are off by half a step cannot cancel them to the last
    digit.
    """
    _, modes = case(tmp_path, outside)
    told, rng = json.loads(Path(modes).read_text()), np.random.default_rng(5)
    for mode, noise in zip(told["modes"], rng.standard_normal(9), strict=True):
        mode["frequency_hz"] *= 1 + 0.005 * noise
    for mode in told["modes"]:
        shape = np.array(mode["shape_re"])
        mode["shape_re"] = (
            shape + 0.02 * np.abs(shape).max() * rng.standard_normal(shape.size)
        ).tolist()
    Path(modes).write_text(json.dumps(told))
    test = small_study.test_model()
    write_sheet(tmp_path / "sensors.csv", test, test.channels)
    found, runs = [], []
    for solver in ("outside", "embedded"):
        before = outside.runs
        head = f'[model]\ndeck = "frame.bdf"\nfmax = 20.0\nsolver = "{solver}"\n'
        head += '[test]\nsheet = "sensors.csv"\nmodes = "test.json"\n'
        (tmp_path / "study.toml").write_text(
            head + STUDY.partition('"frame.bdf"\n')[2].replace("std = 1.0\n", "")
        )
        update = run_study(tmp_path / "study.toml", until="update").results["update"]
        found.append(update.sets[update.chosen])
        runs.append(outside.runs - before)
    near, exact = found
    assert runs[0] < 100
    order = [near.parameters.index(p) for p in exact.parameters]
    assert np.abs(near.factor[order] - exact.factor).max() < 0.1 * exact.std.min()


@pytest.mark.parametrize("failing", [range(0), range(7, 11)])
def test_a_solver_that_fails_at_a_trial_point_is_a_rejected_step(
    capsys: Capture, tmp_path: Path, outside: Outside, failing: range
) -> None:
    words = case(tmp_path, EmbeddedSolver())
    # the first five runs count the modes and give their slopes
    outside.failing = failing
    status, out, err = update(capsys, *words, "--solver", "outside", "--json", "-")
    assert status == 0, err
    found = json.loads(out)
    np.testing.assert_allclose(
        [p["factor"] for p in found["parameters"]], list(TRUTH.values()), rtol=0.01
    )
    assert found["solver"] == "outside"
    assert found["full_solutions"] == outside.runs
    assert found["outcome"].startswith("converged")


def test_a_start_that_cannot_be_solved_is_an_error(
    capsys: Capture, tmp_path: Path, outside: Outside
) -> None:
    words = case(tmp_path, EmbeddedSolver())
    outside.failing = range(3, 4)
    status, _, err = update(capsys, *words, "--solver", "outside")
    assert status != 0
    assert "no licence left" in err
    assert outside.runs == 3


def test_what_is_no_mode_and_unknown_solvers_are_refused(
    capsys: Capture, tmp_path: Path, outside: Outside
) -> None:
    words = case(tmp_path, EmbeddedSolver())
    path = Path(words[0])
    plain = path.read_text()
    path.write_text(plain + '[[residual]]\nkind = "mass"\nmass = 1000.0\n')
    status, _, err = update(capsys, *words, "--solver", "outside")
    path.write_text(plain)
    assert status == 2
    assert "modes alone" in err
    assert outside.runs == 0
    status, _, err = update(capsys, *words, "--solver", "mystrann")
    assert status == 2
    assert "did you mean 'mystran'" in err


@pytest.mark.solver
def test_mystran_finds_a_wrong_modulus(capsys: Capture, tmp_path: Path) -> None:
    try:
        find_mystran()
    except SolverMissing as e:
        pytest.skip(str(e))
    words = case(tmp_path, MystranSolver())
    status, out, err = update(
        capsys,
        *words,
        "--solver",
        "mystran",
        "--out",
        str(tmp_path / "up"),
        "--json",
        "-",
    )
    assert status == 0, err
    found = json.loads(out)
    factors = [p["factor"] for p in found["parameters"]]
    np.testing.assert_allclose(factors, list(TRUTH.values()), rtol=0.01)
    moduli = read_deck(tmp_path / "up" / "frame.bdf")["MAT1"]["E"]
    np.testing.assert_allclose(moduli[:3], 2e11 * np.array(factors), rtol=1e-5)
