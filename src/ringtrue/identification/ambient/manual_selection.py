"""A choice by hand applied to an ambient record: modes added, confirmed, rejected or merged.

The automatic modes keep their numbers: what is picked besides them is not refined with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.choice import Choice
from ringtrue.identification.ambient.candidates import CandidateModes, groups_table, stacked
from ringtrue.identification.ambient.confidence import BandModes
from ringtrue.identification.ambient.ssi_cov import BandPoles
from ringtrue.identification.common.manual_selection import (
    WITHIN,
    group_of,
    match,
    nothing_there,
    pole_of,
)
from ringtrue.identification.common.poles import PoleSet, unit
from ringtrue.identification.common.stabilisation import CUT, distances
from ringtrue.shapes.mac import mac

# MAC above which a pick replaces the automatic mode that it lies within the bandwidth of
SAME = 0.9
Row = tuple[int, int]  # band, and row of its table


def with_picks(
    table: CandidateModes, band: BandPoles, choice: Choice | None
) -> tuple[CandidateModes, Int]:
    """The candidates of a band with a row for each pick that none of them is, and the pick of each
    row, -1 for none.

    Parameters
    ----------
    table : CandidateModes
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
    found : list of BandModes
        The bands, with rows of joined modes.
    rows : list of (band, row), ascending in frequency
    said : mapping of (band, row) to str
        What the hand did to a row.
    notes : tuple of str
        What was rejected, and entries that met nothing.
    """

    found: list[BandModes]
    rows: list[Row]
    said: Mapping[Row, str]
    notes: tuple[str, ...]


def chosen(
    found: Sequence[BandModes], automatic: Sequence[Row], choice: Choice | None, source: str = ""
) -> Chosen:
    """Apply a choice to the candidates of all bands.

    Parameters
    ----------
    found : sequence of BandModes
    automatic : sequence of (band, row)
        What is reported without a choice.
    choice : Choice, optional

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    found = list(found)
    rows = list(automatic)
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
            wanted = ", ".join(f"{f:.5g}" for f in merge.frequencies)
            notes.append(f"merged by hand, but not there as different modes: {wanted} Hz")
            continue
        text = ", ".join(f"{_f(found, r):.5g}" for r in members)
        rows = [r for r in rows if r not in members]
        found, new = _joined(found, members)
        why = f" ({merge.reason})" if merge.reason else ""
        said[new] = f"merged by hand from {text} Hz{why}"
        rows.append(new)
    rows.sort(key=lambda r: _f(found, r))
    return Chosen(found, rows, said, tuple(notes))


def _f(found: Sequence[BandModes], row: Row) -> float:
    return float(found[row[0]].table.frequencies[row[1]])


def _nearest(found: Sequence[BandModes], rows: Sequence[Row], frequency: float) -> Row | None:
    near = [(abs(_f(found, r) / frequency - 1), r) for r in rows]
    far, row = min(near, default=(np.inf, None))
    return row if far <= WITHIN else None


def _picked(
    found: Sequence[BandModes], automatic: Sequence[Row], choice: Choice, source: str
) -> dict[Row, str]:
    """The row of each pick, and what to say of it."""
    every = [(b, i) for b, x in enumerate(found) for i in range(x.table.pole.size)]
    meant = np.array([found[b].picked[i] for b, i in every], dtype=np.int64)
    conf = np.array([found[b].confidence[i] for b, i in every])
    said: dict[Row, str] = {}
    rest = []
    for k, pick in enumerate(choice.picks):
        own = np.flatnonzero(meant == k)
        if own.size:  # in two bands where they overlap
            order = f", order {pick.order}" if pick.order else ""
            said[every[own[np.argmax(conf[own])]]] = f"chosen by hand{order}"
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


def _replaced(found: Sequence[BandModes], row: Row, said: Mapping[Row, str]) -> bool:
    """Whether a picked row is the same mode as an automatic one."""
    x = found[row[0]]
    i = row[1]
    width = x.table.damping[i] * x.table.frequencies[i]
    for b, j in said:
        near = abs(_f(found, (b, j)) - _f(found, row)) < width
        if near and mac(x.shape[:, [i]], found[b].shape[:, [j]])[0, 0] > SAME:
            return True
    return False


def _joined(found: list[BandModes], rows: Sequence[Row]) -> tuple[list[BandModes], Row]:
    """The bands with one more row: the mean by inverse variance of the rows, in the band that knows
    one best.
    """
    sharp = np.array([found[b].table.stds()[0][i] / _f(found, (b, i)) for b, i in rows])
    w = 1 / sharp**2 / (1 / sharp**2).sum()
    k = int(np.argmin(sharp))
    b = rows[k][0]
    x = found[b]
    new = found[b].table.pole.size
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
