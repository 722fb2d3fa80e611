"""Simulated tests: impact tests in triggered blocks, ambient tests with and without events.

What a crew writes down: sensor sheets, lines to draw and the log of the campaign.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.modes import ModalModel
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.io.record_table import RecordChannel
from ringtrue.virtual.excitation import (
    Ambient,
    Pulses,
    ambient_forces,
    input_psd,
    pulse_spectrum,
)
from ringtrue.virtual.joints import SofteningJoints
from ringtrue.virtual.sensors import (
    Chain,
    Sensor,
    anti_alias,
    expected_power,
    lines,
    ratio_db,
    record_volts,
    resonance_power,
    response_spectrum,
)

HEADER = (
    "point",
    "x",
    "y",
    "z",
    "direction",
    "channel",
    "group",
    "quantity",
    "unit",
    "sensitivity",
    "range",
    "sensor",
)


def record_channels(
    test: TestModel, channels: Sequence[str], sensors: Sequence[Sensor], date: str
) -> list[RecordChannel]:
    """The channel table of a record, with the sensitivities of the calibration sheets."""
    at = dict(zip(test.channels, test.at.tolist(), strict=True))
    return [
        RecordChannel(
            id=c,
            point=at[c],
            quantity=s.quantity,
            unit=s.unit,
            sensitivity=s.sensitivity,
            range=s.range,
            sensor=s.name,
            calibration=date,
        )
        for c, s in zip(channels, sensors, strict=True)
    ]


def write_sheet(
    path: Path,
    test: TestModel,
    channels: Sequence[str],
    sensors: Sequence[Sensor] | None = None,
) -> None:
    """A sensor sheet; without `sensors` only places, directions and groups, and points without
    channels too.
    """
    place = dict(
        zip(
            test.points.tolist(),
            zip(test.xyz.tolist(), test.groups, strict=True),
            strict=True,
        )
    )
    here = {c: i for i, c in enumerate(test.channels)}
    rows = []
    for k, c in enumerate(channels):
        point = int(test.at[here[c]])
        xyz, group = place[point]
        s = sensors[k] if sensors else None
        tail = (
            [s.quantity, s.unit, f"{s.sensitivity:g}", f"{s.range:g}", s.name]
            if s
            else [""] * 5
        )
        rows.append(
            [
                point,
                *(f"{v:.6g}" for v in xyz),
                direction(test.axes[here[c]]),
                c,
                group,
                *tail,
            ]
        )
    if sensors is None:
        used = {r[0] for r in rows}
        bare = [p for p in np.unique(test.lines).tolist() if p not in used]
        rows += [
            [p, *(f"{v:.6g}" for v in place[p][0]), "", "", place[p][1], *[""] * 5]
            for p in bare
        ]
    _table(path, HEADER, rows)


def direction(axis: Float) -> str:
    """`+Z` for a global axis, else the vector."""
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > 1 - 1e-9:
        return f"{'+' if axis[k] > 0 else '-'}{'XYZ'[k]}"
    return " ".join(f"{v:.9g}" for v in axis)


def write_lines(path: Path, test: TestModel) -> None:
    """Pairs of points to draw."""
    _table(path, ("from", "to"), test.lines.tolist())


def write_log(
    path: Path, tests: Sequence[Mapping[str, object]], sensors: Sequence[Sensor]
) -> None:
    """campaign.json: tests with their records, and the data sheets of the sensor types."""
    sheets = {
        s.name: {
            "quantity": s.quantity,
            "corner_hz": s.corner,
            "damping": s.damping,
            "reaches_zero": s.corner == 0,
        }
        for s in dict.fromkeys(sensors)
    }
    log = {
        "format": "ringtrue-campaign",
        "version": 1,
        "sensors": sheets,
        "tests": list(tests),
    }
    path.write_text(json.dumps(log, indent=1) + "\n")


def _table(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


@dataclass(frozen=True, slots=True)
class HammerPlan:
    """How a crew strikes.

    Attributes
    ----------
    hits : int
        Clean hits wanted at each reference.
    block, pretrigger : float, s
        Length of a block, and its part before the impact.
    rest : float, s
        Pause between the end of a block and the next impact.
    double, overload : float
        Probability that an attempt is a double hit, and that it exceeds the force range.
    peak : (float, float), N
        Band of the clean impacts' peak force.
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
class SimulatedImpacts:
    """The attempts at one reference.

    Attributes
    ----------
    pulses : Pulses
        Starts from the begin of the record, s.
    times : (attempt,) float64, s
    double, overload : (attempt,) bool
    plan : HammerPlan
    rate : float, Hz
        That peaks are sampled at.
    """

    pulses: Pulses
    times: Float
    double: Bool
    overload: Bool
    plan: HammerPlan
    rate: float


def strike(
    plan: HammerPlan, at: int, limit: float, rate: float, rng: np.random.Generator
) -> SimulatedImpacts:
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
    draw = rng.uniform(0, 1, plan.hits * 10 + 50)
    double = draw < plan.double
    overload = (draw >= plan.double) & (draw < plan.double + plan.overload)
    last = int(np.searchsorted(np.cumsum(~double & ~overload), plan.hits)) + 1
    double = double[:last]
    overload = overload[:last]
    n = double.size
    times = (
        plan.rest
        + np.arange(n) * (plan.block + plan.rest)
        + rng.uniform(0, 0.2 * plan.rest, n)
    )
    hard = rng.uniform(0, 1, n)
    contact = plan.contact[1] - np.ptp(plan.contact) * np.clip(
        hard + rng.normal(0, 0.1, n), 0, 1
    )
    peak = plan.peak[0] + np.ptp(plan.peak) * np.clip(
        hard + rng.normal(0, 0.1, n), 0, 1
    )
    pulses = Pulses(times, contact, -2 / np.pi * peak * contact, np.full(n, at))
    sampled = _sampled_peak(pulses, rate)
    wanted = np.where(
        overload, limit * rng.uniform(1.05, 1.4, n), np.minimum(sampled, 0.9 * limit)
    )
    pulses = replace(pulses, impulse=pulses.impulse * wanted / sampled)
    second = pulses.pick(double)
    k = int(double.sum())
    second = replace(
        second,
        start=second.start + second.duration + rng.uniform(0.03, 0.12, k),
        impulse=second.impulse * rng.uniform(0.2, 0.6, k),
    )
    return SimulatedImpacts(
        Pulses.join([pulses, second]), times, double, overload, plan=plan, rate=rate
    )


def _sampled_peak(pulses: Pulses, rate: float) -> Float:
    """(p,) largest magnitude of each pulse in samples at `rate`, N."""
    width = int(np.ceil(0.25 * rate)) * 2
    alone = replace(
        pulses,
        start=np.arange(pulses.at.size) * width / rate
        + 0.25
        + pulses.start % (1 / rate),
        at=0 * pulses.at,
    )
    n = width * pulses.at.size
    spectrum = pulse_spectrum(alone, 1, n, rate)[0] * anti_alias(lines(n, rate), rate)
    return np.asarray(np.abs(fft.irfft(spectrum, n)).reshape(-1, width).max(axis=1))


def clean_energy(impacts: SimulatedImpacts) -> float:
    """Mean squared impulse of the clean impacts over the sum of all squared impulses."""
    square = impacts.pulses.impulse**2
    n = impacts.times.size
    return float(square[:n][~impacts.double & ~impacts.overload].mean() / square.sum())


def block_samples(plan: HammerPlan, times: Float, rate: float) -> Int:
    """(attempt, sample) positions of the blocks in the continuous signal."""
    first = np.round((times - plan.pretrigger) * rate).astype(np.int64)
    return first[:, None] + np.arange(round(plan.block * rate))


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """What else acts during a hammer test.

    Attributes
    ----------
    forces : (in, line) complex128
        Spectra of all that shakes the structure besides the hammer.
    joints : SofteningJoints, optional
        Of the structure, where it is not linear.
    """

    forces: Complex
    joints: SofteningJoints | None = None


def hammer_record(
    model: ModalModel,
    impacts: SimulatedImpacts,
    chain: Chain,
    background: Background,
    samples: int,
    rng: np.random.Generator,
) -> tuple[Any_, Complex, Complex]:
    """Volts of the force and the responses, the blocks one after the other.

    Parameters
    ----------
    model : ModalModel
        Its outputs are the channels of the setup; accelerations.
    chain : Chain
        Of the force and then the responses.
    background : Background
    samples : int
        Of the continuous signal that the blocks are cut from.

    Returns
    -------
    volts : (1 + r, attempt·sample) float32
    signal, noise : (r, line) complex128, V
        Spectra of the hammer's part (and of all that joints make of both) and of all the rest, over
        the continuous signal.
    """
    rate = impacts.rate
    freqs = lines(samples, rate)
    others = background.forces
    force = pulse_spectrum(impacts.pulses, others.shape[0], samples, rate)
    felt = force.sum(axis=0)  # by the force cell: the hammer alone
    if background.joints is not None:
        force = background.joints.with_forces(force + others, samples, rate) - others
    signal = np.vstack([felt, response_spectrum(model, force, freqs)])
    still = np.zeros((1, freqs.size))
    noise = np.vstack([still, response_spectrum(model, others, freqs)])
    chain.to_volts(signal, rate)
    chain.to_volts(noise, rate)
    noise += chain.noise(samples, rate, rng)
    volts = chain.digitise(np.asarray(fft.irfft(signal + noise, samples)), rate)
    cut = block_samples(impacts.plan, impacts.times, rate).ravel()
    return volts[:, cut], signal[1:], noise[1:]


@dataclass(frozen=True, slots=True, eq=False)
class AmbientTest:
    """A structure on a day, with the sensors on it.

    Attributes
    ----------
    model : ModalModel
        Its outputs are the channels.
    chain : Chain
    site : Ambient
    rate : float, Hz
    poles : (m,) complex128, rad/s
        The modes that signal-to-noise ratios are taken at.
    joints : SofteningJoints, optional
        Of the structure, where it is not linear.
    """

    model: ModalModel
    chain: Chain
    site: Ambient
    rate: float
    poles: Complex
    joints: SofteningJoints | None = None

    def forces(self, samples: int, rng: np.random.Generator) -> Complex:
        """(in, line) spectra of the ambient excitation."""
        ids = tuple(c.id for c in self.model.inputs)
        return ambient_forces(ids, self.site, samples, self.rate, rng)

    def volts(self, forces: Complex, freqs: Float) -> Complex:
        """(channel, line) spectra at the recorder, without noise."""
        motion = response_spectrum(
            self.model, forces, freqs, quantity=self.chain.sensors[0].motion
        )
        self.chain.to_volts(motion, self.rate)
        return motion


def expected_snr(test: AmbientTest) -> float:
    """Median over channels and modes of the ratio at resonance without events, dB."""
    f = np.abs(test.poles) / (2 * np.pi)
    inputs = input_psd([c.id for c in test.model.inputs], f, test.site)
    signal = expected_power(
        test.model, test.poles, inputs, test.chain.sensors[0].motion
    )
    noise = np.stack([s.noise_psd(f, test.rate) for s in test.chain.sensors])
    return float(np.median(ratio_db(signal, noise)))


def scaled_to_snr(
    test: AmbientTest, snr_db: float, bounds: tuple[float, float]
) -> AmbientTest:
    """The test with all ambient levels scaled for a ratio at resonance, ground motion within
    `bounds`, m/s rms.
    """
    gain = 10 ** ((snr_db - expected_snr(test)) / 20)
    return replace(
        test,
        site=scale_site(
            test.site, float(np.clip(test.site.ground_rms * gain, *bounds))
        ),
    )


def scale_site(site: Ambient, ground_rms: float) -> Ambient:
    """A quieter or louder day: all levels in proportion to the ground motion, m/s rms."""
    gain = ground_rms / site.ground_rms
    return replace(
        site,
        ground_rms=ground_rms,
        force_density=gain * site.force_density,
        machine_force=gain * site.machine_force,
    )


def ambient_record(
    test: AmbientTest, events: Sequence[Pulses], samples: int, rng: np.random.Generator
) -> tuple[Any_, float]:
    """One record in the steady state; the tail of the last event stands at its begin.

    Returns
    -------
    volts : (channel, sample) float32
    snr_db : float
        Median over channels and modes at resonance.
    """
    freqs = lines(samples, test.rate)
    forces = test.forces(samples, rng)
    for pulses in events:
        forces += pulse_spectrum(pulses, forces.shape[0], samples, test.rate)
    if test.joints is not None:
        forces = test.joints.with_forces(forces, samples, test.rate)
    signal = response_spectrum(
        test.model, forces, freqs, quantity=test.chain.sensors[0].motion
    )
    volts, noise = record_volts(signal, test.chain, samples, test.rate, rng)
    strength = resonance_power(signal, test.poles, samples, test.rate)
    quantisation = np.array([s.step**2 / 6 / test.rate for s in test.chain.sensors])[
        :, None
    ]
    noisy = resonance_power(noise, test.poles, samples, test.rate) + quantisation
    return volts, float(np.median(ratio_db(strength, noisy)))
