"""Sums of decaying exponentials in white noise: the maximum likelihood fit and the search for them.

The model of decay i in channel c is Re Σ_k A_kci w_ki(t) e^{λ_k t}. The amplitudes A are linear and
eliminated (variable projection: Golub and Pereyra 1973, in the form of Kaufman 1975). A step needs
no more of the data than the products with e^{λt} and t e^{λt}. The factors w are 1 but for a mode
whose frequency or damping depends on its amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.special import chdtri

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.iterate import Outcome, iterate
from ringtrue.core.modes import HasPoles
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.common.stabilisation import DAMPING_MAX

Decays = tuple[Float, ...]  # (ch, sample) each, of equal channels


@dataclass(frozen=True, slots=True, eq=False)
class DecayModel(HasPoles):
    """Poles and the slow factors of their exponentials.

    Attributes
    ----------
    poles : (m,) complex128, rad/s, Im > 0
    factors : tuple of (decay of (sample,) complex128) or ()
        One a pole; () for 1.
    """

    poles: Complex
    factors: tuple[tuple[Complex, ...], ...]

    def take(self, at: Sequence[int] | Int) -> DecayModel:
        """The chosen poles."""
        chosen = np.asarray(at, dtype=np.int64)
        return DecayModel(
            self.poles[chosen], tuple(self.factors[k] for k in chosen.tolist())
        )

    def plus(self, pole: complex) -> DecayModel:
        """With one more pole."""
        return DecayModel(np.append(self.poles, pole), (*self.factors, ()))

    def basis(self, decay: int, samples: int, rate: float) -> Complex:
        """(m, sample) exponentials of one decay."""
        time = np.arange(samples) / rate
        out = np.exp(self.poles[:, None] * time)
        for row, factor in zip(out, self.factors, strict=True):  # few have one
            if factor:
                row *= factor[decay]
        return np.asarray(out)


EMPTY = DecayModel(np.zeros(0, dtype=np.complex128), ())


@dataclass(frozen=True, slots=True, eq=False)
class DecaySums:
    """What a model leaves of decays, and the normal equations of its poles.

    Attributes
    ----------
    model : DecayModel
    amplitudes : (decay, ch, m) complex128
    squares : float
        Sum of the squares of what is left.
    gradient : (2 m,) float64
        Of half of it, by the real parts of the poles, then the imaginary ones; the sign is that of
        a descent.
    normal : (ch, 2 m, 2 m) float64
        Normal matrix of each channel.
    inverse : (decay, 2 m, 2 m) float64
        Covariance of the real and imaginary parts of the amplitudes of one channel, poles known,
        for noise of variance 1.
    gain : (m,) float64
        By how much the squares grow without a pole, the other poles as they are.
    """

    model: DecayModel
    amplitudes: Complex
    squares: float
    gradient: Float
    normal: Float
    inverse: Float
    gain: Float


def decay_sums(decays: Decays, rate: float, model: DecayModel) -> DecaySums:
    """The sums of one model; `decays` in units of the noise of each channel."""
    m = model.poles.size
    ch = len(decays[0])
    squares = 0.0
    amplitudes = np.zeros((len(decays), ch, m), dtype=np.complex128)
    inverse = np.zeros((len(decays), 2 * m, 2 * m))
    gradient = np.zeros((2, m))
    normal = np.zeros((ch, 2, m, 2, m))
    gain = np.zeros(m)
    for i, y in enumerate(decays):  # a few decays, each with its own length
        squares += float(np.einsum("cn,cn->", y, y))
        if not m:
            continue
        e = model.basis(i, y.shape[1], rate)
        time = np.arange(y.shape[1]) / rate
        both = np.stack([e.real, e.imag], axis=1).reshape(2 * m, -1)
        moved = both * time
        size = np.sqrt(np.einsum("un,un->u", both, both)) + np.finfo(np.float64).tiny
        gram = both @ both.T / np.outer(size, size)
        inverse[i] = np.linalg.pinv(gram, rcond=1e-13, hermitian=True) / np.outer(
            size, size
        )
        right = both @ y.T
        linear = inverse[i] @ right  # (2 m, ch)
        squares -= float(np.einsum("uc,uc->", right, linear))
        cross = moved @ both.T
        schur = moved @ moved.T - cross @ inverse[i] @ cross.T
        left = moved @ y.T - cross @ linear
        pairs = linear.reshape(m, 2, ch)
        amplitudes[i] = (pairs[:, 0] - 1j * pairs[:, 1]).T
        turned = np.stack([pairs[:, 1], -pairs[:, 0]], axis=1)
        # (part, m, 2, ch): of the derivatives in `moved`
        by = np.stack([pairs, turned])
        gradient += np.einsum("pkuc,kuc->pk", by, left.reshape(m, 2, ch))
        four = schur.reshape(m, 2, m, 2)
        half = np.einsum("kulv,qlvc->kuqlc", four, by)
        normal += np.einsum("pkuc,kuqlc->cpkql", by, half)
        own = inverse[i].reshape(m, 2, m, 2)[np.arange(m), :, np.arange(m)]
        gain += np.einsum("kuc,kuv,kvc->k", pairs, np.linalg.inv(own), pairs)
    return DecaySums(
        model=model,
        amplitudes=amplitudes,
        squares=squares,
        gradient=gradient.ravel(),
        normal=normal.reshape(ch, 2 * m, 2 * m),
        inverse=inverse,
        gain=gain,
    )


@dataclass(frozen=True, slots=True, eq=False)
class DecayFitState:
    """A state of the fit: its sums, the factor of Levenberg and Marquardt, and the last gain."""

    sums: DecaySums
    factor: float
    lowered: float


@dataclass(frozen=True, slots=True, eq=False)
class DecayFit:
    """Levenberg and Marquardt's method on the poles; a rule set for `iterate`.

    Attributes
    ----------
    decays : tuple of (ch, sample) float64
        In units of the noise of each channel.
    rate : float, Hz
    start : DecayModel
    """

    decays: Decays
    rate: float
    start: DecayModel

    def init(self) -> DecayFitState:
        """The start."""
        return DecayFitState(
            decay_sums(self.decays, self.rate, self.start), 1e-4, np.inf
        )

    def step(self, state: DecayFitState) -> DecayFitState:
        """The next poles; the old ones with a larger factor where the step does not help."""
        sums = state.sums
        m = sums.model.poles.size
        normal = sums.normal.sum(axis=0)
        size = _sizes(normal)
        scaled = normal / np.outer(size, size) + state.factor * np.eye(2 * m)
        move = np.linalg.solve(scaled, sums.gradient / size) / size
        poles = sums.model.poles + move[:m] + 1j * move[m:]
        longest = max(y.shape[1] for y in self.decays) / self.rate
        poles.real = np.minimum(poles.real, 1 / longest)  # no growth
        poles.imag = np.clip(poles.imag, 0.5 / longest, np.pi * self.rate)
        poles.real = np.maximum(poles.real, -poles.imag)
        tried = decay_sums(self.decays, self.rate, replace(sums.model, poles=poles))
        lowered = sums.squares - tried.squares
        if lowered >= 0:
            return DecayFitState(tried, max(state.factor / 10, 1e-12), lowered)
        if state.factor > 1e6:
            return DecayFitState(sums, state.factor, 0.0)
        return DecayFitState(sums, 10 * state.factor, np.inf)

    def terminate(self, state: DecayFitState) -> Outcome | None:
        """Converged when a step lowers the squares by less than their derivatives are rounded."""
        rounding = np.sqrt(np.finfo(np.float64).eps) * state.sums.squares
        return Outcome.CONVERGED if state.lowered <= rounding else None

    def merit(self, state: DecayFitState) -> float:
        """The sum of squares."""
        return state.sums.squares


def _sizes(normal: Float) -> Float:
    """(p,) roots of the diagonal of a normal matrix, none so small that it cannot be divided by."""
    diagonal = np.diag(normal)
    return np.asarray(
        np.sqrt(np.maximum(diagonal, 1e-12 * max(diagonal.max(initial=0.0), 1e-12)))
    )


def fit(
    decays: Decays, rate: float, start: DecayModel, *, limit: int = 60
) -> DecaySums:
    """The most likely poles from a start."""
    if not start.poles.size:
        return decay_sums(decays, rate, start)
    return iterate(DecayFit(decays, rate, start), limit=limit).last.sums


def left_over(
    decays: Decays, rate: float, sums: DecaySums, keep: int | None = None
) -> Decays:
    """What a fit leaves of the decays; with one pole `keep`, that one is left in."""
    amplitudes = sums.amplitudes.copy()
    if keep is not None:
        amplitudes[:, :, keep] = 0
    return tuple(
        y - (amplitudes[i] @ sums.model.basis(i, y.shape[1], rate)).real
        for i, y in enumerate(decays)
    )


@dataclass(frozen=True, slots=True, eq=False)
class DecayFloor:
    """Variance of the noise of channels over frequency, as white noise of that density has it.

    Attributes
    ----------
    freqs : (f,) float64, Hz
    variance : (ch, f) float64
    """

    freqs: Float
    variance: Float

    def at(self, frequencies: Float) -> Float:
        """(ch, m) at frequencies (m,), Hz."""
        return np.array([np.interp(frequencies, self.freqs, v) for v in self.variance])


def noise_floor(rest: Decays, rate: float, freqs: Float, gain: Float) -> DecayFloor:
    """The floor below what stands out of a rest (ch, sample), which is white but for a filter.

    The median over frequency: decays not yet found are few lines of it.

    Parameters
    ----------
    freqs, gain : (f,) float64, Hz and modulus
        Of the filter. Below a fifth of its passband the floor is kept level: what is there does
        not count.
    """
    passed = freqs[gain > 0.5]
    lines = min(y.shape[1] for y in rest) * (passed[-1] - passed[0]) / rate
    bins = int(np.clip(lines // 50, 1, 64))
    edges = np.linspace(passed[0], passed[-1], bins + 1)
    level = np.zeros((len(rest[0]), bins))
    for y in rest:  # a few decays
        n = y.shape[1]
        # keeps the skirts of what has not died away out of the other lines
        taper = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
        power = np.abs(rfft(y * taper, axis=1)) ** 2 / np.square(taper).sum()
        at = np.arange(power.shape[1]) * rate / y.shape[1]
        power /= np.maximum(np.interp(at, freqs, gain), 0.1) ** 2
        ends = np.searchsorted(at, edges)
        each = [
            np.median(power[:, i : max(j, i + 1)], axis=1)
            for i, j in pairwise(ends.tolist())
        ]
        # the median of an exponential distribution
        level += np.array(each).T / np.log(2) / len(rest)
    level = median_filter(level, (1, max(bins // 5, 1) | 1), mode="nearest")
    centres = 0.5 * (edges[1:] + edges[:-1])
    white = np.array([np.interp(freqs, centres, v) for v in level])
    white = np.maximum(white, np.finfo(np.float64).tiny)
    return DecayFloor(freqs, white * np.maximum(gain, 0.2) ** 2)


@dataclass(frozen=True, slots=True)
class DecayPeak:
    """Where one more decay lowers the squares most: its pole (rad/s), by how much, and by how much
    noise alone would do so rarely.
    """

    pole: complex
    gain: float
    critical: float


def strongest_decay(
    rest: Decays,
    rate: float,
    floor: DecayFloor,
    limits: tuple[float, float],
) -> DecayPeak:
    """The decay that a rest holds most likely: the generalised likelihood ratio over a grid.

    Parameters
    ----------
    rest : tuple of (ch, sample) float64
    floor : DecayFloor
    limits : (low, high), Hz
    """
    samples = max(y.shape[1] for y in rest)
    longest = samples / rate
    largest = DAMPING_MAX * 2 * np.pi * limits[1]
    count = max(int(np.log(max(largest * longest, 2.0)) / np.log(2.0)), 2)
    grid = np.geomspace(1 / longest, largest, count)
    best = DecayPeak(0j, 0.0, np.inf)
    single = [y.astype(np.float32) for y in rest]  # the scan is most of the work
    for sigma in grid.tolist():  # a transform each, the shorter the faster it decays
        reach = int(np.clip(8 * rate / sigma, 32, samples))
        n = int(next_fast_len(2 * reach, real=True))
        f = np.arange(n // 2 + 1) * rate / n
        total = np.zeros(f.size)
        # a cell is as wide as its decay is fast: it holds the mean of the floor over that width
        lag = np.minimum(np.arange(n), n - np.arange(n)) / rate
        variance = rfft(
            irfft(floor.at(f), n, axis=1) * np.exp(-sigma * lag), axis=1
        ).real
        for y in single:
            part = y[:, :reach]
            weight = np.exp(-sigma * np.arange(part.shape[1]) / rate).astype(np.float32)
            energy = float(weight @ weight)
            spectrum = rfft(part * weight, n, axis=1)
            total += (2 * np.abs(spectrum) ** 2 / (variance * energy)).sum(axis=0)
        total[
            (f < limits[0]) | (f > limits[1]) | (sigma > DAMPING_MAX * 2 * np.pi * f)
        ] = 0
        at = int(total.argmax())
        if total[at] > best.gain:
            best = DecayPeak(
                complex(-sigma, 2 * np.pi * f[at]), float(total[at]), np.inf
            )
    freedom = 2 * len(rest[0]) * len(rest)
    critical = float(chdtri(freedom, FALSE_ALARM / (count * samples)))
    return replace(best, critical=critical)


def covariance(sums: DecaySums, floor: DecayFloor) -> Float:
    """(2 m, 2 m) covariance of the real parts of the poles, then the imaginary ones.

    The inverse of the Fisher information where the noise is white; else what least squares make of
    noise of the floor's density at each pole.
    """
    normal = sums.normal.sum(axis=0)
    size = _sizes(normal)
    inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-13, hermitian=True)
    inverse = inverse / np.outer(size, size)
    deviation = np.sqrt(floor.at(sums.model.poles.imag / (2 * np.pi)))
    both = np.concatenate([deviation, deviation], axis=1)
    middle = np.einsum("cp,cpq,cq->pq", both, sums.normal, both)
    return np.asarray(inverse @ middle @ inverse)


def deviations(poles: Complex, covariance_: Float) -> Float:
    """(2 m, 2 m) covariance of the frequencies, Hz, then the damping ratios, of poles (m,)."""
    size = np.abs(poles)
    x, y = poles.real, poles.imag
    zero = np.zeros((poles.size, poles.size))
    by_x = np.diag(x / size / (2 * np.pi))
    by_y = np.diag(y / size / (2 * np.pi))
    z_x = np.diag(-(y**2) / size**3)
    z_y = np.diag(x * y / size**3)
    turn = np.block([[by_x, by_y], [z_x, z_y]]) if poles.size else zero
    return np.asarray(turn @ covariance_ @ turn.T)


def is_steady(model: DecayModel, longest: float) -> Bool:
    """(m,) whether a pole does not decay in the `longest` decay, s: a line."""
    return np.asarray(-model.poles.real * longest < 1.0)
