"""One parameter set over two configurations: the small frame as it is, and with a known mass on its
top floor.

A factor on all moduli and one on all densities change the frequencies f² ~ E/rho of the bare frame
alike: its test tells their ratio alone, and the prior shares it out. A known mass that is added
tells the scale:

    bare:   f² ~ E / (rho V)          loaded:   f² ~ E / (rho V + m)
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
import small_study

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError
from ringtrue.io.modes import write_modes
from ringtrue.report.build import deliver
from ringtrue.study.acceptance import missed_words, verdict
from ringtrue.study.config import parse_config
from ringtrue.study.run import StudyRun, load_study, run_study

TRUTH = {"stiffness": 0.75, "density": 0.9}
CORNERS = [small_study.node(3, i, j) for i, j in small_study.CORNERS]
MASS = "".join(f"CONM2,{9000 + k},{n},,800.0\n" for k, n in enumerate(CORNERS))
LOADED = '\n[[configuration]]\nname = "loaded"\ncards = "deck/mass.bdf"\nsheet = "loaded/sensors.csv"\n'
LOADED += 'log = "loaded/campaign.json"\nleft_out = 2\n'
OWN = (
    '\n[[configuration]]\nname = "loaded"\ndeck = "deck/loaded.bdf"\nmodes = '
    '"loaded.json"\nleft_out = 1\n'
)
PLAIN = small_study.MODEL + small_study.TEST + small_study.SETTINGS + small_study.WHOLE


def truth(e: float, rho: float, *, loaded: bool) -> str:
    text = small_study.deck(dict.fromkeys((1, 2, 3), e)).replace("3.+10", f"{3 * e}+10")
    text = text.replace("2500.0", f"{2500 * rho}").replace("7850.0", f"{7850 * rho}")
    return text.replace("ENDDATA", MASS + "ENDDATA") if loaded else text


def folder(
    at: Path, toml: str, e: float = TRUTH["stiffness"], rho: float = TRUTH["density"]
) -> Path:
    """The study with the records of both configurations, and the modes of the loaded one as a
    file.
    """
    (at / "deck").mkdir()
    (at / "deck/frame.bdf").write_text(small_study.deck())
    (at / "deck/mass.bdf").write_text(MASS)
    (at / "deck/loaded.bdf").write_text(
        small_study.deck().replace("ENDDATA", MASS + "ENDDATA")
    )
    small_study.write_data(
        at / "data", ambient=False, truth=truth(e, rho, loaded=False)
    )
    small_study.write_data(
        at / "loaded", ambient=False, truth=truth(e, rho, loaded=True)
    )
    (at / "truth.bdf").write_text(truth(e, rho, loaded=True))
    seen = small_study.measured_modes(at / "truth.bdf", small_study.FMAX)
    write_modes(at / "loaded.json", seen)
    (at / "study.toml").write_text(toml)
    return at / "study.toml"


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    run = run_study(
        folder(
            tmp_path_factory.mktemp("both"),
            PLAIN + LOADED + "[uncertainty]\nfolds = 3\nsamples = 160\n",
        )
    )
    deliver(run)
    return run


def errors(run: StudyRun) -> dict[str, float]:
    done = run.results["update"]
    best = done.sets[done.chosen]
    assert best.outcome.startswith("converged")
    found = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    return {
        name: abs(found.get(name, 1.0) / value - 1) for name, value in TRUTH.items()
    }


def test_both_parameters_are_found_and_from_one_configuration_they_are_not(
    both: StudyRun, tmp_path: Path
) -> None:
    alone = errors(run_study(folder(tmp_path, PLAIN), until="final"))
    together = errors(both)
    # the objective allows 1 % of a frequency, so that the prior still pulls; alone one is held at
    # the deck's value, as the data cannot tell the two apart, and the other takes up the error of
    # both
    assert max(together.values()) < 0.003
    assert min(alone.values()) > 0.1


def test_the_intervals_know_of_both_tests(both: StudyRun) -> None:
    found = both.results["uncertainty"]
    truth = np.array([TRUTH[n] for n in found.posterior.parameters.names])
    assert (
        found.posterior.ratio < 0.05
    ).all()  # alone the sum of the two would keep its prior: 0.7 each
    assert (np.abs(found.posterior.factor / truth - 1) < 4 * found.posterior.std).all()


def test_the_proposal_rests_on_both_tests(both: StudyRun) -> None:
    found = both.results["localise"]
    assert found.proposal_basis == "the test of loaded"
    assert {m.name for m in found.proposal.members} == set(TRUTH)
    for m in found.proposal.members:
        assert m.factor == pytest.approx(TRUTH[m.name], rel=0.02)
        assert not m.named[1:]
    page = (both.folder / "report.html").read_text(encoding="utf-8")
    assert "The proposal rests on the test of loaded, too." in page


def test_damping_is_fitted_to_both_tests(both: StudyRun) -> None:
    d = both.results["damping"]
    (other,) = d.others
    assert other.name == "loaded"
    assert (~other.modes.used).sum() == 2
    for modes in (d.modes, other.modes):  # the truth has one ratio in all modes of both
        assert modes.spread(True)[1] < 0.1
    np.testing.assert_allclose(
        d.regions.coefficients, 2 * small_study.DAMPING, rtol=0.2
    )
    told = json.loads((both.folder / "summary.json").read_text())["damping"][
        "configurations"
    ]
    assert [t["name"] for t in told] == ["loaded"]
    assert "Damping of the modes: loaded" in (both.folder / "report.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize(
    ("e", "rho", "wrong"), [(1.0, 0.8, "density"), (0.8, 1.0, "stiffness")]
)
def test_one_wrong_parameter_is_chosen_by_both_tests(
    tmp_path: Path, e: float, rho: float, wrong: str
) -> None:
    toml = (
        PLAIN.replace("[update]", "[update]\nchoose = 1") + LOADED
    )  # the bare frame cannot say which of the two
    run = run_study(folder(tmp_path, toml, e, rho), until="update")
    assert run.results["sensitivity"].sets["best subset"] == (wrong,)
    done = run.results["update"]
    best = done.sets[done.chosen]
    assert best.parameters == (wrong,)
    assert best.factor[0] == pytest.approx(0.8, rel=2e-3)


def test_each_configuration_has_its_table_before_and_after(both: StudyRun) -> None:
    summary = json.loads((both.folder / "summary.json").read_text())
    (found,) = summary["configurations"]
    assert found["name"] == "loaded"
    assert found["carries"] == ["stiffness", "density"]
    for key in ("initial", "final"):
        assert len(found[key]["pairs"]) == 9
        assert sum(not p["used"] for p in found[key]["pairs"]) == 2
    assert found["initial"]["mean_deviation_percent"] > 5
    assert found["final"]["max_deviation_percent"] < 0.3
    page = (both.folder / "report.html").read_text(encoding="utf-8")
    assert 'id="configurations"' in page
    assert "loaded: the delivered deck against its test." in page


def test_stated_limits_hold_for_every_delivered_deck(both: StudyRun) -> None:
    strict = both.config.model_validate(
        both.config.model_dump() | {"correlate": {"accept_percent": 1e-4}}
    )
    said = missed_words(strict, both.results)
    tables = both.results["final"].table, both.results["configured"].items[0].table
    assert len(said) == sum(
        int((np.abs(t.deviation_percent) > 1e-4).sum()) for t in tables
    )
    assert sum(s.startswith("loaded: test mode") for s in said) > 0
    assert [
        c.held
        for c in verdict(both.config, both.results)
        if c.name.startswith("loaded")
    ] == [True]


def test_every_deck_that_has_the_field_is_written(both: StudyRun) -> None:
    update = both.results["update"]
    best = update.sets[update.chosen]
    factor = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    folders = (both.folder / "updated", both.folder / "configurations/loaded/updated")
    for model in (read_deck(f / "frame.bdf") for f in folders):
        m = model["MAT1"]
        # eight characters of a free field
        np.testing.assert_allclose(
            m["E"][m.find(np.array([1, 2, 3]))], 2.0e11 * factor["stiffness"], rtol=1e-6
        )
        np.testing.assert_allclose(
            m["RHO"][m.find(np.array([10]))], 2500 * factor["density"], rtol=1e-6
        )
    assert len(read_deck(folders[1] / "frame.bdf")["CONM2"]) == 4
    assert (both.folder / "deck/frame.bdf").read_text() == small_study.deck()


def test_a_second_run_resumes_and_the_store_holds_the_tables(both: StudyRun) -> None:
    again = run_study(both.folder / "study.toml")
    assert not set(both.timings) - set(again.loaded)
    stored = load_study(both.folder / "study.h5").results
    for stage in ("configurations", "configured"):
        (a,), (b,) = both.results[stage].items, stored[stage].items
        assert a.name == b.name == "loaded"
    np.testing.assert_array_equal(
        both.results["configured"].items[0].table.fe_hz,
        stored["configured"].items[0].table.fe_hz,
    )


def test_a_deck_of_its_own_and_a_file_of_modes(both: StudyRun, tmp_path: Path) -> None:
    study = folder(tmp_path, PLAIN + OWN)
    run = run_study(study, until="configured")
    assert max(errors(run).values()) < 0.01
    (item,) = run.results["configured"].items
    assert (~item.table.used).sum() == 1
    assert item.table.max_deviation() < 0.3
    assert (
        both.results["configurations"].items[0].source
        != run.results["configurations"].items[0].source
    )


def test_where_a_deck_differs_is_said(tmp_path: Path) -> None:
    study = folder(tmp_path, PLAIN + OWN)
    deck = tmp_path / "deck/loaded.bdf"
    text = deck.read_text().replace(
        "MAT1,10,3.+10,,0.2,2500.0", "MAT1,10,3.+10,,0.2,2250.0"
    )
    deck.write_text(
        text.replace("MAT1,3,", "MAT1,53,").replace("PBEAM,3,3,", "PBEAM,3,53,")
    )
    run = run_study(study, until="configurations")
    (item,) = run.results["configurations"].items
    assert item.notes == (
        "its deck has 3 of the 4 fields of stiffness",
        "its deck has 3 of the 4 fields of density",
        "MAT1 10 RHO is 2250 here and 2500 in the deck of the study",
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('cards = "deck/mass.bdf"\n', "", "a deck of its own or cards"),
        ('log = "loaded/campaign.json"\n', "", "a sheet and a log, or a file of modes"),
        ('sheet = "loaded/sensors.csv"\n', "", "a sheet and a log, or a file of modes"),
        ('name = "loaded"', 'name = "../out"', "it names a folder"),
        ('name = "loaded"', 'nmae = "loaded"', "did you mean 'name'"),
    ],
)
def test_what_is_missing_is_told(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_config((PLAIN + LOADED).replace(old, new), tmp_path / "study.toml")


def test_a_deck_that_carries_nothing_is_refused(tmp_path: Path) -> None:
    study = folder(tmp_path, PLAIN + OWN)
    text = (tmp_path / "deck/loaded.bdf").read_text()
    for k in (1, 2, 3, 10):
        text = text.replace(f"MAT1,{k},", f"MAT1,{k + 50},").replace(
            f"PBEAM,{k},{k},", f"PBEAM,{k},{k + 50},"
        )
    (tmp_path / "deck/loaded.bdf").write_text(
        text.replace("PSHELL,10,10,0.1,10,3.0,10", "PSHELL,10,60,0.1,60,3.0,60")
    )
    with pytest.raises(ConfigError, match="its deck has no card of a candidate"):
        run_study(study, until="configurations")


def test_a_suspension_is_tuned_to_the_rigid_body_modes_of_both_tests(
    tmp_path: Path,
) -> None:
    """All moduli and all densities play the suspension; two sways and a torsion lie below 3 Hz in
    each test.
    """
    sure = small_study.SETTINGS.replace("[identify]", "[identify]\nconfidence = 0.4")
    toml = (
        small_study.MODEL + small_study.TEST + sure + "[correlate]\nrigid_below = 3.0\n"
    )
    toml += small_study.WHOLE.replace("[[candidate]]", "[[suspension]]")
    study = folder(tmp_path, toml)
    small_study.write_data(tmp_path / "data", truth=truth(0.75, 0.9, loaded=False))
    found = []
    for more, until in (("", "tune"), (OWN, "configured")):
        study.write_text(toml + more)
        run = run_study(study, until=until)
        tune = run.results["tune"]
        found.append(
            max(abs(tune.factors[n] / value - 1) for n, value in TRUTH.items())
        )
    assert found[0] > 0.1  # their ratio alone
    assert found[1] < 0.02
    assert max(tune.std.values()) < 0.05
    (other,) = tune.others
    assert len(other.after) == 3
    assert other.after.max_deviation() < 0.5 < 5 < other.before.max_deviation()
    deliver(run)
    told = json.loads((run.folder / "summary.json").read_text())[
        "suspension_configurations"
    ]
    assert [len(t["after"]) for t in told] == [3]
    assert "loaded: rigid-body modes after tuning." in (
        run.folder / "report.html"
    ).read_text(encoding="utf-8")
    (deck,) = run.results["configured"].items
    assert any("MAT1 10 RHO" in c for c in deck.changes)
