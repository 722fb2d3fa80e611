"""Sines of machines and mains: seen in the periodogram of the whole record, and taken out without
touching a mode.

A mode in random vibration spreads over ζ f T lines of a periodogram of the length T, a sine over
the one of its window. So a sine stands out even on the peak of a mode where both run for long;
fitted by least squares with a slow change of amplitude and phase, it takes with it a few lines of
the mode only. What is left of a machine whose amplitude or speed wanders is the foot of its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial.legendre import legvander
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import maximum_filter1d, median_filter

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.band_correlations import Signals, detrended
from ringtrue.signal.spectra import window

_LINES = 32  # channels that show the lines of machines, at most
_BATCH = 8  # segments that are transformed together
_CLEAR = 30.0, 10.0, 1.35  # times the power beside a steady line and around it, and its moment
_DOUBT, _EVERY, _MANY = (
    (15.0, 5.0, 1.6),
    4,
    100,
)  # what each fourth segment of many shows of one at least
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
EYES, LONGEST = 4, 1 << 21  # channels (four transforms go in step) and samples


@dataclass(frozen=True, slots=True)
class Harmonic:
    """A spectral line of a machine or the mains: frequency in Hz and why it is taken for one.

    `moment` is the normalised fourth moment of its amplitude: 1 of a steady sine, 2 of a mode in
    random vibration.
    """

    frequency: float
    why: str
    moment: float = 1.0


def line_name(f: float, resolution: float, found: Sequence[float]) -> str:
    """What a line at `f` Hz is: mains hum, a multiple of one `found` already, or a machine."""
    for mains in (50.0, 60.0, 50.0 / 3):
        k = round(f / mains)
        if k >= 1 and abs(f - k * mains) < max(resolution, 2e-3 * f):
            return f"mains hum, {k} x {mains:.4g} Hz"
    for base in found:
        k = round(f / base)
        if k >= 2 and abs(f - k * base) < 2 * resolution:
            return f"{k} x {base:.4g} Hz"
    return "a rotating machine"


def harmonics(history: TimeHistory, *, low: float = 0.0, cycles: int = 0) -> tuple[Harmonic, ...]:
    """Lines with a steady amplitude and no width: machines and mains hum, not modes.

    The normalised fourth moment E|Y|⁴/(E|Y|²)² of the short-time spectra over time is 2 for a mode
    in random vibration and 1 for a sine (Antoni 2006, spectral kurtosis); the line must also be as
    narrow as the window.

    Parameters
    ----------
    low : float, Hz
        Look above this frequency.
    cycles : int
        Segments of the record; 0 chooses 120 of half overlap, or fewer lines in a short record.
    """
    data, rate = history.data, history.rate
    segments = cycles or 120
    length = int(next_fast_len(max(256, 2 * data.shape[1] // (segments + 1)), real=True))
    if data.shape[1] < 16 * length // 2:
        return ()
    if (
        2 * data.shape[1] > _MANY * length
        and not _steady(*_moments(data, length, every=_EVERY), *_DOUBT).size
    ):
        return ()
    second, kurtosis = _moments(data, length)
    line, freqs = _steady(second, kurtosis, *_CLEAR), rfftfreq(length, 1 / rate)
    found = [float(freqs[i]) for i in line if freqs[i] > low]
    names = [line_name(f, freqs[1], found[:i]) for i, f in enumerate(found)]
    return tuple(
        Harmonic(f, f"{name}: steady line (fourth moment {k:.2f}, a mode has 2)", k)
        for f, name, k in zip(
            found, names, kurtosis[np.rint(found / freqs[1]).astype(np.int64)].tolist(), strict=True
        )
    )


def _steady(second: Float, moment: Float, over_side: float, over_floor: float, limit: float) -> Int:
    """Lines of the spectrum `second` (freq,) as narrow as the window, whose `moment` (freq,) is
    below the limit.
    """
    floor = median_filter(second, size=41, mode="nearest")
    at = np.arange(8, second.size - 8)
    side = np.maximum(second[at - 5], second[at + 5])
    peak = (second[at] >= second[at - 1]) & (second[at] > second[at + 1])
    clear = (second[at] > over_side * side) & (second[at] > over_floor * floor[at])
    return np.asarray(at[peak & clear & (moment[at] < limit)], dtype=np.int64)


def _moments(data: Any_, length: int, *, every: int = 1) -> tuple[Float, Float]:
    """Power (freq,) summed over normalised channels, and its normalised second moment over time.

    Of half-overlapped segments of `length` samples, all or one of `every` so many. The moment is
    the mean of those of the channels by their power: the sum of the powers of two modes in
    different directions would look steadier than either.
    """
    win, total, moment = window("blackmanharris", length), *np.zeros((2, length // 2 + 1))
    room = np.empty((_BATCH, length), dtype=np.float32)
    for i in np.unique(np.linspace(0, len(data) - 1, _LINES).astype(np.int64)):
        some = data[i, :: max(1, data.shape[1] // 20000)]
        level, scale = (
            some.mean(dtype=np.float64),
            max(float(np.std(some, dtype=np.float64)), 1e-30),
        )
        gain, parts = (
            (win / scale).astype(np.float32),
            sliding_window_view(data[i], length)[:: every * (length // 2)],
        )
        first, second = np.zeros((2, length // 2 + 1))
        for k in range(
            0, len(parts), _BATCH
        ):  # in the cache, and in place: most of the time is that of the transforms
            x = room[: min(_BATCH, len(parts) - k)]
            np.subtract(parts[k : k + _BATCH], level, out=x, casting="same_kind")
            x *= gain
            y = rfft(x, axis=1).view(np.float32)
            y *= y
            power = y[:, ::2] + y[:, 1::2]
            first += power.sum(0)
            second += np.einsum("sf,sf->f", power, power)
        total += first / len(parts)
        moment += second / np.maximum(first, np.finfo(np.float64).tiny)
    return total, moment / np.maximum(total, np.finfo(np.float64).tiny)


def find_tonal_lines(
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


def unsteady_lines(history: TimeHistory, frequencies: Sequence[float]) -> tuple[float, ...]:
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


def remove_tonal_lines(history: TimeHistory, frequencies: Sequence[float]) -> TimeHistory:
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


def listened(history: TimeHistory) -> Any_:
    """(ch, sample) float32, less about their means: at most `EYES` channels and `LONGEST`
    samples.
    """
    at = np.unique(np.linspace(0, len(history.channels) - 1, EYES).astype(np.int64))
    return Signals.of(history.data).part(0, min(history.data.shape[1], LONGEST), at)


def excerpt_spectrum(history: TimeHistory) -> tuple[Any_, int]:
    """Transform (ch, line) complex64 of these without their straight lines, and its length."""
    x = listened(history)
    n = int(next_fast_len(x.shape[1], real=True))
    return rfft(detrended(x).data, n, axis=1), n
