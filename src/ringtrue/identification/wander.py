"""Frequencies that wander along a record (temperature, traffic, tide): seen in the scatter of its
blocks.

The estimates of stationary modes scatter from block to block without memory. Where the frequency
wanders slowly those of neighbouring blocks are alike, and their covariance is the variance of the
frequency. The mean over the record is then wider than the mode, by more than its scatter tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.identification.stabilise import Candidates

LEAST_BLOCKS = 12
BEYOND = 3.0  # standard deviations of the mean correlation of neighbours
MATTERS = 0.25  # wander over damping: below it adds 3 % of damping
# of the square of that ratio: what it adds to the damping, by the shape of the wander 0.2 to 0.8
WIDER = 0.5


def wander(c: Candidates, at: Int, blocks: int) -> Float:
    """(m,) standard deviation of the frequency along the record over the frequency; 0 where it may
    be scatter.

    Parameters
    ----------
    c : Candidates
        With deviations by the blocks of the record, in time.
    at : (k,) int64
        Rows that are modes; whatever moves them moves most of them.
    blocks : int
        The first columns of the deviations.
    """
    out = np.zeros(c.pole.size)
    if blocks < LEAST_BLOCKS or not at.size:
        return out
    d = (c.deviation[at, :blocks] * c.pole[at, None].conj()).real / np.abs(c.pole[at, None]) ** 2
    d *= np.sqrt(blocks * (blocks - 1.0))  # of a block, not of the mean
    own = (d**2).mean(axis=1)
    both = (d[:, 1:] * d[:, :-1]).sum(axis=1) / (
        blocks - 1
    ) + own / blocks  # the mean over the blocks is taken off
    like = both / np.maximum(own, np.finfo(np.float64).tiny)
    if like.mean() > BEYOND / np.sqrt(blocks * at.size):
        out[at] = np.sqrt(np.maximum(both, 0))
    return np.where(out > MATTERS * c.damping, out, 0.0)


def widened(c: Candidates, wandering: Float) -> Candidates:
    """The candidates with what the wander may add to the damping among their deviations, in a
    column of each.
    """
    rows = np.flatnonzero(wandering)
    if not rows.size:
        return c
    more = np.zeros((c.pole.size, rows.size), dtype=np.complex128)
    share = WIDER * (wandering[rows] / c.damping[rows]) ** 2
    w, zeta = np.abs(c.pole[rows]), c.damping[rows]
    more[rows, np.arange(rows.size)] = share * zeta * w * (-1 - 1j * zeta / np.sqrt(1 - zeta**2))
    return replace(c, deviation=np.concatenate([c.deviation, more], axis=1))
