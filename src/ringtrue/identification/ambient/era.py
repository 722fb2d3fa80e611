"""Eigensystem realisation algorithm (Juang and Pappa 1985) on correlations (NExT, James et al.
1993) or free decays.

All orders come from one decomposition: with H₀ = U S Vᵀ the matrix of order n is the leading block
of S^(-1/2) Uᵀ H₁ V S^(-1/2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.pipeline import AmbientSettings
from ringtrue.identification.ambient.ssi_cov import (
    SsiCov,
    correlated,
    decompose,
)
from ringtrue.identification.common.stabilisation import (
    DAMPING_MAX,
    PoleSet,
    confirmed,
    modes_of,
    unit,
)
from ringtrue.identification.common.uncertainty import hankel
from ringtrue.signal.spectra import correlations


def era(decays: Float, rate: float, settings: SsiCov) -> PoleSet:
    """Poles of all orders from free decays; standard deviations are NaN.

    Parameters
    ----------
    decays : (lag, ch, ref) float64
        Correlations, or impulse responses; lag 0 is not used, as it holds the sensor noise.
        2·block_rows + 1 lags.
    rate : float, Hz
    settings : SsiCov
        `blocks` is not used.

    Raises
    ------
    DataError
        If there are too few lags.
    """
    ch = decays.shape[1]
    rows = settings.block_rows
    if decays.shape[0] < 2 * rows + 1:
        raise DataError(
            f"{decays.shape[0]} lags are too few for {rows} block rows; needed: {2 * rows + 1}"
        )
    h0 = hankel(decays, rows)
    h1 = hankel(decays[1:], rows)
    u, sv, v = decompose(h0, min(settings.order_max, min(h0.shape)))
    root = np.sqrt(sv)
    a = (u.T @ h1 @ v) / np.outer(root, root)
    return orders_of(a, u[:ch] * root, rate)


def orders_of(a: Float, c: Float, rate: float) -> PoleSet:
    """Poles of the orders 2, 4, .. from leading blocks of the transition matrix `a` and of
    `c` (ch, n).
    """
    orders = range(2, len(a) + 1, 2)
    return gathered(orders, [modal(a[:n, :n], c[:, :n], rate) for n in orders])


def modal(a: Float, c: Float, rate: float) -> tuple[Complex, Complex]:
    """Damped poles (k,), rad/s, and shapes (ch, k) of one realisation."""
    mu, right = np.linalg.eig(a)
    pole = np.log(np.where(mu == 0, 1e-300, mu).astype(np.complex128)) * rate
    zeta = -pole.real / np.maximum(np.abs(pole), 1e-300)
    keep = (mu.imag > 0) & (zeta > 0) & (zeta < DAMPING_MAX)
    return np.asarray(pole[keep]), np.asarray(
        (c @ right[:, keep]).astype(np.complex128)
    )


def gathered(
    orders: Sequence[int], parts: Sequence[tuple[Complex, Complex]]
) -> PoleSet:
    """One set of the (poles, shapes) of each order, without standard deviations."""
    order: Int = np.repeat(
        np.asarray(orders, dtype=np.int64), [x[0].size for x in parts]
    )
    unknown = np.full(order.size, np.nan)
    return PoleSet(
        order=order,
        pole=np.concatenate([x[0] for x in parts]),
        shape=unit(np.concatenate([x[1] for x in parts], axis=1)),
        std_frequency=unknown,
        std_damping=unknown,
    )


def next_era(
    history: TimeHistory, settings: SsiCov, *, references: Sequence[str] | None = None
) -> PoleSet:
    """ERA on the correlations of an ambient record with its reference channels (NExT), one band,
    all orders.

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
    lags = 2 * settings.block_rows
    data, scale, refs = correlated(history, references, lags)
    return era(correlations(data, refs, lags), history.rate, settings).rescaled(scale)


SAMPLES_A_LAG = 8  # of the record, at least


def era_modes(
    part: TimeHistory, band: tuple[float, float], settings: AmbientSettings
) -> tuple[ModeSet, Uncertainty]:
    """Modes of one band (Hz) that most orders show, and both halves of the record."""

    def poles(data: Float) -> PoleSet:
        rows = min(settings.block_rows, data.shape[1] // SAMPLES_A_LAG)
        own = SsiCov(rows, order_max=60)
        return next_era(
            replace(part, data=data), own, references=settings.references or None
        )

    modes, std = modes_of(poles(part.data), tuple(c.id for c in part.channels))
    first, second = np.array_split(part.data, 2, axis=1)
    return confirmed(modes, (poles(first), poles(second)), part.duration), std


def fewest_samples(settings: AmbientSettings) -> int:
    """Samples of a band that all block rows need."""
    return SAMPLES_A_LAG * settings.block_rows
