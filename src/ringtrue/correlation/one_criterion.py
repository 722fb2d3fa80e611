"""Assignments of modes by one criterion: by frequency where no shapes were measured, and by shape
beyond the frequency gate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment
from scipy.special import betainc

from ringtrue.core.arrays import Any_, Bool, Float, FrozenArrays, Int
from ringtrue.correlation.assignment import (
    WORTH,
    ComparedModes,
    PairingSettings,
    Scores,
    scores,
)
from ringtrue.shapes import auto_mac, unit

NEVER = 1e6  # cost of a pair that may not be
LOCKED_COST = -1e6
NO_RIVAL = -2  # in place of a rival: the pair is not in doubt


@dataclass(frozen=True, slots=True)
class FrequencyOnlySettings:
    """How frequencies alone decide which modes belong together.

    Attributes
    ----------
    common : float
        Standard deviation of what all frequencies of a model are off together, relative.
    offsets : int
        Common offsets that are tried, over the gate.
    scatter : float
        Prior standard deviation of the single frequencies about the common offset, relative.
    prior_pairs : float
        As many pairs that prior counts.
    unpaired : float
        Cost of a mode without a partner, in squares of the scatter.
    doubt : float
        Another assignment that costs less than this much more leaves a pair in doubt: 6 is twenty
        times less likely.
    far : float
        Offsets about which an assignment costs this much more are not looked at again.
    """

    common: float = 0.1
    offsets: int = 29
    scatter: float = 0.05
    prior_pairs: float = 2.0
    unpaired: float = 25.0
    doubt: float = 6.0
    far: float = 50.0


FREQUENCY_ONLY = FrequencyOnlySettings()


@dataclass(frozen=True, slots=True, eq=False)
class ByFrequency(FrozenArrays):
    """The likeliest assignment.

    Attributes
    ----------
    rows, columns : (k,) int64, ascending rows
    rival : (k,) int64
        What else each mode of A may be: the mode of B that the next likely assignment gives it, -1:
        none of B; `NO_RIVAL` where the pair is not in doubt.
    """

    rows: Int
    columns: Int
    rival: Int


def by_frequency(
    fa: Float, fb: Float, allowed: Bool, forced: Bool, wide: Bool
) -> ByFrequency:
    """The one-to-one assignment in which the frequencies scatter least about a common relative
    offset.

    A model is too stiff or too heavy as a whole more often than mode by mode: where a mode was
    missed the nearest frequencies belong to other modes. ln f_B − ln f_A is normal about an offset
    that is itself normal; the assignment of greatest likelihood, and for each pair the greatest
    without it.

    Parameters
    ----------
    fa, fb : (ma,), (mb,) float64, Hz
    allowed, forced : (ma, mb) bool
        Pairs that may be, and that must be.
    wide : (ma, mb) bool
        Pairs that are looked at for doubts: gates do not make a pair certain.
    """
    tiny = np.finfo(np.float64).tiny
    error = (
        np.log(np.maximum(fb, tiny))[None, :] - np.log(np.maximum(fa, tiny))[:, None]
    )
    offsets = _offsets(error[allowed & ~forced])
    given = FREQUENCY_ONLY
    scatter = given.scatter

    def best(about: list[float], which: Bool) -> _Assigned:
        found = [
            _assigned(error, c, scatter, allowed=which, forced=forced) for c in about
        ]
        return min(found, key=lambda t: t.cost)

    for _ in range(2):
        off = best(offsets, allowed).off
        squares = off @ off + given.prior_pairs * given.scatter**2
        scatter = float(np.sqrt(squares / (max(off.size - 1, 0) + given.prior_pairs)))
    first = best(offsets, allowed)
    rows = np.flatnonzero(first.partner >= 0)
    offsets = _offsets(error[wide & ~forced])
    near = [c for c in offsets if best([c], wide).cost < first.cost + given.far]
    rival = []
    for i, j in zip(rows, first.partner[rows], strict=True):
        other = wide.copy()
        other[i, j] = False
        second = best(near, other)
        clear = forced[i].any() or second.cost >= first.cost + given.doubt
        rival.append(NO_RIVAL if clear else int(second.partner[i]))
    return ByFrequency(rows, first.partner[rows], np.array(rival, dtype=np.int64))


def _offsets(errors: Float) -> list[float]:
    ends = (errors.min(initial=0.0), errors.max(initial=0.0))
    return list(map(float, np.linspace(*ends, FREQUENCY_ONLY.offsets)))


@dataclass(frozen=True, slots=True, eq=False)
class _Assigned:
    """Cost, partner (ma,) of each mode of A, -1 for none, and deviations of the free pairs from
    their common offset.
    """

    cost: float
    partner: Int
    off: Float


def _assigned(
    error: Float, start: float, scatter: float, allowed: Bool, forced: Bool
) -> _Assigned:
    """The best assignment about an offset, and what it costs about its own."""
    m, n = error.shape
    cost = np.full((m, n + m), NEVER)
    cost[:, :n] = np.where(allowed, ((error - start) / scatter) ** 2, NEVER)
    cost[:, :n][forced] = LOCKED_COST
    cost[np.arange(m), n + np.arange(m)] = FREQUENCY_ONLY.unpaired
    rows, cols = linear_sum_assignment(cost)
    partner = np.where(cols < n, cols, -1)
    rows = np.flatnonzero((partner >= 0) & ~forced.any(axis=1))
    off = error[rows, partner[rows]]
    common = FREQUENCY_ONLY.common
    own = float(off.sum() / (rows.size + (scatter / common) ** 2))
    total = float((((off - own) / scatter) ** 2).sum())
    total += (own / common) ** 2
    total += FREQUENCY_ONLY.unpaired * float((partner < 0).sum())
    return _Assigned(total, partner, off - own)


@dataclass(frozen=True, slots=True)
class LikeShapesSettings:
    """When shapes alone make a pair beyond the frequency gate.

    Attributes
    ----------
    mac : float
        Least MAC of such a pair.
    contested : float
        MAC from which another mode may be meant.
    channels : float
        Least number of channels that carry such a shape: one sensor on a panel reads all its modes
        as one.
    chance : float
        Largest probability that unrelated shapes are as like: of random ones, and among the modes
        of each set.
    pattern : float
        Share of the largest singular value from which a pattern of readings is one of its own.
    """

    mac: float = 0.95
    contested: float = 0.5
    channels: float = 3.0
    chance: float = 0.01
    pattern: float = 0.1


LIKE_SHAPES = LikeShapesSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Extended:
    """Pairs within the frequency gate and beyond it.

    Attributes
    ----------
    rows, columns : (k,) int64, ascending rows
    beyond : (k,) bool
    score : Scores
        With close modes rotated among those that the gate left over, too.
    """

    rows: Int
    columns: Int
    beyond: Bool
    score: Scores


def pairs_by_shape(
    modes: ComparedModes,
    score: Scores,
    paired: tuple[Int, Int],
    free: Bool,
    gates: PairingSettings,
) -> Extended:
    """Pairs, and further ones beyond the frequency gate, of modes that look like each other and no
    other of either set.

    Close modes of B that are left over are one subspace, as within the gate.

    Parameters
    ----------
    modes : ComparedModes
    score : Scores
        Of all modes.
    paired : tuple of (j,) int64
        Rows, ascending, and columns of the pairs within the gate.
    free : (ma, mb) bool
        Pairs that may be.
    gates : PairingSettings
    """
    rows, cols = paired
    done = Extended(rows, cols, np.zeros(rows.size, dtype=np.bool_), score)
    ratio = 1 + score.error
    far = (
        (np.abs(score.error) > gates.frequency_gate)
        & (ratio <= gates.reach)
        & (ratio * gates.reach >= 1)
        & free
    )
    far[rows, :] = far[:, cols] = False
    if not far.any():
        return done
    merged = _merged(modes, score, far, gates)
    turned = merged > score.mac
    # how many channels carry each shape (n, m), were their shares equal, (m,)
    share = np.abs(unit(modes.a)) ** 2
    carried = np.asarray(
        1 / np.maximum((share**2).sum(axis=0), np.finfo(np.float64).tiny)
    )
    good = (
        far & (merged >= LIKE_SHAPES.mac) & (carried >= LIKE_SHAPES.channels)[:, None]
    )
    rivals = np.where(turned, _rivals(np.where(turned, 0.0, merged)), _rivals(merged))
    good &= rivals < LIKE_SHAPES.contested
    if good.any():
        patterns = independent_patterns(np.concatenate([modes.a, modes.b], axis=1))
        chance = chance_of_mac(merged, patterns) * far.sum()
        good &= np.maximum(chance, _confused(modes.a, modes.b)) <= LIKE_SHAPES.chance
    i, j = linear_sum_assignment(-np.where(good, merged + WORTH.tie * score.mac, 0.0))
    i, j = i[good[i, j]], j[good[i, j]]
    rows = np.append(rows, i)
    cols = np.append(cols, j)
    order = np.argsort(rows, kind="stable")
    beyond = order >= done.rows.size
    return Extended(rows[order], cols[order], beyond, replace(score, merged=merged))


def independent_patterns(shapes: Any_) -> int:
    """Number of independent patterns of readings in shapes (channel, m), at least 2."""
    s = linalg.svdvals(unit(shapes))
    return max(int((s > LIKE_SHAPES.pattern * s.max(initial=0.0)).sum()), 2)


def chance_of_mac(mac: Float, patterns: int) -> Float:
    """Probability that two unrelated shapes have a MAC as large or larger.

    Of directions that are uniform over so many independent patterns, the squared cosine is
    Beta(½, (patterns − 1)/2) distributed (Muirhead 1982, theorem 1.5.7).
    """
    rest = 1 - np.clip(mac, 0.0, 1.0)
    return betainc((patterns - 1) / 2, 0.5, rest)


def scores_among(
    modes: ComparedModes, rows: Int, columns: Int, gates: PairingSettings
) -> Scores:
    """The scores of some modes, each within reach of each; what it turns is given for all modes."""
    wide = replace(gates, frequency_gate=gates.reach)
    score = scores(modes.take(rows, columns), wide, mixed=False)
    turns = []
    for group, weight in score.turns:
        all_weights = np.zeros(modes.fa.size)
        all_weights[rows] = weight
        turns.append((tuple(columns[list(group)].tolist()), all_weights))
    return replace(score, turns=tuple(turns))


def _merged(
    modes: ComparedModes, score: Scores, far: Bool, gates: PairingSettings
) -> Float:
    """MAC (ma, mb) with close modes of B rotated among those of `far`, too."""
    rows = np.flatnonzero(far.any(axis=1))
    cols = np.flatnonzero(far.any(axis=0))
    merged = score.merged.copy()
    here = np.ix_(rows, cols)
    merged[here] = np.maximum(
        merged[here], scores_among(modes, rows, cols, gates).merged
    )
    return merged


def _confused(a: Any_, b: Any_) -> float:
    """Share of the pairs of different modes of one set that the channels cannot distinguish."""
    macs = [m[np.triu_indices(len(m), 1)] for m in (auto_mac(a), auto_mac(b))]
    like = np.concatenate(macs) >= LIKE_SHAPES.mac
    return float(like.mean()) if like.size else 0.0


def _rivals(mac: Float) -> Float:
    """For each pair (ma, mb) the largest value in its row and column but its own."""
    return np.maximum(_others(mac), _others(mac.T).T)


def _others(mac: Float) -> Float:
    """For each entry the largest other one of its row."""
    first = mac.argmax(axis=1)
    at = np.arange(len(mac))
    most = mac[at, first]
    rest = mac.copy()
    rest[at, first] = 0.0
    out = np.repeat(most[:, None], mac.shape[1], axis=1)
    out[at, first] = rest.max(axis=1, initial=0.0)
    return out
