"""Blows of a machine in regular succession (a press, a pile driver): found, and the response to
them taken out.

Correlations that reach from one blow to the next do not average out where the intervals are alike.
Strokes whose times are known are an input: the mean response to one is the least-squares filter
from them to the record. What is left of each varies from stroke to stroke without memory, and does
no harm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_toeplitz
from scipy.ndimage import maximum_filter1d

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.signal.prediction import unforeseen
from ringtrue.signal.sweeps import mixes

WINDOW = 4  # samples
ABOVE = 10.0  # times the median power of the error: of a normal one none of a million windows
FAINT = 4.0  # times the same, where a blow is due
APART = 4  # windows to either side without a second stroke
FEWEST = 30  # strokes
REGULAR, ALIKE = 0.8, 0.15  # share of the intervals that are within so much of the median
TAPS, EARLY = 2000, 3  # samples of the response at most, and before the stroke
SHARE = 0.05  # of the samples of the record, at most
RIDGE = 1e-2  # equal intervals tell the response to one stroke from that to the next no more


@dataclass(frozen=True, slots=True)
class Strokes:
    """How many blows, and their median interval, s."""

    count: int
    interval: float


def without_strokes(
    history: TimeHistory, heard: Any_ | None = None
) -> tuple[TimeHistory, Strokes | None]:
    """The record without the mean response to regular blows, and these; the same object where there
    are none.

    `heard` are its `sweeps.mixes`, if known.
    """
    at = _strokes(mixes(history.data) if heard is None else heard)
    if not _regular(at):
        return history, None
    taps = min(TAPS, int(SHARE * history.data.shape[1]))
    usual = float(np.median(np.diff(at)))
    return replace(history, data=_left(history.data, at, taps)), Strokes(
        at.size, usual / history.rate
    )


def _regular(at: Int) -> bool:
    """Whether there are many blows (k,), most of them at equal intervals."""
    if at.size < FEWEST:
        return False
    interval = np.diff(at)
    return bool((np.abs(interval / np.median(interval) - 1) < ALIKE).mean() >= REGULAR)


def _strokes(some: Any_) -> Int:
    """(k,) samples at which the signals (ch, sample) are struck."""
    error = np.stack([unforeseen(x) ** 2 for x in some])
    n = error.shape[1] // WINDOW * WINDOW
    power = error[:, :n].reshape(len(error), -1, WINDOW) @ np.full(
        WINDOW, 1 / WINDOW, dtype=error.dtype
    )
    typical = np.median(power, axis=1, keepdims=True)
    if not n or not (typical > 0).all():
        return np.empty(0, dtype=np.int64)
    power = (power / typical).mean(axis=0)
    top = _with_faint(
        np.flatnonzero((power > ABOVE) & (power >= maximum_filter1d(power, 2 * APART + 1))), power
    )
    around = np.clip(WINDOW * top[:, None] + np.arange(-2, WINDOW + 2), 0, error.shape[1] - 1)
    each = (error[:, around] / typical[:, :, None]).mean(axis=0)
    return np.asarray(np.unique(around[np.arange(top.size), each.argmax(axis=1)]), dtype=np.int64)


def _with_faint(top: Int, power: Any_) -> Int:
    """Windows (k,) of regular blows, with the faint ones that are due between them: one left in
    would sound on.
    """
    if not _regular(top):
        return top
    usual = float(np.median(np.diff(top)))
    reach = int(ALIKE * usual)
    faint = []
    for a, b in pairwise(top.tolist()):
        for k in range(1, round((b - a) / usual)):
            middle = round(a + k * (b - a) / round((b - a) / usual))
            at = middle - reach + int(power[middle - reach : middle + reach + 1].argmax())
            faint += [at] if power[at] > FAINT else []
    return np.union1d(top, np.array(faint, dtype=np.int64))


def _left(data: Any_, at: Int, taps: int) -> Any_:
    """`data` (ch, sample) less what a filter of so many `taps` makes of unit blows at the samples
    `at`.
    """
    samples = data.shape[1]
    n = int(next_fast_len(samples + taps, real=True))
    blows = rfft(np.bincount(at, minlength=samples).astype(np.float64), n)
    r = irfft(blows.real**2 + blows.imag**2, n)[:taps]
    r[0] *= 1 + RIDGE
    shift = np.exp(2j * np.pi * EARLY / n * np.arange(blows.size))
    out = np.empty_like(data)
    for y, x in zip(out, data, strict=True):  # channels: one transform is long
        cross = irfft(rfft(x - x.mean(dtype=np.float64), n) * (blows * shift).conj(), n)[:taps]
        response: Float = solve_toeplitz(r, cross)
        y[:] = x - irfft(rfft(response, n) * blows * shift, n)[:samples]
    return out
