"""Maximum likelihood of each mode on its own spectrum: what a subspace estimate leaves on the
table.

A spatial filter (minimum variance, Capon 1969) takes one mode out of the spectral matrix; pole and
background are fitted to the filtered periodogram by Whittle's likelihood (1953), whose expected
value accounts for the length of the record (Sykulski et al. 2019); for one mode in white noise this
is Au's (2011) Bayesian FFT. The statistical floor (Gersch 1974) is reached where the mode stands
clear of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.ambient.spectral_bins import SpectralBins


@dataclass(frozen=True, slots=True)
class LikelihoodLimits:
    """The lines that a fit uses, and what it takes for granted.

    Attributes
    ----------
    reaches : tuple of float
        Half bandwidths on each side of a mode: fewer where something else is there. Ten leave a
        damping 18 % more scatter than the whole spectrum does, and a frequency with an unknown
        slope 27 %; twenty leave 8 and 12 %.
    level : float
        Standard deviation of ln of the levels that noise and other modes leave in a filtered
        spectrum.
    """

    reaches: tuple[float, ...] = (20.0, 10.0)
    level: float = 1.5


LIMITS = LikelihoodLimits()


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedModes:
    """Modes as they are known so far.

    Attributes
    ----------
    frequency, damping : (m,) float64
        Hz, fraction of critical.
    shape : (ch, m) complex128
        In the channels and the units of the spectra.
    """

    frequency: Float
    damping: Float
    shape: Complex


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodFit:
    """Modes refined one by one.

    Attributes
    ----------
    frequency : (m,) float64, Hz
    damping : (m,) float64
    covariance : (m, 2, 2) float64
        Of ln frequency and ln damping.
    misfit : (m,) float64
        Mean squared error over its expectation, 1 for a perfect model.
    ok : (m,) bool
        False where the fit did not settle; the start stands then.
    """

    frequency: Float
    damping: Float
    covariance: Float
    misfit: Float
    ok: Bool


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """One mode's spectrum over ν = f/f_start: level and its logarithmic derivatives."""

    level: Float
    d_freq: Float
    d_zeta: Float


def _finite(
    nu: Float, nu0: float, zeta: float, windows: tuple[tuple[float, float], ...]
) -> Float:
    """Factor on the spectrum of a mode for the finite length; `windows`: weights, and lengths in
    periods of f_start.

    For each window 1 − Re[(1 − e⁻ᑫ)/q²] / Re[1/q], q = a + ib = length · (iω − s) of the pole s.
    """
    decay = 2 * np.pi * zeta * nu0
    off = 2 * np.pi * (nu - nu0 * np.sqrt(1 - min(zeta, 0.9) ** 2))
    factor = np.zeros(nu.shape)
    for weight, turns in windows:
        a = turns * decay
        b = turns * off
        size = a * a + b * b
        part = (a * a - b * b) / size
        if a < 40.0:  # time constants, after which nothing is left of a motion
            part -= np.exp(-a) * (part * np.cos(b) - 2 * a * b / size * np.sin(b))
        factor += weight * (1 - part / a)
    return factor


def _lorentz(
    nu: Float, nu0: float, zeta: float, windows: tuple[tuple[float, float], ...]
) -> _Curve:
    """1 over |ν0² − ν² + 2iζν0ν|², peak 1, as seen in a record of a finite length."""
    square = nu * nu
    own = nu0**2 - square
    wide = (4 * zeta**2 * nu0**2) * square
    d = own * own + wide
    level = (4 * zeta**2 * nu0**4) * _finite(nu, nu0, zeta, windows) / d
    return _Curve(level, 4 - (4 * nu0**2 * own + 2 * wide) / d, 2 - 2 * wide / d)


@dataclass(frozen=True, slots=True, eq=False)
class _SpectrumFit:
    """Whittle fit of one filtered spectrum: θ = ln ν0, ln ζ, slope, ln A, ln of the background at
    both ends, then ln of each neighbour's level.

    Attributes
    ----------
    nu, power, count : (bin,) float64
    windows : tuple of (weight, length in periods of f_start)
    place : (other,) float64
        ν of the neighbours.
    near : (bin, other) float64
        Their spectra without the slope.
    mean, prior : (parameter,) float64
        Start of θ, and one over the variance of what is known of it.
    """

    nu: Float
    power: Float
    count: Float
    windows: tuple[tuple[float, float], ...]
    place: Float
    near: Float
    mean: Float
    prior: Float

    def spectrum(self, theta: Float) -> tuple[Float, Float]:
        """S (bin,) and its logarithmic derivatives (bin, parameter)."""
        nu0 = float(np.exp(theta[0]))
        zeta = float(np.exp(theta[1]))
        slope = float(theta[2])
        own = _lorentz(self.nu, nu0, zeta, self.windows)
        ratio = np.log(self.nu / nu0)
        tilt = np.exp(slope * ratio)
        x = (self.nu - self.nu[0]) / (self.nu[-1] - self.nu[0])
        parts = np.empty((x.size, 3 + self.place.size))
        parts[:, 0], parts[:, 1], parts[:, 2] = own.level * tilt, 1 - x, x
        parts[:, 3:] = self.near * tilt[:, None] * (nu0 / self.place) ** slope
        parts *= np.exp(theta[3:])
        s = np.maximum(parts.sum(1), 1e-300)
        parts /= s[:, None]
        first = parts[:, :1] * np.stack([own.d_freq - slope, own.d_zeta, ratio], axis=1)
        return s, np.concatenate([first, parts], axis=1)

    def cost(self, s: Float, theta: Float) -> float:
        """Negative log posterior."""
        return float(
            self.count @ (np.log(s) + self.power / s)
            + 0.5 * self.prior @ (theta - self.mean) ** 2
        )

    def run(self) -> tuple[Float, Float, float, bool]:
        """θ, covariance, misfit and whether Fisher scoring settled."""
        theta = self.mean.copy()
        s, g = self.spectrum(theta)
        cost = self.cost(s, theta)
        done = False
        for _ in range(80):
            info = (g.T * self.count) @ g + np.diag(self.prior)
            slope = g.T @ (self.count * (self.power / s - 1)) - self.prior * (
                theta - self.mean
            )
            step = np.linalg.solve(info, slope)
            # the posterior can still rise by half of this: below, nothing is left to gain
            if done := bool(slope @ step < 1e-4):
                break
            step *= min(1.0, 0.7 / np.abs(step).max())
            for _ in range(8):
                s_new, g_new = self.spectrum(theta + step)
                if (c := self.cost(s_new, theta + step)) < cost:
                    break
                step = step / 2
            else:
                break
            theta = theta + step
            s = s_new
            g = g_new
            cost = c
        info = (g.T * self.count) @ g + np.diag(self.prior)
        misfit = float(
            (self.count * (self.power / s - 1) ** 2).sum() / max(s.size - theta.size, 1)
        )
        return theta, np.asarray(np.linalg.inv(info), dtype=np.float64), misfit, done

    def waves(self, theta: Float) -> float:
        """Squared error of bins a half bandwidth wide, over what chance makes of it: forces that
        modes share bend it.
        """
        error = self.count * (self.power / self.spectrum(theta)[0] - 1)
        k = np.floor(
            (self.nu / np.exp(theta[0]) - self.nu[0]) / np.exp(theta[1])
        ).astype(np.int64)
        k -= k.min()
        lines = np.bincount(k, self.count)
        some = lines > 0
        square = np.bincount(k, error)[some] ** 2 / lines[some]
        return float(square.sum() / chdtri(square.size, FALSE_ALARM))


@dataclass(frozen=True, slots=True, eq=False)
class _Filter:
    """w (ch,) with wᴴψ = 1, and what passes it besides the mode.

    Attributes
    ----------
    weights : (ch,) complex128
    noise : (2,) float64
        Background expected at both ends of the band; NaN where the shapes leave no room to see it.
    leak : (other,) float64
        Peak expected of each other mode.
    """

    weights: Complex
    noise: Float
    leak: Float


@dataclass(frozen=True, slots=True, eq=False)
class _ModeAmongOthers:
    """One of several modes and the bins around it.

    Attributes
    ----------
    which : int
        Position among the modes.
    at : (bin,) int64
        Its bins, in a row.
    half : float, Hz
        Its half bandwidth.
    others : (other,) int64
        Positions of the modes near it.
    near : (other,) float64
        Their mean spectra in the bins.
    """

    which: int
    at: Int
    half: float
    others: Int
    near: Float


def _filter(b: SpectralBins, modes: EstimatedModes, mode: _ModeAmongOthers) -> _Filter:
    """The filter of a mode that passes least of the noise and of the others in its bins.

    The noise is what no shape explains, away from the peak. All that lies there would not do: the
    mode's own skirts are in it, a motion of other modes in step with them would cancel them, and
    the peak would look too sharp.
    """
    i = mode.which
    at = mode.at
    f = modes.frequency
    psi = modes.shape
    channels = len(psi)
    shapes = psi[:, [i, *mode.others.tolist()]]
    u, size, _ = np.linalg.svd(
        shapes / np.linalg.norm(shapes, axis=0), full_matrices=False
    )
    q = u[:, size > 0.03 * size[0]]  # other directions are none of theirs
    off = at[np.abs(b.freqs[at] - f[i]) > 2.5 * mode.half]
    parts = np.array_split(off if off.size > 20 else at, 3)
    first = at[0]
    inside = slice(first, at[-1] + 1)
    share = np.zeros((3, at[-1] + 1 - first), dtype=np.float32)
    for row, k in zip(share, parts, strict=True):
        row[k - first] = 1 / k.size
    flat = (
        np.ascontiguousarray(b.cross[inside])
        .reshape(share.shape[1], -1)
        .view(np.float32)
    )
    r = (share @ flat).view(np.complex64).reshape(3, channels, -1).astype(np.complex128)
    out = np.eye(channels) - q @ q.conj().T
    left = np.einsum("ca,pab,bc->pc", out, r, out).real
    level = np.trace(r, axis1=1, axis2=2).real[:, None]
    peak = np.trace(b.cross[at], axis1=1, axis2=2).real.max()
    # of a sine nothing lies around it
    floor = np.maximum(1e-6 * level, 1e-12 * peak) / channels
    noise = np.maximum(left / np.maximum(np.diag(out).real, 0.1), floor)
    peaks = np.empty(mode.others.size)
    for row, k in enumerate(mode.others):
        there = b.cross[np.abs(b.freqs - f[k]).argmin()]
        peaks[row] = np.trace(there).real / np.vdot(psi[:, k], psi[:, k]).real
    nulls = (shapes[:, 1:] * (peaks * mode.near)) @ shapes[:, 1:].conj().T
    x = np.linalg.solve(np.diag(noise.mean(0)) + nulls, psi[:, i])
    w = x / np.vdot(psi[:, i], x)
    ends = np.full(2, np.nan)
    if q.shape[1] < channels:
        ends = noise[[0, 2]] @ np.abs(w) ** 2
    return _Filter(w, ends, np.abs(w.conj() @ shapes[:, 1:]) ** 2 * peaks)


def refine_by_likelihood(
    bins: SpectralBins,
    modes: EstimatedModes,
    slope: tuple[float, float],
    doubt: Float,
    blocks: int,
) -> LikelihoodFit:
    """Refine modes by maximum likelihood, two rounds, the others held.

    Parameters
    ----------
    bins : SpectralBins
    modes : EstimatedModes
    slope : (mean, std)
        Of the exponent of ω in the response: 4 for accelerations under a flat force, 2 for
        velocities, 0 for displacements.
    doubt : (m,) float64
        Relative standard deviation of `damping`; a fit that ends far beyond it has found something
        else, and one that knows clearly less is of no use: its filter took the mode with the
        others.
    blocks : int
        Of the record, from whose scatter `doubt` is.
    """
    frequency = modes.frequency
    damping = modes.damping
    m = frequency.size
    reach = np.minimum(0.3 + 3 * doubt, 0.9)  # of ln damping
    # a variance is known to a chi-square distribution of its blocks
    free = blocks - 1
    most = doubt**2 * free / chdtri(free, 1 - FALSE_ALARM)
    f = frequency.copy()
    z = damping.copy()
    cov = np.full((m, 2, 2), np.nan)
    misfit = np.full(m, np.nan)
    ok = np.zeros(m, dtype=np.bool_)
    for _ in range(2):
        start = EstimatedModes(f.copy(), z.copy(), modes.shape)
        for i in range(m):  # modes
            for far in LIMITS.reaches:
                fit = _prepare(bins, start, i, far, slope)
                if fit is None:
                    continue
                theta, c, chi, good = fit.run()
                new_f = start.frequency[i] * np.exp(theta[0])
                new_z = np.exp(theta[1])
                near = abs(new_f / frequency[i] - 1) < max(0.7 * damping[i], 0.002)
                near &= bool(abs(np.log(new_z / damping[i])) < reach[i])
                sharp = c[1, 1] * max(chi, 1.0) < most[i]
                if not (good and near and sharp):
                    continue
                if fit.waves(theta) < 1:
                    f[i] = new_f
                    z[i] = new_z
                    cov[i] = c[:2, :2] * max(chi, 1.0)
                    misfit[i] = chi
                    ok[i] = True
                    break
    return LikelihoodFit(frequency=f, damping=z, covariance=cov, misfit=misfit, ok=ok)


def _joined(nu: Float, zeta: float) -> Int:
    """Where the bins begin that some of `nu` (bin,) make together: coarser away from a mode of
    damping `zeta`.
    """
    far = np.maximum(np.abs(nu - 1) / zeta, 1.0)
    # a tenth of the distance to the mode, and three tenths of its half bandwidth at most
    width = np.minimum(0.1 * far, 0.3)
    place = np.cumsum(np.diff(nu, prepend=nu[0]) / zeta / width)
    return np.flatnonzero(np.diff(np.floor(place), prepend=-1.0))


def _prepare(
    b: SpectralBins,
    modes: EstimatedModes,
    i: int,
    far: float,
    slope: tuple[float, float],
) -> _SpectrumFit | None:
    """The filtered spectrum of mode `i`, `far` half bandwidths to each side, with a start; None
    where lines are too few or too coarse.
    """
    f = modes.frequency
    z = modes.damping
    half = z[i] * f[i]
    at = np.flatnonzero(np.abs(b.freqs - f[i]) < far * half)
    if at.size < 30 or half < 1.5 * np.median(np.diff(b.freqs[at])):
        return None
    others = np.flatnonzero(
        (np.abs(f - f[i]) < 2 * far * half) & (np.arange(f.size) != i)
    )
    begin = _joined(b.freqs[at] / f[i], z[i])
    lines = b.count[at]
    count = np.add.reduceat(lines, begin)
    nu = np.add.reduceat(lines * b.freqs[at], begin) / count / f[i]
    few = max(nu.size // 10, 3)
    place = f[others] / f[i]
    windows = tuple((weight, length * float(f[i])) for weight, length in b.windows)
    near = np.empty((nu.size, others.size))
    # neighbours
    for k, (p, q) in enumerate(zip(place.tolist(), z[others].tolist(), strict=True)):
        near[:, k] = _lorentz(nu, p, q, windows).level
    mode = _ModeAmongOthers(i, at, half, others, count @ near / count.sum())
    own = _filter(b, modes, mode)
    # single precision, that of the spectra: to make them double takes longer than all else
    w = own.weights.astype(np.complex64)
    cross = b.cross[at[0] : at[-1] + 1]
    passed = (cross.reshape(-1, w.size) @ w).reshape(-1, w.size) @ w.conj()
    power = np.maximum(np.add.reduceat(lines * passed.real, begin) / count, 1e-300)
    peak = np.median(power[np.argsort(np.abs(nu - 1))[: max(few, 5)]])
    known = np.isfinite(own.noise)
    seen = np.array([np.median(power[:few]), np.median(power[-few:])]) / 2
    ends = np.where(known, own.noise, seen)
    levels = np.log([peak, *ends, *np.maximum(own.leak, 1e-6 * peak)])
    mean = np.array([0.0, np.log(z[i]), slope[0], *levels])
    # what the data do not show is held near what the filter is expected to pass: levels cannot be
    # negative, so that free ones take from the skirts of the mode on average, and with them from
    # its damping
    loose = np.where(known, LIMITS.level, 3.0) ** -2
    prior = np.concatenate(
        [
            [1e-6, 1e-4, slope[1] ** -2, 1e-4],
            loose,
            np.full(others.size, LIMITS.level**-2),
        ]
    )
    return _SpectrumFit(
        nu,
        power,
        count=count,
        windows=windows,
        place=place,
        near=near,
        mean=mean,
        prior=prior,
    )
