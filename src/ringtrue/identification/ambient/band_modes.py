"""Modes of one band of an ambient record: poles, candidates, confidence, maximum likelihood.

Three kinds of records ask for more. Of a few strong events in silence a block without an event
holds noise only, and the first half of the record may hold all events. A frequency that wanders
along the record (temperature, traffic, tide) makes the estimates of neighbouring blocks similar:
the mean over the record is wider than the mode. What is left of the ripples of an echo
(`signal.echoes`) makes modes less certain.

A ripple ε cos(ωτ + φ) of the logarithmic spectrum at a resonance 1/(1 + x²), x = (ω − ω0)/(ζ ω0),
moves the most likely frequency by ζ ε sin φ exp(−ζ ω0 τ), relatively, and the damping by
ε cos φ exp(−ζ ω0 τ). A ripple wider than the lines of a fit is a slope and a level, which are free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.identification.ambient.candidates import (
    CandidateModes,
    candidates,
    half_agreement,
    steady,
)
from ringtrue.identification.ambient.close_modes import loosened, refined, with_pairs
from ringtrue.identification.ambient.confidence import (
    BandModes,
    all_clear,
    confidence,
    crowded,
    select,
    without_echoes,
    without_noise,
)
from ringtrue.identification.ambient.manual_selection import with_picks
from ringtrue.identification.ambient.maximum_likelihood import REACHES
from ringtrue.identification.ambient.record_bands import BandSums
from ringtrue.identification.ambient.record_checks import CommonMotion, RecordFacts, spectrum
from ringtrue.identification.ambient.ssi_cov import (
    BandPoles,
    SsiCov,
    all_orders,
    block_power,
    identify_band,
    part_of,
    subspace,
)
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.poles import PoleSet, StableDiagram, unit
from ringtrue.signal.decimation import Band
from ringtrue.signal.echoes import Echo
from ringtrue.signal.spectra import block_weights

# of the orders: where modes appear in the first third of them, else, and in bands crowded with
# modes
SHARES = (0.6, 1.0, 1.5)
SILENT_PERCENTILE = 20  # percentile of the power of the blocks
ABOVE_SILENCE = 10.0  # times that: where motion stands out of it, blocks have equal weight
LEAST_BLOCKS = 12
BEYOND = 3.0  # standard deviations of the mean correlation of neighbours
MATTERS = 0.25  # standard deviation of the frequency over the damping: below it adds 3 % of damping
# of the square of that ratio: what it adds to the damping, by its shape 0.2 to 0.8
WIDER = 0.5


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
    sums: BandSums,
    r: Any_,
    weights: Float,
    parts: tuple[Int, Int],
    least: float,
    heard: RecordFacts,
) -> tuple[BandPoles, CandidateModes, Int, list[tuple[int, int]]]:
    """Poles, candidates, the pick behind each and the pairs that are not separated, of the lower
    orders.

    Of all orders where modes still appear late or are in doubt, and of more where they crowd the
    band.
    """
    ssi = sums.ssi
    band = sums.band
    tries = sums.ssi.order_max // sums.ssi.order_step
    for share in SHARES:
        pairs: list[tuple[int, int]] = []
        some = replace(ssi, order_max=max(2 * int(share * ssi.order_max / 2), 2))
        poles = identify_band(
            r, weights, settings=some, rate=band.rate, band=(band.low, band.high), turn=heard.turn
        )
        table, picked = with_picks(candidates(poles, driven=heard.driven), poles, heard.choice)
        if table.pole.size:
            halves = _halves(r, weights, ssi=some, found=poles, band=band, parts=parts)
            agreed = half_agreement(table, halves)
            if heard.driven and r.shape[3] > 1:
                mean = np.tensordot(weights, r, 1)
                other = by_references(
                    mean,
                    some,
                    rate=band.rate,
                    band=(0.97 * band.low, 1.03 * band.high),
                    turn=heard.turn,
                )
                agreed = np.maximum(agreed, half_agreement(table, other))
            table = replace(table, halves=agreed)
            table, pairs = with_pairs(table, poles, halves=halves, tries=tries, least=least)
            picked = np.pad(picked, (0, table.pole.size - picked.size), constant_values=-1)
        if all_clear(table, tries) or (share >= 1.0 and not crowded(table, tries, some.order_max)):
            break
    return poles, table, picked, pairs


def modes_of_band(sums: BandSums, confidence_min: float, heard: RecordFacts) -> BandModes:
    """Modes of one band; those of less confidence are not refined."""
    r = sums.r
    motion = heard.motion
    power = block_power(r, sums.references)
    loudness = event_weights(power) if heard.driven else block_weights(power)
    weights = loudness * sums.share / (loudness @ sums.share)
    halves = np.array_split(np.arange(power.size), 2) if not heard.driven else even_halves(power)
    poles, table, picked, pairs = _candidates(
        sums, r, weights=weights, parts=(halves[0], halves[1]), least=confidence_min, heard=heard
    )
    conf = confidence(table, sums.ssi.order_max // sums.ssi.order_step)
    turning = tuple(i for both in pairs for i in both)
    diagram = _diagram(poles, table, sums)
    found = _found(
        sums, diagram, table=table, conf=conf, picked=picked, turning=turning, motion=motion
    )
    at = np.array([i for _, i in select([found], confidence_min)], dtype=np.int64)
    if not at.size or heard.driven:
        return found
    wandering = frequency_wander(table, at, poles.deviation.shape[1])
    if steady(table, at, power, sums.stretches * sums.bins.duration):
        bins = motion.spectra(sums.bins, sums.eyes) if motion else sums.bins
        table = loosened(
            refined(table, at, references=sums.eyes, bins=bins, slope=heard.slope), pairs
        )
        conf = without_noise(
            table, without_echoes(table, conf), sums.stretches * sums.bins.duration
        )
    found = _found(
        sums,
        diagram,
        table=with_wander_doubt(table, wandering),
        conf=conf,
        picked=picked,
        turning=turning,
        motion=motion,
    )
    return replace(
        found, wandering=tuple((int(i), float(wandering[i])) for i in np.flatnonzero(wandering))
    )


def _found(
    sums: BandSums,
    diagram: StableDiagram,
    table: CandidateModes,
    conf: Float,
    picked: Int,
    turning: tuple[int, ...],
    motion: CommonMotion | None,
) -> BandModes:
    """The candidates with shapes in the channels' units, or in that of one motion."""
    scale = sums.scale[:, None] if motion is None else sums.scale[:, None] * motion.lift(table.pole)
    scaled = table.shape * scale
    std = var.modulus_std(scaled, table.shape_deviation * scale.T[:, :, None])
    return BandModes(
        table=table,
        shape=unit(scaled),
        shape_std=std,
        confidence=conf,
        diagram=diagram,
        picked=picked,
        turning=turning,
    )


def _diagram(poles: BandPoles, table: CandidateModes, sums: BandSums) -> StableDiagram:
    shown = poles.poles.rescaled(sums.scale)
    return StableDiagram(
        shown, table.stable, table.label, *spectrum(sums.bins, sums.scale[sums.eyes])
    )


def event_weights(power: Float) -> Float:
    """(block,) weights, sum 1, of blocks of mean square `power` (block,): loud ones have equal
    weight, silent ones little.
    """
    floor = max(
        float(np.percentile(power, SILENT_PERCENTILE)),
        1e-12 * float(power.max()),
        np.finfo(float).tiny,
    )
    w = 1 / np.maximum(power, ABOVE_SILENCE * floor)
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
        subspace(mean[:, :, k::2], ssi.block_rows, order=ssi.order_max, rate=rate, turn=turn)
        for k in (0, 1)
    )
    return all_orders(one, None, step, band)[0], all_orders(two, None, step, band)[0]


def frequency_wander(c: CandidateModes, at: Int, blocks: int) -> Float:
    """(m,) standard deviation of the frequency along the record over the frequency; 0 where it may
    be scatter.

    Parameters
    ----------
    c : CandidateModes
        With deviations by the blocks of the record, in time.
    at : (k,) int64
        Rows that are modes; whatever moves them moves most of them.
    blocks : int
        The first columns of the deviations.
    """
    out = np.zeros(c.pole.size)
    if blocks < LEAST_BLOCKS or not at.size:
        return out
    d = (c.deviation[at, :blocks] * c.pole[at, None].conj()).real / np.abs(c.pole[at, None]) ** 2
    d *= np.sqrt(blocks * (blocks - 1.0))  # of a block, not of the mean
    own = (d**2).mean(axis=1)
    # the mean over the blocks is taken off
    both = (d[:, 1:] * d[:, :-1]).sum(axis=1) / (blocks - 1) + own / blocks
    like = both / np.maximum(own, np.finfo(np.float64).tiny)
    if like.mean() > BEYOND / np.sqrt(blocks * at.size):
        out[at] = np.sqrt(np.maximum(both, 0))
    return np.where(out > MATTERS * c.damping, out, 0.0)


def with_wander_doubt(c: CandidateModes, wandering: Float) -> CandidateModes:
    """The candidates with what a wandering frequency may add to the damping, a column each."""
    rows = np.flatnonzero(wandering)
    if not rows.size:
        return c
    more = np.zeros((c.pole.size, rows.size), dtype=np.complex128)
    share = WIDER * (wandering[rows] / c.damping[rows]) ** 2
    w = np.abs(c.pole[rows])
    zeta = c.damping[rows]
    more[rows, np.arange(rows.size)] = share * zeta * w * (-1 - 1j * zeta / np.sqrt(1 - zeta**2))
    return replace(c, deviation=np.concatenate([c.deviation, more], axis=1))


def with_echo_doubt(found: BandModes, echo: Echo) -> BandModes:
    """The candidates with what a wrong factor of the echo does among their deviations, in two
    columns of each.
    """
    c = found.table
    w = np.abs(c.pole)
    zeta = c.damping
    decay = zeta * w * echo.delay
    seen = np.exp(-decay) * np.minimum(2 / np.pi * REACHES[0] * decay, 1)
    size = np.sqrt(2) * echo.doubt * abs(echo.factor) / np.sqrt(1 - echo.factor**2) * seen
    moved = c.pole * zeta * size
    damped = zeta * w * (-1 - 1j * zeta / np.sqrt(1 - zeta**2)) * size
    more = np.concatenate([np.diag(moved), np.diag(damped)], axis=1)
    return replace(found, table=replace(c, deviation=np.concatenate([c.deviation, more], axis=1)))
