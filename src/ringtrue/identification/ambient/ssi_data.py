"""Data-driven stochastic subspace identification with reference channels (Peeters and De Roeck
1999).

The LQ factorisation of past references over future outputs gives the orthogonal projection P = Y_f
/ Y_p; it is streamed: only the triangle stays from stretch to stretch, so memory does not grow with
the record. The left vectors of L21 are those of P (unweighted principal components).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import qr, solve_triangular

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.pipeline import AmbientSettings
from ringtrue.identification.ambient.ssi_cov import (
    MAX_REFERENCES,
    SsiCov,
    Subspace,
    all_orders,
    choose_references,
    decompose,
    factored,
    prepared,
)
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import PoleSet, modes_of
from ringtrue.signal.spectra import block_bounds


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """What is kept of a record.

    Attributes
    ----------
    past : (rows·ref, rows·ref) float64
        Lower triangle L11 of the LQ, per root sample.
    future : (rows·ch, rows·ref) float64
        L21 = P in the basis of the past references.
    products : (block, rows·ch, rows·ref) float32
        Mean of Y_f Y_pᵀ over each block of the record.
    weights : (block,) float64, sum 1
    """

    past: Float
    future: Float
    products: Any_
    weights: Float


def columns(data: Float, references: Int, rows: int) -> Float:
    """Past references and future outputs of each sample of `data` (ch, sample): (sample, rows·(ref
    + ch)).
    """
    n = data.shape[1] - 2 * rows + 1
    past = sliding_window_view(data[references], n, axis=1)[:, :rows]
    future = sliding_window_view(data, n, axis=1)[:, rows : 2 * rows]
    return np.concatenate(
        [x.transpose(1, 0, 2).reshape(-1, n) for x in (past, future)]
    ).T


def _triangle(data: Float, references: Int, rows: int) -> Float:
    """Upper triangle R of the columns of one block, stretch by stretch; RᵀR is their Gram
    matrix.
    """
    width = rows * (references.size + len(data))
    n = data.shape[1] - 2 * rows + 1
    step = 4 * width  # rows of a stretch: the triangle is refactored a few times only
    r = np.zeros((0, width))
    for start in range(0, n, step):
        part = columns(
            data[:, start : min(start + step, n) + 2 * rows - 1], references, rows
        )
        r = qr(
            np.concatenate([r, part]), mode="r", overwrite_a=True, check_finite=False
        )[0][:width]
    return r


def project(data: Float, references: Int, rows: int, blocks: int) -> Projection:
    """The projection of future outputs on past references of `data` (ch, sample), from `blocks`
    blocks.

    Raises
    ------
    DataError
        If the record is too short.
    """
    width = rows * (references.size + len(data))
    past = rows * references.size
    n = data.shape[1] - 2 * rows + 1
    if n < 2 * width or n < 4 * blocks:
        raise DataError(
            f"{data.shape[1]} samples are too few for {rows} block rows of {len(data)} channels "
            f"and {references.size} "
            f"references; needed are {max(2 * width, 4 * blocks) + 2 * rows}"
        )
    bounds = block_bounds(n, blocks)
    r = np.zeros((0, width))
    products = np.empty((blocks, width - past, past), dtype=np.float32)
    for b, (start, end) in enumerate(pairwise(bounds.tolist())):
        own = _triangle(data[:, start : end + 2 * rows - 1], references, rows)
        products[b] = own[:, past:].T @ own[:, :past] / (end - start)
        r = qr(
            np.concatenate([r, own]), mode="r", overwrite_a=True, check_finite=False
        )[0][:width]
    size = np.sqrt(n)
    return Projection(
        r[:past, :past].T / size,
        r[:past, past:].T / size,
        products,
        np.diff(bounds) / n,
    )


def _perturbations(p: Projection, sub: Subspace) -> var.Perturbations:
    """With the projection Y_f Y_pᵀ L11^(-T), only the change of Y_f Y_pᵀ moves the span of its left
    vectors.
    """
    ch = sub.channels
    n = p.weights.size
    vs = solve_triangular(p.past, sub.vs, lower=True, trans="T").astype(np.float32)
    t = p.products @ vs
    t = (t - np.einsum("b,bij->ij", p.weights, t)) * (p.weights * np.sqrt(n / (n - 1)))[
        :, None, None
    ]
    q = sub.q.T
    u = sub.u.T
    return var.Perturbations(q @ t[:, :-ch], q @ t[:, ch:], t[:, :ch], u @ t)


def ssi_data(
    history: TimeHistory, settings: SsiCov, *, references: Sequence[str] | None = None
) -> PoleSet:
    """Poles of all orders of the record as it stands by SSI-data, with their standard deviations.

    Parameters
    ----------
    history : TimeHistory
    settings : SsiCov
        The cost grows with the square of block_rows·(channels + references), and with the length of
        the record.
    references : sequence of str
        Channel ids; None: all channels, or the 8 that span the motion best.

    Raises
    ------
    DataError
        If the record is too short, a channel is dead or there is no such reference.
    """
    rows = settings.block_rows
    data, scale = prepared(history)
    refs = choose_references(history, data, references)
    blocks = settings.blocks or var.blocks_for(data.shape[1], 2 * rows)
    p = project(data, refs, rows=rows, blocks=blocks)
    ch = len(data)
    u, sv, v = decompose(
        p.future, min(settings.order_max, (rows - 1) * ch, min(p.future.shape))
    )
    sub = factored(u, sv, v / sv, ch, history.rate)
    poles = all_orders(sub, _perturbations(p, sub), settings, (0.0, history.rate / 2))[
        0
    ]
    return poles.rescaled(scale)


def ssi_data_modes(
    part: TimeHistory, band: tuple[float, float], settings: AmbientSettings
) -> tuple[ModeSet, Uncertainty]:
    """Modes of one band (Hz) that most orders show."""
    own = SsiCov(_block_rows(len(part.channels), settings), order_max=40)
    poles = ssi_data(part, own, references=settings.references or None)
    return modes_of(poles, tuple(c.id for c in part.channels))


def fewest_samples(channels: int, settings: AmbientSettings) -> int:
    """Samples of a band that the projection needs."""
    references = len(settings.references) or min(channels, MAX_REFERENCES)
    return 2 * _block_rows(channels, settings) * (channels + references + 1)


def _block_rows(channels: int, settings: AmbientSettings) -> int:
    # the cost grows with the square of rows times channels
    most = 400 // max(channels, 1)
    return max(4, min(settings.block_rows, most) // 2)
