"""A virtual test of the plan: signals with the planned points, hammer and sensors; identified and
correlated.

What comes out are the modes that will be found, with which probability and which error, before
anyone goes on site.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.special import betaincinv

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.progress import Progress
from ringtrue.core.signals import Channel
from ringtrue.correlation.pairing import Pairing, PairingSettings, pair_modes
from ringtrue.errors import DataError, InputError
from ringtrue.virtual.hammer import HammerPlan
from ringtrue.virtual.sensors import ICP, Sensor

RATE = 3.2  # over fmax: the recorder's filter is flat up to 0.4 of the rate


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A structure as planned to be measured.

    Attributes
    ----------
    frequencies : (m,) float64, Hz
        All modes that take part, those beside the band too; rigid-body modes, free or on a soft
        suspension, count as mass lines: those below a tenth of `fmin` or a thousandth of `fmax`.
    outputs : (o, m) float64
        Mass-normalised shapes in SI at the channels.
    inputs : (i, m) float64
        At the points and directions struck.
    channels, references : tuple of str
        Equal ids mark a driving point.
    fmin, fmax : float, Hz
        Band of the test.
    """

    frequencies: Float
    outputs: Float
    inputs: Float
    channels: tuple[str, ...]
    references: tuple[str, ...]
    fmin: float
    fmax: float

    def __post_init__(self) -> None:
        freeze_fields(self, frequencies=np.float64, outputs=np.float64, inputs=np.float64)
        m, o, i = self.frequencies.size, len(self.channels), len(self.references)
        if self.outputs.shape != (o, m) or self.inputs.shape != (i, m) or not i:
            raise InputError(
                f"outputs {self.outputs.shape}, inputs {self.inputs.shape} for {m} modes, {o} "
                f"channels, {i} references"
            )
        if not 0 <= self.fmin < self.fmax or not self.targets.any():
            raise InputError(f"no mode between {self.fmin:g} and {self.fmax:g} Hz")

    @property
    def targets(self) -> Bool:
        """(m,) bool, modes in the band."""
        return np.asarray((self.frequencies >= self.fmin) & (self.frequencies <= self.fmax))


@dataclass(frozen=True, slots=True)
class Conditions:
    """How the test is made.

    Attributes
    ----------
    trials : int
    damping : float
        Expected ratio.
    damping_scatter : float
        Of its logarithm, mode by mode and trial by trial.
    frequency_scatter : float
        Relative error of the model's frequencies, drawn likewise.
    background : float, N/√Hz
        White force at each reference all the time.
    coherence : float, optional, 0..1
        In place of `background`: so strong that the FRFs of driving points have this coherence;
        each reference is a channel then.
    sensor : Sensor
        Of the responses; an accelerometer.
    hits : int
        Good blows at each reference, unless `hammer` says so.
    hammer : HammerPlan, optional
        By default a hammer that fits the structure: `fitting_hammer`.
    pairing : PairingSettings
        When a mode counts as found.
    """

    trials: int = 10
    damping: float = 0.01
    damping_scatter: float = 0.2
    frequency_scatter: float = 0.01
    background: float = 0.0
    coherence: float | None = None
    sensor: Sensor = ICP
    hits: int = 5
    hammer: HammerPlan | None = None
    pairing: PairingSettings = field(default_factory=lambda: PairingSettings(0.8, 0.03, reach=1.0))

    def __post_init__(self) -> None:
        if (
            min(self.trials, self.hits) < 1
            or not 0 < self.damping < 1
            or min(self.damping_scatter, self.background) < 0
        ):
            raise InputError(
                f"virtual test: trials {self.trials} and hits {self.hits} (1 or more), damping "
                f"{self.damping} (0..1), "
                f"scatter and background {self.damping_scatter}, {self.background} (0 or more)"
            )
        if self.coherence is not None and not 0 < self.coherence <= 1:
            raise InputError(f"virtual test: coherence {self.coherence} must be above 0, 1 at most")


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """What the trials found of each mode in the band.

    Attributes
    ----------
    frequencies : (t,) float64, Hz
        Of the model.
    found : (t,) float64, 0..1
        Share of the trials that found the mode.
    at_least : (t,) float64, 0..1
        Lower 95 % confidence bound of that probability (Clopper and Pearson 1934).
    frequency_bias, frequency_std : (t,) float64
        Relative, of the trials that found it; NaN where none did, the deviation where fewer than
        two did.
    damping_bias, damping_std : (t,) float64
        Relative.
    mac : (t,) float64
        Mean of the trials that found it.
    invented : float
        Modes a trial that pair with none of the structure.
    trials : int
    force : float
        Largest planned peak of a blow, N; of an ambient test the density of the forces, N/√Hz.
    background : float, N/√Hz
        White force at each reference beside the blows.
    """

    frequencies: Float
    found: Float
    at_least: Float
    frequency_bias: Float
    frequency_std: Float
    damping_bias: Float
    damping_std: Float
    mac: Float
    invented: float
    trials: int
    force: float
    background: float = 0.0

    def __post_init__(self) -> None:
        names = (
            "frequencies",
            "found",
            "at_least",
            "frequency_bias",
            "frequency_std",
            "damping_bias",
            "damping_std",
        )
        freeze_fields(self, **dict.fromkeys((*names, "mac"), np.float64))

    def take(self, modes: Int) -> Rehearsal:
        """The chosen modes (k,) of the band, in the given order."""
        arrays = [f.name for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)]
        return replace(self, **{name: getattr(self, name)[modes] for name in arrays})


def modal_model(plan: Planned, frequencies: Float, damping: Float) -> ModalModel:
    """The structure as poles and residues: φψᵀ/(2iω_d) at each pole, rigid-body modes as the term
    L/s².

    Parameters
    ----------
    frequencies, damping : (m,) float64
        In place of those of the plan, Hz and ratio.
    """
    elastic = plan.frequencies > max(0.1 * plan.fmin, 1e-3 * plan.fmax)
    w, z = 2 * np.pi * frequencies[elastic], damping[elastic]
    wd = w * np.sqrt(1 - z**2)
    rigid = plan.outputs[:, ~elastic] @ plan.inputs[:, ~elastic].T
    return ModalModel(
        -z * w + 1j * wd,
        plan.outputs[:, elastic] / (2j * wd),
        plan.inputs[:, elastic].T.astype(np.complex128),
        rigid.astype(np.complex128),
        np.zeros(rigid.shape, dtype=np.complex128),
        tuple(Channel(c, "acceleration", "m/s^2") for c in plan.channels),
        tuple(Channel(c, "force", "N") for c in plan.references),
        norm=Norm.MASS,
    )


def trials(
    plan: Planned,
    conditions: Conditions,
    find: Callable[[ModalModel, np.random.Generator], ModeSet],
    rng: np.random.Generator,
    *,
    force: float,
    progress: Progress | None = None,
) -> Rehearsal:
    """What tests find of structures that scatter about the planned one.

    Parameters
    ----------
    plan : Planned
    conditions : Conditions
        Of the trials, the scatter and the pairing.
    find : callable
        The modes that a test of the structure finds.
    rng : Generator
    force : float
        To be told.
    """
    target = plan.targets
    zeta = np.full(plan.frequencies.size, conditions.damping)
    error = np.full((3, conditions.trials, int(target.sum())), np.nan)
    invented = 0
    for k, stream in enumerate(rng.spawn(conditions.trials)):
        if progress:
            progress(k / conditions.trials, f"virtual test {k + 1} of {conditions.trials}")
        f = plan.frequencies * (
            1 + conditions.frequency_scatter * stream.standard_normal(zeta.size)
        )
        z = np.minimum(
            zeta * np.exp(conditions.damping_scatter * stream.standard_normal(zeta.size)), 0.5
        )
        truth = ModeSet(
            f[target], z[target], plan.outputs[:, target], plan.channels, Norm.MASS, "model"
        )
        truth = truth.take(np.argsort(truth.frequencies, kind="stable"))
        back = np.argsort(f[target], kind="stable")
        try:
            modes = _whole(find(modal_model(plan, f, z), stream), plan.channels)
        except DataError:  # no pole found: every mode is missed in this trial
            continue
        pairs = pair_modes(truth, modes, conditions.pairing, names=("model", "test"))
        error[:, k, back[pairs.a]] = _errors(truth, modes, pairs)
        inside = (modes.frequencies > plan.fmin) & (modes.frequencies < plan.fmax)
        invented += int(inside[pairs.lone_b].sum())
    return _outcome(plan.frequencies[target], error, invented, force)


def _whole(modes: ModeSet, channels: tuple[str, ...]) -> ModeSet:
    """The modes at all channels of the plan; nothing was seen at those that the test left out, as
    drowned in noise.
    """
    shapes = np.zeros((len(channels), len(modes)), dtype=modes.shapes.dtype)
    kept = np.flatnonzero(np.isin(channels, modes.channels))
    shapes[kept] = modes.rows([channels[i] for i in kept.tolist()]).shapes
    return replace(modes, shapes=shapes, labels=channels)


def _errors(truth: ModeSet, found: ModeSet, pairs: Pairing) -> Float:
    """Relative errors of frequency and damping, and the MAC, (3, pairs)."""
    f = found.frequencies[pairs.b] / truth.frequencies[pairs.a] - 1
    z = found.damping[pairs.b] / truth.damping[pairs.a] - 1
    return np.stack([f, z, pairs.mac])


def _outcome(frequencies: Float, error: Float, invented: int, force: float) -> Rehearsal:
    trials = error.shape[1]
    there = np.isfinite(error[0])
    hits = there.sum(axis=0)
    low = np.where(hits > 0, betaincinv(np.maximum(hits, 1), trials - hits + 1, 0.05), 0.0)
    some, value = np.where(hits > 0, hits, np.nan), np.where(there, error, 0.0)
    mean = value.sum(axis=1) / some
    spread = np.where(there, (error - mean[:, None]) ** 2, 0.0).sum(axis=1)
    std = np.sqrt(spread / np.where(hits > 1, hits - 1, np.nan))
    return Rehearsal(
        frequencies,
        hits / trials,
        low,
        mean[0],
        std[0],
        mean[1],
        std[1],
        mean[2],
        invented / trials,
        trials,
        force,
    )


def missed_words(result: Rehearsal, names: Sequence[str], least: float = 0.9) -> tuple[str, ...]:
    """A sentence for each mode that fewer than the share `least` of the trials found."""
    rows = zip(names, result.frequencies.tolist(), result.found.tolist(), strict=True)
    return tuple(
        f"mode {n} at {f:.4g} Hz is found in {100 * p:.0f} % of the trials"
        for n, f, p in rows
        if p < least
    )
