"""Sines in the random response of one mode: told by kurtosis, taken out without harm to the
mode.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.signal.tonal_lines import find_tonal_lines, remove_tonal_lines

RATE, N = 100.0, 40000
T = np.arange(N) / RATE
MODE = 8.0


def response(seed: int = 0) -> np.ndarray:
    """One mode at 8 Hz, 1 %, under white noise; unit rms."""
    rng = np.random.default_rng(seed)
    pole = np.exp((-0.01 + 1j) * 2 * np.pi * MODE / RATE)
    y = lfilter(
        [1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal((2, N)), axis=1
    )
    return np.asarray(y / y.std(axis=1, keepdims=True))


def record(y: np.ndarray) -> TimeHistory:
    return TimeHistory(
        y, RATE, tuple(Channel(f"{i + 1}+Z") for i in range(len(y))), "r"
    )


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
    machine = record(
        y + 2 * y.std() * np.outer([0.3, 1.0, 1.0], np.sin(2 * np.pi * 8.02 * t + 1))
    )
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
