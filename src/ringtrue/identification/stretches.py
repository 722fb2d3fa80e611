"""From the stretches of a record to the sums of its bands: what is kept does not grow with the
record.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.progress import Progress
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.bands import BandSums, begin, joined, of_stretch
from ringtrue.identification.same_setup import MOVED, likeness
from ringtrue.identification.ssi import SsiCov
from ringtrue.signal.band_correlations import map_in_threads
from ringtrue.signal.decimation import Band, remove_drift
from ringtrue.signal.echoes import Echo, remove_echo
from ringtrue.signal.gaps import Gaps, bridge_gaps
from ringtrue.signal.run_ups import channel_mixes, remove_run_ups
from ringtrue.signal.tonal_lines import (
    Harmonic,
    find_tonal_lines,
    remove_tonal_lines,
    unsteady_lines,
)
from ringtrue.signal.transients import Events, find_events, remove_regular_impacts

MORE_LAGS = 3
SHORTEST = 0.5  # stretch, over the first: edges of the filters would weigh too much


def without_strokes_sweeps_and_echoes(
    good: TimeHistory, whole: TimeHistory | None, impacts: Events, lags: float
) -> tuple[TimeHistory, TimeHistory | None, tuple[str, ...], Echo | None]:
    """Both records (`whole`: some channels of `good`) without regular blows, run-ups and echoes,
    notes, the echo.

    Where decays after `impacts` are most of the motion, modes are found in them: they stay, if the
    next blow comes after twice the longest of the `lags`, s, of the highest band.
    """
    heard = channel_mixes(good.data)
    quiet, strokes = remove_regular_impacts(good, heard)
    if strokes and impacts.driven and strokes.interval > 2 * lags:
        quiet, strokes = good, None
    still, sweeps = remove_run_ups(quiet, heard if quiet is good else None)
    clean, echo = remove_echo(still)
    notes: tuple[str, ...] = ()
    if strokes:
        notes += (
            f"{strokes.count} blows {strokes.interval:.3g} s apart (a press, a pile driver): the "
            "mean response to "
            "them is taken out",
        )
    if sweeps:
        low, high = min(x.low for x in sweeps), max(x.high for x in sweeps)
        notes += (
            f"{len(sweeps)} tone{'s' if len(sweeps) > 1 else ''} of changing frequency between "
            f"{low:.3g} and "
            f"{high:.3g} Hz (run-ups of machines): taken out where and when they stood",
        )
    if echo:
        notes += (
            f"the force comes again {echo.delay:.3g} s later, times {echo.factor:.2g} (two "
            "axles, a reflection): its "
            "spectrum ripples; taken out as far as noise and resonances let it be seen",
        )
    if whole is good:
        whole = clean
    elif whole and clean is not good:
        whole = clean.pick([c.id for c in whole.channels])
    return clean, whole, notes, echo


def steady_sines(
    good: TimeHistory,
    whole: TimeHistory | None,
    bands: tuple[Band, ...],
    leave: tuple[float, ...],
    impacts: Events,
    *,
    once: bool,
) -> tuple[Harmonic, ...]:
    """Lines that are taken out, but for those to `leave`; with one look at the record, only those
    without a foot.

    Impacts at equal intervals have lines of their own, in which the decays after them are: no
    machine makes these.
    """
    if whole is None:
        return ()
    found = find_tonal_lines(whole, low=bands[-1].low, high=bands[0].high)
    found = tuple(h for h in found if all(abs(h.frequency / f - 1) > 1e-5 for f in leave))
    own = impacts.in_step(np.array([h.frequency for h in found]))
    found = tuple(h for h, of_impacts in zip(found, own, strict=True) if not of_impacts)
    places = [h.frequency for h in found]
    unsteady = unsteady_lines(remove_tonal_lines(good, places), places) if once else ()
    return tuple(h for h in found if h.frequency not in unsteady)


def gathered(
    good: TimeHistory,
    gaps: Gaps,
    coming: Iterable[TimeHistory],
    bands: tuple[Band, ...],
    ssi: SsiCov,
    refs: Int | None,
    places: list[float],
    tell: Progress,
) -> tuple[list[BandSums], list[Events]]:
    """Sums of each band over all stretches, and the events of each stretch."""
    heard = [events_of(good, gaps)]
    sums = begin(good.data, good.rate, bands, ssi, refs, heard[0])
    duration = good.duration

    def told() -> Iterator[tuple[list[BandSums], TimeHistory]]:  # each with the sums so far
        nonlocal duration
        for part in coming:
            tell(0.0, f"filtering into bands, {duration:.4g} s done")
            yield sums, part
            duration += part.duration

    for got, events in map_in_threads(lambda x: _one(*x, good, places), told()):
        sums = joined(sums, got)
        heard.append(events)
    return sums, heard


def with_more_lags(
    good: TimeHistory, gaps: Gaps, bands: tuple[Band, ...], ssi: SsiCov, refs: Int | None
) -> BandSums:
    """The last of the `bands` of a record with lags and orders for modes that stand close to each
    other.
    """
    more = replace(ssi, block_rows=MORE_LAGS * ssi.block_rows, order_max=3 * ssi.order_max // 2)
    return begin(good.data, good.rate, bands, more, refs, events_of(good, gaps))[-1]


def events_of(part: TimeHistory, gaps: Gaps) -> Events:
    """The events of a stretch, none where samples are lost."""
    return find_events(part.data, part.rate, gaps.cut(part.data.shape[1]))


def _one(
    sums: list[BandSums], coming: TimeHistory, first: TimeHistory, places: list[float]
) -> tuple[list[BandSums], Events]:
    """The bands of one more stretch and its events."""
    part = (
        coming if coming.channels == first.channels else coming.pick([c.id for c in first.channels])
    )
    if not np.isclose(part.rate, first.rate):
        raise DataError(
            f"{coming.source}: a stretch at {part.rate} Hz in a record at {first.rate} Hz"
        )
    whole, gaps = bridge_gaps(part)
    if len(whole.channels) < len(part.channels):
        raise DataError(f"{coming.source}: {gaps.notes[0]}: leave it out of all stretches")
    part = remove_drift(whole, sums[-1].band.low)
    impacts = events_of(part, gaps)
    part = remove_tonal_lines(
        without_strokes_sweeps_and_echoes(part, None, impacts, sums[0].seconds)[0], places
    )
    events = events_of(part, gaps)
    out = of_stretch(sums, part.data, part.rate, events)
    same = likeness([x.spectra for x in sums], [x.spectra for x in out])
    if same < MOVED:
        raise DataError(
            f"{coming.source}: it moves in other shapes than the record before it (they have "
            f"{100 * same:.0f} % in "
            "common): were sensors moved? Identify each setup by itself; a study joins them "
            "(`setup` in its log)"
        )
    lost = np.asarray(~np.isfinite(out[0].parts[0]).all((0, 1, 3)))
    if lost.any():
        bad = [c.id for c, x in zip(part.channels, lost, strict=True) if x]
        raise DataError(
            f"{coming.source}: channels {' '.join(bad[:8])} fail later in the record; leave them "
            "out"
        )
    return out, events
