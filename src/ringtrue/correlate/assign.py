"""One global assignment of modes over MAC and frequency, on arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.errors import ConfigError
from ringtrue.shapes.mac import mac, paired_mac
from ringtrue.shapes.subspace import close_groups, rotation, subspace_mac

TIE = 1e-3
LOCKED = 1e6  # worth of a forced pair, above that of all others together
APART = 4.0  # times the distance of close modes: as far may be in B what is close in A
SOFT = 0.02  # 1 − MAC below this brings no further gain: it is noise
HOLD = 0.5  # of the MAC gate: a shape that matches less is another, which no rotation mends; of 1/frequency gate


@dataclass(frozen=True, slots=True)
class PairingSettings:
    """Gates of the pairing.

    Attributes
    ----------
    mac_gate : float
        Least MAC of a pair.
    frequency_gate : float
        Largest |f_B − f_A|/f_A of a pair.
    close : float
        Relative distance below which neighbours of one set are one subspace.
    distinct : float
        Shapes that match one to one with a MAC from here on are not rotated, however close they are.
    largest_group : int
        Most modes in one subspace.
    min_confidence : float
        Modes of A with less are left unpaired.
    min_visible : float
        Modes of B with a smaller share of motion where sensors sit are left unpaired (if the shares are passed).
    faint : float
        Mass-normalised modes of B whose largest component at the sensors is below this share of the median
        mode's are not observable.
    """

    mac_gate: float = 0.6
    frequency_gate: float = 0.4
    close: float = 0.02
    distinct: float = 0.9
    largest_group: int = 4
    min_confidence: float = 0.5
    min_visible: float = 0.01
    faint: float = 0.01

    def __post_init__(self) -> None:
        if not (0 <= self.mac_gate < 1 and self.frequency_gate > 0 and self.close >= 0 and self.largest_group >= 1):
            raise ConfigError(
                f"pairing: mac_gate {self.mac_gate} (0..1), frequency_gate {self.frequency_gate} (> 0), "
                f"close {self.close} (>= 0), largest_group {self.largest_group} (>= 1)"
            )


@dataclass(frozen=True, slots=True)
class Locks:
    """Pairs that the user decides; positions count from 0.

    Attributes
    ----------
    forced : tuple of (int, int)
        (mode of A, mode of B) that belong together, whatever the gates say.
    forbidden : tuple of (int, int)
        That do not belong together.
    """

    forced: tuple[tuple[int, int], ...] = ()
    forbidden: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        for side in (0, 1):
            modes = [pair[side] for pair in self.forced]
            if len(set(modes)) != len(modes):
                raise ConfigError(f"locks: mode {_twice(modes) + 1} of {'AB'[side]} is forced into two pairs")
        both = sorted(set(self.forced) & set(self.forbidden))
        if both:
            raise ConfigError(f"locks: pair {both[0][0] + 1}:{both[0][1] + 1} is both forced and forbidden")

    def mask(self, shape: tuple[int, int]) -> tuple[Bool, Bool]:
        """Which pairs (ma, mb) are forced, and which of all may be taken at all."""
        for i, j in (*self.forced, *self.forbidden):
            if not (0 <= i < shape[0] and 0 <= j < shape[1]):
                raise ConfigError(f"locks: no pair {i + 1}:{j + 1}; A has {shape[0]} modes, B {shape[1]}")
        forced, free = np.zeros(shape, dtype=np.bool_), np.ones(shape, dtype=np.bool_)
        for i, j in self.forced:
            free[i, :] = free[:, j] = False
        for i, j in self.forbidden:
            free[i, j] = False
        for i, j in self.forced:
            forced[i, j] = free[i, j] = True
        return forced, free


def _twice(modes: list[int]) -> int:
    return next(m for m in modes if modes.count(m) > 1)


NO_LOCKS = Locks()


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Pairs that the user decides where modes of B change places: each is known by its shape in a first model.

    Attributes
    ----------
    forced, forbidden : tuple of int
        Modes of A.
    shapes, barred : (channel, k) float64
        The first model's shapes that they belong to, and do not belong to.
    """

    forced: tuple[int, ...]
    shapes: Float
    forbidden: tuple[int, ...]
    barred: Float

    def locks(self, shapes: Any_) -> Locks:
        """The pairs among modes of B with shapes (channel, m), each found by its MAC with the first model's."""
        if not shapes.shape[1]:
            return NO_LOCKS
        rows, cols = linear_sum_assignment(-mac(self.shapes, shapes))
        of = dict(zip(rows.tolist(), cols.tolist(), strict=True))
        forced = tuple((t, of[i]) for i, t in enumerate(self.forced) if i in of)
        near = mac(self.barred, shapes).argmax(axis=1).tolist() if self.forbidden else []
        forbidden = tuple((t, j) for t, j in zip(self.forbidden, near, strict=True) if (t, j) not in forced)
        return Locks(forced, forbidden)


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """All that the assignment rests on.

    Attributes
    ----------
    mac : (ma, mb) float64
        Of the single shapes; NaN where none were measured.
    merged : (ma, mb) float64
        With shapes of a close group rotated towards A; equal to `mac` elsewhere.
    error : (ma, mb) float64
        (f_B − f_A)/f_A.
    groups_b : tuple of tuple of int
        Close groups of B, those that close modes of A mix among them.
    """

    mac: Float
    merged: Float
    error: Float
    groups_b: tuple[tuple[int, ...], ...]


def scores(fa: Float, a: Any_, fb: Float, b: Any_, settings: PairingSettings) -> Scores:
    """MAC and frequency errors of all combinations, with close groups of B rotated towards those of A.

    Parameters
    ----------
    fa, fb : (ma,), (mb,) float64, Hz
    a, b : (n, ma), (n, mb) float64 or complex128
        Without channels, n = 0, frequencies alone tell which modes belong together.
    """
    scale = np.maximum(np.abs(fa), np.finfo(float).tiny)[:, None]
    error = (fb[None, :] - fa[:, None]) / scale
    if not len(a):
        return Scores(np.full(error.shape, np.nan), np.full(error.shape, np.nan), error, ())
    single = mac(a, b)
    merged = single.copy()
    groups_a = [np.array(g) for g in close_groups(fa, settings.close, settings.largest_group)]
    groups_b = close_groups(fb, settings.close, settings.largest_group)
    for ga in (g for g in groups_a if g.size > 1):
        share = np.where((np.abs(error[ga]) <= settings.frequency_gate).any(axis=0), subspace_mac(b, a[:, ga]), 0.0)
        if share.any():
            here = fb[share.argmax()]
            share[np.abs(fb - here) > APART * settings.close * here] = 0.0
            groups_b = _joined(groups_b, _mixed(single[ga], share, settings), settings.largest_group)
    for gb in (np.array(g) for g in groups_b if len(g) > 1):
        share = subspace_mac(a, b[:, gb])  # no rotation inside the group reaches more
        held = np.asarray(share > HOLD * settings.mac_gate)
        gains = held & np.asarray(share > single[:, gb].max(axis=1) + SOFT - TIE)
        near = np.asarray((np.abs(error[:, gb]) <= settings.frequency_gate).any(axis=1))
        for ga in (g for g in groups_a if gains[g].any() and near[g].any()):
            # a chain of close modes of A may be longer: a neighbour belongs elsewhere
            these = np.sort(ga[np.argsort(-share[ga], kind="stable")[: gb.size]])
            these = these[held[these]]
            if gains[these].any():
                _merge(merged, single, error, these, gb, a, b, settings)
    return Scores(single, merged, error, groups_b)


def peak_shares(shapes: Any_) -> Float:
    """Largest component of each mass-normalised shape (n, m) over that of the median mode, (m,)."""
    peak = np.abs(shapes).max(axis=0, initial=0.0)
    typical = float(np.median(peak)) if peak.size else 0.0
    return np.asarray(peak / typical if typical > 0 else np.ones_like(peak))


def _mixed(single: Float, share: Float, settings: PairingSettings) -> Int:
    """The modes of B that a group of close modes of A mixes; none where single shapes match one to one.

    How close modes share two shapes is decided by perturbations as small as their distance: it differs between two
    sets whose frequencies differ by more, whichever of the two has them close.
    """
    best = np.argsort(-share, kind="stable")[: single.shape[0]]
    best = best[share[best] >= settings.mac_gate]
    rows, cols = linear_sum_assignment(-single[:, best])
    return best if (single[:, best][rows, cols] < settings.distinct).any() else best[:0]


def _joined(groups: tuple[tuple[int, ...], ...], members: Int, largest: int) -> tuple[tuple[int, ...], ...]:
    """The groups with those of `members` made one, unless that is more than `largest` modes."""
    those = set(members.tolist())
    touched = [g for g in groups if not those.isdisjoint(g)]
    one = tuple(sorted(j for g in touched for j in g))
    if len(touched) < 2 or len(one) > largest:
        return groups
    return (*(g for g in groups if g not in touched), one)


def _merge(
    merged: Float, single: Float, error: Float, ga: Int, gb: Int, a: Any_, b: Any_, settings: PairingSettings
) -> None:
    """Raise `merged` in place for the group `gb` where a rotation explains the shapes `ga` and single shapes do not."""
    block = np.ix_(ga, gb)
    rows, cols = linear_sum_assignment(-single[block])
    if np.abs(error[block]).min() > settings.frequency_gate or single[block][rows, cols].min() >= settings.distinct:
        return
    turned = paired_mac(a[:, ga], b[:, gb] @ rotation(a[:, ga], b[:, gb]))
    gain = turned > single[block].max(axis=1) + SOFT
    merged[block] = np.where(gain[:, None], turned[:, None], single[block])


def within(
    score: Scores, settings: PairingSettings, usable_a: Bool, usable_b: Bool, locks: Locks = NO_LOCKS
) -> tuple[Bool, Bool]:
    """Which pairs (ma, mb) may be: inside both gates and not forbidden, or forced; and which are forced.

    Without shapes the gate on the MAC holds for none.
    """
    allowed = np.isnan(score.merged) | (score.merged >= settings.mac_gate)
    allowed &= np.abs(score.error) <= settings.frequency_gate
    allowed &= usable_a[:, None] & usable_b[None, :]
    forced, free = locks.mask((allowed.shape[0], allowed.shape[1]))
    return np.asarray((allowed & free) | forced), forced


def assign(
    score: Scores, settings: PairingSettings, usable_a: Bool, usable_b: Bool, locks: Locks = NO_LOCKS
) -> tuple[Int, Int]:
    """The one-to-one assignment of greatest total worth among the pairs inside both gates.

    The worth of a pair is log((1 − gate)/(1 − MAC)), lowered with the square of the frequency error: two poor pairs
    never outvote a good one, which a sum of MACs allows. Forced pairs come before all others, forbidden ones never.

    Returns
    -------
    rows, columns : (k,) int64, ascending rows
    """
    value = np.log((1 - settings.mac_gate + SOFT) / (1 - score.merged + SOFT)) + SOFT
    worth = value * (1 - 0.5 * (score.error / settings.frequency_gate) ** 2)
    worth += TIE * score.mac  # decides between the members of a rotated group
    allowed, forced = within(score, settings, usable_a, usable_b, locks)
    worth = np.where(forced, LOCKED, np.where(allowed, worth, 0.0))
    rows, cols = linear_sum_assignment(-worth)
    keep = allowed[rows, cols]
    return rows[keep].astype(np.int64), cols[keep].astype(np.int64)
