"""Frequency and damping of one mode against its amplitude, from a free decay.

The envelope a and the phase of the mode alone, in its own narrow band, obey
d ln a/dt = -2π f ζ(a) and dφ/dt = 2π f(a). With ζ and f polynomials in the amplitude, the phase and
the logarithm of the envelope are linear in the coefficients, by the integrals of the powers of a
over time: weighted least squares, not derivatives of noisy signals (Feldman 1994 takes these).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import ClassVar

import numpy as np
from numpy.polynomial import polynomial
from scipy.fft import fft, ifft, next_fast_len
from scipy.special import chdtri

from ringtrue.core.arrays import Complex, Float, Int, freeze_arrays
from ringtrue.core.display import Displayed
from ringtrue.core.signals import FALSE_ALARM


@dataclass(frozen=True, slots=True, eq=False)
class Backbone(Displayed):
    """Frequency and damping ratio of a mode against its amplitude.

    Attributes
    ----------
    amplitude : (point,) float64
        Of the channel in which the mode is largest, in its unit.
    frequency : (point,) float64, Hz
    damping : (point,) float64
        Both measured, over one width of the mode's band each.
    fit_amplitude : (k,) float64
        Where the polynomials are drawn, over the range of the amplitudes.
    frequency_terms : (p,) float64, Hz
        Coefficients of the powers of amplitude / `reference`, from the 0th.
    damping_terms : (p,) float64
    std_frequency_terms, std_damping_terms : (p,) float64
    reference : float
        The largest amplitude.
    impact : (point,) int64
        Which decay each point is of.
    """

    UNITS: ClassVar[dict[str, str]] = {"frequency": "Hz", "damping": "-"}

    amplitude: Float
    frequency: Float
    damping: Float
    fit_amplitude: Float
    frequency_terms: Float
    damping_terms: Float
    std_frequency_terms: Float
    std_damping_terms: Float
    reference: float
    impact: Int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def nonlinear(self) -> bool:
        """Whether frequency or damping depends on the amplitude."""
        return self.frequency_terms.size > 1

    @property
    def fit_frequency(self) -> Float:
        """The polynomial at `fit_amplitude`, (k,) float64, Hz."""
        return np.asarray(
            polynomial.polyval(
                self.fit_amplitude / self.reference, self.frequency_terms
            )
        )

    @property
    def fit_damping(self) -> Float:
        """The polynomial at `fit_amplitude`, (k,) float64."""
        return np.asarray(
            polynomial.polyval(self.fit_amplitude / self.reference, self.damping_terms)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """One mode over one decay, slow: its analytic signal times e^{-iωt}.

    Attributes
    ----------
    signal : (sample,) complex128
        In the unit of the channel in which the mode is largest; its carrier is taken off.
    noise : float
        Standard deviation of its real part.
    step : int
        Samples from which on two are independent.
    begin, end : int
        Samples between which it can be used.
    """

    signal: Complex
    noise: float
    step: int
    begin: int
    end: int


def envelope(
    y: Float, shape: Complex, variance: Float, basis: Complex, width: float
) -> Envelope:
    """The envelope of a mode in a decay `y` (ch, sample) of nothing but it and noise.

    What changes slowly is its ratio to the `basis`, which is smoothed: a decay that is already
    known is not bent by it.

    Parameters
    ----------
    shape : (ch,) complex128
        In the units of `y` of an amplitude 1.
    variance : (ch,) float64
        Of the noise, as white noise of its density at the mode has it.
    basis : (sample,) complex128
        The mode as it is known, of any amplitude.
    width : float
        Half width of the band, cycles a sample.
    """
    weight = shape.conj() / variance
    one = (weight / (weight @ shape)) @ y
    size = np.maximum(np.abs(basis), 1e-100)
    turn = basis / size
    # a Gaussian has no sidelobes: it is forgotten after four of its widths
    n = int(next_fast_len(2 * one.size))
    window = np.exp(-0.5 * (np.fft.fftfreq(n) / width) ** 2)
    both = ifft(fft(np.stack([one * turn.conj(), size]), n, axis=1) * window, axis=1)
    smooth = both[:, : one.size]
    signal = 2 * smooth[0] / np.maximum(smooth[1].real, 1e-100) * size * turn
    ratio = float((np.abs(weight) ** 2 * variance).sum() / np.abs(weight @ shape) ** 2)
    noise = np.sqrt(2 * ratio * width * np.sqrt(np.pi))
    reach = int(np.ceil(0.6 / width))
    loud = np.flatnonzero(np.abs(signal) < 5 * noise)
    end = int(loud[loud > reach].min(initial=one.size - reach))
    step = max(int(0.5 / width), 1)
    return Envelope(signal, float(noise), step, reach, min(end, one.size - reach))


def fit_backbone(
    parts: list[Envelope],
    pole: complex,
    rate: float,
    degree: int | None = None,
) -> tuple[Backbone, list[Complex]] | None:
    """The backbone from the envelopes of a mode, and the slow factor that each decay has over
    e^{λt} from it; None where no decay shows it long enough.

    The degree is the lowest that explains the data: a higher one must lower the sum of squares as
    noise rarely does, and odd and even ones are tried; or as given.
    """
    used = [k for k, e in enumerate(parts) if e.end - e.begin > 6 * e.step]
    if not used:
        return None
    at = [np.arange(parts[k].begin, parts[k].end, parts[k].step) for k in used]
    size = [np.abs(parts[k].signal) for k in used]
    reference = max(float(a[t].max()) for a, t in zip(size, at, strict=True))
    values = [np.log(parts[k].signal[t]) for k, t in zip(used, at, strict=True)]
    values = [v.real + 1j * np.unwrap(v.imag) for v in values]
    weights = [a[t] / parts[k].noise for a, t, k in zip(size, at, used, strict=True)]
    y = np.concatenate([v * w for v, w in zip(values, weights, strict=True)])
    best = None
    smooth = [
        _smooth(values[i], weights[i], at[i], parts[k]) for i, k in enumerate(used)
    ]
    for d in count() if degree is None else (degree,):
        if (
            best is not None and d > best[1] + 2
        ):  # odd and even degrees lower it no more
            break
        columns = []
        for i, k in enumerate(used):
            power = (smooth[i] / reference)[:, None] ** np.arange(d + 1)
            integral = (np.cumsum(power, axis=0) - 0.5 * power) / rate
            offset = np.zeros((at[i].size, len(used)))
            offset[:, i] = 1
            begin = parts[k].begin
            both = np.concatenate([integral[at[i] - begin], offset], axis=1)
            columns.append(both * weights[i][:, None])
        a = np.concatenate(columns)
        inverse = np.linalg.pinv(a.T @ a, hermitian=True)
        linear = inverse @ (a.T @ y)
        squares = float((np.abs(y - a @ linear) ** 2).sum())
        if best is None or best[0] - squares > chdtri(
            2 * max(d - best[1], 1), FALSE_ALARM
        ):
            best = (squares, d, linear, inverse)
    assert best is not None
    squares, d, linear, inverse = best
    freedom = max(2 * y.size - 2 * linear.size, 1)
    spread = max(squares / freedom, 1.0)
    terms = linear[: d + 1]
    deviation = np.sqrt(np.diag(inverse)[: d + 1] * spread)
    carrier = pole.imag / (2 * np.pi)
    f_terms = terms.imag / (2 * np.pi)
    f_terms[0] += carrier
    omega = abs(pole)
    points_a, points_f, points_z, points_i = [], [], [], []
    for i, k in enumerate(used):
        slope = np.diff(values[i]) / np.diff(at[i]) * rate
        points_a.append(np.exp(0.5 * (values[i][1:].real + values[i][:-1].real)))
        points_f.append(carrier + slope.imag / (2 * np.pi))
        points_z.append(-slope.real / omega)
        points_i.append(np.full(slope.size, k))
    amplitudes = np.concatenate(points_a)
    found = Backbone(
        amplitude=amplitudes,
        frequency=np.concatenate(points_f),
        damping=np.concatenate(points_z),
        fit_amplitude=np.linspace(float(amplitudes.min()), float(amplitudes.max()), 50),
        frequency_terms=f_terms,
        damping_terms=-terms.real / omega,
        std_frequency_terms=deviation / (2 * np.pi),
        std_damping_terms=deviation / omega,
        reference=reference,
        impact=np.concatenate(points_i),
    )
    middle = float(np.median(amplitudes)) / reference
    known = {k: smooth[i] / reference for i, k in enumerate(used)}
    return found, _factors(parts, known, terms / rate, middle)


def _smooth(values: Complex, weights: Float, at: Int, part: Envelope) -> Float:
    """Amplitude (sample,) from `begin` to `end`, a smooth curve through that of the points."""
    time = (at - at[0]) / max(at[-1] - at[0], 1)
    degree = int(min(5, at.size // 3))
    curve = np.polynomial.Polynomial.fit(
        time, values.real, degree, w=weights, domain=[0, 1]
    )
    inside = np.arange(part.begin, part.end)
    return np.asarray(np.exp(curve((inside - at[0]) / max(at[-1] - at[0], 1))))


def _factors(
    parts: list[Envelope], smooth: dict[int, Float], terms: Complex, middle: float
) -> list[Complex]:
    """(sample,) factors e^{∫ Σ c_p (a^p − m^p) dt} over p > 0: 1 at the `middle` amplitude m.

    `terms` c_p per sample. Before the first known amplitude its equation is integrated backwards;
    behind the last one it stays.
    """
    out = []
    powers = np.arange(1, terms.size)
    for k, part in enumerate(parts):
        if k not in smooth:
            out.append(np.ones(part.signal.size, dtype=np.complex128))
            continue
        before = _before(float(smooth[k][0]), terms.real, part.begin)
        after = np.full(part.signal.size - part.end, smooth[k][-1])
        known = np.concatenate([before, smooth[k], after])
        slow = (known[:, None] ** powers - middle**powers) @ terms[1:]
        total = np.cumsum(slow) - 0.5 * slow
        total -= total[0]
        # finite, whatever came
        out.append(np.exp(np.clip(total.real, -100, 30) + 1j * total.imag))
    return out


def _before(first: float, terms: Float, samples: int) -> Float:
    """(sample,) amplitudes ahead of a `first` one, by d ln a/dt = Σ c_p a^p."""
    back = np.arange(samples, 0, -1)
    rate = float(first ** np.arange(terms.size) @ terms)
    track = np.log(first) - rate * back
    for _ in range(4):  # Picard's iteration: the rate changes little
        power = np.exp(np.minimum(track, np.log(first) + 1.5))[:, None] ** np.arange(
            terms.size
        )
        slope = power @ terms
        track = np.log(first) - np.cumsum(slope[::-1])[::-1]
    return np.asarray(np.exp(np.minimum(track, np.log(first) + 1.5)))
