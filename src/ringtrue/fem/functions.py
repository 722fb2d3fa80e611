"""Scalar functions of the parameters' factors that are 0 at the nominal model: powers, and series of any smooth one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from scipy import sparse

from ringtrue.core.arrays import Float

NODES = (2.0, 0.5, 3.0)  # factors at which powers are told apart


@dataclass(frozen=True, slots=True)
class Powers:
    """a^p - 1 for each of the exponents p."""

    exponents: tuple[int, ...]

    @property
    def nodes(self) -> Float:
        """Factors that tell the functions apart, one each."""
        return np.array(NODES[: len(self.exponents)])

    def __call__(self, a: float) -> tuple[Float, Float]:
        """Values and slopes, (n,) each."""
        return np.array([a**p - 1.0 for p in self.exponents]), np.array([p * a ** (p - 1) for p in self.exponents])


@dataclass(frozen=True, slots=True)
class Chebyshev:
    """T_j(u) - T_j(u(1)), j = 1 .. n - 1, with u linear in ln a and -1 and 1 at `lower` and `upper`."""

    lower: float
    upper: float
    n: int

    @property
    def nodes(self) -> Float:
        """Factors at the zeros of T_n, (n,)."""
        mid, half = self._range
        return np.asarray(np.exp(mid + half * chebyshev.chebpts1(self.n)))

    @property
    def _range(self) -> tuple[float, float]:
        low, high = np.log(self.lower), np.log(self.upper)
        return float(low + high) / 2, float(high - low) / 2

    def __call__(self, a: float) -> tuple[Float, Float]:
        """Values and slopes, (n - 1,) each."""
        mid, half = self._range
        u = (np.log([a, 1.0]) - mid) / half
        t = chebyshev.chebvander(u, self.n - 1)
        return (t[0] - t[1])[1:], t[0, :-1] @ _derivatives(self.n)[:, 1:] / (half * a)


@cache
def _derivatives(n: int) -> Float:
    """Chebyshev coefficients (n - 1, n) of the derivatives of T_0 .. T_(n-1)."""
    return np.asarray(chebyshev.chebder(np.eye(n)))


Basis = Powers | Chebyshev


@lru_cache(maxsize=4096)
def _at(basis: Basis, a: float) -> tuple[Float, Float]:
    """Values and slopes; the terms of a parameter share its bases."""
    return basis(a)


@dataclass(frozen=True, slots=True, eq=False)
class Function:
    """A sum of products of functions of one factor each; 0 wherever one of its factors is 1.

    Attributes
    ----------
    which : tuple of int
        Its parameters, by position.
    bases : tuple of Basis
        One for each of them.
    weights : (n_1, n_2, ...) float64
    """

    which: tuple[int, ...]
    bases: tuple[Basis, ...]
    weights: Float

    def own(self, a: Float) -> tuple[float, ...]:
        """Its own of the factors a (P,) of all parameters."""
        return tuple(float(a[i]) for i in self.which)

    def value(self, own: Sequence[float]) -> float:
        """At its own factors."""
        return self._contracted([_at(b, x)[0] for b, x in zip(self.bases, own, strict=True)])

    def slope(self, own: Sequence[float]) -> tuple[float, ...]:
        """The derivative to each of its own factors."""
        both = [_at(b, x) for b, x in zip(self.bases, own, strict=True)]
        return tuple(self._contracted([x[int(i == j)] for i, x in enumerate(both)]) for j in range(len(both)))

    def _contracted(self, vectors: Sequence[Float]) -> float:
        left = self.weights
        for v in vectors:
            left = np.tensordot(v, left, 1)
        return float(left)


def power(which: int, exponent: int = 1) -> Function:
    """a^exponent - 1 of the factor of one parameter."""
    return Function((which,), (Powers((exponent,)),), np.ones(1))


@dataclass(frozen=True, slots=True, eq=False)
class AffineTerm:
    """A part of K and M, (f, f) csr float64, and the function that it goes with."""

    function: Function
    stiffness: sparse.csr_array
    mass: sparse.csr_array
