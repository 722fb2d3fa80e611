"""One global assignment of modes over MAC and frequency, on arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.errors import ConfigError
from ringtrue.shapes import (
    FADE,
    NIL,
    above_rounding,
    close_groups,
    fade,
    gaps,
    mac,
    paired_mac,
    rotation,
    share_in,
    unit,
)


@dataclass(frozen=True, slots=True)
class WorthSettings:
    """What a pair is worth, and when close modes are one group.

    Attributes
    ----------
    tie : float
        Of the MAC of single shapes, which decides between the members of a rotated group.
    locked : float
        Of a forced pair, above that of all others together.
    close : float
        Times the distance of close modes: as far may be in B what is close in A.
    soft : float
        1 − MAC below this brings no further gain: it is noise.
    shared : float
        Above the MAC gate, from where on a share counts whole.
    hold : float
        Share of the MAC gate: a shape that matches less is another, which no rotation mends;
        likewise of the frequency gate.
    """

    tie: float = 1e-3
    locked: float = 1e6
    close: float = 4.0
    soft: float = 0.02
    shared: float = 0.1
    hold: float = 0.5


WORTH = WorthSettings()


@dataclass(frozen=True, slots=True)
class PairingSettings:
    """Gates of the pairing.

    Attributes
    ----------
    mac_gate : float
        Least MAC of a pair.
    frequency_gate : float
        Largest |f_B − f_A|/f_A of a pair.
    reach : float
        Largest ratio of the frequencies of a pair beyond that gate; 1: none. Only
        modes that look like each other and no other are taken there (`pairs_by_shape`).
    close : float
        Relative distance below which neighbours of one set are one subspace; from there to `FADE`
        times it ever less.
    distinct : float
        Shapes that match one to one with a MAC above it are rotated ever less, from halfway to 1 on
        not at all.
    largest_group : int
        Most modes in one subspace.
    min_confidence : float
        Modes of A with less are left unpaired.
    faint : float
        Mass-normalised modes of B whose largest component at the sensors is below this share of the
        median mode's are not observable: the correlation leaves them unpaired, the updating trusts
        them less.
    """

    mac_gate: float = 0.6
    frequency_gate: float = 0.4
    reach: float = 3.0
    close: float = 0.02
    distinct: float = 0.9
    largest_group: int = 4
    min_confidence: float = 0.5
    faint: float = 0.01

    def __post_init__(self) -> None:
        gates = 0 <= self.mac_gate < 1 and self.frequency_gate > 0 and self.reach >= 1
        if not (gates and self.close >= 0 and self.largest_group >= 1):
            raise ConfigError(
                f"pairing: mac_gate {self.mac_gate} (0..1), frequency_gate {self.frequency_gate} "
                "(> 0), "
                f"reach {self.reach} (>= 1), close {self.close} (>= 0), largest_group "
                f"{self.largest_group} (>= 1)"
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
            if twice := [m for m in modes if modes.count(m) > 1]:
                raise ConfigError(
                    f"locks: mode {twice[0] + 1} of {'AB'[side]} is forced into two pairs"
                )
        both = sorted(set(self.forced) & set(self.forbidden))
        if both:
            raise ConfigError(
                f"locks: pair {both[0][0] + 1}:{both[0][1] + 1} is both forced and forbidden"
            )

    def mask(self, shape: tuple[int, int]) -> tuple[Bool, Bool]:
        """Which pairs (ma, mb) are forced, and which of all may be taken at all."""
        for i, j in (*self.forced, *self.forbidden):
            if not (0 <= i < shape[0] and 0 <= j < shape[1]):
                raise ConfigError(
                    f"locks: no pair {i + 1}:{j + 1}; A has {shape[0]} modes, B {shape[1]}"
                )
        forced = np.zeros(shape, dtype=np.bool_)
        free = np.ones(shape, dtype=np.bool_)
        for i, j in self.forced:
            free[i, :] = free[:, j] = False
        for i, j in self.forbidden:
            free[i, j] = False
        for i, j in self.forced:
            forced[i, j] = free[i, j] = True
        return forced, free


NO_LOCKS = Locks()


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Pairs that the user decides where modes of B change places: each is known by its shape in a
    first model.

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

    def among(self, modes: Int) -> Followed:
        """Those of some modes of A, ascending (k,), which are counted anew."""

        def kept(
            which: tuple[int, ...], shapes: Float
        ) -> tuple[tuple[int, ...], Float]:
            every = np.array(which, dtype=np.int64)
            stay = np.isin(every, modes)
            return tuple(np.searchsorted(modes, every[stay]).tolist()), shapes[:, stay]

        return Followed(
            *kept(self.forced, self.shapes), *kept(self.forbidden, self.barred)
        )

    def locks(self, shapes: Any_) -> Locks:
        """The pairs among modes of B with shapes (channel, m), each found by its MAC with the first
        model's.
        """
        if not shapes.shape[1]:
            return NO_LOCKS
        rows, cols = linear_sum_assignment(-mac(self.shapes, shapes))
        of = dict(zip(rows.tolist(), cols.tolist(), strict=True))
        forced = tuple((t, of[i]) for i, t in enumerate(self.forced) if i in of)
        near = (
            mac(self.barred, shapes).argmax(axis=1).tolist() if self.forbidden else []
        )
        forbidden = tuple(
            (t, j)
            for t, j in zip(self.forbidden, near, strict=True)
            if (t, j) not in forced
        )
        return Locks(forced, forbidden)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedModes:
    """Two sets of modes at the same channels.

    Attributes
    ----------
    fa, fb : (ma,), (mb,) float64, Hz
    a, b : (n, ma), (n, mb) float64 or complex128
        Without channels, n = 0, frequencies alone decide which modes belong together.
    """

    fa: Float
    a: Any_
    fb: Float
    b: Any_

    @property
    def error(self) -> Float:
        """(f_B − f_A)/f_A, (ma, mb)."""
        scale = np.maximum(np.abs(self.fa), NIL)[:, None]
        return (self.fb[None, :] - self.fa[:, None]) / scale

    def take(self, rows: Int, columns: Int) -> ComparedModes:
        """Some modes of A and of B."""
        return ComparedModes(
            self.fa[rows], self.a[:, rows], self.fb[columns], self.b[:, columns]
        )


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
    turns : tuple of (group, weight)
        Close groups of B, those that close modes of A mix among them, and how far each is rotated
        towards every mode of A, (ma,) float64, 0..1.
    """

    mac: Float
    merged: Float
    error: Float
    turns: tuple[tuple[tuple[int, ...], Float], ...]


def scores(
    modes: ComparedModes, settings: PairingSettings, *, mixed: bool = True
) -> Scores:
    """MAC and frequency errors of all combinations, with close groups of B rotated towards those of
    A.

    Parameters
    ----------
    modes : ComparedModes
    settings : PairingSettings
    mixed : bool
        Also make one group of the modes of B that close modes of A mix.
    """
    fa = modes.fa
    a = modes.a
    fb = modes.fb
    b = modes.b
    error = modes.error
    if not len(a):
        none = np.full(error.shape, np.nan)
        return Scores(none, none, error, ())
    single = mac(a, b)
    # once: with hundreds of modes there are as many groups
    merged = single.copy()
    units = (unit(a), unit(b))
    groups_a = [
        np.array(g) for g in close_groups(fa, settings.close, settings.largest_group)
    ]
    shared = list[list[tuple[float, Int]]]()
    turns = []
    for ga in (g for g in groups_a if g.size > 1 and mixed):
        in_reach = (np.abs(error[ga]) <= settings.frequency_gate).any(axis=0)
        share = np.where(in_reach, share_in(units[1], a[:, ga]), 0.0)
        if share.any():
            here = fb[share.argmax()]
            near = fade(
                np.abs(fb - here) / max(WORTH.close * settings.close * here, NIL)
            )[0]
            shared.append(_mixed(single[ga], share, near, settings))
    for group, weight in _weighed(fb, shared, settings).items():
        gb = np.array(group)
        turn = np.zeros(fa.size)
        # no rotation inside the group reaches more
        share = share_in(units[0], b[:, gb])
        held = np.asarray(share > WORTH.hold * settings.mac_gate)
        gains = held & np.asarray(
            share > single[:, gb].max(axis=1) + WORTH.soft - WORTH.tie
        )
        if not gains.any():
            continue
        near = np.asarray((np.abs(error[:, gb]) <= settings.frequency_gate).any(axis=1))
        for ga in (g for g in groups_a if gains[g].any() and near[g].any()):
            # a chain of close modes of A may be longer: a neighbour belongs elsewhere
            these = np.sort(ga[np.argsort(-share[ga], kind="stable")[: gb.size]])
            these = these[held[these]]
            if gains[these].any():
                block = np.ix_(these, gb)
                turned, far = _turned(
                    single[block],
                    error[block],
                    a[:, these],
                    b=b[:, gb],
                    settings=settings,
                )
                turn[these] = weight * far
                merged[block] += turn[these, None] * (turned[:, None] - single[block])
        if turn.any():
            turns.append((group, turn))
    return Scores(single, merged, error, tuple(turns))


def peak_shares(shapes: Any_) -> Float:
    """Largest component of each mass-normalised shape (n, m) over that of the median of the modes
    seen at all, (m,).
    """
    peak = np.abs(above_rounding(shapes)).max(axis=0, initial=0.0)
    seen = peak[peak > 0]
    return peak / np.median(seen) if seen.size else np.ones_like(peak)


def _mixed(
    single: Float, share: Float, near: Float, settings: PairingSettings
) -> list[tuple[float, Int]]:
    """The modes of B that a group of close modes of A mixes, as sets that grow, each with how far
    that is so, 0..1.

    Not where single shapes match one to one. How close modes share two shapes is decided by
    perturbations as small as their distance: it differs between two sets whose frequencies differ
    by more, whichever of the two has them close.
    """
    held = near * np.clip((share - settings.mac_gate) / WORTH.shared, 0.0, 1.0)
    best = np.lexsort((-share, -held))[: single.shape[0]]
    held = held[best]
    sets = [best[:k] for k in range(2, np.count_nonzero(held) + 1)]
    return [
        (float(held[s.size - 1]) * _blurred(single[:, s], settings), s) for s in sets
    ]


def _blurred(block: Float, settings: PairingSettings) -> float:
    """How far single shapes (ka, kb), by their MAC, fail to match one to one: 1 below `distinct`,
    from there ever less.

    Nothing from halfway to a MAC of 1 on.
    """
    rows, cols = linear_sum_assignment(-block)
    return float(
        np.clip(
            2 * (1 - block[rows, cols].min()) / (1 - settings.distinct) - 1, 0.0, 1.0
        )
    )


def _weighed(
    fb: Float, mixed: Sequence[Sequence[tuple[float, Int]]], settings: PairingSettings
) -> dict[tuple[int, ...], float]:
    """Groups of more than one mode of B, each with its weight: the mean over all limits between
    `close` and `FADE` it.

    Each limit joins those that `mixed` says, too, where that is so by more than the limit asks,
    unless that makes more than `largest_group` modes. A mean over limits has no jump where two
    modes pass one.
    """
    gap = gaps(np.sort(fb))
    near = fade(gap / settings.close)[0] if settings.close else np.zeros(gap.size)
    steps = np.unique(
        np.concatenate([[0.0, 1.0], near, [s for sets in mixed for s, _ in sets]])
    )
    out = dict[tuple[int, ...], float]()
    limit = -1.0
    close = dict[int, tuple[int, ...]]()
    for low, high in pairwise(steps.tolist()):
        last = limit
        limit = float(gap[near <= low].min(initial=FADE * settings.close))
        if limit != last:
            groups = close_groups(fb, limit, settings.largest_group)
            close = {j: tuple(sorted(g)) for g in groups if len(g) > 1 for j in g}
        of = dict(close)
        for sets in mixed:
            if not (joined := [m for s, m in sets if s >= high]):
                continue
            one = tuple(
                sorted({j for m in joined[-1].tolist() for j in of.get(m, (m,))})
            )
            if len(one) <= settings.largest_group:
                of.update(dict.fromkeys(one, one))
        for g in dict.fromkeys(of.values()):
            out[g] = out.get(g, 0.0) + high - low
    return dict(sorted(out.items()))


def _turned(
    single: Float, error: Float, a: Any_, b: Any_, settings: PairingSettings
) -> tuple[Float, Float]:
    """MAC (ka,) with shapes `b` (n, kb) rotated towards `a` (n, ka), and how far that is done,
    (ka,) 0..1.

    Done where a rotation explains the shapes and single ones do not; `single` and `error` are (ka,
    kb).
    """
    far = (
        _blurred(single, settings)
        if np.abs(error).min() <= settings.frequency_gate
        else 0.0
    )
    if not far:
        return np.zeros(len(single)), np.zeros(len(single))
    turned = paired_mac(a, b @ rotation(a, b))
    return turned, far * np.clip(
        (turned - single.max(axis=1)) / WORTH.soft - 1, 0.0, 1.0
    )


def within(
    score: Scores,
    settings: PairingSettings,
    usable_a: Bool,
    usable_b: Bool,
    locks: Locks = NO_LOCKS,
) -> tuple[Bool, Bool]:
    """Which pairs (ma, mb) may be: inside both gates and not forbidden, or forced; and which are
    forced.

    Without shapes the gate on the MAC holds for none.
    """
    allowed = np.isnan(score.merged) | (score.merged >= settings.mac_gate)
    allowed &= np.abs(score.error) <= settings.frequency_gate
    allowed &= usable_a[:, None] & usable_b[None, :]
    forced, free = locks.mask((allowed.shape[0], allowed.shape[1]))
    return np.asarray((allowed & free) | forced), forced


def assign(
    score: Scores,
    settings: PairingSettings,
    usable_a: Bool,
    usable_b: Bool,
    locks: Locks = NO_LOCKS,
    trust: Float | None = None,
) -> tuple[Int, Int]:
    """The one-to-one assignment of greatest total worth among the pairs inside both gates.

    The worth of a pair is log((1 − gate)/(1 − MAC)), lowered with the square of the frequency
    error: two poor pairs never outvote a good one, which a sum of MACs allows. Forced pairs come
    before all others, forbidden ones never.

    Parameters
    ----------
    trust : (ma, mb) float64, optional
        Factors 0..1 on the worth; a pair with 0 is none unless it is forced.

    Returns
    -------
    rows, columns : (k,) int64, ascending rows
    """
    left = 1 - score.merged + WORTH.soft
    value = np.log((1 - settings.mac_gate + WORTH.soft) / left) + WORTH.soft
    worth = value * (1 - 0.5 * (score.error / settings.frequency_gate) ** 2)
    worth += WORTH.tie * score.mac  # decides between the members of a rotated group
    allowed, forced = within(score, settings, usable_a, usable_b=usable_b, locks=locks)
    if trust is not None:
        worth = trust * worth
        allowed = (allowed & (trust > 0)) | forced
    worth = np.where(forced, WORTH.locked, np.where(allowed, worth, 0.0))
    rows, cols = linear_sum_assignment(-worth)
    keep = allowed[rows, cols]
    return rows[keep].astype(np.int64), cols[keep].astype(np.int64)
