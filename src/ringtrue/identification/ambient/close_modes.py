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

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.identification.ambient.candidates import (
    CandidateModes,
    groups_table,
    stable_poles,
    stacked,
)
from ringtrue.identification.ambient.confidence import confidence
from ringtrue.identification.ambient.maximum_likelihood import (
    CHANCE,
    WAVES,
    SpectralBins,
    refine_by_likelihood,
)
from ringtrue.identification.ambient.ssi_cov import BandPoles
from ringtrue.identification.common.poles import PoleSet, unit
from ringtrue.shapes.complexity import mpc
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
LEAST_CHANNELS = 4  # in a plane of three channels any shape nearly lies
MOST_ORDERS = 0.3  # share that must show two poles in one plane
WITHIN = 0.8  # of a squared shape that must lie in the plane
UNLIKE = 0.05  # least eigenvalue of the Gram matrix of two unit shapes that span a plane
WEAK = 0.2  # strength of the weaker pole over that of the stronger
ANY = float(np.sqrt(0.5))
SEPARATE = 2.0  # standard deviations between poles that are separated
DAMPING = 3.0  # ratio to that of the place within which a pole may be one of a pair


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
    m = frequency.size
    half = frequency * damping
    begin = np.eye(m, dtype=np.complex128) if start is None else start
    matrix = begin.copy()
    variance = np.zeros((m, m))
    distance = np.abs(frequency[:, None] - frequency) / (half[:, None] + half)
    rank = np.argsort(np.argsort(frequency, kind="stable"), kind="stable")
    near = np.where(np.abs(rank[:, None] - rank) == 1, distance < FAR, distance < CLOSE)
    pairs = [(i, j) for i in range(m) for j in range(i) if near[i, j] and len(shape) > 2]
    for i, j in pairs:
        both = (np.array([i, j]), np.array([j, i]))
        if (
            found := _pair_mixing(
                bins,
                frequency,
                z=damping,
                psi=shape @ begin,
                pair=(i, j),
                slope=slope,
                known=begin[both],
            )
        ) is not None:
            matrix[both], variance[both] = found
    return Mixing(matrix, variance)


def _pair_mixing(
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
    w = _filters(b, parts, f=f, z=z, psi=psi, pair=two)
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
    return _solve_mixing(
        q[:, 1], count / expected.prod(1), h=h, power=power, rest=rest, known=known, cell=cell
    )


def _windows(freqs: Float, f: Float, z: Float) -> list[slice]:
    """The bins around both modes: one range, or two where these do not touch."""
    low = np.searchsorted(freqs, f - REACH * z * f)
    high = np.searchsorted(freqs, f + REACH * z * f)
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
    """Peak of each mode and the background around it (2,) from the spectra (bin, 2) of its
    coordinate.
    """
    form = np.abs(h) ** 2
    inside = form > 0.5
    power = (own * inside).sum(0) / np.maximum((form * inside).sum(0), 1e-300)
    away = np.where(form < 0.03, own - power * form, np.nan)
    seen = np.asarray(np.isfinite(away).any(0))
    rest = np.array([np.nanmedian(x) if s else 0.0 for x, s in zip(away.T, seen, strict=True)])
    return power, np.maximum(rest, 1e-3 * power)


def _solve_mixing(
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
    misfit = float((np.abs(error) ** 2).mean())
    size = np.bincount(cell)
    together = np.abs(np.bincount(cell, error.real) + 1j * np.bincount(cell, error.imag)) ** 2
    waves = float((together[size > 0] / size[size > 0]).mean())
    if misfit > MISFIT or waves > WAVES:
        return None
    found = value + step
    spread = np.diagonal(np.linalg.solve(n, np.eye(4))).real * max(misfit, waves / CHANCE, 1.0)
    return np.array([found[0], found[1].conj()]), spread[:2]


def refined(
    c: CandidateModes, at: Int, references: Int, bins: SpectralBins, slope: tuple[float, float]
) -> CandidateModes:
    """The candidates with poles and deviations of the rows `at` from their own spectra.

    Modes of one band are then independent: the deviations of each take two columns of their own.
    """
    doubt = c.stds()[1][at] / c.damping[at]
    shape = c.shape[np.ix_(references, at)]
    rough = unmix(
        bins, c.frequencies[at], damping=c.damping[at], shape=shape, slope=slope[0]
    ).matrix
    fit = refine_by_likelihood(
        bins,
        c.frequencies[at],
        damping=c.damping[at],
        shape=shape @ rough,
        slope=slope,
        doubt=doubt,
    )
    mix = unmix(bins, fit.frequency, damping=fit.damping, shape=shape, slope=slope[0], start=rough)
    c = _unmixed(c, at, mix)
    ok = np.flatnonzero(fit.ok)
    rows = at[ok]
    f = fit.frequency[ok]
    z = fit.damping[ok]
    root = np.sqrt(1 - z**2)
    pole = 2 * np.pi * f * (-z + 1j * root)
    by = np.stack([pole, 2 * np.pi * f * z * (-1 - 1j * z / root)], axis=1)
    own = (by[:, None] @ np.linalg.cholesky(fit.covariance[ok]))[:, 0]
    blocks = c.deviation.shape[1]
    m = rows.size
    deviation = np.concatenate([c.deviation, np.zeros((len(c.pole), 2 * m))], axis=1)
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
    halves: tuple[PoleSet, PoleSet],
    tries: int,
    least: float,
) -> tuple[CandidateModes, list[tuple[int, int]]]:
    """The candidates with two more rows for each pair that they lack, and the rows of pairs that
    are not separated.

    Rows that the two replace are agreed on by no half of the record any more.

    Parameters
    ----------
    table : CandidateModes
    band : BandPoles
    halves : poles of the first and the second half of the record
    tries : int
        Orders there are to try.
    least : float
        Confidence of what is reported.
    """
    free: list[tuple[int, int]] = []
    if table.shape.shape[0] < LEAST_CHANNELS:
        return table, free
    # a mixture of two real shapes is complex
    worth = table.stable | stable_poles(band, collinearity=0.0)
    for f, z in _places(table):
        pair = _pair(band, worth, f, z)
        if pair is None:
            continue
        near = np.abs(table.frequencies / f - 1) < z
        own = np.flatnonzero(near & (_inside(table.shape, pair.basis) > WITHIN))
        if pair.turn < ANY and (confidence(table, tries)[own] > least).sum() > 1:
            continue
        two = _rows(band, pair, min(_seen(h, pair.basis, f, z) for h in halves))
        if confidence(two, tries).min() < least:
            continue
        doubt = table.halves.copy()
        doubt[own] = 0.0
        rows = (table.pole.size, table.pole.size + 1)
        table = stacked(replace(table, halves=doubt), two)
        free += [rows] if pair.turn == ANY else []
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
            d[row, :, -1] = ANY * other * size[k] / size[1 - k]
    return replace(table, shape_deviation=d)


def _places(table: CandidateModes) -> list[tuple[float, float]]:
    """Frequency, Hz, and damping of the places to look at: the strongest candidates, a bandwidth
    apart.
    """
    out: list[tuple[float, float]] = []
    for k in np.argsort(-table.strength, kind="stable"):
        f = float(table.frequencies[k])
        z = float(table.damping[k])
        if all(abs(f - g) > 2 * max(z * f, y * g) for g, y in out):
            out.append((f, z))
    return out


def _inside(shape: Complex, basis: Complex) -> Float:
    """(k,) share of the squared shapes (ch, k) that lies in the plane."""
    return np.asarray((np.abs(basis.conj().T @ shape) ** 2).sum(0) / (np.abs(shape) ** 2).sum(0))


def _near(p: PoleSet, f: float, z: float, slack: float = 1.0) -> Int:
    most = DAMPING * slack
    like = (p.damping > z / most) & (p.damping < z * most)
    return np.flatnonzero((np.abs(p.frequencies / f - 1) < slack * z) & like)


def _pair(band: BandPoles, stable: Bool, f: float, z: float) -> Pair | None:
    """The pair at a place, if enough orders show two poles in one plane."""
    p = band.poles
    near = np.intersect1d(_near(p, f, z), np.flatnonzero(stable))
    two = []
    for n in np.unique(p.order[near]):
        here = near[p.order[near] == n]
        best = here[np.argsort(p.std_frequency[here], kind="stable")[:2]]
        if best.size == 2 and band.strength[best].min() > WEAK * band.strength[best].max():
            two.append(best)
    if len(two) < MOST_ORDERS * p.orders.size:
        return None
    at = np.array(two)
    planes, size, _ = np.linalg.svd(
        np.moveaxis(p.shape[:, at], 1, 0) / np.linalg.norm(p.shape[:, at], axis=0)[:, None],
        full_matrices=False,
    )
    at = at[size[:, 1] ** 2 > UNLIKE]
    planes = planes[size[:, 1] ** 2 > UNLIKE]
    if len(at) < MOST_ORDERS * p.orders.size:
        return None
    basis = np.linalg.eigh(np.einsum("nik,njk->ij", planes, planes.conj()))[1][:, -2:]
    like = np.linalg.svd(basis.conj().T @ planes, compute_uv=False)[:, 1] ** 2 > WITHIN
    if like.sum() < MOST_ORDERS * p.orders.size:
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
    separated = turn < 1 / SEPARATE
    real, size, _ = np.linalg.svd(
        np.concatenate([basis.real, basis.imag], axis=1), full_matrices=False
    )
    if not separated and size[2] < 0.5 * size[1]:
        inner = real[:, :2].T @ basis
        turned = (inner @ mean @ np.linalg.inv(inner)).imag
        shape = (real[:, :2] @ np.linalg.eigh(turned + turned.T)[1]).astype(np.complex128)
    else:
        shape = basis @ (vectors if separated else np.eye(2))
    rank = np.argsort(np.abs(pole))
    return Pair(
        members=at,
        basis=basis,
        pole=pole[rank],
        shape=shape[:, rank] if separated else shape,
        turn=turn if separated else ANY,
    )


def _mean_deviation(band: BandPoles, at: Int) -> Complex:
    """(order, block) deviations of the mean of the two poles of each order."""
    return np.asarray(band.deviation[at].mean(axis=1))


def _rows(band: BandPoles, pair: Pair, agreed: float) -> CandidateModes:
    """The two rows of a pair; the poles are known as two independent ones, of which their mean is
    known.
    """
    at = pair.members
    p = band.poles
    d = _mean_deviation(band, at)
    w = 1 / (np.abs(d) ** 2).sum(1)
    d = w @ d / w.sum()
    overlap = np.abs((p.shape[:, at[:, 0]].conj() * p.shape[:, at[:, 1]]).sum(0))
    overlap /= np.linalg.norm(p.shape[:, at[:, 0]], axis=0) * np.linalg.norm(
        p.shape[:, at[:, 1]], axis=0
    )
    # the order that shows the plane best
    table = groups_table(band, [at[[overlap.argmin()], k] for k in (0, 1)])
    c = np.linalg.lstsq(table.shape, pair.shape)[0]
    outside = np.einsum("mk,mcb->kcb", c, table.shape_deviation)
    outside -= np.einsum("cd,kdb->kcb", pair.basis @ pair.basis.conj().T, outside)
    size = np.linalg.norm(pair.shape, axis=0)
    other = pair.shape[:, ::-1] * (size / size[::-1])
    outside += pair.turn * other.T[:, :, None] * (np.abs(d) / np.linalg.norm(d))
    top = np.take_along_axis(pair.shape, np.abs(pair.shape).argmax(0)[None], 0)[0]
    return replace(
        table,
        pole=pair.pole,
        deviation=np.stack([np.concatenate([d, s * d]) for s in (1.0, -1.0)]),
        shape=unit(pair.shape),
        shape_deviation=outside / top[:, None, None],
        share=np.full(2, len(at) / max(int((p.orders >= p.order[at].min()).sum()), 1)),
        orders=np.array([[len(at), p.orders.size]] * 2),
        halves=np.full(2, agreed),
        mpc=mpc(pair.shape),
        label=_labels(len(p), at),
    )


def _labels(poles: int, at: Int) -> Int:
    label = np.full(poles, -1, dtype=np.int64)
    label[at] = np.arange(2)
    return label


def _seen(h: PoleSet, basis: Complex, f: float, z: float) -> float:
    """Share of the orders of half a record that show two poles of the plane."""
    near = _near(h, f, z, 1.5)
    near = near[_inside(h.shape[:, near], basis) > WITHIN]
    psi = h.shape / np.linalg.norm(h.shape, axis=0)
    seen = 0
    for n in np.unique(h.order[near]):
        c = basis.conj().T @ psi[:, near[h.order[near] == n]]
        seen += c.shape[1] > 1 and np.linalg.eigvalsh(c @ c.conj().T)[0] > UNLIKE
    return seen / max(h.orders.size, 1)
