"""Decays of a record in bands: from just behind each impact on, down to the noise.

The filters run backwards in time. A filtered sample then depends on later ones only, so that no
impact reaches into the decay behind it, and a decaying exponential stays one: the filter multiplies
its amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.signal.spectra import Band

STOP_DB = 120.0  # what other bands leave in a band stays below the noise of any recorder


@dataclass(frozen=True, slots=True, eq=False)
class BandDecays:
    """The decays of one band.

    Attributes
    ----------
    band : Band
    rate : float, Hz
        Of the samples.
    decays : tuple of (ch, sample) float64
        One an impact; those in which nothing rings are left out.
    impacts : (decay,) int64
        Of which impact each is.
    freqs : (f,) float64, Hz
    gain : (f,) float64
        Modulus of the filters.
    """

    band: Band
    rate: float
    decays: tuple[Float, ...]
    impacts: Int
    freqs: Float
    gain: Float

    def gain_at(self, frequencies: Float) -> Float:
        """(m,) gain of the filters at frequencies (m,), Hz."""
        return np.asarray(np.interp(frequencies, self.freqs, self.gain))


def decays_of(data: Any_, rate: float, bounds: Int, bands: Sequence[Band]) -> list[BandDecays]:
    """The decays of each band.

    Parameters
    ----------
    data : (ch, sample) float
    rate : float, Hz
    bounds : (decay, 2) int64
        First sample of each decay, and the first one behind it.
    bands : sequence of Band, from the highest
        The rate of each divides that of the one before, and the first one that of the record.
    """
    from scipy.signal import sosfreqz  # slow to import, and few commands need it

    parts = [np.array(data[:, a:b], dtype=np.float64) for a, b in bounds.tolist()]
    total = [np.ones(1 << 13) for _ in bands]
    out = []
    now = rate
    lowered: list[tuple[Float, float]] = []
    for k, band in enumerate(bands):
        factor = round(now / band.rate)
        if factor > 1:
            low = _filter(0.36 / factor, 0.5 / factor, "low")
            parts = [_backwards(low, y)[:, ::factor] for y in parts]
            lowered.append((low, now))
        now /= factor
        f = (np.arange(total[k].size) + 0.5) * 0.5 * now / total[k].size
        gain = np.ones(f.size)
        for sections, at_rate in lowered:
            gain *= np.abs(sosfreqz(sections, 2 * np.pi * f / at_rate)[1])
        high = _filter(0.8 * band.low / now, 0.4 * band.low / now, "high")
        gain *= np.abs(sosfreqz(high, 2 * np.pi * f / now)[1])
        memory = _memory(high) + sum(_memory(s) * now / at for s, at in lowered)
        filtered = [_backwards(high, y) for y in parts]
        kept = [_sounding(y, int(min(memory, y.shape[1] // 3))) for y in filtered]
        alive = [i for i, y in enumerate(kept) if y.shape[1]]
        out.append(
            BandDecays(
                band=band,
                rate=now,
                decays=tuple(kept[i] for i in alive),
                impacts=np.array(alive, dtype=np.int64),
                freqs=f,
                gain=gain,
            )
        )
    return out


def _filter(passing: float, stopped: float, kind: Literal["low", "high"]) -> Float:
    """(section, 6) elliptic filter, edges in cycles a sample."""
    from scipy.signal import ellip, ellipord  # slow to import, and few commands need it

    order, edge = ellipord(2 * passing, 2 * stopped, 0.02, STOP_DB)
    return np.asarray(ellip(int(order), 0.02, STOP_DB, float(edge), kind, output="sos"))


def _backwards(sections: Float, y: Float) -> Float:
    from scipy.signal import sosfilt  # slow to import, and few commands need it

    return np.asarray(sosfilt(sections, y[:, ::-1], axis=1)[:, ::-1])


def _memory(sections: Float) -> float:
    """Samples after which a filter has forgotten all but a ten-thousandth."""
    poles = max(float(np.abs(np.roots(s[3:])).max()) for s in sections)
    return float(np.log(1e-4) / np.log(poles))


def _sounding(y: Float, memory: int) -> Float:
    """A decay (ch, sample) without the end that the filter had to begin with, cut off twice as
    far from its begin as it stands out of the noise.

    () samples where it does not.
    """
    y = y[:, : y.shape[1] - memory]
    frames = min(y.shape[1] // 16, 256)
    if frames < 4:
        return y[:, :0]
    size = y.shape[1] // frames
    power = np.square(y[:, : frames * size]).reshape(len(y), frames, size).mean(axis=2)
    floor = np.maximum(np.quantile(power, 0.1, axis=1), np.finfo(np.float64).tiny)
    level = (power / floor[:, None]).mean(axis=0)
    # of the mean square of so many independent samples, at least
    scatter = np.sqrt(2 / (0.5 * size * len(y)))
    loud = np.flatnonzero(level > (1 + 6 * scatter) * np.quantile(level, 0.1))
    if not loud.size:
        return y[:, :0]
    end = max(2 * (int(loud[-1]) + 1) * size, 256)
    return np.ascontiguousarray(y[:, :end])
