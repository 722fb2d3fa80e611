"""Parts that a recorder lost: samples that are not there (NaN), or a value held far longer than
the resolution explains, as logged over a broken link; and samples that two files of one record both
have.

Their steps would ring in every band, and a channel without its part of the motion has wrong shapes:
the whole record is left out there. A few missing samples in a row are interpolated in their
channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Bool
from ringtrue.core.signals import TimeHistory
from ringtrue.signal.channel_checks import equal_runs, runs

HELD, TYPICAL = (
    16,
    20.0,
)  # samples, and more than these times the runs of the record but for 1 %, and those beside
BESIDE = 8  # runs, to each side: in the rest between events all are long in a coarse record
# median differences, by which a lost stretch leaves an extreme of the record; a clipped one does
# not
LEAP = 8.0
SHORT = 5  # missing samples in a row that are interpolated
SCATTERED, EACH = (
    0.1,
    2.0,
)  # share of the record that single channels lose, and that over what one of them does
MOST = 0.3  # of the record: a channel that others do not follow is left out beyond
_LEAST = 64  # samples that are the same in all channels: fewer may be chance


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """What is lost of a record.

    Attributes
    ----------
    lost : (sample,) bool
        Some channel has nothing to say.
    channels : tuple of str
        What is said of single channels.
    stretches : str
        What is said of all that is lost; empty where nothing is.
    """

    lost: Bool
    channels: tuple[str, ...]
    stretches: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """All that is said."""
        return (*self.channels, *((self.stretches,) if self.stretches else ()))

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
    size, held = history.data.shape[1], dict(missing)
    nothing = np.zeros(size, dtype=bool)
    for c, x in zip(history.channels, history.data, strict=True):
        if (h := _held(np.asarray(x))) is not None and h.any():
            held[c.id] = h | missing[c.id] if c.id in missing else h
    if not held:
        return history, Gaps(nothing, notes)
    share = {
        c.id: np.count_nonzero(held[c.id]) / size if c.id in held else 0.0 for c in history.channels
    }
    typical = float(np.median(list(share.values())))
    keep = [i for i, part in share.items() if part <= typical + MOST]
    notes += tuple(
        f"channel {i}: {100 * share[i]:.0f} % of its samples are lost; left out"
        for i in share
        if i not in keep
    )
    if len(keep) < len(share):
        history = history.pick(keep)
    held = {i: held[i] for i in keep if i in held}
    lost = np.any([nothing, *held.values()], axis=0)
    history, common, said = _each_by_itself(history, held, lost)
    if said:
        lost, held, notes = (
            common,
            {i: h & common for i, h in held.items() if (h & common).any()},
            (*notes, said),
        )
    if not lost.any() or lost.all():
        return history, Gaps(nothing, notes)
    names = [i for i in keep if i in held]
    parts, first = len(runs(lost)), int(np.flatnonzero(lost)[0]) / history.rate
    why = [
        w
        for w, some in (
            ("samples are missing", missing),
            ("a value is held", held.keys() - missing),
        )
        if some
    ]
    told = (
        f"{'all channels' if len(names) == len(keep) > 1 else 'channel ' + ' '.join(names)}: "
        f"lost {parts} "
        f"time{'s' if parts > 1 else ''} ({', '.join(why)}), the first at {first:.4g} s, "
        f"{np.count_nonzero(lost) / history.rate:.3g} s in all; left out in all channels"
    )
    data = np.array(history.data)
    for x in data:
        _bridge(x, lost)
    return replace(history, data=data), Gaps(lost, notes, told)


def _each_by_itself(
    history: TimeHistory, held: dict[str, Bool], lost: Bool
) -> tuple[TimeHistory, Bool, str]:
    """The record, what most channels lost, and a note where others lost parts at times of their own
    (radio links).

    To leave these out in all channels would leave little: each has a straight line there by itself.
    """
    common = np.sum(list(held.values()), axis=0) * 2 > len(history.channels) if held else lost
    alone = {i: h & ~common for i, h in held.items()}
    most = max((float(h.mean()) for h in alone.values()), default=0.0)
    if (lost & ~common).mean() < max(SCATTERED, EACH * most):
        return history, lost, ""
    data = np.array(history.data)
    for k, c in enumerate(history.channels):
        if c.id in alone:
            _bridge(data[k], alone[c.id])
    count = sum(bool(h.any()) for h in alone.values())
    told = (
        f"{count} channels lost parts at times of their own, {100 * most:.2g} % of one at most: "
        "straight lines there "
        "in each by itself"
    )
    return replace(history, data=data), common, told


def _filled(history: TimeHistory) -> tuple[TimeHistory, dict[str, Bool], tuple[str, ...]]:
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
    notes: list[str] = []
    for i in bad:
        none, name = ~np.isfinite(data[i]), history.channels[i].id
        _bridge(data[i], none)
        long = none.copy()
        for a, b in runs(none):
            long[a : b + 1] = b - a >= SHORT
        if long.any():
            missing[name] = long
        if count := np.count_nonzero(none & ~long):
            notes.append(
                f"channel {name}: {count} missing sample{'s' if count > 1 else ''} interpolated"
            )
    return replace(history, data=data), missing, tuple(notes)


def _held(x: Any_) -> Bool | None:
    """(sample,) samples that are held; None where few equal their neighbours."""
    if np.count_nonzero(x[1:] == x[:-1]) < HELD:
        return None
    first, length = equal_runs(x)
    if length.size < 2:
        return None
    long = length > HELD + TYPICAL * float(np.percentile(length, 99))
    at = np.flatnonzero(long)
    near = length[(at[:, None] + np.arange(-BESIDE, BESIDE + 1)).clip(0, length.size - 1)]
    long[at] = length[at] > HELD + TYPICAL * np.median(near, axis=1)
    steps = np.abs(np.diff(x[first].astype(np.float64)))
    leap = LEAP * float(np.median(steps))
    into, out = np.insert(steps, 0, np.inf) > leap, np.append(steps, np.inf) > leap
    extreme = (x[first] == x.max()) | (x[first] == x.min())
    return np.asarray(np.repeat(long & (~extreme | (into & out)), length))


def _bridge(x: Any_, lost: Bool) -> None:
    """Lay a straight line over the lost samples of x (sample,); zeros where all are."""
    at, known = np.flatnonzero(lost), np.flatnonzero(~lost)
    x[at] = np.interp(at, known, x[known]) if known.size else 0.0


def overlap(before: TimeHistory, later: TimeHistory) -> int:
    """How many of the first samples of `later` are the last ones of `before`, or lie within it."""
    a, b = before.data, later.data
    if (
        a.shape[0] != b.shape[0]
        or min(a.shape[1], b.shape[1]) < _LEAST
        or not np.ptp(b[:, :_LEAST], axis=1).any()
    ):
        return 0
    begin = np.flatnonzero(a[0, : a.shape[1] - _LEAST + 1] == b[0, 0])
    for k in range(_LEAST):  # of coarse samples many begin alike
        begin = begin[(a[:, begin + k] == b[:, k : k + 1]).all(axis=0)]
    for at in begin.tolist():
        n: int = min(a.shape[1] - at, b.shape[1])
        if np.array_equal(a[:, at : at + n], b[:, :n], equal_nan=True):
            return n
    return 0


def remove_overlap(before: TimeHistory | None, later: TimeHistory) -> tuple[TimeHistory, str]:
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
