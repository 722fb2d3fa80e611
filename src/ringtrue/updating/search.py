"""The search for a subset of candidates: points and fits that are computed once, and what a
candidate more promises.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import NumericalError
from ringtrue.updating.choose import TURNS, Candidates, Choice, predicted, short_update
from ringtrue.updating.identifiable import clusters
from ringtrue.updating.joint import doubting, joint_residual, short_solve, weighed
from ringtrue.updating.objective import Residual, Target, Weights, objective, residual
from ringtrue.updating.pool import falling
from ringtrue.updating.several import Problem

SENSITIVE = (
    0.05  # least effect of one prior standard deviation, in standard deviations of the residual
)
POOL = 12  # candidates for an addition or exchange whose bounded prediction is computed
DIGITS = 6  # of J by which sets are compared
STEPS = (-3.0, -1.5, 1.5, 3.0)  # prior standard deviations: how far a candidate is moved by itself


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
