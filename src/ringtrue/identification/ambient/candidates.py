"""Candidate modes of a band: checks of each pole, clusters over the orders, one estimate of each.

A physical pole differs from a mathematical one by what is measured: its standard deviation, the
strength of its contribution to the correlations, the orders and the halves of the record that show
it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import stdtrit

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.identification.ambient.ssi_cov import BandPoles, transition
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.poles import PoleSet, unit
from ringtrue.identification.common.stabilisation import cluster_poles, seen_in_halves
from ringtrue.shapes.complexity import mpc

KNOWN = 0.025  # standard deviation of a frequency: of itself
WITHIN = 0.5  # and of the half bandwidth of the mode
UNEVEN = 1.2  # mean square of the power of blocks over its squared mean


@dataclass(frozen=True, slots=True, eq=False)
class CandidateModes:
    """Modes of one band before their confidence is known.

    Attributes
    ----------
    pole : (m,) complex128, rad/s
    deviation : (m, block) complex128, rad/s
        By each block of the record; the sum of squares is the variance.
    shape : (ch, m) complex128
    shape_deviation : (m, ch, block) complex128
        Of the shape by each block of the record, and by what is not known of its mixing with
        others.
    share : (m,) float64
        Fraction of the orders, from the first that shows the mode, that show it.
    orders : (m, 2) int64
        Orders that show it, orders tried.
    strength : (m,) float64
        Signal-to-noise ratio in the correlations.
    mpc : (m,) float64
    halves : (m,) float64
        Agreement of the two halves of the record, 0..1; NaN where not tried.
    label : (k,) int64
        Row of this table for each pole of the band, -1 for none.
    stable : (k,) bool
    refined : (m,) bool
        Pole and deviation are of the maximum likelihood fit.
    """

    pole: Complex
    deviation: Complex
    shape: Complex
    shape_deviation: Complex
    share: Float
    orders: Int
    strength: Float
    mpc: Float
    halves: Float
    label: Int
    stable: Bool
    refined: Bool

    def stds(self) -> tuple[Float, Float]:
        """Standard deviations of frequency (Hz) and damping ratio, each (m,)."""
        df, dz = var.frequency_damping(self.pole, self.deviation)
        return var.root_sum_square(df), var.root_sum_square(dz)

    def take(self, at: Int) -> CandidateModes:
        """The chosen rows, in the given order; `label` and `stable` stay."""
        rows = (
            "pole",
            "deviation",
            "shape_deviation",
            "share",
            "orders",
            "strength",
            "mpc",
            "halves",
            "refined",
        )
        part = {name: getattr(self, name)[at] for name in rows}
        return replace(self, **part, shape=self.shape[:, at])

    @property
    def frequencies(self) -> Float:
        """(m,) Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(m,) fraction of critical."""
        return -self.pole.real / np.abs(self.pole)


def stable_poles(
    band: BandPoles, damping_max: float = 0.2, strength: float = 2.0, collinearity: float = 0.3
) -> Bool:
    """(k,) poles worth clustering: damped, known to a few per cent, of some strength, and not
    wildly complex.
    """
    p = band.poles
    sharp = p.std_frequency < np.maximum(KNOWN, WITHIN * p.damping) * p.frequencies
    known = sharp & (p.std_damping < np.maximum(p.damping, 2e-3))
    return (
        (p.damping < damping_max)
        & known
        & (band.strength > strength)
        & (mpc(p.shape) > collinearity)
    )


def _average(band: BandPoles, at: Int) -> tuple[complex, Complex, Complex, int]:
    """Pole, deviation and shape of the poles `at` of one cluster by inverse variance, and its
    representative.
    """
    p = band.poles
    # relative to ζ: the variance of a pole grows with its damping, weights from it alone would
    # favour small damping
    v = (np.abs(band.deviation[at]) ** 2).sum(1) / np.maximum(-p.pole[at].real, 1e-12)
    w = (1 / v) / (1 / v).sum()
    pole = complex(w @ p.pole[at])
    best = int(
        at[np.argmin(np.abs(p.pole[at] - pole) ** 2 / np.abs(pole) ** 2 + 1e-4 * v / v.min())]
    )
    # low orders lack modes, whose motion goes into the shapes of those that are there
    high = p.order[at] > p.order.max() / 2
    share = w * high if high.sum() > 1 else w
    psi = p.shape[:, at]
    turn = p.shape[:, best].conj() @ psi
    return (
        pole,
        w @ band.deviation[at],
        (psi * (turn.conj() / np.abs(turn))) @ (share / share.sum()),
        best,
    )


def _shape_deviations(band: BandPoles, at: list[int]) -> Complex:
    """Deviations (m, ch, block) of the shapes of the poles `at`, their largest component 1.

    A little larger than those of the blocks: few of them know it badly, and 95 % are to lie within
    1.96 of it.
    """
    sub = band.subspace
    p = band.poles
    few = stdtrit(band.deviation.shape[1] - 1, 0.975) / 1.96
    orders = {n: transition(sub, n) for n in np.unique(p.order[at]).tolist()}
    out = np.empty((len(at), sub.channels, band.deviation.shape[1]), dtype=np.complex128)
    for row, k in zip(out, at, strict=True):  # modes
        n = int(p.order[k])
        i = int(np.argmin(np.abs(orders[n][1] - np.exp(p.pole[k] / sub.rate))))
        c = sub.u[: sub.channels, :n]
        r = sub.r[:n, :n]
        row[:] = sub.turned(few * var.shape_deviations(band.perturbations, orders[n], c, i, r))
    return out


def candidates(band: BandPoles, least: int = 4, *, driven: bool = False) -> CandidateModes:
    """Clusters of the stable poles with `least` members or more, ascending in frequency.

    The strengths of modes `driven` by events vary as these do and are not asked for.
    """
    stable = stable_poles(band, strength=0.0 if driven else 2.0)
    use = np.flatnonzero(stable)
    label = cluster_poles(band.poles.pole[use], band.poles.shape[:, use], band.poles.order[use])
    groups = [use[label == g] for g in range(int(label.max(initial=-1)) + 1)]
    groups = [g for g in groups if g.size >= least]
    means = [_average(band, g) for g in groups]
    rank = np.argsort([abs(m[0]) for m in means], kind="stable")
    groups = [groups[i] for i in rank]
    means = [means[i] for i in rank]
    return _table(band, groups, means, stable)


def groups_table(band: BandPoles, groups: list[Int]) -> CandidateModes:
    """Candidates of given groups of poles (positions), whatever the checks say of them, in the
    given order.
    """
    return _table(band, groups, [_average(band, g) for g in groups], stable_poles(band))


def _table(
    band: BandPoles,
    groups: list[Int],
    means: list[tuple[complex, Complex, Complex, int]],
    stable: Bool,
) -> CandidateModes:
    p = band.poles
    m = len(groups)
    ch = band.subspace.channels
    nb = band.deviation.shape[1]
    tried = p.orders
    label = np.full(len(p), -1, dtype=np.int64)
    for i, g in enumerate(groups):
        label[g] = i
    first = np.array([p.order[g].min() for g in groups], dtype=np.int64)
    size = np.array([g.size for g in groups], dtype=np.int64)
    possible = (tried[:, None] >= first).sum(0) if m else size
    shape = np.stack([x[2] for x in means], axis=1) if m else np.empty((ch, 0), np.complex128)
    d = _shape_deviations(band, [x[3] for x in means])
    return CandidateModes(
        pole=np.array([x[0] for x in means], dtype=np.complex128),
        deviation=np.stack([x[1] for x in means]) if m else np.empty((0, nb), np.complex128),
        shape=unit(shape),
        shape_deviation=d,
        share=size / np.maximum(possible, 1),
        orders=np.stack([size, np.full(m, tried.size)], axis=1).astype(np.int64),
        strength=np.array([np.median(band.strength[g]) for g in groups]),
        mpc=mpc(shape),
        halves=np.full(m, np.nan),
        label=label,
        stable=stable,
        refined=np.zeros(m, dtype=np.bool_),
    )


def stacked(one: CandidateModes, two: CandidateModes) -> CandidateModes:
    """The rows of two tables of one band; the second one's poles count for it."""
    wide = max(one.deviation.shape[1], two.deviation.shape[1])
    one, two = (
        replace(c, deviation=np.pad(c.deviation, ((0, 0), (0, wide - c.deviation.shape[1]))))
        for c in (one, two)
    )
    by_row = [f.name for f in fields(CandidateModes) if f.name not in ("shape", "label", "stable")]
    joined = {n: np.concatenate([getattr(one, n), getattr(two, n)]) for n in by_row}
    return CandidateModes(
        **joined,
        shape=np.concatenate([one.shape, two.shape], axis=1),
        label=np.where(two.label >= 0, two.label + one.pole.size, one.label),
        stable=one.stable,
    )


def steady(c: CandidateModes, at: Int, power: Float, seconds: float) -> bool:
    """Whether the `power` (block,) of a record of `seconds` varies no more than that of the modes
    `at` by chance.

    A spectrum takes loud blocks for more than they tell: the scatter of what is fitted to it grows
    as the mean square of the power does over its squared mean, the blocks of the subspace estimate
    are weighed.
    """
    chance = np.median(1 / (1 - c.pole.real[at] * seconds / power.size))
    return bool((power**2).mean() < (UNEVEN + 2 * chance) * power.mean() ** 2)


def half_agreement(c: CandidateModes, halves: tuple[PoleSet, PoleSet]) -> Float:
    """How far the two halves of the record show each mode, (m,) 0..1 (`seen_in_halves`)."""
    return seen_in_halves(c.frequencies, c.damping, shape=c.shape, stds=c.stds(), halves=halves)
