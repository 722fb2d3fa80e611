"""The methods of updating under one driver: Gauss-Newton, Levenberg-Marquardt, trust region; bounds
and constraints.

Each step minimises the same quadratic model ½dᵀHd + gᵀd, H = GᵀWG + W_p (+ S + μD), inside bounds,
linear constraints, move limits and the trust region, by one least-squares problem with inequalities
(Lawson and Hanson, 1974, ch. 23).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.iterate import Outcome, iterate
from ringtrue.core.progress import Progress
from ringtrue.errors import ConfigError, DataError, NumericalError, SolverError, did_you_mean
from ringtrue.io.files import atomic_write, keeps_up
from ringtrue.io.foreign.parsers import read_json
from ringtrue.updating.problem import Evaluated, Problem, held_to, least_distance, squares

Kind = Literal["gauss-newton", "published", "levenberg-marquardt", "trust-region"]
KINDS = {
    "gauss-newton": "full steps inside the move limits, halved when they do not lower J",
    "published": "equation (4) as printed: the prior restrains each step, not their sum; not "
    "stationary for J",
    "levenberg-marquardt": "steps damped by mu D, D the diagonal of the Hessian",
    "trust-region": "steps inside a box that grows and shrinks with how well J was predicted",
}
REJECTIONS = 12
SMALL = 1e-14  # relative rise of J that is not one
# The rounding of eigensolutions may hide a fall of J of this part of J, and a change of each
# weighted residual of this size (which decides where the data fit exactly and J is near 0).
ROUNDING = 1e-7


@dataclass(frozen=True, slots=True)
class Method:
    """A method and its settings.

    Attributes
    ----------
    kind : one of KINDS
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
        if self.kind not in KINDS:
            raise ConfigError(
                f"no method of updating {self.kind!r}{did_you_mean(self.kind, KINDS)}"
            )
        if min(self.move, self.radius, self.damping) <= 0:
            raise ConfigError(
                f"move {self.move}, radius {self.radius}, damping {self.damping}: must be > 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class State:
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
class Solution:
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

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, x=f, factors=f, y=f, covariance=f, identifiability=f)

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
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """A method on a problem, run by `core.iterate`."""

    problem: Problem
    method: Method
    start: Float
    keep: Callable[[State], None] | None = None
    radius: float = 0.0  # of an interrupted run
    damping: float = 0.0

    def init(self) -> State:
        """The start."""
        at = self.problem.evaluate(self.start)
        flat = np.zeros((at.y.size, at.y.size))
        return State(
            at,
            self.radius or self.method.radius,
            self.damping or self.method.damping,
            np.inf,
            0,
            "",
            flat,
        )

    def gradient(self, at: Evaluated) -> Float:
        """½ ∂J/∂y; without the prior where the published equation is asked for."""
        g = self.problem.gradient(at)
        return g - self.problem.linked_precision @ at.y if self.method.kind == "published" else g

    def hessian(self, at: Evaluated, curvature: Float) -> Float:
        """GᵀWG + W_p + secant, (q, q)."""
        _, g = self.problem.weighted(at)
        h = g.T @ g + self.problem.linked_precision
        h[np.diag_indices_from(h)] += 1e-14 * max(float(np.diag(h).max()), 1e-300)
        return positive(h, curvature)

    def _inside(self, at: Evaluated, h: Float, g: Float, reach: float) -> Float:
        """The minimum of the quadratic model inside all limits and a box of half width `reach`."""
        q = at.y.size
        rows, limits = self.problem.inequalities()
        room = np.concatenate([np.maximum(limits - rows @ at.y, 0.0), np.full(2 * q, reach)])
        return least_distance(h, g, np.concatenate([rows, np.eye(q), -np.eye(q)]), room)

    def propose(self, state: State) -> tuple[Float, float]:
        """The step d (q,) and the fall of J that the quadratic model promises."""
        h, g = self.hessian(state.at, state.secant), self.gradient(state.at)
        plain = self.method.kind in ("gauss-newton", "published")
        reach = self.method.move
        if self.method.kind == "levenberg-marquardt":
            h = h + state.damping * np.diag(np.diag(h))
        elif not plain:
            reach = min(state.radius, reach)
        d = self._inside(state.at, h, g, reach) * (0.5**state.rejected if plain else 1.0)
        return d, float(-2 * (g @ d) - d @ h @ d)

    def step(self, state: State) -> State:
        """One accepted step, or the same point with less reach."""
        d, promised = self.propose(state)
        size = float(np.abs(d).max(initial=0.0))
        if np.array_equal(state.at.y + d, state.at.y):
            return self._rejected(state, size, "no step inside the limits lowers J")
        try:
            trial = self.problem.evaluate(state.at.y + d, state.at)
        except (NumericalError, SolverError) as e:
            return self._rejected(state, size, f"the trial point could not be solved: {e}")
        now, before = self.problem.shared(trial, state.at), self.problem.shared(state.at, state.at)
        if now is None or before is None:
            return self._rejected(state, size, "the trial point loses a mode")
        fall = before - now
        if not np.isfinite(now) or (
            fall < -SMALL * abs(before) and self.method.kind != "published"
        ):
            return self._rejected(state, size, "the trial point does not lower J")
        return self._accepted(state, trial, size, fall / promised if promised > 0 else 1.0)

    def _accepted(self, state: State, trial: Evaluated, size: float, ratio: float) -> State:
        secant = self._secant(state, trial) if self.method.secant else np.zeros_like(state.secant)
        grow = 2.0 if ratio > 0.75 else 1.0 if ratio > 0.25 else 0.5
        radius = (
            max(state.radius, 2 * size)
            if grow > 1
            else grow * min(state.radius, size if grow < 1 else np.inf)
        )
        damping = max(state.damping * {2.0: 0.2, 1.0: 1.0, 0.5: 4.0}[grow], 1e-12)
        made = State(trial, min(radius, self.method.move), damping, size, 0, "", secant)
        if self.keep is not None:
            self.keep(made)
        return made

    def _rejected(self, state: State, size: float, why: str) -> State:
        flat = np.zeros_like(state.secant)
        if state.rejected and why not in state.why:
            why = f"{state.why}; {why}"
        damping = max(8 * state.damping, 1e-2)
        return replace(
            state,
            radius=0.3 * min(size, state.radius),
            damping=damping,
            rejected=state.rejected + 1,
            why=why,
            secant=flat,
        )

    def _secant(self, state: State, trial: Evaluated) -> Float:
        """Zero where the rows changed."""
        old = state.at
        if old.mode.tolist() != trial.mode.tolist() or self.method.kind == "published":
            return np.zeros_like(state.secant)
        (r0, g0), (r, g) = self.problem.weighted(old), self.problem.weighted(trial)
        return secant(
            state.secant, trial.y - old.y, (r0, g0), (r, g), self.problem.linked_precision
        )

    def terminate(self, state: State) -> Outcome | None:
        """Small gradient or step, or many rejected steps in a row."""
        if self.reason(state):
            return Outcome.CONVERGED
        return Outcome.STALLED if state.rejected >= REJECTIONS else None

    def reason(self, state: State) -> str:
        """Which tolerance is met; empty if none."""
        r, g = self.problem.weighted(state.at)
        whole = (
            np.abs(g).T @ np.abs(r) + np.abs(self.problem.linked_precision @ state.at.y) + 1e-300
        )
        slope = self.gradient(state.at)
        rows, limits = self.problem.inequalities()
        if (np.abs(slope) <= self.method.gradient * whole).all() and (
            rows @ state.at.y <= limits + 1e-9
        ).all():
            return "the gradient of J is below its tolerance"
        # the undamped step: one that damping or a small region made short proves nothing
        h = self.hessian(state.at, state.secant)
        d = self._inside(state.at, h, slope, self.method.move)
        if float(np.abs(d).max(initial=0.0)) > self.method.step:
            promised = float(-2 * (slope @ d) - d @ h @ d)
            hidden = ROUNDING * state.at.cost + r.size * ROUNDING**2
            finished = state.rejected >= 2 and promised <= hidden
            return "J cannot be lowered by more than its rounding" if finished else ""
        at_limit = (rows @ state.at.y > limits - 1e-9).any()
        return "the step is below its tolerance" + (
            "; bounds or constraints are reached" if at_limit else ""
        )

    def merit(self, state: State) -> float:
        """J."""
        return state.at.cost


def solve(
    problem: Problem,
    method: Method | None = None,
    *,
    start: Float | None = None,
    iterations: int = 100,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
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
    begin = np.zeros(problem.size) if start is None else np.array(start, dtype=np.float64)
    descent = Descent(problem, method, problem.nearest(begin))
    if checkpoint is not None:
        descent = replace(
            _resumed(descent, checkpoint), keep=lambda s: write_checkpoint(checkpoint, problem, s)
        )
    run = iterate(descent, limit=iterations, progress=progress)
    last = run.last
    history = tuple(
        s.at for i, s in enumerate(run.states) if i == 0 or s.at is not run.states[i - 1].at
    )
    why = descent.reason(last) or last.why or run.outcome.value
    return _solution(problem, history, run.outcome, why, len(run.states))


def _solution(
    problem: Problem, history: tuple[Evaluated, ...], outcome: Outcome, why: str, count: int
) -> Solution:
    end, precision = history[-1], problem.linked_precision
    _, g = problem.weighted(end)
    normal = g.T @ g
    total = (
        normal
        + precision
        + 1e-14 * np.eye(len(normal)) * float(np.diag(normal + precision).max(initial=1e-300))
    )
    spent = float(np.trace(linalg.solve(total, normal, assume_a="pos")))
    many = problem.configurations[
        0
    ].target.weights.independent  # errors in a shape, the datum of many rows
    data = float(np.where(np.bincount(end.datum) > 1, many, 1.0).sum())
    spread = max(
        1.0, float(problem.loss.cost(squares(end.value, end.datum)).sum()) / max(data - spent, 1.0)
    )
    posterior = normal / spread + total - normal
    covariance = linalg.solve(posterior, np.eye(len(normal)), assume_a="pos")
    prior = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    told = np.sqrt(np.diag(covariance)) * prior
    return Solution(
        end.x,
        problem.parameters.factors(end.x),
        end.y,
        covariance,
        told,
        history,
        outcome,
        why,
        count,
    )


def write_checkpoint(path: Path, problem: Problem, state: State) -> None:
    """The point and the reach of a state as JSON, whole or not at all."""
    names = list(problem.parameters.names)
    found = {
        "names": names,
        "y": state.at.y.tolist(),
        "radius": state.radius,
        "damping": state.damping,
    }
    with atomic_write(path) as part:
        part.write_text(json.dumps(found | {"cost": state.at.cost}), encoding="utf-8")


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
                descent, start=y, radius=float(found["radius"]), damping=float(found["damping"])
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
    progress: Progress | None = None,
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
        if progress is not None:
            progress(i / len(stages), f"stage {i + 1}: {', '.join(names)}")
        done.append(solve(part, method, start=start, iterations=iterations))
        x = np.array(done[-1].x)
    return tuple(done)


def positive(normal: Float, curvature: Float, safe: float = 1e-3) -> Float:
    """`normal` + `curvature` if that is safely positive definite, else `normal` (q, q)."""
    if not curvature.any():
        return normal
    both, size = normal + curvature, np.sqrt(np.diag(normal))
    return (
        both
        if float(np.linalg.eigvalsh(both / np.outer(size, size)).min(initial=1.0)) > safe
        else normal
    )


def secant(
    kept: Float,
    s: Float,
    old: tuple[Float, Float],
    new: tuple[Float, Float],
    precision: Float,
    near: float = 0.3,
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
    if along <= 0 or float(np.abs(s).max(initial=0.0)) > near:
        return np.zeros_like(kept)
    own = float(s @ kept @ s)
    sized = kept * (min(1.0, abs(float(s @ part) / own)) if own else 0.0)
    miss = part - sized @ s
    update = (np.outer(miss, change) + np.outer(change, miss)) / along
    return np.asarray(sized + update - float(miss @ s) / along**2 * np.outer(change, change))
