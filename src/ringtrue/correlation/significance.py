"""Which frequency deviations are beyond what the uncertainty of test and model allows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from ringtrue.core.arrays import Bool, Float, freeze_fields
from ringtrue.correlation.table import CorrelationTable
from ringtrue.errors import ConfigError, InputError


@dataclass(frozen=True, slots=True, eq=False)
class Significance:
    """Deviations against their combined standard deviation.

    Attributes
    ----------
    deviation : (k,) float64, Hz
    std : (k,) float64, Hz
        Combined; NaN where neither set tells its own.
    z : (k,) float64
        |deviation|/std.
    p : (k,) float64
        Chance of a larger one if the two sets had the same frequency (two-sided, normal).
    significant : (k,) bool
        With at most the share `rate` of false ones among them (Benjamini and Hochberg, 1995).
    rate : float
    """

    deviation: Float
    std: Float
    z: Float
    p: Float
    significant: Bool
    rate: float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, deviation=f, std=f, z=f, p=f, significant=np.bool_)

    @property
    def chi_square(self) -> tuple[float, int, float]:
        """Σz², the number of deviations with a standard deviation, and the chance of a larger
        sum.
        """
        known = np.isfinite(self.z)
        total, count = float((self.z[known] ** 2).sum()), int(known.sum())
        return total, count, float(chdtrc(count, total)) if count else float("nan")


def significance(
    f_a: Float,
    f_b: Float,
    std_a: Float | float = float("nan"),
    std_b: Float | float = float("nan"),
    *,
    model: float = 0.0,
    rate: float = 0.05,
) -> Significance:
    """Deviations f_B − f_A of paired modes against √(σ_A² + σ_B² + (model·f_A)²).

    Parameters
    ----------
    f_a, f_b : (k,) float64, Hz
    std_a, std_b : (k,) float64 or float, Hz
        NaN: unknown. Where one of them is known, the unknown one counts as zero.
    model : float
        Relative standard deviation that the model's form is granted.
    rate : float
        False discovery rate.

    Raises
    ------
    InputError
        If the sizes differ or a standard deviation is negative.
    ConfigError
        If `rate` is not between 0 and 1 or `model` is negative.
    """
    f_a, f_b = np.asarray(f_a, dtype=np.float64), np.asarray(f_b, dtype=np.float64)
    if f_a.shape != f_b.shape or f_a.ndim != 1:
        raise InputError(
            f"frequencies {f_a.shape} and {f_b.shape} of paired modes must be equal in number"
        )
    if not (0 < rate < 1 and model >= 0):
        raise ConfigError(f"rate {rate} (between 0 and 1), model {model} (0 or more)")
    one, two = (np.broadcast_to(np.asarray(s, dtype=np.float64), f_a.shape) for s in (std_a, std_b))
    if (one < 0).any() or (two < 0).any():
        raise InputError("a standard deviation is negative")
    variance = np.nan_to_num(one) ** 2 + np.nan_to_num(two) ** 2 + (model * f_a) ** 2
    known = (np.isfinite(one) | np.isfinite(two) | (model > 0)) & (variance > 0)
    std = np.sqrt(np.where(known, variance, np.nan))
    z = np.abs(f_b - f_a) / std
    p = 2 * ndtr(-z)
    return Significance(f_b - f_a, std, z, p, _discoveries(p, rate), rate)


def _discoveries(p: Float, rate: float) -> Bool:
    """The step-up rule of Benjamini and Hochberg over the finite p."""
    out = np.zeros(p.size, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    below = np.flatnonzero(p[order] <= rate * np.arange(1, order.size + 1) / max(order.size, 1))
    out[order[: below[-1] + 1 if below.size else 0]] = True
    return out


def table_significance(
    table: CorrelationTable,
    std_b: Float | float = float("nan"),
    *,
    model: float = 0.0,
    rate: float = 0.05,
) -> Significance:
    """`significance` of the pairs of a table; `std_b` (k,) Hz belongs to its second set."""
    return significance(table.test_hz, table.fe_hz, table.std_hz, std_b, model=model, rate=rate)
