"""A small complete study from deck and raw signals to the delivered deck; see `small_study` for the
structure.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import small_study

import ringtrue as rt
from ringtrue.cli.main import run as command
from ringtrue.core.notes import Note, sentence
from ringtrue.decks.nastran.editor import unified_diff
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, DataError
from ringtrue.report.build import deliver
from ringtrue.study.messages import run_messages
from ringtrue.study.reference import beyond
from ringtrue.study.run import StudyRun, run_study

# the signals have 1 % noise; three records of blows and 400 s of ambient motion tell a modulus to
# some percent
CLOSE = 0.03


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    run = run_study(small_study.write_study(tmp_path_factory.mktemp("small")))
    deliver(run)
    return run


def summary(run: StudyRun) -> dict[str, object]:
    return dict(json.loads((run.folder / "summary.json").read_text()))


def test_the_study_finds_the_true_stiffness_of_each_storey(done: StudyRun) -> None:
    update = done.results["update"]
    best = update.sets[update.chosen]
    for name, factor, std in zip(best.parameters, best.factor, best.std, strict=True):
        truth = small_study.TRUTH[int(name.split()[-1])]
        assert abs(factor - truth) < min(CLOSE, 3 * std)
    assert best.outcome.startswith("converged")


def test_used_and_left_out_modes_improve(done: StudyRun) -> None:
    before, after = done.results["correlate"].initial, done.results["final"].table
    assert len(after) >= 8
    assert (~after.used).sum() == 2
    for used in (True, False):
        assert after.mean_deviation(after.used == used) < 0.2 * before.mean_deviation(
            before.used == used
        )


def test_a_held_structure_has_no_rigid_body_modes(done: StudyRun) -> None:
    # the widest gap of this frame, between 2.0 and 4.9 Hz, is one between elastic modes
    assert len(done.results["correlate"].reference.rigid) == 0
    assert done.results["correlate"].reference.elastic.frequencies[0] < 2.0


def test_only_the_changed_fields_differ_in_the_delivered_deck(done: StudyRun) -> None:
    old = done.folder / "deck/frame.bdf"
    new = done.folder / "updated/frame.bdf"
    lines = unified_diff([old], [new]).splitlines()
    changed = [
        (a[1:], b[1:])
        for a, b in pairwise(lines)
        if a[:5] == "-MAT1" and b[:5] == "+MAT1"
    ]
    assert len(changed) == 3
    assert (
        sum(line[0] in "+-" and line[:3] not in ("+++", "---") for line in lines) == 6
    )
    for before, after in changed:
        a, b = before.split(","), after.split(",")
        assert [i for i, (x, y) in enumerate(zip(a, b, strict=True)) if x != y] == [2]


def test_channels_at_fault_are_told_once(done: StudyRun) -> None:
    stage = done.results["identify"]
    straight = Note("channel straight", "error", "3+X")
    strain = Note("channel strain", "warning", "4+X")
    one = replace(
        stage.records[0], channel_notes=(straight,), notes=("a machine at 5 Hz",)
    )
    two = replace(stage.records[-1], channel_notes=(straight, strain))
    lines = run_messages({"identify": replace(stage, records=(one, two))})
    assert lines[1:] == (
        f"{one.name}: {sentence(straight)} (further notes on it: 1)",
        f"{two.name}: {sentence(strain)}",
    )


def test_the_summary_has_the_agreed_keys(done: StudyRun) -> None:
    found = summary(done)
    wanted = {
        "mass_t",
        "dof",
        "rigid_body",
        "ambient_vs_hammer",
        "initial",
        "remodelled",
        "final",
        "left_out",
    }
    assert wanted | {"unpaired", "parameters", "timings_s"} <= set(found)
    # floors 3 x 12 m2 x 0.1 m x 2500 kg/m3, columns 36 m x 140 cm2 x 7850 kg/m3: feet count, too
    assert found["mass_t"] == pytest.approx(9.0 + 36 * 0.014 * 7.85, rel=1e-3)
    assert set(found["parameters"][0]) >= {"name", "initial", "updated", "std"}  # type: ignore[index]


def test_results_are_taken_out_of_a_stored_study(
    done: StudyRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = rt.open_study(done.folder)
    assert len(study.test) == len(study.test.std_frequency) > 5
    assert dict(
        zip(study.parameters.names, study.parameters.factors, strict=True)
    ).keys()
    np.testing.assert_allclose(study.pairs("final").deviation_percent, 0, atol=1)
    assert len(study.modes("initial")) == len(study.modes("final"))
    assert study.frfs.data.ndim == 3
    assert len(study.plot().data) > 0
    assert (
        command(
            ["convert", str(done.folder / "study.h5"), str(tmp_path / "merged.json")]
        )
        == 0
    )
    merged = rt.read_modes(tmp_path / "merged.json")
    np.testing.assert_allclose(merged.std_frequency, study.test.std_frequency)
    words = [str(done.folder / "study.h5"), str(tmp_path / "merged.json")]
    assert command(["correlate", *words]) == 0
    assert f"{len(merged)}" in capsys.readouterr().out


def test_the_same_inputs_give_the_same_numbers(done: StudyRun, tmp_path: Path) -> None:
    again = run_study(done.folder / "study.toml", out=tmp_path)
    assert again.loaded == ()
    deliver(again)
    one, two = summary(done), summary(again)
    for name in ("initial", "final", "ambient_vs_hammer", "parameters"):
        _same(one[name], two[name])


def _same(a: object, b: object) -> None:
    if isinstance(a, dict):
        assert isinstance(b, dict)
        assert a.keys() == b.keys()
        for k in a:
            _same(a[k], b[k])
    elif isinstance(a, list):
        assert isinstance(b, list)
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            _same(x, y)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-6, abs=1e-9)
    else:
        assert a == b


def test_a_deck_without_a_test(tmp_path: Path) -> None:
    run = run_study(
        small_study.write_study(
            tmp_path, small_study.MODEL + "[plan]\nfmax = 14.0\nsensors = 6\n"
        )
    )
    assert set(run.results) == {"model", "plan", "provenance"}
    assert len(run.results["plan"].target_modes) == 9
    assert deliver(run).stat().st_size > 1e5
    assert {"mass_t", "dof", "timings_s"} <= set(summary(run))


def _grids(*levels: int) -> str:
    return ", ".join(
        str(small_study.node(k, i, j))
        for k in levels
        for i in range(3)
        for j in range(3)
    )


FLOORS = f"candidates = {{ top = [{_grids(3)}], rest = [{_grids(1, 2)}] }}\n"


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("kinetic = { top = 0.4 }\n", "kinetic energy of top over 40 %"),
        ("redundancy = 1\n", "Hz"),
    ],
)
def test_what_a_plan_may_ask_for(tmp_path: Path, asked: str, told: str) -> None:
    head = "[plan]\nfmax = 14.0\nsensors = 6\nambient = false\nprecision = 0.05\nmax_auto_mac = 0.9\n"
    toml = (
        small_study.MODEL
        + head
        + FLOORS
        + asked
        + small_study.candidates(small_study.TRUTH)
    )
    plan = run_study(small_study.write_study(tmp_path, toml)).results["plan"]
    assert all(told in r for r in plan.reasons)
    assert 0 < len(plan.target_modes) < (9 if "kinetic" in asked else 10)
    lowest = float(
        plan.target_frequencies.min()
    )  # the record is as long as its damping to 5 % asks
    assert plan.acquisition.record_length == pytest.approx(
        1 / (0.05**2 * 2 * np.pi * plan.acquisition.damping * lowest), abs=60.0
    )


PLAN = (
    small_study.MODEL
    + "[plan]\nfmax = 14.0\nsensors = {}\nreferences = 3\nambient = false\nmax_auto_mac = 0.9\n"
)


@pytest.mark.parametrize(
    ("strike", "told"), [("greedy", "greedily"), ("worst", "best set")]
)
def test_exciters_by_each_method(tmp_path: Path, strike: str, told: str) -> None:
    run = run_study(
        small_study.write_study(
            tmp_path, PLAN.format(6) + f'strike = "{strike}"\nat_hand = 4\n'
        )
    )
    deliver(run)
    plan, page = (
        run.results["plan"],
        (run.folder / "report.html").read_text(encoding="utf-8"),
    )
    assert told in plan.rule
    assert len(set(plan.excitation.references)) == 3
    assert set(plan.excitation.references) <= set(plan.sensors.test.channels)
    measured = [
        p for k in range(-1, plan.sensors.setups.count) for p in plan.sensors.roving(k)
    ]
    assert sorted(measured) == sorted(plan.sensors.test.points.tolist())
    assert f"{plan.sensors.setups.count} setups of up to 4 sensors" in page


@pytest.mark.parametrize(
    "extra", ["", "min_distance = 1.0\nsensor_mass = 1.0\nredundancy = 1\ntrials = 1\n"]
)
def test_single_axes_distinguish_the_modes_with_fewer_channels(
    tmp_path: Path, extra: str
) -> None:
    toml = PLAN.format(12) + 'directions = "uniaxial"\n' + extra
    plan = run_study(small_study.write_study(tmp_path, toml)).results["plan"]
    assert "single axes" in plan.rule
    assert 12 <= len(plan.sensors.test.channels) < 36
    assert plan.sensors.worst_auto_mac < 0.9
    node = {c: int(c.split("+")[0]) for c in plan.sensors.test.channels}
    assert plan.sensors.test.at.tolist() == list(node.values())
    assert len(set(node.values())) == plan.sensors.test.points.size
    np.testing.assert_array_equal(
        plan.sensors.test.axes,
        np.stack([np.eye(3)["XYZ".index(c[-1])] for c in plan.sensors.test.channels]),
    )
    if extra:  # the same axis at least 1 m apart
        xyz = plan.sensors.test.channel_xyz()
        for axis in "XYZ":
            mine = xyz[[c[-1] == axis for c in plan.sensors.test.channels]]
            gap = np.linalg.norm(mine[:, None] - mine, axis=2) + 9 * np.eye(len(mine))
            assert gap.min(initial=9.0) > 1.0
        assert (plan.sensors.loaded < 0).all()


def test_sensors_along_normals_stand_on_shells(tmp_path: Path) -> None:
    low = (
        PLAN.replace("14.0", "20.0").format(8)
        + 'modes = [5, 6]\ndirections = "normal"\n'
    )
    plan = run_study(small_study.write_study(tmp_path, low)).results["plan"]
    assert all(c.endswith("+N") for c in plan.sensors.test.channels)
    np.testing.assert_allclose(
        np.abs(plan.sensors.test.axes[:, 2]), 1.0, atol=1e-12
    )  # the floors lie flat
    half = (
        f"candidates = {{ columns = "
        f"[{', '.join(str(small_study.node(1, *c) + 50) for c in small_study.CORNERS)}] }}\n"
    )
    with pytest.raises(ConfigError, match="no candidate lies on a shell"):
        run_study(small_study.write_study(tmp_path, low + half))


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("kinetic = { tip = 0.5 }\n", "did you mean 'top'"),
        ("telling = 3\n", r"need a \[\[candidate\]\]"),
    ],
)
def test_what_a_plan_cannot_do_is_refused(
    tmp_path: Path, asked: str, told: str
) -> None:
    toml = (
        small_study.MODEL
        + "[plan]\nfmax = 14.0\nsensors = 6\nambient = false\n"
        + FLOORS
        + asked
    )
    with pytest.raises(ConfigError, match=told):
        run_study(small_study.write_study(tmp_path, toml))


def test_a_plan_needs_modes(tmp_path: Path) -> None:
    below = re.sub(r"fmax = \S+", "fmax = 0.5", small_study.MODEL)
    toml = below + "[plan]\nfmax = 14.0\nsensors = 6\nambient = false\n"
    with pytest.raises(ConfigError, match=r"no mode below 0\.5 Hz"):
        run_study(small_study.write_study(tmp_path, toml))


@pytest.mark.parametrize(("ambient", "hammer"), [(True, False), (False, True)])
def test_a_test_without_a_deck(tmp_path: Path, ambient: bool, hammer: bool) -> None:
    toml = (
        small_study.TEST
        + "[identify]\nhammer_fmin = 1.0\nhammer_fmax = 20.0\nambient_fmin = 1.0\n"
    )
    run = run_study(
        small_study.write_study(tmp_path, toml, ambient=ambient, hammer=hammer)
    )
    assert set(run.results) == {"identify", "compare", "conditions", "provenance"}
    found = run.results["identify"]
    modes = (found.ambient if ambient else found.hammer).modes
    assert len(modes) == 9
    deliver(run)


@pytest.mark.parametrize(("ambient", "hammer"), [(True, False), (False, True)])
def test_one_kind_of_test_is_enough_to_update(
    tmp_path: Path, ambient: bool, hammer: bool
) -> None:
    run = run_study(small_study.write_study(tmp_path, ambient=ambient, hammer=hammer))
    assert (
        run.results["final"].table.mean_deviation()
        < 0.3 * run.results["correlate"].initial.mean_deviation()
    )
    deliver(run)


def test_modes_of_the_deck_reach_well_above_the_test_where_nothing_is_said(
    tmp_path: Path,
) -> None:
    toml = small_study.FULL.replace(f"fmax = {small_study.FMAX}\n", "", 1)
    run = run_study(
        small_study.write_study(tmp_path, toml, ambient=False), until="correlate"
    )
    found = run.results["correlate"]
    assert run.session.fmax == pytest.approx(
        1.5 * found.reference.elastic.frequencies.max()
    )
    assert (found.fe_initial.frequencies <= run.session.fmax).all()
    assert not beyond(found.reference.elastic, run.session.fmax)
    assert (
        len(found.notes) == 1
    )  # none that the modes of the deck end too low, and that the floors are coarse
    assert "the mesh puts frequencies of the deck off" in found.notes[0]
    assert "`refine = 1` under [model]" in found.notes[0]


def test_a_study_on_a_refined_mesh_edits_the_deck_as_it_is(tmp_path: Path) -> None:
    toml = small_study.FULL.replace(
        "[model]\n", "[plan]\nsensors = 4\n[model]\nrefine = 1\n"
    )
    run = run_study(small_study.write_study(tmp_path, toml, ambient=False))
    ids = read_deck(tmp_path / "deck" / "frame.bdf")["GRID"].ids
    assert run.results["model"].nodes > 2 * ids.size
    assert np.isin(run.results["plan"].sensors.test.points, ids).all()
    written = read_deck(run.results["final"].files[0])
    np.testing.assert_array_equal(written["GRID"].ids, ids)
    assert any("MAT1 1 E" in c for c in run.results["final"].changes)
    deliver(run)


def test_a_mesh_is_not_refined_for_another_solver_or_under_a_candidate(
    tmp_path: Path,
) -> None:
    with pytest.raises(ConfigError, match="solves decks as they are"):
        run_study(
            small_study.write_study(
                tmp_path, '[model]\ndeck = "x"\nrefine = 1\nsolver = "mystran"\n'
            )
        )
    text = small_study.FULL.replace("[model]\n", "[model]\nrefine = 1\n")
    text += '[[candidate]]\nname = "plate"\ntargets = ["CQUAD4 110 T1"]\n'
    with pytest.raises(ConfigError, match="splits every CQUAD4"):
        run_study(small_study.write_study(tmp_path, text))


def test_nothing_is_written_when_an_input_is_wrong(tmp_path: Path) -> None:
    out = tmp_path / "out"
    study = small_study.write_study(tmp_path)
    study.write_text(small_study.FULL.replace("MAT1 2 E", "MAT1 20 E"))
    with pytest.raises(
        ConfigError,
        match=r"MAT1 20 is not in the model; did you mean 10\? The nearest ids are \[10",
    ):
        run_study(study, out=out)
    study.write_text(small_study.FULL)
    (tmp_path / "data/ambient.h5").unlink()
    with pytest.raises(DataError, match=r"ambient\.h5: no such file"):
        run_study(study, out=out)
    assert not out.exists()


def test_a_suspension_without_rigid_body_modes_is_said(tmp_path: Path) -> None:
    toml = (
        small_study.FULL
        + '[correlate]\nrigid_below = 0.0\n[[suspension]]\nname = "s"\ntargets = ["MAT1 10 E"]\n'
    )
    with pytest.raises(DataError, match="no rigid-body mode to tune"):
        run_study(small_study.write_study(tmp_path, toml, ambient=False))


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (
            lambda log: log["tests"][0].update(kind="ambiant"),
            r"tests\.0\.kind: .*'ambient'.*got 'ambiant'",
        ),
        (
            lambda log: log["tests"][1].pop("block_samples"),
            r"tests\.1.*block_samples missing",
        ),
        (
            lambda log: log["tests"][1].update(pretrigger_samples=1e5),
            r"tests\.1\.pretrigger_samples: .*integer",
        ),
        (
            lambda log: log["tests"][1].update(pretriger_samples=16),
            "'pretriger_samples'; did you mean 'pretrigger_s",
        ),
        (
            lambda log: log["tests"][0].pop("records"),
            r"tests\.0\.records: Field required",
        ),
        (
            lambda log: log["tests"][0]["records"][0].update(file=3),
            r"records\.0\.file: .*string \(got 3\)",
        ),
        (
            lambda log: log.update(
                sensors={"g": {"quantity": "velocity", "corner_hz": 4.5}}
            ),
            "sensors.g: .*damping",
        ),
        (lambda log: log.update(tests=[]), "no record in any test"),
        (lambda log: log.update(tests=3), "tests: .*valid list"),
    ],
)
def test_a_wrong_log_is_explained(tmp_path: Path, edit: object, told: str) -> None:
    study = small_study.write_study(tmp_path, small_study.TEST)
    path = tmp_path / "data/campaign.json"
    log = json.loads(path.read_text())
    edit(log)  # type: ignore[operator]
    path.write_text(json.dumps(log))
    with pytest.raises(DataError, match=told):
        run_study(study)


def test_a_channel_that_is_not_on_the_sheet_is_named(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, small_study.TEST)
    sheet = tmp_path / "data/sensors.csv"
    lines = sheet.read_text().splitlines(keepends=True)
    sheet.write_text("".join(line for line in lines if "303+Y" not in line))
    with pytest.raises(
        DataError, match=r"h5: channel 303\+Y is not on the sensor sheet"
    ):
        run_study(study)


def test_updated_values_are_those_in_the_deck(done: StudyRun) -> None:
    text = (done.folder / "updated/frame.bdf").read_text()
    update = done.results["update"]
    for name, value in update.updated_values.items():
        line = next(
            x for x in text.splitlines() if x.startswith(f"MAT1,{name.split()[-1]},")
        )
        assert float(np.float64(line.split(",")[2])) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("candidates", [(), (2, 3)])
def test_a_suspension_is_tuned_to_the_modes_below_the_stated_frequency(
    tmp_path: Path, candidates: tuple[int, ...]
) -> None:
    """The lowest storey plays the suspension: two sways and a torsion lie below 3 Hz."""
    sure = small_study.SETTINGS.replace("[identify]", "[identify]\nconfidence = 0.4")
    toml = (
        small_study.MODEL + small_study.TEST + sure + small_study.candidates(candidates)
    )
    toml += (
        '[correlate]\nrigid_below = 3.0\n[[suspension]]\nname = "lowest storey"\ntargets = '
        '["MAT1 1 E"]\n'
    )
    # sections beside them take most of the time
    toml += '[localise]\nkinds = ["material"]\n'
    run = run_study(small_study.write_study(tmp_path, toml))
    final = run.results["final"]
    assert len(final.rigid) == 3
    assert (
        final.rigid.mean_deviation()
        < 0.3 * run.results["correlate"].rigid_initial.mean_deviation()
    )
    assert any("MAT1 1 E" in c for c in final.changes)
    deliver(run)
    assert summary(run)["suspension"][0]["name"] == "lowest storey"  # type: ignore[index]


def test_an_unreadable_record_is_named(tmp_path: Path) -> None:
    study = small_study.write_study(tmp_path, small_study.TEST, hammer=False)
    (tmp_path / "data/ambient.h5").write_bytes(b"\x89HDF\r\n\x1a\nno")
    with pytest.raises(DataError, match=r"ambient\.h5: not a readable HDF5 file"):
        run_study(study)
