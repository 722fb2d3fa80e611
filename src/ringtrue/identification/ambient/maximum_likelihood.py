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
        Standard deviation of ln of what noise and other modes leave in a filtered spectrum: of
        their levels, and of the bend of the response at the ends of its lines.
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
    ok : (m,) bool
        False where the fit did not settle; the start stands then.
    """

    frequency: Float
    damping: Float
    covariance: Float
    ok: Bool


def _finite(
    nu: Float, nu0: float, zeta: float, windows: tuple[tuple[float, float], ...]
) -> Float:
    """(3, bin): factor on the spectrum of a mode for the finite length, and its derivatives by
    ln ν0 and ln ζ; `windows`: weights, and lengths in periods of f_start.

    For each window 1 − Re g / Re[1/q], g = (1 − e⁻ᑫ)/q², q = a + ib = length · (iω − s) of the
    pole s.
    """
    root = np.sqrt(1 - min(zeta, 0.9) ** 2)
    out = np.zeros((3, *nu.shape))
    for weight, turns in windows:
        length = 2 * np.pi * turns
        a = length * zeta * nu0
        q = a + 1j * length * (nu - nu0 * root)
        # after 40 time constants nothing is left of a motion
        left = np.exp(-q) if a < 40.0 else 0.0
        inverse = 1 / q
        square = inverse * inverse
        ratio = ((1 - left) * square).real / inverse.real
        by_q = (left * (q + 2) - 2) * square * inverse + ratio * square
        out[0] += weight * (1 - ratio)
        change = length * nu0 * (zeta + 1j * np.array([[-root], [zeta**2 / root]]))
        out[1:] -= weight * (by_q * change).real / inverse.real
    return out


def _lorentz(
    nu: Float, nu0: float, zeta: float, windows: tuple[tuple[float, float], ...]
) -> Float:
    """(3, bin): 1 over |ν0² − ν² + 2iζν0ν|², peak 1, as seen in a record of a finite length, and
    its logarithmic derivatives by ln ν0 and ln ζ.
    """
    square = nu * nu
    own = nu0**2 - square
    wide = (4 * zeta**2 * nu0**2) * square
    d = own * own + wide
    seen, by_freq, by_zeta = _finite(nu, nu0, zeta, windows)
    by_freq = 4 - (4 * nu0**2 * own + 2 * wide) / d + by_freq / seen
    by_zeta = 2 - 2 * wide / d + by_zeta / seen
    return np.stack([(4 * zeta**2 * nu0**4) * seen / d, by_freq, by_zeta])


@dataclass(frozen=True, slots=True, eq=False)
class _SpectrumFit:
    """Whittle fit of one filtered spectrum: θ = ln ν0, ln ζ, slope, bend, ln A, ln of the
    background at both ends, then ln of each neighbour's level.

    Forces that modes share make them move in step: far modes that the filter does not stop add to
    the response on one side of the mode, or take from it on both. Its logarithm is a parabola.

    Attributes
    ----------
    nu, power, count : (bin,) float64
    windows : tuple of (weight, length in periods of f_start)
    reach : float
        Of the bins on each side, relative to f_start.
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
    reach: float
    place: Float
    near: Float
    mean: Float
    prior: Float

    def spectrum(self, theta: Float) -> tuple[Float, Float]:
        """S (bin,) and its logarithmic derivatives (bin, parameter)."""
        nu0, zeta = np.exp(theta[:2]).tolist()
        slope, bend = theta[2:4].tolist()
        own, by_freq, by_zeta = _lorentz(self.nu, nu0, zeta, self.windows)
        ratio = np.log(self.nu / nu0)
        square = (ratio / self.reach) ** 2
        shown = own * np.exp(slope * ratio + bend * square)
        x = (self.nu - self.nu[0]) / (self.nu[-1] - self.nu[0])
        parts = np.empty((x.size, 3 + self.place.size))
        parts[:, 0], parts[:, 1], parts[:, 2] = shown, 1 - x, x
        away = ratio[:, None] + np.log(nu0 / self.place)
        parts[:, 3:] = self.near * np.exp(slope * away)
        parts *= np.exp(theta[4:])
        s = np.maximum(parts.sum(1), 1e-300)
        parts /= s[:, None]
        by_freq = by_freq - slope - 2 * bend * ratio / self.reach**2
        first = parts[:, :1] * np.stack([by_freq, by_zeta, ratio, square], axis=1)
        first[:, 2] += (parts[:, 3:] * away).sum(axis=1)
        return s, np.concatenate([first, parts], axis=1)

    def cost(self, s: Float, theta: Float) -> float:
        """Negative log posterior."""
        return float(
            self.count @ (np.log(s) + self.power / s)
            + 0.5 * self.prior @ (theta - self.mean) ** 2
        )

    def run(self) -> tuple[Float, Float, bool]:
        """θ, its covariance with the misfit of the model, and whether Fisher scoring settled."""
        theta = self.mean.copy()
        s, g = self.spectrum(theta)
        cost = self.cost(s, theta)
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
                step /= 2
            else:
                break
            theta += step
            s = s_new
            g = g_new
            cost = c
        info = (g.T * self.count) @ g + np.diag(self.prior)
        square = float(self.count @ (self.power / s - 1) ** 2)
        misfit = max(square / max(s.size - theta.size, 1), 1.0)
        return theta, np.asarray(misfit * np.linalg.inv(info)), done

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
    ok = np.zeros(m, dtype=np.bool_)
    for _ in range(2):
        start = EstimatedModes(f.copy(), z.copy(), modes.shape)
        for i in range(m):  # modes
            for far in LIMITS.reaches:
                fit = _prepare(bins, start, i, far, slope)
                if fit is None:
                    continue
                theta, c, good = fit.run()
                new_f = start.frequency[i] * np.exp(theta[0])
                new_z = np.exp(theta[1])
                near = abs(new_f / frequency[i] - 1) < max(0.7 * damping[i], 0.002)
                near &= bool(abs(np.log(new_z / damping[i])) < reach[i])
                sharp = c[1, 1] < most[i]
                if good and near and sharp and fit.waves(theta) < 1:
                    f[i] = new_f
                    z[i] = new_z
                    cov[i] = c[:2, :2]
                    ok[i] = True
                    break
    return LikelihoodFit(f, z, cov, ok)


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
    where lines are too few, or averages hide the mode.
    """
    f = modes.frequency
    z = modes.damping
    half = z[i] * f[i]
    at = np.flatnonzero(np.abs(b.freqs - f[i]) < far * half)
    if at.size < 12:  # no more than the unknowns of a mode with some neighbours
        return None
    averaged = np.median(np.diff(b.freqs[at])) - 1 / b.duration
    if half < 1.5 * averaged:
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
    for k, other in enumerate(others.tolist()):  # neighbours
        near[:, k] = _lorentz(nu, float(place[k]), float(z[other]), windows)[0]
    mode = _ModeAmongOthers(i, at, half, others, count @ near / count.sum())
    own = _filter(b, modes, mode)
    # single precision, that of the spectra: to make them double takes longer than all else
    w = own.weights.astype(np.complex64)
    cross = b.cross[at[0] : at[-1] + 1]
    passed = (cross.reshape(-1, w.size) @ w).reshape(-1, w.size) @ w.conj()
    power = np.maximum(np.add.reduceat(lines * passed.real, begin) / count, 1e-300)
    peak = np.median(power[np.argsort(np.abs(nu - 1))[: few + 2]])
    seen = np.array([np.median(power[:few]), np.median(power[-few:])]) / 2
    ends = np.where(np.isfinite(own.noise), own.noise, seen)
    levels = np.log([peak, *ends, *np.maximum(own.leak, 1e-6 * peak)])
    mean = np.array([0.0, np.log(z[i]), slope[0], 0.0, *levels])
    # what the data do not show is held near what the filter is expected to pass: levels cannot be
    # negative, so that free ones take from the skirts of the mode on average, and with them from
    # its damping
    prior = np.full(mean.size, LIMITS.level**-2)
    prior[[0, 1, 4]] = 1e-4  # ν0, ζ and A are free
    prior[2] = slope[1] ** -2
    return _SpectrumFit(
        nu,
        power,
        count,
        windows,
        far * float(z[i]),
        place=place,
        near=near,
        mean=mean,
        prior=prior,
    )
