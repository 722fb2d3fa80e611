"""Records at the size of a screen: extremes, spectra, names of the sheet; hits one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study
from record_files import write_history
from test_ema_frf import record

from ringtrue.core.choice import Hit
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.records import read_record, write_record
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.signal import overview
from ringtrue.signal.frf import estimate_frf
from ringtrue.signal.spectra import Welch, psd
from ringtrue.study import record_views
from ringtrue.study.log import Logged, read_log
from ringtrue.study.record_views import (
    force_of,
    hit_signals,
    kept_frfs,
    open_view,
    place_of,
)


def noise(samples: int, channels: int = 2) -> np.ndarray:
    return (
        np.random.default_rng(0).standard_normal((channels, samples)).astype(np.float32)
    )


def reader(data: np.ndarray) -> overview.Read:
    def read(spans: overview.Spans) -> Iterator[np.ndarray]:
        for start, stop in spans:
            yield data[:, start:stop]

    return read


def never() -> overview.Envelope:
    raise AssertionError("the whole record was read")


def test_extremes_of_any_part_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    data = noise(100_000)
    data[1, 70_000:70_010] = np.nan
    data[0, 33_333] = 9.0
    read = reader(data)
    few = overview.envelope(read, 500, 900, bins=300, whole=never)
    np.testing.assert_array_equal(few.low, data[:, 500:900])
    np.testing.assert_array_equal(few.low, few.high)
    direct = overview.envelope(read, 0, 100_000, bins=300, whole=never)
    monkeypatch.setattr(overview, "DIRECT", 10_000)
    monkeypatch.setattr(overview, "STEP", 20 * overview.BLOCK)
    kept = overview.extremes(read, 100_000)
    coarse = overview.envelope(read, 0, 100_000, bins=30, whole=lambda: kept)
    for seen in (direct, coarse):
        assert seen.low.shape[1] <= 300
        size = int(seen.first[1])
        for k, first in enumerate(seen.first.tolist()):
            part = data[:, first : first + size]
            np.testing.assert_array_equal(seen.low[:, k], np.nanmin(part, axis=1))
            np.testing.assert_array_equal(seen.high[:, k], np.nanmax(part, axis=1))
            np.testing.assert_array_equal(seen.lost[:, k], np.isnan(part).any(axis=1))


def test_spectra_are_those_of_welch() -> None:
    data = noise(40_000)
    freqs, density, used = overview.spectra(
        reader(data), 0, 40_000, rate=100.0, resolution=0.25
    )
    wanted = psd(TimeHistory(data, 100.0, (Channel("a"), Channel("b"))), Welch(0.25))
    assert used == 160  # of 199, spread
    np.testing.assert_allclose(freqs, wanted[0])
    # 160 of the same segments, but for the places of most
    np.testing.assert_allclose(density.mean(axis=1), wanted[1].mean(axis=1), rtol=0.02)
    few = overview.spectra(reader(data), 0, 8_000, rate=100.0, resolution=0.25)
    same = psd(
        TimeHistory(data[:, :8_000], 100.0, (Channel("a"), Channel("b"))), Welch(0.25)
    )
    np.testing.assert_allclose(few[1], same[1], rtol=1e-5)
    data[1, 3_000] = np.nan
    assert (
        overview.spectra(reader(data), 0, 8_000, rate=100.0, resolution=0.25)[2]
        == few[2] - 2
    )


def test_a_spectrogram_follows_a_tone() -> None:
    t = np.arange(20_000) / 100.0
    data = np.sin(2 * np.pi * np.where(t < 100, 10.0, 20.0) * t)[None]
    seen = overview.spectrogram(reader(data), 0, 20_000, rate=100.0)
    assert seen.level.shape[1] <= 300
    loudest = seen.freqs[seen.level.argmax(axis=0)]
    middle = (seen.first + seen.freqs.size - 1) / 100.0
    away = np.abs(middle - 100) > 3
    np.testing.assert_allclose(
        loudest[away], np.where(middle < 100, 10.0, 20.0)[away], atol=0.2
    )


def test_a_record_is_read_where_it_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names and units are those of the sheet; the samples those of `read_record`."""
    small_study.write_data(tmp_path, ambient=False)
    sheet = read_sensor_sheet(tmp_path / "sensors.csv")
    (hammer, _), _ = read_log(tmp_path / "campaign.json")
    whole = read_record(hammer.path)
    # the log turns a channel round, leaves one out and names another as the sheet does
    names = [c.id for c in whole.channels]
    names[1] = names[1].replace("+", "-")
    names[2] = ""
    logged = hammer.model_copy(update={"channels": names})
    view = open_view(logged, sheet)
    assert view.samples == whole.data.shape[1]
    assert [c.id for c in view.channels] == [
        c.id for k, c in enumerate(whole.channels) if k != 2
    ]
    turned = whole.channels[1].id
    np.testing.assert_allclose(view.read([turned], 10, 30)[0], -whole.data[1, 10:30])
    assert view.checked() == ()
    with pytest.raises(DataError, match="no channel 9"):
        view.read(["9+Z"], 0, 2)
    monkeypatch.setattr(record_views, "CHECKED", 10)
    assert view.checked() is None


def test_large_files_of_others_are_kept_outside_of_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blows = record(1, [0, 1])
    write_history(tmp_path / "b.csv", blows)
    small = open_view(tmp_path / "b.csv")
    monkeypatch.setattr(record_views, "IN_MEMORY", 1000)
    large = open_view(tmp_path / "b.csv")
    ids = [c.id for c in blows.channels]
    np.testing.assert_allclose(
        large.read(ids, 100, 200), blows.data[:, 100:200], rtol=1e-6
    )
    np.testing.assert_array_equal(large.read(ids, 0, 999), small.read(ids, 0, 999))
    assert large.name == "b"


def logged_blows(folder: Path, blows: TimeHistory, **more: object) -> Logged:
    channels = [RecordChannel(c.id, 0, c.quantity, c.unit) for c in blows.channels]
    write_record(folder / "b.h5", blows.data, blows.rate, channels)
    given = {"file": "b.h5", "excitation": "hammer", "test": "t", "kind": "hammer"}
    return Logged(**given, path=folder / "b.h5", **more)


def test_hits_are_shown_one_by_one(tmp_path: Path) -> None:
    blows = replace(record(1, [0, 1], rebound=2), source="b")
    logged = logged_blows(tmp_path, blows)
    view = open_view(logged)
    _, hits = estimate_frf(blows)
    assert force_of(view, logged) == "F:2+Z"
    seen = hit_signals(view, logged, hits, 1, ["1+Z", "2+Z"])
    peak = place_of(view, hits[1])
    assert seen.force.max() == pytest.approx(hits[1].peak, rel=1e-3)
    assert seen.force_time[seen.force.argmax()] == 0.0
    # from the pretrigger to the next hit
    end = place_of(view, hits[2])
    assert seen.time[0] == pytest.approx(-0.02, abs=1 / blows.rate)
    assert seen.time[-1] == pytest.approx((end - 1 - peak) / blows.rate)
    np.testing.assert_allclose(
        seen.response[0], blows.data[1, end - seen.time.size : end], rtol=1e-5
    )
    # sin² over T = 6 ms: its transform is sinc(fT)/(1 − (fT)²); three samples tell it to 0.5 dB
    share = np.sinc(0.006 * 150) / (1 - (0.006 * 150) ** 2)
    level = np.interp(150.0, seen.freqs, seen.force_level)
    assert level == pytest.approx(20 * np.log10(share), abs=0.5)


def test_what_is_kept_decides_the_coherence(tmp_path: Path) -> None:
    small_study.write_data(tmp_path, ambient=False)
    sheet = read_sensor_sheet(tmp_path / "sensors.csv")
    (hammer, _), _ = read_log(tmp_path / "campaign.json")
    every = kept_frfs(hammer, sheet, (), ())
    assert every.averages.tolist() == [3.0]
    less = kept_frfs(hammer, sheet, (), [Hit(hammer.name, 20.27, False, "cable")])
    assert less.averages.tolist() == [2.0]
    none = [Hit(hammer.name, t, False, "cable") for t in (0.27, 20.27, 40.27)]
    with pytest.raises(DataError, match="none of 3 hits can be used"):
        kept_frfs(hammer, sheet, (), none)
