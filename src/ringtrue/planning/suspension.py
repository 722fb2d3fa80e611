"""Where to hang or support a structure, and what supports and sensors do to its frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.errors import InputError

_MOST_SETS = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Suspension:
    """Points to hang from.

    Attributes
    ----------
    points : (k,) int64
        Positions in the candidates, ascending.
    motion : float, 0..1
        Largest mean motion at the points in any target mode, over the largest at any candidate.
    steady : bool
        The vertical through the centre of gravity passes between the points.
    """

    points: Int
    motion: float
    steady: bool

    def __post_init__(self) -> None:
        freeze_fields(self, points=np.int64)


def quiet(shapes: Float) -> Float:
    """Motion (n,) of each point in the mode that moves it most, squared, over the mode's largest:
    0..1.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Along the directions of the suspension.
    """
    return np.asarray(_motion(shapes).max(axis=1))


def _motion(shapes: Float) -> Float:
    """(n, m) squared motion over the largest of the mode."""
    square = (np.asarray(shapes, dtype=np.float64) ** 2).sum(axis=1)
    return np.asarray(square / np.maximum(square.max(axis=0), 1e-300))


def suspension_points(
    shapes: Float, xyz: Float, count: int, cg: Float, *, min_distance: float = 0.0
) -> Suspension:
    """Points where the target modes move least, with the centre of gravity between them where
    possible.

    The quietest candidates are combined fully; a set is judged by the mode that moves its points
    most.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Target modes along the directions of the suspension.
    xyz : (n, 3) float64, m
    count : int
        2 or more; with two the centre of gravity must lie on their line and the set is not steady.
    cg : (3,) float64, m
        Gravity acts along Z.
    min_distance : float, m

    Raises
    ------
    InputError
        If no set of candidates is that far apart.
    """
    n = len(shapes)
    if not 1 <= count <= n:
        raise InputError(f"{count} suspension points of {n} candidates: must be 1 to {n}")
    pool = _pool(quiet(shapes), xyz, count, min_distance)
    sets = np.array(list(combinations(pool.tolist(), count)), dtype=np.int64).reshape(-1, count)
    gap = np.linalg.norm(xyz[sets][:, :, None] - xyz[sets][:, None], axis=3) + np.eye(count) * 1e300
    sets = sets[gap.min(axis=(1, 2)) >= min_distance]
    if not sets.size:
        raise InputError(
            f"no {count} of the quietest points are {min_distance:g} m apart: lower min_distance"
        )
    motion = _motion(shapes)[sets].mean(axis=1).max(axis=1)
    held = _between(xyz[sets][..., :2], np.asarray(cg, dtype=np.float64)[:2])
    best = int(np.lexsort((motion, ~held))[0])
    return Suspension(np.sort(sets[best]), float(motion[best]), bool(held[best]))


def _pool(motion: Float, xyz: Float, count: int, distance: float) -> Int:
    """The quietest points, neighbours thinned, as many as can be combined fully."""
    size = count
    while size < motion.size and comb(size + 1, count) <= _MOST_SETS:
        size += 1
    kept: list[int] = []
    for i in np.argsort(motion, kind="stable").tolist():  # greedy by nature, stops at tens
        if not kept or np.linalg.norm(xyz[kept] - xyz[i], axis=1).min() >= 0.5 * distance:
            kept.append(i)
        if len(kept) >= size:
            break
    return np.array(kept, dtype=np.int64)


def _between(plan: Float, point: Float) -> Bool:
    """Whether `point` (2,) lies in the hull of each set of points (s, k, 2): in one of its
    triangles.
    """
    k = plan.shape[1]
    inside = np.zeros(len(plan), dtype=np.bool_)
    for tri in combinations(range(k), 3):  # a handful of points
        a, b, c = (plan[:, i] - point for i in tri)
        turns = np.stack([_cross(a, b), _cross(b, c), _cross(c, a)])
        area = np.abs(turns.sum(axis=0))
        tiny = 1e-9 * area
        inside |= ((turns >= -tiny).all(axis=0) | (turns <= tiny).all(axis=0)) & (area > 0)
    return inside


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def loaded_frequencies(
    frequencies: Float, shapes: Float, mass: Float, stiffness: Float | None = None
) -> Float:
    """Frequencies (m,) with masses and springs added at points, Hz, by Rayleigh-Ritz on the given
    modes.

    (Λ + ΦᵀkΦ)q = λ(I + ΦᵀmΦ)q: an upper bound that the number of modes drives down; with one mode
    it is √((λ + Σkφ²)/(1 + Σmφ²)). Close modes mix, which the first-order shift -½Σmφ² of each
    alone misses.

    Parameters
    ----------
    frequencies : (m,) float64, Hz
    shapes : (n, d, m) float64, mass-normalised in SI
    mass : (n,) float64, kg
        Sensor, block and the moved part of its cable, at each point.
    stiffness : (n,) float64, N/m, optional
        Of a spring along each of the d directions.

    Raises
    ------
    InputError
        If masses do not match the points or are negative.
    """
    added = np.asarray(mass, dtype=np.float64)
    if added.shape != (len(shapes),) or (added < 0).any():
        raise InputError(f"mass {added.shape}: one number >= 0 for each of {len(shapes)} points")
    lam = (2 * np.pi * np.asarray(frequencies, dtype=np.float64)) ** 2
    M = np.eye(lam.size) + np.einsum("ndi,n,ndj->ij", shapes, added, shapes)
    K = np.diag(lam)
    if stiffness is not None:
        K = K + np.einsum("ndi,n,ndj->ij", shapes, np.asarray(stiffness, dtype=np.float64), shapes)
    values = linalg.eigh(K, M, eigvals_only=True)
    return np.asarray(np.sqrt(np.maximum(values, 0)) / (2 * np.pi))
