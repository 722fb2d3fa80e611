"""Peaks that stand out of their surroundings."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ringtrue.core.arrays import Float, Int


def prominent_peaks(level: Float, prominence: float) -> Int:
    """(k,) int64 positions of the peaks that stand at least so much above the higher of the valleys on both sides.

    A valley is the lowest value between a peak and a higher one, or the end; of a flat top the middle is told.

    Parameters
    ----------
    level : (n,) float64
    prominence : float
    """
    starts = np.append(0, np.flatnonzero(np.diff(level)) + 1)  # of runs of equal values
    value = level[starts]
    top = np.flatnonzero((value[1:-1] > value[:-2]) & (value[1:-1] > value[2:])) + 1
    if not top.size:
        return np.zeros(0, dtype=np.int64)
    height, valleys = value[top], np.minimum.reduceat(value, np.append(0, top))
    left = _valleys(height, valleys[:-1])
    right = _valleys(height[::-1], valleys[:0:-1])[::-1]
    far = top[height - np.maximum(left, right) >= prominence]
    return np.asarray((starts[far] + starts[far + 1] - 1) // 2, dtype=np.int64)


def _valleys(heights: Iterable[float], before: Iterable[float]) -> Float:
    """(peak,) lowest value since a higher peak; `before` are those since the peak before."""
    out: list[float] = []
    higher: list[tuple[float, float]] = []  # peaks before, each higher than the next, and their valleys
    for h, v in zip(heights, before, strict=True):  # one pass; most peaks are passed over at once
        while higher and higher[-1][0] <= h:
            v = min(v, higher.pop()[1])
        higher.append((h, v))
        out.append(v)
    return np.array(out)
