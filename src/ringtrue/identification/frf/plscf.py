"""Poly-reference least-squares complex frequency-domain estimation (pLSCF), all model orders at
once, and the candidate poles of FRFs band by band.

Guillaume, Verboven, Vanlanduit, Van der Auweraer, Peeters (2003), "A poly-reference implementation
of the least-squares complex frequency-domain estimator", IMAC XXI; the constraint on the lowest
coefficient, which makes the mathematical poles unstable, after Cauberghe, Guillaume, Verboven,
Parloo (2005), J. Sound Vib. 283.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.linalg import LinAlgError, cholesky, solve_triangular, toeplitz
from scipy.spatial.distance import squareform

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.channels import POWER
from ringtrue.core.signals import FrfSet
from ringtrue.errors import InputError
from ringtrue.identification.common.stabilisation import (
    PoleSet,
    StableDiagram,
    check_orders,
    unit,
)
from ringtrue.identification.frf.confidence import CandidatePoles
from ringtrue.identification.frf.lines import Noise, count_peaks
from ringtrue.shapes import mac

Entry = TypeVar("Entry", np.float64, np.complex128)


def lower_factor(normal: NDArray[Entry], ridge: float) -> NDArray[Entry]:
    """Lower Cholesky factor of normal + ridge·I, with the least ridge that does.

    Exact data make a normal matrix singular, and one that is a difference of two has the rounding
    of both, which hangs on the machine. The ridge grows by tens until the matrix is definite.

    Parameters
    ----------
    normal : (n, n) float64 or complex128, symmetric or Hermitian, finite
    ridge : float
        The least, in the unit of `normal`.

    Returns
    -------
    (n, n), of the type of `normal`
    """
    eye = np.eye(len(normal))
    ridge = max(ridge, np.finfo(float).tiny)
    while True:
        try:
            return cholesky(normal + ridge * eye, lower=True)
        except LinAlgError:
            ridge *= 10.0


@dataclass(frozen=True, slots=True)
class Plscf:
    """Settings of the estimator in one band.

    Attributes
    ----------
    ordmin, ordmax : int
        Orders of the denominator polynomial; each order holds (order · inputs)/2 modes.
    damping_max : float
        Poles above are dropped.
    """

    ordmin: int = 4
    ordmax: int = 40
    damping_max: float = 0.15

    def __post_init__(self) -> None:
        check_orders(self.ordmin, self.ordmax)


def plscf(data: Complex, freqs: Float, settings: Plscf) -> PoleSet:
    """Poles and participation vectors of every order.

    Parameters
    ----------
    data : (freq, out, in) complex128
    freqs : (freq,) float64, Hz, ascending; the band
    settings : Plscf

    Returns
    -------
    PoleSet
        `shape` (in, k) holds the participation vectors, largest component 1.

    Raises
    ------
    InputError
        If the band has fewer lines than coefficients.
    """
    n_in = data.shape[2]
    if freqs.size < settings.ordmax + 2:
        raise InputError(
            f"{freqs.size} lines in the band for order {settings.ordmax}: widen it or lower ordmax"
        )
    scale = np.sqrt(np.mean(np.abs(data) ** 2, axis=(0, 1))) + np.finfo(float).tiny
    factor = _factor(
        data / scale, (freqs - freqs[0]) / (freqs[-1] - freqs[0]), settings.ordmax
    )
    found = [
        _order(factor, n, n_in, freqs)
        for n in range(settings.ordmin, settings.ordmax + 1)
    ]
    order = np.repeat(
        np.arange(settings.ordmin, settings.ordmax + 1), [p.size for p, _ in found]
    )
    poles = np.concatenate([p for p, _ in found])
    part = unit(np.concatenate([v for _, v in found], axis=1) * scale[:, None])
    unknown = np.full(poles.size, np.nan)
    f = np.abs(poles) / (2 * np.pi)
    zeta = -poles.real / np.abs(poles)
    inside = (f >= freqs[0]) & (f <= freqs[-1]) & (poles.imag > 0)
    plausible = inside & (zeta > 1e-05) & (zeta < settings.damping_max)
    return PoleSet(
        order=order, pole=poles, shape=part, std_frequency=unknown, std_damping=unknown
    ).take(plausible)


def _factor(h: Complex, place: Float, n: int) -> Float:
    """Lower Cholesky factor of the reduced normal matrix, highest power of z first, ((n+1) in,
    (n+1) in).

    `place` (freq,) is that of the lines in the band, 0 to 1.

    With z on the upper half circle the blocks Re Σ z^(l-k) (...) hang on l - k alone: trigonometric
    sums give all.
    """
    n_out, m = h.shape[1:]
    k = np.arange(-n, n + 1)
    wave = np.exp(1j * np.pi * np.outer(k, place))
    r = toeplitz(wave.real.sum(axis=1)[n:])
    s = (wave @ h.reshape(place.size, -1)).real.reshape(2 * n + 1, n_out, m)
    t = (wave @ (h.conj().transpose(0, 2, 1) @ h).reshape(place.size, -1)).real.reshape(
        2 * n + 1, m, m
    )
    lag = np.arange(n + 1)[None, :] - np.arange(n + 1)[:, None] + n
    size = (n + 1) * m
    big_t = t[lag].transpose(0, 2, 1, 3).reshape(size, size)
    low = lower_factor(r, np.finfo(float).eps * r[0, 0])
    v = solve_triangular(low, s[lag].reshape(n + 1, -1), lower=True, check_finite=False)
    v = v.reshape(n + 1, n + 1, n_out, m).transpose(0, 2, 1, 3).reshape(-1, size)
    normal = big_t - v.T @ v
    flip = np.arange(size).reshape(n + 1, m)[::-1].ravel()
    normal = normal[np.ix_(flip, flip)]
    # exact data make the matrix singular, or less than the rounding of what it is the difference of
    ridge = max(1e-13 * np.trace(normal), 1e-15 * np.trace(big_t)) / size
    return lower_factor(normal, ridge)


def _order(factor: Float, n: int, m: int, freqs: Float) -> tuple[Complex, Complex]:
    """Poles (k,) and left null vectors (m, k) of the order n: the lowest coefficient is the
    identity.
    """
    a = -solve_triangular(
        factor[: n * m, : n * m],
        factor[n * m : (n + 1) * m, : n * m].T,
        lower=True,
        trans="T",
        check_finite=False,
    )
    companion = np.eye(n * m, k=-m)
    # A transposed: left null vectors
    companion[:m] = -a.reshape(n, m, m)[::-1].transpose(2, 0, 1).reshape(m, n * m)
    mu, vectors = np.linalg.eig(companion)
    keep = (mu.imag < 0) & (np.abs(mu) > 1e-6)  # z = 1/mu in the upper half plane
    step = 2 * (freqs[-1] - freqs[0])
    poles = -np.log(mu[keep]) * step + 2j * np.pi * freqs[0]
    return poles, vectors[-m:, keep]


def order_range(n_in: int, peaks: int, lines: int) -> tuple[int, int]:
    """Lowest and highest order for a band with about `peaks` modes."""
    top = int(np.clip(np.ceil((4 * peaks + 24) / n_in), 10, 60))
    # the eigenvalue problems grow with the cube of order times inputs
    most = 130 // n_in
    top = max(min(top + 8, most, lines // 3), 3)
    return max(2, min(top // 3, int(np.ceil(2 * peaks / n_in)))), top


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Groups of poles that agree over the orders.

    Attributes
    ----------
    label : (k,) int64, cluster of each pole of the set, -1 for none
    pole : (c,) complex128, rad/s
    participation : (in, c) complex128
    support : (c,) float64, 0..1
        Share of the orders from its first appearance on that hold the pole.
    scatter : (c,) float64
        Median distance to `pole` in units of the half bandwidth.
    """

    label: Int
    pole: Complex
    participation: Complex
    support: Float
    scatter: Float


def pole_shapes(poles: PoleSet, data: Complex, freqs: Float, power: int) -> Complex:
    """Response shapes (out, k) of the poles of each order, by least squares with a lower and an
    upper residual.

    With one input overlapping modes are separated by their responses alone.

    Parameters
    ----------
    poles : PoleSet
        `shape` (in, k) holds the participation vectors.
    data : (freq, out, in) complex128
    freqs : (freq,) float64, Hz
    power : int
        0 for receptance, 1 for mobility, 2 for accelerance.
    """
    s = 2j * np.pi * freqs
    kind = (s / s[-1]) ** power
    terms = np.linalg.qr(
        kind[:, None] * np.stack([(s[0] / s) ** 2, np.ones(s.size)], axis=1)
    )[0]
    q = kind[:, None] / (s[:, None] - poles.pole)
    q -= terms @ (terms.conj().T @ q)
    part = poles.shape
    # terms are no part of q
    rhs = (q.conj().T @ data.reshape(s.size, -1)).reshape(len(poles), *data.shape[1:])
    rhs = (rhs * part.conj().T[:, None]).sum(axis=2)
    out = np.zeros((data.shape[1], len(poles)), dtype=np.complex128)
    for n in poles.orders:
        at = np.flatnonzero(poles.order == n)
        gram = (q[:, at].conj().T @ q[:, at]) * (part[:, at].conj().T @ part[:, at])
        out[:, at] = np.linalg.lstsq(gram, rhs[at], rcond=1e-12)[0].T
    return out


def half_bandwidths(pole: Complex, resolution: Float) -> Float:
    """(k, k) distances of poles (k,) in half bandwidths, which the distance of the lines (k,), Hz,
    widens.
    """
    steps = np.sqrt(np.outer(resolution, resolution))
    width = 0.5 * np.sqrt(np.outer(pole.real, pole.real)) + 0.6 * np.pi * steps
    return np.abs(pole[:, None] - pole) / width


def cluster_poles(
    poles: PoleSet, resolution: Float, *, responses: Complex | None = None
) -> Clusters:
    """Average-linkage clusters of poles that stay in place over three tenths of the orders.

    The distance counts the poles in half bandwidths and the participation vectors in 1 − MAC.

    Parameters
    ----------
    poles : PoleSet
    resolution : (k,) float64, Hz, the spacing of the lines at each pole
    responses : (out, k) complex128, optional
        Response shapes, for poles that have one input only; counted in 1 − MAC as well.
    """
    if len(poles) < 2:
        return _clusters(poles, np.full(len(poles), -1, dtype=np.int64), [])
    v = poles.shape / np.linalg.norm(poles.shape, axis=0)
    far = half_bandwidths(poles.pole, resolution)
    if v.shape[0] > 1:
        far += (1 - np.minimum(np.abs(v.conj().T @ v) ** 2, 1.0)) / 0.4
    if responses is not None:
        far += (1 - np.minimum(mac(responses, responses), 1.0)) / 0.4
    np.fill_diagonal(far, 0)
    tree = linkage(squareform((far + far.T) / 2, checks=False), "average")
    raw = fcluster(tree, 1.0, "distance")
    least = max(3, 0.3 * poles.orders.size)
    groups = [np.flatnonzero(raw == c) for c in np.unique(raw)]
    held = [g for g in groups if np.unique(poles.order[g]).size >= least]
    held.sort(key=lambda g: float(np.median(poles.frequencies[g])))
    label = np.full(len(poles), -1, dtype=np.int64)
    for c, g in enumerate(held):
        label[g] = c
    return _clusters(poles, label, held)


def _clusters(poles: PoleSet, label: Int, held: Sequence[Int]) -> Clusters:
    rows = [_summary(poles, g) for g in held]
    part = np.array([r[1] for r in rows], dtype=np.complex128)
    return Clusters(
        label=label,
        pole=np.array([r[0] for r in rows], dtype=np.complex128),
        participation=part.reshape(len(rows), len(poles.shape)).T,
        support=np.array([r[2] for r in rows]),
        scatter=np.array([r[3] for r in rows]),
    )


def _summary(poles: PoleSet, g: Int) -> tuple[complex, Complex, float, float]:
    """Medians over the upper half of the orders that hold the pole."""
    late = g[poles.order[g] >= np.median(poles.order[g])]
    pole = complex(np.median(poles.pole[late].real), np.median(poles.pole[late].imag))
    parts = poles.shape[:, late]
    u = np.linalg.svd(parts / np.linalg.norm(parts, axis=0), full_matrices=False)[0][
        :, 0
    ]
    here = np.unique(poles.order[g])
    support = here.size / np.count_nonzero(poles.orders >= here[0])
    scatter = float(np.median(np.abs(poles.pole[late] - pole)) / max(-pole.real, 1e-12))
    return pole, u, support, scatter


@dataclass(frozen=True, slots=True)
class BandLimits:
    """Bands of the pole search, and what the estimator sees of them.

    Attributes
    ----------
    ratio : float
        Upper to lower edge, at most.
    lines : int
        At least.
    peaks : int
        Of the CMIF, at most, unless more than `bands` bands would be needed.
    bands : int
    responses, inputs : int
        Combinations of responses and of inputs that are kept, at most. All inputs share the orders
        of the polynomials.
    """

    ratio: float = 1.8
    lines: int = 64
    peaks: int = 5
    bands: int = 40
    responses: int = 40
    inputs: int = 12


LIMITS = BandLimits()


def choose_bands(freqs: Float, curve: Float) -> tuple[tuple[float, float], ...]:
    """Overlapping bands of all lines, Hz: none spans more than a ratio, holds too few lines or too
    many peaks of the CMIF.
    """
    low = float(freqs[0])
    number = np.arange(freqs.size, dtype=np.float64)

    def lines_below(edge: float, lines: float) -> float:
        return float(np.interp(np.interp(edge, freqs, number) - lines, number, freqs))

    all_peaks = np.sort(freqs[count_peaks(curve)])
    most = max(LIMITS.peaks, all_peaks.size // LIMITS.bands)
    edges = [float(freqs[-1])]
    while edges[-1] > low * 1.05:
        lower = min(edges[-1] / LIMITS.ratio, lines_below(edges[-1], LIMITS.lines))
        inside = all_peaks[(all_peaks < edges[-1]) & (all_peaks > lower)]
        if inside.size > most:
            cut = 0.5 * (inside[-most] + inside[-most - 1])
            lower = max(lower, min(float(cut), lines_below(edges[-1], LIMITS.lines)))
        edges.append(lower if lines_below(lower, LIMITS.lines / 2) > low else low)
    bands = []
    for a, b in pairwise(edges[::-1]):
        more = 0.15 * (b - a)  # so that neighbours overlap
        bands.append((max(a - more, low), min(b + more, edges[0])))
    return tuple(bands)


def line_steps(freqs: Float, at: Complex) -> Float:
    """(k,) distance of the lines, Hz, around poles `at` (k,), rad/s."""
    step = np.diff(freqs)
    below = np.searchsorted(freqs, at.imag / (2 * np.pi)) - 1
    return step[np.clip(below, 0, step.size - 1)]


def band_candidates(
    frfs: FrfSet,
    sigma: Noise,
    curve: Float,
    band: tuple[float, float],
    damping_max: float,
) -> tuple[Clusters, StableDiagram]:
    """Poles of a band (Hz) that stay in place over the orders, damped up to a ratio, and the
    diagram of all poles.
    """
    at = (frfs.freqs >= band[0]) & (frfs.freqs <= band[1])
    most = damping_max + frfs.window_decay / (2 * np.pi * band[0])
    white = frfs.data[at] / (
        np.median(sigma.line[at]) * sigma.response[:, None] * sigma.input
    )
    strong, driven = few_inputs(white)
    strong = principal(strong)
    lowest, highest = order_range(
        strong.shape[2], count_peaks(curve[at]).size, int(at.sum())
    )
    poles = plscf(strong, frfs.freqs[at], Plscf(lowest, highest, most))
    poles = replace(poles, shape=driven @ poles.shape)
    poles, clusters = grouped(poles, strong, sigma=sigma, frfs=frfs, at=at)
    db = 20 * np.log10(np.maximum(curve[at, :3].T, np.finfo(float).tiny))
    return clusters, StableDiagram(
        poles=poles,
        stable=clusters.label >= 0,
        cluster=clusters.label,
        freqs=frfs.freqs[at],
        level=db,
    )


def grouped(
    poles: PoleSet, white: Complex, sigma: Noise, frfs: FrfSet, at: Bool
) -> tuple[PoleSet, Clusters]:
    """Poles of whitened lines `at` in the units of the inputs, and those that stay in place over
    the orders.

    With one input the responses separate the modes.
    """
    alone = white.shape[2] == 1 and white.shape[1] > 1 and len(poles) > 0
    responses = (
        pole_shapes(poles, white, frfs.freqs[at], POWER[frfs.kind]) if alone else None
    )
    poles = replace(poles, shape=poles.shape * sigma.input[:, None])
    return poles, cluster_poles(
        poles, line_steps(frfs.freqs, poles.pole), responses=responses
    )


def few_inputs(data: Complex) -> tuple[Complex, Float]:
    """(freq, out, r) the strongest combinations of many inputs, and the real orthonormal
    combinations (in, r).

    The participation vectors of a band lie in their span, but for noise; few inputs are left as
    they are.
    """
    n_in = data.shape[2]
    if n_in <= LIMITS.inputs:
        return data, np.eye(n_in)
    few = _directions(_stacked(data.transpose(0, 2, 1)), LIMITS.inputs)
    return np.ascontiguousarray(data @ few), few


def principal(data: Complex) -> Complex:
    """(freq, r, in) responses combined along the directions that stand out of the noise; `data` has
    noise of 1.

    The combination is real, for the response space of real modes, and leaves r/out of the noise.
    """
    rows = _stacked(data)
    few = (_directions(rows, LIMITS.responses).T @ rows).view(np.complex128)
    return np.ascontiguousarray(few.reshape(len(few), len(data), -1).transpose(1, 0, 2))


def _stacked(data: Complex) -> Float:
    """(n, 2k) real and imaginary parts of `data` (freq, n, m), side by side."""
    return (
        np.ascontiguousarray(data.transpose(1, 0, 2))
        .view(np.float64)
        .reshape(data.shape[1], -1)
    )


def _directions(rows: Float, most: int) -> Float:
    """(n, r) orthonormal combinations of `rows` (n, k) that stand out of noise of 1: four at least,
    `most` at most.
    """
    n, k = rows.shape
    values, vectors = np.linalg.eigh(rows @ rows.T)
    # Marchenko, Pastur (1967): the largest eigenvalue of noise alone
    edge = k * (1 + np.sqrt(n / k)) ** 2
    r = int(np.clip((values > 1.5 * edge).sum(), min(n, 4), most))
    return vectors[:, -r:]


def merged(found: Sequence[Clusters], freqs: Float, decay: float) -> CandidatePoles:
    """Candidates of all bands, the window out of the poles; of those seen twice, the one with less
    scatter.
    """
    found = [c for c in found if c.pole.size]
    if not found:
        return CandidatePoles(
            np.zeros(0, complex), np.zeros((0, 1), complex), np.zeros(0), np.zeros(0)
        )
    pole = np.concatenate([c.pole for c in found])
    part = np.concatenate([c.participation.T for c in found])
    support = np.concatenate([c.support for c in found])
    scatter = np.concatenate([c.scatter for c in found])
    band = np.repeat(np.arange(len(found)), [c.pole.size for c in found])
    keep = np.ones(pole.size, dtype=bool)
    rank = scatter + (1 - support)
    far = half_bandwidths(pole, line_steps(freqs, pole))
    if part.shape[1] > 1:
        far += (1 - mac(part.T, part.T)) / 0.3
    for i, j in np.argwhere(np.triu(far < 1.5, 1)):  # a few pairs in the overlaps
        if band[i] != band[j] and keep[i] and keep[j]:
            keep[j if rank[i] <= rank[j] else i] = False
    order = np.flatnonzero(keep)[np.argsort(np.abs(pole[keep]), kind="stable")]
    true = np.minimum(pole.real + decay, -1e-4 * np.abs(pole)) + 1j * pole.imag
    return CandidatePoles(true, part, support, scatter).take(order)
