"""Which mode of one set belongs to which of another, and why the rest have no partner.

And modes followed from point to point through crossing and veering.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Any_, Bool, Float, FrozenArrays, Int, freeze_arrays
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import (
    NO_LOCKS,
    WORTH,
    ComparedModes,
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
from ringtrue.shapes import above_rounding, mac


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(FrozenArrays):
    """Modes along a path.

    Attributes
    ----------
    points : (k, p) float64
    index : (k, m) int64
        Position of each followed mode among the modes of each point.
    frequencies : (k, m) float64, Hz
    overlap : (k, m) float64
        With the point before; ones at the first.
    """

    points: Float
    index: Int
    frequencies: Float
    overlap: Float

    @property
    def worst(self) -> Float:
        """(m,) smallest overlap of each mode along the path: below about 0.6 its identity was
        lost.
        """
        return np.asarray(self.overlap.min(axis=0))


def track(
    frequencies: Sequence[Float], shapes: Sequence[Any_], *, count: int | None = None
) -> Tracks:
    """Follow the `count` lowest modes of the first point (all) through a given sequence.

    From point to point by the one-to-one assignment of greatest total MAC.

    Parameters
    ----------
    frequencies : sequence of (m_i,) float64, Hz
    shapes : sequence of (n, m_i) float64 or complex128

    Raises
    ------
    InputError
        If a point has fewer modes than are followed.
    """
    m = shapes[0].shape[1] if count is None else count
    if (fewest := min(s.shape[1] for s in shapes)) < m:
        raise InputError(
            f"{m} modes to follow, {fewest} at a point; compute more there"
        )
    index = [np.arange(m)]
    overlap = [np.ones(m)]
    for before, now in pairwise(shapes):  # each point rests on the one before
        share = mac(before[:, index[-1]], now)
        rows, columns = linear_sum_assignment(-share)
        index.append(columns)
        overlap.append(share[rows, columns])
    return Tracks(
        points=np.arange(float(len(shapes)))[:, None],
        index=np.array(index),
        frequencies=np.array([f[i] for f, i in zip(frequencies, index, strict=True)]),
        overlap=np.array(overlap),
    )


__all__ = ["Locks", "Pairing", "PairingSettings", "pair_modes"]


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
        The pair is beyond the frequency gate: its modes look like each other and no other.
    gated_a : (u,) bool
        Of `unpaired_a`: an unpaired mode of B that looks like it is beyond the frequency gate.
    """

    a: Int
    b: Int
    mac: Float
    frequency_error: Float
    subspace: Bool
    unpaired_a: Int
    reasons_a: tuple[str, ...]
    unpaired_b: Int
    reasons_b: tuple[str, ...]
    rival: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    beyond: Bool = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    gated_a: Bool = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        for name, size in (("beyond", self.a.size), ("gated_a", self.unpaired_a.size)):
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.zeros(size, dtype=np.bool_))
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.a.size)

    def doubts(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """Each pair that frequencies alone leave in doubt, in words."""
        a, b = names
        return tuple(
            f"{a} {i + 1} is taken for {b} {j + 1}, and may as well be "
            + (f"{b} {k + 1}" if k >= 0 else f"no mode of {b}")
            for i, j, k in zip(self.a, self.b, self.rival, strict=False)
            if k != NO_RIVAL
        )

    def far(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """The pairs beyond the frequency gate, in words; nothing where there is none."""
        a, b = names
        pairs = [
            f"{a} {self.a[k] + 1} with {b} {self.b[k] + 1} ({100 * self.frequency_error[k]:+.3g} %)"
            for k in np.flatnonzero(self.beyond)
        ]
        why = "paired beyond the frequency gate, as they look like no other mode"
        return (f"{why}: {', '.join(pairs)}",) if pairs else ()


# frequency gates, within which the reason of an unpaired mode names another
BEYOND_GATE = 2.0
BEYOND_GATE_MAC = 0.8  # least MAC of that other mode


def pair_modes(
    a: ModeSet,
    b: ModeSet,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
    *,
    names: tuple[str, str] = ("test", "FE"),
    first_b: int = 0,
    locks: Locks = NO_LOCKS,
) -> Pairing:
    """Pair the modes of two sets by one global assignment over MAC and frequency.

    Modes left over that look like each other and no other are pairs beyond the frequency gate, too
    (`settings.reach`). Blind to the order of modes and channels and to the sign, phase and scale of
    shapes. Close modes (`settings.close`) are treated as subspaces where a rotation inside the
    group of B explains A and single shapes do not.

    Parameters
    ----------
    a, b : ModeSet
        B must hold the channels of A. Where A has none, frequencies alone decide (`by_frequency`),
        and `mac` is NaN.
    settings : PairingSettings
    names : tuple of str
        What A and B are called in the reasons.
    first_b : int
        Number of modes that stand before those of B in the whole set; the reasons count them.
    locks : Locks
        Pairs forced and forbidden by the user; positions in A and B as given here.

    Raises
    ------
    InputError
        If channels of A are not in B, or shapes have gaps.
    """
    b = b.rows(a.channels)
    for name, modes in zip(names, (a, b), strict=True):
        _refuse_gaps(modes, name)
    hidden = _hidden(b, settings)
    a, b = (replace(m, shapes=above_rounding(m.shapes)) for m in (a, b))
    usable_a = a.confidence >= settings.min_confidence
    if a.channels:
        usable_a &= a.shapes.any(axis=0)
    usable_b = np.array([not why for why in hidden], dtype=np.bool_)
    compared = ComparedModes(a.frequencies, a.shapes, b.frequencies, b.shapes)
    score = scores(compared, settings)
    pairs = _by_shape if a.channels else _by_frequency
    usable = usable_a, usable_b
    found = pairs(compared, score, settings, usable, locks)
    rows = found.rows
    cols = found.columns
    score = found.score

    unpaired_a = np.setdiff1d(np.arange(len(a)), rows)
    unpaired_b = np.setdiff1d(np.arange(len(b)), cols)
    partner_a = np.full(len(a), -1)
    partner_a[rows] = cols
    partner_b = np.full(len(b), -1)
    partner_b[cols] = rows
    why = _Reasons(
        score=score,
        settings=settings,
        a=_Side(names[0], 0, partner_a, ("",) * len(a)),
        b=_Side(names[1], first_b, partner_b, tuple(hidden)),
        locks=locks,
        usable_a=usable_a,
    )
    gated = {i: why.beyond_gate(i) for i in unpaired_a.tolist() if usable_a[i]}
    return Pairing(
        a=rows,
        b=cols,
        mac=score.merged[rows, cols],
        frequency_error=score.error[rows, cols],
        subspace=score.merged[rows, cols] > score.mac[rows, cols],
        unpaired_a=unpaired_a,
        reasons_a=tuple(
            why.of_a(i) + gated[i] if i in gated else _unusable(a, i, settings)
            for i in unpaired_a.tolist()
        ),
        unpaired_b=unpaired_b,
        reasons_b=tuple(hidden[j] or why.of_b(j, a, b) for j in unpaired_b.tolist()),
        rival=found.rival,
        beyond=found.beyond,
        gated_a=np.array(
            [bool(gated.get(i)) for i in unpaired_a.tolist()], dtype=np.bool_
        ),
    )


def _refuse_gaps(modes: ModeSet, name: str) -> None:
    """Shapes with gaps cannot be compared."""
    whole = np.isfinite(modes.shapes).all(axis=1)
    if gaps := [modes.channels[i] for i in np.flatnonzero(~whole)]:
        raise InputError(
            f"shapes of {name} have gaps (NaN) at "
            f"{' '.join(gaps[:8])}{' ...' * (len(gaps) > 8)}: "
            "take the channels (rows) and modes (take) that have none"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Positions in A and B that are pairs (k,), what they were judged by, and `rival` and `beyond`
    of `Pairing`.
    """

    rows: Int
    columns: Int
    score: Scores
    rival: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    beyond: Bool = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


def _by_shape(
    modes: ComparedModes,
    score: Scores,
    gates: PairingSettings,
    usable: tuple[Bool, Bool],
    locks: Locks,
) -> _Pairs:
    """By MAC and frequency, then beyond the frequency gate by MAC alone."""
    a, b = usable
    paired = assign(score, gates, a, usable_b=b, locks=locks)
    free = np.logical_and.outer(a, b) & locks.mask((a.size, b.size))[1]
    found = pairs_by_shape(modes, score, paired=paired, free=free, gates=gates)
    return _Pairs(found.rows, found.columns, found.score, beyond=found.beyond)


def _by_frequency(
    modes: ComparedModes,
    score: Scores,
    gates: PairingSettings,
    usable: tuple[Bool, Bool],
    locks: Locks,
) -> _Pairs:
    """By frequencies alone; rivals are looked for within wider gates."""
    a, b = usable
    loose = replace(gates, frequency_gate=gates.frequency_gate / WORTH.hold)
    wide = within(score, loose, a, usable_b=b, locks=locks)[0]
    allowed, forced = within(score, gates, a, usable_b=b, locks=locks)
    found = by_frequency(modes.fa, modes.fb, allowed, forced=forced, wide=wide)
    return _Pairs(found.rows, found.columns, score, rival=found.rival)


UNSEEN = "not observable: it does not move the channels that are compared"


def _unusable(a: ModeSet, i: int, settings: PairingSettings) -> str:
    """Why a mode of A takes no part."""
    if a.channels and not a.shapes[:, i].any():
        return UNSEEN
    return f"confidence {a.confidence[i]:.2f} < {settings.min_confidence:.2f}"


def _hidden(b: ModeSet, settings: PairingSettings) -> list[str]:
    """For each mode of B why no sensor sees it, or an empty text."""
    share = peak_shares(b.shapes)
    out = []
    for j in range(len(b)):
        if b.channels and share[j] == 0:
            out.append(UNSEEN)
        elif b.norm is Norm.MASS and share[j] < settings.faint:
            out.append(
                f"not observable: |shape| at the sensors is only {100 * share[j]:.2g} % of the "
                "median mode's"
            )
        else:
            out.append("")
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """One of the two sets.

    Attributes
    ----------
    name : str
    first : int
        Number of modes that stand before it in the whole set.
    partner : (m,) int64
        Partner of each mode in the other set, -1 for none.
    hidden : tuple of str
        Why each mode cannot be seen, empty where it can.
    """

    name: str
    first: int
    partner: Int
    hidden: tuple[str, ...]

    def called(self, i: int) -> str:
        """A mode by the name of the set and its number."""
        return f"{self.name} {i + 1 + self.first}"


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    """Why modes are unpaired, in words."""

    score: Scores
    settings: PairingSettings
    a: _Side
    b: _Side
    locks: Locks
    usable_a: Bool

    @property
    def shapes_known(self) -> bool:
        """Whether shapes were measured."""
        return not np.isnan(self.score.mac).all()

    def of_a(self, i: int) -> str:
        forbidden = [q for p, q in self.locks.forbidden if p == i]
        return self._reason(
            self.score.merged[i], self.score.error[i], forbidden, self.a, self.b
        )

    def of_b(self, j: int, a: ModeSet, b: ModeSet) -> str:
        f = float(b.frequencies[j])
        gate = self.settings.frequency_gate
        if len(a) and not a.frequencies.min() * (
            1 - gate
        ) <= f <= a.frequencies.max() * (1 + gate):
            return (
                f"outside of the {self.a.name} band {a.frequencies.min():.4g} to "
                f"{a.frequencies.max():.4g} Hz"
            )
        macs = self.score.merged[:, j]
        errors = self.score.error[:, j]
        near = np.flatnonzero(
            (np.abs(errors) <= gate) & (macs >= self.settings.mac_gate)
        )
        best = int(near[np.argmax(macs[near])]) if near.size else -1
        if best >= 0 and not self.usable_a[best]:
            return f"{self.a.called(best)} (MAC {100 * macs[best]:.0f} %) has too little confidence"
        forbidden = [p for p, q in self.locks.forbidden if q == j]
        return self._reason(macs, errors, forbidden, self.b, self.a)

    def beyond_gate(self, i: int) -> str:
        """The unpaired mode of B that looks like mode i of A and is beyond the frequency gate;
        empty without one.
        """
        macs = self.score.merged[i]
        errors = self.score.error[i]
        gate = self.settings.frequency_gate
        free = (np.abs(errors) > gate) & (np.abs(errors) <= BEYOND_GATE * gate)
        free &= self.b.partner < 0
        if not self.shapes_known or not free.any():
            return ""
        best = int(np.argmax(np.where(free, macs, 0.0)))
        if macs[best] < BEYOND_GATE_MAC:
            return ""
        return (
            f"; beyond the gate {self.b.called(best)}, {100 * errors[best]:+.3g} %, has "
            f"{100 * macs[best]:.0f} %: widen it (frequency_gate)"
        )

    def _reason(
        self, macs: Float, errors: Float, forbidden: list[int], own: _Side, other: _Side
    ) -> str:
        gate = self.settings.frequency_gate
        least = self.settings.mac_gate
        near = np.flatnonzero(np.abs(errors) <= gate)
        if not near.size:
            return f"no {other.name} mode within {100 * gate:.3g} %"
        likeness = macs[near] if self.shapes_known else -np.abs(errors[near])
        best = int(near[np.argmax(likeness)])
        if macs[best] < least:
            return (
                f"no {other.name} mode within {100 * gate:.3g} % has MAC >= {100 * least:.3g} %: "
                f"best {other.called(best)} with {_below(macs[best], least)} %"
            )
        name = other.called(best)
        name += f" (MAC {100 * macs[best]:.0f} %)" if self.shapes_known else ""
        if best in forbidden:
            return f"{name} is forbidden by the user"
        if other.partner[best] >= 0:
            return f"{name} is already taken by {own.called(int(other.partner[best]))}"
        if other.hidden[best]:
            return f"{name} is left out: {other.hidden[best]}"
        return f"{name} was set aside for another reason"


def _below(mac: float, least: float) -> str:
    """A MAC in percent, with the digits that show it to be below the gate."""
    texts = (f"{100 * mac:.{digits}f}" for digits in range(12))
    return next((t for t in texts if float(t) < 100 * least), f"{100 * mac:.12f}")
