"""Standard deviations that stand beside a ModeSet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Standard deviations of identified modes.

    Attributes
    ----------
    frequency : (m,) float64, Hz
    damping : (m,) float64
    shape : (channel, m) float64
        Of the modulus of each component, in the unit of the shape.
    factor : (r, 2 m) float64
        Low-rank factor F of the covariance FᵀF of (frequencies, damping); r may be 0.
    """

    frequency: Float
    damping: Float
    shape: Float
    factor: Float

    def __post_init__(self) -> None:
        freeze_fields(
            self, frequency=np.float64, damping=np.float64, shape=np.float64, factor=np.float64
        )

    @classmethod
    def independent(cls, frequency: Float, damping: Float, shape: Float) -> Uncertainty:
        """Uncorrelated standard deviations."""
        m = np.size(frequency)
        return cls(frequency, damping, shape, np.zeros((0, 2 * m)))

    def take(self, modes: Sequence[int] | Int) -> Uncertainty:
        """The chosen modes, in the given order."""
        at = np.asarray(modes, dtype=np.int64)
        both = np.concatenate([at, at + self.frequency.size])
        return Uncertainty(
            self.frequency[at], self.damping[at], self.shape[:, at], self.factor[:, both]
        )
