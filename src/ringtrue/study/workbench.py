"""What the stages of one run share: settings, results so far, and the models, opened once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.backends.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.core.modes import ModeSet
from ringtrue.core.observation import Observation
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlate.observe import observe
from ringtrue.errors import ConfigError
from ringtrue.io.nastran.edit import add_cards
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.study.config import ModelSection, StudyConfig
from ringtrue.study.store import Store

LENGTH = {"SI": 1.0, "mm-t-s": 1e-3}


@dataclass(eq=False)
class Workbench:
    """Settings, store and shared models; results are put once, never changed."""

    config: StudyConfig
    base: Path  # the folder of study.toml
    out: Path
    store: Store
    results: dict[str, Any] = field(default_factory=dict)

    def get(self, stage: str) -> Any:
        """The result of a stage, from this run or from the store."""
        if stage not in self.results:
            self.results[stage] = self.store.load(stage)
        return self.results[stage]

    def put(self, stage: str, result: object) -> None:
        """Keep the result of a stage for those that follow."""
        self.results[stage] = result

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
    def length(self) -> float:
        """Metres a model unit."""
        return LENGTH[self.deck.units]

    @cached_property
    def initial(self) -> Opened:
        """The deck as delivered."""
        return Opened(read_deck(self.base / self.deck.deck), self.length)

    @cached_property
    def remodelled(self) -> Opened:
        """The deck after the stated remodelling, read from `out/remodelled`; the initial one if there is none."""
        step = self.config.remodel
        if step is None:
            return self.initial
        folder = self.out / "remodelled"
        cards = (self.base / step.cards).read_text(encoding="utf-8")
        add_cards(self.initial.model, self.base / step.file, cards, folder)
        return Opened(read_deck(folder / Path(self.deck.deck).name), self.length)


@dataclass(eq=False)
class Opened:
    """A model and its analysis, assembled and factored when first asked for."""

    model: Model
    length: float

    @cached_property
    def analysis(self) -> EmbeddedAnalysis:
        """The embedded solver's view."""
        return EmbeddedSolver().open(self.model)

    @cached_property
    def _modes(self) -> dict[float, Any]:
        return {}

    def modes(self, fmax: float) -> Any:
        """All modes below `fmax`, Hz (`ModesResult`), solved once."""
        if fmax not in self._modes:
            self._modes[fmax] = self.analysis.modes(ModesRequest(band=(0.0, fmax)))
        return self._modes[fmax]

    def observation(self, test: TestModel, tolerance: float) -> Observation:
        """The bridge to the channels of a test; `tolerance` in m."""
        return observe(
            test,
            self.model["GRID"].ids,
            positions(self.model),
            self.analysis.dofs,
            unit=self.length,
            tolerance=tolerance,
        )

    def seen(self, modes: ModeSet, test: TestModel, tolerance: float) -> ModeSet:
        """The modes at the channels."""
        shapes = self.observation(test, tolerance)(modes.shapes)
        return ModeSet(modes.frequencies, modes.damping, shapes, test.channels, modes.norm, modes.source)


def union(sets: Sequence[ParameterSet]) -> ParameterSet:
    """All parameters of several sets, each name once."""
    named = {p.name: p for s in sets for p in s.parameters}
    return ParameterSet(tuple(named.values()))


def rigid_split(frequencies: np.ndarray[Any, np.dtype[np.float64]], below: float | None) -> float:
    """The frequency between rigid-body and elastic modes: as given, or the middle of the largest relative gap."""
    if below is not None:
        return below
    f = np.sort(np.asarray(frequencies)[np.asarray(frequencies) > 0])
    if f.size < 2:
        return 0.0
    ratio = f[1:] / f[:-1]
    i = int(np.argmax(ratio[: max(1, min(12, ratio.size))]))
    return float(np.sqrt(f[i] * f[i + 1]))
