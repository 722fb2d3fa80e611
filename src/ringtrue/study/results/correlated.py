"""Test against test and model against test, of the deck of the study and of other
configurations.
"""

from __future__ import annotations

from dataclasses import dataclass

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.frf import FrfComparison
from ringtrue.correlation.measures import CompleteCorrelation
from ringtrue.correlation.sensor_mounting import Mending
from ringtrue.correlation.table import CorrelationTable
from ringtrue.correlation.tracking import Tracks


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
    """

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
    tracks: Tracks | None = (
        None  # FE modes followed by their shapes at the channels: final, remodelled, initial
    )
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
    mean_subspace_mac: float  # %


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Test shapes on all of a deck."""

    method: str
    modes: ModeSet  # at the scene's translations
    misfit: Float  # (m,) of the readings that the expanded shape does not reproduce, relative


@dataclass(frozen=True, slots=True, eq=False)
class CorrelateStage:
    """The initial model against the test, and after the stated remodelling."""

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
    history: tuple[RemodelStep, ...] = ()  # the initial deck, then each step
    expanded: Expansion | None = (
        None  # the elastic test shapes on the remodelled deck, where the study asks for them
    )
    gaps: tuple[
        str, ...
    ] = ()  # what of the test is not used, and partners that cannot be found, in words
    seats: tuple[Seat, ...] = ()  # where the channels of the sheet are read on the initial deck
    mendings: tuple[
        Mending, ...
    ] = ()  # other mountings of the sensors that explain the test better

    @property
    def changed(self) -> bool:
        """Whether the deck was remodelled before the updating."""
        return bool(self.diff or self.remodelling)


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
    seats: tuple[Seat, ...] = ()  # where the channels of its sheet are read on its deck
    mendings: tuple[Mending, ...] = ()


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
