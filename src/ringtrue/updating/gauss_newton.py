"""The objective J(p) = Δzᵀ W Δz + pᵀ W_p p: residuals of eigenvalues and mode shapes with their
sensitivities.

Friswell and Mottershead (1995), Finite Element Model Updating in Structural Dynamics, ch. 8 and 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.iterate import Outcome, iterate
from ringtrue.core.progress import Progress
from ringtrue.errors import NumericalError, SolverError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.updating.problem import APART, Evaluated, Problem
from ringtrue.updating.residuals.modal import (
    OF_FREQUENCY,
    CrossOrthogonality,
    Mac,
    Shapes,
    Term,
    Weighted,
)
from ringtrue.updating.solver import positive, secant
from ringtrue.updating.target import Target, match, span_residual

FREE = 0.1  # damping below which the length of a step is the method's own
STEP, GRADIENT = (
    1e-5,
    1e-6,
)  # convergence: step in x; gradient relative to its size without cancellation


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Weighted residuals and their sensitivities at one point, pairs fixed.

    Attributes
    ----------
    value : (r,) float64
        √W Δz with Δz = z_test − z_model.
    slope : (r, p) float64
        √W ∂z_model/∂x.
    pairs : (k, 2) int64
        Test mode and FE mode.
    mac : (k,) float64
        Of the pair, or of its subspace.
    frequency_error : (k,) float64
        (f_FE − f_test)/f_test, of all pairs.
    used : (k,) bool
        Pairs that the residual holds.
    kinds : (r,) int64
        0: frequency, 1: shape, 2: what else was measured; empty: a frequency a used pair, then
        shapes.
    more : float
        Number of data beside the modes.
    """

    value: Float
    slope: Float
    pairs: Int
    mac: Float
    frequency_error: Float
    used: Bool
    kinds: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    more: float = 0.0


def residual(target: Target, now: Linearisation, held: Bool | None = None) -> Residual:
    """Residuals of the used pairs at a point, modes paired anew; `held` (m,) as in `match`."""
    pairs, mac, of = match(target, now, held)
    test, fe = pairs[:, 0], pairs[:, 1]
    used = target.used[test]
    error = now.frequencies[fe] / target.frequencies[test] - 1
    w = target.weights
    lam_test = (2 * np.pi * target.frequencies[test[used]]) ** 2
    lam = (2 * np.pi * now.frequencies[fe[used]]) ** 2
    # a relative deviation of λ is twice that of f
    root = 0.5 / np.sqrt(w.frequency**2 + target.std[test[used]] ** 2)
    k, n = int(used.sum()), len(target.shapes) if w.shape > 0 else 0
    value, slope = np.empty(k * (1 + n)), np.empty((k * (1 + n), now.d_lambda.shape[1]))
    value[:k], slope[:k] = (
        root * (1 - lam / lam_test),
        root[:, None] * now.d_lambda[fe[used]] / lam_test[:, None],
    )
    if n:
        for i, k_th in enumerate(np.flatnonzero(used).tolist()):  # each pair has its own space
            r, g = span_residual(target.shapes, now, int(test[k_th]), of[k_th])
            rows = slice(k + i * n, k + (i + 1) * n)
            value[rows], slope[rows] = np.sqrt(w.of_shape) * r, np.sqrt(w.of_shape) * g
    return Residual(value, slope, pairs, mac, error, used)


def objective(target: Target, r: Residual, x: Float, prior_std: Float) -> float:
    """J = Δzᵀ W Δz + pᵀ W_p p, and `target.lost` for each used mode that has no partner."""
    lost = int(target.used.sum()) - int(r.used.sum())
    return float(r.value @ r.value + (x / prior_std) @ (x / prior_std) + target.lost * lost)


def used_up(normal: Float, precision: Float) -> float:
    """How many data the parameters use up: the trace of the hat matrix, of GᵀG (p, p) and that of
    the prior (p, p).
    """
    return float(np.trace(np.linalg.solve(normal + precision, normal)))


def aicc(value: float, n: float, parameters: int) -> float:
    """n ln(J/n) with a penalty on the parameters and the scale of J, J over `n` data; Burnham,
    Anderson, eq. 7.
    """
    k = parameters + 1
    return float(n * np.log(max(value, 1e-300) / n) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 1))


def comparable_criteria(
    target: Target, residuals: Sequence[Residual], points: Sequence[Float], priors: Sequence[Float]
) -> Float:
    """AICc (k,) of parameter sets that may have paired different modes: the same modes are counted
    in all.

    Counted are the used modes that at least one set has paired; a set that has no partner for one
    of them pays `target.lost`. So losing a mode never pays, and a mode that no set explains does
    not decide. Burnham and Anderson (2002), eq. 7.

    Parameters
    ----------
    residuals : sequence (k) of Residual
    points, priors : sequences (k) of (p,) float64
        x and the prior standard deviations of each set.
    """
    counted = np.unique(np.concatenate([r.pairs[r.used, 0] for r in residuals]))
    n = target.weights.data * max(counted.size, 1) + residuals[0].more
    out = []
    for r, x, prior in zip(residuals, points, priors, strict=True):
        missing = counted.size - int(r.used.sum())
        value = float(r.value @ r.value + (x / prior) @ (x / prior)) + target.lost * missing
        out.append(aicc(value, n, x.size))
    return np.array(out)


def shared_cost(r: Residual, others: Residual) -> float | None:
    """Δzᵀ W Δz over the test modes that `others` uses; None if one of them has no partner in `r`.

    Points with different pairs are compared by this: a mode that has just found a partner must not
    count against a point, and losing one must not pay.
    """
    mine, theirs = r.pairs[r.used, 0], others.pairs[others.used, 0]
    if not np.isin(theirs, mine).all():
        return None
    square = r.value**2
    k = mine.size
    cost = square[:k] + square[k:].reshape(k, -1).sum(axis=1) if k else square
    return float(cost[np.isin(mine, theirs)].sum())


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


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A point, its residual, the damping for the next step and the secant estimate of Σ Δz ∂²Δz (p,
    p).
    """

    x: Float
    residual: Residual
    value: float
    mu: float
    step: float
    rejected: int
    curvature: Float


@dataclass(frozen=True, slots=True, eq=False)
class UpdateResult:
    """Where the updating ended.

    Attributes
    ----------
    x : (p,) float64
    factors : (p,) float64
    covariance : (p, p) float64
        Of x, Laplace: s² (GᵀWG)… with the model discrepancy s² estimated from the residuals, W_p as
        prior.
    identifiability : (p,) float64
        Posterior over prior standard deviation of x.
    history : tuple of State
    outcome : Outcome
    condition : float
        Of the scaled GᵀWG at the end.
    gradient : float
        Norm of the projected gradient at the end over that at the start.
    """

    x: Float
    factors: Float
    covariance: Float
    identifiability: Float
    history: tuple[State, ...]
    outcome: Outcome
    condition: float
    gradient: float

    def __post_init__(self) -> None:
        freeze_fields(
            self,
            x=np.float64,
            factors=np.float64,
            covariance=np.float64,
            identifiability=np.float64,
        )

    @property
    def residual(self) -> Residual:
        """At the end."""
        return self.history[-1].residual

    @property
    def std(self) -> Float:
        """Standard deviation of x, (p,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class GaussNewton:
    """The method as a frozen value; run by `core.iterate`."""

    model: ObservedModel
    target: Target
    published: bool = False
    mu: float = 1e-3
    move: float = 0.7  # largest change of any x in one step
    least: Float | None = None  # start

    def _at(self, x: Float, before: Residual | None = None) -> tuple[Residual, float]:
        held = None
        if before is not None:
            held = np.isin(np.arange(self.target.used.size), before.pairs[before.used, 0])
        r = residual(self.target, self.model.linearise(x), held)
        return r, objective(self.target, r, x, self.model.parameters.std())

    def init(self) -> State:
        """The nominal model, or the start given."""
        x = (
            np.zeros(len(self.model.parameters))
            if self.least is None
            else np.array(self.least, dtype=np.float64)
        )
        r, value = self._at(x)
        return State(x, r, value, self.mu, np.inf, 0, np.zeros((x.size, x.size)))

    def gradient(self, state: State) -> Float:
        """½ ∂J/∂x with the components that point out of the bounds set to zero, (p,)."""
        g = -(state.residual.slope.T @ state.residual.value)
        if not self.published:
            g = g + state.x / self.model.parameters.std() ** 2
        low, high = self.model.parameters.bounds()
        out = ((state.x <= low + 1e-12) & (g > 0)) | ((state.x >= high - 1e-12) & (g < 0))
        return np.where(out, 0.0, g)

    def step(self, state: State) -> State:
        """One accepted step, or the same point with more damping."""
        g, w = state.residual.slope, 1 / self.model.parameters.std() ** 2
        gradient = self.gradient(state)
        free = gradient != 0
        normal = positive(g.T @ g + np.diag(w), state.curvature)[np.ix_(free, free)]
        low, high = self.model.parameters.bounds()
        x = state.x.copy()
        dx = np.zeros_like(x)
        dx[free] = -np.linalg.solve(normal + state.mu * np.diag(np.diag(normal)), gradient[free])
        dx *= min(1.0, self.move / max(float(np.abs(dx).max(initial=0.0)), 1e-300))
        x = np.clip(x + dx, low, high)
        try:
            r, value = self._at(x, state.residual)
        except (
            NumericalError,
            SolverError,
        ):  # a trial point that cannot be solved is a rejected step
            return self._rejected(state)
        if self._better(x, r, state):
            curvature = self._curvature(state, x, r)
            return State(
                x, r, value, max(state.mu / 5, 1e-8), float(np.abs(x - state.x).max()), 0, curvature
            )
        if (
            state.mu < FREE and (step := float(np.abs(x - state.x).max())) < STEP
        ):  # what it gains is round-off of J
            return replace(state, step=step, rejected=state.rejected + 1)
        return self._rejected(state)

    def _rejected(self, state: State) -> State:
        """The same point with more damping."""
        flat = np.zeros_like(state.curvature)
        mu = max(8 * state.mu, 1e-2)
        return State(state.x, state.residual, state.value, mu, state.step, state.rejected + 1, flat)

    def _better(self, x: Float, r: Residual, state: State) -> bool:
        """Whether the trial keeps every mode and lowers J (published: keeps every mode) over the
        modes of the state.

        Where no pair costs more than a lost mode, J itself is compared.
        """
        if self.target.rule != "gates" and not self.published:
            std = self.model.parameters.std()
            return objective(self.target, r, x, std) <= objective(
                self.target, state.residual, state.x, std
            )
        now, before = shared_cost(r, state.residual), shared_cost(state.residual, state.residual)
        if now is None or before is None:
            return False
        w = 1 / self.model.parameters.std() ** 2
        return self.published or now + float(w @ x**2) <= before + float(w @ state.x**2)

    def _curvature(self, state: State, x: Float, r: Residual) -> Float:
        """Σ Δz ∂²Δz (p, p) after a step to x; 0 where the pairs have changed."""
        old = state.residual
        same_rows = r.value.shape == old.value.shape and r.pairs.tolist() == old.pairs.tolist()
        if self.published or not same_rows:
            return np.zeros_like(state.curvature)
        return secant(
            state.curvature,
            x - state.x,
            (old.value, old.slope),
            (r.value, r.slope),
            np.diag(1 / self.model.parameters.std() ** 2),
        )

    def terminate(self, state: State) -> Outcome | None:
        """Small gradient or step, or eight rejected steps in a row."""
        scale = np.abs(state.residual.slope).T @ np.abs(state.residual.value) + 1e-300
        if float(np.max(np.abs(self.gradient(state)) / scale, initial=0.0)) < GRADIENT or (
            state.step < STEP and state.mu < FREE  # a step that damping made small proves nothing
        ):
            return Outcome.CONVERGED
        return Outcome.STALLED if state.rejected >= 8 else None

    def merit(self, state: State) -> float:
        """J."""
        return state.value


def update(
    model: ObservedModel,
    target: Target,
    *,
    iterations: int = 30,
    published: bool = False,
    start: Float | None = None,
    progress: Progress | None = None,
) -> UpdateResult:
    """Minimise J over the parameters of `model`.

    Parameters
    ----------
    model : ObservedModel
    target : Target
    iterations : int
        Limit; rejected steps count.
    published : bool
        Equation (4) as printed.
    start : (p,) float64, optional
        x at the start; 0 by default.
    """
    method = GaussNewton(model, target, published=published, least=start)
    run = iterate(method, limit=iterations, progress=progress)
    accepted = tuple(s for i, s in enumerate(run.states) if i == 0 or s.rejected == 0)
    last = accepted[-1]
    return _result(method, accepted, run.outcome, last)


def _result(
    method: GaussNewton, states: tuple[State, ...], outcome: Outcome, last: State
) -> UpdateResult:
    parameters = method.model.parameters
    g, prior = last.residual.slope, parameters.std()
    # the expected size of a weighted residual is 1; a larger one is model discrepancy that W did
    # not foresee
    spread = _spread(last.residual, g.T @ g, prior, method.target.weights.data)
    covariance: Float = np.asarray(
        np.linalg.inv(g.T @ g / spread + np.diag(1 / prior**2)), dtype=np.float64
    )
    scaled = g / np.maximum(np.linalg.norm(g, axis=0), 1e-300)
    start = float(np.linalg.norm(method.gradient(states[0]))) or 1.0
    return UpdateResult(
        last.x,
        parameters.factors(last.x),
        covariance,
        np.asarray(np.sqrt(np.diag(covariance)) / prior, dtype=np.float64),
        states,
        outcome,
        float(np.linalg.cond(scaled.T @ scaled)) if scaled.size else 1.0,
        float(np.linalg.norm(method.gradient(last))) / start,
    )


def _spread(r: Residual, normal: Float, prior: Float, each: float) -> float:
    """Mean square of the weighted residuals over what the parameters have not used up; not below
    the expected 1.

    A mode gives as many data as `each`.
    """
    data, spent = each * int(r.used.sum()), used_up(normal, np.diag(1 / prior**2))
    return max(1.0, float(r.value @ r.value) / max(data - spent, 1.0))
