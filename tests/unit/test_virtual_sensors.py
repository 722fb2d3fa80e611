"""Measuring chains: transfer, converter, range, noise; hammer blows; the campaign on disk."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_virtual_system import MadeUp, made_up, made_up_plan

from ringtrue.demos.lsf.campaign import CampaignPlan, run_campaign
from ringtrue.errors import InputError
from ringtrue.io.records import read_record
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.virtual.measurements import HammerPlan, strike
from ringtrue.virtual.sensors import (
    ACCELEROMETER,
    FORCE_CELL,
    GEOPHONE,
    Chain,
    NoiseFloor,
    lines,
    power,
    record_volts,
    tone,
)

RATE = 256.0
QUIET = replace(
    ACCELEROMETER,
    floor=NoiseFloor(0.0, 0.0),
    hum=0.0,
    drift=0.0,
    offset=0.0,
    calibration=0.0,
    sensitivity=1.0,
    range=1.0,
)


def chain(*sensors: object) -> Chain:
    return Chain.draw(tuple(sensors), np.random.default_rng(0))  # type: ignore[arg-type]


def test_geophone_transfer_at_its_corner_and_far_above() -> None:
    h = GEOPHONE.transfer(np.array([0.0, 4.5, 450.0]))
    np.testing.assert_allclose(h[:2], [0.0, 1j / (2 * 0.56)], atol=1e-12)
    assert abs(h[2]) == pytest.approx(1.0, abs=1e-3)


def test_a_tone_through_a_geophone_comes_out_with_its_gain() -> None:
    n, amplitude = 5120, 1e-3
    quiet = replace(
        GEOPHONE,
        floor=NoiseFloor(0.0, 0.0),
        hum=0.0,
        drift=0.0,
        offset=0.0,
        calibration=0.0,
    )
    motion = tone(4.5, np.array([amplitude]), np.zeros(1), n, RATE)
    volts, _ = record_volts(motion, chain(quiet), n, RATE, np.random.default_rng(0))
    want = (
        28.8 * amplitude / (2 * 0.56) * -np.sin(2 * np.pi * 4.5 * np.arange(n) / RATE)
    )
    np.testing.assert_allclose(volts[0], want, atol=1e-7)


def test_quantisation_rounds_to_the_step_of_the_converter() -> None:
    coarse = replace(QUIET, bits=8)
    volts = np.linspace(-0.9, 0.9, 1000)[None]
    got = chain(coarse).digitise(volts.copy(), RATE)
    np.testing.assert_allclose(got * 128, np.rint(got * 128), atol=1e-6)
    assert np.abs(got - volts).max() <= 0.5 / 128 + 1e-7


def test_signals_beyond_the_range_are_clipped() -> None:
    got = chain(QUIET).digitise(np.array([[-3.0, 0.5, 3.0]]), RATE)
    np.testing.assert_allclose(got, [[-1.0, 0.5, 1.0]], atol=2 * QUIET.step)


def test_calibration_errors_stay_within_one_percent() -> None:
    c = Chain.draw((ACCELEROMETER,) * 500, np.random.default_rng(1))
    error = np.abs(c.true_sensitivity / ACCELEROMETER.sensitivity - 1)
    assert 0.002 < error.mean() < error.max() <= 0.01 + 1e-12


def test_self_noise_has_its_density_and_its_corner() -> None:
    n = 1 << 16
    noise = Chain.draw(
        (replace(ACCELEROMETER, hum=0.0),) * 8, np.random.default_rng(0)
    ).noise(n, RATE, np.random.default_rng(1))
    f, psd = (
        lines(n, RATE),
        power(noise, n, RATE).mean(axis=0) / ACCELEROMETER.sensitivity**2,
    )
    micro_g = np.sqrt(psd) / 9.80665e-6
    assert np.sqrt(np.mean(micro_g[(f > 50) & (f < 90)] ** 2)) == pytest.approx(
        0.1, rel=0.05
    )
    assert np.sqrt(np.mean(micro_g[(f > 0.95) & (f < 1.05)] ** 2)) == pytest.approx(
        0.1 * np.sqrt(2), rel=0.1
    )


def test_blows_are_clean_but_for_the_doubles_and_overloads_among_them() -> None:
    plan = HammerPlan(hits=40, double=0.2, overload=0.2)
    limit = FORCE_CELL.range / FORCE_CELL.sensitivity
    blows = strike(plan, 0, limit, 512.0, np.random.default_rng(0))
    n = blows.times.size
    assert (~blows.double & ~blows.overload).sum() == 40
    assert blows.double.any()
    assert blows.overload.any()
    assert blows.pulses.at.size == n + blows.double.sum()
    assert (-blows.pulses.peak[:n][blows.overload] > limit).all()
    assert np.diff(blows.times).min() > plan.block


@pytest.fixture(scope="module")
def campaign(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, MadeUp, CampaignPlan]:
    twin, folder = made_up(), tmp_path_factory.mktemp("campaign")
    plan = small_plan(twin)
    run_campaign(twin, plan, folder, 7, fast=True)
    return folder, twin, plan


def small_plan(twin: MadeUp) -> CampaignPlan:
    c = twin.test.channels
    return made_up_plan(
        twin,
        foundation=c[:6],
        frame=c[:9],
        setups=(c[:4], c[:1] + c[4:8]),
        references=("101+Z", "102+Z"),
        duration_a=120.0,
        duration_b=120.0,
        hammer=HammerPlan(hits=3, overload=0.3, peak=(1e3, 4e3)),
    )


def test_the_log_names_records_that_can_be_read(
    campaign: tuple[Path, MadeUp, CampaignPlan],
) -> None:
    folder, _, plan = campaign
    tests = {
        t["name"]: t
        for t in json.loads((folder / "campaign.json").read_text())["tests"]
    }
    assert list(tests) == ["foundation", "frame", "hammer"]
    for r in tests["frame"]["records"]:
        history = read_record(folder / r["file"], 256.0)
        assert tuple(c.id for c in history.channels) == plan.frame
        assert history.channels[0].unit == "m/s"
    hammer = tests["hammer"]
    for r in hammer["records"]:
        history = read_record(folder / r["file"])
        assert history.channels[0].id == r["force_channel"] == f"F:{r['reference']}"
        assert history.data.shape[1] % hammer["block_samples"] == 0
        blocks = history.data[0].reshape(-1, hammer["block_samples"])
        assert (
            np.abs(np.argmax(np.abs(blocks), axis=1) - hammer["pretrigger_samples"]) < 5
        ).all()
        assert blocks.shape[0] >= plan.hammer.hits


def test_overloads_stand_at_the_range_of_the_force_channel(
    campaign: tuple[Path, MadeUp, CampaignPlan],
) -> None:
    files = sorted(campaign[0].glob("hammer-*.h5"))
    peaks = []
    for path in files:
        with h5py.File(path) as file:
            peaks.append(np.abs(file["record/data"][0]).max())
    assert max(peaks) == pytest.approx(FORCE_CELL.range, rel=1e-6)


def test_events_are_not_recorded_and_nothing_of_the_truth_is(
    campaign: tuple[Path, MadeUp, CampaignPlan],
) -> None:
    folder, twin, plan = campaign
    with h5py.File(folder / "foundation-drop.h5") as file:
        assert sorted(file["record"]) == ["channels", "data"]
        assert file["record/data"].shape[0] == len(plan.foundation)
        assert file["record/data"].dtype == np.float32
    text = (folder / "campaign.json").read_text()
    assert not any(f"{f:.3f}" in text for f in twin.modal.frequencies)


def test_the_sheets_hold_places_and_directions(
    campaign: tuple[Path, MadeUp, CampaignPlan],
) -> None:
    folder, twin, plan = campaign
    sheet = read_sensor_sheet(folder / "sensors.csv")
    assert set(sheet.model.channels) == set(
        plan.foundation + plan.frame + plan.references + plan.setups[0] + plan.setups[1]
    )
    known = twin.test.pick(sheet.model.channels)
    np.testing.assert_allclose(
        sheet.model.channel_xyz(), known.channel_xyz(), rtol=1e-5
    )
    np.testing.assert_allclose(sheet.model.axes, known.axes)
    assert (
        read_sensor_sheet(folder / "sensors-frame.csv").channels[0].sensitivity
        == GEOPHONE.sensitivity
    )


def test_the_same_seed_gives_the_same_samples(
    campaign: tuple[Path, MadeUp, CampaignPlan], tmp_path: Path
) -> None:
    folder, twin, plan = campaign
    run_campaign(twin, plan, tmp_path, 7, fast=True)
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path) as a, h5py.File(tmp_path / path.name) as b:
            np.testing.assert_array_equal(a["record/data"], b["record/data"])


def test_the_ratio_at_resonance_is_between_5_and_25_db(tmp_path: Path) -> None:
    twin = made_up(2)
    summary = run_campaign(twin, small_plan(twin), tmp_path, 1)
    assert set(summary.snr_db) == {"foundation", "frame", "hammer"}
    assert all(5 < v < 25 for v in summary.snr_db.values())
    assert all(0.3e-6 <= v <= 3e-6 for v in summary.ground_rms.values())
    assert all(p.is_file() for p in summary.records)


def test_a_plan_without_places_or_with_hasty_events_is_refused() -> None:
    twin = made_up()
    with pytest.raises(InputError, match="name something"):
        made_up_plan(twin, frame=())
    with pytest.raises(InputError, match="20 to 80"):
        made_up_plan(twin, spacing=(5.0,))
    with pytest.raises(InputError, match="hammer plan"):
        HammerPlan(hits=0)
