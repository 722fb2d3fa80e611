"""A problem with several tests, and with what was measured beside modes, in the form of one test's
residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.updating.alike import errors_of_shapes
from ringtrue.updating.choose import Choice
from ringtrue.updating.objective import Residual, Weights
from ringtrue.updating.residuals import (
    OF_FREQUENCY,
    CrossOrthogonality,
    Mac,
    Shapes,
    Term,
    Weighted,
)
from ringtrue.updating.several import APART, Evaluated, Problem, held_to
from ringtrue.updating.trust import solve
from ringtrue.updating.weights import left_over


def joint_residual(problem: Problem, x: Float) -> Residual:
    """All residuals at x (p,); test modes of configuration i are numbered from i times `APART`."""
    at = problem.evaluate(x)
    value, slope = problem.weighted(at)
    pairs, error, used = [], [], []
    for i, (c, p) in enumerate(zip(problem.configurations, at.points, strict=True)):
        test, fe = p.every.T
        pairs.append(np.stack([test + i * APART, fe], axis=1))
        error.append(p.now.frequencies[fe] / c.target.frequencies[test] - 1)
        used.append(c.target.used[test])
    kind, more = _kinds(problem, at)
    mac = np.concatenate([p.mac for p in at.points])
    return Residual(
        value,
        slope,
        np.concatenate(pairs),
        mac,
        np.concatenate(error),
        np.concatenate(used),
        kind[at.kind],
        more,
    )


def _kinds(
    problem: Problem, at: Evaluated
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], float]:
    """Of each term 0 for frequencies, 1 for shapes, 2 for the rest, and the number of data of the
    rest.
    """
    terms = [t for c in problem.configurations for t in c.terms]
    kind = np.array([_kind(t) for t in terms], dtype=np.int64)
    rows = np.bincount(at.kind, minlength=kind.size).tolist()
    return kind, float(
        sum(t.factor * n for t, n in zip(terms, rows, strict=True) if isinstance(t, Weighted))
    )


def _kind(term: Term) -> int:
    if isinstance(term, OF_FREQUENCY):
        return 0
    return 1 if isinstance(term, Shapes | Mac | CrossOrthogonality) else 2


def weighed(problem: Problem, found: Weights) -> Problem:
    """With discrepancies of frequencies and shapes as found."""
    every = (
        c.weighed(found.frequency, found.mac, found.independent) for c in problem.configurations
    )
    return replace(problem, configurations=tuple(every))


def left_at(problem: Problem, y: Float) -> Weights:
    """The weights with the discrepancies that an updating has left at y (q,); shapes as in the
    first configuration.
    """
    at, first = problem.evaluate(y), problem.configurations[0].target
    r, prior = joint_residual(problem, y), np.sqrt(np.diag(np.linalg.inv(problem.linked_precision)))
    many = errors_of_shapes(first, at.points[0].now)
    return left_over(first.weights, r, at.slope * prior, first.weights.data, many)


def doubting(problem: Problem) -> Problem:
    """The same with no pair that costs more than a lost mode."""
    every = (replace(c, target=c.target.doubting()) for c in problem.configurations)
    return replace(problem, configurations=tuple(every))


def short_solve(problem: Problem, members: Sequence[int], x: Float, turns: int) -> Choice:
    """A short updating of some parameters from x; the others go to 0."""
    names, at = problem.parameters.names, sorted(members)
    done = solve(held_to(problem, [names[i] for i in at]), start=x[at], iterations=turns)
    return Choice(np.array(list(members), dtype=np.int64), done.x, done.cost)
