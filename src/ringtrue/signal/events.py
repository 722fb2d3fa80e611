"""Events that nobody measured: jumps, dropped weights, blows, seen in the responses alone.

Behind an event the structure rings freely, and the correlation of any later sample with any earlier one since then is
a sum of decays, as that of ambient vibration is. A pair of samples with the event between them is not, and few
events are too few to average it away: the earlier sample is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import maximum_filter1d

from ringtrue.core.arrays import Any_, Bool, Float

WIDTH = 16  # samples of a window
LOUD = 30.0  # times the median power; windows of a narrow band of noise do not reach it (exp(-30 ln 2) = 1e-9)
FADING = 0.05  # of the loudest window just before: what is below only rings
MEMORY = 64  # windows in which that one is sought
CHANNELS = 4  # that are listened to
DRIVEN = 0.5  # share of the power
LEAST = 0.3  # share of the record that must stay
DEARER, DEAR = 3.0, 0.1  # times the lost share, and share of the record, that lost stretches may take with them


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """When forces acted that stand out of the rest.

    Attributes
    ----------
    struck : (window,) bool
        Windows of the record in which one acts.
    window : float, s
    count : int
        Of the events: runs of struck windows.
    level : float, dB
        Median of their loudest windows over the median of all.
    share : float
        Of the power of the differentiated responses.
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
    gone: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))
    rate: float = 1.0

    @property
    def driven(self) -> bool:
        """Whether most of the motion comes from events: no stationary noise."""
        return self.share > DRIVEN

    @property
    def kept(self) -> float:
        """Share of the record that is not lost."""
        return 1.0 - float(self.gone.mean()) if self.gone.size else 1.0

    @property
    def breaks(self) -> float:
        """Number of lost stretches in a second of the record."""
        return self.rate * np.count_nonzero(np.diff(self.gone, prepend=False) & self.gone) / max(self.gone.size, 1)

    def free(self, samples: int, rate: float, lags: int) -> Any_ | None:
        """(sample,) float32: 1 where a sample may be the earlier one of a pair, 0 elsewhere; None: all of them.

        All of them, too, where the events come so often that little would be left. Lost stretches so short and many
        that far more than they would have to go stay, as straight lines.
        """
        ahead = _before(self.struck, 1 / self.window, samples, rate, lags)
        lost = _before(self.gone, self.rate, samples, rate, lags)
        if lost.mean() < DEARER * (1 - self.kept) + DEAR:
            ahead = ahead | lost
        return np.asarray(~ahead, dtype=np.float32) if 0 < ahead.mean() < 1 - LEAST else None


def _before(flags: Bool, flag_rate: float, samples: int, rate: float, lags: int) -> Bool:
    """(sample,) of a signal at `rate` Hz: one of the flags at their own rate follows within so many lags, or stands."""
    at = np.flatnonzero(flags)
    a = np.floor(at / flag_rate * rate).astype(np.int64) - lags - 1
    b = np.ceil((at + 1) / flag_rate * rate).astype(np.int64) + 1
    steps = np.zeros(samples + 1, dtype=np.int64)
    np.add.at(steps, a.clip(0, samples), 1)
    np.add.at(steps, b.clip(0, samples), -1)
    return np.asarray(np.cumsum(steps[:-1]) > 0)


NONE = Events(np.zeros(0, dtype=bool), 1.0, 0, 0.0, 0.0)


def find_events(data: Any_, rate: float) -> Events:
    """Events in responses (ch, sample) at `rate` Hz.

    The second difference brings out the highest frequencies, which die away first. An event is seen by most
    channels: a spike of one sensor is none.
    """
    power = _power(data)
    if not power.size or not (level := float(np.median(power))) > 0:
        return NONE
    recent = maximum_filter1d(power, MEMORY, origin=(MEMORY - 1) // 2, mode="nearest")
    struck = (power > LOUD * level) & (power > FADING * recent)
    if not struck.any():
        return NONE
    at = np.flatnonzero(struck)
    runs = np.split(at, np.flatnonzero(np.diff(at) > MEMORY) + 1)
    peaks = np.array([power[r].max() for r in runs]) / level
    share = float(1 - power[~_after(struck)].mean() / power.mean()) if not _after(struck).all() else 1.0
    return Events(struck, WIDTH / rate, len(runs), float(10 * np.log10(np.median(peaks))), share)


def _after(struck: Bool) -> Bool:
    """Struck windows and those that ring from them."""
    return np.asarray(maximum_filter1d(struck, MEMORY, origin=(MEMORY - 1) // 2, mode="nearest"))


def _power(data: Any_) -> Float:
    """(window,) of the second difference, in units of each channel's median, median of some channels."""
    some = np.unique(np.linspace(0, len(data) - 1, CHANNELS).round().astype(np.int64))
    n = max(data.shape[1] - 2, 0) // WIDTH
    power = np.empty((some.size, n))
    for own, k in zip(power, some, strict=True):  # channels: one stays in the cache
        d = np.diff(data[k].astype(np.float32), 2)[: n * WIDTH]
        own[:] = np.square(d, out=d).reshape(n, WIDTH).mean(1, dtype=np.float64)
    middle = np.median(power, axis=1) if n else np.zeros(0)
    alive = middle > 0
    return np.asarray(np.median(power[alive] / middle[alive, None], axis=0)) if alive.any() else np.empty(0)
