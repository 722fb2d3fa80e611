"""Measuring chains: from the motion at a point to the volts on disk, with noise, drift and mains
hum; signal-to-noise ratio at the resonances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.core.motions import DERIVATIVE, POWER, Motion
from ringtrue.core.signals import Quantity
from ringtrue.errors import InputError
from ringtrue.virtual.response import MOTIONS, lines


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Self-noise with a 1/f part: S(f) = density²·(1 + corner/f).

    Attributes
    ----------
    density : float, unit/√Hz
        Far above the corner.
    corner : float, Hz
    """

    density: float
    corner: float

    def psd(self, freqs: Float) -> Float:
        """(line,) one-sided spectral density, unit²/Hz; 0 at 0 Hz, where an offset stands
        instead.
        """
        safe = np.where(freqs > 0, freqs, np.inf)
        return np.asarray(np.where(freqs > 0, self.density**2 * (1 + self.corner / safe), 0.0))


def coloured(psd: Float, samples: int, rate: float, rng: np.random.Generator) -> Complex:
    """Spectra of Gaussian noise, periodic over the record.

    Parameters
    ----------
    psd : (row, line) float64
        One-sided spectral densities at the lines of the record, unit²/Hz.
    samples : int
    rate : float, Hz

    Returns
    -------
    (row, line) complex128
    """
    normal = rng.standard_normal((*psd.shape, 2)).view(np.complex128)[..., 0]
    normal *= np.sqrt(0.25 * rate * samples * psd)
    return np.asarray(normal)


def white(
    count: int, density: float, samples: int, rate: float, rng: np.random.Generator
) -> Complex:
    """Spectra (count, line) of independent white noise of a density, unit/√Hz, without an offset:
    as of `coloured`.
    """
    psd = np.full((count, samples // 2 + 1), density**2)
    psd[:, 0] = 0.0
    return coloured(psd, samples, rate, rng)


def power(spectrum: Complex, samples: int, rate: float) -> Float:
    """Periodogram (row, line) of a spectrum, one-sided, unit²/Hz."""
    return np.asarray(2.0 / (rate * samples) * (spectrum.real**2 + spectrum.imag**2))


def tone(freq: float, amplitude: Float, phase: Float, samples: int, rate: float) -> Complex:
    """Spectra (row, line) of amplitude·cos(2πft + phase), f moved to the nearest line."""
    out = np.zeros((amplitude.size, samples // 2 + 1), dtype=np.complex128)
    line = round(freq * samples / rate)
    if 0 < line < out.shape[1]:
        out[:, line] = 0.5 * samples * amplitude * np.exp(1j * phase)
    return out


def hum(
    amplitude: Float, samples: int, rate: float, rng: np.random.Generator, mains: float = 50.0
) -> Complex:
    """Mains hum and its third harmonic (30 %); lines above half the rate are filtered away.

    Returns
    -------
    (row, 2) complex128
        Spectra at the lines `hum_lines`, 0 where there is no such line.
    """
    at = hum_lines(samples, rate, mains)
    phase = rng.uniform(0, 2 * np.pi, (amplitude.size, 2))
    return np.asarray(
        0.5 * samples * amplitude[:, None] * [1.0, 0.3] * np.exp(1j * phase) * (at > 0)
    )


def hum_lines(samples: int, rate: float, mains: float = 50.0) -> Int:
    """(2,) lines nearest to the mains frequency and its third harmonic; 0 where beyond half the
    rate.
    """
    at = np.round(np.array([1, 3]) * mains * samples / rate).astype(np.int64)
    return np.asarray(np.where(at < samples // 2, at, 0))


def anti_alias(freqs: Float, rate: float, start: float = 0.4) -> Float:
    """(line,) gain of the recorder's filter: flat to `start` of the rate, cosine to 0 at half of
    it.
    """
    x = np.clip((freqs / rate - start) / (0.5 - start), 0.0, 1.0)
    return np.asarray(0.5 * (1 + np.cos(np.pi * x)))


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor and its recorder channel.

    Attributes
    ----------
    name : str
        Type.
    quantity, unit : str
        SI.
    sensitivity : float, V per unit
        On the calibration sheet.
    range : float, V
        Full scale of the recorder channel, ±.
    floor : NoiseFloor
        In the unit of the quantity.
    corner, damping : float, Hz, -
        Second-order high pass; 0 Hz for a sensor that reaches 0 Hz.
    calibration : float
        Largest error of the sheet's sensitivity, relative.
    hum : float, V
        Typical amplitude of mains pick-up.
    drift, offset : float, V
        Largest drift over an hour, and zero offset.
    bits : int
    """

    name: str
    quantity: Quantity
    unit: str
    sensitivity: float
    range: float
    floor: NoiseFloor
    corner: float = 0.0
    damping: float = 0.7
    calibration: float = 0.01
    hum: float = 2e-6
    drift: float = 1e-3
    offset: float = 5e-3
    bits: int = 24

    def transfer(self, freqs: Float) -> Complex:
        """(line,) complex128, output over sensitivity: s²/(s² + 2ζω₀s + ω₀²), or 1."""
        if self.corner == 0:
            return np.ones(freqs.size, dtype=np.complex128)
        r = 1j * freqs / self.corner
        return np.asarray(r**2 / (r**2 + 2 * self.damping * r + 1))

    @property
    def motion(self) -> Motion:
        """The quantity as a motion.

        Raises
        ------
        InputError
            If the sensor does not measure one.
        """
        for name in MOTIONS:
            if name == self.quantity:
                return name
        raise InputError(f"{self.name} measures {self.quantity}; allowed are {', '.join(MOTIONS)}")

    @property
    def step(self) -> float:
        """One unit of the converter, V."""
        return float(2.0 * self.range / 2**self.bits)

    def noise_psd(self, freqs: Float, rate: float) -> Float:
        """Self-noise and quantisation referred to the unit before the high pass, one-sided,
        unit²/Hz.
        """
        quantisation = self.step**2 / 6.0 / rate / self.sensitivity**2
        return np.asarray(
            (self.floor.psd(freqs) + quantisation)
            / np.maximum(np.abs(self.transfer(freqs)), 1e-9) ** 2
        )


_UG = 9.80665e-6  # m/s² per µg
ACCELEROMETER = Sensor(
    "force-balance accelerometer", "acceleration", "m/s^2", 1.02, 2.5, NoiseFloor(0.1 * _UG, 1.0)
)
GEOPHONE = Sensor(
    "geophone 4.5 Hz",
    "velocity",
    "m/s",
    28.8,
    1.0,
    NoiseFloor(5e-9, 1.0),
    4.5,
    0.56,
    hum=3e-6,
    drift=2e-4,
)
ICP = Sensor(
    "ICP accelerometer",
    "acceleration",
    "m/s^2",
    0.0102,
    0.5,
    NoiseFloor(3 * _UG, 5.0),
    0.25,
    0.9,
    hum=1e-6,
)
FORCE_CELL = Sensor(
    "force cell", "force", "N", 2.3e-4, 5.0, NoiseFloor(0.02, 5.0), 0.01, 0.9, hum=1e-5
)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The sensors of one record with what the crew does not know of them.

    Attributes
    ----------
    sensors : tuple of Sensor
    true_sensitivity, offset, drift, hum : (channel,) float64, V per unit, V, V/s, V
    """

    sensors: tuple[Sensor, ...]
    true_sensitivity: Float
    offset: Float
    drift: Float
    hum: Float

    @classmethod
    def draw(cls, sensors: tuple[Sensor, ...], rng: np.random.Generator) -> Chain:
        """A particular set of sensors."""

        def column(name: str) -> Float:
            return np.array([getattr(s, name) for s in sensors], dtype=np.float64)

        error = np.clip(rng.normal(0, 0.4, len(sensors)), -1, 1) * column("calibration")
        offset = rng.uniform(-1, 1, len(sensors)) * column("offset")
        drift = rng.uniform(-1, 1, len(sensors)) * column("drift") / 3600
        pickup = column("hum") * rng.lognormal(0, 0.5, len(sensors))
        return cls(sensors, column("sensitivity") * (1 + error), offset, drift, pickup)

    def to_volts(self, motion: Complex, rate: float) -> None:
        """Turn motions into volts behind the recorder's filter, in place.

        Parameters
        ----------
        motion : (channel, line) complex128
            Spectra of an even number of samples, in the unit of each sensor.
        rate : float, Hz
        """
        freqs = lines(2 * motion.shape[1] - 2, rate)
        kinds, which = _kinds(self.sensors)
        for k, sensor in enumerate(kinds):  # one or two types
            gain = sensor.transfer(freqs) * anti_alias(freqs, rate)
            np.multiply(motion, gain, out=motion, where=(which == k)[:, None])
        motion *= self.true_sensitivity[:, None]

    def noise(self, samples: int, rate: float, rng: np.random.Generator) -> Complex:
        """(channel, line) spectra of self-noise and hum, V, recorder filter included."""
        freqs = lines(samples, rate)
        kinds, which = _kinds(self.sensors)
        psd = np.stack([s.floor.psd(freqs) * s.sensitivity**2 for s in kinds])[which]
        out = coloured(psd, samples, rate, rng)
        out[:, hum_lines(samples, rate)] += hum(self.hum, samples, rate, rng)
        out *= anti_alias(freqs, rate)
        return out

    def digitise(self, volts: Float, rate: float, *, start: int = 0) -> Any_:
        """Offset, drift, clipping at the range and rounding to the converter's step.

        Parameters
        ----------
        volts : (channel, sample) float64, overwritten
        rate : float, Hz
        start : int
            Number of the first sample.

        Returns
        -------
        (channel, sample) float32, V
        """
        seconds = (start + np.arange(volts.shape[1])) / rate
        full = np.array([s.range for s in self.sensors])[:, None]
        step = np.array([s.step for s in self.sensors])[:, None]
        volts += self.offset[:, None] + self.drift[:, None] * seconds
        np.clip(volts, -full, full - step, out=volts)
        volts /= step
        np.rint(volts, out=volts)
        volts *= step
        return volts.astype(np.float32)


def record_volts(
    motion: Complex, chain: Chain, samples: int, rate: float, rng: np.random.Generator
) -> tuple[Any_, Complex]:
    """Volts on disk from the spectra at the sensors.

    Parameters
    ----------
    motion : (channel, line) complex128
        In the unit of each sensor; overwritten by its volts.
    chain : Chain

    Returns
    -------
    volts : (channel, sample) float32
    noise : (channel, line) complex128, V
        Its noise part.
    """
    if motion.shape[0] != len(chain.sensors):
        raise InputError(f"{motion.shape[0]} motions for {len(chain.sensors)} sensors")
    chain.to_volts(motion, rate)
    noise = chain.noise(samples, rate, rng)
    return chain.digitise(
        np.asarray(fft.irfft(motion + noise, samples, overwrite_x=True)), rate
    ), noise


def _kinds(sensors: tuple[Sensor, ...]) -> tuple[list[Sensor], Int]:
    kinds = list(dict.fromkeys(sensors))
    here = {s: i for i, s in enumerate(kinds)}
    return kinds, np.array([here[s] for s in sensors])


def resonance_power(spectrum: Complex, poles: Complex, samples: int, rate: float) -> Float:
    """Mean spectral density within the half-power band of each mode.

    Parameters
    ----------
    spectrum : (channel, line) complex128
    poles : (m,) complex128, rad/s

    Returns
    -------
    (channel, m) float64, unit²/Hz
    """
    total = np.concatenate(
        [np.zeros((spectrum.shape[0], 1)), np.cumsum(power(spectrum, samples, rate), axis=1)],
        axis=1,
    )
    f, half = np.abs(poles) / (2 * np.pi), np.abs(poles.real) / (2 * np.pi)
    low = np.floor((f - half) * samples / rate).astype(np.int64).clip(1, spectrum.shape[1] - 1)
    high = (np.ceil((f + half) * samples / rate).astype(np.int64) + 1).clip(
        low + 1, spectrum.shape[1]
    )
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def in_band(poles: Complex, low: float, high: float) -> Complex:
    """The poles between two frequencies, Hz."""
    f = np.abs(poles) / (2 * np.pi)
    return np.asarray(poles[(f >= low) & (f <= high)])


def ratio_db(signal: Float, noise: Float) -> Float:
    """10·lg(signal/noise), dB."""
    tiny = np.finfo(np.float64).tiny
    return np.asarray(10 * np.log10(np.maximum(signal, tiny) / np.maximum(noise, tiny)))


def expected_power(model: ModalModel, poles: Complex, input_psd: Float, quantity: Motion) -> Float:
    """(out, m) spectral density at the resonances, inputs uncorrelated with `input_psd` (in, m)
    there.
    """
    f = np.abs(poles) / (2 * np.pi)
    power_of_s = DERIVATIVE[quantity] - POWER[model.kind]
    h = np.moveaxis(model.synthesise(f), 0, -1)  # (out, in, m)
    return np.asarray(
        np.einsum("oim,im->om", np.abs(h) ** 2, input_psd) * (2 * np.pi * f) ** (2 * power_of_s)
    )
