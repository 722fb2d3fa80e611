"""Hits of a hammer one by one: their signals, and what those that are kept give together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.core.choice import Hit
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.io.sheets import SensorSheet
from ringtrue.signal.frf import estimate_columns
from ringtrue.signal.impacts import HammerSettings, ImpactReport, force_channel, pulse_width
from ringtrue.study.log import Logged
from ringtrue.study.record_views import RecordView
from ringtrue.study.stages.identify import acquisitions, block_settings

PULSES = 8  # pulse widths of the force that are shown on both sides
LONGEST_S = 60.0  # of a response without a block


@dataclass(frozen=True, slots=True, eq=False)
class HitSignals(FrozenArrays):
    """One hit.

    Attributes
    ----------
    force_time : (k,) float64, s
        From the peak of the force on.
    force : (k,) float64, N
        Without its offset.
    freqs : (f,) float64, Hz
    force_level : (f,) float64, dB
        Of the spectrum of the pulse over its largest line.
    time : (n,) float64, s
        From the peak of the force on.
    response : (channel, n) float64
    rate : float, Hz
    """

    force_time: Float
    force: Float
    freqs: Float
    force_level: Float
    time: Float
    response: Float
    rate: float


def force_of(view: RecordView, record: Logged) -> str:
    """The force channel of a record with a hammer.

    Raises
    ------
    DataError
        As `signal.impacts.force_channel` does.
    """
    empty = TimeHistory(np.zeros((len(view.channels), 2)), view.rate, view.channels, view.name)
    at = force_channel(empty, HammerSettings(force=record.force_channel))
    return view.channels[at].id


def place_of(view: RecordView, hit: ImpactReport) -> int:
    """Sample of the peak of a hit in the record."""
    number = hit.source.rpartition(" #")[2]
    run = int(number) - 1 if number.isdigit() and len(view.starts) > 1 else 0
    return view.starts[min(run, len(view.starts) - 1)] + round(hit.time * view.rate)


def hit_signals(
    view: RecordView,
    record: Logged,
    hits: Sequence[ImpactReport],
    k: int,
    responses: Sequence[str],
) -> HitSignals:
    """The signals of hit `k` of a record: of its block, or up to the next hit."""
    settings = block_settings(record, view.rate)
    peak = place_of(view, hits[k])
    later = sorted(place_of(view, h) for h in hits)
    ends = [s for s in (*view.starts[1:], view.samples) if s > peak]
    following = [s for s in later if s > peak]
    length = round((settings.block or LONGEST_S) * view.rate)
    start = max(peak - round(settings.pretrigger * view.rate), 0)
    stop = min([start + length, ends[0], *following[:1]])
    (block,) = view.read([force_of(view, record)], start, stop)
    force = np.asarray(block, dtype=np.float64)
    force = force - np.median(force)
    at = peak - start
    wide = PULSES * max(pulse_width(force, at), 1)
    around = slice(max(at - wide, 0), at + wide + 1)
    pulse = np.zeros_like(force)
    pulse[around] = force[around]
    power = np.abs(np.fft.rfft(pulse)) ** 2
    level = 10 * np.log10(np.maximum(power / max(float(power.max()), 1e-300), 1e-12))
    time = (np.arange(force.size) - at) / view.rate
    response = np.asarray(view.read(responses, start, stop), dtype=np.float64)
    return HitSignals(
        force_time=time[around],
        force=force[around],
        freqs=np.asarray(np.fft.rfftfreq(force.size, 1 / view.rate), dtype=np.float64),
        force_level=level,
        time=time,
        response=response,
        rate=view.rate,
    )


def kept_frfs(
    record: Logged,
    sheet: SensorSheet,
    unused: Sequence[str],
    hits: Sequence[Hit],
    keep_to: float | None = None,
) -> FrfSet:
    """FRFs and coherence of one record, of the hits that count after a choice by hand.

    Raises
    ------
    DataError
        As `signal.frf.estimate_columns` does, as where no hit is left.
    """
    runs, _ = acquisitions(record, sheet, unused)
    settings = replace(block_settings(record, runs[0].rate), keep_to=keep_to, hits=tuple(hits))
    columns, _ = estimate_columns(runs, settings)
    return columns[0]
