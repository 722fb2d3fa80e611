"""Sensors: the geophone's transfer function, its deconvolution where the signal allows, integration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.signals import Channel, Quantity, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.signal.preprocess import detrend
from ringtrue.signal.windows import step

_ORDER: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
_UNIT: dict[str, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
Motion = Literal["displacement", "velocity", "acceleration"]


@dataclass(frozen=True, slots=True)
class Geophone:
    """A moving-coil velocity sensor: H(s) = G s²/(s² + 2ζω₀s + ω₀²), velocity in, signal out.

    Attributes
    ----------
    frequency : float, Hz
        Natural frequency f₀.
    damping : float
        ζ, with its shunt.
    sensitivity : float
        G, signal over velocity far above f₀; 1 if the record is scaled to m/s already.
    """

    frequency: float
    damping: float
    sensitivity: float = 1.0

    def __post_init__(self) -> None:
        if not (self.frequency > 0 and self.damping > 0 and self.sensitivity != 0):
            raise ConfigError(
                f"geophone: frequency {self.frequency} and damping {self.damping} must be > 0, "
                f"sensitivity {self.sensitivity} not 0"
            )

    def response(self, freqs: Float) -> Complex:
        """(f,) complex128 transfer function at `freqs`, Hz."""
        s = 2j * np.pi * np.asarray(freqs, dtype=np.float64)
        w = 2 * np.pi * self.frequency
        return np.asarray(self.sensitivity * s**2 / (s**2 + 2 * self.damping * w * s + w**2))


def lowest_frequency(freqs: Float, signal_psd: Float, noise_psd: Float, *, snr_db: float = 10.0) -> float:
    """The frequency (Hz) from which on every third-octave has the wanted signal-to-noise ratio.

    Third-octaves above the last good one (an anti-alias filter) do not count.

    Parameters
    ----------
    freqs : (f,) Hz
    signal_psd : (f,)
        One-sided density of the recorded signal, noise included, unit²/Hz.
    noise_psd : (f,) or scalar
        Density of the sensor's own noise at its output, same unit.
    snr_db : float
        Of (signal − noise) to noise.

    Raises
    ------
    DataError
        If no frequency has it.
    """
    f = np.asarray(freqs, dtype=np.float64)
    ok = f > 0
    band = np.round(3 * np.log2(f[ok])).astype(np.int64)
    _, where = np.unique(band, return_inverse=True)
    total = np.bincount(where, np.asarray(signal_psd)[ok])
    noise = np.bincount(where, np.broadcast_to(noise_psd, f.shape)[ok])
    good = total > (1 + 10 ** (snr_db / 10)) * noise
    if not good.any():
        peak = float((10 * np.log10(np.maximum(total / noise - 1, 1e-30))).max())
        raise DataError(f"signal over sensor noise is {peak:.3g} dB at most; wanted are {snr_db:.3g} dB")
    top = int(np.flatnonzero(good)[-1])
    below = np.flatnonzero(~good[:top])
    first = int(below[-1]) + 1 if below.size else 0
    return float(f[ok][where == first].min())


def deconvolve(history: TimeHistory, sensor: Geophone, *, low: float, high: float | None = None) -> TimeHistory:
    """Velocity in m/s from geophone signals, between `low` and `high` Hz only.

    The gain is that of 1/H inside the band and falls to 0 at half of `low`; below the natural frequency 1/H grows
    as 1/f², so `low` must stand where the signal is above the sensor's noise: see `lowest_frequency`.
    """
    top = _edge(history, low, high)
    channels = _renamed(history, "velocity", "m/s" if sensor.sensitivity != 1.0 else "")

    def gain(f: Float) -> Complex:
        return np.asarray(1 / sensor.response(np.maximum(f, low / 4)))

    return replace(history, data=_filtered(history, gain, low, top), channels=channels)


def convert(history: TimeHistory, to: Motion, *, low: float, high: float | None = None) -> TimeHistory:
    """Integrate or differentiate to `to` in the frequency domain, between `low` and `high` Hz only.

    Raises
    ------
    DataError
        If the channels are not all of one quantity of motion.
    """
    here = {c.quantity for c in history.channels}
    if len(here) != 1 or not here <= set(_ORDER):
        raise DataError(
            f"{history.source}: quantities {sorted(here)}: must be one of displacement, velocity, acceleration"
        )
    power = _ORDER[to] - _ORDER[here.pop()]
    top = _edge(history, low, high)

    def gain(f: Float) -> Complex:
        return np.asarray((2j * np.pi * np.maximum(f, low / 4)) ** power)

    return replace(history, data=_filtered(history, gain, low, top), channels=_renamed(history, to, _UNIT[to]))


def _edge(history: TimeHistory, low: float, high: float | None) -> float:
    top = history.rate / 2 if high is None else high
    if not 0 < low < top <= history.rate / 2:
        raise ConfigError(f"band {low} .. {top} Hz: must be 0 < low < high <= {history.rate / 2} Hz")
    return top


def _renamed(history: TimeHistory, quantity: Quantity, unit: str) -> tuple[Channel, ...]:
    return tuple(replace(c, quantity=quantity, unit=unit or c.unit) for c in history.channels)


def _filtered(history: TimeHistory, gain: Callable[[Float], Complex], low: float, high: float) -> Float:
    """Signals (ch, sample) through `gain(f)`, with smooth edges from low/2 to low and from high to 1.1 high."""
    samples = history.data.shape[1]
    n = int(next_fast_len(samples + int(4 * history.rate / low), real=True))
    f = rfftfreq(n, 1 / history.rate)
    edge = step(f, low / 2, low) * (step(f, 1.1 * high, high) if high < history.rate / 2 else 1.0)
    spectrum = rfft(detrend(history.data), n, axis=1)
    return np.asarray(irfft(spectrum * (gain(f) * edge), n, axis=1)[:, :samples])
