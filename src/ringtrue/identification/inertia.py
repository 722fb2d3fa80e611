"""Heat that comes late: a structure takes the temperature of the air with an inertia of hours.

To first order lag·dθ/dt = T − θ. The lag, one for all modes, is that of a row under which their
frequencies are most likely, each with a slope and a scatter of its own; none unless twice the
logarithm of the likelihood ratio is above 10, that of each mode divided by what residuals that hang
together make of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.identification.environment import FEWEST, inflation, memory_of, weighted

LAGS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 12.0)  # h
SURER = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Frequencies (n,) of a mode, Hz, their standard deviations, and the stretches (n,) that they
    belong to.
    """

    frequency: Float
    std: Float
    at: Int


def behind(hours: Float, temperature: Float, lag: float) -> Float:
    """Temperature (n,) of a body that follows that of the air, given at rising `hours` (n,), linear
    between them.

    It starts in balance. NaN where the temperature of the air is.
    """
    known = np.isfinite(temperature)
    if not known.any():
        return temperature
    air = np.interp(hours, hours[known], temperature[known])
    body = air.copy()
    for k, step in enumerate(np.diff(hours)):  # stretches
        late = lag * (air[k + 1] - air[k]) / step  # behind a ramp, in the end
        body[k + 1] = air[k + 1] - late + (body[k] - air[k] + late) * np.exp(-step / lag)
    return np.where(known, body, np.nan)


def thermal_lag(modes: Sequence[Followed], hours: Float, temperature: Float) -> float:
    """By how many hours the modes follow a temperature (stretch,); 0 where they do at once, or do
    not tell.
    """
    best, most = 0.0, SURER
    for lag in LAGS:
        late = behind(hours, temperature, lag)
        gain = sum(_gain(m, temperature[m.at], late[m.at]) for m in modes)
        if gain > most:
            best, most = lag, gain
    return best


def _gain(mode: Followed, now: Float, late: Float) -> float:
    """Twice the logarithm of the likelihood of a mode with the late temperature over that with the
    other.
    """
    use = np.isfinite(now) & np.isfinite(mode.std) & (mode.std > 0)
    if use.sum() < 2 * FEWEST or np.ptp(now[use]) == 0:
        return 0.0
    y, sd = mode.frequency[use], mode.std[use]
    fits = [
        weighted(y, sd, np.stack([np.ones(y.size), x - x.mean()], axis=1))
        for x in (now[use], late[use])
    ]
    misfit = [float((f.residual**2).sum() + np.log(sd**2 + f.scatter**2).sum()) for f in fits]
    return (misfit[0] - misfit[1]) / inflation(memory_of(fits[1].residual, mode.at[use], 2), 1.0)
