"""Frequency response functions from impact records: H1, H2 or Hv with coherence.

FRFs from continuous records with one or several shakers: H1, Hv, coherences, their variance.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import bdtr

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import (
    ANGULAR,
    DERIVATIVE,
    FORCES,
    FRF_KIND,
    LINEAR,
    MOTIONS,
    UNIT,
    channel,
    input_id,
)
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.signals import (
    Channel,
    FrfSet,
    Impacts,
    Quantity,
    TimeHistory,
    join_impacts,
)
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.signal.frf_sets import join_frfs
from ringtrue.signal.impacts import (
    Estimator,
    HammerSettings,
    ImpactReport,
    block_length,
    check_impacts,
    decided,
    find_impacts,
    force_channel,
    impacts_of,
    pulse_width,
)
from ringtrue.signal.spectra import Welch, csd, window

_ESTIMATORS = ("H1", "H2", "Hv")


@dataclass(frozen=True, slots=True, eq=False)
class ShakerFrfs:
    """FRFs of a record with running excitation.

    Attributes
    ----------
    frfs : FrfSet
        Its coherence is the partial one of each input with the others taken out, the ordinary one
        of a single input; `frf.frf_variance` holds with it. `averages` are independent segments
        less the other inputs.
    ordinary : (freq, out, in) float64
        Coherence of one input alone.
    multiple : (freq, out) float64
        Share of the response that all inputs together explain.
    condition : (freq,) float64
        Condition number of the scaled input spectra; large where two shakers act together.
    """

    frfs: FrfSet
    ordinary: Float
    multiple: Float
    condition: Float


def independent_segments(samples: int, length: int, settings: Welch) -> float:
    """Segments of no overlap that have the variance of the given ones (Welch 1967, eq. 17)."""
    hop = max(1, length // 2)
    count = (samples - length) // hop + 1
    w = window(settings.window, length)
    k = np.arange(1, min(count, -(-length // hop)))
    rho = np.array([(w[: length - i * hop] @ w[i * hop :]) / (w @ w) for i in k]) ** 2
    return float(count / (1 + 2 * ((1 - k / count) * rho).sum()))


def shaker_frfs(
    history: TimeHistory,
    settings: Welch,
    *,
    inputs: Sequence[str] = (),
    estimator: Literal["H1", "H2", "Hv"] = "H1",
) -> ShakerFrfs:
    """FRFs of all responses against all forces at once.

    H1 = G_yf G_ff⁻¹ (noise on the responses). Hv takes noise on both: the smallest eigenvector of
    the spectra of all forces and one response, each scaled to unit power; of one input it is the
    geometric mean of H1 and H2. Source: Bendat and Piersol (2010), Random Data, chapters 7 and 9;
    Rocklin, Crowley and Vold (1985) for Hv.

    Parameters
    ----------
    history : TimeHistory
    settings : Welch
    inputs : sequence of str, optional
        Ids of the force channels; by default all channels whose quantity is force.
    estimator : {"H1", "H2", "Hv"}
        H2 of one input only.

    Raises
    ------
    DataError
        If there is no force channel, a channel is constant or not finite, the responses are of
        different kinds, or the record has too few segments for its inputs.
    """
    if estimator not in _ESTIMATORS:
        raise ConfigError(
            f"estimator {estimator!r}{did_you_mean(estimator, _ESTIMATORS)}"
        )
    ordered, q = sorted_channels(history, inputs)
    if estimator == "H2" and q > 1:
        raise ConfigError(f"H2 of {q} inputs is not determined; take H1 or Hv")
    spectra = csd(ordered, settings)
    length = round(history.rate / settings.resolution)
    n = independent_segments(history.data.shape[1], length, settings) - (q - 1)
    if n < 2:
        raise DataError(
            f"{history.source}: {n + q - 1:.3g} independent segments for {q} inputs"
        )
    g = spectra.data[1:]  # the mean is taken out, there is nothing at 0 Hz
    h, partial, ordinary, multiple, condition = _estimate(g, q, estimator)
    frfs = FrfSet(
        data=h,
        freqs=spectra.freqs[1:],
        outputs=ordered.channels[q:],
        inputs=tuple(as_input(c) for c in ordered.channels[:q]),
        coherence=partial,
        averages=np.full(q, n),
        kind=MOTIONS[ordered.channels[q].quantity],
        window_decay=0.0,
        source=history.source,
    )
    return ShakerFrfs(frfs, ordinary, multiple, condition)


def sorted_channels(
    history: TimeHistory, inputs: Sequence[str] = ()
) -> tuple[TimeHistory, int]:
    """The record with its forces first, and their number.

    Raises
    ------
    DataError
        If there is no force channel, a channel is constant or not finite, or the responses are of
        different kinds.
    """
    forces = list(inputs) or [c.id for c in history.channels if c.quantity in FORCES]
    others = [
        c for c in history.channels if c.id not in forces and c.quantity not in FORCES
    ]
    kinds = {LINEAR.get(c.quantity, c.quantity) for c in others}
    if not forces or len(kinds) != 1 or not kinds <= set(FRF_KIND):
        raise DataError(
            f"{history.source}: {len(forces)} forces and responses of "
            f"{', '.join(sorted(kinds)) or 'no kind'}; "
            "there must be a force and one kind of motion"
        )
    ordered = history.pick([*forces, *(c.id for c in others)])
    _check(ordered)
    return ordered, len(forces)


def as_input(channel: Channel) -> Channel:
    """The same channel under the name that FRFs have for a reference."""
    return replace(channel, id=input_id(channel.id))


def _check(history: TimeHistory) -> None:
    for sensor, x in zip(history.channels, history.data, strict=True):
        low = float(x.min())
        high = float(x.max())
        if not (np.isfinite(low) and np.isfinite(high) and high > low):
            raise DataError(
                f"{history.source}: sensor {sensor.id} is constant or not finite; leave it out"
            )


def _estimate(
    g: Complex, q: int, estimator: str
) -> tuple[Complex, Float, Float, Float, Float]:
    """FRFs (f, out, in), partial and ordinary coherence (f, out, in), multiple (f, out), condition
    (f,).
    """
    power = np.maximum(np.einsum("fii->fi", g).real, np.finfo(np.float64).tiny)
    scale = np.sqrt(power)
    # scaled, so that no unit makes it ill-conditioned
    c = g / (scale[:, :, None] * scale[:, None, :])
    ff = c[:, :q, :q]
    yf = c[:, q:, :q]
    values, vectors = np.linalg.eigh(ff)
    condition = values[:, -1] / np.maximum(values[:, 0], np.finfo(np.float64).tiny)
    values = np.maximum(values, 1e-12 * values[:, -1:])
    inverse = (vectors / values[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    h1 = yf @ inverse
    multiple = np.clip(np.einsum("foi,foi->fo", h1, yf.conj()).real, 0.0, 1.0)
    # power of one input, others taken out
    alone = np.abs(h1) ** 2 / np.einsum("fii->fi", inverse).real[:, None, :]
    partial = alone / np.maximum(
        alone + (1 - multiple)[:, :, None], np.finfo(np.float64).tiny
    )
    h = {"H1": h1, "H2": h1 / np.maximum(multiple, 1e-12)[:, :, None]}.get(estimator)
    h = _total(c, q) if h is None else h
    h = h * scale[:, q:, None] / scale[:, None, :q]
    return (
        h,
        np.clip(partial, 0.0, 1.0),
        np.clip(np.abs(yf) ** 2, 0.0, 1.0),
        multiple,
        condition,
    )


def _total(c: Complex, q: int) -> Complex:
    """Total least squares of each response on all forces, scaled spectra (f, ch, ch) -> (f, out,
    in).
    """
    at = [np.append(np.arange(q), q + k) for k in range(c.shape[1] - q)]
    both = np.stack([c[:, i][:, :, i] for i in at], axis=1)  # (f, out, q + 1, q + 1)
    v = np.linalg.eigh(both)[1][..., 0].conj()
    return np.asarray(-v[..., :q] / v[..., q:])


log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HitSelection:
    """Which samples and lines of hits give an FRF.

    Attributes
    ----------
    rise : int
        Samples in which the force of a hit rises.
    pulse : int
        Samples at least that the force is kept: an anti-aliasing filter rings on.
    heard : float
        Power of the response over that of the noise, from which a hit counts.
    slow : int
        Lines that a drift takes.
    filter_edge : float
        Share of half the rate below which no filter rings.
    no_force : float
        Power over the largest: a zero of the spectrum of a pulse without noise, rounding alone.
    """

    rise: int = 8
    pulse: int = 16
    heard: float = 10.0
    slow: int = 3
    filter_edge: float = 0.75
    no_force: float = 1e-12


HITS = HitSelection()


@dataclass(frozen=True, slots=True)
class QuietSamples:
    """What is noise before and after a hit.

    Attributes
    ----------
    level : float
        Share of the response.
    floor : float
        Times the typical power, above which a line is no noise.
    deviations : float
        Standard deviations that noise does not reach.
    median : float
        Median of the moduli of a standard normal variable.
    ends_at : float
        Share of its start that a response has left under an automatic exponential window.
    """

    level: float = 0.02
    floor: float = 6.0
    deviations: float = 4.0
    median: float = 0.6745
    ends_at: float = 0.01


QUIET = QuietSamples()


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """Where the hits of one record are."""

    record: TimeHistory
    force: int
    hits: Int
    length: int


def estimate_frf(
    records: TimeHistory | Sequence[TimeHistory],
    settings: HammerSettings | None = None,
    *,
    full_scale: Mapping[str, float] | None = None,
    progress: Progress = quiet,
) -> tuple[FrfSet, tuple[ImpactReport, ...]]:
    """FRFs from one or several hammer records.

    Each record has one force channel, whose id names the point and direction hit (a leading `F:` is
    dropped). Records of the same input and responses are averaged together; different ones become
    columns (roving hammer) or rows (roving responses) of one set. Motions of several kinds become
    that of most responses.

    Parameters
    ----------
    records : TimeHistory or sequence of TimeHistory, SI, equal rates
    settings : HammerSettings, optional
    full_scale : mapping of str to float, optional
        Range of each channel by id, in its unit; for the detection of overloads.
    progress : callable (fraction, text)

    Returns
    -------
    FrfSet
        With the exponential window still in the data, its rate in `window_decay`, and `kept` of the
        response.
    tuple of ImpactReport
        All hits, those left out with their reasons.

    Raises
    ------
    DataError
        If a record has no hits or none can be used, rates differ, or a pair of response and input
        is absent.
    """
    records = [records] if isinstance(records, TimeHistory) else records
    columns, reports = estimate_columns(
        records, settings, full_scale=full_scale, progress=progress
    )
    return join_frfs(columns), reports


def estimate_columns(
    records: Sequence[TimeHistory],
    settings: HammerSettings | None = None,
    *,
    full_scale: Mapping[str, float] | None = None,
    progress: Progress = quiet,
) -> tuple[tuple[FrfSet, ...], tuple[ImpactReport, ...]]:
    """The FRFs of each input with each set of responses, on the same lines, before `estimate_frf`
    joins them.

    Lines at which one of the pulses has no force are left out: the zeros of a pulse without noise,
    and all beyond the last line where it stands out of its noise.
    """
    settings = settings or HammerSettings()
    cuts = [_cut(r, settings) for r in records]
    # a triggered record of one hit may have less before it than the pretrigger asked for
    room = min(
        [float(c.hits[0]) / c.record.rate for c in cuts if c.hits.size == 1] or [np.inf]
    )
    settings = replace(settings, pretrigger=min(settings.pretrigger, room))
    length = min(c.length for c in cuts)
    if len({c.record.rate for c in cuts}) > 1:
        raise DataError(
            f"records of different rates: {sorted({c.record.rate for c in cuts})} Hz; resample "
            "them first"
        )
    if length < 16:
        raise DataError(
            f"{records[0].source}: {length} samples between the hits; give HammerSettings.block"
        )
    cuts, reports = _checked(cuts, length, settings, full_scale)
    reports = decided(reports, settings.hits)
    good = [
        c.hits[[r.accepted for r in rep]] for c, rep in zip(cuts, reports, strict=True)
    ]
    _check_used(cuts, reports)
    decay = max(_decay(c, g, length, settings) for c, g in zip(cuts, good, strict=True))
    sums: dict[tuple[str, ...], _Sums] = {}
    for i, (cut, hits) in enumerate(zip(cuts, good, strict=True)):
        progress(i / len(cuts), f"FRFs of {cut.record.source or f'record {i + 1}'}")
        new = _spectra(cut, hits, length, decay, settings)
        key = (new.input, *(c.id for c in new.outputs))
        sums[key] = sums[key].plus(new) if key in sums else new
    source = ", ".join(dict.fromkeys(r.source for r in records if r.source))
    struck = np.all(
        [s.ff > HITS.no_force * s.ff.max(initial=0.0) for s in sums.values()], axis=0
    )
    last = max(
        min(_last_heard(s) for s in sums.values()),
        int((settings.keep_to or 0.0) * length / cuts[0].record.rate),
    )
    struck &= np.arange(struck.size) <= last
    columns = tuple(_column(s, struck, decay, settings, source) for s in sums.values())
    return columns, tuple(r for rep in reports for r in rep)


def _check_used(
    cuts: Sequence[_Cut], reports: Sequence[Sequence[ImpactReport]]
) -> None:
    for cut, rep in zip(cuts, reports, strict=True):
        if not any(r.accepted for r in rep):
            listed = "; ".join(
                f"{r.time:.2f} s: {', '.join(r.reasons)}" for r in rep[:5]
            )
            spoilt = all(
                any(w.startswith("overload of ") for w in r.reasons) for r in rep
            )
            way = (
                "; leave such responses out, or measure with a wider range"
                if spoilt
                else ""
            )
            raise DataError(
                f"{cut.record.source}: none of {len(rep)} hits can be used: {listed}{way}"
            )


def _cut(record: TimeHistory, settings: HammerSettings) -> _Cut:
    at = force_channel(record, settings)
    force = np.asarray(record.data[at], dtype=np.float64)
    hits = find_impacts(force - np.median(force), record.rate, settings)
    if not hits.size:
        raise DataError(f"{record.source}: no hit in channel {record.channels[at].id}")
    return _Cut(
        record,
        at,
        hits,
        block_length(hits, record.data.shape[1], record.rate, settings),
    )


def _checked(
    cuts: list[_Cut],
    length: int,
    settings: HammerSettings,
    full_scale: Mapping[str, float] | None,
) -> tuple[list[_Cut], list[tuple[ImpactReport, ...]]]:
    """The verdict on all hits, without responses that overload in most of those of a record."""
    reports = [
        check_impacts(
            c.record,
            c.force,
            hits=c.hits,
            length=length,
            settings=settings,
            full_scale=full_scale,
        )
        for c in cuts
    ]
    lost = tuple(dict.fromkeys(c for rep in reports for r in rep for c in r.lost))
    if not lost:
        return cuts, reports
    cuts, reports = _checked(
        [_without(c, lost) for c in cuts], length, settings, full_scale
    )
    return cuts, [
        tuple(replace(r, lost=(*lost, *r.lost)) for r in rep) for rep in reports
    ]


def _without(cut: _Cut, lost: Sequence[str]) -> _Cut:
    """Without some responses."""
    kept = [c.id for c in cut.record.channels if c.id not in lost]
    if len(kept) == 1:
        raise DataError(
            f"{cut.record.source}: no response is left: {' '.join(lost)} overload in most impacts"
        )
    return replace(
        cut,
        record=cut.record.pick(kept),
        force=kept.index(cut.record.channels[cut.force].id),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Summed spectra of one input."""

    input: str
    outputs: tuple[Channel, ...]
    rate: float
    length: int
    count: int
    ff: Float  # (freq,)
    xf: Complex  # (freq, out)
    xx: Float  # (freq, out)
    kept: float  # s, of the response
    quiet: float  # power that the noise on the force leaves at a line
    impacts: Impacts | None  # of equal weight in all FRFs

    def plus(self, other: _Sums) -> _Sums:
        both = self.impacts, other.impacts
        return replace(
            self,
            count=self.count + other.count,
            ff=self.ff + other.ff,
            xf=self.xf + other.xf,
            xx=self.xx + other.xx,
            quiet=self.quiet + other.quiet,
            impacts=join_impacts(both, [b.weight for b in both if b]),
            kept=(self.kept * self.count + other.kept * other.count)
            / (self.count + other.count),
        )


def _last_heard(s: _Sums) -> int:
    """The last line at which the force stands out of its noise."""
    heard = np.flatnonzero(s.ff > HITS.heard * s.quiet)
    return int(heard[-1]) if heard.size else s.ff.size - 1


def _block(data: Any_, start: int, length: int) -> Float:
    """(channel, length) float64 without the offset: the mean of the second half, where least is
    left of the impact.
    """
    block = np.asarray(data[:, start : start + length], dtype=np.float64)
    return np.asarray(block - block[:, length // 2 :].mean(axis=1, keepdims=True))


def _lead(cut: _Cut, hits: Int) -> tuple[int, int]:
    """Samples of a block before the peak, and how many of them a smooth rise takes.

    What rings on from the impact before would stand in the pretrigger, where the model of an impact
    has nothing; from the impact on it decays as the response does. So a block begins with the
    pulse, at an edge. Where the anti-aliasing filter rings before a short pulse, in force and
    response, an edge leaves a part of that at all lines: there, if the structure is quiet, the
    block begins earlier and smoothly.
    """
    force = np.asarray(cut.record.data[cut.force], dtype=np.float64)
    force = force - np.median(force)
    pulse = 2 * max(pulse_width(force, h) for h in hits.tolist()) + 2
    room = int(hits.min())
    rise = max(min(room - pulse, HITS.rise), 0)
    if rise and _unrest(cut, hits - pulse) > QUIET.level:
        rise = 0
    return min(room, pulse + rise), rise


def _unrest(cut: _Cut, starts: Int) -> float:
    """Level of the responses before the impacts over that after them, at the line that rings on
    most.

    0 where it is not known, as too little was recorded before an impact.
    """
    responses = np.delete(np.arange(len(cut.record.channels)), cut.force)
    length = min(cut.length // 4, int(starts.min()))
    if length < 2 * HITS.slow:
        return 0.0
    taper = np.hanning(length)
    power = np.zeros((2, length // 2 + 1))
    for a in starts.tolist():  # a few dozen impacts
        for row, at in zip(power, (a - length, a), strict=True):
            block = cut.record.data[responses, at : at + length]
            block = block - block.mean(axis=1, keepdims=True)
            row += (np.abs(np.fft.rfft(block * taper)) ** 2).sum(axis=0)
    power = power[:, HITS.slow : max(int(HITS.filter_edge * length / 2), HITS.slow + 1)]
    left = np.maximum(power[0] - QUIET.floor * np.median(power[0]), 0)
    return float(np.sqrt(left / np.maximum(power[1], 1e-300)).max(initial=0.0))


def _decay(cut: _Cut, hits: Int, length: int, settings: HammerSettings) -> float:
    """Decay rate of the exponential window, 1/s."""
    duration = length / cut.record.rate
    if settings.exp_end is not None:
        return float(-np.log(settings.exp_end) / duration)
    pre = round(settings.pretrigger * cut.record.rate)
    block = _block(
        np.delete(cut.record.data, cut.force, axis=0), int(hits[0]) - pre, length
    )
    part = max(length // 20, 2)
    first = np.sqrt(np.mean(block[:, pre : pre + part] ** 2))
    last = np.sqrt(np.mean(block[:, -part:] ** 2))
    return float(np.log(max(last / max(first, 1e-300) / QUIET.ends_at, 1.0)) / duration)


def _force_window(
    force: Float, pre: int, rate: float, settings: HammerSettings, noise: float
) -> Float:
    """1 over the pulse, then a half cosine of the same length down to 0.

    Unless it is given, no longer than the pulse stands out of the `noise`: what is kept of that
    moves the poles.
    """
    half = np.flatnonzero(np.abs(force[pre:]) < 0.5 * abs(force[pre]))
    width = 2 * (int(half[0]) if half.size else 1)
    keep = (
        round(settings.force_window * rate)
        if settings.force_window
        else max(4 * width, round(0.001 * rate), HITS.pulse)
    )
    t = np.arange(force.size) - pre
    if not settings.force_window and noise > 0:
        seen = t[
            (np.abs(force) > QUIET.deviations * noise) & (t >= -keep) & (t <= keep)
        ]
        keep = min(
            keep, max(int(seen.max(initial=0)) + 1, 2 * int(-seen.min(initial=0)), 1)
        )
    down = 0.5 + 0.5 * np.cos(np.pi * np.clip((t - keep) / max(keep, 1), 0, 1))
    up = np.clip((t + max(keep, 1) + 1) / max(keep / 2, 1), 0, 1)
    return np.asarray(down * up)


def _spectra(
    cut: _Cut, hits: Int, length: int, decay: float, settings: HammerSettings
) -> _Sums:
    rate = cut.record.rate
    at = cut.force
    (lead, rise), last = _lead(cut, hits), cut.record.data.shape[1] - length
    fade = np.exp(-decay * np.arange(length) / rate)
    fade[:rise] *= bdtr(np.arange(rise), rise, 0.5)
    lines = length // 2 + 1
    outputs = tuple(c for i, c in enumerate(cut.record.channels) if i != at)
    ff = np.zeros(lines)
    xf = np.zeros((lines, len(outputs)), dtype=np.complex128)
    xx = np.zeros((lines, len(outputs)))
    kept = 0.0
    pulses = list[Float]()
    quiet = list[float]()
    force = np.asarray(cut.record.data[at], dtype=np.float64)
    # of the force between the impacts, which take little of the record
    noise = float(np.median(np.abs(force - np.median(force)))) / QUIET.median
    # a few dozen hits; all at once would hold the record twice
    for hit in hits.tolist():
        start = min(hit - lead, last)
        block = _block(cut.record.data, start, length)
        window = _force_window(block[at], hit - start, rate, settings, noise)
        pulse = block[at] * window
        quiet.append(noise**2 * float(np.square(window * fade).sum()))
        kept += (
            (length - float(np.arange(length) @ pulse) / float(pulse.sum()))
            / rate
            / hits.size
        )
        f = np.fft.rfft(pulse * fade)
        x = np.fft.rfft(np.delete(block, at, axis=0) * fade, axis=1).T
        pulses.append(np.abs(f) ** 2)
        ff += pulses[-1]
        xf += x * f.conj()[:, None]
        xx += np.abs(x) ** 2
    name = input_id(cut.record.channels[at].id)
    force = np.asarray(cut.record.data[at], dtype=np.float64)
    impacts = impacts_of(
        force - np.median(force),
        rate,
        hits=cut.hits,
        used=hits,
        pulses=pulses,
        quiet=quiet,
    )
    return _Sums(
        input=name,
        outputs=outputs,
        rate=rate,
        length=length,
        count=int(hits.size),
        ff=ff,
        xf=xf,
        xx=xx,
        kept=kept,
        quiet=sum(quiet),
        impacts=impacts,
    )


def estimators(
    ff: Float, xf: Complex, xx: Float, which: Estimator
) -> tuple[Complex, Float]:
    """FRF and coherence, each (freq, out), from spectra of force (freq,), cross and response (freq,
    out).

    H1 = G_xf/G_ff (noise on the response), H2 = G_xx/G_fx (noise on the force), Hv their geometric
    mean.
    """
    tiny = np.finfo(np.float64).tiny
    coherence = np.abs(xf) ** 2 / np.maximum(ff[:, None] * xx, tiny)
    h1 = xf / np.maximum(ff, tiny)[:, None]
    power = {"H1": 0.0, "Hv": 0.5, "H2": 1.0}[which]
    return h1 / np.maximum(coherence, 1e-12) ** power, np.clip(coherence, 0.0, 1.0)


def frf_variance(frfs: FrfSet) -> Float:
    """(freq, out, in) variance of the real and the imaginary part, |H|²(1 − γ²)/(2 n γ²) (Bendat,
    Piersol 2010).
    """
    g = np.clip(frfs.coherence, 1e-12, 1.0)
    return np.asarray(np.abs(frfs.data) ** 2 * (1 - g) / (2 * frfs.averages * g))


def _of_kind(c: Channel, kind: Quantity) -> Channel:
    """The channel as of a kind of motion, along or about its axis."""
    quantity = ANGULAR[kind] if c.quantity in LINEAR else kind
    return replace(c, quantity=quantity, unit=UNIT[quantity])


def _column(
    s: _Sums, struck: Bool, decay: float, settings: HammerSettings, source: str
) -> FrfSet:
    kinds = [LINEAR.get(c.quantity, c.quantity) for c in s.outputs]
    if not kinds or not set(kinds) <= set(FRF_KIND):
        raise DataError(
            f"{source}: responses measure {', '.join(sorted(set(kinds)))}; all must be motions: "
            "leave the others out"
        )
    kind = max(dict.fromkeys(kinds), key=kinds.count)
    h, coherence = estimators(s.ff, s.xf, s.xx, settings.estimator)
    if s.count < 2:
        # one hit has coherence 1 whatever its noise
        coherence = np.full(coherence.shape, np.nan)
    freqs = np.fft.rfftfreq(s.length, 1 / s.rate)
    power = np.array([DERIVATIVE[kind] - DERIVATIVE[k] for k in kinds])
    keep = (
        struck
        & (freqs <= (settings.fmax or np.inf))
        & ((freqs > 0) | (decay > 0) | (power == 0).all())
    )
    freqs = freqs[keep]
    h = h[keep]
    coherence = coherence[keep]
    if power.any():  # under the window the FRF stands at s + decay
        h = h * (2j * np.pi * freqs + decay)[:, None] ** power
    return FrfSet(
        data=h[:, :, None],
        freqs=np.asarray(freqs, dtype=np.float64),
        outputs=tuple(_of_kind(c, kind) for c in s.outputs),
        inputs=(channel(s.input, "force"),),
        coherence=coherence[:, :, None],
        averages=np.array([float(s.count)]),
        kind=FRF_KIND[kind],
        window_decay=decay,
        source=source,
        kept=s.kept,
        impacts=s.impacts.spread(len(s.outputs)) if s.impacts else None,
    )
