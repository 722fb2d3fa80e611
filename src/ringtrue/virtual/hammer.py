"""Roving-response hammer tests: several blows on one point, recorded in triggered blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.errors import InputError
from ringtrue.virtual.events import Pulses, pulse_spectrum
from ringtrue.virtual.noise import anti_alias
from ringtrue.virtual.response import lines, response_spectrum
from ringtrue.virtual.sensors import Chain


@dataclass(frozen=True, slots=True)
class HammerPlan:
    """How a crew strikes.

    Attributes
    ----------
    hits : int
        Clean hits wanted at each reference.
    block, pretrigger : float, s
        Length of a block, and its part before the blow.
    rest : float, s
        Pause between the end of a block and the next blow.
    double, overload : float
        Probability that an attempt is a double hit, and that it exceeds the force range.
    peak : (float, float), N
        Band of the clean blows' peak force.
    contact : (float, float), s
    """

    hits: int = 5
    block: float = 8.0
    pretrigger: float = 0.2
    rest: float = 6.0
    double: float = 0.1
    overload: float = 0.08
    peak: tuple[float, float] = (5e3, 16e3)
    contact: tuple[float, float] = (0.003, 0.008)

    def __post_init__(self) -> None:
        if (
            self.hits < 1
            or not 0 < self.pretrigger < self.block
            or self.double + self.overload > 0.8
        ):
            raise InputError(
                f"hammer plan: hits {self.hits} (1 or more), pretrigger {self.pretrigger} s "
                "within the block of "
                f"{self.block} s, double + overload {self.double + self.overload:g} (at most 0.8)"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Blows:
    """The attempts at one reference.

    Attributes
    ----------
    pulses : Pulses
        Starts from the begin of the record, s.
    times : (attempt,) float64, s
    double, overload : (attempt,) bool
    """

    pulses: Pulses
    times: Float
    double: Bool
    overload: Bool


def strike(plan: HammerPlan, at: int, limit: float, rate: float, rng: np.random.Generator) -> Blows:
    """Attempts until there are `plan.hits` clean ones.

    Parameters
    ----------
    plan : HammerPlan
    at : int
        Input struck; the force is downwards, negative.
    limit : float, N
        Force range: overloads exceed it by 5 to 40 % as sampled at `rate`, clean hits stay below
        0.9 of it.
    rate : float, Hz
    """
    double, overload = _attempts(plan, rng)
    n = double.size
    times = plan.rest + np.arange(n) * (plan.block + plan.rest) + rng.uniform(0, 0.2 * plan.rest, n)
    hard = rng.uniform(0, 1, n)
    contact = plan.contact[1] - np.ptp(plan.contact) * np.clip(hard + rng.normal(0, 0.1, n), 0, 1)
    peak = plan.peak[0] + np.ptp(plan.peak) * np.clip(hard + rng.normal(0, 0.1, n), 0, 1)
    pulses = Pulses(times, contact, -2 / np.pi * peak * contact, np.full(n, at))
    sampled = _sampled_peak(pulses, rate)
    wanted = np.where(overload, limit * rng.uniform(1.05, 1.4, n), np.minimum(sampled, 0.9 * limit))
    pulses = replace(pulses, impulse=pulses.impulse * wanted / sampled)
    second = pulses.pick(double)
    k = int(double.sum())
    second = replace(
        second,
        start=second.start + second.duration + rng.uniform(0.03, 0.12, k),
        impulse=second.impulse * rng.uniform(0.2, 0.6, k),
    )
    return Blows(Pulses.join([pulses, second]), times, double, overload)


def _attempts(plan: HammerPlan, rng: np.random.Generator) -> tuple[Bool, Bool]:
    draw = rng.uniform(0, 1, plan.hits * 10 + 50)
    double, overload = (
        draw < plan.double,
        (draw >= plan.double) & (draw < plan.double + plan.overload),
    )
    last = int(np.searchsorted(np.cumsum(~double & ~overload), plan.hits)) + 1
    return double[:last], overload[:last]


def _sampled_peak(pulses: Pulses, rate: float) -> Float:
    """(p,) largest magnitude of each pulse in samples at `rate`, N."""
    width = int(np.ceil(0.25 * rate)) * 2
    alone = replace(
        pulses,
        start=np.arange(pulses.at.size) * width / rate + 0.25 + pulses.start % (1 / rate),
        at=0 * pulses.at,
    )
    n = width * pulses.at.size
    spectrum = pulse_spectrum(alone, 1, n, rate)[0] * anti_alias(lines(n, rate), rate)
    return np.asarray(np.abs(fft.irfft(spectrum, n)).reshape(-1, width).max(axis=1))


def clean_energy(blows: Blows) -> float:
    """Mean squared impulse of the clean blows over the sum of all squared impulses."""
    square, n = blows.pulses.impulse**2, blows.times.size
    return float(square[:n][~blows.double & ~blows.overload].mean() / square.sum())


def block_samples(plan: HammerPlan, times: Float, rate: float) -> Int:
    """(attempt, sample) positions of the blocks in the continuous signal."""
    first = np.round((times - plan.pretrigger) * rate).astype(np.int64)
    return np.asarray(first[:, None] + np.arange(round(plan.block * rate)))


def hammer_record(
    model: ModalModel,
    blows: Blows,
    plan: HammerPlan,
    chain: Chain,
    background: Complex,
    samples: int,
    rate: float,
    rng: np.random.Generator,
) -> tuple[Any_, Complex, Complex]:
    """Volts of the force and the responses, the blocks one after the other.

    Parameters
    ----------
    model : ModalModel
        Its outputs are the channels of the setup; accelerations.
    chain : Chain
        Of the force and then the responses.
    background : (in, line) complex128
        Spectra of all that shakes the structure besides the hammer.
    samples : int
        Of the continuous signal that the blocks are cut from.

    Returns
    -------
    volts : (1 + r, attempt·sample) float32
    signal, noise : (r, line) complex128, V
        Spectra of the hammer's part and of all the rest, over the continuous signal.
    """
    freqs = lines(samples, rate)
    force = pulse_spectrum(blows.pulses, background.shape[0], samples, rate)
    still = np.zeros((1, freqs.size))  # the force cell feels the hammer alone
    signal = np.vstack([force.sum(axis=0), response_spectrum(model, force, freqs)])
    noise = np.vstack([still, response_spectrum(model, background, freqs)])
    chain.to_volts(signal, rate)
    chain.to_volts(noise, rate)
    noise += chain.noise(samples, rate, rng)
    volts = chain.digitise(np.asarray(fft.irfft(signal + noise, samples)), rate)
    cut = block_samples(plan, blows.times, rate).ravel()
    return volts[:, cut], signal[1:], noise[1:]
