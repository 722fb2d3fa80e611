"""Spectral matrices of a record in bins of constant relative width.

Candidate modes of a band: checks of each pole, clusters over the orders, one estimate of each.

A physical pole differs from a mathematical one by what is measured: its standard deviation, the
strength of its contribution to the correlations, and the orders that show it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from scipy.fft import prev_fast_len, rfft
from scipy.sparse import csr_array
from scipy.special import ndtri

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.ambient.ssi_cov import BandPoles, transition
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import (
    DAMPING_MAX,
    cluster_poles,
    unit,
)
from ringtrue.shapes import mpc
from ringtrue.signal.band_correlations import Signals


@dataclass(frozen=True, slots=True, eq=False)
class CandidateModes:
    """Modes of one band before their confidence is known.

    Attributes
    ----------
    pole : (m,) complex128, rad/s
    deviation : (m, block) complex128, rad/s
        By each block of the record; the sum of squares is the variance.
    shape : (ch, m) complex128
    shape_deviation : (m, ch, block) complex128
        Of the shape by each block of the record, and by what is not known of its mixing with
        others.
    orders : (m, 2) int64
        Orders that show it, orders tried.
    strength : (m,) float64
        Signal-to-noise ratio in the correlations.
    mpc : (m,) float64
    label : (k,) int64
        Row of this table for each pole of the band, -1 for none.
    stable : (k,) bool
    refined : (m,) bool
        Pole and deviation are of the maximum likelihood fit.
    gain : (m,) float64
        Root of twice what a peak adds to the log-likelihood of the spectrum (`BandEvidence`).
    agreement : (m, 2) float64
        Share of the orders of SSI-data and of pLSCF that show it; NaN where they were not asked.
    """

    pole: Complex
    deviation: Complex
    shape: Complex
    shape_deviation: Complex
    orders: Int
    strength: Float
    mpc: Float
    label: Int
    stable: Bool
    refined: Bool
    gain: Float
    agreement: Float

    def stds(self) -> tuple[Float, Float]:
        """Standard deviations of frequency (Hz) and damping ratio, each (m,)."""
        df, dz = var.frequency_damping(self.pole, self.deviation)
        return var.root_sum_square(df), var.root_sum_square(dz)

    @property
    def frequencies(self) -> Float:
        """(m,) Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(m,) fraction of critical."""
        return -self.pole.real / np.abs(self.pole)


def stable_poles(band: BandPoles, strength: float = 2.0) -> Bool:
    """(k,) poles worth clustering: damped, known to a few per cent, of some strength."""
    p = band.poles
    # to a share of the frequency, or of the half bandwidth of a mode of much damping
    sharp = p.std_frequency < np.maximum(0.025, 0.5 * p.damping) * p.frequencies
    known = sharp & (p.std_damping < np.maximum(p.damping, 2e-3))
    return (p.damping < DAMPING_MAX) & known & (band.strength > strength)


def _average(band: BandPoles, at: Int) -> tuple[complex, Complex, Complex, int]:
    """Pole, deviation and shape of the poles `at` of one cluster by inverse variance, and its
    representative.
    """
    p = band.poles
    # relative to ζ: the variance of a pole grows with its damping, weights from it alone would
    # favour small damping
    v = (np.abs(band.deviation[at]) ** 2).sum(1) / np.maximum(-p.pole[at].real, 1e-12)
    w = (1 / v) / (1 / v).sum()
    pole = complex(w @ p.pole[at])
    far = np.abs(p.pole[at] - pole) ** 2 / np.abs(pole) ** 2
    best = int(at[np.argmin(far + 1e-4 * v / v.min())])
    # low orders lack modes, whose motion goes into the shapes of those that are there
    high = p.order[at] > p.order.max() / 2
    share = w * high if high.sum() > 1 else w
    psi = p.shape[:, at]
    turn = p.shape[:, best].conj() @ psi
    shape = (psi * (turn.conj() / np.abs(turn))) @ (share / share.sum())
    return pole, w @ band.deviation[at], shape, best


def _shape_deviations(band: BandPoles, at: list[int]) -> Complex:
    """Deviations (m, ch, block) of the shapes of the poles `at`, their largest component 1, with
    Student's factor.
    """
    sub = band.subspace
    p = band.poles
    blocks = band.deviation.shape[1]
    orders = {n: transition(sub, n) for n in np.unique(p.order[at]).tolist()}
    out = np.empty((len(at), sub.channels, blocks), dtype=np.complex128)
    for row, k in zip(out, at, strict=True):  # modes
        n = int(p.order[k])
        i = int(np.argmin(np.abs(orders[n][0] - np.exp(p.pole[k] / sub.rate))))
        c = sub.u[: sub.channels, :n]
        r = sub.r[:n, :n]
        row[:] = sub.turned(
            var.shape_deviations(band.perturbations, orders[n], c, i, r)
        )
    return var.students_factor(blocks - 1) * out


def candidates(band: BandPoles, *, driven: bool) -> CandidateModes:
    """Clusters of the stable poles with four members or more, ascending in frequency.

    The strengths of modes `driven` by events vary as these do and are not asked for.
    """
    stable = stable_poles(band, strength=0.0 if driven else 2.0)
    use = np.flatnonzero(stable)
    label = cluster_poles(
        band.poles.pole[use], band.poles.shape[:, use], band.poles.order[use]
    )
    groups = [use[label == g] for g in range(int(label.max(initial=-1)) + 1)]
    groups = [g for g in groups if g.size >= 4]
    means = [_average(band, g) for g in groups]
    rank = np.argsort([abs(m[0]) for m in means], kind="stable")
    groups = [groups[i] for i in rank]
    means = [means[i] for i in rank]
    return _table(band, groups, means, stable)


def groups_table(band: BandPoles, groups: list[Int]) -> CandidateModes:
    """Candidates of given groups of poles (positions), whatever the checks say of them, in the
    given order.
    """
    return _table(band, groups, [_average(band, g) for g in groups], stable_poles(band))


def _table(
    band: BandPoles,
    groups: list[Int],
    means: list[tuple[complex, Complex, Complex, int]],
    stable: Bool,
) -> CandidateModes:
    p = band.poles
    m = len(groups)
    ch = band.subspace.channels
    nb = band.deviation.shape[1]
    label = np.full(len(p), -1, dtype=np.int64)
    for i, g in enumerate(groups):
        label[g] = i
    size = np.array([g.size for g in groups], dtype=np.int64)
    shape = (
        np.stack([x[2] for x in means], axis=1)
        if m
        else np.empty((ch, 0), np.complex128)
    )
    d = _shape_deviations(band, [x[3] for x in means])
    return CandidateModes(
        pole=np.array([x[0] for x in means], dtype=np.complex128),
        deviation=np.stack([x[1] for x in means])
        if m
        else np.empty((0, nb), np.complex128),
        shape=unit(shape),
        shape_deviation=d,
        orders=np.stack([size, np.full(m, p.orders.size)], axis=1).astype(np.int64),
        strength=np.array([np.median(band.strength[g]) for g in groups]),
        mpc=mpc(shape),
        label=label,
        stable=stable,
        refined=np.zeros(m, dtype=np.bool_),
        gain=np.zeros(m),
        agreement=np.full((m, 2), np.nan),
    )


def stacked(one: CandidateModes, two: CandidateModes) -> CandidateModes:
    """The rows of two tables of one band; the second one's poles count for it."""
    wide = max(one.deviation.shape[1], two.deviation.shape[1])
    one, two = (
        replace(
            c, deviation=np.pad(c.deviation, ((0, 0), (0, wide - c.deviation.shape[1])))
        )
        for c in (one, two)
    )
    by_row = [
        f.name
        for f in fields(CandidateModes)
        if f.name not in ("shape", "label", "stable")
    ]
    joined = {n: np.concatenate([getattr(one, n), getattr(two, n)]) for n in by_row}
    return CandidateModes(
        **joined,
        shape=np.concatenate([one.shape, two.shape], axis=1),
        label=np.where(two.label >= 0, two.label + one.pole.size, one.label),
        stable=one.stable,
    )


def steady(c: CandidateModes, at: Int, power: Float, seconds: float) -> bool:
    """Whether the `power` (block,) of a record of `seconds` varies no more than that of the modes
    `at` by chance.

    A spectrum takes loud blocks for more than they tell: the scatter of what is fitted to it grows
    as the mean square of the power does over its squared mean, the blocks of the subspace estimate
    are weighed.
    """
    chance = np.median(1 / (1 - c.pole.real[at] * seconds / power.size))
    return bool((power**2).mean() < (1.2 + 2 * chance) * power.mean() ** 2)


def oscillator_spectrum(nu: Float, zeta: Float | float) -> Float:
    """Power spectrum, peak 1, of an oscillator under a flat force, ν = f/f₀."""
    return 4 * zeta**2 / ((1 - nu**2) ** 2 + 4 * zeta**2 * nu**2)


@dataclass(frozen=True, slots=True, eq=False)
class SpectralBins:
    """Spectral matrix averaged over bins of neighbouring lines.

    Attributes
    ----------
    freqs : (bin,) float64, Hz
    count : (bin,) float64
        Lines averaged.
    cross : (bin, ch, ch) complex64
    duration : float, s
        Of one periodogram.
    lost : float
        Share of the record that the recorder lost, bridged by straight lines.
    breaks : float, 1/s
        Number of these stretches, in a second of the record.
    """

    freqs: Float
    count: Float
    cross: Any_
    duration: float
    lost: float = 0.0
    breaks: float = 0.0

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """Weights and lengths (s) of the triangles that make up the window on the correlations.

        Pairs of samples at a lag τ that are both there become fewer as 1 - τ/duration, and by those
        that a lost stretch takes: breaks · τ at small lags, of the share (1 - lost), and as much as
        chance counts beyond their length.
        """
        if not self.lost:
            return ((1.0, self.duration),)
        return (
            (1 - self.lost, self.duration),
            (self.lost, self.lost * (1 - self.lost) / self.breaks),
        )


def spectral_bins(
    y: Signals, channels: Int, *, rate: float, limits: tuple[float, float], scale: Float
) -> SpectralBins:
    """Spectral matrices of some channels times `scale` (ch,) within `limits` (Hz).

    A bin is 4e-4 of its frequency wide. Transforms of a long record are slow, and their lines finer
    than the bins, so it is taken in parts of 2¹⁸ samples.
    """
    parts = max(1, round(y.samples / 2**18))
    n = int(prev_fast_len(y.samples // parts, real=True))
    first = int(np.ceil(max(limits[0] * n / rate, 1)))
    last = int(min(limits[1] * n / rate, n // 2 - 1))
    lines = np.empty((last + 1 - first, parts, channels.size), dtype=np.complex64)
    for k in range(parts):
        start = k * (y.samples // parts)
        part = y.part(start, start + n, channels)
        lines[:, k] = rfft(part, axis=1)[:, first : last + 1].T
    unit = np.outer(scale, scale).astype(np.float32) * np.float32(
        2 / (n * rate * parts)
    )
    edges = [first]
    while edges[-1] <= last:  # sub-bands, with bins of one width each
        edges.append(max(int(edges[-1] * 1.2), edges[-1] + 1))
    places = []
    counts = []
    matrices = []
    for low, high in pairwise(edges):
        band = lines[low - first : high - first]
        width = max(1, min(int(4e-4 * low), len(band)))
        bins = len(band) // width
        z = band[: bins * width].reshape(bins, -1, channels.size)
        cross = z.transpose(0, 2, 1) @ z.conj()
        cross *= unit / np.float32(width)
        places.append(low + np.arange(bins) * width + 0.5 * (width - 1))
        counts.append(np.full(bins, float(width * parts)))
        matrices.append(cross)
    freqs = np.concatenate(places) * rate / n
    return SpectralBins(
        freqs, np.concatenate(counts), np.concatenate(matrices), n / rate
    )


@dataclass(frozen=True, slots=True)
class SpectrumPeak:
    """A peak of a singular value.

    Attributes
    ----------
    frequency, width : float, Hz
        Width at half of its height above the surroundings.
    value : int
        Which singular value, from 1.
    prominence : float, dB
    """

    frequency: float
    width: float
    value: int
    prominence: float


def averaged_lines(bins: SpectralBins) -> tuple[Int, Float, Float]:
    """The first bin (f,), the frequency (f,), Hz, and the number of lines (f,) of averages over at
    least as many lines as the spectral matrix has channels.
    """
    group = np.floor(np.cumsum(bins.count) / bins.cross.shape[1])
    start = np.flatnonzero(np.diff(group, prepend=-1.0))
    count = np.add.reduceat(bins.count, start)
    return start, np.add.reduceat(bins.freqs * bins.count, start) / count, count


def singular_values(bins: SpectralBins) -> tuple[Float, Float]:
    """Frequencies (f,), Hz, and the three singular values (3, f) of the averaged spectral matrix
    that diagrams show, positive and descending.
    """
    start, freqs, count = averaged_lines(bins)
    channels = bins.cross.shape[1]
    size = bins.count.size
    parts = (bins.count.astype(np.float32), np.arange(size), np.append(start, size))
    sums = csr_array(parts) @ bins.cross.reshape(size, -1)
    values = np.linalg.eigvalsh(sums.reshape(-1, channels, channels)).T[:-4:-1]
    return freqs, np.maximum(values / count, np.finfo(np.float32).tiny)


def spectrum_peaks(
    bins: SpectralBins, decibel: Float, low: float, high: float
) -> tuple[SpectrumPeak, ...]:
    """Peaks of the singular values between `low` and `high`, Hz, that have half power points and
    are higher than chance makes any of them.

    The singular values of the spectral matrix peak at the modes (Brincker, Zhang and Andersen
    2001). Where the curves of two modes cross, the lower value has a peak under a dip of the upper:
    that is none.

    Parameters
    ----------
    bins : SpectralBins
    decibel : (value, f) float64
        Levels of their singular values.
    low, high : float, Hz
    """
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    _, freqs, count = averaged_lines(bins)
    if freqs.size < 8:
        return ()
    level = decibel * np.log(10) / 10
    # by chance the logarithm of a line differs from that of another one by this at most
    chance = -ndtri(FALSE_ALARM / level.size) * np.sqrt(2 / np.median(count))
    least = max(chance, np.log(2))
    found = []
    for k, curve in enumerate(level):
        places, about = find_peaks(curve, prominence=least, width=0, rel_height=0.5)
        for at, prominence, width in zip(
            places, about["prominences"], about["widths"], strict=True
        ):
            frequency = float(freqs[at])
            above = level[k - 1, max(at - 2, 0) : at + 3]
            dip = k > 0 and 0 < above.argmin() < above.size - 1  # where two modes cross
            if low <= frequency <= high and not dip:
                step = float(freqs[min(at + 1, freqs.size - 1)] - freqs[at - 1]) / 2
                height = float(10 * prominence / np.log(10))
                found.append(
                    SpectrumPeak(frequency, float(width) * step, k + 1, height)
                )
    return tuple(found)
