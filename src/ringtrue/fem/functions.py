"""Scalar functions of the parameters' factors that are 0 at the nominal model: products of powers,
or any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Protocol

from scipy import sparse

from ringtrue.core.arrays import Float


class Function(Protocol):
    """A function of the factors a (P,) of all parameters.

    Attributes
    ----------
    which : tuple of int
        Positions of those that it depends on.
    """

    @property
    def which(self) -> tuple[int, ...]: ...

    def value(self, a: Float) -> float:
        """At the factors."""

    def slope(self, a: Float, i: int) -> float:
        """The derivative to a_i."""


@dataclass(frozen=True, slots=True)
class Product:
    """Π (a_i^p_i - 1): 0 wherever one of its factors is 1.

    Attributes
    ----------
    which, exponents : tuple of int
        Positions of the parameters, and the exponent of each.
    """

    which: tuple[int, ...]
    exponents: tuple[int, ...]

    def value(self, a: Float) -> float:
        """See `Function`."""
        return prod(float(a[i]) ** p - 1.0 for i, p in zip(self.which, self.exponents, strict=True))

    def slope(self, a: Float, i: int) -> float:
        """See `Function`."""
        own = {j: (float(a[j]), p) for j, p in zip(self.which, self.exponents, strict=True)}
        x, p = own.pop(i, (0.0, 0))
        return p * x ** (p - 1) * prod(y**q - 1.0 for y, q in own.values()) if p else 0.0


def power(which: int, exponent: int = 1) -> Product:
    """a^exponent - 1 of the factor of one parameter."""
    return Product((which,), (exponent,))


@dataclass(frozen=True, slots=True, eq=False)
class AffineTerm:
    """A part of K and M, (f, f) csr float64, and the function that it goes with."""

    function: Function
    stiffness: sparse.csr_array
    mass: sparse.csr_array
