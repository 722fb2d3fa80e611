"""Output-only identification in one call: a pyramid of bands, every order in each, modes with their uncertainty.

A wide band at a high rate spans a fraction of a period of a slow mode with its lags, so the record is decimated by
four again and again; each band keeps 0.06 to 0.34 of its rate and overlaps the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import TimeHistory
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import ConfigError, DataError
from ringtrue.identify import variance as var
from ringtrue.identify.poles import PoleSet, StableDiagram
from ringtrue.identify.ssi import BandPoles, SsiCov, all_orders, blockwise, identify_band, subspace, unit
from ringtrue.identify.stabilise import Candidates, candidates, half_agreement
from ringtrue.shapes.mac import mac
from ringtrue.signal.preprocess import Band, Harmonic, band_signals, harmonics, usable
from ringtrue.signal.psd import Welch, csd

LEAST_DAMPING = 5e-4  # below what structures have in operation (welded steel: 0.1 %)
TOP = 0.34  # of the rate of a decimated band: the skirts of its filter begin at 0.4
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class AmbientSettings:
    """Settings; the defaults need no tuning.

    Attributes
    ----------
    fmin, fmax : float, Hz
        Band of interest; None: 50 cycles in the record, and what the rate allows.
    order_max : int
        Largest model order of each band.
    block_rows : int
        Block rows, fewer in a band with few samples.
    references : tuple of str
        Reference channels; () lets each band choose at most 16.
    confidence_min : float
        Modes below are not reported.
    """

    fmin: float | None = None
    fmax: float | None = None
    order_max: int = 80
    block_rows: int = 50
    references: tuple[str, ...] = ()
    confidence_min: float = 0.33

    def __post_init__(self) -> None:
        low, high = self.fmin or 0.0, self.fmax or np.inf
        if low < 0 or not low < high:
            raise ConfigError(f"band {self.fmin} .. {self.fmax} Hz: must be 0 <= fmin < fmax")


@dataclass(frozen=True, slots=True, eq=False)
class AmbientResult:
    """What an ambient record says.

    Attributes
    ----------
    modes : ModeSet
        Unscaled complex shapes, largest component 1; `confidence` 0..1 for each.
    uncertainty : Uncertainty
    diagrams : tuple of StableDiagram
        One for each band, from the highest; clusters are numbered within the band.
    reasons : tuple of str
        Why each mode is believed.
    harmonics : tuple of Harmonic
        Lines of machines, left out.
    notes : tuple of str
        What the reader should know: bad channels, left-out poles, nothing found.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    diagrams: tuple[StableDiagram, ...]
    reasons: tuple[str, ...]
    harmonics: tuple[Harmonic, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Candidates of one band with shapes in the channels' units, and their confidence."""

    table: Candidates
    shape: Complex
    shape_std: Float
    confidence: Float
    diagram: StableDiagram


def bands_for(rate: float, duration: float, settings: AmbientSettings) -> tuple[Band, ...]:
    """The pyramid, from the highest band.

    Raises
    ------
    ConfigError
        If the band of interest is empty at this rate and length.
    """
    low = settings.fmin if settings.fmin is not None else 50.0 / duration
    high = min(settings.fmax or np.inf, 0.49 * rate)
    if not low < high:
        raise ConfigError(
            f"band {low:.4g} .. {high:.4g} Hz is empty: {duration:.4g} s at {rate:.4g} Hz allow "
            f"{50 / duration:.4g} .. {0.49 * rate:.4g} Hz"
        )
    top = rate if high > TOP * rate else high / TOP
    bands = [Band(max(low, 0.06 * top), high, top)]
    while bands[-1].low > low:
        r = bands[-1].rate / 4
        bands.append(Band(max(low, 0.06 * r), TOP * r, r))
    return tuple(bands)


def _halves(r: Float, weights: Float, ssi: SsiCov, rate: float, band: Band) -> tuple[PoleSet, PoleSet]:
    """Poles of the first and of the second half of the record, every other order."""
    mid = weights.size // 2
    step = replace(ssi, order_step=2 * ssi.order_step)

    def half(part: slice) -> PoleSet:
        mean = np.einsum("b,bkij->kij", weights[part] / weights[part].sum(), r[part])
        sub = subspace(mean, ssi.block_rows, ssi.order_max, rate)
        return all_orders(sub, None, step, (0.97 * band.low, 1.03 * band.high))[0]

    return half(slice(0, mid)), half(slice(mid, None))


def confidence(c: Candidates) -> Float:
    """(m,) 0..1: agreement of the halves, share of the orders, certainty of the damping, collinearity."""
    _, sz = c.stds()
    orders = np.sqrt(c.orders[:, 0] / np.maximum(c.orders[:, 1], 1))
    known = 1 / (1 + (2 * sz / np.maximum(c.damping, 1e-3)) ** 2)
    return np.asarray(np.clip(c.halves * orders * known * np.sqrt(c.mpc), 0, 1))


def _spectrum(signals: TimeHistory, most: int = 8) -> tuple[Float, Float]:
    """Frequencies and level (dB) of the first singular value of the spectral matrix of up to 8 channels."""
    pick = np.unique(np.linspace(0, len(signals.channels) - 1, most).round().astype(np.int64))
    part = replace(signals, data=signals.data[pick], channels=tuple(signals.channels[i] for i in pick))
    lines = int(min(1024, signals.data.shape[1] // 4))
    s = csd(part, Welch(signals.rate / lines))
    return s.freqs, 10 * np.log10(np.maximum(s.singular_values()[:, 0], np.finfo(np.float64).tiny))


def _band(history: TimeHistory, band: Band, settings: AmbientSettings, refs: Int | None) -> _Found:
    """Identify one band of the signals `history`, already filtered and decimated."""
    data = history.data
    rows = int(np.clip(data.shape[1] // 60, 10, settings.block_rows))
    ssi = SsiCov(rows, settings.order_max)
    r, weights, rms = blockwise(data, ssi, refs)
    scale = rms[:, None]
    poles = identify_band(r, weights, ssi, history.rate, (band.low, band.high))
    table = candidates(poles)
    if table.pole.size:
        table = replace(table, halves=half_agreement(table, _halves(r, weights, ssi, history.rate, band)))
    scaled = table.shape * scale
    top = np.abs(scaled).max(0, initial=0.0)
    return _Found(
        table,
        unit(scaled),
        table.shape_std * scale / top,
        confidence(table),
        _diagram(poles, table, history, scale),
    )


def _diagram(poles: BandPoles, table: Candidates, history: TimeHistory, scale: Float) -> StableDiagram:
    p = poles.poles
    shown = PoleSet(p.order, p.pole, unit(p.shape * scale), p.std_frequency, p.std_damping)
    return StableDiagram(shown, table.stable, table.label, *_spectrum(history))


def _select(found: list[_Found], least: float) -> list[tuple[int, int]]:
    """(band, row) of the modes to report: confident ones, each once, ascending in frequency."""
    rows = [(b, i) for b, x in enumerate(found) for i in np.flatnonzero(x.confidence >= least).tolist()]
    if not rows:
        return []
    f = np.array([found[b].table.frequencies[i] for b, i in rows])
    z = np.array([found[b].table.damping[i] for b, i in rows])
    sf = np.array([found[b].table.stds()[0][i] for b, i in rows])
    conf = np.array([found[b].confidence[i] for b, i in rows])
    band = np.array([b for b, _ in rows])
    psi = np.stack([found[b].shape[:, i] for b, i in rows], axis=1)
    near = np.abs(f[:, None] - f) < np.maximum(4 * np.hypot(sf[:, None], sf), (z * f)[:, None] + z * f)
    same = near & _alike(mac(psi, psi), band, conf)
    keep: list[int] = []
    for k in np.lexsort((sf / f, -conf.round(1))).tolist():  # greedy: the best first
        if not same[k, keep].any():
            keep.append(k)
    return [rows[k] for k in sorted(keep, key=lambda k: float(f[k]))]


def _alike(like: Float, band: Int, conf: Float) -> Bool:
    """Shapes (MAC `like`) of one mode; two clusters of one band beyond doubt must be more alike to be one."""
    sure = (np.minimum(conf[:, None], conf) > 0.6) & (band[:, None] == band)
    return np.asarray(like > np.where(sure, 0.95, 0.8))


def _machine(f: float, zeta: float, lines: tuple[Harmonic, ...], resolution: float) -> Harmonic | None:
    """The line that a pole stands on, if its width is no more than that of a line."""
    narrow = zeta < max(2e-3, resolution / f)
    near = [h for h in lines if abs(h.frequency - f) < max(1.5 * resolution, 1e-3 * f)]
    return near[0] if narrow and near else None


def _reason(c: Candidates, i: int) -> str:
    sf, sz = c.stds()
    n, tried = c.orders[i].tolist()
    thin = "; so little damping may be a machine of unsteady speed" if c.damping[i] < 2.5e-3 else ""
    return (
        f"found at {n} of {tried} orders, std {100 * sf[i] / c.frequencies[i]:.2g} % of frequency and "
        f"{100 * sz[i] / c.damping[i]:.2g} % of damping, MPC {c.mpc[i]:.2f}, halves of the record agree to "
        f"{c.halves[i]:.2f}{thin}"
    )


def _uncertainty(found: list[_Found], at: list[tuple[int, int]], channels: int) -> Uncertainty:
    """Standard deviations and covariance factor; modes of different bands are taken as independent."""
    m = len(at)
    if not m:
        return Uncertainty.independent(np.empty(0), np.empty(0), np.empty((channels, 0)))
    shape = np.stack([found[b].shape_std[:, i] for b, i in at], axis=1)
    blocks = np.cumsum([0] + [x.table.deviation.shape[1] for x in found])
    factor = np.zeros((int(blocks[-1]), 2 * m))
    for k, (b, i) in enumerate(at):
        df, dz = var.frequency_damping(found[b].table.pole[[i]], found[b].table.deviation[[i]])
        factor[blocks[b] : blocks[b + 1], k], factor[blocks[b] : blocks[b + 1], m + k] = df[0], dz[0]
    size = np.sqrt((factor**2).sum(0))
    return Uncertainty(size[:m], size[m:], shape, factor)


def _notes(history: TimeHistory, left_out: list[str], modes: int, bands: tuple[Band, ...]) -> list[str]:
    span = f"{bands[-1].low:.3g} .. {bands[0].high:.3g} Hz"
    if modes:
        return left_out
    return [*left_out, f"no mode found in {span}: {history.duration:.4g} s look like noise"]


def identify_ambient(
    history: TimeHistory, settings: AmbientSettings | None = None, *, progress: Progress | None = None
) -> AmbientResult:
    """Modes of a structure in operation, from its responses alone.

    Parameters
    ----------
    history : TimeHistory
        Responses; (channel, sample).
    settings : AmbientSettings
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If no channel is usable or the record is too short.
    ConfigError
        If the band of interest is empty.
    """
    settings = settings or AmbientSettings()
    tell = progress or (lambda _fraction, _text: None)
    good, states = usable(history)
    refs = _references(good, settings.references)
    bands = _long_enough(bands_for(good.rate, good.duration, settings), good, settings)
    tell(0.0, "filtering into bands")
    signals = band_signals(good.data, good.rate, bands)
    found = []
    for k, (band, (data, rate)) in enumerate(zip(bands, signals, strict=True)):
        tell((k + 1) / (len(bands) + 2), f"identifying {band.low:.3g} .. {band.high:.3g} Hz")
        found.append(_band(replace(good, data=data, rate=rate), band, settings, refs))
    tell((len(bands) + 1) / (len(bands) + 2), "looking for machines")
    lines = tuple(h for h in harmonics(good, low=bands[-1].low) if h.frequency < bands[0].high)
    result = _assemble(good, found, lines, bands, settings)
    tell(1.0, f"{len(result.modes)} modes")
    notes = tuple(f"channel {s.id}: {s.why}{'' if s.usable else '; left out'}" for s in states)
    return replace(result, notes=notes + result.notes)


def _references(history: TimeHistory, names: tuple[str, ...]) -> Int | None:
    if not names:
        return None
    ids = [c.id for c in history.channels]
    if lost := [n for n in names if n not in ids]:
        raise DataError(f"{history.source}: no usable reference channel {' '.join(lost[:8])}; there are {ids[:40]}")
    return np.array([ids.index(n) for n in names], dtype=np.int64)


def _long_enough(bands: tuple[Band, ...], history: TimeHistory, settings: AmbientSettings) -> tuple[Band, ...]:
    """The bands with samples enough for ten block rows."""
    long = tuple(b for b in bands if history.duration * b.rate >= 200)
    if not long:
        raise DataError(
            f"{history.source}: {history.duration:.4g} s are too short for modes above "
            f"{bands[-1].low:.3g} Hz; needed are {200 / bands[0].rate:.4g} s"
        )
    return long


def _assemble(
    history: TimeHistory,
    found: list[_Found],
    lines: tuple[Harmonic, ...],
    bands: tuple[Band, ...],
    settings: AmbientSettings,
) -> AmbientResult:
    resolution = 61 * 4 / history.duration  # main lobe of the window of `harmonics` in 120 half-overlapped segments
    at, left_out = [], []
    for b, i in _select(found, settings.confidence_min):
        f, z = float(found[b].table.frequencies[i]), float(found[b].table.damping[i])
        if h := _machine(f, z, lines, resolution):
            left_out.append(f"pole at {f:.4g} Hz left out: {h.why}")
        elif z < LEAST_DAMPING:
            left_out.append(f"pole at {f:.4g} Hz left out: damping {100 * z:.2g} % is a line, not a structure")
        else:
            at.append((b, i))
    shapes = [found[b].shape[:, i] for b, i in at]
    modes = ModeSet(
        np.array([found[b].table.frequencies[i] for b, i in at]),
        np.array([found[b].table.damping[i] for b, i in at]),
        np.stack(shapes, axis=1) if at else np.empty((len(history.channels), 0), np.complex128),
        tuple(c.id for c in history.channels),
        source=f"{history.source or 'record'}: SSI-cov",
        confidence=np.array([found[b].confidence[i] for b, i in at]),
    )
    return AmbientResult(
        modes,
        _uncertainty(found, at, len(history.channels)),
        tuple(x.diagram for x in found),
        tuple(_reason(found[b].table, i) for b, i in at),
        lines,
        tuple(_notes(history, left_out, len(at), bands)),
    )
