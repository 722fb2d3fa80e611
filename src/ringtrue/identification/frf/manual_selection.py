"""A choice by hand applied to FRFs: fitted modes that stay, and poles of the diagrams that join."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.choice import Choice, Pick
from ringtrue.identification.common.manual_selection import (
    WITHIN,
    group_of,
    match,
    nothing_there,
    pole_of,
)
from ringtrue.identification.common.poles import PoleSet
from ringtrue.identification.frf.added_modes import support
from ringtrue.identification.frf.confidence import CandidatePoles


@dataclass(frozen=True, slots=True, eq=False)
class HandPoles:
    """What a choice makes of the fitted modes.

    Attributes
    ----------
    keep : (m,) bool
        Fitted modes that stay.
    added : CandidatePoles
        Poles that join them.
    said : tuple of str
        For each kept and then each added mode what the hand did; empty for nothing.
    notes : tuple of str
        What was rejected, and entries that met nothing.
    """

    keep: Bool
    added: CandidatePoles
    said: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def changes(self) -> bool:
        """Whether the fit must be made anew."""
        return bool(not self.keep.all() or self.added.pole.size)


def hand_poles(
    fitted: Complex,
    sets: Sequence[PoleSet],
    choice: Choice,
    band: tuple[float, float],
    *,
    decay: float = 0.0,
    source: str = "",
) -> HandPoles:
    """Apply a choice to the automatic fit; fitted modes outside the reported band stay in any case.

    Parameters
    ----------
    fitted : (m,) complex128, rad/s
    sets : sequence of PoleSet
        The poles of the diagrams, `shape` holding participation vectors.
    choice : Choice
    band : (float, float), Hz
        What is reported.
    decay : float, 1/s
        Exponential window still in `sets`.
    source : str

    Raises
    ------
    DataError
        If a pick means no pole.
    """
    f = np.abs(fitted) / (2 * np.pi)
    inside = (f >= band[0]) & (f <= band[1])
    said = [""] * f.size
    keep = ~inside | choice.automatic
    added: list[tuple[complex, Complex]] = []
    texts: list[str] = []
    plain = [p for p in choice.picks if not p.order]
    at = match(np.array([p.frequency for p in plain]), np.where(inside, f, np.inf))
    for pick, k in zip(plain, at.tolist(), strict=True):
        if k >= 0:
            keep[k], said[k] = True, "confirmed by hand"
        else:
            added.append(_pole(pick, sets, decay, source))
            texts.append("chosen by hand")
    for pick in (p for p in choice.picks if p.order):
        pole, part = _pole(pick, sets, decay, source)
        added.append((pole, part))
        texts.append(f"chosen by hand, order {pick.order}")
        keep &= ~(inside & (np.abs(fitted - pole) < 0.5 * np.abs(pole.real))) | np.array(
            [bool(t) for t in said]
        )
    notes = _rejected(f, keep & inside, keep, choice)
    notes += _merged(f, keep & inside, keep=keep, said=said, choice=choice)
    n_in = sets[0].shape.shape[0] if sets else 1
    poles = np.array([p for p, _ in added], dtype=np.complex128)
    parts = np.array([v for _, v in added], dtype=np.complex128).reshape(len(added), n_in)
    more = CandidatePoles(poles, parts, support(poles, parts, sets, decay), np.zeros(poles.size))
    return HandPoles(keep, more, (*(said[k] for k in np.flatnonzero(keep)), *texts), tuple(notes))


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
        raise nothing_there(source or "choice", pick, sets)
    _, s, at = max(found, key=lambda x: x[0])
    pole = complex(np.median(s.pole[at].real), np.median(s.pole[at].imag))
    near = at[np.argmin(np.abs(s.pole[at] - pole))]
    return complex(min(pole.real + decay, -1e-4 * abs(pole)), pole.imag), s.shape[:, near]


def _late(s: PoleSet, frequency: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The group of poles at a frequency in the upper half of its orders, or the one of the highest
    order there.
    """
    at = group_of(s, frequency)
    if at.size:
        return np.asarray(at[s.order[at] >= np.median(s.order[at])])
    near = np.flatnonzero(np.abs(s.frequencies / frequency - 1) <= WITHIN)
    return near[[np.argmax(s.order[near])]] if near.size else near


def _nearest(f: Float, here: Bool, frequency: float) -> int:
    far = np.where(here, np.abs(f / frequency - 1), np.inf)
    k = int(np.argmin(far)) if far.size else -1
    return k if k >= 0 and far[k] <= WITHIN else -1


def _rejected(f: Float, inside: Bool, keep: Bool, choice: Choice) -> list[str]:
    """Take the rejected modes out of `keep`."""
    notes = []
    for reject in choice.rejects:
        if (k := _nearest(f, inside & keep, reject.frequency)) < 0:
            notes.append(f"rejected by hand, but not there: a mode at {reject.frequency:.5g} Hz")
        else:
            keep[k] = False
            notes.append(f"mode at {f[k]:.5g} Hz rejected by hand: {reject.reason}")
    return notes


def _merged(f: Float, inside: Bool, keep: Bool, said: list[str], choice: Choice) -> list[str]:
    """Leave the first of the modes to be merged in `keep`: the refinement places it for all of
    them.
    """
    notes = []
    for merge in choice.merges:
        members = list(dict.fromkeys(_nearest(f, inside & keep, x) for x in merge.frequencies))
        members = [k for k in members if k >= 0]
        if len(members) < 2:
            wanted = ", ".join(f"{x:.5g}" for x in merge.frequencies)
            notes.append(f"merged by hand, but not there as different modes: {wanted} Hz")
            continue
        keep[members[1:]] = False
        why = f" ({merge.reason})" if merge.reason else ""
        said[members[0]] = (
            "merged by hand from " + ", ".join(f"{f[k]:.5g}" for k in members) + f" Hz{why}"
        )
    return notes
