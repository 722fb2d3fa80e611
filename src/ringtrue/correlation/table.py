"""The table of a correlation: paired modes side by side.

Which frequency deviations are beyond what the uncertainty of test and model allows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import chdtrc, ndtr

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.display import Displayed
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.pairing import Pairing
from ringtrue.errors import InputError
from ringtrue.shapes import NIL, above_rounding, mac

__all__ = ["CorrelationRow", "CorrelationTable", "correlation_table"]


@dataclass(frozen=True, slots=True)
class CorrelationRow:
    """One pair; mode numbers count from 1."""

    test: int
    fe: int
    test_hz: float
    fe_hz: float
    deviation_percent: float
    deviation_hz: float
    mac_percent: float
    subspace_mac_percent: float
    used: bool
    subspace: bool
    beyond: bool
    significance: float


@dataclass(frozen=True, slots=True, eq=False)
class CorrelationTable(Displayed, FrozenArrays):
    """Paired modes side by side.

    Attributes
    ----------
    pairing : Pairing
    test_hz, fe_hz : (k,) float64, Hz, of the pairs
    std_hz : (k,) float64, Hz
        Standard deviation of the test frequency; NaN where unknown.
    used : (k,) bool
        The pair takes part in updating (others are left out to check it).
    mac : (test, fe) float64, 0..1
        All combinations of single shapes; 0 for modes that do not move the channels.
    all_test_hz, all_fe_hz : (test,), (fe,) float64, Hz
    names : tuple of str
        What the two sets are called.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "test_hz": "Hz",
        "fe_hz": "Hz",
        "deviation_percent": "%",
        "mac_percent": "%",
        "subspace_mac_percent": "%",
    }

    pairing: Pairing
    test_hz: Float
    fe_hz: Float
    std_hz: Float
    used: Bool
    mac: Float
    all_test_hz: Float
    all_fe_hz: Float
    names: tuple[str, str] = ("test", "FE")

    def __len__(self) -> int:
        return int(self.test_hz.size)

    def displayed(self) -> Mapping[str, Any]:
        """The pairs."""
        pairs = {"test": self.pairing.a + 1, "fe": self.pairing.b + 1}
        names = (*self.UNITS, "used")
        return pairs | {name: getattr(self, name) for name in names}

    @property
    def frequency_only(self) -> bool:
        """Whether frequencies alone were measured."""
        return not self.mac.size and bool(self.all_test_hz.size)

    @property
    def deviation_hz(self) -> Float:
        """f_FE − f_test, (k,) Hz."""
        return self.fe_hz - self.test_hz

    @property
    def deviation_percent(self) -> Float:
        """(f_FE − f_test)/f_test, (k,) %."""
        return 100 * self.deviation_hz / np.maximum(np.abs(self.test_hz), NIL)

    @property
    def mac_percent(self) -> Float:
        """MAC of the two single shapes of each pair, as in the matrix, (k,) %; NaN without
        shapes.
        """
        if not self.mac.size:
            return np.full(len(self), np.nan)
        return 100 * self.mac[self.pairing.a, self.pairing.b]

    @property
    def subspace_mac_percent(self) -> Float:
        """The same with close modes rotated inside their subspace towards the test, (k,) %.

        Close modes mix at the smallest change of the structure: their single shapes need not agree
        where their subspaces do. Equal to `mac_percent` for pairs that belong to no such group.
        """
        return 100 * self.pairing.mac

    @property
    def significance(self) -> Float:
        """|Δf| in standard deviations of the test frequency, (k,); NaN where that is unknown."""
        return np.abs(self.deviation_hz) / self.std_hz

    def mean_deviation(self, which: Bool | None = None) -> float:
        """Mean |Δf|, %, of the pairs `which` (all); NaN without a pair."""
        return _over(np.mean, np.abs(self.deviation_percent), which)

    def max_deviation(self, which: Bool | None = None) -> float:
        """Largest |Δf|, %."""
        return _over(np.max, np.abs(self.deviation_percent), which)

    def mean_mac(self, which: Bool | None = None) -> float:
        """Mean MAC of single shapes, %."""
        return _over(np.mean, self.mac_percent, which)

    def min_mac(self, which: Bool | None = None) -> float:
        """Smallest MAC of single shapes, %."""
        return _over(np.min, self.mac_percent, which)

    def mean_subspace_mac(self, which: Bool | None = None) -> float:
        """Mean subspace MAC, %."""
        return _over(np.mean, self.subspace_mac_percent, which)

    def min_subspace_mac(self, which: Bool | None = None) -> float:
        """Smallest subspace MAC, %."""
        return _over(np.min, self.subspace_mac_percent, which)

    def rows(self) -> tuple[CorrelationRow, ...]:
        """The pairs in ascending test mode."""
        columns = (
            self.pairing.a + 1,
            self.pairing.b + 1,
            self.test_hz,
            self.fe_hz,
            self.deviation_percent,
            self.deviation_hz,
            self.mac_percent,
            self.subspace_mac_percent,
            self.used,
            self.pairing.subspace,
            self.pairing.beyond,
            self.significance,
        )
        return tuple(
            CorrelationRow(*row)
            for row in zip(*(c.tolist() for c in columns), strict=True)
        )


def _over(reduce: object, values: Float, which: Bool | None) -> float:
    chosen = values if which is None else values[which]
    return float(reduce(chosen)) if chosen.size and callable(reduce) else float("nan")


def correlation_table(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    *,
    std_hz: Float | None = None,
    left_out: Sequence[int] | Int = (),
    names: tuple[str, str] = ("test", "FE"),
) -> CorrelationTable:
    """The table of a pairing.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired.
    pairing : Pairing
    std_hz : (ma,) float64, Hz, optional
        Standard deviations of the frequencies of A.
    left_out : sequence of int
        Positions in A that take no part in updating.
    """
    b = b.rows(a.channels)
    std = (
        np.full(len(a), np.nan)
        if std_hz is None
        else np.asarray(std_hz, dtype=np.float64)
    )
    everything: Float = np.full((len(a), len(b)), np.nan)
    if a.channels:
        everything = mac(above_rounding(a.shapes), above_rounding(b.shapes))
    return CorrelationTable(
        pairing=pairing,
        test_hz=a.frequencies[pairing.a],
        fe_hz=b.frequencies[pairing.b],
        std_hz=std[pairing.a],
        used=~np.isin(pairing.a, np.asarray(left_out, dtype=np.int64)),
        mac=everything,
        all_test_hz=a.frequencies,
        all_fe_hz=b.frequencies,
        names=names,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Significance(FrozenArrays):
    """Deviations against their combined standard deviation.

    Attributes
    ----------
    deviation : (k,) float64, Hz
    std : (k,) float64, Hz
        Combined; NaN where neither set has its own.
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

    @property
    def chi_square(self) -> tuple[float, int, float]:
        """Σz², the number of deviations with a standard deviation, and the chance of a larger
        sum.
        """
        known = np.isfinite(self.z)
        total = float((self.z[known] ** 2).sum())
        count = int(known.sum())
        return total, count, float(chdtrc(count, total)) if count else float("nan")


RATE = 0.05  # of false ones among the deviations that are called significant


def significance(
    f_a: Float,
    f_b: Float,
    std_a: Float | float = float("nan"),
    std_b: Float | float = float("nan"),
) -> Significance:
    """Deviations f_B − f_A of paired modes against √(σ_A² + σ_B²).

    Parameters
    ----------
    f_a, f_b : (k,) float64, Hz
    std_a, std_b : (k,) float64 or float, Hz
        NaN: unknown. Where one of them is known, the unknown one counts as zero.

    Raises
    ------
    InputError
        If the sizes differ or a standard deviation is negative.
    """
    f_a = np.asarray(f_a, dtype=np.float64)
    f_b = np.asarray(f_b, dtype=np.float64)
    if f_a.shape != f_b.shape or f_a.ndim != 1:
        raise InputError(
            f"frequencies {f_a.shape} and {f_b.shape} of paired modes must be equal in number"
        )
    one, two = (
        np.broadcast_to(np.asarray(s, dtype=np.float64), f_a.shape)
        for s in (std_a, std_b)
    )
    if (one < 0).any() or (two < 0).any():
        raise InputError("a standard deviation is negative")
    variance = np.nan_to_num(one) ** 2 + np.nan_to_num(two) ** 2
    known = (np.isfinite(one) | np.isfinite(two)) & (variance > 0)
    std = np.sqrt(np.where(known, variance, np.nan))
    z = np.abs(f_b - f_a) / std
    p = 2 * ndtr(-z)
    return Significance(
        deviation=f_b - f_a,
        std=std,
        z=z,
        p=p,
        significant=_discoveries(p),
        rate=RATE,
    )


def _discoveries(p: Float) -> Bool:
    """The step-up rule of Benjamini and Hochberg over the finite p."""
    out = np.zeros(p.size, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    below = np.flatnonzero(
        p[order] <= RATE * np.arange(1, order.size + 1) / max(order.size, 1)
    )
    out[order[: below[-1] + 1 if below.size else 0]] = True
    return out


def repeatability(table: CorrelationTable | None) -> float:
    """Relative standard deviation with which one test repeats the frequencies of another.

    The deviations of two tests have √2 times that of each. It is taken from their median,
    1.4826 median |d| / √2 (Hampel, 1974), so that a wrong pair says nothing.

    Parameters
    ----------
    table : CorrelationTable or None
        Two tests of one structure; None where there is one.

    Returns
    -------
    float
        NaN without a pair.
    """
    if table is None or not len(table):
        return float("nan")
    deviation = np.abs(table.fe_hz / table.test_hz - 1)
    return float(1.4826 * np.median(deviation) / np.sqrt(2))


def table_significance(
    table: CorrelationTable, repeats: float = float("nan")
) -> Significance:
    """`significance` of the pairs of a table, whose second set is known exactly.

    Parameters
    ----------
    table : CorrelationTable
        A test and a model.
    repeats : float
        `repeatability` of the test: no frequency is known better than it was repeated. Where the
        test states no standard deviation this is the one; NaN: nothing was repeated.
    """
    return significance(
        table.test_hz, table.fe_hz, np.fmax(table.std_hz, repeats * table.test_hz)
    )
