"""What temperature and amplitude do to a frequency followed through time, and what is left:
outliers and changes.

Model: f_t = f_0 + Σ_j b_j (x_jt − x̄_j) + steps + e_t, e_t of variance σ_t² + τ²: the stated
variance of each estimate and a scatter τ² that they share (Paule and Mandel 1982). Residuals that
hang together from stretch to stretch make coefficients less certain: with correlations r_k of the
residuals at lag k and q^k of a regressor the variance grows by 1 + 2 Σ r_k q^k (Bartlett 1935), r_k
= r_1 φ^(k−1). Outliers: externally studentised residuals against Student's t at 1 % over all
stretches (Bonferroni), one after the other. Changes: the largest excursion of the sum of residuals
against that of a Brownian bridge (Ploberger and Krämer 1992) at 1 %, with a long-run variance from
residuals about the best step. Residuals that wander for hours (r_1 above 0.7) make false changes in
up to one in ten records of three days.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.special import kolmogorov, stdtr

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.errors import InputError

LEVEL = 0.01  # of the tests, for one mode
LEAST = 6  # values on either side of a change
FEWEST = 6  # values that a slope needs
MOST_CHANGES = 5
MOST_OUTLIERS = 0.1  # of the values
_MOST_MEMORY = 0.95


@dataclass(frozen=True, slots=True)
class Change:
    """A step of the frequency that the regressors do not explain.

    Attributes
    ----------
    at : int
        Position of the first value after it.
    shift, std : float, Hz
        After less before, and its standard deviation.
    p_value : float
        Of no change at all in this part of the record.
    """

    at: int
    shift: float
    std: float
    p_value: float


@dataclass(frozen=True, slots=True, eq=False)
class EnvironmentFit:
    """A frequency against its environment.

    Attributes
    ----------
    names : tuple of str
        Regressors.
    reference, std_reference : float, Hz
        At the mean of the regressors, before any change.
    centre : (p,) float64
        Mean of each regressor.
    slope, std_slope : (p,) float64, Hz per unit
        NaN where a regressor does not vary, repeats another one or there are too few values.
    p_value : (p,) float64
        Of a slope of 0 (Student's t).
    explained : float
        Share of the weighted variance that regressors and changes explain.
    scatter : float, Hz
        τ: scatter beyond the stated standard deviations.
    memory : float
        Lag-one correlation of the residuals.
    corrected : (n,) float64, Hz
        Frequencies brought to the mean of the regressors; changes stay in.
    residual : (n,) float64
        What is left, in standard deviations; NaN where a regressor is missing.
    outlier : (n,) bool
        Left out of the fit.
    changes : tuple of Change, ascending
    """

    names: tuple[str, ...]
    reference: float
    std_reference: float
    centre: Float
    slope: Float
    std_slope: Float
    p_value: Float
    explained: float
    scatter: float
    memory: float
    corrected: Float
    residual: Float
    outlier: Bool
    changes: tuple[Change, ...]

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(
            self,
            centre=f,
            slope=f,
            std_slope=f,
            p_value=f,
            corrected=f,
            residual=f,
            outlier=np.bool_,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    beta: Float
    covariance: Float
    scatter: float
    residual: Float  # standardised
    leverage: Float


def fit_environment(
    frequency: Float, std: Float, regressors: Mapping[str, Float], at: Int | None = None
) -> EnvironmentFit:
    """Regress a frequency on its environment and look at what is left.

    Parameters
    ----------
    frequency : (n,) float64, Hz
    std : (n,) float64, Hz
        Standard deviations; NaN counts as the median of the others.
    regressors : mapping of str to (n,) float64
        Temperature, amplitude, ...; NaN where missing.
    at : (n,) int64, optional
        Stretches of the values: only neighbours tell whether residuals hang together.

    Raises
    ------
    InputError
        If lengths differ or there are fewer than three values.
    """
    y, sd = np.asarray(frequency, dtype=np.float64), np.asarray(std, dtype=np.float64)
    n = y.size
    if n < 3 or sd.shape != y.shape or any(np.shape(x) != y.shape for x in regressors.values()):
        raise InputError(
            f"{n} frequencies, std {sd.shape}: 3 or more, and one of each and of each regressor"
        )
    known = sd[np.isfinite(sd) & (sd > 0)]
    sd = np.where(
        np.isfinite(sd) & (sd > 0), sd, np.median(known) if known.size else 1e-6 * abs(y.mean())
    )
    order = np.arange(n) if at is None else np.asarray(at)
    names = tuple(regressors)
    x = (
        np.stack([np.asarray(regressors[k], dtype=np.float64) for k in names], axis=1)
        if names
        else np.zeros((n, 0))
    )
    seen = np.isfinite(x).sum(axis=0) >= FEWEST
    use: Bool = np.asarray(np.isfinite(x[:, seen]).all(axis=1))
    use = (
        use if use.sum() >= FEWEST else np.ones(n, dtype=bool)
    )  # no regressor is known often enough
    x, centre, ok = _centred(x, use)
    base = np.concatenate([np.ones((n, 1)), x[:, ok]], axis=1)
    steps = _steps(y, sd, base, use, order)
    design = np.concatenate([base, *(_step(n, k)[:, None] for k, _ in steps)], axis=1)
    outlier = _outliers(y, sd, design, use)
    good = use & ~outlier
    fit = weighted(y[good], sd[good], design[good])
    memory = memory_of(fit.residual, order[good], design.shape[1])
    infl = np.array([inflation(memory, _persistence(c, order[good])) for c in design[good].T])
    se = np.sqrt(np.maximum(np.diag(fit.covariance), 0) * infl)
    return _report(names, y, sd, design, ok, centre, steps, good, outlier & use, fit, se, memory[0])


def _centred(x: Float, use: Bool) -> tuple[Float, Float, Bool]:
    """Regressors less their means, the means, and which of them can be told from a constant and
    from each other.
    """
    p = x.shape[1]
    centre = x[use].mean(axis=0) if use.any() else np.zeros(p)
    x = np.where(use[:, None], x - centre, 0.0)
    ok = np.zeros(p, dtype=bool)
    for j in range(p):  # one or two
        part = x[use][:, [*np.flatnonzero(ok), j]]
        size = np.linalg.norm(part, axis=0)
        enough = use.sum() >= 2 * (ok.sum() + 1) + 4
        far = size[-1] > 1e-9 * max(abs(centre[j]), 1e-300) * np.sqrt(max(use.sum(), 1))
        ok[j] = enough and far and np.linalg.cond(part / np.maximum(size, 1e-300)) < 1e4
    return x, centre, ok


def _step(n: int, at: int) -> Float:
    return (np.arange(n) >= at).astype(np.float64)


def weighted(y: Float, sd: Float, x: Float) -> _Fit:
    """Least squares with weights 1/(σ² + τ²), τ such that the weighted squares sum to the degrees
    of freedom.
    """
    dof = y.size - x.shape[1]

    def solve(tau2: float) -> tuple[Float, Float, Float, Float]:
        root = 1 / np.sqrt(sd**2 + tau2)
        q, r = np.linalg.qr(x * root[:, None])
        beta = np.linalg.solve(r, q.T @ ((y - y.mean()) * root))
        return beta, (y - y.mean() - x @ beta) * root, q, r

    def excess(tau2: float) -> float:
        return float((solve(tau2)[1] ** 2).sum() - dof)

    tau2 = 0.0
    if dof > 0 and excess(0.0) > 0:
        top = max(float(np.ptp(y) ** 2), 1e-300)
        tau2 = float(brentq(excess, 0.0, 10 * top * max(1, y.size), xtol=1e-12 * top, rtol=1e-10))
    beta, residual, q, r = solve(tau2)
    beta[0] += y.mean()
    inverse = np.linalg.solve(r, np.eye(r.shape[0]))
    return _Fit(beta, inverse @ inverse.T, float(np.sqrt(tau2)), residual, (q**2).sum(axis=1))


def memory_of(residual: Float, order: Int, fitted: int) -> tuple[float, float]:
    """Correlation of residuals of neighbouring stretches, and the factor that it falls by with each
    stretch more.

    `fitted` coefficients pull the correlation down by about (1 + 3r)·fitted/n (Kendall 1954), which
    is put back. A correlation that could be chance counts as none.
    """
    e, n = residual - residual.mean(), residual.size
    power = max(float((e**2).mean()), 1e-300)
    lag = (
        [float((e[k:] * e[:-k])[order[k:] - order[:-k] == k].sum()) / (n * power) for k in (1, 2)]
        if n > 8
        else [0, 0]
    )
    one, two = (r + (1 + 3 * r) * fitted / n for r in lag)
    if one < 1.3 / np.sqrt(n):
        return 0.0, 0.0
    one = min(one, _MOST_MEMORY)
    return one, float(np.clip(two / one, one, _MOST_MEMORY))


def inflation(memory: tuple[float, float], q: float) -> float:
    """Factor 1 + 2 Σ r_k q^k on a variance, for residual correlations r_k and q^k of a
    regressor.
    """
    return 1 + 2 * memory[0] * q / (1 - memory[1] * q)


def _persistence(column: Float, order: Int) -> float:
    if np.ptp(column) == 0:
        return 1.0
    x, near = column - column.mean(), np.diff(order) == 1
    return float(np.clip((x[1:] * x[:-1])[near].sum() / max(float(x @ x), 1e-300), 0.0, 1.0))


def _steps(y: Float, sd: Float, base: Float, use: Bool, order: Int) -> list[tuple[int, float]]:
    """First position after each change and its p-value: the strongest first, then within the
    parts.
    """
    where = np.flatnonzero(use)
    y, sd, base, order = y[use], sd[use], base[use], order[use]
    found: list[tuple[int, float]] = []
    for _ in range(MOST_CHANGES):
        x = np.concatenate([base, *(_step(y.size, k)[:, None] for k, _ in found)], axis=1)
        edges = [0, *sorted(k for k, _ in found), y.size]
        if y.size <= x.shape[1] + LEAST:
            break
        trials = [_excursion(y, sd, x, order, slice(a, b)) for a, b in pairwise(edges)]
        at, p = min(trials, key=lambda t: t[1])
        if p > LEVEL / len(trials):
            break
        found.append((at, p))
    return sorted((int(where[k]), p) for k, p in found)


def _excursion(y: Float, sd: Float, x: Float, order: Int, part: slice) -> tuple[int, float]:
    """The likeliest change within a part: position of the first value after it, and the p-value of
    no change.
    """
    n = part.stop - part.start
    if n < 2 * LEAST:
        return 0, 1.0
    k = np.arange(1, n)
    inside = (k >= LEAST) & (k <= n - LEAST)
    e = _calm(weighted(y, sd, x).residual)[part]
    sums = np.cumsum(e - e.mean())[:-1]
    at = part.start + int(k[np.argmax(np.where(inside, np.abs(sums) / np.sqrt(k * (n - k)), 0.0))])
    # the variance is that about the step, or a large one would hide itself
    other = weighted(y, sd, np.concatenate([x, _step(y.size, at)[:, None]], axis=1))
    left = _calm(other.residual)
    left = left[part] - left[part].mean()
    root = 1 / np.sqrt(sd**2 + other.scatter**2)
    level, *_ = np.linalg.lstsq(x * root[:, None], y * root, rcond=None)
    e = _calm((y - x @ level) * root)[part]
    sums = np.cumsum(e - e.mean())[:-1]
    fitted = x.shape[1] + 1
    spread = (
        (left**2).sum() / max(n - fitted, 1) * inflation(memory_of(left, order[part], fitted), 1.0)
    )
    return at, float(kolmogorov(np.abs(sums).max() / np.sqrt(spread * n)))


def _calm(e: Float) -> Float:
    """Residuals with those beyond four robust standard deviations drawn in: an outlier is no
    change.
    """
    middle = float(np.median(e))
    reach = 4 * 1.4826 * float(np.median(np.abs(e - middle)))
    return np.clip(e, middle - reach, middle + reach) if reach > 0 else e


def _outliers(y: Float, sd: Float, x: Float, use: Bool) -> Bool:
    """Values that do not belong: the largest studentised residual goes while it is too large."""
    out = np.zeros(y.size, dtype=bool)
    for _ in range(int(MOST_OUTLIERS * use.sum())):
        at = np.flatnonzero(use & ~out)
        dof = at.size - x.shape[1] - 1
        if dof < 4 or np.linalg.matrix_rank(x[at]) < x.shape[1]:
            break
        fit = weighted(y[at], sd[at], x[at])
        inner = fit.residual / np.sqrt(np.maximum(1 - fit.leverage, 1e-9))
        spread = float((fit.residual**2).sum())
        outer = inner * np.sqrt(dof / np.maximum(spread - inner**2, 1e-300))
        k = int(np.argmax(np.abs(outer)))
        if 2 * stdtr(dof, -abs(outer[k])) * at.size > LEVEL:
            break
        out[at[k]] = True
    return out


def _report(
    names: tuple[str, ...],
    y: Float,
    sd: Float,
    x: Float,
    ok: Bool,
    centre: Float,
    steps: list[tuple[int, float]],
    good: Bool,
    outlier: Bool,
    fit: _Fit,
    se: Float,
    memory: float,
) -> EnvironmentFit:
    p = int(ok.sum())
    slope, std, chance = (np.full(ok.size, np.nan) for _ in range(3))
    slope[ok], std[ok] = fit.beta[1 : 1 + p], se[1 : 1 + p]
    dof = max(int(good.sum()) - x.shape[1], 1)
    chance[ok] = 2 * stdtr(dof, -np.abs(slope[ok]) / np.maximum(std[ok], 1e-300))
    known = good | outlier
    weight = 1 / (sd**2 + fit.scatter**2)
    residual = np.where(known, (y - x @ fit.beta) * np.sqrt(weight), np.nan)
    mean = float(weight[good] @ y[good] / weight[good].sum())
    total = float(weight[good] @ (y[good] - mean) ** 2)
    explained = 1 - float((residual[good] ** 2).sum()) / total if total > 0 else 0.0
    changes = tuple(
        Change(k, float(fit.beta[1 + p + i]), float(se[1 + p + i]), chance_k)
        for i, (k, chance_k) in enumerate(steps)
    )
    corrected = np.where(known, y - x[:, 1 : 1 + p] @ fit.beta[1 : 1 + p], np.nan)
    return EnvironmentFit(
        names,
        float(fit.beta[0]),
        float(se[0]),
        centre,
        slope,
        std,
        chance,
        max(explained, 0.0),
        fit.scatter,
        memory,
        corrected,
        residual,
        outlier,
        changes,
    )
