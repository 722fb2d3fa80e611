"""How much to trust the prior (W_p) and the data (W): L-curve, generalised cross-validation,
evidence.

All rules for W_p choose one factor γ on a given W_p for the problem linearised at the current
point, min ‖r + Gx₀ − Gx‖² + γ xᵀW_p x, and `regularised` repeats choice and updating until the
factor stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import Literal

import numpy as np
from scipy import linalg
from scipy.optimize import minimize_scalar

from ringtrue.core.arrays import Float
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.updating.problem import (
    Evaluated,
    Problem,
    Residual,
    data_used_up,
    residual_at,
)
from ringtrue.updating.solver import Method, Solution, solve
from ringtrue.updating.target import Weights
from ringtrue.updating.uncertainty import errors_of_shapes

Rule = Literal["l-curve", "gcv", "evidence"]
# factors tried, in units of the median squared singular value
GRID = np.logspace(-8, 8, 161)


@dataclass(frozen=True, slots=True)
class DiscrepancySearch:
    """How the error of the model's form is found.

    Attributes
    ----------
    settled : float
        Relative change of the factor below which it stands.
    turns : int
        Updatings with the discrepancy found, at most.
    tight : float
        Lower limit of the discrepancy found, in units of the assumed one.
    loose : float
        Upper limit.
    """

    settled: float = 0.1
    turns: int = 8
    tight: float = 0.05
    loose: float = 3.0


DISCREPANCY = DiscrepancySearch()


@dataclass(frozen=True, slots=True, eq=False)
class Standard:
    """A linear problem in standard form, min ‖b − Σ u s v‖² + γ ‖·‖².

    Attributes
    ----------
    singular : (k,) float64
        Of G W_p^{-½}.
    along : (k,) float64
        Uᵀb.
    rest : float
        ‖b‖² outside the range of G.
    rows : int
        Number of residuals.
    """

    singular: Float
    along: Float
    rest: float
    rows: int

    def terms(self, factor: Float) -> tuple[Float, Float, Float]:
        """‖b − Gx‖² (n,), xᵀW_p x (n,) and the trace of the hat matrix (n,) for factors γ (n,)."""
        s2 = self.singular**2
        g = np.asarray(factor)[:, None]
        misfit = self.rest + ((g / (s2 + g) * self.along) ** 2).sum(axis=1)
        size = ((self.singular / (s2 + g) * self.along) ** 2).sum(axis=1)
        return misfit, size, (s2 / (s2 + g)).sum(axis=1)


def standard(slope: Float, value: Float, x: Float, precision: Float) -> Standard:
    """The standard form at x (q,) of residuals (r,) with slopes (r, q) and W_p (q, q), positive
    definite.
    """
    root = linalg.cholesky(precision)
    u, s, _ = linalg.svd(
        linalg.solve_triangular(root, slope.T, trans="T").T, full_matrices=False
    )
    if not s.any():
        raise InputError(
            "no residual depends on a parameter: there is nothing to weigh"
        )
    b = value + slope @ x
    along = u.T @ b
    return Standard(s, along, max(float(b @ b - along @ along), 0.0), b.size)


def l_curve(problem: Standard) -> float:
    """γ at the corner: largest curvature of ln ‖x‖ over ln ‖b − Gx‖. Hansen and O'Leary (1993),
    sec. 4.

    Between the squares of the least and the largest singular value: outside nothing changes but
    rounding.
    """
    s = problem.singular[problem.singular > 1e-8 * problem.singular.max()]
    g = np.geomspace(float(s.min()) ** 2, max(s.max(), 1.1 * float(s.min())) ** 2, 201)
    misfit, size, _ = problem.terms(g)
    t = np.log(g)
    x = 0.5 * np.log(np.maximum(misfit, 1e-300))
    y = 0.5 * np.log(np.maximum(size, 1e-300))
    dx = np.gradient(x, t)
    dy = np.gradient(y, t)
    bend = (dx * np.gradient(dy, t) - dy * np.gradient(dx, t)) / np.maximum(
        (dx**2 + dy**2) ** 1.5, 1e-12
    )
    inner = slice(2, -2)  # one-sided differences bend
    return float(g[inner][np.argmax(np.abs(bend[inner]) * (bend[inner] > 0))])


def gcv(problem: Standard) -> float:
    """γ of least generalised cross-validation r ‖b − Gx‖²/(r − trace)². Golub, Heath and Wahba
    (1979), eq. 1.4.
    """

    def score(g: Float) -> Float:
        misfit, _, spent = problem.terms(g)
        kept = np.maximum(problem.rows - spent, 1e-12)
        return np.asarray(problem.rows * misfit / kept**2)

    return _least(problem, score)


def evidence(problem: Standard) -> float:
    """γ = σ²_data/σ²_prior of largest marginal likelihood, the common scale of both integrated out
    at its best value.

    −2 ln p = r ln(bᵀ(I + GW_p⁻¹Gᵀ/γ)⁻¹b) + ln det(I + GW_p⁻¹Gᵀ/γ). MacKay (1992), sec. 4.
    """

    def score(g: Float) -> Float:
        swell = 1 + problem.singular**2 / g[:, None]
        square = problem.rest + (problem.along**2 / swell).sum(axis=1)
        misfit = problem.rows * np.log(np.maximum(square, 1e-300))
        return np.asarray(misfit + np.log(swell).sum(axis=1))

    return _least(problem, score)


def _least(problem: Standard, score: Callable[[Float], Float]) -> float:
    """The factor of the least score: of the grid, then between the neighbours there."""
    g = GRID * float(np.median(problem.singular[problem.singular > 0]) ** 2)
    i = int(np.argmin(score(g)))
    if i in (0, g.size - 1):
        return float(g[i])
    span = (np.log(g[i - 1]), np.log(g[i + 1]))
    found = minimize_scalar(
        lambda t: float(score(np.exp([t]))[0]), bounds=span, method="bounded"
    )
    return float(np.exp(found.x))


RULES: dict[str, Callable[[Standard], float]] = {
    "l-curve": l_curve,
    "gcv": gcv,
    "evidence": evidence,
}


@dataclass(frozen=True, slots=True, eq=False)
class Regularised:
    """An updating whose W_p was scaled by a rule.

    Attributes
    ----------
    solution : Solution
    settled : bool
        False: the factor still moved at the last round.
    """

    solution: Solution
    settled: bool


ROUNDS = 20  # of choosing the factor and updating


def regularised(
    problem: Problem,
    rule: Rule,
    method: Method | None = None,
    *,
    start: Float | None = None,
) -> Regularised:
    """Choose the factor on W_p and update, in turns.

    Raises
    ------
    ConfigError
        If there is no such rule.
    """
    if rule not in RULES:
        raise ConfigError(
            f"no rule for the weight of the prior {rule!r}{did_you_mean(rule, RULES)}"
        )
    factor = 1.0
    done = solve(problem, method, start=start)
    for i in range(ROUNDS):
        r, g = problem.weighted(done.end)
        wanted = RULES[rule](standard(g, r, done.y, problem.linked_precision))
        # the choice changes the linearisation that it rests on: shrinking steps keep the two from
        # chasing one another
        before = factor
        factor = (
            wanted if i == 0 else float(before * (wanted / before) ** (1 / (i + 1)))
        )
        now = replace(problem, precision=factor * problem.precision)
        done = solve(now, method, start=done.y)
        if i > 0 and abs(np.log(factor / before)) < DISCREPANCY.settled:
            return Regularised(done, settled=True)
    return Regularised(done, settled=False)


def discrepancy_by_evidence(at: Evaluated, problem: Problem) -> Float:
    """Factors s (k,) on the standard deviations of kinds of residuals that make the data most
    likely.

    The data are Gaussian with covariance S² + G W_p⁻¹ Gᵀ about the linearisation at the point; S²
    is block-wise s². Rows of one datum share it: of a shape with n channels each row has the
    variance s²/n, since it is its square sum, 1 − MAC, that has the expectation s². Multiply the
    standard deviations of `Weights` by s (1 − MAC by s²).

    Parameters
    ----------
    at : Evaluated
    problem : Problem
    """
    kinds, kind = np.unique(at.kind, return_inverse=True)
    b = at.value + at.slope @ at.y
    inner = at.slope @ linalg.solve(
        problem.linked_precision, at.slope.T, assume_a="pos"
    )
    unit = 1.0 / np.bincount(at.datum)[at.datum]  # variance of a row in units of s²
    scale = np.ones(kinds.size)

    def unlikely(log: float, i: int) -> float:
        """−2 ln p of the data with ln s of one kind, without the constant."""
        trial = scale.copy()
        trial[i] = np.exp(log)
        factor = linalg.cholesky(np.diag(trial[kind] ** 2 * unit) + inner, lower=True)
        z = linalg.solve_triangular(factor, b, lower=True)
        return float(z @ z + 2 * np.log(np.diag(factor)).sum())

    for _ in range(20):  # coordinate ascent
        before = scale.copy()
        for i in range(kinds.size):
            found = minimize_scalar(
                unlikely,
                args=(i,),
                bounds=(-6.0, 6.0),
                method="bounded",
            )
            scale[i] = np.exp(found.x)
        if np.abs(np.log(scale / before)).max() < 1e-3:
            break
    return scale


def left_over(
    assumed: Weights, r: Residual, slope: Float, data: float, independent: float
) -> Weights:
    """With the relative frequency and 1 − MAC that an updating leaves, over the data that its
    parameters have not used.

    Parameters
    ----------
    assumed : Weights
        Before any were found: what is found lies between `DISCREPANCY.tight` and
        `DISCREPANCY.loose` times these.
    r : Residual
        At the end of the updating.
    slope : (r, k) float64
        Of `r.value`, in units of the prior, to what was updated.
    data : float
        Number of data that a mode gave.
    independent : float
        Number of independent errors in a shape (`uncertainty.errors_of_shapes`).
    """
    n = int(r.used.sum())
    if not n:
        loose = DISCREPANCY.loose
        return replace(
            assumed, frequency=loose * assumed.frequency, mac=loose * assumed.mac
        )
    spent = data_used_up(slope.T @ slope, np.eye(slope.shape[1]))
    swell = data * n / max(data * n - spent, 1.0)
    f = float(np.sqrt(np.mean(r.frequency_error[r.used] ** 2) * swell))
    m = float(np.mean(1 - r.mac[r.used]) * swell)
    low = np.array(
        [DISCREPANCY.tight * assumed.frequency, DISCREPANCY.tight**2 * assumed.mac]
    )
    high = DISCREPANCY.loose * np.array([assumed.frequency, assumed.mac])
    f, m = np.clip([f, m], low, high).tolist()
    return replace(
        assumed,
        frequency=f,
        mac=m,
        independent=independent,
    )


def distance(a: Weights, b: Weights) -> float:
    """The largest change of the logarithm of a weight."""
    return max(
        abs(float(np.log(p / q)))
        for p, q in zip(astuple(a), astuple(b), strict=True)
        if q
    )


def left_at(problem: Problem, y: Float) -> Weights:
    """The weights with the discrepancies that an updating has left at y (q,); shapes as in the
    first configuration.
    """
    at = problem.evaluate(y)
    first = problem.configurations[0].target
    r = residual_at(problem, y)
    prior = np.sqrt(np.diag(np.linalg.inv(problem.linked_precision)))
    many = errors_of_shapes(first, at.points[0].now)
    return left_over(first.weights, r, at.slope * prior, first.weights.data, many)
