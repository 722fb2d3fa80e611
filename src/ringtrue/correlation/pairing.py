"""Which mode of one set belongs to which of another, and why the rest have no partner.

Pairing of two mode sets, with a reason for each mode that stays alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import (
    HOLD,
    NO_LOCKS,
    Locks,
    PairingSettings,
    Scores,
    assign,
    peak_shares,
    scores,
    within,
)
from ringtrue.correlation.one_criterion import NO_RIVAL, by_frequency, pairs_by_shape
from ringtrue.errors import InputError
from ringtrue.shapes.mac import above_rounding


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """A one-to-one assignment between modes of set A (test) and set B (model or second test).

    Attributes
    ----------
    a, b : (k,) int64
        Positions in A and B, ascending in A.
    mac : (k,) float64, 0..1
        Of the pair; of its subspace where `subspace` is true.
    frequency_error : (k,) float64
        (f_B − f_A)/f_A.
    sign : (k,) float64
        ±1, brings b to the phase of a.
    subspace : (k,) bool
        The pair belongs to a group of close modes that was treated as a subspace.
    unpaired_a, unpaired_b : (u,) int64
        Positions without a partner.
    reasons_a, reasons_b : tuple of str
        The reason for each.
    rival : (k,) int64
        Where frequencies alone decide: another mode of B that the mode of A may be, -1 if it may
        have no partner at all, `NO_RIVAL` where neither is likely; empty where shapes decide.
    beyond : (k,) bool
        The pair is beyond the frequency gate: its modes look alike and like no other.
    """

    a: Int
    b: Int
    mac: Float
    frequency_error: Float
    sign: Float
    subspace: Bool
    unpaired_a: Int
    reasons_a: tuple[str, ...]
    unpaired_b: Int
    reasons_b: tuple[str, ...]
    rival: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    beyond: Bool = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        i, f, yes = np.int64, np.float64, np.bool_
        freeze_fields(
            self,
            a=i,
            b=i,
            mac=f,
            frequency_error=f,
            sign=f,
            subspace=yes,
            unpaired_a=i,
            unpaired_b=i,
        )
        object.__setattr__(
            self, "beyond", self.beyond if len(self.beyond) else np.zeros(len(self.a), dtype=yes)
        )
        freeze_fields(self, rival=i, beyond=yes)

    def __len__(self) -> int:
        return int(self.a.size)

    def doubts(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """Each pair that frequencies alone leave in doubt, in words."""
        a, b = names
        return tuple(
            f"{a} {i + 1} is taken for {b} {j + 1}, and may as well be "
            + (f"{b} {k + 1}" if k >= 0 else f"no mode of {b}")
            for i, j, k in zip(self.a.tolist(), self.b.tolist(), self.rival.tolist(), strict=False)
            if k != NO_RIVAL
        )

    def far(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """The pairs beyond the frequency gate, in words; nothing where there is none."""
        a, b = names
        pairs = [
            f"{a} {self.a[k] + 1} with {b} {self.b[k] + 1} ({100 * self.frequency_error[k]:+.3g} %)"
            for k in np.flatnonzero(self.beyond).tolist()
        ]
        why = "paired beyond the frequency gate, as they look alike and like no other mode"
        return (f"{why}: {', '.join(pairs)}",) if pairs else ()


__all__ = [
    "BEYOND_THE_GATE",
    "Locks",
    "PairingSettings",
    "pair_modes",
]

BEYOND_THE_GATE = "beyond the gate"  # in the reason of such a mode
BEYOND, ALIKE = 2.0, 0.8  # times the frequency gate, and MAC, of a mode that is told of a lone one


def pair_modes(
    a: ModeSet,
    b: ModeSet,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
    *,
    visible_b: Float | None = None,
    names: tuple[str, str] = ("test", "FE"),
    first_b: int = 0,
    locks: Locks = NO_LOCKS,
) -> Pairing:
    """Pair the modes of two sets by one global assignment over MAC and frequency.

    Modes left over that look alike and like no other are pairs beyond the frequency gate, too
    (`settings.reach`). Blind to the order of modes and channels and to the sign, phase and scale of
    shapes. Close modes (`settings.close`) are treated as subspaces where a rotation inside the
    group of B explains A and single shapes do not.

    Parameters
    ----------
    a, b : ModeSet
        B must hold the channels of A. Where A has none, frequencies alone decide (`by_frequency`),
        and `mac` is NaN.
    settings : PairingSettings
    visible_b : (mb,) float64, optional
        Share of each mode's motion that takes place where sensors sit, 0..1.
    names : tuple of str
        What A and B are called in the reasons.
    first_b : int
        Number of modes that stand before those of B in the whole set; the reasons count them.
    locks : Locks
        Pairs forced and forbidden by the user; positions in A and B as given here.

    Raises
    ------
    InputError
        If channels of A are not in B, shapes have gaps, or `visible_b` does not fit.
    """
    b = b.rows(a.channels)
    for name, m in zip(names, (a, b), strict=True):
        if gaps := [
            m.channels[i] for i in np.flatnonzero(~np.isfinite(m.shapes).all(axis=1)).tolist()
        ]:
            raise InputError(
                f"shapes of {name} have gaps (NaN) at "
                f"{' '.join(gaps[:8])}{' ...' * (len(gaps) > 8)}: "
                "take the channels (rows) and modes (take) that have none"
            )
    if visible_b is not None and np.shape(visible_b) != (len(b),):
        raise InputError(
            f"visible_b {np.shape(visible_b)} for {len(b)} modes: one share a mode is needed"
        )
    hidden = _hidden(b, settings, visible_b)
    a, b = (replace(m, shapes=above_rounding(m.shapes)) for m in (a, b))
    sure = a.confidence >= settings.min_confidence
    if a.channels:
        sure &= a.shapes.any(axis=0)
    s = scores(a.frequencies, a.shapes, b.frequencies, b.shapes, settings)
    plain = np.array([not why for why in hidden], dtype=np.bool_)
    if a.channels:
        (rows, cols), rival = assign(s, settings, sure, plain, locks), np.zeros(0, dtype=np.int64)
        free = np.logical_and.outer(sure, plain) & locks.mask((len(a), len(b)))[1]
        more = pairs_by_shape(
            a.frequencies, a.shapes, b.frequencies, b.shapes, s, (rows, cols), free, settings
        )
        rows, cols, s, beyond = more.rows, more.columns, more.score, more.beyond
    else:
        wide = within(
            s, replace(settings, frequency_gate=settings.frequency_gate / HOLD), sure, plain, locks
        )[0]
        found = by_frequency(
            a.frequencies, b.frequencies, *within(s, settings, sure, plain, locks), wide
        )
        rows, cols, rival, beyond = (
            found.rows,
            found.columns,
            found.rival,
            np.zeros(0, dtype=np.bool_),
        )
    unpaired_a = np.setdiff1d(np.arange(len(a)), rows)
    unpaired_b = np.setdiff1d(np.arange(len(b)), cols)
    why = _Reasons(s, settings, rows, cols, names, first_b, locks, sure, tuple(hidden))
    return Pairing(
        a=rows,
        b=cols,
        mac=s.merged[rows, cols],
        frequency_error=s.error[rows, cols],
        sign=_signs(a, b, rows, cols),
        subspace=s.merged[rows, cols] > s.mac[rows, cols],
        unpaired_a=unpaired_a,
        reasons_a=tuple(
            _unseen(a, i)
            or (
                why.of_a(i)
                if sure[i]
                else f"confidence {a.confidence[i]:.2f} < {settings.min_confidence:.2f}"
            )
            for i in unpaired_a.tolist()
        ),
        unpaired_b=unpaired_b,
        reasons_b=tuple(hidden[j] or why.of_b(j, a, b) for j in unpaired_b.tolist()),
        rival=rival,
        beyond=beyond,
    )


def _signs(a: ModeSet, b: ModeSet, rows: Int, cols: Int) -> Float:
    cross = (b.shapes[:, cols].conj() * a.shapes[:, rows]).sum(axis=0)
    return np.where(cross.real < 0, -1.0, 1.0)


def _unseen(a: ModeSet, i: int) -> str:
    if not a.channels or a.shapes[:, i].any():
        return ""
    return "not observable: it does not move the channels that are compared"


def _hidden(b: ModeSet, settings: PairingSettings, visible: Float | None) -> list[str]:
    """For each mode of B why no sensor sees it, or an empty text."""
    share, out = peak_shares(b.shapes), []
    for j in range(len(b)):
        if b.channels and share[j] == 0:
            out.append("not observable: it does not move the channels that are compared")
            continue
        if visible is not None and visible[j] < settings.min_visible:
            out.append(
                f"moves where no sensor is: {100 * visible[j]:.2g} % of its motion is at sensors"
            )
        elif b.norm is Norm.MASS and share[j] < settings.faint:
            out.append(
                f"not observable: |shape| at the sensors is only {100 * share[j]:.2g} % of the "
                "median mode's"
            )
        else:
            out.append("")
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    score: Scores
    settings: PairingSettings
    rows: Int
    cols: Int
    names: tuple[str, str]
    first_b: int
    locks: Locks
    sure: Bool
    hidden: tuple[str, ...]

    @property
    def seen(self) -> bool:
        """Whether shapes tell the modes apart."""
        return not np.isnan(self.score.mac).all()

    def of_a(self, i: int) -> str:
        macs, errors, barred = (
            self.score.merged[i],
            self.score.error[i],
            [q for p, q in self.locks.forbidden if p == i],
        )
        why = self._of(
            macs,
            errors,
            barred,
            self.names[1],
            self.cols,
            self.rows,
            self.names[0],
            self.first_b,
            0,
        )
        return why + self._beyond(macs, errors)

    def _beyond(self, macs: Float, errors: Float) -> str:
        """A lone mode of B that looks like this one, just farther off than the gate lets it."""
        gate = self.settings.frequency_gate
        free = (np.abs(errors) > gate) & (np.abs(errors) <= BEYOND * gate)
        free[self.cols] = False
        if not self.seen or not free.any():
            return ""
        best = int(np.argmax(np.where(free, macs, 0.0)))
        if macs[best] < ALIKE:
            return ""
        return (
            f"; {BEYOND_THE_GATE} {self.names[1]} {best + 1 + self.first_b}, "
            f"{100 * errors[best]:+.3g} %, has "
            f"{100 * macs[best]:.0f} %: widen it (frequency_gate)"
        )

    def of_b(self, j: int, a: ModeSet, b: ModeSet) -> str:
        f = float(b.frequencies[j])
        gate = self.settings.frequency_gate
        if len(a) and not a.frequencies.min() * (1 - gate) <= f <= a.frequencies.max() * (1 + gate):
            return (
                f"outside of the {self.names[0]} band {a.frequencies.min():.4g} to "
                f"{a.frequencies.max():.4g} Hz"
            )
        macs, errors = self.score.merged[:, j], self.score.error[:, j]
        barred = [p for p, q in self.locks.forbidden if q == j]
        near = np.flatnonzero((np.abs(errors) <= gate) & (macs >= self.settings.mac_gate))
        best = int(near[np.argmax(macs[near])]) if near.size else -1
        if best >= 0 and not self.sure[best]:
            return (
                f"{self.names[0]} {best + 1} (MAC {100 * macs[best]:.0f} %) has too little "
                "confidence"
            )
        return self._of(
            macs,
            errors,
            barred,
            self.names[0],
            self.rows,
            self.cols,
            self.names[1],
            0,
            self.first_b,
        )

    def _of(
        self,
        macs: Float,
        errors: Float,
        barred: list[int],
        theirs: str,
        taken: Int,
        by: Int,
        mine: str,
        their_first: int,
        my_first: int,
    ) -> str:
        gate, least = self.settings.frequency_gate, self.settings.mac_gate
        near = np.flatnonzero(np.abs(errors) <= gate)
        if not near.size:
            return f"no {theirs} mode within {100 * gate:.3g} %"
        best = int(near[np.argmax(macs[near] if self.seen else -np.abs(errors[near]))])
        if macs[best] < least:
            return (
                f"no {theirs} mode within {100 * gate:.3g} % has MAC >= {100 * least:.3g} %: "
                f"best {theirs} {best + 1 + their_first} with {_below(macs[best], least)} %"
            )
        told = f" (MAC {100 * macs[best]:.0f} %)" if self.seen else ""
        if best in barred:
            return f"{theirs} {best + 1 + their_first}{told} is forbidden by the user"
        owner = np.flatnonzero(taken == best)
        if owner.size:
            number = int(by[owner[0]]) + 1 + my_first
            return f"{theirs} {best + 1 + their_first}{told} is already taken by {mine} {number}"
        hidden = self.hidden[best] if theirs == self.names[1] else ""
        why = f"is left out: {hidden}" if hidden else "was set aside for another reason"
        return f"{theirs} {best + 1 + their_first}{told} {why}"


def _below(mac: float, least: float) -> str:
    """A MAC in percent, with the digits that show it to be below the gate."""
    texts = (f"{100 * mac:.{digits}f}" for digits in range(12))
    return next((t for t in texts if float(t) < 100 * least), f"{100 * mac:.12f}")
