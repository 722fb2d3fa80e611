"""A virtual hammer test: blows at each reference, recorded by the planned sensors, made FRFs and
identified.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.identification.hammer import HammerModes, identify_hammer
from ringtrue.planning.rehearsal import RATE, Conditions, Planned, Rehearsal, modal_model, trials
from ringtrue.signal.frf import estimate_frf
from ringtrue.signal.hits import HammerSettings
from ringtrue.virtual.events import Pulses, pulse_spectrum
from ringtrue.virtual.hammer import HammerPlan, hammer_record, strike
from ringtrue.virtual.noise import white
from ringtrue.virtual.response import decay_time, lines, response_spectrum
from ringtrue.virtual.sensors import FORCE_CELL, Chain, Sensor

LOOK = 10  # blows that tell a coherence
SMALLEST = 200.0  # N, range of the smallest impact hammers


def fitting_hammer(model: ModalModel, fmax: float, sensor: Sensor, *, hits: int = 5) -> HammerPlan:
    """A hammer whose blows fill half the sensors' range at most and reach to `fmax`.

    The tip gives contact times of 0.4 to 0.7 over fmax (first zero of a half-sine at 1.5 over the
    time), the block lasts until the slowest mode has decayed to 1 %.

    Parameters
    ----------
    model : ModalModel
    fmax : float, Hz
    sensor : Sensor
        Of the responses.
    """
    rate = RATE * fmax
    contact = (0.4 / fmax, 0.7 / fmax)
    block = float(np.clip(decay_time(model, np.log(100)), 40 / fmax, 200.0))
    peak = (
        sensor.range
        / sensor.sensitivity
        / max(_peak_response(model, contact[0], block, rate), 1e-300)
    )
    top = float(min(0.5 * peak, FORCE_CELL.range / FORCE_CELL.sensitivity))
    return HammerPlan(
        hits,
        block,
        max(0.01 * block, 24 / rate),
        0.3 * block,
        peak=(0.5 * top, top),
        contact=contact,
    )


def _peak_response(model: ModalModel, contact: float, block: float, rate: float) -> float:
    """Largest acceleration of any output by a blow of 1 N at any input."""
    n = 2 * int(np.ceil(0.5 * min(block, 2000 / rate) * rate))
    top = 0.0
    for i in range(len(model.inputs)):  # a handful of references
        blow = Pulses(
            np.array([4 / rate]),
            np.array([contact]),
            np.array([2 / np.pi * contact]),
            np.array([i]),
        )
        force = pulse_spectrum(blow, len(model.inputs), n, rate)
        top = max(
            top, float(np.abs(fft.irfft(response_spectrum(model, force, lines(n, rate)), n)).max())
        )
    return top


def rehearse(
    plan: Planned,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    progress: Progress | None = None,
) -> Rehearsal:
    """Test the plan on signals: strike, record, estimate FRFs, identify and correlate, trial by
    trial.

    Each trial draws other dampings, frequencies, calibration errors, blows and noise.

    Parameters
    ----------
    plan : Planned
    conditions : Conditions
    rng : Generator
    progress : callable, optional
    """
    nominal = modal_model(
        plan, plan.frequencies, np.full(plan.frequencies.size, conditions.damping)
    )
    hammer = conditions.hammer or fitting_hammer(
        nominal, plan.fmax, conditions.sensor, hits=conditions.hits
    )
    settings = HammerModes(0.97 * plan.fmin or None, 1.03 * plan.fmax)
    if conditions.coherence is not None:
        density = background_density(
            nominal, hammer, conditions, (plan.fmin, plan.fmax), rng.spawn(1)[0]
        )
        conditions = replace(conditions, background=density)

    def find(model: ModalModel, stream: np.random.Generator) -> ModeSet:
        return identify_hammer(
            measured(model, hammer, conditions, RATE * plan.fmax, stream), settings
        ).modes

    result = trials(plan, conditions, find, rng, force=hammer.peak[1], progress=progress)
    return replace(result, background=conditions.background)


def background_density(
    model: ModalModel,
    hammer: HammerPlan,
    conditions: Conditions,
    band: tuple[float, float],
    rng: np.random.Generator,
) -> float:
    """White forces at all references that leave the driving points the coherence of `conditions`,
    N/√Hz.

    γ² = 1/(1 + N/S), and N/S grows with the square of the density. One that would leave 0.98 of
    blows without windows is mended by what FRFs of a virtual test tell; twice, as windows depend on
    noise.

    Parameters
    ----------
    model : ModalModel
    hammer : HammerPlan
    conditions : Conditions
    band : (float, float), Hz
    """
    wanted = 1 / (conditions.coherence or 1.0) - 1
    impulse = 2 / np.pi * float(np.mean(hammer.peak) * np.mean(hammer.contact))
    density = impulse * float(np.sqrt(0.04 / (hammer.block * len(model.inputs))))
    blows = replace(hammer, hits=max(hammer.hits, LOOK))
    for _ in range(2):
        frfs = measured(model, blows, replace(conditions, background=density), RATE * band[1], rng)
        at = tuple(np.array(frfs.driving_points()).T)  # elsewhere may be no motion
        seen = frfs.coherence[(frfs.freqs > band[0]) & (frfs.freqs < band[1])][:, *at]
        seen = seen[np.isfinite(seen)]
        if not seen.size:  # too loud for two good blows
            break
        density *= float(np.sqrt(wanted / max(1 / np.median(seen) - 1, 1e-12)))
    return density


def measured(
    model: ModalModel,
    hammer: HammerPlan,
    conditions: Conditions,
    rate: float,
    rng: np.random.Generator,
) -> FrfSet:
    """FRFs as the crew would have them: blows at each input, recorded by the sensors with their
    noise.

    Parameters
    ----------
    model : ModalModel
    hammer : HammerPlan
    conditions : Conditions
    rate : float, Hz
    """
    sensors = (_cell(hammer.peak[1] / 0.85), *(conditions.sensor,) * len(model.outputs))
    chain = Chain.draw(sensors, rng)
    records = [
        _record(model, i, hammer, chain, conditions, rate, rng) for i in range(len(model.inputs))
    ]
    full = {
        c.id: s.range / s.sensitivity
        for r in records
        for c, s in zip(r.channels, sensors, strict=True)
    }
    block = round(hammer.block * rate) / rate
    settings = HammerSettings(block=block - hammer.pretrigger, pretrigger=hammer.pretrigger)
    return estimate_frf(records, settings, full_scale=full)[0]


def _cell(limit: float) -> Sensor:
    """A force cell of so many N: the noise of a smaller hammer is smaller, too."""
    size = max(limit, SMALLEST) * FORCE_CELL.sensitivity / FORCE_CELL.range
    floor = replace(FORCE_CELL.floor, density=FORCE_CELL.floor.density * size)
    return replace(FORCE_CELL, sensitivity=FORCE_CELL.range / limit, floor=floor)


def _record(
    model: ModalModel,
    at: int,
    hammer: HammerPlan,
    chain: Chain,
    conditions: Conditions,
    rate: float,
    rng: np.random.Generator,
) -> TimeHistory:
    limit = chain.sensors[0].range / chain.sensors[0].sensitivity
    blows = strike(hammer, at, limit, rate, rng)
    samples = 2 * int(np.ceil(0.5 * (float(blows.times[-1]) + hammer.block + hammer.rest) * rate))
    background = white(len(model.inputs), conditions.background, samples, rate, rng)
    volts, _, _ = hammer_record(model, blows, hammer, chain, background, samples, rate, rng)
    data = volts / np.array([s.sensitivity for s in chain.sensors])[:, None]
    force = replace(model.inputs[at], id=f"F:{model.inputs[at].id}")
    return TimeHistory(data, rate, (force, *model.outputs), f"virtual test, {model.inputs[at].id}")
