"""Several setups with common references in one global identification (PreGER): one pole and one
shape for all.

The block-Hankel matrices of the references of all setups, side by side, share their column space;
each setup's own observability matrix is brought to that basis, which takes out the force of that
day (Döhler, Reynders, Magalhães, Mevel, De Roeck and Cunha 2010; Reynders et al. 2009).
`merge.merge_modes` glues separately identified modes instead (PoSER); where frequencies differ from
setup to setup, that is the better choice.

Deviations are to first order: the correlations of each setup are changed by the deviation of each
of its blocks in turn, and what that does to the transition matrix of each order moves its poles and
shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import InputError
from ringtrue.identification import variance as var
from ringtrue.identification.pick import modes_of
from ringtrue.identification.poles import PoleSet, unit
from ringtrue.identification.ssi import SsiCov, decompose, positions, prepared
from ringtrue.signal.spectra import block_bounds, block_correlations

MOST_BLOCKS = 12  # of a setup


@dataclass(frozen=True, slots=True, eq=False)
class GlobalPoles:
    """Poles of all orders on all channels.

    Attributes
    ----------
    poles : PoleSet
        Rows of the shapes are `channels`.
    shape_std : (ch, k) float64
        Standard deviations of the moduli, the largest component held.
    deviation : (k, block) complex128, rad/s
        Of each pole by each block of all setups; the squares sum up to the variance.
    channels : tuple of str
        References first, then the other channels of each setup.
    """

    poles: PoleSet
    shape_std: Float
    deviation: Complex
    channels: tuple[str, ...]

    def modes(self, source: str = "PreGER") -> tuple[ModeSet, Uncertainty]:
        """Modes that most orders show (`identify.pick.modes_of`) with their standard deviations."""
        return modes_of(
            self.poles,
            self.channels,
            source=source,
            shape_std=self.shape_std,
            deviation=self.deviation,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """Correlations (lag, ch, ref) of one setup, references first, and their deviations by its
    blocks.

    In units of each channel's root mean square, that of the references' in the first setup, over
    the norm of those of the references.
    """

    r: Float
    dr: Any_

    def hankels(self, rows: int, refs: int, block: int = -1) -> tuple[Float, Float]:
        """Block-Hankel matrices of the references and of the others, changed by the deviation of a
        block.
        """
        r = self.r if block < 0 else self.r + self.dr[block]
        return var.hankel(r[:, :refs], rows), var.hankel(r[:, refs:], rows)


def _channels(setups: Sequence[TimeHistory], references: tuple[str, ...]) -> list[list[str]]:
    """Ids of the moved channels of each setup."""
    if len(setups) < 1 or not references:
        raise InputError(
            f"{len(setups)} setups with {len(references)} references: at least one of each is "
            "needed"
        )
    if any(not np.isclose(h.rate, setups[0].rate) for h in setups):
        raise InputError(f"setups at {[h.rate for h in setups]} Hz: resample them to one rate")
    moved = [[c.id for c in h.channels if c.id not in references] for h in setups]
    flat = [c for m in moved for c in m]
    if twice := sorted({c for c in flat if flat.count(c) > 1}):
        raise InputError(
            f"channels {' '.join(twice[:8])} occur in several setups: name them among the "
            "references"
        )
    return moved


def _setup(
    history: TimeHistory, ids: Sequence[str], refs: int, first: Float | None, s: SsiCov
) -> tuple[_Setup, Float]:
    """Correlations of one setup, and the root mean squares of its channels; `first`: of the
    references in the first.
    """
    data, scale = prepared(history)
    at, lags = positions(history, tuple(ids)), 2 * s.block_rows - 1
    samples = data.shape[1]
    blocks = s.blocks or min(var.blocks_for(samples, lags), MOST_BLOCKS)
    r, count = block_correlations(data[at], np.arange(refs), lags, block_bounds(samples, blocks))
    scale = scale[at]
    own = (
        np.ones(len(at))
        if first is None
        else np.concatenate([scale[:refs] / first, np.ones(len(at) - refs)])
    )
    r *= own[:, None]  # the columns are but combinations and may stay
    weights = count[:, 0] / count[:, 0].sum()
    mean, dr = var.deviations(r, weights) if blocks > 1 else (r[0], r[:0])
    size = np.linalg.norm(var.hankel(mean[:, :refs], s.block_rows))
    return _Setup(mean / size, dr / size), scale


def preger(
    setups: Sequence[TimeHistory], references: Sequence[str], settings: SsiCov | None = None
) -> GlobalPoles:
    """Poles of all orders from several setups at once.

    Parameters
    ----------
    setups : sequence of TimeHistory
        Each holds the references; the others of its channels occur in it alone. One rate.
    references : sequence of str
        Ids of the channels common to all.
    settings : SsiCov
        `blocks` of each setup; 1 leaves the standard deviations out (NaN), 0 chooses.

    Raises
    ------
    InputError
        If rates differ, a channel that is no reference occurs twice, or there is no setup or
        reference.
    DataError
        If a setup lacks a reference or has a dead channel.
    """
    s, refs = settings or SsiCov(), tuple(references)
    moved = _channels(setups, refs)
    parts: list[_Setup] = []
    scales: list[Float] = []
    for h, m in zip(setups, moved, strict=True):
        part, scale = _setup(
            h, refs + tuple(m), len(refs), scales[0][: len(refs)] if scales else None, s
        )
        parts.append(part)
        scales.append(scale)
    plain = [x.hankels(s.block_rows, len(refs)) for x in parts]
    u, sv, v = decompose(
        np.concatenate([x[0] for x in plain], axis=1),
        min(s.order_max, (s.block_rows - 1) * len(refs)),
    )
    n = int((sv > 1e-10 * sv[0]).sum())
    right = v[:, :n] / sv[:n]
    orders = list(range(2, n + 1, s.order_step))
    base = _realised(u[:, :n], plain, orders, s.block_rows)
    changed = []
    for j, x in enumerate(parts):
        for b in range(len(x.dr)):
            some = [*plain[:j], x.hankels(s.block_rows, len(refs), b), *plain[j + 1 :]]
            # the same right vectors, the same signs: a basis that changes as little as the
            # correlations do
            q, r = np.linalg.qr(np.concatenate([y[0] for y in some], axis=1) @ right)
            changed.append(_realised(q * np.sign(np.diag(r)), some, orders, s.block_rows))
    scale = np.concatenate([scales[0], *(x[len(refs) :] for x in scales[1:])])
    found = [
        _order(base[k], [c[k] for c in changed], s, setups[0].rate, scale)
        for k in range(len(orders))
    ]
    poles = PoleSet(
        np.repeat(np.asarray(orders, dtype=np.int64), [len(x[0]) for x in found]),
        np.concatenate([x[0] for x in found]),
        unit(np.concatenate([x[1] for x in found], axis=1)),
        np.concatenate([x[2] for x in found]),
        np.concatenate([x[3] for x in found]),
    )
    shape_std = np.concatenate([x[4] for x in found], axis=1)
    return GlobalPoles(
        poles,
        shape_std,
        np.concatenate([x[5] for x in found]),
        refs + tuple(c for m in moved for c in m),
    )


def _realised(
    u: Float, hankels: Sequence[tuple[Float, Float]], orders: Sequence[int], rows: int
) -> list[tuple[Float, Float]]:
    """A (n, n) and C (ch, n) of each order: O_moved = H_moved Xᵀ (X Xᵀ)⁻¹ of each setup under the
    references' O.
    """
    seen = [u.T @ fixed for fixed, _ in hankels]
    gram, cross = (
        [x @ x.T for x in seen],
        [h @ x.T for (_, h), x in zip(hankels, seen, strict=True)],
    )
    out = []
    for n in orders:
        own = [
            np.linalg.lstsq(g[:n, :n], c[:, :n].T, rcond=1e-14)[0].T
            for g, c in zip(gram, cross, strict=True)
        ]
        by_row = np.concatenate([x.reshape(rows, -1, n) for x in (u[:, :n], *own)], axis=1)
        ch = by_row.shape[1]
        o = by_row.reshape(-1, n)
        q, r = np.linalg.qr(o[:-ch])
        out.append((solve_triangular(r, q.T @ o[ch:]), o[:ch].copy()))
    return out


def _order(
    base: tuple[Float, Float],
    changed: Sequence[tuple[Float, Float]],
    s: SsiCov,
    rate: float,
    scale: Float,
) -> tuple[Complex, Complex, Float, Float, Float, Complex]:
    """Damped poles (k,), shapes (ch, k), standard deviations of frequency, damping and moduli, and
    what each block does to the poles (k, block), of one order.
    """
    a, c = base
    mu, right = np.linalg.eig(a)
    right = right.astype(np.complex128)
    every = np.asarray(
        np.log(np.where(mu == 0, 1e-300, mu).astype(np.complex128)) * rate, dtype=np.complex128
    )
    zeta = -every.real / np.maximum(np.abs(every), 1e-300)
    keep = np.flatnonzero((mu.imag > 0) & (zeta > 0) & (zeta < s.damping_max))
    pole = every[keep]
    psi = np.asarray(scale[:, None] * (c @ right[:, keep]), dtype=np.complex128)
    if not changed or not keep.size:
        unknown, none = (
            np.full(keep.size, np.nan),
            np.empty((keep.size, len(changed)), np.complex128),
        )
        return pole, psi, unknown, unknown, np.full(psi.shape, np.nan), none
    d_a, d_c = (np.stack([x[i] - base[i] for x in changed]) for i in (0, 1))
    load = np.linalg.solve(right, d_a @ right[:, keep])  # (block, n, k)
    at = np.arange(keep.size)
    d_mu = load[:, keep, at].T
    gain = mu[keep] - mu[:, None]
    gain[keep, at] = np.inf
    d_psi = scale[:, None] * (d_c @ right[:, keep] + c @ (right @ (load / gain)))
    d_pole = np.asarray(d_mu / mu[keep, None] * rate, dtype=np.complex128)
    df, dz = var.frequency_damping(pole, d_pole)
    return (
        pole,
        psi,
        var.std(df),
        var.std(dz),
        var.modulus_std(psi, d_psi.transpose(2, 1, 0)),
        d_pole,
    )
