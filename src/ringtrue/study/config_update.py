"""The sections of study.toml that say what is compared in the updating, and how it is minimised."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from ringtrue.study.config_sections import StudySection

ModalKind = Literal["eigenvalues", "frequencies", "shapes", "mac", "modal masses"]
Positive = Annotated[float, Field(gt=0)]


FREQUENCY_KINDS = ("eigenvalues", "frequencies")  # residuals that need no shapes
Discrepancy = Literal["found", "assumed", "evidence"]
Prior = Literal["study", "evidence", "gcv", "l-curve"]
Robust = Literal["squares", "huber"]
Written = Literal["proven", "all"]
BEGINS: dict[str, object] = {
    "starts": 1,
    "stages": [],
}  # where an updating begins: at the deck


class RemodelSection(StudySection):
    """A stated edit of the deck before updating: cards added to one of its files."""

    file: str
    """File of the deck that gets the cards."""
    cards: str
    """File of the cards."""
    reason: str
    """Of the change, for the report."""


class UpdateSection(StudySection):
    """Updating."""

    propose: bool = False
    """The proposal of the localisation is a parameter set; the only one without [[candidate]]."""
    choose: int = Field(default=6, gt=0)
    """Parameters of a set that is chosen by a rule."""
    left_out: int | None = Field(default=None, ge=0)
    """Modes to judge the result by; a third, 5 at most, if not given."""
    shape_weight: float = Field(default=1.0, ge=0)
    """Of shapes over frequencies."""
    iterations: int = Field(default=30, gt=0)
    """Limit of each part of the updating."""
    residuals: list[ModalKind] = Field(default=["eigenvalues", "shapes"])
    """What is compared of the paired modes."""
    frequency_error: Positive = 0.01
    """That the best model of this form keeps, relative; that of the test is added."""
    mac_error: Positive = 0.05
    """The same of 1 - MAC."""
    mass_error: Positive = 0.1
    """Of a modal mass, relative."""
    discrepancy: Discrepancy = "found"
    """Errors of the kinds of residuals: as left over, as given, or as likely."""
    prior: Prior = "study"
    """Rule for the weight of the prior."""
    loss: Robust = "squares"
    """Against a wrong mode."""
    write: Written = "proven"
    """Factors that the deck gets: those whose interval does not hold 1, or all."""
    starts: int = Field(default=1, gt=0)
    """Number of starts; the first is the deck."""
    stages: list[list[str]] = Field(default=[])
    """Growing sets of candidates that are freed one after the other, in place of starts."""

    @field_validator("residuals")
    @classmethod
    def _some(cls, value: list[str]) -> list[str]:
        if not value or len(set(value)) < len(value):
            raise ValueError(
                "residuals: at least one kind of the paired modes, each once"
            )
        return value

    @model_validator(mode="after")
    def _one_beginning(self) -> Self:
        begins_once({n: getattr(self, n) for n in BEGINS})
        return self

    def otherwise(self, change: Mapping[str, Any]) -> UpdateSection:
        """The same but for some settings; one that says where it begins takes the place of all that
        do.
        """
        dropped = BEGINS if any(n in BEGINS for n in change) else {}
        kept = {
            n: v
            for n, v in self.model_dump(exclude_unset=True).items()
            if n not in dropped
        }
        return UpdateSection.model_validate(kept | dict(change))

    def of_frequencies(self) -> Self:
        """The same without what needs shapes: frequencies alone are compared."""
        kinds = [k for k in self.residuals if k in FREQUENCY_KINDS] or ["frequencies"]
        return self.model_copy(update={"residuals": kinds, "shape_weight": 0.0})

    @property
    def sharpened(self) -> bool:
        """Whether the last part of an updating weighs deviations by what the parts before have
        left.

        Not where the user gives the errors and does not ask for it, and not with a robust loss:
        what a few wrong data leave says nothing of the others.
        """
        given = (
            self.model_fields_set & {"frequency_error", "mac_error"}
            and "discrepancy" not in self.model_fields_set
        )
        return self.discrepancy == "found" and not given and self.loss == "squares"

    @property
    def plain(self) -> bool:
        """Whether eigenvalues and shapes are compared by squares, with a prior and errors as given
        or left over.
        """
        usual = (
            self.loss == "squares"
            and self.prior == "study"
            and self.discrepancy != "evidence"
        )
        at_the_deck = all(getattr(self, n) == v for n, v in BEGINS.items())
        return (
            usual and set(self.residuals) == {"eigenvalues", "shapes"} and at_the_deck
        )


def begins_once(settings: Mapping[str, object]) -> None:
    """Refuse settings of which more than one says where an updating begins.

    Raises
    ------
    ValueError
        With what was asked.
    """
    asked = [n for n, plain in BEGINS.items() if settings.get(n) not in (None, plain)]
    if len(asked) > 1:
        raise ValueError(
            f"{' and '.join(asked)}: an updating begins in one way: starts = N or stages"
        )


class UncertaintySection(StudySection):
    """How well the updated parameters and what the model predicts are known."""

    folds: int = Field(default=5, ge=2)
    """Of the used modes, each left out once."""
    level: float = Field(default=0.9, gt=0, lt=1)
    """Probability of intervals and bands."""
    samples: int = Field(default=0, ge=0)
    """Of the posterior by Markov chains; 0: the normal approximation alone."""


AUTOMATIC = frozenset(
    {"proposal", "best subset", "orthogonal sensitivities", "largest sensitivities"}
)  # sets
JUDGED = (
    "residuals",
    "shape_weight",
    "frequency_error",
    "mac_error",
    "loss",
)


class SetSection(StudySection):
    """A parameter set to compare: some candidates, and what it does otherwise than [update]."""

    name: str
    """Of the set."""
    candidates: list[str] = Field(default=[])
    """By name; all if empty. The other keys are as under [update]."""
    shape_weight: float | None = Field(default=None, ge=0)
    residuals: list[ModalKind] | None = None
    frequency_error: Positive | None = None
    mac_error: Positive | None = None
    discrepancy: Discrepancy | None = None
    prior: Prior | None = None
    loss: Robust | None = None
    starts: int | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _one_beginning(self) -> Self:
        begins_once(self.own())
        return self

    def own(self) -> dict[str, object]:
        """What it does otherwise."""
        return {
            k: v
            for k, v in self.model_dump(exclude={"name", "candidates"}).items()
            if v is not None
        }

    def settings(self, update: UpdateSection) -> UpdateSection:
        """[update] as this set has it."""
        return update.otherwise(self.own())

    def comparable(self, update: UpdateSection) -> bool:
        """Whether its J weighs data as that of the other sets does."""
        mine = self.settings(update)
        return all(getattr(mine, k) == getattr(update, k) for k in JUDGED)

    def words(self) -> str:
        """What it does otherwise, in words."""
        words = []
        for key, value in self.own().items():
            text = " ".join(value) if isinstance(value, list) else str(value)
            words.append(f"{key.replace('_', ' ')} {text}")
        return ", ".join(words)


class ConstraintSection(StudySection):
    """Σ factor · x <= most over candidates by name; x is ln(updated/initial), or updated/initial −
    1 where linear.
    """

    terms: dict[str, float]
    """Factor of each candidate."""
    most: float = 0.0
    """Upper limit of the sum."""

    @field_validator("terms")
    @classmethod
    def _some(cls, value: dict[str, float]) -> dict[str, float]:
        if not any(value.values()):
            raise ValueError(
                'a constraint needs at least one candidate: terms = { "a" = 1.0, "b" = -1.0 }'
            )
        return value


class _DataResidual(StudySection):
    name: str = ""
    """In results; the kind if not given."""
    weight: Positive = 1.0
    """On the squares."""
    configuration: str | None = None
    """That it was measured on; the study's own deck if not given."""


class FrfResidual(_DataResidual):
    """Measured FRFs; each counts as one datum."""

    kind: Literal["frf"]
    file: str | None = None
    """.uff, .h5 or .npz; the FRFs of the test if not given."""
    form: Literal["log", "complex"] = "log"
    """Logarithms of the moduli, or complex values."""
    error: Positive = 0.3
    """Of ln|H|, or of H over its root mean square."""
    fmin: float | None = None
    """Lower end of the band, Hz; around the modes of the test if not given."""
    fmax: float | None = None
    """Upper end, Hz."""
    count: int = Field(default=60, gt=0)
    """Lines, spread evenly over the measured ones."""
    lines: list[Positive] = Field(default=[])
    """Chosen by hand, Hz."""
    outputs: list[str] = Field(default=[])
    """Channels; all if empty."""
    inputs: list[str] = Field(default=[])
    """Channels; all if empty."""
    damping: float | None = Field(default=None, ge=0)
    """Ratio of all modes; as the test modes have, by frequency, if not given."""


class AntiResonanceResidual(_DataResidual):
    """Zeros of one FRF, in Hz."""

    kind: Literal["anti-resonances"]
    output: str
    """Channel of the response."""
    input: str
    """Channel of the force."""
    frequencies: list[Positive]
    """Of the zeros, Hz."""
    error: Positive = 0.01
    """Relative."""
    gate: Positive = 0.3
    """Largest relative deviation of a pair."""


class StaticResidual(_DataResidual):
    """A table of static tests with the columns case, channel, load (N), deflection (m)."""

    kind: Literal["static"]
    file: str
    """.csv or .xlsx."""
    error: Positive = 0.02
    """Relative to the root mean square of the case."""


class MassResidual(_DataResidual):
    """A weighing."""

    kind: Literal["mass"]
    mass: float | None = Field(default=None, gt=0)
    """kg."""
    mass_error: Positive = 0.005
    """Relative."""
    center: list[float] | None = None
    """m, basic frame; nan where not measured."""
    center_error: Positive = 0.01
    """m."""
    inertia: list[float] | None = None
    """kg m², Ixx Iyy Izz Ixy Iyz Izx (tensor) about the centre of gravity."""
    inertia_error: Positive = 0.02
    """Relative to the largest."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.mass is None and self.center is None and self.inertia is None:
            raise ValueError("a weighing gives mass, center or inertia")
        if len(self.center or [0.0] * 3) != 3 or len(self.inertia or [0.0] * 6) != 6:
            raise ValueError(
                "center is x y z, inertia Ixx Iyy Izz Ixy Iyz Izx; nan where not measured"
            )
        return self


DataResidual = FrfResidual | AntiResonanceResidual | StaticResidual | MassResidual
ResidualSection = Annotated[DataResidual, Field(discriminator="kind")]
