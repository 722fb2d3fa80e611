"""A virtual ambient test: the structure under broad random forces, recorded by the planned sensors
and identified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import InputError
from ringtrue.identification.ambient import AmbientSettings, identify_ambient
from ringtrue.planning.rehearsal import RATE, Conditions, Planned, Rehearsal, trials
from ringtrue.virtual.noise import white
from ringtrue.virtual.response import lines, response_spectrum
from ringtrue.virtual.sensors import Chain, record

HEADROOM = 6.0  # of the range over the RMS: nothing clips
MOST = 40_000_000  # samples of all channels of a record


@dataclass(frozen=True, slots=True)
class Ambience:
    """How an ambient test is made.

    Attributes
    ----------
    duration : float, s
        Of the record.
    density : float, N/√Hz
        Of the independent white forces along each row of the inputs of the plan.
    """

    duration: float
    density: float

    def __post_init__(self) -> None:
        if not (self.duration > 0 and self.density > 0):
            raise InputError(
                f"virtual ambient test: {self.duration} s and {self.density} N/√Hz must be above 0"
            )


def longest(channels: int, fmax: float) -> float:
    """Duration of a record that is simulated whole, s."""
    return MOST / (channels * RATE * fmax)


def rehearse_ambient(
    plan: Planned,
    ambience: Ambience,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    progress: Progress | None = None,
) -> Rehearsal:
    """Test an ambient plan on signals: record under random forces, identify by SSI and correlate,
    trial by trial.

    Parameters
    ----------
    plan : Planned
        Its inputs are where and along which the forces act.
    ambience : Ambience
    conditions : Conditions
        Its sensor, trials, scatter and pairing count.
    rng : Generator
    """
    settings = AmbientSettings(0.97 * plan.fmin or None, 1.03 * plan.fmax)
    # forces at many rows are, for the modes, as many as there are modes: QR keeps the covariance of
    # ΦᵀF
    inputs = np.asarray(np.linalg.qr(plan.inputs, mode="r"))
    few = replace(plan, inputs=inputs, references=tuple(f"F{k}" for k in range(len(inputs))))

    def find(model: ModalModel, stream: np.random.Generator) -> ModeSet:
        return identify_ambient(
            recorded(model, ambience, conditions, RATE * plan.fmax, stream), settings
        ).modes

    return trials(few, conditions, find, rng, force=ambience.density, progress=progress)


def recorded(
    model: ModalModel,
    ambience: Ambience,
    conditions: Conditions,
    rate: float,
    rng: np.random.Generator,
) -> TimeHistory:
    """The accelerations as the crew would have them, with the noise of the sensors; a range that
    they do not fill.

    Parameters
    ----------
    model : ModalModel
    ambience : Ambience
    conditions : Conditions
    rate : float, Hz
    """
    samples = 2 * fft.next_fast_len(int(np.ceil(0.5 * ambience.duration * rate)), real=True)
    forces = white(len(model.inputs), ambience.density, samples, rate, rng)
    motion = response_spectrum(model, forces, lines(samples, rate))
    loudest = np.sqrt(2 * (np.abs(motion) ** 2).sum(axis=1).max()) / samples
    wide = max(conditions.sensor.range, HEADROOM * conditions.sensor.sensitivity * float(loudest))
    chain = Chain.draw((replace(conditions.sensor, range=wide),) * len(model.outputs), rng)
    volts, _ = record(motion, chain, samples, rate, rng)
    return TimeHistory(
        volts / conditions.sensor.sensitivity, rate, model.outputs, "virtual ambient test"
    )
