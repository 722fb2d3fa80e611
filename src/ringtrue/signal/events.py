"""Events that nobody measured: jumps, dropped weights, blows, seen in the responses alone.

Behind an event the structure rings freely, and the correlation of any later sample with any earlier
one since then is a sum of decays, as that of ambient vibration is. A pair of samples with the event
between them is not, and few events are too few to average it away: the earlier sample is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.signal.prediction import FRAME, ORDER, unforeseen
from ringtrue.signal.pyramid import Signals, lowered
from ringtrue.signal.stream import decimator

WIDTH = 16  # samples of a window
# times the median power around and of the record: noise does not reach it in ten million windows
LOUD = 10.0
FADING = 0.05  # of the loudest window just before: what is below only rings
MEMORY = 64  # windows in which that one is sought
APART = 8  # windows without force between two events
SPREAD = 2  # windows to either side, in which the force of an event rises and falls
HELD = 0.5  # of the power of the record, at a lower rate
STEP = 4  # from one rate to the next
LEAST_FRAMES = 16  # of the prediction, at a lower rate: fewer are foreseen by chance
LAST = 0.25  # of the time to the next event: when its decay is looked at
CHANNELS = 4  # that are listened to
DRIVEN = 0.5  # share of the power
REGULAR = (
    8  # events: lines of fewer at equal intervals are nearer than the window of a periodogram tells
)
IN_STEP = 0.7  # mean phasor of the events at the frequency of a line that they make
LEAST = 0.3  # share of the record that must stay
DEARER, DEAR = (
    3.0,
    0.1,
)  # times the lost share, and share of the record, that lost stretches may take with them


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """When forces acted that stand out of the rest.

    Attributes
    ----------
    struck : (window,) bool
        Windows of the record in which one acts, and a few beside them.
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
        return self.share > DRIVEN

    def in_step(self, frequencies: Float) -> Bool:
        """(line,) whether lines at (line,) `frequencies`, Hz, are those of the events: they act at
        one phase of it.
        """
        if self.times.size < REGULAR:
            return np.zeros(frequencies.size, dtype=bool)
        turns = np.exp(-2j * np.pi * frequencies[:, None] * self.times)
        return np.asarray(np.abs(turns.mean(axis=1)) > IN_STEP)

    def lines_near(self, frequency: float) -> bool:
        """Whether the events have lines about a frequency, Hz: at the multiple of their rate that
        is nearest to it.
        """
        if self.times.size < REGULAR:
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

        All of them, too, where the events come so often that little would be left. Lost stretches
        so short and many that far more than they would have to go stay, as straight lines.
        """
        ahead = _before(self.struck, 1 / self.window, samples, rate, lags)
        lost = _before(self.gone, self.rate, samples, rate, lags)
        if lost.mean() < DEARER * (1 - self.kept) + DEAR:
            ahead = ahead | lost
        return np.asarray(~ahead, dtype=np.float32) if 0 < ahead.mean() < 1 - LEAST else None


def _before(flags: Bool, flag_rate: float, samples: int, rate: float, lags: int) -> Bool:
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


NONE = Events(np.zeros(0, dtype=bool), 1.0, 0, 0.0, 0.0)


def find_events(data: Any_, rate: float, gone: Bool | None = None) -> Events:
    """Events in responses (ch, sample) at `rate` Hz.

    The error of a linear prediction is the force of the moment: decays are foreseen, and so are
    steady machines. An event is seen by most channels: a spike of one sensor is none. Where the
    record shows none, it is looked at again at lower rates that still hold half of its power: a
    soft impact is lost among the noise of a fast recorder. After the first sample, and samples
    (sample,) that are `gone`, nothing is foreseen.
    """
    lost = np.zeros(data.shape[1], dtype=bool) if gone is None else gone.copy()
    lost[:1] = True
    step = 1
    some = np.unique(np.linspace(0, len(data) - 1, CHANNELS).round().astype(np.int64))
    signals = Signals.of(data[some])
    part = signals.part(0, signals.samples)
    power = np.square(part).mean(axis=1, dtype=np.float64)
    while True:
        found = _at_one_rate(part, rate / step, lost[::step])
        part, step = lowered(Signals.of(part), decimator(STEP)), STEP * step
        left = np.square(part).mean(axis=1, dtype=np.float64)
        if (
            found.count
            or part.shape[1] < LEAST_FRAMES * FRAME
            or np.median(left) < HELD * np.median(power)
        ):
            return found if gone is None else replace(found, gone=gone, rate=rate)


def _at_one_rate(data: Any_, rate: float, lost: Bool) -> Events:
    """Events of some channels (ch, sample) float32, none where samples (sample,) are lost or soon
    after.
    """
    force = np.stack([unforeseen(x) ** 2 for x in data])
    power = _in_windows(force)
    middle = np.median(power, axis=1) if power.size else np.zeros(len(data))
    alive = middle > 0
    if not alive.any():
        return NONE
    force = force[alive] / middle[alive, None]
    power = np.median(power[alive] / middle[alive, None], axis=0)
    level = np.maximum(median_filter(power, 2 * MEMORY + 1, mode="reflect"), np.median(power))
    recent = maximum_filter1d(power, MEMORY, origin=(MEMORY - 1) // 2, mode="nearest")
    struck = (power > LOUD * level) & (power > FADING * recent) & ~_after_loss(lost, power.size)
    if not struck.any():
        return NONE
    at = np.flatnonzero(struck)
    runs = np.split(at, np.flatnonzero(np.diff(at) > APART) + 1)
    loudest = np.array([r[power[r].argmax()] for r in runs])
    inside = WIDTH * loudest[:, None] + np.arange(WIDTH)
    largest = np.median(force[:, inside], axis=0).argmax(axis=1)
    times = inside[np.arange(len(runs)), largest] / rate
    decibels = float(10 * np.log10(np.median((power / level)[loudest])))
    ends = np.array([[r[0], r[-1]] for r in runs])
    faded = _faded(_in_windows(np.square(data[alive])), ends)
    struck = np.asarray(maximum_filter1d(struck, 2 * SPREAD + 1))
    forced = float(power[struck].sum() / power.sum())
    share = max(
        faded, forced
    )  # each is less than the truth: where decays last, and where sensors are noisy
    return Events(struck, WIDTH / rate, len(runs), decibels, share, times)


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
        signals[:, : n * WIDTH].reshape(len(signals), n, WIDTH).mean(axis=2, dtype=np.float64)
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
        quiet[b - int(np.ceil(LAST * (b - a - 1))) : b] = True
    if not quiet.any():
        return 0.0
    left = np.median(power[:, quiet], axis=1) / np.maximum(
        power.mean(axis=1), np.finfo(np.float64).tiny
    )
    return float(1 - np.median(left))
