"""The blocks a section is made of; the templates draw them.

The stage results of a study by name, any of them absent.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from ringtrue import __version__
from ringtrue.core.arrays import Float
from ringtrue.core.display import MISSING as MISSING
from ringtrue.core.display import number as number
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, InputError
from ringtrue.study.acceptance import Acceptance as Acceptance
from ringtrue.study.acceptance import AcceptanceCheck
from ringtrue.study.conclusion import Conclusion, repeats
from ringtrue.study.config_sections import StudyInfo
from ringtrue.study.results import (
    CompareStage,
    ConditionsStage,
    ConfigurationsStage,
    ConfiguredStage,
    CorrelateStage,
    DampingStage,
    FinalStage,
    IdentifyStage,
    LocaliseStage,
    ModelStage,
    PlanStage,
    PredictStage,
    Provenance,
    SensitivityStage,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)
from ringtrue.viewer.scene import View

IMAGES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
    ".gif": "image/gif",
}


@dataclass(frozen=True, slots=True)
class Photo:
    """A photograph of the user's.

    Attributes
    ----------
    path : Path
        PNG, JPEG, WebP or GIF; it is embedded.
    caption : str
    """

    path: Path
    caption: str = ""

    def data_url(self) -> str:
        """The whole picture as an address.

        Raises
        ------
        ConfigError
            If the type is not one of those above.
        InputError
            If there is no such file.
        """
        mime = IMAGES.get(self.path.suffix.lower())
        if mime is None:
            raise ConfigError(
                f"photo {self.path}: allowed are {', '.join(sorted(IMAGES))}"
            )
        if not self.path.is_file():
            raise InputError(f"photo {self.path}: no such file")
        raw = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:{mime};base64,{raw}"


@dataclass(frozen=True, slots=True)
class Cell:
    """A table cell that is more than text: `tone` in good, bad, warn, muted, chip, "" and a hint on
    hover.
    """

    text: str
    tone: str = ""
    hint: str = ""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Rows of texts or cells; a head that starts with `|` is left-aligned text, others are
    numbers.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    caption: str = ""
    foot: Sequence[str | Cell] = ()
    scroll: bool = False
    lead: int = 1  # columns that the first cell of the foot spans

    def without_blank(self, head: str) -> ReportTable:
        """The table without the columns with these words in their head, where no row has a number
        in them.
        """
        named = [i for i, h in enumerate(self.heads) if head in h]
        blank = [
            i for i in named if not any(re.search(r"\d", str(r[i])) for r in self.rows)
        ]

        def rest(cells: Sequence[str | Cell], first: int = 0) -> list[str | Cell]:
            return [c for i, c in enumerate(cells, start=first) if i not in blank]

        return replace(
            self,
            heads=[h for i, h in enumerate(self.heads) if i not in blank],
            rows=[rest(r) for r in self.rows],
            foot=rest(self.foot, self.lead - 1),
        )


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; `tone` lead, note or empty."""

    text: str
    tone: str = ""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading inside a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Items:
    """A bulleted list."""

    items: Sequence[str]
    title: str = ""


@dataclass(frozen=True, slots=True)
class Fact:
    """One number of the headline, with the one it came from."""

    label: str
    value: str
    unit: str = ""
    before: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """Headline numbers side by side."""

    facts: Sequence[Fact]


@dataclass(frozen=True, slots=True)
class Checks:
    """What must hold, and whether it held."""

    checks: Sequence[AcceptanceCheck]


@dataclass(frozen=True, slots=True)
class Key:
    """What the colours of the figures that follow mean: (name, colour)."""

    items: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Plot:
    """A figure with its caption."""

    figure: go.Figure
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Scene3D:
    """A 3D figure with its caption."""

    view: View
    caption: str = ""
    height: int = 520


@dataclass(frozen=True, slots=True)
class Diff:
    """A unified diff."""

    text: str
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Code:
    """Preformatted text, folded away on screen."""

    title: str
    text: str


@dataclass(frozen=True, slots=True)
class Picture:
    """A photograph, embedded."""

    photo: Photo


@dataclass(frozen=True, slots=True)
class Tabs:
    """Alternatives behind tabs; on paper one after the other."""

    tabs: Sequence[tuple[str, Sequence[Block]]]


@dataclass(frozen=True, slots=True)
class Fold:
    """Details, folded away on screen."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Columns:
    """Blocks side by side where the page is wide enough."""

    columns: Sequence[Sequence[Block]]


Block = (
    ReportTable
    | Text
    | Heading
    | Items
    | Facts
    | Checks
    | Key
    | Plot
    | Scene3D
    | Diff
    | Code
    | Picture
    | Tabs
    | Fold
    | Columns
)


@dataclass(frozen=True, slots=True)
class Section:
    """A numbered section with an anchor."""

    id: str
    title: str
    blocks: Sequence[Block]


def plain(value: float) -> str:
    """A setting as a person would write it: 16, 0.0625, 1.5."""
    return f"{value:.4g}".replace("-", "−")


def fixed(value: float | None, decimals: int, sign: bool = False) -> str:
    """A number with fixed decimals, so that a column lines up; `–` where unknown."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:{'+' if sign else ''}.{decimals}f}"
    return (text if float(text) else text.lstrip("+-")).replace("-", "−")


def sentence(text: str) -> str:
    """A remark of a stage as a sentence."""
    text = signs(text.strip())
    return text[:1].upper() + text[1:] + ("" if not text or text[-1] in ".!?" else ".")


def signs(text: str) -> str:
    """Typed relations, arrows, minus signs and quotes of settings as what they stand for."""
    text = re.sub(r"`([^`]*)`", r"“\1”", text)
    text = text.replace(">=", "≥").replace("<=", "≤").replace("->", "→")
    return re.sub(r"(?<=[\s(])-(?=\d)", "−", text)


@dataclass(frozen=True, slots=True)
class Stages:
    """What a report is made of; a stage that was not run is None."""

    info: StudyInfo
    acceptance: Acceptance
    conclusion: Conclusion | None = None
    photos: Sequence[Photo] = ()
    model: ModelStage | None = None
    plan: PlanStage | None = None
    identify: IdentifyStage | None = None
    compare: CompareStage | None = None
    conditions: ConditionsStage | None = None
    correlate: CorrelateStage | None = None
    configurations: ConfigurationsStage | None = None
    localise: LocaliseStage | None = None
    sensitivity: SensitivityStage | None = None
    update: UpdateStage | None = None
    tune: TuneStage | None = None
    final: FinalStage | None = None
    configured: ConfiguredStage | None = None
    uncertainty: UncertaintyStage | None = None
    damping: DampingStage | None = None
    predict: PredictStage | None = None
    provenance: Provenance | None = None

    @property
    def kind(self) -> str:
        """What the report is on."""
        return "Modal test" if self.model is None else "Finite element model validation"

    @property
    def meta(self) -> list[str]:
        """The lines below the title: when and with what, for whom and by whom."""
        info = self.info
        run = [f"ringtrue {__version__}"]
        if (p := self.provenance) is not None:
            run = [
                p.started[:16].replace("T", " "),
                f"ringtrue {p.version}",
                f"seed {p.seed}",
            ]
        client = f"for {info.client}" if info.client else ""
        revision = f"revision {info.revision}" if info.revision else ""
        people = [part for part in (client, revision, info.author) if part]
        return [" · ".join(parts) for parts in (run, people) if parts]

    @property
    def test(self) -> TestModel | None:
        """The test model as measured, else as planned; none of frequencies alone."""
        if self.identify is None:
            return self.plan.sensors.test if self.plan is not None else None
        hammer = self.identify.hammer
        if hammer is not None and hammer.modes.frequency_only:
            return None
        return self.identify.test

    @property
    def repeats(self) -> float:
        """How far one test repeats the frequencies of another, relative; NaN where there is one."""
        return repeats(self.compare, self.conditions)

    @property
    def computed(self) -> Float:
        """Frequencies of the initial deck, Hz: up to [model] fmax, or as far as the test asked for
        them.
        """
        found = [np.zeros(0)]
        if self.model is not None:
            found.append(self.model.modes.frequencies)
        if self.correlate is not None:
            found.append(self.correlate.fe_initial.frequencies)
        return max(found, key=len)

    @property
    def names(self) -> dict[float, str]:
        """Names that the study gives to test modes, by their frequency, Hz.

        Raises
        ------
        ConfigError
            If there is no mode of such a number.
        """
        modes = self.reference
        if modes is None and self.identify is not None:
            found = self.identify.hammer or self.identify.ambient
            modes = found.modes
        if modes is None:
            return {}
        lost = [k for k in self.info.names if int(k) > len(modes)]
        if lost:
            raise ConfigError(
                f"[study] names: no test mode {lost[0]}; there are {len(modes)}, numbered from 1"
            )
        f = modes.frequencies.tolist()
        return {f[int(k) - 1]: name for k, name in self.info.names.items()}

    @property
    def reference(self) -> ModeSet | None:
        """The test modes the model is judged by."""
        return self.correlate.reference.elastic if self.correlate is not None else None
