"""Localisation and uncertainty as stages of the small study, whose columns are wrong; see
`small_study`.
"""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
import small_study

from ringtrue.errors import DataError
from ringtrue.report.build import deliver
from ringtrue.study.messages import run_messages
from ringtrue.study.results import LocaliseStage, UncertaintyStage
from ringtrue.study.run import StudyRun, load_study, run_study

PLAIN = small_study.MODEL + small_study.TEST + small_study.SETTINGS
AUTO = PLAIN.replace("[update]\n", "[update]\npropose = true\n")
# candidates: where the choice among them is not what is tested
FEW = "[localise]\npool = 6\n"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    """With the three storeys as candidates, and sampled."""
    text = small_study.FULL + "[uncertainty]\nfolds = 3\nsamples = 160\n"
    run = run_study(small_study.write_study(tmp_path_factory.mktemp("given"), text))
    deliver(run)
    return run


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    """Without candidates, the proposal updated."""
    run = run_study(small_study.write_study(tmp_path_factory.mktemp("made"), AUTO))
    deliver(run)
    return run


def test_errors_gather_in_the_columns_and_not_in_the_floors(given: StudyRun) -> None:
    found: LocaliseStage = given.results["localise"]
    value = dict(
        zip(
            found.indicators.regions,
            found.indicators.concentration.tolist(),
            strict=True,
        )
    )
    # a quarter too soft: the worst
    assert max(value, key=lambda k: value[k]) == "property 1"
    assert value["property 10"] < 1
    for share in (
        found.indicators.strain,
        found.indicators.force,
        found.indicators.constitutive,
        found.indicators.energy,
    ):
        assert share.sum() == pytest.approx(1.0)
    assert not np.isin(
        found.indicators.modes, given.results["correlate"].reference.left_out
    ).any()


def test_the_proposal_has_every_wrong_storey_with_its_factor(given: StudyRun) -> None:
    found: LocaliseStage = given.results["localise"]
    assert {m.name for m in found.proposal.members} == {
        f"columns {k}" for k in small_study.TRUTH
    }
    for m in found.proposal.members:
        # modes to 1e-4, but columns of two storeys trade for each other: a modulus is told to some
        # percent
        assert m.factor == pytest.approx(small_study.TRUTH[int(m.name[-1])], rel=0.02)
        assert "MAT1" in m.because
    assert found.pool.made == 0
    assert found.candidates.elements == ("property 1", "property 2", "property 3")


def test_candidates_made_from_the_deck_are_proposed_and_updated(made: StudyRun) -> None:
    found: LocaliseStage = made.results["localise"]
    proposed = {m.name for m in found.proposal.members}
    assert {"MAT1 1 E", "MAT1 2 E"} <= proposed
    assert found.pool.made >= len(found.candidates.parameters)
    best = made.results["update"].sets[made.results["update"].chosen]
    held = made.results["sensitivity"].held.get(
        best.name, {}
    )  # the data cannot tell these from others
    assert {*best.parameters, *held} == proposed
    before, after = made.results["correlate"].initial, made.results["final"].table
    assert after.mean_deviation() < 0.2 * before.mean_deviation()
    assert any("MAT1 1 E" in c for c in made.results["final"].changes)
    summary = json.loads((made.folder / "summary.json").read_text())
    assert {p["name"] for p in summary["proposed"]} == proposed
    assert {p["name"] for p in summary["parameters"]} == set(best.parameters)


@pytest.mark.parametrize("propose", [False, True])
def test_parts_of_a_property_are_looked_at_but_not_updated(
    tmp_path: Path, propose: bool
) -> None:
    text = (AUTO if propose else PLAIN) + FEW + 'kinds = ["region", "material"]\n'
    found = run_study(
        small_study.write_study(tmp_path, text, ambient=False), until="localise"
    ).results["localise"]
    assert (
        any(p.targets[0].elements for p in found.candidates.parameters.parameters)
        is not propose
    )


def test_a_proposal_of_parts_alone_is_refused(tmp_path: Path) -> None:
    study = small_study.write_study(
        tmp_path, AUTO + '[localise]\nkinds = ["region"]\n', ambient=False
    )
    with pytest.raises(
        DataError,
        match=r"further `kinds` under \[localise\] \(region, a part of a property",
    ):
        run_study(study, until="localise")


def test_a_study_with_nothing_to_update_says_what_could_be(tmp_path: Path) -> None:
    run = run_study(
        small_study.write_study(tmp_path, PLAIN + FEW.replace("6", "10"), ambient=False)
    )
    assert len(run.results["localise"].proposal.members) >= 2
    assert "sensitivity" not in run.results
    assert "final" not in run.results
    deliver(run)
    off = run_study(
        small_study.write_study(
            tmp_path / "off", PLAIN + "[localise]\npool = 0\n", ambient=False
        )
    )
    assert off.results["localise"] is None
    deliver(off)


def test_a_proposal_without_a_paired_mode_is_refused(tmp_path: Path) -> None:
    study = small_study.write_study(
        tmp_path, AUTO + "[correlate]\nfrequency_gate = 1e-6\n", ambient=False
    )
    with pytest.raises(DataError, match="no mode of the model is paired"):
        run_study(study)
    study.write_text(study.read_text().replace("propose = true", ""))
    run = run_study(study)
    assert run.results["localise"] is None
    deliver(run)


def test_intervals_hold_the_truth_and_bands_the_modes(given: StudyRun) -> None:
    found: UncertaintyStage = given.results["uncertainty"]
    best = given.results["update"].sets[given.results["update"].chosen]
    np.testing.assert_allclose(found.posterior.factor, best.factor)
    assert (found.posterior.interval[:, 0] < found.posterior.factor).all()
    assert (found.posterior.factor < found.posterior.interval[:, 1]).all()
    truth = np.array(
        [small_study.TRUTH[int(n[-1])] for n in found.posterior.parameters.names]
    )
    assert (
        np.abs(np.log(found.posterior.factor / truth)) < 2.5 * found.posterior.std
    ).all()
    assert found.posterior.moved.all()
    assert (found.posterior.ratio < 0.2).all()
    assert (found.held.in_turn == found.bands.used).all()
    # those that the updating did not see, too
    assert np.isfinite(found.held.predicted).all()
    assert not found.unproven.any()
    assert found.held.coverage(found.level) > 0.5
    assert found.discrepancy[0] < 2e-3  # the twin has the form of the model
    np.testing.assert_allclose(found.bands.predicted, found.bands.test, rtol=0.01)
    reach = found.bands.band[:, 1] - found.bands.predicted
    assert (
        reach
        > 1.6 * np.sqrt((found.bands.parts**2).sum(axis=1)) * found.bands.predicted
    ).all()  # Student's is wider


def test_draws_are_where_the_intervals_are(given: StudyRun) -> None:
    found: UncertaintyStage = given.results["uncertainty"]
    assert found.chains.draws.shape == (160, 3)
    assert 0.1 < found.chains.acceptance < 0.95
    middle = np.median(found.chains.draws, axis=0)
    # few draws of chains that hang together: their middle is known to about a standard deviation
    assert (
        np.abs(np.log(middle / found.posterior.factor)) < 6 * found.posterior.std
    ).all()


def test_same_study_same_numbers_and_stored_as_found(
    given: StudyRun, tmp_path: Path
) -> None:
    again = run_study(given.folder / "study.toml", out=tmp_path)
    held = load_study(given.folder / "study.h5")
    for name in ("localise", "uncertainty"):
        _same(given.results[name], again.results[name], 1e-6)
        _same(given.results[name], held.results[name], 0.0)


def _same(a: object, b: object, close: float) -> None:
    if is_dataclass(a):
        assert type(a) is type(b)
        for f in fields(a):
            _same(getattr(a, f.name), getattr(b, f.name), close)
    elif isinstance(a, np.ndarray):
        np.testing.assert_allclose(
            np.asarray(b), a, rtol=close, atol=1e3 * close * np.finfo(float).eps
        )
    elif isinstance(a, str):
        assert a == b or close > 0  # a reason tells rounded numbers
    elif isinstance(a, tuple | list):
        assert isinstance(b, tuple | list)
        for x, y in zip(a, b, strict=True):
            _same(x, y, close)
    elif isinstance(a, dict):
        assert isinstance(b, dict)
        _same(list(a.items()), list(b.items()), close)
    else:
        assert a == pytest.approx(b, rel=max(close, 1e-15))


def test_a_deck_that_needs_no_change_is_delivered_as_it_is(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, AUTO + FEW, ambient=False)
    (tmp_path / "deck" / "frame.bdf").write_text(small_study.deck(small_study.TRUTH))
    run = run_study(study)
    assert run.results["localise"].proposal.members == ()
    assert run.results["update"].sets[0].parameters == ()
    assert run.results["final"].changes == ()
    assert any(
        "nothing is proposed, and the deck is delivered as it is" in line
        for line in run_messages(run.results)
    )
    deliver(run)
