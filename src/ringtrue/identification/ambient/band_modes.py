"""Modes of one band of an ambient record: poles, candidates, confidence, maximum likelihood.

Two kinds of records ask for more. Of a few strong events in silence a block without an event holds
noise only, and the first half of the record may hold all events. A frequency that wanders along the
record (temperature, traffic, tide) makes the estimates of neighbouring blocks similar: the mean
over the record is wider than the mode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.ambient.band_evidence import BandEvidence, other_poles
from ringtrue.identification.ambient.close_modes import loosened, refined, with_pairs
from ringtrue.identification.ambient.confidence import (
    BandModes,
    all_clear,
    crowded,
    evidence,
    select,
)
from ringtrue.identification.ambient.record_bands import BandSums
from ringtrue.identification.ambient.record_checks import RecordFacts
from ringtrue.identification.ambient.spectral_bins import (
    CandidateModes,
    SpectralBins,
    candidates,
    singular_values,
    steady,
)
from ringtrue.identification.ambient.ssi_cov import (
    BandPoles,
    block_power,
    identify_band,
)
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.manual_selection import with_picks
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram, unit
from ringtrue.signal.spectra import block_weights


@dataclass(frozen=True, slots=True, eq=False)
class _BandCandidates:
    """Poles and candidates of a band.

    Attributes
    ----------
    poles : BandPoles
    table : CandidateModes
    picked : (m,) int64
        The pick behind each candidate, -1 for none.
    pairs : list of (int, int)
        Rows of pairs that the record does not separate.
    others : tuple of PoleSet
        By other estimators.
    """

    poles: BandPoles
    table: CandidateModes
    picked: Int
    pairs: list[tuple[int, int]]
    others: tuple[PoleSet, ...]


def modes_of_band(
    sums: BandSums, confidence_min: float, facts: RecordFacts
) -> BandModes:
    """Modes of one band; those of less confidence are not refined."""
    power = block_power(sums.r, sums.references)
    loudness = event_weights(power) if facts.driven else block_weights(power)
    weights = loudness * sums.share / (loudness @ sums.share)
    bins = facts.motion.spectra(sums.bins, sums.eyes) if facts.motion else sums.bins
    search = _search(sums, weights, confidence_min, facts, bins)
    table = search.table
    shape, std = _in_units(sums, table, facts)
    poles = search.poles.poles.rescaled(sums.scale)
    blocks = search.poles.deviation.shape[1]
    few = var.students_factor(blocks - 1)
    poles = replace(
        poles,
        std_frequency=few * poles.std_frequency,
        std_damping=few * poles.std_damping,
    )
    freqs, values = singular_values(sums.bins)
    level = 10 * np.log10(values * np.mean(sums.scale[sums.eyes] ** 2))
    found = BandModes(
        table=table,
        shape=shape,
        shape_std=std,
        evidence=evidence(table, facts.duration),
        diagram=StableDiagram(
            poles,
            table.stable,
            table.label,
            freqs,
            level,
            others=tuple(x.rescaled(sums.scale) for x in search.others),
        ),
        picked=search.picked,
        inseparable=tuple(i for both in search.pairs for i in both),
        wander=np.zeros(table.pole.size),
    )
    at = np.array([i for _, i in select([found], confidence_min)], dtype=np.int64)
    if at.size and not facts.driven:
        wander = frequency_wander(table, at, blocks)
        if steady(table, at, power, sums.stretches * sums.bins.duration):
            table = refined(table, at, sums.eyes, bins, facts.slope)
            table = loosened(table, search.pairs)
        shape, std = _in_units(sums, table, facts)
        found = replace(found, shape=shape, shape_std=std, wander=wander)
    deviation = table.deviation.copy()
    deviation[~table.refined] *= few
    table = replace(table, deviation=deviation)
    return replace(found, table=with_wander_doubt(table, found.wander))


def _search(
    sums: BandSums,
    weights: Float,
    least: float,
    facts: RecordFacts,
    bins: SpectralBins,
) -> _BandCandidates:
    """Candidates of the lower orders; of all orders where modes still appear late or are in doubt,
    and of more where they crowd the band.
    """
    r = sums.r
    mean = np.tensordot(weights.astype(r.dtype), r, 1).astype(np.float64)
    band = sums.band
    largest = sums.ssi.order_max
    for share in (0.6, 1.0, 1.5):
        some = replace(sums.ssi, order_max=max(2 * int(share * largest / 2), 2))
        poles = identify_band(r, weights, some, band, turn=facts.turn)
        table, picked = with_picks(
            candidates(poles, driven=facts.driven), poles, facts.choice
        )
        others: tuple[PoleSet, ...] = ()
        if not facts.driven:
            others = other_poles(mean, sums.references, some, band, facts.turn)
        seen = BandEvidence(bins, sums.eyes, facts.duration, others)
        table = seen.weighed(table)
        pairs: list[tuple[int, int]] = []
        if table.pole.size:
            table, pairs = with_pairs(table, poles, seen, least)
            added = table.pole.size - picked.size
            picked = np.pad(picked, (0, added), constant_values=-1)
        if all_clear(table, facts.duration):
            break
        if share >= 1.0 and not crowded(table, facts.duration, some.order_max):
            break
    return _BandCandidates(poles, table, picked, pairs, others)


def _in_units(
    sums: BandSums, table: CandidateModes, facts: RecordFacts
) -> tuple[Complex, Float]:
    """Shapes and their standard deviations in the channels' units, or in that of one motion."""
    scale = sums.scale[:, None]
    if facts.motion:
        scale = scale * facts.motion.lift(table.pole)
    scaled = table.shape * scale
    std = var.modulus_std(scaled, table.shape_deviation * scale.T[:, :, None])
    return unit(scaled), std


def event_weights(power: Float) -> Float:
    """(block,) weights, sum 1, of blocks of mean square `power` (block,).

    Blocks ten times above the silence (the 20th percentile) weigh the same, silent ones little.
    """
    silence = float(np.percentile(power, 20))
    floor = max(silence, 1e-12 * float(power.max()), np.finfo(float).tiny)
    w = 1 / np.maximum(power, 10.0 * floor)
    return np.asarray(w / w.sum())


def frequency_wander(c: CandidateModes, at: Int, blocks: int) -> Float:
    """(m,) standard deviation of the frequency along the record over the frequency; 0 where it may
    be scatter, or adds less to the damping than its standard deviation.

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
    if blocks < 2 or not at.size:
        return out
    d = (c.deviation[at, :blocks] * c.pole[at, None].conj()).real / np.abs(
        c.pole[at, None]
    ) ** 2
    d *= np.sqrt(blocks * (blocks - 1.0))  # of a block, not of the mean
    own = (d**2).mean(axis=1)
    # the mean over the blocks is taken off
    both = (d[:, 1:] * d[:, :-1]).sum(axis=1) / (blocks - 1) + own / blocks
    like = both / np.maximum(own, np.finfo(np.float64).tiny)
    if like.mean() > -ndtri(FALSE_ALARM) / np.sqrt(blocks * at.size):
        out[at] = np.sqrt(np.maximum(both, 0))
    return np.where(out**2 > c.stds()[1] * c.damping, out, 0.0)


def with_wander_doubt(c: CandidateModes, wander: Float) -> CandidateModes:
    """The candidates with what a wandering frequency may add to the damping, a column each: its
    relative variance over the damping, at most.
    """
    rows = np.flatnonzero(wander)
    if not rows.size:
        return c
    zeta = c.damping[rows]
    by_damping = np.abs(c.pole[rows]) * (-1 - 1j * zeta / np.sqrt(1 - zeta**2))
    more = np.zeros((c.pole.size, rows.size), dtype=np.complex128)
    more[rows, np.arange(rows.size)] = wander[rows] ** 2 / zeta * by_damping
    return replace(c, deviation=np.concatenate([c.deviation, more], axis=1))
