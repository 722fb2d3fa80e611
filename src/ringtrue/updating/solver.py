"""The methods of updating under one driver: a trust region, or damped steps for short updatings;
bounds and constraints; many starts.

Each step minimises the same quadratic model ½dᵀHd + gᵀd, H = GᵀWG + W_p (+ S + μD), inside bounds,
linear constraints, move limits and the trust region, by one least-squares problem with inequalities
(Lawson and Hanson, 1974, ch. 23).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.iterate import Outcome, Progress, iterate, part, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.side_by_side import Workers, side_by_side
from ringtrue.errors import (
    ConfigError,
    DataError,
    NumericalError,
    SolverError,
    did_you_mean,
)
from ringtrue.io.files import atomic_write, keeps_up
from ringtrue.io.foreign.parsers import read_json
from ringtrue.updating.problem import Evaluated, Problem, held_to, least_distance

Kind = Literal["levenberg-marquardt", "trust-region"]
REJECTIONS = 12
# The rounding of eigensolutions may hide a fall of J of this part of J, and a change of each
# weighted residual of this size (which decides where the data fit exactly and J is near 0).
ROUNDING = 1e-7


@dataclass(frozen=True, slots=True)
class Method:
    """A method and its settings.

    Attributes
    ----------
    kind : {"trust-region", "levenberg-marquardt"}
        Steps inside a box that grows and shrinks with how well J was predicted; or steps damped by
        μ D, D the diagonal of the Hessian.
    move : float
        Largest change of any unknown in one step.
    radius : float
        Of the first trust region.
    damping : float
        First μ of Levenberg-Marquardt.
    secant : bool
        Estimate what Gauss-Newton leaves out of the Hessian (Dennis, Gay and Welsch 1981).
    step, gradient : float
        Convergence: change of an unknown; gradient relative to its size without cancellation.
    """

    kind: Kind = "trust-region"
    move: float = 0.7
    radius: float = 0.5
    damping: float = 1e-3
    secant: bool = True
    step: float = 1e-7
    gradient: float = 1e-8

    def __post_init__(self) -> None:
        if self.kind not in (known := get_args(Kind)):
            raise ConfigError(
                f"no method of updating {self.kind!r}{did_you_mean(self.kind, known)}"
            )
        if min(self.move, self.radius, self.damping) <= 0:
            raise ConfigError(
                f"move {self.move}, radius {self.radius}, damping {self.damping}: must be > 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class DescentState:
    """A point, and what the next step needs.

    Attributes
    ----------
    at : Evaluated
    radius, damping : float
    step : float
        Largest change of an unknown that led here.
    rejected : int
        Trials in a row that were rejected here.
    why : str
        The reason of the last rejection.
    secant : (q, q) float64
    """

    at: Evaluated
    radius: float
    damping: float
    step: float
    rejected: int
    why: str
    secant: Float


@dataclass(frozen=True, slots=True, eq=False)
class Solution(FrozenArrays):
    """Where the updating ended.

    Attributes
    ----------
    x, factors : (p,) float64
    y : (q,) float64
        The unknowns.
    covariance : (q, q) float64
        Of y: (GᵀWG/s² + W_p)⁻¹ with s² >= 1 the mean square of the residuals (Laplace).
    identifiability : (q,) float64
        Posterior over prior standard deviation of y.
    history : tuple of Evaluated
        Accepted points.
    outcome : Outcome
    why : str
        What met the tolerance, or why the last trials were rejected.
    evaluations : int
        Linearisations of all configurations.
    """

    x: Float
    factors: Float
    y: Float
    covariance: Float
    identifiability: Float
    history: tuple[Evaluated, ...]
    outcome: Outcome
    why: str
    evaluations: int

    @property
    def cost(self) -> float:
        """J at the end."""
        return self.history[-1].cost

    @property
    def end(self) -> Evaluated:
        """The last point."""
        return self.history[-1]

    @property
    def std(self) -> Float:
        """Standard deviation of y, (q,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """A method on a problem, run by `core.iterate`."""

    problem: Problem
    method: Method
    start: Float
    keep: Callable[[DescentState], None] | None = None
    radius: float = 0.0  # of an interrupted run
    damping: float = 0.0

    def init(self) -> DescentState:
        """The start."""
        at = self.problem.evaluate(self.start)
        flat = np.zeros((at.y.size, at.y.size))
        return DescentState(
            at=at,
            radius=self.radius or self.method.radius,
            damping=self.damping or self.method.damping,
            step=np.inf,
            rejected=0,
            why="",
            secant=flat,
        )

    def hessian(self, at: Evaluated, curvature: Float) -> Float:
        """GᵀWG + W_p + secant, (q, q)."""
        _, g = self.problem.weighted(at)
        h = g.T @ g + self.problem.linked_precision
        h[np.diag_indices_from(h)] += 1e-14 * max(np.diag(h).max(), 1e-300)
        return positive(h, curvature)

    def _inside(self, at: Evaluated, h: Float, g: Float, reach: float) -> Float:
        """The minimum of the quadratic model inside all limits and a box of half width `reach`."""
        q = at.y.size
        rows, limits = self.problem.inequalities()
        room = np.concatenate(
            [np.maximum(limits - rows @ at.y, 0.0), np.full(2 * q, reach)]
        )
        return least_distance(h, g, np.concatenate([rows, np.eye(q), -np.eye(q)]), room)

    def propose(self, state: DescentState) -> tuple[Float, float]:
        """The step d (q,) and the fall of J that the quadratic model promises."""
        h = self.hessian(state.at, state.secant)
        g = self.problem.gradient(state.at)
        reach = self.method.move
        if self.method.kind == "levenberg-marquardt":
            h = h + state.damping * np.diag(np.diag(h))
        else:
            reach = min(state.radius, reach)
        d = self._inside(state.at, h, g, reach)
        return d, float(-2 * (g @ d) - d @ h @ d)

    def step(self, state: DescentState) -> DescentState:
        """One accepted step, or the same point with less reach."""
        d, promised = self.propose(state)
        size = float(np.abs(d).max(initial=0.0))
        if np.array_equal(state.at.y + d, state.at.y):
            return self._rejected(state, size, "no step inside the limits lowers J")
        try:
            trial = self.problem.evaluate(state.at.y + d, state.at)
        except (NumericalError, SolverError) as e:
            return self._rejected(
                state, size, f"the trial point could not be solved: {e}"
            )
        now = self.problem.shared(trial, state.at)
        before = self.problem.shared(state.at, state.at)
        if now is None or before is None:
            return self._rejected(state, size, "the trial point loses a mode")
        fall = before - now
        # 1e-14: relative rise of J that is not one
        if not np.isfinite(now) or fall < -1e-14 * abs(before):
            return self._rejected(state, size, "the trial point does not lower J")
        return self._accepted(
            state, trial, size, fall / promised if promised > 0 else 1.0
        )

    def _accepted(
        self, state: DescentState, trial: Evaluated, size: float, ratio: float
    ) -> DescentState:
        radius = state.radius
        damping = state.damping
        if ratio > 0.75:
            radius = max(radius, 2 * size)
            damping = 0.2 * damping
        elif ratio <= 0.25:
            radius = 0.5 * min(radius, size)
            damping = 4.0 * damping
        made = DescentState(
            at=trial,
            radius=min(radius, self.method.move),
            damping=max(damping, 1e-12),
            step=size,
            rejected=0,
            why="",
            secant=self._secant(state, trial),
        )
        if self.keep is not None:
            self.keep(made)
        return made

    def _rejected(self, state: DescentState, size: float, why: str) -> DescentState:
        if state.rejected and why not in state.why:
            why = f"{state.why}; {why}"
        return replace(
            state,
            radius=0.3 * min(size, state.radius),
            damping=max(8 * state.damping, 1e-2),
            rejected=state.rejected + 1,
            why=why,
            secant=np.zeros_like(state.secant),
        )

    def _secant(self, state: DescentState, trial: Evaluated) -> Float:
        """Zero where the rows changed."""
        old = state.at
        if not self.method.secant or not np.array_equal(old.mode, trial.mode):
            return np.zeros_like(state.secant)
        before, after = (self.problem.weighted(e) for e in (old, trial))
        precision = self.problem.linked_precision
        return secant(state.secant, trial.y - old.y, before, after, precision)

    def terminate(self, state: DescentState) -> Outcome | None:
        """Small gradient or step, or many rejected steps in a row."""
        if self.reason(state):
            return Outcome.CONVERGED
        return Outcome.STALLED if state.rejected >= REJECTIONS else None

    def reason(self, state: DescentState) -> str:
        """Which tolerance is met; empty if none."""
        r, g = self.problem.weighted(state.at)
        whole = (
            np.abs(g).T @ np.abs(r)
            + np.abs(self.problem.linked_precision @ state.at.y)
            + 1e-300
        )
        slope = self.problem.gradient(state.at)
        rows, limits = self.problem.inequalities()
        inside = (rows @ state.at.y <= limits + 1e-9).all()
        if inside and (np.abs(slope) <= self.method.gradient * whole).all():
            return "the gradient of J is below its tolerance"
        # the undamped step: one that damping or a small region made short proves nothing
        h = self.hessian(state.at, state.secant)
        d = self._inside(state.at, h, slope, self.method.move)
        if float(np.abs(d).max(initial=0.0)) > self.method.step:
            promised = float(-2 * (slope @ d) - d @ h @ d)
            hidden = ROUNDING * state.at.cost + r.size * ROUNDING**2
            finished = state.rejected >= 2 and promised <= hidden
            return "J cannot be lowered by more than its rounding" if finished else ""
        if (rows @ state.at.y > limits - 1e-9).any():
            return "the step is below its tolerance; bounds or constraints are reached"
        return "the step is below its tolerance"

    def merit(self, state: DescentState) -> float:
        """J."""
        return state.at.cost


def solve(
    problem: Problem,
    method: Method | None = None,
    *,
    start: Float | None = None,
    iterations: int = 100,
    checkpoint: Path | None = None,
    progress: Progress = quiet,
) -> Solution:
    """Minimise J.

    Parameters
    ----------
    problem : Problem
    method : Method, optional
        Trust region by default.
    start : (q,) float64, optional
        Unknowns at the start, 0 by default; taken to the nearest point inside all limits.
    iterations : int
        Limit; rejected steps count.
    checkpoint : Path, optional
        A JSON file that holds the last accepted point; if it is there, the run goes on from it.

    Raises
    ------
    ConfigError
        If no point is inside all limits.
    NumericalError, SolverError
        If the start itself cannot be solved; a trial point that cannot is a rejected step.
    DataError
        If the checkpoint belongs to another problem.
    """
    method = method or Method()
    begin = (
        np.zeros(problem.size) if start is None else np.array(start, dtype=np.float64)
    )
    descent = Descent(problem, method, problem.nearest(begin))
    if checkpoint is not None:
        descent = replace(
            _resumed(descent, checkpoint),
            keep=lambda s: write_checkpoint(checkpoint, problem, s),
        )
    run = iterate(descent, limit=iterations, progress=progress)
    last = run.last
    history = tuple(
        s.at
        for i, s in enumerate(run.states)
        if i == 0 or s.at is not run.states[i - 1].at
    )
    why = descent.reason(last) or last.why or run.outcome.value
    return _solution(problem, history, run.outcome, why, len(run.states))


def _solution(
    problem: Problem,
    history: tuple[Evaluated, ...],
    outcome: Outcome,
    why: str,
    count: int,
) -> Solution:
    end = history[-1]
    precision = problem.linked_precision
    _, g = problem.weighted(end)
    normal = g.T @ g
    largest = float(np.diag(normal + precision).max(initial=1e-300))
    total = normal + precision + 1e-14 * np.eye(len(normal)) * largest
    spent = float(np.trace(linalg.solve(total, normal, assume_a="pos")))
    # errors in a shape, the datum of many rows
    many = problem.configurations[0].target.weights.independent
    data = float(np.where(np.bincount(end.datum) > 1, many, 1.0).sum())
    spread = max(1.0, end.data / max(data - spent, 1.0))
    posterior = normal / spread + total - normal
    covariance = linalg.solve(posterior, np.eye(len(normal)), assume_a="pos")
    prior = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    return Solution(
        x=end.x,
        factors=problem.parameters.factors(end.x),
        y=end.y,
        covariance=covariance,
        identifiability=np.sqrt(np.diag(covariance)) * prior,
        history=history,
        outcome=outcome,
        why=why,
        evaluations=count,
    )


def write_checkpoint(path: Path, problem: Problem, state: DescentState) -> None:
    """The point and the reach of a state as JSON, whole or not at all."""
    found = {
        "names": list(problem.parameters.names),
        "y": state.at.y.tolist(),
        "radius": state.radius,
        "damping": state.damping,
        "cost": state.at.cost,
    }
    with atomic_write(path) as part:
        part.write_text(json.dumps(found), encoding="utf-8")


def _resumed(descent: Descent, path: Path) -> Descent:
    """From the file if it is there."""
    if not path.exists():
        return descent
    keeps_up(path)
    try:
        found = read_json(path)
        y = np.array(found["y"], dtype=np.float64)
        same = found["names"] == list(descent.problem.parameters.names) and y.shape == (
            descent.problem.size,
        )
        if same:
            return replace(
                descent,
                start=y,
                radius=float(found["radius"]),
                damping=float(found["damping"]),
            )
    except (ValueError, KeyError, TypeError) as e:
        raise DataError(
            f"{path}: not a checkpoint of an updating: {e}; remove it to start anew"
        ) from e
    raise DataError(
        f"{path}: the checkpoint has other parameters ({', '.join(found['names'])}); remove it "
        "to start anew"
    )


def staged(
    problem: Problem,
    stages: Sequence[Sequence[str]],
    method: Method | None = None,
    *,
    iterations: int = 100,
    progress: Progress = quiet,
) -> tuple[Solution, ...]:
    """Solve with growing sets of parameters, by name, each stage from the end of the one before.

    Raises
    ------
    InputError
        If a stage drops a parameter that an earlier one has moved.
    """
    done: list[Solution] = []
    x = np.zeros(len(problem.parameters))
    for i, names in enumerate(stages):
        part = held_to(problem, names, x)
        start = linalg.lstsq(part.link, x)[0]
        progress(i / len(stages), f"stage {i + 1}: {', '.join(names)}")
        done.append(solve(part, method, start=start, iterations=iterations))
        x = np.array(done[-1].x)
    return tuple(done)


def positive(normal: Float, curvature: Float) -> Float:
    """`normal` + `curvature` if that is safely positive definite, else `normal` (q, q)."""
    if not curvature.any():
        return normal
    both = normal + curvature
    size = np.sqrt(np.diag(normal))
    least = float(np.linalg.eigvalsh(both / np.outer(size, size)).min(initial=1.0))
    return both if least > 1e-3 else normal


def secant(
    kept: Float,
    s: Float,
    old: tuple[Float, Float],
    new: tuple[Float, Float],
    precision: Float,
) -> Float:
    """Σ r ∂²r (q, q) updated from one step s; 0 for a long one. Dennis, Gay and Welsch (1981), eq.
    2.11 and 3.1.

    Parameters
    ----------
    kept : (q, q) float64
    s : (q,) float64
    old, new : residual (r,) and ∂z/∂y (r, q) before and after the step
    precision : (q, q) float64
    """
    (r0, g0), (r, g) = old, new
    part = -(g - g0).T @ r
    change = g0.T @ r0 - g.T @ r + precision @ s
    along = float(change @ s)
    if along <= 0 or float(np.abs(s).max(initial=0.0)) > 0.3:
        return np.zeros_like(kept)
    own = float(s @ kept @ s)
    sized = kept * (min(1.0, abs(float(s @ part) / own)) if own else 0.0)
    miss = part - sized @ s
    update = (np.outer(miss, change) + np.outer(change, miss)) / along
    return sized + update - float(miss @ s) / along**2 * np.outer(change, change)


@dataclass(frozen=True, slots=True, eq=False)
class MultiStart(FrozenArrays):
    """Where many starts have ended.

    Attributes
    ----------
    starts, ends : (n, q) float64
        NaN for a start that could not be solved.
    costs : (n,) float64
        J, infinite for a start that could not be solved.
    minimum : (n,) int64
        Number of the minimum that a start ended in, in order of J; −1 for none.
    best : Solution
    """

    starts: Float
    ends: Float
    costs: Float
    minimum: Int
    best: Solution

    @property
    def share(self) -> float:
        """Share of the starts that ended in the lowest minimum."""
        return float(np.mean(self.minimum == 0))


def latin_hypercube(
    parameters: ParameterSet, count: int, rng: np.random.Generator
) -> Float:
    """Starts x (count, p), spread over the bounds."""
    if count < 1:
        raise ConfigError(f"{count} starts: 1 or more")
    from scipy.stats import qmc  # slow to import, and few need it

    low, high = parameters.bounds()
    unit = qmc.LatinHypercube(len(parameters), rng=rng).random(count)
    return low + unit * (high - low)


@dataclass(frozen=True, slots=True)
class StartSettings:
    """How far several starts are followed.

    Attributes
    ----------
    iterations : int
        Limit for each start.
    finish : int
        How many of the best that have not converged by then go on for ten times as long.
    workers : int or str
        That they are spread over.
    """

    iterations: int = 60
    finish: int = 0
    workers: Workers = 1


def multi_start(
    problem: Problem,
    starts: Float,
    method: Method | None = None,
    settings: StartSettings | None = None,
    *,
    progress: Progress = quiet,
) -> MultiStart:
    """Solve from each of the starts (n, q); a start that cannot be solved is reported, not raised.

    Raises
    ------
    NumericalError
        If none can be solved.
    """
    method = method or Method()
    settings = settings or StartSettings()
    limit = settings.iterations
    count = len(starts)
    models = [c.model for c in problem.configurations]
    cases = {f"start {i + 1} of {count}": y for i, y in enumerate(starts)}
    follow = partial(_from_start, problem, method, limit)
    ends = list(
        side_by_side(follow, cases, settings.workers, part(progress, 0.0, 0.8), models)
    )
    found = {i: s for i, s in enumerate(ends) if isinstance(s, Solution)}
    if not found:
        why = ends[-1] if ends else "none given"
        raise NumericalError(f"none of {count} starts could be solved; {why}")
    best = sorted(found, key=lambda i: found[i].cost)[: settings.finish]
    unfinished = [i for i in best if not found[i].outcome.ok]
    cases = {f"start {i + 1} goes on": found[i].y for i in unfinished}
    follow = partial(_from_start, problem, method, 10 * limit)
    more = side_by_side(
        follow, cases, settings.workers, part(progress, 0.8, 1.0), models
    )
    for i, s in zip(unfinished, more, strict=True):
        if isinstance(s, Solution):
            found[i] = s
    costs = np.full(count, np.inf)
    points = np.full((count, problem.size), np.nan)
    for i, s in found.items():
        costs[i] = s.cost
        points[i] = s.y
    return MultiStart(
        starts=starts,
        ends=points,
        costs=costs,
        minimum=_minima(problem, points, costs),
        best=min(found.values(), key=lambda s: s.cost),
    )


def _from_start(
    problem: Problem, method: Method, limit: int, start: Float, _progress: Progress
) -> Solution | str:
    """The solution from a start, or why there is none."""
    try:
        return solve(problem, method, start=start, iterations=limit)
    except (NumericalError, SolverError) as e:
        return str(e)


def _minima(problem: Problem, ends: Float, costs: Float) -> Int:
    """Number of the minimum of each end, the lowest first."""
    low, high = problem.parameters.bounds()
    x = ends @ problem.link.T / (high - low)
    out = np.full(costs.size, -1)
    centres = np.empty((0, x.shape[1]))
    for i in np.argsort(costs, kind="stable"):  # over starts: each may found a minimum
        if not np.isfinite(costs[i]):
            continue
        # 1e-3: largest distance in x, relative to the range of the bounds, of two ends that are one
        # minimum
        near = np.flatnonzero(np.abs(centres - x[i]).max(axis=1, initial=0.0) < 1e-3)
        out[i] = near[0] if near.size else len(centres)
        centres = centres if near.size else np.vstack([centres, x[i]])
    return out
