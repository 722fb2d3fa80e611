"""Recorders with clocks of their own: delay and drift from a motion that both felt, resampling,
joining.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.preprocess import detrend

_HALF = 24  # taps each side of the interpolation, Kaiser window of 90 dB: flat to 0.43 of the rate
_BETA = 9.0
_ROWS = 1024  # of the table of taps; straight between them is 4e-7 off
_WEAK = 0.3  # correlation below which a block says nothing about the delay
_NEAR = 0.01  # rates may differ by this share; beyond it decimate first


@dataclass(frozen=True, slots=True)
class Clock:
    """The clock of a recorder against a reference: t = offset + (1 + drift) t_ref.

    Attributes
    ----------
    offset : float, s
        Its time at the first sample of the reference.
    drift : float
        Relative; 1e-6 is a microsecond a second.
    std_offset, std_drift : float
        From the scatter of the blocks; NaN with fewer than three.
    correlation : float
        Median over the blocks, at the fitted delay.
    blocks : int
        Blocks used.
    """

    offset: float
    drift: float
    std_offset: float
    std_drift: float
    correlation: float
    blocks: int


def delay(reference: Any_, other: Any_, rate: float, longest: float) -> tuple[float, float]:
    """Delay (s) of `other` after `reference`, (sample,) each of one motion, and their correlation
    there.

    The largest cross-correlation within ±`longest` s, refined between the samples by Newton's
    method on its trigonometric interpolation.
    """
    x, y = (detrend(np.asarray(v)[None])[0] for v in (reference, other))
    norm = float(np.linalg.norm(x) * np.linalg.norm(y))
    if not norm > 0:
        raise DataError("delay: a signal is constant; leave it out")
    n = int(next_fast_len(x.size + y.size, real=True))
    spectrum = rfft(y, n) * rfft(x, n).conj()
    reach = min(round(longest * rate), n // 2 - 1)
    near = np.concatenate([np.arange(reach + 1), np.arange(-reach, 0)])
    values = irfft(spectrum, n)[near]
    start = int(near[int(values.argmax())])
    w = 2 * np.pi * np.arange(spectrum.size) / n
    tau = float(start)
    for _ in range(8):  # Newton, from within a sample of the peak
        z = spectrum * np.exp(1j * w * tau)
        slope, curve = -float((w * z.imag).sum()), -float((w**2 * z.real).sum())
        if not curve < 0:
            break
        tau = float(np.clip(tau - slope / curve, start - 1, start + 1))
    peak = 2 * float((spectrum * np.exp(1j * w * tau)).real.sum()) / n
    return tau / rate, peak / norm


def compare_clocks(
    reference: TimeHistory,
    other: TimeHistory,
    pair: tuple[str, str],
    *,
    longest: float = 10.0,
    blocks: int = 20,
) -> Clock:
    """Offset and drift of another recorder's clock, from one motion that both recorded.

    The offset of the whole record comes first, then the delay of each block about it; a line
    through the delays is fitted with weights that leave out blocks off the line.

    Parameters
    ----------
    reference, other : TimeHistory
        Of equal nominal rates.
    pair : (str, str)
        A channel of each that felt the same motion.
    longest : float, s
        Largest offset to look for.
    blocks : int
        Into which the record is cut.

    Raises
    ------
    DataError
        If the rates differ by more than 1 %, or the two channels are not related.
    """
    _check_rates(reference, other)
    rate = reference.rate
    x, y = reference.pick([pair[0]]).data[0], other.pick([pair[1]]).data[0]
    size = min(x.size, y.size) // blocks
    if size < 256:
        raise DataError(
            f"{other.source}: {size} samples in each of {blocks} blocks; 256 are needed: take "
            "fewer blocks"
        )
    coarse = _coarse(x, y, rate, longest, size * blocks)
    shift = round(coarse * rate)
    found = [_block_delay(x, y, k * size, size, shift, rate) for k in range(blocks)]
    good = np.array([f for f in found if f is not None and f[2] > _WEAK]).reshape(-1, 3)
    if good.shape[0] < 2:
        raise DataError(
            f"{pair[0]} and {pair[1]}: {good.shape[0]} of {blocks} blocks are related; take "
            "another pair"
        )
    offset, drift, std = _line(good[:, 0], good[:, 1])
    ratio = (1 + drift) * reference.rate / other.rate - 1 if other.rate != rate else drift
    return Clock(offset, ratio, std[0], std[1], float(np.median(good[:, 2])), good.shape[0])


def _check_rates(reference: TimeHistory, other: TimeHistory) -> None:
    if abs(other.rate / reference.rate - 1) > _NEAR:
        raise DataError(
            f"rates {reference.rate:g} and {other.rate:g} Hz: decimate to one nominal rate first"
        )


def _coarse(x: Any_, y: Any_, rate: float, longest: float, samples: int) -> float:
    """Offset of the recorders: the best of several stretches, as a drift blurs the correlation of
    the whole.
    """
    size = min(samples, max(4096, round(8 * longest * rate)))
    starts = np.unique(np.linspace(0, min(x.size, y.size) - size, 5).astype(np.int64)).tolist()
    found = [delay(x[a : a + size], y[a : a + size], rate, longest) for a in starts]
    return max(found, key=lambda f: f[1])[0]


def _block_delay(
    x: Any_, y: Any_, at: int, size: int, shift: int, rate: float
) -> tuple[float, float, float] | None:
    """Middle (s of the reference), delay (s), correlation of one block."""
    if at + shift < 0 or at + size + shift > y.size or at + size > x.size:
        return None
    part, twin = x[at : at + size], y[at + shift : at + shift + size]
    if not (np.ptp(part) > 0 and np.ptp(twin) > 0):
        return None
    tau, r = delay(part, twin, rate, size / (4 * rate))
    return (at + size / 2) / rate, tau + shift / rate, r


def _line(t: Float, tau: Float) -> tuple[float, float, tuple[float, float]]:
    """Offset, slope and their standard deviations, by iterated bisquare weights (Holland and Welsch
    1977).
    """
    a = np.column_stack([np.ones_like(t), t])
    upper = np.triu_indices(t.size, 1)
    slope = float(
        np.median((tau[None] - tau[:, None])[upper] / (t[None] - t[:, None])[upper])
    )  # Theil and Sen
    p = np.array([np.median(tau - slope * t), slope])
    w = np.ones_like(t)
    for _ in range(10):
        off = tau - a @ p
        scale = max(1.4826 * float(np.median(np.abs(off))), 1e-12)
        w = np.clip(1 - (off / (4.685 * scale)) ** 2, 0, 1) ** 2
        root = np.sqrt(w)
        p = np.linalg.lstsq(a * root[:, None], tau * root, rcond=None)[0]
    if t.size < 3:
        return float(p[0]), float(p[1]), (np.nan, np.nan)
    spread = float((w * (tau - a @ p) ** 2).sum() / max(w.sum() - 2, 1))
    covariance = spread * np.linalg.pinv(a.T @ (a * w[:, None]))
    return (
        float(p[0]),
        float(p[1]),
        (float(np.sqrt(covariance[0, 0])), float(np.sqrt(covariance[1, 1]))),
    )


def at_positions(data: Any_, positions: Float) -> Float:
    """(ch, position) values between the samples of `data` (ch, sample), by a windowed sinc; 0
    outside the record.
    """
    out = np.empty((data.shape[0], positions.size))
    part = np.linspace(0, 1, _ROWS + 1)[:, None] + np.arange(_HALF - 1, -_HALF - 1, -1)
    table = (
        np.sinc(part)
        * np.i0(_BETA * np.sqrt(np.clip(1 - (part / _HALF) ** 2, 0, 1)))
        / np.i0(_BETA)
    )
    padded = np.pad(data, ((0, 0), (_HALF, _HALF)))
    size = 1 << 14
    for i in range(
        0, positions.size, size
    ):  # blocks, as the taps take 48 times the memory of the samples
        p = np.clip(positions[i : i + size], 0, data.shape[1] - 1)
        base = p.astype(np.int64)
        at = (p - base) * _ROWS
        row = at.astype(np.int64)
        share = (at - row)[:, None]
        weight = (1 - share) * table[row] + share * table[row + 1]
        weight[p != positions[i : i + size]] = 0.0
        for x, y in zip(padded, out, strict=True):
            y[i : i + size] = np.einsum(
                "pt,pt->p", sliding_window_view(x, 2 * _HALF)[base + 1], weight
            )
    return out


def align(reference: TimeHistory, other: TimeHistory, clock: Clock) -> TimeHistory:
    """Both recorders in one record at the times of the reference, over the time that both cover.

    Raises
    ------
    DataError
        If the rates differ by more than 1 %, ids occur twice, or there is no common time.
    """
    _check_rates(reference, other)
    twice = {c.id for c in reference.channels} & {c.id for c in other.channels}
    if twice:
        raise DataError(
            f"channel {' '.join(sorted(twice)[:8])} is in both recorders; rename it in one"
        )
    t = np.arange(reference.data.shape[1]) / reference.rate
    positions = (clock.offset + (1 + clock.drift) * t) * other.rate
    inside = np.flatnonzero((positions >= 0) & (positions <= other.data.shape[1] - 1))
    if inside.size < 2:
        raise DataError(
            f"{reference.source} and {other.source} have no time in common: offset "
            f"{clock.offset:g} s"
        )
    part = slice(int(inside[0]), int(inside[-1]) + 1)
    data = np.concatenate([reference.data[:, part], at_positions(other.data, positions[part])])
    return replace(reference, data=data, channels=(*reference.channels, *other.channels))
