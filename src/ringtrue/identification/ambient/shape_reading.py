"""Shapes of modes of known poles, read from the correlations of a record, and how much they move.

The correlations of responses under white forces are free decays of the modes,

    R(τ) = Σ_m Re(Q_m e^{λ_m τ}),  Q_m = ψ_m g_mᵀ,

so that with known poles the residues Q_m are a linear least squares problem (Ibrahim and Mikulcik
1977; Prony). Their first singular vectors are the shapes. A record shows the shape of a mode even
where it is too short to find the pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.channels import DERIVATIVE
from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.pipeline import WeighedRecord
from ringtrue.identification.ambient.record_bands import BandSums
from ringtrue.identification.ambient.record_checks import CommonMotion
from ringtrue.identification.ambient.ssi_cov import block_power
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import unit
from ringtrue.signal.spectra import Welch, block_weights, detrend, psd

REACH = 0.5  # of the limits of a band: poles beyond it have no part in its correlations


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
        mean, deviation = var.deviations(r, loudness * sums.share / (loudness @ sums.share))
        band = sums.band
        return cls(band.low, band.high, band.rate, mean, deviation, sums.scale)

    def residues(self, pole: Complex) -> tuple[Complex, Complex]:
        """Residues (m, ch, ref) of the poles (m,), rad/s, and by each block (block, m, ch, ref)."""
        lag = np.arange(1, len(self.mean))
        decay = np.exp(pole * (lag[:, None] / self.rate))
        design = np.concatenate([decay.real, -decay.imag], axis=1)
        inverse = np.linalg.pinv(design, rcond=1e-6)
        parts = np.tensordot(inverse, self.mean[1:], 1)
        by_block = np.einsum("pl,blcr->bpcr", inverse, self.deviation[:, 1:], optimize=True)
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
            near = (frequency > REACH * band.low) & (frequency < band.high / REACH)
            near &= frequency < 0.45 * band.rate
            near |= inside
            residue, by_block = band.residues(pole[near])
            own = inside[near]
            scale: Any_ = band.scale[:, None]
            if self.motion:
                scale = scale * self.motion.turn[:, None] * self.motion.lift(pole[inside])
            shape[:, inside], std[:, inside] = _shapes(residue[own], by_block[:, own], scale)
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
