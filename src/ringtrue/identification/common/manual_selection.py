"""A choice by hand: which pole of the stabilisation diagrams a frequency and an order mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Float, Int
from ringtrue.core.choice import Choice, Pick
from ringtrue.core.modes import ModeSet
from ringtrue.errors import DataError
from ringtrue.identification.common.poles import PoleSet
from ringtrue.identification.common.stabilisation import cluster_poles

WITHIN = 0.01  # of its frequency: so near a pick must be to what it means


def as_choice(
    modes: ModeSet, reasons: Sequence[str] = (), *, record: str = "", source: str = ""
) -> Choice:
    """The modes as a choice that reports these and no others; replayed as it is, it changes
    nothing.
    """
    notes = [reasons[k] if k < len(reasons) else "" for k in range(len(modes))]
    picks = (
        Pick(float(f), 0, record, note) for f, note in zip(modes.frequencies, notes, strict=True)
    )
    return Choice(tuple(picks), automatic=False, source=source)


def match(wanted: Float, there: Float, penalty: Float | None = None) -> Int:
    """Position (w,) in `there` (n,) Hz of each frequency `wanted` (w,), one to one within `WITHIN`;
    -1 for none.

    `penalty` (n,), 0..2, makes a position less likely to be taken.
    """
    at = np.full(wanted.size, -1, dtype=np.int64)
    if not wanted.size or not there.size:
        return at
    far = np.abs(there / wanted[:, None] - 1) / WITHIN
    cost = np.where(far <= 1, far + (0.0 if penalty is None else penalty), 1e6)
    rows, cols = linear_sum_assignment(cost)
    good = far[rows, cols] <= 1
    at[rows[good]] = cols[good]
    return at


def pole_of(poles: PoleSet, pick: Pick) -> int:
    """Position of the pole that a pick with an order means; -1 if there is none within `WITHIN`."""
    at = np.flatnonzero(poles.order == pick.order)
    far = np.abs(poles.frequencies[at] / pick.frequency - 1)
    return int(at[np.argmin(far)]) if at.size and far.min() <= WITHIN else -1


def group_of(poles: PoleSet, frequency: float) -> Int:
    """Positions of the poles of the largest cluster within `WITHIN` of a frequency, Hz; none if it
    has no two.
    """
    at = np.flatnonzero(np.abs(poles.frequencies / frequency - 1) <= WITHIN)
    if at.size < 2:
        return at[:0]
    label = cluster_poles(poles.pole[at], poles.shape[:, at], poles.order[at])
    size = np.bincount(label[label >= 0], minlength=1)
    return at[label == int(np.argmax(size))] if size.max() > 1 else at[:0]


def nothing_there(source: str, pick: Pick, sets: Sequence[PoleSet]) -> DataError:
    """The error of a pick that means no pole."""
    f = np.concatenate([p.frequencies for p in sets]) if sets else np.empty(0)
    order = np.concatenate([p.order for p in sets]) if sets else np.empty(0, dtype=np.int64)
    where = f"{pick.frequency:.6g} Hz" + (f" at order {pick.order}" if pick.order else "")
    if not f.size:
        return DataError(f"{source}: pick at {where}: the diagrams hold no pole")
    k = int(np.argmin(np.abs(f - pick.frequency)))
    return DataError(
        f"{source}: pick at {where}: no such pole within {100 * WITHIN:g} %; the nearest is at "
        f"{f[k]:.6g} Hz, "
        f"order {order[k]}"
    )
