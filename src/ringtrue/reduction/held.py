"""A reduced model whose vectors other processes hold, with the matrices of the whole model: in this
one are small matrices alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.model.ports import Analysis
from ringtrue.reduction.projected import ProjectedModel

Along = Callable[[Sequence[Parameter], Float], tuple[Float, Float]]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeldModel(ProjectedModel):
    """A projected model; the vectors of its basis are coordinates (h, r) by h vectors held
    elsewhere.

    Attributes
    ----------
    along : callable
        vᵀ(∂K/∂a)v and vᵀ(∂M/∂a)v, (p, m, m) each, of p parameters along combinations (h, m) of the
        held vectors.
    """

    along: Along


@runtime_checkable
class ReducingAnalysis(Analysis, Protocol):
    """An analysis that reduces its model where its matrices are."""

    def reduced(
        self, parameters: ParameterSet, readings: sparse.csr_array, count: int, fmax: float
    ) -> HeldModel:
        """The reduced model that returns the lowest `count` modes, up to `fmax`, Hz, seen by
        readings (channel, dof).
        """
        ...
