"""Losses that keep a wrong datum (a mode paired wrongly, a bad channel) from pulling the whole
model.

The cost of a datum is ρ(s) of its squared weighted residual s, a shape being one datum. Minimised
by weighting its rows with ρ'(s) (iteratively reweighted least squares). Huber (1964); Beaton and
Tukey (1974).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import InputError


class Loss(Protocol):
    """ρ and ρ' of squared weighted residuals s (n,)."""

    def cost(self, s: Float) -> Float:
        """ρ(s), equal to s for small s."""
        ...

    def weight(self, s: Float) -> Float:
        """ρ'(s), 0 to 1."""
        ...


@dataclass(frozen=True, slots=True)
class Squares:
    """Plain least squares."""

    def cost(self, s: Float) -> Float:
        """s."""
        return s

    def weight(self, s: Float) -> Float:
        """1."""
        return np.ones_like(s)


@dataclass(frozen=True, slots=True)
class Huber:
    """Squares up to `limit` standard deviations, linear beyond: convex, an outlier pulls with
    constant force.
    """

    limit: float = 2.0

    def __post_init__(self) -> None:
        _positive(self.limit)

    def cost(self, s: Float) -> Float:
        """s, beyond the limit 2k√s − k²."""
        r = np.sqrt(s)
        return np.where(r <= self.limit, s, 2 * self.limit * r - self.limit**2)

    def weight(self, s: Float) -> Float:
        """min(1, k/√s)."""
        return np.asarray(np.minimum(1.0, self.limit / np.sqrt(np.maximum(s, 1e-300))))


@dataclass(frozen=True, slots=True)
class Tukey:
    """Bisquare: a datum beyond `limit` standard deviations has no influence at all; not convex, so
    start near.
    """

    limit: float = 6.0

    def __post_init__(self) -> None:
        _positive(self.limit)

    def cost(self, s: Float) -> Float:
        """k²/3 (1 − (1 − s/k²)³), at most k²/3."""
        inside = np.minimum(s / self.limit**2, 1.0)
        return np.asarray(self.limit**2 / 3 * (1 - (1 - inside) ** 3))

    def weight(self, s: Float) -> Float:
        """(1 − s/k²)², 0 beyond."""
        return np.asarray((1 - np.minimum(s / self.limit**2, 1.0)) ** 2)


def _positive(limit: float) -> None:
    if not limit > 0:
        raise InputError(f"limit of a robust loss {limit}: must be > 0 standard deviations")


def squares(value: Float, datum: Int) -> Float:
    """Squared weighted residual of each datum (n,) from rows (r,) numbered 0 to n − 1."""
    return np.asarray(np.bincount(datum, value**2, minlength=int(datum.max(initial=-1)) + 1))
