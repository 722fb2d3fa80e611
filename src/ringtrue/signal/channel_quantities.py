"""What channels without a unit measure, learned from the record: velocities among accelerations,
and columns that show no motion.

Modes of little damping under random forces have cross spectra that are real between channels of one
quantity; between a motion and its derivative they are a quarter turn off, at every frequency and
whatever the shapes. The square of the phase factor of a cross spectrum does not see the sign of the
shapes, so

    J_cd = Σ w(f) Re (S_cd/|S_cd|)² / Σ w(f),  w = γ⁴ (squared coherence, squared),

is 1 in one quantity and -1 between a motion and its derivative. Which of the two is the derivative
shows in their levels: the power of the derivative over that of the motion grows as f².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.channels import DERIVATIVE
from ringtrue.core.notes import Note
from ringtrue.core.signals import FALSE_ALARM, Quantity, TimeHistory
from ringtrue.signal.channel_checks import LIMITS
from ringtrue.signal.clock_alignment import (
    DELAY,
    in_one_motion,
    least_weight,
    segment_lines,
    segments_of,
    summed_power,
)

MOTION_OF = {order: motion for motion, order in DERIVATIVE.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _PhaseAgreement:
    """Phases between channels, over all lines.

    Attributes
    ----------
    agreement : (ch, ch) float64
        J.
    weight : (ch, ch) float64
        Sum of squared coherences.
    by_line : (freq,) float64
        The same of a line over all pairs.
    power : (freq, ch) float64
        Mean powers, each channel over its size.
    """

    agreement: Float
    weight: Float
    by_line: Float
    power: Float


def with_learned_quantities(
    history: TimeHistory,
) -> tuple[TimeHistory, tuple[Note, ...]]:
    """The record with quantities that its channels do not state, without columns that show no
    motion; notes on both.

    Parameters
    ----------
    history : TimeHistory
        Finite samples. Channels of a known quantity keep it.
    """
    unknown = np.array([c.quantity == "unknown" for c in history.channels])
    length, starts = segments_of(history.data.shape[1])
    if len(unknown) < 3 or not unknown.any() or not starts.size:
        return history, ()
    phases = _phase_agreement(segment_lines(history.data, length, starts))
    np.fill_diagonal(phases.weight, 0.0)
    total = phases.weight.sum(axis=1)
    seen = total > least_weight()
    if seen.sum() < 2:
        return history, ()
    ids = np.array([c.id for c in history.channels])
    # less than one line that others answer as a whole
    alone = total < 1.0
    silent = unknown & alone & _without_peaks(phases.power)
    size = history.data.std(axis=1)
    # velocities have another level than accelerations
    side = _sides(phases)
    like = np.eye(len(side), dtype=bool) | (seen & (side[:, None] == side))
    ratio = size / np.array([np.median(size[own]) for own in like])
    odd = (ratio > LIMITS.level_ratio) | (ratio * LIMITS.level_ratio < 1)
    # strain among accelerations
    stray = unknown & odd & (total < np.median(total[seen]) / 2) & ~silent
    notes = []
    for code, out in (
        ("channel without motion", silent),
        ("channel of another kind", stray),
    ):
        if out.any():
            notes.append(Note(code, "warning", " ".join(ids[out].tolist())))
    kept = ~(silent | stray)
    if not kept.all():
        history = history.pick(ids[kept].tolist())
        unknown = unknown[kept]
        seen = seen[kept]
        phases = _picked(phases, kept)
    quantities = [c.quantity for c in history.channels]
    for at, quantity in _learned(quantities, unknown & seen, seen, phases):
        names = " ".join(history.channels[i].id for i in at.tolist())
        notes.append(
            Note("channel quantity", "information", names, {"quantity": quantity})
        )
        for i in at.tolist():
            quantities[i] = cast("Quantity", quantity)
    channels = tuple(
        replace(c, quantity=quantity)
        for c, quantity in zip(history.channels, quantities, strict=True)
    )
    return (replace(history, channels=channels) if notes else history), tuple(notes)


def _phase_agreement(lines: Any_) -> _PhaseAgreement:
    """Of the transforms (freq, segment, ch) of segments of the record."""
    _, segments, channels = lines.shape
    agreement = np.empty((channels, channels))
    weight = np.empty((channels, channels))
    by_line = np.zeros(len(lines))
    power = summed_power(lines)
    same: Int = np.zeros(channels, dtype=np.int64)
    for k in range(channels):  # all pairs at once would be channels² spectra
        cross = np.einsum("fsc,fs->fc", lines, lines[:, :, k].conj())
        turned, coherence = in_one_motion(cross, power * power[:, [k]], segments, same)
        counted = coherence**2
        weight[k] = counted.sum(axis=0)
        agreement[k] = (counted * turned.real).sum(axis=0) / np.maximum(
            weight[k], 1e-12
        )
        by_line += counted.sum(axis=1) - counted[:, k]
    return _PhaseAgreement(agreement, weight, by_line, power / segments)


def _picked(phases: _PhaseAgreement, kept: Bool) -> _PhaseAgreement:
    return replace(
        phases,
        agreement=phases.agreement[kept][:, kept],
        weight=phases.weight[kept][:, kept],
        power=phases.power[:, kept],
    )


def _without_peaks(power: Float) -> Bool:
    """(ch,) whether no line of the mean spectrum (freq, ch) stands out of its surroundings by more
    than chance makes any of them.
    """
    level = median_filter(power, size=(41, 1), mode="nearest")
    free = 2 * DELAY.segments
    chance = chdtri(free, FALSE_ALARM / power.size) / free
    inside = power[8:-8] > chance * np.maximum(level[8:-8], np.finfo(np.float64).tiny)
    return np.asarray(~inside.any(axis=0))


def _sides(phases: _PhaseAgreement) -> Float:
    """(ch,) 1 and -1 of channels a quarter turn from each other."""
    side: Float = np.sign(np.linalg.eigh(phases.weight * phases.agreement)[1][:, -1])
    return side


def _learned(
    quantities: Sequence[str],
    open_: Bool,
    seen: Bool,
    phases: _PhaseAgreement,
) -> list[tuple[Int, str]]:
    """Groups of the `open_` channels with their quantity; none where all are of one."""
    weighted = phases.weight * phases.agreement
    side = _sides(phases)
    total = np.maximum(phases.weight.sum(axis=1), 1e-12)
    clear = seen & (side * (weighted @ side) / total > 0.5)
    order = np.array([DERIVATIVE.get(q, -1) for q in quantities])
    known = clear & (order >= 0)
    if known.any():
        first = int(np.bincount(order[known]).argmax())
        side = side * np.sign(side[known & (order == first)].sum())
    else:
        first = -1
    one = clear & (side > 0)
    other = clear & (side < 0)
    if not (one.any() and other.any()):
        return []
    rises = _rise(phases, one, other) > 0
    if first < 0:
        orders = (1, 2) if rises else (2, 1)
    else:
        second = first + 1 if rises else first - 1
        orders = (first, second if 0 <= second <= 2 else 1)
        stated = order[known & other]
        if stated.size:
            orders = (first, int(np.bincount(stated).argmax()))
    groups = ((one & open_, orders[0]), (other & open_, orders[1]))
    return [(np.flatnonzero(at), MOTION_OF[n]) for at, n in groups if at.any()]


def _rise(phases: _PhaseAgreement, one: Bool, other: Bool) -> float:
    """Exponent of the frequency in the power of the `other` channels over that of the first: 2 of
    their derivative, -2 of their integral.
    """
    lines = np.flatnonzero(phases.by_line > 0)
    level = np.log(np.maximum(phases.power[lines], np.finfo(np.float64).tiny))
    ratio = level[:, other].mean(axis=1) - level[:, one].mean(axis=1)
    weight = phases.by_line[lines]
    x = np.log(lines)
    x = x - np.average(x, weights=weight)
    ratio = ratio - np.average(ratio, weights=weight)
    return float((weight * x) @ ratio / max(float((weight * x) @ x), 1e-300))
