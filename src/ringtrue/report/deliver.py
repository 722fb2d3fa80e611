"""From a finished study to its files: report.html and summary.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ringtrue.io.files import atomic_write
from ringtrue.report.build import Acceptance, Photo, build
from ringtrue.study.acceptance import Check, verdict
from ringtrue.study.config import StudyConfig
from ringtrue.study.run import StudyRun, load_study
from ringtrue.study.summary import finite, summarise


def deliver(
    run: StudyRun, extra: Mapping[str, Any] | None = None, *, checks: Sequence[Check] | None = None
) -> Path:
    """Write summary.json and report.html into the folder of the run; returns the report.

    `checks` are what must hold; by default those of any study and the limits that this one states.
    """
    summary = finite(summarise(run) | dict(extra or {}))
    with atomic_write(run.folder / "summary.json") as part:
        part.write_text(json.dumps(summary, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return _report(run, run.folder / "report.html", checks)


def report_from_store(store: Path, target: Path | None = None) -> Path:
    """The report of a stored study, beside its store unless `target` says otherwise."""
    return _report(load_study(store), target or store.with_name("report.html"))


def _report(run: StudyRun, out: Path, checks: Sequence[Check] | None = None) -> Path:
    config: StudyConfig = run.config
    captions = [*config.report.captions, *[""] * len(config.report.photos)]
    photos = [
        Photo(run.desk.base / p, t) for p, t in zip(config.report.photos, captions, strict=False)
    ]
    stages = {k: v for k, v in run.results.items() if v is not None}
    acceptance = Acceptance.of(config.correlate)
    return build(
        stages,
        out,
        title=config.study.title,
        system_text=config.study.system,
        acceptance=acceptance,
        photos=photos,
        checks=verdict(config, stages) if checks is None else checks,
    )
