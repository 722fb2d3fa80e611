"""A model whose K and M are affine in powers of its parameters' factors, and where it is observed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.observation import Observation
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError


class Term(Protocol):
    """A part of K and M that goes with a power of a parameter's factor."""

    @property
    def power(self) -> int: ...
    @property
    def stiffness(self) -> sparse.csr_array: ...
    @property
    def mass(self) -> sparse.csr_array: ...


@dataclass(frozen=True, slots=True, eq=False)
class AffineSystem:
    """K(a) and M(a) of a model, and where it is observed.

    Attributes
    ----------
    stiffness, mass : (f, f) csr_array float64
        At a = 1.
    parameters : ParameterSet
    terms : tuple (p,) of tuples of Term
        For each parameter. Terms of different parameters must not share a product (the same field of the same
        elements scaled by two parameters): that would not be affine.
    observe : (channel, f) csr_array float64
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    parameters: ParameterSet
    terms: tuple[tuple[Term, ...], ...]
    observe: sparse.csr_array

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(tuple(t) for t in self.terms))
        if len(self.terms) != len(self.parameters):
            raise InputError(f"{len(self.parameters)} parameters, terms for {len(self.terms)}")

    def at(self, factors: Float) -> tuple[sparse.csr_array, sparse.csr_array]:
        """K and M at the factors a (p,)."""
        k, m = self.stiffness, self.mass
        for a, terms in zip(factors.tolist(), self.terms, strict=True):  # over parameters and their powers
            for t in terms:
                if a != 1.0:
                    k = k + (a**t.power - 1.0) * t.stiffness
                    m = m + (a**t.power - 1.0) * t.mass
        return sparse.csr_array(k), sparse.csr_array(m)


def observed_system(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    transform: sparse.csr_array,
    parameters: ParameterSet,
    terms: Sequence[Sequence[Term]],
    observation: Observation,
) -> AffineSystem:
    """The affine system of an assembled model; `transform` (full, f) goes from free to observed DOFs."""
    if observation.matrix.shape[1] != transform.shape[0]:
        raise InputError(f"the observation has {observation.matrix.shape[1]} DOFs, the model {transform.shape[0]}")
    observe = sparse.csr_array(observation.matrix @ transform)
    return AffineSystem(stiffness, mass, parameters, tuple(tuple(t) for t in terms), observe)
