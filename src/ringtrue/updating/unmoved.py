"""Changes of an updating that are not worth a new value in a deck."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Bool, Float

# relative shift of a frequency: half of the last digit in which deviations are stated (0.01 %)
STILL = 5e-5


def unmoved(x: Float, std: Float, slopes: Float) -> Bool:
    """Parameters (p,) whose change is smaller than its own stated error and moves no mode.

    Parameters
    ----------
    x, std : (p,) float64
        Changes from nominal and their standard deviations.
    slopes : (m, p) float64
        Of ln f of the modes to x.
    """
    shift = np.abs(slopes * x).max(axis=0, initial=0.0)
    return np.asarray((np.abs(x) < std) & (shift < STILL))
