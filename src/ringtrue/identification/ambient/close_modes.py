"""Close modes: shapes separated by their spectra, and pairs that the record does not separate.

The shapes of two close modes lie in the plane of the two estimates; each estimate holds a little of
the other mode. Filters that pass one of the two and stop all others give modal coordinates

    q'_i = q_i + ε_ij q_j + .., E[q'_i q'_j*] = ε_ij P_j + ε_ji* P_i + S_ij H_i H_j* + B_ij,

with the spectra P = A |H|² of single modes, the correlation S_ij of their forces and a background
B_ij: linear in four unknowns. Periodograms are independent from line to line, of variance
E[|q'_i|²] E[|q'_j|²] / lines; so weighted least squares is a step of Fisher scoring of Whittle's
likelihood, and reaches its bound.

The poles of a repeated root take another mixture of the two shapes at every order; the plane of the
two stays in place. In a basis q of that plane each order gives A = C diag(λ) C⁻¹, C = qᴴψ, free of
the mixture. Its mean has the poles of the pair. Where they are no farther from each other than they
are known, any turn in the plane fits as well: the shapes are then two real orthogonal ones, and
their deviations hold the turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.ambient.band_evidence import BandEvidence
from ringtrue.identification.ambient.confidence import LIMITS as CONFIDENCE
from ringtrue.identification.ambient.confidence import confidence
from ringtrue.identification.ambient.maximum_likelihood import (
    EstimatedModes,
    refine_by_likelihood,
)
from ringtrue.identification.ambient.spectral_bins import (
    CandidateModes,
    SpectralBins,
    groups_table,
    oscillator_spectrum,
    stable_poles,
    stacked,
)
from ringtrue.identification.ambient.ssi_cov import BandPoles
from ringtrue.identification.common.stabilisation import unit
from ringtrue.shapes import mpc

ANY_TURN = float(np.sqrt(0.5))


@dataclass(frozen=True, slots=True, eq=False)
class Mixing:
    """How the true shapes hang together with the estimates.

    Attributes
    ----------
    matrix : (m, m) complex128
        The true shapes are the estimates (ch, m) times this; 1 on the diagonal.
    variance : (m, m) float64
        E|Δ|² of its values; 0 where modes are too far from each other to mix.
    """

    matrix: Complex
    variance: Float


def unmix(
    bins: SpectralBins,
    modes: EstimatedModes,
    slope: float,
    *,
    start: Complex | None = None,
) -> Mixing:
    """The mixing of the shapes of close modes, to first order around a start.

    Parameters
    ----------
    bins : SpectralBins
    modes : EstimatedModes
    slope : float
        Exponent of the frequency in the responses' spectrum under a flat force: 4 for
        accelerations.
    start : (m, m) complex128
        The mixing known so far, 1 on the diagonal.
    """
    frequency = modes.frequency
    m = frequency.size
    half = frequency * modes.damping
    begin = np.eye(m, dtype=np.complex128) if start is None else start
    matrix = begin.copy()
    variance = np.zeros((m, m))
    if len(modes.shape) < 3:
        return Mixing(matrix, variance)
    distance = np.abs(frequency[:, None] - frequency) / (half[:, None] + half)
    near = distance < CONFIDENCE.mixing
    mixed = replace(modes, shape=modes.shape @ begin)
    for i in range(m):
        for j in range(i):
            both = (np.array([i, j]), np.array([j, i]))
            found = None
            if near[i, j]:
                found = _pair_mixing(bins, mixed, [i, j], slope, begin[both])
            if found is not None:
                matrix[both], variance[both] = found
    return Mixing(matrix, variance)


def _pair_mixing(
    b: SpectralBins,
    modes: EstimatedModes,
    pair: list[int],
    slope: float,
    known: Complex,
) -> tuple[Complex, Float] | None:
    """ε_ij and ε_ji, (2,) `known` so far, and their variances; None where the spectra do not show
    them.
    """
    f = modes.frequency[pair]
    z = modes.damping[pair]
    # the bins around both modes
    low = np.searchsorted(b.freqs, f - CONFIDENCE.mixing * z * f)
    high = np.searchsorted(b.freqs, f + CONFIDENCE.mixing * z * f)
    at = np.union1d(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    freqs = b.freqs[at]
    nu = freqs[:, None] / f
    inside = (np.abs(nu - 1) < z).sum(0)
    averaged = 7  # bins
    if not inside.all() or at.size < averaged:
        return None
    h: Complex = (2 * z * nu ** (slope / 2) / (1 - nu**2 + 2j * z * nu)).astype(complex)
    w = _filters(b, at, modes, pair)
    # w G wᴴ as a product of long rows
    both = np.einsum("ic,jd->cdij", w, w.conj()).reshape(-1, 4).astype(np.complex64)
    q = (b.cross[at].reshape(-1, len(both)) @ both).astype(np.complex128)
    own = np.maximum(q[:, [0, 3]].real, 1e-300)
    power, rest = _levels(own, h)
    peaks = power * np.abs(h) ** 2
    # a thousandth of the other mode is left in each coordinate
    expected = peaks + rest + 1e-3 * peaks[:, ::-1]
    box = np.full(averaged, 1 / averaged)
    smooth = np.stack([np.convolve(x, box, "same") for x in own.T], axis=1)
    # something else is there
    expected = np.where(smooth > 2.5 * expected, smooth, expected)
    cell = np.floor((freqs - freqs.min()) / (f * z).min()).astype(np.int64)
    p = peaks
    force = np.sqrt(power.prod()) * h[:, 0] * h[:, 1].conj()
    background = np.full(len(p), np.sqrt(rest.prod()))
    x = np.stack([p[:, 1], p[:, 0], force, background], axis=1)
    return _solve_mixing(q[:, 1], b.count[at] / expected.prod(1), x, known, cell)


def _filters(
    b: SpectralBins, at: Int, modes: EstimatedModes, pair: list[int]
) -> Complex:
    """(2, ch) of gain 1 for one shape of the pair and 0 for the other, that pass least of noise and
    other modes.
    """
    others = np.setdiff1d(np.arange(modes.frequency.size), pair)
    f = modes.frequency[others]
    z = modes.damping[others]
    psi = modes.shape[:, others]
    auto = np.diagonal(b.cross, axis1=1, axis2=2).real
    here = auto[at]
    noise = np.percentile(here, 10, axis=0) + 1e-6 * here.mean(0)
    peak = auto[np.abs(b.freqs[:, None] - f).argmin(0)].sum(1) / (np.abs(psi) ** 2).sum(
        0
    )
    nu = b.freqs[at][:, None] / f
    level = oscillator_spectrum(nu, z).mean(0)
    r = np.diag(noise) + (psi * (10 * peak * level)) @ psi.conj().T
    own = modes.shape[:, pair]
    x = np.linalg.solve(r, own)
    return np.asarray(np.linalg.solve(own.conj().T @ x, x.conj().T))


def _levels(own: Float, h: Complex) -> tuple[Float, Float]:
    """Peak of each mode and the background around it (2,) from the spectra (bin, 2) of its
    coordinate.
    """
    form = np.abs(h) ** 2
    inside = form > 0.5
    power = (own * inside).sum(0) / np.maximum((form * inside).sum(0), 1e-300)
    away = np.where(form < 0.03, own - power * form, np.nan)
    seen = np.asarray(np.isfinite(away).any(0))
    rest = np.array(
        [np.nanmedian(x) if s else 0.0 for x, s in zip(away.T, seen, strict=True)]
    )
    return power, np.maximum(rest, 1e-3 * power)


def _solve_mixing(
    cross: Complex, weight: Float, x: Complex, known: Complex, cell: Int
) -> tuple[Complex, Float] | None:
    """ε_ij and ε_ji and their variances from the cross spectrum (bin,) of the two coordinates.

    Errors of bins in one `cell` (bin,), half a bandwidth wide, that go together are no noise: other
    modes, or forces that modes share. `x` (bin, 4) are what the four unknowns make of it. A
    subspace estimate of a close pair may be any turn of it.
    """
    wx = x.conj() * weight[:, None]
    hold = np.array([ANY_TURN**-2, ANY_TURN**-2, 1.0, 1.0])
    n = wx.T @ x + np.diag(hold)
    value = np.array([known[0], known[1].conj(), 0.0, 0.0])
    step = np.linalg.solve(n, wx.T @ cross - hold * value)
    error = np.sqrt(weight) * (cross - x @ step)
    misfit = float((np.abs(error) ** 2).mean())
    size = np.bincount(cell)
    sums = np.bincount(cell, error.real) + 1j * np.bincount(cell, error.imag)
    cells = size > 0
    waves = float((np.abs(sums[cells]) ** 2 / size[cells]).sum())
    if 2 * waves > chdtri(2 * cells.sum(), FALSE_ALARM):
        return None
    found = value + step
    by_chance = max(misfit, 1.0)
    spread = np.diagonal(np.linalg.solve(n, np.eye(4))).real * by_chance
    return np.array([found[0], found[1].conj()]), spread[:2]


def refined(
    c: CandidateModes,
    at: Int,
    references: Int,
    bins: SpectralBins,
    slope: tuple[float, float],
) -> CandidateModes:
    """The candidates with poles and deviations of the rows `at` from their own spectra.

    Modes of one band are then independent: the deviations of each take two columns of their own.
    """
    doubt = c.stds()[1][at] / c.damping[at]
    shape = c.shape[np.ix_(references, at)]
    modes = EstimatedModes(c.frequencies[at], c.damping[at], shape)
    rough = unmix(bins, modes, slope[0]).matrix
    blocks = c.deviation.shape[1]
    separated = replace(modes, shape=shape @ rough)
    fit = refine_by_likelihood(bins, separated, slope, doubt, blocks)
    modes = EstimatedModes(fit.frequency, fit.damping, shape)
    mix = unmix(bins, modes, slope[0], start=rough)
    c = _unmixed(c, at, mix)
    ok = np.flatnonzero(fit.ok)
    rows = at[ok]
    f = fit.frequency[ok]
    z = fit.damping[ok]
    root = np.sqrt(1 - z**2)
    pole = 2 * np.pi * f * (-z + 1j * root)
    by = np.stack([pole, 2 * np.pi * f * z * (-1 - 1j * z / root)], axis=1)
    own = (by[:, None] @ np.linalg.cholesky(fit.covariance[ok]))[:, 0]
    m = rows.size
    deviation = np.pad(c.deviation, ((0, 0), (0, 2 * m)))
    deviation[rows, :blocks] = 0.0
    deviation[rows[:, None], blocks + 2 * np.arange(m)[:, None] + np.arange(2)] = own
    poles = c.pole.copy()
    done = c.refined.copy()
    poles[rows], done[rows] = pole, True
    return replace(c, pole=poles, deviation=deviation, refined=done)


def _unmixed(c: CandidateModes, at: Int, mix: Mixing) -> CandidateModes:
    """The candidates with the shapes of the rows `at` separated.

    Deviations in the direction of a shape that was separated give way to those of the mixing, in
    columns of their own.
    """
    psi = c.shape[:, at] @ mix.matrix
    tried = mix.variance > 0
    inverse = np.linalg.pinv(psi)
    size = np.sqrt(0.5 * mix.variance)
    shape = c.shape.copy()
    like = c.mpc.copy()
    m = at.size
    deviation = np.concatenate(
        [c.shape_deviation, np.zeros((*c.shape_deviation.shape[:2], 2 * m))], axis=2
    )
    for k, row in enumerate(at):  # modes
        by_mixing = psi * size[:, k]
        d = c.shape_deviation[row]
        d = d - psi[:, tried[:, k]] @ (inverse @ d)[tried[:, k]]
        deviation[row] = np.concatenate([d, by_mixing, 1j * by_mixing], axis=1)
    shape[:, at], like[at] = psi, mpc(psi)
    return replace(c, shape=shape, shape_deviation=deviation, mpc=like)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two modes of a plane.

    Attributes
    ----------
    members : (order, 2) int64
        Positions among the poles of the band.
    basis : (ch, 2) complex128, orthonormal
    pole : (2,) complex128, rad/s, ascending
    shape : (ch, 2) complex128
    turn : float
        Standard deviation of each shape towards the other, 1/sqrt(2) where any turn in the plane is
        as good.
    """

    members: Int
    basis: Complex
    pole: Complex
    shape: Complex
    turn: float


def with_pairs(
    table: CandidateModes,
    band: BandPoles,
    seen: BandEvidence,
    least: float,
) -> tuple[CandidateModes, list[tuple[int, int]]]:
    """The candidates with two more rows for each pair that they lack, and the rows of pairs that
    are not separated.

    No order counts any more for rows that the two replace.

    Parameters
    ----------
    table : CandidateModes
    band : BandPoles
    seen : BandEvidence
        Of the same band.
    least : float
        Confidence of what is reported.
    """
    free: list[tuple[int, int]] = []
    if len(table.shape) < 3:  # any shape lies in a plane of two channels
        return table, free
    worth = table.stable | stable_poles(band)
    for f, z in _places(table):
        pair = _pair(band, worth, f, z)
        if pair is None:
            continue
        near = np.abs(table.frequencies / f - 1) < z
        in_plane = (np.abs(pair.basis.conj().T @ table.shape) ** 2).sum(0)
        inside = in_plane / (np.abs(table.shape) ** 2).sum(0)
        own = np.flatnonzero(near & (inside > CONFIDENCE.same))
        if (
            pair.turn < ANY_TURN
            and (confidence(table, seen.duration)[own] > least).sum() > 1
        ):
            continue
        two = seen.weighed(_rows(band, pair))
        if confidence(two, seen.duration).min() < least:
            continue
        orders = table.orders.copy()
        orders[own, 0] = 0
        rows = (table.pole.size, table.pole.size + 1)
        table = stacked(replace(table, orders=orders), two)
        free += [rows] if pair.turn == ANY_TURN else []
    return table, free


def loosened(table: CandidateModes, pairs: list[tuple[int, int]]) -> CandidateModes:
    """The candidates with every turn in the plane of the pairs among the deviations of their
    shapes.
    """
    if not pairs:
        return table
    d = np.pad(table.shape_deviation, ((0, 0), (0, 0), (0, 1)))
    for rows in pairs:
        both = table.shape[:, rows]
        inverse = np.linalg.pinv(both)
        size = np.linalg.norm(both, axis=0)
        for k, row in enumerate(rows):
            other = both[:, 1 - k]
            d[row] -= np.outer(other, inverse[1 - k] @ d[row])
            d[row, :, -1] = ANY_TURN * other * size[k] / size[1 - k]
    return replace(table, shape_deviation=d)


def _places(table: CandidateModes) -> list[tuple[float, float]]:
    """Frequency, Hz, and damping of the places to look at: the strongest candidates, one in a
    bandwidth.
    """
    out: list[tuple[float, float]] = []
    for k in np.argsort(-table.strength, kind="stable"):
        f = float(table.frequencies[k])
        z = float(table.damping[k])
        if all(abs(f - g) > 2 * max(z * f, y * g) for g, y in out):
            out.append((f, z))
    return out


def _pair(band: BandPoles, stable: Bool, f: float, z: float) -> Pair | None:
    """The pair at a place, if most orders show two poles in one plane."""
    p = band.poles
    near = np.flatnonzero((np.abs(p.frequencies / f - 1) < z) & stable)
    two = []
    for n in np.unique(p.order[near]):
        here = near[p.order[near] == n]
        best = here[np.argsort(p.std_frequency[here], kind="stable")[:2]]
        if best.size == 2:
            two.append(best)
    if 2 * len(two) < p.orders.size:
        return None
    at = np.array(two)
    shapes = p.shape[:, at]
    unit_shapes = np.moveaxis(shapes, 1, 0) / np.linalg.norm(shapes, axis=0)[:, None]
    planes = np.linalg.svd(unit_shapes, full_matrices=False)[0]
    basis = np.linalg.eigh(np.einsum("nik,njk->ij", planes, planes.conj()))[1][:, -2:]
    like = (
        np.linalg.svd(basis.conj().T @ planes, compute_uv=False)[:, 1] ** 2
        > CONFIDENCE.same
    )
    if 2 * like.sum() < p.orders.size:
        return None
    return _solved(band, at[like], basis)


def _solved(band: BandPoles, at: Int, basis: Complex) -> Pair:
    """Poles and shapes of the pair from its members at all orders."""
    p = band.poles
    c = np.moveaxis(np.tensordot(basis.conj().T, p.shape[:, at], 1), 1, 0)
    a = (c * p.pole[at][:, None]) @ np.linalg.inv(c)
    w = 1 / (np.abs(_mean_deviation(band, at)) ** 2).sum(1)
    mean = np.tensordot(w / w.sum(), a, 1)
    pole, vectors = np.linalg.eig(mean)
    std = np.sqrt(2 * (np.abs(w @ _mean_deviation(band, at) / w.sum()) ** 2).sum())
    turn = np.sqrt(2) * std / abs(pole[0] - pole[1])
    separated = turn < ANY_TURN
    real, size, _ = np.linalg.svd(
        np.concatenate([basis.real, basis.imag], axis=1), full_matrices=False
    )
    if not separated and size[2] < 0.5 * size[1]:
        inner = real[:, :2].T @ basis
        turned = (inner @ mean @ np.linalg.inv(inner)).imag
        shape = (real[:, :2] @ np.linalg.eigh(turned + turned.T)[1]).astype(
            np.complex128
        )
    else:
        shape = basis @ (vectors if separated else np.eye(2))
    rank = np.argsort(np.abs(pole))
    return Pair(
        members=at,
        basis=basis,
        pole=pole[rank],
        shape=shape[:, rank] if separated else shape,
        turn=turn if separated else ANY_TURN,
    )


def _mean_deviation(band: BandPoles, at: Int) -> Complex:
    """(order, block) deviations of the mean of the two poles of each order."""
    return np.asarray(band.deviation[at].mean(axis=1))


def _rows(band: BandPoles, pair: Pair) -> CandidateModes:
    """The two rows of a pair; the poles are known as two independent ones, of which their mean is
    known.
    """
    at = pair.members
    p = band.poles
    d = _mean_deviation(band, at)
    w = 1 / (np.abs(d) ** 2).sum(1)
    d = w @ d / w.sum()
    one = p.shape[:, at[:, 0]]
    two = p.shape[:, at[:, 1]]
    overlap = np.abs((one.conj() * two).sum(0))
    overlap /= np.linalg.norm(one, axis=0) * np.linalg.norm(two, axis=0)
    # the order that shows the plane best
    table = groups_table(band, [at[[overlap.argmin()], k] for k in (0, 1)])
    c = np.linalg.lstsq(table.shape, pair.shape)[0]
    outside = np.einsum("mk,mcb->kcb", c, table.shape_deviation)
    outside -= np.einsum("cd,kdb->kcb", pair.basis @ pair.basis.conj().T, outside)
    size = np.linalg.norm(pair.shape, axis=0)
    other = pair.shape[:, ::-1] * (size / size[::-1])
    outside += pair.turn * other.T[:, :, None] * (np.abs(d) / np.linalg.norm(d))
    top = np.take_along_axis(pair.shape, np.abs(pair.shape).argmax(0)[None], 0)[0]
    label = np.full(len(p), -1, dtype=np.int64)
    label[at] = np.arange(2)
    return replace(
        table,
        pole=pair.pole,
        deviation=np.stack([np.concatenate([d, s * d]) for s in (1.0, -1.0)]),
        shape=unit(pair.shape),
        shape_deviation=outside / top[:, None, None],
        orders=np.array([[len(at), p.orders.size]] * 2),
        mpc=mpc(pair.shape),
        label=label,
    )
