"""The virtual test: a string on which the answer is known, the test sheet, and `ringtrue plan` on a
small frame.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff
import small_study

import ringtrue as rt
from ringtrue.cli.main import run
from ringtrue.cli.plan import numbers
from ringtrue.core.modes import ModalModel, ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, DataError, InputError
from ringtrue.fem.response import frf
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.io.uff.functions import write_test_model
from ringtrue.planning.exciters import ambient_std
from ringtrue.planning.plan_files import PlannedExcitation, reach_of, write_test_sheet
from ringtrue.planning.virtual_test import (
    AmbientConditions,
    Conditions,
    Planned,
    background_density,
    fitting_hammer,
    measured,
    modal_model,
    rarely_found_modes,
    simulate_ambient_test,
    simulate_impact_test,
    trials,
)
from ringtrue.study.run import run_study
from ringtrue.virtual.sensors import ACCELEROMETER, ICP

MODES, POINTS = 6, 19
F = 8.0 * np.arange(1, MODES + 1)  # Hz, of a string of 50 kg
S = np.arange(1, POINTS + 1) / (POINTS + 1)
PHI = np.sqrt(2 / 50) * np.sin(np.pi * np.outer(S, np.arange(1, MODES + 1)))
NAMES = tuple(f"{k + 1}+Z" for k in range(POINTS))


def planned(struck: tuple[int, ...], fmax: float = 36.0) -> Planned:
    return Planned(
        F, PHI, PHI[list(struck)], NAMES, tuple(NAMES[k] for k in struck), 4.0, fmax
    )


def test_the_model_is_that_of_modal_superposition() -> None:
    plan = planned((3, 6))
    zeta = np.linspace(0.01, 0.03, MODES)
    freqs = np.linspace(1.0, 60.0, 40)
    got = modal_model(plan, F, zeta).synthesise(freqs)
    want = frf(freqs, F, zeta, PHI, PHI[[3, 6]], "accelerance")
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)
    # a rigid-body mode is a mass: accelerance φφ
    free = replace(plan, frequencies=np.array([0.0, *F[1:]]))
    low = modal_model(free, free.frequencies, zeta).synthesise(np.array([1e-3]))[
        0, 0, 0
    ]
    assert low == pytest.approx(PHI[0, 0] * PHI[3, 0], rel=1e-3)


def test_the_hammer_fits_the_sensors() -> None:
    """The recorded accelerations fill between a tenth and all of the range, and nothing clips."""
    plan = planned((3, 6))
    model = modal_model(plan, F, np.full(MODES, 0.01))
    hammer = fitting_hammer(model, plan.fmax, ICP)
    # the first zero of the spectrum is beyond the band
    assert hammer.contact[1] * plan.fmax < 1.5
    assert np.exp(-0.01 * 2 * np.pi * F[0] * hammer.block) == pytest.approx(
        0.01, rel=1e-3
    )
    heavy = fitting_hammer(replace(model, shapes=model.shapes / 4), plan.fmax, ICP)
    assert heavy.peak[1] == pytest.approx(4 * hammer.peak[1])
    frfs = measured(
        model, hammer, Conditions(), 3.2 * plan.fmax, np.random.default_rng(0)
    )
    truth = model.synthesise(frfs.freqs[1:])
    assert frfs.data.shape[1:] == (POINTS, 2)
    assert frfs.driving_points() == [(3, 0), (6, 1)]
    peak = int(np.abs(truth[:, 6, 1]).argmax())
    # calibration errors of 1 % at most on either side; an exponential window widens the peak
    # between resonances the window does not matter
    at = np.abs(frfs.freqs[1:] - 12.0).argmin()
    np.testing.assert_allclose(
        np.abs(frfs.data[1 + at, 6, 1]), np.abs(truth[at, 6, 1]), rtol=0.05
    )
    assert 0 < peak < truth.shape[0]


@pytest.mark.parametrize(
    ("lost", "found"), [((0, 17, 18), True), (tuple(range(9)), False)]
)
def test_channels_that_a_virtual_test_leaves_out_count_as_not_seen(
    lost: tuple[int, ...], found: bool
) -> None:
    """Three near the supports carry little of any mode; half of the string carries half, which is
    no MAC of 80 %.
    """
    plan, kept = planned((3, 6)), [n for k, n in enumerate(NAMES) if k not in lost]

    def find(model: ModalModel, _: np.random.Generator) -> ModeSet:
        return ModeSet(model.frequencies, model.damping, PHI, NAMES).rows(kept[::-1])

    told = trials(plan, Conditions(trials=2), find, np.random.default_rng(0), force=1.0)
    assert told.found.tolist() == [float(found)] * 4


def test_soft_suspensions_do_not_lengthen_the_block() -> None:
    """Modes on bungees far below the band are mass lines: no crew waits until they have come to
    rest.
    """
    plan, zeta = planned((3, 6)), np.full(MODES, 0.01)
    hung = replace(plan, frequencies=np.array([0.05 * plan.fmin, *F[1:]]))
    free = replace(plan, frequencies=np.array([0.0, *F[1:]]))
    block = fitting_hammer(
        modal_model(hung, hung.frequencies, zeta), plan.fmax, ICP
    ).block
    assert (
        block
        == fitting_hammer(
            modal_model(free, free.frequencies, zeta), plan.fmax, ICP
        ).block
    )


def test_a_good_plan_finds_all_modes_and_a_node_loses_its_mode() -> None:
    """Struck at the middle, the string hides its even modes; elsewhere all are found, close to the
    truth.
    """
    rng = np.random.default_rng(1)
    good = simulate_impact_test(planned((3, 6)), Conditions(trials=3), rng)
    assert (good.found == 1).all()
    # three of three, one-sided 95 %
    np.testing.assert_allclose(good.at_least, 0.05 ** (1 / 3))
    assert np.abs(good.frequency_bias).max() < 1e-3
    assert np.abs(good.damping_bias).max() < 0.05
    assert good.mac.min() > 0.99
    assert good.invented < 0.5
    poor = simulate_impact_test(planned((9,)), Conditions(trials=3), rng)
    assert poor.found.tolist() == [1, 0, 1, 0]
    assert poor.at_least[1] == 0
    assert np.isnan(poor.mac[1])
    words = rarely_found_modes(poor, ["1", "2", "3", "4"])
    assert [w.split(" is ")[0] for w in words] == ["mode 2 at 16 Hz", "mode 4 at 32 Hz"]


def test_a_light_structure_is_struck_with_a_small_hammer() -> None:
    """A thousandth of the mass, a thousandth of the force: the noise of the force cell does not
    drown the blows.
    """
    heavy, rng = planned((3, 6)), np.random.default_rng(6)
    light = replace(
        heavy, outputs=heavy.outputs * 1000**0.5, inputs=heavy.inputs * 1000**0.5
    )
    found = simulate_impact_test(light, Conditions(trials=2), rng)
    assert found.force < 20  # N, far below the smallest hammer's range
    assert (found.found == 1).all()
    assert np.abs(found.damping_bias).max() < 0.05


def test_noise_makes_what_is_found_worse() -> None:
    plan, seed = planned((3,), 20.0), 2
    quiet = simulate_impact_test(
        plan, Conditions(trials=4), np.random.default_rng(seed)
    )
    loud = simulate_impact_test(
        plan, Conditions(trials=4, background=2.0), np.random.default_rng(seed)
    )
    assert (loud.frequency_std > 2 * quiet.frequency_std).all()


@pytest.mark.parametrize("coherence", [0.98, 0.85])
def test_forces_in_the_background_leave_the_expected_coherence(
    coherence: float,
) -> None:
    """Noise over signal of the typical line as wanted; a coherence of 20 blows has an error √2(1 −
    γ²)/(γ√n).
    """
    plan = planned((3, 6))
    model = modal_model(plan, F, np.full(MODES, 0.01))
    hammer = fitting_hammer(model, plan.fmax, ICP, hits=20)
    rng, wanted = np.random.default_rng(3), Conditions(coherence=coherence)
    noise = replace(
        wanted,
        background=background_density(
            model, hammer, wanted, (plan.fmin, plan.fmax), rng
        ),
    )
    frfs = measured(model, hammer, noise, 3.2 * plan.fmax, rng)
    there = (frfs.freqs > plan.fmin) & (frfs.freqs < plan.fmax)
    ratio = 1 / np.median(frfs.coherence[there][:, [3, 6], [0, 1]]) - 1
    assert 0.7 < ratio / (1 / coherence - 1) < 1.4


def test_an_ambient_test_scatters_as_theory_foretells() -> None:
    """White forces along a string, five sensors: the floor of Gersch (1974) for the errors, as far
    as 24 tests tell.
    """
    plan = Planned(F, PHI[2::4], PHI, NAMES[2::4], NAMES, 4.0, 36.0)
    conditions = Conditions(trials=24, sensor=ACCELEROMETER)
    found = simulate_ambient_test(
        plan, AmbientConditions(600.0, 0.2), conditions, np.random.default_rng(2)
    )
    assert found.found.tolist() == [1.0] * 4
    assert found.invented < 0.2
    assert found.mac.min() > 0.99
    # one standard deviation by 24 tests is known to 15 %, the mean of four modes to 7 %
    for got, floor in zip(
        (found.frequency_std, found.damping_std),
        ambient_std(F[:4], 0.01, 600.0),
        strict=True,
    ):
        assert 0.8 < np.mean(got / floor) < 1.4
    quiet = simulate_ambient_test(
        plan,
        AmbientConditions(600.0, 1e-8),
        replace(conditions, trials=3),
        np.random.default_rng(2),
    )
    assert quiet.found.mean() < 0.5  # below the noise of the sensors
    with pytest.raises(InputError, match="above 0"):
        AmbientConditions(600.0, 0.0)


def test_the_same_seed_gives_the_same_answer() -> None:
    one, two = (
        simulate_impact_test(
            planned((3,), 12.0), Conditions(trials=2), np.random.default_rng(5)
        )
        for _ in range(2)
    )
    assert one.frequency_bias.tolist() == two.frequency_bias.tolist()


def test_bad_plans_are_refused() -> None:
    with pytest.raises(InputError, match="no mode between"):
        planned((3,), 5.0)
    with pytest.raises(InputError, match="0 references"):
        Planned(F, PHI, PHI[:0], NAMES, (), 4.0, 36.0)
    with pytest.raises(InputError, match="trials 0"):
        Conditions(trials=0)


def frame() -> TestModel:
    xyz = np.array([[0, 0, 0], [1.25, 0, 0], [1.25, 2, 0.5]])
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, 0, -1], [0, 0.6, 0.8]])
    names = ("11+X", "11+Z", "12-Z", "13+Zs")
    return TestModel(
        np.array([11, 12, 13]),
        xyz,
        names,
        np.array([11, 11, 12, 13]),
        axes,
        np.array([[11, 12], [12, 13]]),
    )


def test_the_sheet_reads_back(tmp_path: Path) -> None:
    test = frame()
    shapes = np.array([[1.0, 0.1], [0.5, 0.0], [0.2, 2.0], [0.0, 0.5]])
    reach = reach_of(shapes, [0, 2])
    np.testing.assert_allclose(reach, [[1, 0.0025], [0.04, 1]])
    frequencies = np.array([5.0, 9.0])
    struck = PlannedExcitation(("11+X", "12-Z"), frequencies, reach)
    files = write_test_sheet(tmp_path / "sheet", test, struck, sensor=ICP)
    again = read_sensor_sheet(
        tmp_path / "sheet/sensors.csv", tmp_path / "sheet/lines.csv"
    )
    assert again.model.channels == test.channels
    np.testing.assert_allclose(again.model.axes, test.axes)
    np.testing.assert_array_equal(again.model.lines, test.lines)
    assert again.channels[0].sensitivity == ICP.sensitivity
    with files[2].open() as file:
        blows = list(csv.DictReader(file))
    assert [(b["reference"], b["direction"], b["best_for_hz"]) for b in blows] == [
        ("11+X", "+X", "5"),
        ("12-Z", "-Z", "9"),
    ]
    with pytest.raises(InputError, match="reach"):
        PlannedExcitation(("11+X",), frequencies, reach)


def test_the_universal_file_holds_points_and_lines(tmp_path: Path) -> None:
    test = frame()
    write_test_model(tmp_path / "geometry.uff", test)
    file = pyuff.UFF(str(tmp_path / "geometry.uff"))
    assert [int(t) for t in file.get_set_types()] == [164, 15, 82]
    points, lines = file.read_sets(1), file.read_sets(2)
    assert [int(n) for n in points["node_nums"]] == [11, 12, 13]
    np.testing.assert_allclose(
        np.stack([points["x"], points["y"], points["z"]], axis=1), test.xyz
    )
    assert [int(n) for n in lines["nodes"]] == [11, 12, 0, 12, 13, 0]
    none = replace(
        test, points=test.points - 11, at=test.at - 11, lines=test.lines - 11
    )
    with pytest.raises(DataError, match="must be 1 to"):
        write_test_model(tmp_path / "none.uff", none)


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "frame.bdf"
    path.write_text(small_study.deck())
    return path


def test_plan_command(deck: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "plan",
        str(deck),
        "--modes",
        "1-3,5",
        "--points",
        "9",
        "--references",
        "2",
        *("--trials", "1", "--settings", str(deck.with_name("settings.toml"))),
    ]
    deck.with_name("settings.toml").write_text(
        """
        [plan]
        suspension = 3
        sensor_mass = 0.2
        redundancy = 1
        ambient_force = 1.0
        boxes = [[-1.0, -1.0, 2.0, 9.0, 9.0, 10.0]]
        """
    )
    status = run([*words, "--json", "-"])
    out, err = capsys.readouterr()
    assert status == 0, err
    told = json.loads(out)
    folder = deck.with_name("frame-test")
    assert [m["mode"] for m in told["modes"]] == [1, 2, 3, 5]
    assert all(m["found"] == 1 and -0.01 < m["loaded"] < 0 for m in told["modes"])
    assert told["left_by_loss"] >= 0.1
    assert (told["lost_points"], told["averages"]) == (1, 5)
    assert len(told["suspension"]["nodes"]) == 3
    ambient = told["virtual_ambient_test"]
    assert [m["mode"] for m in ambient["modes"]] == [1, 2, 3, 5]
    assert sum(m["found"] for m in ambient["modes"]) >= 3
    assert told["missed"] == []
    sheet = read_sensor_sheet(folder / "sensors.csv", folder / "lines.csv").model
    assert list(sheet.channels) == told["channels"]
    assert sheet.xyz[:, 2].min() > 2  # no foot is a point
    page = (folder / "report.html").read_text()
    assert "Suspension at nodes" in page
    assert "virtual tests" in page
    assert "1 virtual ambient tests under" in page
    # what is stored reads back, and the file of settings is a study
    rt.open_study(folder).report()
    again = run_study(folder / "plan.toml", until="plan")
    assert again.loaded == ("model", "plan")
    # the virtual tests are drawn: another seed is another plan
    text = (folder / "plan.toml").read_text()
    assert "seed = 0" in text
    (folder / "plan.toml").write_text(text.replace("seed = 0", "seed = 5"))
    assert run_study(folder / "plan.toml", until="plan").loaded == ("model",)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--modes", "7-"], "a number or a range"),
        (["--modes", "90", "--band", "1", "9"], "raise it"),
        (["--band", "9", "1"], "F0 < F1"),
        (["--units", "inch"], "mm-t-s"),
    ],
)
def test_bad_options_are_refused(
    deck: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    assert run(["plan", str(deck), *words]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("strike", ["worst", "greedy"])
def test_only_what_can_be_reached_is_struck(
    deck: Path, capsys: pytest.CaptureFixture[str], strike: str
) -> None:
    path = deck.with_name("settings.toml")
    path.write_text(f'[plan]\nstrike = "{strike}"\n')
    words = [
        "plan",
        str(deck),
        "--modes",
        "1-3",
        "--points",
        "4",
        "--references",
        "2",
        "--settings",
        str(path),
    ]
    run([*words, "--strike-at", "104,205,209", "--json", "-"])
    told = json.loads(capsys.readouterr().out)
    assert len(told["references"]) == 2
    assert {int(r.split("+")[0]) for r in told["references"]} <= {104, 205, 209}
    assert set(told["references"]) <= set(told["channels"])
    assert run([*words, "--strike-at", "999", "--json", "-"]) == 2
    assert "strike_at: none of [999] is a candidate" in capsys.readouterr().err


def test_a_folder_with_a_study_is_left_alone(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (deck.parent / "study.toml").write_text("")
    assert run(["plan", str(deck), "--out", str(deck.parent)]) == 2
    assert "name a folder" in capsys.readouterr().err


def test_lists_of_numbers() -> None:
    assert numbers("7-9, 12,3", "--modes") == [7, 8, 9, 12, 3]
    assert numbers("", "--modes") == []
    with pytest.raises(ConfigError, match="9-7"):
        numbers("9-7", "--modes")


def cantilever(length: float, mass: float) -> str:
    """A steel strip of 1 m in six bars, in the given units (SI: 1, 1; mm and t: 1000, 0.001)."""
    stress, density = mass / length, mass / length**3
    area, inertia = 3e-3 * length**2, 1e-6 * length**4
    lines = ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{k + 1},,{k / 6 * length:.6g},0.,0." for k in range(7)]
    lines += [f"CBAR,{k},1,{k},{k + 1},0.,0.,1." for k in range(1, 7)]
    lines += [f"PBAR,1,1,{area:.6g},{inertia:.6g},{3 * inertia:.6g},{4 * inertia:.6g}"]
    lines += [
        f"MAT1,1,{2.1e11 * stress:.6g},,0.3,{7850 * density:.6g}",
        "SPC1,1,123456,1",
        "ENDDATA",
    ]
    return "\n".join(lines) + "\n"


def test_the_units_of_the_deck_do_not_matter(tmp_path: Path) -> None:
    stages = []
    for units, length, mass in (("SI", 1.0, 1.0), ("mm-t-s", 1e3, 1e-3)):
        (tmp_path / units).mkdir()
        (tmp_path / units / "strip.bdf").write_text(cantilever(length, mass))
        study = tmp_path / units / "study.toml"
        study.write_text(
            f'[model]\ndeck = "strip.bdf"\nunits = "{units}"\nfmax = 900.0\n[plan]\nfmax = '
            "400.0\nsensors = 4\n"
            "references = 2\nambient = false\nmin_distance = 0.1\nsensor_mass = 0.05\ntrials = "
            "1\nat_hand = 3\n"
        )
        stages.append(run_study(study, until="plan").results["plan"])
    si, mm = stages
    assert si.sensors.test.channels == mm.sensors.test.channels
    np.testing.assert_allclose(si.sensors.test.xyz, mm.sensors.test.xyz)
    np.testing.assert_allclose(si.sensors.loaded, mm.sensors.loaded, rtol=1e-4)
    assert si.sensors.setups.setup.tolist() == mm.sensors.setups.setup.tolist()
    assert si.sensors.setups.count == 2  # one of three sensors stays, two rove
    np.testing.assert_allclose(
        si.sensors.setups.shift, mm.sensors.setups.shift, rtol=1e-3
    )
    assert (si.sensors.setups.shift > 0).all()
    assert (si.sensors.setups.shift < -si.sensors.loaded).all()
    assert si.virtual_test.force == pytest.approx(mm.virtual_test.force, rel=1e-4)
    # four masses of 50 g on a strip of 23.55 kg: at most -½·0.2/23.55 times the square of the
    # shape's crest factor, 4
    assert (
        -0.5 * 4 * 0.2 / 23.55 < si.sensors.loaded.min() < si.sensors.loaded.max() < 0
    )


def test_criteria_of_target_modes_in_a_study(deck: Path) -> None:
    """Modes that carry mass, and those whose frequencies tell the three storeys apart."""
    study = deck.with_name("study.toml")
    head = (
        '[model]\ndeck = "frame.bdf"\nfmax = 20.0\n[plan]\nfmax = 18.0\nsensors = 9\n'
    )
    head += "min_distance = 0.1\nambient = false\n"
    candidates = "".join(
        f'[[candidate]]\nname = "storey {k}"\ntargets = ["MAT1 {k} E"]\n'
        for k in (1, 2, 3)
    )
    study.write_text(head + "effective_mass = 0.5\n")
    heavy = run_study(study, until="plan").results["plan"]
    assert heavy.target_modes.tolist() == [0, 1]  # first sway along y and x
    assert heavy.reasons[0] == "effective mass over 50 %"
    study.write_text(head + "telling = 3\n" + candidates)
    telling = run_study(study, until="plan").results["plan"]
    assert telling.target_modes.size == 3
    study.write_text(head + "telling = 3\n")
    with pytest.raises(ConfigError, match="candidate"):
        run_study(study, until="plan")


def test_a_plan_of_rigid_body_modes_alone(deck: Path) -> None:
    """The frame with its lowest modes taken for those of a suspension: a band below their end holds
    them.
    """
    study = deck.with_name("study.toml")
    text = (
        '[model]\ndeck = "frame.bdf"\nfmax = 20.0\n[correlate]\nrigid_below = '
        "{}\n[plan]\nsensors = 9\nfmax = {}\n"
    )
    whole = text.format(1.0, 18.0) + "ambient = false\n"
    study.write_text(whole)
    f = run_study(study, until="plan").results["plan"].target_frequencies
    edge = float(np.sqrt(f[1] * f[2]))
    study.write_text(text.format(edge, 0.99 * edge))
    found = run_study(study, until="plan").results["plan"]
    np.testing.assert_allclose(found.target_frequencies, f[:2])
    assert found.acquisition.modes.tolist() == found.target_modes.tolist()
    study.write_text(text.format(edge, 18.0))
    np.testing.assert_allclose(
        run_study(study, until="plan").results["plan"].target_frequencies, f[2:]
    )


def test_what_a_plan_asks_for_in_vain_is_said(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "plan",
        str(deck),
        "--band",
        "1",
        "12",
        "--points",
        "5",
        "--strike-at",
        "303,304,7777",
    ]
    path = deck.with_name("settings.toml")
    path.write_text(
        "[plan]\nexclude = [8888]\nkeep_out = [[3.9, -1.0, 8.9, 4.1, 1.0, 9.1]]\n"
    )
    run([*words, "--settings", str(path), "--json", "-"])
    told = json.loads(capsys.readouterr().out)
    assert told["notes"] == [
        "strike_at names nodes that are no candidates: 303 7777",
        "exclude names nodes that are not in the deck: 8888",
    ]
    assert all(r.startswith("304") for r in told["references"])


def test_a_single_point_has_all_to_lose(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(
        [
            "plan",
            str(deck),
            "--modes",
            "1",
            "--points",
            "1",
            "--references",
            "1",
            "--json",
            "-",
        ]
    )
    told = json.loads(capsys.readouterr().out)
    assert (len(told["points"]), told["lost_points"], told["left_by_loss"]) == (
        1,
        1,
        0.0,
    )


def test_sensors_shift_no_mode_at_zero_hertz(
    deck: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The frame on no supports: what the sensors weigh shifts its elastic modes alone."""
    text = "".join(
        x
        for x in small_study.deck().splitlines(keepends=True)
        if not x.startswith("SPC")
    )
    deck.write_text(text)
    path = deck.with_name("settings.toml")
    path.write_text("[plan]\nsensor_mass = 2.0\n")
    words = ["--modes", "1-8", "--points", "6", "--settings", str(path), "--json", "-"]
    run(["plan", str(deck), *words])
    shifts = [m["loaded"] for m in json.loads(capsys.readouterr().out)["modes"]]
    assert shifts[:6] == [None] * 6
    assert all(-0.2 < x < -1e-4 for x in shifts[6:])
