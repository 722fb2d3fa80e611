"""Long signals at the size of a screen: extremes, spectra and spectrograms of any part of a record.

What reads samples is given as a function, so that a record may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, FrozenArrays
from ringtrue.signal.spectra import one_sided, segments_spectrum, window

Spans = Sequence[tuple[int, int]]  # first sample and end of parts of a record
Read = Callable[[Spans], Iterator[Any_]]  # of which each is (channel, sample)
BLOCK = 1024  # samples whose extremes are kept
DIRECT = 1 << 20  # samples that are read anew for every picture
STEP = 1 << 20  # samples in memory at a time
SEGMENTS = 160  # of a spectrum, spread over the part


@dataclass(frozen=True, slots=True, eq=False)
class Extremes(FrozenArrays):
    """Part of some signals as a screen shows it.

    Attributes
    ----------
    first : (k,) int64
        First sample of each bin.
    low, high : (channel, k) float64
        Extremes of the finite samples in each bin; NaN where there is none. Equal where a bin is
        one sample.
    lost : (channel, k) bool
        Bins with samples that are not finite.
    """

    first: Any_
    low: Float
    high: Float
    lost: Bool


def _bins(data: Any_, size: int) -> tuple[Float, Float, Bool]:
    """Lowest and highest finite value of each `size` samples, and whether one is not finite."""
    channels, samples = data.shape
    count = -(-samples // size)
    whole = np.full((channels, count * size), np.nan, dtype=data.dtype)
    whole[:, :samples] = data
    parts = whole.reshape(channels, count, size)
    lost = ~np.isfinite(data)
    flags = np.zeros((channels, count * size), dtype=np.bool_)
    flags[:, :samples] = lost
    if lost.any():
        parts = np.where(np.isfinite(parts), parts, np.nan)
    low = np.fmin.reduce(parts, axis=2)
    high = np.fmax.reduce(parts, axis=2)
    return low, high, np.asarray(flags.reshape(channels, count, size).any(axis=2))


def extremes(read: Read, samples: int) -> Extremes:
    """The envelope of whole signals in bins of `BLOCK` samples, read once from end to end."""
    spans = [(start, min(start + STEP, samples)) for start in range(0, samples, STEP)]
    parts = [_bins(data, BLOCK) for data in read(spans)]
    low, high, lost = (np.concatenate(x, axis=1) for x in zip(*parts, strict=True))
    return Extremes(BLOCK * np.arange(low.shape[1]), low, high, lost)


def envelope(
    read: Read, start: int, stop: int, *, bins: int, whole: Callable[[], Extremes]
) -> Extremes:
    """Samples `start` to `stop`, as they are where these are few, else their extremes in about
    `bins` bins.

    Parameters
    ----------
    read : callable
    start, stop : int
    bins : int
    whole : callable
        Gives `extremes` of the record; called for long parts only.
    """
    length = stop - start
    if length <= DIRECT:
        (data,) = read([(start, stop)])
        size = max(1, -(-length // bins)) if length > 2 * bins else 1
        low, high, lost = _bins(data, size)
        return Extremes(start + size * np.arange(low.shape[1]), low, high, lost)
    known = whole()
    a = start // BLOCK
    b = min(-(-stop // BLOCK), known.first.size)
    size = max(1, -(-(b - a) // bins))
    low = _bins(known.low[:, a:b], size)[0]
    high = _bins(known.high[:, a:b], size)[1]
    lost = _bins(np.where(known.lost[:, a:b], np.nan, 0.0), size)[2]
    return Extremes(BLOCK * (a + size * np.arange(low.shape[1])), low, high, lost)


def spectra(
    read: Read, start: int, stop: int, *, rate: float, resolution: float
) -> tuple[Float, Float, int]:
    """Welch estimate of each channel over a part of a record: frequencies (f,) Hz, densities
    (channel, f) unit²/Hz, and the segments behind them.

    Segments under a Hann window, half overlapping, or spread evenly where there are more than
    `SEGMENTS`; those with samples that are not finite are left out.
    """
    length = min(max(2 * round(rate / resolution / 2), 16), stop - start)
    last = stop - start - length
    count = min(2 * last // length + 1, SEGMENTS)
    win = window("hann", length)
    used = 0
    total: Float = np.zeros((1, length // 2 + 1))
    for data in read(_segments(start, last, length, count)):  # one at a time in memory
        power = _power(data, win)
        total = total + np.where(np.isfinite(power).all(), power, 0.0)
        used += int(np.isfinite(power).all())
    freqs = _lines(length, rate)
    density = total * (one_sided(rate, length, used) if used else np.nan)
    return freqs, density, used


@dataclass(frozen=True, slots=True, eq=False)
class Spectrogram(FrozenArrays):
    """Spectra of one signal along its time.

    Attributes
    ----------
    first : (t,) int64
        First sample of each segment.
    freqs : (f,) float64, Hz
    level : (f, t) float64, dB of unit²/Hz
    """

    first: Any_
    freqs: Float
    level: Float


def spectrogram(
    read: Read,
    start: int,
    stop: int,
    *,
    rate: float,
    longest: int = 512,
    columns: int = 300,
) -> Spectrogram:
    """At most `columns` spectra of the first channel, spread over a part of a record, of `longest`
    samples each, or a sixteenth of the part.
    """
    length = min(longest, max(2 * ((stop - start) // 32), 16))
    last = stop - start - length
    count = max(1, min(4 * last // length + 1, columns))
    spans = _segments(start, last, length, count)
    win = window("hann", length)
    power = np.stack([_power(data[:1], win)[0] for data in read(spans)], axis=1)
    density = power * one_sided(rate, length, 1)[:, None]
    floor = np.nanmax(density, initial=0.0) * 1e-14 + np.finfo(np.float64).tiny
    return Spectrogram(
        np.array([first for first, _ in spans]),
        _lines(length, rate),
        10 * np.log10(np.maximum(density, floor)),
    )


def _lines(length: int, rate: float) -> Float:
    """Frequencies of a segment, Hz."""
    return np.asarray(np.fft.rfftfreq(length, 1 / rate), dtype=np.float64)


def _segments(start: int, last: int, length: int, count: int) -> Spans:
    """Segments of one length, spread evenly; the last one begins `last` samples behind `start`."""
    at = np.linspace(start, start + last, max(count, 1)).astype(np.int64)
    return [(first, first + length) for first in at.tolist()]


def _power(data: Any_, win: Float) -> Float:
    """(channel, f) squared spectra of one windowed segment."""
    wide = np.asarray(data, dtype=np.float64)
    (y,) = segments_spectrum(wide, np.zeros(1, dtype=np.int64), win)
    return np.asarray(np.abs(y) ** 2)
