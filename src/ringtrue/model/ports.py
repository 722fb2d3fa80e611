"""The port to a modal solver: what `update`, `plan` and `study` see of any engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import NO_DOFS, DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.model.model import Model


@dataclass(frozen=True, slots=True)
class ModesRequest:
    """The lowest `count` modes, or all in `band` (Hz) if that is given; from 0 on with the
    rigid-body modes.
    """

    count: int = 20
    band: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ModesResult:
    """Modes with their proof.

    Attributes
    ----------
    modes : ModeSet
        Real, mass-normalised, basic frame, every node's six DOFs (dependent and fixed ones too).
    residuals : (m,) float64
        ‖Kφ − λMφ‖ / ‖Kφ‖ (relative to the scale of K for rigid-body modes).
    complete : bool
        Inertia counts prove that no mode of the band is missing or invented.
    proof : str
        What was counted, in words.
    orthogonality : float
        max |ΦᵀMΦ − I|; NaN where the solver does not tell.
    autospc : DofSet
        DOFs that were held because nothing stiffens them, in the displacement frames; empty where
        the solver does not tell.
    """

    modes: ModeSet
    residuals: Float
    complete: bool
    proof: str
    orthogonality: float = float("nan")
    autospc: DofSet = NO_DOFS


@runtime_checkable
class Analysis(Protocol):
    """One model, opened in a solver; one factorisation behind all answers."""

    # of "modes", "derivatives", "frf", "static", "complex_modes"
    capabilities: frozenset[str]
    dofs: DofSet

    def modes(self, request: ModesRequest) -> ModesResult:
        """Natural modes."""
        ...

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at the nominal factors a = 1."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


@runtime_checkable
class ObservedDerivatives(Protocol):
    """An analysis that differentiates what channels see, without the shapes at all DOFs."""

    def observed_derivatives(
        self, modes: ModeSet, parameters: ParameterSet, readings: sparse.csr_array
    ) -> tuple[Float, Float]:
        """∂λ/∂a (m, p) and ∂φ/∂a (channel, m, p) at a = 1, by readings (channel, dof)."""
        ...


@runtime_checkable
class ModalSolver(Protocol):
    """An engine: `with solver.open(model) as analysis: analysis.modes(...)`."""

    name: str

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> Analysis:
        """Assemble (or hand over) the model."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Observed modes at a point x of the parameter space, with their sensitivities to x.

    Attributes
    ----------
    x : (p,) float64
    frequencies : (m,) float64, Hz
    shapes : (channel, m) float64, mass-normalised
    d_lambda : (m, p) float64, ∂λ/∂x, (rad/s)²
    d_shapes : (channel, m, p) float64, ∂φ/∂x
    """

    x: Float
    frequencies: Float
    shapes: Float
    d_lambda: Float
    d_shapes: Float

    @classmethod
    def of_modes(cls, x: Float, frequencies: Float, shapes: Float) -> Linearisation:
        """Modes alone: the sensitivities have no columns."""
        d_lambda = np.zeros((len(frequencies), 0))
        d_shapes = np.zeros((*shapes.shape, 0))
        return cls(
            np.array(x, dtype=float),
            frequencies,
            np.asarray(shapes),
            d_lambda,
            d_shapes,
        )


class ObservedModel(Protocol):
    """A model with parameters, seen at the channels of a test: all that `update` and `plan` need to
    know.

    A full model solves anew at each x; a reduced one (`reduction.parametric`) projects. Each
    gives exact derivatives of what it returns.
    """

    @property
    def parameters(self) -> ParameterSet: ...

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,)."""
        ...

    def modes(self, x: Float) -> Linearisation:
        """Modes at x; the sensitivities may have p = 0 columns."""
        ...
