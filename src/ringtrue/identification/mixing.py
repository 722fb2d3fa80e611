"""Shapes of close modes told apart by their spectra: separation of sources whose spectra are known.

The shapes of two close modes are known to lie in the plane of the two estimates, but less well
where in it: each estimate holds a little of the other mode. Filters that pass one of the two and
stop all others give modal coordinates

    q'_i = q_i + ε_ij q_j + .., E[q'_i q'_j*] = ε_ij P_j + ε_ji* P_i + S_ij H_i H_j* + B_ij,

with the spectra P = A |H|² of single modes, the correlation S_ij of their forces and a background
B_ij: linear in four unknowns. Periodograms are independent from line to line, of variance
E[|q'_i|²] E[|q'_j|²] / lines; weighted least squares therefore is a step of Fisher scoring of
Whittle's likelihood, and reaches its bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.whittle import CHANCE, WAVES, SpectralBins
from ringtrue.shapes.mac import mac

CLOSE = 4.0  # sums of half bandwidths between modes that mix
FAR = 8.0  # the same for neighbours
REACH = 8.0  # half bandwidths to each side of a mode that are looked at
LEAST = 4  # bins within the bandwidth of a mode
# standard deviation of ε; what the subspace estimates of a close pair state of it themselves is too
# small
PRIOR = 0.2
MISFIT = 1.5  # of the cross spectrum, beyond which something else than two modes is in it
ALIKE = 0.6  # MAC of shapes that may be those of one mode, seen twice
LEFT = 1e-3  # power of the other mode expected in a modal coordinate
FOREIGN = 2.5  # times the expected power: something else stands there


@dataclass(frozen=True, slots=True, eq=False)
class Mixing:
    """How the true shapes hang together with the estimates.

    Attributes
    ----------
    matrix : (m, m) complex128
        The true shapes are the estimates (ch, m) times this; 1 on the diagonal.
    variance : (m, m) float64
        E|Δ|² of its values; 0 where modes are too far apart to mix.
    """

    matrix: Complex
    variance: Float


def unmix(
    bins: SpectralBins,
    frequency: Float,
    damping: Float,
    shape: Complex,
    slope: float,
    *,
    start: Complex | None = None,
) -> Mixing:
    """The mixing of the shapes of close modes, to first order around a start.

    Parameters
    ----------
    bins : SpectralBins
    frequency, damping : (m,) float64
        Hz, fraction of critical.
    shape : (ch, m) complex128
        The estimates, in the channels and the units of the spectra.
    slope : float
        Exponent of the frequency in the responses' spectrum under a flat force: 4 for
        accelerations.
    start : (m, m) complex128
        The mixing known so far, 1 on the diagonal.
    """
    m, half = frequency.size, frequency * damping
    begin = np.eye(m, dtype=np.complex128) if start is None else start
    matrix, variance = begin.copy(), np.zeros((m, m))
    apart = np.abs(frequency[:, None] - frequency) / (half[:, None] + half)
    rank = np.argsort(np.argsort(frequency, kind="stable"), kind="stable")
    near = np.where(np.abs(rank[:, None] - rank) == 1, apart < FAR, apart < CLOSE)
    pairs = [(i, j) for i in range(m) for j in range(i) if near[i, j] and len(shape) > 2]
    for i, j in pairs:
        both = (np.array([i, j]), np.array([j, i]))
        if (
            found := _pair(bins, frequency, damping, shape @ begin, (i, j), slope, begin[both])
        ) is not None:
            matrix[both], variance[both] = found
    return Mixing(matrix, variance)


def _pair(
    b: SpectralBins,
    f: Float,
    z: Float,
    psi: Complex,
    pair: tuple[int, int],
    slope: float,
    known: Complex,
) -> tuple[Complex, Float] | None:
    """ε_ij and ε_ji, (2,) `known` so far, and their variances; None where the spectra do not tell
    them.
    """
    (i, j), two = pair, list(pair)
    parts = _windows(b.freqs, f[two], z[two])
    freqs, count = (np.concatenate([x[p] for p in parts]) for x in (b.freqs, b.count))
    nu = freqs[:, None] / f[two]
    inside = (np.abs(nu - 1) < z[two]).sum(0)
    if inside.min() < LEAST or mac(psi[:, [i]], psi[:, [j]])[0, 0] > ALIKE:
        return None
    h = np.asarray(
        2 * z[two] * nu ** (slope / 2) / (1 - nu**2 + 2j * z[two] * nu), dtype=np.complex128
    )
    w = _filters(b, parts, f, z, psi, two)
    # w G wᴴ as a product of long rows
    both = np.einsum("ic,jd->cdij", w, w.conj()).reshape(-1, 4).astype(np.complex64)
    q = np.concatenate([b.cross[p].reshape(-1, len(both)) @ both for p in parts]).astype(
        np.complex128
    )
    seen = np.maximum(q[:, [0, 3]].real, 1e-300)
    power, rest = _levels(seen, h)
    expected = power * np.abs(h) ** 2 + rest + LEFT * (power * np.abs(h) ** 2)[:, ::-1]
    smooth = np.stack([np.convolve(x, np.full(7, 1 / 7), "same") for x in seen.T], axis=1)
    expected = np.where(smooth > FOREIGN * expected, smooth, expected)
    cell = np.floor((freqs - freqs.min()) / (f[two] * z[two]).min()).astype(np.int64)
    return _solved(q[:, 1], count / expected.prod(1), h, power, rest, known, cell)


def _windows(freqs: Float, f: Float, z: Float) -> list[slice]:
    """The bins beside both modes: one range, or two where these do not touch."""
    low, high = np.searchsorted(freqs, f - REACH * z * f), np.searchsorted(freqs, f + REACH * z * f)
    first, second = np.argsort(low, kind="stable").tolist()
    if high[first] < low[second]:
        return [slice(low[k], high[k]) for k in (first, second)]
    return [slice(low[first], max(high))]


def _filters(
    b: SpectralBins, parts: list[slice], f: Float, z: Float, psi: Complex, pair: list[int]
) -> Complex:
    """(2, ch) of gain 1 for one shape of the pair and 0 for the other, that pass least of noise and
    other modes.
    """
    others = np.setdiff1d(np.arange(f.size), pair)
    auto = np.diagonal(b.cross, axis1=1, axis2=2).real
    here = np.concatenate([auto[p] for p in parts])
    noise = np.percentile(here, 10, axis=0) + 1e-6 * here.mean(0)
    peak = auto[np.abs(b.freqs[:, None] - f[others]).argmin(0)].sum(1) / (
        np.abs(psi[:, others]) ** 2
    ).sum(0)
    nu = np.concatenate([b.freqs[p] for p in parts])[:, None] / f[others]
    level = (4 * z[others] ** 2 / ((1 - nu**2) ** 2 + 4 * z[others] ** 2 * nu**2)).mean(0)
    r = np.diag(noise) + (psi[:, others] * (10 * peak * level)) @ psi[:, others].conj().T
    own = psi[:, pair]
    x = np.linalg.solve(r, own)
    return np.asarray(np.linalg.solve(own.conj().T @ x, x.conj().T))


def _levels(own: Float, h: Complex) -> tuple[Float, Float]:
    """Peak of each mode and the background beside it (2,) from the spectra (bin, 2) of its
    coordinate.
    """
    form = np.abs(h) ** 2
    inside = form > 0.5
    power = (own * inside).sum(0) / np.maximum((form * inside).sum(0), 1e-300)
    away = np.where(form < 0.03, own - power * form, np.nan)
    seen = np.asarray(np.isfinite(away).any(0))
    rest = np.array([np.nanmedian(x) if s else 0.0 for x, s in zip(away.T, seen, strict=True)])
    return power, np.maximum(rest, 1e-3 * power)


def _solved(
    cross: Complex, weight: Float, h: Complex, power: Float, rest: Float, known: Complex, cell: Int
) -> tuple[Complex, Float] | None:
    """ε_ij and ε_ji and their variances from the cross spectrum (bin,) of the two coordinates.

    Errors of bins in one `cell` (bin,), half a bandwidth wide, that go together are no noise: other
    modes, or forces that modes share.
    """
    p = power * np.abs(h) ** 2
    force = np.sqrt(power.prod()) * h[:, 0] * h[:, 1].conj()
    x = np.stack([p[:, 1], p[:, 0], force, np.full(len(p), np.sqrt(rest.prod()))], axis=1)
    wx = x.conj() * weight[:, None]
    hold = np.array([PRIOR**-2, PRIOR**-2, 1.0, 1.0])
    n = wx.T @ x + np.diag(hold)
    value = np.array([known[0], known[1].conj(), 0.0, 0.0])
    step = np.linalg.solve(n, wx.T @ cross - hold * value)
    error = np.sqrt(weight) * (cross - x @ step)
    misfit, size = float((np.abs(error) ** 2).mean()), np.bincount(cell)
    together = np.abs(np.bincount(cell, error.real) + 1j * np.bincount(cell, error.imag)) ** 2
    waves = float((together[size > 0] / size[size > 0]).mean())
    if misfit > MISFIT or waves > WAVES:
        return None
    found = value + step
    spread = np.diagonal(np.linalg.solve(n, np.eye(4))).real * max(misfit, waves / CHANCE, 1.0)
    return np.array([found[0], found[1].conj()]), spread[:2]
