"""A study through another solver: modes of its decks and of the updating are the solver's, found
anew at each point.

The solver of the test is the embedded one with every λ 20 % higher: an updating that minds it finds
all moduli 1/1.2 of the true ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import small_study

from ringtrue.core.dofs import DofSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import ConfigError, SolverMissing
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.report.build import deliver
from ringtrue.solvers import registry
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver, find_mystran
from ringtrue.study.config import parse_config
from ringtrue.study.run import StudyRun, run_study

STIFFER = 1.2
FLOORS = '[[candidate]]\nname = "floors 10"\ntargets = ["MAT1 10 E"]\n'


@dataclass
class Handed:
    """Modes alone, rows in an order of its own."""

    real: EmbeddedAnalysis
    capabilities: frozenset[str] = frozenset({"modes"})

    @property
    def dofs(self) -> DofSet:
        return self.real.dofs

    def modes(self, request: ModesRequest) -> ModesResult:
        f = np.sqrt(STIFFER)
        low, high = request.band or (-1.0, -1.0)
        asked = request if request.band is None else ModesRequest(band=(low, high / f))
        found = self.real.modes(asked)
        return replace(
            found, modes=replace(found.modes, frequencies=f * found.modes.frequencies)
        )

    def __enter__(self) -> Handed:
        return self

    def __exit__(self, *_: object) -> None:
        self.real.__exit__(None, None, None)


class Outside:
    name = "outside"

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> Handed:
        return Handed(EmbeddedSolver().open(model))


def asked(toml: str, solver: str) -> str:
    return toml.replace("[model]\n", f'[model]\nsolver = "{solver}"\n')


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    folder = tmp_path_factory.mktemp("outside")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry.BUILT_IN, "outside", Outside)  # type: ignore[arg-type]
        run = run_study(
            small_study.write_study(
                folder, asked(small_study.FULL + FLOORS, "outside"), ambient=False
            )
        )
        deliver(run)
    return run


def test_the_updating_minds_the_modes_of_the_solver(done: StudyRun) -> None:
    update = done.results["update"]
    best = update.sets[update.chosen]
    assert best.outcome.startswith("converged")
    for name, factor in zip(best.parameters, best.factor, strict=True):
        truth = small_study.TRUTH.get(int(name.split()[-1]), 1.0)
        assert factor * STIFFER == pytest.approx(
            truth, rel=0.05
        )  # 2 to 3 % where nothing is done through a solver
    assert update.runs > 10
    table = done.results["final"].table
    assert table.max_deviation() < 0.5
    assert (
        table.mean_deviation()
        < 0.2 * done.results["correlate"].initial.mean_deviation()
    )


def test_two_workers_take_as_many_runs_to_the_same_factors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(registry.BUILT_IN, "outside", Outside)
    toml = asked(small_study.FULL, "outside").replace(
        "[update]", "[update]\niterations = 4"
    )
    toml += '[[set]]\nname = "two"\ncandidates = ["columns 1", "columns 2"]\n'
    study = small_study.write_study(tmp_path, toml, ambient=False)
    one = run_study(study, until="update").results["update"]
    two = run_study(study, first="update", until="update", workers=2).results["update"]
    assert two.runs == one.runs > 0
    for a, b in zip(one.sets, two.sets, strict=True):
        np.testing.assert_array_equal(a.factor, b.factor)
        np.testing.assert_array_equal(a.history.path, b.history.path)


def test_every_table_has_its_frequencies_and_what_is_embedded_is_said(
    done: StudyRun,
) -> None:
    real = done.session.initial.analysis.modes(ModesRequest(3)).modes.frequencies
    for stage in (done.results["model"].modes, done.results["correlate"].fe_initial):
        np.testing.assert_allclose(
            stage.frequencies[:3], np.sqrt(STIFFER) * real, rtol=1e-9
        )
    told = json.loads((done.folder / "summary.json").read_text())
    assert told["solver"] == {"name": "outside", "runs": done.results["update"].runs}
    page = (done.folder / "report.html").read_text(encoding="utf-8")
    assert re.search("by outside, found anew at each point in [0-9]+ runs", page)
    assert (
        done.results["uncertainty"] is None
    )  # the embedded frequencies are 10 % lower: its posterior is not this one
    assert "No uncertainty is given" in page


@pytest.mark.parametrize(
    ("toml", "told"),
    [
        (asked(small_study.FULL, "outsid"), "no solver 'outsid'"),
        (
            asked(small_study.FULL, "mystran")
            + '[[residual]]\nkind = "mass"\nmass = 1.0\n',
            "gives modes alone",
        ),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, toml: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        run_study(small_study.write_study(tmp_path, toml, ambient=False))


def test_the_embedded_solver_is_the_default(tmp_path: Path) -> None:
    config = parse_config(small_study.FULL, tmp_path / "study.toml")
    assert config.model is not None
    assert config.model.solver == "embedded"


@pytest.mark.solver
def test_mystran_updates_a_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame with CBAR for CBEAM, which MYSTRAN does not have; the truth is its own, too.

    On so coarse a mesh its frequencies are up to 13 % off those of the embedded solver.
    """
    try:
        find_mystran()
    except SolverMissing as e:
        pytest.skip(str(e))

    def bars(deck: str) -> str:
        text = deck.replace("CBEAM", "CBAR").replace("PBEAM", "PBAR")
        return text.replace("2.2867-5,1.1667-5,0.0,2.8-5", "2.2867-5,1.1667-5,2.8-5")

    toml = asked(small_study.FULL, "mystran").replace(
        "[update]", "[update]\niterations = 8"
    )
    study = small_study.write_study(tmp_path, toml, ambient=False)
    (tmp_path / "deck/frame.bdf").write_text(bars(small_study.deck()))
    # of the structure that is measured
    monkeypatch.setattr("ringtrue.demos.frame.EmbeddedSolver", MystranSolver)
    small_study.write_data(
        tmp_path / "data",
        ambient=False,
        truth=bars(small_study.deck(small_study.TRUTH)),
    )
    run = run_study(study, until="final")
    update = run.results["update"]
    best = update.sets[update.chosen]
    for name, factor in zip(best.parameters, best.factor, strict=True):
        assert factor == pytest.approx(
            small_study.TRUTH[int(name.split()[-1])], rel=0.05
        )
    assert run.results["final"].observed.source == "mystran"
    assert run.results["final"].table.mean_deviation() < 0.2
