"""Which subset of many candidates explains a test: elimination from all at once, growing sets,
exchange.

1. Candidates to which the residuals are not sensitive are left out; one member stands for a
   cluster.
2. Sets of growing size: the best addition, or the best two, by the bounded minimum of the
   linearised J, confirmed by a short updating with new linearisations, or by J itself far from
   there; then exchange of members while J falls.
3. All candidates are updated at once, held back by their priors; then the least useful go, one by
   one.
4. What the best set leaves as residual replaces the assumed model discrepancy, and a shape is as
   many data as it has independent errors. No pair costs more than a lost mode: a test mode that no
   candidate explains then pulls none. The sets of 2 and 3 compete, members exchanged again.
5. The size is that of the lowest AICc plus the price of the search. Members of the same cluster
   join, as long as that falls; those that it gives no support leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.errors import InputError
from ringtrue.updating.alike import errors_of_shapes
from ringtrue.updating.choose import GAIN, Candidates, Choice
from ringtrue.updating.lumps import PLACES
from ringtrue.updating.objective import Residual, Target, Weights, comparable_criteria
from ringtrue.updating.objective import aicc as criterion
from ringtrue.updating.pool import NOISE
from ringtrue.updating.search import Search, ranked, rounded
from ringtrue.updating.several import Problem
from ringtrue.updating.weights import distance, left_over

TRIALS = 2  # promising sets that are fitted in one round
AT_ONCE = 20  # Gauss-Newton steps with all candidates free
TWICE = 2  # searches with the discrepancy that was found
NEAR = 0.4  # change of the logarithm of the discrepancy that asks for another search
PRICE = 1.0  # γ: 0 follows the noise, 1 finds little that is small
LATER = 2  # sizes beyond the best one that are looked at
DECIMALS = 6  # of the criterion: rounding does not choose between equal sets


@dataclass(frozen=True, slots=True, eq=False)
class Subsets:
    """The sets that were found.

    Attributes
    ----------
    search : Search
        With the discrepancy that was found.
    start, end : Residual
        At x = 0 and at the chosen point, with the weights and gates that were given.
    path : list of Choice
        The best set of each size from 0 on; the last is the one chosen.
    criteria : (k,) float64
        AICc and the price of the search.
    found : Weights
        With the discrepancy that the best set leaves.
    """

    search: Search
    start: Residual
    end: Residual
    path: list[Choice]
    criteria: Float
    found: Weights


def subsets(
    model: Candidates,
    target: Target,
    most: int,
    alike: float,
    apart: Bool | None,
    told: Progress,
    problem: Problem | None = None,
    passed_over: int = 0,
    barred: Sequence[int] = (),
    known: Sequence[Choice] = (),
) -> Subsets:
    """The best sets of up to `most` candidates, and the one that the criterion chooses.

    Parameters
    ----------
    apart : (p, p) bool, optional
        Candidates that must not be in one set.
    problem : Problem, optional
        All tests and data, the first of them `target`; over the same candidates.
    passed_over : int
        Candidates that were left out since they explain less of the same test, without lumps.
    barred : sequence of int
        Candidates that no set may have.
    known : sequence of Choice
        Sets that compete with those that are found.

    Raises
    ------
    InputError
        If no mode is paired at the start.
    """
    plain = Search.of(model, target, alike, apart, problem, passed_over, barred=barred)
    none = Choice(np.zeros(0, dtype=np.int64), np.zeros(len(model.parameters)), np.inf)
    start = plain.point(none.x)
    if not start.used.any():
        raise InputError(
            "no mode of the model is paired with one of the test: nothing can be localised from "
            "them"
        )
    if not plain.pool.size:
        return Subsets(
            plain, start, start, [none, none], criteria(plain, [none, none]), _found(plain, none)
        )
    path = _path(plain, most, none, [], part(told, 0.0, 0.4))
    sets, first = [*path[1:], *known], _best(plain, path)
    told(0.4, "all candidates together")
    whole = plain.fit(plain.together(), none.x, AT_ONCE)
    search = plain.sharper(_found(plain, whole), whole.x)
    whole = search.fit(search.together(), whole.x, AT_ONCE)
    few = [
        c for c in _eliminated(search, whole, most, part(told, 0.4, 0.6)) if c.members.size <= most
    ]
    best = _best(search, [search.refitted(c) for c in (first, *known)] + few)
    found, led = _found(search, best), best.x
    sets, count = [*sets, *few], plain.point(best.x).used.sum()
    for _ in range(TWICE):
        search = plain.sharper(found, led)
        path = _path(search, most, none, [search.refitted(c) for c in sets], part(told, 0.6, 1.0))
        best = _best(search, path)
        better = _found(search, best)
        if search.point(best.x).used.sum() < count or distance(better, found) < NEAR:
            break
        found, led, sets = better, best.x, path[1:]
    path.append(_pruned(search, _parted(search, best, most)))
    return Subsets(search, start, plain.point(path[-1].x), path, criteria(search, path), found)


def _eliminated(search: Search, now: Choice, most: int, told: Progress) -> list[Choice]:
    """The least useful members left out, one by one (several while there are many), the others
    updated again.
    """
    path, first = [now], now.members.size
    while now.members.size > 1:
        at = now.members
        r = search.point(now.x)
        g = r.slope[:, at]
        normal = g.T @ g + np.diag(search.prior[at] ** -2)
        best = np.linalg.solve(normal, g.T @ (r.value + g @ now.x[at]))
        rise = best**2 / np.diag(np.linalg.inv(normal))  # of the linearised J without each
        drop = max(1, (at.size - most) // 3)
        stay = np.sort(at[np.argsort(rise, kind="stable")[drop:]])
        now = search.fit(stay.tolist(), np.where(np.isin(np.arange(now.x.size), stay), now.x, 0.0))
        path.append(now)
        told(1 - now.members.size / first, f"candidates left: {now.members.size}")
    return path


def _path(
    search: Search, most: int, none: Choice, few: Sequence[Choice], told: Progress
) -> list[Choice]:
    """The best set of each size from 0 on, members exchanged: of `few`, or that of the size below
    with one more.
    """
    names = search.model.parameters.names
    path = [none]
    for k in range(1, min(most, int(search.data) - 4) + 1):  # AICc needs more data than parameters
        now, r, stay = path[-1], search.point(path[-1].x), path[-1].members.tolist()
        tried = [c for c in few if c.members.size == k]
        free = search.free(stay)
        if not tried and free.size and r.used.any():
            tried += [
                search.fit(at, now.x)
                for _, at in search.best(r, now.x, stay, free, r.value)[:TRIALS]
            ]
        if k > 1:
            tried += _in_pairs(search, path[-2])
        gained = any(search.value(c.x).used.sum() > r.used.sum() for c in tried)
        if search.target.rule == "gates" and r.used.sum() < search.modes and not gained:
            # no slope sees a mode without partner; where one leads to it, all candidates need not
            # be looked at far off
            here = search.cost(now.x)
            tried += [
                search.fit(at, x) for value, at, x in search.far(now, free)[:TRIALS] if value < here
            ]
        if not tried:
            break
        path.append(_exchanged(search, min(tried, key=lambda c: rounded(c.value))))
        more = [c for c in few if k < c.members.size <= most]
        if (
            k >= LATER and np.argmin(criteria(search, [*path, *more])) <= k - LATER
        ):  # more parameters do not pay
            break
        told(k / most, f"best {k}: {', '.join(names[i] for i in path[-1].members.tolist())}")
    return path


def _in_pairs(search: Search, now: Choice) -> list[Choice]:
    """Sets with two members more."""
    r, stay = search.point(now.x), now.members.tolist()
    free = search.free(stay)
    if free.size < 2 or not r.used.any():
        return []
    return [
        search.fit(at, now.x) for _, at in search.best_pairs(r, now.x, stay, free, r.value)[:TRIALS]
    ]


def _exchanged(search: Search, now: Choice) -> Choice:
    """Exchange one member at a time while J falls."""
    for _ in range(now.members.size if now.members.size > 1 else 0):
        r = search.point(now.x)
        options: list[tuple[float, list[int]]] = []
        for out in now.members.tolist():
            stay = [m for m in now.members.tolist() if m != out]
            free = np.setdiff1d(search.free(stay), [out])
            options += search.best(r, now.x, stay, free, r.value + r.slope[:, out] * now.x[out])[
                :TRIALS
            ]
        options = ranked(o for o in options if o[0] < (1 - GAIN) * now.value)[:TRIALS]
        tried = [
            search.fit(at, np.where(np.isin(np.arange(now.x.size), at), now.x, 0.0))
            for _, at in options
        ]
        better = min(tried, key=lambda c: rounded(c.value), default=now)
        if not better.value < (1 - GAIN) * now.value:
            return now
        now = better
    return now


def _parted(search: Search, now: Choice, most: int) -> Choice:
    """With members of the same clusters, as long as the criterion falls: exact data tell even these
    apart.
    """
    while 0 < now.members.size < most:
        at, r = now.members.tolist(), search.point(now.x)
        alike = np.isin(search.groups[search.pool], search.groups[at]) & ~np.isin(search.pool, at)
        twins = search.pool[alike & ~search.apart[np.ix_(search.pool, at)].any(axis=1)]
        options = search.best(r, now.x, at, twins, r.value)[:TRIALS] if twins.size else []
        tried = [search.fit(more, now.x) for value, more in options if value < now.value - NOISE]
        rise = criteria(search, [now, *tried])
        if rise.argmin() == 0:
            return now
        now = tried[int(rise.argmin()) - 1]
    return now


def _pruned(search: Search, now: Choice) -> Choice:
    """Leave out members, the least first, without whom the criterion is no higher."""
    while now.members.size > 1:
        all_ = now.members.tolist()
        fewer = [
            search.fit(
                [m for m in all_ if m != out], np.where(np.arange(now.x.size) == out, 0.0, now.x)
            )
            for out in all_
        ]
        value = criteria(search, [now, *fewer])
        best = int(np.argmin(value[1:]))
        if value[1 + best] > value[0]:
            return now
        now = fewer[best]
    return now


def criteria(search: Search, path: Sequence[Choice]) -> Float:
    """AICc of each set and the price of the search.

    The best of many sets fits the noise, too: 2 γ ln of the number of sets with as many factors and
    as many lumps. Chen and Chen (2008), eq. 2.2.
    """
    every = price(search, [c.members for c in path]) + aicc(search, path)
    return np.round(every, DECIMALS)


def foreseen(search: Search, r: Residual, members: Sequence[int], value: float) -> float:
    """The criterion of a set whose J is not computed but foreseen, all modes that are paired at a
    point counted.
    """
    n = search.target.weights.data * int(r.used.sum()) + r.more
    return float(price(search, [np.array(members)])[0]) + criterion(value, n, len(members))


def price(search: Search, sets: Sequence[Int]) -> Float:
    """Of the search for each set."""
    lump = np.isin(np.arange(search.prior.size), list(search.lumps))
    pool = np.unique(search.groups[search.pool[~lump[search.pool]]]).size + search.passed_over
    added = np.array([lump[s].sum() for s in sets])
    return (
        2
        * PRICE
        * (_log_sets(pool, np.array([s.size for s in sets]) - added) + _log_sets(PLACES, added))
    )


def _log_sets(pool: int, size: Int) -> Float:
    """ln of the number of sets of each size."""
    return np.asarray(
        gammaln(pool + 1) - gammaln(size + 1) - gammaln(np.maximum(pool - size, 0) + 1)
    )


def aicc(search: Search, path: Sequence[Choice]) -> Float:
    """AICc of each set, all over the test modes that at least one of them pairs."""
    return comparable_criteria(
        search.target,
        [search.value(c.x) for c in path],
        [c.x[c.members] for c in path],
        [search.prior[c.members] for c in path],
    )


def _best(search: Search, sets: Sequence[Choice]) -> Choice:
    """The set of the lowest criterion."""
    return sets[int(np.argmin(criteria(search, sets)))]


def _found(search: Search, c: Choice) -> Weights:
    """With the relative frequency and 1 − MAC that a set leaves, over the data that its parameters
    have left over.
    """
    g = search.point(c.x).slope[:, c.members] * search.prior[c.members]
    many = errors_of_shapes(search.target, search.model.modes(c.x))
    return left_over(search.assumed, search.point(c.x), g, search.target.weights.data, many)
