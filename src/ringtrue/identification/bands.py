"""What the bands of the pyramid keep of a record, however long: blocks of correlations and binned
spectra.

Each band is a pass over the signals at its rate, which also gives those of the next one, a quarter
of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import prev_fast_len, rfft

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.identification import variance as var
from ringtrue.identification.ssi import MAX_REFERENCES, SsiCov, spanning
from ringtrue.identification.whittle import RELATIVE, SpectralBins
from ringtrue.signal import band_correlations
from ringtrue.signal.band_correlations import Signals
from ringtrue.signal.decimation import Band, Fir, decimator, high_passer
from ringtrue.signal.transients import NONE, Events

SPECTRAL_CHANNELS = 16  # that separate the modes for the maximum likelihood fit
STEP = 4  # from one rate to the next
MOST_BLOCKS = 32
NOTHING = SpectralBins(np.empty(0), np.empty(0), np.empty((0, 0, 0)), 0.0)
LONG, TELLING, FEWEST_ROWS = (
    5.0,
    2.2,
    10,
)  # decays over all lags that are too many, those that tell most; block rows
PERIODOGRAM = 1 << 18  # samples at the rate of a band: lines finer than the bins


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
    parts, shares = (*a.parts, *b.parts), (*a.shares, *b.shares)
    both = replace(a, parts=parts, shares=shares)
    if sum(len(p) for p in parts) > MOST_BLOCKS:
        both = _in_pairs(both)
    x, y = a.spectra, b.spectra
    if x.freqs.shape != y.freqs.shape or not np.isclose(x.duration, y.duration):
        return both
    np.add(x.cross, y.cross, out=x.cross)  # in place: these are the largest arrays
    n = a.stretches
    lost, breaks = (n * x.lost + y.lost) / (n + 1), (n * x.breaks + y.breaks) / (n + 1)
    return replace(
        both, spectra=replace(x, count=x.count + y.count, lost=lost, breaks=breaks), stretches=n + 1
    )


def _in_pairs(x: BandSums) -> BandSums:
    """Half as many blocks, twice as long."""
    r, share = x.r, x.share
    n = len(r) // 2
    share = share[: 2 * n].reshape(n, 2)
    each = (share / share.sum(1, keepdims=True)).astype(np.float32)
    r = np.einsum("bpkij,bp->bkij", r[: 2 * n].reshape(n, 2, *r.shape[1:]), each)
    return replace(x, parts=(r,), shares=(share.mean(1),), blocks=max(x.blocks // 2, 1))


def _filters(band: Band, last: bool) -> tuple[Fir, Fir]:
    """What leaves out all below a third of the lower limit, and the decimation to the next rate."""
    high = high_passer(min(band.low / 1.5, 0.24 * band.rate), band.rate)
    return high, Fir(np.ones(1)) if last else decimator(STEP)


def begin(
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
        first = BandSums(band, own, blocks, refs, eyes, scale, (), (), NOTHING, 0)
        got, y = _pass(first, y, events, band is bands[-1])
        out.append(got)
    return out


def of_stretch(
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


def joined(sums: list[BandSums], stretch: list[BandSums]) -> list[BandSums]:
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
    first, last = (
        int(np.ceil(max(low * n / band.rate, 1))),
        int(min(high * n / band.rate, n // 2 - 1)),
    )
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
