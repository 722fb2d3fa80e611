"""Correlations and binned spectra of the bands of a record, summed over its stretches.

Each band is a pass over the signals at its rate, which also gives those of the next band, a quarter
of it. What is kept does not grow with the record. The files of one record must be of one setup:
where one mode is most of the motion, the first singular vector of the spectral matrix is its shape
(Brincker, Zhang and Andersen 2001), in each file anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.iterate import Progress
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.spectral_bins import SpectralBins, spectral_bins
from ringtrue.identification.ambient.ssi_cov import MAX_REFERENCES, SsiCov, spanning
from ringtrue.identification.common import uncertainty as var
from ringtrue.signal import band_correlations
from ringtrue.signal.band_correlations import Signals, map_in_threads
from ringtrue.signal.channel_checks import Gaps, bridge_gaps
from ringtrue.signal.machines import Machine, find_machines, remove_machines
from ringtrue.signal.spectra import Band, Fir, decimator, high_passer, remove_drift
from ringtrue.signal.tonal_lines import (
    Harmonic,
    channel_mixes,
    find_tonal_lines,
    remove_run_ups,
    remove_tonal_lines,
)
from ringtrue.signal.transients import NONE, Events, find_events, remove_regular_impacts

STEP = 4  # from one rate to the next
MOST_BLOCKS = 32  # of a record, all stretches together
NOTHING = SpectralBins(np.empty(0), np.empty(0), np.empty((0, 0, 0)), 0.0)


def too_short(stretch: float, first: float) -> bool:
    """Whether the edges of the filters would weigh too much in a stretch, s, of less than half of
    the first one, s.
    """
    return stretch < first / 2


@dataclass(frozen=True, slots=True, eq=False)
class BandSums:
    """What one band keeps.

    Attributes
    ----------
    band : Band
    ssi : SsiCov
    blocks : int
        Blocks of one stretch.
    references, eyes : (ref,), (eye,) int64
        Channels of the correlations, and those of the spectra.
    scale : (ch,) float64
        Root mean squares of the first stretch.
    parts : tuple of (block, lag, ch, ref) float32
        Correlations of each stretch, in units of `scale`.
    shares : tuple of (block,) float64
        Share of the pairs of samples of each block that were used.
    spectra : SpectralBins
        Of the eyes, in units of `scale`, summed over the stretches.
    stretches : int
        In these spectra.
    """

    band: Band
    ssi: SsiCov
    blocks: int
    references: Int
    eyes: Int
    scale: Float
    parts: tuple[Any_, ...]
    shares: tuple[Float, ...]
    spectra: SpectralBins
    stretches: int

    @property
    def r(self) -> Any_:
        """(block, lag, ch, ref) float32 correlations."""
        return self.parts[0] if len(self.parts) == 1 else np.concatenate(self.parts)

    @property
    def seconds(self) -> float:
        """The longest lag."""
        return 2 * self.ssi.block_rows / self.band.rate

    @property
    def share(self) -> Float:
        """(block,) share of the pairs that were used."""
        return np.concatenate(self.shares)

    @property
    def bins(self) -> SpectralBins:
        """Mean spectra."""
        if self.stretches == 1:
            return self.spectra
        return replace(
            self.spectra, cross=self.spectra.cross / np.float32(self.stretches)
        )


def _added(a: BandSums, b: BandSums) -> BandSums:
    """Both; `a` gives its arrays away. Pairs of blocks are joined when they become many, and later
    ones are as long.
    """
    b = _in_pairs(b) if b.blocks > a.blocks else b
    parts = (*a.parts, *b.parts)
    shares = (*a.shares, *b.shares)
    both = replace(a, parts=parts, shares=shares)
    if sum(len(p) for p in parts) > MOST_BLOCKS:
        both = _in_pairs(both)
    x = a.spectra
    y = b.spectra
    if x.freqs.shape != y.freqs.shape or not np.isclose(x.duration, y.duration):
        return both
    np.add(x.cross, y.cross, out=x.cross)  # in place: these are the largest arrays
    n = a.stretches
    lost = (n * x.lost + y.lost) / (n + 1)
    breaks = (n * x.breaks + y.breaks) / (n + 1)
    return replace(
        both,
        spectra=replace(x, count=x.count + y.count, lost=lost, breaks=breaks),
        stretches=n + 1,
    )


def _in_pairs(x: BandSums) -> BandSums:
    """Half as many blocks, twice as long."""
    r = x.r
    share = x.share
    n = len(r) // 2
    share = share[: 2 * n].reshape(n, 2)
    each = (share / share.sum(1, keepdims=True)).astype(np.float32)
    r = np.einsum("bpkij,bp->bkij", r[: 2 * n].reshape(n, 2, *r.shape[1:]), each)
    return replace(x, parts=(r,), shares=(share.mean(1),), blocks=max(x.blocks // 2, 1))


def _filters(band: Band, factor: int) -> tuple[Fir, Fir]:
    """What leaves out all below a third of the lower limit, and the decimation to the next rate."""
    high = high_passer(min(band.low / 1.5, 0.24 * band.rate), band.rate)
    return high, Fir(np.ones(1)) if factor == 1 else decimator(factor)


def _steps(bands: Sequence[Band]) -> list[int]:
    """From the rate of each band to that of the next, 1 for the last."""
    return [round(a.rate / b.rate) for a, b in pairwise((*bands, bands[-1]))]


def _block_rows(samples: int, most: int) -> int:
    """So many that the longest lag is a thirtieth of the record."""
    return int(np.clip(samples // 60, 10, most))


def bands_of_use(
    bands: tuple[Band, ...], duration: float, events: Events, block_rows: int
) -> tuple[Band, ...]:
    """The bands of a pyramid whose longer lags are of use; the one above goes down in the place of
    the others.

    In a short record there is one band: its length bounds the lags at any rate. Where events
    drive the record, correlations must end before the next event, as at equal intervals what
    reaches across does not average out: it is lines at all multiples of one over the interval.
    Bands below the first line see a force that lasts.
    """
    low = bands[-1].low
    if _block_rows(int(duration * bands[0].rate), block_rows) < block_rows:
        return (replace(bands[0], low=low),)
    ends = [events.ends_before_next(2 * block_rows / b.rate) for b in bands]
    if not events.driven or not ends[0] or all(ends):
        return bands
    first = ends.index(False)
    line = max(1 / events.interval, low)
    slow = [replace(b, high=min(b.high, line)) for b in bands[first:] if b.low < line]
    return (*bands[: first - 1], replace(bands[first - 1], low=line), *slow)


def first_sums(
    data: Any_,
    rate: float,
    bands: tuple[Band, ...],
    ssi: SsiCov,
    references: Int | None,
    events: Events = NONE,
) -> list[BandSums]:
    """The bands of the first stretch `data` (ch, sample) at `rate` Hz.

    Parameters
    ----------
    ssi : SsiCov
        `block_rows` is cut where samples are few; `blocks` 0 chooses.
    references : (ref,) int64
        None: each band chooses at most 8.
    events : Events
        Of this stretch.
    """
    y = _at_first_rate(data, rate, bands)
    out = []
    for band, factor in zip(bands, _steps(bands), strict=True):
        rows = _block_rows(y.samples, ssi.block_rows)
        blocks = ssi.blocks or var.blocks_for(y.samples, 2 * rows - 1)
        own = replace(ssi, block_rows=rows)
        high, down = _filters(band, factor)
        cut = band_correlations.segments(
            y.samples, blocks, 2 * rows - 1, high, down, references=MAX_REFERENCES
        )
        scale, lagged = band_correlations.glance(y, cut, high)
        refs = spanning(lagged, MAX_REFERENCES) if references is None else references
        # they separate the modes for the maximum likelihood fit
        eyes = spanning(lagged, 16)
        first = BandSums(
            band=band,
            ssi=own,
            blocks=blocks,
            references=refs,
            eyes=eyes,
            scale=scale,
            parts=(),
            shares=(),
            spectra=NOTHING,
            stretches=0,
        )
        got, y = _pass(first, y, events, factor)
        out.append(got)
    return out


def stretch_sums(
    sums: list[BandSums], data: Any_, rate: float, events: Events = NONE
) -> list[BandSums]:
    """One more stretch `data` (ch, sample) at `rate` Hz alone, by the references and scales of the
    `sums`.
    """
    y = _at_first_rate(data, rate, tuple(x.band for x in sums))
    out = []
    for x, factor in zip(sums, _steps([x.band for x in sums]), strict=True):
        got, y = _pass(x, y, events, factor)
        out.append(got)
    return out


def joined_sums(sums: list[BandSums], stretch: list[BandSums]) -> list[BandSums]:
    """The bands with one more stretch; those of before are used up."""
    return [_added(a, b) for a, b in zip(sums, stretch, strict=True)]


def _at_first_rate(data: Any_, rate: float, bands: tuple[Band, ...]) -> Signals:
    y = Signals.of(data)
    factor = round(rate / bands[0].rate)
    return (
        band_correlations.detrended(band_correlations.lowered(y, decimator(factor)))
        if factor > 1
        else y
    )


def _pass(
    x: BandSums, y: Signals, events: Events, factor: int
) -> tuple[BandSums, Signals]:
    """The sums of one stretch at the rate of its band, and the signals of the next one."""
    high, down = _filters(x.band, factor)
    cut = band_correlations.segments(
        y.samples,
        x.blocks,
        2 * x.ssi.block_rows - 1,
        high,
        down,
        references=x.references.size,
    )
    keep = events.free(y.samples, x.band.rate, cut.lags)
    share = band_correlations.pairs(cut, y.samples, keep)[:, 0] / (cut.each * cut.hop)
    r, lower = band_correlations.run(
        y, cut, high, down, references=x.references, keep=keep
    )
    scale = x.scale.astype(np.float32)
    r /= scale[:, None] * scale[x.references]
    low = 0.7 * x.band.low
    high_end = min(1.15 * x.band.high, 0.4 * x.band.rate)
    spectra = spectral_bins(
        y, x.eyes, rate=x.band.rate, limits=(low, high_end), scale=1 / scale[x.eyes]
    )
    spectra = replace(
        spectra,
        count=spectra.count * events.kept,
        lost=1 - events.kept,
        breaks=events.breaks,
    )
    return replace(
        x, parts=(r,), shares=(share,), spectra=spectra, stretches=1
    ), band_correlations.detrended(lower)


@dataclass(frozen=True, slots=True, eq=False)
class FirstStretch:
    """The first stretch of a record, ready for the bands.

    Attributes
    ----------
    good : TimeHistory
        Usable channels in step, without lines, regular impacts and run-ups.
    unclipped : TimeHistory, optional
        Those of its channels whose amplitude is not cut off; None if all are.
    gaps : Gaps
    events : Events
        Of `good`.
    factor : float
        Unit of `good`.
    references : (ref,) int64, optional
    bands : tuple of Band
    sines : tuple of Harmonic
        Lines of steady machines that were taken out.
    machines : tuple of Machine
        Whose harmonics were taken out.
    steady : bool
        Whether no impacts drive it: a steady amplitude then means a machine.
    notes : tuple of str
    channel_notes : tuple of Note
    """

    good: TimeHistory
    unclipped: TimeHistory | None
    gaps: Gaps
    events: Events
    factor: float
    references: Int | None
    bands: tuple[Band, ...]
    sines: tuple[Harmonic, ...]
    machines: tuple[Machine, ...]
    steady: bool
    notes: tuple[str, ...]
    channel_notes: tuple[Note, ...]

    @property
    def places(self) -> list[float]:
        """Frequencies of the lines that were taken out, Hz."""
        return [sine.frequency for sine in self.sines]


@dataclass(frozen=True, slots=True, eq=False)
class WithoutMachines:
    """A record without regular impacts, run-ups and harmonics of machines.

    Attributes
    ----------
    good : TimeHistory
    unclipped : TimeHistory, optional
        Some channels of `good`.
    machines : tuple of Machine
    notes : tuple of str
        What was taken out.
    """

    good: TimeHistory
    unclipped: TimeHistory | None
    machines: tuple[Machine, ...]
    notes: tuple[str, ...]


def without_machines(
    good: TimeHistory,
    unclipped: TimeHistory | None,
    impacts: Events,
    longest_lag: float,
) -> WithoutMachines:
    """The record without the regular impacts, run-ups and harmonics of machines.

    Where decays after `impacts` are most of the motion, modes are found in them: they stay, if the
    next impact comes after twice the `longest_lag`, s, of the highest band.
    """
    mixes = channel_mixes(good.data)
    quiet, press = remove_regular_impacts(good, mixes)
    if press and impacts.driven and press.interval > 2 * longest_lag:
        quiet = good
        press = None
    clean, sweeps = remove_run_ups(quiet, mixes if quiet is good else None)
    notes: tuple[str, ...] = ()
    if press:
        notes += (
            f"{press.count} impacts, one in {press.interval:.3g} s (a press, a pile driver): the "
            "mean response to them is taken out",
        )
    if sweeps:
        low = min(x.low for x in sweeps)
        high = max(x.high for x in sweeps)
        notes += (
            f"{len(sweeps)} tone{'s' if len(sweeps) > 1 else ''} of changing frequency between "
            f"{low:.3g} and {high:.3g} Hz (run-ups of machines): taken out where and when they "
            "stood",
        )
    machines = () if impacts.driven else find_machines(clean)
    clean = remove_machines(clean, machines)
    for machine in machines:
        values: dict[str, float | int] = {
            "speed": machine.frequency,
            "rpm": 60 * machine.frequency,
            "wander": 100 * machine.wander,
            "count": machine.harmonics.size,
            "last": int(machine.harmonics.max(initial=0)),
        }
        notes += (sentence(Note("machine", "information", good.source, values)),)
    if unclipped is good:
        unclipped = clean
    elif unclipped and clean is not good:
        unclipped = clean.pick([c.id for c in unclipped.channels])
    return WithoutMachines(clean, unclipped, machines, notes)


def steady_sines(
    unclipped: TimeHistory | None, bands: tuple[Band, ...], impacts: Events
) -> tuple[Harmonic, ...]:
    """Lines of machines of steady speed.

    Impacts at equal intervals have lines of their own, in which the decays after them are: no
    machine makes these.
    """
    if unclipped is None:
        return ()
    lines = find_tonal_lines(unclipped, low=bands[-1].low, high=bands[0].high)
    of_impacts = impacts.in_step(np.array([line.frequency for line in lines]))
    return tuple(line for line, own in zip(lines, of_impacts, strict=True) if not own)


def sums_of_stretches(
    record: FirstStretch, coming: Iterable[TimeHistory], ssi: SsiCov, report: Progress
) -> tuple[list[BandSums], list[Events]]:
    """Sums of each band over all stretches, and the events of each stretch.

    Parameters
    ----------
    record : FirstStretch
    coming : iterable of TimeHistory
        The stretches after the first.
    ssi : SsiCov
    report : callable (fraction, text)
    """
    good = record.good
    events = [record.events]
    sums = first_sums(
        good.data,
        good.rate,
        bands=record.bands,
        ssi=ssi,
        references=record.references,
        events=events[0],
    )
    duration = good.duration

    # each with the sums so far
    def with_sums() -> Iterator[tuple[list[BandSums], TimeHistory]]:
        nonlocal duration
        for part in coming:
            report(0.0, f"filtering into bands, {duration:.4g} s done")
            yield sums, part
            duration += part.duration

    for got, own in map_in_threads(lambda x: _next_stretch(*x, record), with_sums()):
        sums = joined_sums(sums, got)
        events.append(own)
    return sums, events


def events_of(part: TimeHistory, gaps: Gaps) -> Events:
    """The events of a stretch, none where samples are lost."""
    return find_events(part.data, part.rate, gaps.cut(part.data.shape[1]))


def _next_stretch(
    sums: list[BandSums], coming: TimeHistory, record: FirstStretch
) -> tuple[list[BandSums], Events]:
    """The bands of one more stretch and its events."""
    first = record.good
    part = coming
    if coming.channels != first.channels:
        part = coming.pick([c.id for c in first.channels])
    if not np.isclose(part.rate, first.rate):
        raise DataError(
            f"{coming.source}: a stretch at {part.rate} Hz in a record at {first.rate} Hz"
        )
    whole, gaps = bridge_gaps(part)
    if len(whole.channels) < len(part.channels):
        raise DataError(
            f"{coming.source}: {sentence(gaps.notes[0])}: leave it out of all stretches"
        )
    part = remove_drift(whole, sums[-1].band.low)
    part = without_machines(part, None, events_of(part, gaps), sums[0].seconds).good
    part = remove_tonal_lines(part, record.places)
    events = events_of(part, gaps)
    out = stretch_sums(sums, part.data, part.rate, events)
    same = shared_shapes([x.spectra for x in sums], [x.spectra for x in out])
    if same < 0.9:  # of one setup nearer to 1, of moved sensors far less
        raise DataError(
            f"{coming.source}: it moves in other shapes than the record before it (they have "
            f"{100 * same:.0f} % in common): sensors that were moved make setups, not one record. "
            "Give them by `ringtrue oma --setups table.csv`, a row for each channel of each file: "
            "file,channel,point,direction,reference such as "
            f"{Path(coming.source).name},1,101,+Z,yes (yes: this sensor stayed in place)"
        )
    lost = np.flatnonzero(~np.isfinite(out[0].parts[0]).all((0, 1, 3)))
    if lost.size:
        bad = " ".join(part.channels[k].id for k in lost[:8].tolist())
        raise DataError(
            f"{coming.source}: channels {bad} fail later in the record; leave them out"
        )
    return out, events


def shared_shapes(
    first: Sequence[SpectralBins], other: Sequence[SpectralBins]
) -> float:
    """Mean share of the shapes that both records have in common, 1 where nothing is clear.

    The least of two means: by the power of the lines, and of lines and channels of equal weight.
    Sensors that stay may be most of the motion of the loudest mode, and one that
    measures nothing has noise alone to compare.

    Parameters
    ----------
    first, other : sequence of SpectralBins
        The bands of two records, of the same channels.
    """
    by_power = [(np.ones(1), np.full(1, np.finfo(np.float64).tiny))]
    common = [np.ones(0)]
    for a, b in zip(first, other, strict=True):
        if a.freqs.shape != b.freqs.shape or not a.freqs.size or a.cross.shape[1] < 3:
            continue  # any shape lies in a plane of two channels
        groups = np.cumsum(b.count) // (2 * a.cross.shape[1])
        starts = np.unique(groups, return_index=True)[1]
        one, two = (
            np.add.reduceat(x.cross * x.count[:, None, None], starts).astype(
                np.complex128
            )
            for x in (a, b)
        )
        share, power = _common_shapes(one, two)
        by_power.append((share, power))
        level = 1 / np.sqrt(
            np.maximum(_channel_shares(one) + _channel_shares(two), 1e-12)
        )
        balance = np.outer(level, level)
        common.append(_common_shapes(one * balance, two * balance)[0])
    shares, weights = (np.concatenate(x) for x in zip(*by_power, strict=True))
    lines = np.concatenate(common)
    return min(
        float(np.average(shares, weights=weights)),
        float(lines.mean()) if lines.size else 1,
    )


def _channel_shares(cross: Any_) -> Float:
    """(ch,) mean share of each channel in the power of a line, of spectra (line, ch, ch)."""
    power = np.einsum("lcc->lc", cross).real
    total = np.maximum(power.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return np.asarray((power / total).mean(axis=0))


def _common_shapes(one: Any_, two: Any_) -> tuple[Float, Float]:
    """Share of the shapes that the spectra (line, ch, ch) of two records have in common, and the
    power of these lines: those with a first singular value ten times the second.
    """
    found = []
    for cross in (one, two):
        values, vectors = np.linalg.eigh(cross)
        power = values[:, -1] / max(float(values.sum()), np.finfo(np.float64).tiny)
        found.append((vectors[:, :, -2:], power, values[:, -1] > 10.0 * values[:, -2]))
    (a, power_a, clear_a), (b, power_b, clear_b) = found
    share = np.maximum(_within(a, b), _within(b, a))
    clear = clear_a & clear_b
    return share[clear], np.sqrt(power_a * power_b)[clear]


def _within(plane: Any_, shapes: Any_) -> Float:
    """(line,) share of the first vectors of `shapes` in the planes (line, ch, 2)."""
    inside = np.einsum("lcp,lc->lp", plane.conj(), shapes[:, :, -1])
    return np.asarray((np.abs(inside) ** 2).sum(axis=1))
