"""Stored results in, one self-contained offline HTML file out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from ringtrue import __version__
from ringtrue.core.arrays import Any_
from ringtrue.io.files import atomic_write
from ringtrue.plots.scene import thinned
from ringtrue.plots.style import packed
from ringtrue.report.documents import print_page, write_word
from ringtrue.report.parts import Acceptance, Photo, Plot, Scene3D, Section, Stages
from ringtrue.report.sections import (
    conclusion,
    correlation,
    damping,
    identified,
    localised,
    planned,
    prediction,
    shapes,
    summary,
    system,
    updated,
)
from ringtrue.study.acceptance import AcceptanceCheck, verdict
from ringtrue.study.conclusion import conclude
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import StudyInfo
from ringtrue.study.run import StudyRun
from ringtrue.study.summary import finite, summarise
from ringtrue.viewer.scene import asset, script_json, to_json, viewer_script

__all__ = ["Acceptance", "Photo", "assemble"]

ReportFormat = Literal["html", "pdf", "docx"]

SECTIONS: tuple[Callable[[Stages], Section | None], ...] = (
    conclusion.section,
    summary.summary,
    system.survey,
    system.model,
    planned.section,
    system.signal_section,
    system.frf_section,
    identified.section,
    identified.diagrams,
    correlation.tests,
    correlation.initial,
    correlation.remodelled,
    localised.section,
    updated.choice,
    updated.updating,
    updated.suspension,
    correlation.final,
    correlation.configurations,
    shapes.section,
    prediction.uncertainty,
    damping.response,
    damping.damping,
    prediction.prediction,
    summary.provenance,
)

# of a test without a model: what was found, then what it was found in
TEST_SECTIONS: tuple[Callable[[Stages], Section | None], ...] = (
    summary.summary,
    identified.section,
    shapes.section,
    identified.diagrams,
    correlation.tests,
    system.survey,
    planned.section,
    system.frf_section,
    system.signal_section,
    summary.provenance,
)

DRAWN = 1_000_000  # nodes of all shapes together, eight bytes each in the page
# nodes that are drawn of a model
FEWEST = 3000
MOST = 12_000


@dataclass(frozen=True, slots=True)
class Report:
    """What a report says, to be shown as a page, on paper or as a document of Word.

    Attributes
    ----------
    data : Stages
    sections : sequence of Section
        Numbered from 1 in this order.
    """

    data: Stages
    sections: Sequence[Section]

    def page(self) -> str:
        """The whole page, which needs nothing else.

        Raises
        ------
        ConfigError, InputError
            If a photograph cannot be read.
        """
        return _render(self.data, self.sections)

    def write(self, out: Path, form: ReportFormat = "html") -> Path:
        """Write it to a file, which appears complete or not at all; returns `out`.

        Raises
        ------
        SolverMissing
            If there is no Chromium to print, or no python-docx.
        SolverFailed
            If Chromium did not draw it.
        """
        page = self.page()
        with atomic_write(out) as part:
            if form == "pdf":
                print_page(page, part)
            elif form == "docx":
                write_word(self.data, self.sections, page, part)
            else:
                part.write_text(page, encoding="utf-8")
        return out


def assemble(
    stages: Mapping[str, Any],
    *,
    info: StudyInfo,
    acceptance: Acceptance | None = None,
    photos: Sequence[Photo] = (),
    checks: Sequence[AcceptanceCheck] = (),
) -> Report:
    """The sections of the report of a study.

    Parameters
    ----------
    stages : mapping of str to stage result
        Any of model, plan, identify, compare, correlate, sensitivity, update, tune, final,
        provenance; a section whose stages are absent is left out.
    info : StudyInfo
        Headline, the system under test in words (paragraphs parted by empty lines), what the model
        is for, and who signs.
    acceptance : Acceptance
        When a mode is accepted.
    photos : sequence of Photo
        The user's own photographs, embedded.
    checks : sequence of AcceptanceCheck
        What must hold of the study, and whether it did.
    """
    stages = dict(stages)
    if (model := stages.get("model")) is not None:
        most = min(max(DRAWN // max(len(model.modes), 1), FEWEST), MOST)
        stages["model"] = replace(model, scene=thinned(model.scene, most))
    accepted = acceptance or Acceptance()
    data = Stages(info, accepted, conclude(stages, checks, accepted), photos, **stages)
    of_test = data.model is None and data.identify is not None
    order = TEST_SECTIONS if of_test else SECTIONS
    return Report(data, [s for s in (make(data) for make in order) if s is not None])


@dataclass(slots=True)
class _Figures:
    """Collects what the page draws by script, numbered in the order of the page."""

    plots: list[str] = field(default_factory=list)
    views: list[str] = field(default_factory=list)
    models: list[str] = field(default_factory=list)
    figure: int = 0
    table: int = 0

    def next_figure(self) -> int:
        self.figure += 1
        return self.figure

    def next_table(self) -> int:
        self.table += 1
        return self.table

    def add(self, block: Plot | Scene3D) -> int:
        """The position of the figure's data in its list."""
        if isinstance(block, Plot):
            self.plots.append(figure_json(block.figure))
            return len(self.plots) - 1
        self.views.append(to_json(self._shared(block.view.payload)))
        return len(self.views) - 1

    def _shared(self, payload: dict[str, Any]) -> dict[str, Any]:
        """The payload with its model, the same in every view, replaced by its position."""
        scene = payload["scene"]
        if "model" not in scene:
            return payload
        text = to_json(scene["model"])
        if text not in self.models:
            self.models.append(text)
        return payload | {"scene": scene | {"model": {"at": self.models.index(text)}}}


def _diff_lines(text: str) -> Iterator[tuple[str, str]]:
    for line in text.splitlines():
        head = line[:3] in ("+++", "---") or line.startswith("@@")
        yield ("head" if head else {"+": "plus", "-": "minus"}.get(line[:1], "")), line


def _environment() -> Environment:
    env = Environment(
        loader=PackageLoader("ringtrue.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters |= {
        "diff_lines": _diff_lines,
        "kind": lambda block: type(block).__name__,
        "script_json": script_json,
    }
    return env


def _render(data: Stages, sections: Sequence[Section]) -> str:
    env = _environment()
    figures = _Figures()
    source = env.loader
    assert source is not None

    def raw(name: str) -> str:
        return source.get_source(env, name)[0]

    short = {"summary", "identification", "shapes"}
    if data.model is not None:
        last = "initial" if data.final is None else "final"
        short = {"conclusion", "summary", last, "uncertainty", "prediction"}
    body = env.get_template("body.html.j2").render(
        data=data,
        sections=sections,
        short=short,
        figures=figures,
    )
    return env.get_template("report.html.j2").render(
        data=data,
        sections=sections,
        short=short,
        body=body.replace("|Δf|", "|\u2060Δf|"),  # no line break after the bar
        raw=raw,
        viewer_style=asset("viewer.css"),
        viewer_script=viewer_script(),
        plotly=get_plotlyjs() if figures.plots else "",
        version=__version__,
        plots=figures.plots,
        views=figures.views,
        models=figures.models,
    )


def figure_json(figure: go.Figure) -> str:
    """The JSON of a figure; traces whose `meta` says `overlay: n` (see plots.style.joined) are
    packed.

    The page unfolds them: the abscissa is stored once, ordinates as 16-bit parts of the largest.
    """
    text = str(figure.to_json())
    marked = [i for i, t in enumerate(figure.data) if t.meta]
    if not marked:
        return text
    spec = json.loads(text)
    for i in marked:
        trace = figure.data[i]
        spec["data"][i] |= _packed(trace.x, trace.y, trace.meta["overlay"])
    return json.dumps(spec, separators=(",", ":"), allow_nan=False)


def _packed(x: Any_, y: Any_, curves: int) -> dict[str, Any]:
    rows = np.nan_to_num(y.reshape(curves, -1)[:, :-1])
    peak = float(np.abs(rows).max(initial=0.0)) or 1.0
    meta = {
        "x": packed(x.reshape(curves, -1)[0, :-1], "<f4"),
        "q": packed(np.round(rows * (32767 / peak)), "<i2"),
        "peak": peak,
    }
    return {"x": [], "y": [], "meta": meta}


def deliver(
    run: StudyRun,
    extra: Mapping[str, Any] | None = None,
    *,
    checks: Sequence[AcceptanceCheck] | None = None,
) -> Path:
    """Write summary.json and report.html into the folder of the run; returns the report.

    `checks` are what must hold; by default those of any study and the limits that this one states.
    """
    summary = finite(summarise(run) | dict(extra or {}))
    with atomic_write(run.folder / "summary.json") as part:
        part.write_text(
            json.dumps(summary, indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
    return write_report(run, run.folder / "report.html", checks)


def write_report(
    run: StudyRun,
    out: Path,
    checks: Sequence[AcceptanceCheck] | None = None,
    *,
    form: ReportFormat = "html",
) -> Path:
    """The report of a run or of a stored study; see `Report.write`."""
    config: StudyConfig = run.config
    captions = [*config.report.captions, *[""] * len(config.report.photos)]
    photos = [
        Photo(run.session.base / p, t)
        for p, t in zip(config.report.photos, captions, strict=False)
    ]
    stages = {k: v for k, v in run.results.items() if v is not None}
    report = assemble(
        stages,
        info=config.study,
        acceptance=Acceptance.of(config.correlate),
        photos=photos,
        checks=verdict(config, stages) if checks is None else checks,
    )
    return report.write(out, form)
