"""Windows, spectral densities (Welch) and correlation functions of records.

Trends, drifts and bands of records: filters, decimation, block by block where a record is larger
than memory. The transfer function of a geophone, and its deconvolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import SI_UNIT
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError

AT_ONCE = 1 << 21  # numbers that are worked on together: they stay in the cache
WindowName = Literal["hann", "hamming", "blackmanharris", "flattop", "boxcar"]


@dataclass(frozen=True, slots=True)
class Welch:
    """Settings of a Welch estimate of segments that overlap by half.

    Attributes
    ----------
    resolution : float, Hz
        Distance of the frequency lines.
    window : str
    """

    resolution: float
    window: WindowName = "hann"

    def __post_init__(self) -> None:
        if not self.resolution > 0:
            raise ConfigError(f"Welch: resolution {self.resolution} must be > 0")


@dataclass(frozen=True, slots=True, eq=False)
class Csd:
    """One-sided cross-spectral density.

    Attributes
    ----------
    data : (freq, ch, ch) complex128, unit²/Hz
        E[Y_i conj(Y_j)].
    freqs : (freq,) float64, Hz
    channels : tuple of Channel
    segments : int
        Segments averaged (overlapping ones counted in full).
    """

    data: Complex
    freqs: Float
    channels: tuple[Channel, ...]
    segments: int


def segments_spectrum(data: Any_, starts: Int, win: Any_) -> Any_:
    """(segment, ch, freq) spectra of mean-free, windowed segments of `data` (ch, sample), precision
    as `win`.
    """
    at = starts[:, None] + np.arange(win.size)
    seg = np.asarray(data[:, at], dtype=win.dtype)
    seg -= seg.mean(-1, keepdims=True)
    return np.asarray(rfft(seg * win, axis=-1)).transpose(1, 0, 2)


def csd(history: TimeHistory, settings: Welch) -> Csd:
    """Welch estimate of all channels against all, (freq, ch, ch); a few segments in memory at a
    time.

    Raises
    ------
    DataError
        If the record is shorter than one segment.
    """
    data = history.data
    win, starts = _welch_segments(history, settings)
    total = np.zeros((win.size // 2 + 1, len(data), len(data)), dtype=np.complex128)
    batch = max(1, AT_ONCE // (win.size * len(data)))
    # streamed: a batch of segments is what is in memory
    for i in range(0, starts.size, batch):
        y = np.ascontiguousarray(
            segments_spectrum(data, starts[i : i + batch], win).transpose(2, 1, 0)
        )
        total += y @ y.conj().transpose(0, 2, 1)
    total *= one_sided(history.rate, win.size, starts.size)[:, None, None]
    freqs = rfftfreq(win.size, 1 / history.rate)
    return Csd(total, freqs, history.channels, int(starts.size))


def psd(history: TimeHistory, settings: Welch) -> tuple[Float, Float]:
    """Frequencies (freq,), Hz, and the Welch estimate of each channel by itself, (ch, freq).

    Raises
    ------
    DataError
        As `csd` does.
    """
    data = history.data
    win, starts = _welch_segments(history, settings)
    total = np.zeros((len(data), win.size // 2 + 1))
    batch = max(1, AT_ONCE // (win.size * len(data)))
    for i in range(0, starts.size, batch):
        y = segments_spectrum(data, starts[i : i + batch], win)
        total += (y.real**2 + y.imag**2).sum(axis=0)
    total *= one_sided(history.rate, win.size, starts.size)
    return rfftfreq(win.size, 1 / history.rate), total


def _welch_segments(history: TimeHistory, settings: Welch) -> tuple[Float, Int]:
    """The window of a segment, and the first samples of all."""
    length = round(history.rate / settings.resolution)
    samples = history.data.shape[1]
    if samples < length:
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for a resolution of "
            f"{settings.resolution:.4g} Hz; it needs {1 / settings.resolution:.4g} s"
        )
    hop = max(1, length // 2)
    starts = np.arange(0, samples - length + 1, hop, dtype=np.int64)
    return window(settings.window, length), starts


def one_sided(rate: float, length: int, count: int) -> Float:
    """What makes sums over `count` segments one-sided densities, (freq,)."""
    scale = np.full(length // 2 + 1, 2.0 / (rate * length * count))
    scale[0] /= 2.0
    if length % 2 == 0:
        scale[-1] /= 2.0
    return scale


def block_correlations(
    data: Float, references: Int, lags: int, bounds: Int
) -> tuple[Float, Float]:
    """Correlations of each block of the record, each pair (t + k, t) of samples used once.

    R_b[k] = Σ_t y(t + k) y_ref(t)ᵀ / n_b[k] over the t of block b; y(t + k) reaches into the next
    blocks, so the weighted sum over the blocks is the exact correlation of the whole record.

    Parameters
    ----------
    data : (ch, sample) float64
    references : (ref,) int64
    lags : int
        The largest lag k.
    bounds : (block + 1,) int64
        First sample of each block, and the end of the record.

    Returns
    -------
    correlation : (block, lags + 1, ch, ref) float64
    count : (block, lags + 1) float64
        The number of pairs n_b[k].
    """
    ch, n = data.shape
    sizes = np.diff(bounds)
    nfft = int(
        next_fast_len(int(min(max(12 * lags, 256), sizes.max() + lags)), real=True)
    )
    hop = nfft - lags
    out = np.empty((sizes.size, lags + 1, ch, references.size))
    # a block at a time in memory
    for b, (start, end) in enumerate(pairwise(bounds.tolist())):
        at = np.arange(0, end - start, hop)[:, None] + np.arange(nfft)
        block = np.zeros((ch, int(at[-1, -1]) + 1))
        part = data[:, start : min(end + lags, n)]
        block[:, : part.shape[1]] = part
        y = rfft(block[:, at], axis=-1)
        x = rfft(
            block[references][:, at] * ((np.arange(nfft) < hop) & (at < end - start)),
            axis=-1,
        )
        left = np.ascontiguousarray(y.transpose(2, 0, 1))
        right = np.ascontiguousarray(x.conj().transpose(2, 1, 0))
        out[b] = irfft(left @ right, nfft, axis=0)[: lags + 1]
    count = np.minimum(
        sizes[:, None], np.maximum(n - np.arange(lags + 1) - bounds[:-1, None], 0)
    ).astype(np.float64)
    return out / np.maximum(count, 1.0)[:, :, None, None], count


def correlations(data: Float, references: Int, lags: int) -> Float:
    """R (lags + 1, ch, ref) float64 of the whole record `data` (ch, sample), R[k] = mean of y(t +
    k) y_ref(t)ᵀ.
    """
    size = max(20 * lags, 20000)
    bounds = np.append(np.arange(0, data.shape[1], size), data.shape[1]).astype(
        np.int64
    )
    r, count = block_correlations(
        np.asarray(data, dtype=np.float64), references, lags, bounds
    )
    return np.asarray(np.einsum("bk,bkij->kij", count / count.sum(0), r))


@dataclass(frozen=True, slots=True)
class HalfSpectrumSettings:
    """Half spectra.

    Attributes
    ----------
    lags : int
        Of a half spectrum of a whole record.
    ends_at : float
        What the exponential window leaves at the last of them.
    """

    lags: int = 400
    ends_at: float = 0.01


HALF = HalfSpectrumSettings()


@dataclass(frozen=True, slots=True, eq=False)
class HalfSpectra:
    """Spectra of the correlations at positive lags, of the form of FRFs.

    Attributes
    ----------
    data : (freq, ch, ref) complex128
    freqs : (freq,) float64, Hz
    decay : float, 1/s
        Of the exponential window on the correlations, which is in the poles.
    """

    data: Complex
    freqs: Float
    decay: float


def half_spectra(r: Float, rate: float, band: tuple[float, float]) -> HalfSpectra:
    """Those of correlations `r` (lag, ch, ref), from lag 0 on, of signals at `rate`, Hz, at the
    lines in the band, Hz, and a little around it.

    Peeters and Van der Auweraer (2005), "PolyMAX: a revolution in operational modal analysis",
    IOMAC. Lag 0 holds the noise of the sensors and is left out.
    """
    lags = len(r) - 1
    decay = -np.log(HALF.ends_at) * rate / lags
    tapered = np.exp(-decay * np.arange(1, lags + 1) / rate)[:, None, None]
    freqs = np.arange(lags // 2 + 1) * rate / lags
    late = np.exp(-2j * np.pi * freqs / rate)[:, None, None]
    at = (freqs >= 0.9 * band[0]) & (freqs <= min(1.1 * band[1], 0.48 * rate))
    at &= freqs > 0
    data = (rfft(r[1:] * tapered, axis=0) * late)[at]
    return HalfSpectra(data, freqs[at], float(decay))


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
    x = np.clip(
        (np.asarray(freqs, dtype=np.float64) - start) / (stop - start), 0.0, 1.0
    )
    edge = (x > 0.0) & (x < 1.0)
    x[edge] = np.sin(0.5 * np.pi * x[edge]) ** 2
    return np.asarray(x)


def block_bounds(samples: int, blocks: int) -> Int:
    """(block + 1,) first sample of each block, and the end."""
    return np.linspace(0, samples, blocks + 1).round().astype(np.int64)


def block_weights(power: Float) -> Float:
    """(block,) weights, sum 1, of blocks of mean square `power` (block,): loud ones count as
    typical ones.

    A jump or an impact would otherwise outweigh the rest of the record, and its variance with it.
    """
    power = np.asarray(power, dtype=np.float64)
    typical = float(np.median(power)) or float(power.mean()) or 1.0
    loud = np.maximum(power / typical, 1.0)
    return np.asarray((1 / loud) / (1 / loud).sum())


_STOP = 90.0  # dB
# of the polynomials of a drift, at most: 8 cycles in the record, where bands begin at 50
DEGREE = 24


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
    # slow to import, and few commands need it
    from scipy.signal import firwin, kaiserord

    count, beta = kaiserord(_STOP, 2 * (stop - start))
    taps = firwin(count | 1, start + stop, window=("kaiser", beta), scale=True)
    return np.asarray(taps, dtype=np.float64)


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


def check_band(fmin: float | None, fmax: float | None) -> None:
    """Refuse a band of interest, Hz, that is empty; None is no limit.

    Raises
    ------
    ConfigError
    """
    low = 0.0 if fmin is None else fmin
    high = np.inf if fmax is None else fmax
    if not 0 <= low < high:
        raise ConfigError(f"fmin {fmin}, fmax {fmax}: must be 0 <= fmin < fmax")


def detrend(data: Any_) -> Float:
    """`data` (ch, sample) as float64 less mean and straight line of each channel."""
    y = np.array(data, dtype=np.float64)
    t = np.linspace(-1.0, 1.0, y.shape[1])
    for x in y:  # in place: there may be many samples
        x -= x.mean()
        x -= (x @ t / (t @ t)) * t
    return y


def band_signals(
    data: Any_, rate: float, bands: Sequence[Band]
) -> tuple[tuple[Float, float], ...]:
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
        f = freqs[: m // 2 + 1]
        new = rate * m / n
        edge = step(f, 0.5 * new, 0.4 * new) if m < n else np.ones(f.size)
        gains.append(step(f, b.low / 3, b.low / 1.5) * edge * (m / n))
    batch = max(1, AT_ONCE // n)
    # the whole spectrum of all channels would double the memory
    for i in range(0, len(data), batch):
        spectrum = rfft(detrend(data[i : i + batch]), n, axis=1)
        for y, g, m, k in zip(out, gains, sizes, keep, strict=True):
            y[i : i + batch] = irfft(spectrum[:, : g.size] * g, m, axis=1)[:, :k]
    return tuple((y, rate * m / n) for y, m in zip(out, sizes, strict=True))


def pieces(samples: int, columns: int) -> list[slice]:
    """Parts of a record, of which a basis of so many columns stays in the cache: that of the whole
    would not fit in memory.
    """
    size = AT_ONCE // columns
    return [slice(k, min(k + size, samples)) for k in range(0, samples, size)]


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
    much = _drifts(history.data, degree)
    if not much.any():
        return history
    data = np.array(history.data)
    drifting = data[much]
    places = np.linspace(-1.0, 1.0, samples)
    offset = drifting[:, :1].astype(np.float64)
    parts = pieces(samples, degree + 1)
    gram = np.zeros((degree + 1, degree + 1))
    right = np.zeros((degree + 1, len(drifting)))
    for part in parts:
        basis = legvander(places[part], degree)
        gram += basis.T @ basis
        right += basis.T @ (drifting[:, part] - offset).T
    drift = np.linalg.solve(gram, right)
    drift[0] += offset[:, 0]
    for part in parts:
        basis = legvander(places[part], degree)
        drifting[:, part] -= (basis @ drift).T
    data[much] = drifting
    return replace(history, data=data)


def _drifts(data: Any_, degree: int) -> Bool:
    """(ch,) whether polynomials up to a `degree` hold more than half of the power of signals (ch,
    sample): fitted to means over parts that are short against them.
    """
    samples = data.shape[1]
    size = max(1, samples // (64 * (degree + 1)))
    used = data[:, : samples // size * size]
    offset = data[:, :1].astype(np.float64)
    means = used.reshape(len(data), -1, size).mean(axis=2, dtype=np.float64) - offset
    basis = legvander(np.linspace(-1.0, 1.0, means.shape[1]), degree)
    fitted = basis @ np.linalg.lstsq(basis, means.T)[0] + offset[:, 0]
    power = np.einsum("sc,sc->c", fitted, fitted) * size
    return np.asarray(power > 0.5 * np.einsum("cs,cs->c", used, used, dtype=np.float64))


def unit_factor(history: TimeHistory) -> float:
    """The power of two that brings the typical standard deviation of the channels near 1, so that
    no product of single precision overflows; it changes no digit. 1 within 2**±20 of it.
    """
    # one by one for the memory's sake
    levels = [x.std(dtype=np.float64) for x in history.data]
    exponent = int(np.frexp(np.median(levels))[1])
    return 1.0 if abs(exponent) <= 20 else float(np.ldexp(1.0, -exponent))


def scaled(history: TimeHistory, factor: float) -> TimeHistory:
    """The record times one factor in all channels, which changes no shape."""
    if factor == 1:
        return history
    return replace(history, data=history.data * history.data.dtype.type(factor))


@dataclass(frozen=True, slots=True)
class Geophone:
    """A moving-coil velocity sensor: H(s) = G s²/(s² + 2ζω₀s + ω₀²), velocity in, signal out.

    Attributes
    ----------
    frequency : float, Hz
        Natural frequency f₀.
    damping : float
        ζ, with its shunt.
    sensitivity : float
        G, signal over velocity far above f₀; 1 if the record is scaled to m/s already.
    """

    frequency: float
    damping: float
    sensitivity: float = 1.0

    def __post_init__(self) -> None:
        if not (self.frequency > 0 and self.damping > 0 and self.sensitivity != 0):
            raise ConfigError(
                f"geophone: frequency {self.frequency} and damping {self.damping} must be > 0, "
                f"sensitivity {self.sensitivity} not 0"
            )

    def response(self, freqs: Float) -> Complex:
        """(f,) complex128 transfer function at `freqs`, Hz."""
        s = 2j * np.pi * np.asarray(freqs, dtype=np.float64)
        w = 2 * np.pi * self.frequency
        return np.asarray(
            self.sensitivity * s**2 / (s**2 + 2 * self.damping * w * s + w**2)
        )


def lowest_frequency(
    freqs: Float, signal_psd: Float, noise_psd: Float, *, snr_db: float = 10.0
) -> float:
    """The frequency (Hz) from which on every third-octave has the wanted signal-to-noise ratio.

    Third-octaves above the last good one (an anti-alias filter) do not count.

    Parameters
    ----------
    freqs : (f,) Hz
    signal_psd : (f,)
        One-sided density of the recorded signal, noise included, unit²/Hz.
    noise_psd : (f,) or scalar
        Density of the sensor's own noise at its output, same unit.
    snr_db : float
        Of (signal − noise) to noise.

    Raises
    ------
    DataError
        If no frequency has it.
    """
    f = np.asarray(freqs, dtype=np.float64)
    ok = f > 0
    band = np.round(3 * np.log2(f[ok])).astype(np.int64)
    _, where = np.unique(band, return_inverse=True)
    total = np.bincount(where, np.asarray(signal_psd)[ok])
    noise = np.bincount(where, np.broadcast_to(noise_psd, f.shape)[ok])
    good = total > (1 + 10 ** (snr_db / 10)) * noise
    if not good.any():
        peak = float((10 * np.log10(np.maximum(total / noise - 1, 1e-30))).max())
        raise DataError(
            f"signal over sensor noise is {peak:.3g} dB at most; wanted are {snr_db:.3g} dB"
        )
    top = int(np.flatnonzero(good)[-1])
    below = np.flatnonzero(~good[:top])
    first = int(below[-1]) + 1 if below.size else 0
    return float(f[ok][where == first].min())


def deconvolve(
    history: TimeHistory, sensor: Geophone, *, low: float, high: float | None = None
) -> TimeHistory:
    """The velocity (m/s) from the signals of a sensor, between `low` and `high` Hz only.

    The gain is that of 1/H inside the band and falls to 0 at half of `low` and at 1.1 times `high`.
    Below the natural frequency of a geophone 1/H raises the noise as 1/f²: `low` must stand where
    the signal is above it, see `lowest_frequency`.

    Raises
    ------
    ConfigError
        If the band is empty.
    """
    top = history.rate / 2 if high is None else high
    if not 0 < low < top <= history.rate / 2:
        raise ConfigError(
            f"band {low} .. {top} Hz: must be 0 < low < high <= {history.rate / 2} Hz"
        )
    samples = history.data.shape[1]
    n = int(next_fast_len(samples + int(4 * history.rate / low), real=True))
    f = rfftfreq(n, 1 / history.rate)
    gain = step(f, low / 2, low) / sensor.response(np.maximum(f, low / 4))
    if top < history.rate / 2:
        gain = gain * step(f, 1.1 * top, top)
    spectrum = rfft(detrend(history.data), n, axis=1)
    data = np.asarray(irfft(spectrum * gain, n, axis=1)[:, :samples])
    unit = SI_UNIT["velocity"] if sensor.sensitivity != 1.0 else ""
    channels = (
        replace(c, quantity="velocity", unit=unit or c.unit) for c in history.channels
    )
    return replace(history, data=data, channels=tuple(channels))
