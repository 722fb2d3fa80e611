"""Evidence that a pole is a machine: its amplitude is steady, or its phase goes with that of a
known line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import ifft, next_fast_len
from scipy.special import ndtr

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.signal.spectra import AT_ONCE, step
from ringtrue.signal.tonal_lines import excerpt_spectrum
from ringtrue.signal.transients import FEWEST


@dataclass(frozen=True, slots=True)
class AmplitudeSettings:
    """When the amplitude of a pole is that of a machine.

    Attributes
    ----------
    loud : float
        Share of the time that gives the loud level.
    peak : float
        Largest power of a machine that switches, over its loud level: what is counted by chance is
        more than the instants of a long record that are looked at.
    """

    loud: float = 0.05
    peak: float = 1.4


@dataclass(frozen=True, slots=True)
class PhaseSettings:
    """When the phase of a pole goes with that of a known line.

    Attributes
    ----------
    orders : tuple of int
        Of one line over that of another.
    """

    orders: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 9, 12)

    @property
    def near(self) -> float:
        """Relative distance from a ratio of whole numbers, at most: half of that between the
        highest. Half a band has twice as much of its frequency at most.
        """
        return 0.5 / max(self.orders)


AMPLITUDE = AmplitudeSettings()
PHASE = PhaseSettings()


def _narrow(
    spectrum: Complex, n: int, samples: int, rate: float, frequency: float, width: float
) -> tuple[float, float, float]:
    """Kurtosis 1.5 E|a|⁴/(E|a|²)² of a narrow band by its complex envelope a, power E|a|² up to a
    factor, and peak.

    The peak is that of |a|² over what it exceeds in a twentieth of the time, in the loudest
    channel.

    `spectrum` is that of `samples` at `rate` Hz, by a transform of the length `n`.
    """
    step_f = rate / n
    first = max(int((frequency - 0.75 * width) / step_f), 1)
    last = min(int((frequency + 0.75 * width) / step_f) + 2, spectrum.shape[1])
    f = step_f * np.arange(first, last)
    edges = (
        (frequency - 0.75 * width, frequency - 0.4 * width),
        (frequency + 0.75 * width, frequency + 0.4 * width),
    )
    gain = (step(f, *edges[0]) * step(f, *edges[1])).astype(spectrum.real.dtype)
    m = int(next_fast_len(min(2 * f.size, 1 << 14)))
    lines = np.zeros((len(spectrum), -(-f.size // m), m), dtype=spectrum.dtype)
    lines.reshape(len(spectrum), -1)[:, : f.size] = spectrum[:, first:last] * gain
    # folded lines: the same envelope at fewer instants
    envelope = ifft(lines.sum(axis=1), axis=1, norm="forward")
    power = envelope.real**2 + envelope.imag**2
    skirt = int(np.ceil(m * step_f / width))
    power = power[:, skirt : m * samples // n - skirt]
    mean = power.mean(axis=1, dtype=np.float64)
    power *= (1 / np.maximum(mean, np.finfo(power.dtype).tiny)).astype(power.dtype)[
        :, None
    ]
    each = np.einsum("cs,cs->c", power, power) / power.shape[1] * mean
    loudest = power[mean.argmax()]
    top = float(
        loudest.max()
        / max(np.quantile(loudest, 1 - AMPLITUDE.loud), np.finfo(power.dtype).tiny)
    )
    return float(1.5 * each.sum() / max(mean.sum(), 1e-300)), float(mean.sum()), top


def amplitude_evidence(
    history: TimeHistory,
    frequencies: ArrayLike,
    damping: ArrayLike,
    lines: Sequence[float] = (),
    interval: float = 0.0,
) -> tuple[str, ...]:
    """Why a pole is taken for a machine by its steady amplitude, always or while it runs; empty
    where it is not.

    A line that wanders looks like a mode of small damping, but its amplitude stays. The kurtosis of
    the band of the pole is that of random response, 3, with a standard deviation of 3/sqrt(2π ζ f
    T); a pole is no mode where it is nearer to the 1.5 of a sine and too far below 3 by chance. The
    band is widened to four times its width, as a line may wander beyond its pole, while it holds
    most of its power near the pole and no known line. Poles of few cycles are not tried.

    A machine that switches on and off has the same amplitude each time: the power of a mode,
    exponentially distributed, goes far beyond what it exceeds in a twentieth of the time. With the
    4π ζ f T values that it takes independently the largest is below m times that in (1 − 20^−m)^(4π
    ζ f T) of cases, and less often where the forces come and go.

    Parameters
    ----------
    history : TimeHistory
        Some of it is looked at (`searched_part`).
    frequencies : (k,) float, Hz
    damping : (k,) float
    lines : sequence of float, Hz
        Lines known already: they make any band steady.
    interval : float, s
        Between impacts that drive the record; 0: none. Amplitudes that do not fall between them are
        steady, and their largest are equal where the impacts are. Only poles that would fall far
        are tried.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    z = np.asarray(damping, dtype=np.float64)
    samples = min(history.data.shape[1], AT_ONCE)
    duration = samples / history.rate
    width = np.maximum(6 * z * f, 20 / duration)
    cycles = 2 * np.pi * z * f * duration
    distance = (
        np.abs(f[:, None] - np.asarray(lines)).min(axis=1, initial=np.inf)
        - 120 / duration
    )
    edge = 0.9 * np.minimum(f, history.rate / 2 - f)
    out = [""] * f.size
    tried = cycles > 40
    if interval:
        # their power falls below that of a false alarm between impacts
        tried &= 4 * np.pi * z * f * interval > -np.log(FALSE_ALARM)
    if not (tried & (width < np.minimum(edge, distance / 0.75))).any():
        return tuple(out)
    spectrum, n = excerpt_spectrum(history)
    for k in np.argsort(z, kind="stable").tolist():  # a few poles, sharp lines first
        room = min(edge[k], distance[k] / 0.75)
        if not (tried[k] and width[k] < room):
            continue
        widths = [float(w) for w in width[k] * np.array([1.0, 2.0, 4.0]) if w < room]
        bands = [
            _narrow(
                spectrum,
                n,
                samples=samples,
                rate=history.rate,
                frequency=float(f[k]),
                width=w,
            )
            for w in widths
        ]
        near = [band for band in bands if band[1] < 2 * bands[0][1]]
        kurtosis = min(x[0] for x in near)
        top = min(x[2] for x in near)
        as_low = (1 - AMPLITUDE.loud**top) ** (2 * cycles[k])  # chance of a mode
        regular = top < AMPLITUDE.peak and as_low < FALSE_ALARM and not interval
        as_steady = ndtr((kurtosis - 3) / (3 / np.sqrt(cycles[k])))
        if kurtosis < np.sqrt(1.5 * 3) and as_steady < FALSE_ALARM:
            out[k] = (
                f"a machine of unsteady speed: steady amplitude (kurtosis {kurtosis:.2f}, a mode "
                "has 3, a sine 1.5)"
            )
        elif regular:
            out[k] = (
                f"a machine that switches: its loudest moments are equal (peaks {top:.3g} times "
                "the loud level)"
            )
        if out[k]:
            offset = np.abs(f - f[k])
            distance = np.minimum(
                distance, np.where(offset > width[k], offset - width[k] / 2, np.inf)
            )
    return tuple(out)


def phase_evidence(
    history: TimeHistory, frequencies: Float, damping: Float, machines: Sequence[bool]
) -> tuple[str, ...]:
    """Why a pole belongs to a machine that is known: their phases go together; empty where they do
    not.

    Parameters
    ----------
    history : TimeHistory
        Some of it is looked at (`searched_part`).
    frequencies : (k,) float64, Hz
    damping : (k,) float64
    machines : sequence of bool
        Which are known to be lines of machines.
    """
    f = frequencies
    known = np.array(machines, dtype=bool)
    out = [""] * frequencies.size
    pairs = [
        (k, j, *r)
        for k in np.flatnonzero(~known)
        for j in np.flatnonzero(known)
        if (r := _ratio(f[k] / f[j]))
    ]
    if not pairs:
        return tuple(out)
    spectrum, n = excerpt_spectrum(history)
    step = history.rate / n
    evidence = -np.log(FALSE_ALARM / len(pairs))  # of the test of Rayleigh
    for k, j, p, q in pairs:  # a few poles
        if out[k]:
            continue
        half = min(
            max(3 * max(damping[k], damping[j]), FEWEST * step / min(f[k], f[j])),
            2 * PHASE.near,
        )
        count = int(next_fast_len(int(4 * half * max(f[k], f[j]) / step) + 8))
        a, b = (_instants(spectrum, step, float(x), half, count) for x in (f[k], f[j]))
        weight = np.abs(a * b)
        turn = np.exp(1j * (q * np.angle(a) - p * np.angle(b)))
        together = float(np.abs((weight * turn).sum()) / weight.sum())
        periods = 2 * half * min(f[k], f[j]) / step
        if together**2 * periods > evidence:
            out[k] = (
                f"a machine: its phase goes with that of the line at {f[j]:.4g} Hz, {p}:{q}"
            )
    return tuple(out)


def _ratio(x: float) -> tuple[int, int] | None:
    """Whole numbers p, q with x = p/q but for a few per cent; None where there are none, or x is
    1.
    """
    pairs: Sequence[tuple[int, int]] = (
        [(p, 1) for p in PHASE.orders[1:]]
        + [(1, q) for q in PHASE.orders[1:]]
        + [(3, 2), (2, 3)]
    )
    p, q = min(pairs, key=lambda r: abs(x * r[1] / r[0] - 1))
    return (p, q) if abs(x * q / p - 1) < PHASE.near else None


def _instants(
    spectrum: Any_, step: float, frequency: float, half: float, count: int
) -> Complex:
    """(count,) the one-sided band of a relative half width at instants of the record, of the
    channel loudest there.
    """
    first = int(frequency * (1 - half) / step)
    last = int(np.ceil(frequency * (1 + half) / step))
    own = spectrum[:, first : last + 1]
    loud = own[int((np.abs(own) ** 2).sum(axis=1).argmax())]
    band = np.zeros((last // count + 1) * count, dtype=np.complex64)
    band[first : first + loud.size] = loud * np.hanning(loud.size)
    return np.asarray(ifft(band.reshape(-1, count).sum(axis=0), norm="forward"))
