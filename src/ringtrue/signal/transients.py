"""Impacts that nobody measured: jumps, dropped weights, presses, seen in the responses alone.

Behind an event the structure rings freely, and the correlation of any later sample with any earlier
one since then is a sum of decays, as that of ambient vibration is. A pair of samples with the event
between them is not, and few events are too few to average it away: the earlier sample is not used.

Correlations that reach from one impact to the next do not average out where the intervals are equal
(a press, a pile driver). Impacts whose times are known are an input: the mean response to one is
the least-squares filter from them to the record. What is left of each varies from impact to impact
without memory, and does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_toeplitz
from scipy.ndimage import maximum_filter1d, median_filter

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.signals import FALSE_ALARM, TimeHistory
from ringtrue.signal.band_correlations import Signals, lowered
from ringtrue.signal.spectra import decimator
from ringtrue.signal.tonal_lines import channel_mixes

ORDER = 60  # of the prediction
WIDTH = 16  # samples of a window, and orders of a frame
FEWEST = 32  # changes, values or impacts: fewer say nothing
IMPACT_WINDOW = 4  # samples


@dataclass(frozen=True, slots=True)
class EventSettings:
    """What is an event, and what it takes away.

    Attributes
    ----------
    loud : float
        Times the median power around and of the record: noise does not reach it in ten million
        windows.
    fading : float
        Of the loudest window of the last frame: what is below only rings.
    spread : int, windows
        To either side, in which the force of an event rises and falls.
    """

    loud: float = 10.0
    fading: float = 0.05
    spread: int = 2


EVENT = EventSettings()


def prediction_error(x: Any_) -> Any_:
    """Error (sample,) of the linear prediction of a signal (sample,) from what went before (Yule
    and Walker).
    """
    from scipy.signal import oaconvolve  # slow to import, and few commands need it

    size = WIDTH * ORDER
    frames = x[: x.size // size * size].reshape(-1, size)
    spectra = rfft(frames, 2 * size, axis=1)
    r = irfft((spectra.real**2 + spectra.imag**2).sum(axis=0, dtype=np.float64))[
        : ORDER + 1
    ]
    if not r[0] > 0:
        return np.zeros_like(x)
    r[0] *= 1 + 1e-6
    filter_ = np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])]).astype(x.dtype)
    foreseen: Any_ = oaconvolve(x, filter_)
    return foreseen[: x.size]


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """When forces acted that stand out of the rest.

    Attributes
    ----------
    struck : (window,) bool
        Windows of the record in which one acts, and a few around them.
    window : float, s
    count : int
        Of the events: runs of struck windows.
    level : float, dB
        Median of their loudest windows over the median of all.
    share : float
        Of the power: that of the responses which has died away before the next event, or that of
        the force.
    times : (event,) float64, s
        When its largest force acts, to a sample.
    gone : (sample,) bool
        Lost by the recorder; () where nothing is.
    rate : float, Hz
        Of these samples.
    """

    struck: Bool
    window: float
    count: int
    level: float
    share: float
    times: Float = field(default_factory=lambda: np.zeros(0))
    gone: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))
    rate: float = 1.0

    @property
    def driven(self) -> bool:
        """Whether most of the motion comes from events: no stationary noise."""
        return self.share > 0.5

    def in_step(self, frequencies: Float) -> Bool:
        """(line,) whether lines at (line,) `frequencies`, Hz, are those of the events: they act at
        one phase of it, by the test of Rayleigh on the mean phasor.
        """
        turns = np.exp(-2j * np.pi * frequencies[:, None] * self.times)
        together = np.abs(turns.sum(axis=1)) ** 2 / max(self.times.size, 1)
        return np.asarray(together > -np.log(FALSE_ALARM))

    def lines_near(self, frequency: float) -> bool:
        """Whether the events have lines about a frequency, Hz: at the multiple of their rate that
        is nearest to it.
        """
        if self.times.size < 2:
            return False
        rate = (self.times.size - 1) / float(np.ptp(self.times))
        return bool(self.in_step(np.array([round(frequency / rate) * rate]))[0])

    @property
    def interval(self) -> float:
        """Median time between events, s; that of the record for a single one."""
        return (
            float(np.median(np.diff(self.times)))
            if self.times.size > 1
            else self.struck.size * self.window
        )

    def ends_before_next(self, longest_lag: float) -> bool:
        """Whether correlations of so many seconds end before the next event, from half of the
        samples or more.

        Events that follow within a pause are one by their `times`, but not here.
        """
        begins = np.flatnonzero(np.diff(self.struck.astype(np.int8), prepend=0) > 0)
        windows = np.diff(begins) if begins.size > 1 else self.struck.size
        return 2 * longest_lag < float(np.median(windows)) * self.window

    @property
    def kept(self) -> float:
        """Share of the record that is not lost."""
        return 1.0 - float(self.gone.mean()) if self.gone.size else 1.0

    @property
    def breaks(self) -> float:
        """Number of lost stretches in a second of the record."""
        return (
            self.rate
            * np.count_nonzero(np.diff(self.gone, prepend=False) & self.gone)
            / max(self.gone.size, 1)
        )

    def free(self, samples: int, rate: float, lags: int) -> Any_ | None:
        """(sample,) float32: 1 where a sample may be the earlier one of a pair, 0 elsewhere; None:
        all of them.

        All of them, too, where the events come so often that little would be left, but for decays
        that hold most of the motion. Lost stretches so short and many that far more than they would
        have to go stay, as straight lines.
        """
        ahead = _before(self.struck, 1 / self.window, samples, rate, lags)
        lost = _before(self.gone, self.rate, samples, rate, lags)
        if lost.mean() < 3.0 * (1 - self.kept) + 0.1:
            ahead = ahead | lost
        most = 1.0 if self.driven and self.ends_before_next(lags / rate) else 0.7
        return np.asarray(~ahead, dtype=np.float32) if 0 < ahead.mean() < most else None


NONE = Events(np.zeros(0, dtype=bool), 1.0, 0, 0.0, 0.0)


def _before(
    flags: Bool, flag_rate: float, samples: int, rate: float, lags: int
) -> Bool:
    """(sample,) of a signal at `rate` Hz: one of the flags at their own rate follows within so many
    lags, or stands.
    """
    at = np.flatnonzero(flags)
    a = np.floor(at / flag_rate * rate).astype(np.int64) - lags - 1
    b = np.ceil((at + 1) / flag_rate * rate).astype(np.int64) + 1
    steps = np.zeros(samples + 1, dtype=np.int64)
    np.add.at(steps, a.clip(0, samples), 1)
    np.add.at(steps, b.clip(0, samples), -1)
    return np.asarray(np.cumsum(steps[:-1]) > 0)


def find_events(data: Any_, rate: float, gone: Bool | None = None) -> Events:
    """Events in responses (ch, sample) at `rate` Hz.

    The error of a linear prediction is the force of the moment: decays are foreseen, and so are
    steady machines. An event is seen by most channels: a spike of one sensor is none. Where the
    record shows none, it is looked at again at lower rates: a soft impact is lost among the noise
    of a fast recorder. After the first sample, and samples (sample,) that are `gone`, nothing is
    foreseen.
    """
    lost = np.zeros(data.shape[1], dtype=bool) if gone is None else gone.copy()
    lost[:1] = True
    step = 1
    some = np.unique(np.linspace(0, len(data) - 1, 4).round().astype(np.int64))
    signals = Signals.of(data[some])
    part = signals.part(0, signals.samples)
    while True:
        found = _at_one_rate(part, rate / step, lost[::step])
        if found.count or -(-part.shape[1] // 4) < WIDTH**2 * ORDER:
            return found if gone is None else replace(found, gone=gone, rate=rate)
        part = lowered(Signals.of(part), decimator(4))
        step *= 4


def _at_one_rate(data: Any_, rate: float, lost: Bool) -> Events:
    """Events of some channels (ch, sample) float32, none where samples (sample,) are lost or soon
    after.
    """
    force = np.stack([prediction_error(x) ** 2 for x in data])
    power = _in_windows(force)
    middle = np.median(power, axis=1) if power.size else np.zeros(len(data))
    alive = middle > 0
    if not alive.any():
        return NONE
    force = force[alive] / middle[alive, None]
    power = np.median(power[alive] / middle[alive, None], axis=0)
    level = np.maximum(
        median_filter(power, 2 * ORDER + 1, mode="reflect"), np.median(power)
    )
    recent = maximum_filter1d(power, ORDER, origin=(ORDER - 1) // 2, mode="nearest")
    struck = (
        (power > EVENT.loud * level)
        & (power > EVENT.fading * recent)
        & ~_after_loss(lost, power.size)
    )
    if not struck.any():
        return NONE
    at = np.flatnonzero(struck)
    # windows around two events do not meet
    runs = np.split(at, np.flatnonzero(np.diff(at) > 2 * EVENT.spread + 1) + 1)
    loudest = np.array([r[power[r].argmax()] for r in runs])
    inside = WIDTH * loudest[:, None] + np.arange(WIDTH)
    largest = np.median(force[:, inside], axis=0).argmax(axis=1)
    times = inside[np.arange(len(runs)), largest] / rate
    decibels = float(10 * np.log10(np.median((power / level)[loudest])))
    ends = np.array([[r[0], r[-1]] for r in runs])
    faded = _faded(_in_windows(np.square(data[alive])), ends)
    struck = np.asarray(maximum_filter1d(struck, 2 * EVENT.spread + 1))
    forced = float(power[struck].sum() / power.sum())
    # each is less than the truth: where decays last, and where sensors are noisy
    share = max(faded, forced)
    return Events(
        struck=struck,
        window=WIDTH / rate,
        count=len(runs),
        level=decibels,
        share=share,
        times=times,
    )


def _after_loss(lost: Bool, windows: int) -> Bool:
    """(window,) whether one of the samples (sample,) in it, or before it in the reach of the
    prediction, is lost.
    """
    within = lost[: windows * WIDTH].reshape(windows, WIDTH).any(axis=1)
    reach = -(-ORDER // WIDTH)
    return np.asarray(maximum_filter1d(within, 2 * reach + 1))


def _in_windows(signals: Any_) -> Float:
    """(ch, window) means of signals (ch, sample)."""
    n = signals.shape[1] // WIDTH
    return np.asarray(
        signals[:, : n * WIDTH]
        .reshape(len(signals), n, WIDTH)
        .mean(axis=2, dtype=np.float64)
    )


def _faded(power: Float, ends: Int) -> float:
    """Share of the power (ch, window) of the responses that is gone at the end of the times between
    events.

    `ends` (event, 2) are the first and the last window of each. The median of these times: some
    events may be missed.
    """
    quiet = np.zeros(power.shape[1], dtype=bool)
    after = np.append(-1, ends[:, 1])
    before = np.append(ends[:, 0], power.shape[1])
    for a, b in zip(after.tolist(), before.tolist(), strict=True):  # a few events
        quiet[b - int(np.ceil(0.25 * (b - a - 1))) : b] = True
    if not quiet.any():
        return 0.0
    left = np.median(power[:, quiet], axis=1) / np.maximum(
        power.mean(axis=1), np.finfo(np.float64).tiny
    )
    return float(1 - np.median(left))


@dataclass(frozen=True, slots=True)
class RegularImpacts:
    """How many impacts, and their median interval, s."""

    count: int
    interval: float


def remove_regular_impacts(
    history: TimeHistory, mixes: Any_ | None = None
) -> tuple[TimeHistory, RegularImpacts | None]:
    """The record without the mean response to regular impacts, and these; the same object where
    there are none.

    `mixes` are its `channel_mixes`, if known.
    """
    at = _impact_samples(channel_mixes(history.data) if mixes is None else mixes)
    if not _regular(at):
        return history, None
    # the response is as long as the prediction is known from, in a long record
    taps = min(WIDTH * ORDER, history.data.shape[1] // WIDTH)
    return replace(history, data=_left(history.data, at, taps)), RegularImpacts(
        at.size, _usual_interval(at) / history.rate
    )


def _usual_interval(at: Int) -> float:
    """The lower median of the intervals of impacts (k,): one of them, as the mean of two may lie
    between an interval and its multiple.
    """
    return float(np.percentile(np.diff(at), 50, method="lower"))


def _regular(at: Int) -> bool:
    """Whether there are many impacts (k,), the phasors of whose intervals agree in most of their
    power.
    """
    if at.size < FEWEST:
        return False
    turns = np.exp(2j * np.pi * np.diff(at) / _usual_interval(at))
    return bool(2 * np.abs(turns.mean()) ** 2 > 1)


def _impact_samples(some: Any_) -> Int:
    """(k,) samples of impacts on the signals (ch, sample)."""
    error = np.stack([prediction_error(x) ** 2 for x in some])
    n = error.shape[1] // IMPACT_WINDOW * IMPACT_WINDOW
    power = error[:, :n].reshape(len(error), -1, IMPACT_WINDOW) @ np.full(
        IMPACT_WINDOW, 1 / IMPACT_WINDOW, dtype=error.dtype
    )
    typical = np.median(power, axis=1, keepdims=True)
    if not n or not (typical > 0).all():
        return np.empty(0, dtype=np.int64)
    power = (power / typical).mean(axis=0)
    top = _with_faint(
        np.flatnonzero(
            (power > EVENT.loud)
            & (power >= maximum_filter1d(power, 2 * (WIDTH // IMPACT_WINDOW) + 1))
        ),
        power,
    )
    around = np.clip(
        IMPACT_WINDOW * top[:, None] + np.arange(-2, IMPACT_WINDOW + 2),
        0,
        error.shape[1] - 1,
    )
    each = (error[:, around] / typical[:, :, None]).mean(axis=0)
    return np.asarray(
        np.unique(around[np.arange(top.size), each.argmax(axis=1)]), dtype=np.int64
    )


def _with_faint(top: Int, power: Any_) -> Int:
    """Windows (k,) of regular impacts, with the faint ones that are due between them: one left in
    would sound on.
    """
    if not _regular(top):
        return top
    usual = _usual_interval(top)
    off = np.abs(np.diff(top) - usual)
    reach = int(off[off < usual / 2].max())
    faint = []
    for a, b in pairwise(top.tolist()):
        count = round((b - a) / usual)
        for k in range(1, count):
            first = max(round(a + k * (b - a) / count) - reach, 0)
            faint.append(first + int(power[first : first + 2 * reach + 1].argmax()))
    return np.union1d(top, np.array(faint, dtype=np.int64))


def _left(data: Any_, at: Int, taps: int) -> Any_:
    """`data` (ch, sample) less what a filter of so many `taps` makes of unit impacts at the samples
    `at`.
    """
    samples = data.shape[1]
    n = int(next_fast_len(samples + taps, real=True))
    impacts = rfft(np.bincount(at, minlength=samples).astype(np.float64), n)
    r = irfft(impacts.real**2 + impacts.imag**2, n)[:taps]
    # equal intervals tell the response to one impact from that to the next no more
    r[0] *= 1.01
    shift = np.exp(2j * np.pi * 3 / n * np.arange(impacts.size))
    out = np.empty_like(data)
    for y, x in zip(out, data, strict=True):  # channels: one transform is long
        cross = irfft(
            rfft(x - x.mean(dtype=np.float64), n) * (impacts * shift).conj(), n
        )[:taps]
        response: Float = solve_toeplitz(r, cross)
        y[:] = x - irfft(rfft(response, n) * impacts * shift, n)[:samples]
    return out
