"""A virtual test of the plan: signals with the planned points, hammer and sensors; identified and
correlated.

What comes out are the modes that will be found, with which probability and which error, before
anyone goes on site.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy import fft
from scipy.special import betaincinv

from ringtrue.core.arrays import Bool, Float, Int, freeze_arrays, freeze_fields
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModalModel, ModeSet, Norm
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.errors import DataError, InputError
from ringtrue.identification.ambient.pipeline import AmbientSettings, identify_ambient
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.signal.frf import estimate_frf
from ringtrue.signal.impacts import HammerSettings
from ringtrue.virtual.excitation import Pulses, pulse_spectrum
from ringtrue.virtual.measurements import (
    Background,
    HammerPlan,
    SimulatedImpacts,
    hammer_record,
    strike,
)
from ringtrue.virtual.sensors import (
    FORCE_CELL,
    ICP,
    Chain,
    Sensor,
    decay_time,
    lines,
    record_volts,
    response_spectrum,
    white,
)


@dataclass(frozen=True, slots=True)
class VirtualChain:
    """Recorder and hammer of a virtual test.

    Attributes
    ----------
    rate : float
        Over fmax: the recorder's filter is flat up to 0.4 of the rate.
    impacts : int
        Impacts that estimate a coherence.
    smallest : float
        Range of the smallest impact hammers, N.
    headroom : float
        Range over the RMS: nothing clips.
    most : int
        Samples of all channels of a record.
    """

    rate: float = 3.2
    impacts: int = 10
    smallest: float = 200.0
    headroom: float = 6.0
    most: int = 40_000_000


CHAIN = VirtualChain()


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A structure as planned to be measured.

    Attributes
    ----------
    frequencies : (m,) float64, Hz
        All modes that take part, those outside of the band too; rigid-body modes, free or on a soft
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
        freeze_arrays(self)
        m = self.frequencies.size
        o = len(self.channels)
        i = len(self.references)
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
        return (self.frequencies >= self.fmin) & (self.frequencies <= self.fmax)


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
        Good impacts at each reference, unless `hammer` says so.
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
    pairing: PairingSettings = field(
        default_factory=lambda: PairingSettings(0.8, 0.03, reach=1.0)
    )

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
            raise InputError(
                f"virtual test: coherence {self.coherence} must be above 0, 1 at most"
            )


@dataclass(frozen=True, slots=True, eq=False)
class VirtualTest:
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
        Largest planned peak of an impact, N; of an ambient test the density of the forces, N/√Hz.
    background : float, N/√Hz
        White force at each reference besides the impacts.
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

    def take(self, modes: Int) -> VirtualTest:
        """The chosen modes (k,) of the band, in the given order."""
        arrays = [
            f.name
            for f in fields(self)
            if isinstance(getattr(self, f.name), np.ndarray)
        ]
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
    w = 2 * np.pi * frequencies[elastic]
    z = damping[elastic]
    wd = w * np.sqrt(1 - z**2)
    rigid = plan.outputs[:, ~elastic] @ plan.inputs[:, ~elastic].T
    return ModalModel(
        poles=-z * w + 1j * wd,
        shapes=plan.outputs[:, elastic] / (2j * wd),
        participation=plan.inputs[:, elastic].T.astype(np.complex128),
        lower=rigid.astype(np.complex128),
        upper=np.zeros(rigid.shape, dtype=np.complex128),
        outputs=tuple(Channel(c, "acceleration", "m/s^2") for c in plan.channels),
        inputs=tuple(Channel(c, "force", "N") for c in plan.references),
        norm=Norm.MASS,
    )


def trials(
    plan: Planned,
    conditions: Conditions,
    find: Callable[[ModalModel, np.random.Generator], ModeSet],
    rng: np.random.Generator,
    *,
    force: float,
    progress: Progress = quiet,
) -> VirtualTest:
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
        For the reader.
    """
    target = plan.targets
    zeta = np.full(plan.frequencies.size, conditions.damping)
    error = np.full((3, conditions.trials, int(target.sum())), np.nan)
    invented = 0
    for k, stream in enumerate(rng.spawn(conditions.trials)):
        progress(k / conditions.trials, f"virtual test {k + 1} of {conditions.trials}")
        f = plan.frequencies * (
            1 + conditions.frequency_scatter * stream.standard_normal(zeta.size)
        )
        z = np.minimum(
            zeta
            * np.exp(conditions.damping_scatter * stream.standard_normal(zeta.size)),
            0.5,
        )
        truth = ModeSet(
            frequencies=f[target],
            damping=z[target],
            shapes=plan.outputs[:, target],
            labels=plan.channels,
            norm=Norm.MASS,
            source="model",
        )
        truth = truth.take(np.argsort(truth.frequencies, kind="stable"))
        back = np.argsort(f[target], kind="stable")
        try:
            modes = _whole(find(modal_model(plan, f, z), stream), plan.channels)
        except DataError:  # no pole found: every mode is missed in this trial
            continue
        pairs = pair_modes(truth, modes, conditions.pairing, names=("model", "test"))
        of_frequency = modes.frequencies[pairs.b] / truth.frequencies[pairs.a] - 1
        of_damping = modes.damping[pairs.b] / truth.damping[pairs.a] - 1
        error[:, k, back[pairs.a]] = np.stack([of_frequency, of_damping, pairs.mac])
        inside = (modes.frequencies > plan.fmin) & (modes.frequencies < plan.fmax)
        invented += int(inside[pairs.unpaired_b].sum())
    return _outcome(plan.frequencies[target], error, invented, force)


def _whole(modes: ModeSet, channels: tuple[str, ...]) -> ModeSet:
    """The modes at all channels of the plan; nothing was seen at those that the test left out, as
    drowned in noise.
    """
    shapes = np.zeros((len(channels), len(modes)), dtype=modes.shapes.dtype)
    kept = np.flatnonzero(np.isin(channels, modes.channels))
    shapes[kept] = modes.rows([channels[i] for i in kept.tolist()]).shapes
    return replace(modes, shapes=shapes, labels=channels)


def _outcome(
    frequencies: Float, error: Float, invented: int, force: float
) -> VirtualTest:
    trials = error.shape[1]
    there = np.isfinite(error[0])
    hits = there.sum(axis=0)
    low = np.where(
        hits > 0, betaincinv(np.maximum(hits, 1), trials - hits + 1, 0.05), 0.0
    )
    some = np.where(hits > 0, hits, np.nan)
    value = np.where(there, error, 0.0)
    mean = value.sum(axis=1) / some
    spread = np.where(there, (error - mean[:, None]) ** 2, 0.0).sum(axis=1)
    std = np.sqrt(spread / np.where(hits > 1, hits - 1, np.nan))
    return VirtualTest(
        frequencies=frequencies,
        found=hits / trials,
        at_least=low,
        frequency_bias=mean[0],
        frequency_std=std[0],
        damping_bias=mean[1],
        damping_std=std[1],
        mac=mean[2],
        invented=invented / trials,
        trials=trials,
        force=force,
    )


def rarely_found_modes(
    result: VirtualTest, names: Sequence[str], least: float = 0.9
) -> tuple[str, ...]:
    """A sentence for each mode that fewer than the share `least` of the trials found."""
    rows = zip(names, result.frequencies.tolist(), result.found.tolist(), strict=True)
    return tuple(
        f"mode {n} at {f:.4g} Hz is found in {100 * p:.0f} % of the trials"
        for n, f, p in rows
        if p < least
    )


def fitting_hammer(
    model: ModalModel, fmax: float, sensor: Sensor, *, hits: int = 5
) -> HammerPlan:
    """A hammer whose impacts fill half the sensors' range at most and reach to `fmax`.

    The tip gives contact times of 0.4 to 0.7 over fmax (first zero of a half-sine at 1.5 over the
    time), the block lasts until the slowest mode has decayed to 1 %.

    Parameters
    ----------
    model : ModalModel
    fmax : float, Hz
    sensor : Sensor
        Of the responses.
    """
    rate = CHAIN.rate * fmax
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


def _peak_response(
    model: ModalModel, contact: float, block: float, rate: float
) -> float:
    """Largest acceleration of any output by an impact of 1 N at any input."""
    n = 2 * int(np.ceil(0.5 * min(block, 2000 / rate) * rate))
    top = 0.0
    for i in range(len(model.inputs)):  # a handful of references
        impact = Pulses(
            np.array([4 / rate]),
            np.array([contact]),
            np.array([2 / np.pi * contact]),
            np.array([i]),
        )
        force = pulse_spectrum(impact, len(model.inputs), n, rate)
        top = max(
            top,
            float(
                np.abs(
                    fft.irfft(response_spectrum(model, force, lines(n, rate)), n)
                ).max()
            ),
        )
    return top


def simulate_impact_test(
    plan: Planned,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    progress: Progress = quiet,
) -> VirtualTest:
    """Test the plan on signals: strike, record, estimate FRFs, identify and correlate, trial by
    trial.

    Each trial draws other dampings, frequencies, calibration errors, impacts and noise.

    Parameters
    ----------
    plan : Planned
    conditions : Conditions
    rng : Generator
    progress : callable (fraction, text)
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
            measured(model, hammer, conditions, CHAIN.rate * plan.fmax, stream),
            settings,
        ).modes

    result = trials(
        plan, conditions, find, rng, force=hammer.peak[1], progress=progress
    )
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
    impacts without windows is mended by what FRFs of a virtual test tell; twice, as windows depend
    on noise.

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
    impacts = replace(hammer, hits=max(hammer.hits, CHAIN.impacts))
    for _ in range(2):
        frfs = measured(
            model,
            impacts,
            replace(conditions, background=density),
            CHAIN.rate * band[1],
            rng,
        )
        at = tuple(np.array(frfs.driving_points()).T)  # elsewhere may be no motion
        seen = frfs.coherence[(frfs.freqs > band[0]) & (frfs.freqs < band[1])][:, *at]
        seen = seen[np.isfinite(seen)]
        if not seen.size:  # too loud for two good impacts
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
    """FRFs as the crew would have them: impacts at each input, recorded by the sensors with their
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
    limit = sensors[0].range / sensors[0].sensitivity
    records = [
        _record(model, strike(hammer, i, limit, rate, rng), chain, conditions, rng)
        for i in range(len(model.inputs))
    ]
    full = {
        c.id: s.range / s.sensitivity
        for r in records
        for c, s in zip(r.channels, sensors, strict=True)
    }
    block = round(hammer.block * rate) / rate
    settings = HammerSettings(
        block=block - hammer.pretrigger, pretrigger=hammer.pretrigger
    )
    return estimate_frf(records, settings, full_scale=full)[0]


def _cell(limit: float) -> Sensor:
    """A force cell of so many N: the noise of a smaller hammer is smaller, too."""
    size = max(limit, CHAIN.smallest) * FORCE_CELL.sensitivity / FORCE_CELL.range
    floor = replace(FORCE_CELL.floor, density=FORCE_CELL.floor.density * size)
    return replace(FORCE_CELL, sensitivity=FORCE_CELL.range / limit, floor=floor)


def _record(
    model: ModalModel,
    impacts: SimulatedImpacts,
    chain: Chain,
    conditions: Conditions,
    rng: np.random.Generator,
) -> TimeHistory:
    hammer, rate = impacts.plan, impacts.rate
    samples = 2 * int(
        np.ceil(0.5 * (float(impacts.times[-1]) + hammer.block + hammer.rest) * rate)
    )
    background = Background(
        white(len(model.inputs), conditions.background, samples, rate, rng)
    )
    volts, _, _ = hammer_record(
        model, impacts, chain, background=background, samples=samples, rng=rng
    )
    data = volts / np.array([s.sensitivity for s in chain.sensors])[:, None]
    struck = model.inputs[int(impacts.pulses.at[0])]
    force = replace(struck, id=f"F:{struck.id}")
    return TimeHistory(
        data, rate, (force, *model.outputs), f"virtual test, {struck.id}"
    )


@dataclass(frozen=True, slots=True)
class AmbientConditions:
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
    return CHAIN.most / (channels * CHAIN.rate * fmax)


def simulate_ambient_test(
    plan: Planned,
    ambience: AmbientConditions,
    conditions: Conditions,
    rng: np.random.Generator,
    *,
    progress: Progress = quiet,
) -> VirtualTest:
    """Test an ambient plan on signals: record under random forces, identify by SSI and correlate,
    trial by trial.

    Parameters
    ----------
    plan : Planned
        Its inputs are where and along which the forces act.
    ambience : AmbientConditions
    conditions : Conditions
        Its sensor, trials, scatter and pairing count.
    rng : Generator
    """
    settings = AmbientSettings(0.97 * plan.fmin or None, 1.03 * plan.fmax)
    # forces at many rows are, for the modes, as many as there are modes: QR keeps the covariance of
    # ΦᵀF
    inputs = np.asarray(np.linalg.qr(plan.inputs, mode="r"))
    few = replace(
        plan, inputs=inputs, references=tuple(f"F{k}" for k in range(len(inputs)))
    )

    def find(model: ModalModel, stream: np.random.Generator) -> ModeSet:
        return identify_ambient(
            recorded(model, ambience, conditions, CHAIN.rate * plan.fmax, stream),
            settings,
        ).modes

    return trials(few, conditions, find, rng, force=ambience.density, progress=progress)


def recorded(
    model: ModalModel,
    ambience: AmbientConditions,
    conditions: Conditions,
    rate: float,
    rng: np.random.Generator,
) -> TimeHistory:
    """The accelerations as the crew would have them, with the noise of the sensors; a range that
    they do not fill.

    Parameters
    ----------
    model : ModalModel
    ambience : AmbientConditions
    conditions : Conditions
    rate : float, Hz
    """
    samples = 2 * fft.next_fast_len(
        int(np.ceil(0.5 * ambience.duration * rate)), real=True
    )
    forces = white(len(model.inputs), ambience.density, samples, rate, rng)
    motion = response_spectrum(model, forces, lines(samples, rate))
    loudest = np.sqrt(2 * (np.abs(motion) ** 2).sum(axis=1).max()) / samples
    wide = max(
        conditions.sensor.range,
        CHAIN.headroom * conditions.sensor.sensitivity * float(loudest),
    )
    chain = Chain.draw(
        (replace(conditions.sensor, range=wide),) * len(model.outputs), rng
    )
    volts, _ = record_volts(motion, chain, samples, rate, rng)
    return TimeHistory(
        volts / conditions.sensor.sensitivity,
        rate,
        model.outputs,
        "virtual ambient test",
    )
