"""What the stages of one run share: settings, results so far, and the models, opened once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.correlation.sensor_mapping import Alignment
from ringtrue.decks.nastran.editor import add_cards
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, about
from ringtrue.model.edit import carried, in_seconds
from ringtrue.model.ports import ModalSolver
from ringtrue.model.refine import refined
from ringtrue.study.config import StudyConfig, read_config
from ringtrue.study.config_sections import ConfigurationSection, ModelSection
from ringtrue.study.measured_data import (
    Measured,
    Source,
    channels_of,
    excited,
    flexible,
    read_measured,
    rigid_mass,
)
from ringtrue.study.opened import AtChannels, Opened, build, with_lumps
from ringtrue.study.placing import alignment, placed, seats
from ringtrue.study.reference import highest, reference_modes, settings
from ringtrue.study.results import (
    ConfiguredTest,
    CorrelateStage,
    DeliveredConfiguration,
    FinalStage,
    IdentifyStage,
    LocaliseStage,
    ReferenceModes,
    Seat,
    SetResult,
    UpdateStage,
)
from ringtrue.study.store import STORE, Store
from ringtrue.updating.residuals.static import RigidMass
from ringtrue.updating.selection.candidates import Candidate, CandidateSettings

DEFAULT_FMAX_HZ = 100.0  # where neither the study nor a test says how far


@dataclass(eq=False)
class Session:
    """Settings, store and shared models; results are put once, never changed.

    Attributes
    ----------
    config : StudyConfig
    base : Path
        The folder of study.toml.
    out : Path
    store : Store
    results : dict
        By stage.
    keys : dict
        Of the stages of this run: what their results follow from.
    generated : ParameterSet, optional
        Candidates that the localisation has made from the deck.
    lumped : Opened, optional
        The remodelled deck with places for masses that it may not have.
    delivered : dict
        Decks that this run has written, by configuration.
    """

    config: StudyConfig
    base: Path
    out: Path
    store: Store
    results: dict[str, Any] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    generated: ParameterSet | None = None
    lumped: Opened | None = None
    delivered: dict[str, Any] = field(default_factory=dict)
    _updated: tuple[SetResult, tuple[AtChannels, ...]] | None = None
    _alignments: dict[TestModel, Alignment] = field(default_factory=dict)

    @classmethod
    def of(
        cls, study: Path, out: Path | None = None, config: StudyConfig | None = None
    ) -> Session:
        """Of a study.toml, whose settings may be given; results are in its folder or in `out`.

        Raises
        ------
        ConfigError
            On a study file that is wrong.
        """
        folder = out or study.parent
        return cls(
            config or read_config(study), study.parent, folder, Store(folder / STORE)
        )

    def get(self, stage: str) -> Any:
        """The result of a stage, from this run or from the store."""
        if stage not in self.results:
            self.results[stage] = self.store.load(stage)
        return self.results[stage]

    def put(self, stage: str, result: object) -> None:
        """Keep the result of a stage for those that follow."""
        self.results[stage] = result

    def folder(self, name: str) -> Path:
        """Where decks of this name are written: `name` in the folder of the results, with a number
        in a second round.

        A study whose deck is `updated/frame.bdf` writes `updated-2`, one of `updated-2/frame.bdf`
        writes `updated-3`.
        """
        out = self.out.resolve()
        numbers = [0]
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
        return self.deck.fmax or DEFAULT_FMAX_HZ

    @cached_property
    def fmax(self) -> float:
        """Hz, up to where the modes of decks are computed: as given, or well above the modes of the
        test.
        """
        return self.up_to(reference_modes(self.get("identify"), self.config).elastic)

    def up_to(self, test: ModeSet) -> float:
        """The same for the elastic modes of the test of another configuration."""
        return self.deck.fmax or highest(test.frequencies, settings(self.config))

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
        return self.deck.engine()

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

    def chosen(self, names: Sequence[str]) -> ParameterSet:
        """The candidates of these names."""
        return self.parameters.take(self.parameters.at(names))

    @property
    def best(self) -> SetResult:
        """The parameter set that the updating has chosen."""
        done: UpdateStage = self.get("update")
        return done.best

    def with_lumps(self, nodes: Int) -> tuple[Candidate, ...]:
        """Masses that the remodelled deck may not have at these nodes, ids (k,); it has a place for
        each from now on.
        """
        deck = self.steps[-1]
        model, found = with_lumps(deck, nodes, CandidateSettings(units=self.deck.units))
        self.lumped = deck.extended(model) if nodes.size else None
        return found

    @property
    def places(self) -> Int:
        """Nodes of the places for masses, ids (k,)."""
        if self.lumped is None:
            return np.zeros(0, dtype=np.int64)
        before = self.steps[-1].model
        count = len(before["CONM2"]) if "CONM2" in before else 0
        return self.lumped.model["CONM2"]["G"][count:]

    @property
    def everything(self) -> ParameterSet:
        """All candidates and suspensions."""
        return ParameterSet(
            self.parameters.parameters + self.config.suspensions().parameters
        )

    @cached_property
    def configurations(self) -> tuple[StudyConfiguration, ...]:
        """The study's own deck and test, then its [[configuration]]s."""
        return tuple(
            StudyConfiguration(self, s) for s in (None, *self.config.configuration)
        )

    @property
    def own(self) -> StudyConfiguration:
        """The study's own deck and test."""
        return self.configurations[0]

    @property
    def others(self) -> tuple[StudyConfiguration, ...]:
        """The further configurations."""
        return self.configurations[1:]

    def models(self, progress: Progress) -> tuple[AtChannels, ...]:
        """The reduced models of all configurations over the candidates."""
        return tuple(c.model(progress) for c in self.configurations)

    def updated(self, best: SetResult, progress: Progress) -> tuple[AtChannels, ...]:
        """`models` on bases that hold the full modes at the end of a parameter set, too.

        They follow from the deck and the factors as stored: a stage gets the same ones in any run.
        """
        if self._updated is None or self._updated[0] is not best:
            factors = dict.fromkeys(self.parameters.names, 1.0) | best.factors
            models = []
            for model in self.models(progress):
                x = model.parameters.vector(factors)
                models.append(model.enrich(x)[0] if x.any() else model)
            self._updated = (best, tuple(models))
        return self._updated[1]

    def delivered_models(self, progress: Progress) -> tuple[AtChannels, ...]:
        """`updated` at the chosen parameter set; as before where there is nothing to update."""
        if not len(self.parameters):
            return self.models(progress)
        return self.updated(self.best, progress)

    def updated_factors(self) -> dict[str, float]:
        """Of all candidates at the end of the updating; 1 for those not chosen."""
        names = self.parameters.names
        return dict.fromkeys(names, 1.0) | (self.best.factors if names else {})

    def factors(self) -> dict[str, float]:
        """Of all candidates and suspensions at the end of the study."""
        tuned = self.get("tune").factors if self.config.suspension else {}
        return self.updated_factors() | tuned

    def alignment(self, test: TestModel, opened: Opened) -> Alignment:
        """How a sheet is laid onto a deck, which holds for all states of the deck."""
        if test not in self._alignments:
            deck = self.initial if test is self.get("identify").test else opened
            self._alignments[test] = alignment(test, deck, self.config.correlate.align)
        return self._alignments[test]

    def observed(
        self, opened: Opened, test: TestModel | None, channels: Sequence[str]
    ) -> Observation:
        """The bridge from a deck to channels on a sheet, laid onto the deck; without a sheet they
        are DOFs of it.
        """
        c = self.config.correlate
        if test is not None and c.align:
            test = self.alignment(test, opened).move(test)
        return placed(opened, channels, test, tolerance=c.tolerance, method=c.match)

    def seen(
        self,
        opened: Opened,
        test: TestModel | None,
        reference: ModeSet,
        progress: Progress = quiet,
    ) -> ModeSet:
        """The modes of a deck at all channels of a test, as far up as its elastic modes ask for."""
        channels = reference.channels if test is None else test.channels
        look = self.observed(opened, test, channels)
        modes = opened.modes(self.up_to(reference), progress).modes
        return replace(modes, shapes=look(modes.shapes), labels=look.channels)

    @cached_property
    def initial(self) -> Opened:
        """The initial deck."""
        return self.opened(self.base / self.deck.deck)

    @cached_property
    def steps(self) -> tuple[Opened, ...]:
        """The initial deck, and after each step of the stated remodelling, read from
        `out/remodelled`.
        """
        out = [self.initial]
        files = [Path(f).resolve() for f in self.initial.model.files]
        last = len(self.config.remodel)
        for i, step in enumerate(self.config.remodel, start=1):
            model = out[-1].model
            file = self.base / step.file
            if i > 1 and file.resolve() in files:  # as the step before has left it
                file = Path(model.files[files.index(file.resolve())])
            folder = self.folder("remodelled") / ("" if i == last else f"step {i}")
            cards = (self.base / step.cards).read_text(encoding="utf-8")
            main, *_ = add_cards(model, file, cards, folder)
            out.append(self.opened(main))
        return tuple(out)

    @property
    def remodelled(self) -> Opened:
        """The deck after the whole remodelling; the initial one if there is none."""
        return self.lumped or self.steps[-1]


@dataclass(eq=False)
class StudyConfiguration:
    """A deck with its test: the study's own, where `section` is None, or a [[configuration]].

    Its models are opened when first asked for.
    """

    session: Session
    section: ConfigurationSection | None
    _model: AtChannels | None = None
    _rigid: dict[tuple[str, ...], RigidMass] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Empty for the study's own."""
        return "" if self.section is None else self.section.name

    @property
    def deck(self) -> Opened:
        """Before the updating."""
        return self.session.remodelled if self.section is None else self._deck

    @cached_property
    def _deck(self) -> Opened:
        """Its own deck, or that of the study with cards, in `out/configurations`."""
        assert self.section is not None
        session = self.session
        if self.section.deck is not None:
            return session.opened(session.base / self.section.deck)
        cards = (session.base / str(self.section.cards)).read_text(encoding="utf-8")
        model = session.remodelled.model
        main, *_ = add_cards(model, model.files[0], cards, self.folder / "initial")
        return session.opened(main)

    @property
    def folder(self) -> Path:
        """Where the decks of a further configuration are written."""
        return self.session.folder("configurations") / self.name

    @property
    def updated_folder(self) -> Path:
        """Where the updated deck is written."""
        if self.section is None:
            return self.session.folder("updated")
        return self.folder / "updated"

    @property
    def tested(self) -> CorrelateStage | ConfiguredTest:
        """Its stored correlation before the updating."""
        if self.section is None:
            own: CorrelateStage = self.session.get("correlate")
            return own
        items: tuple[ConfiguredTest, ...] = self.session.get("configurations").items
        return next(item for item in items if item.name == self.name)

    @property
    def final(self) -> FinalStage | DeliveredConfiguration:
        """Its stored correlation after the updating."""
        if self.section is None:
            own: FinalStage = self.session.get("final")
            return own
        items: tuple[DeliveredConfiguration, ...] = self.session.get("configured").items
        return next(item for item in items if item.name == self.name)

    @property
    def reference(self) -> ReferenceModes:
        """The modes of its test."""
        return self.tested.reference

    @property
    def test(self) -> TestModel | None:
        """Its sensor sheet; None where channels are DOFs of the deck."""
        if self.section is not None:
            assert isinstance(self.tested, ConfiguredTest)
            return self.tested.test
        found: IdentifyStage = self.session.get("identify")
        return found.test

    @property
    def sheet(self) -> TestModel | None:
        """The sheet as measured: none of a test of frequencies alone, whose points are nodes."""
        if self.section is None and self.session.config.frequency_only:
            return None
        return self.test

    def observed(self, opened: Opened) -> Observation:
        """The bridge from a deck to all channels of its test."""
        test = self.test
        channels = self.reference.elastic.channels if test is None else test.channels
        return self.session.observed(opened, test, channels)

    def modes(self, opened: Opened) -> ModeSet:
        """The modes of a deck at all channels of its test."""
        return self.session.seen(opened, self.test, self.reference.elastic)

    @cached_property
    def measured(self) -> tuple[Measured, ...]:
        """What the [[residual]]s of this configuration name."""
        session = self.session
        mine = [
            s for s in session.config.residual if (s.configuration or "") == self.name
        ]
        frfs = session.get("identify").frfs if mine and self.section is None else None
        source = Source(session.base, self.reference.elastic, frfs)
        return tuple(read_measured(s, source) for s in mine)

    @cached_property
    def seen(self) -> Observation:
        """The bridge from its deck to the channels of its test and of its [[residual]]s."""
        seen = self.observed(self.deck)
        for m in self.measured:
            with about(f"[[residual]] {m.name}"):
                more = tuple(c for c in channels_of([m]) if c not in set(seen.channels))
                if more:
                    also = self.session.observed(self.deck, self.sheet, more)
                    seen = seen.and_also(also)
        return seen

    def seats_of(self, found: Measured) -> tuple[Seat, ...]:
        """Where the channels of a [[residual]] are read; none where they are DOFs of the deck."""
        if self.sheet is None:
            return ()
        mine = set(channels_of([found]))
        return tuple(s for s in seats(self.seen, self.sheet) if s.channel in mine)

    @property
    def at(self) -> dict[str, int]:
        """Position of each channel among all that the reduced model has."""
        return {c: i for i, c in enumerate(self.seen.channels)}

    def rows(self, channels: Sequence[str]) -> Int:
        """Positions of channels among all that the reduced model has."""
        at = self.at
        return np.array([at[c] for c in channels], dtype=np.int64)

    @property
    def loaded(self) -> Int:
        """Positions of the channels at which something was excited or pulled."""
        return excited(self.measured, self.at)

    def reduced(self, parameters: ParameterSet, progress: Progress) -> AtChannels:
        """A reduced model over any parameters at the channels of the elastic reference modes; it is
        not kept.
        """
        test = self.reference.elastic
        fmax = self.session.up_to(test)
        model = build(self.deck, parameters, self.seen, fmax, progress)
        return AtChannels(model, self.rows(test.channels))

    def parameters(self) -> tuple[ParameterSet, int]:
        """The candidates and suspensions that its deck has, and how many are candidates: the first
        ones.
        """
        every = self.session.everything
        candidates = self.session.parameters
        if self.section is not None:
            every = carried(self.deck.model, every)
            candidates = carried(self.deck.model, candidates)
        return every, len(candidates)

    def model(self, progress: Progress) -> AtChannels:
        """The reduced model over the candidates that its deck has, its suspension held as in the
        deck.
        """
        if self._model is None:
            every, count = self.parameters()
            base = self.reduced(every, progress)
            model = flexible(base.model, self.measured, self.loaded)
            whole = AtChannels(model, base.rows, self.loaded)
            self._model = whole.with_parameters(range(count), np.zeros(len(every)))
        return self._model

    def rigid_mass(self, every: ParameterSet) -> RigidMass:
        """The rigid-body mass of its deck over parameters."""
        if every.names not in self._rigid:
            self._rigid[every.names] = rigid_mass(self.deck.model, every)
        return self._rigid[every.names]
