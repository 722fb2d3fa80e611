"""Orders of a machine, tracked and taken out; families of harmonics taken out by cepstrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.signal.decimation import detrend
from ringtrue.signal.spectra import step


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


def remove_tracked_lines(
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


def remove_harmonics(
    history: TimeHistory, frequencies: Sequence[float], method: str = "lines"
) -> tuple[TimeHistory, tuple[str, ...]]:
    """The record without the lines of machines at steady speed, and what was done.

    Parameters
    ----------
    history : TimeHistory
    frequencies : sequence of float, Hz
        As `ringtrue.signal.tonal_lines.harmonics` lists them.
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
        history, steady = remove_tracked_lines(history, left, 20 / history.duration)
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
