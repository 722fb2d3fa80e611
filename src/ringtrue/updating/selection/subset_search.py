"""The search for a subset of candidates: points and fits that are computed once, and what a
candidate more promises.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import gammaln

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.errors import InputError, NumericalError
from ringtrue.updating.gauss_newton import (
    Residual,
    comparable_criteria,
    joint_residual,
    objective,
    residual,
)
from ringtrue.updating.gauss_newton import aicc as criterion
from ringtrue.updating.identifiability import clusters
from ringtrue.updating.problem import Problem, doubting, weighed
from ringtrue.updating.regularisation import distance, left_over
from ringtrue.updating.selection.candidates import PLACES
from ringtrue.updating.selection.selection_rules import (
    GAIN,
    NOISE,
    TURNS,
    Candidates,
    Choice,
    falling,
    predicted,
    short_solve,
    short_update,
)
from ringtrue.updating.target import Target, Weights
from ringtrue.updating.uncertainty import errors_of_shapes

SENSITIVE = (
    0.05  # least effect of one prior standard deviation, in standard deviations of the residual
)
POOL = 12  # candidates for an addition or exchange whose bounded prediction is computed
DIGITS = 6  # of J by which sets are compared
STEPS = (-3.0, -1.5, 1.5, 3.0)  # prior standard deviations: how far a candidate is moved by itself
TRIALS = 2  # promising sets that are fitted in one round
AT_ONCE = 20  # Gauss-Newton steps with all candidates free
TWICE = 2  # searches with the discrepancy that was found
NEAR = 0.4  # change of the logarithm of the discrepancy that asks for another search
PRICE = 1.0  # γ: 0 follows the noise, 1 finds little that is small
LATER = 2  # sizes beyond the best one that are looked at
DECIMALS = 6  # of the criterion: rounding does not choose between equal sets


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The candidates, what they aim at, and which of them may enter.

    With a `problem` over the same candidates all of its tests and data are aimed at; `target` is
    its first. So many as were `passed_over` were compared with the same test before, and are paid
    for. The weights were `assumed` before any were found.
    """

    model: Candidates
    target: Target
    pool: Int
    groups: Int
    apart: Bool
    size: Float
    low: Float
    high: Float
    prior: Float
    alike: float
    problem: Problem | None = None
    passed_over: int = 0
    assumed: Weights = field(default_factory=Weights)
    lumps: frozenset[int] = frozenset()  # positions of those that are masses which the deck lacks
    seen: dict[bytes, Residual] = field(default_factory=dict)
    done: dict[tuple[tuple[int, ...], bytes, int], Choice] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Candidates,
        target: Target,
        alike: float,
        apart: Bool | None,
        problem: Problem | None = None,
        passed_over: int = 0,
        assumed: Weights | None = None,
        barred: Sequence[int] = (),
        led: Float | None = None,
    ) -> Search:
        """With clusters of candidates that are alike at the deck and, if given, where a search has
        `led`, x (p,).

        At one point two modes may be so close that every candidate turns them into each other, and
        all look alike.
        """
        p = model.parameters
        low, high = p.bounds()
        points = [np.zeros(len(p))] if led is None else [np.zeros(len(p)), led]
        each = [_residual(model, target, problem, x).slope * p.std() for x in points]
        size = np.linalg.norm(each[0], axis=0)
        groups = clusters(
            np.concatenate([g / np.maximum(np.linalg.norm(g, axis=0), 1e-300) for g in each]), alike
        )
        none = np.zeros((len(p), len(p)), dtype=np.bool_)
        return cls(
            model,
            target,
            np.setdiff1d(np.flatnonzero(size >= SENSITIVE), barred),
            groups,
            none if apart is None else apart,
            size,
            low,
            high,
            p.std(),
            alike,
            problem,
            passed_over,
            assumed or target.weights,
            frozenset(i for i, one in enumerate(p.parameters) if one.lump),
        )

    @property
    def modes(self) -> int:
        """Number of used modes of all tests."""
        aims = (
            [self.target]
            if self.problem is None
            else [c.target for c in self.problem.configurations]
        )
        return sum(int(t.used.sum()) for t in aims)

    @property
    def data(self) -> float:
        """Number of data: a frequency and a shape, where it counts, each used mode, and what else
        was measured.
        """
        return (2 if self.target.weights.shape > 0 else 1) * self.modes + self.point(
            np.zeros(self.prior.size)
        ).more

    def sharper(self, found: Weights, led: Float) -> Search:
        """The same with the discrepancy that was found, capped (`Target.doubting`): more can be
        told apart by it.

        `led` is where it was found, x (p,).
        """
        aim = replace(self.target, weights=found)
        more = None if self.problem is None else weighed(self.problem, found)
        at = Search.of(
            self.model, aim, self.alike, self.apart, more, self.passed_over, self.assumed, led=led
        )
        more = None if more is None else doubting(more)
        return replace(at, target=aim.doubting(), problem=more, pool=self.pool, seen={}, done={})

    def point(self, x: Float) -> Residual:
        """Residuals and sensitivities to all candidates at x, shapes in few rows (`_compact`),
        computed once.
        """
        key = x.tobytes()
        if key not in self.seen or not self.seen[key].slope.shape[1]:
            self.seen[key] = _compact(_residual(self.model, self.target, self.problem, x))
        return self.seen[key]

    def value(self, x: Float) -> Residual:
        """Residuals at x, computed once, with sensitivities only where these are known."""
        key = x.tobytes()
        if key not in self.seen and self.problem is None:
            self.seen[key] = _compact(residual(self.target, self.model.modes(x)))
        return self.seen[key] if key in self.seen else self.point(x)

    def fit(self, members: Sequence[int], x: Float, turns: int = TURNS) -> Choice:
        """A short updating from x, or from the nominal model where x cannot be solved; done
        once.
        """
        x = np.clip(x, self.low, self.high)
        key = (tuple(members), x.tobytes(), turns)
        if key not in self.done:
            try:
                self.done[key] = self._updated(members, x, turns)
            except NumericalError:
                self.done[key] = self._updated(members, np.zeros(x.size), turns)
        return self.done[key]

    def _updated(self, members: Sequence[int], x: Float, turns: int) -> Choice:
        if self.problem is not None:
            return short_solve(self.problem, members, x, turns)
        return short_update(self.model, self.target, members, x, turns)

    def cost(self, x: Float) -> float:
        """J at x, modes only; infinite where it cannot be solved."""
        try:
            if self.problem is not None:
                return self.problem.cost(x)
            return objective(self.target, residual(self.target, self.model.modes(x)), x, self.prior)
        except NumericalError:
            return np.inf

    def far(self, now: Choice, free: Int) -> list[tuple[float, list[int], Float]]:
        """Sets with one of `free` more, too far off for a linearisation: J, members and x (p,), the
        lowest first.
        """
        out = []
        for c, step in product(free.tolist(), STEPS):
            x = np.where(
                np.arange(now.x.size) == c, np.clip(step * self.prior, self.low, self.high), now.x
            )
            out.append((self.cost(x), [*now.members.tolist(), c], x))
        return sorted(out, key=lambda o: rounded(o[0]))

    def refitted(self, c: Choice) -> Choice:
        """A set of another search, updated in this one."""
        return self.fit(c.members.tolist(), c.x) if c.members.size else c

    def free(self, members: Sequence[int]) -> Int:
        """Candidates that may stand beside the members: of other clusters, and not kept apart from
        any.
        """
        at = np.array(members, dtype=np.int64)
        beside = ~np.isin(self.groups[self.pool], self.groups[at]) & ~self.apart[
            np.ix_(self.pool, at)
        ].any(axis=1)
        return self.pool[beside]

    def together(self, members: Sequence[int] = ()) -> list[int]:
        """As many candidates as may stand side by side, the members and those of the largest effect
        first.
        """
        out = list(members)
        while (free := self.free(out)).size:
            out.append(int(free[falling(self.size[free])[0]]))
        return sorted(out)

    def ahead(self, r: Residual, x: Float, at: Sequence[int], base: Float) -> float:
        """J at the bounded minimum over `at`, linearised at x; `base` is the residual at x with
        others put to 0.
        """
        i = list(at)
        g, w = r.slope[:, i], self.prior[i] ** -2
        load = base + g @ x[i]
        y = np.linalg.solve(g.T @ g + np.diag(w), g.T @ load)
        if (y >= self.low[i]).all() and (y <= self.high[i]).all():
            return float(np.sum((load - g @ y) ** 2) + w @ y**2)
        return predicted(g, base, x[i], w, self.low[i], self.high[i])

    def best(
        self, r: Residual, x: Float, stay: Sequence[int], free: Int, value: Float
    ) -> list[tuple[float, list[int]]]:
        """Sets `stay` + one of `free`, by predicted J; a cheap bound chooses the `POOL` that are
        looked at.
        """
        column, left = self._beside(r, x, stay, free, value)
        gain = (column.T @ left) ** 2 / (np.sum(column**2, axis=0) + 1)
        few = [[c] for c in free[falling(gain)[:POOL]].tolist()]
        return self._ahead(r, x, stay, few, value)

    def best_pairs(
        self, r: Residual, x: Float, stay: Sequence[int], free: Int, value: Float
    ) -> list[tuple[float, list[int]]]:
        """The same with two of `free`: of two errors that cancel neither pays alone."""
        column, left = self._beside(r, x, stay, free, value)
        b, t = column.T @ left, column.T @ column
        d = np.diag(t) + 1
        own, both = np.outer(b**2, d), np.outer(b, b) * t
        gain = np.triu((own + own.T - 2 * both) / (np.outer(d, d) - t**2), 1)
        gain[self.apart[np.ix_(free, free)] | (self.groups[free][:, None] == self.groups[free])] = (
            0.0
        )
        few = falling(gain.ravel())[:POOL]
        at = np.stack(np.unravel_index(few[gain.ravel()[few] > 0], gain.shape), axis=1)
        return self._ahead(r, x, stay, free[at].tolist(), value)

    def _ahead(
        self, r: Residual, x: Float, stay: Sequence[int], more: Sequence[list[int]], value: Float
    ) -> list[tuple[float, list[int]]]:
        return ranked((self.ahead(r, x, [*stay, *c], value), [*stay, *c]) for c in more)

    def _beside(
        self, r: Residual, x: Float, stay: Sequence[int], free: Int, value: Float
    ) -> tuple[Float, Float]:
        """Slopes (n, f) of `free`, in units of the prior, and the residual (n,), less what `stay`
        can take of them.
        """
        i = list(stay)
        g = r.slope * self.prior
        rest = value + r.slope[:, i] @ x[i]
        q = (
            np.linalg.qr(np.concatenate([g[:, i], np.eye(len(i))]))[0]
            if i
            else np.zeros((g.shape[0], 0))
        )
        pad = np.zeros((len(i), free.size))
        column = np.concatenate([g[:, free], pad]) if i else g[:, free]
        column = column - q @ (q.T @ column)
        left = np.concatenate([rest, np.zeros(len(i))])
        return column, left - q @ (q.T @ left)


def rounded(value: float) -> float:
    """A value to compare by: candidates that do the same differ in rounding, which must not choose
    between them.
    """
    return float(f"{value:.{DIGITS}g}")


def ranked(options: Iterable[tuple[float, list[int]]]) -> list[tuple[float, list[int]]]:
    """The lowest first; of those that are as low the first of the candidates."""
    return sorted(options, key=lambda o: (rounded(o[0]), o[1]))


def _residual(model: Candidates, target: Target, problem: Problem | None, x: Float) -> Residual:
    return residual(target, model.linearise(x)) if problem is None else joint_residual(problem, x)


def _compact(r: Residual) -> Residual:
    """The same squares and products of a residual, its shapes in as many rows as the candidates
    span, (p + 1,).

    A rotation of the rows, by QR, that leaves frequencies and other data as they are: hundreds of
    channels and modes are 10⁵ rows, and a search keeps hundreds of points.
    """
    kinds = r.kinds if r.kinds.size else (np.arange(r.value.size) >= r.used.sum()).astype(np.int64)
    of_shape = kinds == 1
    if of_shape.sum() <= r.slope.shape[1] + 1:
        return r
    both = np.column_stack([r.slope[of_shape], r.value[of_shape]])
    few = np.asarray(np.linalg.qr(both, mode="r"), dtype=np.float64)
    value = np.concatenate([r.value[~of_shape], few[:, -1]])
    slope = np.concatenate([r.slope[~of_shape], few[:, :-1]])
    return replace(
        r,
        value=value,
        slope=slope,
        kinds=np.append(kinds[~of_shape], np.ones(len(few), dtype=np.int64)),
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
