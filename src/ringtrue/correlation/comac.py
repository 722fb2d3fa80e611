"""Where two sets of paired shapes differ: by channel."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.shapes.mac import unit


def comac(a: Any_, b: Any_) -> Float:
    """Coordinate MAC, (n,) 0..1: (Σ|a b|)²/(Σ|a|² Σ|b|²) over paired modes (Lieven and Ewins,
    1988).

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
        Column k of one belongs to column k of the other. Blind to the sign of a channel.
    """
    a, b = unit(np.asarray(a)), unit(np.asarray(b))
    below = (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
    return np.asarray(
        np.abs(a * b).sum(axis=1) ** 2 / np.where(below > 0, below, 1.0), dtype=np.float64
    )


def ecomac(a: Any_, b: Any_) -> Float:
    """Enhanced COMAC, (n,) 0 is best: mean |a − b|/2 of unit shapes in phase (Hunt, 1992); sees
    signs.
    """
    a, b = unit(np.asarray(a)), unit(np.asarray(b))
    cross = (b.conj() * a).sum(axis=0)
    phase = cross / np.where(np.abs(cross) > 0, np.abs(cross), 1.0)
    return np.asarray(
        np.abs(a - b * phase).sum(axis=1) / (2 * max(a.shape[1], 1)), dtype=np.float64
    )
