"""A few channels of a record, and as much of it as shows what machines do to it."""

from __future__ import annotations

import numpy as np
from scipy.fft import next_fast_len, rfft

from ringtrue.core.arrays import Any_
from ringtrue.core.signals import TimeHistory
from ringtrue.signal.pyramid import Signals, detrended

EYES, LONGEST = 4, 1 << 21  # channels (four transforms go in step) and samples


def listened(history: TimeHistory) -> Any_:
    """(ch, sample) float32, less about their means: at most `EYES` channels and `LONGEST`
    samples.
    """
    at = np.unique(np.linspace(0, len(history.channels) - 1, EYES).astype(np.int64))
    return Signals.of(history.data).part(0, min(history.data.shape[1], LONGEST), at)


def listened_spectrum(history: TimeHistory) -> tuple[Any_, int]:
    """Transform (ch, line) complex64 of these without their straight lines, and its length."""
    x = listened(history)
    n = int(next_fast_len(x.shape[1], real=True))
    return rfft(detrended(x).data, n, axis=1), n
