"""Several setups with common references in one global identification (PreGER): one pole and one shape for all.

The block-Hankel matrices of the references of all setups, side by side, share their column space; each setup's own
observability matrix is brought to that basis, which takes out the force of that day (Döhler, Reynders, Magalhães,
Mevel, De Roeck and Cunha 2010; Reynders et al. 2009). `merge.merge_modes` glues separately identified modes instead
(PoSER); where frequencies differ from setup to setup, that is the better choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import InputError
from ringtrue.identify.era import gathered, modal
from ringtrue.identify.poles import PoleSet
from ringtrue.identify.ssi import SsiCov, decompose, positions, prepared
from ringtrue.identify.variance import hankel
from ringtrue.signal.psd import correlations


@dataclass(frozen=True, slots=True, eq=False)
class GlobalPoles:
    """Poles of all orders on all channels.

    Attributes
    ----------
    poles : PoleSet
        Rows of the shapes are `channels`; standard deviations are NaN.
    channels : tuple of str
        References first, then the other channels of each setup.
    """

    poles: PoleSet
    channels: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """Block-Hankel matrices of one setup, the references' of unit norm."""

    fixed: Float
    moved: Float


def _channels(setups: Sequence[TimeHistory], references: tuple[str, ...]) -> list[list[str]]:
    """Ids of the moved channels of each setup."""
    if len(setups) < 1 or not references:
        raise InputError(f"{len(setups)} setups with {len(references)} references: at least one of each is needed")
    if any(not np.isclose(h.rate, setups[0].rate) for h in setups):
        raise InputError(f"setups at {[h.rate for h in setups]} Hz: resample them to one rate")
    moved = [[c.id for c in h.channels if c.id not in references] for h in setups]
    flat = [c for m in moved for c in m]
    if twice := sorted({c for c in flat if flat.count(c) > 1}):
        raise InputError(f"channels {' '.join(twice[:8])} occur in several setups: name them among the references")
    return moved


def _hankels(history: TimeHistory, references: tuple[str, ...], moved: list[str], s: SsiCov) -> tuple[_Setup, Float]:
    """Block-Hankel matrices in units of each channel's root mean square, and those, references first."""
    at = np.concatenate([positions(history, references), positions(history, tuple(moved))]).astype(np.int64)
    data, scale = prepared(history)
    k = len(references)
    r = correlations(data[at], np.arange(k), 2 * s.block_rows - 1)
    fixed, other = hankel(r[:, :k], s.block_rows), hankel(r[:, k:], s.block_rows)
    size = np.linalg.norm(fixed)
    return _Setup(fixed / size, other / size), scale[at]


def preger(setups: Sequence[TimeHistory], references: Sequence[str], settings: SsiCov | None = None) -> GlobalPoles:
    """Poles of all orders from several setups at once.

    Parameters
    ----------
    setups : sequence of TimeHistory
        Each holds the references; the others of its channels occur in it alone. One rate.
    references : sequence of str
        Ids of the channels common to all.
    settings : SsiCov
        `blocks` is not used.

    Raises
    ------
    InputError
        If rates differ, a channel that is no reference occurs twice, or there is no setup or reference.
    DataError
        If a setup lacks a reference or has a dead channel.
    """
    s, refs = settings or SsiCov(), tuple(references)
    moved = _channels(setups, refs)
    parts = [_hankels(h, refs, m, s) for h, m in zip(setups, moved, strict=True)]
    # one scale of the references for all setups: that of the first
    first = parts[0][1][: len(refs)]
    fixed = [_common(x.fixed, scale[: len(refs)] / first) for x, scale in parts]
    u, sv, _ = decompose(np.concatenate(fixed, axis=1), min(s.order_max, (s.block_rows - 1) * len(refs)))
    n = int((sv > 1e-10 * sv[0]).sum())
    seen = [u[:, :n].T @ h for h in fixed]
    gram = [x @ x.T for x in seen]
    cross = [x.moved @ y.T for (x, _), y in zip(parts, seen, strict=True)]
    orders = list(range(2, n + 1, s.order_step))
    found = [
        _order(u[:, :k], [(c[:, :k], g[:k, :k]) for c, g in zip(cross, gram, strict=True)], s, setups[0].rate)
        for k in orders
    ]
    scales = np.concatenate([first, *(scale[len(refs) :] for _, scale in parts)])
    return GlobalPoles(gathered(orders, found).rescaled(scales), refs + tuple(c for m in moved for c in m))


def _common(h: Float, ratio: Float) -> Float:
    """Rows of the references' matrix in the units of the first setup; its columns are but combinations and may stay."""
    return np.asarray(h * np.tile(ratio, h.shape[0] // ratio.size)[:, None])


def _order(fixed: Float, own: list[tuple[Float, Float]], s: SsiCov, rate: float) -> tuple[Complex, Complex]:
    """Poles and shapes of one order: O_moved = H_moved Xᵀ (X Xᵀ)⁻¹ of each setup under the references' O."""
    n = fixed.shape[1]
    moved = [np.linalg.lstsq(g, c.T, rcond=1e-14)[0].T for c, g in own]
    by_row = np.concatenate([x.reshape(s.block_rows, -1, n) for x in (fixed, *moved)], axis=1)
    ch = by_row.shape[1]
    o = by_row.reshape(-1, n)
    return modal(np.linalg.lstsq(o[:-ch], o[ch:], rcond=None)[0], o[:ch], rate, s.damping_max)
