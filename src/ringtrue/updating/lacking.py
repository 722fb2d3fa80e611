"""Whether masses that the deck lacks are among what is proposed: only where nothing that the deck
has does as well.

They stand at many places and fit much that is another error. So the deck's own candidates are tried
without them first, and sets with them are sought only where one grown from a mass, as far as the
linearised J shows, is better than these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.progress import Progress
from ringtrue.updating.choose import Choice
from ringtrue.updating.search import SENSITIVE, Search
from ringtrue.updating.subsets import Subsets, criteria, foreseen

LEAST = 0.01  # of the mass of the structure that is worth telling as lacking at one place
LOOKS, MOST = 4, 6  # sets that are fitted at a point, and their largest size
# difference of AICc beyond which a model has none (Burnham and Anderson 2002, section 2.6)
SUPPORT = 10.0


def with_lumps(
    search: Callable[[Sequence[int], Sequence[Choice], Progress], Subsets],
    own: Subsets,
    lumps: list[int],
    told: Progress,
) -> tuple[Subsets, list[int]]:
    """The sets with lumps where the one without has no support beside them, else `own`; and which
    were barred.

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
        found = search(
            barred,
            [own.path[-1], *(c for c in known if not np.isin(c.members, barred).any())],
            told,
        )
        solid, faint = _by_size(found.search, found.path[-1])
        if not faint:
            sets = [found.search.refitted(own.path[-1]), found.path[-1]]
            without, with_them = criteria(found.search, sets).tolist()
            return (found, barred) if without - with_them > SUPPORT else (own, lumps)
        likely = [i for i in {*likely, *solid} if i not in faint]
        barred = [i for i in lumps if i not in likely]
    return own, lumps


def _better(own: Subsets, lumps: list[int]) -> list[Choice]:
    """Sets with lumps that are better than the best without: grown by the linearised J at points of
    the path.
    """
    search, best, tried = own.search, own.path[-1], list[Choice]()
    able = np.array([i for i in lumps if search.size[i] >= SENSITIVE], dtype=np.int64)
    for c in {c.x.tobytes(): c for c in (own.path[0], *own.path[-2:])}.values():
        r = search.point(c.x)
        if not r.used.any():
            continue
        grown = [
            o for i in able.tolist() for o in _grown(search, c, [i], np.append(search.pool, able))
        ]
        for _, at in sorted(grown)[:LOOKS]:
            tried.append(search.fit(at, np.where(np.isin(np.arange(c.x.size), at), c.x, 0.0)))
    tried = [c for c in tried if not _by_size(search, c)[1]]
    tried = [
        *{tuple(sorted(c.members)): c for c in sorted(tried, key=lambda c: -c.value)}.values()
    ]  # one a set
    least, *every = criteria(search, [best, *tried]).tolist()
    return [c for c, value in zip(tried, every, strict=True) if value < least]


def _grown(
    search: Search, at: Choice, members: list[int], free: Int
) -> list[tuple[float, list[int]]]:
    """Sets by the linearised J at a point, one member more each time: the criterion foreseen, and
    members.
    """
    r, nominal, out = search.point(at.x), np.zeros(at.x.size), list[tuple[float, list[int]]]()
    base = r.value + r.slope @ at.x
    value = search.ahead(r, nominal, members, base)
    while True:
        out.append((foreseen(search, r, members, value), members))
        if len(members) >= MOST:
            return out
        barred = np.isin(search.groups[free], search.groups[members]) | search.apart[free][
            :, members
        ].any(axis=1)
        more = free[~barred]
        if not more.size:
            return out
        value, members = search.best(r, nominal, members, more, base)[0]


def _by_size(search: Search, c: Choice) -> tuple[list[int], list[int]]:
    """Lumps of a set of at least `LEAST`, and those below: what is so small takes the part of some
    other error.
    """
    added = search.model.parameters.factors(c.x) - 1
    every = [i for i in c.members.tolist() if i in search.lumps]
    return [i for i in every if abs(added[i]) >= LEAST], [i for i in every if abs(added[i]) < LEAST]
