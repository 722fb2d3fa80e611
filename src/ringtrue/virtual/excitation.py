"""Forces on a structure: ground motion, small forces, one rotating machine; impacts, a dropped
weight and jumping people as half-sine pulses with a known impulse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy import fft
from scipy.constants import g

from ringtrue.core.arrays import Bool, Complex, Float, Int, freeze_arrays
from ringtrue.errors import InputError
from ringtrue.virtual.sensors import coloured, lines

# where the shape of the ground spectrum is normalised, Hz
_GRID = np.geomspace(0.01, 200.0, 4000)


@dataclass(frozen=True, slots=True)
class Ambient:
    """What shakes the structure all the time.

    Attributes
    ----------
    ground_rms : float, m/s
        Vertical ground velocity, 0.01 to 200 Hz.
    lateral : float
        Lateral over vertical.
    correlation : float
        Share of the amplitude common to the three components, 0..1.
    force_density : float, N/√Hz
        Air pressure and machinery at each point that carries such a force, above `force_corner`;
        below it the density rises as 1/f, as sound and wind pressure do, and is flat under 0.3 Hz.
    force_corner : float, Hz
    machine_hz, machine_force : float, Hz, N
        Unbalance force of one rotating machine.
    points : tuple of str
        Inputs that carry small broadband forces.
    machine : str, optional
        Input of the rotating machine.
    """

    ground_rms: float = 1e-6
    lateral: float = 0.6
    correlation: float = 0.2
    force_density: float = 0.2
    force_corner: float = 20.0
    machine_hz: float = 24.3
    machine_force: float = 3.0
    points: tuple[str, ...] = ()
    machine: str | None = None


def ground_psd(freqs: Float, rms: float) -> Float:
    """Velocity of the ground, one-sided, (m/s)²/Hz.

    A hump of ocean microseism at 0.28 Hz with 30 % of the variance and cultural noise between 2 and
    40 Hz with the rest (the shape of Peterson, 1993, new noise models, for a busy site).
    """
    return rms**2 * (
        0.3 * _normal(_microseism, freqs) + 0.7 * _normal(_cultural, freqs)
    )


def _microseism(f: Float) -> Float:
    return np.exp(-0.5 * (np.log(f / 0.28) / 0.3) ** 2)


def _cultural(f: Float) -> Float:
    return (f / 2) ** 2 / (1 + (f / 2) ** 2) / (1 + (f / 40) ** 4) + 0.02 / (1 + f**2)


def _normal(shape: Callable[[Float], Float], freqs: Float) -> Float:
    area = np.trapezoid(shape(_GRID), _GRID)
    return np.where(freqs > 0, shape(np.maximum(freqs, 1e-6)), 0.0) / area


def force_psd(freqs: Float, ambient: Ambient) -> Float:
    """Small forces, one-sided, N²/Hz."""
    f = np.maximum(freqs, 0.3)
    return (
        ambient.force_density**2 * (1 + (ambient.force_corner / f) ** 2) * (freqs > 0)
    )


def input_psd(ids: Sequence[str], freqs: Float, ambient: Ambient) -> Float:
    """(in, line) spectral density of each input, its own unit²/Hz, the machine left out.

    Columns `ground+X` carry displacement, `groundv+X` velocity of the same motion; the points of
    `ambient` carry small forces.
    """
    omega = np.where(freqs > 0, 2 * np.pi * freqs, np.inf)
    out = np.zeros((len(ids), freqs.size))
    velocity = ground_psd(freqs, ambient.ground_rms)
    force = force_psd(freqs, ambient)
    for i, name in enumerate(ids):  # about twenty inputs
        weight = 1.0 if name.endswith("Z") else ambient.lateral**2
        if name.startswith("groundv"):
            out[i] = weight * velocity
        elif name.startswith("ground"):
            out[i] = weight * velocity / omega**2
        elif name in ambient.points:
            out[i] = force
    return out


def ambient_forces(
    ids: Sequence[str],
    ambient: Ambient,
    samples: int,
    rate: float,
    rng: np.random.Generator,
) -> Complex:
    """Spectra of all inputs, periodic over the record.

    Parameters
    ----------
    ids : sequence of str
        Inputs of the modal model: `ground+X`, `groundv+X`, force points.
    ambient : Ambient

    Returns
    -------
    (in, line) complex128
    """
    points = ambient.points
    machine = ambient.machine
    at = {name: i for i, name in enumerate(ids)}
    if lost := [p for p in [*points, *([machine] if machine else [])] if p not in at]:
        raise InputError(
            f"no input {' '.join(lost[:8])} in the modal model; there are {' '.join(list(at)[:40])}"
        )
    freqs = lines(samples, rate)
    out = np.zeros((len(ids), freqs.size), dtype=np.complex128)
    for name, motion in _ground(freqs, ambient, samples, rate, rng).items():
        if name in at:
            out[at[name]] += motion
    force = force_psd(freqs, ambient)[None]
    out[[at[p] for p in points]] = coloured(
        np.repeat(force, len(points), axis=0), samples, rate, rng
    )
    if machine:
        out[at[machine]] += fft.rfft(machine_force(ambient, samples, rate, rng))
    return out


def _ground(
    freqs: Float, ambient: Ambient, samples: int, rate: float, rng: np.random.Generator
) -> dict[str, Complex]:
    """The ground's velocity, by the inputs `groundv`, and its displacement, by the inputs
    `ground`.
    """
    own = coloured(
        np.repeat(ground_psd(freqs, ambient.ground_rms)[None], 4, axis=0),
        samples,
        rate,
        rng,
    )
    velocity = (
        np.sqrt(1 - ambient.correlation**2) * own[:3] + ambient.correlation * own[3]
    )
    velocity[:2] *= ambient.lateral
    s = np.where(freqs > 0, 2j * np.pi * freqs, np.inf)
    motions: dict[str, Complex] = {}
    for name, v in zip("XYZ", velocity, strict=True):
        motions |= {f"groundv+{name}": v, f"ground+{name}": v / s}
    return motions


def machine_force(
    ambient: Ambient, samples: int, rate: float, rng: np.random.Generator
) -> Float:
    """(sample,) force of the machine, N: amplitude ±10 % and phase wander within seconds."""
    freqs = lines(samples, rate)
    slow = 1.0 / (1 + (freqs / 0.05) ** 4) * (freqs > 0)
    wander = fft.irfft(coloured(np.stack([slow, slow]), samples, rate, rng), samples)
    wander /= wander.std(axis=1, keepdims=True)
    phase = 2 * np.pi * ambient.machine_hz * np.arange(samples) / rate + 0.3 * wander[1]
    return np.asarray(ambient.machine_force * (1 + 0.1 * wander[0]) * np.cos(phase))


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """Half-sine forces.

    Attributes
    ----------
    start, duration : (p,) float64, s
    impulse : (p,) float64, N·s; its sign is that of the input
    at : (p,) int64
        Input of the modal model.
    flat : (p,) bool
        Constant over the duration instead of a half-sine; a single value serves for all.
    """

    start: Float
    duration: Float
    impulse: Float
    at: Int
    flat: Bool = field(default_factory=lambda: np.zeros(1, dtype=bool))

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "flat", np.broadcast_to(self.flat, np.shape(self.start))
        )
        freeze_arrays(self)

    @property
    def peak(self) -> Float:
        """(p,) largest force, N."""
        return np.where(self.flat, 1.0, 0.5 * np.pi) * self.impulse / self.duration

    def pick(self, which: Bool | Int) -> Pulses:
        """Some of the pulses."""
        return Pulses(*(getattr(self, f.name)[which] for f in fields(self)))

    @staticmethod
    def join(parts: Sequence[Pulses]) -> Pulses:
        """All pulses of all parts."""
        return Pulses(
            *(
                np.concatenate([getattr(p, f.name) for p in parts])
                for f in fields(Pulses)
            )
        )


def pulse_spectrum(pulses: Pulses, inputs: int, samples: int, rate: float) -> Complex:
    """Spectra (in, line) of band-limited pulses.

    Built on a fine grid whose cells hold the exact impulse (the mean over a cell is taken out of
    the spectrum), then cut at half the rate, as an ideal anti-aliasing filter does. What lies
    beyond the record is cut off.
    """
    if pulses.at.size and pulses.at.max() >= inputs:
        raise InputError(f"pulse at input {int(pulses.at.max())}: there are {inputs}")
    # 2048.0: Hz at least: a 3 ms pulse spans 6 cells, each holding its exact share of the impulse
    factor = int(np.ceil(2048.0 / rate))
    out = np.zeros((inputs, samples // 2 + 1), dtype=np.complex128)
    cell = np.sinc(lines(samples, rate) / (rate * factor)) * factor
    for i in np.unique(pulses.at):  # a handful of struck points
        keep = pulses.at == i
        fine = _sampled(pulses.pick(keep), samples * factor, rate * factor)
        out[i] = fft.rfft(fine)[: samples // 2 + 1] / cell
    return out


def _sampled(p: Pulses, samples: int, rate: float) -> Float:
    """(sample,) mean force of each cell [k − ½, k + ½]/rate."""
    width = int(np.ceil(p.duration.max() * rate)) + 2
    first = np.floor(p.start * rate).astype(np.int64)
    edges = (first[:, None] + np.arange(width + 1) - 0.5) / rate
    x = np.clip((edges - p.start[:, None]) / p.duration[:, None], 0.0, 1.0)
    # share of the impulse so far
    given = np.where(p.flat[:, None], x, 0.5 - 0.5 * np.cos(np.pi * x))
    force = p.impulse[:, None] * np.diff(given, axis=1) * rate
    cell = first[:, None] + np.arange(width)
    ok = (cell >= 0) & (cell < samples)
    return np.asarray(
        np.bincount(cell[ok], force[ok], minlength=samples), dtype=np.float64
    )


def event_times(
    spacing: Sequence[float], duration: float, rng: np.random.Generator
) -> Float:
    """(event,) starts, s: the given spacings in turn, ±5 %, the first after a tenth of one; none in
    the last.
    """
    if not len(spacing) or min(spacing) <= 0:
        raise InputError(f"event spacing {list(spacing)} s: must be positive")
    count = int(np.ceil(duration / min(spacing))) + 1
    steps = np.resize(np.asarray(spacing, dtype=np.float64), count) * rng.uniform(
        0.95, 1.05, count
    )
    times = 0.1 * steps[0] + np.concatenate([[0.0], np.cumsum(steps[:-1])])
    return np.asarray(times[times < max(duration - 0.8 * min(spacing), 0.5 * duration)])


def dropped_weight(times: Float, points: Int, rng: np.random.Generator) -> Pulses:
    """A weight of 30 kg dropped on the floor from 1.5 m, with two rebounds; forces downwards on
    inputs that are positive upwards.

    The impact speed is √(2gh); the impulse of the first contact m·v·(1 + e), of the n-th eⁿ⁻¹ of
    it, after a flight of 2·e·v/g.

    Parameters
    ----------
    times : (event,) float64, s
    points : (event,) int64
        Input struck by each event.
    """
    n = times.size
    e = rng.uniform(0.15, 0.35, n)
    contact = rng.uniform(0.006, 0.014, n)
    speed = np.sqrt(2 * g * 1.5) * np.stack([np.ones(n), e, e**2])
    flight = 2 * speed[1:] / g + contact
    start = times + np.vstack([np.zeros(n), np.cumsum(flight, axis=0)])
    impulse = -30.0 * speed * (1 + e)
    return Pulses(
        start.ravel(), np.tile(contact, 3), impulse.ravel(), np.tile(points, 3)
    )


def sledge(times: Float, points: Int, rng: np.random.Generator) -> Pulses:
    """Impacts of a 5.4 kg sledge: peak force and contact time drawn so that long contacts go with
    low peaks.
    """
    n = times.size
    hard = rng.uniform(0, 1, n)
    weak, strong = 5e3, 25e3  # N
    short, long = 0.003, 0.008  # s
    force = weak + (strong - weak) * np.clip(hard + rng.normal(0, 0.1, n), 0, 1)
    duration = long - (long - short) * np.clip(hard + rng.normal(0, 0.1, n), 0, 1)
    return Pulses(times, duration, -2 / np.pi * force * duration, points)


def jumping(times: Float, points: Sequence[int], rng: np.random.Generator) -> Pulses:
    """People jumping in bursts at about 2 Hz; the constant weight itself is left out.

    One person per point. In each period the ground reaction is a half-sine over the contact ratio
    (Bachmann and Ammann, 1987), with a heel strike of a few milliseconds at its start; both
    together have the impulse of the weight over the period, and the constant weight, which stands
    there all day, is taken off.

    Parameters
    ----------
    times : (event,) float64, s
    points : sequence of int
        Input under each person.
    """
    return Pulses.join([_jumper(times, p, rng) for p in points])


def _jumper(times: Float, point: int, rng: np.random.Generator) -> Pulses:
    """Six jumps of a person of 64 to 96 kg at each time."""
    mass = 80.0 * rng.uniform(0.8, 1.2)
    shape = (times.size, 6)
    period = 0.5 * np.clip(
        rng.normal(1, 0.04, (times.size, 1)) * rng.normal(1, 0.04, shape), 0.8, 1.2
    )
    start = (
        times[:, None]
        + rng.uniform(0, 0.15, (times.size, 1))
        + np.cumsum(period, axis=1)
        - period[:, :1]
    )
    weight = mass * g * period
    heel = rng.uniform(0.05, 0.12, shape) * weight
    parts = [
        (rng.uniform(0.006, 0.015, shape), -heel, False),
        (rng.uniform(0.35, 0.55, shape) * period, heel - weight, False),
        (period, weight, True),
    ]
    at = np.full(start.size, point)
    return Pulses.join(
        [
            Pulses(start.ravel(), d.ravel(), i.ravel(), at, flat=np.full(at.size, c))
            for d, i, c in parts
        ]
    )
