"""Frequency domain decomposition: FDD, enhanced (EFDD) and frequency-spatial (FSDD), with damping.

Brincker, Zhang and Andersen 2001 (FDD, EFDD), Zhang, Wang and Tamura 2010 (FSDD), Rodrigues,
Brincker and Andersen 2004 (random decrement). The taper of the spectra widens every peak; here it
is divided out of the correlation, or put into the fitted model, so that the damping is not biased
by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.ambient.pipeline import AmbientSettings
from ringtrue.identification.common.poles import unit
from ringtrue.signal.decimation import detrend
from ringtrue.signal.spectra import Csd, Welch, csd, window

_DAMPING = 1e-4, 0.3
_ROUNDS = 40
_NEAR = 1e-3
_REACH = 10.0  # half bandwidths
_FOOT = 0.05  # of the peak: where the bell ends at an edge
_FALL = 0.3  # of a mode: what no mode falls below
Method = Literal["fsdd", "efdd", "random decrement"]


@dataclass(frozen=True, slots=True)
class FddSettings:
    """Settings.

    Attributes
    ----------
    method : str
        Of frequency and damping: `fsdd` fits the spectrum of the modal coordinate, `efdd` its
        correlation, `random decrement` its signature in time.
    resolution : float, Hz
        0: 20 segments in the record.
    fmin, fmax : float, Hz
        Band of the peaks; fmax 0: what the rate allows.
    mac : float
        Lines around the peak belong to the bell while their singular vector has this MAC with it.
    levels : tuple of float
        Part of the decay that is fitted, of its start: from the first to the second. A correlation
        scatters by some 1/sqrt(ζωT), 0.12 for 2 Hz, 2 % and five minutes, so that little below 0.5
        is of use.
    """

    method: Method = "fsdd"
    resolution: float = 0.0
    fmin: float = 0.0
    fmax: float = 0.0
    mac: float = 0.8
    levels: tuple[float, float] = (0.95, 0.5)

    def __post_init__(self) -> None:
        if not 0 < self.mac < 1 or not 1 >= self.levels[0] > self.levels[1] > 0:
            raise ConfigError(
                f"FDD: mac {self.mac} in 0..1, levels {self.levels} must fall, within 1..0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class FddResult:
    """Modes with the spectrum they were picked from.

    Attributes
    ----------
    modes : ModeSet
        Confidence is the mean MAC of the singular vectors over the bell.
    uncertainty : Uncertainty
        Of frequency and damping for `fsdd`, NaN otherwise; shapes have none.
    freqs : (f,) float64, Hz
    singular : (f, ch) float64, unit²/Hz
    bells : tuple of (first, last) line of each mode's bell
    """

    modes: ModeSet
    uncertainty: Uncertainty
    freqs: Float
    singular: Float
    bells: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Bell:
    """Lines `first` .. `last` around the peak of one mode, its singular vector (ch,) and the two
    spectra (line,).
    """

    first: int
    last: int
    vector: Complex
    level: Float
    enhanced: Float
    mean_mac: float


def fdd(
    history: TimeHistory, settings: FddSettings | None = None, *, near: Sequence[float] = ()
) -> FddResult:
    """Modes from the peaks of the singular values of the spectral matrix.

    Parameters
    ----------
    history : TimeHistory
    settings : FddSettings
    near : sequence of float, Hz
        Peaks to take, each the highest line within three of it; (): all peaks of the first singular
        value that stand out of its scatter and whose neighbours have the same singular vector.

    Raises
    ------
    DataError
        If the record is shorter than a segment, or a channel is not finite.
    """
    s = settings or FddSettings()
    if not np.isfinite(history.data).all():
        raise DataError(f"{history.source}: values are not finite; leave those channels out")
    spectra = csd(history, Welch(s.resolution or 20.0 / history.duration))
    scale = np.sqrt(np.maximum(np.einsum("fii->i", spectra.data).real, np.finfo(np.float64).tiny))
    u, sv, _ = np.linalg.svd(spectra.data / (scale[:, None] * scale), hermitian=True)
    lines = (
        _near(spectra.freqs, sv[:, 0], near) if near else _peaks(spectra, u[:, :, 0], sv[:, 0], s)
    )
    bells = [
        _bell(int(k), u, sv=sv, least=s.mac, borders=_borders(lines, int(k), sv)) for k in lines
    ]
    fitted = [_fit(b, spectra, history=history, scale=scale, s=s) for b in bells]
    rows = np.array(fitted).reshape(len(bells), 4)
    shape = (
        np.array([unit(b.vector[:, None] * scale[:, None])[:, 0] for b in bells])
        .reshape(len(bells), scale.size)
        .T
    )
    ids = tuple(c.id for c in history.channels)
    modes = ModeSet(
        rows[:, 0],
        rows[:, 1],
        shape.astype(np.complex128),
        ids,
        source=f"{history.source or 'record'}: {s.method}",
        confidence=np.array([b.mean_mac for b in bells]),
    )
    std = Uncertainty.independent(rows[:, 2], rows[:, 3], np.full(shape.shape, np.nan))
    return FddResult(
        modes=modes,
        uncertainty=std,
        freqs=spectra.freqs,
        singular=spectra.singular_values(),
        bells=tuple((b.first, b.last) for b in bells),
    )


def peak_modes(
    method: Method, history: TimeHistory, settings: AmbientSettings, near: Sequence[float]
) -> tuple[ModeSet, Uncertainty]:
    """Modes of the peaks in the band of the settings, or `near` some frequencies, Hz."""
    own = FddSettings(method, fmin=settings.fmin or 0.0, fmax=settings.fmax or 0.0)
    found = fdd(history, own, near=near)
    return found.modes, found.uncertainty


def _near(freqs: Float, level: Float, near: Sequence[float]) -> Int:
    """The highest line within three of each frequency."""
    at = np.searchsorted(freqs, np.asarray(near, dtype=np.float64))
    window_at = np.clip(at[:, None] + np.arange(-3, 4), 1, freqs.size - 2)
    best = window_at[np.arange(at.size), np.argmax(level[window_at], axis=1)]
    return np.asarray(np.unique(best), dtype=np.int64)


def _peaks(spectra: Csd, vector: Complex, level: Float, s: FddSettings) -> Int:
    """Lines of peaks that stand eight standard deviations out of their surroundings, steady in
    their vector.
    """
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    # a singular value averaged over K segments scatters by 1/sqrt(K) of itself
    found, _ = find_peaks(
        np.log(np.maximum(level, 1e-300)), prominence=8 / np.sqrt(spectra.segments)
    )
    f = spectra.freqs
    top = s.fmax or 0.95 * f[-1]
    found = found[(f[found] >= max(s.fmin, 3 * f[1])) & (f[found] <= top) & (found < f.size - 2)]
    around = vector[found[:, None] + np.array([-2, -1, 1, 2])]
    like = np.abs(np.einsum("pkc,pc->pk", around.conj(), vector[found])) ** 2
    return np.asarray(found[like.mean(1) > 0.8], dtype=np.int64)


def _borders(lines: Int, k: int, sv: Float) -> tuple[int, int]:
    """The bell may not pass the neighbouring peaks.

    Of one channel, that has no shapes, it ends at the valleys before them or at a foot of its peak.
    """
    below = lines[lines < k]
    above = lines[lines > k]
    low = int(below[-1]) + 1 if below.size else 1
    high = int(above[0]) - 1 if above.size else len(sv) - 2
    if sv.shape[1] > 1:
        return low, high
    level = np.maximum(sv[:, 0], _FOOT * sv[k, 0])
    return k - int(np.argmin(level[low : k + 1][::-1])), k + int(np.argmin(level[k : high + 1]))


def _bell(k: int, u: Complex, sv: Float, least: float, borders: tuple[int, int]) -> _Bell:
    """Lines around `k` with a singular vector like that of the peak, three to each side at
    least.
    """
    psi = u[k, :, 0]
    like = np.abs(np.einsum("fci,c->fi", u.conj(), psi)) ** 2
    which = np.argmax(like, axis=1)
    best = like[np.arange(len(like)), which]
    out = np.flatnonzero(uniform_filter1d(best, 5) < least)
    low = out[out < k]
    high = out[out > k]
    first = max(min(int(low[-1]) + 1 if low.size else 0, k - 3), borders[0])
    last = min(max(int(high[0]) - 1 if high.size else len(sv), k + 3), borders[1])
    part = slice(first, last + 1)
    level = sv[np.arange(len(sv)), which][part]
    enhanced = (like[part] * sv[part]).sum(1)  # ψᴴ G ψ
    return _Bell(
        first, last, vector=psi, level=level, enhanced=enhanced, mean_mac=float(best[part].mean())
    )


def _fit(b: _Bell, spectra: Csd, history: TimeHistory, scale: Float, s: FddSettings) -> list[float]:
    """Frequency, damping and their standard deviations."""
    df = spectra.freqs[1]
    length = round(history.rate / df)
    if s.method == "fsdd":
        return _spectral(b, length, history.rate, spectra.segments)
    f = spectra.freqs[b.first : b.last + 1]
    lag = np.arange(length // 2)
    taper = lag_window(length)
    if s.method == "efdd":
        decay = _turns(lag, f, history.rate) @ b.level / taper[: lag.size]
    else:
        decay = _signature(history, b, scale=scale, df=df, length=length)
    got = log_decrement(decay, history.rate, s.levels)
    low = np.flatnonzero(np.abs(decay) < s.levels[1] * np.abs(decay[0]))
    # where a mode of that damping has fallen as far
    lag = lag[: 2 * int(low[0]) + 16] if low.size else lag
    if s.method == "efdd":
        turns = _turns(lag, f, history.rate) / taper[: lag.size, None]
        kernel = _tapered(f, taper, history.rate)

        def cut(f0: float, zeta: float) -> Complex:
            return np.asarray(
                turns @ (kernel @ _free_decay(f0, zeta, length, history.rate) * (f / f0) ** 2)
            )
    else:
        fine = np.linspace((b.first - 0.5) * df, (b.last + 0.5) * df, 3 * f.size)
        turns = _turns(lag, fine, history.rate)

        def cut(f0: float, zeta: float) -> Complex:
            nu2 = (fine / f0) ** 2
            return np.asarray(turns @ (nu2**2 / ((1 - nu2) ** 2 + 4 * zeta**2 * nu2)))

    return [
        *_whole(got, cut, edges=(f[0], f[-1]), rate=history.rate, levels=s.levels),
        np.nan,
        np.nan,
    ]


def _whole(
    got: tuple[float, float],
    cut: Callable[[float, float], Complex],
    edges: tuple[float, float],
    rate: float,
    levels: tuple[float, float],
) -> tuple[float, float]:
    """Frequency and damping of the mode whose decay, `cut` to the bell, has those that were `got`
    by its logarithm.

    A bell that ends within a few half bandwidths, at its neighbours or in the noise, has a decay of
    its own.
    """

    f = float(np.clip(got[0], *edges))
    zeta = float(np.clip(got[1], *_DAMPING))
    for _ in range(_ROUNDS):
        f_cut, zeta_cut = log_decrement(cut(f, zeta), rate, levels)
        by = float(np.clip(got[1] / max(zeta_cut, _DAMPING[0]), 0.5, 2.0))
        f = float(np.clip(f * got[0] / f_cut, *edges))
        zeta = float(np.clip(zeta * by, *_DAMPING))
        if abs(by - 1) < _NEAR and abs(got[0] / f_cut - 1) < _NEAR * zeta:
            break
    return f, zeta


def _turns(lag: Int, freqs: Float, rate: float) -> Complex:
    """(lag, line) phasors."""
    return np.asarray(np.exp(2j * np.pi * np.outer(lag, freqs) / rate))


def _tapered(freqs: Float, taper: Float, rate: float) -> Float:
    """(line, lag) cosines that give the spectrum of a tapered correlation at the lines."""
    lag = np.arange(taper.size)
    return np.asarray(
        np.cos(2 * np.pi * np.outer(freqs, lag) / rate) * taper * np.where(lag == 0, 1.0, 2.0)
    )


def _free_decay(f: float, zeta: float, length: int, rate: float) -> Float:
    """(length,) decay of a mode."""
    wt = 2 * np.pi * f * np.arange(length) / rate
    return np.asarray(np.exp(-zeta * wt) * np.cos(wt * np.sqrt(max(1 - zeta**2, 1e-3))))


def lag_window(length: int) -> Float:
    """(length,) factor by which Hann-tapered segments of `length` samples shrink a correlation at
    each lag.
    """
    w = window("hann", length)
    n = int(next_fast_len(2 * length, real=True))
    return np.asarray(irfft(np.abs(rfft(w, n)) ** 2, n)[:length] / length)


def log_decrement(
    decay: Complex, rate: float, levels: tuple[float, float] = (0.95, 0.5)
) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of an analytic free decay (lag,) by its logarithm between
    two `levels`.

    The level is that of the envelope over its start; the weight of a lag is its power.
    """
    size = np.abs(decay)
    below = np.flatnonzero(size < levels[1] * size[0])
    end = max(int(below[0]) if below.size else size.size, 8)
    late = np.flatnonzero(size[:end] < levels[0] * size[0])
    at = np.arange(min(int(late[0]) if late.size else 0, end - 6), end)
    w = size[at]
    slope = [
        np.polyfit(at / rate, x[at], 1, w=w)[0] for x in (np.log(size), np.unwrap(np.angle(decay)))
    ]
    pole = complex(slope[0], slope[1])
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


def _signature(history: TimeHistory, b: _Bell, scale: Float, df: float, length: int) -> Complex:
    """Analytic random decrement signature of the modal coordinate within the bell."""
    q = (b.vector.conj() / scale) @ detrend(history.data)
    n = q.size
    f = np.abs(np.fft.fftfreq(n, 1 / history.rate)) - 0.5 * df
    spectrum = np.fft.fft(q) * ((f >= (b.first - 1) * df) & (f <= b.last * df))
    spectrum[n // 2 :] = 0.0
    return random_decrement(np.asarray(2 * np.fft.ifft(spectrum)), length // 2)


def random_decrement(signal: Complex, lags: int) -> Complex:
    """(lags,) mean of the stretches of an analytic `signal` (sample,) after each crossing of √2
    standard deviations.

    Upward and downward crossings of both signs: what depends on the slope cancels, and the mean is
    proportional to the correlation (Vandiver et al. 1982).

    Raises
    ------
    DataError
        If there is no crossing.
    """
    x = signal.real
    level = np.sqrt(2) * x.std()
    total = np.zeros(lags, dtype=np.complex128)
    count = 0
    for sign in (1.0, -1.0):
        over = sign * x > level
        at = np.flatnonzero(over[1:] != over[:-1])
        at = at[at < x.size - lags]
        for part in np.array_split(at, max(1, at.size * lags // 4_000_000)):
            total += sign * signal[part[:, None] + np.arange(lags)].sum(0)
        count += at.size
    if not count:
        raise DataError(f"{x.size} samples hold no crossing of {level:.3g} for {lags} lags")
    return total / count


def _spectral(b: _Bell, length: int, rate: float, segments: int) -> list[float]:
    """Fit of ψᴴGψ over the bell, or where lines above are lower than any mode has them, a filter,
    over its peak.
    """
    f = np.arange(b.first, b.last + 1) * rate / length
    peak = int(np.argmax(b.enhanced))
    level = b.enhanced / b.enhanced[peak]
    low = np.flatnonzero(level < _FOOT)
    after = low[low > peak + 3]
    if not after.size:
        return _around(f, level, length=length, rate=rate, segments=segments)
    near = _one_mode(f[: after[0]], level[: after[0]], length=length, rate=rate, segments=segments)
    nu = f / near[0]
    zeta = near[1]
    mode = 4 * zeta**2 / ((1 - nu**2) ** 2 + 4 * zeta**2 * nu**2)
    filtered = (level < _FALL * mode) & (f > f[peak + 3])
    return (
        near if filtered.any() else _around(f, level, length=length, rate=rate, segments=segments)
    )


def _around(f: Float, level: Float, length: int, rate: float, segments: int) -> list[float]:
    """The fit over the lines; where some are farther from the mode than a slope and a level can
    tell, without those.
    """
    fit = _one_mode(f, level, length=length, rate=rate, segments=segments)
    near = np.abs(f - fit[0]) <= max(_REACH * fit[0] * fit[1], 4 * (f[1] - f[0]))
    return (
        fit
        if near.all() or near.sum() < 8
        else _one_mode(f[near], level[near], length=length, rate=rate, segments=segments)
    )


def _one_mode(f: Float, unit_level: Float, length: int, rate: float, segments: int) -> list[float]:
    """Whittle-like fit of the spectrum of a modal coordinate: one mode seen through the taper, a
    slope, a background.

    Frequency, damping and their standard deviations.
    """
    kernel = _tapered(f, lag_window(length), rate)
    peak = int(np.argmax(unit_level))

    def misfit(x: Float) -> Float:
        w = 2 * np.pi * f[peak] * np.exp(x[0])
        zeta = np.exp(x[1])
        curve = kernel @ _free_decay(w / (2 * np.pi), zeta, length, rate) * 2 * zeta * w / rate
        model = np.exp(x[2]) * np.maximum(curve, 1e-9) * (f / f[peak]) ** x[4] + np.exp(x[3])
        return np.asarray(
            np.append(np.log(unit_level) - np.log(model), (x[4] - 2) / 2 * np.sqrt(1 / segments))
        )

    low = float(np.log(max(unit_level.min(), 1e-6)))
    start = np.array([0.0, np.log(0.01), 0.0, low - 1.0, 2.0])
    low_z, high_z = np.log(_DAMPING)
    bounds = ([-0.3, low_z, -12.0, -25.0, -8.0], [0.3, high_z, 12.0, 1.0, 12.0])
    fit = least_squares(
        misfit, np.clip(start, bounds[0], bounds[1]), bounds=bounds, x_scale=[0.01, 0.3, 0.3, 1, 2]
    )
    jac = np.asarray(fit.jac, dtype=np.float64)
    cov = np.linalg.pinv(jac.T @ jac) * _scatter(length) / segments
    f0 = f[peak] * np.exp(fit.x[0])
    zeta = np.exp(fit.x[1])
    return [
        float(f0),
        float(zeta),
        float(f0 * np.sqrt(cov[0, 0])),
        float(zeta * np.sqrt(cov[1, 1])),
    ]


def _scatter(length: int) -> float:
    """How much neighbouring lines and half-overlapped segments of a Hann taper say the same, as a
    variance ratio.
    """
    w = window("hann", length)
    lines = np.abs(np.fft.fft(w**2)[:5] / (w**2).sum()) ** 2
    overlap = ((w[length // 2 :] * w[: length - length // 2]).sum() / (w**2).sum()) ** 2
    return float((1 + 2 * lines[1:].sum()) * (1 + 2 * overlap))
