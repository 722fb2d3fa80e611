"""Modes that a fit shows twice because the FRFs disagree about them: one pole in each response, or
two in all?

A sensor that is moved from response to response loads the structure at another place each time, and
each response has the mode at a frequency of its own. One fit of all then shows two modes or three,
a fraction of a bandwidth from each other, of similar participation vectors. The two models have
about as many unknowns: a pole and a residue of each response, or two residues of each response and
two poles. True close modes add up to nothing in some responses, or have other participation
vectors: no single pole fits there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from ringtrue.core.arrays import Complex, Float
from ringtrue.identification.frf.confidence import CandidatePoles
from ringtrue.identification.frf.lines import Lines, resonances, without
from ringtrue.identification.frf.refinement import Refined

NEAR = 2.0  # half bandwidths between neighbours among the poles of a split mode
BAND = 6.0  # half bandwidths around them that tell
INSIDE = 0.5  # length, in the band, of smooth terms that the fit has there
LEAST = 12  # lines on each side
FEWEST = 6  # responses
TURNS = 12
SETTLED = 1e-4  # of the squares left, that a step still takes away
BETWEEN_TURNS = 10
LEAST_DAMPED = 0.1  # of the half bandwidth
# standard deviations between responses that do not agree: those of one place differ by 1 to 3
APART = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalPoles:
    """One mode with a pole in each response.

    Attributes
    ----------
    poles : (out,) complex128, rad/s
    variance : (out,) float64
        Of their real and of their imaginary parts.
    residues : (out,) complex128
        For the participation vector.
    participation : (in,) complex128
        Unit length, of the weighted data.
    cost : float
        Squares that it leaves over those that the fit leaves, per value that is free, in the band
        of the mode.
    """

    poles: Complex
    variance: Float
    residues: Complex
    participation: Complex
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class SplitMode:
    """Positions of several modes of a fit that are one, and that one."""

    at: tuple[int, ...]
    mode: LocalPoles


def split_modes(lines: Lines, fit: Refined) -> list[SplitMode]:
    """Modes next to each other that one with a pole in each response explains no worse.

    Of fewer than six responses nothing is found.
    """
    if fit.shapes.shape[0] < FEWEST:
        return []
    order = np.argsort(fit.poles.imag, kind="stable")
    poles = fit.poles[order]
    half = np.abs(poles.real)
    ends = np.flatnonzero(np.diff(poles.imag) > NEAR * np.maximum(half[1:], half[:-1])) + 1
    return [m for run in np.split(order, ends) for m in _split(lines, fit, tuple(run.tolist()))]


def _split(lines: Lines, fit: Refined, run: tuple[int, ...]) -> list[SplitMode]:
    """Those of a run of neighbours, the longest first."""
    for length in range(len(run), 1, -1):
        for i in range(len(run) - length + 1):
            at = run[i : i + length]
            mode = local_poles(lines, fit, at)
            if mode.cost < 1:
                rest = run[:i], run[i + length :]
                return [
                    SplitMode(at, mode),
                    *(m for part in rest for m in _split(lines, fit, part)),
                ]
    return []


def joined(lines: Lines, candidates: CandidatePoles, split: Sequence[SplitMode]) -> CandidatePoles:
    """The candidates with one in place of each split mode, these last."""
    c = candidates
    parts = [m for s in split for m in s.at]
    keep = np.setdiff1d(np.arange(c.pole.size), parts)
    return CandidatePoles(
        np.append(c.pole[keep], [_mean(s.mode)[0] for s in split]),
        np.concatenate(
            [c.participation[keep], [s.mode.participation / lines.input for s in split]]
        ),
        np.append(c.support[keep], [c.support[list(s.at)].max() for s in split]),
        np.append(c.scatter[keep], [c.scatter[list(s.at)].min() for s in split]),
    )


def levelled(lines: Lines, split: Sequence[SplitMode]) -> Lines:
    """The lines as if each response had the mean pole of the split modes; residues of one modal
    mass go with 1/ω.
    """
    y = lines.y.copy()
    for mode in (s.mode for s in split):
        pole = _mean(mode)[0]
        mean = resonances(lines, np.array([pole]))[0] * (mode.poles.imag / pole.imag)
        change = lines.weight[:, None] * (resonances(lines, mode.poles)[0] - mean) * mode.residues
        change = without(lines.terms, without(lines.smooth, change))
        for i, part in enumerate(mode.participation):  # all inputs at once would not fit
            y[i] -= part * change
    return replace(lines, y=y, power=_squares(y).sum(axis=0))


def scattered(lines: Lines, fit: Refined, new: Refined, split: Sequence[SplitMode]) -> Refined:
    """`new`, of `joined` modes, with deviations that hold the scatter between the responses in
    `fit`.

    Where responses disagree about some modes, those of the others hold it too.
    """
    keep = np.setdiff1d(np.arange(fit.poles.size), [m for s in split for m in s.at])
    x = lines.s.imag
    # modes beyond the lines no response knows
    seen = [x[0] < fit.poles[k].imag < x[-1] for k in keep.tolist()]
    spread = [
        _mean(local_poles(lines, fit, (k,)))[1:] if s else (0.0, 0.0)
        for k, s in zip(keep.tolist(), seen, strict=True)
    ]
    old = np.array([new.std_frequency, new.std_damping])
    std = np.maximum(old, np.array([*spread, *(_mean(s.mode)[1:] for s in split)]).T)
    factor = new.factor * (std / np.maximum(old, 1e-300)).ravel()
    return replace(new, std_frequency=std[0], std_damping=std[1], factor=factor)


def agreeing(split: Sequence[SplitMode]) -> tuple[tuple[int, ...], ...]:
    """Responses that have the split modes at the same frequencies: those of a place that the
    sensors had, or a day.

    Average linkage of their distances in standard deviations, of several modes the median. Empty
    where all agree, or one agrees with no other: then there are no groups.
    """
    if not split:
        return ()
    shift = np.array([np.log(s.mode.poles.imag) for s in split])
    variance = np.array([s.mode.variance / s.mode.poles.imag**2 for s in split])
    i, j = np.triu_indices(shift.shape[1], 1)
    far = np.abs(shift[:, i] - shift[:, j]) / np.sqrt(
        variance[:, i] + variance[:, j] + np.finfo(float).tiny
    )
    group = fcluster(linkage(np.median(far, axis=0), "average"), APART, "distance")
    parts = tuple(sorted(tuple(np.flatnonzero(group == g).tolist()) for g in np.unique(group)))
    return parts if len(parts) > 1 and min(map(len, parts)) > 1 else ()


def split_note(fit: Refined, count: int) -> str:
    """Says which the last `count` modes are, and how far the responses disagree."""
    f = np.abs(fit.poles[-count:]) / (2 * np.pi)
    order = np.argsort(f)
    shift = float(np.median(fit.std_frequency[-count:] / f))
    named = " ".join(f"{x:.5g}" for x in f[order])
    return (
        f"the responses disagree about the modes at {named} Hz, by {100 * shift:.2g} % of the "
        "frequency: each would show as several, and is one with the mean and scatter of the "
        "responses (moved sensors load the structure, or it changed)"
    )


def _mean(mode: LocalPoles) -> tuple[complex, float, float]:
    """Pole of the mean frequency and damping over the responses; deviations of those of one
    response.
    """
    omega = np.abs(mode.poles)
    zeta = -mode.poles.real / np.abs(mode.poles)
    mean, spread = _random_effects(omega, mode.variance)
    damping, damping_spread = _random_effects(zeta, mode.variance / omega**2)
    return mean * complex(-damping, np.sqrt(1 - damping**2)), spread / (2 * np.pi), damping_spread


def _random_effects(x: Float, variance: Float) -> tuple[float, float]:
    """Mean of values that differ by more than their variances tell, and the deviation of one.

    The variance between the values is what their scatter has over their own (DerSimonian, Kacker
    2007), by turns with the weights.
    """
    between = float(np.var(x))
    mean = float(x.mean())
    w = np.ones(x.size)
    for _ in range(BETWEEN_TURNS):
        w = 1 / (variance + between + np.finfo(float).tiny)
        total = w.sum()
        mean = float(w @ x / total)
        excess = w @ (x - mean) ** 2 - w @ variance + (w**2) @ variance / total
        between = max(float(excess / (total - w @ w / total)), 0.0)
    return mean, float(np.sqrt(between + 1 / w.sum()))


def local_poles(lines: Lines, fit: Refined, at: Sequence[int]) -> LocalPoles:
    """The modes `at` of a fit replaced by one with a pole in each response, others near as they
    are.

    Modes further away may have another pole and residue in each response too, to first order.
    Gauss-Newton steps on the poles, the residues eliminated.
    """
    band = _band(lines, fit, list(at))
    z = band.along
    poles = fit.poles[list(at)]
    centre = poles.mean()
    half = float(np.abs(poles.real).max())
    reach = half + np.ptp(poles.imag)
    p = np.full(z.shape[1], centre)
    q, r, cost = band.residues(p)
    for _ in range(TURNS):
        slope = band.slopes(p, q, r)
        step = (slope.conj() * (z - q * r)).sum(axis=0) / np.maximum(_squares(slope), 1e-300)
        away = p + step - centre
        new = centre + away * np.minimum(1, reach / np.maximum(np.abs(away), 1e-300))
        new = np.minimum(new.real, -LEAST_DAMPED * half) + 1j * new.imag
        trial = band.residues(new)
        better = trial[2] < cost
        gain = (cost - trial[2])[better].sum()
        p, q, r, cost = (
            np.where(better, x, y) for x, y in zip((new, *trial), (p, q, r, cost), strict=True)
        )
        if gain <= SETTLED * cost.sum():
            break
    free = z.shape[0] - band.neighbours.shape[1]  # of each response, to one participation vector
    variance = 0.5 * cost / max(free - 2, 1) / np.maximum(_squares(band.slopes(p, q, r)), 1e-300)
    values = free * band.part.size
    share = (band.across + cost.sum()) / max(values - 2, 1) * max(values - len(at), 1) / band.left
    return LocalPoles(
        poles=p,
        variance=variance,
        residues=r / lines.response,
        participation=band.part,
        cost=float(share),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """What the data hold of some modes in their band, without what neighbours and smooth terms may
    have.

    `along` (freq, out) is the part along the participation vector `part` (in,); `across` are the
    squares of the rest, `left` those that the fit leaves. `neighbours` (freq, n) is an orthonormal
    basis.
    """

    lines: Lines
    along: Complex
    across: float
    left: float
    part: Complex
    neighbours: Complex

    def residues(self, p: Complex) -> tuple[Complex, Complex, Float]:
        """Functions of the poles, residues, and the squares left of each response."""
        q = without(self.neighbours, self.lines.weight[:, None] * resonances(self.lines, p)[0])
        r = (q.conj() * self.along).sum(axis=0) / _squares(q)
        return q, r, _squares(self.along - q * r)

    def slopes(self, p: Complex, q: Complex, r: Complex) -> Complex:
        """Derivatives of the fit by the poles, without their part along the functions."""
        slope = without(
            self.neighbours, self.lines.weight[:, None] * resonances(self.lines, p)[1] * r
        )
        return np.asarray(slope - q * ((q.conj() * slope).sum(axis=0) / _squares(q)))


def _band(lines: Lines, fit: Refined, at: list[int]) -> _Band:
    poles = fit.poles[at]
    part = fit.known.state.part[at]
    half = np.abs(poles.real).max()
    reach = max(BAND * half, LEAST * np.diff(lines.s.imag).mean()) + np.ptp(poles.imag) / 2
    near = np.abs(lines.s.imag - poles.imag.mean()) < reach
    band = replace(lines, s=lines.s[near], kind=lines.kind[near], weight=lines.weight[near])
    far = np.abs(fit.poles.imag[:, None] - poles.imag).min(axis=1)
    others = fit.poles[(far > NEAR * np.maximum(half, np.abs(fit.poles.real))) & (far < 2 * reach)]
    flat, size, _ = np.linalg.svd(lines.smooth[near], full_matrices=False)
    columns = [
        *(band.weight[:, None] * x for x in resonances(band, others)),
        flat[:, size > INSIDE],
    ]
    basis = np.linalg.qr(np.concatenate(columns, axis=1))[0]
    shapes = fit.shapes[:, at] * lines.response[:, None]
    left = without(basis, fit.known.rest[:, near])
    own = band.weight[:, None] * resonances(band, poles)[0]
    y = left + without(basis, own) @ (part.T[:, :, None] * shapes.T)
    vector = np.linalg.svd(part.T * np.linalg.norm(shapes, axis=0), full_matrices=False)[0][:, 0]
    z = np.tensordot(vector.conj(), y, 1)
    across = float(_squares(y).sum() - _squares(z).sum())
    return _Band(
        band,
        z,
        across=across,
        left=max(float(_squares(left).sum()), 1e-300),
        part=vector,
        neighbours=basis,
    )


def _squares(y: Complex) -> Float:
    """Sums of squares over the lines."""
    return np.asarray((np.abs(y) ** 2).sum(axis=-2))
