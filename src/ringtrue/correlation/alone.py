"""One assignment of modes by their frequencies alone, and which of its pairs these leave in
doubt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.pairing import SURE

COMMON = 0.1  # standard deviation of what all frequencies of a model are off together, relative
OFFSETS = 29  # common offsets that are tried, over the gate
SCATTER = 0.05  # of the single frequencies about the common offset, before any is known
KNOWN = 2.0  # as many pairs `SCATTER` counts: what the pairs show is the least of all assignments
ALONE = 25.0  # cost of a mode without a partner, in squares of the scatter
DOUBT = 6.0  # an assignment that costs this much more is twenty times less likely
FAR = 50.0  # offsets about which an assignment costs this much more are not looked at again
NEVER, LOCKED = 1e6, -1e6


@dataclass(frozen=True, slots=True, eq=False)
class ByFrequency:
    """The likeliest assignment.

    Attributes
    ----------
    rows, columns : (k,) int64, ascending rows
    rival : (k,) int64
        What else each mode of A may be: the mode of B that the next likely assignment gives it, -1:
        none of B; `SURE` where the pair is not in doubt.
    """

    rows: Int
    columns: Int
    rival: Int

    def __post_init__(self) -> None:
        freeze_fields(self, rows=np.int64, columns=np.int64, rival=np.int64)


def by_frequency(fa: Float, fb: Float, allowed: Bool, forced: Bool, wide: Bool) -> ByFrequency:
    """The one-to-one assignment in which the frequencies scatter least about a common relative
    offset.

    A model is too stiff or too heavy as a whole more often than mode by mode: where a mode was
    missed the nearest frequencies belong to other modes. ln f_B − ln f_A is normal about an offset
    that is itself normal; the assignment of greatest likelihood, and for each pair the greatest
    without it.

    Parameters
    ----------
    fa, fb : (ma,), (mb,) float64, Hz
    allowed, forced : (ma, mb) bool
        Pairs that may be, and that must be.
    wide : (ma, mb) bool
        Pairs that are looked at for doubts: gates do not make a pair certain.
    """
    tiny = np.finfo(np.float64).tiny
    error = np.log(np.maximum(fb, tiny))[None, :] - np.log(np.maximum(fa, tiny))[:, None]
    offsets = _offsets(error[allowed & ~forced])
    scatter = SCATTER
    for _ in range(2):
        off = min(
            (_assigned(error, c, scatter, allowed, forced) for c in offsets), key=lambda t: t.cost
        ).off
        scatter = float(np.sqrt((off @ off + KNOWN * SCATTER**2) / (max(off.size - 1, 0) + KNOWN)))
    tried = [_assigned(error, c, scatter, allowed, forced) for c in offsets]
    best = min(tried, key=lambda t: t.cost)
    rows = np.flatnonzero(best.partner >= 0)
    offsets = _offsets(error[wide & ~forced])
    loose = [_assigned(error, c, scatter, wide, forced).cost for c in offsets]
    near = [c for c, cost in zip(offsets, loose, strict=True) if cost < best.cost + FAR]
    rival = []
    for i, j in zip(rows.tolist(), best.partner[rows].tolist(), strict=True):
        other = wide.copy()
        other[i, j] = False
        second = min(
            (_assigned(error, c, scatter, other, forced) for c in near), key=lambda t: t.cost
        )
        clear = forced[i].any() or second.cost >= best.cost + DOUBT
        rival.append(SURE if clear else int(second.partner[i]))
    return ByFrequency(rows, best.partner[rows], np.array(rival, dtype=np.int64))


def _offsets(errors: Float) -> list[float]:
    return list(map(float, np.linspace(errors.min(initial=0.0), errors.max(initial=0.0), OFFSETS)))


@dataclass(frozen=True, slots=True, eq=False)
class _Assigned:
    """Cost, partner (ma,) of each mode of A, -1 for none, and deviations of the free pairs from
    their common offset.
    """

    cost: float
    partner: Int
    off: Float


def _assigned(error: Float, start: float, scatter: float, allowed: Bool, forced: Bool) -> _Assigned:
    """The best assignment about an offset, and what it costs about its own."""
    m, n = error.shape
    cost = np.full((m, n + m), NEVER)
    cost[:, :n] = np.where(allowed, ((error - start) / scatter) ** 2, NEVER)
    cost[:, :n][forced] = LOCKED
    cost[np.arange(m), n + np.arange(m)] = ALONE
    rows, cols = linear_sum_assignment(cost)
    partner = np.where(cols < n, cols, -1)
    rows = np.flatnonzero((partner >= 0) & ~forced.any(axis=1))
    off = error[rows, partner[rows]]
    own = float(off.sum() / (rows.size + (scatter / COMMON) ** 2))
    lone = ALONE * float((partner < 0).sum())
    return _Assigned(
        float((((off - own) / scatter) ** 2).sum()) + (own / COMMON) ** 2 + lone, partner, off - own
    )
