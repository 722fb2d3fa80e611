"""Predictions with bands: modes, an unbalance run-up against closed form, forces in springs, the
command.

A Jeffcott rotor: a mass M on a spring k across its axis, unbalance U = m e turning at ω:

    x = U ω² / (k − M ω² + 2iζ √(kM) ω),   force in the spring = k x.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_study import FULL, write_study

from ringtrue.cli.main import run
from ringtrue.cli.study import settings
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, InputError
from ringtrue.io.modes import write_modes
from ringtrue.model.edit import apply_factors
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.dense_models import DenseModel
from ringtrue.report.build import deliver
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config_sections import PredictSection
from ringtrue.study.messages import validity_sentence
from ringtrue.study.opened import Opened
from ringtrue.study.results import DampedModes
from ringtrue.study.run import run_study
from ringtrue.study.stages.predict import _forces, scatter
from ringtrue.updating.prediction import (
    Bands,
    Damping,
    KnownModel,
    Output,
    RegionDamping,
    Rows,
    RunUp,
    Unbalance,
    bands,
    plane,
    run_up,
    unbalance_load,
    validated_band,
)

K, M, ZETA = 4e6, 100.0, 0.02
F1 = float(np.sqrt(K / M) / (2 * np.pi))
NAMES = ParameterSet((Parameter("k", (), 0.2, 5.0, "log", 0.5),))
UNBALANCE = Unbalance(M, 6.3, 50.0)


def jeffcott() -> DenseModel:
    """Y and Z of the rotor; one factor on both springs."""
    return DenseModel.springs(K * np.eye(2), M * np.eye(2), K * np.eye(2)[None], NAMES)


def outputs() -> list[Output]:
    eye = np.eye(2)
    return [
        Output("rotor", "m", Rows(eye), 2),
        Output("spring", "N", Rows(K * eye, ((0, K * eye),)), 2),
    ]


def runs(
    draws: np.ndarray, freqs: np.ndarray, seed: int = 0, discrepancy: float = 0.0
) -> RunUp:
    damping, rng = (
        Damping(np.array([1.0]), np.array([ZETA])),
        np.random.default_rng(seed),
    )
    load = unbalance_load(freqs, np.eye(2), UNBALANCE)
    known = KnownModel(jeffcott(), np.zeros(1), draws, damping, discrepancy)
    return run_up(known, load, outputs(), rng)


def exact(factor: float, freqs: np.ndarray) -> np.ndarray:
    w, k = 2 * np.pi * freqs, factor * K
    u = M * 6.3e-3 / (2 * np.pi * 50.0)
    return np.sqrt(2) * np.abs(
        u * w**2 / (k - M * w**2 + 2j * ZETA * np.sqrt(k * M) * w)
    )  # both directions


def test_run_up_is_the_jeffcott_rotor() -> None:
    freqs = np.linspace(1, 100, 100)
    found = runs(np.zeros((20, 1)), freqs)
    np.testing.assert_allclose(found.nominal[0], exact(1.0, freqs), rtol=1e-9)
    np.testing.assert_allclose(found.nominal[1], K * exact(1.0, freqs), rtol=1e-9)
    np.testing.assert_allclose(found.amplitude.high, found.nominal, rtol=1e-9)


def test_force_grows_with_the_stiffness_of_its_spring() -> None:
    freqs = np.linspace(1, 100, 100)
    found = runs(np.full((20, 1), np.log(1.5)), freqs)
    np.testing.assert_allclose(
        found.amplitude.median[1], 1.5 * K * exact(1.5, freqs), rtol=1e-9
    )


def by_region(loss: float, std: float) -> RegionDamping:
    """A loss factor of the springs, a dashpot that is not there."""
    none = np.zeros((2, 2))
    matrices = np.array([K * np.eye(2), none])
    return RegionDamping(
        np.array([loss, 0.0]),
        np.diag([std**2, 0.0]),
        matrices,
        np.array([False, True]),
        (none, none),
    )


def test_bands_do_not_depend_on_stiff_vectors_of_the_basis() -> None:
    freqs = np.linspace(10, 60, 60)

    def found(size: int) -> Bands:
        k = np.diag([K, 2 * K, 1e6 * K][:size])
        model = DenseModel.springs(k, M * np.eye(size), k[None], NAMES)
        known = KnownModel(
            model, np.zeros(1), np.zeros((30, 1)), Damping(*[np.ones(1)] * 2), 0.05
        )
        load = unbalance_load(freqs, np.eye(size)[:, :2], UNBALANCE)
        rotor = Output("rotor", "m", Rows(np.eye(size)[:2]), 2)
        return run_up(known, load, [rotor], np.random.default_rng(0)).peak

    np.testing.assert_allclose(found(3).high, found(2).high, rtol=1e-9)
    np.testing.assert_allclose(found(3).low, found(2).low, rtol=1e-9)


def test_a_loss_factor_of_the_springs_is_twice_the_ratio() -> None:
    """At every stiffness of the spring: η K of the nominal spring is a ratio of η K/2λM."""
    lam, y = np.array([K / M, 2 * K / M]), np.eye(2) / np.sqrt(M)
    np.testing.assert_allclose(
        by_region(2 * ZETA, 0.0).drawn(None)(lam, y), [ZETA, ZETA / 2]
    )
    freqs = np.linspace(1, 100, 100)
    known = KnownModel(
        jeffcott(), np.zeros(1), np.zeros((20, 1)), by_region(2 * ZETA, 0.0)
    )
    load = unbalance_load(freqs, np.eye(2), UNBALANCE)
    found = run_up(known, load, outputs(), np.random.default_rng(0))
    np.testing.assert_allclose(found.nominal[0], exact(1.0, freqs), rtol=1e-9)


def test_a_dashpot_gives_c_over_twice_the_frequency() -> None:
    none, c = np.zeros((1, 1)), 300.0
    one = RegionDamping(
        np.array([c]), none, np.ones((1, 1, 1)), np.array([True]), (none, none)
    )
    w = np.sqrt(K / M)
    ratio = one.drawn(None)(np.array([w**2]), np.array([[1 / np.sqrt(M)]]))
    np.testing.assert_allclose(ratio, c / (2 * M * w))


def test_drawn_damping_scatters_as_told_and_is_never_negative() -> None:
    rng, lam, y = (
        np.random.default_rng(3),
        np.array([K / M]),
        np.array([[1.0], [0.0]]) / np.sqrt(M),
    )
    small = np.array(
        [by_region(2 * ZETA, 0.004).drawn(rng)(lam, y)[0] for _ in range(2000)]
    )
    assert small.mean() == pytest.approx(ZETA, rel=0.01)
    assert small.std() == pytest.approx(0.002, rel=0.06)
    wide = np.array(
        [by_region(2 * ZETA, 0.1).drawn(rng)(lam, y)[0] for _ in range(200)]
    )
    assert wide.min() == 0.0


def test_each_mode_has_a_damping_of_its_own_beside_that_of_the_regions() -> None:
    rng, lam, y = (
        np.random.default_rng(4),
        np.array([K / M, 2 * K / M]),
        np.eye(2) / np.sqrt(M),
    )
    one = replace(by_region(2 * ZETA, 0.0), scatter=0.2)
    drawn = np.log([one.drawn(rng)(lam, y) for _ in range(2000)]) - np.log(
        [ZETA, ZETA / 2]
    )
    np.testing.assert_allclose(drawn.std(axis=0), 0.2, rtol=0.06)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.08  # 2000 draws: 0.02
    np.testing.assert_allclose(one.drawn(None)(lam, y), [ZETA, ZETA / 2])


@pytest.mark.parametrize(
    ("own", "least", "most"), [(0.0, 0.0, 0.05), (0.3, 0.25, 0.35)]
)
def test_scatter_of_damping_is_what_errors_of_test_and_regions_do_not_explain(
    own: float, least: float, most: float
) -> None:
    rng, n = np.random.default_rng(5), 400
    error, at = 0.1, np.full(n, 0.02)
    measured = at * np.exp(np.hypot(own, error) * rng.standard_normal(n))
    none = np.zeros(n)
    modes = DampedModes(
        none,
        ("",) * n,
        none == 0,
        none,
        measured,
        error * measured,
        at,
        at,
        none,
        none,
        none,
    )
    assert least <= scatter(modes) <= most


def test_bands_hold_what_a_machine_of_the_same_kind_does() -> None:
    """90 % of new machines drawn from the posterior lie in the band at each speed."""
    rng, freqs = np.random.default_rng(1), np.linspace(5, 100, 60)
    found = runs(0.1 * rng.standard_normal((2000, 1)), freqs)
    new = np.array(
        [exact(float(np.exp(0.1 * z)), freqs) for z in rng.standard_normal(2000)]
    )
    low, high = found.amplitude.low[0], found.amplitude.high[0]
    assert ((low <= new) & (new <= high)).mean() == pytest.approx(
        0.9, abs=0.03
    )  # 2000 draws each: 1 %
    assert found.peak_speed.low[0] < F1 < found.peak_speed.high[0]


def test_discrepancy_widens_the_peak_though_the_parameters_are_known() -> None:
    freqs = np.linspace(0.5 * F1, 2 * F1, 301)
    sharp, wide = (runs(np.zeros((200, 1)), freqs, discrepancy=d) for d in (0.0, 0.02))
    spread = wide.peak_speed.high[0] - wide.peak_speed.low[0]
    assert spread > 3 * (sharp.peak_speed.high[0] - sharp.peak_speed.low[0])
    assert spread == pytest.approx(
        2 * 1.645 * 0.02 * F1, rel=0.5
    )  # the first of two equal modes peaks higher


def test_validated_band_ends_before_the_first_mode_that_is_not_held() -> None:
    f = np.array([9.0, 3.0, 20.0, 14.0])
    assert validated_band(f, np.array([True, True, True, False])) == (3.0, 9.0)
    assert validated_band(f, np.ones(4, dtype=bool)) == (3.0, 20.0)
    assert validated_band(f, np.array([True, False, True, True])) == (0.0, 0.0)
    assert "nowhere" in validity_sentence((0.0, 0.0))
    assert "from 3 to 9 Hz" in validity_sentence((3.0, 9.0))


DECK = """SOL 103
CEND
SPC = 1
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,0.,0.,1.
CBUSH,1,58,2,1,,,,0
CBUSH,2,60,1,,,,,0
PBUSH,58,K,2.+6,3.+6,4.+6
PBUSH,60,K,1.+6,1.+6,5.+5
CONM2,3,2,,10.
CONM2,4,1,,20.
SPC1,1,456,1,2
ENDDATA
"""


def test_forces_in_springs_of_a_deck(tmp_path: Path) -> None:
    """A unit force on the upper mass passes through both springs in series, down to the ground."""
    (tmp_path / "two.bdf").write_text(DECK)
    opened = Opened(read_deck(tmp_path / "two.bdf"), 1.0)
    names = ParameterSet((Parameter("b", (CardField("PBUSH", 58, "K1"),), 0.5, 2.0),))
    system = opened.analysis.system
    v = np.eye(system.stiffness.shape[0])
    top = np.asarray(system.transform.T @ (system.dofs.key == 2 * 8 + 1).astype(float))
    x = np.linalg.solve(system.stiffness.toarray(), top)
    for name, pid in (("bearing", 58), ("support", 60)):
        each, along, across, _ = _forces(opened, names, name, [pid], v)
        at = np.ones(1)
        np.testing.assert_allclose(each.rows.at(at) @ x, [1, 0, 0], atol=1e-9)
        np.testing.assert_allclose(along.rows.at(at) @ x, [1.0], rtol=1e-9)
        np.testing.assert_allclose(across.rows.at(at) @ x, [0.0], atol=1e-9)
    each = _forces(opened, names, "bearing", [58], v)[0]
    np.testing.assert_allclose(
        each.rows.at(np.array([1.5])) @ x, [1.5, 0, 0], atol=1e-9
    )
    with pytest.raises(ConfigError, match="no CBUSH with PBUSH"):
        _forces(opened, names, "bearing", [59], v)


def test_options_stand_in_place_of_the_study() -> None:
    section = PredictSection(rotor=7, mass=10.0, grade=2.5)
    got = settings(section, {"grade": 6.3, "rotor": None}, ["bearings=58,59"])
    assert (got.rotor, got.grade, got.springs) == (7, 6.3, {"bearings": [58, 59]})
    with pytest.raises(ConfigError, match="--rotor"):
        settings(None, {"mass": 1.0}, [])
    with pytest.raises(ConfigError, match="NAME=PID"):
        settings(section, {}, ["bearings"])


def test_a_study_that_was_not_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "two.bdf").write_text(DECK)
    (tmp_path / "study.toml").write_text(
        '[model]\ndeck = "two.bdf"\n[predict]\nrotor = 2\nmass = 10.0\n'
    )
    assert run(["predict", str(tmp_path / "study.toml")]) == 2
    assert "run the study to its final stage" in capsys.readouterr().err


def test_command_on_a_finished_study(tmp_path: Path) -> None:
    """An unbalanced machine on the top floor of the small study: the response peaks at the first
    sway modes.
    """
    study = write_study(tmp_path)
    run_study(study)
    result = tmp_path / "p.json"
    options = [
        "--rotor",
        "305",
        "--mass",
        "500",
        "--axis",
        "Z",
        "--to",
        "20",
        "--draws",
        "20",
    ]
    assert (
        run(
            [
                "predict",
                str(study),
                *options,
                "--csv",
                str(tmp_path / "p.csv"),
                "--json",
                str(result),
            ]
        )
        == 0
    )
    told = json.loads(result.read_text())
    low, high = told["validated_hz"]
    assert 1.0 < low < 2.0
    assert 10.0 < high < 20.0
    (rotor,) = told["outputs"]
    assert rotor["peak"][0] < rotor["peak"][1] < rotor["peak"][2]
    assert low < rotor["peak_speed_hz"][1] < 2.0
    sheet = np.genfromtxt(tmp_path / "p.csv", delimiter=",", skip_header=1)
    assert sheet.shape == (800, 5)
    assert (sheet[:, 2] <= sheet[:, 4]).all()
    assert set(sheet[sheet[:, 0] > high, 1]) == {0.0}


PREDICT = """[predict]
rotor = 305
mass = 500.0
axis = "Z"
fmax = 20.0
lines = 50
draws = 20
"""


def test_the_stage_of_a_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """[predict] makes it a stage: stored, shown by the command, in summary and report."""
    study = write_study(tmp_path, FULL + PREDICT)
    ran = run_study(study)
    found = ran.results["predict"]
    assert found.residual < 0.02
    assert found.damping.startswith("loss factors and dashpots by region")
    assert found.run_up.freqs.size == 50
    assert run(["predict", str(study), "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outputs"][0]["median"] == found.run_up.amplitude.median[0].tolist()
    assert "predict" in run_study(study).loaded
    assert (
        run(["predict", str(study), "--seed", "5", "--json", "-"]) == 0
    )  # an option: computed, not stored
    other = json.loads(capsys.readouterr().out)["outputs"][0]
    # the upper end of a band of 20 draws is that of one of them
    low_and_median = slice(2)
    np.testing.assert_allclose(
        other["peak"][low_and_median],
        told["outputs"][0]["peak"][low_and_median],
        rtol=0.3,
    )
    assert other["peak"] != told["outputs"][0]["peak"]
    page = deliver(ran).read_text()
    assert '<section id="prediction">' in page
    assert {"name", "unit", "band"} == set(
        json.loads((tmp_path / "summary.json").read_text())["prediction"]["peaks"][0]
    )


def test_a_rotor_that_is_not_in_the_deck_is_told_before_anything_is_computed(
    tmp_path: Path,
) -> None:
    study = write_study(tmp_path, FULL + PREDICT.replace("305", "999"))
    with pytest.raises(ConfigError, match="rotor node 999"):
        run_study(study)
    assert not (tmp_path / "study.h5").exists()


def test_input_is_checked() -> None:
    with pytest.raises(ConfigError, match="axis"):
        plane("W")
    with pytest.raises(InputError, match="draws"):
        bands(np.zeros((5, 2)), 0.9)
    with pytest.raises(ConfigError, match="unbalance"):
        Unbalance(0.0, 2.5, 50.0)


CHAIN = """SOL 103
CEND
SPC = 1
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,0.,0.,1.
GRID,3,,0.,0.,2.
CBUSH,1,51,1,,,,,0
CBUSH,2,52,2,1,,,,0
CBUSH,3,53,3,2,,,,0
PBUSH,51,K,1.+6,1.3+6,3.+6
PBUSH,52,K,2.+6,2.3+6,4.+6
PBUSH,53,K,3.+6,2.8+6,5.+6
CONM2,4,1,,40.
CONM2,5,2,,30.
CONM2,6,3,,20.
SPC1,1,456,1,2,3
ENDDATA
"""


@pytest.mark.parametrize(("units", "length"), [("SI", 1.0), ("mm-t-s", 1000.0)])
def test_forces_stand_with_the_unbalance_however_the_springs_were_updated(
    tmp_path: Path, units: str, length: float
) -> None:
    """Far below the first mode every spring of a chain passes on the whole force, U w^2, at any
    stiffness.
    """
    chain = CHAIN.replace("0.,1.", f"0.,{length}").replace("0.,2.", f"0.,{2 * length}")
    if units == "mm-t-s":  # N/mm and t
        chain = re.sub(r"(\d\.)\+6|(\d\.\d)\+6", lambda m: f"{(m[1] or m[2])}+3", chain)
        chain = re.sub(
            r"(CONM2,\d,\d,,)(\d+)\.", lambda m: f"{m[1]}{float(m[2]) / 1000}", chain
        )
    (tmp_path / "chain.bdf").write_text(chain)
    found = {51: 1.0, 52: 0.6, 53: 1.5}
    springs = [
        Parameter(
            str(k),
            tuple(CardField("PBUSH", k, f) for f in ("K1", "K2", "K3")),
            0.2,
            5.0,
        )
        for k in found
    ]
    built = apply_factors(
        read_deck(tmp_path / "chain.bdf"),
        ParameterSet(tuple(springs)),
        np.array([*found.values()]),
    )
    with EmbeddedSolver().open(built) as analysis:
        modes = replace(
            analysis.modes(ModesRequest(count=9)).modes, damping=np.full(9, ZETA)
        )
        write_modes(
            tmp_path / "test.json",
            modes.rows([d for d in modes.channels if d[1:3] in ("+X", "+Y", "+Z")]),
        )
    sheet = "point,x,y,z,direction,channel,quantity,unit\n"
    sheet += "".join(
        f"{n},0,0,{n - 1},+{a},{n}+{a},acceleration,m/s^2\n"
        for n in (1, 2, 3)
        for a in "XYZ"
    )
    (tmp_path / "sensors.csv").write_text(sheet)
    text = f'[model]\ndeck = "chain.bdf"\nunits = "{units}"\nfmax = 200.0\n'
    text += '[test]\nsheet = "sensors.csv"\nmodes = "test.json"\n'
    text += "[update]\nleft_out = 0\nchoose = 2\n"
    for k in found:
        text += (
            f'[[candidate]]\nname = "spring {k}"\ntargets = ["PBUSH {k} K1,K2,K3"]\n'
        )
    text += '[predict]\nrotor = 3\nmass = 20.0\naxis = "Z"\nlines = 60\ndraws = 20\n[predict.springs]\n'
    (tmp_path / "study.toml").write_text(
        text + "".join(f"s{k} = [{k}]\n" for k in found)
    )
    results = run_study(tmp_path / "study.toml").results
    run, best = (
        results["predict"].run_up,
        results["update"].sets[results["update"].chosen],
    )
    assert (
        best.parameters[0] != "spring 51"
    )  # positions in the set are not those among the candidates
    force = Unbalance(20.0, 2.5, 50.0).force(run.freqs[:1])[0]
    for k in found:
        for axis in "XY":
            at = run.names.index(f"s{k}, sum along {axis}")
            # inertia: (1 Hz / 16 Hz)^2
            assert run.nominal[at, 0] == pytest.approx(force, rel=0.01)
            assert run.amplitude.median[at, 0] == pytest.approx(force, rel=0.03)


def test_a_peak_is_checked_where_the_whole_band_of_its_speed_is() -> None:
    """The median of the second lies inside, the band of the third too, but not its low end."""
    one = np.ones(3)
    speed = Bands(
        np.array([20.0, 35.0, 4.0]),
        np.array([25.0, 38.0, 30.0]),
        np.array([30.0, 61.0, 35.0]),
        0.9,
    )
    found = RunUp(
        freqs=np.arange(1.0, 100.0),
        names=("a", "b", "c"),
        units=("N",) * 3,
        nominal=np.ones((3, 99)),
        amplitude=Bands(*(np.ones((3, 99)),) * 3, 0.9),
        peak=Bands(one, one, one, 0.9),
        peak_speed=speed,
        validated=(5.0, 41.0),
    )
    assert found.checked_peaks.tolist() == [True, False, False]
