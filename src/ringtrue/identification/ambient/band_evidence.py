"""What the spectrum of a band and other estimators say of its candidates.

The others are SSI-data, and pLSCF on half spectra, on the same correlations. An error that the
record makes is the same in all of them, so their evidence weighs little. Where events drive the
record there is no steady past to project on: they are not asked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.ambient.confidence import LIMITS
from ringtrue.identification.ambient.spectral_bins import CandidateModes, SpectralBins
from ringtrue.identification.ambient.ssi_cov import (
    SsiCov,
    all_orders,
    subspace,
)
from ringtrue.identification.common.stabilisation import DAMPING_MAX, PoleSet, unit
from ringtrue.identification.frf.plscf import Plscf, plscf, pole_shapes
from ringtrue.shapes import mac
from ringtrue.signal.spectra import Band, half_spectra
from ringtrue.signal.tonal_lines import DYNAMIC_RANGE


@dataclass(frozen=True, slots=True, eq=False)
class BandEvidence:
    """The spectral matrix and the poles of other estimators of a band, to weigh candidates by.

    Attributes
    ----------
    bins : SpectralBins
    channels : (eye,) int64
        Their positions among all channels.
    duration : float, s
        Of the record.
    others : two PoleSet
        Of SSI-data and of pLSCF; none where events drive the record.
    """

    bins: SpectralBins
    channels: Int
    duration: float
    others: tuple[PoleSet, ...]

    def weighed(self, c: CandidateModes) -> CandidateModes:
        """The candidates with what the spectrum and the other estimators say of them."""
        c = replace(c, gain=self._gains(c))
        if not self.others:
            return c
        agreement = [share_of_orders(x, c.pole, c.shape) for x in self.others]
        return replace(c, agreement=np.stack(agreement, axis=1))

    def _gains(self, c: CandidateModes) -> Float:
        """(m,) the likelihood that a peak at each candidate adds to the spectrum.

        The spectrum along the shape of a mode, by the filter that passes least of what lies on both
        sides of it (Capon 1969), has lines that are exponentially distributed. Their mean at the
        mode is r times that on both sides, and 2n (r - 1 - ln r) is twice the logarithm of the
        likelihood ratio of n lines. The sign is that of the peak. What lies 140 dB below the
        highest level is rounding.
        """
        gain = [
            self._gain(*x)
            for x in zip(c.frequencies, c.damping, c.shape.T, strict=True)
        ]
        level = np.trace(self.bins.cross, axis1=1, axis2=2).real
        here = np.interp(c.frequencies, self.bins.freqs, level)
        rounding = here < DYNAMIC_RANGE * level.max(initial=0.0)
        return np.where(rounding, -np.inf, np.array(gain, dtype=np.float64))

    def _gain(self, frequency: float, damping: float, shape: Complex) -> float:
        bins = self.bins
        half = max(damping * frequency, 1 / bins.duration)
        away = np.abs(bins.freqs - frequency) / half
        peak = np.flatnonzero(away < 1.5)
        sides = np.flatnonzero((away >= 1.5) & (away < 6.0))
        if not peak.size or not sides.size:
            return 0.0
        psi = shape[self.channels]
        inside = np.average(bins.cross[peak], axis=0, weights=bins.count[peak])
        outside = np.average(bins.cross[sides], axis=0, weights=bins.count[sides])
        floor = 1e-3 * np.trace(outside).real / psi.size
        if not floor > 0:
            return 0.0
        solved = np.linalg.solve(outside + floor * np.eye(psi.size), psi)
        ratio = float(
            (solved.conj() @ inside @ solved).real / (psi.conj() @ solved).real
        )
        twice = 2 * bins.count[peak].sum() * (ratio - 1 - np.log(ratio))
        return float(np.sign(ratio - 1) * np.sqrt(max(twice, 0.0)))


def share_of_orders(poles: PoleSet, pole: Complex, shape: Complex) -> Float:
    """(m,) share of the orders of `poles` that show a mode: by a pole of its shape, within half of
    its half bandwidth.

    Half an order is counted for it and half against it, as its logarithm is taken.

    Parameters
    ----------
    poles : PoleSet
    pole : (m,) complex128, rad/s
    shape : (ch, m) complex128
    """
    near = np.abs(poles.pole[:, None] - pole) < -0.5 * pole.real
    near &= mac(poles.shape, shape) > LIMITS.same
    shown = np.zeros(pole.size)
    for n in poles.orders:
        shown += near[poles.order == n].any(axis=0)
    return (shown + 0.5) / (poles.orders.size + 1)


def other_poles(
    r: Float, references: Int, ssi: SsiCov, band: Band, turn: Complex | None = None
) -> tuple[PoleSet, PoleSet]:
    """Poles of a band by SSI-data and by pLSCF, without standard deviations.

    Parameters
    ----------
    r : (lag, ch, ref) float64
        Correlations.
    references : (ref,) int64
    ssi : SsiCov
        The largest order holds for both.
    band : Band
    turn : (ch,) complex128, optional
        Phases that make one motion of channels of different kinds.
    """
    limits = band.low, band.high
    own = ssi.projected(r.shape[1])
    projected = subspace(r, own, band.rate, turn=turn, past=references)
    by_projection = replace(
        all_orders(projected, None, ssi, limits)[0], method="SSI-data"
    )
    half = half_spectra(r, band.rate, limits)
    top = min(ssi.order_max // references.size, half.freqs.size // 3)
    if top < 2:  # too few lines
        none = np.empty(0, dtype=np.int64)
        return by_projection, replace(by_projection.take(none), method="pLSCF")
    # with the window
    most = DAMPING_MAX + half.decay / (2 * np.pi * half.freqs[0])
    found = plscf(half.data, half.freqs, Plscf(max(top // 4, 1), top, most))
    by_spectra = replace(
        found,
        order=found.order * references.size,
        pole=found.pole + half.decay,
        shape=unit(pole_shapes(found, half.data, half.freqs, power=0)),
        method="pLSCF",
    )
    return by_projection, by_spectra.take(by_spectra.damping > 0)
