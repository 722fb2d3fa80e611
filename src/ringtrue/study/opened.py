"""A model opened in the embedded solver, assembled, factored and solved when first asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from ringtrue.backends.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.core.modes import ModeSet
from ringtrue.core.observation import Observation
from ringtrue.core.testmodel import TestModel
from ringtrue.correlate.observe import Method, observe
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult

Progress = Callable[[float, str], None]


def quiet(fraction: float, text: str) -> None:
    """No progress."""


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
    def _modes(self) -> dict[float, ModesResult]:
        return {}

    def modes(self, fmax: float) -> ModesResult:
        """All modes below `fmax`, Hz (`ModesResult`), solved once."""
        if fmax not in self._modes:
            self._modes[fmax] = self.analysis.modes(ModesRequest(band=(-1.0, fmax)))
        return self._modes[fmax]

    def observation(self, test: TestModel, tolerance: float, method: Method = "nearest") -> Observation:
        """The bridge to the channels of a test; `tolerance` in m, `method` as in `correlate.observe`."""
        return observe(
            test,
            self.model["GRID"].ids,
            positions(self.model),
            self.analysis.dofs,
            unit=self.length,
            tolerance=tolerance / self.length,
            method=method,
        )

    def seen(self, modes: ModeSet, test: TestModel, tolerance: float) -> ModeSet:
        """The modes at the channels."""
        shapes = self.observation(test, tolerance)(modes.shapes)
        return ModeSet(modes.frequencies, modes.damping, shapes, test.channels, modes.norm, modes.source)
