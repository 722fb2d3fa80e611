"""Transfer functions of geophones, accelerometers and calibration sheets, their deconvolution;
integration of motions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ringtrue.core.arrays import Complex, Float, freeze_fields
from ringtrue.core.motions import DERIVATIVE, SI_UNIT, Motion
from ringtrue.core.signals import Channel, Quantity, TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.signal.decimation import detrend
from ringtrue.signal.spectra import step


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


@dataclass(frozen=True, slots=True)
class Accelerometer:
    """A piezoelectric accelerometer: G · sτ/(1 + sτ) · ω₀²/(s² + 2ζω₀s + ω₀²), acceleration in,
    signal out.

    Attributes
    ----------
    time_constant : float, s
        τ of the coupling; its corner is 1/(2πτ). inf for a sensor down to 0 Hz.
    resonance : float, Hz
        Mounted resonance; inf where it is far above the band.
    damping : float
        ζ of the resonance.
    sensitivity : float
        G; 1 if the record is scaled to m/s² already.
    """

    time_constant: float = float("inf")
    resonance: float = float("inf")
    damping: float = 0.02
    sensitivity: float = 1.0

    def __post_init__(self) -> None:
        if not (
            self.time_constant > 0
            and self.resonance > 0
            and self.damping > 0
            and self.sensitivity != 0
        ):
            raise ConfigError(
                f"accelerometer: time constant {self.time_constant}, resonance {self.resonance} "
                "and damping "
                f"{self.damping} must be > 0, sensitivity {self.sensitivity} not 0"
            )

    def response(self, freqs: Float) -> Complex:
        """(f,) complex128 transfer function at `freqs`, Hz."""
        s = 2j * np.pi * np.asarray(freqs, dtype=np.float64)
        tau = self.time_constant
        coupling = s * tau / (1 + s * tau) if np.isfinite(tau) else 1.0
        x = s / (2 * np.pi * self.resonance)  # 0 without a resonance
        return np.asarray(self.sensitivity * coupling / (x**2 + 2 * self.damping * x + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A sensor by its sheet: gain and phase at some frequencies, between them linear over the
    logarithm of frequency.

    Attributes
    ----------
    freqs : (f,) float64, Hz, rising, > 0
    gain : (f,) float64
        Signal over motion; constant beyond the ends.
    phase : (f,) float64, degrees
    quantity : {"displacement", "velocity", "acceleration"}
    """

    freqs: Float
    gain: Float
    phase: Float
    quantity: Motion = "acceleration"

    def __post_init__(self) -> None:
        freeze_fields(self, freqs=np.float64, gain=np.float64, phase=np.float64)
        ok = (
            self.freqs.ndim == 1
            and self.freqs.shape == self.gain.shape == self.phase.shape
            and self.freqs.size > 1
        )
        if not (
            ok and self.freqs[0] > 0 and (np.diff(self.freqs) > 0).all() and (self.gain > 0).all()
        ):
            raise ConfigError(
                "calibration: frequencies must rise from above 0, with a positive gain and a "
                "phase at each"
            )

    def response(self, freqs: Float) -> Complex:
        """(f,) complex128 transfer function at `freqs`, Hz."""
        at, x = np.log(np.maximum(freqs, self.freqs[0] * 1e-3)), np.log(self.freqs)
        gain = np.exp(np.interp(at, x, np.log(self.gain)))
        return np.asarray(gain * np.exp(1j * np.interp(at, x, np.unwrap(np.radians(self.phase)))))


Sensor = Geophone | Accelerometer | Calibration


def usable_band(
    sensor: Sensor, rate: float, *, smallest: float = 0.1, largest: float = 10.0
) -> tuple[float, float]:
    """The band (Hz) around its middle where |H| is between `smallest` and `largest` times its
    median: to deconvolve in.

    Raises
    ------
    ConfigError
        If there is none below half of the rate.
    """
    f = np.geomspace(rate * 1e-6, rate / 2, 4000)
    size = np.abs(sensor.response(f))
    above = f > rate / 1000
    ratio = size / float(np.median(size[above]))
    bad = np.flatnonzero((ratio < smallest) | (ratio > largest))
    middle = int(np.argmin(np.abs(np.log(np.maximum(ratio, 1e-300)))))
    low = int(bad[bad < middle][-1]) + 1 if (bad < middle).any() else 0
    high = int(bad[bad > middle][0]) - 1 if (bad > middle).any() else f.size - 1
    if not f[low] < f[high]:
        raise ConfigError(f"the sensor has no usable band below {rate / 2:g} Hz")
    return float(f[low]), float(f[high])


def lowest_frequency(
    freqs: Float, signal_psd: Float, noise_psd: Float, *, snr_db: float = 10.0
) -> float:
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
        raise DataError(
            f"signal over sensor noise is {peak:.3g} dB at most; wanted are {snr_db:.3g} dB"
        )
    top = int(np.flatnonzero(good)[-1])
    below = np.flatnonzero(~good[:top])
    first = int(below[-1]) + 1 if below.size else 0
    return float(f[ok][where == first].min())


def deconvolve(
    history: TimeHistory, sensor: Sensor, *, low: float, high: float | None = None
) -> TimeHistory:
    """The motion (SI) from the signals of a sensor, between `low` and `high` Hz only.

    The gain is that of 1/H inside the band and falls to 0 at half of `low`; where H is small, below
    the natural frequency of a geophone as f², 1/H raises the noise: `low` must stand where the
    signal is above it, see `lowest_frequency` and `usable_band`.
    """
    top = _edge(history, low, high)
    quantity: Motion = "velocity"
    if not isinstance(sensor, Geophone):
        quantity = "acceleration" if isinstance(sensor, Accelerometer) else sensor.quantity
    scaled = isinstance(sensor, Calibration) or sensor.sensitivity != 1.0
    channels = _renamed(history, quantity, SI_UNIT[quantity] if scaled else "")

    def gain(f: Float) -> Complex:
        return np.asarray(1 / sensor.response(np.maximum(f, low / 4)))

    return replace(history, data=_filtered(history, gain, low, top), channels=channels)


def convert(
    history: TimeHistory, to: Motion, *, low: float, high: float | None = None
) -> TimeHistory:
    """Integrate or differentiate to `to` in the frequency domain, between `low` and `high` Hz only.

    Raises
    ------
    DataError
        If the channels are not all of one quantity of motion.
    """
    here = {c.quantity for c in history.channels}
    if len(here) != 1 or not here <= set(DERIVATIVE):
        raise DataError(
            f"{history.source}: quantities {sorted(here)}: must be one of displacement, "
            "velocity, acceleration"
        )
    power = DERIVATIVE[to] - DERIVATIVE[here.pop()]
    top = _edge(history, low, high)

    def gain(f: Float) -> Complex:
        return np.asarray((2j * np.pi * np.maximum(f, low / 4)) ** power)

    return replace(
        history,
        data=_filtered(history, gain, low, top),
        channels=_renamed(history, to, SI_UNIT[to]),
    )


def _edge(history: TimeHistory, low: float, high: float | None) -> float:
    top = history.rate / 2 if high is None else high
    if not 0 < low < top <= history.rate / 2:
        raise ConfigError(
            f"band {low} .. {top} Hz: must be 0 < low < high <= {history.rate / 2} Hz"
        )
    return top


def _renamed(history: TimeHistory, quantity: Quantity, unit: str) -> tuple[Channel, ...]:
    return tuple(replace(c, quantity=quantity, unit=unit or c.unit) for c in history.channels)


def _filtered(
    history: TimeHistory, gain: Callable[[Float], Complex], low: float, high: float
) -> Float:
    """Signals (ch, sample) through `gain(f)`, with smooth edges from low/2 to low and from high to
    1.1 high.
    """
    samples = history.data.shape[1]
    n = int(next_fast_len(samples + int(4 * history.rate / low), real=True))
    f = rfftfreq(n, 1 / history.rate)
    edge = step(f, low / 2, low) * (step(f, 1.1 * high, high) if high < history.rate / 2 else 1.0)
    spectrum = rfft(detrend(history.data), n, axis=1)
    return np.asarray(irfft(spectrum * (gain(f) * edge), n, axis=1)[:, :samples])
