"""What is left of the ripples of an echo (`signal.echoes`): modes are less certain by it.

A ripple ε cos(ωτ + φ) of the logarithmic spectrum at a resonance, which stands there as 1/(1 + x²)
with x = (ω − ω0)/(ζ ω0), moves the most likely frequency by ζ ε sin φ exp(−ζ ω0 τ), relatively, and
the damping by ε cos φ exp(−ζ ω0 τ): the products of its cosine with the two derivatives of the
logarithm, over their squares. A ripple wider than what is looked at of a resonance is a slope and a
level, which are free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.identification.ambient_verdict import Found
from ringtrue.identification.whittle import REACHES
from ringtrue.signal.echoes import Echo


def rippled(found: Found, echo: Echo) -> Found:
    """The candidates with what a wrong factor of the echo does among their deviations, in two
    columns of each.
    """
    c = found.table
    w, zeta = np.abs(c.pole), c.damping
    decay = zeta * w * echo.delay
    seen = np.exp(-decay) * np.minimum(2 / np.pi * REACHES[0] * decay, 1)
    size = np.sqrt(2) * echo.doubt * abs(echo.factor) / np.sqrt(1 - echo.factor**2) * seen
    moved = c.pole * zeta * size
    damped = zeta * w * (-1 - 1j * zeta / np.sqrt(1 - zeta**2)) * size
    more = np.concatenate([np.diag(moved), np.diag(damped)], axis=1)
    return replace(found, table=replace(c, deviation=np.concatenate([c.deviation, more], axis=1)))
