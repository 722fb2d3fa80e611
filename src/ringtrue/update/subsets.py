"""Which subset of many candidates explains a test: elimination from all at once, growing sets, exchange.

1. Candidates to which the residuals are not sensitive are left out; one member stands for a cluster.
2. Sets of growing size: the best addition by the bounded minimum of the linearised J, confirmed by a short updating
   with new linearisations, or by J itself far from there; then exchange of members while J falls.
3. All candidates are updated at once, held back by their priors; then the least useful go, one by one.
4. What the best set leaves as residual replaces the assumed model discrepancy, and no pair costs more than a lost
   mode: a test mode that no candidate explains then pulls none. The sets of 2 and 3 compete, members exchanged again.
5. The size is that of the lowest AICc plus the price of the search. Members of the same cluster join, as long as that
   falls; those that it gives no support leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import gammaln

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.errors import InputError, NumericalError
from ringtrue.update.choose import GAIN, TURNS, Candidates, Choice, predicted, short_update
from ringtrue.update.identifiable import clusters
from ringtrue.update.joint import joint_residual, sharper, short_solve
from ringtrue.update.objective import Residual, Target, comparable_criteria, objective, residual
from ringtrue.update.several import Problem

TRIALS = 2  # promising sets that are fitted in one round
SENSITIVE = 0.05  # least effect of one prior standard deviation, in standard deviations of the residual
AT_ONCE = 20  # Gauss-Newton steps with all candidates free
POOL = 12  # candidates for an addition or exchange whose bounded prediction is computed
STEPS = (-3.0, -1.5, 1.5, 3.0)  # prior standard deviations: how far a candidate is moved by itself
TIGHT, LOOSE = 0.05, 3.0  # limits of the discrepancy found, in units of the assumed one
TWICE = 2  # searches with the discrepancy that was found
NEAR = 0.4  # change of the logarithm of the discrepancy that asks for another search
PRICE = 0.5  # γ: 0 follows the noise, 1 finds little that is small
LATER = 2  # sizes beyond the best one that are looked at


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The candidates, what they aim at, and which of them may enter.

    With a `problem` over the same candidates all of its tests and data are aimed at; `target` is its first. So many as
    were `passed_over` were compared with the same test before, and are paid for.
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
    problem: Problem | None = None
    passed_over: int = 0
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
    ) -> Search:
        p = model.parameters
        low, high = p.bounds()
        start = _residual(model, target, problem, np.zeros(len(p)))
        sensitive = start.slope * p.std()
        size = np.linalg.norm(sensitive, axis=0)
        groups = clusters(sensitive, alike)
        none = np.zeros((len(p), len(p)), dtype=np.bool_)
        return cls(
            model,
            target,
            np.flatnonzero(size >= SENSITIVE),
            groups,
            none if apart is None else apart,
            size,
            low,
            high,
            p.std(),
            problem,
            passed_over,
        )

    @property
    def modes(self) -> int:
        """Number of used modes of all tests."""
        aims = [self.target] if self.problem is None else [c.target for c in self.problem.configurations]
        return sum(int(t.used.sum()) for t in aims)

    @property
    def data(self) -> float:
        """Number of data: two a used mode, and what else was measured."""
        return 2 * self.modes + self.point(np.zeros(self.prior.size)).more

    def sharper(self, discrepancy: Float) -> Search:
        """The same with the discrepancy (relative frequency, 1 − MAC) that was found, capped: see `Target.doubting`."""
        w = replace(self.target.weights, frequency=float(discrepancy[0]), mac=float(discrepancy[1]))
        aim = replace(self.target, weights=w).doubting()
        more = None if self.problem is None else sharper(self.problem, w.frequency, w.mac)
        return replace(self, target=aim, problem=more, seen={}, done={})

    def point(self, x: Float) -> Residual:
        """Residuals and sensitivities to all candidates at x, computed once."""
        key = x.tobytes()
        if key not in self.seen:
            self.seen[key] = _residual(self.model, self.target, self.problem, x)
        return self.seen[key]

    def fit(self, members: Sequence[int], x: Float, turns: int = TURNS) -> Choice:
        """A short updating from x, or from the nominal model where x cannot be solved; done once."""
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
        """Sets with one of `free` more, too far off for a linearisation: J, members and x (p,), the lowest first."""
        out = []
        for c, step in product(free.tolist(), STEPS):
            x = np.where(np.arange(now.x.size) == c, np.clip(step * self.prior, self.low, self.high), now.x)
            out.append((self.cost(x), [*now.members.tolist(), c], x))
        return sorted(out, key=lambda o: o[0])

    def refitted(self, c: Choice) -> Choice:
        """A set of another search, updated in this one."""
        return self.fit(c.members.tolist(), c.x) if c.members.size else c

    def free(self, members: Sequence[int]) -> Int:
        """Candidates that may stand beside the members: of other clusters, and not kept apart from any."""
        at = np.array(members, dtype=np.int64)
        beside = ~np.isin(self.groups[self.pool], self.groups[at]) & ~self.apart[np.ix_(self.pool, at)].any(axis=1)
        return self.pool[beside]

    def together(self) -> list[int]:
        """As many candidates as may stand side by side, those of the largest effect first."""
        out: list[int] = []
        while (free := self.free(out)).size:
            out.append(int(free[np.argmax(self.size[free])]))
        return sorted(out)

    def ahead(self, r: Residual, x: Float, at: Sequence[int], base: Float) -> float:
        """J at the bounded minimum over `at`, linearised at x; `base` is the residual at x with others put to 0."""
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
        """Sets `stay` + one of `free`, by predicted J; a cheap bound chooses the `POOL` that are looked at."""
        i = list(stay)
        g = r.slope * self.prior
        rest = value + r.slope[:, i] @ x[i]
        q = np.linalg.qr(np.concatenate([g[:, i], np.eye(len(i))]))[0] if i else np.zeros((g.shape[0], 0))
        pad = np.zeros((len(i), free.size))
        column = np.concatenate([g[:, free], pad]) if i else g[:, free]
        column = column - q @ (q.T @ column)
        left = np.concatenate([rest, np.zeros(len(i))])
        left = left - q @ (q.T @ left)
        gain = (column.T @ left) ** 2 / (np.sum(column**2, axis=0) + 1)
        few = free[np.argsort(-gain, kind="stable")[:POOL]]
        return sorted((self.ahead(r, x, [*i, c], value), [*i, c]) for c in few.tolist())


@dataclass(frozen=True, slots=True, eq=False)
class Subsets:
    """The sets that were found.

    Attributes
    ----------
    search : Search
        With the discrepancy that was found.
    start : Residual
        At x = 0, with the weights and gates that were given.
    path : list of Choice
        The best set of each size from 0 on; the last is the one chosen.
    criteria : (k,) float64
        AICc and the price of the search.
    discrepancy : (2,) float64
        Relative frequency and 1 − MAC.
    """

    search: Search
    start: Residual
    path: list[Choice]
    criteria: Float
    discrepancy: Float


def _residual(model: Candidates, target: Target, problem: Problem | None, x: Float) -> Residual:
    return residual(target, model.linearise(x)) if problem is None else joint_residual(problem, x)


def subsets(
    model: Candidates,
    target: Target,
    most: int,
    alike: float,
    apart: Bool | None,
    told: Progress,
    problem: Problem | None = None,
    passed_over: int = 0,
) -> Subsets:
    """The best sets of up to `most` candidates, and the one that the criterion chooses.

    Parameters
    ----------
    apart : (p, p) bool, optional
        Candidates that must not be in one set.
    problem : Problem, optional
        All tests and data, the first of them `target`; over the same candidates.
    passed_over : int
        Candidates that were left out since they explain less of the same test.

    Raises
    ------
    InputError
        If no mode is paired at the start.
    """
    plain = Search.of(model, target, alike, apart, problem, passed_over)
    none = Choice(np.zeros(0, dtype=np.int64), np.zeros(len(model.parameters)), np.inf)
    start = plain.point(none.x)
    if not start.used.any():
        raise InputError("no mode of the model is paired with one of the test: nothing can be localised from them")
    if not plain.pool.size:
        return Subsets(plain, start, [none, none], _criteria(plain, [none, none]), _discrepancy(plain, none))
    path = _path(plain, most, none, [], part(told, 0.0, 0.4))
    sets, best = path[1:], _best(plain, path)
    told(0.4, "all candidates together")
    whole = plain.fit(plain.together(), none.x, AT_ONCE)
    search = plain.sharper(_discrepancy(plain, whole))
    whole = search.fit(search.together(), whole.x, AT_ONCE)
    few = [c for c in _eliminated(search, whole, most, part(told, 0.4, 0.6)) if c.members.size <= most]
    best = _best(plain, [best, plain.refitted(_best(search, few))])
    found = _discrepancy(plain, best)
    sets, count = [*sets, *few], plain.point(best.x).used.sum()
    for _ in range(TWICE):
        search = plain.sharper(found)
        path = _path(search, most, none, [search.refitted(c) for c in sets], part(told, 0.6, 1.0))
        best = _best(search, path)
        better = _discrepancy(search, best)
        if search.point(best.x).used.sum() < count or np.abs(np.log(better / found)).max() < NEAR:
            break
        found, sets = better, path[1:]
    path.append(_pruned(search, _parted(search, best, most)))
    return Subsets(search, start, path, _criteria(search, path), found)


def _eliminated(search: Search, now: Choice, most: int, told: Progress) -> list[Choice]:
    """The least useful members left out, one by one (several while there are many), the others updated again."""
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


def _path(search: Search, most: int, none: Choice, few: Sequence[Choice], told: Progress) -> list[Choice]:
    """The best set of each size from 0 on, members exchanged: of `few`, or that of the size below with one more."""
    names = search.model.parameters.names
    path = [none]
    for k in range(1, min(most, int(search.data) - 4) + 1):  # AICc needs more data than parameters
        now, r, stay = path[-1], search.point(path[-1].x), path[-1].members.tolist()
        tried = [c for c in few if c.members.size == k]
        free = search.free(stay)
        if not tried and free.size and r.used.any():
            tried += [search.fit(at, now.x) for _, at in search.best(r, now.x, stay, free, r.value)[:TRIALS]]
        if search.target.rule == "gates" and r.used.sum() < search.modes:  # no slope sees a mode without partner
            here = search.cost(now.x)
            tried += [search.fit(at, x) for value, at, x in search.far(now, free)[:TRIALS] if value < here]
        if not tried:
            break
        path.append(_exchanged(search, min(tried, key=lambda c: c.value)))
        more = [c for c in few if k < c.members.size <= most]
        if k >= LATER and np.argmin(_criteria(search, [*path, *more])) <= k - LATER:  # more parameters do not pay
            break
        told(k / most, f"{k} parameters: {', '.join(names[i] for i in path[-1].members.tolist())}")
    return path


def _exchanged(search: Search, now: Choice) -> Choice:
    """Exchange one member at a time while J falls."""
    for _ in range(now.members.size if now.members.size > 1 else 0):
        r = search.point(now.x)
        options: list[tuple[float, list[int]]] = []
        for out in now.members.tolist():
            stay = [m for m in now.members.tolist() if m != out]
            free = np.setdiff1d(search.free(stay), [out])
            options += search.best(r, now.x, stay, free, r.value + r.slope[:, out] * now.x[out])[:TRIALS]
        options = sorted(o for o in options if o[0] < (1 - GAIN) * now.value)[:TRIALS]
        tried = [search.fit(at, np.where(np.isin(np.arange(now.x.size), at), now.x, 0.0)) for _, at in options]
        better = min(tried, key=lambda c: c.value, default=now)
        if not better.value < (1 - GAIN) * now.value:
            return now
        now = better
    return now


def _parted(search: Search, now: Choice, most: int) -> Choice:
    """With members of the same clusters, as long as the criterion falls: exact data tell even these apart."""
    while 0 < now.members.size < most:
        at, r = now.members.tolist(), search.point(now.x)
        alike = np.isin(search.groups[search.pool], search.groups[at]) & ~np.isin(search.pool, at)
        twins = search.pool[alike & ~search.apart[np.ix_(search.pool, at)].any(axis=1)]
        options = search.best(r, now.x, at, twins, r.value)[:TRIALS] if twins.size else []
        tried = [search.fit(more, now.x) for value, more in options if value < (1 - GAIN) * now.value]
        rise = _criteria(search, [now, *tried])
        if rise.argmin() == 0:
            return now
        now = tried[int(rise.argmin()) - 1]
    return now


def _pruned(search: Search, now: Choice) -> Choice:
    """Leave out members, the least first, without whom the criterion is no higher."""
    while now.members.size > 1:
        all_ = now.members.tolist()
        fewer = [
            search.fit([m for m in all_ if m != out], np.where(np.arange(now.x.size) == out, 0.0, now.x))
            for out in all_
        ]
        value = _criteria(search, [now, *fewer])
        best = int(np.argmin(value[1:]))
        if value[1 + best] > value[0]:
            return now
        now = fewer[best]
    return now


def _criteria(search: Search, path: Sequence[Choice]) -> Float:
    """AICc of each set and the price of the search.

    The best of many sets fits the noise, too: 2 γ ln of the number of sets of that size. Chen and Chen (2008), eq. 2.2.
    """
    pool = np.unique(search.groups[search.pool]).size + search.passed_over
    size = np.array([c.members.size for c in path])
    sets = gammaln(pool + 1) - gammaln(size + 1) - gammaln(np.maximum(pool - size, 0) + 1)
    return np.asarray(2 * PRICE * sets + aicc(search, path))


def aicc(search: Search, path: Sequence[Choice]) -> Float:
    """AICc of each set, all over the test modes that at least one of them pairs."""
    return comparable_criteria(
        search.target,
        [search.point(c.x) for c in path],
        [c.x[c.members] for c in path],
        [search.prior[c.members] for c in path],
    )


def _best(search: Search, sets: Sequence[Choice]) -> Choice:
    """The set of the lowest criterion."""
    return sets[int(np.argmin(_criteria(search, sets)))]


def _discrepancy(search: Search, c: Choice) -> Float:
    """Relative frequency and 1 − MAC that a set leaves, (2,), over the data that its parameters have left over."""
    w, r = search.target.weights, search.point(c.x)
    n = int(r.used.sum())
    if not n:
        return LOOSE * np.array([w.frequency, w.mac])
    g = r.slope[:, c.members] * search.prior[c.members]
    normal = g.T @ g
    spent = float(np.trace(np.linalg.solve(normal + np.eye(len(normal)), normal)))
    swell = 2 * n / max(2 * n - spent, 1.0)
    f = float(np.sqrt(np.mean(r.frequency_error[r.used] ** 2) * swell))
    m = float(np.mean(1 - r.mac[r.used]) * swell)
    low, high = np.array([TIGHT * w.frequency, TIGHT**2 * w.mac]), LOOSE * np.array([w.frequency, w.mac])
    return np.clip([f, m], low, high)
