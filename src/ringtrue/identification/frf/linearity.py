"""Frequency and damping over the force level: is the structure linear?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import InputError
from ringtrue.shapes.mac import mac


@dataclass(frozen=True, slots=True)
class LevelCheck:
    """Settings of `level_dependence`.

    Attributes
    ----------
    significance : float
        Chance at which a linear structure is called nonlinear, in one of its modes.
    mac_min : float
        A mode of another level must be this much alike.
    shift_max : float
        And no farther in frequency than this, relative.
    """

    significance: float = 0.01
    mac_min: float = 0.7
    shift_max: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class LevelDependence:
    """The modes of the lowest level, followed over all levels.

    Attributes
    ----------
    levels : (l,) float64
        Ascending, in the unit given.
    frequency, damping : (l, m) float64, Hz and fraction of critical
        NaN where the mode was not found.
    std_frequency, std_damping : (l, m) float64
    slope_frequency, slope_damping : (m,) float64
        Relative change for each factor e of the level: d ln f/d ln F and d ln ζ/d ln F, weighted
        least squares.
    std_slope_frequency, std_slope_damping : (m,) float64
    chance_frequency, chance_damping : (m,) float64
        Chance of so much scatter over the levels in a linear structure (χ² test of equal values).
    linear : (m,) bool
        No significant change in either, among so many modes.
    """

    levels: Float
    frequency: Float
    damping: Float
    std_frequency: Float
    std_damping: Float
    slope_frequency: Float
    slope_damping: Float
    std_slope_frequency: Float
    std_slope_damping: Float
    chance_frequency: Float
    chance_damping: Float
    linear: Bool

    def __post_init__(self) -> None:
        names = [n for n in self.__dataclass_fields__ if n != "linear"]
        freeze_fields(self, linear=np.bool_, **dict.fromkeys(names, np.float64))


def level_dependence(
    levels: Sequence[float],
    found: Sequence[tuple[ModeSet, Uncertainty]],
    settings: LevelCheck | None = None,
) -> LevelDependence:
    """Follow the modes over force levels and test whether they stay.

    Parameters
    ----------
    levels : sequence of float
        Force of each result (rms, or peak of the hits), any unit, positive.
    found : sequence of (ModeSet, Uncertainty)
        Of each level, same channels.
    settings : LevelCheck, optional

    Raises
    ------
    InputError
        If there are fewer than two levels, or levels that are not positive and different.
    """
    settings = settings or LevelCheck()
    force = np.asarray(levels, dtype=np.float64)
    if (
        force.size < 2
        or force.size != len(found)
        or (force <= 0).any()
        or np.unique(force).size != force.size
    ):
        raise InputError(
            f"levels {force.tolist()} for {len(found)} results: two or more, positive, "
            "different, one each"
        )
    order = np.argsort(force)
    first = found[order[0]][0]
    values = np.full((4, force.size, len(first)), np.nan)
    last = first
    for i, k in enumerate(order):  # a handful of levels, each followed from the one before
        modes, std = found[k]
        here, there = track(last, modes, settings)
        values[:, i, here] = np.stack(
            [modes.frequencies, modes.damping, std.frequency, std.damping]
        )[:, there]
        last = _moved(last, modes, here, there)
    x = np.log(force[order])
    slope_f, dev_f, chance_f = _trend(x, values[0], values[2])
    slope_z, dev_z, chance_z = _trend(x, values[1], values[3])
    each = settings.significance / max(
        2 * np.isfinite(chance_f).sum(), 1
    )  # Bonferroni: all tests together
    linear = ~((chance_f < each) | (chance_z < each))
    f, z, std_f, std_z = values
    return LevelDependence(
        force[order], f, z, std_f, std_z, slope_f, slope_z, dev_f, dev_z, chance_f, chance_z, linear
    )


def track(a: ModeSet, b: ModeSet, settings: LevelCheck) -> tuple[Int, Int]:
    """Positions in `a` and `b` of the pairs with the largest total MAC, near in frequency."""
    b = b.rows(a.channels)
    alike = mac(a.shapes, b.shapes)
    far = np.abs(np.log(a.frequencies[:, None] / b.frequencies))
    ok = (alike >= settings.mac_min) & (far <= settings.shift_max)
    here, there = linear_sum_assignment(np.where(ok, alike - far, -1.0), maximize=True)
    good = ok[here, there]
    return here[good], there[good]


def _moved(last: ModeSet, modes: ModeSet, here: Int, there: Int) -> ModeSet:
    """`last` with the frequencies of the level just seen, so that slow drift is followed."""
    f = last.frequencies.copy()
    f[here] = modes.frequencies[there]
    return ModeSet(
        f, last.damping, last.shapes, last.labels, last.norm, last.source, last.confidence
    )


def _trend(x: Float, value: Float, std: Float) -> tuple[Float, Float, Float]:
    """Slope (m,) of ln value over x, its deviation, and the chance of equal values; NaN with fewer
    than two levels.
    """
    y, s = np.log(value), std / value
    w = np.where(np.isfinite(y) & (s > 0), 1 / np.where(s > 0, s, 1.0) ** 2, 0.0)
    y = np.where(w > 0, y, 0.0)
    total = np.where(w.sum(axis=0) > 0, w.sum(axis=0), np.nan)
    xm, ym = (w * x[:, None]).sum(axis=0) / total, (w * y).sum(axis=0) / total
    dx = x[:, None] - xm
    sxx = (w * dx**2).sum(axis=0)
    sxx = np.where((w > 0).sum(axis=0) > 1, sxx, np.nan)
    slope = (w * dx * (y - ym)).sum(axis=0) / sxx
    chance = chdtrc((w > 0).sum(axis=0) - 1, (w * (y - ym) ** 2).sum(axis=0))
    return (
        np.asarray(slope),
        np.asarray(1 / np.sqrt(sxx)),
        np.where(np.isfinite(sxx), chance, np.nan),
    )
