"""Filters from block to block give what the whole record gives; sensors are taken out within a
band.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.record_layout import RecordChannel
from ringtrue.io.records import record_blocks, write_record
from ringtrue.signal.decimation import decimator, filtered, high_passer
from ringtrue.signal.sensor_response import (
    Accelerometer,
    Calibration,
    Geophone,
    deconvolve,
    usable_band,
)

RATE = 200.0


def record(n: int = 5000) -> TimeHistory:
    rng = np.random.default_rng(0)
    return TimeHistory(rng.standard_normal((3, n)), RATE, tuple(Channel(f"{i}") for i in range(3)))


def cut(history: TimeHistory, sizes: list[int]) -> list[TimeHistory]:
    ends = np.cumsum([0, *sizes, history.data.shape[1]]).clip(max=history.data.shape[1])
    return [
        TimeHistory(history.data[:, a:b], RATE, history.channels)
        for a, b in pairwise(ends.tolist())
        if b > a
    ]


@pytest.mark.parametrize(
    "fir", [decimator(5), high_passer(4.0, RATE)], ids=["decimate", "high-pass"]
)
@pytest.mark.parametrize("sizes", [[5000], [1, 2, 3, 700, 33], [999] * 5])
def test_blocks_give_what_the_whole_gives(fir: object, sizes: list[int]) -> None:
    whole = record()
    parts = list(filtered(cut(whole, sizes), fir))  # type: ignore[arg-type]
    got = np.hstack([p.data for p in parts])
    taps, factor = fir.taps, fir.factor  # type: ignore[attr-defined]
    want = np.stack(
        [np.convolve(x, taps)[taps.size // 2 :][: x.size][::factor] for x in whole.data]
    )
    np.testing.assert_allclose(got, want, atol=1e-12)
    assert parts[0].rate == RATE / factor


def test_filters_pass_and_stop() -> None:
    t = np.arange(20000) / RATE

    def gain(fir: object, f: float) -> float:
        history = TimeHistory(np.sin(2 * np.pi * f * t)[None], RATE, (Channel("a"),))
        out = np.hstack([p.data for p in filtered([history], fir)])  # type: ignore[arg-type]
        return float(np.sqrt(2) * out[0, out.shape[1] // 4 : -out.shape[1] // 4].std())

    assert gain(decimator(5), 15.9) == pytest.approx(1.0, abs=1e-4)
    assert gain(decimator(5), 20.1) < 1e-4
    assert gain(high_passer(4.0, RATE), 4.1) == pytest.approx(1.0, abs=1e-4)
    assert gain(high_passer(4.0, RATE), 1.9) < 1e-4
    with pytest.raises(ConfigError, match="2 or more"):
        decimator(1)


def test_streams_from_a_file(tmp_path: Path) -> None:
    whole = record()
    rows = [RecordChannel(c.id) for c in whole.channels]
    write_record(tmp_path / "r.h5", np.asarray(whole.data), RATE, rows)
    got = np.hstack([p.data for p in filtered(record_blocks(tmp_path / "r.h5", 777), decimator(4))])
    want = np.hstack([p.data for p in filtered([whole], decimator(4))])
    np.testing.assert_allclose(got, want, atol=1e-6)  # float32 in the file
    some = list(record_blocks(tmp_path / "r.h5", 1000, channels=["2", "0"], overlap=100))
    np.testing.assert_array_equal(some[0].data[:, -100:], some[1].data[:, :100])
    assert [c.id for c in some[0].channels] == ["2", "0"]
    with pytest.raises(DataError, match="overlap"):
        next(record_blocks(tmp_path / "r.h5", 10, overlap=10))


def band_noise(n: int, low: float, high: float) -> np.ndarray:
    rng = np.random.default_rng(5)
    f = np.fft.rfftfreq(n, 1 / RATE)
    return np.fft.irfft(
        np.where(
            (f > low) & (f < high),
            rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size),
            0,
        )
    )


SENSORS = {
    "accelerometer": Accelerometer(0.2, 300.0, 0.05, 0.1),
    "geophone": Geophone(4.5, 0.56, 28.0),
    "sheet": Calibration(
        np.array([0.5, 5.0, 90.0]),
        np.array([0.5, 1.0, 1.2]),
        np.array([40.0, 5.0, -20.0]),
        "velocity",
    ),
}


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_is_taken_out_in_its_band(name: str) -> None:
    sensor = SENSORS[name]
    n = 8192
    x = band_noise(n, 3.0, 70.0)
    signal = np.fft.irfft(np.fft.rfft(x) * sensor.response(np.fft.rfftfreq(n, 1 / RATE)), n)
    out = deconvolve(TimeHistory(signal[None], RATE, (Channel("1+Z"),)), sensor, low=2.0, high=80.0)
    inner = slice(n // 4, -n // 4)  # the record is periodic, its deconvolution is not
    assert np.abs(out.data[0, inner] - x[inner]).max() < 0.02 * np.abs(x).max()
    assert out.channels[0].quantity == ("acceleration" if name == "accelerometer" else "velocity")


def test_usable_band_of_a_geophone() -> None:
    """|H| = 1/10 at about f₀/√10 (second order); above it is flat."""
    low, high = usable_band(Geophone(4.5, 0.7), 1000.0)
    assert low == pytest.approx(4.5 / np.sqrt(10), rel=0.05)
    assert high == pytest.approx(500.0)
    low, high = usable_band(Accelerometer(resonance=100.0, damping=0.01), 1000.0)
    assert high < 100.0
    with pytest.raises(ConfigError, match="must be > 0"):
        Accelerometer(-1.0)
