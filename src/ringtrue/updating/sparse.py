"""Sparse choice of parameters: the LASSO path inside a box, and by it the order in which candidates
enter.

min ½‖r − G x‖² + κ Σ |x_j| with low <= x <= high, x in units of the prior standard deviation.
Tibshirani (1996); coordinate descent with warm starts after Friedman, Hastie and Tibshirani (2010).
low = 0 makes it non-negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError

SWEEPS = 2000  # of the members between two checks of all columns
EXACT = 1e-9  # change of a fit, relative to ‖r‖, that ends a descent


@dataclass(frozen=True, slots=True, eq=False)
class LassoPath:
    """Solutions along falling penalties.

    Attributes
    ----------
    penalties : (k,) float64
        κ, descending; at the first no candidate is in.
    x : (k, p) float64
    misfit : (k,) float64
        ‖r − G x‖²/‖r‖².
    slack : (k,) float64
        Largest violation of the optimality conditions, relative to the first penalty.
    """

    penalties: Float
    x: Float
    misfit: Float
    slack: Float

    def __post_init__(self) -> None:
        freeze_fields(self, penalties=np.float64, x=np.float64, misfit=np.float64, slack=np.float64)

    def order(self) -> Int:
        """Candidates in the order in which they enter; those that never do are left out."""
        inside = self.x != 0
        first = np.where(inside.any(axis=0), inside.argmax(axis=0), len(inside))
        size = np.abs(self.x).max(axis=0, initial=0.0)
        order = np.lexsort((-size, first))
        return order[first[order] < len(inside)].astype(np.int64)


def lasso_path(
    slope: Float, value: Float, low: Float, high: Float, *, count: int = 40, end: float = 1e-3
) -> LassoPath:
    """The path from the penalty that keeps every candidate out down to `end` of it.

    Parameters
    ----------
    slope : (r, p) float64
        Weighted sensitivities in units of the prior.
    value : (r,) float64
        Weighted residuals.
    low, high : (p,) float64
        Bounds of x, low <= 0 <= high; equal bounds hold a candidate out.
    count : int
        Penalties, spaced evenly in their logarithm.

    Raises
    ------
    InputError
        If the sizes differ or a box does not hold 0.
    """
    g, r = np.asarray(slope, dtype=np.float64), np.asarray(value, dtype=np.float64)
    if (
        g.ndim != 2
        or r.shape != g.shape[:1]
        or low.shape != g.shape[1:]
        or high.shape != g.shape[1:]
    ):
        raise InputError(
            f"slope {g.shape}, value {r.shape}, bounds {low.shape} and {high.shape} do not fit "
            "together"
        )
    if (low > 0).any() or (high < 0).any() or not 0 < end < 1 or count < 2:
        raise InputError(
            f"LASSO path: each box must hold 0, end {end} be in 0..1 and count {count} 2 or more"
        )
    gram, load = g.T @ g, g.T @ r
    top = float(_pull(load, low, high).max(initial=0.0))
    penalties = top * np.geomspace(1.0, end, count)
    x, found, slack = np.zeros(g.shape[1]), [], []
    for k in penalties.tolist():  # warm start from the penalty before
        x = _descend(gram, load, k, x, low, high)
        found.append(x.copy())
        slack.append(_slack(load - gram @ x, k, x, low, high) / (top or 1.0))
    path = np.array(found)
    rest = np.sum((r[:, None] - g @ path.T) ** 2, axis=0) / max(float(r @ r), 1e-300)
    return LassoPath(penalties, path, rest, np.array(slack))


def _pull(gradient: Float, low: Float, high: Float) -> Float:
    """How strongly the residual pulls a candidate at 0 to where its box lets it go, (p,)."""
    return np.maximum(np.where(high > 0, gradient, 0.0), np.where(low < 0, -gradient, 0.0))


def _slack(gradient: Float, penalty: float, x: Float, low: Float, high: Float) -> float:
    """Largest violation of the Karush-Kuhn-Tucker conditions."""
    at_zero = np.maximum(_pull(gradient, low, high) - penalty, 0.0)
    free = gradient - penalty * np.sign(x)
    inside = np.where(
        x >= high, np.maximum(-free, 0), np.where(x <= low, np.maximum(free, 0), np.abs(free))
    )
    return float(np.where(x == 0, at_zero, inside).max(initial=0.0))


def _descend(gram: Float, load: Float, penalty: float, x: Float, low: Float, high: Float) -> Float:
    """Coordinate descent on the members; others join where the conditions ask."""
    x = x.copy()
    size = np.diag(gram)
    scale = EXACT * float(np.abs(load).max(initial=0.0))
    for _ in range(x.size + 1):
        pull = _pull(load - gram @ x, low, high)
        members = np.flatnonzero((x != 0) | (pull > penalty + scale))
        members = members[size[members] > 0]
        _sweep(gram, load, penalty, x, low, high, members)
        if not (_pull(load - gram @ x, low, high)[x == 0] > penalty + scale).any():
            break
    return x


def _sweep(
    gram: Float, load: Float, penalty: float, x: Float, low: Float, high: Float, members: Int
) -> None:
    """Cycle over the members, in place, until none moves: each has a closed form, so the loop is
    over coordinates.
    """
    inner, rest = gram[np.ix_(members, members)], load[members]
    y, size = x[members].copy(), np.diag(inner)
    tiny = EXACT * float(np.abs(load).max(initial=0.0))
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(y.size):
            pull = float(rest[i] - inner[i] @ y + size[i] * y[i])
            new = np.sign(pull) * max(abs(pull) - penalty, 0.0) / size[i]
            new = min(max(new, low[members[i]]), high[members[i]])
            moved = max(moved, abs(new - y[i]) * size[i])
            y[i] = new
        if moved <= tiny:
            break
    x[members] = y
