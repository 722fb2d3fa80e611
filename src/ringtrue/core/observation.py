"""Observation: the only bridge between the DOFs of a model and the channels of a test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, freeze_fields
from ringtrue.core.dofs import DofSet
from ringtrue.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A sparse matrix from FE degrees of freedom to test channels.

    Attributes
    ----------
    matrix : (channel, dof) scipy.sparse.csr_array float64
        Interpolation, direction cosines and signs; dimensionless.
    channels : tuple of str
    dofs : DofSet
        The FE degrees of freedom (basic frame) that the columns stand for.
    unit : float
        Factor from the model's length unit to metres (mm-t-s: 1e-3).
    distance : (channel,) float64, model unit
        From the sensor to the node or nodes it was matched to.
    """

    matrix: sparse.csr_array
    channels: tuple[str, ...]
    dofs: DofSet
    unit: float
    distance: Float

    def __post_init__(self) -> None:
        freeze_fields(self, distance=np.float64)
        if self.matrix.shape != (len(self.channels), len(self.dofs)):
            raise InputError(
                f"observation {self.matrix.shape} for {len(self.channels)} channels and "
                f"{len(self.dofs)} DOFs"
            )

    def __call__(self, shapes: Any_) -> Any_:
        """Shapes (dof, m) of the model, seen at the channels (channel, m).

        Mass-normalised shapes of a model in its own units stay so in SI through `unit` (length)
        elsewhere; here only direction and place change.
        """
        return np.asarray(self.matrix @ shapes)

    def and_also(self, more: Observation) -> Observation:
        """The same model seen at further channels, too."""
        matrix = sparse.csr_array(sparse.vstack([self.matrix, more.matrix]))
        distance = np.concatenate([self.distance, more.distance])
        return Observation(matrix, (*self.channels, *more.channels), self.dofs, self.unit, distance)
