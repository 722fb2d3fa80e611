"""Updating on a reduced basis that ends on full solutions: solve, compare with the full model,
enrich, repeat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self, runtime_checkable

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import rigid_below
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.several import Problem
from ringtrue.updating.trust import Method, Solution, solve

TINY = 1e-300


@runtime_checkable
class Enriched(Protocol):
    """An `ObservedModel` on a basis to which the full model's modes can be added."""

    @property
    def parameters(self) -> ParameterSet: ...
    def linearise(self, x: Float) -> Linearisation: ...
    def modes(self, x: Float) -> Linearisation: ...
    def enrich(self, x: Float, *, sensitivities: bool = False) -> tuple[Self, Linearisation]: ...


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


def solve_verified(
    problem: Problem,
    method: Method | None = None,
    *,
    solved: Callable[[Problem, Float | None], tuple[Solution, Problem]] | None = None,
    start: Float | None = None,
    tolerance: float = 1e-4,
    rounds: int = 4,
    progress: Progress | None = None,
) -> Verified:
    """Solve on the basis; at each end solve the full model and add its modes, until the two agree.

    The static sensitivities at the ends are added, too: they cost one block of solves, no
    eigensolution.

    Parameters
    ----------
    problem : Problem
        One configuration with a `ReducedModel`, or another that can be enriched.
    method : Method, optional
    solved : callable (problem, start) -> (solution, the problem that it solves), optional
        In place of the method.
    start : (q,) float64, optional
    tolerance : float
        Largest relative frequency error that is accepted, up to the highest test frequency.
    rounds : int
        Most full solutions; compare `error` with the tolerance for a run that used them up.

    Raises
    ------
    InputError
        If the model is not a reduced one or there are several.
    """
    only = problem.configurations[0]
    model = only.model
    if len(problem.configurations) != 1 or not isinstance(model, Enriched) or rounds < 1:
        raise InputError(
            "a verified updating needs one configuration, a ReducedModel, and one round or more"
        )
    solved = solved or (lambda p, y: (solve(p, method, start=y), p))
    (done, end), error, count = solved(problem, start), np.inf, 0
    while error > tolerance and count < rounds:
        at = [problem.parameters.names.index(n) for n in model.parameters.names]
        better, truth = model.enrich(done.x[at], sensitivities=True)
        seen = np.flatnonzero(truth.frequencies <= 1.05 * only.target.frequencies.max())
        error = _off(model.modes(done.x[at]).frequencies[seen], truth.frequencies[seen])
        model, count = better, count + 1
        problem = replace(problem, configurations=(replace(only, model=model),))
        done, end = solved(problem, done.y)
        if progress is not None:
            progress(
                count / rounds,
                f"full solution {count}: frequencies of the basis off by {error:.1e}",
            )
    return Verified(done, end, error, count)


def _off(basis: Float, truth: Float) -> float:
    """Largest relative error of frequencies; where the structure is free to move they are rounding,
    and no error.
    """
    change = basis * np.abs(basis) - truth * np.abs(truth)
    return float(
        (np.abs(change) / (2 * np.maximum(truth, max(rigid_below(truth), TINY)) ** 2)).max(
            initial=0.0
        )
    )
