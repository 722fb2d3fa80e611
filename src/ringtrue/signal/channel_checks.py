"""Faults of channels: dead, wrapped, clipped, coarse, of an odd level, recorded twice, with spikes;
overloads of impacts and their responses.

Parts that a recorder lost: samples that are not there (NaN), or a value held far longer than
the resolution explains, as logged over a broken link; and samples that two files of one record both
have.

Their steps would ring in every band, and a channel without its part of the motion has wrong shapes:
the whole record is left out there. A few missing samples in a row are interpolated in their
channel.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.special import ndtri

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.spectra import detrend
from ringtrue.signal.transients import FEWEST, prediction_error


@dataclass(frozen=True, slots=True)
class ChannelLimits:
    """When a channel is at fault.

    Attributes
    ----------
    level_ratio : float
        Ratio of an odd level to the median level of the quantity.
    clipped : int
        Samples at an extreme of a clipped record, at least.
    clipped_ratio : float
        Samples at an extreme over those at the next value, of a clipped record: 2.4 at the top of a
        smooth signal, below 1 of noise.
    odd : float
        Times what is typical of the record: runs of equal samples, and steps into and out of them,
        where samples are lost; spikes.
    short : int
        Missing samples in a row that are interpolated: more would be missed in the damping.
    """

    level_ratio: float = 100.0
    clipped: int = 10
    clipped_ratio: float = 4.0
    odd: float = 20.0
    short: int = 5


LIMITS = ChannelLimits()


def check_channels(history: TimeHistory) -> tuple[Note, ...]:
    """Notes on channels: errors on those that cannot be used, warnings on others.

    Raises
    ------
    DataError
        If values are so large that their squares overflow, or so small that these vanish.
    """
    data = history.data
    ids = [c.id for c in history.channels]
    # not finite where a sample is not
    top = np.maximum(data.max(axis=1), -data.min(axis=1)).astype(np.float64)
    finite = np.isfinite(data.max(axis=1)) & np.isfinite(data.min(axis=1))
    # fourth powers of all samples add up to a finite sum
    largest = (np.finfo(np.float64).max / data.shape[1]) ** 0.25
    odd = finite & ((top > largest) | ((top > 0) & (top < 1 / largest)))
    for i in np.flatnonzero(odd).tolist():
        raise DataError(
            f"{history.source}: channel {ids[i]} reaches {top[i]:.2g}: no unit makes that"
        )
    level = np.array(
        [_level(x) if ok else np.nan for x, ok in zip(data, finite, strict=True)]
    )
    notes = []
    ramp = np.linspace(-1.0, 1.0, data.shape[1])
    for i, x in enumerate(data):
        fatal = _no_signal(x, level[i], ramp)
        if fatal is not None:
            notes.append(Note(fatal[0], "error", ids[i], fatal[1]))
            continue
        peers = [
            level[k]
            for k, c in enumerate(history.channels)
            if level[k] > 0 and c.quantity == history.channels[i].quantity
        ]
        found = (
            _clipping(x, history.channels[i].unit),
            _odd_level(level[i], peers),
            _same_samples(data, i, ids),
        )
        notes += [
            Note(code, "warning", ids[i], values)
            for code, values in filter(None, found)
        ]
    return tuple(notes)


_Finding = tuple[str, dict[str, float | int | str]]


def _level(x: Any_) -> float:
    """Standard deviation, in as few passes through the memory as keep its digits."""
    d = np.subtract(x, x.mean(dtype=np.float64), dtype=np.float64)
    return float(np.sqrt(d @ d / d.size))


def _no_signal(x: Any_, level: float, ramp: Float) -> _Finding | None:
    """Why a channel cannot be used; `ramp` (sample,) rises from -1 to 1."""
    if not np.isfinite(level):
        return "channel not finite", {"samples": int((~np.isfinite(x)).sum())}
    changes = int(np.count_nonzero(x[1:] != x[:-1]))
    if changes < min(FEWEST, x.size // FEWEST):
        return "channel dead", {"value": float(np.median(x)), "changes": changes}
    size = float(ramp @ ramp)
    slope = float((x - float(x[0])) @ ramp) / size
    line = slope**2 * size / x.size
    if line > (1 - 1e-10) * level**2:  # nothing but rounding is left besides it
        return "channel straight", {}
    if wraps := _wraps(x):
        return "channel wraps", {"count": wraps}
    return None


def _wraps(x: Any_) -> int:
    """How often a signal (sample,) leaves one end of its range and comes back at the other.

    A wrap is a step over more than half of the range that, less the range, is like the other steps.
    The signal can be predicted better without wraps. Noise, telegraphs, clipped and coarse
    signals have none.
    """
    span = float(x.max()) - float(x.min())
    steps = x[1:] - x[:-1]
    over = np.flatnonzero(np.abs(steps) > 0.5 * span)
    if over.size < FEWEST:
        return 0
    large = steps[over].astype(np.float64)
    # most of them in one direction
    if np.abs(np.sign(large).sum()) > 0.5 * over.size:
        return 0
    left = np.abs(span - np.abs(large))
    steps = steps.astype(np.float64)
    steps[over] = 0.0
    others = (steps @ steps) / max(steps.size - over.size, 1)
    # Gaussian steps cross an end the more often the larger they are: by the law of Rayleigh
    if not others or np.median(left) ** 2 > -2 * np.log(FALSE_ALARM) * others:
        return 0
    if _clipping(x, "") is not None:
        return 0
    steps[over] = large - np.sign(large) * span
    with_wraps = prediction_error(detrend(x[None])[0])
    without = prediction_error(detrend(np.cumsum(steps)[None])[0])
    # two variances of so many samples of one noise have no lower ratio
    lowest = 1 + ndtri(FALSE_ALARM) * 2 / np.sqrt(x.size)
    return over.size if without @ without < lowest * (with_wraps @ with_wraps) else 0


def _clipping(x: Any_, unit: str) -> _Finding | None:
    levels = np.unique(x[:2000]).size
    if levels < FEWEST:  # to sort more takes its time
        levels = np.unique(x[: 1 << 16]).size
    if levels < FEWEST:
        return "channel coarse", {"levels": int(levels)}
    ends = clipped_ends(x, LIMITS.clipped, LIMITS.clipped_ratio)
    if not ends:
        return None
    count = int(sum(np.count_nonzero(np.isclose(x, end, rtol=1e-9)) for end in ends))
    value = max(map(abs, ends))
    return "channel clipped", {
        "value": value,
        "unit": unit,
        "samples": count,
        "total": x.size,
    }


def clipped_ends(x: Any_, least: int, ratio: float) -> list[float]:
    """Extremes of a signal (sample,) that it takes far more often than the next value.

    Parameters
    ----------
    x : (sample,) float
    least : int
        Samples at an extreme, at least.
    ratio : float
        Of these to the samples at the next value.
    """
    rest = float(np.median(x[:: max(1, x.size // 10000)]))
    high = float(x.max())
    low = float(x.min())
    span = high - low
    same = 1e-9 * span  # values that differ by rounding
    out = []
    for end in (high, low):
        inner = x < high - same if end == high else x > low + same
        count = x.size - int(np.count_nonzero(inner))
        # a channel at rest is not clipped
        if count < least or abs(end - rest) < 0.1 * span:
            continue
        neighbour = float(x[inner].max() if end > rest else x[inner].min())
        if count >= ratio * np.count_nonzero(np.abs(x - neighbour) <= same):
            out.append(end)
    return out


def _odd_level(level: float, peers: Sequence[float]) -> _Finding | None:
    """Far louder or quieter than the other channels of its quantity: the unit, the sensitivity or a
    node.
    """
    ratio = level / float(np.median(peers))
    if len(peers) < 3 or 1 / LIMITS.level_ratio < ratio < LIMITS.level_ratio:
        return None
    return "channel level", {"ratio": ratio}


def _same_samples(data: Any_, i: int, ids: Sequence[str]) -> _Finding | None:
    """The first earlier channel with the same samples."""
    first = (data[:i, :2000] == data[i, :2000]).all(axis=1)
    for k in np.flatnonzero(first).tolist():
        if np.array_equal(data[k], data[i]):
            return "channel twice", {"other": ids[k]}
    return None


def unclipped_channels(
    history: TimeHistory, notes: Sequence[Note]
) -> TimeHistory | None:
    """The channels whose amplitudes are not cut off by clipping; None if there is none."""
    cut = {n.subject for n in notes if n.code == "channel clipped"}
    whole = [c.id for c in history.channels if c.id not in cut]
    if len(whole) == len(history.channels):
        return history
    return history.pick(whole) if whole else None


def usable(history: TimeHistory) -> tuple[TimeHistory, tuple[Note, ...]]:
    """The record without the channels that cannot be used, and what was found.

    Raises
    ------
    DataError
        If no channel is left.
    """
    notes = check_channels(history)
    bad = {n.subject for n in notes if n.severity == "error"}
    good = [c.id for c in history.channels if c.id not in bad]
    if not good:
        causes = "; ".join(sentence(n) for n in notes[:6])
        raise DataError(f"{history.source}: no usable channel; {causes}")
    return (history.pick(good) if bad else history), notes


def find_spikes(history: TimeHistory) -> tuple[Note, ...]:
    """A note on each channel with spikes."""
    out = []
    for channel, x in zip(history.channels, history.data, strict=True):
        known = np.isfinite(x)
        if not known.any():
            continue
        spike, size = _spikes(np.where(known, x, np.median(x[known])))
        at = np.flatnonzero(spike & known)
        if at.size:
            values: dict[str, float | int | str] = {
                "count": len(runs(spike & known)),
                "time": at[0] / history.rate,
                "size": float(size[at[0]]),
            }
            out.append(Note("channel spikes", "warning", channel.id, values))
    return tuple(out)


def runs(flag: Bool) -> list[tuple[int, int]]:
    """First and last position of each run of true values."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], flag.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edge[::2], edge[1::2], strict=True)]


def equal_runs(x: Any_) -> tuple[Int, Int]:
    """First sample and length of each run of equal samples."""
    first = np.concatenate([[0], np.flatnonzero(x[1:] != x[:-1]) + 1]).astype(np.int64)
    return first, np.diff(np.append(first, x.size))


def _spikes(x: Any_) -> tuple[Bool, Float]:
    """Single or double samples that leave a quiet neighbourhood, and their size in robust standard
    deviations.
    """
    reach = 25  # samples around a spike that must be quiet
    off = np.abs(np.asarray(x, dtype=np.float64) - median_filter(x, 7, mode="nearest"))
    scale = 1.4826 * float(np.median(off[off > 0])) if (off > 0).any() else 1.0
    size = off / max(scale, 1e-300)
    candidate = size > LIMITS.odd
    for a, b in runs(candidate):
        if b - a > 1:
            candidate[a : b + 1] = False
    around = np.where(candidate, 0.0, size)
    quiet = maximum_filter1d(around, reach, mode="nearest") < 0.3 * size
    steps = np.abs(np.diff(np.asarray(x, dtype=np.float64), append=x[-1]))
    # into and out of the candidates
    steps[candidate | np.append(candidate[1:], False)] = 0.0
    # a crest of a smooth signal is no spike
    smooth = maximum_filter1d(steps, reach, mode="nearest") < 0.3 * off
    return candidate & quiet & smooth, size


def clipping_levels(record: TimeHistory) -> dict[str, float]:
    """Ranges by id of channels that clip: four samples at an extreme of a test with impacts."""
    out = {}
    for channel, x in zip(record.channels, record.data, strict=True):
        ends = clipped_ends(x, 4, LIMITS.clipped_ratio)
        # equal peaks of equal impacts are no clipping: somewhere two samples in a row stand there
        held = [
            end for end in ends if any(last > first for first, last in runs(x == end))
        ]
        if held:
            out[channel.id] = min(map(abs, held))
    return out


def clipping(record: TimeHistory) -> tuple[str, ...]:
    """A sentence on each channel that is clipped."""
    return tuple(
        sentence(n) for n in check_channels(record) if n.code == "channel clipped"
    )


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


def overloaded(
    record: TimeHistory, block: Any_, ranges: Mapping[str, float]
) -> list[str]:
    """Ids of the channels of a block (channel, sample) that reach the end of their range."""
    peak = np.abs(block).max(axis=1)
    full = np.array([ranges.get(c.id, np.inf) for c in record.channels])
    return [
        c.id
        for c, over in zip(record.channels, peak >= 0.985 * full, strict=True)
        if over
    ]


def mostly_overloaded(
    responses: Set[str], over: Sequence[Sequence[str]]
) -> tuple[str, ...]:
    """Ids of the responses that overload in more than half of the impacts, none if all do; `over`
    is a list an impact.
    """
    count = Counter(c for ids in over for c in ids if c in responses)
    lost = tuple(c for c, n in count.items() if 2 * n > len(over))
    return lost if len(lost) < len(responses) else ()


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """What is lost of a record.

    Attributes
    ----------
    lost : (sample,) bool
        Some channel has nothing to say.
    channels : tuple of Note
        On single channels.
    stretches : Note, optional
        On all that is lost.
    """

    lost: Bool
    channels: tuple[Note, ...]
    stretches: Note | None = None

    @property
    def notes(self) -> tuple[Note, ...]:
        """All of them."""
        return (*self.channels, self.stretches) if self.stretches else self.channels

    def cut(self, samples: int) -> Bool:
        """(samples,) what is lost of the record after as much was cut from its two ends."""
        end = (self.lost.size - samples) // 2
        return self.lost[end : end + samples]

    def marked(self, history: TimeHistory) -> TimeHistory:
        """A record of as many samples with NaN in what is lost: for a bridged one that filters went
        over.
        """
        if not self.lost.any():
            return history
        data = np.array(history.data)
        data[:, self.lost] = np.nan
        return replace(history, data=data)


def bridge_gaps(history: TimeHistory) -> tuple[TimeHistory, Gaps]:
    """The record with straight lines over what is lost, the same in all channels, without those
    that lost too much.
    """
    history, missing, notes = _filled(history)
    size = history.data.shape[1]
    held = dict(missing)
    nothing = np.zeros(size, dtype=bool)
    for c, x in zip(history.channels, history.data, strict=True):
        if (h := _held(np.asarray(x))) is not None and h.any():
            held[c.id] = h | missing[c.id] if c.id in missing else h
    if not held:
        return history, Gaps(nothing, notes)
    share = {
        c.id: np.count_nonzero(held[c.id]) / size if c.id in held else 0.0
        for c in history.channels
    }
    typical = float(np.median(list(share.values())))
    # what others have lost, or less than half of the record
    keep = [i for i, part in share.items() if part <= typical or 2 * part < 1]
    notes += tuple(
        Note("channel lost", "error", i, {"percent": 100 * share[i]})
        for i in share
        if i not in keep
    )
    if len(keep) < len(share):
        history = history.pick(keep)
    held = {i: held[i] for i in keep if i in held}
    lost = np.any([nothing, *held.values()], axis=0)
    history, common, said = _each_by_itself(history, held, lost)
    if said:
        lost = common
        held = {i: h & common for i, h in held.items() if (h & common).any()}
        notes = (*notes, said)
    if not lost.any() or lost.all():
        return history, Gaps(nothing, notes)
    names = [i for i in keep if i in held]
    parts = len(runs(lost))
    first = int(np.flatnonzero(lost)[0]) / history.rate
    causes = ["samples are missing"] if missing else []
    if held.keys() - missing:
        causes.append("a value is held")
    everywhere = len(names) == len(keep) > 1
    stretches = Note(
        "samples lost",
        "warning",
        "all channels" if everywhere else f"channel {' '.join(names)}",
        {
            "parts": parts,
            "causes": ", ".join(causes),
            "first": first,
            "total": np.count_nonzero(lost) / history.rate,
        },
    )
    data = np.array(history.data)
    for x in data:
        _bridge(x, lost)
    return replace(history, data=data), Gaps(lost, notes, stretches)


def _each_by_itself(
    history: TimeHistory, held: dict[str, Bool], lost: Bool
) -> tuple[TimeHistory, Bool, Note | None]:
    """The record, what most channels lost, and a note where others lost parts at times of their own
    (radio links).

    To leave these out in all channels would leave little: each has a straight line there by itself.
    """
    common = (
        np.sum(list(held.values()), axis=0) * 2 > len(history.channels)
        if held
        else lost
    )
    alone = {i: h & ~common for i, h in held.items()}
    most = max((float(h.mean()) for h in alone.values()), default=0.0)
    # one channel has lost most of what all have
    if (lost & ~common).mean() <= 2 * most:
        return history, lost, None
    data = np.array(history.data)
    for k, c in enumerate(history.channels):
        if c.id in alone:
            _bridge(data[k], alone[c.id])
    count = sum(bool(h.any()) for h in alone.values())
    note = Note(
        "scattered losses", "warning", f"{count} channels", {"percent": 100 * most}
    )
    return replace(history, data=data), common, note


def _filled(
    history: TimeHistory,
) -> tuple[TimeHistory, dict[str, Bool], tuple[Note, ...]]:
    """The record with straight lines over samples that are not finite, the long runs of these
    (sample,), and notes.
    """
    bad = [
        i
        for i, x in enumerate(history.data)
        if x.size and not np.isfinite([x.min(), x.max()]).all()
    ]
    if not bad:
        return history, {}, ()
    data = np.array(history.data)
    missing: dict[str, Bool] = {}
    notes: list[Note] = []
    for i in bad:
        none = ~np.isfinite(data[i])
        name = history.channels[i].id
        _bridge(data[i], none)
        long = none.copy()
        for a, b in runs(none):
            long[a : b + 1] = b - a >= LIMITS.short
        if long.any():
            missing[name] = long
        if count := np.count_nonzero(none & ~long):
            notes.append(
                Note("channel interpolated", "warning", name, {"count": int(count)})
            )
    return replace(history, data=data), missing, tuple(notes)


def _held(x: Any_) -> Bool | None:
    """(sample,) samples that are held; None where none are."""
    if np.count_nonzero(x[1:] == x[:-1]) < LIMITS.odd:
        return None
    first, length = equal_runs(x)
    long = length > LIMITS.odd * float(np.percentile(length, 99))
    if not long.any():  # as nearly always
        return None
    steps = np.abs(np.diff(x[first].astype(np.float64)))
    leap = LIMITS.odd * float(np.median(steps))
    into = np.insert(steps, 0, np.inf) > leap
    out = np.append(steps, np.inf) > leap
    extreme = (x[first] == x.max()) | (x[first] == x.min())
    return np.asarray(np.repeat(long & (~extreme | (into & out)), length))


def _bridge(x: Any_, lost: Bool) -> None:
    """Lay a straight line over the lost samples of x (sample,); zeros where all are."""
    at = np.flatnonzero(lost)
    known = np.flatnonzero(~lost)
    x[at] = np.interp(at, known, x[known]) if known.size else 0.0


def overlap(before: TimeHistory, later: TimeHistory) -> int:
    """How many of the first samples of `later` are the last ones of `before`, or lie within it."""
    a = before.data
    b = later.data
    if (
        a.shape[0] != b.shape[0]
        or min(a.shape[1], b.shape[1]) < FEWEST
        or not np.ptp(b[:, :FEWEST], axis=1).any()
    ):
        return 0
    begin = np.flatnonzero(a[0, : a.shape[1] - FEWEST + 1] == b[0, 0])
    for k in range(FEWEST):  # of coarse samples many begin with the same value
        begin = begin[(a[:, begin + k] == b[:, k : k + 1]).all(axis=0)]
    for at in begin.tolist():
        n: int = min(a.shape[1] - at, b.shape[1])
        if np.array_equal(a[:, at : at + n], b[:, :n], equal_nan=True):
            return n
    return 0


def remove_overlap(
    before: TimeHistory | None, later: TimeHistory
) -> tuple[TimeHistory, str]:
    """A record without the samples that the one before it ends with, and what is to be said of
    that.
    """
    n = overlap(before, later) if before is not None else 0
    if not n or before is None:
        return later, ""
    name = before.source.rpartition("/")[2]
    return (
        replace(later, data=later.data[:, n:]),
        f"its first {n / later.rate:.4g} s are in {name} too: they count once",
    )
