"""Functions of one factor as Chebyshev series in its logarithm, in place of a call of the kernels
at each point.

Analytic functions have series that converge geometrically: Trefethen (2013), Approximation Theory
and Approximation Practice, ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander

from ringtrue.core.arrays import Float

DEGREES = (4, 8, 16, 32, 64, 128)  # each takes the points of the one before
# relative to the largest, at the points that the next degree adds; that one's error is about the
# square
HOLDS = 1e-9
ROUNDING = 1e-12  # by which a factor may pass its bounds


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Functions (r,) of one factor between two bounds.

    Attributes
    ----------
    lower, upper : float
        Bounds of the factor.
    terms : (n, r) float64
        Of the Chebyshev polynomials in ln a, put to -1 and 1 at the bounds.
    """

    lower: float
    upper: float
    terms: Float

    def holds(self, a: float) -> bool:
        """Whether a factor is between the bounds."""
        return self.lower * (1 - ROUNDING) <= a <= self.upper * (1 + ROUNDING)

    def value(self, a: float) -> Float:
        """The functions (r,)."""
        return np.asarray(chebval(self._at(a), self.terms))

    def slope(self, a: float) -> Float:
        """Their derivatives (r,)."""
        inner = 2 / (a * np.log(self.upper / self.lower))
        return np.asarray(inner * chebval(self._at(a), chebder(self.terms)))

    def _at(self, a: float) -> float:
        return float(2 * np.log(a / self.lower) / np.log(self.upper / self.lower) - 1)


def fitted(bounds: Float, values: Callable[[Float], list[Float]]) -> list[Series | None]:
    """Series of several functions (r,), each of a factor of its own; None where it does not
    converge.

    Parameters
    ----------
    bounds : (k, 2) float64
        Lower and upper of each factor.
    values : callable (k,) -> k arrays (r,)
        All functions, each at its own factor.
    """
    low, high = bounds.T
    known: dict[float, list[Float]] = {}
    found: list[Series | None] = [None] * len(bounds)
    before: list[Float] = []
    for n in DEGREES:
        shares = (1 - np.round(np.cos(np.pi * np.arange(n + 1) / n), 15)) / 2
        known |= {s: values(low * (high / low) ** s) for s in shares.tolist() if s not in known}
        basis, every = (
            chebvander(2 * shares - 1, n),
            [np.array([known[s][k] for s in shares]) for k in range(len(low))],
        )
        for k, c in enumerate(every):
            if before and found[k] is None:
                miss = np.abs(basis[:, : len(before[k])] @ before[k] - c).max(initial=0.0)
                if miss <= HOLDS * np.abs(c).max(initial=0.0):
                    found[k] = Series(float(low[k]), float(high[k]), np.linalg.solve(basis, c))
        if all(found):
            break
        before = [np.linalg.solve(basis, c) for c in every]
    return found
