"""One driver for all stages: what is up to date is loaded, the rest is run, each result is stored at once."""

from __future__ import annotations

import hashlib
import json
import logging
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ringtrue import __version__
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.study.config import StudyConfig, parse_config, read_config
from ringtrue.study.results import Provenance
from ringtrue.study.stages import STAGES, Stage
from ringtrue.study.store import Store
from ringtrue.study.workbench import Workbench

log = logging.getLogger(__name__)
Progress = Callable[[float, str], None]


def quiet(fraction: float, text: str) -> None:
    """A progress callable that shows nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class StudyRun:
    """A finished run: results by stage, seconds by stage, and which stages were loaded rather than run."""

    folder: Path
    desk: Workbench
    results: Mapping[str, Any]
    timings: Mapping[str, float] = field(default_factory=dict)
    loaded: tuple[str, ...] = ()

    @property
    def config(self) -> StudyConfig:
        """The settings."""
        return self.desk.config


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def stage_key(stage: Stage, desk: Workbench, upstream: Mapping[str, str]) -> str:
    """A hash over the stage's settings, its input files, the version and the keys of the stages it needs."""
    settings = {name: json.loads(json.dumps(_plain(getattr(desk.config, name)))) for name in stage.settings}
    files = {str(p.name): _digest(p) for p in stage.files(desk)}
    needs = {n: upstream[n] for n in stage.needs if n in upstream}
    text = json.dumps([__version__, stage.name, settings, files, needs], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(section: Any) -> Any:
    if isinstance(section, list):
        return [_plain(s) for s in section]
    return section.model_dump() if hasattr(section, "model_dump") else section


def _position(name: str) -> int:
    names = [s.name for s in STAGES]
    if name not in names:
        raise ConfigError(f"no stage {name!r}{did_you_mean(name, names)}")
    return names.index(name)


def run_study(
    study: Path,
    *,
    out: Path | None = None,
    first: str | None = None,
    until: str | None = None,
    progress: Progress = quiet,
) -> StudyRun:
    """Run a study from its toml file.

    Parameters
    ----------
    study : Path
        The study.toml; paths in it are relative to its folder.
    out : Path, optional
        Where study.h5 and what is delivered go; the folder of the study by default.
    first : str, optional
        Stages from here on are run anew even if they are up to date; earlier ones are taken from the store.
    until : str, optional
        The last stage to run.
    progress : callable
        Called with the fraction done and a text.

    Raises
    ------
    ConfigError
        On a study file that is wrong or a stage that does not exist.
    """
    config = read_config(study)
    folder = out or study.parent
    desk = Workbench(config, study.parent, folder, Store(folder / "study.h5"))
    start = _position(first) if first else len(STAGES)
    stop = _position(until) if until else len(STAGES) - 1
    keys: dict[str, str] = {}
    timings: dict[str, float] = {}
    loaded = []
    todo = [s for s in STAGES[: stop + 1] if s.applies(desk)]
    for i, stage in enumerate(todo):
        progress(i / len(todo), stage.title)
        keys[stage.name] = stage_key(stage, desk, keys)
        if _position(stage.name) < start and desk.store.key(stage.name) == keys[stage.name]:
            loaded.append(stage.name)
            continue
        began = time.perf_counter()
        result = stage.run(desk, _within(progress, i, len(todo)))
        desk.put(stage.name, result)
        desk.store.save(stage.name, keys[stage.name], result)
        timings[stage.name] = time.perf_counter() - began
        log.info("%s: %.1f s", stage.name, timings[stage.name])
    progress(1.0, "done")
    results = {s.name: desk.get(s.name) for s in todo}
    made = provenance(desk, [f for s in todo for f in s.files(desk)], study, timings)
    desk.store.save("provenance", "", made)
    return StudyRun(folder, desk, results | {"provenance": made}, made.timings, tuple(loaded))


def provenance(desk: Workbench, files: Iterable[Path], study: Path, timings: Mapping[str, float]) -> Provenance:
    """Where the results came from; seconds of stages that were loaded are those of their own run."""
    before = desk.get("provenance").timings if "provenance" in desk.store.stages() else {}
    unique = dict.fromkeys([study, *files])
    return Provenance(
        __version__,
        platform.python_version(),
        {name: version(name) for name in ("numpy", "scipy", "h5py", "plotly", "pydantic")},
        platform.platform(),
        desk.config.study.seed,
        datetime.now(UTC).isoformat(timespec="seconds"),
        {p.name: _digest(p) for p in unique},
        study.read_text(encoding="utf-8"),
        {**before, **timings},
    )


def load_study(store: Path) -> StudyRun:
    """A stored study, for its report.

    Raises
    ------
    DataError
        If there is no store.
    ConfigError
        If the study.toml that was stored with it is not valid any more.
    """
    held = Store(store)
    made = held.load("provenance")
    assert isinstance(made, Provenance)
    names = [s.name for s in STAGES]
    results = {n: held.load(n) for n in held.stages() if n in names}
    config = parse_config(made.settings, store)
    desk = Workbench(config, store.parent, store.parent, held)
    return StudyRun(store.parent, desk, results | {"provenance": made}, made.timings, tuple(results))


def _within(progress: Progress, i: int, n: int) -> Progress:
    return lambda fraction, text: progress((i + fraction) / n, text)
