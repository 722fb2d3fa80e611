"""The poles of all bands, each once, and which of them are multiples or sums of others."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.notes import Note
from ringtrue.identification.ambient.confidence import LIMITS
from ringtrue.identification.ambient.decay_backbone import Backbone, fit_backbone
from ringtrue.identification.ambient.decay_band_fit import (
    BandFit,
    shape_mac,
)
from ringtrue.identification.ambient.decay_fit import covariance, deviations, is_steady
from ringtrue.identification.common.stabilisation import DAMPING_MAX
from ringtrue.identification.common.uncertainty import by_chance


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
class DecayCandidate:
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


def candidates(fits: list[BandFit]) -> list[DecayCandidate]:
    """The poles of all bands, ascending, each from one band."""
    out: list[DecayCandidate] = []
    for i, found in enumerate(fits):
        model = found.sums.model
        band = found.part.band
        # bands overlap: each has what is nearer to its own middle
        high = band.high if i == 0 else np.sqrt(band.high * fits[i - 1].part.band.low)
        low = (
            band.low
            if i == len(fits) - 1
            else np.sqrt(band.low * fits[i + 1].part.band.high)
        )
        spread = deviations(model.poles, covariance(found.sums, found.floor))
        std = np.sqrt(np.maximum(np.diag(spread), 0)).reshape(2, -1)
        slack = 5 * std[0]
        f = model.frequencies
        inside = (
            (f > low - slack) & (f < high + slack) & (f >= band.low) & (f <= band.high)
        )
        inside &= model.damping < DAMPING_MAX
        for k in np.flatnonzero(inside).tolist():
            parts = found.envelopes(k)
            pole = complex(model.poles[k])
            fitted = fit_backbone(parts, pole, found.part.rate)
            new = DecayCandidate(
                found,
                k,
                frequency=float(f[k]),
                damping=float(model.damping[k]),
                gain=float(found.sums.gain[k]),
                std=std[:, k],
                backbone=fitted[0] if fitted else None,
            )
            others = (c for c in out if c.found is not found)
            if not any(
                abs(new.frequency - c.frequency)
                < 6 * float(np.hypot(new.std[0], c.std[0]))
                for c in others
            ):
                out.append(new)
    return sorted(out, key=lambda c: c.frequency)


def is_remainder(c: DecayCandidate, others: list[DecayCandidate]) -> bool:
    """Whether a decay is what the fit of a bent mode near it leaves: small, of its shape."""
    for other in others:
        if other is c or other.found is not c.found or not other.bent:
            continue
        low, high = other.span
        reach = LIMITS.mixing * max(
            other.damping * other.frequency, c.damping * c.frequency
        )
        close = low - reach < c.frequency < high + reach
        like = shape_mac(c.found.shape(c.k), other.found.shape(other.k)) > 0.8
        if (
            close
            and c.gain < 0.01 * other.gain
            and (like or c.gain < 1e-4 * other.gain)
        ):
            return True
    return False


def sum_of(c: DecayCandidate, stronger: list[DecayCandidate]) -> tuple[float, ...]:
    """The frequencies, Hz, of the modes whose multiple or sum a decay is; () if it is none.

    The product of decays has the sum of their poles, some of them conjugate: twice the frequency
    and twice the decay rate for a square. The pole must be that sum within the standard deviations
    of both. Where the nonlinearity is no power, or the mode is bent, the phase of a multiple stays
    locked to that of the mode all the same.
    """
    far = [a for a in stronger if c.gain < 0.1 * a.gain]
    for a in far:
        for n in (2, 3, 4, 5):
            if _is_multiple(c, a, n) or _is_locked(c, a, n) or _is_in_span(c, a, n):
                return (a.frequency,) * n
    signed = [(a, sign) for a in far for sign in (1, -1)]
    for order in (2, 3):
        for parts in combinations_with_replacement(signed, order):
            if _is_sum(c, parts):
                ordered = sorted(parts, key=lambda part: -part[1])
                return tuple(sign * a.frequency for a, sign in ordered)
    return ()


def _is_sum(c: DecayCandidate, parts: tuple[tuple[DecayCandidate, int], ...]) -> bool:
    """Whether the pole of a weak decay is the sum of those of `parts`, conjugate for a sign of -1.

    A pole that is not known to 0.3 % of the largest part is near some sum, whatever it is.
    """
    total = sum(complex(a.pole.real, sign * a.pole.imag) for a, sign in parts)
    # standard deviation of the real and the imaginary part of a pole, rad/s: both of 2π σ_f
    turns = {id(a): sum(x is a for x, _ in parts) for a, _ in parts}
    each = {id(a): turns[id(a)] * float(a.std[0]) for a, _ in parts}
    std = 2 * np.pi * float(np.sqrt(c.std[0] ** 2 + sum(x**2 for x in each.values())))
    away = c.pole - total
    reach = by_chance() * std
    known = reach < 3e-3 * max(abs(a.pole) for a, _ in parts)
    weak = c.gain < 1e-3 * max(a.gain for a, _ in parts)
    return known and weak and abs(away) < reach


def _is_multiple(c: DecayCandidate, a: DecayCandidate, n: int) -> bool:
    """Whether a weak decay is at n times the frequency of a mode, and decays about n times as
    fast.
    """
    reach = by_chance() * float(np.hypot(c.std[0], n * a.std[0]))
    near = abs(c.pole.imag - n * a.pole.imag) / (2 * np.pi) < reach < 0.01 * c.frequency
    return near and c.pole.real < 0.7 * n * a.pole.real


def _is_in_span(c: DecayCandidate, a: DecayCandidate, n: int) -> bool:
    """Whether a decay, far weaker than a bent mode, is at n times a frequency that this runs
    through.
    """
    low, high = a.span
    width = 2 * c.damping * c.frequency + 3 * float(c.std[0])
    inside = n * low - width < c.frequency < n * high + width
    return a.bent and c.gain < 1e-3 * a.gain and inside


def _is_locked(c: DecayCandidate, a: DecayCandidate, n: int) -> bool:
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
