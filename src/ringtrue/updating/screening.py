"""Which of many candidates are looked at closely: seen from the deck, then from where a first
choice of them leads.

The slopes at a deck that is far off tell little of some candidates. So the set that is chosen among
those that explain most from there only leads nearer, and all are weighed again with the modes found
there (iterated screening: Fan and Lv 2008, sec. 4.1). Of many modes the lowest lead: those of a
dense band find partners only once these are right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.fem.assembly import System
from ringtrue.model.model import Model
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.updating import choose
from ringtrue.updating.candidates import Candidate
from ringtrue.updating.effects import misfits
from ringtrue.updating.objective import Target
from ringtrue.updating.pool import close, conflicts, counted_once, passed_over
from ringtrue.updating.several import Problem
from ringtrue.updating.subsets import subsets

LEADING = 60  # modes at most by which the first choice is made


class Beside(Protocol):
    """What was measured beside the modes, over all candidates."""

    def misfit(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Float, Float]:
        """As those of `misfits`, at x (k,) of a model over the candidates `which`; of the deck
        without a model.
        """

    def problem(self, search: Any, aim: Target) -> Problem:
        """Modes and data of a model that is searched with."""


Look = Callable[[tuple[Candidate, ...]], tuple[choose.Candidates, ReducedModel]]


def screened(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    aim: Target,
    observe: sparse.csr_array,
    modes: tuple[Float, Float],
    look: Look,
    *,
    pool: int,
    most: int,
    alike: float,
    progress: Progress,
    beside: Beside | None = None,
) -> tuple[Candidate, ...]:
    """Up to `pool` of the candidates, in their order.

    Parameters
    ----------
    candidates : sequence of Candidate
        All that change a mode.
    aim : Target
    observe : (channel, f) csr float64
        Readings of the channels of the test by the free degrees of freedom.
    modes : (m,), (f, m) float64
        λ, (rad/s)², and shapes of unit modal mass of the deck.
    look : callable (candidates) -> (model to search with, model whose modes are in the free degrees
    of freedom)
        The first needs modes for the `LEADING` lowest of the test only.
    pool, most : int
        Candidates that are kept, and parameters of the first choice.
    alike : float
        |cosine| from which on two candidates are one to the data.
    beside : Beside, optional
        What else was measured: it counts with the modes, and a candidate that it alone sees is
        seen.
    """

    def seen(
        modes: tuple[Float, Float], at: ReducedModel | None, x: Float, which: Sequence[int]
    ) -> tuple[tuple[Float, Float], ...]:
        found = misfits(model, system, candidates, *modes, observe @ modes[1], aim)
        if beside is None:
            return found
        more, slopes = beside.misfit(at, x, which, aim)
        return tuple((np.append(r, more), np.concatenate([g, slopes])) for r, g in found)

    kept = counted_once(model)
    at = close(model, candidates, seen(modes, None, np.zeros(0), ()), pool, kept=kept)
    some = tuple(candidates[i] for i in at.tolist())
    if len(some) == len(candidates):
        return some
    search, whole = look(some)
    low = aim.lowest(LEADING)
    problem = None if beside is None else beside.problem(search, low)
    far = passed_over(candidates, some)
    found = subsets(search, low, most, alike, conflicts(model, some), progress, problem, far)
    best, groups = found.path[-1], found.search.groups
    if not best.members.size:
        return some
    x = np.zeros(len(candidates))
    x[at] = best.x / whole.parameters.std()
    stay = at[np.isin(groups, groups[best.members])]
    near = [(r + g @ x, g) for r, g in seen(whole.vectors(best.x), whole, best.x, at.tolist())]
    return tuple(
        candidates[i] for i in close(model, candidates, near, pool, stay=stay.tolist(), kept=kept)
    )
