"""Where to measure and where to hit: effective independence, auto-MAC and driving-point residues.

Kammer (1991), Sensor placement for on-orbit modal identification; Schedlinski and Link (1996) for the reference
points: the information of the target modes at the candidates decides.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import InputError
from ringtrue.shapes.mac import auto_mac, worst_off_diagonal


def independence(shapes: Float) -> Float:
    """Effective independence of points, (n,): the share of the modes' information that each carries.

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
        Points to keep.
    fixed : (n,) bool, optional
        Points that stay.
    min_distance : float, m
        Of two candidates that are closer the weaker goes first.

    Returns
    -------
    (count,) int64
        Positions, ascending.

    Raises
    ------
    InputError
        If the points asked for cannot tell the modes apart, or there are too few.
    """
    n, d, m = shapes.shape
    if count * d < m:
        raise InputError(f"{count} points with {d} directions cannot tell {m} modes apart; ask for more points")
    keep = np.arange(n)
    held = np.zeros(n, dtype=np.bool_) if fixed is None else np.asarray(fixed, dtype=np.bool_)
    if min_distance > 0:
        keep = thinned(independence(shapes), xyz, held, min_distance)
    if keep.size < count:
        raise InputError(
            f"{keep.size} candidates are {min_distance:g} m apart, {count} points were asked for: "
            "lower min_distance or name more candidates"
        )
    while keep.size > count:
        score = independence(shapes[keep])
        score[held[keep]] = np.inf
        # a tenth at a time while there are many: the ranking of the weakest hardly changes
        drop = max(1, min((keep.size - count) // 10, keep.size - count))
        keep = np.delete(keep, np.argsort(score, kind="stable")[:drop])
    return keep


def thinned(score: Float, xyz: Float, held: Bool, distance: float) -> Int:
    """Candidates that are farther than `distance` apart, ascending: strongest first, each bans its neighbours.

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


def lower_auto_mac(shapes: Float, chosen: Int, target: float, most: int) -> Int:
    """Adds the points that lower the worst off-diagonal auto-MAC most, until it is below `target` or `most` are in.

    Parameters
    ----------
    shapes : (n, d, m) float64
    chosen : (k,) int64
    target : float, 0..1
    most : int
    """
    n, _, m = shapes.shape
    chosen = np.array(chosen)
    while chosen.size < most:
        now = shapes[chosen].reshape(-1, m)
        if worst_off_diagonal(auto_mac(now)) <= target:
            break
        rest = np.setdiff1d(np.arange(n), chosen)
        cross = now.T @ now + np.einsum("ndi,ndj->nij", shapes[rest], shapes[rest])
        size = np.einsum("nii->ni", cross)
        mac = cross**2 / (size[:, :, None] * size[:, None, :])
        mac[:, np.arange(m), np.arange(m)] = 0.0
        chosen = np.append(chosen, rest[int(np.argmin(mac.max(axis=(1, 2))))])
    return np.sort(chosen)


def select_references(shapes: Float, count: int) -> Int:
    """Rows to hit, greedily by the worst driving-point residue over all modes.

    The residue of mode m at row i is φ_im², taken relative to the mode's largest.

    Parameters
    ----------
    shapes : (r, m) float64
        Mass-normalised shapes at the rows that can be hit.

    Returns
    -------
    (count,) int64
        In order of choice.
    """
    share = shapes**2 / np.maximum((shapes**2).max(axis=0), 1e-300)
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
    """The largest share of each mode's best driving-point residue that the references reach, (m,)."""
    share = shapes**2 / np.maximum((shapes**2).max(axis=0), 1e-300)
    return np.asarray(share[references].max(axis=0))
