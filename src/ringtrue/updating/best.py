"""How close a model of a given form can come to given frequencies at all: a yardstick, not a method
of updating.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError, NumericalError
from ringtrue.model.ports import Linearisation
from ringtrue.updating.choose import Candidates
from ringtrue.updating.objective import Target, match

RADIUS = 0.5  # first trust region of x
SMALLEST = 1e-4  # of the trust region
LOST = 0.4  # relative deviation that a mode without a partner counts as


@dataclass(frozen=True, slots=True, eq=False)
class BestPossible:
    """The smallest mean |Δf| found.

    Attributes
    ----------
    members : (k,) int64, positions among the candidates
    x : (p,) float64, 0 for the others
    deviation : float
        Mean |f_model − f_target|/f_target of the used modes.
    """

    members: Int
    x: Float
    deviation: float

    def __post_init__(self) -> None:
        freeze_fields(self, members=np.int64, x=np.float64)


def _errors(target: Target, now: Linearisation) -> tuple[Float, Float]:
    """Relative frequency deviations (m,) of the used modes and ∂/∂x (m, p); `LOST` and 0 without a
    partner.
    """
    pairs, _, _ = match(target, now)
    pairs = pairs[target.used[pairs[:, 0]]]
    m, p = target.frequencies.size, now.d_lambda.shape[1]
    error, slope = np.full(m, LOST), np.zeros((m, p))
    f = now.frequencies[pairs[:, 1]]
    error[pairs[:, 0]] = f / target.frequencies[pairs[:, 0]] - 1
    d_f = now.d_lambda[pairs[:, 1]] / (8 * np.pi**2 * f[:, None])
    slope[pairs[:, 0]] = d_f / target.frequencies[pairs[:, 0], None]
    return error[target.used], slope[target.used]


def least_absolute(error: Float, slope: Float, lower: Float, upper: Float) -> tuple[Float, float]:
    """d (p,) in [lower, upper] with the smallest mean |error + slope d|, and that mean: one linear
    programme.
    """
    m, p = slope.shape
    eye = np.eye(m)
    rows = np.block([[slope, -eye], [-slope, -eye]])
    cost = np.concatenate([np.zeros(p), np.full(m, 1 / m)])
    box = [*zip(lower, upper, strict=True), *[(0.0, None)] * m]
    found = linprog(
        cost, A_ub=rows, b_ub=np.concatenate([-error, error]), bounds=box, method="highs"
    )
    if found.x is None or found.fun is None:
        raise NumericalError(f"no least-absolute step: {found.message}")
    return np.asarray(found.x[:p]), float(found.fun)


def descend(model: Candidates, target: Target, start: Float, limit: int) -> tuple[Float, float]:
    """Successive linear programming in a trust region from `start` (p,): x and the mean |Δf|."""
    low, high = model.parameters.bounds()
    x, radius = np.array(start), RADIUS
    error, slope = _errors(target, model.linearise(x))
    for _ in range(limit):
        d, _ = least_absolute(
            error, slope, np.maximum(low - x, -radius), np.minimum(high - x, radius)
        )
        trial = _errors(target, model.linearise(np.clip(x + d, low, high)))
        if np.abs(trial[0]).mean() < np.abs(error).mean():
            x, (error, slope) = np.clip(x + d, low, high), trial
        else:
            radius /= 3
        if radius < SMALLEST or np.abs(d).max(initial=0.0) < SMALLEST:
            break
    return x, float(np.abs(error).mean())


def best_possible(
    model: Candidates, target: Target, count: int, *, starts: Sequence[Float] = (), limit: int = 15
) -> BestPossible:
    """The smallest mean |Δf| of the used modes that `count` of the candidates reach, over subsets
    and starts.

    For each start (the nominal model first) subsets grow by forward selection on linear programmes,
    each confirmed by successive linear programming; then members are exchanged while the mean
    falls. A search, not a proof: the true minimum can only be lower.

    Parameters
    ----------
    model : Candidates
    target : Target
    count : int
    starts : sequence of (p,) float64
        More points to rank the candidates from.
    limit : int
        Linear programmes in one descent.

    Raises
    ------
    InputError
        If there are fewer candidates.
    """
    p = len(model.parameters)
    if not 0 < count <= p:
        raise InputError(f"best {count} of {p} candidates: allowed are 1 to {p}")
    found = [_grown(model, target, count, np.asarray(s), limit) for s in (np.zeros(p), *starts)]
    return min(found, key=lambda b: b.deviation)


def _grown(model: Candidates, target: Target, count: int, start: Float, limit: int) -> BestPossible:
    now = _descended(model, target, [], start, limit)
    while now.members.size < count:
        now = _descended(
            model, target, _ranked(model, target, now, now.members.tolist())[0], now.x, limit
        )
    for _ in range(2 * count):
        options = [
            o
            for out in now.members.tolist()
            for o in _ranked(model, target, now, np.setdiff1d(now.members, out))[:1]
        ]
        trials = [
            _descended(model, target, o, now.x, limit)
            for o in options
            if set(o) != set(now.members.tolist())
        ]
        better = min(trials, key=lambda b: b.deviation, default=now)
        if better.deviation >= now.deviation * (1 - 1e-3):
            break
        now = better
    return now


def _descended(
    model: Candidates, target: Target, members: Sequence[int], x: Float, limit: int
) -> BestPossible:
    at = list(members)
    out = np.zeros(len(model.parameters))
    if not at:
        error, _ = _errors(target, model.linearise(out))
        return BestPossible(np.zeros(0, dtype=np.int64), out, float(np.abs(error).mean()))
    out[at], value = descend(model.with_parameters(at, np.zeros(out.size)), target, x[at], limit)
    return BestPossible(np.array(at, dtype=np.int64), out, value)


def _ranked(
    model: Candidates, target: Target, now: BestPossible, stay: Sequence[int] | Int
) -> list[list[int]]:
    """`stay` with each further candidate, the most promising by its linear programme first."""
    low, high = model.parameters.bounds()
    kept = [int(i) for i in stay]
    here = np.where(np.isin(np.arange(now.x.size), kept), now.x, 0.0)
    error, slope = _errors(target, model.linearise(here))
    sets = [[*kept, c] for c in range(now.x.size) if c not in kept]
    value = [
        least_absolute(error, slope[:, s], low[s] - here[s], high[s] - here[s])[1] for s in sets
    ]
    return [sets[i] for i in np.argsort(value, kind="stable").tolist()]
