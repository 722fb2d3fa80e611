"""A choice by hand: which pole of the stabilisation diagrams a pick means, what is rejected or
merged.

In an ambient record modes are added, confirmed, rejected or merged. The automatic modes keep their
numbers: what is picked besides them is not refined with them. Of FRFs fitted modes stay, and poles
of the diagrams join them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.choice import SAME_MODE, Choice, Pick
from ringtrue.core.modes import ModeSet
from ringtrue.errors import DataError
from ringtrue.identification.ambient.confidence import BandModes, Row, listed
from ringtrue.identification.ambient.spectral_bins import (
    CandidateModes,
    groups_table,
    stacked,
)
from ringtrue.identification.ambient.ssi_cov import BandPoles
from ringtrue.identification.common.stabilisation import (
    CUT,
    PoleSet,
    cluster_poles,
    distances,
)
from ringtrue.identification.frf.confidence import CandidatePoles, DroppedPole
from ringtrue.identification.frf.refinement import Refined
from ringtrue.identification.frf.split_modes import support
from ringtrue.shapes import mac


def as_choice(
    modes: ModeSet, reasons: Sequence[str] = (), *, record: str = ""
) -> Choice:
    """The modes as a choice that reports these and no others; replayed as it is, it changes
    nothing.
    """
    notes = reasons or [""] * len(modes)
    noted = zip(modes.frequencies.tolist(), notes, strict=True)
    return Choice(tuple(Pick(f, 0, record, n) for f, n in noted), automatic=False)


def match(wanted: Float, there: Float, penalty: Float | None = None) -> Int:
    """Position (w,) in `there` (n,) Hz of each frequency `wanted` (w,), one to one; -1: none.

    `penalty` (n,), 0..2, makes a position as much farther away, but not one that is meant to the
    digits of a table.
    """
    at = np.full(wanted.size, -1, dtype=np.int64)
    if not wanted.size or not there.size:
        return at
    far = np.abs(there / wanted[:, None] - 1) / SAME_MODE
    cost = far if penalty is None else far * (1 + penalty)
    cost = np.where(far <= 1, cost, 1e6)
    rows, cols = linear_sum_assignment(cost)
    good = far[rows, cols] <= 1
    at[rows[good]] = cols[good]
    return at


def pole_of(poles: PoleSet, pick: Pick) -> int:
    """Position of the pole that a pick with an order means; -1 if none is near."""
    at = np.flatnonzero(poles.order == pick.order)
    far = np.abs(poles.frequencies[at] / pick.frequency - 1)
    return int(at[np.argmin(far)]) if at.size and far.min() <= SAME_MODE else -1


def group_of(poles: PoleSet, frequency: float) -> Int:
    """Positions of the poles of the largest cluster near a frequency, Hz; none if it has no two."""
    at = np.flatnonzero(np.abs(poles.frequencies / frequency - 1) <= SAME_MODE)
    if at.size < 2:
        return at[:0]
    label = cluster_poles(poles.pole[at], poles.shape[:, at], poles.order[at])
    size = np.bincount(label[label >= 0], minlength=1)
    return at[label == int(np.argmax(size))] if size.max() > 1 else at[:0]


def reject_and_merge(
    choice: Choice, frequency: Float, doubt: Float, *, keep: Bool, said: list[str]
) -> list[str]:
    """Take what the choice rejects out of the modes, and all but the best known of those it merges.

    Parameters
    ----------
    choice : Choice
    frequency : (m,) float64, Hz
    doubt : (m,) float64
        Of the modes to be merged the one of least doubt stays.
    keep : (m,) bool
        Modes that are there; changed in place.
    said : list of str
        What the hand did to each mode; changed in place.

    Returns
    -------
    list of str
        Notes on what was rejected, and on entries that met nothing.
    """

    def nearest(wanted: float) -> int:
        far = np.where(keep, np.abs(frequency / wanted - 1), np.inf)
        k = int(np.argmin(far)) if far.size else -1
        return k if k >= 0 and far[k] <= SAME_MODE else -1

    notes = []
    for reject in choice.rejects:
        k = nearest(reject.frequency)
        if k < 0:
            notes.append(
                f"rejected by hand, but not there: a mode at {reject.frequency:.5g} Hz"
            )
            continue
        keep[k] = False
        notes.append(f"mode at {frequency[k]:.5g} Hz rejected by hand: {reject.reason}")
    for merge in choice.merges:
        near = [nearest(f) for f in merge.frequencies]
        members = list(dict.fromkeys(k for k in near if k >= 0))
        if len(members) < 2:
            wanted = ", ".join(f"{f:.5g}" for f in merge.frequencies)
            notes.append(
                f"merged by hand, but not there as different modes: {wanted} Hz"
            )
            continue
        best = min(members, key=lambda k: float(doubt[k]))
        keep[members] = False
        keep[best] = True
        why = f" ({merge.reason})" if merge.reason else ""
        text = ", ".join(f"{frequency[k]:.5g}" for k in members)
        said[best] = f"merged by hand from {text} Hz{why}"
    return notes


def _place(source: str, pick: Pick) -> str:
    order = f" at order {pick.order}" if pick.order else ""
    return f"{source or 'choice'}: pick at {pick.frequency:.6g} Hz{order}"


def with_evidence(said: str, evidence: str) -> str:
    """What the hand did to a mode, and the evidence for it; either may be empty."""
    return "; ".join(filter(None, (said, evidence)))


def nothing_there(source: str, pick: Pick, sets: Sequence[PoleSet]) -> DataError:
    """The error of a pick that means no pole."""
    where = _place(source, pick)
    f = np.concatenate([np.empty(0), *(p.frequencies for p in sets)])
    if not f.size:
        return DataError(f"{where}: the diagrams hold no pole")
    order = np.concatenate([p.order for p in sets])
    k = int(np.argmin(np.abs(f - pick.frequency)))
    return DataError(
        f"{where}: no such pole within {100 * SAME_MODE:g} %; the nearest is at {f[k]:.6g} Hz, "
        f"order {order[k]}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class HandPoles:
    """What a choice makes of the fitted modes.

    Attributes
    ----------
    keep : (m,) bool
        Fitted modes that stay.
    added : CandidatePoles
        Poles that join them.
    taken : tuple of int
        Doubtful modes that are among these.
    said : tuple of str
        For each kept and then each added mode what the hand did; empty for nothing.
    notes : tuple of str
        What was rejected, and entries that met nothing.
    """

    keep: Bool
    added: CandidatePoles
    taken: tuple[int, ...]
    said: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def changes(self) -> bool:
        """Whether the fit must be made anew."""
        return bool(not self.keep.all() or self.added.pole.size)


def hand_poles(
    fit: Refined,
    sets: Sequence[PoleSet],
    choice: Choice,
    band: tuple[float, float],
    *,
    decay: float = 0.0,
    doubtful: Sequence[DroppedPole] = (),
) -> HandPoles:
    """Apply a choice to the automatic fit; fitted modes outside the reported band stay in any case.

    Parameters
    ----------
    fit : Refined
    sets : sequence of PoleSet
        The poles of the diagrams, `shape` holding participation vectors.
    choice : Choice
    band : (float, float), Hz
        What is reported.
    decay : float, 1/s
        Exponential window still in `sets`.
    doubtful : sequence of DroppedPole
        A pick may mean one of these, too.

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    f = fit.frequencies
    inside = (f >= band[0]) & (f <= band[1])
    said = [""] * f.size
    keep = ~inside | choice.automatic
    added: list[tuple[complex, Complex]] = []
    texts: list[str] = []
    taken: list[int] = []
    plain = [p for p in choice.picks if not p.order]
    there = np.append(np.where(inside, f, np.inf), [d.frequency for d in doubtful])
    at = _meant(plain, there, np.arange(there.size) < f.size)
    for pick, k in zip(plain, at.tolist(), strict=True):
        if k >= f.size:
            taken.append(k - f.size)
            added.append((doubtful[taken[-1]].pole, doubtful[taken[-1]].participation))
            texts.append("taken up by hand")
        elif k >= 0:
            keep[k] = True
            said[k] = "confirmed by hand"
        else:
            added.append(_pole(pick, sets, decay, choice.source))
            texts.append("chosen by hand")
    for pick in (p for p in choice.picks if p.order):
        pole, part = _pole(pick, sets, decay, choice.source)
        added.append((pole, part))
        texts.append(f"chosen by hand, order {pick.order}")
        replaced = inside & (np.abs(fit.poles - pole) < 0.5 * np.abs(pole.real))
        keep &= ~replaced | np.array([bool(text) for text in said])
    shown = keep & inside
    notes = reject_and_merge(choice, f, fit.std_frequency / f, keep=shown, said=said)
    keep = np.where(inside, shown, keep)
    n_in = sets[0].shape.shape[0] if sets else 1
    poles = np.array([p for p, _ in added], dtype=np.complex128)
    parts = np.array([v for _, v in added], dtype=np.complex128).reshape(
        len(added), n_in
    )
    more = CandidatePoles(
        poles, parts, support(poles, parts, sets, decay), np.zeros(poles.size)
    )
    kept = [said[k] for k in np.flatnonzero(keep)]
    return HandPoles(keep, more, tuple(taken), (*kept, *texts), tuple(notes))


def _meant(picks: Sequence[Pick], frequency: Float, natural: Bool) -> Int:
    """Position in `frequency` (m,) Hz of the mode that each pick means, -1 for none. A natural mode
    is meant rather than a doubtful one, but for the digits of the latter.
    """
    wanted = np.array([p.frequency for p in picks])
    return match(wanted, frequency, (~natural).astype(np.float64))


def chosen_of_setups(
    frequency: Float, deviation: Float, natural: Bool, choice: Choice
) -> tuple[Bool, list[str], list[str]]:
    """Apply a choice to the candidates of several setups, by frequency: an order is that of a pole
    of one setup, and plays no role.

    Parameters
    ----------
    frequency, deviation : (m,) float64, Hz
    natural : (m,) bool
        What is reported without a choice.
    choice : Choice

    Returns
    -------
    keep : (m,) bool
    said : list of str
        What the hand did to each.
    notes : list of str
        What was rejected, and entries that met nothing.

    Raises
    ------
    DataError
        If a pick means no candidate.
    """
    at = _meant(choice.picks, frequency, natural)
    keep = natural & choice.automatic
    said = [""] * frequency.size
    for pick, k in zip(choice.picks, at.tolist(), strict=True):
        if k < 0:
            where = _place(choice.source, pick)
            raise DataError(
                f"{where}: no candidate of the setups within {100 * SAME_MODE:g} %"
            )
        keep[k] = True
        said[k] = "confirmed by hand" if natural[k] else "taken up by hand"
    notes = reject_and_merge(
        choice, frequency, deviation / frequency, keep=keep, said=said
    )
    return keep, said, notes


def current_poles(
    modes: ModeSet,
    sets: Sequence[PoleSet],
    choice: Choice | None,
    *,
    decay: float = 0.0,
    doubtful: ModeSet | None = None,
) -> Complex:
    """Poles (m,), rad/s, of the automatic modes after a choice, before it is replayed: what is
    picked has its own pole if it is a doubtful mode, else that of its diagram.

    Parameters
    ----------
    modes : ModeSet
        The automatic ones.
    sets : sequence of PoleSet
        Those of the diagrams.
    choice : Choice, optional
    decay : float, 1/s
        Exponential window still in `sets`.
    doubtful : ModeSet, optional
        Further candidates.

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    own = _poles_of(modes)
    if choice is None:
        return own
    if doubtful is not None and len(doubtful):
        own = np.concatenate([own, _poles_of(doubtful)])
    natural = np.arange(own.size) < len(modes)
    keep = natural & choice.automatic
    plain = [p for p in choice.picks if not p.order]
    at = _meant(plain, np.abs(own) / (2 * np.pi), natural)
    keep[at[at >= 0]] = True
    picked = [p for p, k in zip(plain, at.tolist(), strict=True) if k < 0]
    picked += [p for p in choice.picks if p.order]
    new = np.array(
        [_pole(p, sets, decay, choice.source)[0] for p in picked], dtype=np.complex128
    )
    for pole in new:  # a pick replaces the automatic mode there
        keep &= np.abs(own - pole) >= 0.5 * np.abs(pole.real)
    both = np.concatenate([own, new])
    keep = np.concatenate([keep, np.ones(new.size, dtype=np.bool_)])
    reject_and_merge(
        choice,
        np.abs(both) / (2 * np.pi),
        np.abs(both),
        keep=keep,
        said=[""] * both.size,
    )
    return np.asarray(both[keep])


def _poles_of(modes: ModeSet) -> Complex:
    zeta = np.nan_to_num(modes.damping, nan=0.01)
    size = 2 * np.pi * modes.frequencies
    return np.asarray(size * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0.0))))


def _pole(
    pick: Pick, sets: Sequence[PoleSet], decay: float, source: str
) -> tuple[complex, Complex]:
    """Pole without the window and participation vector that a pick means, in the band that knows
    most of it.
    """
    found = []
    for s in sets:
        at = np.array([pole_of(s, pick)]) if pick.order else _late(s, pick.frequency)
        if at.size and at[0] >= 0:
            found.append((at.size, s, at))
    if not found:
        raise nothing_there(source, pick, sets)
    _, s, at = max(found, key=lambda x: x[0])
    pole = complex(np.median(s.pole[at].real), np.median(s.pole[at].imag))
    near = at[np.argmin(np.abs(s.pole[at] - pole))]
    return complex(min(pole.real + decay, -1e-4 * abs(pole)), pole.imag), s.shape[
        :, near
    ]


def _late(s: PoleSet, frequency: float) -> Int:
    """The group of poles at a frequency in the upper half of its orders, or the one of the highest
    order there.
    """
    at = group_of(s, frequency)
    if at.size:
        return at[s.order[at] >= np.median(s.order[at])]
    near = np.flatnonzero(np.abs(s.frequencies / frequency - 1) <= SAME_MODE)
    return near[[np.argmax(s.order[near])]] if near.size else near


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
    poles = band.poles
    groups: list[Int] = []
    picks: list[int] = []
    orders: list[int] = []
    for k, pick in enumerate(choice.picks if choice else ()):
        if pick.order:
            at = pole_of(poles, pick)
            if at < 0:
                continue
            group = np.array([at])
            like = distances(poles.pole, poles.shape)[at] < CUT
            orders.append(np.unique(poles.order[like]).size)
        else:
            known = (np.abs(table.frequencies / pick.frequency - 1) <= SAME_MODE).any()
            group = group_of(poles, pick.frequency)
            if known or not group.size:
                continue
            orders.append(group.size)
        groups.append(group)
        picks.append(k)
    automatic = np.full(table.pole.size, -1, dtype=np.int64)
    if not groups:
        return table, automatic
    more = groups_table(band, groups)
    more = replace(more, orders=np.stack([np.array(orders), more.orders[:, 1]], axis=1))
    picked = np.concatenate([automatic, picks]).astype(np.int64)
    return stacked(table, more), picked


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """What is reported after a choice.

    Attributes
    ----------
    rows : list of (band, row), ascending in frequency
    said : mapping of (band, row) to str
        What the hand did to a row.
    notes : tuple of str
        What was rejected, and entries that met nothing.
    """

    rows: list[Row]
    said: Mapping[Row, str]
    notes: tuple[str, ...]


def chosen(
    found: list[BandModes],
    automatic: Sequence[Row],
    choice: Choice | None,
    source: str = "",
) -> Chosen:
    """Apply a choice to the candidates of all bands.

    Parameters
    ----------
    found : list of BandModes
    automatic : sequence of (band, row)
        What is reported without a choice.
    choice : Choice, optional

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    if choice is None:
        return Chosen(list(automatic), {}, ())
    rows = [(b, i) for b, x in enumerate(found) for i in range(x.table.pole.size)]
    c = listed(found, rows)
    f = c.frequency
    picked = np.concatenate([x.picked for x in found])
    reported = np.array([row in automatic for row in rows], dtype=np.bool_)
    said = [""] * len(rows)
    rest = []
    for k, pick in enumerate(choice.picks):
        own = np.flatnonzero(picked == k)
        if own.size:  # in two bands where they overlap
            order = f", order {pick.order}" if pick.order else ""
            said[own[np.argmax(c.confidence[own])]] = f"chosen by hand{order}"
        else:
            rest.append(pick)
    free = np.flatnonzero(picked < 0)
    penalty = ~reported[free] + 0.1 * (1 - c.confidence[free])
    at = match(np.array([pick.frequency for pick in rest]), f[free], penalty)
    for pick, j in zip(rest, at.tolist(), strict=True):
        if j < 0:
            raise nothing_there(source, pick, [x.diagram.poles for x in found])
        said[free[j]] = "confirmed by hand" if reported[free[j]] else "chosen by hand"
    keep = np.array([bool(text) for text in said])
    by_hand = np.flatnonzero(keep)
    for k in np.flatnonzero(reported & ~keep).tolist() if choice.automatic else ():
        near = by_hand[np.abs(f[by_hand] - f[k]) < c.damping[k] * f[k]]
        # a pick replaces the automatic mode of its shape
        keep[k] = not (mac(c.shape[:, [k]], c.shape[:, near]) > 0.9).any()
    notes = reject_and_merge(choice, f, c.std_frequency / f, keep=keep, said=said)
    left = sorted(np.flatnonzero(keep).tolist(), key=lambda k: float(f[k]))
    return Chosen(
        [rows[k] for k in left], {rows[k]: said[k] for k in left}, tuple(notes)
    )
