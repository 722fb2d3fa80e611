"""Where to measure: effective independence, pivoted QR, auto-MAC; redundancy against lost sensors.

Kammer (1991), Sensor placement for on-orbit modal identification; Schedlinski and Link (1996) for
the reference points: the information of the target modes at the candidates decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.errors import InputError
from ringtrue.shapes import auto_mac, worst_off_diagonal

HARD = 64  # pairs of modes that bound the auto-MAC of an addition
PAIRS = 1_000_000  # pairs of modes of candidates that are looked at together
_MOST_SUBSETS = 20_000


def independence(shapes: Float) -> Float:
    """Effective independence of points, (n,): the share of the modes' information that each
    carries.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Points, directions at each, target modes.
    """
    n, d, m = shapes.shape
    flat = shapes.reshape(n * d, m)
    q, _ = np.linalg.qr(flat)
    return np.asarray((q**2).sum(axis=1).reshape(n, d).sum(axis=1))


def select_points(
    shapes: Float,
    xyz: Float,
    count: int,
    *,
    fixed: Bool | None = None,
    min_distance: float = 0.0,
) -> Int:
    """Points that distinguish the target modes, by backward elimination of the least independent.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Mass-normalised shapes at the candidates; d directions a point (a triaxial sensor has 3).
    xyz : (n, 3) float64, m
    count : int
        Points to keep, the fixed ones included.
    fixed : (n,) bool, optional
        Points that stay, be they more than `count`.
    min_distance : float, m
        Of two candidates that are closer the weaker goes first.

    Returns
    -------
    (max(count, fixed),) int64
        Positions, ascending.

    Raises
    ------
    InputError
        If the points asked for cannot distinguish the modes, or there are too few.
    """
    n, d, m = shapes.shape
    held = (
        np.zeros(n, dtype=np.bool_)
        if fixed is None
        else np.asarray(fixed, dtype=np.bool_)
    )
    count = max(count, int(held.sum()))
    if count * d < m:
        raise InputError(
            f"{count} points with {d} directions cannot distinguish {m} modes; ask for more points"
        )
    keep = np.arange(n)
    if min_distance > 0:
        keep = thinned(independence(shapes), xyz, held, min_distance)
    if keep.size < count:
        wide = f" are {min_distance:g} m from each other" if min_distance > 0 else ""
        raise InputError(
            f"{keep.size} candidates{wide}, {count} points were asked for: "
            f"{'lower min_distance' if wide else 'ask for fewer'} or name more candidates"
        )
    while keep.size > count:
        score = independence(shapes[keep])
        score[held[keep]] = np.inf
        # a tenth at a time while there are many: the ranking of the weakest does not change much
        drop = max(1, min((keep.size - count) // 10, keep.size - count))
        keep = np.delete(keep, np.argsort(score, kind="stable")[:drop])
    return keep


def thinned(score: Float, xyz: Float, held: Bool, distance: float) -> Int:
    """Candidates that are farther than `distance` from each other, ascending: strongest first,
    each bans its neighbours.

    Parameters
    ----------
    score : (n,) float64
    xyz : (n, 3) float64, m
    held : (n,) bool
        Points that stay in any case.
    distance : float, m
    """
    order = np.argsort(-(score + held * 1e9), kind="stable")
    near = cKDTree(xyz).query_ball_point(xyz, distance)
    banned = np.zeros(len(xyz), dtype=np.bool_)
    kept = []
    for i in order.tolist():  # greedy by nature; hundreds of candidates
        if banned[i] and not held[i]:
            continue
        kept.append(i)
        banned[near[i]] = True
    return np.sort(np.array(kept, dtype=np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class Spacing:
    """The least distance, m, that is kept between points xyz (n, 3), m."""

    xyz: Float
    least: float


def _far_from(points: Int, n: int, spacing: Spacing | None) -> Bool:
    """Which of n points are none of these, and keep the spacing from them."""
    out = np.ones(n, dtype=np.bool_)
    out[points] = False
    if spacing is not None and spacing.least > 0:
        out &= cKDTree(spacing.xyz[points]).query(spacing.xyz)[0] > spacing.least
    return out


def lower_auto_mac(
    shapes: Float,
    chosen: Int,
    target: float,
    most: int,
    *,
    spacing: Spacing | None = None,
    worth: float = 0.0,
) -> Int:
    """Adds the points that lower the worst off-diagonal auto-MAC most, until it is below `target`
    or `most` are in.

    It ends before where no point keeps the spacing from all that are in. Where the
    target is not reached, the last additions that lower it by less than `worth` together are left
    out.

    Parameters
    ----------
    shapes : (n, d, m) float64
    chosen : (k,) int64
    target : float, 0..1
    most : int
    spacing : Spacing, optional
    worth : float, 0..1
    """
    n, _, m = shapes.shape
    chosen, first = np.array(chosen), len(chosen)
    open_ = _far_from(chosen, n, spacing)
    now = shapes[chosen].reshape(-1, m)
    worst = [worst_off_diagonal(auto_mac(now))]
    while chosen.size < most and worst[-1] > target and open_.any():
        rest = np.flatnonzero(open_)
        best = rest[_best_addition(now.T @ now, shapes[rest])]
        chosen = np.append(chosen, best)
        now = shapes[chosen].reshape(-1, m)
        worst.append(worst_off_diagonal(auto_mac(now)))
        open_ &= _far_from(np.array([best]), n, spacing)
    if worth and worst[-1] > target:
        chosen = chosen[: first + int(np.argmax(np.array(worst) <= worst[-1] + worth))]
    return np.sort(chosen)


def _best_addition(gram: Float, shapes: Float) -> int:
    """The first of the candidates `shapes` (r, d, m) whose addition to `gram` (m, m) leaves the
    least worst auto-MAC.

    The pairs of modes that are worst now bound that of each candidate from below; only those whose
    bound stays under the best are looked at in full.
    """
    m = len(gram)
    i, j = np.triu_indices(m, 1)
    if not i.size:
        return 0
    # a mode that nothing moves in
    size = np.maximum(np.diag(gram) + (shapes**2).sum(axis=1), 1e-150)
    now = np.abs(gram[i, j]) / np.sqrt(np.maximum(gram[i, i] * gram[j, j], 1e-300))
    hard = np.argsort(-now, kind="stable")[:HARD]
    bound = np.zeros(len(shapes))
    for a, b in zip(i[hard].tolist(), j[hard].tolist(), strict=True):  # a few
        cross = gram[a, b] + np.einsum("nd,nd->n", shapes[:, :, a], shapes[:, :, b])
        bound = np.maximum(bound, cross**2 / (size[:, a] * size[:, b]))
    best = 0
    value = np.inf
    order = np.argsort(bound, kind="stable")
    step = max(1, PAIRS // (m * m))
    for first in range(0, order.size, step):
        at = order[first : first + step]
        if bound[at[0]] > value * (1 + 1e-9):
            break
        part = shapes[at]
        mac = (gram + np.swapaxes(part, 1, 2) @ part) ** 2 / (
            size[at, :, None] * size[at, None, :]
        )
        mac[:, np.arange(m), np.arange(m)] = 0.0
        worst = mac.max(axis=(1, 2))
        least = float(worst.min())
        if least <= value:
            here = int(at[worst == least].min())
            best = min(best, here) if least == value else here
            value = least
    return best


@dataclass(frozen=True, slots=True, eq=False)
class Loss(FrozenArrays):
    """The worst loss of k sensors.

    Attributes
    ----------
    points : (k,) int64
        Positions in the chosen points whose loss hurts most.
    left : float, 0..1
        Information that stays about the combination of modes that suffers most; 0: modes become
        indistinguishable.
    combination : (m,) float64
        That combination, in modal coordinates.
    exact : bool
        All subsets were looked at; otherwise the worst were built up one sensor at a time.
    """

    points: Int
    left: float
    combination: Float
    exact: bool


def worst_sensor_loss(shapes: Float, k: int) -> Loss:
    """The loss of k of the given points that hurts most.

    With Φ = QR the information that stays, relative to the whole, has the least eigenvalue 1 -
    σ²(Q_lost) of the lost rows Q_lost: no matrix larger than the lost rows is needed.

    Parameters
    ----------
    shapes : (c, d, m) float64, at the chosen points
    k : int

    Returns
    -------
    Loss
        Where not even all points distinguish the modes, `left` is 0 and `points` is empty.

    Raises
    ------
    InputError
        If k is not below the number of points.
    """
    c, d, m = shapes.shape
    if not 0 <= k < c:
        raise InputError(f"loss of {k} of {c} points: must be 0 to {c - 1}")
    if k == 0:
        return Loss(np.zeros(0, dtype=np.int64), 1.0, np.zeros(m), True)
    flat = shapes.reshape(c * d, m)
    _, size, right = np.linalg.svd(flat, full_matrices=c * d < m)
    if c * d < m or size[-1] <= 1e-10 * size[0]:
        return Loss(np.zeros(0, dtype=np.int64), 0.0, right[-1], True)
    q, r = np.linalg.qr(flat)
    rows = q.reshape(c, d, m)
    exact = comb(c, k) <= _MOST_SUBSETS
    subsets = (
        np.array(list(combinations(range(c), k)), dtype=np.int64).reshape(-1, k)
        if exact
        else _built(rows, k)
    )
    _, s, v = np.linalg.svd(
        rows[subsets].reshape(len(subsets), k * d, m), full_matrices=False
    )
    worst = int(np.argmax(s[:, 0]))
    left = float(np.clip(1 - s[worst, 0] ** 2, 0, 1))
    return Loss(subsets[worst], left, np.linalg.solve(r, v[worst, 0]), exact)


def _built(rows: Float, k: int) -> Int:
    """(c, k) subsets, each grown from one point by the point that hurts most."""
    c, _, m = rows.shape
    subsets = np.arange(c)[:, None]
    for _ in range(k - 1):
        grown = []
        for s in subsets.tolist():  # a subset for each sensor: tens
            rest = np.setdiff1d(np.arange(c), s)
            trial = np.column_stack([np.tile(s, (rest.size, 1)), rest])
            top = np.linalg.norm(
                rows[trial].reshape(len(trial), -1, m), ord=2, axis=(1, 2)
            )
            grown.append(trial[int(np.argmax(top))])
        subsets = np.array(grown)
    return subsets


LEAST_LEFT = 0.1  # of the information, after the loss of sensors


def add_redundancy(
    shapes: Float,
    chosen: Int,
    k: int,
    *,
    most: int = 0,
    spacing: Spacing | None = None,
) -> Int:
    """Adds points until at least the share `least` of the information about any mode survives the
    loss of any k.

    Each added point is the one that sees most of the combination of modes that the worst loss
    blinds.

    Parameters
    ----------
    shapes : (n, d, m) float64
    chosen : (c,) int64
    k : int
    most : int
        Most points in all; 0: all candidates.
    spacing : Spacing, optional
        From each point that is added to all others.

    Returns
    -------
    (c + a,) int64
        `chosen`, then those added.

    Raises
    ------
    InputError
        If the limit is not reached with `most` points, or with all that are far enough from each
        other.
    """
    points = np.array(chosen, dtype=np.int64)
    most = most or len(shapes)
    free = _far_from(points, len(shapes), spacing)
    while (loss := worst_sensor_loss(shapes[points], k)).left < LEAST_LEFT:
        rest = np.flatnonzero(free)
        if points.size >= most or not rest.size:
            lower = ""
            if spacing is not None and spacing.least > 0 and not rest.size:
                lower = f", a distance below {spacing.least:.2g} m"
            raise InputError(
                f"with {points.size} points the loss of any {k} leaves {100 * loss.left:.2g} % "
                "of the information, "
                f"{100 * LEAST_LEFT:g} % are asked for: allow more points{lower} or less redundancy"
            )
        seen = ((shapes[rest] @ loss.combination) ** 2).sum(axis=1)
        best = int(rest[np.argmax(seen)])
        points = np.append(points, best)
        free &= _far_from(np.array([best]), len(shapes), spacing)
    return points
