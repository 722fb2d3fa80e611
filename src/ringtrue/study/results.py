"""What each stage of a study leaves in the store: one frozen type a stage, nothing filled in later."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.correlate.complete import CompleteCorrelation
from ringtrue.correlate.frf import FrfComparison
from ringtrue.correlate.pairing import CorrelationTable
from ringtrue.correlate.track import Tracks
from ringtrue.identify.poles import StableDiagram
from ringtrue.plan.rehearsal import Rehearsal
from ringtrue.update.kfold import Held
from ringtrue.update.localise import SCARCE
from ringtrue.update.posterior import Posterior
from ringtrue.update.predict import RunUp, Unbalance
from ringtrue.update.proposal import Proposal


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is drawn of the model: skin triangles and lines, by group (property or region).

    Attributes
    ----------
    node : (n,) int64
    xyz : (n, 3) float64, m, basic
    triangles : (t, 3) int64, positions in `node`
    triangle_group : (t,) int64, positions in `groups`
    lines : (l, 2) int64
    line_group : (l,) int64
    groups : tuple of str
    """

    node: Int
    xyz: Float
    triangles: Int
    triangle_group: Int
    lines: Int
    line_group: Int
    groups: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ModelStage:
    """The deck and its modes."""

    title: str
    files: tuple[str, ...]
    units: str
    cards: dict[str, int]
    findings: tuple[str, ...]
    nodes: int
    dof: int
    mass: float
    cg: Float
    inertia: Float
    modes: ModeSet  # at the scene's translations: labels node+X.. of the scene nodes
    residuals: Float
    proof: str
    scene: Scene


@dataclass(frozen=True, slots=True, eq=False)
class PlanStage:
    """The planned test."""

    candidates: int
    target_modes: Int  # positions in the deck's modes
    test: TestModel  # the planned channels
    ambient: tuple[str, ...]  # channels planned for the ambient tests
    references: tuple[str, ...]  # hammer points
    auto_mac: Float  # (target, target)
    worst_off_diagonal: float
    frequency_step: float  # Hz
    block: float  # s
    record_length: float  # s
    damping: float  # assumed ratio
    expected_modes: Int  # positions in the deck's modes: rigid-body and first elastic ones, of the ambient tests
    expected_std_frequency: Float  # (expected,) relative, 1 sigma
    expected_std_damping: Float  # (expected,) relative
    rule: str  # the selection rule in words
    target_frequencies: Float = field(default_factory=lambda: np.zeros(0))  # (target,) Hz
    reasons: tuple[str, ...] = ()  # why each target mode is one
    reach: Float = field(default_factory=lambda: np.zeros(0))  # (target,) share of the best driving-point residue
    shown: Float = field(default_factory=lambda: np.zeros(0))  # (target,) MAC of the mode with its drawing
    left_by_loss: float = 1.0  # least share of information left when the worst sensor point fails
    loaded: Float = field(default_factory=lambda: np.zeros(0))  # (target,) relative shift by the mass of the sensors
    suspension: tuple[int, ...] = ()  # nodes to hang from
    suspension_motion: float = 0.0  # their largest motion in a target mode, squared, over the largest of the mode
    steady: bool = False  # the centre of gravity hangs between them
    rehearsal: Rehearsal | None = None  # the virtual test


@dataclass(frozen=True, slots=True, eq=False)
class RecordSummary:
    """One raw record as the report shows it."""

    name: str
    test: str  # test (a), (b), (c)
    excitation: str
    file: str
    channels: int
    rate: float
    duration: float  # s
    preview_time: Float  # (k,) s, thinned for drawing
    preview: Float  # (channel<=4, k), SI unit
    preview_channels: tuple[str, ...]
    psd_freqs: Float  # (f,) Hz
    psd: Float  # (channel<=4, f) one-sided, unit²/Hz
    notes: tuple[str, ...]  # harmonics found, channels dropped, band of the sensor correction
    unit: str = ""  # of the previewed channels; empty where they differ
    setup: str = ""  # of a roving test


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedRecord:
    """Modes of one record."""

    record: str
    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...]
    diagrams: tuple[StableDiagram, ...]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifyStage:
    """All identified modes."""

    test: TestModel
    records: tuple[RecordSummary, ...]
    ambient_records: tuple[IdentifiedRecord, ...]
    ambient: ModeSet  # merged over the records; may hold no mode
    ambient_uncertainty: Uncertainty
    ambient_reasons: tuple[str, ...]
    frfs: FrfSet | None
    cmif: Float  # (f, in)
    rejected_hits: tuple[str, ...]
    hammer: ModeSet | None
    hammer_uncertainty: Uncertainty | None
    hammer_reasons: tuple[str, ...]
    hammer_diagrams: tuple[StableDiagram, ...]
    hammer_model: ModalModel | None
    synthesis_error: Float  # (out, in) relative


@dataclass(frozen=True, slots=True, eq=False)
class FrfEvidence:
    """Measured FRFs against those of the initial and of the final model, in the band of the identified modes."""

    initial: FrfComparison
    final: FrfComparison
    lines: Float  # (l,) Hz, of the FDAC
    fdac_initial: Float  # (test line, model line) -1..1, over all responses and references
    fdac_final: Float


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a correlation rests on beside deviation and MAC."""

    measures: CompleteCorrelation
    auto_mac: Float  # (a, a) of the first set
    tracks: Tracks | None = None  # FE modes followed by their shapes at the channels: final, remodelled, initial
    frfs: FrfEvidence | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CompareStage:
    """Ambient against hammer."""

    table: CorrelationTable
    evidence: Evidence | None = None


@dataclass(frozen=True, slots=True)
class RemodelStep:
    """The deck after one step of the remodelling against the test."""

    reason: str
    pairs: int
    mean_deviation: float  # %
    max_deviation: float
    mean_mac: float  # %


@dataclass(frozen=True, slots=True, eq=False)
class CorrelateStage:
    """The model as delivered against the test, and after the stated remodelling."""

    reference: ModeSet  # the elastic test modes that the model is judged by, real shapes
    reference_uncertainty: Uncertainty
    rigid: ModeSet  # the rigid-body test modes
    rigid_uncertainty: Uncertainty
    left_out: Int  # positions in `reference` that the updating must not see
    initial: CorrelationTable
    remodelled: CorrelationTable
    rigid_initial: CorrelationTable
    remodelling: str  # in words
    diff: str  # unified diff of the deck
    fe_initial: ModeSet  # observed at the channels
    fe_remodelled: ModeSet
    evidence_initial: Evidence | None = None
    evidence: Evidence | None = None  # of the remodelled deck
    placed: str = ""  # how the test was laid onto the deck, in words
    history: tuple[RemodelStep, ...] = ()  # the deck as delivered, then each step


@dataclass(frozen=True, slots=True, eq=False)
class ConfiguredTest:
    """Another configuration: its deck before the updating against its own test."""

    name: str
    files: tuple[str, ...]  # of the deck
    source: str  # of the test modes, in words
    test: TestModel | None  # None: the channels are DOFs of the deck
    reference: ModeSet  # its elastic test modes, real shapes
    reference_uncertainty: Uncertainty
    rigid: ModeSet  # its rigid-body test modes
    rigid_uncertainty: Uncertainty
    left_out: Int  # positions in `reference` that the updating must not see
    initial: CorrelationTable
    fe_initial: ModeSet  # observed at the channels
    carried: tuple[str, ...]  # candidates and suspensions that its deck has
    notes: tuple[str, ...]  # fields of candidates that its deck lacks, or has with another value


@dataclass(frozen=True, slots=True, eq=False)
class ConfigurationsStage:
    """All other configurations before the updating."""

    items: tuple[ConfiguredTest, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DeliveredConfiguration:
    """Another configuration with what was found written into its deck, read back."""

    name: str
    files: tuple[str, ...]
    changes: tuple[str, ...]
    table: CorrelationTable
    observed: ModeSet  # at the channels


@dataclass(frozen=True, slots=True, eq=False)
class ConfiguredStage:
    """All other configurations after the updating."""

    items: tuple[DeliveredConfiguration, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LocaliseStage:
    """Where the remodelled deck is wrong, and which parameters the data ask for."""

    regions: tuple[str, ...]  # of the elements: groups of the scene, or cards without a property
    strain: Float  # (g,) share of the strain energy in the test shapes, expanded
    force: Float  # (g,) share of the force residual
    constitutive: Float  # (g,) share of the error in constitutive relation
    energy: Float  # (g,) share of the change of strain energy
    modes: Int  # (m,) positions in the reference modes
    relative: Float  # (m,) error in constitutive relation over the strain energy of each mode
    parameters: ParameterSet  # the candidates (p)
    what: tuple[str, ...]  # (p) in words
    elements: tuple[str, ...]  # (p) regions that each candidate changes, in words
    effect: Float  # (p,) of one prior standard deviation, in standard deviations of the residuals
    alone: Float  # (p,) posterior over prior standard deviation, all others known
    together: Float  # (p,) all candidates free
    explains: Float  # (p,) share of the squared frequency errors that each explains by itself
    made: int  # candidates that were made from the deck; 0: they are given
    dropped: tuple[str, ...]  # of these, what changes nothing
    screened: tuple[str, ...]  # of these, those that were not looked at closely
    proposal: Proposal

    @property
    def concentration(self) -> Float:
        """Error in constitutive relation over strain energy, share by share, (g,); NaN where nothing is strained."""
        known = self.strain > SCARCE
        return np.where(known, self.constitutive / np.where(known, self.strain, 1.0), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class SensitivityStage:
    """Sensitivities of the candidates and the choice of parameters."""

    names: tuple[str, ...]  # candidates
    d_frequency: Float  # (mode, candidate) ∂ln f/∂x
    d_mac: Float  # (mode, candidate) ∂MAC/∂x
    fe_modes: Int
    sets: dict[str, tuple[str, ...]]  # named parameter sets
    rules: dict[str, str]  # how each set was chosen
    clusters: tuple[str, ...]  # candidates that the data cannot tell apart, in words


@dataclass(frozen=True, slots=True, eq=False)
class SetResult:
    """One parameter set, updated."""

    name: str
    parameters: tuple[str, ...]
    factor: Float  # (p,) updated / initial
    std: Float  # (p,) relative standard deviation of the factor
    bounds: Float  # (p, 2)
    identifiability: Float  # (p,) posterior / prior std
    mean_deviation: float  # %, used modes
    max_deviation: float
    mean_mac: float  # %
    mean_deviation_left_out: float
    condition: float
    criterion: float  # AICc
    outcome: str
    objective: Float  # (iteration,)
    step: Float  # (iteration,)
    deviation: Float  # (iteration,) mean |Δf| %
    mac: Float  # (iteration,) mean MAC %
    path: Float  # (iteration, p) factors
    gradient: float  # norm at the end, relative to the start
    settings: str = ""  # what it does otherwise than [update], in words


@dataclass(frozen=True, slots=True, eq=False)
class DataResult:
    """What was measured beside the modes, (n,) each, against the model before and after the updating."""

    name: str
    kind: str  # frf, anti-resonances, static or mass
    configuration: str  # empty: the deck of the study
    labels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Float  # NaN where before and after are deviations from it
    before: Float
    after: Float
    error: Float  # one standard deviation that the updating assumed


@dataclass(frozen=True, slots=True, eq=False)
class UpdateStage:
    """The parameter sets compared and the chosen one."""

    sets: tuple[SetResult, ...]
    chosen: int
    why: str
    left_out: Int  # positions in the reference modes, fixed before
    initial_values: dict[str, float]  # of the chosen parameters: first target's value in the deck
    updated_values: dict[str, float]
    regions: dict[str, tuple[int, ...]]  # parameter -> scene groups that it changes
    data: tuple[DataResult, ...] = ()  # what was measured beside the modes


@dataclass(frozen=True, slots=True, eq=False)
class TuneStage:
    """Rigid-body tuning of the suspension."""

    before: CorrelationTable
    after: CorrelationTable
    factors: dict[str, float]
    std: dict[str, float]
    ambiguity: tuple[str, ...] = ()  # pairings that the test leaves open, with their weight, in words
    flags: tuple[str, ...] = ()  # factors that are not plausible


@dataclass(frozen=True, slots=True, eq=False)
class FinalStage:
    """The delivered deck, read back: correlation, damping and FRFs."""

    files: tuple[str, ...]
    changes: tuple[str, ...]  # "anchors.bdf:12 PBUSH 31 K3 1.2e9 -> 2.9e9"
    table: CorrelationTable
    rigid: CorrelationTable
    modes: ModeSet  # at the scene's translations
    observed: ModeSet  # at the channels
    damping: Float  # (m,) taken over from the test or interpolated
    damping_from: tuple[str, ...]  # per mode: "test mode 3" or "interpolated"
    frf_freqs: Float  # (f,)
    frf_channels: tuple[str, ...]  # "out / in"
    frf_test: Complex  # (f, k)
    frf_initial: Complex
    frf_final: Complex
    evidence: Evidence | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DampedRegions:
    """Loss factors and dashpots, (k,) each."""

    names: tuple[str, ...]
    targets: tuple[str, ...]  # "MAT1 7 GE"
    natures: tuple[str, ...]  # "material", "joint" or "dashpot"
    coefficients: Float  # loss factor, or force over velocity in deck units
    covariance: Float  # (k, k)
    expected: Float  # before the data
    expected_std: Float

    @property
    def std(self) -> Float:
        """(k,) float64."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class DampedModes:
    """Damping ratios of the paired modes, (t,) each."""

    fe: Int  # positions in the final modes
    test: tuple[str, ...]  # "ambient mode 3", "test mode 1"
    used: Bool  # False: left out, its damping is a prediction
    hertz: Float  # of the test
    measured: Float
    measured_std: Float
    before: Float
    after: Float
    after_std: Float
    frf_before: Float  # relative error of the FRFs around the mode; NaN where there is none
    frf_after: Float

    def spread(self, used: bool) -> tuple[float, float]:
        """Root mean square relative deviation from the test before and after, of the modes used or left out."""
        at = self.used == used
        if not at.any():
            return float("nan"), float("nan")
        before, after = (float(np.sqrt(np.mean((x / self.measured - 1)[at] ** 2))) for x in (self.before, self.after))
        return before, after


@dataclass(frozen=True, slots=True, eq=False)
class DampingStage:
    """Damping by region and by mode; None where the test tells nothing of it."""

    why: str  # why there is nothing; empty where there is
    regions: DampedRegions | None
    modes: DampedModes | None
    misfit: float  # root mean square deviation of the ratios over the error of test and model
    before: str  # what damps the model before, in words
    flags: tuple[str, ...]  # what is not plausible, in words
    files: tuple[str, ...]  # of the damped deck, if it was written
    changes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyStage:
    """How well the chosen parameters are known, and what the delivered model predicts with bands."""

    parameters: ParameterSet
    factor: Float  # (p,) as delivered
    std: Float  # (p,) of x, posterior
    interval: Float  # (p, 2) of the factor
    prior: Float  # (p, 2) the same interval before the test
    ratio: Float  # (p,) posterior over prior standard deviation
    moved: Bool  # (p,) the data have told something of it
    correlation: Float  # (p, p)
    level: float  # of the intervals and bands
    discrepancy: Float  # (2,) of the model: relative frequency and 1 − MAC, from modes left out
    assumed: Float  # (2,) the same as the updating assumed
    test: Float  # (m,) Hz, the elastic test modes
    predicted: Float  # (m,) Hz, NaN without a partner
    band: Float  # (m, 2) Hz, where the measured frequency is expected
    parts: Float  # (m, 3) relative standard deviations: parameters, test, model
    used: Bool  # (m,) seen by the updating
    inside: Bool  # (m,) the band holds the measured frequency
    held: Held  # the used modes, predicted fold by fold
    flags: tuple[str, ...]  # what of it is not plausible
    draws: Float = field(default_factory=lambda: np.zeros((0, 0)))  # (s, p) factors sampled from the posterior
    sampled: Float = field(default_factory=lambda: np.zeros((0, 2)))  # (p, 2) their intervals
    acceptance: float = 0.0  # share of accepted moves
    independent: float = 0.0  # effective number of draws
    converged: bool = True  # the chains are long enough and agree


@dataclass(frozen=True, slots=True, eq=False)
class PredictStage:
    """Running a rotor on the validated model."""

    rotor: int  # node
    axis: str
    unbalance: Unbalance
    run_up: RunUp
    posterior: Posterior  # of the elastic and suspension parameters
    discrepancy: float  # relative, of a frequency, from the modes left out of the updating (all pairs if none was)
    damping: str  # where it comes from, in words
    residual: float  # of the reduced model at the worst speed, relative to the load
    flags: tuple[str, ...]  # parameters that are not plausible


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """Where everything came from."""

    version: str
    python: str
    packages: dict[str, str]
    platform: str
    seed: int
    started: str
    inputs: dict[str, str]  # file -> SHA-256
    settings: str  # the resolved study.toml
    timings: dict[str, float]  # stage -> s
    home: str = "."  # the folder of study.toml, seen from that of the store
