"""Windows of spectral estimates and smooth edges of frequency-domain filters."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ringtrue.core.arrays import Float

WindowName = Literal["hann", "hamming", "blackmanharris", "flattop", "boxcar"]
COSINES: dict[WindowName, tuple[float, ...]] = {  # Harris (1978); flat top: D'Antona, Ferrero (2006)
    "hann": (0.5, 0.5),
    "hamming": (0.54, 0.46),
    "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168),
    "flattop": (0.21557895, 0.41663158, 0.277263158, 0.083578947, 0.006947368),
    "boxcar": (1.0,),
}


def window(name: WindowName, samples: int) -> Float:
    """(sample,) float64 periodic window of unit mean square, so that a periodogram keeps its power."""
    turn = 2 * np.pi * np.arange(samples) / samples
    w = sum((-1) ** k * a * np.cos(k * turn) for k, a in enumerate(COSINES[name]))
    return np.asarray(w / np.sqrt(np.mean(w**2)))


def step(freqs: Float, start: float, stop: float) -> Float:
    """(f,) gain from 0 at `start` to 1 at `stop`, Hz, a squared-sine edge; reversed if start > stop."""
    if start == stop:
        return np.asarray(freqs >= stop, dtype=np.float64)
    x = np.clip((np.asarray(freqs, dtype=np.float64) - start) / (stop - start), 0.0, 1.0)
    edge = (x > 0.0) & (x < 1.0)
    x[edge] = np.sin(0.5 * np.pi * x[edge]) ** 2
    return np.asarray(x)
