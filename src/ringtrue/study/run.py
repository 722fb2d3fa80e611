"""One driver for all stages: what is up to date is loaded, the rest is run, each result is stored
at once.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ringtrue import __version__
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.side_by_side import Workers, checked_workers, reached
from ringtrue.decks.nastran.editor import refuse_copy
from ringtrue.errors import ConfigError, DataError, InputError, did_you_mean
from ringtrue.io.files import absence, one_run, reads, writes
from ringtrue.model.edit import apply_factors, resolve_target
from ringtrue.study.config import StudyConfig, parse_config, read_config
from ringtrue.study.opened import Opened
from ringtrue.study.results import Provenance
from ringtrue.study.session import Session
from ringtrue.study.stages import STAGES, Stage
from ringtrue.study.stages.predict import check as check_rotor
from ringtrue.study.store import PROVENANCE, Store, locked
from ringtrue.study.store import SETS_FILE as SETS

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class StudyRun:
    """A finished run: results by stage, seconds by stage, and which stages were loaded rather than
    run.
    """

    folder: Path
    session: Session
    results: Mapping[str, Any]
    timings: Mapping[str, float] = field(default_factory=dict)
    loaded: tuple[str, ...] = ()

    @property
    def config(self) -> StudyConfig:
        """The settings."""
        return self.session.config


def _digest(path: Path) -> str:
    try:
        state = path.stat()
        return _hashed(path, state.st_mtime_ns, state.st_size)
    except (FileNotFoundError, IsADirectoryError) as e:
        raise DataError(
            f"{path}: {absence(path)}; the study, its log or its deck names it"
        ) from e


@lru_cache(maxsize=4096)
def _hashed(path: Path, mtime: int, size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _seen_from(base: Path, path: Path) -> str:
    """The path as seen from the folder of the study."""
    return Path(os.path.relpath(path.resolve(), base.resolve())).as_posix()


def stage_key(
    stage: Stage,
    session: Session,
    upstream: Mapping[str, str],
    inputs: Mapping[str, str],
) -> str:
    """A hash over the stage's settings, its input files, the version and the keys of the stages it
    needs.

    The files are those that the run began with (`inputs`, SHA-256 by path): it has read the deck,
    and may read no more.
    """
    settings = {
        name: json.loads(json.dumps(_plain(attrgetter(name)(session.config))))
        for name in stage.settings
    }
    files = {
        name: inputs[name]
        for name in (_seen_from(session.base, p) for p in stage.files(session))
    }
    needs = {n: upstream[n] for n in stage.needs if n in upstream}
    text = json.dumps([__version__, stage.name, settings, files, needs], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(section: Any) -> Any:
    if isinstance(section, list):
        return [_plain(s) for s in section]
    return section.model_dump() if hasattr(section, "model_dump") else section


@dataclass(frozen=True, slots=True)
class StageState:
    """How a stage of a study stands.

    Attributes
    ----------
    name, title : str
    standing : {"done", "stale", "missing"}
        Its stored result follows from what the study says now, or does not, or there is none.
    seconds : float
        That the stored result took; NaN where there is none.
    problem : str
        Why the stage cannot run, in words; empty where nothing keeps it.
    """

    name: str
    title: str
    standing: Literal["done", "stale", "missing"]
    seconds: float
    problem: str = ""


def stage_states(
    study: Path, out: Path | None = None, deck: Opened | None = None
) -> tuple[tuple[StageState, ...], Opened | None]:
    """How each stage of a study that applies stands, without running any, and the initial deck, if
    that took its reading.

    Parameters
    ----------
    study : Path
    out : Path, optional
        As in `run_study`.
    deck : Opened, optional
        The initial deck where it was read already.

    Raises
    ------
    ConfigError
        On a study file that is wrong.
    """
    session = Session.of(study, out)
    if deck is not None:
        session.initial = deck
    spent = session.store.timings()
    states = []
    for stage in (s for s in STAGES if s.applies(session)):
        standing: Literal["done", "stale", "missing"]
        standing = "stale" if stage.name in spent else "missing"
        problem = ""
        try:
            files = stage.files(session)
            inputs = {_seen_from(session.base, p): _digest(p) for p in files}
            key = stage_key(stage, session, session.keys, inputs)
            session.keys[stage.name] = key
            if stage.name in spent and session.store.key(stage.name) == key:
                standing = "done"
        except (InputError, OSError) as e:
            problem = str(e)
        seconds = spent.get(stage.name, float("nan"))
        states.append(StageState(stage.name, stage.title, standing, seconds, problem))
    return tuple(states), vars(session).get("initial")


def _position(name: str) -> int:
    names = [s.name for s in STAGES]
    if name not in names:
        raise ConfigError(f"no stage {name!r}{did_you_mean(name, names)}")
    return names.index(name)


def _span(session: Session, first: str | None, until: str | None) -> tuple[int, int]:
    """The first stage that is run anew whatever the store holds, and the last stage."""
    for name in (first, until):
        if name and not STAGES[_position(name)].applies(session):
            lost = " and no ".join(STAGES[_position(name)].missing(session)).replace(
                "|", " or "
            )
            raise ConfigError(
                f"stage {name!r} does not apply: the study has no section {lost}"
            )
    start = _position(first) if first else len(STAGES)
    stop = _position(until) if until else len(STAGES) - 1
    if first and start > stop:
        raise ConfigError(
            f"--from {first} comes after --until {until}; the order is "
            f"{', '.join(s.name for s in STAGES)}"
        )
    return start, stop


def _downstream(name: str) -> set[str]:
    """The stages that take results of a stage, directly or not."""
    out = {name}
    for stage in STAGES:
        if out & set(stage.needs):
            out.add(stage.name)
    return out - {name}


def _check_targets(session: Session, todo: Iterable[Stage]) -> None:
    """What the study names must be in the deck: found before hours of identification, not after."""
    names = {s.name for s in todo}
    if "damping" in names:
        for target in (
            t for r in session.config.damping.region for t in r.region().targets
        ):
            resolve_target(session.remodelled.model, target)
    if "predict" in names and session.config.predict is not None:
        check_rotor(session.remodelled.model, session.config.predict)
    if "final" in names:
        refuse_copy(session.own.deck.model, session.own.updated_folder)
    if "configured" in names:
        for c in session.others:
            refuse_copy(c.deck.model, c.updated_folder)
    if session.config.model is None:
        return
    for kind, given in (
        ("candidate", session.config.candidates()),
        ("suspension", session.config.suspensions()),
    ):
        for p in given.parameters:
            try:
                apply_factors(session.remodelled.model, ParameterSet((p,)), np.ones(1))
            except InputError as e:
                raise ConfigError(f"[[{kind}]] {p.name!r}: {e}") from e


def _protect(session: Session, files: Iterable[Path]) -> None:
    """What the study reads is never replaced by what it writes: found before anything is computed,
    not after.
    """
    photos = [session.base / p for p in session.config.report.photos]
    reads(*files, *photos)
    writes(
        session.store.path,
        *(session.out / name for name in (SETS, "summary.json", "report.html")),
    )


def run_study(
    study: Path,
    *,
    out: Path | None = None,
    first: str | None = None,
    until: str | None = None,
    workers: Workers | None = None,
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
        Stages from here on are run anew even if they are up to date; earlier ones are taken from
        the store.
    until : str, optional
        The last stage to run.
    workers : int or str, optional
        In place of [study] workers.
    progress : callable
        Called with the fraction done and a text.

    Raises
    ------
    ConfigError
        On a study file that is wrong, a stage that does not exist, or workers that cannot be
        reached.
    InputError
        If a file that the study reads would be replaced by one that it writes.
    DataError
        If another run has the folder.
    """
    config = read_config(study)
    if workers is not None:
        info = config.study.model_copy(update={"workers": checked_workers(workers)})
        config = config.model_copy(update={"study": info})
    reached(config.study.workers)
    text = study.read_text(encoding="utf-8")
    session = Session.of(study, out, config)
    with one_run(), locked(session.out):
        return _run(
            session, study, text=text, first=first, until=until, progress=progress
        )


def _run(
    session: Session,
    study: Path,
    text: str,
    first: str | None,
    until: str | None,
    progress: Progress,
) -> StudyRun:
    start, stop = _span(session, first, until)
    todo = [s for s in STAGES[: stop + 1] if s.applies(session)]
    files = [study, *(f for s in todo for f in s.files(session))]
    # SHA-256 by path; a file that is lost is found before anything is computed
    inputs = {_seen_from(session.base, p): _digest(p) for p in dict.fromkeys(files)}
    _protect(session, files)
    _check_targets(session, todo)
    loaded = []
    ran = False
    try:
        for i, stage in enumerate(todo):
            progress(i / len(todo), stage.title)
            session.keys[stage.name] = key = stage_key(
                stage, session, session.keys, inputs
            )
            stored = _intact_key(session, stage.name)
            if _position(stage.name) < start and stored == key:
                loaded.append(stage.name)
                continue
            began = time.perf_counter()
            result = stage.run(
                session, part(progress, i / len(todo), (i + 1) / len(todo))
            )
            stale = _downstream(stage.name) if stored != key else ()
            seconds = time.perf_counter() - began
            session.store.save(stage.name, key, result, seconds=seconds, drop=stale)
            ran = True
            # Later stages see what a resumed run would read: the order of an array in memory
            # decides which kernel of BLAS takes it, and so its last digit.
            session.put(stage.name, session.store.load(stage.name))
            log.info("%s: %.1f s", stage.name, seconds)
    except BaseException:
        # stopped by the user, too: what is stored can be reported, and the next run resumes
        if ran:
            _sign(session, inputs, text)
        raise
    progress(1.0, f"{todo[-1].title}: done")
    results = {s.name: session.get(s.name) for s in todo}
    made = _sign(session, inputs, text)
    return StudyRun(
        folder=session.out,
        session=session,
        results=results | {PROVENANCE: made},
        timings=made.timings,
        loaded=tuple(loaded),
    )


def _intact_key(session: Session, stage: str) -> str | None:
    """The key of a stored result that can be read; None where it is none of this code, damaged, or
    not there.

    Without a key the stage is run anew, and what was made of it goes, too.
    """
    try:
        key = session.store.key(stage)
        if key is not None:
            session.get(stage)
    except DataError as e:
        log.warning("run anew: %s", str(e).removesuffix("; run the study again"))
        return None
    return key


def _sign(session: Session, inputs: Mapping[str, str], text: str) -> Provenance:
    made = provenance(session, inputs, text)
    session.store.save(PROVENANCE, "", made)
    return made


def provenance(session: Session, inputs: Mapping[str, str], text: str) -> Provenance:
    """Where the results came from; each stage stands with the seconds of the run that made it.

    `inputs` are SHA-256 by path, `text` that of study.toml: as the run began.
    """
    spent = session.store.timings()
    return Provenance(
        version=__version__,
        python=platform.python_version(),
        packages={
            name: version(name)
            for name in ("numpy", "scipy", "h5py", "plotly", "pydantic")
        },
        platform=platform.platform(),
        seed=session.config.study.seed,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        inputs=dict(inputs),
        settings=text,
        timings={s.name: spent[s.name] for s in STAGES if s.name in spent},
        home=os.path.relpath(session.base.resolve(), session.out.resolve()),
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
    made = held.load(PROVENANCE)
    assert isinstance(made, Provenance)
    config = parse_config(made.settings, store)
    session = Session(config, store.parent / made.home, store.parent, held)
    there = held.stages()
    results = {
        s.name: held.load(s.name)
        for s in STAGES
        if s.name in there and s.applies(session)
    }
    return StudyRun(
        store.parent,
        session,
        results | {PROVENANCE: made},
        made.timings,
        tuple(results),
    )
