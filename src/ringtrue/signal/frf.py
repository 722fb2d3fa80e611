"""Frequency response functions from impact records: H1, H2 or Hv with coherence."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtr

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import input_id
from ringtrue.core.impacts import Impacts, join_impacts
from ringtrue.core.motions import ANGULAR, DERIVATIVE, FRF_KIND, LINEAR, UNIT, channel
from ringtrue.core.progress import Progress
from ringtrue.core.signals import Channel, FrfSet, Quantity, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.frf_sets import join_frfs
from ringtrue.signal.impacts import (
    Estimator,
    HammerSettings,
    ImpactReport,
    block_length,
    check_impacts,
    find_impacts,
    force_channel,
    impacts_of,
    pulse_width,
)

log = logging.getLogger(__name__)
_NO_FORCE = (
    1e-12  # power over the largest: a zero of the spectrum of a pulse without noise, rounding alone
)
_RISE = 8  # samples
_HEARD = 10.0  # times the power of the noise on the force
_QUIET, _FLOOR = (
    0.02,
    6.0,
)  # of the response; times the typical power, above which a line is no noise
_SLOW, _FILTER = (
    3,
    0.75,
)  # lines that a drift takes; share of half the rate, that no filter rings at
_PULSE = 16  # samples at least that the force is kept: an anti-aliasing filter rings on
_SEEN, _MEDIAN = (
    4.0,
    0.6745,
)  # standard deviations that noise does not reach; median of their moduli
_ENDS_AT = 0.01  # of its start, a response under an automatic exponential window


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
    progress: Progress | None = None,
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
    progress : callable, optional

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
    columns, reports = estimate_columns(records, settings, full_scale=full_scale, progress=progress)
    return join_frfs(columns), reports


def estimate_columns(
    records: Sequence[TimeHistory],
    settings: HammerSettings | None = None,
    *,
    full_scale: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> tuple[tuple[FrfSet, ...], tuple[ImpactReport, ...]]:
    """The FRFs of each input with each set of responses, on the same lines, before `estimate_frf`
    joins them.

    Lines at which one of the pulses has no force are left out: the zeros of a pulse without noise,
    and all beyond the last line where it stands out of its noise.
    """
    settings = settings or HammerSettings()
    cuts = [_cut(r, settings) for r in records]
    settings = _with_room(cuts, settings)
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
    good = [c.hits[[r.accepted for r in rep]] for c, rep in zip(cuts, reports, strict=True)]
    _check_used(cuts, reports)
    decay = max(_decay(c, g, length, settings) for c, g in zip(cuts, good, strict=True))
    sums: dict[tuple[str, ...], _Sums] = {}
    for i, (cut, hits) in enumerate(zip(cuts, good, strict=True)):
        if progress:
            progress(i / len(cuts), f"FRFs of {cut.record.source or f'record {i + 1}'}")
        new = _spectra(cut, hits, length, decay, settings)
        key = (new.input, *(c.id for c in new.outputs))
        sums[key] = sums[key].plus(new) if key in sums else new
    source = ", ".join(dict.fromkeys(r.source for r in records if r.source))
    struck = np.all([s.ff > _NO_FORCE * s.ff.max(initial=0.0) for s in sums.values()], axis=0)
    last = max(
        min(_last_heard(s) for s in sums.values()),
        int((settings.keep_to or 0.0) * length / cuts[0].record.rate),
    )
    struck &= np.arange(struck.size) <= last
    columns = tuple(_column(s, struck, decay, settings, source) for s in sums.values())
    return columns, tuple(r for rep in reports for r in rep)


def _with_room(cuts: Sequence[_Cut], settings: HammerSettings) -> HammerSettings:
    """A triggered record of one hit may have less before it than asked for: then that is the
    pretrigger.
    """
    room = min([float(c.hits[0]) / c.record.rate for c in cuts if c.hits.size == 1] or [np.inf])
    return replace(settings, pretrigger=min(settings.pretrigger, room))


def _check_used(cuts: Sequence[_Cut], reports: Sequence[Sequence[ImpactReport]]) -> None:
    for cut, rep in zip(cuts, reports, strict=True):
        if not any(r.accepted for r in rep):
            told = "; ".join(f"{r.time:.2f} s: {', '.join(r.reasons)}" for r in rep[:5])
            spoilt = all(any(w.startswith("overload of ") for w in r.reasons) for r in rep)
            way = "; leave such responses out, or measure with a wider range" if spoilt else ""
            raise DataError(
                f"{cut.record.source}: none of {len(rep)} hits can be used: {told}{way}"
            )


def _cut(record: TimeHistory, settings: HammerSettings) -> _Cut:
    at = force_channel(record, settings)
    force = np.asarray(record.data[at], dtype=np.float64)
    hits = find_impacts(force - np.median(force), record.rate, settings)
    if not hits.size:
        raise DataError(f"{record.source}: no hit in channel {record.channels[at].id}")
    return _Cut(record, at, hits, block_length(hits, record.data.shape[1], record.rate, settings))


def _checked(
    cuts: list[_Cut], length: int, settings: HammerSettings, full_scale: Mapping[str, float] | None
) -> tuple[list[_Cut], list[tuple[ImpactReport, ...]]]:
    """The verdict on all hits, without responses that overload in most of those of a record."""
    reports = [check_impacts(c.record, c.force, c.hits, length, settings, full_scale) for c in cuts]
    lost = tuple(dict.fromkeys(c for rep in reports for r in rep for c in r.lost))
    if not lost:
        return cuts, reports
    cuts, reports = _checked([_without(c, lost) for c in cuts], length, settings, full_scale)
    return cuts, [tuple(replace(r, lost=(*lost, *r.lost)) for r in rep) for rep in reports]


def _without(cut: _Cut, lost: Sequence[str]) -> _Cut:
    """Without some responses."""
    kept = [c.id for c in cut.record.channels if c.id not in lost]
    if len(kept) == 1:
        raise DataError(
            f"{cut.record.source}: no response is left: {' '.join(lost)} overload in most impacts"
        )
    return replace(
        cut, record=cut.record.pick(kept), force=kept.index(cut.record.channels[cut.force].id)
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
            kept=(self.kept * self.count + other.kept * other.count) / (self.count + other.count),
        )


def _last_heard(s: _Sums) -> int:
    """The last line at which the force stands out of its noise."""
    heard = np.flatnonzero(s.ff > _HEARD * s.quiet)
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
    pulse, room = 2 * max(pulse_width(force, h) for h in hits.tolist()) + 2, int(hits.min())
    rise = max(min(room - pulse, _RISE), 0)
    if rise and _unrest(cut, hits - pulse) > _QUIET:
        rise = 0
    return min(room, pulse + rise), rise


def _unrest(cut: _Cut, starts: Int) -> float:
    """Level of the responses before the impacts over that after them, at the line that rings on
    most.

    0 where it cannot be told, as too little was recorded before an impact.
    """
    responses = np.delete(np.arange(len(cut.record.channels)), cut.force)
    length = min(cut.length // 4, int(starts.min()))
    if length < 2 * _SLOW:
        return 0.0
    taper = np.hanning(length)
    power = np.zeros((2, length // 2 + 1))
    for a in starts.tolist():  # a few dozen impacts
        for row, at in zip(power, (a - length, a), strict=True):
            block = cut.record.data[responses, at : at + length]
            block = block - block.mean(axis=1, keepdims=True)
            row += (np.abs(np.fft.rfft(block * taper)) ** 2).sum(axis=0)
    power = power[:, _SLOW : max(int(_FILTER * length / 2), _SLOW + 1)]
    left = np.maximum(power[0] - _FLOOR * np.median(power[0]), 0)
    return float(np.sqrt(left / np.maximum(power[1], 1e-300)).max(initial=0.0))


def _decay(cut: _Cut, hits: Int, length: int, settings: HammerSettings) -> float:
    """Decay rate of the exponential window, 1/s."""
    duration = length / cut.record.rate
    if settings.exp_end is not None:
        return float(-np.log(settings.exp_end) / duration)
    pre = round(settings.pretrigger * cut.record.rate)
    block = _block(np.delete(cut.record.data, cut.force, axis=0), int(hits[0]) - pre, length)
    part = max(length // 20, 2)
    first = np.sqrt(np.mean(block[:, pre : pre + part] ** 2))
    last = np.sqrt(np.mean(block[:, -part:] ** 2))
    return float(np.log(max(last / max(first, 1e-300) / _ENDS_AT, 1.0)) / duration)


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
        else max(4 * width, round(0.001 * rate), _PULSE)
    )
    t = np.arange(force.size) - pre
    if not settings.force_window and noise > 0:
        seen = t[(np.abs(force) > _SEEN * noise) & (t >= -keep) & (t <= keep)]
        keep = min(keep, max(int(seen.max(initial=0)) + 1, 2 * int(-seen.min(initial=0)), 1))
    down = 0.5 + 0.5 * np.cos(np.pi * np.clip((t - keep) / max(keep, 1), 0, 1))
    up = np.clip((t + max(keep, 1) + 1) / max(keep / 2, 1), 0, 1)
    return np.asarray(down * up)


def _noise(force: Float) -> float:
    """Standard deviation of the force between the impacts, which take little of the record."""
    return float(np.median(np.abs(force - np.median(force)))) / _MEDIAN


def _spectra(cut: _Cut, hits: Int, length: int, decay: float, settings: HammerSettings) -> _Sums:
    rate, at = cut.record.rate, cut.force
    (lead, rise), last = _lead(cut, hits), cut.record.data.shape[1] - length
    fade = np.exp(-decay * np.arange(length) / rate)
    fade[:rise] *= bdtr(np.arange(rise), rise, 0.5)
    lines = length // 2 + 1
    outputs = tuple(c for i, c in enumerate(cut.record.channels) if i != at)
    ff = np.zeros(lines)
    xf, xx = np.zeros((lines, len(outputs)), dtype=np.complex128), np.zeros((lines, len(outputs)))
    kept, pulses, quiet = 0.0, list[Float](), list[float]()
    noise = _noise(np.asarray(cut.record.data[at], dtype=np.float64))
    for hit in hits.tolist():  # a few dozen hits; all at once would hold the record twice
        start = min(hit - lead, last)
        block = _block(cut.record.data, start, length)
        window = _force_window(block[at], hit - start, rate, settings, noise)
        pulse = block[at] * window
        quiet.append(noise**2 * float(np.square(window * fade).sum()))
        kept += (length - float(np.arange(length) @ pulse) / float(pulse.sum())) / rate / hits.size
        f = np.fft.rfft(pulse * fade)
        x = np.fft.rfft(np.delete(block, at, axis=0) * fade, axis=1).T
        pulses.append(np.abs(f) ** 2)
        ff += pulses[-1]
        xf += x * f.conj()[:, None]
        xx += np.abs(x) ** 2
    name, force = (
        input_id(cut.record.channels[at].id),
        np.asarray(cut.record.data[at], dtype=np.float64),
    )
    impacts = impacts_of(force - np.median(force), rate, cut.hits, hits, pulses, quiet)
    return _Sums(name, outputs, rate, length, int(hits.size), ff, xf, xx, kept, sum(quiet), impacts)


def estimators(ff: Float, xf: Complex, xx: Float, which: Estimator) -> tuple[Complex, Float]:
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


def _column(s: _Sums, struck: Bool, decay: float, settings: HammerSettings, source: str) -> FrfSet:
    kinds = [LINEAR.get(c.quantity, c.quantity) for c in s.outputs]
    if not kinds or not set(kinds) <= set(FRF_KIND):
        raise DataError(
            f"{source}: responses measure {', '.join(sorted(set(kinds)))}; all must be motions: "
            "leave the others out"
        )
    kind = max(dict.fromkeys(kinds), key=kinds.count)
    h, coherence = estimators(s.ff, s.xf, s.xx, settings.estimator)
    if s.count < 2:
        coherence = np.full(coherence.shape, np.nan)  # one hit has coherence 1 whatever its noise
    freqs = np.fft.rfftfreq(s.length, 1 / s.rate)
    power = np.array([DERIVATIVE[kind] - DERIVATIVE[k] for k in kinds])
    keep = (
        struck
        & (freqs <= (settings.fmax or np.inf))
        & ((freqs > 0) | (decay > 0) | (power == 0).all())
    )
    freqs, h, coherence = freqs[keep], h[keep], coherence[keep]
    if power.any():  # under the window the FRF stands at s + decay
        h = h * (2j * np.pi * freqs + decay)[:, None] ** power
    return FrfSet(
        h[:, :, None],
        np.asarray(freqs, dtype=np.float64),
        tuple(_of_kind(c, kind) for c in s.outputs),
        (channel(s.input, "force"),),
        coherence[:, :, None],
        np.array([float(s.count)]),
        FRF_KIND[kind],
        decay,
        source,
        s.kept,
        impacts=s.impacts.spread(len(s.outputs)) if s.impacts else None,
    )
