"""Sines in the random response of one mode: told by kurtosis, taken out without harm to the
mode.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.signal.harmonic_evidence import line_statistics
from ringtrue.signal.order_tracking import (
    edit_cepstrum,
    phase_of_pulses,
    phase_of_speed,
    refine_frequency,
    remove_orders,
    remove_tracked_lines,
)
from ringtrue.signal.tonal_lines import find_tonal_lines, remove_tonal_lines

RATE, N = 100.0, 40000
T = np.arange(N) / RATE
MODE = 8.0


def response(seed: int = 0) -> np.ndarray:
    """One mode at 8 Hz, 1 %, under white noise; unit rms."""
    rng = np.random.default_rng(seed)
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * MODE / RATE)
    y = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal((2, N)), axis=1)
    return np.asarray(y / y.std(axis=1, keepdims=True))


def record(y: np.ndarray) -> TimeHistory:
    return TimeHistory(y, RATE, tuple(Channel(f"{i + 1}+Z") for i in range(len(y))), "r")


def test_kurtosis_tells_a_sine_from_a_mode() -> None:
    y = response() + 0.5 * np.sin(2 * np.pi * 20.0 * T)
    mode, sine = line_statistics(record(y), [MODE, 20.0], 0.5)
    assert (mode.harmonic, sine.harmonic) == (False, True)
    assert sine.kurtosis == pytest.approx(1.5, abs=0.05)
    assert mode.kurtosis == pytest.approx(
        3.0, abs=0.5
    )  # 400 s of 0.16 Hz: some 60 independent envelopes
    with pytest.raises(ConfigError, match="must be in"):
        line_statistics(record(y), [60.0], 0.5)
    with pytest.raises(DataError, match="too short"):
        line_statistics(record(y), [20.0], 0.01)


def test_a_steady_line_is_refined_and_removed() -> None:
    y = response()
    f = 16.66873
    hum = np.array([[2.0], [1.0]]) * np.sin(2 * np.pi * f * T + 0.3)
    assert refine_frequency(record(y + hum), 16.7, 0.2) == pytest.approx(f, abs=1e-5)
    left, (exact,) = remove_tracked_lines(record(y + hum), [16.7], 0.05)
    assert exact == pytest.approx(f, abs=1e-5)
    assert np.sqrt(((left.data - y) ** 2).mean()) < 0.01  # of unit rms


def test_orders_of_a_running_machine() -> None:
    """A speed from 3 to 12 Hz passes the mode; the first and second order go, the mode stays."""
    y = response()
    speed = 3.0 + 9.0 * T / T[-1]
    phase = phase_of_speed(speed, RATE)
    wave = np.cos(2 * np.pi * phase) + 0.5 * np.cos(4 * np.pi * phase + 1)
    left, rms = remove_orders(record(y + wave), phase, [1.0, 2.0], 0.05)
    assert np.sqrt(((left.data - y) ** 2).mean()) < 0.08  # the wave had 0.79
    np.testing.assert_allclose(rms[:, 0], [0.5**0.5, 0.125**0.5], rtol=0.05)


def test_phase_of_a_tachometer() -> None:
    times = np.arange(0.5, 399.0, 0.25)
    phase = phase_of_pulses(times, N, RATE, per_turn=2)
    np.testing.assert_allclose(np.diff(phase) * RATE, 2.0, rtol=1e-9)
    with pytest.raises(DataError, match="must rise"):
        phase_of_pulses([1.0, 0.5, 2.0], N, RATE)


def test_cepstrum_takes_a_family_of_harmonics() -> None:
    y = response()
    family = sum(0.4 * np.cos(2 * np.pi * 2.5 * k * T + k) for k in range(1, 20))
    left = edit_cepstrum(record(y + family), 2.5)
    spectrum = np.abs(np.fft.rfft(left.data[0] * np.hanning(N))) / np.abs(
        np.fft.rfft((y + family)[0] * np.hanning(N))
    )
    lines = np.round(2.5 * np.arange(1, 20) * N / RATE).astype(int)
    assert np.median(spectrum[lines]) < 0.2
    assert left.data[0].std() == pytest.approx(y[0].std(), rel=0.25)
    with pytest.raises(ConfigError, match="period"):
        edit_cepstrum(record(y), 40.0)


def test_a_sine_on_the_flank_of_a_mode_is_listed_and_leaves_the_mode_whole() -> None:
    """1200 s, the sine 0.02 Hz from a mode of a half bandwidth of 0.08 Hz: 22 lines of the
    periodogram.
    """
    rng, t = np.random.default_rng(5), np.arange(120_000) / RATE
    pole = np.exp((-0.01 + 1j * np.sqrt(1 - 1e-4)) * 2 * np.pi * MODE / RATE)
    y = np.outer(
        [1.0, 0.6, -0.8],
        lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(t.size)),
    )
    y += 0.02 * y.std() * rng.standard_normal(y.shape)
    assert find_tonal_lines(record(y)) == ()
    machine = record(y + 2 * y.std() * np.outer([0.3, 1.0, 1.0], np.sin(2 * np.pi * 8.02 * t + 1)))
    (line,) = find_tonal_lines(machine)
    assert line.frequency == pytest.approx(8.02, abs=1e-4)
    left = remove_tonal_lines(machine, [line.frequency]).data
    assert (
        np.abs(left - y).std() < 0.2 * y.std()
    )  # what it takes of the mode: 8 of the 200 lines of its band
    found = identify_ambient(machine)
    assert [h.frequency for h in found.harmonics] == [line.frequency]
    assert len(found.modes) == 1
    assert np.abs(found.modes.frequencies - MODE) < 4 * found.uncertainty.frequency
    assert np.abs(found.modes.damping - 0.01) < 4 * found.uncertainty.damping
