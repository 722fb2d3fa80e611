"""Frequency lines: those that several axes share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int

_SAME = 1e-6  # of the last line
_MOST = 0.5  # of the lines of the shortest axis, that must be shared


def shared_lines(axes: Sequence[Float]) -> list[Int] | None:
    """Where the lines that all axes share stand in each; None where these are no more than half of
    the fewest.

    Parameters
    ----------
    axes : sequence of (f,) float64, Hz, ascending
    """
    distinct = {(a.size, a.tobytes()): a for a in axes}
    fewest = min(distinct.values(), key=lambda a: a.size)
    near = {k: _nearest(a, fewest) for k, a in distinct.items()}
    limit = _SAME * max(float(fewest[-1]), 1.0)
    shared = np.all([np.abs(a[near[k]] - fewest) <= limit for k, a in distinct.items()], axis=0)
    if np.count_nonzero(shared) <= _MOST * fewest.size:
        return None
    return [near[a.size, a.tobytes()][shared] for a in axes]


def _nearest(axis: Float, lines: Float) -> Int:
    """(f,) position in an ascending axis of the line nearest to each of `lines`."""
    middle = 0.5 * (axis[1:] + axis[:-1])
    return np.asarray(np.searchsorted(middle, lines))
