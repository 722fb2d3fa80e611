"""Frequencies of one structure on several days, at several temperatures and levels of vibration.

For each mode ln f = c + a·T + b·log10(v), by weighted least squares over the records: T is the
temperature, v the level of the mode. Records of the same channels share c, since their levels
compare. What all modes do with the temperature, or the level, is the mean of their a, or b, with
the variance between them (DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import stats

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int

CHANCE = 0.01  # that a finding is none
FEWEST = 3  # modes that a drift of all is drawn from
# ranges below which nothing is asked: K, and decades of the level
LEAST_RANGE = (1.0, 0.3)


@dataclass(frozen=True, slots=True, eq=False)
class RepeatedModes(FrozenArrays):
    """Modes that several records show.

    Attributes
    ----------
    frequency, std : (r, m) float64, Hz
        NaN where a record does not show a mode.
    level : (r, m) float64, m/s
        RMS velocity of each mode in each record; NaN where it is not known.
    temperature : (r,) float64, °C
        NaN where it was not noted down.
    place : (r,) int64
        Records of one number have the same channels.
    """

    frequency: Float
    std: Float
    level: Float
    temperature: Float
    place: Int


@dataclass(frozen=True, slots=True, eq=False)
class ConditionSlopes(FrozenArrays):
    """What the conditions do to each mode; NaN where the records do not show it.

    Attributes
    ----------
    per_kelvin, per_kelvin_std : (m,) float64, 1/K
        Relative change of the frequency.
    per_decade, per_decade_std : (m,) float64
        The same a decade of level.
    decades : (m,) float64
        Range of the levels within records of the same channels.
    scatter : float
        Deviations from the fit over the stated standard deviations, robust; these were widened by
        it, or by the RMS of the mode's own where this is larger, but not made smaller.
    """

    per_kelvin: Float
    per_kelvin_std: Float
    per_decade: Float
    per_decade_std: Float
    decades: Float
    scatter: float

    @property
    def bent(self) -> Bool:
        """(m,) modes whose frequency depends on the level, each by itself, with `CHANCE`."""
        z = np.nan_to_num(np.abs(self.per_decade) / self.per_decade_std)
        return z > stats.norm.isf(CHANCE / 2)

    @property
    def drift(self) -> CommonSlope | None:
        """What all modes do with the temperature, a kelvin; None where no record shows it."""
        return common_slope(self.per_kelvin, self.per_kelvin_std)

    @property
    def dependence(self) -> CommonSlope | None:
        """What all modes do with the level, a decade; None where no record shows it."""
        return common_slope(self.per_decade, self.per_decade_std)


@dataclass(frozen=True, slots=True)
class CommonSlope:
    """What all modes do with a condition.

    Attributes
    ----------
    value, std : float
        Relative change of the frequency a unit of the condition.
    modes : int
    evidence : float
        Sum of their values over their deviations, over the root of their number (Stouffer 1949):
        normal if no mode does anything.
    """

    value: float
    std: float
    modes: int
    evidence: float

    @property
    def proven(self) -> bool:
        """Whether chance makes as much in less than `CHANCE`."""
        return self.modes >= FEWEST and abs(self.evidence) > stats.norm.isf(CHANCE / 2)


def condition_slopes(seen: RepeatedModes) -> ConditionSlopes:
    """Fit each mode; the scatter is that of all modes."""
    fits = [_fit(seen, m) for m in range(seen.frequency.shape[1])]
    z = np.concatenate([np.zeros(0), *(f.z for f in fits)])
    scatter = 1.4826 * float(np.median(np.abs(z))) if z.size else 0.0
    own = [float(np.sqrt(np.mean(f.z**2))) if f.z.size else 1.0 for f in fits]
    wide = np.maximum(max(scatter, 1.0), own)[:, None]
    slope = np.array([f.slope for f in fits]).reshape(-1, 2)
    std = wide * np.array([f.std for f in fits]).reshape(-1, 2)
    decades = np.array([f.decades for f in fits])
    return ConditionSlopes(
        per_kelvin=slope[:, 0],
        per_kelvin_std=std[:, 0],
        per_decade=slope[:, 1],
        per_decade_std=std[:, 1],
        decades=decades,
        scatter=scatter,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _ModeFit:
    """Slopes (2,) with T and with log10(v), their deviations, deviations (k,) over the stated ones,
    and the range of levels.
    """

    slope: Float
    std: Float
    z: Float
    decades: float


def _fit(seen: RepeatedModes, mode: int) -> _ModeFit:
    """By weighted least squares over the records that show the mode."""
    f = seen.frequency[:, mode]
    rows = np.flatnonzero(np.isfinite(f) & (seen.std[:, mode] > 0))
    _, place = np.unique(seen.place[rows], return_inverse=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.log10(seen.level[rows, mode])
    conditions = np.stack([seen.temperature[rows], level], axis=1)
    ranges = np.zeros(2)  # the largest among records of one place
    for p in np.unique(place):
        ranges = np.fmax(ranges, np.ptp(conditions[place == p], axis=0))
    ranges = np.where(np.isfinite(conditions).all(axis=0), ranges, 0.0)
    asked = ranges >= LEAST_RANGE
    columns = conditions[:, asked] - conditions[:, asked].mean(axis=0, keepdims=True)
    design = np.concatenate([np.eye(place.max(initial=-1) + 1)[place], columns], axis=1)
    nothing = np.full(2, np.nan)
    unknown = _ModeFit(nothing, nothing, np.zeros(0), float(ranges[1]))
    if not asked.any() or np.linalg.matrix_rank(design) < design.shape[1]:
        return unknown
    sigma = seen.std[rows, mode] / f[rows]
    weighed = design / sigma[:, None]
    y = np.log(f[rows] / f[rows].mean()) / sigma
    q, r = np.linalg.qr(weighed)
    x = np.linalg.solve(r, q.T @ y)
    spread = np.linalg.norm(np.linalg.inv(r), axis=1)
    left = 1 - (q**2).sum(axis=1)  # of its variance that a residual keeps
    free = left > 1e-6
    z = ((y - weighed @ x)[free]) / np.sqrt(left[free])
    slope = nothing.copy()
    std = nothing.copy()
    slope[asked] = x[design.shape[1] - columns.shape[1] :]
    std[asked] = spread[design.shape[1] - columns.shape[1] :]
    return _ModeFit(slope, std, z, float(ranges[1]))


def common_slope(slope: Float, std: Float) -> CommonSlope | None:
    """The mean of all modes (m,), by their variance and that between them; None without one."""
    known = np.isfinite(slope)
    n = int(known.sum())
    if not n:
        return None
    a = slope[known]
    variance = std[known] ** 2
    w = 1 / variance
    mean = float(w @ a / w.sum())
    excess = float(w @ (a - mean) ** 2) - (n - 1)
    between = max(excess, 0.0) / max(float(w.sum() - (w @ w) / w.sum()), 1e-300)
    w = 1 / (variance + between)
    return CommonSlope(
        value=float(w @ a / w.sum()),
        std=float(1 / np.sqrt(w.sum())),
        modes=n,
        evidence=float((a / std[known]).sum() / np.sqrt(n)),
    )


def day_scatter(
    seen: RepeatedModes, days: Sequence[str], kinds: Sequence[str]
) -> tuple[float, int]:
    """Relative standard deviation with which a test repeats frequencies on another day, and in how
    many modes; NaN and 0 where none was repeated.

    The deviations of two days have √2 times that of each; it is taken from their median.

    Parameters
    ----------
    seen : RepeatedModes
    days, kinds : sequence (r) of str
        Date and excitation of each record; the same kind at the same channels is a repeated test.
    """
    off = []
    for i, k in combinations(range(len(days)), 2):
        again = (
            days[i] != days[k]
            and kinds[i] == kinds[k]
            and seen.place[i] == seen.place[k]
        )
        if again and days[i] and days[k]:
            ratio = seen.frequency[k] / seen.frequency[i] - 1
            off.append(np.abs(ratio[np.isfinite(ratio)]))
    every = np.concatenate([np.zeros(0), *off])
    if not every.size:
        return float("nan"), 0
    most = max(x.size for x in off)
    return float(1.4826 * np.median(every) / np.sqrt(2)), most
