"""Ambient excitation: ground motion, small forces on the structure, one rotating machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Complex, Float
from ringtrue.errors import InputError
from ringtrue.virtual.noise import coloured
from ringtrue.virtual.response import lines

_GRID = np.geomspace(0.01, 200.0, 4000)  # where the shape of the ground spectrum is normalised, Hz


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
    """

    ground_rms: float = 1e-6
    lateral: float = 0.6
    correlation: float = 0.2
    force_density: float = 0.2
    force_corner: float = 20.0
    machine_hz: float = 24.3
    machine_force: float = 3.0


def ground_psd(freqs: Float, rms: float) -> Float:
    """Velocity of the ground, one-sided, (m/s)²/Hz.

    A hump of ocean microseism at 0.28 Hz with 30 % of the variance and cultural noise between 2 and
    40 Hz with the rest (the shape of Peterson, 1993, new noise models, for a busy site).
    """
    return np.asarray(
        rms**2 * (0.3 * _normal(_microseism, freqs) + 0.7 * _normal(_cultural, freqs))
    )


def _microseism(f: Float) -> Float:
    return np.asarray(np.exp(-0.5 * (np.log(f / 0.28) / 0.3) ** 2))


def _cultural(f: Float) -> Float:
    return np.asarray((f / 2) ** 2 / (1 + (f / 2) ** 2) / (1 + (f / 40) ** 4) + 0.02 / (1 + f**2))


def _normal(shape: Callable[[Float], Float], freqs: Float) -> Float:
    area = np.trapezoid(shape(_GRID), _GRID)
    return np.asarray(np.where(freqs > 0, shape(np.maximum(freqs, 1e-6)), 0.0) / area)


def force_psd(freqs: Float, ambient: Ambient) -> Float:
    """Small forces, one-sided, N²/Hz."""
    f = np.maximum(freqs, 0.3)
    return np.asarray(
        ambient.force_density**2 * (1 + (ambient.force_corner / f) ** 2) * (freqs > 0)
    )


def input_psd(ids: Sequence[str], points: Sequence[str], freqs: Float, ambient: Ambient) -> Float:
    """(in, line) spectral density of each input, its own unit²/Hz, the machine left out.

    Columns `ground+X` carry displacement, `groundv+X` velocity of the same motion; `points` carry
    small forces.
    """
    omega = np.where(freqs > 0, 2 * np.pi * freqs, np.inf)
    out = np.zeros((len(ids), freqs.size))
    velocity, force = ground_psd(freqs, ambient.ground_rms), force_psd(freqs, ambient)
    for i, name in enumerate(ids):  # about twenty inputs
        weight = 1.0 if name.endswith("Z") else ambient.lateral**2
        if name.startswith("groundv"):
            out[i] = weight * velocity
        elif name.startswith("ground"):
            out[i] = weight * velocity / omega**2
        elif name in points:
            out[i] = force
    return out


def ambient_forces(
    ids: Sequence[str],
    points: Sequence[str],
    machine: str | None,
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
    points : sequence of str
        Inputs that carry small broadband forces.
    machine : str or None
        Input of the rotating machine.

    Returns
    -------
    (in, line) complex128
    """
    at = {name: i for i, name in enumerate(ids)}
    if lost := [p for p in [*points, *([machine] if machine else [])] if p not in at]:
        raise InputError(
            f"no input {' '.join(lost[:8])} in the modal model; there are {' '.join(list(at)[:40])}"
        )
    freqs = lines(samples, rate)
    out = np.zeros((len(ids), freqs.size), dtype=np.complex128)
    _ground(out, at, freqs, ambient, samples, rate, rng)
    force = force_psd(freqs, ambient)[None]
    out[[at[p] for p in points]] = coloured(
        np.repeat(force, len(points), axis=0), samples, rate, rng
    )
    if machine:
        out[at[machine]] += fft.rfft(machine_force(ambient, samples, rate, rng))
    return out


def _ground(
    out: Complex,
    at: dict[str, int],
    freqs: Float,
    ambient: Ambient,
    samples: int,
    rate: float,
    rng: np.random.Generator,
) -> None:
    """Adds the ground's velocity to the columns `groundv`, its displacement to the columns
    `ground`.
    """
    own = coloured(
        np.repeat(ground_psd(freqs, ambient.ground_rms)[None], 4, axis=0), samples, rate, rng
    )
    velocity = np.sqrt(1 - ambient.correlation**2) * own[:3] + ambient.correlation * own[3]
    velocity[:2] *= ambient.lateral
    s = np.where(freqs > 0, 2j * np.pi * freqs, np.inf)
    for name, v in zip("XYZ", velocity, strict=True):
        for column, motion in ((f"groundv+{name}", v), (f"ground+{name}", v / s)):
            if column in at:
                out[at[column]] += motion


def machine_force(ambient: Ambient, samples: int, rate: float, rng: np.random.Generator) -> Float:
    """(sample,) force of the machine, N: amplitude ±10 % and phase wander within seconds."""
    freqs = lines(samples, rate)
    slow = 1.0 / (1 + (freqs / 0.05) ** 4) * (freqs > 0)
    wander = fft.irfft(coloured(np.stack([slow, slow]), samples, rate, rng), samples)
    wander /= wander.std(axis=1, keepdims=True)
    phase = 2 * np.pi * ambient.machine_hz * np.arange(samples) / rate + 0.3 * wander[1]
    return np.asarray(ambient.machine_force * (1 + 0.1 * wander[0]) * np.cos(phase))
