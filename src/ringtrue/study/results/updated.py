"""Where the model is wrong, what was changed, how it stands then, how well that is known, and what
it predicts.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.study.results.correlated import Evidence, Seat
from ringtrue.updating.identifiability import SLIGHT, Flag, kept, unproven
from ringtrue.updating.prediction import RunUp, Unbalance
from ringtrue.updating.selection.localisation import SCARCE
from ringtrue.updating.selection.proposal import Proposal
from ringtrue.updating.uncertainty import Posterior
from ringtrue.updating.validation import Held


@dataclass(frozen=True, slots=True, eq=False)
class ErrorIndicators:
    """Local errors of the deck in the expanded test shapes, by region (g) and by mode (m)."""

    regions: tuple[str, ...]  # groups of the scene, or cards without a property
    strain: Float  # (g,) share of the strain energy in the test shapes
    force: Float  # (g,) share of the force residual
    constitutive: Float  # (g,) share of the error in constitutive relation
    energy: Float  # (g,) share of the change of strain energy
    modes: Int  # (m,) positions in the reference modes
    relative: Float  # (m,) error in constitutive relation over the strain energy of each mode
    expansion: str  # method by which the test shapes are expanded
    misfit: Float  # (m,) readings that the expansion does not reproduce, relative

    @property
    def concentration(self) -> Float:
        """Error in constitutive relation over strain energy, (g,); NaN without strain."""
        known = self.strain > SCARCE
        return np.where(known, self.constitutive / np.where(known, self.strain, 1.0), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class CandidateEffects:
    """What the data say of each candidate (p)."""

    parameters: ParameterSet
    what: tuple[str, ...]  # in words
    elements: tuple[str, ...]  # regions that each candidate changes
    effect: Float  # (p,) of one prior standard deviation, in standard deviations of the residuals
    others_known: Float  # (p,) posterior over prior standard deviation, all others known
    all_free: Float  # (p,) the same with all candidates free
    explains: Float  # (p,) share of the squared frequency errors that each explains by itself


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePool:
    """The candidates that were made from the deck, and those that were not examined closely."""

    made: int  # 0: the candidates are given
    dropped: tuple[str, ...]  # they change nothing
    screened: tuple[str, ...]  # they explain less than others
    held: tuple[str, ...] = ()  # they scale a field of the suspension, which its tuning finds


@dataclass(frozen=True, slots=True, eq=False)
class LocaliseStage:
    """Where the remodelled deck is wrong, and which parameters the data ask for."""

    indicators: ErrorIndicators
    candidates: CandidateEffects
    pool: CandidatePool
    proposal: Proposal
    proposal_basis: str = ""  # data of the proposal other than the modes of the study's own test
    places: Int = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64)
    )  # (k,) nodes where a mass may be missing


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
    held: dict[str, dict[str, tuple[str, ...]]] = field(
        default_factory=dict
    )  # set -> held candidate -> its stand-ins


@dataclass(frozen=True, slots=True, eq=False)
class SetFit:
    """How well an updated parameter set fits the used modes, and at what price."""

    mean_deviation: float  # %, used modes
    max_deviation: float
    mean_subspace_mac: float  # %
    mean_deviation_left_out: float
    condition: float
    criterion: float  # AICc


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
    discrepancy: Float = field(
        default_factory=lambda: np.full(2, np.nan)
    )  # of f and 1 - MAC: the model error that the updating assumed at its end


@dataclass(frozen=True, slots=True, eq=False)
class FinishedSet:
    """A parameter set that an updating which still runs has finished."""

    result: SetResult
    lost: int  # used modes without partner whose shape the model has
    runs: int  # of another solver


@dataclass(frozen=True, slots=True, eq=False)
class DataResult:
    """What was measured beside the modes, (n,) each, against the model before and after the
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
    left_out: Int  # positions in the reference modes, fixed before
    initial_values: dict[str, float]  # of the chosen parameters: first target's value in the deck
    updated_values: dict[str, float]
    regions: dict[str, tuple[int, ...]]  # parameter -> scene groups that it changes
    data: tuple[DataResult, ...] = ()  # what was measured beside the modes
    solver: str = "embedded"
    runs: int = 0  # of another solver


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
    others: tuple[TunedConfiguration, ...] = ()  # configurations that were tuned to as well
    disagreeing: tuple[
        str, ...
    ] = ()  # elastic test modes that strain it and that its tuning puts off, in words


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
    """Damping by region and by mode; None where the test tells nothing of it."""

    why: str  # why there is nothing; empty where there is
    regions: DampedRegions | None
    modes: DampedModes | None
    misfit: float  # root mean square deviation of the ratios over the error of test and model
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
        return np.asarray(self.parameters.derivative(x) * self.std / self.factor)


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
    sampled: Float = field(default_factory=lambda: np.zeros((0, 2)))  # (p, 2) their intervals
    acceptance: float = 0.0  # share of accepted moves
    independent: float = 0.0  # effective number of draws
    converged: bool = True  # the chains are long enough and agree


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyStage:
    """How well the chosen parameters are known, and what the delivered model predicts."""

    posterior: ParameterPosterior
    bands: FrequencyBands
    level: float  # of the intervals and bands
    discrepancy: Float  # (2,) of the model: relative frequency and 1 − MAC, from modes left out
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
        return np.where(np.abs(p.factor - 1) > SLIGHT, share, np.nan)

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
