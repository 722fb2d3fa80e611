"""Modes from the poles of all orders where no standard deviation judges them: what most orders show
stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.identification import variance as var
from ringtrue.identification.cluster import cluster_poles
from ringtrue.identification.poles import PoleSet, unit
from ringtrue.identification.stabilise import seen_in_halves
from ringtrue.shapes.complexity import mpc
from ringtrue.shapes.mac import mac


def modes_of(
    poles: PoleSet,
    channels: tuple[str, ...],
    *,
    share: float = 0.5,
    damping_max: float = 0.2,
    source: str = "",
    shape_std: Float | None = None,
    deviation: Complex | None = None,
) -> tuple[ModeSet, Uncertainty]:
    """One mode for each cluster of stable poles that `share` of the orders, from the first that
    shows it, show.

    A pole is stable if the order before has one within 1 % of its frequency and 5 % of its damping
    (or four of its standard deviations, where known), MAC above 0.98. `identify.ambient` judges by
    more than this, and invents less.

    Frequency and damping are medians over the cluster, or with their standard deviations the means
    by inverse variance where these are known; the shape is that of the pole nearest to them. The
    confidence is the share of the orders times the square root of the modal phase collinearity.

    Parameters
    ----------
    poles : PoleSet
    channels : tuple of str
        Rows of the shapes.
    share : float
        0 < share <= 1.
    damping_max : float
        Poles with more are dropped.
    source : str
    shape_std : (ch, k) float64, optional
        Standard deviations of the shapes of all poles.
    deviation : (k, block) complex128, rad/s, optional
        What each block of the record does to all poles: the standard deviations then are those of
        the means.
    """
    known = _physical(poles, damping_max)
    good, moved = poles.take(known), None if deviation is None else deviation[known]
    label = cluster_poles(good.pole, good.shape, good.order)
    groups = [np.flatnonzero(label == g) for g in range(int(label.max(initial=-1)) + 1)]
    shown = np.array(
        [g.size / (poles.orders >= good.order[g].min()).sum() if g.size else 0.0 for g in groups]
    )
    groups = [g for g, s in zip(groups, shown, strict=True) if s >= share and g.size > 2]
    part = shown[[i for i, s in enumerate(shown) if s >= share and (label == i).sum() > 2]]
    rows = np.array([centre(good, g, moved) for g in groups]).reshape(len(groups), 5)
    rank = np.argsort(rows[:, 0], kind="stable")
    rows, at = rows[rank], rows[rank, 4].astype(np.int64)
    shape = unit(good.shape[:, at])
    confidence = np.clip(part[rank] * np.sqrt(mpc(shape)), 0, 1) if at.size else np.empty(0)
    modes = ModeSet(rows[:, 0], rows[:, 1], shape, channels, source=source, confidence=confidence)
    std = np.full(shape.shape, np.nan) if shape_std is None else shape_std[:, known][:, at]
    return modes, Uncertainty.independent(rows[:, 2], rows[:, 3], std)


def confirmed(modes: ModeSet, halves: tuple[PoleSet, PoleSet], duration: float) -> ModeSet:
    """The modes of a record of `duration` (s), their confidence times the root of the agreement of
    its halves.
    """
    f, zeta = modes.frequencies, modes.damping
    seen = seen_in_halves(f, zeta, modes.shapes, least_deviations(f, zeta, duration), halves)
    return replace(modes, confidence=modes.confidence * np.sqrt(seen))


def least_deviations(frequency: Float, damping: Float, duration: float) -> tuple[Float, Float]:
    """Standard deviations (m,) of frequency (Hz) and damping ratio that no method falls below
    (Gersch 1974).

    Of modes (m,) without noise in a record of `duration` s.
    """
    turns = 2 * np.pi * frequency * duration
    return frequency * np.sqrt(damping / turns), np.sqrt(damping / turns)


def _physical(poles: PoleSet, damping_max: float) -> Bool:
    """(k,) damped, not wildly complex, known to some extent, and stable from one order to the
    next.
    """
    f, z, psi = poles.frequencies, poles.damping, poles.shape
    ok = (z > 0) & (z < damping_max)
    if len(psi) > 1:
        ok &= mpc(psi) > 0.3
    known = np.isfinite(poles.std_frequency)
    ok &= ~known | ((poles.std_frequency < 0.5 * z * f) & (poles.std_damping < np.maximum(z, 2e-3)))
    step = int(np.diff(poles.orders).min(initial=2))
    before = poles.order[:, None] - poles.order == step
    reach = 0.05 + 4 * np.nan_to_num(poles.std_damping) / np.maximum(z, 1e-12)
    like = (np.abs(f[:, None] / f - 1) < 0.01) & (
        np.abs(z[:, None] - z) < (np.minimum(reach, 0.3) * z)[:, None]
    )
    return np.asarray(ok & (before & like & (mac(psi, psi) > 0.98)).any(1))


def centre(
    p: PoleSet, at: Int, deviation: Complex | None = None
) -> tuple[float, float, float, float, float]:
    """Frequency, damping, their standard deviations, and the most typical pole of the cluster `at`.

    `deviation` (k, block) are those of the poles by the blocks of the record: that of a mean over
    orders is less than that of each, as far as they do not move together.
    """
    f, z, sf, sz = p.frequencies[at], p.damping[at], p.std_frequency[at], p.std_damping[at]
    known = np.isfinite(sf).all() and (sf > 0).all()
    # relative to the damping: the variance of a pole grows with it, weights from it alone would
    # favour a small one
    w = z / (sf / f) ** 2 if known else np.ones(at.size)
    mf, mz = (float(w @ x / w.sum()) if known else float(np.median(x)) for x in (f, z))
    best = at[np.argmin((f / mf - 1) ** 2 + (0.01 * (z / mz - 1)) ** 2)]
    if deviation is not None and known and deviation.shape[1]:
        sf, sz = (
            var.std(w @ d / w.sum()) for d in var.frequency_damping(p.pole[at], deviation[at])
        )
        return mf, mz, float(sf), float(sz), float(best)
    # the orders see one record: their mean is no better known than they are in the mean
    return mf, mz, float(w @ sf / w.sum()), float(w @ sz / w.sum()), float(best)
