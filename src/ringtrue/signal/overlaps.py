"""Files of one record that overlap: samples that two of them hold count once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.signals import TimeHistory

_LEAST = 64  # samples that are the same in all channels: fewer may be chance


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


def without_overlap(before: TimeHistory | None, later: TimeHistory) -> tuple[TimeHistory, str]:
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
