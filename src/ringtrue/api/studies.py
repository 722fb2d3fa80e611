"""Whole studies: test plans, runs, predictions, and what a stored study holds."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from ringtrue.api.measurements import TestModes, merged_modes
from ringtrue.api.models import read_deck
from ringtrue.core.arrays import Float
from ringtrue.core.display import Displayed, plot
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.side_by_side import Workers
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.decks.nastran.editor import unified_diff
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.io.files import atomic_write, writes
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.planning.plan_files import (
    NAMES,
    PlannedExcitation,
    reach_of,
    write_test_sheet,
)
from ringtrue.report.build import ReportFormat as ReportFormat
from ringtrue.report.build import deliver, write_report
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study import run as runs
from ringtrue.study.config import read_config
from ringtrue.study.config_sections import PlanSection, PredictSection
from ringtrue.study.results import PlanStage, PredictStage, UpdateStage
from ringtrue.study.session import Session
from ringtrue.study.stages import predict as predict_stage
from ringtrue.study.store import STORE, Store
from ringtrue.study.summary import finite, summarise
from ringtrue.study.synthesis import (
    final_modes,
    initial_modes,
    measured_frfs,
    model_frfs,
)
from ringtrue.virtual.sensors import ICP

# a plan of its own, without ambient tests
ALONE: dict[str, Any] = {
    "sensors": 20,
    "references": 3,
    "ambient": False,
    "min_distance": "even",
    "strike": "worst",
}

Stage = Literal["initial", "final"]


@dataclass(frozen=True, eq=False)
class ParameterTable(Displayed):
    """The parameters of an updating.

    Attributes
    ----------
    names : tuple of str
    factors : (p,) float64
        Updated over initial value.
    std : (p,) float64
        Relative standard deviation.
    """

    names: tuple[str, ...]
    factors: Float
    std: Float


@dataclass(frozen=True, eq=False)
class Study:
    """A study that has been run; any result can be taken out of it.

    Attributes
    ----------
    folder : Path
        Where `study.h5` is.
    run : StudyRun
        Settings and results of all stages.
    """

    folder: Path
    run: runs.StudyRun

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that are stored, in their order."""
        return tuple(self.run.results)

    def stage(self, name: str) -> Any:
        """The stored result of a stage, with all its fields.

        Raises
        ------
        DataError
            If it is not stored.
        """
        found = self.run.results.get(name)
        if found is None:
            raise DataError(
                f"{self.folder}: no stage {name!r}{did_you_mean(name, self.stages)}"
            )
        return found

    @property
    def test(self) -> TestModes:
        """The identified modes, merged over all records."""
        return merged_modes(self.folder / STORE)

    @property
    def frfs(self) -> FrfSet:
        """The FRFs of the test."""
        found = self.stage("identify").frfs
        if found is None:
            raise DataError(f"{self.folder}: the study has no FRFs")
        assert isinstance(found, FrfSet)
        return found

    def modes(self, of: Stage = "final") -> ModeSet:
        """The modes of the initial or the final deck at the channels of the test."""
        if of == "initial":
            modes = self.stage("correlate").fe_initial
        else:
            modes = self.stage("final").observed
        assert isinstance(modes, ModeSet)
        return modes

    def pairs(self, of: Stage = "final") -> CorrelationTable:
        """The mode pairs of the initial or the final deck with the test."""
        table = (
            self.stage("final").table
            if of == "final"
            else self.stage("correlate").initial
        )
        assert isinstance(table, CorrelationTable)
        return table

    @property
    def parameters(self) -> ParameterTable:
        """The parameters of the chosen updating."""
        done: UpdateStage = self.stage("update")
        best = done.best
        return ParameterTable(tuple(best.parameters), best.factor, best.std)

    def model_frfs(self, of: Stage = "final") -> FrfSet:
        """The FRFs of the initial or the final deck at the channels and lines of those measured.

        Raises
        ------
        DataError
            If the study has no FRFs on its sheet, or was not run as far.
        """
        self.stage("correlate")
        own = self.run.session.own
        measured = measured_frfs(own)
        if measured is None:
            raise DataError(
                f"{self.folder}: the study has no FRFs at the channels of its sheet"
            )
        modes = (
            initial_modes(own)
            if of == "initial"
            else final_modes(own, self.stage("final"))
        )
        return model_frfs(own, modes, measured)

    @property
    def deck_diff(self) -> str:
        """The delivered deck against the initial one, as a unified diff.

        Raises
        ------
        DataError
            If no deck was delivered.
        """
        session = self.run.session
        folder = session.own.updated_folder
        inside = [Path(f).parts for f in self.stage("final").files]
        # stored as seen from where the study was run
        delivered = [folder.joinpath(*p[p.index(folder.name) + 1 :]) for p in inside]
        return unified_diff(session.initial.model.files, delivered)

    @property
    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        value = finite(summarise(self.run))
        assert isinstance(value, dict)
        return value

    def report(
        self, target: str | Path | None = None, form: ReportFormat = "html"
    ) -> Path:
        """Write the report anew; in the folder of the store if no file is named.

        Parameters
        ----------
        target : str or Path, optional
            The file.
        form : {"html", "pdf", "docx"}
            A page; the page printed by an installed Chromium; a document of Word, which needs
            `ringtrue[documents]`.

        Raises
        ------
        SolverMissing
            If Chromium or python-docx is not installed.
        """
        return write_report(
            self.run, Path(target or self.folder / f"report.{form}"), form=form
        )

    def plot(self) -> Any:
        """The MAC matrix of the last correlation, a plotly figure."""
        return plot(self.pairs("final" if "final" in self.stages else "initial"))

    def _repr_html_(self) -> str:
        table = self.pairs("final" if "final" in self.stages else "initial")
        return (
            f"<b>{self.run.config.study.title}</b>: "
            f"{', '.join(self.stages)}<br>{len(table)} pairs"
        )


def store_of(path: str | Path) -> Path:
    """The store that is meant by `study.h5`, its `study.toml`, or their folder."""
    path = Path(path)
    if path.is_dir():
        return path / STORE
    return path.with_name(STORE) if path.suffix.lower() == ".toml" else path


def open_study(path: str | Path) -> Study:
    """Open a study that has been run.

    Parameters
    ----------
    path : str or Path
        `study.h5`, its `study.toml`, or their folder.

    Raises
    ------
    DataError
        If there is no store, or it is damaged.
    """
    store = store_of(path)
    return Study(store.parent, runs.load_study(store))


def run_study(
    path: str | Path,
    *,
    out: str | Path | None = None,
    first: str | None = None,
    until: str | None = None,
    workers: Workers | None = None,
    progress: Progress = quiet,
) -> Study:
    """Run a study: what is up to date is taken from `study.h5`, the rest is computed.

    Writes `study.h5`, `report.html`, `summary.json` and the updated deck.

    Parameters
    ----------
    path : str or Path
        `study.toml`; paths in it are relative to its folder.
    out : str or Path, optional
        Where the results go; the folder of the study if not given.
    first, until : str, optional
        The first stage that is run anew, and the last one that is run.
    workers : int or str, optional
        Processes side by side, or the address of a dask scheduler; in place of `[study] workers`.

    Raises
    ------
    ConfigError
        If a setting is wrong, or there is no such stage.
    DataError
        If a file that the study names is missing or wrong.
    """
    folder = None if out is None else Path(out)
    run = runs.run_study(
        Path(path),
        out=folder,
        first=first,
        until=until,
        workers=workers,
        progress=progress,
    )
    deliver(run)
    return Study(run.folder, run)


def predict(
    study: str | Path,
    *,
    out: str | Path | None = None,
    settings: PredictSection | None = None,
    seed: int | None = None,
    progress: Progress = quiet,
) -> PredictStage:
    """Unbalance run-up of a rotor on the validated model of a study, with probability bands.

    Parameters
    ----------
    study : str or Path
        `study.toml` of a study that has been run to its final stage.
    out : str or Path, optional
        Where its results are.
    settings : PredictSettings, optional
        In place of `[predict]` of the study; the result is then not stored.
    seed : int, optional
        Of the draws of the posterior.

    Raises
    ------
    ConfigError
        If the study has no updated model, or the rotor is not in the deck.

    References
    ----------
    ISO 21940-11 (balance grades).
    """
    path = Path(study)
    config = read_config(path)
    where = path.parent if out is None else Path(out)
    held = Store(where / STORE)
    if "final" not in held.stages():
        raise ConfigError(
            f"{held.path}: no updated model in it: run the study to its final stage first, or "
            "name the folder of its results"
        )
    asked = settings or config.predict
    if asked == config.predict and seed is None:
        done = runs.run_study(
            path,
            out=None if out is None else Path(out),
            until="predict",
            progress=progress,
        )
        found = done.results["predict"]
    else:
        info = (
            config.study
            if seed is None
            else config.study.model_copy(update={"seed": seed})
        )
        changed = config.model_copy(update={"predict": asked, "study": info})
        found = predict_stage.run(Session(changed, path.parent, where, held), progress)
    assert isinstance(found, PredictStage)
    return found


@dataclass(frozen=True, eq=False)
class TestPlan(Displayed):
    """A test plan.

    Attributes
    ----------
    channels : tuple of str
        Where to measure.
    references : tuple of str
        Excitation points.
    target_frequencies : (mode,) float64, Hz
    frequency_step : float, Hz
    block : float, s
    record_length : float, s
        Of an ambient record.
    files : tuple of Path
        The test sheet and the report.
    stage : PlanStage
        All that the plan holds.
    model : Model
        Of the deck.
    """

    __test__: ClassVar[bool] = False  # not a test of pytest
    UNITS: ClassVar[Mapping[str, str]] = {
        "target_frequencies": "Hz",
        "frequency_step": "Hz",
        "block": "s",
        "record_length": "s",
    }

    channels: tuple[str, ...]
    references: tuple[str, ...]
    target_frequencies: Float
    frequency_step: float
    block: float
    record_length: float
    files: tuple[Path, ...]
    stage: PlanStage
    model: Model


def plan_test(
    deck: str | Path,
    folder: str | Path | None = None,
    *,
    band: tuple[float, float] | None = None,
    units: str = "SI",
    settings: PlanSection | Mapping[str, Any] | None = None,
    seed: int = 0,
    progress: Progress = quiet,
) -> TestPlan:
    """Plan a modal test: where to measure and to hit, for how long, and which modes it will give.

    Parameters
    ----------
    deck : str or Path
    folder : str or Path, optional
        Where `plan.toml`, the test sheet and the report go; `NAME-test` in the folder of the deck.
    band : (float, float), Hz, optional
        Of the target modes; taken from the deck if not given.
    units : str
        As in `read_deck`.
    settings : PlanSettings or mapping, optional
        Number of points, excitation points, and what else `[plan]` of a study has, by its keys.
    seed : int
        Of the virtual tests.

    Raises
    ------
    ConfigError
        If the band is empty, or the folder holds another study.

    References
    ----------
    Kammer (1991), effective independence; Papadimitriou (2004), information entropy.
    """
    deck = Path(deck)
    folder = deck.with_name(f"{deck.stem}-test") if folder is None else Path(folder)
    if (folder / "study.toml").exists():
        raise ConfigError(
            f"{folder}: holds a study.toml; name a folder for the plan alone"
        )
    writes(*(folder / name for name in ("plan.toml", *NAMES)))
    asked = (
        settings.model_dump(exclude_unset=True)
        if isinstance(settings, PlanSection)
        else settings
    )
    section = ALONE | dict(asked or {})
    progress(0.0, f"reading {deck}")
    if band is None and "fmax" in section:
        band = section.get("fmin", 0.0), section["fmax"]
    low, high = _band(deck, units, band, section.get("modes", ()))
    section |= {"fmin": low, "fmax": high}
    path = _write_study(folder, deck, units, section, seed)
    run = runs.run_study(path, out=folder, until="plan", progress=progress)
    report = deliver(run)
    stage: PlanStage = run.results["plan"]
    sensors = stage.sensors
    references = stage.excitation.references
    timing = stage.acquisition
    files = write_test_sheet(
        folder,
        sensors.test,
        PlannedExcitation(references, stage.target_frequencies, _reach(run)),
        sensor=ICP,
        setups=sensors.setups,
    )
    return TestPlan(
        channels=sensors.test.channels,
        references=references,
        target_frequencies=stage.target_frequencies,
        frequency_step=timing.frequency_step,
        block=timing.block,
        record_length=timing.record_length,
        files=(*map(Path, files), report),
        stage=stage,
        model=run.session.initial.model,
    )


def _band(
    deck: Path, units: str, band: tuple[float, float] | None, modes: Sequence[int]
) -> tuple[float, float]:
    """The band, taken from the deck where it is not given."""
    if band is not None and not 0 <= band[0] < band[1]:
        raise ConfigError(f"band {band[0]} {band[1]}: must be 0 <= F0 < F1")
    model = read_deck(deck, units=units)
    if band is None:
        with EmbeddedSolver().open(model) as analysis:
            # modes of a deck that a band is taken from
            count = max([21, *(m + 1 for m in modes)])
            f = analysis.modes(ModesRequest(count)).modes.frequencies
        flexible = f[elastic(f)]
        if not flexible.size:
            raise ConfigError(
                f"{deck}: none of the {f.size} lowest modes is elastic; give the band"
            )
        if modes and max(modes) <= f.size:
            last = f[max(modes) - 1]
        else:
            last = flexible[-2 if flexible.size > 1 else -1]
        band = (0.5 * float(flexible[0]), 1.001 * float(last))
    return float(f"{band[0]:.6g}"), float(f"{band[1]:.6g}")


def _write_study(
    folder: Path, deck: Path, units: str, section: Mapping[str, Any], seed: int
) -> Path:
    """plan.toml: the settings of this plan, a study that `ringtrue run` takes."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "plan.toml"
    place = Path(os.path.relpath(deck.resolve(), folder.resolve())).as_posix()
    # 1.3: modes up to here over the band take part in virtual tests
    tables: dict[str, Mapping[str, Any]] = {
        "study": {"title": f"Test plan of {deck.name}", "seed": seed},
        "model": {
            "deck": place,
            "units": units,
            "fmax": float(f"{1.3 * section['fmax']:.6g}"),
        },
        "plan": section,
    }
    lines = [
        f"[{name}]\n" + "".join(f"{k} = {_toml(v)}\n" for k, v in table.items())
        for name, table in tables.items()
    ]
    with atomic_write(path) as part:
        part.write_text("\n".join(lines), encoding="utf-8")
    return path


def _toml(value: Any) -> str:
    """JSON's texts, numbers and lists are TOML's too."""
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{_toml(k)} = {_toml(v)}" for k, v in value.items()) + "}"
        )
    return json.dumps(value, ensure_ascii=False)


def _reach(run: runs.StudyRun) -> Float:
    """Driving-point residue of each reference over the best of all channels, (r, target)."""
    stage: PlanStage = run.results["plan"]
    found = run.session.initial.modes(run.session.first_fmax).modes.take(
        stage.target_modes
    )
    test = stage.sensors.test
    seen = run.session.initial.observation(test)(found.shapes)
    at = [test.channels.index(r) for r in stage.excitation.references]
    return reach_of(seen, at)
