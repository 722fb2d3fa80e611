"""Confidence of candidate modes of FRFs: the evidence for and against each, with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Complex, Float
from ringtrue.core.modes import ModeClass, ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note
from ringtrue.identification.frf.lines import Lines
from ringtrue.identification.frf.refinement import Refined
from ringtrue.shapes import mac, mpc


@dataclass(frozen=True, slots=True)
class EvidenceLimits:
    """What counts as evidence for a mode of FRFs.

    Attributes
    ----------
    gain : float
        Gain in the fit over that of noise, from which on a mode is significant.
    visible : float
        Share of the response at its own frequency that makes a mode plain to see.
    real : float
        MPC of a shape that is real.
    white : float
        Correlation of the errors at neighbouring lines, below which they are noise.
    around : float
        Half bandwidths on each side of a mode in which these errors are looked at.
    lines : int
        Least number of lines there.
    double : float
        MAC above which a weaker mode is the double of a stronger one near it.
    doubtful : float
        Confidence above which a candidate that is no mode is listed as doubtful.
    same : float
        MAC above which two candidates within half a bandwidth are the same.
    """

    gain: float = 12.0
    visible: float = 0.3
    real: float = 0.9
    white: float = 0.4
    around: float = 2.0
    lines: int = 12
    double: float = 0.9
    doubtful: float = 0.1
    same: float = 0.8


LIMITS = EvidenceLimits()


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

    def at(self, fit: Refined) -> CandidatePoles:
        """The candidates where their fit has them."""
        return replace(self, pole=fit.poles, participation=fit.participation)

    def joined(self, more: CandidatePoles) -> CandidatePoles:
        """With more candidates."""
        return CandidatePoles(
            np.concatenate([self.pole, more.pole]),
            np.concatenate([self.participation, more.participation]),
            np.concatenate([self.support, more.support]),
            np.concatenate([self.scatter, more.scatter]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Confidence and reason of each candidate.

    Attributes
    ----------
    frequency : (c,) float64, Hz
    confidence : (c,) float64, 0..1
    reason : tuple of str
    doubt : tuple of str
        Code of a note: the aspect that speaks most against it.
    """

    frequency: Float
    confidence: Float
    reason: tuple[str, ...]
    doubt: tuple[str, ...]

    def describe(self, k: int) -> str:
        """One line on a candidate."""
        return f"{self.frequency[k]:.4g} Hz: {self.reason[k]}"


@dataclass(frozen=True, slots=True, eq=False)
class _Aspect:
    """A factor of the confidence and a text, each (c,); empty where there is nothing to say."""

    factor: Float
    text: tuple[str, ...]


def assess_candidates(
    lines: Lines,
    fit: Refined,
    candidates: CandidatePoles,
    *,
    damping_max: float,
    strict: bool = True,
) -> Assessment:
    """Weigh each candidate.

    The confidence is the product of factors: stability over the orders, gain in the fit against the
    error left nearby, share of the response, damping in range and known, and not the double of a
    stronger mode.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    candidates : CandidatePoles
        In the order of `fit`.
    damping_max : float
    strict : bool
        False while modes may still be missing, whose response the others then seem to lack.
    """
    shapes = fit.shapes
    # fall of the weighted sum of squares (σ = 1) by each mode with all others present
    variance = np.maximum(fit.known.state.shape_var, np.finfo(float).tiny)
    total = (2 * np.abs(shapes) ** 2 / variance).sum(axis=0)
    near = np.abs(1 / (lines.s[:, None] - fit.poles)) ** 4
    near = near / near.sum(axis=0)
    zeta = fit.damping
    collinear = np.ones(shapes.shape[1])
    if shapes.shape[0] > 2:
        collinear = mpc(shapes * lines.response[:, None])
    gains, ratio = _gains(fit, total, near)
    share = shares(lines, fit)
    needed = _noise_left(lines, fit) & (
        ratio > LIMITS.gain * np.maximum(_shared_error(lines, fit, near), 1)
    )
    clear = (collinear > LIMITS.real) & (zeta < 4 * np.median(zeta))
    clear &= (share > LIMITS.visible) & (gains.factor > 0.99)
    seen = np.where(needed | (not strict), 1.0, share)
    faint = [f"only {100 * x:.0f} % of the response at its frequency" for x in seen]
    aspects = {
        "pole orders": _stable(candidates, clear, needed),
        "pole gain": gains,
        "pole share": _aspect(
            np.clip((seen - 0.02) / 0.1, 0, 1), [""] * seen.size, faint
        ),
        "pole damping": _damped(fit, zeta, damping_max),
        "pole double": _double(lines, fit, candidates, total, strict=strict),
    }
    factors = np.array([a.factor for a in aspects.values()])
    codes = list(aspects)
    reasons = []
    for k in range(fit.poles.size):
        texts = [a.text[k] for a in aspects.values()]
        reasons.append("; ".join([*filter(None, texts), f"MPC {collinear[k]:.3f}"]))
    return Assessment(
        fit.frequencies,
        factors.prod(axis=0),
        tuple(reasons),
        tuple(codes[worst] for worst in factors.argmin(axis=0).tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DroppedPole:
    """A candidate as it was when the fit went on without it.

    Attributes
    ----------
    pole : complex, rad/s
    participation : (in,) complex128
    shape : (out,) complex128, largest component 1
    std_frequency : float, Hz
    std_damping : float
    confidence : float
    alone : bool
        No candidate that was kept is within its half bandwidth.
    note : Note
        The evidence.
    """

    pole: complex
    participation: Complex
    shape: Complex
    std_frequency: float
    std_damping: float
    confidence: float
    alone: bool
    note: Note

    @property
    def frequency(self) -> float:
        """Hz."""
        return abs(self.pole) / (2 * np.pi)

    @property
    def damping(self) -> float:
        """Fraction of critical."""
        return -self.pole.real / abs(self.pole)


def dropped(fit: Refined, assessment: Assessment, k: int, keep: Bool) -> DroppedPole:
    """A candidate of a fit, from 0, of which those of `keep` (c,) stay."""
    far = np.abs(fit.frequencies[keep] - fit.frequencies[k])
    frequency = float(fit.frequencies[k])
    why = {"why": assessment.reason[k]}
    shape = fit.shapes[:, k]
    return DroppedPole(
        pole=complex(fit.poles[k]),
        participation=fit.participation[k],
        shape=shape / shape[np.abs(shape).argmax()],
        std_frequency=float(fit.std_frequency[k]),
        std_damping=float(fit.std_damping[k]),
        confidence=float(assessment.confidence[k]),
        alone=bool((far >= fit.damping[k] * frequency).all()),
        note=Note(assessment.doubt[k], "warning", f"{frequency:.5g} Hz", why),
    )


def doubtful_candidates(
    candidates: Sequence[DroppedPole],
    frequencies: Float,
    shapes: Complex,
    band: tuple[float, float],
) -> list[DroppedPole]:
    """Candidates with some evidence for them that are none of the modes, each once, ascending.

    Parameters
    ----------
    candidates : sequence of DroppedPole
        Of all turns of the fit.
    frequencies, shapes : (m,) float64, Hz; (out, m) complex128
        Of the modes.
    band : (float, float), Hz
        What is reported.
    """
    known = list(zip(frequencies.tolist(), shapes.T, strict=True))
    kept: list[DroppedPole] = []
    for c in sorted(candidates, key=lambda x: -x.confidence):
        inside = band[0] <= c.frequency <= band[1]
        if c.confidence < LIMITS.doubtful or not inside:
            continue
        near = [
            shape
            for f, shape in known
            if abs(f - c.frequency) < c.damping * c.frequency
        ]
        # one that was alone there was found again later
        if near and (
            c.alone or mac(c.shape[:, None], np.array(near).T).max() > LIMITS.same
        ):
            continue
        kept.append(c)
        known.append((c.frequency, c.shape))
    return sorted(kept, key=lambda x: x.frequency)


def as_other_candidates(
    doubtful: Sequence[DroppedPole], modes: ModeSet
) -> OtherCandidates:
    """Doubtful modes at the channels of `modes`."""
    if not doubtful:
        return OtherCandidates.none(modes.channels)
    shapes = np.stack([c.shape for c in doubtful], axis=1)
    found = ModeSet(
        frequencies=np.array([c.frequency for c in doubtful]),
        damping=np.array([c.damping for c in doubtful]),
        shapes=shapes,
        labels=modes.labels,
        source=modes.source,
        confidence=np.array([c.confidence for c in doubtful]),
    )
    std = Uncertainty.independent(
        np.array([c.std_frequency for c in doubtful]),
        np.array([c.std_damping for c in doubtful]),
        np.full(shapes.shape, np.nan),
    )
    classes: list[ModeClass] = ["doubtful" for _ in doubtful]
    return OtherCandidates(found, std, tuple(classes), tuple(c.note for c in doubtful))


def _aspect(factor: Float, good: Sequence[str], bad: Sequence[str]) -> _Aspect:
    texts = [b if x < 0.9 else g for x, g, b in zip(factor, good, bad, strict=True)]
    return _Aspect(factor, tuple(texts))


def _noise_left(lines: Lines, fit: Refined) -> Bool:
    """(m,) where the fit leaves nothing but noise, of lines that do not follow each other, and
    there are many.

    FRFs that disagree leave smooth errors there, which further poles would patch up.
    """
    rest = fit.known.rest
    along = (rest[:, 1:] * rest[:, :-1].conj()).real.sum(axis=(0, 2))
    power = (np.abs(rest) ** 2).sum(axis=(0, 2))
    far = np.abs(lines.s.imag[:, None] - fit.poles.imag)
    near = far < LIMITS.around * np.abs(fit.poles.real)
    white = along @ near[1:] < LIMITS.white * (power @ near)
    return np.asarray((near.sum(axis=0) >= LIMITS.lines) & white)


def _stable(c: CandidatePoles, clear: Bool, needed: Bool) -> _Aspect:
    """Stability over the orders; a mode whose shape and gain are beyond doubt may do without.

    So may one without which more than noise would be left: it hides under others.
    """
    factor = np.clip((c.support - 0.15) / 0.35, 0, 1) * np.clip(1.6 - c.scatter, 0.4, 1)
    factor = np.maximum(factor, np.where(needed, 0.9, np.where(clear, 0.7, 0.0)))
    good = [f"in {100 * s:.0f} % of the orders" for s in c.support]
    scatter = [f" only, scatter {x:.2g} half bandwidths" for x in c.scatter]
    return _aspect(factor, good, [g + x for g, x in zip(good, scatter, strict=True)])


def _gains(fit: Refined, total: Float, near: Float) -> tuple[_Aspect, Float]:
    """Gain per real unknown over the squared error near the mode, weighted with its own magnitude;
    that ratio.
    """
    rest = 0.5 * (np.abs(fit.known.rest) ** 2).mean(axis=(0, 2))  # per real value
    ratio = total / (2 * fit.shapes.shape[0]) / np.maximum(near.T @ rest, 1e-300)
    factor = np.log(np.maximum(ratio, 1e-9) / 2) / np.log(LIMITS.gain / 2)
    text = [
        f"contribution {10 * np.log10(max(r, 1e-9)):.0f} dB over the error"
        for r in ratio
    ]
    return _aspect(np.clip(factor, 0, 1), text, [f"weak, {t}" for t in text]), ratio


def _shared_error(lines: Lines, fit: Refined, near: Float) -> Float:
    """(m,) power of the error along each shape over that in the typical response, near the mode.

    1 where responses err independently; as many as there are responses where they move together, as
    in wind.
    """
    seen = fit.shapes * lines.response[:, None]
    seen = seen / np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    rest = fit.known.rest
    along = (near * (np.abs(rest @ seen.conj()) ** 2).mean(axis=0)).sum(axis=0)
    typical = near.T @ (np.abs(rest) ** 2).mean(axis=(0, 2))
    return np.asarray(along / np.maximum(typical, 1e-300))


def _damped(fit: Refined, zeta: Float, damping_max: float) -> _Aspect:
    doubt = fit.std_damping / np.maximum(zeta, 1e-9)
    inside = (zeta > 1e-5) & (zeta < damping_max)
    factor = np.where(inside, np.clip(1.4 - doubt, 0, 1), 0.0)
    good = [f"damping {100 * z:.3g} %" for z in zeta]
    std = [f" ± {100 * s:.2g} % out of range or unknown" for s in fit.std_damping]
    return _aspect(factor, good, [g + s for g, s in zip(good, std, strict=True)])


def shares(lines: Lines, fit: Refined) -> Float:
    """(m,) amplitude of each mode at its own frequency against the data there, rms over responses
    and inputs.
    """
    at = np.abs(lines.s.imag[:, None] - fit.poles.imag).argmin(axis=0)
    gain = np.abs(lines.weight[at] * lines.kind[at] / (lines.s[at] - fit.poles))
    psi = np.sqrt(((np.abs(fit.shapes) * lines.response[:, None]) ** 2).mean(axis=0))
    part = np.sqrt((np.abs(fit.participation * lines.input) ** 2).mean(axis=1))
    data = np.sqrt((np.abs(lines.y[:, at] * lines.response) ** 2).mean(axis=(0, 2)))
    return np.asarray(gain * psi * part / np.maximum(data, 1e-300))


def _double(
    lines: Lines, fit: Refined, c: CandidatePoles, total: Float, *, strict: bool
) -> _Aspect:
    """A weaker mode near a stronger one of the same shape and participation is its double.

    One that the orders do not show needs the same shape only: setups that disagree about a mode
    split it that way.
    """
    p = fit.poles
    half = np.abs(p.real)
    width = np.maximum(half[:, None], half) + np.median(np.diff(lines.s.imag))
    far = np.abs(p[:, None] - p) / width
    like = mac(fit.shapes, fit.shapes)
    both = like * mac(fit.participation.T, fit.participation.T)
    shape_alone = like if fit.shapes.shape[0] > 4 else both
    rare = (c.support < 0.4)[:, None] & strict
    by_shape = rare | ((far < 1.0) & (shape_alone > LIMITS.double))
    similarity = np.where(by_shape, shape_alone, both)
    weak = total[:, None] / np.maximum(total[None], 1e-300) < 0.1
    near = (far < 1.0) & (similarity > 0.8)
    near |= (far < 3.0) & (similarity > LIMITS.double) & weak
    double = near & (total[None] > total[:, None])
    of = np.argmax(double, axis=1)
    factor = np.where(double.any(axis=1), 0.1, 1.0)
    text = [f"doubles the mode at {abs(p[j]) / (2 * np.pi):.4g} Hz" for j in of]
    return _aspect(factor, [""] * p.size, text)
