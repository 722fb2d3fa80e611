"""Modes followed from point to point through crossing and veering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Any_, Float, Int, freeze_fields
from ringtrue.errors import InputError
from ringtrue.shapes.mac import mac
from ringtrue.shapes.orthogonality import Mass, mass_mac


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Where the modes of one point are at the next.

    Attributes
    ----------
    index : (m,) int64
        Position at the new point of each mode followed.
    overlap : (m,) float64, 0..1
        Squared overlap (MAC over the mass, if given) of old and new shape.
    runner_up : (m,) float64, 0..1
        The best of the other new modes.
    """

    index: Int
    overlap: Float
    runner_up: Float

    def __post_init__(self) -> None:
        freeze_fields(self, index=np.int64, overlap=np.float64, runner_up=np.float64)


def follow(old: Any_, new: Any_, mass: Mass | None = None) -> Step:
    """The one-to-one assignment of greatest total overlap between the shapes of two points.

    Parameters
    ----------
    old : (n, m) float64 or complex128
        The modes followed.
    new : (n, k) float64 or complex128, k >= m
    mass : (n, n), optional
        The overlap is then that of the mass product, which is exact; without it shapes at few
        channels may look equal.

    Raises
    ------
    InputError
        If there are fewer new modes than followed ones.
    """
    old = np.asarray(old)
    new = np.asarray(new)
    m = old.shape[1]
    if new.shape[1] < m:
        raise InputError(
            f"{m} modes to follow, {new.shape[1]} at the new point; compute more there"
        )
    share = mac(old, new) if mass is None else mass_mac(old, new, mass)
    rows, cols = linear_sum_assignment(-share)
    index = cols[np.argsort(rows)]
    best = share[np.arange(m), index]
    other = share.copy()
    other[np.arange(m), index] = 0.0
    return Step(index, best, other.max(axis=1, initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Modes along a path.

    Attributes
    ----------
    points : (k, p) float64
    index : (k, m) int64
        Position of each followed mode among the modes of each point.
    frequencies : (k, m) float64, Hz
    overlap : (k, m) float64
        With the point before; ones at the first.
    solves : int
        Points at which modes were computed.
    """

    points: Float
    index: Int
    frequencies: Float
    overlap: Float
    solves: int = 0

    def __post_init__(self) -> None:
        freeze_fields(
            self, points=np.float64, index=np.int64, frequencies=np.float64, overlap=np.float64
        )

    @property
    def worst(self) -> Float:
        """(m,) smallest overlap of each mode along the path: below about 0.6 its identity was
        lost.
        """
        return np.asarray(self.overlap.min(axis=0))


def track(
    frequencies: Sequence[Float],
    shapes: Sequence[Any_],
    mass: Mass | None = None,
    *,
    count: int | None = None,
) -> Tracks:
    """Follow the `count` lowest modes of the first point (all) through a given sequence.

    Parameters
    ----------
    frequencies : sequence of (m_i,) float64, Hz
    shapes : sequence of (n, m_i) float64 or complex128
    mass : (n, n), optional
    """
    if len(frequencies) != len(shapes) or not len(shapes):
        raise InputError(f"{len(frequencies)} sets of frequencies for {len(shapes)} sets of shapes")
    m = np.shape(shapes[0])[1] if count is None else count
    index = [np.arange(m)]
    overlap = [np.ones(m)]
    for before, now in pairwise(shapes):  # each point rests on the one before
        step = follow(np.asarray(before)[:, index[-1]], now, mass)
        index.append(step.index)
        overlap.append(step.overlap)
    where = np.arange(len(shapes), dtype=np.float64)[:, None]
    f = np.array([np.asarray(f)[i] for f, i in zip(frequencies, index, strict=True)])
    return Tracks(
        points=where,
        index=np.array(index),
        frequencies=f,
        overlap=np.array(overlap),
        solves=len(shapes),
    )
