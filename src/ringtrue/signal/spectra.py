"""Windows, spectral densities (Welch) and correlation functions of records."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import ConfigError, DataError

WindowName = Literal["hann", "hamming", "blackmanharris", "flattop", "boxcar"]


@dataclass(frozen=True, slots=True)
class Welch:
    """Settings of a Welch estimate.

    Attributes
    ----------
    resolution : float, Hz
        Distance of the frequency lines.
    overlap : float
        Fraction of a segment shared with the next, 0 <= overlap < 1.
    window : str
    """

    resolution: float
    overlap: float = 0.5
    window: WindowName = "hann"

    def __post_init__(self) -> None:
        if not self.resolution > 0 or not 0 <= self.overlap < 1:
            raise ConfigError(
                f"Welch: resolution {self.resolution} must be > 0, overlap {self.overlap} in [0, 1)"
            )


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

    def singular_values(self) -> Float:
        """(freq, ch) singular values, descending: the first is the spectrum to draw behind a
        diagram.
        """
        return np.asarray(np.linalg.svd(self.data, compute_uv=False, hermitian=True))


def _starts(samples: int, length: int, hop: int) -> Int:
    return np.arange(0, samples - length + 1, hop, dtype=np.int64)


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
    data, rate = history.data, history.rate
    length = round(rate / settings.resolution)
    if data.shape[1] < length:
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for a resolution of "
            f"{settings.resolution:.4g} Hz; it needs {1 / settings.resolution:.4g} s"
        )
    win = window(settings.window, length)
    starts = _starts(data.shape[1], length, max(1, round(length * (1 - settings.overlap))))
    total = np.zeros((length // 2 + 1, len(data), len(data)), dtype=np.complex128)
    batch = max(1, 4_000_000 // (length * len(data)))
    for i in range(0, starts.size, batch):  # streamed: a batch of segments is what is in memory
        y = np.ascontiguousarray(
            segments_spectrum(data, starts[i : i + batch], win).transpose(2, 1, 0)
        )
        total += y @ y.conj().transpose(0, 2, 1)
    total *= 2.0 / (rate * length * starts.size)
    total[0] /= 2.0
    if length % 2 == 0:
        total[-1] /= 2.0
    return Csd(total, rfftfreq(length, 1 / rate), history.channels, int(starts.size))


def block_correlations(data: Float, references: Int, lags: int, bounds: Int) -> tuple[Float, Float]:
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
    nfft = int(next_fast_len(int(min(max(12 * lags, 256), sizes.max() + lags)), real=True))
    hop = nfft - lags
    out = np.empty((sizes.size, lags + 1, ch, references.size))
    for b, (start, end) in enumerate(pairwise(bounds.tolist())):  # a block at a time in memory
        at = np.arange(0, end - start, hop)[:, None] + np.arange(nfft)
        block = np.zeros((ch, int(at[-1, -1]) + 1))
        part = data[:, start : min(end + lags, n)]
        block[:, : part.shape[1]] = part
        y = rfft(block[:, at], axis=-1)
        x = rfft(block[references][:, at] * ((np.arange(nfft) < hop) & (at < end - start)), axis=-1)
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
    bounds = np.append(np.arange(0, data.shape[1], size), data.shape[1]).astype(np.int64)
    r, count = block_correlations(np.asarray(data, dtype=np.float64), references, lags, bounds)
    return np.asarray(np.einsum("bk,bkij->kij", count / count.sum(0), r))


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
    x = np.clip((np.asarray(freqs, dtype=np.float64) - start) / (stop - start), 0.0, 1.0)
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
