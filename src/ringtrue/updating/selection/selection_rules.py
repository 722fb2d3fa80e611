"""Which parameters to update: the best subset of a given size, and simpler rules to compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self, runtime_checkable

import numpy as np
from scipy.optimize import lsq_linear

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.identifiability import COLLINEARITY, cosines
from ringtrue.updating.problem import (
    Configuration,
    Problem,
    doubting,
    held_to,
    residual_at,
)
from ringtrue.updating.residuals.modal import Quantity
from ringtrue.updating.solver import Method, solve

LEAST_GAIN = 0.01  # relative fall of J that an exchange must promise and keep
SHORT = 6  # iterations of an updating after each change of the set
RULES = {
    "best subset": (
        "forward selection on J with re-linearisation after each choice, then, from it and from "
        "the two simpler sets, exchange of members while J falls; each trial is a bounded "
        "Gauss-Newton prediction, confirmed by a short updating"
    ),
    "orthogonal sensitivities": (
        "QR with column pivoting of the weighted sensitivities scaled by the prior: the "
        "parameters that span most, whatever the residual"
    ),
    "largest sensitivities": (
        "the largest weighted sensitivities scaled by the prior, overlap ignored"
    ),
}
SHORT_METHOD = Method("levenberg-marquardt")
TIE = 1e-9  # relative difference up to which two norms of sensitivities are equal


@runtime_checkable
class Candidates(Protocol):
    """An `ObservedModel` over all candidates that can be held to some of them."""

    @property
    def parameters(self) -> ParameterSet: ...
    def linearise(self, x: Float) -> Linearisation: ...
    def modes(self, x: Float) -> Linearisation: ...
    def with_parameters(
        self, active: Sequence[int], base: Float | None = None
    ) -> Self: ...


@dataclass(frozen=True, slots=True, eq=False)
class FittedSet:
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

    def without(self, members: Sequence[int]) -> Float:
        """x (p,) with some members at 0."""
        x = self.x.copy()
        x[list(members)] = 0.0
        return x

    def only(self, members: Sequence[int]) -> Float:
        """x (p,) with all but some members at 0."""
        at = list(members)
        x = np.zeros(self.x.size)
        x[at] = self.x[at]
        return x


def rounded(value: float) -> float:
    """A value of J to six digits: candidates of equal effect differ in rounding, which must not
    choose between them.
    """
    return float(f"{value:.6g}")


def predicted(g: Float, r: Float, x: Float, w: Float, low: Float, high: Float) -> float:
    """J at the bounded minimum of its linearisation in the columns given."""
    a = np.concatenate([g, np.diag(np.sqrt(w))])
    b = np.concatenate([r + g @ x, np.zeros(x.size)])
    return float(2 * lsq_linear(a, b, (low, high), method="bvls").cost)


def short_update(
    problem: Problem, members: Sequence[int], x: Float, limit: int = SHORT
) -> FittedSet:
    """An updating of some parameters from x, in a few iterations; the others go to 0."""
    at = sorted(members)
    done = solve(_restricted(problem, at), SHORT_METHOD, start=x[at], iterations=limit)
    out = np.zeros(x.size)
    out[at] = done.y
    return FittedSet(np.array(members, dtype=np.int64), out, done.cost)


def _restricted(problem: Problem, at: list[int]) -> Problem:
    """The problem over some parameters, ascending positions, the others at 0.

    Where all kinds of residuals read modes alone, the models are held to these parameters, which
    saves the derivatives to the others.
    """
    names = [problem.parameters.names[i] for i in at]
    part = held_to(problem, names)
    terms = [t for c in problem.configurations for t in c.terms]
    if any(t.quantity is Quantity.OTHER for t in terms):
        return part
    return replace(
        part,
        configurations=tuple(_held(c, names) for c in problem.configurations),
        parameters=problem.parameters.take(at),
        precision=problem.precision[np.ix_(at, at)],
        link=np.eye(len(at)),
        rows=part.rows[:, at],
    )


def _held(configuration: Configuration, names: Sequence[str]) -> Configuration:
    model = configuration.model
    assert isinstance(model, Candidates)
    own = model.parameters.names
    active = [own.index(n) for n in names if n in own]
    return replace(
        configuration, model=model.with_parameters(active, np.zeros(len(own)))
    )


def best_subset(problem: Problem, count: int, progress: Progress = quiet) -> FittedSet:
    """Forward selection and exchange of `count` parameters on J.

    Parameters
    ----------
    problem : Problem
        Over all candidates, none of them linked.

    Raises
    ------
    InputError
        If there are fewer candidates.
    """
    grown = _grown(problem, count, progress)
    sensitivities = weighted_sensitivities(problem)
    starts = [
        grown.members,
        orthogonal(sensitivities, count),
        largest(sensitivities, count),
    ]
    near = doubting(problem)
    found = []
    for members in {tuple(sorted(s.tolist())): s.tolist() for s in starts}.values():
        rough = short_update(problem, members, np.zeros(grown.x.size))
        found.append(_exchanged(near, short_update(near, members, rough.x)))
    return min(found, key=lambda c: (rounded(c.value), sorted(c.members.tolist())))


def _promising(
    problem: Problem, now: FittedSet, options: Sequence[list[int]]
) -> list[list[int]]:
    """The sets by J at the bounded minimum of its linearisation at a point, the lowest first."""
    low, high = problem.parameters.bounds()
    w = 1 / problem.parameters.std() ** 2
    r = residual_at(problem, now.x)
    values = []
    for at in options:
        gone = np.setdiff1d(np.flatnonzero(now.x), at)
        # what is not a member goes back to 0
        value = r.value + r.slope[:, gone] @ now.x[gone]
        j = predicted(
            r.slope[:, at],
            value,
            x=now.x[at],
            w=w[at],
            low=low[at],
            high=high[at],
        )
        values.append(rounded(j))
    return [options[i] for i in np.argsort(values, kind="stable")]


def _grown(problem: Problem, count: int, progress: Progress) -> FittedSet:
    """Forward selection."""
    p = len(problem.parameters)
    if not 0 < count <= p:
        raise InputError(f"choose {count} of {p} candidates: allowed are 1 to {p}")
    now = FittedSet(np.zeros(0, dtype=np.int64), np.zeros(p), np.inf)
    for k in range(count):
        members = now.members.tolist()
        rest = np.setdiff1d(np.arange(p), members).tolist()
        at = _promising(problem, now, [[*members, c] for c in rest])[0]
        now = short_update(problem, at, now.x)
        progress(
            (k + 1) / (count + 2),
            f"parameter {k + 1}: {problem.parameters.names[at[-1]]}",
        )
    return now


def _exchanged(problem: Problem, now: FittedSet) -> FittedSet:
    """With one member at a time exchanged while J falls."""
    for _ in range(2 * now.members.size):
        members = now.members.tolist()
        rest = np.setdiff1d(np.arange(now.x.size), members).tolist()
        options = [
            [*(m for m in members if m != out), c] for out in members for c in rest
        ]
        best = _promising(problem, now, options)[:3]
        trials = [short_update(problem, at, now.x) for at in best]
        better = min(trials, key=lambda c: rounded(c.value), default=now)
        if better.value >= (1 - LEAST_GAIN) * now.value:
            return now
        now = better
    return now


def weighted_sensitivities(problem: Problem) -> Float:
    """√W ∂z/∂x scaled by the prior standard deviation of x, at x = 0, (r, p)."""
    return problem.evaluate(np.zeros(problem.size)).slope * problem.parameters.std()


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


def collinear_pairs(sensitivities: Float, names: Sequence[str]) -> tuple[str, ...]:
    """Pairs of candidates whose effects the data cannot separate, a line each."""
    cosine = cosines(sensitivities)
    a, b = np.nonzero(np.triu(cosine, 1) > COLLINEARITY.cosine)
    return tuple(
        f"{names[i]} and {names[j]} have the same effect on the measured modes "
        f"(cosine {cosine[i, j]:.3f})"
        for i, j in zip(a.tolist(), b.tolist(), strict=True)
    )


def falling(value: Float) -> Int:
    """Positions of values (n,) >= 0, the largest first; of equal ones the first.

    Values are equal to nine digits of the largest: rounding must not choose between candidates.
    """
    largest_value = max(value.max(initial=0.0), 1e-300)
    return np.argsort(-np.round(value / largest_value, 9), kind="stable")
