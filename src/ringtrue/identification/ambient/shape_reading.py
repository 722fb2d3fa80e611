"""Shapes of modes of known poles, read from the correlations of a record, and how much they move.

The correlations of responses under white forces are free decays of the modes,

    R(τ) = Σ_m Re(Q_m e^{λ_m τ}),  Q_m = ψ_m g_mᵀ,

so that with known poles the residues Q_m are a linear least squares problem (Ibrahim and Mikulcik
1977; Prony). Their first singular vectors are the shapes. A record shows the shape of a mode even
where it is too short to find the pole.

The shapes of several setups become one. The estimate of one of two close modes holds a little of
the other, another share in each setup. On the common channels these shares average out, so that the
shapes Φ there are known better than those of a setup, Ψ = Φ T. The matrix T, found on the common
channels, scales the other channels of the setup and takes the shares of other modes out of them: a
least squares fit in which the share of a mode is expected to fall with its distance in bandwidths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import DERIVATIVE
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.pipeline import WeighedRecord
from ringtrue.identification.ambient.record_bands import BandSums
from ringtrue.identification.ambient.record_checks import CommonMotion
from ringtrue.identification.ambient.ssi_cov import block_power
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.merging import Merged, MergeRecord, mended
from ringtrue.identification.common.stabilisation import unit
from ringtrue.signal.spectra import Welch, block_weights, detrend, psd


@dataclass(frozen=True, slots=True, eq=False)
class BandCorrelations:
    """Correlations of one band.

    Attributes
    ----------
    low, high, rate : float, Hz
    mean : (lag, ch, ref) float64
    deviation : (block, lag, ch, ref) float32
        Of each block; the sum of squares is the variance of the mean.
    scale : (ch,) float64
        Units of the channels.
    """

    low: float
    high: float
    rate: float
    mean: Float
    deviation: Any_
    scale: Float

    @classmethod
    def of(cls, sums: BandSums) -> BandCorrelations:
        """Those of the sums of a band, loud blocks weighed less."""
        r = sums.r
        loudness = block_weights(block_power(r, sums.references))
        mean, deviation = var.deviations(
            r, loudness * sums.share / (loudness @ sums.share)
        )
        band = sums.band
        return cls(band.low, band.high, band.rate, mean, deviation, sums.scale)

    def residues(self, pole: Complex) -> tuple[Complex, Complex]:
        """Residues (m, ch, ref) of the poles (m,), rad/s, and by each block (block, m, ch, ref)."""
        lag = np.arange(1, len(self.mean))
        decay = np.exp(pole * (lag[:, None] / self.rate))
        design = np.concatenate([decay.real, -decay.imag], axis=1)
        inverse = np.linalg.pinv(design, rcond=1e-6)
        parts = np.tensordot(inverse, self.mean[1:], 1)
        by_block = np.einsum(
            "pl,blcr->bpcr", inverse, self.deviation[:, 1:], optimize=True
        )
        m = pole.size
        return parts[:m] + 1j * parts[m:], by_block[:, :m] + 1j * by_block[:, m:]


@dataclass(frozen=True, slots=True, eq=False)
class RecordCorrelations:
    """What a record keeps to have the shapes of modes read from it.

    Attributes
    ----------
    channels : tuple of str
    bands : tuple of BandCorrelations
    motion : CommonMotion, optional
    """

    channels: tuple[str, ...]
    bands: tuple[BandCorrelations, ...]
    motion: CommonMotion | None

    @classmethod
    def of(cls, weighed: WeighedRecord) -> RecordCorrelations:
        """Those of a record whose bands were summed for identification."""
        channels = tuple(c.id for c in weighed.record.good.channels)
        bands = tuple(map(BandCorrelations.of, weighed.sums))
        return cls(channels, bands, weighed.facts.motion)

    def shapes(self, frequency: Float, damping: Float) -> tuple[Complex, Float]:
        """Shapes (ch, m), largest component 1, and their standard deviations (ch, m).

        Parameters
        ----------
        frequency, damping : (m,) float64, Hz and fraction of critical
            All modes of the structure.
        """
        pole = 2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2))
        shape = np.full((len(self.channels), pole.size), np.nan, dtype=np.complex128)
        std = np.full(shape.shape, np.nan)
        for band in self.bands:
            inside = (frequency >= band.low) & (frequency <= band.high)
            if not inside.any():
                continue
            near = inside | (frequency < 0.45 * band.rate)
            residue, by_block = band.residues(pole[near])
            own = inside[near]
            scale: Any_ = band.scale[:, None]
            if self.motion:
                scale = (
                    scale * self.motion.turn[:, None] * self.motion.lift(pole[inside])
                )
            shape[:, inside], std[:, inside] = _shapes(
                residue[own], by_block[:, own], scale
            )
        return shape, std


def _shapes(residue: Complex, by_block: Complex, scale: Any_) -> tuple[Complex, Float]:
    """Shapes (ch, m) of residues (m, ch, ref), times `scale` (ch, m), and their standard
    deviations.
    """
    left, size, right = np.linalg.svd(residue, full_matrices=False)
    change = np.einsum("bmcr,mr->mcb", by_block, right[:, 0].conj()) / size[:, :1, None]
    psi = left[:, :, 0].T
    scale = np.broadcast_to(scale, psi.shape)
    return unit(psi * scale), var.modulus_std(psi * scale, change * scale.T[:, :, None])


def mode_levels(history: TimeHistory, frequency: Float, damping: Float) -> Float:
    """(m,) RMS velocity within the half-power bandwidth of each mode, over the channels that are
    motions, m/s.

    Parameters
    ----------
    history : TimeHistory
        SI; samples that were lost are bridged.
    frequency, damping : (m,) float64, Hz and fraction of critical

    Returns
    -------
    (m,) float64
        NaN where no channel is a motion.
    """
    order = [DERIVATIVE.get(c.quantity) for c in history.channels]
    motions = [i for i, n in enumerate(order) if n is not None]
    if not motions or not frequency.size:
        return np.full(frequency.shape, np.nan)
    width = np.maximum(damping * frequency, 1e-3 * frequency)
    # four lines of a spectrum at least
    resolution = max(float(width.min()) / 2, 4 / history.duration)
    data = detrend(history.data[motions])
    chosen = tuple(history.channels[i] for i in motions)
    freqs, density = psd(TimeHistory(data, history.rate, chosen), Welch(resolution))
    omega = 2 * np.pi * np.maximum(freqs, freqs[1])
    power = [n or 0 for n in order if n is not None]
    velocity = density * omega ** (2.0 * (1 - np.array(power)[:, None]))
    mean = velocity.mean(axis=0)
    step = float(freqs[1])
    near = np.abs(freqs[:, None] - frequency) <= np.maximum(width, step)
    return np.asarray(np.sqrt((mean[:, None] * near).sum(axis=0) * step))


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
    distance = np.abs(joint.frequencies[:, None] - joint.frequencies) / (
        half[:, None] + half
    )
    share = 1 / np.maximum(distance, 1.0)
    # records are scaled before shares of other modes are taken out
    for expected in (np.zeros(share.shape), share):
        total = np.zeros(shape.shape, dtype=np.complex128)
        weight = np.zeros(shape.shape)
        spread = np.zeros(shape.shape)
        for record, rows in zip(records, there, strict=True):
            scaled_on = rows & common & np.isfinite(shape).all(axis=1)
            if not scaled_on.any():
                continue
            psi = record.psi[rows]
            own = record.var[rows]
            turn = _mixing(
                shape[scaled_on], record.psi[scaled_on], record.var[scaled_on], expected
            )
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
