"""Which parameters to update: subset selection on the objective itself, and simpler rules to
compare it with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from scipy.optimize import lsq_linear

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.gauss_newton import Residual, residual, update
from ringtrue.updating.identifiability import ALIKE
from ringtrue.updating.problem import Problem, held_to
from ringtrue.updating.solver import solve
from ringtrue.updating.target import Target

GAIN = 0.01  # relative gain in J that an exchange must promise and keep
TRIALS = 3  # promising exchanges tried in one round
TURNS = 6  # Gauss-Newton steps after each change of the set
RULES = {
    "best subset": "forward selection on J with re-linearisation after each choice, then, from "
    "it and from the two "
    "simpler sets, exchange of members while J falls; each trial is a bounded Gauss-Newton "
    "prediction, confirmed by a "
    "short updating",
    "orthogonal sensitivities": "QR with column pivoting of the weighted sensitivities scaled by "
    "the prior: the "
    "parameters that span most, whatever the residual",
    "largest sensitivities": "the largest weighted sensitivities scaled by the prior, overlap "
    "ignored",
}
SWEEPS = 2000  # of the members between two checks of all columns
EXACT = 1e-9  # change of a fit, relative to ‖r‖, that ends a descent
EQUAL = 9  # decimals, in units of the largest, to which what candidates explain is compared
TIE = 1e-9  # relative difference up to which two norms of sensitivities are equal
NOISE = 2.0  # fall of J that one parameter of no meaning is good for


class Candidates(Protocol):
    """An `ObservedModel` over all candidates that can be held to some of them."""

    @property
    def parameters(self) -> ParameterSet: ...
    def linearise(self, x: Float) -> Linearisation: ...
    def modes(self, x: Float) -> Linearisation: ...
    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> Self: ...


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """A subset, and where a short updating took it.

    Attributes
    ----------
    members : (k,) int64
        Positions among the candidates, in the order of choice.
    x : (p,) float64
        All candidates; zero for those not chosen.
    value : float
        J.
    """

    members: Int
    x: Float
    value: float


def predicted(g: Float, r: Float, x: Float, w: Float, low: Float, high: Float) -> float:
    """J at the bounded minimum of its linearisation in the columns given."""
    a = np.concatenate([g, np.diag(np.sqrt(w))])
    b = np.concatenate([r + g @ x, np.zeros(x.size)])
    return float(2 * lsq_linear(a, b, (low, high), method="bvls").cost)


def short_update(
    model: Candidates, target: Target, members: Sequence[int], x: Float, turns: int = TURNS
) -> Choice:
    """A short updating of some members from x."""
    at = list(members)
    result = update(
        model.with_parameters(at, np.zeros(x.size)), target, iterations=turns, start=x[at]
    )
    out = np.zeros(x.size)
    out[at] = result.x
    return Choice(np.array(at, dtype=np.int64), out, result.history[-1].value)


def _point(model: Candidates, target: Target, x: Float) -> Residual:
    return residual(target, model.linearise(x))


@dataclass(frozen=True, slots=True)
class _Search:
    """What sets are chosen by.

    Attributes
    ----------
    parameters : ParameterSet
        The candidates.
    linearised : callable
        Weighted residuals (r,) and their slopes (r, p) at x.
    updated : callable
        A short updating of some members from x; the others go to 0.
    """

    parameters: ParameterSet
    linearised: Callable[[Float], tuple[Float, Float]]
    updated: Callable[[Sequence[int], Float], Choice]

    @classmethod
    def of_model(cls, model: Candidates, target: Target) -> _Search:
        """One deck and its test, by Gauss-Newton."""

        def linearised(x: Float) -> tuple[Float, Float]:
            r = _point(model, target, x)
            return r.value, r.slope

        return cls(model.parameters, linearised, lambda at, x: short_update(model, target, at, x))

    @classmethod
    def of_problem(cls, problem: Problem) -> _Search:
        """Several configurations, none of their parameters linked."""

        def updated(members: Sequence[int], x: Float) -> Choice:
            names, at = problem.parameters.names, sorted(members)
            done = solve(held_to(problem, [names[i] for i in at]), start=x[at], iterations=TURNS)
            return Choice(np.array(members, dtype=np.int64), done.x, done.cost)

        return cls(problem.parameters, lambda x: problem.weighted(problem.evaluate(x)), updated)

    def promising(self, now: Choice, options: Sequence[list[int]]) -> list[list[int]]:
        """The sets by J at the bounded minimum of its linearisation at a point, the lowest
        first.
        """
        low, high = self.parameters.bounds()
        w = 1 / self.parameters.std() ** 2
        r, g = self.linearised(now.x)
        values = []
        for at in options:
            gone = np.setdiff1d(np.flatnonzero(now.x), at)
            value = r + g[:, gone] @ now.x[gone]  # what is not a member goes back to x = 0
            values.append(predicted(g[:, at], value, now.x[at], w[at], low[at], high[at]))
        return [options[i] for i in np.argsort(values, kind="stable").tolist()]

    def grown(self, count: int, progress: Progress | None) -> Choice:
        """Forward selection.

        Raises
        ------
        InputError
            If there are fewer candidates.
        """
        p = len(self.parameters)
        if not 0 < count <= p:
            raise InputError(f"choose {count} of {p} candidates: allowed are 1 to {p}")
        now = Choice(np.zeros(0, dtype=np.int64), np.zeros(p), np.inf)
        for k in range(count):
            rest = np.setdiff1d(np.arange(p), now.members).tolist()
            at = self.promising(now, [[*now.members.tolist(), c] for c in rest])[0]
            now = self.updated(at, now.x)
            if progress is not None:
                progress(
                    (k + 1) / (count + 2), f"parameter {k + 1}: {self.parameters.names[at[-1]]}"
                )
        return now

    def exchanged(self, now: Choice) -> Choice:
        """With one member at a time exchanged while J falls."""
        for _ in range(2 * now.members.size):
            members = now.members.tolist()
            rest = np.setdiff1d(np.arange(len(self.parameters)), members).tolist()
            options = [[*(m for m in members if m != out), c] for out in members for c in rest]
            trials = [self.updated(at, now.x) for at in self.promising(now, options)[:TRIALS]]
            better = min(trials, key=lambda c: c.value, default=now)
            if better.value >= (1 - GAIN) * now.value:
                return now
            now = better
        return now


def _different(sets: Sequence[Int]) -> list[list[int]]:
    return [s.tolist() for s in {tuple(sorted(s.tolist())): s for s in sets}.values()]


def best_subset(
    model: Candidates, target: Target, count: int, progress: Progress | None = None
) -> Choice:
    """Forward selection and exchange of `count` candidates on J.

    Raises
    ------
    InputError
        If there are fewer candidates.
    """
    first, near = _Search.of_model(model, target), _Search.of_model(model, target.doubting())
    now = first.grown(count, progress)
    sensitive = weighted_sensitivities(model, target)
    starts = _different([now.members, orthogonal(sensitive, count), largest(sensitive, count)])
    rough = [(s, first.updated(s, np.zeros(now.x.size)).x) for s in starts]
    return min((near.exchanged(near.updated(s, x)) for s, x in rough), key=lambda c: c.value)


def joint_subset(
    problem: Problem, count: int, starts: Sequence[Int] = (), progress: Progress | None = None
) -> Choice:
    """Forward selection and exchange of `count` parameters of a problem with several
    configurations, on its J.

    Parameters
    ----------
    problem : Problem
        Over all candidates, none of them linked.
    count : int
    starts : sequence of (count,) int64
        Sets by simpler rules, from which members are exchanged, too.

    Raises
    ------
    InputError
        If there are fewer candidates.
    """
    search = _Search.of_problem(problem)
    now = search.grown(count, progress)
    found = [
        search.exchanged(search.updated(s, np.zeros(now.x.size)))
        for s in _different([now.members, *starts])
    ]
    return min(found, key=lambda c: c.value)


def weighted_sensitivities(model: Candidates, target: Target) -> Float:
    """√W ∂z/∂x scaled by the prior standard deviation of x, at x = 0, (r, p)."""
    return np.asarray(
        _point(model, target, np.zeros(len(model.parameters))).slope * model.parameters.std(),
        dtype=np.float64,
    )


def orthogonal(sensitivities: Float, count: int) -> Int:
    """The first pivots of a QR with column pivoting, (count,); of equal columns the first.

    The sensitivities to a stiffness and to a mass are often equal but for their sign: which of the
    two is larger must not be a matter of rounding.
    """
    rest = np.array(sensitivities, dtype=np.float64)
    floor = TIE * np.linalg.norm(rest, axis=0).max(initial=0.0)
    pivots: list[int] = []
    for _ in range(count):
        norm = np.linalg.norm(rest, axis=0)
        norm[norm < floor] = 0.0
        norm[pivots] = -1.0
        pivot = int(np.argmax(norm >= (1 - TIE) * norm.max()))
        pivots.append(pivot)
        if norm[pivot] > 0:
            unit = rest[:, pivot] / norm[pivot]
            rest -= np.outer(unit, unit @ rest)
    return np.array(pivots, dtype=np.int64)


def largest(sensitivities: Float, count: int) -> Int:
    """The columns of largest norm, (count,); of equal columns the first."""
    norm = np.linalg.norm(sensitivities, axis=0)
    steps = np.round(norm / (TIE * max(norm.max(initial=0.0), 1e-300)))
    return np.argsort(-steps, kind="stable")[:count].astype(np.int64)


def alike(sensitivities: Float, names: Sequence[str]) -> tuple[str, ...]:
    """Pairs of candidates whose effects the data cannot tell apart, in words."""
    unit = sensitivities / np.maximum(np.linalg.norm(sensitivities, axis=0), 1e-300)
    cosine = np.abs(unit.T @ unit)
    a, b = np.nonzero(np.triu(cosine, 1) > ALIKE)
    return tuple(
        f"{names[i]} and {names[j]} act alike on the measured modes (cosine {cosine[i, j]:.3f})"
        for i, j in zip(a.tolist(), b.tolist(), strict=True)
    )


def short_solve(problem: Problem, members: Sequence[int], x: Float, turns: int) -> Choice:
    """A short updating of some parameters from x; the others go to 0."""
    names, at = problem.parameters.names, sorted(members)
    done = solve(held_to(problem, [names[i] for i in at]), start=x[at], iterations=turns)
    return Choice(np.array(list(members), dtype=np.int64), done.x, done.cost)


@dataclass(frozen=True, slots=True, eq=False)
class LassoPath:
    """Solutions along falling penalties.

    Attributes
    ----------
    penalties : (k,) float64
        κ, descending; at the first no candidate is in.
    x : (k, p) float64
    misfit : (k,) float64
        ‖r − G x‖²/‖r‖².
    slack : (k,) float64
        Largest violation of the optimality conditions, relative to the first penalty.
    """

    penalties: Float
    x: Float
    misfit: Float
    slack: Float

    def __post_init__(self) -> None:
        freeze_fields(self, penalties=np.float64, x=np.float64, misfit=np.float64, slack=np.float64)

    def order(self) -> Int:
        """Candidates in the order in which they enter; those that never do are left out."""
        inside = self.x != 0
        first = np.where(inside.any(axis=0), inside.argmax(axis=0), len(inside))
        size = np.abs(self.x).max(axis=0, initial=0.0)
        order = np.lexsort((-size, first))
        return order[first[order] < len(inside)].astype(np.int64)


def lasso_path(
    slope: Float, value: Float, low: Float, high: Float, *, count: int = 40, end: float = 1e-3
) -> LassoPath:
    """The path from the penalty that keeps every candidate out down to `end` of it.

    Parameters
    ----------
    slope : (r, p) float64
        Weighted sensitivities in units of the prior.
    value : (r,) float64
        Weighted residuals.
    low, high : (p,) float64
        Bounds of x, low <= 0 <= high; equal bounds hold a candidate out.
    count : int
        Penalties, spaced evenly in their logarithm.

    Raises
    ------
    InputError
        If the sizes differ or a box does not hold 0.
    """
    g, r = np.asarray(slope, dtype=np.float64), np.asarray(value, dtype=np.float64)
    if (
        g.ndim != 2
        or r.shape != g.shape[:1]
        or low.shape != g.shape[1:]
        or high.shape != g.shape[1:]
    ):
        raise InputError(
            f"slope {g.shape}, value {r.shape}, bounds {low.shape} and {high.shape} do not fit "
            "together"
        )
    if (low > 0).any() or (high < 0).any() or not 0 < end < 1 or count < 2:
        raise InputError(
            f"LASSO path: each box must hold 0, end {end} be in 0..1 and count {count} 2 or more"
        )
    gram, load = g.T @ g, g.T @ r
    top = float(_pull(load, low, high).max(initial=0.0))
    penalties = top * np.geomspace(1.0, end, count)
    x, found, slack = np.zeros(g.shape[1]), [], []
    for k in penalties.tolist():  # warm start from the penalty before
        x = _descend(gram, load, k, x, low, high)
        found.append(x.copy())
        slack.append(_slack(load - gram @ x, k, x, low, high) / (top or 1.0))
    path = np.array(found)
    rest = np.sum((r[:, None] - g @ path.T) ** 2, axis=0) / max(float(r @ r), 1e-300)
    return LassoPath(penalties, path, rest, np.array(slack))


def _pull(gradient: Float, low: Float, high: Float) -> Float:
    """How strongly the residual pulls a candidate at 0 to where its box lets it go, (p,)."""
    return np.maximum(np.where(high > 0, gradient, 0.0), np.where(low < 0, -gradient, 0.0))


def _slack(gradient: Float, penalty: float, x: Float, low: Float, high: Float) -> float:
    """Largest violation of the Karush-Kuhn-Tucker conditions."""
    at_zero = np.maximum(_pull(gradient, low, high) - penalty, 0.0)
    free = gradient - penalty * np.sign(x)
    inside = np.where(
        x >= high, np.maximum(-free, 0), np.where(x <= low, np.maximum(free, 0), np.abs(free))
    )
    return float(np.where(x == 0, at_zero, inside).max(initial=0.0))


def _descend(gram: Float, load: Float, penalty: float, x: Float, low: Float, high: Float) -> Float:
    """Coordinate descent on the members; others join where the conditions ask."""
    x = x.copy()
    size = np.diag(gram)
    scale = EXACT * float(np.abs(load).max(initial=0.0))
    for _ in range(x.size + 1):
        pull = _pull(load - gram @ x, low, high)
        members = np.flatnonzero((x != 0) | (pull > penalty + scale))
        members = members[size[members] > 0]
        _sweep(gram, load, penalty, x, low, high, members)
        if not (_pull(load - gram @ x, low, high)[x == 0] > penalty + scale).any():
            break
    return x


def _sweep(
    gram: Float, load: Float, penalty: float, x: Float, low: Float, high: Float, members: Int
) -> None:
    """Cycle over the members, in place, until none moves: each has a closed form, so the loop is
    over coordinates.
    """
    inner, rest = gram[np.ix_(members, members)], load[members]
    y, size = x[members].copy(), np.diag(inner)
    tiny = EXACT * float(np.abs(load).max(initial=0.0))
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(y.size):
            pull = float(rest[i] - inner[i] @ y + size[i] * y[i])
            new = np.sign(pull) * max(abs(pull) - penalty, 0.0) / size[i]
            new = min(max(new, low[members[i]]), high[members[i]])
            moved = max(moved, abs(new - y[i]) * size[i])
            y[i] = new
        if moved <= tiny:
            break
    x[members] = y


def falling(value: Float) -> Int:
    """Positions of values (n,) that are not negative, the largest first; of those that are as large
    the first.

    Candidates that do the same differ in rounding, which must not choose between them.
    """
    return np.argsort(
        -np.round(value / max(float(value.max(initial=0.0)), 1e-300), EQUAL), kind="stable"
    )
