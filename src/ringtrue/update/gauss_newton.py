"""Damped Gauss-Newton on J(p) = Δzᵀ W Δz + pᵀ W_p p inside bounds.

The step solves (Gᵀ W G + W_p + μI) Δp = Gᵀ W Δz₀ − W_p p₀ on the free parameters. `published` leaves the last term
out: equation (4) as printed, which is the case p₀ = 0 and not stationary for J elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.iterate import iterate
from ringtrue.core.outcome import Outcome
from ringtrue.model.ports import ObservedModel
from ringtrue.update.objective import Residual, Target, objective, residual

STEP, GRADIENT = 1e-5, 1e-6  # convergence: step in x; gradient relative to its size without cancellation


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A point, its residual and the damping for the next step."""

    x: Float
    residual: Residual
    value: float
    mu: float
    step: float
    rejected: int


@dataclass(frozen=True, slots=True, eq=False)
class UpdateResult:
    """Where the updating ended.

    Attributes
    ----------
    x : (p,) float64
    factors : (p,) float64
    covariance : (p, p) float64
        Of x, Laplace: s² (GᵀWG)… with the model discrepancy s² estimated from the residuals, W_p as prior.
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
        freeze_fields(self, x=np.float64, factors=np.float64, covariance=np.float64, identifiability=np.float64)

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
        x = np.zeros(len(self.model.parameters)) if self.least is None else np.array(self.least, dtype=np.float64)
        r, value = self._at(x)
        return State(x, r, value, self.mu, np.inf, 0)

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
        normal = (g.T @ g + np.diag(w))[np.ix_(free, free)]
        low, high = self.model.parameters.bounds()
        x = state.x.copy()
        dx = np.zeros_like(x)
        dx[free] = -np.linalg.solve(normal + state.mu * np.diag(np.diag(normal)), gradient[free])
        dx *= min(1.0, self.move / max(float(np.abs(dx).max(initial=0.0)), 1e-300))
        x = np.clip(x + dx, low, high)
        r, value = self._at(x, state.residual)
        if self.published or value <= state.value:
            return State(x, r, value, max(state.mu / 5, 1e-8), float(np.abs(x - state.x).max()), 0)
        return State(state.x, state.residual, state.value, max(8 * state.mu, 1e-2), state.step, state.rejected + 1)

    def terminate(self, state: State) -> Outcome | None:
        """Small gradient or step, or eight rejected steps in a row."""
        scale = np.abs(state.residual.slope).T @ np.abs(state.residual.value) + 1e-300
        if float(np.max(np.abs(self.gradient(state)) / scale, initial=0.0)) < GRADIENT or (
            state.step < STEP and state.mu < 0.1  # a step that damping made small proves nothing
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
    progress: Callable[[float, str], None] | None = None,
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


def _result(method: GaussNewton, states: tuple[State, ...], outcome: Outcome, last: State) -> UpdateResult:
    parameters = method.model.parameters
    g, prior = last.residual.slope, parameters.std()
    # the expected size of a weighted residual is 1; a larger one is model discrepancy that W did not foresee
    spread = _spread(last.residual, g.T @ g, prior)
    covariance: Float = np.asarray(np.linalg.inv(g.T @ g / spread + np.diag(1 / prior**2)), dtype=np.float64)
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


def _spread(r: Residual, normal: Float, prior: Float) -> float:
    """Mean square of the weighted residuals over what the parameters have not used up; not below the expected 1.

    A shape counts as one datum, however many channels it has. The parameters use up the trace of the hat matrix.
    """
    pairs = int(r.used.sum())
    data = pairs if r.value.size == pairs else 2 * pairs
    spent = float(np.trace(np.linalg.solve(normal + np.diag(1 / prior**2), normal)))
    return max(1.0, float(r.value @ r.value) / max(data - spent, 1.0))
