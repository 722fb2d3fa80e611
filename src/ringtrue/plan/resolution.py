"""Frequency step, record length and what precision to expect of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """What the records must be like.

    Attributes
    ----------
    step : float, Hz
        Of the FRFs: a quarter of the narrowest half-power bandwidth.
    block : float, s
        Of one hit; 1/step, or until the slowest mode has decayed to 1 % if that is longer.
    record : float, s
        Of an ambient record for the wanted precision of damping.
    std_frequency, std_damping : (m,) float64
        Relative standard deviations to expect of an ambient record of that length.
    """

    step: float
    block: float
    record: float
    std_frequency: Float
    std_damping: Float


def ambient_std(frequencies: Float, damping: Float | float, duration: float) -> tuple[Float, Float]:
    """Relative standard deviations (m,) of frequency and damping from `duration` s of white excitation.

    σ_f/f = √(ζ/(2π f T)), σ_ζ/ζ = √(1/(2π ζ f T)); Gersch (1974), the statistical floor of any method.
    """
    z, f = np.asarray(damping, dtype=np.float64), np.asarray(frequencies, dtype=np.float64)
    n = 2 * np.pi * f * duration
    return np.sqrt(z / n), np.sqrt(1 / (z * n))


def resolution(frequencies: Float, damping: float, *, precision: float = 0.1, shortest: float = 600.0) -> Resolution:
    """Resolution for modes at `frequencies` (m,) Hz with about the damping ratio `damping`.

    Parameters
    ----------
    precision : float
        Wanted relative standard deviation of the damping of the lowest mode in an ambient record.
    shortest : float, s
        Least length of an ambient record.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    low = float(f.min())
    step = 0.5 * damping * low
    block = max(1 / step, np.log(100) / (2 * np.pi * damping * low)) if low > 0 else np.inf
    record = max(shortest, 1 / (precision**2 * 2 * np.pi * damping * low))
    record = float(np.ceil(record / 60) * 60)
    std_f, std_z = ambient_std(f, damping, record)
    return Resolution(float(step), float(block), record, std_f, std_z)
