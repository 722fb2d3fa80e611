"""Channels of recorders that did not start together, or whose clocks drift: delays from the
phases of cross spectra.

Modes of little damping under forces that have nothing to do with each other have cross spectra that
are real at all frequencies: their phase is 0 or half a turn. A delay τ between two channels turns
it by 2π f τ. The square of the phase factor does not see the half turn, so

    J(τ) = Σ w(f) Re[(S/|S|)² e^{4πi f τ}] / Σ w(f),  w = γ⁴,

is 1 at the delay, and its Fourier transform gives all delays at once. Where clocks differ
(quartz differs by 1 to 100 millionths), it is sought in eight parts of the record, J_p(τ), where it
may grow along it by g:

    J(τ, g) = Σ_p J_p(τ + g u_p) / Σ_p Σ_f w_p(f),  u from -1/2 (first part) to 1/2 (last).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft
from scipy.special import ndtri

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.signal.spectra import window


@dataclass(frozen=True, slots=True)
class DelaySettings:
    """When a delay, or a drift of clocks, is found.

    Attributes
    ----------
    segments : int
        Of the record, that are looked at; drifts are sought between as many parts of it as a part
        has segments.
    agreement : float
        J with the delay or the drift, at least; of one that is sound.
    most : float
        Drift of one clock against another, s/s; quartz differs by 1e-6 to 1e-4.
    """

    segments: int = 64
    agreement: float = 0.9
    most: float = 3e-4

    @property
    def parts(self) -> int:
        """Of the record, between which clocks drift."""
        return isqrt(self.segments)


DELAY = DelaySettings()
# values of J between those of the transform: eight to a sample; delays and gains of less than two
# of them are scatter
FINE = 4
# each side of the interpolation, Kaiser window of 90 dB: flat to 0.43 of the rate
TAPS = 24


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """How the phases of channels stand to those of one of them.

    Attributes
    ----------
    known : (ch,) bool
        Coherent enough with the others to say anything.
    delay : (ch,) float64, s
        After most of the channels, in the middle of the record; 0 where none is known.
    drift : (ch,) float64
        What the delay gains, s/s: the clock of a recorder that runs fast against that of most
        channels.
    odd : (ch,) bool
        Of a phase that no delay explains, among channels that agree.
    """

    known: Bool
    delay: Float
    drift: Float
    odd: Bool


def channel_phases(history: TimeHistory, derivatives: Sequence[int]) -> Phases:
    """Delays and drifts of channels against most of the others, and channels out of phase with the
    rest.

    Parameters
    ----------
    history : TimeHistory
    derivatives : sequence of int
        Of the displacement that each channel measures: 2 of an acceleration.
    """
    m = len(history.channels)
    samples = history.data.shape[1]
    nothing = Phases(
        np.zeros(m, np.bool_), np.zeros(m), np.zeros(m), np.zeros(m, np.bool_)
    )
    length, starts = segments_of(samples)
    if m < 2 or not starts.size:
        return nothing
    order = np.asarray(derivatives)
    lines = segment_lines(history.data, length, starts)
    root, turned, coherence = _against_one(lines, order)
    gain = gained(lines, root, order, starts)
    if gain.any():  # twice, as a large one smears the parts
        gain = shared(
            gain + gained(turned_back(lines, gain, starts), root, order, starts)
        )
        root, turned, coherence = _against_one(turned_back(lines, gain, starts), order)
    weight = coherence**2
    total = weight.sum(axis=1)
    known = (total > least_weight()) & (np.arange(m) != root)
    if not known.any():
        return nothing
    at, best, second = _delays(
        turned[known] * weight[known] / total[known, None], length
    )
    none = (turned[known].real * weight[known]).sum(axis=1) / total[known]
    clear = (best > DELAY.agreement) & _explains(best, np.maximum(none, second))
    delay = np.zeros(m)
    agree = np.ones(m)
    delay[known], agree[known] = (
        np.where(clear, at / history.rate, 0.0),
        np.where(clear, best, none),
    )
    seen = known | (np.arange(m) == root)
    delay[seen] -= _usual(delay[seen], 1 / (FINE * history.rate))
    delay[np.abs(delay) < 1 / (FINE * history.rate)] = 0.0
    sound = np.median(agree[known]) > DELAY.agreement
    gain[seen] -= _usual(gain[seen], 1 / FINE)
    # nearer to no agreement than to a whole one
    odd = (agree < 0.5) & sound
    return Phases(seen, delay, gain / np.ptp(starts), np.asarray(seen & odd))


def _explains(j: Float, other: Float | float) -> Any_:
    """Whether J explains most of what the `other` one leaves to 1."""
    return 1 - j < 0.5 * (1 - other)


def least_weight() -> float:
    """Sum of squared coherences from which on a mean of squared phase factors that agree is no
    chance: of one at random the real part has a variance of a half.
    """
    return float(0.5 * ndtri(FALSE_ALARM) ** 2)


def segments_of(samples: int) -> tuple[int, Int]:
    """Length of the segments of a record, and their first samples; none of one too short."""
    segments = DELAY.segments
    length = int(2 ** np.floor(np.log2(np.clip(2 * samples // segments, 256, 4096))))
    if samples < 16 * length:
        return length, np.empty(0, dtype=np.int64)
    return length, np.linspace(0, samples - length, segments).astype(np.int64)


def segment_lines(data: Any_, length: int, starts: Int) -> Any_:
    """(freq, segment, ch) transforms of segments of the record, by a Hann window, each channel over
    its size.

    What comes of them takes fourth powers in single precision: counts of a converter would
    overflow, nm vanish.
    """
    win = window("hann", length)
    size = data[:, :: max(data.shape[1] // 65_536, 1)].std(axis=1)
    gain = (win / np.where(size > 0, size, 1.0)[:, None]).astype(np.float32)
    out = np.empty((length // 2 + 1, starts.size, len(data)), dtype=np.complex64)
    # a segment of all channels is in the cache
    for k, start in enumerate(starts.tolist()):
        part = data[:, start : start + length]
        out[:, k] = rfft(
            (part - part.mean(axis=1, keepdims=True)).astype(np.float32) * gain, axis=1
        ).T
    return out


def _against_one(lines: Any_, order: Int) -> tuple[int, Complex, Float]:
    """The channel, of eight, that most others are coherent and in phase with; squared phase factors
    of all against it, as of one motion, and squared coherences less the bias of few segments, both
    (ch, freq).
    """
    tried = np.unique(np.linspace(0, lines.shape[2] - 1, 8).astype(np.int64))
    cross = lines.transpose(0, 2, 1) @ lines[:, :, tried].conj()
    power = summed_power(lines)
    powers = power[:, :, None] * power[:, None, tried]
    steps = order[:, None] - order[tried]
    turned, coherence = in_one_motion(cross, powers, lines.shape[1], steps)
    k = int((coherence * turned.real).sum(axis=(0, 1)).argmax())
    return (
        int(tried[k]),
        turned[:, :, k].T,
        np.asarray(coherence[:, :, k].T, dtype=np.float64),
    )


def _delays(z: Complex, length: int) -> tuple[Float, Float, Float]:
    """Delay in samples, J there and the largest J beyond its lobe, each (ch,), of weighted phases z
    (ch, freq).
    """
    fine = 8  # values of J between those of the transform
    n = fine * length
    j = irfft(z, n, axis=1) * n / 2
    lag = (
        np.where(np.arange(n) < n // 2, np.arange(n), np.arange(n) - n)
        * length
        / (2.0 * n)
    )
    j[:, np.abs(lag) > 0.25 * length] = -1.0
    top = j.argmax(axis=1)
    rows = np.arange(len(j))
    left, mid, right = (j[rows, (top + k) % n] for k in (-1, 0, 1))
    at = lag[top] + 0.5 * (left - right) / np.minimum(
        left - 2 * mid + right, -1e-12
    ) * length / (2.0 * n)
    second = np.array([_beyond(x, int(k)) for x, k in zip(j, top, strict=True)])
    return at, mid, second


def _beyond(j: Float, top: int) -> float:
    """The largest value outside of the lobe around the `top`."""
    x = np.roll(j, -top)
    fall = np.flatnonzero(np.diff(x) > 0)
    rise = np.flatnonzero(np.diff(x[::-1]) > 0)
    first = int(fall[0]) if fall.size else 0
    last = x.size - 1 - (int(rise[1]) if rise.size > 1 else 0)
    return float(x[first : last + 1].max())


def _usual(delay: Float, near: float) -> float:
    """The delay that most channels share within `near`."""
    same = np.abs(delay[:, None] - delay) < near
    return float(np.median(delay[same[same.sum(axis=1).argmax()]]))


def in_step(
    history: TimeHistory, delay: Float, drift: Float | None = None
) -> TimeHistory:
    """The record with its channels moved back by `delay` (ch,) s, without the ends that not all of
    them have.

    With `drift` (ch,), by as much more or less as it adds from the middle of the record.
    """
    drift = np.zeros(delay.size) if drift is None else drift
    data = np.array(history.data)
    lag = delay * history.rate
    middle = np.arange(data.shape[1]) - 0.5 * (data.shape[1] - 1)
    samples = np.arange(middle.size)
    for i in np.flatnonzero((delay != 0) | (drift != 0)):
        data[i] = at_positions(data[i : i + 1], samples + lag[i] + drift[i] * middle)[0]
    most = int(np.ceil((np.abs(lag) + np.abs(drift) * middle[-1]).max())) + TAPS
    return replace(history, data=data[:, most:-most])


def gained(lines: Any_, root: int, order: Int, starts: Int) -> Float:
    """Samples that the delay of each channel after `root` gains from the first segment to the last,
    (ch,).

    Parameters
    ----------
    lines : (freq, segment, ch) complex64
        Transforms of segments.
    order : (ch,) int
        Derivatives of the displacement that each channel measures.
    starts : (segment,) int
        First samples of them.
    """
    length = 2 * (len(lines) - 1)
    turned, weight = _by_parts(lines, root, order)
    total = weight.sum(axis=(0, 1))
    out = np.zeros(lines.shape[2])
    middle = starts.reshape(DELAY.parts, -1).mean(axis=1)
    u = np.asarray((middle - middle.mean()) / np.ptp(starts), dtype=np.float64)
    most = max(int(np.ceil(DELAY.most * np.ptp(starts) * FINE)), 1)
    grid = np.arange(-most, most + 1, dtype=np.float64) / FINE
    for i in np.flatnonzero((total > least_weight()) & (np.arange(out.size) != root)):
        j = _along(turned[:, :, i] * weight[:, :, i] / total[i], length)
        alone = float(j.sum(axis=0).max())
        # with any gain, J is no larger than each part at its best
        if _explains(j.max(axis=1).sum(), alone):
            out[i] = _best(j, u, grid, alone)
    return out


def turned_back(lines: Any_, gain: Float, starts: Int) -> Any_:
    """The lines (freq, segment, ch) without delays that gain `gain` (ch,) samples along the
    record.
    """
    if not gain.any():
        return lines
    f = np.linspace(0, 0.5, len(lines))
    u = (starts - starts.mean()) / np.ptp(starts)
    out = lines.copy()
    for i in np.flatnonzero(gain):
        out[:, :, i] *= np.exp(2j * np.pi * f[:, None] * (gain[i] * u)).astype(
            np.complex64
        )
    return out


def shared(values: Float) -> Float:
    """Gains (ch,), samples, that scatter about each other become their mean: channels of one
    recorder have one clock.
    """
    order = np.argsort(values)
    out = np.empty_like(values)
    for run in np.split(order, np.flatnonzero(np.diff(values[order]) > 1 / FINE) + 1):
        out[run] = 0.0 if (values[run] == 0).any() else values[run].mean()
    return out


def _by_parts(lines: Any_, root: int, order: Int) -> tuple[Complex, Float]:
    """Squared phase factors against the root, as of one motion, and weights, both (freq, part,
    ch).
    """
    x = lines.reshape(len(lines), DELAY.parts, -1, lines.shape[2])
    y = x[:, :, :, root]
    cross = np.einsum("fpsc,fps->fpc", x, y.conj())
    power = summed_power(x)
    turned, coherence = in_one_motion(
        cross, power * power[:, :, [root]], x.shape[2], order - order[root]
    )
    return turned, coherence**2


def summed_power(x: Any_) -> Any_:
    """(..., ch) float32 squared moduli of complex64 (..., segment, ch), summed over the
    segments.
    """
    parts = x.view(np.float32)
    both = np.einsum("...sk,...sk->...k", parts, parts)
    return np.asarray(both[..., ::2] + both[..., 1::2])


def in_one_motion(
    cross: Any_, powers: Any_, segments: int, steps: Int
) -> tuple[Any_, Any_]:
    """Squared phase factors as of one motion, and squared coherences less the bias of few segments,
    (freq, ...) each; 0 where chance may have made them.

    Of n segments of noise a squared coherence is above c with the probability (1 - c)^(n - 1)
    (Carter, Knapp, Nuttall 1973).

    Parameters
    ----------
    cross : (freq, ...) complex64
        Sums over so many segments.
    powers : (freq, ...) float32
        Products of both powers.
    steps : (...) int
        By how many derivatives the two motions differ.
    """
    tiny = np.finfo(np.float32).tiny
    square = cross.real**2 + cross.imag**2
    coherence = np.clip(square / np.maximum(powers, tiny), 0, 1)
    chance = 1 - FALSE_ALARM ** (1 / (segments - 1))
    coherence = np.where(coherence > chance, coherence - 2 / segments, 0.0)
    coherence[:2] = coherence[-2:] = 0.0
    quarters = ((-1.0) ** steps).astype(np.float32)
    return cross * cross * (quarters / np.maximum(square, tiny)), coherence


def _along(z: Complex, length: int) -> Float:
    """J of each part (part, lag) from its weighted phases z (freq, part); the lags ascend, 2
    `FINE` to a sample.
    """
    n = FINE * length
    j = np.fft.fftshift(irfft(z.T, n, axis=1) * (n / 2), axes=1)
    reach = int(2 * FINE * 0.25 * length)
    return np.asarray(j[:, n // 2 - reach : n // 2 + reach + 1])


def _best(j: Float, u: Float, grid: Float, alone: float) -> float:
    """The gain with the largest J, 0 if that is not clearly more than `alone`."""
    shift = np.rint(2 * FINE * grid[:, None] * u).astype(np.int64)
    room = int(np.abs(shift).max())
    if 2 * room >= j.shape[1]:
        return 0.0
    width = j.shape[1] - 2 * room
    tops = np.array(
        [
            sum(
                x[room + k : room + k + width] for x, k in zip(j, row, strict=True)
            ).max()
            for row in shift
        ]
    )
    k = int(tops.argmax())
    if not (
        0 < k < grid.size - 1
        and tops[k] > DELAY.agreement
        and _explains(tops[k], alone)
    ):
        return 0.0
    left, mid, right = tops[k - 1 : k + 2]
    gain = float(
        grid[k] + 0.5 / FINE * (left - right) / min(left - 2 * mid + right, -1e-12)
    )
    return gain if abs(gain) > 1 / FINE else 0.0


def at_positions(data: Any_, positions: Float) -> Float:
    """(ch, position) values between the samples of `data` (ch, sample), by a windowed sinc; 0
    outside the record.
    """
    rows = 1024  # of the table of taps; straight between them is 4e-7 off
    out = np.empty((data.shape[0], positions.size))
    part = np.linspace(0, 1, rows + 1)[:, None] + np.arange(TAPS - 1, -TAPS - 1, -1)
    table = (
        np.sinc(part)
        * np.i0(9.0 * np.sqrt(np.clip(1 - (part / TAPS) ** 2, 0, 1)))
        / np.i0(9.0)
    )
    padded = np.pad(data, ((0, 0), (TAPS, TAPS)))
    size = 1 << 14
    # blocks, as the taps take 48 times the memory of the samples
    for i in range(0, positions.size, size):
        p = np.clip(positions[i : i + size], 0, data.shape[1] - 1)
        base = p.astype(np.int64)
        at = (p - base) * rows
        row = at.astype(np.int64)
        share = (at - row)[:, None]
        weight = (1 - share) * table[row] + share * table[row + 1]
        weight[p != positions[i : i + size]] = 0.0
        for x, y in zip(padded, out, strict=True):
            y[i : i + size] = np.einsum(
                "pt,pt->p", sliding_window_view(x, 2 * TAPS)[base + 1], weight
            )
    return out
