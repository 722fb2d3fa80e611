"""An observed model that solves the full model anew at each point, through the port to any solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ringtrue.backends.embedded import EmbeddedSolver
from ringtrue.core.arrays import Float
from ringtrue.core.observation import Observation
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import UnsupportedError
from ringtrue.fem.assembly import assemble
from ringtrue.fem.derivatives import scaled, terms
from ringtrue.fem.spins import without_spins
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation, ModalSolver, ModesRequest
from ringtrue.reduce.affine import AffineSystem, observed_system
from ringtrue.reduce.basis import Progress
from ringtrue.reduce.parametric import BasisOptions, ReducedModel, reduced_model


def at_factors(model: Model, parameters: ParameterSet, factors: Float) -> Model:
    """A copy with each parameter's fields multiplied by its factor a (p,).

    Raises
    ------
    InputError
        If a target is not in the model.
    """
    for p, a in zip(parameters.parameters, np.asarray(factors).tolist(), strict=True):  # over parameters
        model = scaled(model, p, a)
    return model


@dataclass(frozen=True, slots=True, eq=False)
class FullModel:
    """An `ObservedModel` by full solves: the truth for a reduced one, and enough for small models.

    Attributes
    ----------
    model : Model
        Nominal, x = 0.
    parameters : ParameterSet
    observation : Observation
    request : ModesRequest
    solver : ModalSolver
    """

    model: Model
    parameters: ParameterSet
    observation: Observation
    request: ModesRequest = field(default_factory=ModesRequest)
    solver: ModalSolver = field(default_factory=EmbeddedSolver)

    def _model(self, x: Float) -> Model:
        return at_factors(self.model, self.parameters, self.parameters.factors(x))

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,); sensitivities with no columns."""
        with self.solver.open(self._model(x)) as analysis:
            modes = analysis.modes(self.request).modes
        seen = self.observation(modes.shapes)
        none = (np.zeros((len(modes), 0)), np.zeros((*seen.shape, 0)))
        return Linearisation(np.array(x, dtype=float), modes.frequencies, seen, *none)

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,).

        Raises
        ------
        UnsupportedError
            If the solver gives no derivatives.
        """
        with self.solver.open(self._model(x), (self.parameters,)) as analysis:
            if "derivatives" not in analysis.capabilities:
                raise UnsupportedError(f"solver {self.solver.name!r} gives no derivatives; use 'embedded'")
            modes = analysis.modes(self.request).modes
            d_lambda, d_phi = analysis.derivatives(modes, self.parameters)
        relative = self.parameters.slope(x) / self.parameters.factors(x)  # the edited model is at a = 1 of itself
        seen = self.observation(modes.shapes)
        d_seen = self.observation(d_phi.reshape(d_phi.shape[0], -1)).reshape(*seen.shape, len(self.parameters))
        x = np.array(x, dtype=float)
        return Linearisation(x, modes.frequencies, seen, d_lambda * relative, d_seen * relative)


def reduced(
    model: Model,
    parameters: ParameterSet,
    observation: Observation,
    count: int,
    *,
    options: BasisOptions | None = None,
    points: Sequence[Float] = (),
    progress: Progress | None = None,
) -> ReducedModel:
    """The reduced observed model of a deck: assemble, differentiate, project."""
    system, _ = without_spins(model, assemble(model))
    parts = [terms(model, p, system) for p in parameters.parameters]
    affine: AffineSystem = observed_system(
        system.stiffness, system.mass, system.transform, parameters, parts, observation
    )
    return reduced_model(affine, count, options=options, points=points, progress=progress)
