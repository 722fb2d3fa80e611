"""Sines of machines and mains: told from modes by their statistics, tracked, taken out by orders or
by cepstrum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.signal.listened import LONGEST, listened_spectrum
from ringtrue.signal.preprocess import detrend
from ringtrue.signal.windows import step

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


def steady_amplitudes(
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
    spectrum, n = listened_spectrum(history)
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


def phase_of_speed(speed: ArrayLike, rate: float) -> Float:
    """(sample,) cycles turned, from the speed (sample,) in Hz at each sample, by the trapezoidal
    rule.
    """
    v = np.asarray(speed, dtype=np.float64)
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) / rate])


def phase_of_pulses(times: ArrayLike, samples: int, rate: float, *, per_turn: int = 1) -> Float:
    """(sample,) cycles turned, from the times (s, rising) of the pulses of a tachometer.

    Raises
    ------
    DataError
        If the times do not rise.
    """
    t = np.asarray(times, dtype=np.float64)
    if t.size < 3 or not (np.diff(t) > 0).all():
        raise DataError(
            f"tachometer: {t.size} pulses; there must be 3 or more, and their times must rise"
        )
    at = np.arange(samples) / rate
    turned = np.interp(at, t, np.arange(t.size) / per_turn)
    before, after = 1 / (t[1] - t[0]), 1 / (t[-1] - t[-2])
    turned = np.where(at < t[0], (at - t[0]) * before / per_turn, turned)
    return np.asarray(
        np.where(at > t[-1], ((t.size - 1) + (at - t[-1]) * after) / per_turn, turned)
    )


def track_order(data: Any_, phase: Float, order: float, rate: float, bandwidth: float) -> Complex:
    """(ch, sample) complex amplitude A(t) of A cos(2π order phase): demodulated, low-passed to
    `bandwidth` Hz.

    The ends are mirrored for `2 / bandwidth` seconds.
    """
    samples = data.shape[1]
    turn = np.exp(-2j * np.pi * order * phase)
    edge = min(samples - 1, int(2 * rate / bandwidth))
    z = np.pad(detrend(data) * turn, ((0, 0), (edge, edge)), mode="reflect")
    n = int(next_fast_len(z.shape[1]))
    f = np.abs(np.fft.fftfreq(n, 1 / rate))
    low = step(f, bandwidth, 0.5 * bandwidth)
    return np.asarray(2 * ifft(fft(z, n, axis=1) * low, axis=1)[:, edge : edge + samples])


def remove_orders(
    history: TimeHistory, phase: Float, orders: Sequence[float], bandwidth: float
) -> tuple[TimeHistory, Float]:
    """The record without the orders of a machine, and the rms (order, ch) of what was taken out.

    Each order is tracked within ±`bandwidth` Hz of its momentary frequency; a mode there loses its
    response too, so the band must be narrower than the half-power band of any mode that it may
    cross.

    Parameters
    ----------
    history : TimeHistory
    phase : (sample,) float64
        Cycles turned, see `phase_of_speed` and `phase_of_pulses`.
    orders : sequence of float
    bandwidth : float, Hz

    Raises
    ------
    DataError
        If the phase has another length, or the record is shorter than four times 1/bandwidth.
    """
    phase = np.asarray(phase, dtype=np.float64)
    if phase.shape != (history.data.shape[1],):
        raise DataError(f"phase {phase.shape} must be given at all {history.data.shape[1]} samples")
    if not (bandwidth > 0 and history.duration * bandwidth >= 4):
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for a bandwidth of "
            f"{bandwidth:g} Hz"
        )
    data = np.array(history.data, dtype=np.float64)
    rms = np.zeros((len(orders), data.shape[0]))
    for k, order in enumerate(
        orders
    ):  # each from what is left, so that close orders are not taken twice
        amplitude = track_order(data, phase, order, history.rate, bandwidth)
        wave = (amplitude * np.exp(2j * np.pi * order * phase)).real
        rms[k] = np.sqrt((wave**2).mean(axis=1))
        data -= wave
    return replace(history, data=data), rms


def refine_frequency(history: TimeHistory, frequency: float, width: float) -> float:
    """The frequency (Hz) of a steady line near `frequency`, from the turning of its phase over the
    record.
    """
    t = np.arange(history.data.shape[1]) / history.rate
    z = track_order(history.data, frequency * t, 1.0, history.rate, width)
    lag = max(1, round(history.rate / (4 * width)))
    for _ in range(3):  # longer lags are more exact but ambiguous: each step is ready for the next
        turn = np.angle((z[:, lag:] * z[:, :-lag].conj()).sum()) * history.rate / (2 * np.pi * lag)
        frequency += float(turn)
        z = z * np.exp(-2j * np.pi * turn * t)
        lag = min(lag * 16, z.shape[1] // 2)
    return frequency


def remove_lines(
    history: TimeHistory, frequencies: Sequence[float], bandwidth: float
) -> tuple[TimeHistory, tuple[float, ...]]:
    """The record without steady lines (mains hum), and their refined frequencies, Hz.

    Each line is looked for within ±2 `bandwidth` of the frequency given, and removed within
    ±`bandwidth`.
    """
    exact = []
    for f in frequencies:
        exact.append(refine_frequency(history, f, 4 * bandwidth))
        t = np.arange(history.data.shape[1]) / history.rate
        history, _ = remove_orders(history, exact[-1] * t, [1.0], bandwidth)
    return history, tuple(exact)


def edit_cepstrum(history: TimeHistory, frequency: float, *, width: int = 2) -> TimeHistory:
    """The record without the family of harmonics of `frequency` Hz, by a comb on the real cepstrum.

    The rahmonics k/frequency are set to 0, ±`width` samples; the amplitude that is left is put back
    on the phase of the record. For families of many harmonics at constant speed. Source: Randall,
    Antoni, Smith (2019), A survey of the application of the cepstrum to structural modal analysis.

    Raises
    ------
    ConfigError
        If the quefrency 1/frequency is not well above `width` samples and below half of the record.
    """
    samples = history.data.shape[1]
    n = int(next_fast_len(samples, real=True))
    period = history.rate / frequency if frequency > 0 else 0.0
    if not 4 * width < period < n / 4:
        raise ConfigError(
            f"cepstrum: a period of {period:g} samples must be in {4 * width} .. {n // 4}"
        )
    mean = history.data.mean(axis=1, keepdims=True, dtype=np.float64)
    spectrum = rfft(history.data - mean, n, axis=1)
    size = np.abs(spectrum)
    size = np.maximum(size, 1e-12 * size.max(axis=1, keepdims=True))
    cepstrum = irfft(np.log(size), n, axis=1)
    centre = np.round(np.arange(period, n / 2, period)).astype(np.int64)
    at = np.unique((centre[:, None] + np.arange(-width, width + 1)).ravel())
    at = at[at <= n // 2]
    cepstrum[:, at] = 0.0
    cepstrum[:, n - at[at > 0]] = 0.0
    left = np.exp(rfft(cepstrum, axis=1).real)
    data = irfft(spectrum / size * left, n, axis=1)[:, :samples]
    return replace(history, data=data + mean)


def without_machines(
    history: TimeHistory, frequencies: Sequence[float], method: str = "lines"
) -> tuple[TimeHistory, tuple[str, ...]]:
    """The record without the lines of machines at steady speed, and what was done.

    Parameters
    ----------
    history : TimeHistory
    frequencies : sequence of float, Hz
        As `ringtrue.signal.preprocess.harmonics` lists them.
    method : {"lines", "cepstrum"}
        Each line by itself, tracked within 20 resolutions of the record; or a comb on the cepstrum
        for each family of harmonics with three members or more, and lines for the rest.

    Raises
    ------
    ConfigError
        If the method is another one.
    """
    if method not in ("lines", "cepstrum"):
        raise ConfigError(
            f"removal of harmonics {method!r}{did_you_mean(method, ('lines', 'cepstrum'))}"
        )
    left = sorted(float(f) for f in frequencies)
    said: list[str] = []
    for base in families(left, 4 * 61 / history.duration) if method == "cepstrum" else ():
        exact = refine_frequency(history, base, 80 / history.duration)
        history = edit_cepstrum(history, exact)
        left = [f for f in left if abs(f - round(f / base) * base) > 4 * 61 / history.duration]
        said.append(f"harmonics of {exact:.5g} Hz taken out by cepstrum")
    if left:
        history, steady = remove_lines(history, left, 20 / history.duration)
        said += [f"line at {f:.6g} Hz taken out" for f in steady]
    return history, tuple(said)


def families(frequencies: Sequence[float], tolerance: float) -> tuple[float, ...]:
    """Base frequencies (Hz) that three or more of the rising `frequencies` are multiples of, within
    `tolerance` Hz.
    """
    left = np.array(sorted(frequencies))
    out = []
    for base in left.tolist():  # a few lines
        multiple = np.round(left / base)
        own = (multiple >= 1) & (np.abs(left - multiple * base) < tolerance)
        if own.sum() >= 3:
            out.append(base)
            left = left[~own]
    return tuple(out)
