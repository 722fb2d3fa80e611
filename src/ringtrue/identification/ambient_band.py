"""Modes of one band of an ambient record: poles of all orders, candidates, their refinement by
maximum likelihood.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.identification import variance as var
from ringtrue.identification.ambient_record import Heard, Motion, spectrum
from ringtrue.identification.ambient_verdict import (
    Found,
    confidence,
    crowded,
    select,
    settled,
    without_echoes,
    without_noise,
)
from ringtrue.identification.bands import BandSums
from ringtrue.identification.choice import with_picks
from ringtrue.identification.poles import PoleSet, StableDiagram, unit
from ringtrue.identification.repeated import loosened, with_pairs
from ringtrue.identification.ssi import (
    BandPoles,
    SsiCov,
    all_orders,
    block_power,
    identify_band,
    part_of,
)
from ringtrue.identification.stabilise import (
    Candidates,
    candidates,
    half_agreement,
    refined,
    steady,
)
from ringtrue.identification.struck import by_references, even_halves, event_weights
from ringtrue.identification.wander import wander, widened
from ringtrue.signal.decimation import Band
from ringtrue.signal.spectra import block_weights

# of the orders: where modes appear in the first third of them, else, and in bands crowded with
# modes
SHARES = (0.6, 1.0, 1.5)


def _halves(
    r: Any_, weights: Float, ssi: SsiCov, found: BandPoles, band: Band, parts: tuple[Int, Int]
) -> tuple[PoleSet, PoleSet]:
    """Poles of both halves (blocks) of the record, every other order."""
    whole = found.subspace
    step = replace(ssi, order_step=2 * ssi.order_step)

    def half(part: Int) -> PoleSet:
        mean = np.tensordot(
            (weights[part] / weights[part].sum()).astype(r.dtype), r[part], 1
        ).astype(np.float64)
        return all_orders(
            part_of(whole, mean, ssi.block_rows), None, step, (0.97 * band.low, 1.03 * band.high)
        )[0]

    return half(parts[0]), half(parts[1])


def _candidates(
    sums: BandSums, r: Any_, weights: Float, parts: tuple[Int, Int], least: float, heard: Heard
) -> tuple[BandPoles, Candidates, Int, list[tuple[int, int]]]:
    """Poles, candidates, the pick behind each and the pairs that are not told apart, of the lower
    orders.

    Of all orders where modes still appear late or are in doubt, and of more where they crowd the
    band.
    """
    ssi, band, tries = sums.ssi, sums.band, sums.ssi.order_max // sums.ssi.order_step
    for share in SHARES:
        pairs: list[tuple[int, int]] = []
        some = replace(ssi, order_max=max(2 * int(share * ssi.order_max / 2), 2))
        poles = identify_band(r, weights, some, band.rate, (band.low, band.high), heard.turn)
        table, picked = with_picks(candidates(poles, driven=heard.driven), poles, heard.choice)
        if table.pole.size:
            halves = _halves(r, weights, some, poles, band, parts)
            agreed = half_agreement(table, halves)
            if heard.driven and r.shape[3] > 1:
                mean = np.tensordot(weights, r, 1)
                other = by_references(
                    mean, some, band.rate, (0.97 * band.low, 1.03 * band.high), heard.turn
                )
                agreed = np.maximum(agreed, half_agreement(table, other))
            table = replace(table, halves=agreed)
            table, pairs = with_pairs(table, poles, halves, tries, least)
            picked = np.pad(picked, (0, table.pole.size - picked.size), constant_values=-1)
        if settled(table, tries) or (share >= 1.0 and not crowded(table, tries, some.order_max)):
            break
    return poles, table, picked, pairs


def modes_of_band(sums: BandSums, confidence_min: float, heard: Heard) -> Found:
    """Modes of one band; those of less confidence are not refined."""
    r, motion = sums.r, heard.motion
    power = block_power(r, sums.references)
    loudness = event_weights(power) if heard.driven else block_weights(power)
    weights = loudness * sums.share / (loudness @ sums.share)
    halves = np.array_split(np.arange(power.size), 2) if not heard.driven else even_halves(power)
    poles, table, picked, pairs = _candidates(
        sums, r, weights, (halves[0], halves[1]), confidence_min, heard
    )
    sure = confidence(table, sums.ssi.order_max // sums.ssi.order_step)
    turning = tuple(i for both in pairs for i in both)
    diagram = _diagram(poles, table, sums)
    found = _found(sums, diagram, table, sure, picked, turning, motion)
    at = np.array([i for _, i in select([found], confidence_min)], dtype=np.int64)
    if not at.size or heard.driven:
        return found
    wandering = wander(table, at, poles.deviation.shape[1])
    if steady(table, at, power, sums.stretches * sums.bins.duration):
        bins = motion.spectra(sums.bins, sums.eyes) if motion else sums.bins
        table = loosened(refined(table, at, sums.eyes, bins, heard.slope), pairs)
        sure = without_noise(
            table, without_echoes(table, sure), sums.stretches * sums.bins.duration
        )
    found = _found(sums, diagram, widened(table, wandering), sure, picked, turning, motion)
    return replace(
        found, wandering=tuple((int(i), float(wandering[i])) for i in np.flatnonzero(wandering))
    )


def _found(
    sums: BandSums,
    diagram: StableDiagram,
    table: Candidates,
    sure: Float,
    picked: Int,
    turning: tuple[int, ...],
    motion: Motion | None,
) -> Found:
    """The candidates with shapes in the channels' units, or in that of one motion."""
    scale = sums.scale[:, None] if motion is None else sums.scale[:, None] * motion.lift(table.pole)
    scaled = table.shape * scale
    std = var.modulus_std(scaled, table.shape_deviation * scale.T[:, :, None])
    return Found(table, unit(scaled), std, sure, diagram, picked, turning)


def _diagram(poles: BandPoles, table: Candidates, sums: BandSums) -> StableDiagram:
    shown = poles.poles.rescaled(sums.scale)
    return StableDiagram(
        shown, table.stable, table.label, *spectrum(sums.bins, sums.scale[sums.eyes])
    )
