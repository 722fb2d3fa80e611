"""Decays of a record in bands, and all modes of the decays of one band, one after the other, the
bent ones as their amplitude bends them.

The decays last from just behind each impact down to the noise. The filters run backwards in time. A
filtered sample then depends on later ones only, so that no impact reaches into the decay behind it,
and a decaying exponential stays one: the filter multiplies its amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.identification.ambient.confidence import LIMITS
from ringtrue.identification.ambient.decay_backbone import (
    Envelope,
    envelope,
    fit_backbone,
)
from ringtrue.identification.ambient.decay_fit import (
    EMPTY,
    DecayFloor,
    DecayModel,
    DecayPeak,
    Decays,
    DecaySums,
    fit,
    left_over,
    noise_floor,
    strongest_decay,
)
from ringtrue.identification.common.stabilisation import unit
from ringtrue.signal.spectra import Band, check_band
from ringtrue.signal.tonal_lines import DYNAMIC_RANGE


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


def decays_of(
    data: Any_, rate: float, bounds: Int, bands: Sequence[Band]
) -> list[BandDecays]:
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
    """(section, 6) elliptic filter, edges in cycles a sample; what is stopped is rounding."""
    from scipy.signal import ellip, ellipord  # slow to import, and few commands need it

    stop = -10 * np.log10(DYNAMIC_RANGE)
    order, edge = ellipord(2 * passing, 2 * stopped, 0.02, stop)
    return np.asarray(ellip(int(order), 0.02, stop, float(edge), kind, output="sos"))


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


@dataclass(frozen=True, slots=True)
class DecaySettings:
    """Settings; the defaults need no tuning.

    Attributes
    ----------
    fmin, fmax : float, Hz
        Band of interest; None: eight cycles in the longest decay, and what the rate allows.
    decades : float
        That the power falls by behind the impacts in a record of free decays.
    """

    fmin: float | None = None
    fmax: float | None = None
    decades: float = 1.5

    def __post_init__(self) -> None:
        check_band(self.fmin, self.fmax)


@dataclass(frozen=True, slots=True, eq=False)
class BandFit:
    """The modes of one band and what they leave.

    Attributes
    ----------
    part : BandDecays
    scaled : tuple of (ch, sample) float64
        The decays in units of the noise.
    scale : (ch,) float64
    sums : DecaySums
    floor : DecayFloor
    critical : float
        Gain that noise alone rarely reaches.
    """

    part: BandDecays
    scaled: Decays
    scale: Float
    sums: DecaySums
    floor: DecayFloor
    critical: float

    def shape(self, k: int) -> Complex:
        """(ch,) shape of a mode from all decays, largest component 1, in the units of the
        channels.
        """
        each = self.sums.amplitudes[:, :, k].T * self.scale[:, None]
        left = np.linalg.svd(each, full_matrices=False)[0]
        return np.asarray(unit(left[:, :1])[:, 0])

    def envelopes(self, k: int) -> list[Envelope]:
        """The envelope of a mode in each decay, in the unit of its largest channel."""
        pole = self.sums.model.poles[k]
        hertz = pole.imag / (2 * np.pi)
        half = max(
            float(-pole.real) / (2 * np.pi),
            0.3 * self.part.rate / len(self.scaled[0][0]),
        )
        width = min(8 * half, 0.2 * hertz) / self.part.rate
        # of the time that its frequency is of
        gain = self.part.gain_at(np.array([hertz]))[0]
        shape = self.shape(k) / self.scale * gain
        variance = self.floor.at(np.array([hertz]))[:, 0]
        own = left_over(self.scaled, self.part.rate, self.sums, keep=k)
        alone = self.sums.model.take([k])
        out = []
        for i, y in enumerate(own):
            basis = alone.basis(i, y.shape[1], self.part.rate)[0]
            one = envelope(y, shape, variance, basis, width)
            carrier = np.exp(-1j * pole.imag / self.part.rate * np.arange(y.shape[1]))
            out.append(replace(one, signal=one.signal * carrier))
        return out


def fit_band(part: BandDecays) -> BandFit:
    """All modes of the decays of a band, one after the other."""
    longest = max(part.decays, key=lambda y: y.shape[1])
    quarter = longest.shape[1] // 4
    scale = longest[:, -quarter:].std(axis=1)
    scale = np.maximum(scale, 1e-12 * scale.max(initial=1e-300))
    seen = part.freqs[part.gain > 1e-3]
    limits = (float(seen[0]), float(seen[-1]))
    found = _state(part, scale, EMPTY, np.inf)
    for _ in range(quarter):  # four unknowns each, at least
        rest = left_over(found.scaled, part.rate, found.sums)
        peak = strongest_decay(rest, part.rate, found.floor, limits)
        if peak.gain < peak.critical:
            return _without_weak(replace(found, critical=peak.critical))
        scale = found.scale * np.sqrt(
            np.median(found.floor.variance[:, part.gain > 0.7], axis=1)
        )
        more = _state(part, scale, found.sums.model.plus(peak.pole), peak.critical)
        bent = _with_backbone(found, scale, peak)
        found = more if bent is None or _squares(more) <= _squares(bent) else bent
    return _without_weak(found)


def _state(
    part: BandDecays,
    scale: Float,
    model: DecayModel,
    critical: float,
) -> BandFit:
    scaled = tuple(y / scale[:, None] for y in part.decays)
    sums = fit(scaled, part.rate, model)
    floor = noise_floor(
        left_over(scaled, part.rate, sums), part.rate, part.freqs, part.gain
    )
    return BandFit(part, scaled, scale, sums, floor=floor, critical=critical)


def _squares(found: BandFit) -> float:
    """Sum of squares with the price of the parameters (Schwarz 1978)."""
    samples = sum(y.size for y in found.scaled)
    size = found.sums.amplitudes
    parameters = 2 * size.size + 2 * size.shape[2]
    return float(found.sums.squares + parameters * np.log(samples))


def _with_backbone(found: BandFit, scale: Float, peak: DecayPeak) -> BandFit | None:
    """The fit with the strongest mode near a peak as its amplitude bends it, in the place of the
    weaker ones of its shape; None where there is none, or it is not bent.
    """
    model = found.sums.model
    if not model.poles.size:
        return None
    distance = np.abs(model.poles.imag - peak.pole.imag)
    near = distance < LIMITS.mixing * np.maximum(-model.poles.real, -peak.pole.real)
    if not near.any():
        return None
    k = int(np.where(near, found.sums.gain, -1.0).argmax())
    away = np.abs(model.poles.imag - model.poles.imag[k])
    close = away < LIMITS.mixing * np.maximum(-model.poles.real, -model.poles.real[k])
    gain = found.sums.gain
    shape = found.shape(k)
    like = np.array([shape_mac(found.shape(j), shape) > 0.9 for j in range(gain.size)])
    replaced = close & like & (gain < gain[k])
    kept = np.flatnonzero(~replaced).tolist()
    best: BandFit | None = None
    now = found
    if len(kept) < gain.size:
        now = _state(found.part, scale, model.take(kept), peak.critical)
    k = kept.index(k)
    for _ in range(4):  # the envelope is the better known the better the mode is
        model = now.sums.model
        parts = now.envelopes(k)
        fitted = fit_backbone(parts, model.poles[k], now.part.rate)
        if fitted is None or not fitted[0].nonlinear:
            return best
        backbone, factors = fitted
        if backbone.fit_damping.min() <= 0:  # beats of two modes: no mode gains energy
            return best
        middle = float(np.median(backbone.amplitude))
        f = float(np.interp(middle, backbone.fit_amplitude, backbone.fit_frequency))
        zeta = float(np.interp(middle, backbone.fit_amplitude, backbone.fit_damping))
        poles = model.poles.copy()
        poles[k] = 2 * np.pi * f * (-zeta + 1j)
        bent = (*model.factors[:k], tuple(factors), *model.factors[k + 1 :])
        now = _state(now.part, scale, DecayModel(poles, bent), peak.critical)
        if best is not None and now.sums.squares > 0.9 * best.sums.squares:
            return best if best.sums.squares < now.sums.squares else now
        best = now
    return best


def shape_mac(a: Complex, b: Complex) -> float:
    """MAC of two shapes (ch,)."""
    return float(np.abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real))


def _without_weak(found: BandFit) -> BandFit:
    """The fit without the modes that the others explain as well."""
    while found.sums.gain.size and found.sums.gain.min() < found.critical:
        rest = np.delete(np.arange(found.sums.gain.size), found.sums.gain.argmin())
        model = found.sums.model.take(rest)
        found = _state(found.part, found.scale, model, found.critical)
    return found
