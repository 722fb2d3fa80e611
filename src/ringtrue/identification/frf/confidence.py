"""Confidence of candidate modes of FRFs: the evidence for and against each, with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Complex, Float
from ringtrue.identification.frf.lines import Lines
from ringtrue.identification.frf.refinement import Refined
from ringtrue.shapes.complexity import mpc
from ringtrue.shapes.mac import mac

SIGNIFICANT = 12.0  # gain over that of noise
# share of the orders and gain over the error that are no misfit of the FRFs
HELD = 0.8
PLAIN = 3e3
HIDDEN = 1e3  # gain over the error and MPC of a mode that may hide under others
REAL = 0.9  # near a node of the force
# standard deviations of a residue, below and above which its sign means nothing and all
TOLD = 1.0
SURE = 3.0
COMPLEX = 0.6  # confidence of a mode that is plain to see, but of complex shape
BESIDE = 1.25  # times the last line, up to where modes count in the fit
WHITE = 0.4  # correlation of errors at neighbouring lines, below which they are noise and no misfit
# half bandwidths on either side of a mode that tell, if they hold so many lines
AROUND = 2.0
LEAST_LINES = 12
VISIBLE = 0.3  # share of the response at its own frequency that makes a mode plain to see


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePoles:
    """Poles that stayed in place over the model orders.

    Attributes
    ----------
    pole : (c,) complex128, rad/s, without the exponential window
    participation : (c, in) complex128
    support : (c,) float64
        Share of the orders, from the first appearance on, that hold the pole.
    scatter : (c,) float64
        Over the orders, in half bandwidths.
    """

    pole: Complex
    participation: Complex
    support: Float
    scatter: Float

    def take(self, at: Any_) -> CandidatePoles:
        """The chosen candidates, in the given order."""
        return CandidatePoles(
            self.pole[at], self.participation[at], self.support[at], self.scatter[at]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Confidence and reason of each candidate.

    Attributes
    ----------
    frequency : (c,) float64, Hz
    confidence : (c,) float64, 0..1
    reason : tuple of str
    """

    frequency: Float
    confidence: Float
    reason: tuple[str, ...]

    def describe(self, k: int) -> str:
        """One line on a candidate."""
        return f"{self.frequency[k]:.4g} Hz: {self.reason[k]}"


@dataclass(frozen=True, slots=True, eq=False)
class _Aspect:
    factor: Float
    text: tuple[str, ...]  # empty where there is nothing to say


def assess_candidates(
    lines: Lines,
    fit: Refined,
    candidates: CandidatePoles,
    pairs: Sequence[tuple[int, int, float]],
    *,
    damping_max: float,
    strict: bool = True,
) -> Assessment:
    """Weigh each candidate.

    The confidence is the product of factors: stability over the orders, gain in the fit against the
    error left nearby, damping in range and known, place in the lines, not the double of a stronger
    mode, a real shape (MPC), and the sign of the driving-point residues.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    candidates : CandidatePoles
        In the order of `fit`.
    pairs : sequence of (output, input, sign)
        Driving points.
    damping_max : float
    strict : bool
        False while modes may still be missing: their neighbours then have complex shapes and odd
        phases.
    """
    shapes = fit.shapes
    # fall of the weighted sum of squares (σ = 1) by each mode with all others present
    total = (
        2 * np.abs(shapes) ** 2 / np.maximum(fit.known.state.shape_var, np.finfo(float).tiny)
    ).sum(axis=0)
    driven = _driven(fit, shapes, pairs, strict)
    near = _near(lines, fit)
    gains, ratio = _gains(fit, total, near)
    real = _real(shapes, lines.response, strict)
    share = shares(lines, fit, shapes)
    needed = _white(lines, fit) & (ratio > SIGNIFICANT * np.maximum(_together(lines, fit, near), 1))
    clear = (
        _clear(fit, shapes, lines)
        & (share > VISIBLE)
        & (gains.factor > 0.99)
        & (driven.factor > 0.99)
    )
    hidden = (candidates.support > HELD) & (ratio > HIDDEN) & (_mpc(shapes, lines.response) > REAL)
    aspects = [
        _stable(candidates, clear, needed),
        gains,
        _seen(np.where(hidden | needed, 1.0, share) if strict else np.ones_like(share)),
        _damped(fit, damping_max),
        _placed(lines, fit),
        _double(lines, fit, c=candidates, shapes=shapes, total=total, strict=strict),
        real,
        driven,
    ]
    confidence = np.prod([a.factor for a in aspects], axis=0)
    # complex shapes, as of rotors and local dampers, may be plain to see
    phase = real.factor * driven.factor
    plain = (candidates.support > HELD) & (ratio > PLAIN) & (phase < COMPLEX)
    confidence = np.where(plain, COMPLEX / phase, 1.0) * confidence
    reasons = tuple(
        "; ".join(a.text[k] for a in aspects if a.text[k]) for k in range(fit.poles.size)
    )
    return Assessment(np.abs(fit.poles) / (2 * np.pi), confidence, reasons)


def _texts(factor: Float, good: Sequence[str], bad: Sequence[str]) -> _Aspect:
    return _Aspect(
        factor, tuple(b if x < 0.9 else g for x, g, b in zip(factor, good, bad, strict=True))
    )


def _clear(fit: Refined, shapes: Complex, lines: Lines) -> Bool:
    """A real shape and a damping of the size of the others'."""
    zeta = -fit.poles.real / np.abs(fit.poles)
    return np.asarray((_mpc(shapes, lines.response) > REAL) & (zeta < 4 * np.median(zeta)))


def _mpc(shapes: Complex, weight: Float) -> Float:
    return mpc(shapes * weight[:, None]) if shapes.shape[0] > 2 else np.ones(shapes.shape[1])


def _white(lines: Lines, fit: Refined) -> Bool:
    """(m,) where the fit leaves nothing but noise, of lines that do not follow each other, and
    there are many.

    FRFs that disagree leave smooth errors there, which further poles would patch up.
    """
    rest = fit.known.rest
    along = (rest[:, 1:] * rest[:, :-1].conj()).real.sum(axis=(0, 2))
    power = (np.abs(rest) ** 2).sum(axis=(0, 2))
    far = np.abs(lines.s.imag[:, None] - fit.poles.imag)
    near = far < AROUND * np.abs(fit.poles.real)
    return np.asarray(
        (near.sum(axis=0) >= LEAST_LINES) & (along @ near[1:] < WHITE * (power @ near))
    )


def _stable(c: CandidatePoles, clear: Bool, needed: Bool) -> _Aspect:
    """Stability over the orders; a mode whose shape, gain and phase are beyond doubt may do
    without.

    So may one without which more than noise would be left: it hides under others.
    """
    factor = np.clip((c.support - 0.15) / 0.35, 0, 1) * np.clip(1.6 - c.scatter, 0.4, 1)
    factor = np.maximum(factor, np.where(needed, 0.9, np.where(clear, 0.7, 0.0)))
    text = [f"in {100 * s:.0f} % of the orders" for s in c.support]
    return _texts(
        factor,
        text,
        [
            f"{t} only, scatter {x:.2g} half bandwidths"
            for t, x in zip(text, c.scatter, strict=True)
        ],
    )


def _gains(fit: Refined, total: Float, near: Float) -> tuple[_Aspect, Float]:
    """Gain per real unknown over the squared error near the mode, weighted with its own magnitude;
    that ratio.
    """
    rest = 0.5 * (np.abs(fit.known.rest) ** 2).mean(axis=(0, 2))  # per real value
    ratio = total / (2 * fit.shapes.shape[0]) / np.maximum(near.T @ rest, 1e-300)
    factor = np.clip(np.log(np.maximum(ratio, 1e-9) / 2) / np.log(SIGNIFICANT / 2), 0, 1)
    text = [f"contribution {10 * np.log10(max(r, 1e-9)):.0f} dB over the error" for r in ratio]
    return _texts(factor, text, [f"weak, {t}" for t in text]), ratio


def _near(lines: Lines, fit: Refined) -> Float:
    """(freq, m) weights of the lines near each mode, that add up to 1."""
    near = np.abs(1 / (lines.s[:, None] - fit.poles)) ** 4
    return np.asarray(near / near.sum(axis=0))


def _together(lines: Lines, fit: Refined, near: Float) -> Float:
    """(m,) power of the error along each shape over that in the typical response, near the mode.

    1 where responses err independently; as many as there are responses where they move together, as
    in wind.
    """
    seen = fit.shapes * lines.response[:, None]
    seen = seen / np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    rest = fit.known.rest
    along = (near * (np.abs(rest @ seen.conj()) ** 2).mean(axis=0)).sum(axis=0)
    return np.asarray(along / np.maximum(near.T @ (np.abs(rest) ** 2).mean(axis=(0, 2)), 1e-300))


def _damped(fit: Refined, damping_max: float) -> _Aspect:
    zeta = -fit.poles.real / np.abs(fit.poles)
    doubt = fit.std_damping / np.maximum(zeta, 1e-9)
    factor = np.where((zeta > 1e-5) & (zeta < damping_max), 1.0, 0.0) * np.clip(1.4 - doubt, 0, 1)
    good = [f"damping {100 * z:.3g} %" for z in zeta]
    return _texts(
        factor,
        good,
        [
            f"{g} ± {100 * s:.2g} % out of range or unknown"
            for g, s in zip(good, fit.std_damping, strict=True)
        ],
    )


def _placed(lines: Lines, fit: Refined) -> _Aspect:
    """Modes just beyond the lines are no modes to report, but stand in the FRFs as no residual term
    does.
    """
    f = np.abs(fit.poles) / (2 * np.pi)
    low, high = lines.s.imag[[0, -1]] / (2 * np.pi)
    factor = np.where((f > low / BESIDE) & (f < BESIDE * high), 1.0, 0.0)
    return _texts(factor, [""] * f.size, ["outside the lines"] * f.size)


def shares(lines: Lines, fit: Refined, shapes: Complex) -> Float:
    """(m,) amplitude of each mode at its own frequency against the data there, rms over responses
    and inputs.
    """
    at = np.abs(lines.s.imag[:, None] - fit.poles.imag).argmin(axis=0)
    gain = np.abs(lines.weight[at] * lines.kind[at] / (lines.s[at] - fit.poles))
    psi = np.sqrt(((np.abs(shapes) * lines.response[:, None]) ** 2).mean(axis=0))
    part = np.sqrt((np.abs(fit.participation * lines.input) ** 2).mean(axis=1))
    data = np.sqrt((np.abs(lines.y[:, at] * lines.response) ** 2).mean(axis=(0, 2)))
    return np.asarray(gain * psi * part / np.maximum(data, 1e-300))


def _seen(share: Float) -> _Aspect:
    factor = np.clip((share - 0.02) / 0.1, 0, 1)
    text = [f"{100 * x:.0f} % of the response at its frequency" for x in share]
    return _texts(factor, [""] * share.size, [f"only {t}" for t in text])


def _double(
    lines: Lines, fit: Refined, c: CandidatePoles, shapes: Complex, total: Float, strict: bool
) -> _Aspect:
    """A weaker mode near a stronger one of the same shape and participation is its double.

    One that the orders do not show needs the same shape only: setups that disagree about a mode
    split it that way.
    """
    p = fit.poles
    width = np.maximum(np.abs(p.real)[:, None], np.abs(p.real)[None]) + np.median(
        np.diff(lines.s.imag)
    )
    close = np.abs(p[:, None] - p) / width
    similarity = mac(shapes, shapes) * mac(fit.participation.T, fit.participation.T)
    same = mac(shapes, shapes) if shapes.shape[0] > 4 else similarity
    similarity = np.where(
        (c.support < 0.4)[:, None] & strict,
        same,
        np.where((close < 1.0) & (same > 0.9), same, similarity),
    )
    stronger = total[None] > total[:, None]
    share = total[:, None] / np.maximum(total[None], 1e-300)
    bad = stronger & (
        ((close < 1.0) & (similarity > 0.8)) | ((close < 3.0) & (similarity > 0.9) & (share < 0.1))
    )
    which = np.where(bad.any(axis=1), np.argmax(bad, axis=1), -1)
    text = [
        f"doubles the mode at {abs(p[j]) / (2 * np.pi):.4g} Hz" if j >= 0 else "" for j in which
    ]
    return _texts(np.where(which >= 0, 0.1, 1.0), [""] * p.size, text)


def _real(shapes: Complex, weight: Float, strict: bool) -> _Aspect:
    value = _mpc(shapes, weight)
    factor = np.clip(0.25 + 0.85 * value if strict else 0.6 + 0.6 * value, 0, 1)
    text = [f"MPC {v:.3f}" for v in value]
    return _texts(factor, text, [f"{t}, a complex shape" for t in text])


def _driven(
    fit: Refined, shapes: Complex, pairs: Sequence[tuple[int, int, float]], strict: bool
) -> _Aspect:
    """Share of the driving-point residues, by size, that have the phase of a positive modal mass.

    It counts as far as their sum stands out of its noise: near a node of the force it means
    nothing.
    """
    n = fit.poles.size
    if not pairs:
        return _Aspect(np.ones(n), ("",) * n)
    o, i, sign = (np.array(x) for x in zip(*pairs, strict=True))
    part = fit.participation.T[i]
    residue = (shapes[o] * part * sign[:, None] * 1j).real
    phase = residue.sum(axis=0) / np.maximum(np.abs(shapes[o] * part).sum(axis=0), 1e-300)
    noise = (np.abs(part) ** 2 * (fit.known.state.shape_var * fit.known.own)[o]).sum(axis=0) / 2
    score = np.abs(residue.sum(axis=0)) / np.sqrt(np.maximum(noise, 1e-300))
    doubt = np.clip((score - TOLD) / (SURE - TOLD), 0, 1) * (
        1 - np.clip(0.7 + 0.6 * phase, 0.2 if strict else 0.6, 1)
    )
    return _texts(
        1 - doubt,
        [f"driving points in phase{'' if p > 0 else ' within their noise'}" for p in phase],
        [f"driving-point phase {p:.2f}, 1 is a positive mass" for p in phase],
    )
