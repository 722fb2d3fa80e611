"""Channels that records have in common, turned or exchanged in one of them: told from the shapes,
and undone.

The shapes of a mode agree on common channels whatever excited it. A channel turned or swapped in
one record breaks that in all modes, and undoing it mends all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.shapes.mac import mac

NEAR = 0.02  # relative distance of frequencies that may be one mode
LEAST = 0.02  # mean 1 − MAC that calls for a reason
CURED = 0.3  # of it that may be left
# modes that must be mended, or all that are in common: one or two may have poor shapes for another
# reason
SEEN = 3
MOST = 3  # faults that are looked for
WIDEST = 40  # common channels


@dataclass(frozen=True, slots=True)
class CommonFault:
    """A channel that is turned in one record, or two that are exchanged.

    Attributes
    ----------
    record : int
        Position of the record.
    channels : tuple of str
        One that is turned, or two that are exchanged.
    before, after : float
        Mean MAC of the modes of this record with those of the others on the common channels, as
        they are and mended.
    sure : bool
        Whether this record is the one; of two records either may be.
    """

    record: int
    channels: tuple[str, ...]
    before: float
    after: float
    sure: bool

    def describe(self, names: Sequence[str]) -> str:
        """One line."""
        which = names[self.record] if self.sure else " or ".join(names[:2])
        what = "looks turned" if len(self.channels) == 1 else "look exchanged"
        return (
            f"{' and '.join(self.channels)} of {which} {what}: undone (MAC with the other "
            f"records {self.before:.3f} "
            f"before, {self.after:.3f} after)"
        )


def common_faults(records: Sequence[ModeSet]) -> tuple[CommonFault, ...]:
    """Turned and exchanged channels between records of one structure, the surest first.

    Parameters
    ----------
    records : sequence of ModeSet
        With three or more channels and two or more modes in common.
    """
    now, out = list(records), []
    for _ in range(MOST):
        best: CommonFault | None = None
        for r in range(1 if len(now) == 2 else 0, len(now)):
            before = _misfits(now, r, now[r])
            if not _mean(before) > LEAST:
                continue
            for channels in _trials(now, r):
                after = _misfits(now, r, undone(now[r], channels))
                gain = _mean(before) - _mean(after)
                if _cured(before, after) and (best is None or gain > best.after - best.before):
                    best = CommonFault(
                        r, channels, 1 - _mean(before), 1 - _mean(after), len(now) > 2
                    )
        if best is None:
            break
        now[best.record] = undone(now[best.record], best.channels)
        out.append(best)
    return tuple(out)


def _cured(before: Float, after: Float) -> bool:
    """Whether most of the misfit goes, and not in one or two modes alone."""
    mended = (before > LEAST) & (after < CURED * before)
    return _mean(after) < CURED * _mean(before) and bool(
        mended.sum() >= min(SEEN, np.isfinite(before).sum())
    )


def undone(modes: ModeSet, channels: tuple[str, ...]) -> ModeSet:
    """The modes with one channel turned, or two exchanged."""
    at = [modes.channels.index(c) for c in channels]
    shapes = np.array(modes.shapes)
    shapes[at] = -shapes[at] if len(at) == 1 else shapes[at[::-1]]
    return replace(modes, shapes=shapes)


def _trials(records: Sequence[ModeSet], r: int) -> Iterator[tuple[str, ...]]:
    others = {c for k, m in enumerate(records) if k != r for c in m.channels}
    shared = [c for c in records[r].channels if c in others][:WIDEST]
    if len(shared) > 2:
        yield from ((c,) for c in shared)
        yield from combinations(shared, 2)


def _misfits(records: Sequence[ModeSet], r: int, changed: ModeSet) -> Float:
    """(m,) 1 − MAC of each mode of a record, mean over all others that it shares three channels
    with; NaN: in none.
    """
    others = [m for k, m in enumerate(records) if k != r]
    apart = np.array([_one_minus_mac(changed, m) for m in others]).reshape(
        len(others), len(changed)
    )
    known = np.isfinite(apart)
    apart, known = apart[known.sum(axis=1) > 1], known[known.sum(axis=1) > 1]
    count = known.sum(axis=0)
    total = np.where(known, apart, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0))


def _mean(misfits: Float) -> float:
    known = misfits[np.isfinite(misfits)]
    return float(known.mean()) if known.size else 0.0


def _one_minus_mac(a: ModeSet, b: ModeSet) -> Float:
    """(a,) of the modes that two records share, matched by shape among those of like frequency; NaN
    without a match.
    """
    out = np.full(len(a), np.nan)
    shared = [c for c in a.channels if c in b.channels]
    if len(shared) < 3 or not len(a) or not len(b):
        return out
    rows_a, rows_b = _rows(a, shared), _rows(b, shared)
    apart = 1 - mac(a.shapes[rows_a], b.shapes[rows_b])
    near = np.abs(a.frequencies[:, None] / b.frequencies - 1) < NEAR
    i, j = linear_sum_assignment(np.where(near, apart, 10.0))
    out[i[near[i, j]]] = apart[i, j][near[i, j]]
    return out


def _rows(modes: ModeSet, channels: Sequence[str]) -> Int:
    return np.array([modes.channels.index(c) for c in channels], dtype=np.int64)
