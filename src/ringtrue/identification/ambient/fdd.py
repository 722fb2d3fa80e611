"""Frequency domain decomposition with frequency-spatial damping (FDD, FSDD).

Brincker, Zhang and Andersen 2001 (FDD), Zhang, Wang and Tamura 2010 (FSDD). The taper of the
spectra widens every peak. Here the fitted model passes through the same taper, so that the damping
is not biased by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.confidence import LIMITS
from ringtrue.identification.ambient.pipeline import AmbientSettings
from ringtrue.identification.common.stabilisation import DAMPING_MAX, unit
from ringtrue.signal.spectra import Csd, Welch, csd, window


@dataclass(frozen=True, slots=True)
class FddSettings:
    """Settings of `fdd`.

    Attributes
    ----------
    fmin, fmax : float, Hz
        Band of the peaks; fmax 0: what the rate allows.
    foot : float
        Level, over the peak, at which the upper side of a bell ends, as a filter of the recorder
        may cut what is below, and both sides of the bell of one channel.
    """

    fmin: float = 0.0
    fmax: float = 0.0
    foot: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Bell:
    """Lines `first` .. `last` around the peak of one mode.

    Attributes
    ----------
    vector : (ch,) complex128
        Singular vector of the peak.
    enhanced : (line,) float64
        Spectrum of the modal coordinate.
    mean_mac : float
    """

    first: int
    last: int
    vector: Complex
    enhanced: Float
    mean_mac: float


@dataclass(frozen=True, slots=True)
class _Taper:
    """How the spectra were made: segments, samples of each, and their rate (Hz)."""

    length: int
    rate: float
    segments: int


def fdd(
    history: TimeHistory,
    settings: FddSettings | None = None,
    *,
    near: Sequence[float] = (),
) -> tuple[ModeSet, Uncertainty]:
    """Modes from the peaks of the singular values of the spectral matrix, of 20 segments.

    Parameters
    ----------
    history : TimeHistory
    settings : FddSettings
    near : sequence of float, Hz
        Peaks to take, each the highest line within three of it; (): all peaks of the first singular
        value that stand out of its scatter and whose neighbours have the same singular vector.

    Returns
    -------
    ModeSet
        The confidence is the mean MAC of the singular vectors over the bell.
    Uncertainty
        Of frequency and damping; shapes have none.

    Raises
    ------
    DataError
        If the record is shorter than a segment, or a channel is not finite.
    """
    s = settings or FddSettings()
    if not np.isfinite(history.data).all():
        raise DataError(
            f"{history.source}: values are not finite; leave those channels out"
        )
    spectra = csd(history, Welch(20.0 / history.duration))
    power = np.einsum("fii->i", spectra.data).real
    scale = np.sqrt(np.maximum(power, np.finfo(np.float64).tiny))
    u, sv, _ = np.linalg.svd(spectra.data / (scale[:, None] * scale), hermitian=True)
    if near:
        # the highest line within three of each frequency
        at = np.searchsorted(spectra.freqs, np.asarray(near, dtype=np.float64))
        around = np.clip(at[:, None] + np.arange(-3, 4), 1, spectra.freqs.size - 2)
        highest = np.argmax(sv[:, 0][around], axis=1)
        lines = np.asarray(
            np.unique(around[np.arange(at.size), highest]), dtype=np.int64
        )
    else:
        lines = _peaks(spectra, u[:, :, 0], sv[:, 0], s)
    taper = _Taper(
        round(history.rate / spectra.freqs[1]), history.rate, spectra.segments
    )
    mean_mac = np.empty(lines.size)
    fitted = np.empty((lines.size, 4))
    shapes = np.empty((scale.size, lines.size), dtype=np.complex128)
    for row, k in enumerate(lines.tolist()):
        bell = _bell(k, u, sv, _borders(lines, k, sv, s.foot))
        mean_mac[row] = bell.mean_mac
        fitted[row] = _fit(bell, taper, s.foot)
        shapes[:, row] = bell.vector * scale
    modes = ModeSet(
        fitted[:, 0],
        fitted[:, 1],
        unit(shapes),
        tuple(c.id for c in history.channels),
        source=f"{history.source or 'record'}: FDD",
        confidence=mean_mac,
    )
    unknown = np.full(shapes.shape, np.nan)
    return modes, Uncertainty.independent(fitted[:, 2], fitted[:, 3], unknown)


def fdd_modes(
    history: TimeHistory, settings: AmbientSettings, near: Sequence[float]
) -> tuple[ModeSet, Uncertainty]:
    """Modes of the peaks in the band of the settings, or `near` some frequencies, Hz."""
    own = FddSettings(fmin=settings.fmin or 0.0, fmax=settings.fmax or 0.0)
    return fdd(history, own, near=near)


def _peaks(spectra: Csd, vector: Complex, level: Float, s: FddSettings) -> Int:
    """Lines of peaks eight standard deviations above their surroundings, steady in their vector."""
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    # a singular value averaged over K segments scatters by 1/sqrt(K) of itself
    prominence = 8 / np.sqrt(spectra.segments)
    found, _ = find_peaks(np.log(np.maximum(level, 1e-300)), prominence=prominence)
    f = spectra.freqs
    top = s.fmax or 0.95 * f[-1]
    inside = (
        (f[found] >= max(s.fmin, 3 * f[1])) & (f[found] <= top) & (found < f.size - 2)
    )
    found = found[inside]
    around = vector[found[:, None] + np.array([-2, -1, 1, 2])]
    like = np.abs(np.einsum("pkc,pc->pk", around.conj(), vector[found])) ** 2
    return np.asarray(found[like.mean(1) > LIMITS.same], dtype=np.int64)


def _borders(lines: Int, k: int, sv: Float, foot: float) -> tuple[int, int]:
    """The bell may not pass the neighbouring peaks.

    A single channel has no shapes: its bell ends at the valleys around the peak or at its foot.
    """
    below = lines[lines < k]
    above = lines[lines > k]
    low = int(below[-1]) + 1 if below.size else 1
    high = int(above[0]) - 1 if above.size else len(sv) - 2
    if sv.shape[1] > 1:
        return low, high
    level = np.maximum(sv[:, 0], foot * sv[k, 0])
    return k - int(np.argmin(level[low : k + 1][::-1])), k + int(
        np.argmin(level[k : high + 1])
    )


def _bell(k: int, u: Complex, sv: Float, borders: tuple[int, int]) -> _Bell:
    """Lines around `k` with a singular vector like that of the peak (Brincker et al. 2001), at
    least three on each side.
    """
    psi = u[k, :, 0]
    like = np.abs(np.einsum("fci,c->fi", u.conj(), psi)) ** 2
    best = like.max(axis=1)
    out = np.flatnonzero(uniform_filter1d(best, 5) < LIMITS.same)
    low = out[out < k]
    high = out[out > k]
    first = max(min(int(low[-1]) + 1 if low.size else 0, k - 3), borders[0])
    last = min(max(int(high[0]) - 1 if high.size else len(sv), k + 3), borders[1])
    part = slice(first, last + 1)
    enhanced = (like[part] * sv[part]).sum(1)  # ψᴴ G ψ
    return _Bell(first, last, psi, enhanced, float(best[part].mean()))


def _fit(b: _Bell, taper: _Taper, foot: float) -> tuple[float, float, float, float]:
    """Frequency, damping and their standard deviations from ψᴴGψ over the bell, up to its foot."""
    f = np.arange(b.first, b.last + 1) * taper.rate / taper.length
    peak = int(np.argmax(b.enhanced))
    level = b.enhanced / b.enhanced[peak]
    low = np.flatnonzero(level < foot)
    end = int(low[low > peak + 3].min(initial=level.size))
    return _one_mode(f[:end], level[:end], taper)


def _one_mode(
    f: Float, level: Float, taper: _Taper
) -> tuple[float, float, float, float]:
    """Fit of the logarithmic spectrum by one mode seen through the taper, a slope, a background.

    Frequency, damping and their standard deviations.
    """
    length = taper.length
    rate = taper.rate
    lag = np.arange(length)
    once = np.where(lag == 0, 1.0, 2.0)
    cosines = np.cos(2 * np.pi * np.outer(f, lag) / rate)
    # the taper shrinks a correlation at each lag
    padded = int(next_fast_len(2 * length, real=True))
    tapered = (
        irfft(np.abs(rfft(window("hann", length), padded)) ** 2, padded)[:length]
        / length
    )
    kernel = cosines * tapered * once
    peak = int(np.argmax(level))

    def misfit(x: Float) -> Float:
        w = 2 * np.pi * f[peak] * np.exp(x[0])
        zeta = np.exp(x[1])
        wt = w * lag / rate
        decay = np.exp(-zeta * wt) * np.cos(wt * np.sqrt(max(1 - zeta**2, 1e-3)))
        curve = kernel @ decay * 2 * zeta * w / rate
        model = np.exp(x[2]) * np.maximum(curve, 1e-9) * (f / f[peak]) ** x[4] + np.exp(
            x[3]
        )
        slope = (x[4] - 2) / 2 * np.sqrt(1 / taper.segments)
        return np.append(np.log(level) - np.log(model), slope)

    background = float(np.log(max(level.min(), 1e-6)))
    start = np.array([0.0, np.log(0.01), 0.0, background - 1.0, 2.0])
    # the slowest decay has the half-overlapped record for its time constant
    least = rate / (np.pi * f[peak] * length * taper.segments)
    low_z, high_z = np.log([min(least, 0.5 * DAMPING_MAX), DAMPING_MAX])
    bounds = ([-0.3, low_z, -12.0, -25.0, -8.0], [0.3, high_z, 12.0, 1.0, 12.0])
    fit = least_squares(
        misfit,
        np.clip(start, bounds[0], bounds[1]),
        bounds=bounds,
        x_scale=[0.01, 0.3, 0.3, 1, 2],
    )
    jac = np.asarray(fit.jac, dtype=np.float64)
    cov = np.linalg.pinv(jac.T @ jac) * _scatter(length) / taper.segments
    f0 = float(f[peak] * np.exp(fit.x[0]))
    zeta = float(np.exp(fit.x[1]))
    return f0, zeta, f0 * float(np.sqrt(cov[0, 0])), zeta * float(np.sqrt(cov[1, 1]))


def _scatter(length: int) -> float:
    """Variance ratio of what neighbouring lines and half-overlapped Hann segments share."""
    w = window("hann", length)
    power = (w**2).sum()
    lines = np.abs(np.fft.fft(w**2)[:5] / power) ** 2
    overlap = ((w[length // 2 :] * w[: length - length // 2]).sum() / power) ** 2
    return float((1 + 2 * lines[1:].sum()) * (1 + 2 * overlap))
