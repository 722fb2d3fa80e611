"""Linear prediction: what a signal could not foresee from its past is the force of the moment."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, rfft
from scipy.linalg import solve_toeplitz

from ringtrue.core.arrays import Any_

FRAME = 1024  # samples: longer transforms leave the cache
ORDER = 60  # of the prediction


def unforeseen(x: Any_) -> Any_:
    """Error (sample,) of the linear prediction of a signal (sample,) from what went before (Yule
    and Walker).
    """
    from scipy.signal import oaconvolve  # slow to import, and few commands need it

    frames = x[: x.size // FRAME * FRAME].reshape(-1, FRAME)
    spectra = rfft(frames, 2 * FRAME, axis=1)
    r = irfft((spectra.real**2 + spectra.imag**2).sum(axis=0, dtype=np.float64))[: ORDER + 1]
    if not r[0] > 0:
        return np.zeros_like(x)
    r[0] *= 1 + 1e-6
    filter_ = np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])]).astype(x.dtype)
    foreseen: Any_ = oaconvolve(x, filter_)
    return foreseen[: x.size]
