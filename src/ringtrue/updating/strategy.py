"""An updating from where the gates of the pairing lead to its end: pairs that are certain, then for
good, weighed anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, Self, runtime_checkable

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import rigid_below
from ringtrue.core.parameters import ParameterSet
from ringtrue.correlation.assignment import WORTH
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.problem import (
    MODE_STRIDE,
    Evaluated,
    Problem,
    doubting,
    squares,
    weighed,
)
from ringtrue.updating.regularisation import (
    DISCREPANCY,
    Rule,
    discrepancy_by_evidence,
    distance,
    left_at,
    regularised,
)
from ringtrue.updating.residuals.modal import NO_MODE, Quantity
from ringtrue.updating.solver import Method, Solution, solve


@dataclass(frozen=True, slots=True)
class Course:
    """How an updating goes about it.

    Attributes
    ----------
    method : Method
    iterations : int
        Limit of each part.
    prior : str
        Rule for the weight of the prior; "given": as it is.
    discrepancy : {"found", "assumed", "evidence"}
        Weights of the last part: with what the parts before have left, as they are, or those that
        make the data of each kind of residuals most likely.
    widths : tuple of float
        By how much of their frequency the peaks of FRFs are broadened, one part after the other,
        before they are compared as they are.
    """

    method: Method = field(default_factory=Method)
    iterations: int = 100
    prior: Rule | Literal["given"] = "given"
    discrepancy: Literal["found", "assumed", "evidence"] = "assumed"
    widths: tuple[float, ...] = (0.1, 0.03, 0.01)


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The end of an updating.

    Attributes
    ----------
    solution : Solution
        J at its end is by the weights that were given.
    problem : Problem
        With the pairs and the weights of the end.
    path : tuple of Evaluated
        Accepted points of all parts.
    """

    solution: Solution
    problem: Problem
    path: tuple[Evaluated, ...]


def settled(
    problem: Problem,
    course: Course | None = None,
    *,
    start: Float | None = None,
    progress: Progress = quiet,
) -> Settled:
    """Updated with no pair dearer than a lost mode, then with the pairs made there for good,
    weighed as asked for.
    """
    course = course or Course()

    def doubted(spread: float) -> Solution:
        return solve(
            doubting(problem, spread),
            course.method,
            start=start,
            iterations=course.iterations,
            progress=progress,
        )

    near = doubted(1.0)
    spread = 1.0
    # 2.0: deviation of the better half of the modes, in standard deviations, that these are not as
    # assumed
    if (left := _majority(problem, near.y)) > 2.0:
        wide = doubted(DISCREPANCY.loose)
        if _majority(problem, wide.y) < left:
            near = wide
            spread = DISCREPANCY.loose
    held = zip(problem.configurations, near.end.points, strict=True)
    every = (replace(c, target=c.target.settled(p.now, spread)) for c, p in held)
    firm = replace(problem, configurations=tuple(every))
    if course.discrepancy == "found":
        done, final = _sharpened(
            firm, near.y, lambda p, y: _solved(p, course, y, progress)
        )
    else:
        final = _likely(firm, near.end) if course.discrepancy == "evidence" else firm
        done = _solved(final, course, near.y, progress)
    if final is not firm:
        done = replace(
            done, history=(*done.history[:-1], firm.evaluate(done.y, done.end))
        )
    return Settled(done, final, (*near.history, *done.history[1:]))


def by_modes(problem: Problem) -> Problem:
    """The problem without what reads the model between its modes: FRFs and their zeros.

    A peak that is shifted by more than its width is compared with another one, or with none: these
    data have a minimum at each, and join once the modes are near.
    """
    parts = (
        replace(c, terms=tuple(t for t in c.terms if not t.whole))
        for c in problem.configurations
    )
    return replace(problem, configurations=tuple(parts))


def joined_by_all(
    problem: Problem,
    first: Settled,
    course: Course,
    progress: Progress = quiet,
) -> Settled:
    """From the end of an updating `by_modes` to that of the whole problem: with broad peaks first,
    which narrow in turns.

    Begun again from the best point of any part where that is below the end; the lower J is kept.
    """
    path = list(first.path)
    y = first.solution.y
    for width in course.widths:
        parts = (
            replace(c, terms=tuple(t.broadened(width) for t in c.terms))
            for c in doubting(problem).configurations
        )
        broad = replace(problem, configurations=tuple(parts))
        done = solve(
            broad,
            course.method,
            start=y,
            iterations=course.iterations,
            progress=progress,
        )
        path += done.history[1:]
        y = done.y
    seen = [problem.evaluate(at.y) for at in path]
    end = settled(problem, course, start=y, progress=progress)

    def cost(y: Float) -> float:
        return whole_cost(problem, problem.evaluate(y))

    best = min(seen, key=lambda at: whole_cost(problem, at))
    if whole_cost(problem, best) < cost(end.solution.y):
        again = settled(problem, course, start=best.y, progress=progress)
        end = min(end, again, key=lambda s: cost(s.solution.y))
    return replace(end, path=(*seen, *end.path[1:]))


def _majority(problem: Problem, y: Float) -> float:
    """What the better half of the frequencies deviate by at most, in units of what is assumed;
    infinite without a pair.

    Of n modes h = (n + q + 1)/2: q unknowns fit as many whatever the others do. Rousseeuw and Leroy
    (1987), sec. 3.4.
    """
    sizes = []
    for p in problem.evaluate(y).points:
        test, fe = p.pairs.T
        size = np.full(p.target.used.size, np.inf)
        error = np.abs(p.now.frequencies[fe] / p.target.frequencies[test] - 1)
        size[test] = error / np.hypot(p.target.weights.frequency, p.target.std[test])
        sizes.append(size[p.target.used])
    every = np.sort(np.concatenate(sizes))
    return float(every[min(every.size, (every.size + problem.size + 1) // 2) - 1])


def kept(problem: Problem) -> Float:
    """Deviations that the best model is expected to keep, of a frequency (relative) and of 1 − MAC,
    (2,).

    Of the first configuration; NaN where it does not compare them by such a deviation.
    """
    out = np.full(2, np.nan)
    for term in reversed(problem.configurations[0].terms):
        if np.isfinite(term.expected):
            out[0 if term.quantity is Quantity.FREQUENCY else 1] = term.expected
    return out


def lost(problem: Problem, at: Evaluated) -> Int:
    """How many used test modes of each configuration have no partner at a point."""
    both = zip(problem.configurations, at.points, strict=True)
    return np.array([int(c.target.used.sum()) - len(p.pairs) for c, p in both])


def displaced(problem: Problem, at: Evaluated) -> int:
    """How many of these have a shape that the model has, at the point or initially: other starts
    may pair them.

    A shape that no mode comes near, as of a local mode, is of something that the model does not
    have.
    """
    out = 0
    begin = problem.evaluate(np.zeros(problem.size))
    for c, *ends in zip(problem.configurations, begin.points, at.points, strict=True):
        alone = c.target.used.copy()
        alone[ends[1].pairs[:, 0]] = False
        near = [
            c.target.compared(p.now).merged[alone].max(axis=1, initial=0.0)
            for p in ends
        ]
        out += int((np.maximum(*near) > WORTH.hold * c.target.pairing.mac_gate).sum())
    return out


def whole_cost(problem: Problem, at: Evaluated) -> float:
    """J at an end, by the prior that was given, over all used test modes: none costs more than one
    without partner.

    That is `Target.doubt`.
    """
    cost = problem.loss.cost(squares(at.value, at.datum))
    mode = at.mode[np.unique(at.datum, return_index=True)[1]]
    modes, of = np.unique(mode, return_inverse=True)
    each = np.bincount(of, cost)
    doubt = np.array([c.target.doubt() for c in problem.configurations])
    most = np.where(modes == NO_MODE, np.inf, doubt[modes // MODE_STRIDE])
    data = float(np.minimum(each, most).sum())
    unpaired = float(doubt @ lost(problem, at))
    return data + at.lost + float(at.x @ problem.precision @ at.x) + unpaired


def _solved(
    problem: Problem, course: Course, start: Float, progress: Progress
) -> Solution:
    if course.prior != "given":
        return regularised(problem, course.prior, course.method, start=start).solution
    return solve(
        problem,
        course.method,
        start=start,
        iterations=course.iterations,
        progress=progress,
    )


def _sharpened(
    problem: Problem, y: Float, solved: Callable[[Problem, Float], Solution]
) -> tuple[Solution, Problem]:
    """Updated with the discrepancy that is left over, until that stands."""
    w = left_at(problem, y)
    for _ in range(DISCREPANCY.turns):
        now = weighed(problem, w)
        done = solved(now, y)
        y = done.y
        left = left_at(problem, y)
        if distance(w, left) < DISCREPANCY.settled:
            break
        w = left
    return done, now


def _likely(problem: Problem, at: Evaluated) -> Problem:
    """The problem with the errors of each kind of residuals that make the data most likely."""
    by = np.ones(sum(len(c.terms) for c in problem.configurations))
    # a kind may have no row: all its modes are lost
    by[np.unique(at.kind)] = discrepancy_by_evidence(at, problem)
    factor = iter(by.tolist())
    parts = [
        replace(c, terms=tuple(t.widened(next(factor)) for t in c.terms))
        for c in problem.configurations
    ]
    return replace(problem, configurations=tuple(parts))


@runtime_checkable
class Enriched(Protocol):
    """An `ObservedModel` on a basis to which the full model's modes can be added."""

    @property
    def parameters(self) -> ParameterSet: ...
    def linearise(self, x: Float) -> Linearisation: ...
    def modes(self, x: Float) -> Linearisation: ...
    def enrich(
        self, x: Float, *, sensitivities: bool = False
    ) -> tuple[Self, Linearisation]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """A solution and its proof.

    Attributes
    ----------
    solution : Solution
        On the enriched basis.
    problem : Problem
        That it solves, with the enriched model in its first configuration.
    error : float
        Largest relative frequency error of the basis, against a full solution at the last but one
        end.
    full_solutions : int
    """

    solution: Solution
    problem: Problem
    error: float
    full_solutions: int


# change of J over 1 + J by a full solution up to which the basis is good
SAME_OBJECTIVE = 0.01
FULL_SOLUTIONS = 4  # compare `error` with the tolerance for a run that used them up


def solve_verified(
    problem: Problem,
    *,
    solved: Callable[[Problem, Float | None], tuple[Solution, Problem]] | None = None,
    start: Float | None = None,
    tolerance: float = 1e-4,
    progress: Progress = quiet,
) -> Verified:
    """Solve on the basis; at each end solve the full model and add its modes, until the two agree.

    The static sensitivities at the ends are added, too: they cost one block of solves, no
    eigensolution.

    Parameters
    ----------
    problem : Problem
        One configuration with a `ReducedModel`, or another that can be enriched.
    solved : callable (problem, start) -> (solution, the problem that it solves), optional
        In place of `solve`.
    start : (q,) float64, optional
    tolerance : float
        Largest relative frequency error that is accepted, up to the highest frequency that is
        compared. The objective must not be moved by a full solution, either: it sees shapes of
        modes with small motions at the channels.

    Raises
    ------
    InputError
        If the model is not a reduced one or there are several.
    """
    only = problem.configurations[0]
    model = only.model
    if len(problem.configurations) != 1 or not isinstance(model, Enriched):
        raise InputError(
            "a verified updating needs one configuration and a ReducedModel"
        )
    solved = solved or (lambda p, y: (solve(p, start=y), p))
    done, end = solved(problem, start)
    error = np.inf
    moved = np.inf
    count = 0
    while (error > tolerance or moved > SAME_OBJECTIVE) and count < FULL_SOLUTIONS:
        at = problem.positions(only)
        better, truth = model.enrich(done.x[at], sensitivities=True)
        top = max(
            [1.05 * only.target.frequencies.max(), *(t.highest for t in only.terms)]
        )
        seen = np.flatnonzero(truth.frequencies <= top)
        error = _off(model.modes(done.x[at]).frequencies[seen], truth.frequencies[seen])
        model = better
        count = count + 1
        before = whole_cost(problem, problem.evaluate(done.y))
        problem = replace(problem, configurations=(replace(only, model=model),))
        now = whole_cost(problem, problem.evaluate(done.y))
        moved = abs(now - before) / (1.0 + before)
        done, end = solved(problem, done.y)
        progress(
            count / FULL_SOLUTIONS,
            f"full solution {count}: frequencies of the basis off by {error:.1e}",
        )
    return Verified(done, end, error, count)


def _off(basis: Float, truth: Float) -> float:
    """Largest relative error of frequencies; where the structure is free to move they are rounding,
    and no error.
    """
    change = basis * np.abs(basis) - truth * np.abs(truth)
    size = np.maximum(truth, max(rigid_below(truth), 1e-300))
    return float((np.abs(change) / (2 * size**2)).max(initial=0.0))
