"""What each stage of a study leaves in the store: one frozen type a stage."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ringtrue.checks.materials import MassProperties
from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import Suspect
from ringtrue.correlation.conditions import ConditionSlopes
from ringtrue.correlation.frf import FrfComparison
from ringtrue.correlation.measures import CompleteCorrelation
from ringtrue.correlation.pairing import Tracks
from ringtrue.correlation.sensor_mounting import Mending
from ringtrue.correlation.table import CorrelationTable
from ringtrue.identification.common.diagram import (
    IdentificationDiagram,
    SpectrumAccount,
    identification_diagram,
)
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.identification.frf.lines import cmif
from ringtrue.planning.exciters import LEAST_REACH
from ringtrue.planning.plan_files import Setups
from ringtrue.planning.virtual_test import VirtualTest
from ringtrue.shapes import worst_off_diagonal
from ringtrue.signal.impacts import ImpactReport as ImpactReport
from ringtrue.updating.identifiability import FLAGS, Flag, kept, unproven
from ringtrue.updating.prediction import RunUp, Unbalance
from ringtrue.updating.selection.form import FormFindings
from ringtrue.updating.selection.localisation import SCARCE
from ringtrue.updating.selection.missing_members import MissingMember
from ringtrue.updating.selection.proposal import Proposal
from ringtrue.updating.uncertainty import Posterior
from ringtrue.updating.validation import Held, Misfit


@dataclass(frozen=True, slots=True)
class Seat:
    """Where a channel of a test is read on a deck."""

    channel: str  # as the test calls it
    sensor: str  # on the sensor sheet
    sign: int  # -1: the channel reads that sensor the other way
    point: int  # of the sheet
    nodes: tuple[int, ...]  # of the deck; several with match = rigid
    distance: float  # m, from the point to the nearest of them


@dataclass(frozen=True, slots=True, eq=False)
class FrfEvidence:
    """Measured FRFs against those of the initial and of the final model, in the band of the
    identified modes.

    Attributes
    ----------
    initial, final : FrfComparison
    lines : (l,) float64, Hz
        Of the FDAC.
    fdac_initial, fdac_final : (l, l) float64, -1..1
        Test line, model line; over all responses and references.
    """

    initial: FrfComparison
    final: FrfComparison
    lines: Float
    fdac_initial: Float
    fdac_final: Float

    @property
    def worse(self) -> tuple[str, ...]:
        """Excitation points where any measure of the final model is worse than the initial one."""
        both = zip(self.initial.by_input(), self.final.by_input(), strict=True)
        return tuple(now.name for before, now in both if now.worse_than(before))


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a correlation rests on besides deviation and MAC.

    Attributes
    ----------
    measures : CompleteCorrelation
    auto_mac : (a, a) float64
        Of the first set.
    tracks : Tracks, optional
        FE modes followed by their shapes at the channels: final, remodelled if it was, initial.
    frfs : FrfEvidence, optional
    """

    measures: CompleteCorrelation
    auto_mac: Float
    tracks: Tracks | None = None
    frfs: FrfEvidence | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CompareStage:
    """Ambient against hammer."""

    table: CorrelationTable
    evidence: Evidence | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ConditionsStage:
    """What differs between the records of a test: days, temperatures, levels.

    Attributes
    ----------
    slopes : ConditionSlopes
        Of the merged ambient modes.
    scatter : float
        Relative standard deviation with which a test repeats frequencies on another day; NaN where
        none was repeated.
    notes : tuple of Note
        What was found.
    """

    slopes: ConditionSlopes
    scatter: float
    notes: tuple[Note, ...]


@dataclass(frozen=True, slots=True)
class RemodelStep:
    """The deck after one step of the remodelling against the test."""

    reason: str
    pairs: int
    mean_deviation: float  # %
    max_deviation: float
    mean_mac: float  # %
    mean_subspace_mac: float  # %


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Test shapes on all of a deck."""

    method: str
    modes: ModeSet  # at the scene's translations
    # (m,) of the readings that the expanded shape does not reproduce, relative
    misfit: Float


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceModes:
    """The test modes that a deck is judged by, real shapes.

    Attributes
    ----------
    elastic : ModeSet
        Of the hammer test where there is one.
    elastic_std : Uncertainty
    rigid : ModeSet
        Rigid-body modes, of the ambient test where there is one.
    rigid_std : Uncertainty
    left_out : (k,) int64
        Positions of the elastic modes that the updating must not see.
    gaps : tuple of str
        Elastic modes and channels of the test that are not used, in words.
    """

    elastic: ModeSet
    elastic_std: Uncertainty
    rigid: ModeSet
    rigid_std: Uncertainty
    left_out: Int
    gaps: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SensorPlacement:
    """Where the sensors of a test are read on a deck.

    Attributes
    ----------
    seats : tuple of Seat
        Empty where the channels are DOFs of the deck.
    mendings : tuple of Mending
        Other mountings of the sensors that explain the test better.
    alignment : str
        How the test was laid onto the deck, in words.
    rigid : tuple of Suspect
        Channels that contradict the rigid-body motion of the others.
    """

    seats: tuple[Seat, ...] = ()
    mendings: tuple[Mending, ...] = ()
    alignment: str = ""
    rigid: tuple[Suspect, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Remodelling:
    """The stated change of the deck before the updating.

    Attributes
    ----------
    reason : str
        Of all steps, in words.
    diff : str
        Unified diff of the deck.
    history : tuple of RemodelStep
        The initial deck, then each step.
    """

    reason: str
    diff: str
    history: tuple[RemodelStep, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CorrelateStage:
    """The initial model against the test, and after the stated remodelling.

    Attributes
    ----------
    reference : ReferenceModes
    initial, remodelled : CorrelationTable
    rigid_initial : CorrelationTable
    fe_initial, fe_remodelled : ModeSet
        At the channels.
    evidence_initial, evidence : Evidence, optional
        Of the initial and of the remodelled deck.
    remodelling : Remodelling, optional
    sensors : SensorPlacement
        On the initial deck.
    expanded : Expansion, optional
        The elastic test shapes on the remodelled deck, where the study asks for them.
    notes : tuple of str
        What of the test is not used, and test modes whose FE modes cannot be found.
    """

    reference: ReferenceModes
    initial: CorrelationTable
    remodelled: CorrelationTable
    rigid_initial: CorrelationTable
    fe_initial: ModeSet
    fe_remodelled: ModeSet
    evidence_initial: Evidence | None = None
    evidence: Evidence | None = None
    remodelling: Remodelling | None = None
    sensors: SensorPlacement = SensorPlacement()
    expanded: Expansion | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ConfiguredTest:
    """Another configuration: its deck before the updating against its own test.

    Attributes
    ----------
    name : str
    files : tuple of str
        Of the deck.
    source : str
        Of the test modes, in words.
    test : TestModel, optional
        None: the channels are DOFs of the deck.
    reference : ReferenceModes
    initial : CorrelationTable
    fe_initial : ModeSet
        At the channels.
    carried : tuple of str
        Candidates and suspensions that its deck has.
    sensors : SensorPlacement
    notes : tuple of str
        Fields of candidates that its deck does not have, or has with another value.
    """

    name: str
    files: tuple[str, ...]
    source: str
    test: TestModel | None
    reference: ReferenceModes
    initial: CorrelationTable
    fe_initial: ModeSet
    carried: tuple[str, ...]
    sensors: SensorPlacement
    notes: tuple[str, ...]


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
class RecordPreview:
    """Some channels of a record (c), thinned for drawing.

    Attributes
    ----------
    channels : tuple of str
    unit : str
    time : (k,) float64, s
    signal : (c, k) float64, SI unit
    freqs : (f,) float64, Hz
    psd : (c, f) float64, unit²/Hz, one-sided
    """

    channels: tuple[str, ...]
    unit: str
    time: Float
    signal: Float
    freqs: Float
    psd: Float


@dataclass(frozen=True, slots=True, eq=False)
class RecordSummary:
    """One raw record as the report shows it.

    Attributes
    ----------
    name, test, excitation, file : str
    channels : int
    rate : float, Hz
    duration : float, s
    notes : tuple of str
        Harmonics, band of the sensor correction.
    setup : str
        Of a roving test.
    preview : RecordPreview, optional
        None where the record is listed alone.
    channel_notes : tuple of Note
        On channels.
    hits : tuple of int
        Those kept, and all; zeros where none were sought.
    """

    name: str
    test: str
    excitation: str
    file: str
    channels: int
    rate: float
    duration: float
    notes: tuple[str, ...]
    setup: str = ""
    preview: RecordPreview | None = None
    channel_notes: tuple[Note, ...] = ()
    hits: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedModes:
    """Modes with the evidence for each.

    Attributes
    ----------
    modes : ModeSet
        The natural ones.
    uncertainty : Uncertainty
    reasons : tuple of str
    diagrams : tuple of StableDiagram
        One a band.
    remarks : tuple of str
        What is particular of each mode, in six words; empty where nothing is known to be.
    others : OtherCandidates
        Doubtful modes and harmonics.
    account : SpectrumAccount
        Machines, and peaks that nothing explains.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...] = ()
    diagrams: tuple[StableDiagram, ...] = ()
    remarks: tuple[str, ...] = ()
    others: OtherCandidates = field(default_factory=OtherCandidates.none)
    account: SpectrumAccount = field(default_factory=SpectrumAccount)

    def __len__(self) -> int:
        return len(self.modes)

    @property
    def diagram(self) -> IdentificationDiagram:
        """Poles, spectrum, and the modes of each class in one view of the whole band."""
        remarks = self.remarks or ("",) * len(self)
        natural = (self.modes, self.uncertainty, remarks)
        return identification_diagram(self.diagrams, natural, self.others, self.account)


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedRecord(IdentifiedModes):
    """Modes of one record, or of a test.

    Attributes
    ----------
    record : str
    date : str
        As the log has it.
    temperature : float, °C
        NaN where the log has none.
    level : (m,) float64, m/s
        RMS velocity at the frequency of each mode, over all channels; NaN where their quantity is
        not known.
    merged : (m,) int64
        Which mode of all ambient records each is.
    """

    record: str = ""
    date: str = ""
    temperature: float = float("nan")
    level: Float = field(default_factory=lambda: np.zeros(0))
    merged: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class IdentifyStage:
    """All identified modes.

    Attributes
    ----------
    test : TestModel
    ambient : IdentifiedModes
        Merged over the records; may hold no mode.
    hammer : IdentifiedModes, optional
        Of the test with hammer or shakers, of FRFs, or of a file of modes.
    source : str
        Where the modes in `hammer` come from.
    records : tuple of RecordSummary
    ambient_records : tuple of IdentifiedRecord
    merge_notes : tuple of str
        What was undone in an ambient record before merging.
    frfs : FrfSet, optional
    frf_notes : tuple of str
        Of FRFs that were given; those of hammer records are with the records.
    channel_notes : tuple of Note
        On channels of given FRFs, on those that are not used, and on those that read otherwise in
        one setup.
    synthesis_error : (out, in) float64, relative
    hits : tuple of ImpactReport
        Of all records with a hammer; `source` is the name of the record.
    """

    test: TestModel
    ambient: IdentifiedModes
    hammer: IdentifiedModes | None
    source: str = "hammer test"
    records: tuple[RecordSummary, ...] = ()
    ambient_records: tuple[IdentifiedRecord, ...] = ()
    merge_notes: tuple[str, ...] = ()
    frfs: FrfSet | None = None
    frf_notes: tuple[str, ...] = ()
    channel_notes: tuple[Note, ...] = ()
    synthesis_error: Float = field(default_factory=lambda: np.zeros((0, 0)))
    hits: tuple[ImpactReport, ...] = ()

    @property
    def cmif(self) -> Float:
        """Complex mode indicator function of the FRFs, (f, in)."""
        return np.zeros((0, 0)) if self.frfs is None else cmif(self.frfs.data)


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
    triangle_element : (t,) int64
        Element numbers; empty where they are not known.
    line_element : (l,) int64
    """

    node: Int
    xyz: Float
    triangles: Int
    triangle_group: Int
    lines: Int
    line_group: Int
    groups: tuple[str, ...]
    triangle_element: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    line_element: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


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
    mass: MassProperties
    modes: ModeSet  # at the scene's translations: labels node+X.. of the scene nodes
    residuals: Float
    proof: str
    scene: Scene


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


@dataclass(frozen=True, slots=True, eq=False)
class SensorPlan:
    """Where is measured.

    Attributes
    ----------
    candidates : int
        Sensors that were chosen from.
    test : TestModel
        The planned channels.
    ambient : tuple of str
        Channels of the ambient tests.
    auto_mac : (t, t) float64
        Of the target modes at the channels.
    lost : int
        Points that may fail.
    left_by_loss : float
        Least share of information left when the worst of them fail.
    shown : (t,) float64
        MAC of each target mode with its drawing; empty where points are not on what is drawn.
    loaded : (t,) float64
        Relative shift of each target mode by the mass of the sensors, NaN at 0 Hz; empty where no
        mass is stated.
    setups : Setups, optional
        Where fewer sensors are at hand than planned.
    """

    candidates: int
    test: TestModel
    ambient: tuple[str, ...]
    auto_mac: Float
    lost: int = 1
    left_by_loss: float = 1.0
    shown: Float = field(default_factory=lambda: np.zeros(0))
    loaded: Float = field(default_factory=lambda: np.zeros(0))
    setups: Setups | None = None

    @property
    def worst_auto_mac(self) -> float:
        """Largest MAC between two target modes."""
        return worst_off_diagonal(self.auto_mac)

    def roving(self, setup: int) -> list[int]:
        """Points that are measured in one setup alone; in all with -1."""
        if self.setups is None:
            return []
        at = self.test.at.reshape(self.setups.setup.size, -1)[:, 0]
        return list(dict.fromkeys(at[self.setups.roving(setup)].tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationPlan:
    """Where the structure is excited.

    Attributes
    ----------
    references : tuple of str
        Excitation points.
    reach : (t,) float64
        Share of the best driving-point residue of each target mode.
    reachable : (t,) float64
        The same of all points that can be excited.
    sets : tuple of tuples of str
        Sets of points, ranked.
    set_reach : (set, t) float64
    """

    references: tuple[str, ...]
    reach: Float
    reachable: Float
    sets: tuple[tuple[str, ...], ...]
    set_reach: Float

    @property
    def missed(self) -> Bool:
        """Which target modes no reference excites well."""
        return self.reach < LEAST_REACH

    @property
    def unreachable(self) -> Bool:
        """Which target modes no point that can be excited excites well."""
        return self.reachable < LEAST_REACH

    @property
    def least_reach(self) -> Float:
        """Reach, by each of `sets`, of the mode that it excites worst of those that a point can
        reach (all if none).
        """
        some = ~self.unreachable if not self.unreachable.all() else self.unreachable
        return np.asarray(self.set_reach[:, some].min(axis=1, initial=1.0))

    @property
    def missed_by_sets(self) -> list[list[int]]:
        """Positions of the target modes that each of `sets` misses."""
        return [np.flatnonzero(r < LEAST_REACH).tolist() for r in self.set_reach]


@dataclass(frozen=True, slots=True, eq=False)
class AcquisitionPlan:
    """How long is measured, and how precise the ambient tests will be.

    Attributes
    ----------
    damping : float
        Assumed ratio.
    frequency_step : float, Hz
    block : float, s
    averages : int
        Impacts at each reference for the wanted error of the FRFs.
    record_length : float, s
        Of an ambient record.
    segments : int
        Blocks of that length in the ambient record.
    modes : (e,) int64
        Positions in the deck's modes: rigid-body and first elastic ones, of the ambient tests.
    std_frequency, std_damping : (e,) float64
        Relative, 1 sigma.
    """

    damping: float
    frequency_step: float
    block: float
    averages: int
    record_length: float
    segments: int
    modes: Int
    std_frequency: Float
    std_damping: Float


@dataclass(frozen=True, slots=True, eq=False)
class SuspensionPlan:
    """Where the structure hangs.

    Attributes
    ----------
    nodes : tuple of int
    motion : float
        Their largest motion in a target mode, squared, over the largest of the mode.
    steady : bool
        The centre of gravity hangs between them.
    """

    nodes: tuple[int, ...]
    motion: float
    steady: bool


@dataclass(frozen=True, slots=True, eq=False)
class PlanStage:
    """The planned test.

    Attributes
    ----------
    target_modes : (t,) int64
        Positions in the deck's modes.
    target_frequencies : (t,) float64, Hz
    reasons : tuple (t) of str
        Why each target mode is one.
    sensors : SensorPlan
    excitation : ExcitationPlan
    acquisition : AcquisitionPlan
    rule : str
        How points were chosen, in words.
    notes : tuple of str
        What the plan asks for in vain.
    suspension : SuspensionPlan, optional
    virtual_test, virtual_ambient_test : VirtualTest, optional
        What trials of the plan find of its target modes, and of those of its ambient tests.
    """

    target_modes: Int
    target_frequencies: Float
    reasons: tuple[str, ...]
    sensors: SensorPlan
    excitation: ExcitationPlan
    acquisition: AcquisitionPlan
    rule: str
    notes: tuple[str, ...] = ()
    suspension: SuspensionPlan | None = None
    virtual_test: VirtualTest | None = None
    virtual_ambient_test: VirtualTest | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ErrorIndicators:
    """Local errors of the deck in the expanded test shapes, by region (g) and by mode (m)."""

    regions: tuple[str, ...]  # groups of the scene, or cards without a property
    strain: Float  # (g,) share of the strain energy in the test shapes
    force: Float  # (g,) share of the force residual
    constitutive: Float  # (g,) share of the error in constitutive relation
    energy: Float  # (g,) share of the change of strain energy
    modes: Int  # (m,) positions in the reference modes
    # (m,) error in constitutive relation over the strain energy of each mode
    relative: Float
    expansion: str  # method by which the test shapes are expanded
    misfit: Float  # (m,) readings that the expansion does not reproduce, relative

    @property
    def concentration(self) -> Float:
        """Error in constitutive relation over strain energy, (g,); NaN without strain."""
        known = self.strain > SCARCE
        return np.where(
            known, self.constitutive / np.where(known, self.strain, 1.0), np.nan
        )


@dataclass(frozen=True, slots=True, eq=False)
class CandidateEffects:
    """What the data say of each candidate (p)."""

    parameters: ParameterSet
    what: tuple[str, ...]  # in words
    elements: tuple[str, ...]  # regions that each candidate changes
    # (p,) of one prior standard deviation, in standard deviations of the residuals
    effect: Float
    # (p,) posterior over prior standard deviation, all others known
    others_known: Float
    all_free: Float  # (p,) the same with all candidates free
    # (p,) share of the squared frequency errors that each explains by itself
    explains: Float


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePool:
    """The candidates that were made from the deck, and those that were not examined closely."""

    made: int  # 0: the candidates are given
    dropped: tuple[str, ...]  # they change nothing
    screened: tuple[str, ...]  # they explain less than others
    # they scale a field of the suspension, which its tuning finds
    held: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class LocaliseStage:
    """Where the remodelled deck is wrong, and which parameters the data ask for."""

    indicators: ErrorIndicators
    candidates: CandidateEffects
    pool: CandidatePool
    proposal: Proposal
    # data of the proposal other than the modes of the study's own test
    proposal_basis: str = ""
    # (k,) nodes where a mass may be missing
    places: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    # ranked; each is judged by itself, the first first
    members: tuple[MissingMember, ...] = ()
    # what the deviations follow
    form: FormFindings = field(default_factory=FormFindings)
    # the solver that has reduced the deck, if another: then no indicators, members and form
    reduced_by: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SensitivityStage:
    """Sensitivities of the candidates and the choice of parameters."""

    names: tuple[str, ...]  # candidates
    d_frequency: Float  # (mode, candidate) ∂ln f/∂x
    d_mac: Float  # (mode, candidate) ∂MAC/∂x
    fe_modes: Int
    sets: dict[str, tuple[str, ...]]  # named parameter sets
    rules: dict[str, str]  # how each set was chosen
    # candidates that the data cannot tell from each other, in words
    clusters: tuple[str, ...]
    # set -> held candidate -> its stand-ins
    held: dict[str, dict[str, tuple[str, ...]]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class SetFit:
    """How well an updated parameter set fits the used modes, and at what price."""

    mean_deviation: float  # %, used modes
    max_deviation: float
    mean_subspace_mac: float  # %
    mean_deviation_left_out: float
    condition: float
    criterion: float  # AICc
    misfits: tuple[Misfit, ...] = ()  # kinds of residuals beyond their stated errors


@dataclass(frozen=True, slots=True, eq=False)
class UpdateHistory:
    """An updating iteration by iteration (i)."""

    objective: Float  # (i,)
    step: Float  # (i,)
    deviation: Float  # (i,) mean |Δf| %
    subspace_mac: Float  # (i,) mean subspace MAC %
    path: Float  # (i, p) factors
    gradient: float  # norm at the end, relative to the start


@dataclass(frozen=True, slots=True, eq=False)
class SetResult:
    """One parameter set, updated."""

    name: str
    parameters: tuple[str, ...]
    factor: Float  # (p,) updated / initial
    std: Float  # (p,) relative standard deviation of the factor
    bounds: Float  # (p, 2)
    identifiability: Float  # (p,) posterior / prior std
    fit: SetFit
    outcome: Outcome
    history: UpdateHistory
    settings: str = ""  # settings that differ from [update], in words
    # of f and 1 - MAC: the model error that the updating assumed at its end
    discrepancy: Float = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def factors(self) -> dict[str, float]:
        """By the names of the parameters."""
        return dict(zip(self.parameters, self.factor.tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class FinishedSet:
    """A parameter set that an updating which still runs has finished."""

    result: SetResult
    lost: int  # used modes without partner whose shape the model has
    runs: int  # of another solver


@dataclass(frozen=True, slots=True, eq=False)
class DataResult:
    """What was measured besides the modes, (n,) each, against the model before and after the
    updating.
    """

    name: str
    kind: str  # frf, anti-resonances, static or mass
    configuration: str  # empty: the deck of the study
    labels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Float  # NaN where before and after are deviations from it
    before: Float
    after: Float
    error: Float  # one standard deviation that the updating assumed
    seats: tuple[Seat, ...] = ()  # where its channels are read


@dataclass(frozen=True, slots=True, eq=False)
class UpdateStage:
    """The parameter sets compared and the chosen one."""

    sets: tuple[SetResult, ...]
    chosen: int
    why: str
    # of the chosen parameters: first target's value in the deck
    initial_values: dict[str, float]
    updated_values: dict[str, float]
    regions: dict[str, tuple[int, ...]]  # parameter -> scene groups that it changes
    data: tuple[DataResult, ...] = ()  # what was measured besides the modes
    solver: str = "embedded"
    runs: int = 0  # of another solver

    @property
    def best(self) -> SetResult:
        """The chosen set."""
        return self.sets[self.chosen]


@dataclass(frozen=True, slots=True, eq=False)
class TunedConfiguration:
    """The rigid-body modes of another configuration before and after the tuning of the shared
    suspension.
    """

    name: str
    before: CorrelationTable
    after: CorrelationTable


@dataclass(frozen=True, slots=True, eq=False)
class TuneStage:
    """Rigid-body tuning of the suspension."""

    before: CorrelationTable
    after: CorrelationTable
    factors: dict[str, float]
    std: dict[str, float]
    ambiguity: tuple[
        str, ...
    ] = ()  # pairings that the test leaves open, with their weight, in words
    flags: tuple[str, ...] = ()  # factors that are not plausible
    # configurations that were tuned to as well
    others: tuple[TunedConfiguration, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ComparedFrfs:
    """FRFs at driving points: measured, and of the initial and the final model.

    Attributes
    ----------
    freqs : (f,) float64, Hz
    channels : tuple (k) of str
        "out / in".
    test, initial, final : (f, k) complex128
    """

    freqs: Float
    channels: tuple[str, ...]
    test: Complex
    initial: Complex
    final: Complex


@dataclass(frozen=True, slots=True, eq=False)
class FinalStage:
    """The delivered deck, read back: correlation, damping and FRFs.

    Attributes
    ----------
    files : tuple of str
    changes : tuple of str
        "anchors.bdf:12 PBUSH 31 K3 1.2e9 -> 2.9e9".
    table, rigid : CorrelationTable
    modes : ModeSet
        At the scene's translations.
    observed : ModeSet
        At the channels.
    damping : (m,) float64
        Of the test, or interpolated.
    damping_from : tuple of str
        Per mode: "test mode 3" or "interpolated".
    evidence : Evidence, optional
    frfs : ComparedFrfs, optional
        None where none were measured.
    """

    files: tuple[str, ...]
    changes: tuple[str, ...]
    table: CorrelationTable
    rigid: CorrelationTable
    modes: ModeSet
    observed: ModeSet
    damping: Float
    damping_from: tuple[str, ...]
    evidence: Evidence | None = None
    frfs: ComparedFrfs | None = None


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
    # relative error of the FRFs around the mode; NaN where there is none
    frf_before: Float
    frf_after: Float

    def spread(self, used: bool) -> tuple[float, float]:
        """Root mean square relative deviation from the test before and after, of the modes used or
        left out.
        """
        at = self.used == used
        if not at.any():
            return float("nan"), float("nan")
        before, after = (
            float(np.sqrt(np.mean((x / self.measured - 1)[at] ** 2)))
            for x in (self.before, self.after)
        )
        return before, after


@dataclass(frozen=True, slots=True, eq=False)
class DampedConfiguration:
    """The same of another configuration, whose test the regions were fitted to, too."""

    name: str
    modes: DampedModes


@dataclass(frozen=True, slots=True, eq=False)
class DampingStage:
    """Damping by region and by mode; None where the test says nothing of it."""

    # why there is nothing, or why the regions are refused; empty where they hold
    why: str
    regions: DampedRegions | None
    modes: DampedModes | None
    # root mean square deviation of the ratios over the error of test and model
    misfit: float
    before: str  # what damps the model before, in words
    flags: tuple[str, ...]  # what is not plausible, in words
    files: tuple[str, ...]  # of the damped deck, if it was written
    changes: tuple[str, ...]
    others: tuple[DampedConfiguration, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ParameterPosterior:
    """How well the chosen parameters (p) are known."""

    parameters: ParameterSet
    factor: Float  # (p,) as delivered
    std: Float  # (p,) of x
    interval: Float  # (p, 2) of the factor
    prior: Float  # (p, 2) the same interval before the test
    ratio: Float  # (p,) posterior over prior standard deviation
    moved: Bool  # (p,) the data say something of it
    correlation: Float  # (p, p)

    @property
    def relative(self) -> Float:
        """Standard deviation of the factors, relative, (p,)."""
        x = self.parameters.vector(self.factor)
        return self.parameters.derivative(x) * self.std / self.factor


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyBands:
    """Predicted frequencies of the elastic test modes (m)."""

    test: Float  # (m,) Hz, measured
    predicted: Float  # (m,) Hz, NaN where unpaired
    band: Float  # (m, 2) Hz, where the measured frequency is expected
    parts: Float  # (m, 3) relative standard deviations: parameters, test, model
    used: Bool  # (m,) seen by the updating
    inside: Bool  # (m,) the band holds the measured frequency


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorChains:
    """Samples of the posterior by Markov chains; empty where none were asked for."""

    draws: Float = field(default_factory=lambda: np.zeros((0, 0)))  # (s, p) factors
    # (p, 2) their intervals
    sampled: Float = field(default_factory=lambda: np.zeros((0, 2)))
    acceptance: float = 0.0  # share of accepted moves
    independent: float = 0.0  # effective number of draws
    converged: bool = True  # the chains are long enough and agree


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyStage:
    """How well the chosen parameters are known, and what the delivered model predicts."""

    posterior: ParameterPosterior
    bands: FrequencyBands
    level: float  # of the intervals and bands
    # (2,) of the model: relative frequency and 1 − MAC, from modes left out
    discrepancy: Float
    assumed: Float  # (2,) the same as the updating assumed
    held: Held  # the used modes, predicted fold by fold
    flags: tuple[Flag, ...]  # parameters that are not plausible
    chains: PosteriorChains = field(default_factory=PosteriorChains)

    @property
    def kept(self) -> Float:
        """Least share of each change that is there with any fold of modes left out, (p,); NaN where
        it is slight.
        """
        p = self.posterior
        share = kept(p.parameters.vector(p.factor), self.held.ends)
        return np.where(np.abs(p.factor - 1) > FLAGS.slight, share, np.nan)

    @property
    def unproven(self) -> Bool:
        """Parameters that may take up an error of form, (p,)."""
        p = self.posterior
        return unproven(p.parameters, p.factor, p.interval, self.kept)


@dataclass(frozen=True, slots=True, eq=False)
class PredictStage:
    """Running a rotor on the validated model."""

    rotor: int  # node
    axis: str
    unbalance: Unbalance
    run_up: RunUp
    posterior: Posterior  # of the elastic and suspension parameters
    # relative, of a frequency, from the modes left out of the updating (all pairs if none was)
    discrepancy: float
    damping: str  # where it comes from, in words
    residual: float  # of the reduced model at the worst speed, relative to the load
    flags: tuple[str, ...]  # parameters that are not plausible
