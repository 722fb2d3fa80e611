"""Stochastic subspace identification: one decomposition, every model order.

Peeters and De Roeck 1999 (reference-based SSI-cov); the orders from the leading blocks of one QR
factorisation of the observability matrix follow Döhler and Mevel 2012 (fast multi-order
computation).

The projection of future outputs on past references, Y_f Y_pᵀ (Y_p Y_pᵀ)⁻¹ Y_p, of SSI-data has the
left vectors of H L⁻ᵀ, with the block-Hankel matrix H of the correlations and L Lᵀ the covariance of
the past (Van Overschee and De Moor 1996): SSI-cov with weights on its columns, without a matrix of
the length of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import qr, solve_triangular, svd
from scipy.sparse.linalg import LinearOperator, eigsh

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import DAMPING_MAX, PoleSet, unit
from ringtrue.identification.frf.plscf import lower_factor
from ringtrue.signal.spectra import (
    Band,
    block_bounds,
    block_correlations,
    detrend,
)

MAX_REFERENCES = 8


@dataclass(frozen=True, slots=True)
class SsiCov:
    """Settings of one band.

    Attributes
    ----------
    block_rows : int
        Block rows (and columns) of the Hankel matrix; lags up to 2·block_rows − 1 are used.
    order_max : int
        Largest model order (states; two for each mode), even.
    odd_orders : bool
        Take these, too.
    blocks : int
        Blocks of the record for the variance; 0 chooses, 1 leaves the standard deviations out.
    """

    block_rows: int
    order_max: int
    odd_orders: bool = False
    blocks: int = 0

    def __post_init__(self) -> None:
        if self.block_rows < 2 or self.order_max < 2 or self.blocks == 2:
            raise ConfigError(
                f"SSI: block_rows {self.block_rows} >= 2, order_max {self.order_max} >= 2, "
                f"blocks {self.blocks} not 2"
            )

    def projected(self, channels: int) -> SsiCov:
        """For SSI-data: a third of the block rows, as the projection whitens the past and makes as
        loud as the modes what is noise there; more where few channels would not hold the largest
        order.
        """
        needed = self.order_max // channels + 2
        rows = min(max(self.block_rows // 3, needed), self.block_rows)
        return replace(self, block_rows=rows)


@dataclass(frozen=True, slots=True, eq=False)
class Subspace:
    """The decomposition all orders come from: H ≈ U S Vᵀ, O = U, the QR of O without its last block
    row.

    `turn` (ch,) complex128 are the phases that make one motion of channels of different kinds,
    where there are some.
    """

    u: Float
    s: Float
    vs: Float
    q: Float
    r: Float
    qd: Float
    channels: int
    rate: float
    turn: Complex | None = None

    def turned(self, psi: Complex) -> Complex:
        """Shapes (ch, ...) as those of one motion."""
        return psi if self.turn is None else (psi.T * self.turn).T


@dataclass(frozen=True, slots=True, eq=False)
class BandPoles:
    """Poles of all orders of one band, with the deviation by each block of the record.

    Attributes
    ----------
    poles : PoleSet
    deviation : (k, block) complex128, rad/s
    strength : (k,) float64
        Signal-to-noise ratio of the mode in the correlations.
    subspace : Subspace
    perturbations : Perturbations
    """

    poles: PoleSet
    deviation: Complex
    strength: Float
    subspace: Subspace
    perturbations: var.Perturbations


def decompose(
    h: Float, order: int, gram: Float | LinearOperator | None = None
) -> tuple[Float, Float, Float]:
    """Leading singular triplets U (i, order), s, V (j, order) of `h`, fewer where the rank ends.

    They come from hᵀh (`gram`, if there is a faster way to it); a Rayleigh-Ritz step follows where
    the square of a singular value comes near the rounding of the largest.
    """
    u, s, v = _triplets(h, order, gram)
    n = int((s > 1e-12 * s[0]).sum())
    return u[:, :n], s[:n], v[:, :n]


def _triplets(
    h: Float, order: int, gram: Float | LinearOperator | None
) -> tuple[Float, Float, Float]:
    j = h.shape[1]
    if j <= 2 * order or (j <= 4 * order and len(h) <= 4 * j):
        u, s, vt = svd(h, full_matrices=False)
        return u[:, :order], s[:order], vt[:order].T
    # of the Krylov space: the default takes more products
    wide = min(max(3 * order // 2, order + 20), j)
    size, v = eigsh(
        h.T @ h if gram is None else gram, order, v0=np.ones(j), tol=1e-8, ncv=wide
    )
    rank = np.argsort(-size, kind="stable")
    size = size[rank]
    v = v[:, rank]
    if size[-1] > 1e-10 * size[0]:
        s = np.sqrt(size)
        return (h @ v) / s, s, v
    basis, _ = qr(h @ v, mode="economic")
    u, s, vt = svd(basis.T @ h, full_matrices=False)
    return basis @ u[:, :order], s[:order], vt[:order].T


def squared_hankel(h: Float, ch: int, ref: int) -> Float:
    """HᵀH of a block-Hankel matrix with blocks (ch, ref): each block from the one before it on its
    diagonal.
    """
    rows = h.shape[1] // ref
    first = h[:ch, :-ref]
    last = h[-ch:, ref:]
    gain = (last.T @ last - first.T @ first).reshape(rows - 1, ref, rows - 1, ref)
    out = np.empty((rows, ref, rows, ref))
    out[0] = (h[:, :ref].T @ h).reshape(ref, rows, ref)
    for j in range(1, rows):
        out[j, :, 0] = out[0, :, j].T
        out[j, :, 1:] = out[j - 1, :, :-1] + gain[j - 1]
    return out.reshape(rows * ref, rows * ref)


def hankel_gram(r: Float, rows: int) -> LinearOperator:
    """HᵀH of the block-Hankel matrix H of `r` (lag, ch, ref): two convolutions, no matrix of
    rows·ref squared.
    """
    size = int(next_fast_len(2 * rows - 1, real=True))
    spectrum = rfft(r[1 : 2 * rows], size, axis=0)
    back = np.ascontiguousarray(spectrum.transpose(0, 2, 1))

    # (row, k) -> (row, l): Σ_j R[i + j] x_j
    def convolved(x: Float, by: Complex) -> Float:
        y = by @ rfft(x[::-1], size, axis=0)[:, :, None]
        return irfft(y[:, :, 0], size, axis=0)[rows - 1 : 2 * rows - 1]

    def product(v: Float) -> Float:
        return convolved(convolved(v.reshape(rows, -1), spectrum), back).ravel()

    columns = rows * r.shape[2]
    return LinearOperator((columns, columns), matvec=product, dtype=np.float64)


def subspace(
    r: Float,
    settings: SsiCov,
    rate: float,
    *,
    turn: Complex | None = None,
    past: Int | None = None,
) -> Subspace:
    """The decomposition of the correlations `r` (lag, ch, ref).

    With the channels `past` (ref,) of the references it is that of the projection of the future on
    their past (SSI-data).
    """
    ch = r.shape[1]
    rows = settings.block_rows
    h = var.hankel(r, rows)
    order = min(settings.order_max, (rows - 1) * ch, min(h.shape))
    if past is not None:
        low = past_factor(r[:rows, past])
        u, s, v = decompose(solve_triangular(low, h.T, lower=True).T, order)
        vs = solve_triangular(low, v / s, lower=True, trans="T")
        return factored(u, s, vs, ch, rate, turn=turn)
    # of many columns, convolutions take less time than products
    gram = (
        hankel_gram(r, rows) if h.shape[1] > 1500 else squared_hankel(h, ch, r.shape[2])
    )
    u, s, v = decompose(h, order, gram)
    return factored(u, s, v / s, ch, rate, turn=turn)


def past_factor(r: Float) -> Float:
    """Lower Cholesky factor (rows·ref, rows·ref) of the covariance of past references with the
    correlations `r` (row, ref, ref): a block-Toeplitz matrix.

    Signals of a band have no power beyond it but rounding and what filters leave, a millionth.
    """
    rows, ref, _ = r.shape
    both = np.concatenate([r[:0:-1].transpose(0, 2, 1), r])
    lag = np.arange(rows) - np.arange(rows)[:, None] + rows - 1
    square = both[lag].transpose(0, 2, 1, 3).reshape(rows * ref, -1)
    return lower_factor(square, 1e-6 * np.trace(square) / len(square))


def factored(
    u: Float, s: Float, vs: Float, ch: int, rate: float, *, turn: Complex | None = None
) -> Subspace:
    """The subspace of the left vectors `u` (rows·ch, n), with `vs` = V S⁻¹."""
    q, tri = qr(u[:-ch], mode="economic")
    return Subspace(
        u=u,
        s=s,
        vs=vs,
        q=np.asarray(q, np.float64),
        r=np.asarray(tri, np.float64),
        qd=q.T @ u[ch:],
        channels=ch,
        rate=rate,
        turn=turn,
    )


def transition(sub: Subspace, n: int) -> tuple[Complex, Complex, Complex]:
    """Eigenvalues (n,) of the transition matrix of order n, right vectors (columns), left vectors
    (rows); left·right = I.
    """
    a = solve_triangular(sub.r[:n, :n], sub.qd[:n, :n])
    mu, right = np.linalg.eig(a)
    right = right.astype(np.complex128)
    left = np.linalg.solve(right, np.eye(n, dtype=np.complex128))
    return mu.astype(np.complex128), right, left


def _order(
    sub: Subspace,
    back: Float,
    p: var.Perturbations | None,
    n: int,
    settings: SsiCov,
    band: tuple[float, float],
) -> tuple[Complex, Complex, Complex, Float]:
    """Poles, shapes (ch, k), deviations (k, block) and strengths of one order within the band, Hz.

    `back` is R⁻¹: R is a triangle, so the leading blocks of its inverse are the inverses of its
    leading blocks.
    """
    mu, right = np.linalg.eig(back[:n, :n] @ sub.qd[:n, :n])
    log = np.asarray(
        np.log(np.where(mu == 0, 1e-300, mu + 0j)) * sub.rate, dtype=np.complex128
    )
    f = np.abs(log) / (2 * np.pi)
    zeta = -log.real / np.maximum(np.abs(log), 1e-300)
    inside = (f >= band[0]) & (f <= band[1])
    damped = (zeta > 0) & (zeta < DAMPING_MAX)
    keep = np.flatnonzero((mu.imag > 0) & damped & inside)
    pole = log[keep]
    own = right[:, keep].astype(np.complex128)
    psi = sub.turned(np.asarray(sub.u[: sub.channels, :n] @ own, dtype=np.complex128))
    if p is None or not keep.size:
        none = np.empty((keep.size, 0 if p is None else len(p.up)), np.complex128)
        return pole, psi, none, np.full(keep.size, np.nan)
    left = np.linalg.solve(right.T, np.eye(n)[:, keep]).T.astype(np.complex128)
    d_mu = var.pole_deviations(p, left @ back[:n, :n], mu[keep], own)
    return pole, psi, d_mu / mu[keep, None] * sub.rate, var.strengths(p, sub.s, left)


def all_orders(
    sub: Subspace,
    p: var.Perturbations | None,
    settings: SsiCov,
    band: tuple[float, float],
) -> tuple[PoleSet, Complex, Float]:
    """Poles of the orders within the band (Hz), their deviations and strengths."""
    step = 1 if settings.odd_orders else 2
    orders = np.arange(2, min(sub.s.size, settings.order_max) + 1, step)
    back = solve_triangular(sub.r, np.eye(len(sub.r)))
    parts = [
        _order(sub, back, p, n=int(n), settings=settings, band=band) for n in orders
    ]
    pole = np.concatenate([x[0] for x in parts])
    psi = np.concatenate([x[1] for x in parts], axis=1)
    dev = np.concatenate([x[2] for x in parts])
    strength = np.concatenate([x[3] for x in parts])
    order = np.repeat(orders, [x[0].size for x in parts])
    df, dz = var.frequency_damping(pole, dev)
    unknown = np.full(pole.size, np.nan)
    poles = PoleSet(
        order=order,
        pole=pole,
        shape=unit(psi),
        std_frequency=var.root_sum_square(df) if p is not None else unknown,
        std_damping=var.root_sum_square(dz) if p is not None else unknown,
    )
    return poles, dev, strength


def choose_references(
    history: TimeHistory, data: Float, names: Sequence[str] | None
) -> Int:
    """(ref,) int64 channels of these names; without, those that span the motion best, of its
    `prepared` data.

    Raises
    ------
    DataError
        If one is absent.
    """
    if names is not None:
        return positions(history, names)
    if len(data) <= MAX_REFERENCES:
        return np.arange(len(data), dtype=np.int64)
    return spanning(data[:, 1:] @ data[:, :-1].T, MAX_REFERENCES)


def spanning(lagged: Float, most: int) -> Int:
    """(k,) int64 channels that span the motion best: all, or `most` by pivoted QR of the
    correlations at lag 1.
    """
    if len(lagged) <= most:
        return np.arange(len(lagged), dtype=np.int64)
    _, pivots = qr(lagged, mode="r", pivoting=True)
    return np.sort(np.asarray(pivots[:most], dtype=np.int64))


def block_power(r: Float, references: Int) -> Float:
    """(block,) mean squares of the references from the correlations `r` (block, lag, ch, ref)."""
    return np.asarray(
        r[:, 0, references, np.arange(references.size)].mean(1), dtype=np.float64
    )


def identify_band(
    r: Float,
    weights: Float,
    settings: SsiCov,
    band: Band,
    *,
    turn: Complex | None = None,
    past: Int | None = None,
) -> BandPoles:
    """All orders with their uncertainty from block correlations `r` (block, lag, ch, ref) of
    signals at the rate of the `band`; by SSI-data with the channels `past` of the references.
    """
    mean, dr = var.deviations(r, weights)
    sub = subspace(mean, settings, band.rate, turn=turn, past=past)
    p = var.perturb(dr, settings.block_rows, sub.u, sub.vs, sub.q)
    poles, dev, strength = all_orders(sub, p, settings, (band.low, band.high))
    return BandPoles(
        poles=poles, deviation=dev, strength=strength, subspace=sub, perturbations=p
    )


def ssi_data(
    history: TimeHistory, settings: SsiCov, *, references: Sequence[str] | None = None
) -> PoleSet:
    """Poles of all orders of the record as it stands by SSI-data, with their standard deviations.

    Parameters
    ----------
    history : TimeHistory
    settings : SsiCov
    references : sequence of str
        Channel ids; None: all channels, or the 8 that span the motion best.

    Raises
    ------
    DataError
        If the record is too short, a channel is dead or there is no such reference.
    """
    lags = 2 * settings.block_rows - 1
    data, scale, refs = correlated(history, references, lags)
    samples = data.shape[1]
    blocks = settings.blocks or var.blocks_for(samples, lags)
    r, pairs = block_correlations(data, refs, lags, block_bounds(samples, blocks))
    weights = pairs[:, 0] / pairs[:, 0].sum()
    whole = Band(0.0, history.rate / 2, history.rate)
    found = identify_band(r, weights, settings, whole, past=refs)
    return found.poles.rescaled(scale)


def correlated(
    history: TimeHistory, references: Sequence[str] | None, lags: int
) -> tuple[Float, Float, Int]:
    """What correlations of so many lags are made of: `prepared` signals, their root mean squares,
    and the references, as `choose_references` takes them.

    Raises
    ------
    DataError
        If the record is too short, a channel is dead or there is no such reference.
    """
    data, scale = prepared(history)
    samples = data.shape[1]
    if samples < 4 * lags:
        raise DataError(
            f"{history.source}: {samples} samples are too few; needed are {4 * lags}"
        )
    return data, scale, choose_references(history, data, references)


def prepared(history: TimeHistory) -> tuple[Float, Float]:
    """Signals without mean and trend (ch, sample) in units of their root mean square, and those
    (ch,).

    Raises
    ------
    DataError
        If a channel is constant or not finite.
    """
    data = detrend(history.data)
    power = np.einsum("ij,ij->i", data, data) / data.shape[1]
    lost = np.flatnonzero(~(np.isfinite(power) & (power > 0)))
    if lost.size:
        bad = " ".join(history.channels[k].id for k in lost[:8].tolist())
        raise DataError(
            f"{history.source}: channels {bad} are constant or not finite; leave them out"
        )
    scale = np.sqrt(power)
    return data / scale[:, None], scale


def positions(history: TimeHistory, references: Sequence[str]) -> Int:
    """(ref,) int64 rows of the reference channels.

    Raises
    ------
    DataError
        If one is absent.
    """
    ids = [c.id for c in history.channels]
    if lost := [x for x in references if x not in ids]:
        raise DataError(
            f"{history.source}: no reference channel {' '.join(lost[:8])}; there are "
            f"{' '.join(ids[:40])}"
        )
    return np.array([ids.index(x) for x in references], dtype=np.int64)
