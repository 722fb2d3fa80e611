"""Sines of constant frequency: seen in the periodogram of the whole record, and taken out without
touching a mode.

A mode in random vibration spreads over ζ f T lines of a periodogram of the length T, a sine over
the one of its window. So a sine stands out even on the peak of a mode where both run for long;
fitted by least squares with a slow change of amplitude and phase, it takes with it a few lines of
the mode only. What is left of a machine whose amplitude or speed wanders is the foot of its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import maximum_filter1d

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.listened import LONGEST, listened
from ringtrue.signal.preprocess import Harmonic, line_name
from ringtrue.signal.windows import window

# in which the least damped structure (0.05 %) spreads over four lines of the periodogram
CYCLES = 3600.0
ABOVE = 50.0  # times the median around; noise reaches it once in 2^50
EMPTY = 1e-7  # of the record: no recorder has 140 dB
ROUNDING = 1e-12  # of the strongest line: below is the rounding of single precision
BESIDE = 25.0  # times the median just outside of the lobe
FOOT = 1.6  # times the level to either side, where a line was
FOOT_IN, FOOT_OUT = 60, 300  # lines to each side that hold a foot, and those beyond its sides
AROUND = 40  # lines to each side
LOBE = 5  # lines to each side of a sine that the window holds
SLOW = 4  # polynomials of amplitude and phase
BLOCK = 1 << 16  # samples that are fitted at a time
MOST = 256  # lines of machines, the strongest: a shop's mains hum and shafts have no more
TOGETHER = 32  # lines that are fitted at a time: a fit of all would cost the square of their number


def steady_lines(
    history: TimeHistory, *, low: float = 0.0, high: float = np.inf
) -> tuple[Harmonic, ...]:
    """Sines of constant frequency between `low` and `high` Hz, the strongest where there are more
    than `MOST`.

    Parameters
    ----------
    history : TimeHistory
        At most 4 channels and 2 million samples of it are looked at.
    """
    power, step = _periodogram(history)
    samples = min(history.data.shape[1], LONGEST)
    if samples < 16 * AROUND:
        return ()
    k = np.flatnonzero(power >= maximum_filter1d(power, 2 * LOBE + 1, mode="nearest"))
    k = k[(k > AROUND) & (k < power.size - AROUND) & (step * k * samples / history.rate > CYCLES)]
    k = k[power[k] > ROUNDING * power.max()]
    beyond = np.arange(LOBE + 1, LOBE + 5)
    side = np.median(power[k + np.concatenate([-beyond, beyond])[:, None]], axis=0)
    k = k[power[k] > BESIDE * side]
    k = k[power[k] > ABOVE * np.median(power[k + np.arange(-AROUND, AROUND + 1)[:, None]], axis=0)]
    bend = np.log(np.maximum(power[k + np.arange(-1, 2)[:, None]], 1e-300))
    f = step * (k + 0.5 * (bend[0] - bend[2]) / (bend[0] - 2 * bend[1] + bend[2]))
    inside = (f > low) & (f < high)
    k, f = k[inside], f[inside]
    f = f[np.sort(np.argsort(-power[k], kind="stable")[:MOST])]
    why = "steady frequency, taken out before modes are sought"
    names = [line_name(float(x), 2 * step, f[:i].tolist()) for i, x in enumerate(f)]
    return tuple(Harmonic(float(x), f"{name}: {why}") for x, name in zip(f, names, strict=True))


def with_feet(history: TimeHistory, frequencies: Sequence[float]) -> tuple[float, ...]:
    """Those of the `frequencies` (Hz) of lines that were taken out where something is left beside
    them, on both sides.

    It may be a mode of little damping, but more likely is a machine whose amplitude or speed
    wanders.
    """
    if not len(frequencies):
        return ()
    power, step = _periodogram(history)
    out = []
    for f in frequencies:  # a few lines
        k = round(f / step)
        if not FOOT_OUT < k < power.size - FOOT_OUT:
            continue
        near = np.median(
            np.concatenate([power[k - FOOT_IN : k - LOBE], power[k + LOBE : k + FOOT_IN]])
        )
        sides = (power[k - FOOT_OUT : k - FOOT_OUT // 2], power[k + FOOT_OUT // 2 : k + FOOT_OUT])
        if near > FOOT * max(np.median(x) for x in sides):
            out.append(float(f))
    return tuple(out)


def _periodogram(history: TimeHistory) -> tuple[Float, float]:
    """(freq,) of some channels, of unit variance each, and the distance of its lines, Hz."""
    x = listened(history)
    scale = np.maximum(
        x[:, :: max(1, x.shape[1] // 20000)].std(axis=1, dtype=np.float64, keepdims=True), 1e-300
    )
    x *= (1 / scale).astype(np.float32)
    x *= _taper(x.shape[1])
    n = int(next_fast_len(x.shape[1], real=True))
    y = rfft(x, n, axis=1).view(
        np.float32
    )  # single precision is 120 dB below the record, and halves the time
    y *= y
    return np.asarray((y[:, ::2] + y[:, 1::2]).sum(axis=0, dtype=np.float64)), history.rate / n


def _taper(samples: int) -> Any_:
    """Blackman-Harris window (sample,) float32 by powers of one cosine."""
    c: Any_ = np.cos(np.arange(samples, dtype=np.float32) * np.float32(2 * np.pi / samples))
    c2 = c * c
    return (0.35875 - 0.14128) + c * (3 * 0.01168 - 0.48829) + c2 * (2 * 0.14128 - 4 * 0.01168 * c)


def without_lines(history: TimeHistory, frequencies: Sequence[float]) -> TimeHistory:
    """The record without sines of constant frequencies, Hz, of slowly changing amplitude and phase.

    Least squares over the whole record by a window that keeps close modes out of the fit.

    Raises
    ------
    DataError
        If nothing but rounding is left.
    """
    if not len(frequencies):
        return history
    data = np.array(history.data)
    parts = [frequencies[k : k + TOGETHER] for k in range(0, len(frequencies), TOGETHER)]
    sweeps = (
        1 if len(parts) == 1 else 2
    )  # the second mends what neighbours in two parts took of each other
    for part in parts * sweeps:
        _take_out(data, history.rate, part)
    if (
        data.std(axis=1, dtype=np.float64) <= EMPTY * history.data.std(axis=1, dtype=np.float64)
    ).all():
        told = " ".join(f"{f:.5g}" for f in frequencies[:8])
        raise DataError(
            f"{history.source}: nothing but steady lines at {told} Hz: a machine or a generator, "
            "no mode"
        )
    return replace(history, data=data)


def _take_out(data: Any_, rate: float, frequencies: Sequence[float]) -> None:
    """Fit some lines to the signals (ch, sample) and take them out, in place."""
    samples = data.shape[1]
    taper = window("hann", samples)
    columns = 2 * SLOW * len(frequencies)
    gram, right = np.zeros((columns, columns)), np.zeros((columns, len(data)))
    for start in range(0, samples, BLOCK):  # a basis of the whole record would not fit in memory
        a = _basis(rate, samples, frequencies, start)
        weighted = a * taper[start : start + BLOCK, None]
        gram += weighted.T @ a
        right += weighted.T @ data[:, start : start + BLOCK].T.astype(np.float64)
    x = np.linalg.lstsq(gram, right)[0]
    for start in range(0, samples, BLOCK):
        data[:, start : start + BLOCK] -= (_basis(rate, samples, frequencies, start) @ x).T.astype(
            data.dtype
        )


def _basis(rate: float, samples: int, frequencies: Sequence[float], start: int) -> Float:
    """(sample, column) sines and cosines times Legendre polynomials over the record, from a sample
    on.
    """
    t = np.arange(start, min(start + BLOCK, samples))
    slow = legvander(2 * t / samples - 1, SLOW - 1)
    turn = 2 * np.pi * t[:, None] * (np.asarray(frequencies) / rate)
    both = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    return np.asarray((both[:, :, None] * slow[:, None]).reshape(t.size, -1))
