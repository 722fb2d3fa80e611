"""The sections of study.toml: model, plan, test, identification, correlation and what follows."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from ringtrue.core.parameters import CardField, Parameter
from ringtrue.core.units import UnitName
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.errors import did_you_mean
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.updating.damping_regions import DampingRegion
from ringtrue.updating.selection.candidates import Kind


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


SelectionMethod = Literal["independence", "qr", "auto-mac", "information"]
Directions = Literal["triaxial", "uniaxial", "normal"]
Strike = Literal["worst", "greedy", "qr", "mif"]


def rising(name: str, low: float | None, high: float | None) -> None:
    """Refuse a band that does not rise from 0 or more."""
    if (low is not None and low < 0) or (high is not None and high <= (low or 0.0)):
        raise ValueError(f"{name}fmin {low} and {name}fmax {high}: must be 0 <= fmin < fmax")


class PlanSection(Section):
    """What to plan."""

    fmin: float = 0.0
    fmax: float = Field(default=80.0, gt=0)
    sensors: int = Field(
        default=45, gt=0
    )  # measuring points for the hammer test, sensors where not triaxial
    at_hand: int = Field(
        default=0, ge=0
    )  # sensors recorded at once: with more planned, setups; 0: all at once
    ambient_sensors: int = Field(default=12, gt=0)  # measuring points for the ambient tests
    references: int = Field(default=4, gt=0)
    candidates: dict[str, list[int]] = {}  # region -> candidate nodes; empty: the skin of the model
    # m; "even": half of the spacing that the structure gives so many points; not given: that, but
    # at most 0.8 m
    min_distance: Annotated[float, Field(ge=0)] | Literal["even"] | None = None
    damping: float = Field(default=0.01, gt=0)  # expected, for the resolution
    max_auto_mac: float = Field(default=0.25, gt=0, lt=1)
    method: SelectionMethod = "independence"
    modes: list[
        int
    ] = []  # target modes by their number in the deck, from 1; empty: all of the band
    effective_mass: float = Field(
        default=0.0, ge=0, lt=1
    )  # of the band, modes with such a share of the mass, or
    sensitive: float = Field(
        default=0.0, ge=0
    )  # with such a sum of |∂λ/∂a|/λ over the candidates of the updating, or
    telling: int = Field(
        default=0, ge=0
    )  # so many modes that tell those candidates apart; all 0: every mode
    kinetic: dict[
        str, float
    ] = {}  # region of `candidates` -> share of kinetic energy of a target mode
    weigh: bool = False  # points that carry kinetic energy come first
    cost: dict[
        str, float
    ] = {}  # region of `candidates` -> cost of a point, 1 if not named; for qr and information
    draws: int = Field(
        default=0, ge=0
    )  # of the prior of the candidates of the updating; for information
    precision: float = Field(
        default=0.1, gt=0
    )  # relative, wanted of the lowest damping in an ambient record
    error: float = Field(default=0.05, gt=0)  # relative random, wanted of an FRF, with
    coherence: float = Field(
        default=0.98, gt=0, lt=1
    )  # such a coherence: the number of blows at each reference
    ambient: bool = True  # keep points for ambient tests
    boxes: list[list[float]] = []  # x0 y0 z0 x1 y1 z1 in m; candidates lie in one of them
    keep_out: list[list[float]] = []  # boxes without candidates
    exclude: list[int] = []  # nodes that are no candidates
    fixed: list[int] = []  # nodes that are measured in any case
    redundancy: int = Field(default=0, ge=0)  # points that may fail
    directions: Directions = "triaxial"  # of a sensor: X Y Z, one of them, off the skin
    # driving-point residues by the mean of the logarithms, or by the mode that is excited worst; QR
    # of M·Φ; force appropriation by the mode indicator
    strike: Strike = "greedy"
    strike_at: list[
        int
    ] = []  # candidate nodes that can be struck; what is chosen there is measured. Empty: any point
    suspension: int = Field(default=0, ge=0)  # points to hang from; 0: not asked for
    sensor_mass: float = Field(default=0.0, ge=0)  # kg a point, for the shift of the frequencies
    lines: Literal["mesh", "nearest"] = (
        "mesh"  # the drawing of the points follows the mesh, or joins neighbours
    )
    trials: int = Field(default=0, ge=0)  # virtual tests of the plan
    # N/√Hz at each reference in the virtual tests; not given: what leaves the expected coherence
    background: Annotated[float, Field(ge=0)] | None = None
    ambient_force: float = Field(
        default=0.0, ge=0
    )  # N/√Hz along each channel: virtual ambient tests, too, if > 0

    @model_validator(mode="after")
    def _band(self) -> Self:
        rising("", self.fmin, self.fmax)
        if any(len(b) != 6 for b in (*self.boxes, *self.keep_out)):
            raise ValueError("boxes and keep_out: a box is x0 y0 z0 x1 y1 z1")
        if (self.cost and self.method not in ("qr", "information")) or (
            self.draws and self.method != "information"
        ):
            raise ValueError(
                "cost goes with method qr or information, draws with information; method is "
                f"{self.method}"
            )
        if self.at_hand == 1:
            raise ValueError(
                "at_hand: setups need two sensors, one that stays and one that roves; 0: all at "
                "once"
            )
        if self.ambient_force and not self.trials:
            raise ValueError("ambient_force is that of virtual ambient tests; give trials, too")
        if lost := [r for r in (*self.kinetic, *self.cost) if r not in self.candidates]:
            raise ValueError(
                f"no region {lost[0]!r} in candidates{did_you_mean(lost[0], self.candidates)}"
            )
        if any(v <= 0 for v in (*self.cost.values(), *self.kinetic.values())):
            raise ValueError("cost and kinetic: must be > 0")
        if any(m < 1 for m in self.modes):
            raise ValueError("modes: the first mode of the deck is 1")
        return self


Tam = Literal["irs", "guyan", "hybrid", "serep", "craig-bampton"]


OF_SHAPES = {
    "accept_mac",
    "accept_mean_mac",
    "accept_orthogonality",
    "accept_off_diagonal",
    "expand",
}


class CorrelateSection(Section):
    """Pairing and acceptance."""

    mac_gate: float = Field(default=0.6, gt=0, lt=1)
    # |f_FE − f_test|/f_test; None: 0.4, and beyond it modes that look alike and like no other
    frequency_gate: float | None = Field(default=None, gt=0)
    lock: list[
        str
    ] = []  # "3:7": test mode 3 belongs to mode 7 of the initial deck, and to what becomes of it
    forbid: list[str] = []  # that do not belong together
    rigid_below: float | None = (
        None  # Hz: rigid-body modes lie below; None: the largest gap decides
    )
    tolerance: float | None = Field(
        default=None, gt=0
    )  # m, sensor to node; None: 3 % of the deck, or a mesh width
    match: Literal["nearest", "rigid"] = (
        "nearest"  # a sensor off the nodes: the nearest node, or the nodes around it
    )
    align: Literal["", "points", "nearest"] = (
        ""  # lay the test onto the deck by points numbered as nodes, or by nearest
    )
    accept_percent: float = 5.0
    # judged where results are shown: no stage depends on them
    accept_hz: float | None = Field(default=None, exclude=True)
    accept_mac: float | None = Field(default=80.0, exclude=True)
    accept_pairs: int | None = Field(default=None, ge=0, exclude=True)
    accept_mean_percent: float | None = Field(default=None, ge=0, exclude=True)
    accept_mean_mac: float | None = Field(default=None, ge=0, le=100, exclude=True)
    accept_orthogonality: float = Field(
        default=90.0, ge=0, le=100
    )  # %, least cross-orthogonality of a pair
    accept_off_diagonal: float = Field(
        default=10.0, ge=0, le=100
    )  # %, largest between different modes
    # the mass at the channels that orthogonality is over
    tam: Tam = "irs"
    # of the test shapes to the whole deck, for the error indicators (hybrid if not given) and the
    # report (none)
    expand: Literal["", "hybrid", "serep", "guyan", "dynamic"] = ""

    @field_validator("lock", "forbid")
    @classmethod
    def _pairs(cls, value: list[str]) -> list[str]:
        if wrong := [v for v in value if not re.fullmatch(r"[1-9]\d*:[1-9]\d*", v)]:
            raise ValueError(
                f"{wrong[0]!r} is no pair of a test mode and a mode of the deck, from 1, such as "
                "'3:7'"
            )
        return value

    def gates(self, confidence: float = 0.5) -> PairingSettings:
        """The gates of the pairing; a frequency gate that is given holds for all pairs."""
        gates = PairingSettings(mac_gate=self.mac_gate, min_confidence=confidence)
        own = self.frequency_gate
        return gates if own is None else replace(gates, frequency_gate=own, reach=1.0)


class StudyInfo(Section):
    """What is studied."""

    title: str = "Model validation"
    system: str = ""  # a paragraph or more for the report
    seed: int = 0


class ModelSection(Section):
    """The deck."""

    deck: str
    units: UnitName = "SI"
    fmax: float | None = Field(
        default=None, gt=0
    )  # Hz, modes are computed up to here; None: as high as a pair may be
    # of the modes of decks and of the updating: embedded, mystran, nastran, slepc, a plug-in
    solver: str = EMBEDDED
    refine: int = Field(
        default=0, ge=0, le=3
    )  # how often the mesh is refined before anything is computed
    regions: dict[str, list[int]] = {}  # name -> property numbers, for drawing and naming


class TestSection(Section):
    """The measurements: the sensor sheet, and a crew's log that lists the records, measured FRFs,
    or modes.

    Without a sheet the modes are frequencies alone.
    """

    sheet: str | None = None
    log: str | None = None
    frfs: list[str] = []  # .uff, .h5, .npz, in place of hammer records
    modes: str | None = (
        None  # .json, .h5, .uff, .csv, .xlsx: identified elsewhere, or by `ringtrue ema` or `oma`
    )
    leave_out: list[
        str
    ] = []  # channels that are not used: broken, or on a part that the deck does not have
    lines: str | None = None  # pairs of points to draw

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.modes is not None and (self.log is not None or self.frfs):
            raise ValueError("modes take the place of a log and of frfs: give one of the two")
        if self.sheet is None and (self.modes is None or self.leave_out or self.lines):
            raise ValueError(
                "a test needs a `sheet`; only `modes` that are frequencies alone have no channels"
            )
        return self


class IdentifySection(Section):
    """Bands of the identification; None: found from the data."""

    ambient_fmin: float | None = None
    ambient_fmax: float | None = None
    hammer_fmin: float | None = None
    hammer_fmax: float | None = None
    confidence: float = Field(default=0.5, ge=0, le=1)  # modes below are not used, but listed
    choice: str | None = (
        None  # a choice of modes by hand, .toml or .json; records by their names, or "hammer"
    )

    @model_validator(mode="after")
    def _bands(self) -> Self:
        rising("ambient_", self.ambient_fmin, self.ambient_fmax)
        rising("hammer_", self.hammer_fmin, self.hammer_fmax)
        return self


class Candidate(Section):
    """One uncertain region: `targets = ["MAT1 7 E", "PBUSH 3 K1,K2,K3"]`."""

    name: str
    targets: list[str]
    lower: float = 0.2
    upper: float = 5.0
    std: float = Field(default=0.7, gt=0)
    scale: Literal["log", "linear"] = "log"

    @field_validator("targets")
    @classmethod
    def _readable(cls, value: list[str]) -> list[str]:
        for text in value:
            parse_target(text)
        if not value:
            raise ValueError("a candidate needs at least one target, as in 'MAT1 7 E'")
        return value

    @model_validator(mode="after")
    def _bounds(self) -> Self:
        self.parameter()
        return self

    def parameter(self) -> Parameter:
        """As a core parameter."""
        targets = tuple(t for text in self.targets for t in parse_target(text))
        return Parameter(
            name=self.name,
            targets=targets,
            lower=self.lower,
            upper=self.upper,
            scale=self.scale,
            std=self.std,
        )


def parse_target(text: str) -> tuple[CardField, ...]:
    """`"PBUSH 3 K1,K2"` -> two targets."""
    words = text.split()
    if len(words) != 3 or not words[1].isdigit():
        raise ValueError(
            f"{text!r} is not a target; the form is 'CARD id FIELD[,FIELD]', as in 'MAT1 7 E'"
        )
    return tuple(CardField(words[0].upper(), int(words[1]), f.upper()) for f in words[2].split(","))


def target_words(parameter: Parameter) -> list[str]:
    """What a candidate of study.toml has as `targets`, a card each; empty for factors on some
    elements only.
    """
    fields: dict[str, list[str]] = {}
    for t in parameter.targets:
        fields.setdefault(f"{t.card} {t.id}", []).append(t.field)
    partly = bool(parameter.substructures) or any(t.elements for t in parameter.targets)
    return [] if partly else [f"{card} {','.join(some)}" for card, some in fields.items()]


class LocaliseSection(Section):
    """Where the model is wrong: error indicators, and a proposal of parameters."""

    most: int = Field(default=8, gt=0)  # parameters that are proposed
    kinds: list[Kind] = ["material", "property", "spring", "lump"]
    pool: int = Field(
        default=24, ge=0
    )  # candidates made from the deck that are looked at closely; 0: none is made
    alike: float = Field(
        default=0.95, gt=0, le=1
    )  # |cosine| from which on the data cannot tell two apart


class DampingRegionSection(Section):
    """A region with one loss factor, `targets = ["MAT1 7 GE"]`, or one dashpot, `targets = ["PBUSH
    3 B1,B2"]`.
    """

    name: str
    targets: list[str]
    lower: float = Field(default=0.0, ge=0)
    upper: float | None = Field(default=None, gt=0)
    expected: float | None = Field(default=None, ge=0)
    std: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _readable(self) -> Self:
        self.region()
        return self

    def region(self) -> DampingRegion:
        """As a region of the updating."""
        targets = tuple(t for text in self.targets for t in parse_target(text))
        return DampingRegion(
            name=self.name,
            targets=targets,
            lower=self.lower,
            upper=self.upper,
            expected=self.expected,
            std=self.std,
        )


class DampingSection(Section):
    """Damping after stiffness and mass: loss factors and dashpots by region."""

    region: list[DampingRegionSection] = []  # empty: one a material and one a spring group
    error: float = Field(
        default=0.1, gt=0
    )  # of a mode's damping by the model's shapes, relative, 1 sigma
    write: bool = False  # into GE and B of a copy of the delivered deck, out/damped


class PredictSection(Section):
    """Running the rotor: what `ringtrue predict` computes."""

    rotor: int  # node that the unbalance acts on
    mass: float = Field(gt=0)  # kg
    axis: Literal["X", "Y", "Z"] = "X"
    grade: float = Field(default=2.5, gt=0)  # balance grade G, mm/s
    service: float = Field(default=50.0, gt=0)  # Hz
    fmax: float = Field(default=200.0, gt=0)  # Hz
    springs: dict[str, list[int]] = {}  # name -> PBUSH numbers
    lines: int = Field(default=800, ge=2)  # speeds
    draws: int = Field(default=60, ge=20)  # of the posterior
    level: float = Field(default=0.9, ge=0.5, le=0.95)  # of the bands


class ConfigurationSection(Section):
    """Another state of the structure with a test of its own; its deck, or cards that the deck of
    the study gets.
    """

    name: str
    deck: str | None = None
    cards: str | None = None  # a file; its cards are added to the (remodelled) deck of the study
    sheet: str | None = None
    log: str | None = None  # of the crew, or
    modes: str | None = (
        None  # test modes, as above; without a sheet channels are DOFs such as 101+Z
    )
    lines: str | None = None
    choice: str | None = None  # as under [identify], of this log
    left_out: int = Field(default=0, ge=0)  # modes that the updating must not see

    @field_validator("name")
    @classmethod
    def _folder(cls, value: str) -> str:
        if not re.fullmatch(r"\w[\w .+-]*", value):
            raise ValueError(
                "a configuration is named by letters, digits, blanks and . + - _: it names a folder"
            )
        return value

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.deck is None) == (self.cards is None):
            raise ValueError(
                "a configuration has a deck of its own or cards that are added, one of the two"
            )
        if (self.log is None) == (self.modes is None) or (
            self.log is not None and self.sheet is None
        ):
            raise ValueError("a configuration has a sheet and a log, or a file of modes")
        return self


class ReportSection(Section):
    """The report."""

    photos: list[str] = []
    captions: list[str] = []
