"""Clocks of recorders: a band-limited motion sampled at times that are known."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.align import align, at_positions, compare_clocks, delay

RATE = 100.0
N = 30000


def motion(t: np.ndarray, seed: int = 0) -> np.ndarray:
    """A sum of sines up to 35 Hz: its value at any time is exact."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(1, 35, 150), rng.uniform(0, 2 * np.pi, 150)
    out = np.zeros_like(t)
    for a, b in zip(f, phase, strict=True):
        out += np.sin(2 * np.pi * a * t + b)
    return out


def test_delay_between_samples() -> None:
    t = np.arange(4000) / RATE
    for tau in (0.0, 0.01234, -0.5678):
        got, r = delay(motion(t), motion(t - tau), RATE, 2.0)
        assert got == pytest.approx(tau, abs=5e-5)  # the ends of the record, 1/200 of a sample
        assert r > 0.95


def test_interpolation_is_exact_within_the_band() -> None:
    t = np.arange(3000) / RATE
    positions = np.linspace(100, 2800, 1777)
    got = at_positions(motion(t)[None], positions)[0]
    np.testing.assert_allclose(got, motion(positions / RATE), atol=1e-3)  # 90 dB below 150 sines


@pytest.mark.parametrize(("offset", "drift"), [(0.0, 0.0), (1.2345, 20e-6), (-3.21, -150e-6)])
def test_clock_is_found_and_mended(offset: float, drift: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(N) / RATE
    ref = np.stack([motion(t), motion(t, 7)]) + 0.5 * rng.standard_normal((2, N))
    clean = motion(
        (t - offset) / (1 + drift)
    )  # what the clock of the other calls t is this time of the reference
    other = clean + 0.5 * rng.standard_normal(N)
    a = TimeHistory(ref, RATE, (Channel("1+Z"), Channel("2+Z")), "a")
    b = TimeHistory(other[None], RATE, (Channel("3+Z"),), "b")
    clock = compare_clocks(a, b, ("1+Z", "3+Z"))
    assert clock.offset == pytest.approx(offset, abs=5 * clock.std_offset + 2e-5)
    assert clock.drift == pytest.approx(drift, abs=5 * clock.std_drift + 1e-7)
    assert clock.std_drift < 2e-6
    both = align(a, b, clock)
    assert both.data.shape[1] > N - 5 * RATE
    x, y = both.data[0, 100:-100], both.data[2, 100:-100]
    assert np.corrcoef(x, y)[0, 1] > 0.99


def test_unrelated_recorders_and_rates_are_told() -> None:
    rng = np.random.default_rng(2)
    a = TimeHistory(rng.standard_normal((1, N)), RATE, (Channel("1"),), "a")
    b = TimeHistory(rng.standard_normal((1, N)), RATE, (Channel("2"),), "b")
    with pytest.raises(DataError, match="another pair"):
        compare_clocks(a, b, ("1", "2"))
    with pytest.raises(DataError, match="decimate"):
        compare_clocks(a, TimeHistory(b.data, 200.0, b.channels), ("1", "2"))
