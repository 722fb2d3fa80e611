"""What the stages of one run share: settings, results so far, and the models, opened once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.decks.nastran.editor import add_cards
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, about
from ringtrue.model.edit import carried, in_seconds
from ringtrue.model.ports import ModalSolver
from ringtrue.model.refine import refined
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.solvers.registry import EMBEDDED, solver
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import ConfigurationSection, ModelSection
from ringtrue.study.measured_data import (
    NO_FRFS,
    Measured,
    channels_of,
    excited,
    flexible,
    read_measured,
)
from ringtrue.study.opened import AtChannels, Opened, build, with_lumps
from ringtrue.study.placing import alignment, placed, seats
from ringtrue.study.reference import highest, reference_modes, settings
from ringtrue.study.results import (
    ConfigurationsStage,
    ConfiguredTest,
    CorrelateStage,
    IdentifyStage,
    LocaliseStage,
    Seat,
    SetResult,
    UpdateStage,
)
from ringtrue.study.store import Store
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.selection.candidates import Candidate, CandidateSettings

OWN = ""  # the deck of the study among the configurations
FMAX = 100.0  # Hz, where neither the study nor a test says


@dataclass(eq=False)
class Session:
    """Settings, store and shared models; results are put once, never changed."""

    config: StudyConfig
    base: Path  # the folder of study.toml
    out: Path
    store: Store
    results: dict[str, Any] = field(default_factory=dict)
    keys: dict[str, str] = field(
        default_factory=dict
    )  # of the stages of this run: what their results follow from
    delivered: Opened | None = None  # the deck that the final stage has written, while it is open
    generated: ParameterSet | None = None  # candidates that the localisation has made from the deck
    lumped: Opened | None = None  # the remodelled deck with places for masses that it may lack
    _model: ReducedModel | None = None
    _opened: dict[str, Opened] = field(default_factory=dict)  # decks of other configurations
    _others: dict[str, AtChannels] = field(default_factory=dict)  # their reduced models
    _updated: tuple[SetResult, tuple[AtChannels, ...]] | None = (
        None  # a parameter set, and the models at its end
    )
    _measured: dict[str, tuple[Measured, ...]] = field(default_factory=dict)  # by configuration
    masses: dict[str, Float] = field(
        default_factory=dict
    )  # at the channels of the test modes, by configuration
    weighed: dict[tuple[str, tuple[str, ...]], RigidMass] = field(
        default_factory=dict
    )  # by configuration and names
    _placed: dict[TestModel, TestModel] = field(
        default_factory=dict
    )  # sheets as laid onto the deck, by those measured
    _seen: dict[str, Observation] = field(
        default_factory=dict
    )  # of the reduced models, by configuration

    def get(self, stage: str) -> Any:
        """The result of a stage, from this run or from the store."""
        if stage not in self.results:
            self.results[stage] = self.store.load(stage)
        return self.results[stage]

    def put(self, stage: str, result: object) -> None:
        """Keep the result of a stage for those that follow."""
        self.results[stage] = result

    def folder(self, name: str) -> Path:
        """Where decks of this name are written: `name` in the folder of the results, and beside it
        in a second round.

        A study whose deck is `updated/frame.bdf` writes `updated-2`, one of `updated-2/frame.bdf`
        writes `updated-3`.
        """
        out, numbers = self.out.resolve(), [0]
        decks = [self.base / c.deck for c in self.config.configuration if c.deck]
        for file in (*map(Path, self.initial.model.files), *decks):
            inside = file.resolve()
            top = inside.relative_to(out).parts[0] if inside.is_relative_to(out) else ""
            if found := re.fullmatch(rf"{name}(?:-(\d+))?", top, re.IGNORECASE):
                numbers.append(int(found.group(1) or 1))
        number = max(numbers) + 1
        return self.out / (name if number == 1 else f"{name}-{number}")

    @property
    def deck(self) -> ModelSection:
        """The [model] section.

        Raises
        ------
        ConfigError
            If the study has none.
        """
        if self.config.model is None:
            raise ConfigError("this stage needs a [model] with a deck")
        return self.config.model

    @property
    def first_fmax(self) -> float:
        """Hz, up to where the modes of the deck are computed before a test is looked at."""
        return self.deck.fmax or FMAX

    @cached_property
    def fmax(self) -> float:
        """Hz, up to where the modes of decks are computed: as given, or well above the modes of the
        test.
        """
        return self.deck.fmax or self.up_to(
            reference_modes(self.get("identify"), self.config).elastic.frequencies
        )

    def up_to(self, frequencies: Float) -> float:
        """The same for the test of another configuration, with modes at `frequencies`, Hz."""
        return self.deck.fmax or highest(frequencies, settings(self.config))

    @property
    def unit(self) -> UnitSystem:
        """The unit system of the deck."""
        return UNIT_SYSTEMS[self.deck.units]

    @property
    def length(self) -> float:
        """Metres a model unit."""
        return self.unit.length

    @cached_property
    def engine(self) -> ModalSolver | None:
        """The solver of the study; None for the embedded one."""
        return None if self.deck.solver == EMBEDDED else solver(self.deck.solver)

    def opened(self, main: Path) -> Opened:
        """A deck in the solver of the study."""
        model = in_seconds(read_deck(main), self.unit)
        for _ in range(self.deck.refine):
            model = refined(model)
        return Opened(model, self.length, self.engine)

    @property
    def parameters(self) -> ParameterSet:
        """The candidates: those of the study, else those that the localisation has made for the
        updating.
        """
        given = self.config.candidates()
        if len(given) or not self.config.propose:
            return given
        if self.generated is None:
            found: LocaliseStage = self.get("localise")
            self.generated = found.candidates.parameters
            self.with_lumps(found.places)
        return self.generated

    def with_lumps(self, nodes: Int) -> tuple[Candidate, ...]:
        """What the remodelled deck may lack at these nodes, ids (k,); it has a place for it from
        now on.
        """
        deck = self.steps[-1]
        model, found = with_lumps(deck, nodes, CandidateSettings(units=self.deck.units))
        self.lumped = deck.extended(model) if nodes.size else None
        return found

    @property
    def places(self) -> Int:
        """Nodes of the places for lumps, ids (k,)."""
        count = len(self.steps[-1].model.tables["CONM2"]) if "CONM2" in self.steps[-1].model else 0
        none = np.zeros(0, dtype=np.int64)
        return none if self.lumped is None else np.asarray(self.lumped.model["CONM2"]["G"][count:])

    @property
    def everything(self) -> ParameterSet:
        """All candidates and suspensions."""
        return ParameterSet(self.parameters.parameters + self.config.suspensions().parameters)

    def _built(self, parameters: ParameterSet, progress: Progress) -> ReducedModel:
        seen = self._extended(self.bridge(self.remodelled), OWN, self.remodelled)
        return build(self.remodelled, parameters, seen, self.fmax, progress)

    def _extended(self, seen: Observation, name: str, opened: Opened) -> Observation:
        """With the channels of what was measured beside the modes, on the sheet of the
        configuration if it has one.
        """
        sheet = self.sheet(name)
        for m in self.measured(name):
            with about(f"[[residual]] {m.name}"):
                more = tuple(c for c in channels_of([m]) if c not in set(seen.channels))
                seen = seen.and_also(self.observed(opened, sheet, more)) if more else seen
        self._seen[name] = seen
        return seen

    def seats(self, name: str, seen: Observation) -> tuple[Seat, ...]:
        """Where the channels of a configuration are read; nothing where they are DOFs of its
        deck.
        """
        sheet = self.sheet(name)
        return seats(seen, sheet) if sheet is not None else ()

    def seats_beside(self, name: str, found: Measured) -> tuple[Seat, ...]:
        """Where the channels of what was measured beside the modes are read, once the reduced model
        is built.
        """
        mine = set(channels_of([found]))
        return tuple(s for s in self.seats(name, self._seen[name]) if s.channel in mine)

    def sheet(self, name: str) -> TestModel | None:
        """The sensor sheet of a configuration, or of the study (`OWN`); None where channels are
        DOFs of the deck.
        """
        if name != OWN:
            return self._configured_test(name).test
        found: IdentifyStage = self.get("identify")
        return None if self.config.frequency_only else found.test

    def channels(self, name: str) -> tuple[str, ...]:
        """All channels of the reduced model of the deck of the study, or of another
        configuration.
        """
        return self._seen[name].channels

    def loaded(self, name: str) -> Int:
        """Positions of the channels at which something was excited or pulled."""
        return excited(self.measured(name), {c: i for i, c in enumerate(self.channels(name))})

    def measured(self, name: str) -> tuple[Measured, ...]:
        """What was measured beside the modes on the deck of the study (`OWN`), or on another
        configuration.
        """
        if name not in self._measured:
            mine = [s for s in self.config.residual if (s.configuration or OWN) == name]
            found: IdentifyStage | None = self.get("identify") if mine and name == OWN else None
            frfs = found.frfs if found is not None else None
            why = (
                NO_FRFS
                if name == OWN
                else "only FRFs of the study's own test are known without a file"
            )
            self._measured[name] = tuple(
                read_measured(s, self.base, self.reference(name), frfs, why) for s in mine
            )
        return self._measured[name]

    def reference(self, name: str) -> ModeSet:
        """The elastic test modes of a configuration."""
        if name == OWN:
            found: CorrelateStage = self.get("correlate")
            return found.reference
        return self._configured_test(name).reference

    def _configured_test(self, name: str) -> ConfiguredTest:
        others: ConfigurationsStage = self.get("configurations")
        return next(c for c in others.items if c.name == name)

    def _reduced(self, progress: Progress) -> ReducedModel:
        """All candidates and suspensions on the remodelled deck, seen at every channel of the
        sheet.
        """
        if self._model is None:
            model = self._built(self.everything, progress)
            self._model = flexible(model, self.measured(OWN), self.loaded(OWN))
        return self._model

    def apart(self, parameters: ParameterSet, progress: Progress) -> AtChannels:
        """A reduced model over other parameters at the channels of the elastic reference modes; it
        is not kept.
        """
        return AtChannels(
            self._built(parameters, progress), self.rows(self.reference(OWN).channels)
        )

    def rows(self, channels: Sequence[str]) -> Int:
        """Positions of channels on the sheet of the study."""
        at = {c: i for i, c in enumerate(self.get("identify").test.channels)}
        return np.array([at[c] for c in channels], dtype=np.int64)

    def candidates(self, progress: Progress) -> AtChannels:
        """The reduced model over the candidates at the channels of the elastic reference modes."""
        model = self._reduced(progress)
        total = len(model.system.parameters)
        held = model.with_parameters(range(len(self.parameters)), np.zeros(total))
        return AtChannels(held, self.rows(self.reference(OWN).channels), self.loaded(OWN))

    def updated(self, best: SetResult, progress: Progress) -> tuple[AtChannels, ...]:
        """`candidates` and `others` on bases that hold the full modes at the end of a parameter
        set, too.

        They follow from the deck and the factors as stored: a stage gets the same ones in any run.
        """
        if self._updated is None or self._updated[0] is not best:
            factor = dict(zip(best.parameters, best.factor.tolist(), strict=True))
            models = []
            for model in (self.candidates(progress), *self.others(progress)):
                p = model.parameters
                x = p.vector(np.array([factor.get(n, 1.0) for n in p.names]))
                models.append(model.enrich(x)[0] if x.any() else model)
            self._updated = (best, tuple(models))
        return self._updated[1]

    def delivered_models(self, progress: Progress) -> tuple[AtChannels, ...]:
        """`updated` at the chosen parameter set; as before where there is nothing to update."""
        if not len(self.parameters):
            return (self.candidates(progress), *self.others(progress))
        done: UpdateStage = self.get("update")
        return self.updated(done.sets[done.chosen], progress)

    def suspended(self, channels: Sequence[str], progress: Progress) -> AtChannels:
        """The updated model over all candidates and suspensions at the channels of the rigid-body
        reference modes.
        """
        return AtChannels(self.delivered_models(progress)[0].model, self.rows(channels))

    def configured(self, section: ConfigurationSection) -> Opened:
        """The deck of another configuration: its own, or that of the study with cards, in
        `out/configurations`.
        """
        if section.name not in self._opened:
            if section.deck is not None:
                main = self.base / section.deck
            else:
                cards = (self.base / str(section.cards)).read_text(encoding="utf-8")
                model, folder = (
                    self.remodelled.model,
                    self.folder("configurations") / section.name / "initial",
                )
                main, *_ = add_cards(model, model.files[0], cards, folder)
            self._opened[section.name] = self.opened(main)
        return self._opened[section.name]

    def observed(
        self, opened: Opened, test: TestModel | None, channels: Sequence[str]
    ) -> Observation:
        """The bridge from a deck to channels on a sheet, laid onto the deck; without a sheet they
        are DOFs of it.
        """
        c = self.config.correlate
        if test is not None and c.align:
            if test is self.get("identify").test:
                test = self.placed[1]
            else:
                if test not in self._placed:
                    self._placed[test] = alignment(test, opened, c.align).move(test)
                test = self._placed[test]
        return placed(opened, channels, test, tolerance=c.tolerance, method=c.match)

    def bridge(self, opened: Opened) -> Observation:
        """The bridge from a deck to all channels of the test of the study."""
        test = self.get("identify").test
        return self.observed(opened, test, test.channels)

    @cached_property
    def placed(self) -> tuple[Alignment, TestModel]:
        """How the sheet of the study is laid onto the initial deck, and the sheet there: for all
        its states.
        """
        test = self.get("identify").test
        found = alignment(test, self.initial, self.config.correlate.align)
        return found, found.move(test)

    def others(self, progress: Progress) -> tuple[AtChannels, ...]:
        """Reduced models of the other configurations over the candidates they carry, at their
        reference channels.
        """
        if not self.config.configuration:
            return ()
        found: ConfigurationsStage = self.get("configurations")
        for section, item in zip(self.config.configuration, found.items, strict=True):
            if section.name not in self._others:
                opened, channels = self.configured(section), item.reference.channels
                every = channels if item.test is None else item.test.channels
                seen = self._extended(self.observed(opened, item.test, every), section.name, opened)
                mine, count = (
                    carried(opened.model, self.everything),
                    len(carried(opened.model, self.parameters)),
                )
                rows = np.array([seen.channels.index(c) for c in channels], dtype=np.int64)
                loaded = self.loaded(section.name)
                base = build(opened, mine, seen, self.up_to(item.reference.frequencies), progress)
                model = AtChannels(
                    flexible(base, self.measured(section.name), loaded), rows, loaded
                )
                self._others[section.name] = model.with_parameters(
                    range(count), np.zeros(len(mine))
                )
        return tuple(self._others[s.name] for s in self.config.configuration)

    def deck_of(self, name: str) -> tuple[Opened, Observation]:
        """A configuration's deck before the updating, and the bridge to the channels of its
        test.
        """
        if name == OWN:
            return self.remodelled, self.bridge(self.remodelled)
        section = next(c for c in self.config.configuration if c.name == name)
        item = self._configured_test(name)
        opened = self.configured(section)
        channels = item.reference.channels if item.test is None else item.test.channels
        return opened, self.observed(opened, item.test, channels)

    @cached_property
    def initial(self) -> Opened:
        """The initial deck."""
        return self.opened(self.base / self.deck.deck)

    @cached_property
    def steps(self) -> tuple[Opened, ...]:
        """The initial deck, and after each step of the stated remodelling, read from
        `out/remodelled`.
        """
        out, files = [self.initial], [Path(f).resolve() for f in self.initial.model.files]
        for i, step in enumerate(self.config.remodel, start=1):
            model, file = out[-1].model, self.base / step.file
            if i > 1 and file.resolve() in files:
                file = Path(
                    model.files[files.index(file.resolve())]
                )  # as the step before has left it
            folder = self.folder("remodelled") / (
                "" if i == len(self.config.remodel) else f"step {i}"
            )
            main, *_ = add_cards(
                model, file, (self.base / step.cards).read_text(encoding="utf-8"), folder
            )
            out.append(self.opened(main))
        return tuple(out)

    @property
    def remodelled(self) -> Opened:
        """The deck after the whole remodelling; the initial one if there is none."""
        return self.lumped or self.steps[-1]
