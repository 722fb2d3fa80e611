"""Poles of all model orders, the stabilisation diagram, clusters of poles and modes of these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ringtrue.core.arrays import Bool, Complex, Float, Int, freeze_arrays
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import InputError
from ringtrue.shapes import mac, mpc

DAMPING_MAX = 0.2  # of a mode; what decays faster is the end of an impact


def unit(psi: Complex) -> Complex:
    """Shapes (ch, k) with their largest component 1."""
    top = (
        np.argmax(np.abs(psi), axis=0)[None]
        if psi.shape[1]
        else np.zeros((1, 0), dtype=np.int64)
    )
    return psi / np.take_along_axis(psi, top, axis=0)


def check_orders(ordmin: int, ordmax: int) -> None:
    """Refuse model orders that are no range.

    Raises
    ------
    InputError
        Unless 1 <= ordmin <= ordmax.
    """
    if not 1 <= ordmin <= ordmax:
        raise InputError(f"orders {ordmin}..{ordmax}: must be 1 <= ordmin <= ordmax")


@dataclass(frozen=True, slots=True, eq=False)
class PoleSet:
    """Poles of several model orders in one flat list.

    Attributes
    ----------
    order : (k,) int64
        Model order (number of states) that each pole was found at.
    pole : (k,) complex128, rad/s, Im > 0
    shape : (channel, k) complex128
        Largest component 1.
    std_frequency : (k,) float64, Hz
        Standard deviation, NaN where unknown.
    std_damping : (k,) float64
        Standard deviation of the damping ratio, NaN where unknown.
    method : str
        The estimator; empty for that of the modes.
    """

    order: Int
    pole: Complex
    shape: Complex
    std_frequency: Float
    std_damping: Float
    method: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)
        k = self.pole.size
        if self.order.size != k or self.shape.ndim != 2 or self.shape.shape[1] != k:
            raise InputError(
                f"order {self.order.shape}, pole {k}, shape {self.shape.shape}: unequal numbers "
                "of poles"
            )
        if self.std_frequency.size != k or self.std_damping.size != k:
            raise InputError(
                f"std {self.std_frequency.shape}, {self.std_damping.shape}: must be ({k},)"
            )

    def __len__(self) -> int:
        return int(self.pole.size)

    @property
    def frequencies(self) -> Float:
        """(k,) Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(k,) fraction of critical."""
        return -self.pole.real / np.abs(self.pole)

    def take(self, at: Int | Bool) -> PoleSet:
        """The chosen poles, in the given order."""
        return replace(
            self,
            order=self.order[at],
            pole=self.pole[at],
            shape=self.shape[:, at],
            std_frequency=self.std_frequency[at],
            std_damping=self.std_damping[at],
        )

    def rescaled(self, scale: Float) -> PoleSet:
        """With shapes times `scale` (channel,), their largest component 1."""
        return replace(self, shape=unit(self.shape * scale[:, None]))

    @property
    def orders(self) -> Int:
        """The different model orders, ascending."""
        return np.unique(self.order)


@dataclass(frozen=True, slots=True, eq=False)
class StableDiagram:
    """A stabilisation diagram: poles, what became of each, and a spectrum to draw behind them.

    Attributes
    ----------
    poles : PoleSet
    stable : (k,) bool
        The pole passed the checks on damping, shape and standard deviation.
    cluster : (k,) int64
        The mode (row of the mode table of the same band) that the pole belongs to, -1 for none.
    freqs : (f,) float64, Hz
    level : (value, f) float64, dB
        Up to three singular values of the spectrum behind the poles, descending; any reference.
    others : tuple of PoleSet
        Poles of other estimators, which are no modes of their own.
    """

    poles: PoleSet
    stable: Bool
    cluster: Int
    freqs: Float
    level: Float
    others: tuple[PoleSet, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if self.stable.size != len(self.poles) or self.cluster.size != len(self.poles):
            raise InputError(
                f"stable {self.stable.shape}, cluster {self.cluster.shape}: must be "
                f"({len(self.poles)},)"
            )
        if self.level.ndim != 2 or self.level.shape[1:] != self.freqs.shape:
            raise InputError(
                f"freqs {self.freqs.shape} and level {self.level.shape} must be (f,) and (value, f)"
            )


# a pole-and-shape distance within which poles of different orders are one mode
CUT = 0.08


def distances(pole: Complex, psi: Complex) -> Float:
    """(k, k) |λ_i − λ_j| / max|λ| + 1 − MAC_ij (Magalhães et al. 2009)."""
    size = np.abs(pole)
    d = np.abs(pole[:, None] - pole) / np.maximum(size[:, None], size)
    return d + np.maximum(1 - mac(psi, psi), 0.0)


def cluster_poles(pole: Complex, psi: Complex, order: Int) -> Int:
    """A label (k,) int64 for each pole, from 0, by average linkage; a label holds one pole of an
    order at most.

    The second pole of an order in a cluster is the one farther from the others: it gets -1.
    """
    if pole.size < 2:
        return np.zeros(pole.size, dtype=np.int64)
    d = distances(pole, psi)
    np.fill_diagonal(d, 0.0)
    d = 0.5 * (d + d.T)
    tree = linkage(squareform(d, checks=False), "average")
    label = np.asarray(fcluster(tree, CUT, "distance"), dtype=np.int64) - 1
    together = label[:, None] == label
    away = (d * together).sum(1)
    rank = np.lexsort((away, order, label))
    key = np.stack([label[rank], order[rank]])
    again = np.concatenate([[False], (key[:, 1:] == key[:, :-1]).all(0)])
    label[rank[again]] = -1
    return label


def modes_of(poles: PoleSet, channels: tuple[str, ...]) -> tuple[ModeSet, Uncertainty]:
    """One mode for each cluster of stable poles that half of the orders, from the first that shows
    it, show.

    A pole is stable if its damping is below 0.2 and the order before has one within 1 % of its
    frequency and 5 % of its damping (or four of its standard deviations, where known), MAC above
    0.98. `ambient.pipeline` judges by more than this, and invents less.

    Frequency and damping are medians over the cluster, or with their standard deviations the means
    by inverse variance where these are known; the shape is that of the pole nearest to them. The
    confidence is the share of the orders times the square root of the modal phase collinearity.

    Parameters
    ----------
    poles : PoleSet
    channels : tuple of str
        Rows of the shapes.
    """
    good = poles.take(_physical(poles))
    label = cluster_poles(good.pole, good.shape, good.order)
    groups = [np.flatnonzero(label == g) for g in range(int(label.max(initial=-1)) + 1)]
    groups = [g for g in groups if g.size > 2]
    shown = [g.size / (poles.orders >= good.order[g].min()).sum() for g in groups]
    groups = [g for g, share in zip(groups, shown, strict=True) if share >= 0.5]
    part = np.array([share for share in shown if share >= 0.5])
    rows = np.array([centre(good, g) for g in groups]).reshape(len(groups), 5)
    rank = np.argsort(rows[:, 0], kind="stable")
    rows, at = rows[rank], rows[rank, 4].astype(np.int64)
    shape = unit(good.shape[:, at])
    confidence = (
        np.clip(part[rank] * np.sqrt(mpc(shape)), 0, 1) if at.size else np.empty(0)
    )
    modes = ModeSet(rows[:, 0], rows[:, 1], shape, channels, confidence=confidence)
    std = np.full(shape.shape, np.nan)
    return modes, Uncertainty.independent(rows[:, 2], rows[:, 3], std)


def confirmed(
    modes: ModeSet, halves: tuple[PoleSet, PoleSet], duration: float
) -> ModeSet:
    """The modes of a record of `duration` (s), their confidence times the root of the agreement of
    its halves.
    """
    f = modes.frequencies
    zeta = modes.damping
    seen = seen_in_halves(
        f,
        zeta,
        shape=modes.shapes,
        stds=least_deviations(f, zeta, duration),
        halves=halves,
    )
    return replace(modes, confidence=modes.confidence * np.sqrt(seen))


def least_deviations(
    frequency: Float, damping: Float, duration: float
) -> tuple[Float, Float]:
    """Standard deviations (m,) of frequency (Hz) and damping ratio that no method falls below
    (Gersch 1974).

    Of modes (m,) without noise in a record of `duration` s.
    """
    turns = 2 * np.pi * frequency * duration
    return frequency * np.sqrt(damping / turns), np.sqrt(damping / turns)


def _physical(poles: PoleSet) -> Bool:
    """(k,) damped, not wildly complex, known to some extent, and stable from one order to the
    next.
    """
    f = poles.frequencies
    z = poles.damping
    psi = poles.shape
    ok = (z > 0) & (z < 0.2)
    if len(psi) > 1:
        ok &= mpc(psi) > 0.3
    known = np.isfinite(poles.std_frequency)
    sharp = (poles.std_frequency < 0.5 * z * f) & (
        poles.std_damping < np.maximum(z, 2e-3)
    )
    ok &= ~known | sharp
    step = int(np.diff(poles.orders).min(initial=2))
    before = poles.order[:, None] - poles.order == step
    reach = 0.05 + 4 * np.nan_to_num(poles.std_damping) / np.maximum(z, 1e-12)
    like = np.abs(f[:, None] / f - 1) < 0.01
    like &= np.abs(z[:, None] - z) < (np.minimum(reach, 0.3) * z)[:, None]
    like &= mac(psi, psi) > 0.98
    return np.asarray(ok & (before & like).any(1))


def centre(p: PoleSet, at: Int) -> tuple[float, float, float, float, float]:
    """Frequency, damping, their standard deviations, and the most typical pole of the cluster
    `at`.
    """
    f = p.frequencies[at]
    z = p.damping[at]
    sf = p.std_frequency[at]
    sz = p.std_damping[at]
    known = np.isfinite(sf).all() and (sf > 0).all()
    # relative to the damping: the variance of a pole grows with it, weights from it alone would
    # favour a small one
    w = z / (sf / f) ** 2 if known else np.ones(at.size)
    mf, mz = (float(w @ x / w.sum()) if known else float(np.median(x)) for x in (f, z))
    best = at[np.argmin((f / mf - 1) ** 2 + (0.01 * (z / mz - 1)) ** 2)]
    # the orders see one record: their mean is no better known than they are in the mean
    return mf, mz, float(w @ sf / w.sum()), float(w @ sz / w.sum()), float(best)


def seen_in_halves(
    frequency: Float,
    damping: Float,
    shape: Complex,
    stds: tuple[Float, Float],
    halves: tuple[PoleSet, PoleSet],
) -> Float:
    """How far the two halves of the record show modes, (m,) 0..1.

    The share of orders of the poorer half with a pole within the statistical distance, times the
    MAC of the halves.

    Parameters
    ----------
    frequency, damping : (m,) float64, Hz and ratio
    shape : (ch, m) complex128
    stds : two (m,) float64
        Standard deviations of both.
    halves : two PoleSet
    """
    (share_1, psi_1), (share_2, psi_2) = (
        _seen(frequency, damping, shape=shape, stds=stds, h=h) for h in halves
    )
    same = np.abs((psi_1.conj() * psi_2).sum(0)) ** 2
    size = (np.abs(psi_1) ** 2).sum(0) * (np.abs(psi_2) ** 2).sum(0)
    return np.asarray(
        np.minimum(share_1, share_2)
        * same
        / np.maximum(size, np.finfo(np.float64).tiny)
    )


def _seen(
    frequency: Float,
    damping: Float,
    shape: Complex,
    stds: tuple[Float, Float],
    h: PoleSet,
) -> tuple[Float, Complex]:
    """Share of orders of one half that show each mode, and its mean shape there (ch, m)."""
    df = np.abs(h.frequencies[:, None] - frequency)
    dz = np.abs(h.damping[:, None] - damping)
    reach = np.maximum(
        np.maximum(4 * np.sqrt(2) * stds[0], 0.1 * damping * frequency),
        2e-4 * frequency,
    )
    width = np.maximum(np.maximum(5 * np.sqrt(2) * stds[1], 0.2 * damping), 2e-3)
    shape_like = mac(h.shape, shape)
    like = (df < reach) & (dz < width) & (shape_like > 0.7)
    # half a record may split a mode in two; with three channels any shape is like any other
    if len(h.shape) > 3:
        reach = np.where(shape_like > 0.99, 2.0, 0.7) * damping * frequency
        like |= (
            (df < reach) & (dz < np.maximum(width, 0.5 * damping)) & (shape_like > 0.95)
        )
    share = np.array([np.unique(h.order[x]).size for x in like.T]) / max(
        h.orders.size, 1
    )
    turn = (shape.conj().T @ h.shape).T
    phase = np.where(like, turn.conj() / np.maximum(np.abs(turn), 1e-300), 0)
    return share, h.shape @ phase
