"""Preparing a record: trend, bands (zero-phase, decimated), the state of the channels, harmonics of
machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import median_filter

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.prediction import unforeseen
from ringtrue.signal.windows import step, window

_LARGEST, _SMALLEST = 1e70, 1e-70  # fourth powers stay finite, and above nothing
_LINES = 32  # channels that show the lines of machines, at most
_BATCH = 8  # segments that are transformed together
_CLEAR = 30.0, 10.0, 1.35  # times the power beside a steady line and around it, and its moment
_DOUBT, _EVERY, _MANY = (
    (15.0, 5.0, 1.6),
    4,
    100,
)  # what each fourth segment of many shows of one at least
_FEW = 2000  # samples that most channels show themselves in
_STILL = 5000  # samples to a change of the value: of slower ones nothing is to be learnt
_LOOK, _LEVELS = (
    1 << 16,
    32,
)  # samples looked at for different values, and how few are a coarse recorder
_ODD = 100.0  # times the typical level of the channels of a quantity
_PILE, _BESIDE, _HEAP = (
    30,
    0.01,
    5,
)  # samples at an extreme; part of the range beside it; times those there
_FEW_WRAPS, _LIKE_STEPS = (
    8,
    2.0,
)  # steps over half of the range; what is left of them, over the RMS of all others
_FORESEEN = 0.7  # of the variance of the error of a prediction, without wraps
_CUT = 2e-3  # share of the samples at an extreme that changes the statistics of the amplitude


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


@dataclass(frozen=True, slots=True)
class ChannelState:
    """What is wrong with a channel: `usable` or left out, and why."""

    id: str
    usable: bool
    why: str

    @property
    def note(self) -> str:
        """A line for the reader."""
        return f"channel {self.id}: {self.why}{'' if self.usable else '; left out'}"


@dataclass(frozen=True, slots=True)
class Harmonic:
    """A spectral line of a machine or the mains: frequency in Hz and why it is taken for one.

    `moment` is the normalised fourth moment of its amplitude: 1 of a steady sine, 2 of a mode in
    random vibration.
    """

    frequency: float
    why: str
    moment: float = 1.0


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


def _runs(flag: Bool) -> int:
    """Samples in runs of at least three."""
    return int((flag[2:] & flag[1:-1] & flag[:-2]).sum()) if np.count_nonzero(flag) > 2 else 0


def channel_states(history: TimeHistory) -> tuple[ChannelState, ...]:
    """What is wrong with the channels: dead, a straight line, not finite, wrapping (left out);
    clipped, coarse, of an odd level, the same as another one (kept, but said).

    Raises
    ------
    DataError
        If values are so large that their squares overflow, or so small that these vanish.
    """
    data, ids = history.data, [c.id for c in history.channels]
    ends = np.stack([data.max(1), data.min(1)]).astype(
        np.float64
    )  # not finite where a sample is not
    finite: Bool = np.asarray(np.isfinite(ends).all(0))
    top = np.where(finite, np.abs(ends).max(0), 0.0)
    for i in np.flatnonzero((top > _LARGEST) | ((top > 0) & (top < _SMALLEST)))[:1].tolist():
        raise DataError(
            f"{history.source}: channel {ids[i]} reaches {top[i]:.2g}: no unit makes that"
        )
    std = np.array([_std(x) if ok else np.nan for x, ok in zip(data, finite, strict=True)])
    lively = finite & (std > 0)
    typical = float(np.median(std[lively])) if lively.any() else 0.0
    out = []
    for i, (x, ok, s) in enumerate(zip(data, finite, std, strict=True)):
        if not ok:
            out.append(
                ChannelState(
                    ids[i], False, f"{int((~np.isfinite(x)).sum())} samples are not finite"
                )
            )
        elif s <= 1e-12 * max(top[i], typical):
            out.append(ChannelState(ids[i], False, f"constant at {float(x[0]):.4g}: a dead sensor"))
        elif (changes := _changes(x)) < x.size // _STILL:
            why = (
                f"stands still but for {changes} change{'s' if changes > 1 else ''} of its "
                "value: a dead sensor"
            )
            out.append(ChannelState(ids[i], False, why))
        elif _straight(x, s):
            out.append(ChannelState(ids[i], False, "a straight line: no signal"))
        elif wraps := _wraps(x, ends[:, i]):
            why = (
                f"wraps {wraps} times from one end of its range to the other: too few bits, or "
                "an overflow"
            )
            out.append(ChannelState(ids[i], False, why))
        else:
            peers = [
                std[k]
                for k, c in enumerate(history.channels)
                if lively[k] and _alike(c, history.channels[i])
            ]
            said = (_ends(x, ends[:, i]), _level(s, peers), _twin(data, i, ids))
            out += [ChannelState(ids[i], True, w) for w in said if w]
    return tuple(out)


def _alike(a: Channel, b: Channel) -> bool:
    return a.quantity == b.quantity


def _changes(x: Any_) -> int:
    """How often the value is not that of the sample before; no more are counted where the first
    samples tell enough.
    """
    few = int(np.count_nonzero(np.diff(x[:_FEW])))
    return few if few >= x.size // _STILL else int(np.count_nonzero(x[1:] != x[:-1]))


def _straight(x: Any_, std: float) -> bool:
    """Whether nothing but rounding is left beside a straight line."""
    if x.size > 8 * _FEW and not _straight(x[:: x.size // _FEW], 0.99 * std):
        return False  # a straight line is one in some of its samples too
    t = np.linspace(-1.0, 1.0, x.size)
    slope = float((x - float(x[0])) @ (t - t.mean())) / float(t @ t)
    return slope**2 * float(t @ t) / x.size > (1 - 1e-10) * std**2


def _std(x: Any_) -> float:
    """Standard deviation, in as few passes through the memory as keep its digits."""
    d = np.subtract(x, x.mean(dtype=np.float64), dtype=np.float64)
    return float(np.sqrt(d @ d / d.size))


def _stuck(x: Any_, ends: Float) -> int:
    """Samples that stand at an extreme: in runs of at least three, or all where they pile up
    there.
    """
    flags = [x == end for end in ends]
    return max(
        int(at.sum()) if _piled(x, at, end, ends) else _runs(at)
        for at, end in zip(flags, ends, strict=True)
    )


def _piled(x: Any_, at: Bool, end: float, ends: Float) -> bool:
    """Whether far more samples stand at an extreme than just below it: fast signals are clipped for
    a sample or two.
    """
    count = np.count_nonzero(at)
    if count <= max(_PILE, x.size // 5000):
        return False
    beside = np.count_nonzero(np.abs(x - end) < _BESIDE * np.ptp(ends)) - count
    return bool(count > _HEAP * beside)


def _ends(x: Any_, ends: Float) -> str:
    few = np.unique(x[:_FEW]).size < _LEVELS  # to sort more takes its time
    if few and (levels := np.unique(x[:_LOOK]).size) < _LEVELS < x.size / 8:
        return f"coarse: {levels} different values only"
    stuck = _stuck(x, ends)
    return (
        f"clipped: {stuck} samples stand at its largest value"
        if stuck > max(4, x.size // 50000)
        else ""
    )


def _wraps(x: Any_, ends: Float) -> int:
    """How often a signal leaves one end of its range and comes back at the other.

    A step over more than half of the range is one where, less the range, it is like the steps
    between, and where the signal can be predicted better without such steps; 0 of others, such as
    noise, telegraphs and clipped signals.
    """
    top = float(ends[0] - ends[1])
    steps = np.diff(x.astype(np.float64))
    over = np.abs(steps) > 0.5 * top
    count = int(np.count_nonzero(over))
    if (
        count <= max(_FEW_WRAPS, x.size // 50000)
        or np.abs(np.sign(steps[over]).sum()) > 0.5 * count
    ):
        return 0
    left = float(np.median(top - np.abs(steps[over])))
    between = steps[~over]
    if (
        not between.any()
        or _ends(x, ends)
        or left > _LIKE_STEPS * np.sqrt(between @ between / between.size)
    ):
        return 0
    steps[over] -= np.sign(steps[over]) * top
    error, without = (unforeseen(detrend(y[None])[0]) for y in (x, np.cumsum(steps)))
    return count if without @ without < _FORESEEN * (error @ error) else 0


def _level(std: float, peers: Sequence[float]) -> str:
    """Far louder or quieter than the other channels of its quantity: the unit, the sensitivity or a
    node.
    """
    ratio = std / float(np.median(peers))
    if len(peers) < 3 or 1 / _ODD < ratio < _ODD:
        return ""
    return f"{ratio:.1e} of the typical level of its quantity: unit or sensitivity?"


def _twin(data: Any_, i: int, ids: Sequence[str]) -> str:
    """The first earlier channel with the same samples."""
    first = data[:i, :_FEW] == data[i, :_FEW]
    same = [k for k in np.flatnonzero(first.all(1)).tolist() if np.array_equal(data[k], data[i])]
    return f"the same samples as {ids[same[0]]}" if same else ""


def uncut(history: TimeHistory, states: Sequence[ChannelState]) -> TimeHistory | None:
    """The channels whose amplitudes are not cut off by clipping; None if there is none."""
    doubt = {s.id for s in states if s.why.startswith("clipped")}
    whole = [
        c.id
        for c, x in zip(history.channels, history.data, strict=True)
        if c.id not in doubt or _stuck(x, np.array([x.max(), x.min()])) < _CUT * x.size
    ]
    if len(whole) == len(history.channels):
        return history
    return history.pick(whole) if whole else None


def usable(history: TimeHistory) -> tuple[TimeHistory, tuple[ChannelState, ...]]:
    """The record without the channels that cannot be used, and what was found.

    Raises
    ------
    DataError
        If no channel is left.
    """
    states = channel_states(history)
    bad = {s.id for s in states if not s.usable}
    good = [c.id for c in history.channels if c.id not in bad]
    if not good:
        raise DataError(
            f"{history.source}: no usable channel; "
            f"{'; '.join(f'{s.id} {s.why}' for s in states[:6])}"
        )
    return (history.pick(good) if bad else history), states


def block_bounds(samples: int, blocks: int) -> Int:
    """(block + 1,) first sample of each block, and the end."""
    return np.linspace(0, samples, blocks + 1).round().astype(np.int64)


def block_weights(power: Float) -> Float:
    """(block,) weights, sum 1, of blocks of mean square `power` (block,): loud ones count as
    typical ones.

    A jump or a blow would otherwise outweigh the rest of the record, and its variance with it.
    """
    power = np.asarray(power, dtype=np.float64)
    typical = float(np.median(power)) or float(power.mean()) or 1.0
    loud = np.maximum(power / typical, 1.0)
    return np.asarray((1 / loud) / (1 / loud).sum())


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
