"""A model given as small dense matrices, seen at channels: a reduced model, or one from another
program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float, freeze_arrays
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.projected import ProjectedModel


@dataclass(frozen=True, slots=True, eq=False)
class MatricesAtPoint:
    """A model at one point as small matrices, with their derivatives to x.

    Attributes
    ----------
    stiffness, mass : (n, n) float64
    d_stiffness, d_mass : (p, n, n) float64, ∂K/∂x and ∂M/∂x
    observe : (channel, n) float64
    """

    stiffness: Float
    mass: Float
    d_stiffness: Float
    d_mass: Float
    observe: Float


@dataclass(frozen=True, slots=True, eq=False)
class DenseModel:
    """K(a) = K0 + Σ (a_i − 1) K_i and M(a) = M0 + Σ (a_i − 1) M_i; an `ObservedModel` with exact
    derivatives.

    All modes are solved at each point, so the eigenvector derivatives come from the full modal
    expansion (Fox and Kapoor, 1968). Within repeated eigenvalues the part of the derivative along
    the other members is left out: it is not defined.

    Attributes
    ----------
    stiffness, mass : (n, n) float64, at nominal
    d_stiffness, d_mass : (p, n, n) float64, ∂K/∂a and ∂M/∂a
    observation : (channel, n) float64
    parameters : ParameterSet
    count : int
        Number of modes that are returned.
    """

    stiffness: Float
    mass: Float
    d_stiffness: Float
    d_mass: Float
    observation: Float
    parameters: ParameterSet
    count: int

    def __post_init__(self) -> None:
        freeze_arrays(self)
        n = self.stiffness.shape[0]
        p = len(self.parameters)
        shapes = self.d_stiffness.shape, self.d_mass.shape
        if shapes != ((p, n, n),) * 2 or self.observation.shape[1] != n:
            raise InputError(
                f"{p} parameters and {n} DOFs: got d_stiffness {shapes[0]}, "
                f"d_mass {shapes[1]}, observation {self.observation.shape}"
            )
        if n > 3000:
            raise InputError(
                f"{n} DOFs: dense matrices are for 3000 and less; reduce the model first"
            )

    @classmethod
    def springs(
        cls,
        stiffness: Float,
        mass: Float,
        d_stiffness: Float,
        parameters: ParameterSet,
        channels: Sequence[int] = (),
    ) -> DenseModel:
        """Stiffness parameters only, channels at the given DOFs (all)."""
        eye = np.eye(len(stiffness))
        seen = eye[list(channels)] if len(channels) else eye
        return cls(
            stiffness=stiffness,
            mass=mass,
            d_stiffness=d_stiffness,
            d_mass=np.zeros_like(d_stiffness),
            observation=seen,
            parameters=parameters,
            count=len(stiffness),
        )

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> DenseModel:
        """The model with some of its parameters, by position; the others stay at `base` (p,),
        nominal if not given.
        """
        at = list(active)
        hold = np.zeros(len(self.parameters)) if base is None else np.array(base, dtype=np.float64)
        hold[at] = 0.0
        stiffness, mass = self._at(hold)
        return replace(
            self,
            stiffness=stiffness,
            mass=mass,
            d_stiffness=self.d_stiffness[at],
            d_mass=self.d_mass[at],
            parameters=self.parameters.take(at),
        )

    def _at(self, x: Float) -> tuple[Float, Float]:
        """K and M at x."""
        change = self.parameters.factors(x) - 1.0
        k = self.stiffness + np.tensordot(change, self.d_stiffness, axes=1)
        return k, self.mass + np.tensordot(change, self.d_mass, axes=1)

    def matrices(self, x: Float) -> MatricesAtPoint:
        """K, M and their derivatives at x (p,)."""
        slope = self.parameters.derivative(x)[:, None, None]
        return MatricesAtPoint(
            *self._at(x), self.d_stiffness * slope, self.d_mass * slope, self.observation
        )

    def modes(self, x: Float) -> Linearisation:
        """Modes at x (p,), without sensitivities."""
        lam, phi = linalg.eigh(*self._at(x))
        seen = self.observation @ phi[:, : self.count]
        return Linearisation.of_modes(x, frequencies(lam[: self.count]), seen)

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x (p,)."""
        lam, phi = linalg.eigh(*self._at(x))
        c = min(self.count, lam.size)
        slope = self.parameters.derivative(x)
        dk = np.einsum("ni,pnk,kj->pij", phi, self.d_stiffness, phi[:, :c], optimize=True)
        dm = np.einsum("ni,pnk,kj->pij", phi, self.d_mass, phi[:, :c], optimize=True)
        force = (dk - lam[:c] * dm) * slope[:, None, None]  # (p, all, c)
        kept = np.arange(c)
        d_lambda = force[:, kept, kept].T
        gap = lam[:c] - lam[:, None]
        repeated = np.abs(gap) <= 1e-9 * np.abs(lam).max()  # shapes that mix freely
        mix = np.where(repeated, 0.0, force / np.where(repeated, 1.0, gap))
        mix[:, kept, kept] = -0.5 * dm[:, kept, kept] * slope[:, None]
        seen = self.observation @ phi
        d_shapes = np.einsum("ni,pij->njp", seen, mix, optimize=True)
        return Linearisation(np.asarray(x), frequencies(lam[:c]), seen[:, :c], d_lambda, d_shapes)


def matrices_at(model: object, x: Float) -> MatricesAtPoint:
    """Small matrices of a model at x (p,): of a `ProjectedModel` in its basis, or those it gives
    itself by `matrices`.

    Raises
    ------
    InputError
        If the model has no small matrices.
    """
    if isinstance(model, ProjectedModel):
        return _reduced(model, x)
    give = getattr(model, "matrices", None)
    if give is None:
        raise InputError(
            f"{type(model).__name__} has no small matrices; reduce the model (reduce.parametric)"
        )
    return give(x)  # type: ignore[no-any-return]


def _reduced(model: ProjectedModel, x: Float) -> MatricesAtPoint:
    """The projected matrices."""
    everything = model.full_vector(x)
    a = model.basis.parameters.factors(everything)
    slope = model.basis.parameters.derivative(everything)
    k, m = model.projected(a)
    both = [model.derivative(a, i, float(slope[i])) for i in model.active]
    dk, dm = (np.reshape([pair[j] for pair in both], (len(both), *k.shape)) for j in range(2))
    return MatricesAtPoint(k, m, dk, dm, model.basis.observe)
