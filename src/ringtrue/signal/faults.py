"""Faults of channels in time: gaps, drop-outs, overloads, spikes, odd levels; pairs that are
flipped or swapped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.preprocess import detrend

Kind = Literal["not finite", "dead", "drop-out", "overload", "spike", "level"]
_NEAR_FULL = 0.985  # of the range counts as an overload, as for hammer hits
_FLAT = 3  # equal extreme samples in a row
_HELD = 16  # equal samples in a row that are a drop-out, beyond 20 mean runs
_SPIKE = 15.0  # robust standard deviations off the running median
_SPIKE_REACH = 12  # samples around a spike that must be quiet
_LEVEL = 100.0  # times the typical channel of its quantity
_RELATED = 0.5  # correlation above which two channels move together


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
    held = _held(x)
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


def _held(x: Any_) -> Bool:
    """Runs of equal samples far longer than the resolution of the recorder makes them."""
    length = equal_runs(x)[1]
    limit = _HELD + 20 * float(np.median(length[length > 0]))
    return np.repeat(length > limit, length)


def _flat(x: Any_, level: float) -> Bool:
    """Runs of at least three samples at an extreme, more than once or long: a peak of a coarse
    recorder is no clip.
    """
    first, length = equal_runs(x)
    at = (x[first] == level) & (length >= _FLAT)
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
    """The record with short stretches bridged by straight lines, and the faults that were too long
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
