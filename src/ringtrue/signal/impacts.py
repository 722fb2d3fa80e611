"""Impacts of a hammer in a record: where they are, which of them can be used, and what rings on
from earlier ones.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.channels import FORCES, input_id
from ringtrue.core.choice import SAME_HIT_S, Hit
from ringtrue.core.signals import Impacts, TimeHistory, pad_rows
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.signal.channel_checks import (
    clipping_levels,
    mostly_overloaded,
    overloaded,
)

Estimator = Literal["H1", "H2", "Hv"]
_HAMMER = re.compile(
    r"(?<![a-z])(force|hammer|impact|impulse|kraft|f)(?![a-z])", re.IGNORECASE
)
_BEGUN = 0.05  # of the peak, that no sample before it is below
_BAD_RINGING = 0.2  # rms before the hit to rms after it
_NOISE_LINES = 128  # that the noise is kept at


@dataclass(frozen=True, slots=True)
class HammerSettings:
    """How hits are found and FRFs are estimated.

    Attributes
    ----------
    force : str
        Id of the force channel, or a pattern of it (`Hammer*`); by default the only channel whose
        quantity is force, or, where none is, the only one of unknown quantity with a name such as
        `Force` or `hammer`.
    block : float, s, optional
        Length of a block; by default what fits between the hits.
    pretrigger : float, s
        Part of the block before the hit.
    trigger : float
        Level of a hit, as a share of the largest force of the record.
    double : float
        A second pulse above this share of the first makes a double hit.
    weak : float
        A hit below this share of the median hit is left out.
    force_window : float, s, optional
        Length after the hit that the force is kept; by default four pulse widths, 1 ms and 16
        samples at least, but no longer than the pulse stands out of the noise between the impacts.
    exp_end : float, optional
        Value of the exponential window at the end of the block, 1 for none; by default what lets
        the responses end at 1 % of their start.
    estimator : {"H1", "H2", "Hv"}
    fmax : float, Hz, optional
        Highest line kept.
    keep_to : float, Hz, optional
        Lines are kept up to here though the force be noise there; all are up to where it stands out
        of its noise.
    hits : tuple of Hit
        Hits of these and other records that are kept or left out by hand.
    """

    force: str = ""
    block: float | None = None
    pretrigger: float = 0.02
    trigger: float = 0.1
    double: float = 0.05
    weak: float = 0.1
    force_window: float | None = None
    exp_end: float | None = None
    estimator: Estimator = "H1"
    fmax: float | None = None
    keep_to: float | None = None
    hits: tuple[Hit, ...] = ()

    def __post_init__(self) -> None:
        if self.estimator not in ("H1", "H2", "Hv"):
            raise ConfigError(
                f"estimator {self.estimator!r}{did_you_mean(self.estimator, ('H1', 'H2', 'Hv'))}"
            )
        if not 0 < self.trigger < 1 or not 0 < self.double < 1:
            raise ConfigError(
                f"trigger {self.trigger} and double {self.double} are shares between 0 and 1"
            )
        if self.exp_end is not None and not 0 < self.exp_end <= 1:
            raise ConfigError(f"exp_end {self.exp_end} must be in (0, 1]")
        if self.block is not None and not self.block > self.pretrigger >= 0:
            raise ConfigError(
                f"block {self.block} s must be longer than pretrigger {self.pretrigger} s >= 0"
            )


@dataclass(frozen=True, slots=True)
class ImpactReport:
    """One hit.

    Attributes
    ----------
    source : str
        The record.
    input : str
        Id of the point and direction that was hit.
    time : float, s
        In the record.
    peak : float, N
        Largest force, with its sign.
    width : float, s
        Of the pulse at half its peak.
    accepted : bool
    reasons : tuple of str
        Why it was left out, or what is wrong with one that was used.
    lost : tuple of str
        Ids of responses that overload in most impacts, and are left out instead of these.
    """

    source: str
    input: str
    time: float
    peak: float
    width: float
    accepted: bool
    reasons: tuple[str, ...]
    lost: tuple[str, ...] = ()


def force_channel(record: TimeHistory, settings: HammerSettings) -> int:
    """Position of the force channel.

    Raises
    ------
    DataError
        If there is none, or several and none is named.
    """
    ids = [c.id for c in record.channels]
    if settings.force:
        like = (
            [settings.force]
            if settings.force in ids
            else fnmatch.filter(ids, settings.force)
        )
        if not like:
            raise DataError(
                f"{record.source}: no channel {settings.force!r}{did_you_mean(settings.force, ids)}"
            )
        if len(like) > 1:
            raise DataError(
                f"{record.source}: {settings.force!r} may be {' '.join(like[:20])}; there must "
                "be one force"
            )
        return ids.index(like[0])
    at = [i for i, c in enumerate(record.channels) if c.quantity in FORCES]
    at = at or [
        i
        for i, c in enumerate(record.channels)
        if c.quantity == "unknown" and _HAMMER.search(c.id)
    ]
    if len(at) != 1:
        raise DataError(
            f"{record.source}: {len(at)} force channels "
            f"({' '.join(ids[i] for i in at) or 'none'}) of "
            f"{' '.join(ids[:20])}; there must be one, or name it: HammerSettings.force, --force, "
            "`force_channel` of a log (of a shaken base the accelerometer on it); several are "
            "those of "
            "shakers that run all the "
            f"time{'' if at else '; `ringtrue oma` takes records without a force'}"
        )
    return at[0]


def pulses(force: Float, rate: float, level: float) -> tuple[Int, Int]:
    """First and peak sample of every pulse of |force| above a level; gaps under 0.5 ms do not
    divide a pulse.
    """
    above = np.flatnonzero(np.abs(force) > level)
    if not above.size:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    cut = np.flatnonzero(np.diff(above) > max(1, round(0.0005 * rate))) + 1
    runs = np.split(above, cut)
    first = np.array([r[0] for r in runs], dtype=np.int64)
    return first, np.array([r[np.abs(force[r]).argmax()] for r in runs], dtype=np.int64)


def find_impacts(force: Float, rate: float, settings: HammerSettings) -> Int:
    """Samples of the peaks of the hits, (h,), ascending; rebounds within 0.25 s or half a block are
    not hits.

    Parameters
    ----------
    force : (sample,) float64, N, without offset
    rate : float, Hz
    settings : HammerSettings
    """
    level = max(settings.trigger * np.abs(force).max(), 6 * _robust_std(force))
    _, peak = pulses(force, rate, level)
    hold = round(rate * min(0.25, 0.5 * (settings.block or 1.0)))
    hits: list[int] = []
    for p in peak.tolist():  # a few dozen pulses
        if not hits or p - hits[-1] > hold:
            hits.append(p)
    return np.array(hits, dtype=np.int64)


def _robust_std(x: Float) -> float:
    """Robust standard deviation."""
    return float(1.4826 * np.median(np.abs(x - np.median(x))))


def block_length(hits: Int, samples: int, rate: float, settings: HammerSettings) -> int:
    """Samples of a block: as set, else what fits between nine of ten hits, even."""
    if settings.block is not None:
        return 2 * round(settings.block * rate / 2)
    ends = np.append(hits, samples)
    room = np.quantile(np.diff(ends), 0.1, method="lower") if hits.size else 0
    return 2 * int(0.98 * room / 2)


def check_impacts(
    record: TimeHistory,
    at: int,
    hits: Int,
    length: int,
    settings: HammerSettings,
    full_scale: Mapping[str, float] | None = None,
) -> tuple[ImpactReport, ...]:
    """The verdict on every hit.

    Parameters
    ----------
    record : TimeHistory
    at : int
        Force channel.
    hits : (h,) int64, samples of the peaks
    length : int
        Samples of a block.
    settings : HammerSettings
    full_scale : mapping of str to float, optional
        Range of each channel by id, in its unit; without it clipping is recognised by equal extreme
        samples.
    """
    force = np.asarray(record.data[at], dtype=np.float64)
    force = force - np.median(force)
    typical = float(np.median(np.abs(force[hits]))) if hits.size else 0.0
    pre = round(settings.pretrigger * record.rate)
    known = {k: v for k, v in (full_scale or {}).items() if np.isfinite(v)}
    limits = clipping_levels(record) | known
    reports = []
    responses = np.delete(np.arange(len(record.channels)), at)
    unrest = [
        _unrest(record.data[responses, h - pre : h - pre + length], pre)
        for h in hits.tolist()
        if h >= pre
    ]
    quietest = min(unrest) if len(unrest) > 1 else 0.0
    blocks = [record.data[:, max(h - pre, 0) : h - pre + length] for h in hits.tolist()]
    over = [overloaded(record, b, limits) for b in blocks]
    lost = mostly_overloaded(
        {c.id for k, c in enumerate(record.channels) if k != at}, over
    )
    for k, hit in enumerate(hits.tolist()):  # a few dozen hits
        start = hit - pre
        stop = hit - pre + length
        why = _place(start, stop, record.data.shape[1], hits[k + 1 :], record.rate)
        if abs(force[hit]) < settings.weak * typical:
            why.append(f"weak: {abs(force[hit]):.3g} N, the median is {typical:.3g} N")
        if start >= 0:
            why += _double(force, hit, stop, record.rate, settings)
            why += [f"overload of {' '.join(over[k][:8])}"] if over[k] else []
            why += _ringing(_unrest(blocks[k][responses], pre), quietest)
        name = input_id(record.channels[at].id)
        width = pulse_width(force, hit) / record.rate
        causes = tuple(why) or _begun(force[: hit + 1])
        reports.append(
            ImpactReport(
                source=record.source,
                input=name,
                time=hit / record.rate,
                peak=float(force[hit]),
                width=width,
                accepted=not why,
                reasons=causes,
                lost=lost,
            )
        )
    return tuple(reports)


def record_names(source: str) -> tuple[str, str]:
    """What a choice may call a record: its source, and that without folder and ending."""
    path, _, number = source.partition(" #")
    stem = PurePath(path).stem
    return source, f"{stem} #{number}" if number else stem


def decided(
    reports: Sequence[Sequence[ImpactReport]], hits: Sequence[Hit]
) -> list[tuple[ImpactReport, ...]]:
    """The reports of each record after a choice by hand; entries on other records change nothing.

    Raises
    ------
    ConfigError
        If an entry means no hit.
    """
    out = []
    for mine in reports:
        changed = list(mine)
        for hit in hits:
            if not mine or hit.record not in record_names(mine[0].source):
                continue
            k = int(np.argmin([abs(r.time - hit.time) for r in mine]))
            if abs(mine[k].time - hit.time) > SAME_HIT_S:
                there = " ".join(f"{r.time:.2f}" for r in mine[:20])
                raise ConfigError(
                    f"hit of {hit.record} at {hit.time:g} s: there is none within {SAME_HIT_S} s; "
                    f"there are {there} s"
                )
            said = f"{'kept' if hit.keep else 'left out'} by hand: {hit.reason}"
            reasons = (*mine[k].reasons, said)
            changed[k] = replace(mine[k], accepted=hit.keep, reasons=reasons)
        out.append(tuple(changed))
    return out


def _begun(rise: Float) -> tuple[str, ...]:
    """A remark where the force never was near 0 before its peak: the record begins within the
    pulse.
    """
    share = np.sign(rise[-1]) * rise / max(abs(rise[-1]), 1e-300)
    if not share.min() > _BEGUN:
        return ()
    return (
        f"the record begins within the pulse, at {100 * share[0]:.0f} % of its peak: no modal "
        "mass can be exact",
    )


def _place(start: int, stop: int, samples: int, later: Int, rate: float) -> list[str]:
    why = []
    if start < 0:
        why.append("no room for the pretrigger at the start of the record")
    if stop > samples:
        why.append("the record ends before the block")
    if later.size and later[0] < stop:
        why.append(
            f"the next hit comes {(stop - later[0]) / rate:.3g} s before the end of the block"
        )
    return why


def pulse_width(force: Float, hit: int) -> int:
    """Samples around the peak above half of it."""
    half = np.abs(force) >= 0.5 * abs(force[hit])
    left = hit - int(np.argmin(half[hit::-1])) if not half[: hit + 1].all() else 0
    right = hit + int(np.argmin(half[hit:])) if not half[hit:].all() else force.size
    return right - left - 1


def _double(
    force: Float, hit: int, stop: int, rate: float, settings: HammerSettings
) -> list[str]:
    """A second pulse of the same sign, once the first has come down."""
    sign = np.sign(force[hit])
    width = pulse_width(force, hit)
    tail = sign * force[hit + 2 * width + 2 : min(stop, hit + round(0.5 * rate))]
    level = max(settings.double * abs(force[hit]), 8 * _robust_std(force))
    down = np.flatnonzero(tail < 0.5 * level)
    if not down.size or not (tail[down[0] :] > level).any():
        return []
    second = int(tail[down[0] :].argmax()) + int(down[0]) + 2 * width + 2
    share = sign * force[hit + second] / abs(force[hit])
    return [
        f"double hit: {100 * share:.0f} % of the first pulse {1000 * second / rate:.3g} ms after it"
    ]


def _unrest(responses: Any_, pre: int) -> float:
    """Level before the hit over that after it, 0 where it is not known.

    The lower quartile of the channels: across the direction of the impact many show nothing but
    noise.
    """
    if pre < 4 or not responses.shape[0]:
        return 0.0
    centred = responses - np.median(responses, axis=1, keepdims=True)
    before = np.sqrt(
        np.mean(np.square(centred[:, : pre // 2], dtype=np.float64), axis=1)
    )
    after = np.sqrt(
        np.mean(
            np.square(
                centred[:, pre : pre + responses.shape[1] // 4], dtype=np.float64
            ),
            axis=1,
        )
    )
    return float(np.quantile(before / np.maximum(after, 1e-300), 0.25))


def _ringing(share: float, quietest: float) -> list[str]:
    """The structure still rings from the hit before; a level that all hits of the record have is
    noise.
    """
    if share <= max(_BAD_RINGING, 3 * quietest):
        return []
    return [f"still ringing before the hit: {100 * share:.0f} % of the response"]


def impacts_of(
    force: Float,
    rate: float,
    hits: Int,
    used: Int,
    pulses: Sequence[Float],
    quiet: Sequence[float],
) -> Impacts:
    """Impacts of one record; the weights (impact, 1, 1) are their squared impulses.

    Parameters
    ----------
    force : (sample,) float64, N, without offset
    rate : float, Hz
    hits, used : (h,), (u,) int64
        Samples of the peaks of all hits, and of those in the FRFs.
    pulses : u of (freq,) float64
        Power spectra of the pulses, up to half the rate.
    quiet : u of float
        Power of the noise at a line of each.
    """
    impulse, time = np.transpose([_impulse(force, h) for h in hits.tolist()])
    time = time / rate
    at = np.searchsorted(hits, used).tolist()
    step = max(1, pulses[0].size // _NOISE_LINES)
    noise = np.array(
        [
            q / np.maximum(p[::step], max(q, 1e-300))
            for p, q in zip(pulses, quiet, strict=True)
        ]
    )
    return Impacts(
        pad_rows([time[k] - time[:k] for k in at]),
        pad_rows([impulse[:k] / impulse[k] for k in at]),
        (impulse[at] ** 2)[:, None, None],
        0.5 * rate * np.arange(0, pulses[0].size, step) / (pulses[0].size - 1),
        noise,
    )


def _impulse(force: Float, hit: int) -> tuple[float, float]:
    """Sum of the samples of a pulse and where its centre is, in samples."""
    half = 2 * pulse_width(force, hit) + 2
    first = max(hit - half, 0)
    pulse = force[first : hit + half + 1]
    impulse = float(pulse.sum())
    return impulse, first + float(np.arange(pulse.size) @ pulse) / impulse
