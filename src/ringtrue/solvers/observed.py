"""An observed model that solves the full model anew at each point, through the port to any
solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.errors import UnsupportedError
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import (
    Analysis,
    Linearisation,
    ModalSolver,
    ModesRequest,
    ObservedDerivatives,
)
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.components import free_system
from ringtrue.reduction.parametric import ReducedModel, reduced_model
from ringtrue.shapes import close_groups, rotation, unit
from ringtrue.solvers.embedded import EmbeddedSolver

# change of x, and share of the gradient of J, below which printed digits decide
PRINTED = 1e-4
# of x: programs print six or seven digits; the derivative of λ ~ a is off by half of it
STEP = 5e-3
UNTOLD = STEP / 2
CLOSE = 2 * STEP  # relative distance of frequencies that a step may exchange


def at_factors(model: Model, parameters: ParameterSet, factors: Float) -> Model:
    """A copy with each parameter's fields multiplied by its factor a (p,).

    Raises
    ------
    InputError
        If a target is not in the model.
    """
    values = np.asarray(factors).tolist()
    for p, a in zip(parameters.parameters, values, strict=True):
        model = scaled(model, p, a)
    return model


@dataclass(slots=True, eq=False)
class Ledger:
    """Runs of a solver so far, and the points that it has solved, by the bytes of x."""

    runs: int = 0
    points: dict[bytes, Linearisation] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FullModel:
    """An `ObservedModel` by full solves: the truth for a reduced one, and a way through any solver.

    Attributes
    ----------
    model : Model
        Nominal, x = 0.
    parameters : ParameterSet
    observation : Observation
    request : ModesRequest
    solver : ModalSolver
    ledger : Ledger
        A point is solved once.
    """

    model: Model
    parameters: ParameterSet
    observation: Observation
    request: ModesRequest = field(default_factory=ModesRequest)
    solver: ModalSolver = field(default_factory=EmbeddedSolver)
    ledger: Ledger = field(default_factory=Ledger)

    def _open(self, x: Float) -> Analysis:
        self.ledger.runs += 1
        model = at_factors(
            whole_mesh(self.model), self.parameters, self.parameters.factors(x)
        )
        return self.solver.open(model, (self.parameters,))

    def reaching(self, high: float) -> FullModel:
        """The same for as many modes as the nominal model has up to `high`, Hz; at least one."""
        count = self.request.count
        most = len(self.observation.dofs) // 2
        while True:
            model = replace(self, request=ModesRequest(count))
            f = model.modes(np.zeros(len(self.parameters))).frequencies
            if f.size < count or f[-1] > high or count >= most:
                return replace(
                    self, request=ModesRequest(max(int(np.sum(f <= high)), 1))
                )
            count = min(2 * count, most)

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,); sensitivities with no columns."""
        x = np.array(x, dtype=float)
        if (known := self.ledger.points.get(x.tobytes())) is not None:
            return known
        with self._open(x) as analysis:
            modes = analysis.modes(self.request).modes
        return Linearisation.of_modes(
            x, modes.frequencies, self.observation(modes.shapes)
        )

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,): the solver's, or differences of one more run a
        parameter.

        Modes from the first on that a difference cannot follow are left out.
        """
        x = np.array(x, dtype=float)
        if x.tobytes() not in self.ledger.points:
            self.ledger.points[x.tobytes()] = self._linearised(x)
        return self.ledger.points[x.tobytes()]

    def _linearised(self, x: Float) -> Linearisation:
        if not len(self.parameters):  # a deck that shares none of those that are free
            return self.modes(x)
        one_more = replace(self.request, count=self.request.count + 1)
        with self._open(x) as analysis:
            found = analysis.modes(one_more).modes
            modes = (
                found if self.request.band else found.take(slice(self.request.count))
            )
            slopes = self._given(analysis, modes, x)
        if slopes is None:
            whole = modes
            if len(found) > len(modes):  # the last may be half of a close pair
                whole = modes.take(
                    modes.frequencies < (1 - CLOSE) * found.frequencies[-1]
                )
            slopes = self._differences(whole, x)
        seen = self.observation(modes.shapes)
        n = len(slopes[0])
        return Linearisation(x, modes.frequencies[:n], seen[:, :n], *slopes)

    def _given(
        self, analysis: Analysis, modes: ModeSet, x: Float
    ) -> tuple[Float, Float] | None:
        """∂λ/∂x (m, p) and ∂φ/∂x (channel, m, p) of a solver that gives them, for factors on
        fields.
        """
        every = self.parameters.parameters
        if "derivatives" not in analysis.capabilities or any(
            p.shapes or any(t.step for t in p.targets) for p in every
        ):
            return None
        try:
            d_lambda, d_seen = self._differentiated(analysis, modes)
        except UnsupportedError:
            return None
        self.ledger.runs += 1
        # the edited model is at a = 1 of itself
        relative = self.parameters.derivative(x) / self.parameters.factors(x)
        return d_lambda * relative, d_seen * relative

    def _differentiated(
        self, analysis: Analysis, modes: ModeSet
    ) -> tuple[Float, Float]:
        """∂λ/∂a (m, p) and ∂φ/∂a (channel, m, p)."""
        if isinstance(analysis, ObservedDerivatives):
            readings = self.observation.matrix
            return analysis.observed_derivatives(modes, self.parameters, readings)
        d_lambda, d_phi = analysis.derivatives(modes, self.parameters)
        d_seen = self.observation(d_phi.reshape(d_phi.shape[0], -1))
        return d_lambda, d_seen.reshape(-1, *d_phi.shape[1:])

    def _differences(self, here: ModeSet, x: Float) -> tuple[Float, Float]:
        """∂λ/∂x (k, p) and ∂φ/∂x (channel, k, p) of the lowest k <= m modes by one step of each
        parameter.
        """
        slopes = []
        high = self.parameters.bounds()[1]
        seen = self.observation(here.shapes)
        # rigid-body modes, then modes that a step may exchange or mix
        rigid = int(np.sum(~elastic(here.frequencies)))
        f = here.frequencies[rigid:]
        groups = [np.arange(rigid)] if rigid else []
        groups += [rigid + np.array(g) for g in close_groups(f, CLOSE, len(here))]
        for i, at in enumerate(x.tolist()):  # over parameters
            h = STEP if at + STEP <= high[i] else -STEP
            near = x.copy()
            near[i] += h
            with self._open(near) as analysis:
                lam, shapes = followed(here, analysis.modes(self.request).modes, groups)
            n = lam.size
            d_lambda = (lam - _lam(here)[:n]) / h
            slopes.append((d_lambda, (self.observation(shapes) - seen[:, :n]) / h))
        k = min((len(d) for d, _ in slopes), default=len(here))
        d_lambda = np.stack([d[:k] for d, _ in slopes], axis=-1)
        return d_lambda, np.stack([d[:, :k] for _, d in slopes], axis=-1)


def followed(
    here: ModeSet, near: ModeSet, groups: Sequence[Int]
) -> tuple[Float, Float]:
    """λ (k,) and shapes (dof, k) of `near`, turned in each close group towards `here`, up to the
    first that is lost.

    λ of a turned mode is its Rayleigh quotient: that of the mode itself where nothing is turned.
    """
    lam = np.array([])
    shapes = np.zeros((len(here.shapes), 0))
    for g in groups:
        if g[-1] >= len(near):
            break
        turn = rotation(here.shapes[:, g], near.shapes[:, g])
        turned = near.shapes[:, g] @ turn
        if (np.sum(unit(here.shapes[:, g]) * unit(turned), axis=0) ** 2 < 0.5).any():
            break
        lam = np.append(lam, np.diag(turn.T @ (_lam(near)[g, None] * turn)))
        shapes = np.hstack([shapes, turned])
    return lam, shapes


def _lam(modes: ModeSet) -> Float:
    """λ (m,), (rad/s)²."""
    return (2 * np.pi * modes.frequencies) ** 2


def reduced(
    model: Model,
    parameters: ParameterSet,
    observation: Observation,
    count: int,
) -> ReducedModel:
    """The reduced observed model of the whole mesh of a deck: assemble, differentiate, project."""
    model = whole_mesh(model)
    system, _ = free_system(model)
    affine = observed_system(model, system, parameters, observation)
    return reduced_model(affine, count)
