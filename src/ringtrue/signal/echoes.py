"""A force that comes again (a rear axle on the track of the front one, a layer that reflects):
found, and taken out.

The spectrum of f(t) + a f(t - τ) ripples over frequency with the period 1/τ, as 1 + a² + 2a cos ωτ;
a resonance on the flank of a ripple is seen off its place. The power cepstrum has a at τ and -a²/2
at 2τ in all channels alike (Bogert, Healy and Tukey 1963). That of resonances differs from channel
to channel; lines of machines and resonances at equal distances, as of a cable, have peaks of one
sign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.signal.tonal_lines import excerpt_spectrum

SHORTEST, LONGEST = 16, 0.01  # samples, and share of the record
SURE = 6.0  # standard deviations of a peak; half of them below 0 for that at 2τ
TIP, AROUND, ABOVE = (
    2,
    1.4,
    2.0,
)  # samples to each side; range of τ either way, over whose highest peak it must stand
ALIKE = 0.3  # scatter over the channels, of the peak
TWICE = 0.2, 1.0  # of the square of the factor, at 2τ: 1/2 but for resonances
FEWEST, SAMPLES, JOIN = (
    3,
    1 << 18,
    8,
)  # channels; samples that are looked at; lines of their transform in one
LEAST = 1e-10  # of the mean power: below is the rounding of recorders
FLOOR, LOUD = (
    0.05,
    0.7,
)  # of the lines: their level is that of noise, which has no echo; share of an echo that tells it
ORDERS, MOST, TAIL = (
    4,
    0.95,
    60,
)  # peaks that tell the factor, the largest factor, delays that its inverse lasts


@dataclass(frozen=True, slots=True)
class Echo:
    """Delay (s) after which the force comes again, its factor, and how much of that may be of
    resonances.
    """

    delay: float
    factor: float
    doubt: float


def remove_echo(history: TimeHistory) -> tuple[TimeHistory, Echo | None]:
    """The record as the force makes it that comes once, and the echo; the same object where there
    is none.

    A factor above 1 has the spectrum of its inverse, but for a level.
    """
    spectrum, n = excerpt_spectrum(replace(history, data=history.data[:, :SAMPLES]))
    if len(spectrum) < FEWEST:
        return history, None
    lines = (
        spectrum[:, : n // 2 // JOIN * JOIN].view(np.float32).reshape(len(spectrum), -1, 2 * JOIN)
    )
    power = np.einsum("cfk,cfk->cf", lines, lines)
    log = np.log(np.maximum(power, LEAST * power.mean(axis=1, keepdims=True)))
    log -= log.mean(axis=1, keepdims=True)
    at, doubt = _peak(log, int(LONGEST * n))
    if not at:
        return history, None
    turn = 2 * np.pi / n * (JOIN * np.arange(log.shape[1]) + 0.5 * (JOIN - 1))
    delay, factor, share = _measured(log.mean(axis=0, dtype=np.float64), turn, at)
    once = replace(history, data=_once(history.data, delay, factor * share))
    return once, Echo(delay / history.rate, factor, doubt)


def _measured(log: Float, turn: Float, at: int) -> tuple[float, float, Float]:
    """Delay (in samples) and factor of the echo near the sample `at`, and its share of each line.

    `log` (line,) is a logarithmic spectrum, `turn` (line,) are the frequencies, radians a sample.

    The peaks of the factor's cepstrum count by their order: what resonances add to them falls as
    one over it.
    """
    near = at + np.linspace(-1, 1, 41)
    delay = float(near[np.argmax([abs(log @ np.cos(turn * x)) for x in near])])
    level, share = _shares(log, delay)
    loud, order = np.flatnonzero(share > LOUD), np.arange(1, ORDERS + 1)
    ripple = (log - level)[loud] / max(loud.size, 1)
    seen = np.array([ripple @ np.cos(turn[loud] * delay * m) for m in order])
    factors = np.linspace(-MOST, MOST, 381)
    made = -((-factors[:, None]) ** order) / order
    best = ((made - seen) ** 2 * order**2).sum(axis=1).argmin()
    return delay, float(factors[best]), share


def _shares(log: Any_, delay: float) -> tuple[Any_, Any_]:
    """Level over a ripple of logarithmic spectra (..., line), and the share of each line that is
    not noise.
    """
    level: Any_ = uniform_filter1d(log, max(round(2 * log.shape[-1] / delay), 1), mode="nearest")
    floor = np.quantile(level, FLOOR, axis=-1, keepdims=True)
    return level, 1 - np.exp(floor - np.maximum(level, floor))


def _peak(log: Any_, most: int) -> tuple[int, float]:
    """The sample, up to `most`, of the highest peak of an echo in the cepstra of logarithmic
    spectra (ch, line).

    0 if there is none; and the root mean square of what stands around it, over the peak. Noise
    flattens the ripple of one channel more than that of another.
    """
    cepstra = irfft(log, 2 * log.shape[1], axis=1)[:, : log.shape[1]]
    mean = cepstra.mean(axis=0)
    noise, size = float(np.median(np.abs(mean[mean.size // 3 :]))) / 0.6745, np.abs(mean)
    tip = (size > SURE * noise) & (size >= maximum_filter1d(size, 2 * TIP + 1))
    candidates = SHORTEST + np.flatnonzero(tip[SHORTEST:most])
    for k in candidates[np.argsort(-size[candidates])].tolist():
        around = np.r_[int(k / AROUND) : k - TIP, k + TIP + 1 : int(k * AROUND) + 1]
        twice = mean[2 * k - TIP : 2 * k + TIP + 1]
        second = float(twice[np.abs(twice).argmax()])
        if second < -0.5 * SURE * noise and size[k] > ABOVE * size[around].max():
            tips, share = cepstra[:, k], _shares(log, k)[1].mean(axis=1)
            scatter = min(
                np.ptp(x) / abs(x.mean()) for x in (tips, tips / share)
            )  # the level of noise is a guess
            if scatter < ALIKE and TWICE[0] < -second * share.mean() / mean[k] ** 2 < TWICE[1]:
                return int(k), float(np.sqrt(np.mean(size[around] ** 2))) / float(size[k])
    return 0, 0.0


def _once(data: Any_, delay: float, factor: Float) -> Any_:
    """Each signal (ch, sample) through 1/(1 + a e^-iωτ): τ in samples, a (line,) from 0 to half of
    the rate.
    """
    samples = data.shape[1]
    n = int(next_fast_len(samples + int(min(TAIL * delay, samples)), real=True))
    cycles = np.arange(n // 2 + 1) / n
    a = np.interp(cycles, np.linspace(0, 0.5, factor.size), factor)
    gain = 1 / (1 + a * np.exp(-2j * np.pi * delay * cycles))
    out = np.empty_like(data)
    for y, x in zip(out, data, strict=True):  # channels: one transform is long
        y[:] = irfft(rfft(x - x.mean(dtype=np.float64), n) * gain, n)[:samples]
    return out
