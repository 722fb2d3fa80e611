"""A model whose K and M are fixed matrices times functions of its parameters' factors, and where it
is observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.errors import InputError
from ringtrue.fem.parametrisation.interpolation_nodes import on_axis
from ringtrue.fem.parametrisation.parameter_groups import Pair
from ringtrue.fem.parametrisation.polynomials import AffineTerm, Product

NONE = 1e-9  # rounding of a coefficient that is 0


@dataclass(frozen=True, slots=True, eq=False)
class AffineSystem:
    """K(a) and M(a) of a model, and where it is observed.

    Attributes
    ----------
    stiffness, mass : (f, f) csr_array float64
        At a = 1.
    parameters : ParameterSet
    terms : tuple of AffineTerm
        K(a) = K(1) + Σ g_t(a) K_t, M likewise; see `fem.dependence.affine_terms`.
    observe : (channel, f) csr_array float64
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    parameters: ParameterSet
    terms: tuple[AffineTerm, ...]
    observe: sparse.csr_array

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms))
        lost = [
            i for t in self.terms for i in t.function.which if not 0 <= i < len(self.parameters)
        ]
        if lost:
            raise InputError(f"terms of parameters {lost}: there are {len(self.parameters)}")

    def alone(self, which: int) -> tuple[Pair, ...]:
        """K and M that one parameter adds by itself: of each of its powers, or at some factors
        where it has others.
        """
        own = [t for t in self.terms if which in t.function.which]
        if all(isinstance(t.function, Product) for t in own):
            return tuple((t.stiffness, t.mass) for t in own if t.function.which == (which,))
        k, m = sparse.csr_array(self.stiffness.shape), sparse.csr_array(self.mass.shape)
        only = replace(self, stiffness=k, mass=m, terms=tuple(own))
        each = np.arange(len(self.parameters))
        return tuple(
            only.at(np.where(each == which, x, 1.0), NONE)
            for x in on_axis(self.parameters.parameters[which])
        )

    def at(self, factors: Float, least: float = 0.0) -> Pair:
        """K and M at the factors a (p,); without terms whose functions are up to `least` there."""
        k, m = self.stiffness, self.mass
        for t in self.terms:
            if abs(value := t.function.value(factors)) > least:
                k, m = k + value * t.stiffness, m + value * t.mass
        return sparse.csr_array(k), sparse.csr_array(m)


def observed_system(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    transform: sparse.csr_array,
    parameters: ParameterSet,
    terms: Sequence[AffineTerm],
    observation: Observation,
) -> AffineSystem:
    """The affine system of an assembled model; `transform` (full, f) goes from free to observed
    DOFs.
    """
    if observation.matrix.shape[1] != transform.shape[0]:
        raise InputError(
            f"the observation has {observation.matrix.shape[1]} DOFs, the model "
            f"{transform.shape[0]}"
        )
    observe = sparse.csr_array(observation.matrix @ transform)
    return AffineSystem(stiffness, mass, parameters, tuple(terms), observe)
