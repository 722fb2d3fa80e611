"""One pass over a signal at one rate: correlations of its band by blocks, and the signals at the
next rate.

Overlapped segments are transformed once, and their spectra give both, so that a pass costs little
more than its FFT. The filters are symmetric and finite and the segments overlap by their lengths:
nothing depends on where a segment begins, and the correlations are those of the whole filtered
signal.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.fft import ihfft, irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.signal.spectra import AT_ONCE, Fir

UNDER_WAY = 2  # items of threads, however many there are: all of them are in memory


T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Segments:
    """How a signal is cut.

    Attributes
    ----------
    blocks, each : int
        Blocks, and segments of each.
    hop : int
        Samples of a segment that count; a multiple of `factor`.
    lead : int
        Samples before and behind them, for the filters.
    size : int
        Length of the transform.
    lags : int
        Largest lag.
    factor : int
        That the signals of the next rate are decimated by.
    """

    blocks: int
    each: int
    hop: int
    lead: int
    size: int
    lags: int
    factor: int


def segments(
    samples: int, blocks: int, lags: int, band: Fir, decimation: Fir, *, references: int
) -> Segments:
    """A cut of `samples` into equal blocks, with room for a filter of the band and one that
    decimates, for correlations with so many references.
    """
    factor = decimation.factor
    lead = -(-(max(band.taps.size, decimation.taps.size) // 2 + 16) // factor) * factor
    overhang = 2 * lead + lags
    block = -(-samples // blocks)
    # long ones overlap less, but each block has the inverse transforms of all its correlations
    each = max(1, round(np.sqrt(references * block / overhang)))
    hop = -(-block // (each * factor)) * factor
    size = factor * int(next_fast_len(-(-(hop + overhang) // factor), real=True))
    return Segments(
        blocks=blocks,
        each=each,
        hop=hop,
        lead=lead,
        size=size,
        lags=lags,
        factor=factor,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Signals less a level, which is taken off where they are read: a copy of a long record takes
    its time.

    Attributes
    ----------
    data : (ch, sample) float
    level : (ch,) float64
    """

    data: Any_
    level: Float

    @classmethod
    def of(cls, data: Any_) -> Signals:
        """Less about their mean, from some of the samples: what is left is below all bands."""
        some = data[:, :: max(1, min(64, data.shape[1] // 1000))]
        return cls(data, some.mean(1, dtype=np.float64))

    def power(self) -> Float:
        """(ch,) mean squares."""
        n = self.samples
        step = max(1, AT_ONCE // self.level.size)
        total = np.zeros(self.level.size)
        room = np.empty((self.level.size, min(step, n)), dtype=np.float32)
        for k in range(0, n, step):
            x = self.part(k, min(k + step, n), out=room[:, : min(step, n - k)])
            total += np.einsum("cs,cs->c", x, x)
        return total / max(n, 1)

    @property
    def samples(self) -> int:
        """Of each channel."""
        return int(self.data.shape[1])

    def part(
        self,
        start: int,
        stop: int,
        rows: Int | slice = slice(None),
        out: Any_ | None = None,
    ) -> Any_:
        """(ch, stop − start) float32, zero beyond the ends; in `out`, if given."""
        a = max(start, 0)
        b = min(stop, self.samples)
        level = self.level[rows].astype(self.data.dtype)
        if out is None:
            out = np.empty((level.size, stop - start), dtype=np.float32)
        if a >= b:
            out[:] = 0.0
            return out
        out[:, : a - start], out[:, b - start :] = 0.0, 0.0
        inner = out[:, a - start : b - start]
        if isinstance(rows, slice):
            np.subtract(
                self.data[rows, a:b], level[:, None], out=inner, casting="same_kind"
            )
        else:  # channels one by one: all at once would be copied first
            for x, k, own in zip(inner, rows, level, strict=True):
                np.subtract(self.data[k, a:b], own, out=x, casting="same_kind")
        return out


def detrended(data: Any_) -> Signals:
    """The signals less their mean and straight line, in place."""
    if not data.shape[1]:
        return Signals(data, np.zeros(len(data)))
    t = np.linspace(-1.0, 1.0, data.shape[1], dtype=np.float32)
    mean = np.full(t.size, 1 / t.size, dtype=np.float32)
    slope = t / np.float32(max(float(t @ t), 1.0))
    for x in data:
        x -= x @ mean
        x -= (x @ mean) + (x @ slope) * t
    return Signals(data, np.zeros(len(data)))


def _gain(fir: Fir, size: int) -> Any_:
    """(freq,) float32 real gain of a symmetric filter."""
    half = fir.taps.size // 2
    h = np.zeros(size)
    h[: half + 1], h[size - half :] = fir.taps[half:], fir.taps[:half]
    return rfft(h).real.astype(np.float32)


def glance(signals: Signals, cut: Segments, band: Fir) -> tuple[Float, Float]:
    """Root mean squares (ch,) of the band, and correlations (ch, ch) at lag 1 in their units, from
    the first segment of each block.
    """
    some = np.arange(cut.blocks) * cut.each  # one of each block
    gain = _gain(band, cut.size)
    turn = np.exp(2j * np.pi * np.arange(gain.size) / cut.size).astype(np.complex64)
    ch = signals.level.size
    power = np.zeros(ch)
    lagged = np.zeros((ch, ch))
    for k in some.tolist():
        start = k * cut.hop - cut.lead
        y = rfft(signals.part(start, start + cut.size), axis=1) * gain
        flat = y.view(np.float32)
        power += np.einsum("cf,cf->c", flat, flat)
        lagged += (y * turn).view(np.float32) @ flat.T
    size = np.sqrt(np.maximum(power, 1e-300))
    return np.sqrt(2 * power / some.size) / cut.size, lagged / (size[:, None] * size)


def pairs(cut: Segments, samples: int, keep: Any_ | None = None) -> Float:
    """(block, lags + 1) pairs of samples of each block, those whose earlier one is kept
    (sample,).
    """
    block = cut.each * cut.hop
    begin = np.arange(cut.blocks)[:, None] * block
    if keep is None:
        return np.asarray(
            np.clip(samples - np.arange(cut.lags + 1) - begin, 1, block),
            dtype=np.float64,
        )
    total = np.append(0.0, np.cumsum(keep, dtype=np.float64))
    last = (np.minimum(begin + block, samples - np.arange(cut.lags + 1))).clip(
        0, samples
    )
    return np.asarray(np.maximum(total[last] - total[np.minimum(begin, last)], 1.0))


def run(
    signals: Signals,
    cut: Segments,
    band: Fir,
    decimation: Fir,
    references: Int,
    keep: Any_ | None = None,
) -> tuple[Any_, Any_]:
    """One pass.

    Parameters
    ----------
    signals : Signals
    cut : Segments
    band, decimation : Fir
        What makes the band of the signal, and what leads to the next rate.
    references : (ref,) int64
    keep : (sample,) float32, optional
        1 for each t that is used, 0 for others.

    Returns
    -------
    correlation : (block, lags + 1, ch, ref) float32
        Of the band; R[k] = mean of y(t + k) y_ref(t)ᵀ over the t of the block.
    lower : (ch, sample / factor) float32
        Decimated signals; of no length with factor 1.
    """
    gain = _gain(band, cut.size)
    low = _gain(decimation, cut.size)
    ch = signals.level.size
    n = signals.samples
    q = cut.factor
    block = cut.each * cut.hop
    lower = np.empty((ch, cut.blocks * block // q if q > 1 else 0), dtype=np.float32)
    r = np.empty((cut.blocks, cut.lags + 1, ch, references.size), dtype=np.float32)
    batch = _together(cut, ch, cut.each)
    room = np.empty((ch, (batch - 1) * cut.hop + cut.size), dtype=np.float32)
    cross, some = np.empty((2, gain.size, ch, references.size), dtype=np.complex64)
    for b in range(cut.blocks):  # in memory one at a time
        cross[:] = 0.0
        for k in range(b * cut.each, (b + 1) * cut.each, batch):
            count = min(batch, (b + 1) * cut.each - k)
            start = k * cut.hop
            x = _cut_out(signals, cut, start, count, room)
            y = _spectra(x, cut, count)
            ref = _references(
                x, cut, count, references, _kept(keep, start, count * cut.hop)
            )
            cross += np.matmul(y, ref, out=some)
            if q > 1:
                lower[:, start // q : (start + count * cut.hop) // q] = _decimated(
                    y, cut, low
                )
        cross *= (gain**2)[:, None, None]
        r[b] = irfft(cross, cut.size, axis=0)[cut.lead : cut.lead + cut.lags + 1]
    r /= pairs(cut, n, keep)[:, :, None, None].astype(np.float32)
    return r, lower[:, : -(-n // q)]


def lowered(signals: Signals, decimation: Fir) -> Any_:
    """(ch, sample) float32 decimated signals."""
    ch = signals.level.size
    n = signals.samples
    cut = segments(
        n,
        -(-n // max(4 * decimation.taps.size, 4096)),
        0,
        decimation,
        decimation,
        references=0,
    )
    gain = _gain(decimation, cut.size)
    q = cut.factor
    out = np.empty((ch, cut.blocks * cut.each * cut.hop // q), dtype=np.float32)
    batch = _together(cut, ch, cut.blocks * cut.each)
    room = np.empty((ch, (batch - 1) * cut.hop + cut.size), dtype=np.float32)
    for k in range(0, cut.blocks * cut.each, batch):
        count = min(batch, cut.blocks * cut.each - k)
        start = k * cut.hop
        x = _cut_out(signals, cut, start, count, room)
        out[:, start // q : (start + count * cut.hop) // q] = _decimated(
            _spectra(x, cut, count), cut, gain
        )
    return out[:, : -(-n // q)]


def _together(cut: Segments, ch: int, count: int) -> int:
    """How many of `count` segments of `ch` channels are transformed at a time, in parts as equal as
    may be.
    """
    most = max(AT_ONCE // (ch * cut.size), 1)
    return -(-count // -(-count // most))


def _cut_out(
    signals: Signals, cut: Segments, start: int, count: int, room: Any_
) -> Any_:
    """(ch, sample) of `count` segments from `start`, with what leads and follows, in `room`: new
    memory costs time.
    """
    first = start - cut.lead
    wide = (count - 1) * cut.hop + cut.size
    return signals.part(first, first + wide, out=room[:, :wide])


def _spectra(x: Any_, cut: Segments, count: int) -> Any_:
    """(freq, ch, segment) complex64 of `count` segments of the part `x` (ch, sample)."""
    strides = (x.strides[1], x.strides[0], cut.hop * x.strides[1])
    return rfft(as_strided(x, (cut.size, len(x), count), strides), axis=0)


def _kept(keep: Any_ | None, start: int, size: int) -> Any_ | None:
    """The part of `keep`, zero beyond its end."""
    if keep is None:
        return None
    out = np.zeros(size, dtype=np.float32)
    part = keep[start : start + size]
    out[: part.size] = part
    return out


def _references(
    x: Any_, cut: Segments, count: int, references: Int, keep: Any_ | None
) -> Any_:
    """(freq, segment, ref) conjugate spectra of the samples of each segment that count."""
    padded = np.zeros((references.size, count, cut.size), dtype=np.float32)
    for row, k in zip(padded[:, :, : cut.hop], references, strict=True):
        inner = x[k, cut.lead : cut.lead + count * cut.hop].reshape(count, cut.hop)
        np.multiply(inner, 1 if keep is None else keep.reshape(count, cut.hop), out=row)
    return ihfft(padded.transpose(2, 1, 0), axis=0, norm="forward")


def _decimated(y: Any_, cut: Segments, gain: Any_) -> Any_:
    """(ch, sample) decimated signals of the spectra `y` (freq, ch, segment): what counts of each
    segment.
    """
    q = cut.factor
    m = cut.size // cut.factor
    z = irfft(
        y[: m // 2 + 1] * (gain[: m // 2 + 1, None, None] / np.float32(q)), m, axis=0
    )
    return (
        z[cut.lead // q : (cut.lead + cut.hop) // q]
        .transpose(1, 2, 0)
        .reshape(y.shape[1], -1)
    )


def threads() -> int:
    """How many work at once: as many as OMP_NUM_THREADS says or, where it is not set, as there are
    cores.
    """
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(
        max(int(asked), 1) if asked.isdecimal() else os.cpu_count() or 1, UNDER_WAY
    )


def map_in_threads(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Results in the order of the items; the next item is taken when the result before the last one
    has been given.
    """
    under_way: deque[Future[R]] = deque()
    with ThreadPoolExecutor(threads()) as pool:
        for item in items:
            under_way.append(pool.submit(work, item))
            if len(under_way) == UNDER_WAY:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
