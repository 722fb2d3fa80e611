"""study.toml as a typed tree; unknown keys are refused with the nearest allowed one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.core.units import UnitName
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.io.files import read_text
from ringtrue.io.foreign.parsers import toml_value
from ringtrue.model.halves import NODES
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.config_correlate import OF_SHAPES, CorrelateSection
from ringtrue.study.config_errors import explain
from ringtrue.study.config_plan import PlanSection, rising
from ringtrue.study.config_update import (
    ALONE,
    AUTOMATIC,
    ConstraintSection,
    RemodelSection,
    ResidualSection,
    SetSection,
    UncertaintySection,
    UpdateSection,
)
from ringtrue.updating.candidates import Kind
from ringtrue.updating.damping_regions import DampingRegion


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class StudyInfo(_Section):
    """What is studied."""

    title: str = "Model validation"
    system: str = ""  # a paragraph or more for the report
    seed: int = 0


class ModelSection(_Section):
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


class TestSection(_Section):
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


class IdentifySection(_Section):
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


class Candidate(_Section):
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
        return Parameter(self.name, targets, self.lower, self.upper, self.scale, self.std)


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


class LocaliseSection(_Section):
    """Where the model is wrong: error indicators, and a proposal of parameters."""

    most: int = Field(default=8, gt=0)  # parameters that are proposed
    kinds: list[Kind] = ["material", "property", "spring", "lump"]
    pool: int = Field(
        default=24, ge=0
    )  # candidates made from the deck that are looked at closely; 0: none is made
    alike: float = Field(
        default=0.95, gt=0, le=1
    )  # |cosine| from which on the data cannot tell two apart


class DampingRegionSection(_Section):
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
        return DampingRegion(self.name, targets, self.lower, self.upper, self.expected, self.std)


class DampingSection(_Section):
    """Damping after stiffness and mass: loss factors and dashpots by region."""

    region: list[DampingRegionSection] = []  # empty: one a material and one a spring group
    error: float = Field(
        default=0.1, gt=0
    )  # of a mode's damping by the model's shapes, relative, 1 sigma
    write: bool = False  # into GE and B of a copy of the delivered deck, out/damped


class PredictSection(_Section):
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


class ConfigurationSection(_Section):
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


class ReportSection(_Section):
    """The report."""

    photos: list[str] = []
    captions: list[str] = []


class StudyConfig(_Section):
    """The whole study; `model` or `test` may be absent, not both."""

    study: StudyInfo = StudyInfo()
    model: ModelSection | None = None
    plan: PlanSection | None = None
    test: TestSection | None = None
    identify: IdentifySection = IdentifySection()
    correlate: CorrelateSection = CorrelateSection()
    remodel: list[RemodelSection] = []  # one [remodel] or several [[remodel]], in order
    candidate: list[Candidate] = []
    suspension: list[Candidate] = []
    configuration: list[ConfigurationSection] = []
    localise: LocaliseSection = LocaliseSection()
    update: UpdateSection = UpdateSection()
    residual: list[ResidualSection] = []
    constraint: list[ConstraintSection] = []
    set: list[SetSection] = []
    uncertainty: UncertaintySection = UncertaintySection()
    damping: DampingSection = DampingSection()
    predict: PredictSection | None = None
    report: ReportSection = ReportSection()

    @field_validator("remodel", mode="before")
    @classmethod
    def _steps(cls, value: object) -> object:
        return [value] if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.model is None and self.test is None:
            raise ValueError("a study needs a [model], a [test] or both")
        names = [c.name for c in (*self.candidate, *self.suspension)]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise ValueError(
                f"candidates and suspensions need names of their own; twice: {', '.join(twice)}"
            )
        if len({c.name for c in self.configuration}) != len(self.configuration):
            raise ValueError("configurations need names of their own")
        if self.set and not self.candidate:
            raise ValueError("[[set]] needs [[candidate]]s that it names")
        if len({s.name for s in self.set} - AUTOMATIC) != len(self.set):
            raise ValueError(f"[[set]]: names of their own, none of {', '.join(sorted(AUTOMATIC))}")
        if self.candidate:
            self.check_names([c.name for c in self.candidate])
        there = {c.name for c in self.configuration}
        if lost := sorted({r.configuration for r in self.residual if r.configuration} - there):
            raise ValueError(f"[[residual]]: no configuration {lost[0]!r}")
        if self.residual and self.model is not None and self.model.solver != EMBEDDED:
            raise ValueError(
                f"[[residual]] {self.residual[0].kind}: [model] solver {self.model.solver!r} "
                "gives modes alone; what "
                "was measured beside them needs the embedded solver"
            )
        anywhere = "global" in (self.update.search, *(s.search for s in self.set))
        if anywhere and self.model is not None and self.model.solver != EMBEDDED:
            raise ValueError(
                'search = "global" takes thousands of points: [model] solver '
                f"{self.model.solver!r} cannot"
            )
        if self.configuration and (self.model is None or self.test is None):
            raise ValueError("configurations need a [model] and a [test] that they are others of")
        if self.model is not None and self.model.refine:
            self._refinable(self.model.solver)
        return self

    @model_validator(mode="after")
    def _nothing_of_shapes(self) -> Self:
        """What a test of frequencies alone cannot be asked."""
        why = "[test] without a `sheet` is of frequencies alone"
        if self.alone and self.model is None:
            raise ValueError(f"{why}: it needs a [model] to compare them with")
        asked = [
            f"[correlate] {name}" for name in sorted(OF_SHAPES & self.correlate.model_fields_set)
        ]
        given = self.update.residuals if "residuals" in self.update.model_fields_set else []
        asked += [f"[update] residuals {kind}" for kind in given if kind not in ALONE]
        asked += [
            f"[[set]] residuals {kind}"
            for s in self.set
            for kind in s.residuals or []
            if kind not in ALONE
        ]
        asked += ["[[configuration]]"] if self.configuration else []
        if self.alone and asked:
            raise ValueError(f"{why}: {asked[0]} asks for shapes")
        return self

    def _refinable(self, solver: str) -> None:
        if solver != EMBEDDED:
            raise ValueError(
                f"[model] refine: solver {solver!r} solves decks as they are; leave one of the "
                "two out"
            )
        targets = [
            parse_target(t)[0] for c in (*self.candidate, *self.suspension) for t in c.targets
        ]
        if split := next((t.card for t in targets if t.card in NODES), None):
            raise ValueError(
                f"[model] refine splits every {split}: a candidate may target its property instead"
            )

    def check_names(self, candidates: Sequence[str]) -> None:
        """Refuse sets, stages and constraints that name none of the candidates, by a
        ConfigError.
        """
        named = {
            "update.stages": [n for stage in self.update.stages for n in stage],
            "[[constraint]]": [n for c in self.constraint for n in c.terms],
            "[[set]]": [n for s in self.set for n in s.candidates],
        }
        for where, names in named.items():
            if wrong := [n for n in names if n not in candidates]:
                raise ConfigError(
                    f"{where}: no candidate {wrong[0]!r}{did_you_mean(wrong[0], candidates)}"
                )

    @property
    def alone(self) -> bool:
        """Whether the test tells frequencies alone."""
        return self.test is not None and self.test.sheet is None

    @property
    def lending(self) -> dict[str, Any] | None:
        """What decides which modes of the deck frequencies alone are taken for; None where shapes
        were measured.
        """
        if not self.alone or self.model is None:
            return None
        asked = self.correlate.model_dump(include={"frequency_gate", "lock", "forbid"})
        return self.model.model_dump() | asked

    def compared(self) -> Self:
        """The study without what needs shapes, where its test has none."""
        if not self.alone:
            return self
        limits = self.correlate.model_copy(update={"accept_mac": None})
        limits.model_fields_set.discard("accept_mac")
        return self.model_copy(update={"update": self.update.alone(), "correlate": limits})

    @property
    def joint(self) -> bool:
        """Whether sets are chosen by the general objective: more than eigenvalues and shapes of one
        deck.
        """
        return bool(self.configuration or self.residual or self.constraint or not self.update.plain)

    @property
    def propose(self) -> bool:
        """Whether the proposal of the localisation is updated."""
        return self.update.propose

    def candidates(self) -> ParameterSet:
        """The candidate parameters that are given."""
        return ParameterSet(tuple(c.parameter() for c in self.candidate))

    def suspensions(self) -> ParameterSet:
        """The suspension parameters."""
        return ParameterSet(tuple(c.parameter() for c in self.suspension))


def read_config(path: Path) -> StudyConfig:
    """Read study.toml.

    Raises
    ------
    ConfigError
        On a file that is not there, is not TOML, or has a key or value that is not allowed.
    """
    try:
        return parse_config(read_text(path), path)
    except FileNotFoundError as e:
        raise ConfigError(f"{path}: no such file") from e
    except IsADirectoryError as e:
        raise ConfigError(f"{path}: a folder; name the study.toml in it") from e
    except DataError as e:
        raise ConfigError(str(e)) from e


def parse_config(text: str, path: Path) -> StudyConfig:
    """A configuration from text; `path` names it in errors.

    Raises
    ------
    ConfigError
        If it is not TOML, or has a key or value that is not allowed.
    """
    raw = toml_value(text, path, ConfigError)
    try:
        return StudyConfig.model_validate(raw).compared()
    except ValidationError as e:
        raise ConfigError(explain(path, e, StudyConfig)) from e
