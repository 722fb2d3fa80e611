"""Stored results in, one self-contained offline HTML file out."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from ringtrue import __version__
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.io.files import atomic_write
from ringtrue.plots.embedded import script_json
from ringtrue.report.pack import figure_json
from ringtrue.report.parts import Acceptance, Photo, Picture, Plot, Scene3D, Section
from ringtrue.report.sections import (
    after,
    choice,
    configurations,
    correlation,
    damping,
    identified,
    localised,
    measured,
    model,
    origin,
    planned,
    predicted,
    shapes,
    summary,
    survey,
    uncertain,
    updated,
)
from ringtrue.report.stages import Stages
from ringtrue.study.acceptance import Check

__all__ = ["Acceptance", "Photo", "build"]

SECTIONS: tuple[Callable[[Stages], Section | None], ...] = (
    summary.section,
    survey.section,
    model.section,
    planned.section,
    measured.signals,
    measured.functions,
    identified.section,
    correlation.tests,
    correlation.initial,
    correlation.remodelled,
    localised.section,
    choice.section,
    updated.section,
    updated.suspension,
    correlation.final,
    configurations.section,
    shapes.section,
    uncertain.section,
    after.section,
    damping.section,
    predicted.section,
    origin.section,
)

GEOMETRY = frozenset(("xyz", "tri", "tgroup", "line", "lgroup"))  # of a skin; the rest is its look


def build(
    stages: Mapping[str, object],
    out: Path,
    *,
    title: str,
    system_text: str = "",
    acceptance: Acceptance | None = None,
    photos: Sequence[Photo] = (),
    checks: Sequence[Check] = (),
) -> Path:
    """Write the report of a study.

    Parameters
    ----------
    stages : mapping of str to stage result
        Any of model, plan, identify, compare, correlate, sensitivity, update, tune, final,
        provenance; a section whose stages are absent is left out.
    out : Path
        The HTML file; it appears complete or not at all.
    title, system_text : str
        Headline, and the system under test in words (paragraphs parted by empty lines).
    acceptance : Acceptance
        When a mode is accepted.
    photos : sequence of Photo
        The user's own photographs, embedded.
    checks : sequence of Check
        What must hold of the study, and whether it did.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    ConfigError
        On a stage or section that does not exist.
    """
    data = Stages.of(stages, title, system_text, acceptance or Acceptance(), checks)
    sections = [s for s in (make(data) for make in SECTIONS) if s is not None]
    sections = [_with_photos(s, photos) for s in sections]
    _refuse_lost(photos, sections)
    page = _render(data, sections)
    out = Path(out)
    with atomic_write(out) as part:
        part.write_text(page, encoding="utf-8")
    return out


def _with_photos(section: Section, photos: Sequence[Photo]) -> Section:
    mine = [Picture(p) for p in photos if p.section == section.id]
    return replace(section, blocks=[*section.blocks, *mine]) if mine else section


def _refuse_lost(photos: Sequence[Photo], sections: Sequence[Section]) -> None:
    ids = [s.id for s in sections]
    for p in photos:
        if p.section not in ids:
            raise ConfigError(
                f"photo {p.path}: no section {p.section!r}{did_you_mean(p.section, ids)}"
            )


@dataclass(slots=True)
class _Figures:
    """Collects what the page draws by script, numbered in the order of the page."""

    plots: list[str] = field(default_factory=list)
    views: list[str] = field(default_factory=list)
    skins: list[str] = field(default_factory=list)
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
        self.views.append(_json(self._shared(block.view.payload)))
        return len(self.views) - 1

    def _shared(self, payload: dict[str, Any]) -> dict[str, Any]:
        """The payload with the geometry of its skin, the same in every view, replaced by its
        position.
        """
        if "skin" not in payload:
            return payload
        text = _json({k: v for k, v in payload["skin"].items() if k in GEOMETRY})
        if text not in self.skins:
            self.skins.append(text)
        look = {k: v for k, v in payload["skin"].items() if k not in GEOMETRY}
        return payload | {"skin": look | {"at": self.skins.index(text)}}


def _json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _data_url(photo: Photo) -> str:
    mime, raw = photo.read()
    return f"data:{mime};base64,{base64.b64encode(raw).decode('ascii')}"


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
    env.filters |= {"data_url": _data_url, "diff_lines": _diff_lines, "script_json": script_json}
    return env


def _render(data: Stages, sections: Sequence[Section]) -> str:
    env = _environment()
    figures = _Figures()
    source = env.loader
    assert source is not None

    def raw(name: str) -> str:
        return source.get_source(env, name)[0]

    body = env.get_template("body.html.j2").render(data=data, sections=sections, figures=figures)
    return env.get_template("report.html.j2").render(
        data=data,
        sections=sections,
        body=body.replace("|Δf|", "|\u2060Δf|"),  # no line break after the bar
        raw=raw,
        plotly=get_plotlyjs() if figures.plots else "",
        expected=len(figures.plots) + len(figures.views),
        version=__version__,
        plots=figures.plots,
        views=figures.views,
        skins=figures.skins,
    )
