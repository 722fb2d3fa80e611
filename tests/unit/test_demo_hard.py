"""The harder worked example writes its files reproducibly, and nothing of the truth among them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_virtual_sensors import small_plan
from test_virtual_system import MadeUp, made_up

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.demos.lsf import examples, facility
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.campaign import ChannelFaults, Circumstances, Day, _paperwork
from ringtrue.demos.lsf.study import write_facility, write_study
from ringtrue.study.config import StudyConfig, read_config
from ringtrue.virtual.sensors import at_outputs


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folders = []
    for seed in (3, 3):
        folder = tmp_path_factory.mktemp("hard")
        example = examples.hard(seed)
        analyst = facility.build(example.analyst)
        write_facility(analyst, folder / "deck", "analyst's model")
        write_study(analyst, folder, seed, example.contents)
        folders.append(folder)
    return folders[0], folders[1]


def test_deck_and_study_are_the_same_files(written: tuple[Path, Path]) -> None:
    a, b = ({p.relative_to(f): p.read_bytes() for p in f.rglob("*.*")} for f in written)
    assert a == b
    assert {"study.toml", "lsf.bdf"} <= {p.name for p in a}


def test_candidates_are_fields_of_the_deck_and_cut_across_what_is_wrong(
    written: tuple[Path, Path],
) -> None:
    model = read_deck(written[0] / "deck" / "lsf.bdf")
    config: StudyConfig = read_config(written[0] / "study.toml")
    assert not config.remodel
    for target in (t for p in config.candidates().parameters for t in p.targets):
        assert target.id in model[target.card].ids.tolist(), target
    ratio = examples.ratios(3)
    wrong = [ratio[r] for r in (*S.CONCRETE, *S.JOINTED, *S.BUSHES)]
    assert min(wrong) < 0.85 < 1.2 < max(wrong)
    for name, regions in (("foundation", S.CONCRETE), ("anchors", examples.ANCHORS)):
        mine = [p for p in config.candidates().parameters if p.name.startswith(name)]
        assert len(mine) >= 2
        each = [len({t.id % facility.ZONE for t in p.targets}) for p in mine]
        # each holds nearly all regions, whose ratios differ
        assert min(each) >= len(regions) - 1


def test_the_truth_is_that_of_the_seed() -> None:
    assert examples.hard(3) == examples.hard(3)
    assert examples.ratios(3) != examples.ratios(4)
    plan = small_plan(made_up())
    assert examples.plant(3, plan) == examples.plant(3, plan)
    assert examples.plant(3, plan).reversed in plan.foundation


def circumstances(twin: MadeUp, faults: ChannelFaults) -> Circumstances:
    first, second = Day("2024-11-04", 7.5), Day("2024-11-06", 14.0)
    days = {
        "foundation": first,
        "frame": first,
        "hammer": second,
        "foundation-again": second,
    }
    return Circumstances(
        {d.date: twin for d in (first, second)}, days, ("ambient",), faults
    )


def test_channels_read_what_their_faults_make_of_the_motion() -> None:
    twin = made_up()
    plan = small_plan(twin)
    a, b, c = plan.foundation[1:4]
    fixed = plan.setups[0][0]
    faults = ChannelFaults(reversed=a, swapped=(b, c), scaled=fixed, setup=1, gain=2.0)
    here = circumstances(twin, faults)
    right = at_outputs(twin.modal, plan.foundation)
    wrong = here.seen("foundation", plan.foundation)
    assert [x.id for x in wrong.outputs] == list(plan.foundation)
    at, sign = [0, 1, 3, 2, 4, 5], np.array([1, -1, 1, 1, 1, 1])[:, None]
    np.testing.assert_array_equal(wrong.shapes, right.shapes[at] * sign)
    np.testing.assert_array_equal(wrong.upper, right.upper[at] * sign)
    gains = [here.seen("hammer", (fixed,), k).shapes / right.shapes[:1] for k in (0, 1)]
    np.testing.assert_allclose(gains[0], 1.0)
    np.testing.assert_allclose(gains[1], 2.0)


def test_days_are_in_the_log_and_faults_are_not(tmp_path: Path) -> None:
    twin = made_up()
    here = circumstances(twin, ChannelFaults(reversed=twin.test.channels[1]))
    _paperwork(here, small_plan(twin), tmp_path)
    text = (tmp_path / "campaign.json").read_text()
    tests = {t["name"]: t for t in json.loads(text)["tests"]}
    assert tests["foundation"]["temperature_c"] == 7.5
    assert tests["foundation-again"]["date"] == tests["hammer"]["date"] == "2024-11-06"
    assert [r["file"] for r in tests["foundation-again"]["records"]] == [
        "foundation-again-ambient.h5"
    ]
    assert not any(word in text for word in ("reversed", "swapped", "fault"))


def test_a_fault_counts_as_named_with_its_channel_and_setup_alone() -> None:
    faults = ChannelFaults("1+Z", ("2+Z", "3+Z"), scaled="4+Z", setup=1, gain=0.5)
    findings = [
        finding("channel reversed", "1+Z", factor=-1.0),
        finding("channel swapped", "2+Z", partner="3+Z"),
        finding("channel swapped", "3+Z", partner="2+Z"),
        finding("channel gain", "4+Z", setup="2", factor=0.49),
        finding("temperature drift", "ambient records", percent=-0.02),
        finding("amplitude dependent", "ambient modes 1, 2"),
        finding("days differ", "repeated test"),
    ]
    assert all(examples.named(findings, faults).values())
    for k in range(len(findings)):
        assert (
            list(
                examples.named(findings[:k] + findings[k + 1 :], faults).values()
            ).count(False)
            == 1
        )
    more = [*findings, finding("channel scaled", "9+Z", factor=3.0)]
    assert not examples.named(more, faults)["no other channel"]


def finding(what: str, subject: str, **values: object) -> dict[str, object]:
    return {"what": what, "subject": subject, "values": values}
