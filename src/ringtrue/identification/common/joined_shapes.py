"""Shapes of several setups as one, without holes.

A setup that did not find a mode shows its shape nevertheless: it is read at the pole of all setups.
The estimate of one of two close modes holds a little of the other, another share in each setup. On
the common channels these shares average out, so that the shapes Φ there are known better than those
of a setup, Ψ = Φ T. The matrix T, found on the common channels, scales the other channels of the
setup and takes the shares of other modes out of them: a least squares fit in which the share of a
mode is expected to fall with its distance in bandwidths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.identification.common.merging import Merged, MergeRecord, mended

ROUNDS = 3  # of scaling before shares of other modes are taken out


class ShapeReader(Protocol):
    """A record from which shapes are read."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Rows of the shapes."""

    def shapes(self, frequency: Float, damping: Float) -> tuple[Complex, Float]:
        """Shapes (ch, m) of modes (m,) with their standard deviations."""


def with_joined_shapes(
    merged: Merged,
    records: Sequence[tuple[ModeSet, Uncertainty, str]],
    readers: Sequence[ShapeReader],
    rows: Int,
    references: Sequence[str] = (),
) -> Merged:
    """The merged modes with the shapes of some of them from every record.

    Parameters
    ----------
    merged : Merged
        Of `merge_modes`.
    records : sequence of (ModeSet, Uncertainty, name)
        What was merged.
    readers : sequence of ShapeReader
        One a record, of the same channels.
    rows : (k,) int64
        Positions of the modes; those of a single record are best left as they are.
    references : sequence of str
        Channels that scale the records to one another; without, all that two records have.
    """
    if not rows.size or len(records) < 2:
        return merged
    read = []
    for position, (record, reader) in enumerate(zip(records, readers, strict=True)):
        found = {
            k: given.mode
            for k, row in enumerate(rows.tolist())
            for given in merged.provenance[row]
            if given.position == position
        }
        read.append(_completed(merged.modes.take(rows), found, record, reader))
    channels = merged.modes.channels
    full = [MergeRecord.of(*record, channels) for record in mended(read, merged.faults)]
    there = np.array([np.isfinite(x.psi).all(axis=1) for x in full])
    common = there.sum(axis=0) > 1
    if references:
        common &= np.isin(channels, references)
    joint = merged.modes.take(rows)
    shape, var = _joined(full, joint, there, common)
    shapes = np.array(merged.modes.shapes)
    deviation = np.array(merged.uncertainty.shape)
    known = np.isfinite(shape)
    shapes[:, rows] = np.where(known, shape, shapes[:, rows])
    deviation[:, rows] = np.where(known, np.sqrt(var), deviation[:, rows])
    return replace(
        merged,
        modes=replace(merged.modes, shapes=shapes),
        uncertainty=replace(merged.uncertainty, shape=deviation),
    )


def _completed(
    joint: ModeSet,
    found: Mapping[int, int],
    record: tuple[ModeSet, Uncertainty, str],
    reader: ShapeReader,
) -> tuple[ModeSet, Uncertainty, str]:
    """The joint modes as a record shows them: its own where it `found` them, else read.

    The poles that it found belong to its correlations better than those of all setups.
    """
    modes, std, name = record
    at = np.array(list(found), dtype=np.int64)
    own = np.array(list(found.values()), dtype=np.int64)
    frequency = joint.frequencies.copy()
    damping = joint.damping.copy()
    frequency[at] = modes.frequencies[own]
    damping[at] = modes.damping[own]
    shape, deviation = reader.shapes(frequency, damping)
    shape[:, at] = modes.shapes[:, own]
    deviation[:, at] = std.shape[:, own]
    whole = ModeSet(frequency, damping, shape, modes.channels)
    unknown = np.full(frequency.size, np.nan)
    return whole, Uncertainty.independent(unknown, unknown, deviation), name


def _joined(
    records: Sequence[MergeRecord], joint: ModeSet, there: Bool, common: Bool
) -> tuple[Complex, Float]:
    """Shapes (n, m), largest component 1, and variances; NaN of channels without a scale.

    `there` (record, n) says which channels each record has, `common` (n,) those that scale.
    """
    shape = np.array(joint.shapes)
    half = joint.frequencies * joint.damping
    distance = np.abs(joint.frequencies[:, None] - joint.frequencies) / (half[:, None] + half)
    share = 1 / np.maximum(distance, 1.0)
    for step in range(ROUNDS + 1):
        expected = share if step == ROUNDS else np.zeros(share.shape)
        total = np.zeros(shape.shape, dtype=np.complex128)
        weight = np.zeros(shape.shape)
        spread = np.zeros(shape.shape)
        for record, rows in zip(records, there, strict=True):
            scaled_on = rows & common & np.isfinite(shape).all(axis=1)
            if not scaled_on.any():
                continue
            psi = record.psi[rows]
            own = record.var[rows]
            turn = _mixing(shape[scaled_on], record.psi[scaled_on], record.var[scaled_on], expected)
            size = np.abs(np.diag(turn)) ** 2
            new = np.linalg.solve(turn.T, psi.T).T
            noise = np.median(own, axis=0)
            # the scale is no better known than the common channels show it
            seen = (np.abs(record.psi[scaled_on]) ** 2).sum(axis=0)
            loose = np.abs(psi) ** 2 * noise / np.maximum(seen, 1e-300)
            w = np.maximum(size, 1e-300) / np.maximum(own.mean(axis=0), 1e-300)
            total[rows] += w * new
            weight[rows] += w
            spread[rows] += w**2 * (own + loose) / np.maximum(size, 1e-300)
        with np.errstate(invalid="ignore", divide="ignore"):
            shape = total / weight
            var = spread / weight**2
        top = np.nanmax(np.abs(shape), axis=0)
        shape = shape / top
        var = var / top**2
    return shape, var


def _mixing(known: Complex, seen: Complex, var: Float, expected: Float) -> Complex:
    """T (m, m) of `seen` ≈ `known` T (ch, m), with `var` of what is seen and the shares of other
    modes that are `expected` (m, m), 0 for none.
    """
    m = known.shape[1]
    size = np.linalg.norm(known, axis=0)
    out = np.zeros((m, m), dtype=np.complex128)
    for k in range(m):  # few modes
        noise = np.maximum(var[:, k], np.median(var[:, k]))
        others = np.flatnonzero((expected[k] > 0) & (np.arange(m) != k))
        use = np.append(k, others)
        a = known[:, use]
        weighed = a.conj().T / noise
        usual = np.linalg.norm(seen[:, k]) / np.maximum(size[use], 1e-12)
        hold = 1 / (expected[k, use] * usual) ** 2 if others.size else np.zeros(1)
        hold[0] = 0.0
        out[use, k] = np.linalg.solve(weighed @ a + np.diag(hold), weighed @ seen[:, k])
    return out
