"""Whether masses that the deck lacks are among what is proposed: only where nothing that the deck has does as well.

They stand at many places and fit much that is another error. So the deck's own candidates are tried without them first,
and sets with them are sought only where one mass makes one of these sets better than the best of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ringtrue.core.progress import Progress
from ringtrue.update.choose import Choice
from ringtrue.update.search import SENSITIVE, Search
from ringtrue.update.subsets import TRIALS, Subsets, criteria

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
    known, barred = _better(own, lumps), list[int]()
    likely = [i for c in known for i in c.members.tolist() if i in lumps]
    while likely:
        found = search(barred, [own.path[-1], *(c for c in known if not np.isin(c.members, barred).any())], told)
        solid, faint = _by_size(found.search, found.path[-1])
        if not faint:
            sets = [found.search.refitted(own.path[-1]), found.path[-1]]
            without, with_them = criteria(found.search, sets).tolist()
            return (found, barred) if without - with_them > SUPPORT else (own, lumps)
        likely = [i for i in {*likely, *solid} if i not in faint]
        barred = [i for i in lumps if i not in likely]
    return own, lumps


def _better(own: Subsets, lumps: list[int]) -> list[Choice]:
    """Sets with a lump beside those of the path, or in place of a member of the best, that are better than the best."""
    search, best = own.search, own.path[-1]
    able = np.array([i for i in lumps if search.size[i] >= SENSITIVE], dtype=np.int64)
    tried = list[Choice]()
    for c, out in [*((c, -1) for c in own.path), *((best, i) for i in best.members.tolist())]:
        r, stay = search.point(c.x), [i for i in c.members.tolist() if i != out]
        base = r.value + r.slope[:, out] * c.x[out] if out >= 0 else r.value
        x = np.where(np.arange(c.x.size) == out, 0.0, c.x)
        if able.size and r.used.any():
            tried += [search.fit(at, x) for _, at in search.best(r, c.x, stay, able, base)[:TRIALS]]
    tried = [c for c in tried if not _by_size(search, c)[1]]
    least, *every = criteria(search, [best, *tried]).tolist()
    return [c for c, value in zip(tried, every, strict=True) if value < least]


def _by_size(search: Search, c: Choice) -> tuple[list[int], list[int]]:
    """Lumps of a set of at least `LEAST`, and those below: what is so small takes the part of some other error."""
    added = search.model.parameters.factors(c.x) - 1
    every = [i for i in c.members.tolist() if i in search.lumps]
    return [i for i in every if abs(added[i]) >= LEAST], [i for i in every if abs(added[i]) < LEAST]
