"""Faults of channels: dead, wrapped, clipped, coarse, of an odd level, with spikes or drop-outs;
overloads of impacts and their responses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.decimation import detrend
from ringtrue.signal.transients import prediction_error

_LARGEST, _SMALLEST = 1e70, 1e-70  # fourth powers stay finite, and above nothing
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
Kind = Literal["not finite", "dead", "drop-out", "overload", "spike", "level"]
_NEAR_FULL = 0.985  # of the range counts as an overload, as for hammer hits
_FLAT_SAMPLES = 3  # equal extreme samples in a row
_HELD = 16  # equal samples in a row that are a drop-out, beyond 20 mean runs
_SPIKE = 15.0  # robust standard deviations off the running median
_SPIKE_REACH = 12  # samples around a spike that must be quiet
_LEVEL = 100.0  # times the typical channel of its quantity
_RELATED = 0.5  # correlation above which two channels move together
_NEAR_RANGE = 0.985  # of the range counts as an overload
_EQUAL_PEAKS, _UNLIKE, _FINE = (
    3,
    1e-3,
    1e-4,
)  # peaks that are one; how unlike what is around them; resolution of a peak
_AROUND = 8  # samples
_FLAT = 4  # equal extreme samples in a row that give clipping away where no range is known


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
    error, without = (prediction_error(detrend(y[None])[0]) for y in (x, np.cumsum(steps)))
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


def unclipped_channels(history: TimeHistory, states: Sequence[ChannelState]) -> TimeHistory | None:
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


@dataclass(frozen=True, slots=True)
class Fault:
    """One stretch of a channel that is not what the sensor felt.

    Attributes
    ----------
    id : str
    kind : str
        `not finite`, `dead`, `drop-out`, `overload`, `spike` or `level` (mis-scaled).
    first, last : int
        Samples, inclusive.
    time : float, s
        Of the first sample.
    why : str
    """

    id: str
    kind: Kind
    first: int
    last: int
    time: float
    why: str

    @property
    def samples(self) -> int:
        """Length of the stretch."""
        return self.last - self.first + 1


def find_faults(
    history: TimeHistory, full_scale: Mapping[str, float] | None = None
) -> tuple[Fault, ...]:
    """All faults of a record, by channel and time.

    Parameters
    ----------
    history : TimeHistory
    full_scale : mapping of str to float, optional
        Range of each channel by id, in its unit; without it an overload is told by equal extreme
        samples.
    """
    found = []
    for channel, x in zip(history.channels, history.data, strict=True):
        limit = (full_scale or {}).get(channel.id, np.inf)
        for kind, first, last, why in _of_channel(np.asarray(x), limit):
            found.append(Fault(channel.id, kind, first, last, first / history.rate, why))
    return (*found, *_levels(history, {f.id for f in found if f.kind in ("dead", "not finite")}))


def _of_channel(x: Any_, limit: float) -> list[tuple[Kind, int, int, str]]:
    out: list[tuple[Kind, int, int, str]] = []
    bad = ~np.isfinite(x)
    out += [("not finite", a, b, f"{b - a + 1} samples are not finite") for a, b in runs(bad)]
    good = x[~bad]
    if not good.size or good.min() == good.max():
        if good.size:
            out.append(("dead", 0, x.size - 1, f"constant at {float(good[0]):.4g}"))
        return out
    held = _drop_outs(x)
    low, high = good.min(), good.max()
    over = np.abs(x) >= _NEAR_FULL * limit if np.isfinite(limit) else _flat(x, low) | _flat(x, high)
    out += [
        ("overload", a, b, f"{b - a + 1} samples at {float(x[a]):.4g}")
        for a, b in runs(over & ~bad)
    ]
    lost = held & ~over
    out += [
        ("drop-out", a, b, f"{b - a + 1} samples held at {float(x[a]):.4g}") for a, b in runs(lost)
    ]
    spike, size = _spikes(np.where(bad, np.median(good), x))
    spike &= ~(over | held | bad)
    out += [
        ("spike", a, b, f"{float(size[a : b + 1].max()):.3g} standard deviations")
        for a, b in runs(spike)
    ]
    return sorted(out, key=lambda f: f[1])


def runs(flag: Bool) -> list[tuple[int, int]]:
    """First and last position of each run of true values."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], flag.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edge[::2], edge[1::2], strict=True)]


def equal_runs(x: Any_) -> tuple[Int, Int]:
    """First sample and length of each run of equal samples."""
    first = np.concatenate([[0], np.flatnonzero(x[1:] != x[:-1]) + 1]).astype(np.int64)
    return first, np.diff(np.append(first, x.size))


def _drop_outs(x: Any_) -> Bool:
    """Runs of equal samples far longer than the resolution of the recorder makes them."""
    length = equal_runs(x)[1]
    limit = _HELD + 20 * float(np.median(length[length > 0]))
    return np.repeat(length > limit, length)


def _flat(x: Any_, level: float) -> Bool:
    """Runs of at least three samples at an extreme, more than once or long: a peak of a coarse
    recorder is no clip.
    """
    first, length = equal_runs(x)
    at = (x[first] == level) & (length >= _FLAT_SAMPLES)
    if int(length[at].sum()) <= max(4, x.size // 50000):
        at[:] = False
    return np.repeat(at, length)


def _spikes(x: Any_) -> tuple[Bool, Float]:
    """Single or double samples that leave a quiet neighbourhood, and their size in robust standard
    deviations.
    """
    off = np.abs(np.asarray(x, dtype=np.float64) - median_filter(x, 7, mode="nearest"))
    scale = 1.4826 * float(np.median(off[off > 0])) if (off > 0).any() else 1.0
    size = off / max(scale, 1e-300)
    candidate = size > _SPIKE
    for a, b in runs(candidate):
        if b - a > 1:
            candidate[a : b + 1] = False
    reach = 2 * _SPIKE_REACH + 1
    around = np.where(candidate, 0.0, size)
    quiet = maximum_filter1d(around, reach, mode="nearest") < 0.3 * size
    steps = np.abs(np.diff(np.asarray(x, dtype=np.float64), append=x[-1]))
    steps[candidate | np.append(candidate[1:], False)] = 0.0  # into and out of the candidates
    smooth = (
        maximum_filter1d(steps, reach, mode="nearest") < 0.3 * off
    )  # a crest of a smooth signal is no spike
    return candidate & quiet & smooth, size


def _levels(history: TimeHistory, bad: set[str]) -> list[Fault]:
    """Channels a hundred times as loud or quiet as the others of their quantity."""
    good = [i for i, c in enumerate(history.channels) if c.id not in bad]
    rms = {i: float(np.std(history.data[i], dtype=np.float64)) for i in good}
    out = []
    for i in good:
        same = [
            rms[j] for j in good if history.channels[j].quantity == history.channels[i].quantity
        ]
        ratio = rms[i] / max(float(np.median(same)), 1e-300)
        if len(same) > 2 and not 1 / _LEVEL < ratio < _LEVEL:
            why = f"{ratio:.2g} times the level of the others: unit or sensitivity?"
            out.append(
                Fault(history.channels[i].id, "level", 0, history.data.shape[1] - 1, 0.0, why)
            )
    return out


def mend(
    history: TimeHistory, faults: Sequence[Fault], *, longest: int = 5
) -> tuple[TimeHistory, tuple[Fault, ...]]:
    """The record with short gaps bridged by straight lines, and the faults that were too long
    to bridge.

    Parameters
    ----------
    history : TimeHistory
    faults : sequence of Fault
        Of `find_faults`; overloads and levels are never mended.
    longest : int
        Samples that are bridged at most.
    """
    data = np.array(history.data)
    short = [
        f for f in faults if f.samples <= longest and f.kind in ("not finite", "spike", "drop-out")
    ]
    for i, channel in enumerate(history.channels):
        bad = np.zeros(data.shape[1], dtype=bool)
        for f in short:  # a handful
            bad[f.first : f.last + 1] |= f.id == channel.id
        known = ~bad & np.isfinite(data[i])
        if bad.any() and known.any():
            data[i, bad] = np.interp(np.flatnonzero(bad), np.flatnonzero(known), data[i, known])
    return replace(history, data=data), tuple(f for f in faults if f not in short)


@dataclass(frozen=True, slots=True)
class PairCheck:
    """Two channels that should move together.

    Attributes
    ----------
    first, second : str
    correlation : float
        Of the two, at no delay.
    verdict : {"ok", "flipped", "swapped", "unrelated"}
    best : str
        The channel that `first` goes with best.
    """

    first: str
    second: str
    correlation: float
    verdict: Literal["ok", "flipped", "swapped", "unrelated"]
    best: str


def check_pairs(history: TimeHistory, pairs: Sequence[tuple[str, str]]) -> tuple[PairCheck, ...]:
    """Are sensors that should move alike (parallel ones of a point, of a stiff floor) connected and
    turned right?

    A pair is swapped if its first channel goes, in size, better with the second one of another pair
    than with its own.

    Raises
    ------
    DataError
        If a channel is not in the record.
    """
    first, second = history.pick([a for a, _ in pairs]), history.pick([b for _, b in pairs])
    x, y = (detrend(h.data) for h in (first, second))
    scale = np.outer(np.linalg.norm(x, axis=1), np.linalg.norm(y, axis=1))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise DataError(
            f"{history.source}: a channel of the pairs is constant or not finite; see find_faults"
        )
    r = (x @ y.T) / scale
    best = np.abs(r).argmax(axis=1)
    return tuple(_pair(i, pairs, r, int(best[i])) for i in range(len(pairs)))


def _pair(i: int, pairs: Sequence[tuple[str, str]], r: Float, best: int) -> PairCheck:
    own = float(r[i, i])
    verdict: Literal["ok", "flipped", "swapped", "unrelated"] = "unrelated"
    if abs(own) >= _RELATED:
        verdict = "ok" if own > 0 else "flipped"
    elif abs(r[i, best]) >= _RELATED:
        verdict = "swapped"
    return PairCheck(*pairs[i], own, verdict, pairs[best][1])


def flip(history: TimeHistory, ids: Sequence[str]) -> TimeHistory:
    """The record with the sign of some channels turned.

    Raises
    ------
    DataError
        If a channel is not in the record.
    """
    history.pick(ids)
    sign = np.array(
        [-1.0 if c.id in set(ids) else 1.0 for c in history.channels], dtype=history.data.dtype
    )
    return replace(history, data=history.data * sign[:, None])


def clipping_levels(record: TimeHistory) -> dict[str, float]:
    """Ranges by id of channels that clip for a sample or two: unlike peaks of an impact or of a
    response are one value.
    """
    out = {}
    for channel, x in zip(record.channels, record.data, strict=True):
        for peak in (max(float(x.max()), 0.0), min(float(x.min()), 0.0)):
            at = np.flatnonzero(x >= (1 - 1e-6) * peak if peak > 0 else x <= (1 - 1e-6) * peak)
            if peak and at.size >= _EQUAL_PEAKS and _clipped(x, at, abs(peak)):
                out[channel.id] = abs(peak)
    return out


def clipping(record: TimeHistory) -> tuple[str, ...]:
    """A line for each channel that is clipped: at what value, and in how many of its samples."""
    cut = {s.id for s in channel_states(record) if s.why.startswith("clipped")}
    out = []
    for channel, x in zip(record.channels, record.data, strict=True):
        if channel.id not in cut:
            continue
        low, high = float(x.min()), float(x.max())
        count = np.count_nonzero((x == low) | (x == high))
        ends = f"±{high:.4g}" if abs(high + low) < 1e-3 * high else f"{low:.4g} and {high:.4g}"
        out.append(
            f"channel {channel.id}: clipped at {ends} {channel.unit} in {count:,} of {x.size:,} "
            "samples"
        )
    return tuple(out)


@contextmanager
def explain_clipping(lines: Sequence[str]) -> Iterator[None]:
    """What goes wrong inside with records that are clipped is said to be of that, by the `lines` of
    `clipping`.
    """
    try:
        yield
    except DataError as exc:
        if lines:
            raise DataError(
                f"{'; '.join(lines[:4])}: measure again with a larger range ({exc})"
            ) from exc
        raise


def _clipped(x: Any_, at: Int, peak: float) -> bool:
    """Whether a signal (sample,) is finely resolved, and what is around its equal peaks is
    unlike.
    """
    step = np.diff(np.unique(np.asarray(x[: 1 << 16], dtype=np.float64)))
    if not step.size or step[step > 0].min(initial=np.inf) > _FINE * peak:
        return False
    around = [np.abs(x[max(i - _AROUND, 0) : i + _AROUND + 1]).sum() for i in at.tolist()]
    return bool(np.ptp(around) > _UNLIKE * max(around))


def overloaded(record: TimeHistory, block: Any_, full_scale: Mapping[str, float]) -> list[str]:
    """Ids of the channels of a block (channel, sample) at the end of their range, or where unknown,
    flat at the top.
    """
    peak = np.abs(block).max(axis=1)
    limit = np.array([full_scale.get(c.id, np.inf) for c in record.channels])
    over = peak >= _NEAR_RANGE * limit
    unknown = np.isinf(limit)
    if unknown.any():
        flat = np.abs(block[unknown]) >= (1 - 1e-6) * peak[unknown, None]
        runs = np.ones((int(unknown.sum()), block.shape[1] - _FLAT + 1), dtype=bool)
        for i in range(_FLAT):
            runs &= flat[:, i : runs.shape[1] + i]
        over[unknown] = runs.any(axis=1) & (peak[unknown] > 0)
    return [c.id for c, o in zip(record.channels, over, strict=True) if o]


def mostly_overloaded(responses: Set[str], over: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Ids of the responses that overload in more than half of the impacts, none if all do; `over`
    is a list an impact.
    """
    count = Counter(c for ids in over for c in ids if c in responses)
    lost = tuple(c for c, n in count.items() if 2 * n > len(over))
    return lost if len(lost) < len(responses) else ()
