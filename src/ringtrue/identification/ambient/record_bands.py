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

import numpy as np
from scipy.fft import prev_fast_len, rfft

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.progress import Progress
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.maximum_likelihood import RELATIVE, SpectralBins
from ringtrue.identification.ambient.ssi_cov import MAX_REFERENCES, SsiCov, spanning
from ringtrue.identification.common import uncertainty as var
from ringtrue.signal import band_correlations
from ringtrue.signal.band_correlations import Signals, map_in_threads
from ringtrue.signal.decimation import Band, Fir, decimator, high_passer, remove_drift
from ringtrue.signal.echoes import Echo, remove_echo
from ringtrue.signal.gaps import Gaps, bridge_gaps
from ringtrue.signal.run_ups import channel_mixes, remove_run_ups
from ringtrue.signal.tonal_lines import (
    Harmonic,
    find_tonal_lines,
    remove_tonal_lines,
    unsteady_lines,
)
from ringtrue.signal.transients import NONE, Events, find_events, remove_regular_impacts

SPECTRAL_CHANNELS = 16  # that separate the modes for the maximum likelihood fit
STEP = 4  # from one rate to the next
MOST_BLOCKS = 32
NOTHING = SpectralBins(np.empty(0), np.empty(0), np.empty((0, 0, 0)), 0.0)
# decays over all lags that are too many, those that tell most; block rows
LONG = 5.0
TELLING = 2.2
FEWEST_ROWS = 10
PERIODOGRAM = 1 << 18  # samples at the rate of a band: lines finer than the bins
MORE_LAGS = 3
SHORTEST = 0.5  # stretch, over the first: edges of the filters would weigh too much
MOVED = 0.9  # share of the shapes: of one setup 0.99 and more, of moved sensors 0.3 to 0.8
AVERAGES = 2  # of the spectra, over the number of channels
CLEAR = 10.0  # times the second singular value
FEWEST = 3  # channels: any shape lies in a plane of two


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
        return replace(self.spectra, cross=self.spectra.cross / np.float32(self.stretches))


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
        both, spectra=replace(x, count=x.count + y.count, lost=lost, breaks=breaks), stretches=n + 1
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


def _filters(band: Band, last: bool) -> tuple[Fir, Fir]:
    """What leaves out all below a third of the lower limit, and the decimation to the next rate."""
    high = high_passer(min(band.low / 1.5, 0.24 * band.rate), band.rate)
    return high, Fir(np.ones(1)) if last else decimator(STEP)


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
    for band in bands:
        rows = int(np.clip(y.samples // 60, 10, ssi.block_rows))
        blocks = ssi.blocks or var.blocks_for(y.samples, 2 * rows - 1)
        own = replace(ssi, block_rows=rows)
        high, down = _filters(band, band is bands[-1])
        cut = band_correlations.segments(y.samples, blocks, 2 * rows - 1, high, down)
        scale, lagged = band_correlations.glance(y, cut, high)
        refs = spanning(lagged, MAX_REFERENCES) if references is None else references
        eyes = spanning(lagged, SPECTRAL_CHANNELS)
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
        got, y = _pass(first, y, events, band is bands[-1])
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
    for x in sums:
        got, y = _pass(x, y, events, x is sums[-1])
        out.append(got)
    return out


def with_fewer_lags(x: BandSums, decay: float) -> BandSums | None:
    """The sums without the lags at which a motion of this decay, 1/s, has died away; None where few
    have that.

    Noise is all that these tell of it; modes of little damping need them.
    """
    rows = max(int(x.ssi.block_rows * TELLING / max(decay * x.seconds, TELLING)), FEWEST_ROWS)
    if decay * x.seconds < LONG or rows >= x.ssi.block_rows:
        return None
    return replace(
        x, ssi=replace(x.ssi, block_rows=rows), parts=tuple(p[:, : 2 * rows] for p in x.parts)
    )


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


def _pass(x: BandSums, y: Signals, events: Events, last: bool) -> tuple[BandSums, Signals]:
    """The sums of one stretch at the rate of its band, and the signals of the next one."""
    high, down = _filters(x.band, last)
    cut = band_correlations.segments(y.samples, x.blocks, 2 * x.ssi.block_rows - 1, high, down)
    keep = events.free(y.samples, x.band.rate, cut.lags)
    share = band_correlations.pairs(cut, y.samples, keep)[:, 0] / (cut.each * cut.hop)
    r, lower = band_correlations.run(y, cut, high, down, x.references, keep)
    scale = x.scale.astype(np.float32)
    r /= scale[:, None] * scale[x.references]
    spectra = _binned(y, x.eyes, x.band, 1 / scale[x.eyes])
    spectra = replace(
        spectra, count=spectra.count * events.kept, lost=1 - events.kept, breaks=events.breaks
    )
    return replace(
        x, parts=(r,), shares=(share,), spectra=spectra, stretches=1
    ), band_correlations.detrended(lower)


def _binned(y: Signals, eyes: Int, band: Band, scale: Any_) -> SpectralBins:
    """Spectral matrices of some channels times `scale` (eye,), in bins of constant relative width.

    Transforms of a long record are slow, and finer than the bins: it is taken in parts.
    """
    parts = max(1, round(y.samples / PERIODOGRAM))
    n = int(prev_fast_len(y.samples // parts, real=True))
    low, high = span(band)
    first = int(np.ceil(max(low * n / band.rate, 1)))
    last = int(min(high * n / band.rate, n // 2 - 1))
    lines = np.empty((last + 1 - first, parts, eyes.size), dtype=np.complex64)
    unit = np.outer(scale, scale).astype(np.float32) * np.float32(2 / (n * band.rate * parts))
    edges = [first]
    while edges[-1] <= last:  # sub-bands, with bins of one width each
        edges.append(max(int(edges[-1] * 1.2), edges[-1] + 1))
    for k in range(parts):
        start = k * (y.samples // parts)
        lines[:, k] = rfft(y.part(start, start + n, eyes), axis=1)[:, first : last + 1].T
    found = [_sub_band(lines[a - first : b - first], a, unit) for a, b in pairwise(edges)]
    f, count, cross = (np.concatenate(x) for x in zip(*found, strict=True))
    return SpectralBins(f * band.rate / n, count, cross, n / band.rate)


def _sub_band(y: Any_, first: int, unit: Any_) -> tuple[Float, Float, Any_]:
    """Place in lines, lines averaged and matrix of the bins of `y` (line, part, eye) from line
    `first`.
    """
    k = max(1, min(int(RELATIVE * first), len(y)))
    m = len(y) // k
    z = y[: m * k].reshape(m, -1, y.shape[2])
    cross = z.transpose(0, 2, 1) @ z.conj()
    cross *= unit / np.float32(k)
    place = np.asarray(first + np.arange(m) * k + 0.5 * (k - 1), dtype=np.float64)
    return place, np.full(m, float(k * y.shape[1])), cross


def span(band: Band) -> tuple[float, float]:
    """Frequencies of the spectra, Hz: a little more than the band."""
    return max(0.7 * band.low, 0.02 * band.rate), min(1.15 * band.high, 0.4 * band.rate)


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
        quiet = good
        strokes = None
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
        low = min(x.low for x in sweeps)
        high = max(x.high for x in sweeps)
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


def sums_of_stretches(
    good: TimeHistory,
    gaps: Gaps,
    coming: Iterable[TimeHistory],
    bands: tuple[Band, ...],
    ssi: SsiCov,
    refs: Int | None,
    places: list[float],
    report: Progress,
) -> tuple[list[BandSums], list[Events]]:
    """Sums of each band over all stretches, and the events of each stretch."""
    heard = [events_of(good, gaps)]
    sums = first_sums(good.data, good.rate, bands=bands, ssi=ssi, references=refs, events=heard[0])
    duration = good.duration

    def with_sums() -> Iterator[tuple[list[BandSums], TimeHistory]]:  # each with the sums so far
        nonlocal duration
        for part in coming:
            report(0.0, f"filtering into bands, {duration:.4g} s done")
            yield sums, part
            duration += part.duration

    for got, events in map_in_threads(lambda x: _one(*x, good, places), with_sums()):
        sums = joined_sums(sums, got)
        heard.append(events)
    return sums, heard


def with_more_lags(
    good: TimeHistory, gaps: Gaps, bands: tuple[Band, ...], ssi: SsiCov, refs: Int | None
) -> BandSums:
    """The last of the `bands` of a record with lags and orders for modes that stand close to each
    other.
    """
    more = replace(ssi, block_rows=MORE_LAGS * ssi.block_rows, order_max=3 * ssi.order_max // 2)
    return first_sums(
        good.data, good.rate, bands=bands, ssi=more, references=refs, events=events_of(good, gaps)
    )[-1]


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
    out = stretch_sums(sums, part.data, part.rate, events)
    same = shared_shapes([x.spectra for x in sums], [x.spectra for x in out])
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


def shared_shapes(first: Sequence[SpectralBins], other: Sequence[SpectralBins]) -> float:
    """Mean share of the shapes that both records have in common, by the power of the lines; 1 where
    nothing is clear.

    Parameters
    ----------
    first, other : sequence of SpectralBins
        The bands of two records, of the same channels.
    """
    shares = [np.ones(1)]
    weights = [np.full(1, np.finfo(np.float64).tiny)]
    for a, b in zip(first, other, strict=True):
        if a.freqs.shape != b.freqs.shape or not a.freqs.size or a.cross.shape[1] < FEWEST:
            continue
        groups = np.cumsum(b.count) // (AVERAGES * a.cross.shape[1])
        starts = np.unique(groups, return_index=True)[1]
        one, two = (_shapes(x, starts) for x in (a, b))
        clear = one[2] & two[2]
        share = np.maximum(_within(one[0], two[0]), _within(two[0], one[0]))
        power = np.sqrt(one[1] * two[1])
        shares.append(share[clear])
        weights.append(power[clear])
    return float(np.average(np.concatenate(shares), weights=np.concatenate(weights)))


def _shapes(bins: SpectralBins, starts: Any_) -> tuple[Any_, Float, Any_]:
    """First two singular vectors (line, ch, 2), the share of each line in the power, and which
    lines are clear.
    """
    cross = np.add.reduceat(bins.cross * bins.count[:, None, None], starts).astype(np.complex128)
    values, vectors = np.linalg.eigh(cross)
    power = values[:, -1] / max(float(values.sum()), np.finfo(np.float64).tiny)
    return vectors[:, :, -2:], power, values[:, -1] > CLEAR * values[:, -2]


def _within(plane: Any_, shapes: Any_) -> Float:
    """(line,) share of the first vectors of `shapes` in the planes (line, ch, 2)."""
    inside = np.einsum("lcp,lc->lp", plane.conj(), shapes[:, :, -1])
    return np.asarray((np.abs(inside) ** 2).sum(axis=1))
