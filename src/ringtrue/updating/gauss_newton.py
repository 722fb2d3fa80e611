"""Damped Gauss-Newton on J(p) = Δzᵀ W Δz + pᵀ W_p p inside bounds.

The step solves (Gᵀ W G + W_p + μI) Δp = Gᵀ W Δz₀ − W_p p₀ on the free parameters. `published`
leaves the last term out: equation (4) as printed, which is the case p₀ = 0 and not stationary for J
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.iterate import Outcome, iterate
from ringtrue.core.progress import Progress
from ringtrue.errors import NumericalError, SolverError
from ringtrue.model.ports import ObservedModel
from ringtrue.updating.objective import Residual, Target, objective, residual, shared_cost, used_up

# least eigenvalue, in units of the Gauss-Newton diagonal, of a Hessian with second derivatives
SAFE = 1e-3
NEAR = 0.3  # largest change of x over which a secant says something of the Hessian
FREE = 0.1  # damping below which the length of a step is the method's own
STEP, GRADIENT = (
    1e-5,
    1e-6,
)  # convergence: step in x; gradient relative to its size without cancellation


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
        normal = _positive(g.T @ g + np.diag(w), state.curvature)[np.ix_(free, free)]
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
            curvature = np.zeros_like(normal) if self.published else _secant(state, x, r, w)
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


def _positive(normal: Float, curvature: Float) -> Float:
    """`normal` + `curvature` if that is safely positive definite, else `normal` (p, p)."""
    both = normal + curvature
    size = np.sqrt(np.diag(normal))
    return (
        both
        if float(np.linalg.eigvalsh(both / np.outer(size, size)).min(initial=1.0)) > SAFE
        else normal
    )


def _secant(before: State, x: Float, r: Residual, w: Float) -> Float:
    """The part of the Hessian that Gauss-Newton leaves out, updated from one step; 0 where the
    pairs have changed.

    Structured secant of Dennis, Gay and Welsch (1981), NL2SOL, eq. 2.11 and the sizing of 3.1. It
    matters where the residuals stay large: Gauss-Newton alone then converges linearly.
    """
    old = before.residual
    zero = np.zeros_like(before.curvature)
    if r.value.shape != old.value.shape or r.pairs.tolist() != old.pairs.tolist():
        return zero
    s = x - before.x
    if float(np.abs(s).max(initial=0.0)) > NEAR:
        return zero
    part = -(r.slope - old.slope).T @ r.value
    y = old.slope.T @ old.value - r.slope.T @ r.value + w * s
    along = float(y @ s)
    if along <= 0:
        return zero
    own = float(s @ before.curvature @ s)
    kept = before.curvature * (min(1.0, abs(float(s @ part) / own)) if own else 0.0)
    miss = part - kept @ s
    update = (np.outer(miss, y) + np.outer(y, miss)) / along - float(
        miss @ s
    ) / along**2 * np.outer(y, y)
    return np.asarray(kept + update)
