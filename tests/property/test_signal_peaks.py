"""Peaks, windows, filters and convolutions are those of scipy.signal, which takes half a second to import."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from ringtrue.core.arrays import Float
from ringtrue.signal.peaks import prominent_peaks
from ringtrue.signal.stream import convolved, decimator, high_passer
from ringtrue.signal.windows import COSINES, WindowName, window

ROUNDING = 1e-13


@given(st.lists(st.integers(0, 6), min_size=1, max_size=60), st.integers(0, 5))
def test_peaks_flat_tops_and_equal_heights_too(level: list[int], prominence: int) -> None:
    x = np.array(level, dtype=np.float64)
    np.testing.assert_array_equal(prominent_peaks(x, prominence), signal.find_peaks(x, prominence=prominence)[0])


@given(st.integers(0, 2**32 - 1), st.integers(1, 3000), st.integers(1, 61))
def test_convolution(seed: int, samples: int, taps: int) -> None:
    rng = np.random.default_rng(seed)
    x, h = rng.standard_normal((2, samples)), rng.standard_normal(taps)
    expected = np.array([np.convolve(row, h)[:samples] for row in x])
    np.testing.assert_allclose(convolved(x, h), expected, atol=ROUNDING * 100)


@pytest.mark.parametrize("name", COSINES)
def test_windows(name: WindowName) -> None:
    w = signal.get_window(name, 240)
    np.testing.assert_allclose(window(name, 240), w / np.sqrt(np.mean(w**2)), atol=ROUNDING)


def _low_pass(start: float, stop: float) -> Float:
    count, beta = signal.kaiserord(90.0, 2 * (stop - start))
    return np.asarray(signal.firwin(count | 1, start + stop, window=("kaiser", beta)))


def test_filters() -> None:
    for factor in (2, 4, 5):
        np.testing.assert_allclose(decimator(factor).taps, _low_pass(0.4 / factor, 0.5 / factor), atol=ROUNDING)
    for corner in (0.02, 0.2):
        low = _low_pass(0.5 * corner, corner)
        high = -low + (np.arange(low.size) == low.size // 2)
        np.testing.assert_allclose(high_passer(corner, 1.0).taps, high, atol=ROUNDING)
