"""What a record rests on: its offset, trend and slow drift are taken out, and its size brought near
1.

A drift may be many thousand times the vibration. What follows works in single precision, takes
fourth powers, and lets the record begin and end in nothing: a step at its ends would be seen in all
bands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander

from ringtrue.core.signals import TimeHistory

DEGREE = (
    24  # of the polynomials of a drift, at most: 8 cycles in the record, where bands begin at 50
)
BLOCK = 1 << 16  # samples at a time: a basis of the whole record would not fit in memory


def levelled(history: TimeHistory, low: float) -> TimeHistory:
    """The record without what drifts far below `low` Hz, in channels where that is more than all
    else.

    Least squares in Legendre polynomials, of a degree that leaves all from half of `low` on as it
    is.

    Parameters
    ----------
    history : TimeHistory
        (channel, sample), finite.
    low : float, Hz
        Lowest frequency of interest.
    """
    samples = history.data.shape[1]
    degree = min(int(np.clip(0.5 * low * history.duration, 1, DEGREE)), samples - 1)
    places = np.linspace(-1.0, 1.0, samples)
    offset = history.data[:, :1].astype(np.float64)
    gram = np.zeros((degree + 1, degree + 1))
    right = np.zeros((degree + 1, len(history.data)))
    for start in range(0, samples, BLOCK):
        part = slice(start, start + BLOCK)
        basis = legvander(places[part], degree)
        gram += basis.T @ basis
        right += basis.T @ (history.data[:, part] - offset).T
    drift = np.linalg.solve(gram, right)
    drift[0] += offset[:, 0]
    power = np.einsum("pc,pq,qc->c", drift, gram, drift)
    much = power > 0.5 * np.einsum("cs,cs->c", history.data, history.data, dtype=np.float64)
    if not much.any():
        return history
    data = np.array(history.data)
    for start in range(0, samples, BLOCK):
        part = slice(start, start + BLOCK)
        basis = legvander(places[part], degree)
        data[much, part] = history.data[much, part] - (basis @ drift[:, much]).T
    return replace(history, data=data)


def unit_factor(history: TimeHistory) -> float:
    """The power of two that brings the typical standard deviation of the channels near 1; it
    changes no digit.
    """
    exponent = np.frexp(np.median(history.data.std(axis=1, dtype=np.float64)))[1]
    return float(np.ldexp(1.0, -int(exponent)))


def scaled(history: TimeHistory, factor: float) -> TimeHistory:
    """The record times one factor in all channels, which changes no shape."""
    return replace(history, data=history.data * history.data.dtype.type(factor))
