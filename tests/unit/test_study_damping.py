"""The damping stage: a study whose truth has one damping ratio in all modes, which is one loss
factor everywhere.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study

from ringtrue.core.iterate import quiet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError
from ringtrue.report.build import assemble
from ringtrue.study.config import parse_config
from ringtrue.study.config_sections import StudyInfo
from ringtrue.study.run import StudyRun, run_study
from ringtrue.study.stages import damping

LOSS = 2 * small_study.DAMPING  # η = 2ζ where every region has the same
REGIONS = """
[damping]
write = true
[[damping.region]]
name = "floors"
targets = ["MAT1 10 GE"]
[[damping.region]]
name = "columns"
targets = ["MAT1 1 GE", "MAT1 2 GE", "MAT1 3 GE"]
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    folder = tmp_path_factory.mktemp("damped")
    return run_study(small_study.write_study(folder, small_study.FULL + REGIONS))


def test_the_loss_factor_of_every_region_is_that_of_the_modes(done: StudyRun) -> None:
    d = done.results["damping"]
    assert d.regions.names == ("floors", "columns")
    for found, std in zip(d.regions.coefficients, d.regions.std, strict=True):
        assert abs(found - LOSS) < 3 * std
    columns = d.regions.coefficients[1]
    assert columns == pytest.approx(
        LOSS, rel=0.1
    )  # they hold the strain of the sway modes; 400 s of signals
    assert d.modes.spread(True)[1] < 0.1


def test_modes_left_out_are_predicted(done: StudyRun) -> None:
    modes = done.results["damping"].modes
    assert (~modes.used).sum() == 2
    assert modes.spread(False)[1] < 0.1
    spread = np.hypot(modes.after_std, modes.measured_std)
    assert (np.abs(modes.after - modes.measured) < 4 * spread).all()


def test_the_frfs_around_the_resonances_fit(done: StudyRun) -> None:
    """The model is right in shape here, and one ratio for all modes is right too: both fit to some
    per cent.
    """
    modes = done.results["damping"].modes
    assert np.isfinite(modes.frf_after).all()
    assert np.median(modes.frf_after) < 0.15
    assert np.median(modes.frf_before) < 0.15


def test_the_damped_deck_holds_the_loss_factors_and_is_else_the_delivered_one(
    done: StudyRun,
) -> None:
    d = done.results["damping"]
    old, new = (read_deck(done.folder / f / "frame.bdf") for f in ("updated", "damped"))
    at = new["MAT1"].find(np.array([10, 1, 2, 3]))
    wanted = d.regions.coefficients[[0, 1, 1, 1]]
    np.testing.assert_allclose(new["MAT1"]["GE"][at], wanted, rtol=1e-4)
    assert (old["MAT1"]["GE"] == 0).all()
    for name in ("E", "RHO"):
        assert (old["MAT1"][name] == new["MAT1"][name]).all()
    assert len(d.changes) == 4


def test_the_report_shows_it(done: StudyRun, tmp_path: Path) -> None:
    page = (
        assemble({"damping": done.results["damping"]}, info=StudyInfo(title="Damping"))
        .write(tmp_path / "r.html")
        .read_text()
    )
    assert '<section id="damping">' in page
    assert "MAT1 10 GE" in page
    assert "left out" in page


def test_it_is_up_to_date_until_its_settings_change(done: StudyRun) -> None:
    study = done.folder / "study.toml"
    assert "damping" in run_study(study).loaded
    study.write_text(
        study.read_text().replace("write = true", "write = true\nerror = 0.2")
    )
    again = run_study(study)
    assert "final" in again.loaded
    assert "damping" not in again.loaded
    assert (
        again.results["damping"].regions.std > done.results["damping"].regions.std
    ).all()


def test_a_mistake_in_a_region_is_told() -> None:
    text = '[model]\ndeck = "a.bdf"\n[[damping.region]]\nname = "a"\ntargets = ["MAT1 1 E"]\n'
    with pytest.raises(
        ConfigError, match=r"damping\.region\.0.*MAT1 1 E; allowed are loss factors"
    ):
        parse_config(text, Path("study.toml"))


def test_slow_modes_that_the_test_tells_take_part(
    done: StudyRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A structure on bungees has modes as slow, to the highest one, as rigid-body motions are by
    rounding.
    """
    want = done.results["damping"]
    monkeypatch.setattr(damping, "elastic", lambda f: f > 0.5 * f.max())
    found = damping.run(done.session, quiet)
    np.testing.assert_array_equal(found.modes.fe, want.modes.fe)
    np.testing.assert_allclose(found.modes.after, want.modes.after, rtol=0.02)


def test_damping_by_region_that_makes_frfs_worse_is_refused() -> None:
    before = np.array([0.20, 0.21, 0.30, 0.15, 0.18, np.nan])
    exact = np.zeros(6)
    assert damping.refusal(before, before, exact) == ""
    assert damping.refusal(before, 0.9 * before, exact) == ""
    mixed = before + np.array([0.02, -0.03, 0.01, -0.02, 0.01, 0.0])
    assert damping.refusal(before, mixed, exact) == ""
    why = damping.refusal(before, 1.5 * before, exact)
    assert damping.refusal(before, 1.5 * before, np.full(6, 0.5)) == ""
    assert why.startswith(
        "with it the measured FRFs around the resonances deviate by 32."
    )


def test_refused_damping_is_shown_and_not_used(done: StudyRun, tmp_path: Path) -> None:
    refused = replace(
        done.results["damping"], why="the FRFs are worse", files=(), changes=()
    )
    assert done.results["damping"].why == ""
    page = assemble({"damping": refused}, info=StudyInfo(title="damped")).write(
        tmp_path / "r.html"
    )
    assert "Refused: the FRFs are worse." in page.read_text()
