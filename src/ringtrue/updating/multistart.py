"""Many starts, and a global search: for models that are cheap at each point (reduced or small)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.errors import ConfigError, NumericalError, RingtrueError, SolverError
from ringtrue.updating.problem import Problem
from ringtrue.updating.solver import Method, Solution, solve

# largest distance in x, relative to the range of the bounds, of two ends that are one minimum
SAME = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class MultiStart:
    """Where many starts have ended.

    Attributes
    ----------
    starts, ends : (n, q) float64
        NaN for a start that could not be solved.
    costs : (n,) float64
        J, infinite for a start that could not be solved.
    outcomes : tuple of str
        Of each start; the error where there was one.
    minimum : (n,) int64
        Number of the minimum that a start ended in, in order of J; −1 for none.
    best : Solution
    """

    starts: Float
    ends: Float
    costs: Float
    outcomes: tuple[str, ...]
    minimum: Int
    best: Solution

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, starts=f, ends=f, costs=f, minimum=np.int64)

    @property
    def share(self) -> float:
        """Share of the starts that ended in the lowest minimum."""
        return float(np.mean(self.minimum == 0))


def latin_hypercube(
    parameters: ParameterSet, count: int, rng: np.random.Generator, inside: float = 1.0
) -> Float:
    """Starts x (count, p), spread over the bounds drawn in towards 0 by the factor `inside`."""
    if count < 1 or not 0 < inside <= 1:
        raise ConfigError(f"{count} starts (>= 1) inside {inside} (0..1) of the bounds")
    from scipy.stats import qmc  # slow to import, and few need it

    low, high = parameters.bounds()
    unit = qmc.LatinHypercube(len(parameters), rng=rng).random(count)
    return np.asarray(inside * (low + unit * (high - low)))


def multi_start(
    problem: Problem,
    starts: Float,
    method: Method | None = None,
    *,
    iterations: int = 60,
    finish: int | None = None,
    progress: Progress | None = None,
) -> MultiStart:
    """Solve from each of the starts (n, q); a start that cannot be solved is told, not raised.

    Parameters
    ----------
    problem : Problem
    starts : (n, q) float64
    method : Method, optional
    iterations : int
        Limit for each start.
    finish : int, optional
        How many of the best that have not converged by then go on for ten times as long; none if
        not given.

    Raises
    ------
    NumericalError
        If none can be solved.
    """
    method = method or Method()
    found: list[Solution | str] = []
    for i, y in enumerate(starts):  # over starts
        found.append(_one(problem, method, y, iterations))
        if progress is not None:
            progress((i + 1) / len(starts), f"start {i + 1} of {len(starts)}")
    order = sorted(
        (i for i, s in enumerate(found) if isinstance(s, Solution)), key=lambda i: _cost(found[i])
    )
    if not order:
        raise NumericalError(
            f"none of {len(starts)} starts could be solved; {found[-1] if found else 'none given'}"
        )
    for i in order[: finish or 0]:
        s = found[i]
        if isinstance(s, Solution) and not s.outcome.ok:
            found[i] = _one(problem, method, s.y, 10 * iterations)
    costs = np.array([_cost(s) for s in found])
    nothing = np.full(problem.size, np.nan)
    ends = np.array([s.y if isinstance(s, Solution) else nothing for s in found])
    told = tuple(s.outcome.value if isinstance(s, Solution) else s for s in found)
    best = min((s for s in found if isinstance(s, Solution)), key=lambda s: s.cost)
    return MultiStart(np.array(starts), ends, costs, told, _minima(problem, ends, costs), best)


def _one(problem: Problem, method: Method, y: Float, iterations: int) -> Solution | str:
    """A solution, or why the start cannot be solved."""
    try:
        return solve(problem, method, start=y, iterations=iterations)
    except (NumericalError, SolverError) as e:
        return str(e)


def _cost(found: Solution | str) -> float:
    return found.cost if isinstance(found, Solution) else np.inf


def _minima(problem: Problem, ends: Float, costs: Float) -> Int:
    """Number of the minimum of each end, the lowest first."""
    low, high = problem.parameters.bounds()
    x = ends @ problem.link.T / (high - low)
    out, centres = np.full(costs.size, -1), np.empty((0, x.shape[1]))
    for i in np.argsort(costs, kind="stable").tolist():  # over starts: each may found a minimum
        if not np.isfinite(costs[i]):
            continue
        near = np.flatnonzero(np.abs(centres - x[i]).max(axis=1, initial=0.0) < SAME)
        out[i] = near[0] if near.size else len(centres)
        centres = centres if near.size else np.vstack([centres, x[i]])
    return out


def global_search(
    problem: Problem,
    rng: np.random.Generator,
    method: Method | None = None,
    *,
    generations: int = 60,
    population: int = 8,
    progress: Progress | None = None,
) -> Solution:
    """Differential evolution on J inside the bounds (Storn and Price 1997), finished by the method.

    J needs modes only; a point that breaks a constraint stands for the nearest that keeps all, one
    that cannot be solved is the worst there is.

    Parameters
    ----------
    problem : Problem
        Without links: the bounds are those of the unknowns.
    population : int
        Members for each unknown.

    Raises
    ------
    ConfigError
        If parameters are linked, or no point keeps all constraints.
    """
    if problem.link.shape[0] != problem.link.shape[1] or not np.array_equal(
        problem.link, np.eye(problem.size)
    ):
        raise ConfigError(
            "a global search needs bounds of the unknowns: leave the links out, or use multi_start"
        )
    low, high = problem.parameters.bounds()

    def cost(y: Float) -> float:
        inside = problem.nearest(y)
        try:
            return problem.cost(inside)
        except RingtrueError:
            return np.inf

    def tell(_: Float, convergence: Any) -> None:
        if progress is not None:
            progress(min(1.0, float(convergence)), "global search")

    found = differential_evolution(
        cost,
        Bounds(low, high),
        rng=rng,
        maxiter=generations,
        popsize=population,
        polish=False,
        callback=tell,
    )
    return solve(problem, method or Method(), start=np.asarray(found.x))
