"""Pairs beyond the frequency gate: modes that look alike and like no other, as those of far too
soft a support.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment
from scipy.special import betainc

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.correlation.assign import TIE, PairingSettings, Scores, scores
from ringtrue.shapes.mac import auto_mac, unit

LIKE = 0.95  # least MAC of such a pair
CONTESTED = 0.5  # MAC from which another mode may be meant
# channels, at the least, that carry such a shape: one sensor on a panel reads all its modes alike
CARRIED = 3.0
CHANCE = 0.01  # that unrelated shapes are as like: of random ones, and among the modes of each set
FLAT = 0.1  # of the largest singular value: patterns that are less are those of others


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


def uncontested(
    fa: Float,
    a: Any_,
    fb: Float,
    b: Any_,
    score: Scores,
    paired: tuple[Int, Int],
    free: Bool,
    gates: PairingSettings,
) -> Extended:
    """Pairs, and further ones beyond the frequency gate, of modes that look alike and like no other
    of either set.

    Close modes of B that are left over are one subspace, as within the gate.

    Parameters
    ----------
    fa, fb : (ma,), (mb,) float64, Hz
    a, b : (n, ma), (n, mb) float64 or complex128
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
    merged = _merged(fa, a, fb, b, score, far, gates)
    turned = merged > score.mac
    good = far & (merged >= LIKE) & (_carried(a) >= CARRIED)[:, None]
    good &= np.where(turned, _rivals(np.where(turned, 0.0, merged)), _rivals(merged)) < CONTESTED
    if good.any():
        chance = betainc((_patterns(a, b) - 1) / 2, 0.5, 1 - np.clip(merged, 0.0, 1.0)) * far.sum()
        good &= np.maximum(chance, _confused(a, b)) <= CHANCE
    i, j = linear_sum_assignment(-np.where(good, merged + TIE * score.mac, 0.0))
    i, j = i[good[i, j]], j[good[i, j]]
    rows, cols = np.append(rows, i), np.append(cols, j)
    order = np.argsort(rows, kind="stable")
    beyond = order >= done.rows.size
    return Extended(rows[order], cols[order], beyond, replace(score, merged=merged))


def among(
    fa: Float, a: Any_, fb: Float, b: Any_, rows: Int, columns: Int, gates: PairingSettings
) -> Scores:
    """The scores of some modes, each within reach of each; what it turns is told of all modes."""
    wide = replace(gates, frequency_gate=gates.reach)
    score = scores(fa[rows], a[:, rows], fb[columns], b[:, columns], wide, mixed=False)
    turns = []
    for group, weight in score.turns:
        all_weights = np.zeros(fa.size)
        all_weights[rows] = weight
        turns.append((tuple(columns[list(group)].tolist()), all_weights))
    return replace(score, turns=tuple(turns))


def _merged(
    fa: Float, a: Any_, fb: Float, b: Any_, score: Scores, far: Bool, gates: PairingSettings
) -> Float:
    """MAC (ma, mb) with close modes of B rotated among those of `far`, too."""
    rows, cols = np.flatnonzero(far.any(axis=1)), np.flatnonzero(far.any(axis=0))
    merged = score.merged.copy()
    here = np.ix_(rows, cols)
    merged[here] = np.maximum(merged[here], among(fa, a, fb, b, rows, cols, gates).merged)
    return merged


def _carried(shapes: Any_) -> Float:
    """How many channels carry each shape (n, m), were their shares equal, (m,)."""
    share = np.abs(unit(shapes)) ** 2
    return np.asarray(1 / np.maximum((share**2).sum(axis=0), np.finfo(np.float64).tiny))


def _patterns(a: Any_, b: Any_) -> int:
    """Number of independent patterns of readings in both sets."""
    s = linalg.svdvals(np.concatenate([unit(a), unit(b)], axis=1))
    return max(int((s > FLAT * s.max(initial=0.0)).sum()), 2)


def _confused(a: Any_, b: Any_) -> float:
    """Share of the pairs of different modes of one set that the channels cannot tell apart."""
    like = np.concatenate(
        [m[np.triu_indices(len(m), 1)] >= LIKE for m in (auto_mac(a), auto_mac(b))]
    )
    return float(like.mean()) if like.size else 0.0


def _rivals(mac: Float) -> Float:
    """For each pair (ma, mb) the largest value in its row and column but its own."""
    return np.maximum(_others(mac), _others(mac.T).T)


def _others(mac: Float) -> Float:
    """For each entry the largest other one of its row."""
    first = mac.argmax(axis=1)
    at = np.arange(len(mac))
    most, rest = mac[at, first], mac.copy()
    rest[at, first] = 0.0
    out = np.repeat(most[:, None], mac.shape[1], axis=1)
    out[at, first] = rest.max(axis=1, initial=0.0)
    return out
