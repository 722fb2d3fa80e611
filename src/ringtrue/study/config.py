"""study.toml as a typed tree; unknown keys are refused with the nearest allowed one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationError,
    field_validator,
    model_validator,
)

from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.io.files import read_text
from ringtrue.io.foreign.parsers import toml_value
from ringtrue.model.refine import NODES
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.config_sections import (
    OF_SHAPES,
    CandidateSection,
    ConfigurationSection,
    CorrelateSection,
    DampingSection,
    IdentifySection,
    LocaliseSection,
    ModelSection,
    PlanSection,
    PredictSection,
    ReportSection,
    StudyInfo,
    TestSection,
    parse_target,
)
from ringtrue.study.config_update import (
    AUTOMATIC,
    FREQUENCY_KINDS,
    ConstraintSection,
    RemodelSection,
    ResidualSection,
    SetSection,
    UncertaintySection,
    UpdateSection,
)


class StudyConfig(BaseModel):
    """The whole study; `model` or `test` may be absent, not both."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    study: StudyInfo = StudyInfo()
    model: ModelSection | None = None
    plan: PlanSection | None = None
    test: TestSection | None = None
    identify: IdentifySection = IdentifySection()
    correlate: CorrelateSection = CorrelateSection()
    remodel: list[RemodelSection] = []  # one [remodel] or several [[remodel]], in order
    candidate: list[CandidateSection] = []
    suspension: list[CandidateSection] = []
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
            raise ValueError(
                f"[[set]]: names of their own, none of {', '.join(sorted(AUTOMATIC))}"
            )
        if self.candidate:
            self.check_names([c.name for c in self.candidate])
        there = {c.name for c in self.configuration}
        if lost := sorted(
            {r.configuration for r in self.residual if r.configuration} - there
        ):
            raise ValueError(f"[[residual]]: no configuration {lost[0]!r}")
        if self.residual and self.model is not None and self.model.solver != EMBEDDED:
            raise ValueError(
                f"[[residual]] {self.residual[0].kind}: [model] solver {self.model.solver!r} "
                "gives modes alone; what "
                "was measured besides them needs the embedded solver"
            )
        if self.configuration and (self.model is None or self.test is None):
            raise ValueError(
                "configurations need a [model] and a [test] that they are others of"
            )
        if self.model is not None and self.model.refine:
            self._refinable(self.model.solver)
        return self

    @model_validator(mode="after")
    def _nothing_of_shapes(self) -> Self:
        """What a test of frequencies alone cannot be asked."""
        why = "[test] without a `sheet` is of frequencies alone"
        if self.frequency_only and self.model is None:
            raise ValueError(f"{why}: it needs a [model] to compare them with")
        asked = [
            f"[correlate] {name}"
            for name in sorted(OF_SHAPES & self.correlate.model_fields_set)
        ]
        given = (
            self.update.residuals if "residuals" in self.update.model_fields_set else []
        )
        asked += [
            f"[update] residuals {kind}"
            for kind in given
            if kind not in FREQUENCY_KINDS
        ]
        asked += [
            f"[[set]] residuals {kind}"
            for s in self.set
            for kind in s.residuals or []
            if kind not in FREQUENCY_KINDS
        ]
        asked += ["[[configuration]]"] if self.configuration else []
        if self.frequency_only and asked:
            raise ValueError(f"{why}: {asked[0]} asks for shapes")
        return self

    def _refinable(self, solver: str) -> None:
        if solver != EMBEDDED:
            raise ValueError(
                f"[model] refine: solver {solver!r} solves decks as they are; leave one of the "
                "two out"
            )
        targets = [
            parse_target(t)[0]
            for c in (*self.candidate, *self.suspension)
            for t in c.targets
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
    def frequency_only(self) -> bool:
        """Whether the test holds frequencies and no shapes."""
        return self.test is not None and self.test.sheet is None

    @property
    def lending(self) -> dict[str, Any] | None:
        """What decides which modes of the deck frequencies alone are taken for; None where shapes
        were measured.
        """
        if not self.frequency_only or self.model is None:
            return None
        asked = self.correlate.model_dump(include={"frequency_gate", "lock", "forbid"})
        return self.model.model_dump() | asked

    def compared(self) -> Self:
        """The study without what needs shapes, where its test has none."""
        if not self.frequency_only:
            return self
        limits = self.correlate.model_copy(update={"accept_mac": None})
        limits.model_fields_set.discard("accept_mac")
        return self.model_copy(
            update={"update": self.update.of_frequencies(), "correlate": limits}
        )

    @property
    def joint(self) -> bool:
        """Whether sets are chosen by the general objective: more than eigenvalues and shapes of one
        deck.
        """
        return bool(
            self.configuration
            or self.residual
            or self.constraint
            or not self.update.plain
        )

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


def explain(
    path: Path, error: ValidationError, top: type[BaseModel], whole: str = "study"
) -> str:
    """One line for each mistake in a file that should be a `top`."""
    lines = []
    for e in error.errors():
        place = ".".join(str(x) for x in e["loc"])
        if e["type"] == "extra_forbidden":
            hint = did_you_mean(str(e["loc"][-1]), _allowed(top, e["loc"][:-1]))
            lines.append(f"{path}: unknown key {place!r}{hint}")
        else:
            lines.append(f"{path}: {place or whole}: {_value_error(dict(e), place)}")
    return "\n".join(lines)


def _value_error(e: Mapping[str, Any], place: str) -> str:
    """What is wrong with a value, and what was given."""
    given = e["input"]
    about = e.get("ctx", {})
    if e["type"] == "model_type" and isinstance(given, list):
        return f"one section, not a list of them (in TOML [{place}], not [[{place}]])"
    if e["type"] == "list_type" and isinstance(given, dict):
        return f"a list of sections, not one (in TOML [[{place}]], not [{place}])"
    if e["type"] == "union_tag_not_found":
        return "Field required: kind"
    if e["type"] == "union_tag_invalid":
        allowed = [x.strip(" '") for x in about["expected_tags"].split(",")]
        return f"unknown kind {about['tag']!r}{did_you_mean(about['tag'], allowed)}"
    got = (
        f" (got {given!r})"
        if isinstance(given, str | int | float | list) and e["type"] != "missing"
        else ""
    )
    return str(e["msg"]).removeprefix("Value error, ") + got


def _allowed(top: type[BaseModel], location: tuple[Any, ...]) -> list[str]:
    """The keys of the section at a location; a step that is no key is the `kind` of one of several
    sections.
    """
    here = [top]
    for step in (s for s in location if not isinstance(s, int)):
        of_kind = [
            m
            for m in here
            if "kind" in m.model_fields
            and step in get_args(m.model_fields["kind"].annotation)
        ]
        fields = [
            m.model_fields[step].annotation for m in here if step in m.model_fields
        ]
        here = of_kind or [m for f in fields for m in _sections_in(f)]
    return [name for m in here for name in m.model_fields]


def _sections_in(annotation: Any) -> list[type[BaseModel]]:
    """All sections in an annotation such as list[A | B] or A | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in get_args(annotation) for m in _sections_in(part)]
