"""The parametric model of a study: all candidates and suspensions on one reduced basis, seen at
chosen channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part
from ringtrue.core.testmodel import Observation
from ringtrue.eigen.modes import low_shift
from ringtrue.errors import NotConverged
from ringtrue.fem.parametrisation.affine import affine_terms
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.affine import observed_system
from ringtrue.reduction.flexible import with_responses
from ringtrue.reduction.parametric import ReducedModel, reduced_model
from ringtrue.study.opened import Opened
from ringtrue.updating.dense import Matrices, matrices_at
from ringtrue.updating.residuals import Whole

CLOSE = 2e-3  # largest relative error of a frequency of the reduced model that is accepted
ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class AtChannels:
    """A reduced model at some rows of its channels.

    Attributes
    ----------
    model : ReducedModel
    rows : (channel,) int64
        Those that test modes are compared at.
    loaded : (l,) int64
        Those whose static responses the basis holds at every point where the full model is solved.
    """

    model: ReducedModel
    rows: Int
    loaded: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def parameters(self) -> ParameterSet:
        """The active parameters."""
        return self.model.parameters

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> AtChannels:
        """The same with other active parameters, by position among all; a short `base` is filled up
        with zeros.
        """
        if base is not None:
            base = np.concatenate([base, np.zeros(len(self.model.system.parameters) - base.size)])
        return replace(self, model=self.model.with_parameters(active, base))

    def whole(self) -> Whole:
        """All modes of the basis at all channels."""
        every = replace(
            self, model=self.model.whole(), rows=np.arange(self.model.basis.observe.shape[0])
        )
        return Whole(every, self.rows, self.model.count)

    def matrices(self, x: Float) -> Matrices:
        """Small matrices at x, at all channels."""
        return matrices_at(self.model, x)

    def enrich(self, x: Float, *, sensitivities: bool = False) -> tuple[AtChannels, Linearisation]:
        """The model with its full modes at x, and these; static responses of the loaded channels,
        too.
        """
        better, truth = self.model.enrich(x, sensitivities=sensitivities)
        if self.loaded.size:
            better, _ = with_responses(better, self.loaded, x)
        return replace(self, model=better), self._pick(truth)

    def _pick(self, point: Linearisation) -> Linearisation:
        return replace(point, shapes=point.shapes[self.rows], d_shapes=point.d_shapes[self.rows])

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x."""
        return self._pick(self.model.linearise(x))

    def modes(self, x: Float) -> Linearisation:
        """Modes at x."""
        return self._pick(self.model.modes(x))


def build(
    opened: Opened,
    parameters: ParameterSet,
    observation: Observation,
    fmax: float,
    progress: Progress,
) -> ReducedModel:
    """Assemble, differentiate and project: all modes below `fmax` with every parameter."""
    system = opened.analysis.system
    parts = affine_terms(opened.model, parameters, system, progress=part(progress, 0.0, 0.4))
    affine = observed_system(
        system.stiffness, system.mass, system.transform, parameters, parts, observation
    )
    count = len(opened.modes(fmax).modes)
    told = part(progress, 0.4, 1.0)
    return reduced_model(
        affine, count, pencil=opened.analysis.pencil, shift=low_shift(fmax), progress=told
    )


def verified(model: AtChannels, x: Float) -> tuple[AtChannels, float]:
    """The model enriched by a full solution at x, and the largest relative error it had there.

    Of a frequency, or of the flexibility between the loaded channels.
    """
    before = model.model.modes(x)
    better, truth = model.model.enrich(x)
    error, soft = frequency_error(before.frequencies, truth.frequencies), 0.0
    if model.loaded.size:
        better, soft = with_responses(better, model.loaded, x)
    return replace(model, model=better), max(error, soft)


def frequency_error(found: Float, truth: Float) -> float:
    """Largest relative error of the elastic frequencies that a reduced and a full model have in
    common.
    """
    n = min(found.size, truth.size)
    moving = elastic(truth)[:n]
    return float(np.abs(found[:n][moving] / truth[:n][moving] - 1).max(initial=0.0))


def not_verified(error: float) -> NotConverged:
    """The error of a reduced model that does not follow the full one."""
    return NotConverged(
        f"the reduced model is off by {100 * error:.2g} % after {ROUNDS} enrichments (allowed "
        f"{100 * CLOSE:.2g} %): "
        "tighten the bounds of the parameters"
    )
