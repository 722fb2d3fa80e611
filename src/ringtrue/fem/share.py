"""Assembly by several processes, each a share of the elements: what a process does of a model, and
how what all know is put together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.element_cards import ELEMENTS
from ringtrue.fem.mesh import Rows
from ringtrue.model.model import Model


def _alone(a: Any_) -> Any_:
    return a


@dataclass(frozen=True, slots=True)
class Share:
    """One of `size` like shares; all processes call the same functions in the same order.

    Attributes
    ----------
    number : int
        From 0.
    size : int
    summed : callable
        The sum over all shares of float64 arrays of one shape, known to each.
    gathered : callable
        Arrays (k,) of all shares one behind the other, known to each.
    """

    number: int = 0
    size: int = 1
    summed: Callable[[Float], Float] = _alone
    gathered: Callable[[Any_], Any_] = _alone

    def span(self, count: int) -> tuple[int, int]:
        """The first of so many that are its own, and that behind its last."""
        return count * self.number // self.size, count * (self.number + 1) // self.size

    def rows(self, model: Model) -> Rows | None:
        """Its rows of each element card; None for all."""
        if self.size == 1:
            return None
        rows: Rows = {}
        for card in (c for c in ELEMENTS if c in model):
            first, last = self.span(len(model[card]))
            if last > first:
                rows[card] = np.arange(first, last)
        return rows

    def total(self, part: sparse.csr_array) -> sparse.csr_array:
        """The sum of a small matrix over all shares."""
        if self.size == 1:
            return part
        coo = part.tocoo()
        data, row, col = (self.gathered(a) for a in (coo.data, coo.row, coo.col))
        return sparse.csr_array(sparse.coo_array((data, (row, col)), shape=part.shape))


WHOLE = Share()
