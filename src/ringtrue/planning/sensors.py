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

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.errors import InputError
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal

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
    shapes: Float, xyz: Float, count: int, *, fixed: Bool | None = None, min_distance: float = 0.0
) -> Int:
    """Points that keep the target modes apart, by backward elimination of the least independent.

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
        If the points asked for cannot tell the modes apart, or there are too few.
    """
    n, d, m = shapes.shape
    held = np.zeros(n, dtype=np.bool_) if fixed is None else np.asarray(fixed, dtype=np.bool_)
    count = max(count, int(held.sum()))
    if count * d < m:
        raise InputError(
            f"{count} points with {d} directions cannot tell {m} modes apart; ask for more points"
        )
    keep = np.arange(n)
    if min_distance > 0:
        keep = thinned(independence(shapes), xyz, held, min_distance)
    if keep.size < count:
        wide = f" are {min_distance:g} m apart" if min_distance > 0 else ""
        raise InputError(
            f"{keep.size} candidates{wide}, {count} points were asked for: "
            f"{'lower min_distance' if wide else 'ask for fewer'} or name more candidates"
        )
    while keep.size > count:
        score = independence(shapes[keep])
        score[held[keep]] = np.inf
        # a tenth at a time while there are many: the ranking of the weakest hardly changes
        drop = max(1, min((keep.size - count) // 10, keep.size - count))
        keep = np.delete(keep, np.argsort(score, kind="stable")[:drop])
    return keep


def thinned(score: Float, xyz: Float, held: Bool, distance: float) -> Int:
    """Candidates that are farther than `distance` apart, ascending: strongest first, each bans its
    neighbours.

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


def lower_auto_mac(
    shapes: Float,
    chosen: Int,
    target: float,
    most: int,
    *,
    xyz: Float | None = None,
    min_distance: float = 0.0,
    worth: float = 0.0,
) -> Int:
    """Adds the points that lower the worst off-diagonal auto-MAC most, until it is below `target`
    or `most` are in.

    It ends before where no point is farther than `min_distance` from all that are in. Where the
    target is not reached, the last additions that lower it by less than `worth` together are left
    out.

    Parameters
    ----------
    shapes : (n, d, m) float64
    chosen : (k,) int64
    target : float, 0..1
    most : int
    xyz : (n, 3) float64, m, optional
    min_distance : float, m
    worth : float, 0..1
    """
    n, _, m = shapes.shape
    chosen, first = np.array(chosen), len(chosen)
    open_ = np.ones(n, dtype=np.bool_)
    open_[chosen] = False
    if xyz is not None and min_distance > 0:
        open_ &= cKDTree(xyz[chosen]).query(xyz)[0] > min_distance
    now = shapes[chosen].reshape(-1, m)
    worst = [worst_off_diagonal(auto_mac(now))]
    while chosen.size < most and worst[-1] > target and open_.any():
        rest = np.flatnonzero(open_)
        best = rest[_best_addition(now.T @ now, shapes[rest])]
        chosen = np.append(chosen, best)
        now = shapes[chosen].reshape(-1, m)
        worst.append(worst_off_diagonal(auto_mac(now)))
        open_[best] = False
        if xyz is not None and min_distance > 0:
            open_ &= np.linalg.norm(xyz - xyz[best], axis=1) > min_distance
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
    size = np.maximum(
        np.diag(gram) + (shapes**2).sum(axis=1), 1e-150
    )  # a mode that nothing moves in
    now = np.abs(gram[i, j]) / np.sqrt(np.maximum(gram[i, i] * gram[j, j], 1e-300))
    hard = np.argsort(-now, kind="stable")[:HARD]
    bound = np.zeros(len(shapes))
    for a, b in zip(i[hard].tolist(), j[hard].tolist(), strict=True):  # a few
        cross = gram[a, b] + np.einsum("nd,nd->n", shapes[:, :, a], shapes[:, :, b])
        bound = np.maximum(bound, cross**2 / (size[:, a] * size[:, b]))
    best, value = 0, np.inf
    order = np.argsort(bound, kind="stable")
    step = max(1, PAIRS // (m * m))
    for first in range(0, order.size, step):
        at = order[first : first + step]
        if bound[at[0]] > value * (1 + 1e-9):
            break
        part = shapes[at]
        mac = (gram + np.swapaxes(part, 1, 2) @ part) ** 2 / (size[at, :, None] * size[at, None, :])
        mac[:, np.arange(m), np.arange(m)] = 0.0
        worst = mac.max(axis=(1, 2))
        least = float(worst.min())
        if least <= value:
            here = int(at[worst == least].min())
            best = min(best, here) if least == value else here
            value = least
    return best


def kinetic_weighted(shapes: Float, mass: Float) -> Float:
    """Shapes (n, d, m) times the root of the mass at each point: effective independence of the
    kinetic energy.

    Li, Li and Fritzen (2007): QR or effective independence of √m·φ prefers points that carry energy
    and so stand above the noise.

    Parameters
    ----------
    shapes : (n, d, m) float64
    mass : (n,) or (n, d) float64, kg
        Lumped mass at each point.
    """
    m = np.asarray(mass, dtype=np.float64)
    return np.asarray(shapes * np.sqrt(m if m.ndim == 2 else m[:, None])[:, :, None])


def qr_points(
    shapes: Float,
    count: int,
    *,
    xyz: Float | None = None,
    min_distance: float = 0.0,
    fixed: Bool | None = None,
    cost: Float | None = None,
) -> Int:
    """Points by QR of the transposed modal matrix with column pivoting, the d rows of a point taken
    together.

    Schedlinski and Link (1996), An approach to optimal pick-up and exciter placement. With one
    direction a point this is the pivoted QR of LAPACK; when the modes are spanned, it starts again
    with the points that are left.

    Parameters
    ----------
    shapes : (n, d, m) float64
    count : int
        Points, the fixed ones included.
    xyz : (n, 3) float64, m, optional
    min_distance : float, m
    fixed : (n,) bool, optional
    cost : (n,) float64, optional
        The squared norm that is left counts per unit of cost.

    Returns
    -------
    (count,) int64
        Fixed ones first, then in order of choice.

    Raises
    ------
    InputError
        If the points run out.
    """
    price = 1.0 if cost is None else np.asarray(cost, dtype=np.float64)
    scale = float((shapes**2).sum(axis=(1, 2)).max(initial=0.0))
    chosen = [] if fixed is None else np.flatnonzero(fixed).tolist()
    free = np.ones(len(shapes), dtype=np.bool_)
    rest = np.array(shapes, dtype=np.float64)
    for i in chosen:
        rest = _without(rest, i)
        free &= _apart(xyz, i, len(shapes), min_distance)
    while len(chosen) < count:
        if not free.any():
            raise InputError(
                f"{len(chosen)} points are {min_distance:g} m apart, {count} were asked for: "
                "lower min_distance or "
                "name more candidates"
            )
        norm = np.where(free, (rest**2).sum(axis=(1, 2)) / price, -1.0)
        if norm.max() <= 1e-20 * scale:
            if not (shapes[free] ** 2).sum() > 1e-20 * scale:
                raise InputError(
                    f"the candidates that are left do not move in any mode; {len(chosen)} points "
                    "are useful"
                )
            rest = np.array(shapes, dtype=np.float64)
            continue
        best = int(np.argmax(norm))
        chosen.append(best)
        rest = _without(rest, best)
        free &= _apart(xyz, best, len(shapes), min_distance)
    return np.array(chosen, dtype=np.int64)


def _without(rest: Float, i: int) -> Float:
    """`rest` (n, d, m) with the space of the rows of point i projected out."""
    _, s, v = np.linalg.svd(rest[i], full_matrices=False)
    basis = v[s > 1e-12 * max(s.max(initial=0.0), 1e-300)]
    return np.asarray(rest - (rest @ basis.T) @ basis)


def _apart(xyz: Float | None, i: int, n: int, distance: float) -> Bool:
    """Points (n,) that are not i, and farther than `distance` from it."""
    other = np.asarray(np.arange(n) != i)
    if distance <= 0:
        return other
    if xyz is None:
        raise InputError("min_distance needs the places xyz of the candidates")
    return np.asarray(other & (np.linalg.norm(xyz - xyz[i], axis=1) > distance))


def auto_mac_points(
    shapes: Float,
    count: int,
    *,
    xyz: Float | None = None,
    min_distance: float = 0.0,
    fixed: Bool | None = None,
    sweeps: int = 3,
) -> Int:
    """Points of least worst off-diagonal auto-MAC: pivoted QR, additions, then exchanges until none
    helps.

    Carne and Dohrmann (1995) for the additions (a design for modal tests by the auto-MAC).

    Parameters
    ----------
    shapes : (n, d, m) float64
    count : int
    xyz : (n, 3) float64, m, optional
    min_distance : float, m
        Of two candidates that are closer only the one with more effective independence takes part.
    fixed : (n,) bool, optional
    sweeps : int
        Most rounds of exchanges, each over all points that are not fixed.

    Returns
    -------
    (count,) int64, ascending

    Raises
    ------
    InputError
        If `count` points cannot tell the modes apart.
    """
    n, d, m = shapes.shape
    held = np.zeros(n, dtype=np.bool_) if fixed is None else np.asarray(fixed, dtype=np.bool_)
    if min_distance > 0 and xyz is not None:
        keep = thinned(independence(shapes), xyz, held, min_distance)
        return keep[auto_mac_points(shapes[keep], count, fixed=held[keep], sweeps=sweeps)]
    if not -(-m // d) <= count <= n:
        raise InputError(
            f"{count} points of {n} with {d} directions for {m} modes: ask for {-(-m // d)} to {n}"
        )
    start = qr_points(shapes, max(-(-m // d), int(held.sum())), fixed=held)
    chosen = lower_auto_mac(shapes, start, -1.0, count)
    for _ in range(sweeps):
        before = _worst(shapes, chosen)
        for i in chosen[~held[chosen]].tolist():
            other = lower_auto_mac(shapes, chosen[chosen != i], -1.0, count)
            if _worst(shapes, other) < _worst(shapes, chosen) - 1e-12:
                chosen = other
        if _worst(shapes, chosen) >= before - 1e-6:
            break
    return np.sort(chosen)


def _worst(shapes: Float, chosen: Int) -> float:
    return worst_off_diagonal(auto_mac(shapes[chosen].reshape(-1, shapes.shape[2])))


@dataclass(frozen=True, slots=True, eq=False)
class Loss:
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

    def __post_init__(self) -> None:
        freeze_fields(self, points=np.int64, combination=np.float64)


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
        Where not even all points tell the modes apart, `left` is 0 and `points` is empty.

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
    _, s, v = np.linalg.svd(rows[subsets].reshape(len(subsets), k * d, m), full_matrices=False)
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
            top = np.linalg.norm(rows[trial].reshape(len(trial), -1, m), ord=2, axis=(1, 2))
            grown.append(trial[int(np.argmax(top))])
        subsets = np.array(grown)
    return subsets


def add_redundancy(
    shapes: Float,
    chosen: Int,
    k: int,
    *,
    least: float = 0.1,
    most: int = 0,
    xyz: Float | None = None,
    min_distance: float = 0.0,
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
    least : float, 0..1
    most : int
        Most points in all; 0: all candidates.
    xyz : (n, 3) float64, m, optional
    min_distance : float, m
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
    free = np.ones(len(shapes), dtype=np.bool_)
    for i in points.tolist():
        free &= _apart(xyz, i, len(shapes), min_distance)
    while (loss := worst_sensor_loss(shapes[points], k)).left < least:
        rest = np.flatnonzero(free)
        if points.size >= most or not rest.size:
            lower = (
                f", a distance below {min_distance:.2g} m"
                if min_distance > 0 and not rest.size
                else ""
            )
            raise InputError(
                f"with {points.size} points the loss of any {k} leaves {100 * loss.left:.2g} % "
                "of the information, "
                f"{100 * least:g} % are asked for: allow more points{lower} or less redundancy"
            )
        seen = ((shapes[rest] @ loss.combination) ** 2).sum(axis=1)
        best = int(rest[np.argmax(seen)])
        points = np.append(points, best)
        free &= _apart(xyz, best, len(shapes), min_distance)
    return points


def prior_auto_mac(samples: Float, chosen: Int) -> Float:
    """Worst off-diagonal auto-MAC of the chosen points at each sample of the prior, (s,).

    Parameters
    ----------
    samples : (s, n, d, m) float64
        From `information.prior_shapes`, rows of a point together.
    chosen : (c,) int64
    """
    m = samples.shape[3]
    return np.array([worst_off_diagonal(auto_mac(x[chosen].reshape(-1, m))) for x in samples])
