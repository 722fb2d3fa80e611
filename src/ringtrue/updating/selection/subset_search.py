"""The search for the best subset of candidates: points and fits computed once, growth by the
linearised objective, exchange of members, and the criterion that chooses the size.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import gammaln

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import Progress, part
from ringtrue.errors import InputError, NumericalError
from ringtrue.updating.identifiability import COLLINEARITY, clusters
from ringtrue.updating.problem import (
    Problem,
    Residual,
    comparable_criteria,
    doubting,
    residual_at,
    weighed,
)
from ringtrue.updating.problem import aicc as aicc_of
from ringtrue.updating.regularisation import distance, left_over
from ringtrue.updating.residuals.modal import Quantity
from ringtrue.updating.selection.candidates import PLACES
from ringtrue.updating.selection.selection_rules import (
    LEAST_GAIN,
    SHORT,
    FittedSet,
    falling,
    predicted,
    rounded,
    short_update,
)
from ringtrue.updating.target import Target, Weights
from ringtrue.updating.uncertainty import errors_of_shapes


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Limits of a search.

    Attributes
    ----------
    most : int
        Largest number of parameters in a set.
    collinear : float
        |cosine| of two weighted sensitivities from which on the data cannot separate them.
    sensitive : float
        Least effect of one prior standard deviation, in standard deviations of the residual.
    pool : int
        Candidates for an addition or exchange whose bounded prediction is computed.
    trials : int
        Promising sets that are fitted in one round.
    noise : float
        Fall of J that one parameter without meaning reaches (Akaike).
    passed_over : int
        Candidates that were left out before, as they explain less of the same test: the choice was
        among these, too.
    """

    most: int = 8
    collinear: float = COLLINEARITY.cosine
    sensitive: float = 0.05
    pool: int = 12
    trials: int = 2
    noise: float = 2.0
    passed_over: int = 0


DEFAULT_SEARCH = SearchSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Here:
    """The residuals linearised about a point x (p,), with the residual (r,) there when some members
    are put back to 0.
    """

    at: Residual
    x: Float
    value: Float

    @classmethod
    def of(cls, at: Residual, x: Float, removed: Sequence[int] = ()) -> Here:
        """With some members put back to 0."""
        gone = list(removed)
        return cls(at, x, at.value + at.slope[:, gone] @ x[gone])


Ranked = list[tuple[float, list[int]]]


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The candidates, what they are fitted to, and which of them may enter.

    Attributes
    ----------
    problem : Problem
        All tests and data, over all candidates.
    settings : SearchSettings
    assumed : Weights
        Before any discrepancy was found.
    conflicts : (p, p) bool
        Pairs that must not be in one set.
    pool : (k,) int64
        Candidates that may enter.
    groups : (p,) int64
        Cluster of each candidate.
    size : (p,) float64
        Effect of one prior standard deviation.
    points, values : dict
        Residuals with and without sensitivities, by point.
    fits : dict
        Choices by members, start and number of iterations.
    """

    problem: Problem
    settings: SearchSettings
    assumed: Weights
    conflicts: Bool
    pool: Int
    groups: Int
    size: Float
    points: dict[bytes, Residual] = field(default_factory=dict)
    values: dict[bytes, Residual] = field(default_factory=dict)
    fits: dict[tuple[tuple[int, ...], bytes, int], FittedSet] = field(
        default_factory=dict
    )

    @classmethod
    def of(
        cls,
        problem: Problem,
        settings: SearchSettings = DEFAULT_SEARCH,
        *,
        conflicts: Bool | None = None,
        barred: Sequence[int] = (),
        start: Float | None = None,
    ) -> Search:
        """With clusters of candidates that are collinear at the deck and, if given, at `start`.

        At one point two modes may be so close that every candidate turns them into each other, and
        all look collinear.
        """
        p = len(problem.parameters)
        std = problem.parameters.std()
        points = [np.zeros(p)] if start is None else [np.zeros(p), start]
        slopes = [residual_at(problem, x).slope * std for x in points]
        size = np.linalg.norm(slopes[0], axis=0)
        unit = [g / np.maximum(np.linalg.norm(g, axis=0), 1e-300) for g in slopes]
        sensitive = np.flatnonzero(size >= settings.sensitive)
        return cls(
            problem=problem,
            settings=settings,
            assumed=problem.configurations[0].target.weights,
            conflicts=np.zeros((p, p), dtype=np.bool_)
            if conflicts is None
            else conflicts,
            pool=np.setdiff1d(sensitive, barred),
            groups=clusters(np.concatenate(unit), settings.collinear),
            size=size,
        )

    @property
    def target(self) -> Target:
        """Of the first configuration."""
        return self.problem.configurations[0].target

    @property
    def prior(self) -> Float:
        """Standard deviations of x, (p,)."""
        return self.problem.parameters.std()

    @property
    def masses(self) -> Int:
        """Positions of the candidates that add a mass which the deck does not have."""
        every = self.problem.parameters.parameters
        return np.array([i for i, p in enumerate(every) if p.lump], dtype=np.int64)

    @property
    def modes(self) -> int:
        """Number of used modes of all tests."""
        return sum(int(c.target.used.sum()) for c in self.problem.configurations)

    def sharper(self, found: Weights, start: Float) -> Search:
        """The same with the discrepancy that was found at `start`, x (p,), capped
        (`Target.doubting`): it separates more candidates.
        """
        sharp = weighed(self.problem, found)
        again = Search.of(sharp, self.settings, conflicts=self.conflicts, start=start)
        return replace(
            again,
            problem=doubting(sharp),
            assumed=self.assumed,
            pool=self.pool,
        )

    def point(self, x: Float) -> Residual:
        """Residuals and sensitivities to all candidates at x, computed once."""
        key = x.tobytes()
        if key not in self.points:
            self.points[key] = _compact(residual_at(self.problem, x))
        return self.points[key]

    def value(self, x: Float) -> Residual:
        """Residuals at x, computed once, with sensitivities only where these are known."""
        key = x.tobytes()
        if key not in self.points and key not in self.values:
            self.values[key] = residual_at(self.problem, x, slopes=False)
        return self.points.get(key) or self.values[key]

    def fit(self, members: Sequence[int], x: Float, limit: int = SHORT) -> FittedSet:
        """A short updating from x, or from the nominal model where x cannot be solved; done
        once.
        """
        x = np.clip(x, *self.problem.parameters.bounds())
        key = (tuple(members), x.tobytes(), limit)
        if key not in self.fits:
            try:
                self.fits[key] = short_update(self.problem, members, x, limit)
            except NumericalError:
                self.fits[key] = short_update(
                    self.problem, members, np.zeros(x.size), limit
                )
        return self.fits[key]

    def cost(self, x: Float) -> float:
        """J at x, modes only; infinite where it cannot be solved."""
        try:
            return self.problem.cost(x)
        except NumericalError:
            return np.inf

    def far(self, now: FittedSet, free: Int) -> list[tuple[float, list[int], Float]]:
        """Sets with one of `free` more, too far off for a linearisation: J, members and x (p,), the
        lowest first.
        """
        low, high = self.problem.parameters.bounds()
        out = []
        for c, step in product(free.tolist(), (-3.0, -1.5, 1.5, 3.0)):
            x = now.x.copy()
            x[c] = np.clip(step * self.prior[c], low[c], high[c])
            out.append((self.cost(x), [*now.members.tolist(), c], x))
        return sorted(out, key=lambda o: rounded(o[0]))

    def refitted(self, c: FittedSet) -> FittedSet:
        """A set of another search, updated in this one."""
        return self.fit(c.members.tolist(), c.x) if c.members.size else c

    def free(self, members: Sequence[int]) -> Int:
        """Candidates that may join the members: of other clusters, and without conflict."""
        at = np.array(members, dtype=np.int64)
        barred = np.isin(self.groups[self.pool], self.groups[at])
        barred |= self.conflicts[np.ix_(self.pool, at)].any(axis=1)
        return self.pool[~barred]

    def all_free(self) -> list[int]:
        """As many candidates as may be in one set, those of the largest effect first."""
        out: list[int] = []
        while (free := self.free(out)).size:
            out.append(int(free[falling(self.size[free])[0]]))
        return sorted(out)

    def predicted(self, here: Here, members: Sequence[int]) -> float:
        """J at the bounded minimum over the members, linearised."""
        i = list(members)
        g = here.at.slope[:, i]
        w = self.prior[i] ** -2
        low, high = (b[i] for b in self.problem.parameters.bounds())
        load = here.value + g @ here.x[i]
        y = np.linalg.solve(g.T @ g + np.diag(w), g.T @ load)
        if (y >= low).all() and (y <= high).all():
            return float(np.sum((load - g @ y) ** 2) + w @ y**2)
        return predicted(
            g,
            here.value,
            x=here.x[i],
            w=w,
            low=low,
            high=high,
        )

    def best(self, here: Here, stay: Sequence[int], free: Int) -> Ranked:
        """Sets `stay` + one of `free`, by predicted J; a cheap bound chooses those looked at."""
        column, left = self._projected(here, stay, free)
        gain = (column.T @ left) ** 2 / (np.sum(column**2, axis=0) + 1)
        few = free[falling(gain)[: self.settings.pool]].tolist()
        return ranked((self.predicted(here, [*stay, c]), [*stay, c]) for c in few)

    def best_pairs(self, here: Here, stay: Sequence[int], free: Int) -> Ranked:
        """The same with two of `free`: of two errors that cancel neither pays by itself."""
        column, left = self._projected(here, stay, free)
        b = column.T @ left
        t = column.T @ column
        d = np.diag(t) + 1
        own = np.outer(b**2, d)
        both = np.outer(b, b) * t
        gain = np.triu((own + own.T - 2 * both) / (np.outer(d, d) - t**2), 1)
        same = self.groups[free][:, None] == self.groups[free]
        gain[self.conflicts[np.ix_(free, free)] | same] = 0.0
        few = falling(gain.ravel())[: self.settings.pool]
        at = np.stack(np.unravel_index(few[gain.ravel()[few] > 0], gain.shape), axis=1)
        pairs = [[*stay, *c] for c in free[at].tolist()]
        return ranked((self.predicted(here, c), c) for c in pairs)

    def _projected(
        self, here: Here, stay: Sequence[int], free: Int
    ) -> tuple[Float, Float]:
        """Slopes (n, f) of `free`, in units of the prior, and the residual (n,), less what `stay`
        can take of them.
        """
        i = list(stay)
        g = here.at.slope * self.prior
        rest = here.value + here.at.slope[:, i] @ here.x[i]
        if not i:
            return g[:, free], rest
        q = np.linalg.qr(np.concatenate([g[:, i], np.eye(len(i))]))[0]
        column = np.concatenate([g[:, free], np.zeros((len(i), free.size))])
        left = np.concatenate([rest, np.zeros(len(i))])
        return column - q @ (q.T @ column), left - q @ (q.T @ left)


def ranked(options: Iterable[tuple[float, list[int]]]) -> Ranked:
    """The lowest first; of equal ones the first of the candidates."""
    return sorted(options, key=lambda o: (rounded(o[0]), o[1]))


def _compact(r: Residual) -> Residual:
    """The same squares and products of a residual, its shapes in as many rows as the candidates
    span, (p + 1,).

    A rotation of the rows, by QR, that leaves frequencies and other data as they are: hundreds of
    channels and modes are 10⁵ rows, and a search keeps hundreds of points.
    """
    of_shape = r.quantity == Quantity.SHAPE.value
    if of_shape.sum() <= r.slope.shape[1] + 1:
        return r
    both = np.column_stack([r.slope[of_shape], r.value[of_shape]])
    few = np.asarray(np.linalg.qr(both, mode="r"), dtype=np.float64)
    shapes = np.full(len(few), Quantity.SHAPE.value, dtype=np.int64)
    return replace(
        r,
        value=np.concatenate([r.value[~of_shape], few[:, -1]]),
        slope=np.concatenate([r.slope[~of_shape], few[:, :-1]]),
        quantity=np.append(r.quantity[~of_shape], shapes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Subsets:
    """The sets that were found.

    Attributes
    ----------
    search : Search
        With the discrepancy that was found.
    start, end : Residual
        At x = 0 and at the chosen point, with the weights and gates that were given.
    path : list of FittedSet
        The best set of each size from 0 on; the last is the one chosen.
    criteria : (k,) float64
        AICc and the price of the search.
    found : Weights
        With the discrepancy that the best set leaves.
    """

    search: Search
    start: Residual
    end: Residual
    path: list[FittedSet]
    criteria: Float
    found: Weights


def subsets(
    plain: Search, progress: Progress, known: Sequence[FittedSet] = ()
) -> Subsets:
    """The best sets of up to `most` candidates, and the one that the criterion chooses.

    Parameters
    ----------
    plain : Search
        With the weights that are assumed.
    known : sequence of FittedSet
        Sets that compete with those that are found.

    Raises
    ------
    InputError
        If no mode is paired at the start.
    """
    most = plain.settings.most
    p = len(plain.problem.parameters)
    none = FittedSet(np.zeros(0, dtype=np.int64), np.zeros(p), np.inf)
    start = plain.point(none.x)
    if not start.used.any():
        raise InputError(
            "no mode of the model is paired with one of the test: nothing can be localised from "
            "them"
        )
    if not plain.pool.size:
        values = criteria(plain, [none, none])
        return Subsets(
            plain, start, start, [none, none], values, found=_found(plain, none)
        )
    path = _path(plain, none, [], part(progress, 0.0, 0.4))
    sets = [*path[1:], *known]
    first = _best(plain, path)
    progress(0.4, "all candidates in one set")
    many = 20  # iterations: with all free an updating takes longer
    whole = plain.fit(plain.all_free(), none.x, many)
    search = plain.sharper(_found(plain, whole), whole.x)
    whole = search.fit(search.all_free(), whole.x, many)
    few = _eliminated(search, whole, part(progress, 0.4, 0.6))
    few = [c for c in few if c.members.size <= most]
    best = _best(search, [search.refitted(c) for c in (first, *known)] + few)
    found = _found(search, best)
    reached = best.x
    sets += few
    count = plain.point(best.x).used.sum()
    # again with the discrepancy that was found, until that changes little
    for _ in range(2):
        search = plain.sharper(found, reached)
        again = [search.refitted(c) for c in sets]
        path = _path(search, none, again, part(progress, 0.6, 1.0))
        best = _best(search, path)
        better = _found(search, best)
        if search.point(best.x).used.sum() < count or distance(better, found) < 0.4:
            break
        found = better
        reached = best.x
        sets = path[1:]
    path.append(_pruned(search, _with_collinear(search, best)))
    return Subsets(
        search=search,
        start=start,
        end=plain.point(path[-1].x),
        path=path,
        criteria=criteria(search, path),
        found=found,
    )


def _eliminated(search: Search, now: FittedSet, progress: Progress) -> list[FittedSet]:
    """The least useful members left out, one by one (several while there are many), the others
    updated again.
    """
    path = [now]
    first = now.members.size
    while now.members.size > 1:
        at = now.members
        r = search.point(now.x)
        g = r.slope[:, at]
        normal = g.T @ g + np.diag(search.prior[at] ** -2)
        best = np.linalg.solve(normal, g.T @ (r.value + g @ now.x[at]))
        # of the linearised J without each
        rise = best**2 / np.diag(np.linalg.inv(normal))
        drop = max(1, (at.size - search.settings.most) // 3)
        stay = np.sort(at[np.argsort(rise, kind="stable")[drop:]]).tolist()
        now = search.fit(stay, now.only(stay))
        path.append(now)
        progress(1 - now.members.size / first, f"candidates left: {now.members.size}")
    return path


def _path(
    search: Search, none: FittedSet, few: Sequence[FittedSet], progress: Progress
) -> list[FittedSet]:
    """The best set of each size from 0 on, members exchanged: of `few`, or that of the size below
    with one more.
    """
    names = search.problem.parameters.names
    most = search.settings.most
    later = 2  # sizes beyond the best one that are looked at
    per_mode = 2 if search.target.weights.shape > 0 else 1
    data = per_mode * search.modes + search.point(none.x).other_data
    path = [none]
    # AICc needs more data than parameters
    for k in range(1, min(most, int(data) - 4) + 1):
        now = path[-1]
        tried = [c for c in few if c.members.size == k] or _with_more(search, now, 1)
        if k > 1:
            tried += _with_more(search, path[-2], 2)
        tried += _with_one_far(search, now, tried)
        if not tried:
            break
        path.append(_exchanged(search, min(tried, key=lambda c: rounded(c.value))))
        more = [c for c in few if k < c.members.size <= most]
        if k >= later and np.argmin(criteria(search, [*path, *more])) <= k - later:
            break  # more parameters do not pay
        progress(k / most, f"best {k}: {', '.join(names[i] for i in path[-1].members)}")
    return path


def _with_more(search: Search, now: FittedSet, count: int) -> list[FittedSet]:
    """Sets with one or two members more."""
    r = search.point(now.x)
    stay = now.members.tolist()
    free = search.free(stay)
    if free.size < count or not r.used.any():
        return []
    best = search.best if count == 1 else search.best_pairs
    options = best(Here.of(r, now.x), stay, free)[: search.settings.trials]
    return [search.fit(at, now.x) for _, at in options]


def _with_one_far(
    search: Search, now: FittedSet, tried: Sequence[FittedSet]
) -> list[FittedSet]:
    """Sets with one member more, from far off, where a mode has no partner yet.

    No slope sees such a mode. Where one of the sets tried leads to it, none is needed.
    """
    paired = search.point(now.x).used.sum()
    if search.target.rule != "gates" or paired == search.modes:
        return []
    if any(search.value(c.x).used.sum() > paired for c in tried):
        return []
    here = search.cost(now.x)
    options = search.far(now, search.free(now.members.tolist()))[
        : search.settings.trials
    ]
    return [search.fit(at, x) for value, at, x in options if value < here]


def _exchanged(search: Search, now: FittedSet) -> FittedSet:
    """Exchange one member at a time while J falls."""
    trials = search.settings.trials
    if now.members.size < 2:
        return now
    for _ in range(now.members.size):
        r = search.point(now.x)
        least = (1 - LEAST_GAIN) * now.value
        options: Ranked = []
        for out in now.members.tolist():
            stay = [m for m in now.members.tolist() if m != out]
            free = np.setdiff1d(search.free(stay), [out])
            options += search.best(Here.of(r, now.x, [out]), stay, free)[:trials]
        promising = ranked(o for o in options if o[0] < least)[:trials]
        tried = [search.fit(at, now.only(at)) for _, at in promising]
        better = min(tried, key=lambda c: rounded(c.value), default=now)
        if not better.value < least:
            return now
        now = better
    return now


def _with_collinear(search: Search, now: FittedSet) -> FittedSet:
    """With further members of the same clusters, as long as the criterion falls: exact data
    separate even these.
    """
    while 0 < now.members.size < search.settings.most:
        at = now.members.tolist()
        r = search.point(now.x)
        same = np.isin(search.groups[search.pool], search.groups[at])
        same &= ~np.isin(search.pool, at)
        same &= ~search.conflicts[np.ix_(search.pool, at)].any(axis=1)
        twins = search.pool[same]
        if not twins.size:
            return now
        options = search.best(Here.of(r, now.x), at, twins)[: search.settings.trials]
        least = now.value - search.settings.noise
        tried = [search.fit(more, now.x) for value, more in options if value < least]
        best = int(criteria(search, [now, *tried]).argmin())
        if best == 0:
            return now
        now = tried[best - 1]
    return now


def _pruned(search: Search, now: FittedSet) -> FittedSet:
    """Leave out members, the least first, without whom the criterion is no higher."""
    while now.members.size > 1:
        every = now.members.tolist()
        fewer = [
            search.fit([m for m in every if m != out], now.without([out]))
            for out in every
        ]
        value = criteria(search, [now, *fewer])
        best = int(np.argmin(value[1:]))
        if value[1 + best] > value[0]:
            return now
        now = fewer[best]
    return now


def criteria(search: Search, path: Sequence[FittedSet]) -> Float:
    """AICc of each set and the price of the search, to six decimals: rounding must not choose.

    The best of many sets fits the noise, too: 2 ln of the number of sets with as many factors and
    as many added masses. Chen and Chen (2008), eq. 2.2 with γ = 1.
    """
    every = price(search, [c.members for c in path]) + aicc(search, path)
    return np.round(every, 6)


def foreseen(
    search: Search, r: Residual, members: Sequence[int], value: float
) -> float:
    """The criterion of a set whose J is not computed but foreseen, all modes that are paired at a
    point counted.
    """
    n = search.target.weights.data * int(r.used.sum()) + r.other_data
    return float(price(search, [np.array(members)])[0]) + aicc_of(
        value, n, len(members)
    )


def price(search: Search, sets: Sequence[Int]) -> Float:
    """Of the search for each set."""
    masses = search.masses
    factors = np.setdiff1d(search.pool, masses)
    pool = np.unique(search.groups[factors]).size + search.settings.passed_over
    added = np.array([np.isin(s, masses).sum() for s in sets])
    sizes = np.array([s.size for s in sets])
    return 2 * (_log_sets(pool, sizes - added) + _log_sets(PLACES, added))


def _log_sets(pool: int, size: Int) -> Float:
    """ln of the number of sets of each size."""
    rest = gammaln(np.maximum(pool - size, 0) + 1)
    return gammaln(pool + 1) - gammaln(size + 1) - rest


def aicc(search: Search, path: Sequence[FittedSet]) -> Float:
    """AICc of each set, all over the test modes that at least one of them pairs."""
    return comparable_criteria(
        search.target,
        [search.value(c.x) for c in path],
        [c.x[c.members] for c in path],
        [search.prior[c.members] for c in path],
    )


def _best(search: Search, sets: Sequence[FittedSet]) -> FittedSet:
    """The set of the lowest criterion."""
    return sets[int(np.argmin(criteria(search, sets)))]


def _found(search: Search, c: FittedSet) -> Weights:
    """With the relative frequency and 1 − MAC that a set leaves, over the data that its parameters
    have left over.
    """
    r = search.point(c.x)
    slopes = r.slope[:, c.members] * search.prior[c.members]
    model = search.problem.configurations[0].model
    many = errors_of_shapes(search.target, model.modes(c.x))
    return left_over(search.assumed, r, slopes, search.target.weights.data, many)
