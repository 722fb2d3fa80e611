"""Modes from free decays: step relaxation, ring-down, impacts whose force nobody measured.

Band by band, the decays behind all impacts are fitted together by maximum likelihood. One more mode
is looked for in what is left until noise alone explains it. The standard deviations are those of
the Fisher information (Kay 1993, ch. 3 and 13). ERA (Juang and Pappa 1985) on the same decays says
which poles every model order shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.decay_backbone import (
    Backbone,
    Envelope,
    envelope,
    fit_backbone,
)
from ringtrue.identification.ambient.decay_fit import (
    EMPTY,
    DecayModel,
    Decays,
    DecaySums,
    NoiseFloor,
    Peak,
    covariance,
    deviations,
    fit,
    is_steady,
    left_over,
    noise_floor,
    strongest_decay,
)
from ringtrue.identification.ambient.era import era
from ringtrue.identification.ambient.pipeline import AmbientSettings, bands_for
from ringtrue.identification.ambient.ssi_cov import SsiCov
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram, unit
from ringtrue.signal.channel_checks import bridge_gaps, usable
from ringtrue.signal.decay_bands import BandDecays, decays_of
from ringtrue.signal.spectra import Band
from ringtrue.signal.transients import EVENT, Events, find_events

MOST = 30  # modes of a band
MOST_DAMPING = 0.2  # what decays faster is the end of an impact


@dataclass(frozen=True, slots=True)
class DecaySettings:
    """Settings; the defaults need no tuning.

    Attributes
    ----------
    fmin, fmax : float, Hz
        Band of interest; None: eight cycles in the longest decay, and what the rate allows.
    false_alarm : float
        Probability that noise alone makes a mode in a band.
    near : float
        Half widths of a mode, within which a much smaller decay of the same shape is what its
        amplitude does to it.
    locked : float
        Standard deviations, within which a pole is a multiple of another, or a sum of two.
    decades : float
        That the power falls by behind the impacts in a record of free decays.
    early : float
        Share of their energy that is in their first halves there.
    """

    fmin: float | None = None
    fmax: float | None = None
    false_alarm: float = 1e-3
    near: float = 12.0
    locked: float = 5.0
    decades: float = 1.5
    early: float = 0.9

    def __post_init__(self) -> None:
        low = self.fmin or 0.0
        high = self.fmax or np.inf
        if low < 0 or not low < high:
            raise ConfigError(f"band {self.fmin} .. {self.fmax} Hz: must be 0 <= fmin < fmax")


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
    floor : NoiseFloor
    critical : float
        Gain that noise alone rarely reaches.
    """

    part: BandDecays
    scaled: Decays
    scale: Float
    sums: DecaySums
    floor: NoiseFloor
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
        half = max(float(-pole.real) / (2 * np.pi), 0.3 * self.part.rate / len(self.scaled[0][0]))
        width = min(8 * half, 0.2 * hertz) / self.part.rate
        gain = self.part.gain_at(np.array([hertz]))[0]  # of the time that its frequency is of
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


def fit_band(part: BandDecays, settings: DecaySettings) -> BandFit:
    """All modes of the decays of a band, one after the other."""
    longest = max(part.decays, key=lambda y: y.shape[1])
    quarter = longest.shape[1] // 4
    scale = longest[:, -quarter:].std(axis=1)
    scale = np.maximum(scale, 1e-12 * scale.max(initial=1e-300))
    seen = part.freqs[part.gain > 1e-3]
    limits = (float(seen[0]), float(seen[-1]))
    found = _state(part, scale, EMPTY, np.inf)
    for _ in range(MOST):
        rest = left_over(found.scaled, part.rate, found.sums)
        peak = strongest_decay(rest, part.rate, found.floor, limits, settings.false_alarm)
        if peak.gain < peak.critical:
            return _without_weak(replace(found, critical=peak.critical))
        scale = found.scale * np.sqrt(np.median(found.floor.variance[:, part.gain > 0.7], axis=1))
        more = _state(part, scale, found.sums.model.plus(peak.pole), peak.critical)
        bent = _with_backbone(found, scale, peak, settings)
        found = more if bent is None or _squares(more) <= _squares(bent) else bent
    return _without_weak(found)


def _state(
    part: BandDecays, scale: Float, model: DecayModel, critical: float, *, rough: bool = True
) -> BandFit:
    scaled = tuple(y / scale[:, None] for y in part.decays)
    sums = fit(scaled, part.rate, model, rough=rough)
    floor = noise_floor(left_over(scaled, part.rate, sums), part.rate, part.freqs, part.gain)
    return BandFit(part, scaled, scale, sums, floor, critical)


def _squares(found: BandFit) -> float:
    """Sum of squares with the price of the parameters (Schwarz 1978)."""
    samples = sum(y.size for y in found.scaled)
    size = found.sums.amplitudes
    parameters = 2 * size.size + 2 * size.shape[2]
    return float(found.sums.squares + parameters * np.log(samples))


def _with_backbone(
    found: BandFit, scale: Float, peak: Peak, settings: DecaySettings
) -> BandFit | None:
    """The fit with the strongest mode beside a peak as its amplitude bends it, in the place of the
    weaker ones of its shape; None where there is none, or it is not bent.
    """
    model = found.sums.model
    if not model.poles.size:
        return None
    distance = np.abs(model.poles.imag - peak.pole.imag)
    near = distance < settings.near * np.maximum(-model.poles.real, -peak.pole.real)
    if not near.any():
        return None
    k = int(np.where(near, found.sums.gain, -1.0).argmax())
    away = np.abs(model.poles.imag - model.poles.imag[k])
    beside = away < settings.near * np.maximum(-model.poles.real, -model.poles.real[k])
    gain = found.sums.gain
    shape = found.shape(k)
    kept = [
        j
        for j in range(gain.size)
        if j == k or not (beside[j] and gain[j] < gain[k] and _mac(found.shape(j), shape) > 0.9)
    ]
    best: BandFit | None = None
    now = found
    if len(kept) < gain.size:
        now = _state(found.part, scale, model.take(kept), peak.critical)
    k = kept.index(k)
    for _ in range(4):  # the envelope is the better known the better the mode is
        model = now.sums.model
        parts = now.envelopes(k)
        fitted = fit_backbone(parts, model.poles[k], now.part.rate, settings.false_alarm)
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


def _mac(a: Complex, b: Complex) -> float:
    return float(np.abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real))


def _without_weak(found: BandFit) -> BandFit:
    """The fit without the modes that the others explain as well."""
    while found.sums.gain.size and found.sums.gain.min() < found.critical:
        rest = np.delete(np.arange(found.sums.gain.size), found.sums.gain.argmin())
        model = found.sums.model.take(rest)
        found = _state(found.part, found.scale, model, found.critical)
    return _state(found.part, found.scale, found.sums.model, found.critical, rough=False)


def decay_bounds(events: Events, history: TimeHistory) -> Int:
    """(decay, 2) first sample of each decay, behind its impact, and the first one behind it.

    Without an event the record is one decay.
    """
    samples = history.data.shape[1]
    at = np.flatnonzero(events.struck)
    if not at.size:
        return np.array([[0, samples]], dtype=np.int64)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    size = events.window * history.rate
    begin = np.array([(r[-1] + 2 - EVENT.spread) * size for r in runs])
    end = np.array([(r[0] + EVENT.spread) * size for r in runs[1:]] + [float(samples)])
    bounds = np.stack([np.ceil(begin), np.floor(end)], axis=1).astype(np.int64)
    return np.asarray(bounds[bounds[:, 1] > bounds[:, 0] + 64])


def decay_bands(rate: float, longest: float, settings: DecaySettings) -> tuple[Band, ...]:
    """The pyramid for decays of at most `longest` s, from the highest band."""
    low = settings.fmin if settings.fmin else 8.0 / longest
    own = AmbientSettings(fmin=low, fmax=settings.fmax)
    return tuple(b for b in bands_for(rate, longest, own) if b.rate * longest > 96)


@dataclass(frozen=True, slots=True, eq=False)
class DecayMultiple:
    """A decay that is no mode: its phase is locked to that of one or two modes.

    Attributes
    ----------
    frequency, std_frequency : float, Hz
    damping, std_damping : float
    of : tuple of float, Hz
        The modes whose frequencies it is the sum of: one of them twice or more for a multiple;
        negative in a difference.
    """

    frequency: float
    std_frequency: float
    damping: float
    std_damping: float
    of: tuple[float, ...]

    @property
    def note(self) -> Note:
        """As data."""
        parts = [f"{'-' if f < 0 else '+'} {abs(f):.5g}" for f in self.of]
        values: dict[str, float | int | str] = {
            "frequency": self.frequency,
            "damping": 100 * self.damping,
            "sum": " ".join(parts).removeprefix("+ "),
        }
        return Note("decay multiple", "information", f"{self.frequency:.5g} Hz", values)


@dataclass(frozen=True, slots=True, eq=False)
class DecayResult:
    """What free decays say.

    Attributes
    ----------
    modes : ModeSet
        The natural modes. Unscaled complex shapes, largest component 1; of a nonlinear one, those
        at its smallest amplitude.
    uncertainty : Uncertainty
    evidence : tuple of Note
        One a mode.
    backbones : tuple of (Backbone or None)
        One a mode; None where it decays too fast to have one.
    multiples : tuple of DecayMultiple
        Harmonics: multiples and sums of modes, by nonlinearity or clipping.
    notes : tuple of Note
        Of the record and of what was left out.
    diagrams : tuple of StableDiagram
        ERA, one a band, from the highest.
    starts : (decay,) float64, s
        Where the decays begin.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    evidence: tuple[Note, ...]
    backbones: tuple[Backbone | None, ...]
    multiples: tuple[DecayMultiple, ...]
    notes: tuple[Note, ...]
    diagrams: tuple[StableDiagram, ...]
    starts: Float

    @property
    def reasons(self) -> tuple[str, ...]:
        """The evidence for each mode as sentences."""
        return tuple(sentence(note) for note in self.evidence)


def identify_decay(
    history: TimeHistory, settings: DecaySettings | None = None, *, progress: Progress = quiet
) -> DecayResult:
    """Modes from a record of free decays.

    Parameters
    ----------
    history : TimeHistory
        Responses (channel, sample). Several impacts are several decays of the same modes; a record
        without an impact is one decay.
    settings : DecaySettings
    progress : callable (fraction, text)

    Raises
    ------
    DataError
        If no channel is usable, or nothing decays.
    ConfigError
        If the band of interest is empty.
    """
    settings = settings or DecaySettings()
    whole, _ = bridge_gaps(history)
    good, states = usable(whole)
    progress(0.0, "impacts")
    bounds = behind_clipping(good, decay_bounds(find_events(good.data, good.rate), good))
    parts = band_decays(good, bounds, settings)
    if not parts:
        raise DataError(
            f"{history.source or 'record'}: nothing decays to the noise in "
            f"{good.duration:.4g} s; an ambient record goes without `decay`"
        )
    fits = []
    for k, part in enumerate(parts):
        progress((k + 1) / (len(parts) + 1), f"{part.band.low:.3g} .. {part.band.high:.3g} Hz")
        fits.append(fit_band(part, settings))
    found = _assembled(fits, good, settings)
    of_record = Note(
        "decay record",
        "information",
        good.source or "record",
        {"decays": len(bounds), "first": float(bounds[0, 0] / good.rate)},
    )
    of_channels = (*states, of_record)
    progress(1.0, f"{len(found.modes)} modes")
    return replace(found, notes=(*of_channels, *found.notes), starts=bounds[:, 0] / good.rate)


def band_decays(history: TimeHistory, bounds: Int, settings: DecaySettings) -> list[BandDecays]:
    """The decays of the bands in which something decays."""
    longest = float(np.diff(bounds, axis=1).max()) / history.rate
    bands = decay_bands(history.rate, longest, settings)
    parts = decays_of(history.data, history.rate, bounds, bands) if bands else []
    return [p for p in parts if p.decays]


def behind_clipping(history: TimeHistory, bounds: Int) -> Int:
    """The bounds (decay, 2) without what is cut off by the range of a recorder: samples that equal
    the largest or smallest one of a channel, several times.
    """
    out = bounds.copy()
    cut = np.zeros(history.data.shape[1], dtype=bool)
    for x in history.data:  # a channel at a time in memory
        for limit in (x.max(), x.min()):
            at = x == limit
            if np.count_nonzero(at) > 3:
                cut |= at
    for row in out:  # a few decays
        last = np.flatnonzero(cut[row[0] : row[1]])
        row[0] += int(last[-1]) + 1 if last.size else 0
    return np.asarray(out[out[:, 1] > out[:, 0] + 64])


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One pole of one band.

    Attributes
    ----------
    found : BandFit
    k : int
        Its number there.
    frequency, damping, gain : float
    std : (2,) float64
        Of frequency, Hz, and damping.
    backbone : Backbone, optional
    """

    found: BandFit
    k: int
    frequency: float
    damping: float
    gain: float
    std: Float
    backbone: Backbone | None

    @property
    def pole(self) -> complex:
        """rad/s."""
        return complex(self.found.sums.model.poles[self.k])

    @property
    def amplitudes(self) -> Complex:
        """(decay, ch) in the units of the noise."""
        return np.asarray(self.found.sums.amplitudes[:, :, self.k])

    @property
    def bent(self) -> bool:
        """Whether its amplitude bends it."""
        return bool(self.found.sums.model.factors[self.k])

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest frequency, Hz, over its amplitudes."""
        if not self.bent or self.backbone is None:
            return self.frequency, self.frequency
        first, last = self.backbone.fit_frequency[[0, -1]].tolist()
        # the square of the amplitude, ahead of the first known one, is 2.6 times as large
        ends = sorted((first, last + 1.6 * (last - first)))
        return ends[0], ends[1]

    @property
    def steady(self) -> bool:
        """Whether it does not decay."""
        longest = max(y.shape[1] for y in self.found.scaled) / self.found.part.rate
        return bool(is_steady(self.found.sums.model, longest)[self.k])


def candidates(fits: list[BandFit], settings: DecaySettings) -> list[Candidate]:
    """The poles of all bands, ascending, each from one band."""
    out: list[Candidate] = []
    for i, found in enumerate(fits):
        model = found.sums.model
        band = found.part.band
        # bands overlap: each has what is nearer to its own middle
        high = band.high if i == 0 else np.sqrt(band.high * fits[i - 1].part.band.low)
        low = band.low if i == len(fits) - 1 else np.sqrt(band.low * fits[i + 1].part.band.high)
        spread = deviations(model.poles, covariance(found.sums, found.floor))
        std = np.sqrt(np.maximum(np.diag(spread), 0)).reshape(2, -1)
        slack = 5 * std[0]
        f = model.frequencies
        inside = (f > low - slack) & (f < high + slack) & (f >= band.low) & (f <= band.high)
        inside &= model.damping < MOST_DAMPING
        for k in np.flatnonzero(inside).tolist():
            parts = found.envelopes(k)
            pole = complex(model.poles[k])
            fitted = fit_backbone(parts, pole, found.part.rate, settings.false_alarm)
            new = Candidate(
                found,
                k,
                float(f[k]),
                float(model.damping[k]),
                float(found.sums.gain[k]),
                std[:, k],
                fitted[0] if fitted else None,
            )
            if not any(_same_mode(new, other) for other in out if other.found is not found):
                out.append(new)
    return sorted(out, key=lambda c: c.frequency)


def _same_mode(a: Candidate, b: Candidate) -> bool:
    reach = 6 * float(np.hypot(a.std[0], b.std[0]))
    return abs(a.frequency - b.frequency) < reach


def _is_remainder(c: Candidate, others: list[Candidate], near: float) -> bool:
    """Whether a decay is what the fit of a bent mode beside it leaves: small, of its shape."""
    for other in others:
        if other is c or other.found is not c.found or not other.bent:
            continue
        low, high = other.span
        reach = near * max(other.damping * other.frequency, c.damping * c.frequency)
        close = low - reach < c.frequency < high + reach
        alike = _mac(c.found.shape(c.k), other.found.shape(other.k)) > 0.8
        if close and c.gain < 0.01 * other.gain and (alike or c.gain < 1e-4 * other.gain):
            return True
    return False


def sum_of(c: Candidate, stronger: list[Candidate], settings: DecaySettings) -> tuple[float, ...]:
    """The frequencies, Hz, of the modes whose multiple or sum a decay is; () if it is none.

    The product of decays has the sum of their poles, some of them conjugate: twice the frequency
    and twice the decay rate for a square. The pole must be that sum within the standard deviations
    of both. Where the nonlinearity is no power, or the mode is bent, the phase of a multiple stays
    locked to that of the mode all the same.
    """
    far = [a for a in stronger if c.gain < 0.1 * a.gain]
    for a in far:
        for n in (2, 3, 4, 5):
            if _is_multiple(c, a, n, settings) or _is_locked(c, a, n) or _is_in_span(c, a, n):
                return (a.frequency,) * n
    signed = [(a, sign) for a in far for sign in (1, -1)]
    for order in (2, 3):
        for parts in combinations_with_replacement(signed, order):
            if _is_sum(c, parts, settings):
                ordered = sorted(parts, key=lambda part: -part[1])
                return tuple(sign * a.frequency for a, sign in ordered)
    return ()


def _is_sum(
    c: Candidate, parts: tuple[tuple[Candidate, int], ...], settings: DecaySettings
) -> bool:
    """Whether the pole of a weak decay is the sum of those of `parts`, conjugate for a sign of -1.

    A pole that is not known to 0.3 % of the largest part is near some sum, whatever it is.
    """
    total = sum(complex(a.pole.real, sign * a.pole.imag) for a, sign in parts)
    # standard deviation of the real and the imaginary part of a pole, rad/s: both of 2π σ_f
    turns = {id(a): sum(x is a for x, _ in parts) for a, _ in parts}
    each = {id(a): turns[id(a)] * float(a.std[0]) for a, _ in parts}
    std = 2 * np.pi * float(np.sqrt(c.std[0] ** 2 + sum(x**2 for x in each.values())))
    away = c.pole - total
    reach = settings.locked * std
    known = reach < 3e-3 * max(abs(a.pole) for a, _ in parts)
    weak = c.gain < 1e-3 * max(a.gain for a, _ in parts)
    return known and weak and abs(away.real) < reach and abs(away.imag) < reach


def _is_multiple(c: Candidate, a: Candidate, n: int, settings: DecaySettings) -> bool:
    """Whether a weak decay is at n times the frequency of a mode, and decays about n times as
    fast.
    """
    reach = settings.locked * float(np.hypot(c.std[0], n * a.std[0]))
    near = abs(c.pole.imag - n * a.pole.imag) / (2 * np.pi) < reach < 0.01 * c.frequency
    return near and c.pole.real < 0.7 * n * a.pole.real


def _is_in_span(c: Candidate, a: Candidate, n: int) -> bool:
    """Whether a decay, far weaker than a bent mode, is at n times a frequency that this runs
    through.
    """
    low, high = a.span
    width = 2 * c.damping * c.frequency + 3 * float(c.std[0])
    inside = n * low - width < c.frequency < n * high + width
    return a.bent and c.gain < 1e-3 * a.gain and inside


def _is_locked(c: Candidate, a: Candidate, n: int) -> bool:
    """Whether the phase of a decay runs with n times that of a mode, over at least two time
    constants, and its amplitude with the nth power.
    """
    if abs(c.frequency / (n * a.frequency) - 1) > 0.02 or not (a.bent or c.bent):
        return False
    turns = []
    powers = []
    for i in range(min(len(c.found.scaled), len(a.found.scaled))):
        mine, its = c.found.envelopes(c.k)[i], a.found.envelopes(a.k)[i]
        at = np.arange(mine.begin, mine.end, mine.step)
        if at.size < 4:
            continue
        time = at / c.found.part.rate
        grid = np.arange(its.signal.size) / a.found.part.rate
        inside = time < its.end / a.found.part.rate
        if np.count_nonzero(inside) < 4:
            continue
        at, time = at[inside], time[inside]
        phase = np.interp(time, grid, np.unwrap(np.angle(its.signal)))
        level = np.interp(time, grid, np.log(np.abs(its.signal)))
        drift = (c.pole.imag - n * a.pole.imag) * time
        own = np.unwrap(np.angle(mine.signal[at]) - n * phase + drift)
        turns.append(float(np.ptp(own)))
        powers.append(float(np.polyfit(level, np.log(np.abs(mine.signal[at])), 1)[0]))
    if not turns:
        return False
    return bool(np.median(turns) < 0.5 and np.median(powers) > 0.7 * n)


def era_diagram(found: BandFit) -> tuple[StableDiagram, Float]:
    """The poles of ERA on all decays of a band in one Hankel matrix, and the share of the orders
    that show each pole (m,) of the fit.
    """
    ch = len(found.scaled[0])
    shortest = min(y.shape[1] for y in found.scaled)
    rows = int(min(np.clip(400 // ch, 12, 60), (shortest - 1) // 2))
    lags = np.stack([y[:, : 2 * rows + 1].T for y in found.scaled], axis=2)
    own = SsiCov(rows, order_max=min(60, rows * len(found.scaled)))
    poles = era(lags, found.part.rate, own)
    model = found.sums.model
    away = np.abs(poles.pole[:, None] - model.poles)
    near = away < 0.02 * np.abs(model.poles)
    near &= away == away.min(axis=1, keepdims=True, initial=np.inf)
    shown = [np.unique(poles.order[at]) for at in near.T]
    after = [np.count_nonzero(poles.orders >= s.min()) if s.size else 1 for s in shown]
    share = np.array([s.size / max(n, 1) for s, n in zip(shown, after, strict=True)])
    cluster = np.where(near.any(axis=1), near.argmax(axis=1) if model.poles.size else 0, -1)
    y = found.scaled[0]
    power = np.square(np.abs(np.fft.rfft(y, axis=1))).sum(axis=0)
    lines = np.arange(power.size) * found.part.rate / y.shape[1]
    level = 10 * np.log10(np.maximum(power, np.finfo(np.float64).tiny))
    shape = unit(poles.shape * found.scale[:, None])
    full = PoleSet(poles.order, poles.pole, shape, poles.std_frequency, poles.std_damping)
    return StableDiagram(full, cluster >= 0, cluster, lines, level), share


def _assembled(fits: list[BandFit], history: TimeHistory, settings: DecaySettings) -> DecayResult:
    """The candidates of all bands as natural modes, multiples of these and notes."""
    every = candidates(fits, settings)
    notes = []
    decaying = []
    for c in every:
        values = {"frequency": c.frequency}
        if c.steady:
            notes.append(Note("decay steady", "information", f"{c.frequency:.5g} Hz", values))
        elif _is_remainder(c, every, settings.near):
            notes.append(Note("decay remainder", "information", f"{c.frequency:.5g} Hz", values))
        else:
            decaying.append(c)
    natural: list[Candidate] = []
    multiples = []
    for c in sorted(decaying, key=lambda c: -c.gain):
        of = sum_of(c, natural, settings)
        if of:
            std = c.std.tolist()
            multiples.append(DecayMultiple(c.frequency, std[0], c.damping, std[1], of))
        else:
            natural.append(c)
    natural.sort(key=lambda c: c.frequency)
    multiples.sort(key=lambda m: m.frequency)
    diagrams = {id(found): era_diagram(found) for found in fits}
    rows = [_mode(c, float(diagrams[id(c.found)][1][c.k]), history) for c in natural]
    ch = len(history.channels)
    modes = ModeSet(
        frequencies=np.array([r.frequency for r in rows]),
        damping=np.array([r.damping for r in rows]),
        shapes=np.array([r.shape for r in rows], dtype=np.complex128).reshape(-1, ch).T,
        labels=tuple(c.id for c in history.channels),
        source=f"{history.source or 'record'}: free decays",
        confidence=np.array([r.confidence for r in rows]),
    )
    return DecayResult(
        modes=modes,
        uncertainty=_uncertainty(natural, rows, ch),
        evidence=tuple(r.note for r in rows),
        backbones=tuple(r.backbone for r in rows),
        multiples=tuple(multiples),
        notes=(*notes, *(m.note for m in multiples)),
        diagrams=tuple(diagrams[id(found)][0] for found in fits),
        starts=np.zeros(0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One mode of the result."""

    frequency: float
    damping: float
    std: Float
    shape: Complex
    std_shape: Float
    confidence: float
    backbone: Backbone | None
    note: Note


def _mode(c: Candidate, share: float, history: TimeHistory) -> _Row:
    found = c.found
    backbone = c.backbone
    frequency, damping, std = c.frequency, c.damping, c.std
    values: dict[str, float | int | str] = {
        "level": float(10 * np.log10(c.gain)),
        "decays": len(found.scaled),
        "share": 100 * share,
    }
    code = "decay mode"
    if c.bent and backbone is not None and backbone.nonlinear:
        frequency = float(backbone.fit_frequency[0])
        damping = float(backbone.fit_damping[0])
        of_terms = [backbone.std_frequency_terms[0], backbone.std_damping_terms[0]]
        std = np.maximum(std, of_terms)
        largest = np.argmax(np.abs(found.shape(c.k)))
        values["change"] = 100 * (float(backbone.fit_frequency[-1]) / frequency - 1)
        values["amplitude"] = float(backbone.fit_amplitude[-1])
        values["unit"] = history.channels[largest].unit
        code = "decay mode bent"
    sums = found.sums
    each = c.amplitudes * found.scale
    weight = np.linalg.norm(each, axis=1)
    m = sums.gain.size
    blocks = sums.inverse.reshape(-1, m, 2, m, 2)[:, c.k, :, c.k]
    spread = 0.5 * (blocks[:, 0, 0] + blocks[:, 1, 1])
    variance = found.floor.at(np.array([c.frequency]))[:, 0] * found.scale**2
    shape = found.shape(c.k)
    largest_part = np.abs(each).max(axis=1)
    # the shape is the mean over the decays, by the squares of their amplitudes
    relative = float((weight**2 @ spread) / (weight**2).sum() ** 2)
    relative *= float((weight**2).sum() / (largest_part**2).sum())
    likely = c.gain / (c.gain + max(found.critical, 1.0))
    return _Row(
        frequency=frequency,
        damping=damping,
        std=np.asarray(std),
        shape=shape,
        std_shape=np.sqrt(variance * relative),
        confidence=likely if code == "decay mode bent" else likely * 0.5 * (1 + share),
        backbone=backbone,
        note=Note(code, "information", f"{frequency:.5g} Hz", values),
    )


def _uncertainty(natural: list[Candidate], rows: list[_Row], ch: int) -> Uncertainty:
    """Standard deviations, and the covariance of the modes that share a band."""
    m = len(rows)
    std = np.array([r.std for r in rows]).reshape(m, 2)
    joint = np.diag(std.T.ravel() ** 2)
    for i, a in enumerate(natural):
        spread = deviations(a.found.sums.model.poles, covariance(a.found.sums, a.found.floor))
        size = len(spread) // 2
        for j, b in enumerate(natural):
            if j == i or b.found is not a.found or a.bent or b.bent:
                continue
            at = np.ix_([a.k, size + a.k], [b.k, size + b.k])
            joint[np.ix_([i, m + i], [j, m + j])] = spread[at]
        if not a.bent:
            own = np.ix_([a.k, size + a.k], [a.k, size + a.k])
            joint[np.ix_([i, m + i], [i, m + i])] = spread[own]
    scale = np.sqrt(np.maximum(np.diag(joint), np.finfo(np.float64).tiny))
    value, vector = np.linalg.eigh(joint / np.outer(scale, scale))
    factor = np.sqrt(np.maximum(value, 0))[:, None] * vector.T * scale
    shapes = np.array([r.std_shape for r in rows]).reshape(m, ch).T
    return Uncertainty(std[:, 0], std[:, 1], shapes, factor)
