"""A choice by hand applied: poles picked on the diagrams become modes as the automatic ones are,
others go or join.

The automatic modes keep their numbers: what is picked beside them is not refined with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.choice import Choice, Pick
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import DataError
from ringtrue.identification.ambient_verdict import Found
from ringtrue.identification.cluster import CUT, cluster_poles, distances
from ringtrue.identification.pick import centre
from ringtrue.identification.poles import PoleSet, unit
from ringtrue.identification.ssi import BandPoles
from ringtrue.identification.stabilise import Candidates, groups_table, stacked
from ringtrue.shapes.mac import mac

WITHIN = 0.01  # of its frequency: so near a pick must be to what it means
SAME = (
    0.9  # MAC above which a pick replaces the automatic mode that it lies within the bandwidth of
)
Row = tuple[int, int]  # band, and row of its table


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


def with_picks(table: Candidates, band: BandPoles, choice: Choice | None) -> tuple[Candidates, Int]:
    """The candidates of a band with a row for each pick that none of them is, and the pick of each
    row, -1 for none.

    Parameters
    ----------
    table : Candidates
        The automatic ones, before refinement.
    band : BandPoles
    choice : Choice, optional
    """
    groups: list[Int] = []
    picks: list[int] = []
    like: list[int] = []
    for k, pick in enumerate(choice.picks if choice else ()):
        if pick.order:
            at = pole_of(band.poles, pick)
            groups += [np.array([at])] if at >= 0 else []
            like += [_orders_like(band.poles, at)] if at >= 0 else []
        elif not (np.abs(table.frequencies / pick.frequency - 1) <= WITHIN).any():
            found = group_of(band.poles, pick.frequency)
            groups += [found] if found.size else []
            like += [found.size] if found.size else []
        picks += [k] * (len(groups) - len(picks))
    automatic = np.full(table.pole.size, -1, dtype=np.int64)
    if not groups:
        return table, automatic
    more = groups_table(band, groups)
    orders = np.stack([np.array(like), more.orders[:, 1]], axis=1)
    return stacked(table, replace(more, orders=orders)), np.concatenate([automatic, picks]).astype(
        np.int64
    )


def _orders_like(poles: PoleSet, at: int) -> int:
    """Orders with a pole like that at a position."""
    far = distances(poles.pole, poles.shape)[at]
    return int(np.unique(poles.order[far < CUT]).size)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """What is reported after a choice.

    Attributes
    ----------
    found : list of Found
        The bands, with rows of joined modes.
    rows : list of (band, row), ascending in frequency
    said : mapping of (band, row) to str
        What the hand did to a row.
    notes : tuple of str
        What was rejected, and entries that met nothing.
    """

    found: list[Found]
    rows: list[Row]
    said: Mapping[Row, str]
    notes: tuple[str, ...]


def chosen(
    found: Sequence[Found], automatic: Sequence[Row], choice: Choice | None, source: str = ""
) -> Chosen:
    """Apply a choice to the candidates of all bands.

    Parameters
    ----------
    found : sequence of Found
    automatic : sequence of (band, row)
        What is reported without a choice.
    choice : Choice, optional

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    found, rows = list(found), list(automatic)
    if choice is None:
        return Chosen(found, rows, {}, ())
    said = _picked(found, rows, choice, source)
    if choice.automatic:
        rows = [r for r in rows if r not in said and not _replaced(found, r, said)] + list(said)
    else:
        rows = list(said)
    notes: list[str] = []
    for reject in choice.rejects:
        if (row := _nearest(found, rows, reject.frequency)) is None:
            notes.append(f"rejected by hand, but not there: a mode at {reject.frequency:.5g} Hz")
        else:
            rows.remove(row)
            notes.append(f"mode at {_f(found, row):.5g} Hz rejected by hand: {reject.reason}")
    for merge in choice.merges:
        near = [_nearest(found, rows, f) for f in merge.frequencies]
        members = list(dict.fromkeys(r for r in near if r is not None))
        if len(members) < 2:
            told = ", ".join(f"{f:.5g}" for f in merge.frequencies)
            notes.append(f"merged by hand, but not there as different modes: {told} Hz")
            continue
        text = ", ".join(f"{_f(found, r):.5g}" for r in members)
        rows = [r for r in rows if r not in members]
        found, new = _joined(found, members)
        why = f" ({merge.reason})" if merge.reason else ""
        said[new] = f"merged by hand from {text} Hz{why}"
        rows.append(new)
    rows.sort(key=lambda r: _f(found, r))
    return Chosen(found, rows, said, tuple(notes))


def _f(found: Sequence[Found], row: Row) -> float:
    return float(found[row[0]].table.frequencies[row[1]])


def _nearest(found: Sequence[Found], rows: Sequence[Row], frequency: float) -> Row | None:
    near = [(abs(_f(found, r) / frequency - 1), r) for r in rows]
    far, row = min(near, default=(np.inf, None))
    return row if far <= WITHIN else None


def _picked(
    found: Sequence[Found], automatic: Sequence[Row], choice: Choice, source: str
) -> dict[Row, str]:
    """The row of each pick, and what to say of it."""
    every = [(b, i) for b, x in enumerate(found) for i in range(x.table.pole.size)]
    meant = np.array([found[b].picked[i] for b, i in every], dtype=np.int64)
    sure = np.array([found[b].confidence[i] for b, i in every])
    said: dict[Row, str] = {}
    rest = []
    for k, pick in enumerate(choice.picks):
        own = np.flatnonzero(meant == k)
        if own.size:  # in two bands where they overlap
            order = f", order {pick.order}" if pick.order else ""
            said[every[own[np.argmax(sure[own])]]] = f"chosen by hand{order}"
        else:
            rest.append(k)
    free = [r for r, m in zip(every, meant, strict=True) if m < 0]
    f = np.array([_f(found, r) for r in free])
    doubt = np.array(
        [float(r not in automatic) + 0.1 * (1 - found[r[0]].confidence[r[1]]) for r in free]
    )
    at = match(np.array([choice.picks[k].frequency for k in rest]), f, doubt)
    for k, j in zip(rest, at.tolist(), strict=True):
        if j < 0:
            raise nothing_there(
                source or "choice", choice.picks[k], [x.diagram.poles for x in found]
            )
        said[free[j]] = "confirmed by hand" if free[j] in automatic else "chosen by hand"
    return said


def _replaced(found: Sequence[Found], row: Row, said: Mapping[Row, str]) -> bool:
    """Whether a picked row is the same mode as an automatic one."""
    x, i = found[row[0]], row[1]
    width = x.table.damping[i] * x.table.frequencies[i]
    for b, j in said:
        near = abs(_f(found, (b, j)) - _f(found, row)) < width
        if near and mac(x.shape[:, [i]], found[b].shape[:, [j]])[0, 0] > SAME:
            return True
    return False


def _joined(found: list[Found], rows: Sequence[Row]) -> tuple[list[Found], Row]:
    """The bands with one more row: the mean by inverse variance of the rows, in the band that knows
    one best.
    """
    sharp = np.array([found[b].table.stds()[0][i] / _f(found, (b, i)) for b, i in rows])
    w = 1 / sharp**2 / (1 / sharp**2).sum()
    k = int(np.argmin(sharp))
    b = rows[k][0]
    x, new = found[b], found[b].table.pole.size
    tables = [found[band].table.take(np.array([i])) for band, i in rows]
    # rows of other bands deviate in columns of their own
    parts = [v * t.deviation for v, t in zip(w, tables, strict=True)]
    here = sum(d for d, (band, _) in zip(parts, rows, strict=True) if band == b)
    own = np.concatenate(
        [here, *(d for d, (band, _) in zip(parts, rows, strict=True) if band != b)], axis=1
    )
    wide = np.zeros((new, own.shape[1]), dtype=np.complex128)
    wide[:, : x.table.deviation.shape[1]] = x.table.deviation
    shapes = np.stack([found[band].shape[:, i] for band, i in rows], axis=1)
    stds = np.stack([found[band].shape_std[:, i] for band, i in rows], axis=1)
    row = replace(
        tables[k],
        pole=np.array([sum(v * t.pole[0] for v, t in zip(w, tables, strict=True))]),
        deviation=own,
        orders=np.stack([t.orders[0] for t in tables]).max(axis=0, keepdims=True),
        label=np.where(np.isin(x.table.label, [i for band, i in rows if band == b]), 0, -1),
    )
    table = stacked(replace(x.table, deviation=wide), row)
    made = replace(
        x,
        table=table,
        shape=np.concatenate([x.shape, _mean_shape(shapes, w, k)], axis=1),
        shape_std=np.concatenate([x.shape_std, np.sqrt(stds**2 @ w**2)[:, None]], axis=1),
        confidence=np.append(x.confidence, max(found[band].confidence[i] for band, i in rows)),
        picked=np.append(x.picked, -1),
        diagram=replace(x.diagram, cluster=table.label),
    )
    return [made if j == b else y for j, y in enumerate(found)], (b, new)


def _mean_shape(shapes: Complex, weights: Float, first: int) -> Complex:
    """(ch, 1) weighted mean of shapes (ch, m) turned to the phase of one of them."""
    turn = shapes[:, first].conj() @ shapes
    return unit((shapes * (turn.conj() / np.maximum(np.abs(turn), 1e-300))) @ weights[:, None])


def modes_by_hand(
    poles: PoleSet, channels: tuple[str, ...], choice: Choice, *, source: str = ""
) -> tuple[ModeSet, Uncertainty, tuple[str, ...]]:
    """Modes picked from the poles of any method; rejects and merges have nothing to work on and are
    not used.

    With an order the pole itself is taken; without one, frequency and damping are means over the
    largest group of poles there, by inverse variance where standard deviations are known, and the
    shape is that of its middle.

    Parameters
    ----------
    poles : PoleSet
    channels : tuple of str
        Rows of the shapes.
    choice : Choice
    source : str

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    groups = []
    for pick in choice.picks:
        at = np.array([pole_of(poles, pick)]) if pick.order else group_of(poles, pick.frequency)
        if not at.size or at[0] < 0:
            raise nothing_there(source or choice.source or "choice", pick, [poles])
        groups.append(at)
    rows = np.array([centre(poles, g) for g in groups]).reshape(len(groups), 5)
    rank = np.argsort(rows[:, 0], kind="stable")
    rows = rows[rank]
    shape = unit(poles.shape[:, rows[:, 4].astype(np.int64)])
    modes = ModeSet(rows[:, 0], rows[:, 1], shape, channels, source=source)
    said = tuple(f"chosen by hand: {groups[k].size} of {poles.orders.size} orders" for k in rank)
    return (
        modes,
        Uncertainty.independent(rows[:, 2], rows[:, 3], np.full(shape.shape, np.nan)),
        said,
    )
