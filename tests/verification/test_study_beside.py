"""What was measured beside the modes, in the screening of candidates made from the deck.

The frame of `small_study` with a hanger of no account to its modes, a rod along z at a corner of
the top floor:

    pull F at its end, which moves by F l/EA and what the floor gives
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
import small_study

from ringtrue.checks.materials import whole_mass
from ringtrue.core.iterate import quiet
from ringtrue.correlation.sensor_mapping import at_dofs
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError
from ringtrue.io.modes import write_modes
from ringtrue.study.candidate_screening import DataScreening
from ringtrue.study.objective import target
from ringtrue.study.opened import Opened
from ringtrue.study.run import StudyRun, run_study
from ringtrue.updating.selection.candidates import CandidateSettings, parameters
from ringtrue.updating.selection.generation import generate
from ringtrue.virtual.measurements import write_sheet

WRONG, SOFT = 0.75, 0.5  # columns of the first storey, the hanger
END, LOAD = 999, 1000.0  # its lower end, N
STUDY = """
[study]
title = "Hanger"
[model]
deck = "frame.bdf"
[test]
sheet = "sensors.csv"
modes = "modes.json"
[update]
propose = true
[localise]
kinds = ["material"]
pool = 3
"""
STATIC = '[[residual]]\nkind = "static"\nname = "pull"\nfile = "pull.csv"\n'


def deck(columns: float = 1.0, hanger: float = 1.0) -> str:
    cards = [
        f"GRID,{END},,4.0,3.0,8.5",
        f"MAT1,9,{2.1e11 * hanger:.6E},,0.3,7850.0",
        "PROD,9,9,1.-5",
        f"CROD,{END},9,{small_study.node(3, 2, 2)},{END}",
        f"SPC1,1,12456,{END}",
        "ENDDATA",
    ]
    return small_study.deck({1: columns}).replace("ENDDATA", "\n".join(cards))


def written(folder: Path, more: str) -> Path:
    """The deck, the modes of the truth without noise, and what its hanger gave."""
    (folder / "frame.bdf").write_text(deck())
    (folder / "truth.bdf").write_text(deck(WRONG, SOFT))
    true, test = Opened(read_deck(folder / "truth.bdf"), 1.0), small_study.test_model()
    end = replace(
        test,
        points=np.append(test.points, END),
        xyz=np.vstack([test.xyz, [4.0, 3.0, 8.5]]),
        channels=(*test.channels, f"{END}+Z", f"{END}+Y"),
        at=np.append(test.at, [END, END]),
        axes=np.vstack([test.axes, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]]),
        groups=(*test.groups, ""),
    )
    write_sheet(folder / "sensors.csv", end, end.channels)
    modes = true.modes(18.0).modes
    shapes = true.observation(test, 0.01)(modes.shapes)
    write_modes(
        folder / "modes.json", replace(modes, shapes=shapes, labels=test.channels)
    )
    rows = (
        at_dofs((f"{END}+Z", "303+X"), true.analysis.dofs, 1.0).matrix
        @ true.analysis.system.transform
    )
    moved = rows @ true.analysis.pencil.at(0.0).solve(LOAD * rows[[0]].toarray().T)
    lines = [
        f"pull,{END}+Z,{LOAD},{moved[0, 0]:.9e}",
        f"pull,303+X,,{moved[1, 0]:.9e}",
        f"pull,{END}+Y,,0.0",
    ]
    (folder / "pull.csv").write_text(
        "\n".join(["case,channel,load,deflection", *lines]) + "\n"
    )
    (folder / "study.toml").write_text(STUDY + more)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    return run_study(
        written(tmp_path_factory.mktemp("pulled"), STATIC), until="localise"
    )


def test_a_candidate_that_no_mode_strains_is_proposed_by_the_pull_on_it(
    pulled: StudyRun,
) -> None:
    found = {m.name: m.factor for m in pulled.results["localise"].proposal.members}
    assert found["MAT1 9 E"] == pytest.approx(SOFT, rel=0.02)
    assert found["MAT1 1 E"] == pytest.approx(WRONG, rel=0.02)


def test_constraints_may_name_candidates_that_the_screening_left_out(
    pulled: StudyRun, tmp_path: Path
) -> None:
    """Which these are changes with the data; a name that the deck does not give is refused."""
    limit = '[[constraint]]\nterms = {{ "{}" = 1.0 }}\nmost = 0.5\n'
    out = pulled.results["localise"].pool.screened[0]
    study = written(tmp_path, STATIC + limit.format(out))
    assert "sensitivity" in run_study(study, until="sensitivity").results
    study.write_text(STUDY + STATIC + limit.format("MAT1 77 E"))
    with pytest.raises(ConfigError, match="no candidate 'MAT1 77 E'"):
        run_study(study, until="sensitivity")


@pytest.mark.parametrize("kind", ["static", "mass", "zeros"])
def test_what_candidates_do_to_the_data_is_what_the_reduced_model_says(
    pulled: StudyRun, tmp_path: Path, kind: str
) -> None:
    """At a point off the deck, for candidates of which K and M are linear functions."""
    whole = whole_mass(read_deck(pulled.folder / "truth.bdf"))
    more = {
        "static": STATIC,
        "mass": f'[[residual]]\nkind = "mass"\nmass = {whole.mass}\ncenter = '
        f"{[float(c) for c in whole.cg]}\n",
        "zeros": '[[residual]]\nkind = "anti-resonances"\noutput = "303+X"\ninput = '
        '"303+X"\nfrequencies = [3, 7]\n',
    }
    session = run_study(written(tmp_path, more[kind]), until="correlate").session
    every = generate(session.remodelled.model, CandidateSettings(("material",), "SI"))
    beside, aim = DataScreening.of(session.own, every), target(session.own)
    model = beside.loaded(session.own.reduced(parameters(every), quiet))
    problem, x = (
        beside.problem(model, aim),
        0.1 * np.random.default_rng(1).standard_normal(len(every)),
    )
    at, p = problem.evaluate(x), problem.parameters
    mine = at.kind == at.kind.max()
    value, slopes = beside.misfit(model.model, x, range(len(every)), aim)
    np.testing.assert_allclose(value, at.value[mine], rtol=1e-5, atol=1e-6)
    nominal = at.slope[mine] * p.derivative(0 * x) / p.derivative(x) * p.std()
    # zeros: the other vectors of the basis have a small part in the derivatives of shapes
    np.testing.assert_allclose(
        slopes,
        nominal,
        rtol=1e-5,
        atol=(1e-2 if kind == "zeros" else 1e-6) * abs(nominal).max(),
    )
