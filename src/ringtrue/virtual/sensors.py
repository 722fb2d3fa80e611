"""Measuring chains: from the motion at a point to the volts on disk, with noise, drift and mains
hum; signal-to-noise ratio at the resonances.

Response of a modal model to sampled forces, exact at every line of the discrete spectrum.

Spectra here are unnormalised `numpy.fft.rfft` values of band-limited signals: X (row, line), lines
at k·rate/n. A first-order hold would droop by sinc² (12 % at 0.2 of the rate) and bias every
accelerance; the spectrum does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.channels import DERIVATIVE, POWER, UNIT, Motion
from ringtrue.core.modes import ModalModel
from ringtrue.core.signals import Quantity
from ringtrue.errors import InputError

MOTIONS: tuple[Motion, ...] = ("displacement", "velocity", "acceleration")
# lines at a time: the modal coordinates of 130 modes take 1 MB and stay in cache
_CHUNK = 1 << 9


def lines(samples: int, rate: float) -> Float:
    """(line,) frequencies of the discrete spectrum, Hz."""
    return fft.rfftfreq(samples, 1.0 / rate)


def response_spectrum(
    model: ModalModel,
    forces: Complex,
    freqs: Float,
    *,
    quantity: Motion = "acceleration",
) -> Complex:
    """Spectrum of the motion of all outputs.

    Parameters
    ----------
    model : ModalModel
        Residues in receptance form; its `kind` plays no role here.
    forces : (in, line) complex128
        Spectra of the inputs, in the unit of each input (N, m, m/s).
    freqs : (line,) float64, Hz
    quantity : {"displacement", "velocity", "acceleration"}

    Returns
    -------
    (out, line) complex128, unit of the quantity; 0 at 0 Hz.
    """
    if forces.shape != (model.participation.shape[1], freqs.size):
        raise InputError(
            f"forces {forces.shape}: must be (in, line) = "
            f"{(model.participation.shape[1], freqs.size)}"
        )
    if quantity not in DERIVATIVE:
        raise InputError(f"quantity {quantity!r}: allowed are {', '.join(DERIVATIVE)}")
    out = np.empty((model.shapes.shape[0], freqs.size), dtype=np.complex128)
    # bounds the memory of the modal coordinates
    for at in range(0, freqs.size, _CHUNK):
        part = slice(at, at + _CHUNK)
        out[:, part] = _motion(
            model,
            forces[:, part],
            np.asarray(2j * np.pi * freqs[part]),
            DERIVATIVE[quantity],
        )
    return out


def _motion(model: ModalModel, f: Complex, s: Complex, power: int) -> Complex:
    """(out, line) at s = iω.

    With u = Re(l)·f, v = Im(l)·f and s − s_k = S − iω_k, S = s − σ_k, a mode and its conjugate make
    2·[Re(ψ)·(S·u − ω_k·v) − Im(ψ)·(S·v + ω_k·u)]/(S² + ω_k²): real matrices, one division a mode
    and line.
    """
    sigma = model.poles.real[:, None]
    omega = model.poles.imag[:, None]
    u = _real_times(model.participation.real, f)
    v = _real_times(model.participation.imag, f)
    rest = s - sigma
    inverse = 2.0 / (rest * rest + omega**2)
    y = _real_times(model.shapes.real, (rest * u - omega * v) * inverse)
    y -= _real_times(model.shapes.imag, (rest * v + omega * u) * inverse)
    y += model.upper @ f
    if np.any(model.lower):
        y += (model.lower @ f) / np.where(s == 0, np.inf, s**2)
    return y * s**power


def _real_times(a: Float, x: Complex) -> Complex:
    """Product of a real matrix with a complex one, in real arithmetic."""
    x = np.ascontiguousarray(x)
    return (np.ascontiguousarray(a) @ x.view(np.float64)).view(np.complex128)


def simulate(
    model: ModalModel,
    forces: Float,
    rate: float,
    *,
    quantity: Motion = "acceleration",
    tail: float | None = None,
) -> Float:
    """Motion of all outputs under sampled, band-limited forces, from rest.

    Parameters
    ----------
    model : ModalModel
    forces : (in, sample) float64, in the unit of each input
    rate : float, Hz
    quantity : {"displacement", "velocity", "acceleration"}
    tail : float, s, optional
        Zeros appended for the decay, so that nothing wraps round to the start; by default until e⁻⁹
        of the slowest mode. 0 makes the signals periodic: the steady state of a stationary
        excitation.

    Returns
    -------
    (out, sample) float64
    """
    forces = np.asarray(forces, dtype=np.float64)
    n = forces.shape[1]
    pad = decay_time(model) if tail is None else tail
    full = int(fft.next_fast_len(n + int(np.ceil(pad * rate)), real=True))
    full = n if tail == 0 else full
    spectrum = response_spectrum(
        model, np.asarray(fft.rfft(forces, full)), lines(full, rate), quantity=quantity
    )
    return fft.irfft(spectrum, full, overwrite_x=True)[:, :n]


def at_outputs(model: ModalModel, ids: Sequence[str]) -> ModalModel:
    """The model seen at the named outputs only, in the given order."""
    here = {c.id: i for i, c in enumerate(model.outputs)}
    if lost := [c for c in ids if c not in here]:
        raise InputError(
            f"no output {' '.join(lost[:8])} in the modal model; there are "
            f"{' '.join(list(here)[:40])}"
        )
    at = [here[c] for c in ids]
    return replace(
        model,
        shapes=model.shapes[at],
        lower=model.lower[at],
        upper=model.upper[at],
        outputs=tuple(model.outputs[i] for i in at),
    )


def decay_time(model: ModalModel, nepers: float = 9.0) -> float:
    """Time in which the slowest mode decays by e^-nepers, s."""
    return float(nepers / np.abs(model.poles.real).min())


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
        return np.where(freqs > 0, self.density**2 * (1 + self.corner / safe), 0.0)


def coloured(
    psd: Float, samples: int, rate: float, rng: np.random.Generator
) -> Complex:
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
    return normal


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
    return 2.0 / (rate * samples) * (spectrum.real**2 + spectrum.imag**2)


def tone(
    freq: float, amplitude: Float, phase: Float, samples: int, rate: float
) -> Complex:
    """Spectra (row, line) of amplitude·cos(2πft + phase), f moved to the nearest line."""
    out = np.zeros((amplitude.size, samples // 2 + 1), dtype=np.complex128)
    line = round(freq * samples / rate)
    if 0 < line < out.shape[1]:
        out[:, line] = 0.5 * samples * amplitude * np.exp(1j * phase)
    return out


def hum(
    amplitude: Float, samples: int, rate: float, rng: np.random.Generator
) -> Complex:
    """Mains hum and its third harmonic (30 %); lines above half the rate are filtered away.

    Returns
    -------
    (row, 2) complex128
        Spectra at the lines `hum_lines`, 0 where there is no such line.
    """
    at = hum_lines(samples, rate)
    phase = rng.uniform(0, 2 * np.pi, (amplitude.size, 2))
    return np.asarray(
        0.5 * samples * amplitude[:, None] * [1.0, 0.3] * np.exp(1j * phase) * (at > 0)
    )


def hum_lines(samples: int, rate: float) -> Int:
    """(2,) lines nearest to the mains, 50 Hz, and its third harmonic; 0 where beyond half the
    rate.
    """
    at = np.round(np.array([50.0, 150.0]) * samples / rate).astype(np.int64)
    return np.where(at < samples // 2, at, 0)


def anti_alias(freqs: Float, rate: float) -> Float:
    """(line,) gain of the recorder's filter: flat to 0.4 of the rate, cosine to 0 at half of
    it.
    """
    x = np.clip((freqs / rate - 0.4) / 0.1, 0.0, 1.0)
    return 0.5 * (1 + np.cos(np.pi * x))


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor and its recorder channel.

    Attributes
    ----------
    name : str
        Type.
    quantity : str
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

    @property
    def unit(self) -> str:
        """SI."""
        return UNIT[self.quantity]

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
        raise InputError(
            f"{self.name} measures {self.quantity}; allowed are {', '.join(MOTIONS)}"
        )

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
    name="force-balance accelerometer",
    quantity="acceleration",
    sensitivity=1.02,
    range=2.5,
    floor=NoiseFloor(0.1 * _UG, 1.0),
)
GEOPHONE = Sensor(
    name="geophone 4.5 Hz",
    quantity="velocity",
    sensitivity=28.8,
    range=1.0,
    floor=NoiseFloor(5e-9, 1.0),
    corner=4.5,
    damping=0.56,
    hum=3e-6,
    drift=2e-4,
)
ICP = Sensor(
    name="ICP accelerometer",
    quantity="acceleration",
    sensitivity=0.0102,
    range=0.5,
    floor=NoiseFloor(3 * _UG, 5.0),
    corner=0.25,
    damping=0.9,
    hum=1e-6,
)
FORCE_CELL = Sensor(
    name="force cell",
    quantity="force",
    sensitivity=2.3e-4,
    range=5.0,
    floor=NoiseFloor(0.02, 5.0),
    corner=0.01,
    damping=0.9,
    hum=1e-5,
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

    def digitise(self, volts: Float, rate: float) -> Any_:
        """Offset, drift, clipping at the range and rounding to the converter's step.

        Parameters
        ----------
        volts : (channel, sample) float64, overwritten
        rate : float, Hz

        Returns
        -------
        (channel, sample) float32, V
        """
        seconds = np.arange(volts.shape[1]) / rate
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


def resonance_power(
    spectrum: Complex, poles: Complex, samples: int, rate: float
) -> Float:
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
        [
            np.zeros((spectrum.shape[0], 1)),
            np.cumsum(power(spectrum, samples, rate), axis=1),
        ],
        axis=1,
    )
    f = np.abs(poles) / (2 * np.pi)
    half = np.abs(poles.real) / (2 * np.pi)
    low = (
        np.floor((f - half) * samples / rate)
        .astype(np.int64)
        .clip(1, spectrum.shape[1] - 1)
    )
    high = (np.ceil((f + half) * samples / rate).astype(np.int64) + 1).clip(
        low + 1, spectrum.shape[1]
    )
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def in_band(poles: Complex, low: float, high: float) -> Complex:
    """The poles between two frequencies, Hz."""
    f = np.abs(poles) / (2 * np.pi)
    return poles[(f >= low) & (f <= high)]


def ratio_db(signal: Float, noise: Float) -> Float:
    """10·lg(signal/noise), dB."""
    tiny = np.finfo(np.float64).tiny
    return 10 * np.log10(np.maximum(signal, tiny) / np.maximum(noise, tiny))


def expected_power(
    model: ModalModel, poles: Complex, input_psd: Float, quantity: Motion
) -> Float:
    """(out, m) spectral density at the resonances, inputs uncorrelated with `input_psd` (in, m)
    there.
    """
    f = np.abs(poles) / (2 * np.pi)
    power_of_s = DERIVATIVE[quantity] - POWER[model.kind]
    h = np.moveaxis(model.synthesise(f), 0, -1)  # (out, in, m)
    return np.asarray(
        np.einsum("oim,im->om", np.abs(h) ** 2, input_psd)
        * (2 * np.pi * f) ** (2 * power_of_s)
    )
