"""Records of a few strong events in silence: what counts of their blocks, and what confirms a mode
beside halves.

A block without an event holds noise only, and the first half of a record may hold all events.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.poles import PoleSet
from ringtrue.identification.ssi import SsiCov, all_orders, subspace

SILENT = 20  # percentile of the power of the blocks
ABOVE = 10.0  # times that: where motion stands out of it, blocks count alike


def event_weights(power: Float) -> Float:
    """(block,) weights, sum 1, of blocks of mean square `power` (block,): loud ones count alike,
    silent ones little.
    """
    floor = max(
        float(np.percentile(power, SILENT)), 1e-12 * float(power.max()), np.finfo(float).tiny
    )
    w = 1 / np.maximum(power, ABOVE * floor)
    return np.asarray(w / w.sum())


def even_halves(power: Float) -> tuple[Int, Int]:
    """Two halves of the blocks of about the same power: events are in both where there are two."""
    rank = np.argsort(-power, kind="stable")
    first = np.arange(rank.size) % 4 % 3 == 0  # 0, 3, 4, 7, 8, ..
    return np.sort(rank[first]), np.sort(rank[~first])


def by_references(
    mean: Float, ssi: SsiCov, rate: float, band: tuple[float, float], turn: Complex | None
) -> tuple[PoleSet, PoleSet]:
    """Poles of the correlations `mean` (lag, ch, ref) with every other reference, and with the
    rest.

    The noise of sensors is their own: what a single event shows to both is no noise.
    """
    step = replace(ssi, order_step=2 * ssi.order_step)
    one, two = (
        subspace(mean[:, :, k::2], ssi.block_rows, ssi.order_max, rate, turn) for k in (0, 1)
    )
    return all_orders(one, None, step, band)[0], all_orders(two, None, step, band)[0]
