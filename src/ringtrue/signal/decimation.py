"""Trends, drifts and bands of records: filters, decimation, block by block where a record is larger
than memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.signal.spectra import step

_STOP = 90.0  # dB
DEGREE = (
    24  # of the polynomials of a drift, at most: 8 cycles in the record, where bands begin at 50
)
BLOCK = 1 << 16  # samples at a time: a basis of the whole record would not fit in memory


@dataclass(frozen=True, slots=True, eq=False)
class Fir:
    """A symmetric filter and the samples that it is decimated by; its delay is taken out.

    Attributes
    ----------
    taps : (2 k + 1,) float64
    factor : int
    """

    taps: Float
    factor: int = 1

    def __post_init__(self) -> None:
        if (
            self.taps.size % 2 == 0
            or self.factor < 1
            or np.abs(self.taps - self.taps[::-1]).max() > 1e-12
        ):
            raise ConfigError(
                f"{self.taps.size} taps and factor {self.factor}: odd, symmetric and 1 or more "
                "are needed"
            )


def decimator(factor: int) -> Fir:
    """Flat to 0.4 of the new rate, 90 dB down from 0.5 of it."""
    if factor < 2:
        raise ConfigError(f"decimation by {factor}: must be 2 or more")
    return Fir(_low_pass(0.4 / factor, 0.5 / factor), factor)


def high_passer(corner: float, rate: float) -> Fir:
    """Gain 1 from `corner` Hz, 90 dB down below half of it."""
    if not 0 < corner < rate / 4:
        raise ConfigError(
            f"high-pass at {corner} Hz: must be > 0 and below a quarter of the rate {rate} Hz"
        )
    taps = -_low_pass(0.5 * corner / rate, corner / rate)
    taps[taps.size // 2] += 1.0
    return Fir(taps)


def _low_pass(start: float, stop: float) -> Float:
    """Taps of a low-pass with its edge from `start` to `stop`, in cycles per sample."""
    from scipy.signal import firwin, kaiserord  # slow to import, and few commands need it

    count, beta = kaiserord(_STOP, 2 * (stop - start))
    taps = firwin(count | 1, start + stop, window=("kaiser", beta), scale=True)
    return np.asarray(taps, dtype=np.float64)


def filtered(blocks: Iterable[TimeHistory], fir: Fir) -> Iterator[TimeHistory]:
    """The filtered record, block by block, as if it were filtered whole with zeros around it.

    Parameters
    ----------
    blocks : iterable of TimeHistory
        The parts of one record, one after the other, of any length: `io.records.record_blocks`.
    fir : Fir

    Yields
    ------
    TimeHistory
        float64. Together they have a sample for each `factor` samples of the record, the first for
        the first.

    Raises
    ------
    DataError
        If the blocks have different channels or rates.
    """
    half = fir.taps.size // 2
    last: TimeHistory | None = None
    held: Any_ = np.zeros((0, 0))
    begin = 0  # sample of the record at which `held` begins
    wanted = 0  # next sample of the record to give out
    for block in blocks:
        if last is None:
            held, begin = np.zeros((len(block.channels), half)), -half
        elif block.channels != last.channels or block.rate != last.rate:
            raise DataError(
                f"{block.source}: a block has other channels or another rate than the one before"
            )
        last = block
        held = np.concatenate([held, block.data], axis=1)
        part, wanted = _given(held, begin, wanted, fir)
        keep = max(wanted - half - begin, 0)
        held, begin = held[:, keep:], begin + keep
        if part.shape[1]:
            yield replace(block, data=part, rate=block.rate / fir.factor)
    if last is not None:
        part, _ = _given(
            np.concatenate([held, np.zeros((held.shape[0], half))], axis=1), begin, wanted, fir
        )
        if part.shape[1]:
            yield replace(last, data=part, rate=last.rate / fir.factor)


def _given(held: Any_, begin: int, wanted: int, fir: Fir) -> tuple[Float, int]:
    """The outputs whose inputs are all there, and the next sample of the record to give out."""
    from scipy.signal import oaconvolve  # slow to import, and few commands need it

    half = fir.taps.size // 2
    end = begin + held.shape[1] - half  # outputs before this one are complete
    if end <= wanted:
        return np.zeros((held.shape[0], 0)), wanted
    start = wanted - half - begin
    whole = oaconvolve(held[:, start:], fir.taps[None], mode="valid", axes=1)
    part = np.ascontiguousarray(whole[:, : end - wanted : fir.factor])
    return part, wanted + part.shape[1] * fir.factor


@dataclass(frozen=True, slots=True)
class Band:
    """A frequency band and the rate that it is decimated to, Hz.

    Attributes
    ----------
    low, high : float
        Modes are taken from here.
    rate : float
        Sampling rate after decimation; the true one may differ by rounding to a fast FFT length.
    """

    low: float
    high: float
    rate: float


def detrend(data: Any_) -> Float:
    """`data` (ch, sample) as float64 less mean and straight line of each channel."""
    y = np.array(data, dtype=np.float64)
    t = np.linspace(-1.0, 1.0, y.shape[1])
    for x in y:  # in place: there may be many samples
        x -= x.mean()
        x -= (x @ t / (t @ t)) * t
    return y


def band_signals(data: Any_, rate: float, bands: Sequence[Band]) -> tuple[tuple[Float, float], ...]:
    """Each band of the record, filtered with zero phase and decimated, by one FFT per channel.

    The gain falls from 1 at 0.4 to 0 at 0.5 of the new rate (no edge where nothing is decimated)
    and from 1 at two thirds to 0 at one third of the lower band limit.

    Parameters
    ----------
    data : (ch, sample) float
    rate : float, Hz
    bands : sequence of Band

    Returns
    -------
    tuple of (signals (ch, sample) float64, rate Hz), one for each band
    """
    samples = data.shape[1]
    n = int(next_fast_len(samples + samples // 50, real=True))
    freqs = rfftfreq(n, 1 / rate)
    sizes = [
        n if b.rate >= rate else int(next_fast_len(round(n * b.rate / rate), real=True))
        for b in bands
    ]
    keep = [samples * m // n for m in sizes]
    out = [np.empty((len(data), k)) for k in keep]
    gains = []
    for b, m in zip(bands, sizes, strict=True):
        f, new = freqs[: m // 2 + 1], rate * m / n
        edge = step(f, 0.5 * new, 0.4 * new) if m < n else np.ones(f.size)
        gains.append(step(f, b.low / 3, b.low / 1.5) * edge * (m / n))
    batch = max(1, 8_000_000 // n)
    for i in range(
        0, len(data), batch
    ):  # the whole spectrum of all channels would double the memory
        spectrum = rfft(detrend(data[i : i + batch]), n, axis=1)
        for y, g, m, k in zip(out, gains, sizes, keep, strict=True):
            y[i : i + batch] = irfft(spectrum[:, : g.size] * g, m, axis=1)[:, :k]
    return tuple((y, rate * m / n) for y, m in zip(out, sizes, strict=True))


def decimate(history: TimeHistory, rate: float) -> TimeHistory:
    """The record at a lower rate, Hz (zero phase; usable to 0.4 of the new rate, which is
    rounded).
    """
    if not 0 < rate < history.rate:
        raise DataError(
            f"decimation to {rate} Hz: must be > 0 and below the rate {history.rate} Hz"
        )
    data, new = band_signals(history.data, history.rate, (Band(0.0, 0.4 * rate, rate),))[0]
    return replace(history, data=data, rate=new)


def remove_drift(history: TimeHistory, low: float) -> TimeHistory:
    """The record without what drifts far below `low` Hz, in channels where that is more than all
    else.

    Least squares in Legendre polynomials, of a degree that leaves all from half of `low` on as it
    is.

    Parameters
    ----------
    history : TimeHistory
        (channel, sample), finite.
    low : float, Hz
        Lowest frequency of interest.
    """
    samples = history.data.shape[1]
    degree = min(int(np.clip(0.5 * low * history.duration, 1, DEGREE)), samples - 1)
    places = np.linspace(-1.0, 1.0, samples)
    offset = history.data[:, :1].astype(np.float64)
    gram = np.zeros((degree + 1, degree + 1))
    right = np.zeros((degree + 1, len(history.data)))
    for start in range(0, samples, BLOCK):
        part = slice(start, start + BLOCK)
        basis = legvander(places[part], degree)
        gram += basis.T @ basis
        right += basis.T @ (history.data[:, part] - offset).T
    drift = np.linalg.solve(gram, right)
    drift[0] += offset[:, 0]
    power = np.einsum("pc,pq,qc->c", drift, gram, drift)
    much = power > 0.5 * np.einsum("cs,cs->c", history.data, history.data, dtype=np.float64)
    if not much.any():
        return history
    data = np.array(history.data)
    for start in range(0, samples, BLOCK):
        part = slice(start, start + BLOCK)
        basis = legvander(places[part], degree)
        data[much, part] = history.data[much, part] - (basis @ drift[:, much]).T
    return replace(history, data=data)


def unit_factor(history: TimeHistory) -> float:
    """The power of two that brings the typical standard deviation of the channels near 1; it
    changes no digit.
    """
    exponent = np.frexp(np.median(history.data.std(axis=1, dtype=np.float64)))[1]
    return float(np.ldexp(1.0, -int(exponent)))


def scaled(history: TimeHistory, factor: float) -> TimeHistory:
    """The record times one factor in all channels, which changes no shape."""
    return replace(history, data=history.data * history.data.dtype.type(factor))
