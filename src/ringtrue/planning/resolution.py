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
    averages : int
        Blows, or blocks of a shaker, at each reference for the wanted random error of the FRFs.
    std_frequency, std_damping : (m,) float64
        Relative standard deviations to expect of an ambient record of that length.
    """

    step: float
    block: float
    record: float
    averages: int
    std_frequency: Float
    std_damping: Float


def ambient_std(frequencies: Float, damping: Float | float, duration: float) -> tuple[Float, Float]:
    """Relative standard deviations (m,) of frequency and damping from `duration` s of white
    excitation.

    σ_f/f = √(ζ/(2π f T)), σ_ζ/ζ = √(1/(2π ζ f T)); Gersch (1974), the statistical floor of any
    method.
    """
    z, f = np.asarray(damping, dtype=np.float64), np.asarray(frequencies, dtype=np.float64)
    n = 2 * np.pi * f * duration
    return np.sqrt(z / n), np.sqrt(1 / (z * n))


def frf_averages(error: float, coherence: float) -> int:
    """Averages for a relative random error of |H|: (1 − γ²)/(2γ²·error²); Bendat and Piersol
    (2010), section 9.2.

    Parameters
    ----------
    error : float
        Relative standard deviation of the magnitude of an H1 estimate.
    coherence : float, 0..1
        Of force and response, γ².
    """
    return max(1, int(np.ceil((1 - coherence) / (2 * coherence * error**2) * (1 - 1e-9))))


def resolution(
    frequencies: Float,
    damping: float,
    *,
    precision: float = 0.1,
    shortest: float = 600.0,
    error: float = 0.05,
    coherence: float = 0.98,
) -> Resolution:
    """Resolution for modes at `frequencies` (m,) Hz with about the damping ratio `damping`.

    Parameters
    ----------
    precision : float
        Wanted relative standard deviation of the damping of the lowest mode in an ambient record.
    shortest : float, s
        Least length of an ambient record.
    error : float
        Wanted relative random error of an FRF.
    coherence : float, 0..1
        Expected of it.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    low = float(f.min())
    step = 0.5 * damping * low
    block = max(1 / step, np.log(100) / (2 * np.pi * damping * low)) if low > 0 else np.inf
    record = max(shortest, 1 / (precision**2 * 2 * np.pi * damping * low))
    record = float(np.ceil(record / 60) * 60)
    std_f, std_z = ambient_std(f, damping, record)
    averages = frf_averages(error, coherence)
    return Resolution(float(step), float(block), record, averages, std_f, std_z)
