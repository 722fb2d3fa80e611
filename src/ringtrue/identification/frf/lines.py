"""Weighted FRF lines: residual terms projected out, functions of the poles, fewer lines.

H1 = G_xf/G_ff of blocks of noise of length T under a window w(t): the cross-spectrum is that of
R_xf(τ) r(τ), with r the autocorrelation of w over its value at 0 (Bendat, Piersol, Random Data,
2010, 11.5). So each mode is λ^p e^{λτ} r(τ): a fit by poles takes the fading for damping, by 1.3/n²
with n lines in the half-power bandwidth.

Away from all poles the functions 1/(s − λ) are polynomials to many digits. With the weights of its
lines a stretch has orthogonal polynomials, and the zeros of one of them are the nodes at which
fewer lines stand for it: products of functions with each other and with the data are those of all
lines (Golub, Welsch 1969, Calculation of Gauss quadrature rules).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.channels import POWER
from ringtrue.core.signals import FrfSet, Impacts
from ringtrue.errors import InputError


def cmif(data: Complex) -> Float:
    """Complex mode indicator function: singular values (freq, in), descending, of `data` (freq,
    out, in).
    """
    gram = data.conj().transpose(0, 2, 1) @ data
    values = np.linalg.eigvalsh(gram)[:, ::-1]
    return np.asarray(np.sqrt(np.maximum(values, 0)))


def count_peaks(curve: Float) -> Int:
    """Positions of the peaks of the first two singular values that stand 2 dB above their
    surroundings.
    """
    from scipy.signal import find_peaks  # slow to import, and few commands need it

    level = 20 * np.log10(np.maximum(curve[:, :2], curve.max() * 1e-9))
    kernel = np.ones(3) / 3
    found = [
        find_peaks(np.convolve(c, kernel, "same"), prominence=2.0)[0] for c in level.T
    ]
    return np.concatenate(found).astype(np.int64)


NODES = 12  # that stand for the lines of a stretch


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """A separable model of the standard deviation of the FRFs: σ(f, o, i) = line(f) · response(o) ·
    input(i).

    Attributes
    ----------
    line : (freq,) float64
    response : (out,) float64
        Geometric mean 1.
    input : (in,) float64
        Geometric mean 1.
    """

    line: Float
    response: Float
    input: Float


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Weighted data with the residual terms of each input projected out.

    Attributes
    ----------
    s : (freq,) complex128, rad/s
    y : (in, freq, out) complex128
        Weighted data, without its part in the span of the residual terms.
    power : (out,) float64
        Sum of the squares of `y`.
    weight : (freq,) float64
    terms : (freq, t) complex128
        Orthonormal basis of the weighted residual terms, without `smooth`.
    smooth : (freq, n) float64
        Orthonormal basis of the weighted polynomials that count as residual terms too
        (`smooth_rest`).
    response : (out,) float64
        Weight of each response, not in `y`.
    input : (in,) float64
        Weight of each input, in `y`; a participation vector times it belongs to `y`.
    order : int
        p of the s^p that turns receptance into the kind of the data.
    kept : float, s
        Length of response behind the FRFs, `FrfSet.kept`.
    hann : float, s
        `FrfSet.hann`.
    impacts : Impacts, optional
        `FrfSet.impacts`.
    """

    s: Complex
    y: Complex
    power: Float
    weight: Float
    terms: Complex
    smooth: Float
    response: Float
    input: Float
    order: int
    kept: float
    hann: float
    impacts: Impacts | None

    @property
    def kind(self) -> Complex:
        """(freq,) s^p."""
        return np.asarray(self.s**self.order, dtype=np.complex128)


def prepare(frfs: FrfSet, sigma: Noise, smooth: int = 0) -> Lines:
    """Weight the data and project out the lower and upper residuals, and so many `smooth` terms.

    An exponential window e^{-σt} on force and response moves the FRF from s to s + σ, poles, s² of
    the accelerance and all: so the fit is done at s = iω + σ, and the poles come out without the
    window. The end of the block cuts the response of each mode off (`resonances`).
    """
    s = np.asarray(2j * np.pi * frfs.freqs + frfs.window_decay, dtype=np.complex128)
    if (frfs.freqs <= 0).any():
        raise InputError(
            "the line at 0 Hz has no place in a fit of modes: leave it out"
        )
    order = POWER[frfs.kind]
    kind = np.asarray(s**order, dtype=np.complex128)
    weight = 1 / sigma.line
    given = 1 / sigma.input
    t = kind[:, None] * np.stack(
        [(s[0] / s) ** 2, np.ones(s.size), (s / s[-1]) ** 2], axis=1
    )
    # λ^p for s^p: what is cut off, or faded, leaves a polynomial
    if np.isfinite(frfs.kept) or frfs.hann:
        t = np.concatenate([t, (kind * s[0] / s)[:, None]], axis=1)
    flat = np.linalg.qr(weight[:, None] * polynomials(s.imag, smooth))[0]
    weighted = weight[:, None] * t
    residual = without(flat, weighted)
    new = np.linalg.norm(residual, axis=0) > 1e-6 * np.linalg.norm(weighted, axis=0)
    terms = np.linalg.qr(residual[:, new])[0]
    data = weight[:, None] * given[:, None, None] * frfs.data.transpose(2, 0, 1)
    y = without(terms, without(flat, data))
    power = np.einsum("ifo,ifo->o", y.real, y.real) + np.einsum(
        "ifo,ifo->o", y.imag, y.imag
    )
    return Lines(
        s=s,
        y=y,
        power=power,
        weight=weight,
        terms=terms,
        smooth=flat,
        response=1 / sigma.response,
        input=given,
        order=order,
        kept=frfs.kept,
        hann=frfs.hann,
        impacts=frfs.impacts,
    )


def polynomials(x: Float, count: int) -> Float:
    """(freq, count) Legendre polynomials of the lines `x`, by their degree."""
    place = 2 * (x - x[0]) / (x[-1] - x[0]) - 1
    return np.polynomial.legendre.legvander(place, count)[:, :count]


def smooth_rest(lines: Lines, poles: Complex, rest: Complex) -> Float:
    """(freq, t) orthonormal basis of the polynomials that stand out of what a fit leaves, `rest`
    (in, freq, out).

    Noise on the force of an impact is as short as the pulse, and so multiplies the FRFs by a smooth
    function of the frequency: that moves no pole, but (1 + ε(s)) ψ/(s − λ) leaves a smooth
    remainder besides ψ (1 + ε(λ))/(s − λ). So do modes outside the band and short delays. No term
    is narrower than the typical mode.
    """
    width = 2 * float(np.median(np.abs(poles.real)))
    most = int(min(48, np.ptp(lines.s.imag) / width, rest.shape[1] / 16))
    basis = np.linalg.qr(lines.weight[:, None] * polynomials(lines.s.imag, most))[0]
    power = 2 * ((basis.T @ np.ascontiguousarray(rest).view(np.float64)) ** 2).mean(
        axis=(0, 2)
    )
    out = np.flatnonzero(power > 5.0 * (np.abs(rest) ** 2).mean())
    return basis[:, : out.max(initial=-1) + 1]


def without(basis: Any_, y: Complex) -> Complex:
    """(..., freq, n) the part of `y` outside the span of an orthonormal basis (freq, t)."""
    if not basis.shape[1]:
        return y
    parts = y if np.iscomplexobj(basis) else np.ascontiguousarray(y).view(np.float64)
    inside = basis @ (basis.conj().T @ parts)
    # new memory costs as much again
    return np.subtract(parts, inside, out=inside).view(np.complex128)


def resonances(lines: Lines, poles: Complex) -> tuple[Complex, Complex]:
    """(freq, m) s^p/(s − λ) of a response that the block cuts off after τ, and its derivatives by
    λ.

    The rest of the response, λ^p e^{λt} from τ on, is missing: λ^p e^{(λ−s)τ}/(s − λ). Of blocks
    under a Hann window what that takes of the response is missing (`faded`).
    """
    far = 1 / (lines.s[:, None] - poles)
    kind = lines.kind[:, None]
    if lines.hann:
        share, slope = faded(lines.s, poles, lines.hann)
        tail = poles**lines.order * share
        tail_slope = tail * lines.order / poles + poles**lines.order * slope
    elif np.isfinite(lines.kept):
        tail = poles**lines.order * np.exp((poles - lines.s[:, None]) * lines.kept)
        tail_slope = tail * (lines.order / poles + lines.kept)
    else:
        value = kind * far
        return value, value * far
    value = (kind - tail) * far
    return value, (value - tail_slope) * far


def functions(lines: Lines, poles: Complex) -> Complex:
    """Weighted `resonances` of the poles and of the conjugate ones, (freq, 2 m), residual terms
    projected out.
    """
    return _beside_terms(
        lines, lines.weight[:, None] * resonances(lines, augment(poles))[0]
    )


def functions_slopes(lines: Lines, poles: Complex) -> tuple[Complex, Complex]:
    """`functions` and their derivatives by the poles."""
    value, slope = resonances(lines, augment(poles))
    weight = lines.weight[:, None]
    return _beside_terms(lines, weight * value), _beside_terms(lines, weight * slope)


def _beside_terms(lines: Lines, y: Complex) -> Complex:
    return without(lines.terms, without(lines.smooth, y))


def mirrored(a: Complex) -> Complex:
    """Add what the negative frequencies contribute to products with augmented vectors [x, conj x]
    (both axes).
    """
    n = a.shape[-1] // 2
    return a + np.roll(np.roll(a.conj(), n, axis=-1), n, axis=-2)


def mirrored_rows(a: Complex) -> Complex:
    """The same for products with the data: an array (..., 2 m, out) and its partner from the
    conjugate data.
    """
    return a + np.roll(a.conj(), a.shape[-2] // 2, axis=-2)


def augment(x: Complex) -> Complex:
    """[x, conj x] along the first axis."""
    return np.concatenate([x, x.conj()], axis=0)


def faded(s: Complex, poles: Complex, length: float) -> tuple[Complex, Complex]:
    """(freq, m) what the Hann window takes of 1 = (s − λ) ∫ e^{(λ−s)τ} dτ, and its derivatives by
    λ.

    r(x) = (1 − x)(2 + cos 2πx)/3 + sin(2πx)/(2π) on 0 ≤ x = τ/T ≤ 1.

    Parameters
    ----------
    s : (freq,) complex128, rad/s
    poles : (m,) complex128, rad/s
    length : float, s
        T.
    """
    turn = 2j * np.pi
    a = (poles - s[:, None]) * length
    growth = np.expm1(a)  # of e^a, the same for a ± 2πi
    value = np.zeros_like(a)
    slope = np.zeros_like(a)
    for x, share in ((a, 2 / 3), (a + turn, 1 / 6), (a - turn, 1 / 6)):
        ramp = (growth - x) / x**2  # ∫ (1 − x) e^{ax} dx over 0..1
        value += share * ramp
        slope += share * (growth / x**2 - 2 * ramp / x)
    for x, sign in ((a + turn, 1.0), (a - turn, -1.0)):
        wave = growth / x  # ∫ e^{ax} dx over 0..1
        value += sign * wave / (2 * turn)
        slope += sign * (growth + 1 - wave) / x / (2 * turn)
    return 1 + a * value, length * (value + a * slope)


def condensed(lines: Lines, poles: Complex, reach: Float) -> Lines:
    """The lines for fits of poles within `reach` of these; `power` stays that of all lines.

    Parameters
    ----------
    lines : Lines
    poles : (m,) complex128, rad/s
    reach : (m,) float64, rad/s

    Returns
    -------
    Lines
        The same ones where they are few, or hold a response that the block cuts off, or its window:
        that ripples from line to line.
    """
    if np.isfinite(lines.kept) or lines.hann:
        return lines
    x = lines.s.imag
    stretches = [
        (a, b, b - a > NODES) for a, b in _stretches(x, _room(lines, poles, reach))
    ]
    if sum(NODES if long else b - a for a, b, long in stretches) > 0.8 * x.size:
        return lines
    parts = []
    for a, b, long in stretches:
        if long:
            parts.append(_nodes(lines, a, b))
            continue
        at = slice(a, b)
        own = lines.y[:, at]
        parts.append(
            (lines.s[at], lines.weight[at], own, lines.terms[at], lines.smooth[at])
        )
    s, weight, y, terms, smooth = zip(*parts, strict=True)
    return replace(
        lines,
        s=np.concatenate(s),
        weight=np.concatenate(weight),
        y=np.concatenate(y, axis=1),
        terms=np.concatenate(terms),
        smooth=np.concatenate(smooth),
    )


def _room(lines: Lines, poles: Complex, reach: Float) -> Float:
    """(freq,) length of the longest stretch, rad/s, that each line may be in."""
    x = lines.s.imag
    decay = float(lines.s[0].real)
    far = np.abs(lines.s)  # conjugate poles and residual terms: no nearer than 0 Hz
    # (freq, pole) arrays are slower
    for pole, r in zip(poles.tolist(), reach.tolist(), strict=True):
        far = np.minimum(
            far, np.sqrt((x - pole.imag) ** 2 + (decay - pole.real) ** 2) - r
        )
    # the functions are right to (2 + √3)^-NODES in stretches twice as long as that
    room = 2.0 * far
    if n := lines.smooth.shape[1]:  # of the polynomial of the highest degree
        place = 2 * (x - x[0]) / np.ptp(x) - 1
        wavelength = (
            np.pi * np.ptp(x) * (np.sqrt(np.maximum(1 - place**2, 0)) + 1 / n) / n
        )
        room = np.minimum(room, wavelength)
    return room


def _stretches(x: Float, room: Float) -> Iterator[tuple[int, int]]:
    """First line and end of stretches, each as long as the `room` of all its lines allows."""
    start = 0
    while start < x.size:
        end = int(np.searchsorted(x, x[start] + room[start], side="right"))
        fits = x[start:end] - x[start] <= np.minimum.accumulate(room[start:end])
        length = max(int(fits.argmin()) if not fits.all() else fits.size, 1)
        yield start, start + length
        start += length


def _nodes(
    lines: Lines, a: int, b: int
) -> tuple[Complex, Float, Complex, Complex, Float]:
    """Places and weights of the nodes, and the data and residual terms there."""
    x = lines.s.imag[a:b]
    weight = lines.weight[a:b]
    middle = 0.5 * (x[0] + x[-1])
    half = 0.5 * (x[-1] - x[0])
    place = (x - middle) / half
    legendre = np.polynomial.legendre.legvander(place, NODES - 1)
    orthogonal = np.linalg.qr(weight[:, None] * legendre)[0]
    nodes, turn = np.linalg.eigh(orthogonal.T @ (place[:, None] * orthogonal))
    basis = orthogonal @ turn
    basis *= np.sign(weight @ basis)
    parts = np.ascontiguousarray(lines.y[:, a:b]).view(np.float64)
    y = (basis.T @ parts).view(np.complex128)
    s = lines.s[0].real + 1j * (middle + half * nodes)
    return s, weight @ basis, y, basis.T @ lines.terms[a:b], basis.T @ lines.smooth[a:b]
