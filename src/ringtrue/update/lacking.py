"""Whether masses that the deck lacks are among what is proposed: only where nothing that the deck has does as well.

They stand at many places and fit much that is another error. So the deck's own candidates are tried without them first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ringtrue.core.progress import Progress
from ringtrue.update.choose import Choice
from ringtrue.update.subsets import Subsets, criteria

LEAST = 0.01  # of the mass of the structure that is worth telling as lacking at one place
SUPPORT = 10.0  # difference of AICc beyond which a model has none (Burnham and Anderson 2002, section 2.6)


def with_lumps(
    search: Callable[[Sequence[int], Sequence[Choice], Progress], Subsets],
    own: Subsets,
    lumps: list[int],
    told: Progress,
) -> tuple[Subsets, list[int]]:
    """The sets with lumps where the one without has no support beside them, else `own`; and which were barred.

    Parameters
    ----------
    search : callable (barred, known, told) -> Subsets
        Without those barred, and with sets that are known among those that compete.
    own : Subsets
        With all lumps barred.
    lumps : list of int
        Positions of these among the candidates.
    """
    faint = list[int]()
    while True:
        found = search(faint, own.path[-1:], told)
        if not (more := _faint(found)):
            break
        faint += more
    sets = [found.search.refitted(own.path[-1]), found.path[-1]]
    without, with_them = criteria(found.search, sets).tolist()
    return (found, faint) if without - with_them > SUPPORT else (own, lumps)


def _faint(found: Subsets) -> list[int]:
    """Lumps of the set that are less than `LEAST`: what is so small takes the part of some other error."""
    best = found.path[-1]
    a = found.search.model.parameters.factors(best.x)
    return [i for i in best.members.tolist() if i in found.search.lumps and abs(a[i] - 1) < LEAST]
