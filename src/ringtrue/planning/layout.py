"""Where to measure and where to hit: effective independence, auto-MAC and driving-point residues.

Kammer (1991), Sensor placement for on-orbit modal identification; Schedlinski and Link (1996) for
the reference points: the information of the target modes at the candidates decides.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import InputError
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal

HARD = 64  # pairs of modes that bound the auto-MAC of an addition
PAIRS = 1_000_000  # pairs of modes of candidates that are looked at together


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


def shares(shapes: Float, largest: Float | None = None) -> Float:
    """Driving-point residues φ_im² of rows (r, m) over the largest of each mode, (m,), 0..1: of
    these if not given.
    """
    square = np.asarray(shapes, dtype=np.float64) ** 2
    over = square.max(axis=0) if largest is None else largest
    return np.asarray(np.minimum(square / np.maximum(over, 1e-300), 1.0))


def select_references(shapes: Float, count: int, largest: Float | None = None) -> Int:
    """Rows to hit, greedily by the worst driving-point residue over all modes.

    The residue of mode m at row i is φ_im², taken relative to the mode's largest.

    Parameters
    ----------
    shapes : (r, m) float64
        Mass-normalised shapes at the rows that can be hit.
    count : int
    largest : (m,) float64, optional
        Of φ² of each mode; that of these rows if not given.

    Returns
    -------
    (count,) int64
        In order of choice.
    """
    share = shares(shapes, largest)
    reached = np.zeros(shapes.shape[1])
    out: list[int] = []
    for _ in range(min(count, len(shapes))):
        # the smooth minimum over modes: lift the modes that are reached worst
        value = np.log(np.maximum(share, reached) + 1e-3).sum(axis=1)
        value[out] = -np.inf
        best = int(np.argmax(value))
        out.append(best)
        reached = np.maximum(reached, share[best])
    return np.array(out, dtype=np.int64)


def reached(shapes: Float, references: Int) -> Float:
    """The largest share of each mode's best driving-point residue that the references reach,
    (m,).
    """
    return np.asarray(shares(shapes)[references].max(axis=0))
