"""Windows of spectral estimates and smooth edges of frequency-domain filters."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ringtrue.core.arrays import Float

WindowName = Literal["hann", "hamming", "blackmanharris", "flattop", "boxcar"]


def window(name: WindowName, samples: int) -> Float:
    """(sample,) float64 periodic window of unit mean square, so that a periodogram keeps its
    power.
    """
    from scipy.signal import get_window  # slow to import, and few commands need it

    w = np.asarray(get_window(name, samples, fftbins=True), dtype=np.float64)
    return np.asarray(w / np.sqrt(np.mean(w**2)))


def step(freqs: Float, start: float, stop: float) -> Float:
    """(f,) gain from 0 at `start` to 1 at `stop`, Hz, a squared-sine edge; reversed if start >
    stop.
    """
    if start == stop:
        return np.asarray(freqs >= stop, dtype=np.float64)
    x = np.clip((np.asarray(freqs, dtype=np.float64) - start) / (stop - start), 0.0, 1.0)
    edge = (x > 0.0) & (x < 1.0)
    x[edge] = np.sin(0.5 * np.pi * x[edge]) ** 2
    return np.asarray(x)
