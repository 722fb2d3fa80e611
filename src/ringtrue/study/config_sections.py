"""The sections of study.toml: model, plan, test, identification, correlation and what follows."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from ringtrue.core.parameters import CardField, Parameter
from ringtrue.core.side_by_side import Workers, checked_workers
from ringtrue.core.units import UnitName
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.errors import did_you_mean
from ringtrue.model.ports import ModalSolver
from ringtrue.solvers.registry import EMBEDDED, solver
from ringtrue.updating.damping_regions import DampingRegion
from ringtrue.updating.selection.candidates import Kind


class StudySection(BaseModel):
    """A table of study.toml; unknown keys are refused, the text below a key says what it is."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
    )


Directions = Literal["triaxial", "uniaxial", "normal"]
Strike = Literal["worst", "greedy"]


def rising(name: str, low: float | None, high: float | None) -> None:
    """Refuse a band that does not rise from 0 or more."""
    if (low is not None and low < 0) or (high is not None and high <= (low or 0.0)):
        raise ValueError(
            f"{name}fmin {low} and {name}fmax {high}: must be 0 <= fmin < fmax"
        )


class PlanSection(StudySection):
    """What to plan."""

    fmin: float = 0.0
    """Lower end of the band of the target modes, Hz."""
    fmax: float = Field(default=80.0, gt=0)
    """Upper end, Hz."""
    sensors: int = Field(default=45, gt=0)
    """Measuring points of the hammer test; sensors where these are not triaxial."""
    at_hand: int = Field(default=0, ge=0)
    """Sensors that are recorded at once; with more planned, the test has setups. 0: all at once.
    """
    ambient_sensors: int = Field(default=12, gt=0)
    """Measuring points of the ambient tests."""
    references: int = Field(default=4, gt=0)
    """Excitation points."""
    candidates: dict[str, list[int]] = {}
    """Region -> candidate nodes; the skin of the model if empty."""
    min_distance: Annotated[float, Field(ge=0)] | Literal["even"] | None = None
    """Least distance of points, m. "even": half of the spacing that the structure gives so many
    points; not given: that, but at most 0.8 m.
    """
    damping: float = Field(default=0.01, gt=0)
    """Expected damping ratio, for the resolution."""
    max_auto_mac: float = Field(default=0.25, gt=0, lt=1)
    """Points are added while the auto-MAC of two target modes is larger."""
    modes: list[int] = []
    """Target modes by their number in the deck, from 1; all of the band if empty."""
    effective_mass: float = Field(default=0.0, ge=0, lt=1)
    """Target modes have such a share of the mass."""
    sensitive: float = Field(default=0.0, ge=0)
    """Or such a sum of |∂λ/∂a|/λ over the candidates of the updating."""
    telling: int = Field(default=0, ge=0)
    """Or are so many modes that distinguish those candidates."""
    kinetic: dict[str, float] = {}
    """Or have such a share of kinetic energy in a region of `candidates`."""
    precision: float = Field(default=0.1, gt=0)
    """Wanted relative standard deviation of the lowest damping in an ambient record."""
    error: float = Field(default=0.05, gt=0)
    """Wanted relative random error of an FRF."""
    coherence: float = Field(default=0.98, gt=0, lt=1)
    """Expected coherence of the FRFs; with `error` it gives the number of impacts."""
    ambient: bool = True
    """Keep points for ambient tests."""
    boxes: list[list[float]] = []
    """Boxes x0 y0 z0 x1 y1 z1, m; candidates lie in one of them."""
    keep_out: list[list[float]] = []
    """Boxes without candidates."""
    exclude: list[int] = []
    """Nodes that are no candidates."""
    fixed: list[int] = []
    """Nodes that are measured in any case."""
    redundancy: int = Field(default=0, ge=0)
    """Points that may fail."""
    directions: Directions = "triaxial"
    """Of a sensor: X Y Z together, one of them, or normal to the skin."""
    strike: Strike = "greedy"
    """How excitation points are chosen: driving-point residues by the mean of the logarithms, or by
    the mode that is excited worst.
    """
    strike_at: list[int] = []
    """Candidate nodes that can be excited, any if empty; what is chosen there is measured, too.
    """
    suspension: int = Field(default=0, ge=0)
    """Points to hang the structure from; 0: not asked for."""
    sensor_mass: float = Field(default=0.0, ge=0)
    """kg a point, for the shift of the frequencies."""
    lines: Literal["mesh", "nearest"] = "mesh"
    """The drawing of the points follows the mesh, or joins neighbours."""
    trials: int = Field(default=0, ge=0)
    """Virtual tests of the plan."""
    background: Annotated[float, Field(ge=0)] | None = None
    """Noise at each reference in the virtual tests, N/√Hz; what leaves `coherence` if not given.
    """
    ambient_force: float = Field(default=0.0, ge=0)
    """N/√Hz along each channel; virtual ambient tests, too, if > 0."""

    @model_validator(mode="after")
    def _band(self) -> Self:
        rising("", self.fmin, self.fmax)
        if any(len(b) != 6 for b in (*self.boxes, *self.keep_out)):
            raise ValueError("boxes and keep_out: a box is x0 y0 z0 x1 y1 z1")
        if self.at_hand == 1:
            raise ValueError(
                "at_hand: setups need two sensors, one that stays and one that roves; 0: all at "
                "once"
            )
        if self.ambient_force and not self.trials:
            raise ValueError(
                "ambient_force is that of virtual ambient tests; give trials, too"
            )
        if lost := [r for r in self.kinetic if r not in self.candidates]:
            raise ValueError(
                f"no region {lost[0]!r} in candidates{did_you_mean(lost[0], self.candidates)}"
            )
        if any(v <= 0 for v in self.kinetic.values()):
            raise ValueError("kinetic: must be > 0")
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


class CorrelateSection(StudySection):
    """Pairing and acceptance."""

    mac_gate: float = Field(default=0.6, gt=0, lt=1)
    """Least MAC of a pair."""
    frequency_gate: float | None = Field(default=None, gt=0)
    """Largest |f_FE - f_test|/f_test; not given: 0.4, and beyond it modes that look like each
    other and like no other.
    """
    lock: list[str] = []
    """"3:7": test mode 3 belongs to mode 7 of the initial deck, and to what becomes of it."""
    forbid: list[str] = []
    """Pairs that do not belong together."""
    rigid_below: float | None = None
    """Rigid-body modes lie below, Hz; the largest gap decides if not given."""
    tolerance: float | None = Field(default=None, gt=0)
    """From a sensor to its node, m; 3 % of the deck or a mesh width if not given."""
    match: Literal["nearest", "rigid"] = "nearest"
    """A sensor off the nodes reads the nearest node, or the nodes around it."""
    align: Literal["", "points", "nearest"] = ""
    """Lay the test onto the deck by points numbered as nodes, or by the nearest nodes."""
    accept_percent: float = 5.0
    """A pair is accepted up to this frequency deviation, %."""
    accept_hz: float | None = Field(default=None, exclude=True)
    """Or up to this one, Hz. This and the further limits are judged where results are shown."""
    accept_mac: float | None = Field(default=80.0, exclude=True)
    """And from this subspace MAC on, %."""
    accept_pairs: int | None = Field(default=None, ge=0, exclude=True)
    """Least number of pairs."""
    accept_mean_percent: float | None = Field(default=None, ge=0, exclude=True)
    """Largest mean frequency deviation, %."""
    accept_mean_mac: float | None = Field(default=None, ge=0, le=100, exclude=True)
    """Least mean subspace MAC, %."""
    accept_orthogonality: float = Field(default=90.0, ge=0, le=100)
    """Least cross-orthogonality of a pair, %."""
    accept_off_diagonal: float = Field(default=10.0, ge=0, le=100)
    """Largest cross-orthogonality of different modes, %."""
    tam: Tam = "irs"
    """The test-analysis model: the mass at the channels that orthogonality is over."""
    expand: Literal["", "hybrid", "serep"] = ""
    """Expansion of the test shapes to the whole deck, for the report (none if not given) and the
    error indicators (hybrid).
    """

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


class InstrumentSection(StudySection):
    """A sensor, hammer, shaker or recorder of the test, for the report."""

    name: str
    """Kind, maker and type."""
    serial: str = ""
    """Serial number."""
    channels: list[str] = []
    """That it measured, such as 17+Z."""
    sensitivity: str = ""
    """With its unit, such as "102.3 mV/(m/s²)"."""
    calibrated: str = ""
    """Date and certificate of the calibration."""


class StudyInfo(StudySection):
    """What is studied."""

    title: str = "Model validation"
    """Of the report."""
    system: str = ""
    """A paragraph or more for the report."""
    seed: int = 0
    """Of all random numbers."""
    workers: int | str = 1
    """Processes side by side, or the address of a dask scheduler: "tcp://host:8786"."""
    use: str = ""
    """What the model is for, as it follows "validated for"."""
    client: str = ""
    """Whom the report is for."""
    revision: str = ""
    """Of the report."""
    author: str = ""
    """Who signs for the work."""
    checked_by: str = ""
    """Who signs for the check."""
    approved_by: str = ""
    """Who signs for the release."""
    names: dict[str, str] = {}
    """Of test modes by their number, such as {1 = "first bending of the frame"}."""
    instrument: list[InstrumentSection] = []
    """What measured, with its calibration."""

    @field_validator("names")
    @classmethod
    def _numbers(cls, value: dict[str, str]) -> dict[str, str]:
        if wrong := [k for k in value if not re.fullmatch(r"[1-9]\d*", k)]:
            raise ValueError(
                f"{wrong[0]!r} is no number of a test mode, such as 1 or 12"
            )
        return value

    @field_validator("workers")
    @classmethod
    def _some(cls, value: Workers) -> Workers:
        return checked_workers(value)


class ModelSection(StudySection):
    """The deck."""

    deck: str
    """Main file of the bulk data."""
    units: UnitName = "SI"
    """Unit system of the deck."""
    fmax: float | None = Field(default=None, gt=0)
    """Modes are computed up to here, Hz; as high as a pair may be if not given."""
    solver: str = EMBEDDED
    """Of modes and updating (slepc: localise too): embedded, mystran, nastran, slepc, a plug-in."""
    ranks: int | None = Field(default=None, ge=1)
    """MPI processes of `solver = "slepc"`."""
    launcher: str = ""
    """What starts them, in place of `ranks`: "srun -n 64", "mpiexec --hostfile h -n 8"."""
    refine: int = Field(default=0, ge=0, le=3)
    """How often the mesh is refined before anything is computed."""
    regions: dict[str, list[int]] = {}
    """Name -> property numbers, for drawing and naming."""

    def engine(
        self, name: str = "", timeout: float | None = None
    ) -> ModalSolver | None:
        """The solver, or another that is named; None for the embedded one.

        Raises
        ------
        ConfigError
            If there is none of this name, or it takes no ranks, launcher or time limit.
        """
        name = name or self.solver
        ranks, launcher = (
            (self.ranks, self.launcher) if name == self.solver else (None, "")
        )
        made = solver(name, ranks=ranks, launcher=launcher, timeout=timeout)
        return None if name == EMBEDDED else made


class TestSection(StudySection):
    """The measurements: the sensor sheet, and a crew's log that lists the records, measured FRFs,
    or modes.

    Without a sheet the modes are frequencies alone.
    """

    sheet: str | None = None
    """The sensor sheet: .csv, .xlsx, .uff geometry; without it modes are frequencies alone."""
    log: str | None = None
    """The crew's log, .json: lists the records."""
    frfs: list[str] = []
    """Measured FRFs in place of hammer records: .uff, .h5, .npz."""
    modes: str | None = None
    """Modes identified elsewhere, or by `ringtrue ema` or `oma`: .json, .h5, .uff, .csv, .xlsx.
    """
    leave_out: list[str] = []
    """Channels that are not used: broken, or on a part that the deck does not have."""
    lines: str | None = None
    """Pairs of points to draw."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.modes is not None and (self.log is not None or self.frfs):
            raise ValueError(
                "modes take the place of a log and of frfs: give one of the two"
            )
        if self.sheet is None and (self.modes is None or self.leave_out or self.lines):
            raise ValueError(
                "a test needs a `sheet`; only `modes` that are frequencies alone have no channels"
            )
        return self


class IdentifySection(StudySection):
    """Bands of the identification; None: found from the data."""

    ambient_fmin: float | None = None
    """Lower end of the band of ambient records, Hz."""
    ambient_fmax: float | None = None
    """Upper end, Hz."""
    hammer_fmin: float | None = None
    """Lower end of the band of FRFs, Hz."""
    hammer_fmax: float | None = None
    """Upper end, Hz."""
    confidence: float = Field(default=0.5, ge=0, le=1)
    """Modes below are not used, but listed."""
    choice: str | None = None
    """A choice of modes by hand, .toml or .json; records by their names, or "hammer"."""

    @model_validator(mode="after")
    def _bands(self) -> Self:
        rising("ambient_", self.ambient_fmin, self.ambient_fmax)
        rising("hammer_", self.hammer_fmin, self.hammer_fmax)
        return self


class CandidateSection(StudySection):
    """One uncertain region: `targets = ["MAT1 7 E", "PBUSH 3 K1,K2,K3"]`."""

    name: str
    """Of the parameter."""
    targets: list[str]
    """Card fields with one common factor, as in "PBUSH 3 K1,K2,K3"."""
    lower: float = 0.2
    """Lower bound of the factor."""
    upper: float = 5.0
    """Upper bound of the factor."""
    std: float = Field(default=0.7, gt=0)
    """Prior standard deviation of x."""
    scale: Literal["log", "linear"] = "log"
    """x is the logarithm of the factor, or the factor less 1."""

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
    return tuple(
        CardField(words[0].upper(), int(words[1]), f.upper())
        for f in words[2].split(",")
    )


def target_words(parameter: Parameter) -> list[str]:
    """What a candidate of study.toml has as `targets`, a card each; empty for factors on some
    elements only.
    """
    fields: dict[str, list[str]] = {}
    for t in parameter.targets:
        fields.setdefault(f"{t.card} {t.id}", []).append(t.field)
    partly = bool(parameter.substructures) or any(t.elements for t in parameter.targets)
    return (
        [] if partly else [f"{card} {','.join(some)}" for card, some in fields.items()]
    )


class LocaliseSection(StudySection):
    """Where the model is wrong: error indicators, and a proposal of parameters."""

    most: int = Field(default=8, gt=0)
    """Parameters that are proposed."""
    kinds: list[Kind] = ["material", "property", "spring", "lump"]
    """Of candidates that are made from the deck."""
    pool: int = Field(default=24, ge=0)
    """Candidates made from the deck that are looked at closely; 0: none is made."""
    alike: float = Field(default=0.95, gt=0, le=1)
    """|cosine| from which on the data cannot tell two candidates from each other."""


class DampingRegionSection(StudySection):
    """A region with one loss factor, `targets = ["MAT1 7 GE"]`, or one dashpot, `targets = ["PBUSH
    3 B1,B2"]`.
    """

    name: str
    """Of the region."""
    targets: list[str]
    """Card fields of one loss factor, or of one dashpot."""
    lower: float = Field(default=0.0, ge=0)
    """Lower bound."""
    upper: float | None = Field(default=None, gt=0)
    """Upper bound."""
    expected: float | None = Field(default=None, ge=0)
    """Before the data; typical of the kind if not given."""
    std: float | None = Field(default=None, gt=0)
    """Standard deviation of that."""

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


class DampingSection(StudySection):
    """Damping after stiffness and mass: loss factors and dashpots by region."""

    region: list[DampingRegionSection] = []
    """One a material and one a group of springs if empty."""
    error: float = Field(default=0.1, gt=0)
    """Of a mode's damping by the model's shapes, relative, 1 sigma."""
    write: bool = False
    """Into GE and B of a copy of the delivered deck, `damped`."""


class PredictSection(StudySection):
    """Running the rotor: what `ringtrue predict` computes."""

    rotor: int
    """Node that the unbalance acts on."""
    mass: float = Field(gt=0)
    """Of the rotor, kg."""
    axis: Literal["X", "Y", "Z"] = "X"
    """Of the rotor."""
    grade: float = Field(default=2.5, gt=0)
    """Balance grade G (ISO 21940-11), mm/s."""
    service: float = Field(default=50.0, gt=0)
    """Service speed, Hz."""
    fmax: float = Field(default=200.0, gt=0)
    """Highest speed, Hz."""
    springs: dict[str, list[int]] = {}
    """Name -> PBUSH numbers whose forces are wanted."""
    lines: int = Field(default=800, ge=2)
    """Number of speeds."""
    draws: int = Field(default=60, ge=20)
    """Of the posterior."""
    level: float = Field(default=0.9, ge=0.5, le=0.95)
    """Probability of the bands."""


class ConfigurationSection(StudySection):
    """Another state of the structure with a test of its own; its deck, or cards that the deck of
    the study gets.
    """

    name: str
    """Names a folder, too."""
    deck: str | None = None
    """Its own deck, in place of `cards`."""
    cards: str | None = None
    """A file of cards that are added to the (remodelled) deck of the study."""
    sheet: str | None = None
    """The sensor sheet."""
    log: str | None = None
    """Of the crew, in place of `modes`."""
    modes: str | None = None
    """A file of test modes; without a sheet channels are DOFs such as 101+Z."""
    lines: str | None = None
    """Pairs of points to draw."""
    choice: str | None = None
    """As under [identify], of this log."""
    left_out: int = Field(default=0, ge=0)
    """Modes that the updating must not see."""

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
            raise ValueError(
                "a configuration has a sheet and a log, or a file of modes"
            )
        return self


class ReportSection(StudySection):
    """The report."""

    photos: list[str] = []
    """Files of pictures."""
    captions: list[str] = []
    """One a picture."""
    reasons: dict[str, str] = {}
    """Why a check that does not hold is borne, by its name, such as {"final: pairs" = "..."}."""
