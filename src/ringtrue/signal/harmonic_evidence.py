"""Evidence that a pole is a machine: its amplitude is steady, or its phase goes with that of a
known line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import ifft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.signal.decimation import detrend
from ringtrue.signal.spectra import step
from ringtrue.signal.tonal_lines import LONGEST, excerpt_spectrum

_BETWEEN = 2.1  # kurtosis: the geometric mean of 1.5 of a sine and 3 of random response
_WIDEST = 0.05  # apparent damping of a machine that still has a speed
_NEAR = 0.4  # share of the power of a band that lies near its pole
_INSTANTS = 1 << 14  # of an envelope that tell its moments
# of the logarithm of an amplitude between impacts, whose kurtosis is then that of random response
_FALLEN = 2.0
_LOUD, _ALIKE, _CHANCE = (
    0.05,
    1.4,
    1e-3,
)  # share of the time; its peak power over its least; of a mode to be so steady
NEAR = 0.03  # relative distance from a ratio of whole numbers
WIDEST, LINES = (
    0.06,
    30.0,
)  # half a band over its frequency at most, and in lines of the record at least
ORDERS = (1, 2, 3, 4, 6, 8, 9, 12)  # of one line over that of another
LEAST_PHASOR, SURE = 0.35, 15.0  # mean phasor, and its square times the independent samples


@dataclass(frozen=True, slots=True)
class LineStatistic:
    """What the narrow band around a frequency holds.

    Attributes
    ----------
    frequency : float, Hz
    kurtosis : float
        E x⁴ / (E x²)² of the band-passed signal: 1.5 of a sine, 3 of a mode in random vibration.
    harmonic : bool
    """

    frequency: float
    kurtosis: float
    harmonic: bool


def line_statistics(
    history: TimeHistory, frequencies: Sequence[float], width: float
) -> tuple[LineStatistic, ...]:
    """Kurtosis of the signals band-passed to `width` Hz around each frequency, pooled over channels
    by their power.

    Source: Brincker, Andersen and Møller (2000), An indicator for separation of structural and
    harmonic modes.

    Raises
    ------
    DataError
        If the record holds fewer than 20 times of 1/width.
    ConfigError
        If a band is not between 0 and half of the rate.
    """
    _check_band(history, frequencies, width)
    n = int(next_fast_len(history.data.shape[1], real=True))
    spectrum = rfft(detrend(history.data), n, axis=1)
    kurtosis = [
        _narrow(spectrum, n, history.data.shape[1], history.rate, at, width)[0]
        for at in frequencies
    ]
    return tuple(
        LineStatistic(float(f), k, k < _BETWEEN) for f, k in zip(frequencies, kurtosis, strict=True)
    )


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
    m = int(next_fast_len(min(2 * f.size, _INSTANTS)))
    lines = np.zeros((len(spectrum), -(-f.size // m), m), dtype=spectrum.dtype)
    lines.reshape(len(spectrum), -1)[:, : f.size] = spectrum[:, first:last] * gain
    envelope = ifft(
        lines.sum(axis=1), axis=1, norm="forward"
    )  # folded lines: the same envelope at fewer instants
    power = envelope.real**2 + envelope.imag**2
    skirt = int(np.ceil(m * step_f / width))
    power = power[:, skirt : m * samples // n - skirt]
    mean = power.mean(axis=1, dtype=np.float64)
    power *= (1 / np.maximum(mean, np.finfo(power.dtype).tiny)).astype(power.dtype)[:, None]
    each = np.einsum("cs,cs->c", power, power) / power.shape[1] * mean
    loudest = power[mean.argmax()]
    top = float(loudest.max() / max(np.quantile(loudest, 1 - _LOUD), np.finfo(power.dtype).tiny))
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
    T); a pole is told from a mode where it is below 2.1 and more than three of these below 3. The
    band is widened to four times its width, as a line may wander beyond its pole, while it holds
    most of its power near the pole and no known line. Poles of few cycles or of much damping are
    not tried.

    A machine that switches on and off has the same amplitude each time: the power of a mode,
    exponentially distributed, goes far beyond what it exceeds in a twentieth of the time. With the
    4π ζ f T values that it takes independently the largest is below m times that in (1 − 20^−m)^(4π
    ζ f T) of cases, and less often where the forces come and go.

    Parameters
    ----------
    history : TimeHistory
        Some of it is looked at (`listened`).
    frequencies : (k,) float, Hz
    damping : (k,) float
    lines : sequence of float, Hz
        Lines known already: they make any band steady.
    interval : float, s
        Between impacts that drive the record; 0: none. Amplitudes that do not fall between them are
        steady, and their largest are alike where the impacts are. Only poles that would fall far
        are tried.
    """
    f, z = np.asarray(frequencies, dtype=np.float64), np.asarray(damping, dtype=np.float64)
    samples = min(history.data.shape[1], LONGEST)
    duration = samples / history.rate
    width = np.maximum(6 * z * f, 20 / duration)
    cycles = 2 * np.pi * z * f * duration
    apart = np.abs(f[:, None] - np.asarray(lines)).min(axis=1, initial=np.inf) - 120 / duration
    edge = 0.9 * np.minimum(f, history.rate / 2 - f)
    out = [""] * f.size
    tried = (z < _WIDEST) & (cycles > 40)
    if interval:
        tried &= 2 * np.pi * z * f * interval > _FALLEN
    if not (tried & (width < np.minimum(edge, apart / 0.75))).any():
        return tuple(out)
    spectrum, n = excerpt_spectrum(history)
    for k in np.argsort(z, kind="stable").tolist():  # a few poles, sharp lines first
        room = min(edge[k], apart[k] / 0.75)
        if not (tried[k] and width[k] < room):
            continue
        widths = [float(w) for w in width[k] * np.array([1.0, 2.0, 4.0]) if w < room]
        bands = [_narrow(spectrum, n, samples, history.rate, float(f[k]), w) for w in widths]
        near = [band for band in bands if band[1] < bands[0][1] / _NEAR]
        kurtosis, top = min(x[0] for x in near), min(x[2] for x in near)
        alike = not interval and top < _ALIKE and (1 - _LOUD**top) ** (2 * cycles[k]) < _CHANCE
        if kurtosis < _BETWEEN and 3 - kurtosis > 3 * 3 / np.sqrt(cycles[k]):
            out[k] = (
                f"a machine of unsteady speed: steady amplitude (kurtosis {kurtosis:.2f}, a mode "
                "has 3, a sine 1.5)"
            )
        elif alike:
            out[k] = (
                f"a machine that switches: its loudest moments are alike (peaks {top:.3g} times "
                "the loud level)"
            )
        if out[k]:
            beside = np.abs(f - f[k])
            apart = np.minimum(apart, np.where(beside > width[k], beside - width[k] / 2, np.inf))
    return tuple(out)


def _check_band(history: TimeHistory, frequencies: Sequence[float], width: float) -> None:
    if history.duration * width < 20:
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for {width:g} Hz: "
            f"{20 / width:g} s"
        )
    bad = [f for f in frequencies if not width < f < history.rate / 2 - width]
    if bad or not width > 0:
        raise ConfigError(
            f"frequency {bad[:3]} Hz, width {width:g} Hz: must be in width .. "
            f"{history.rate / 2:g} - width"
        )


def phase_evidence(
    history: TimeHistory, frequencies: Float, damping: Float, machines: Sequence[bool]
) -> tuple[str, ...]:
    """Why a pole belongs to a machine that is known: their phases go together; empty where they do
    not.

    Parameters
    ----------
    history : TimeHistory
        Some of it is looked at (`listened`).
    frequencies : (k,) float64, Hz
    damping : (k,) float64
    machines : sequence of bool
        Which are known to be lines of machines.
    """
    f, known, out = frequencies, np.array(machines, dtype=bool), [""] * frequencies.size
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
    for k, j, p, q in pairs:  # a few poles
        if out[k]:
            continue
        half = min(max(3 * max(damping[k], damping[j]), LINES * step / min(f[k], f[j])), WIDEST)
        count = int(next_fast_len(int(4 * half * max(f[k], f[j]) / step) + 8))
        a, b = (_instants(spectrum, step, float(x), half, count) for x in (f[k], f[j]))
        weight = np.abs(a * b)
        turn = np.exp(1j * (q * np.angle(a) - p * np.angle(b)))
        together = float(np.abs((weight * turn).sum()) / weight.sum())
        told = 2 * half * min(f[k], f[j]) / step
        if together > LEAST_PHASOR and together**2 * told > SURE:
            out[k] = f"a machine: its phase goes with that of the line at {f[j]:.4g} Hz, {p}:{q}"
    return tuple(out)


def _ratio(x: float) -> tuple[int, int] | None:
    """Whole numbers p, q with x = p/q but for a few per cent; None where there are none, or x is
    1.
    """
    pairs: Sequence[tuple[int, int]] = (
        [(p, 1) for p in ORDERS[1:]] + [(1, q) for q in ORDERS[1:]] + [(3, 2), (2, 3)]
    )
    p, q = min(pairs, key=lambda r: abs(x * r[1] / r[0] - 1))
    return (p, q) if abs(x * q / p - 1) < NEAR else None


def _instants(spectrum: Any_, step: float, frequency: float, half: float, count: int) -> Complex:
    """(count,) the one-sided band of a relative half width at instants of the record, of the
    channel loudest there.
    """
    first, last = int(frequency * (1 - half) / step), int(np.ceil(frequency * (1 + half) / step))
    own = spectrum[:, first : last + 1]
    loud = own[int((np.abs(own) ** 2).sum(axis=1).argmax())]
    band = np.zeros((last // count + 1) * count, dtype=np.complex64)
    band[first : first + loud.size] = loud * np.hanning(loud.size)
    return np.asarray(ifft(band.reshape(-1, count).sum(axis=0), norm="forward"))
