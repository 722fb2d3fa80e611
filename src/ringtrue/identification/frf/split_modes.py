"""Modes that a fit shows twice because the FRFs disagree about them: one pole in each response, or
two in all?

A sensor that is moved from response to response loads the structure at another place each time, and
each response has the mode at a frequency of its own. One fit of all then shows two modes or three,
a fraction of a bandwidth from each other, of similar participation vectors. The two models have
about as many unknowns: a pole and a residue of each response, or two residues of each response and
two poles. True close modes add up to nothing in some responses, or have other participation
vectors: no single pole fits there.

Modes that the pole search missed, and repeated roots.

Missed modes are peaks in what a fit leaves of the FRFs. Poles that the data do not separate may
have any mixture of the two shapes. Where the participation vectors of several references span a
plane, the pair is given one pole and two real shapes, orthogonal to each other and, with two
driving points, to the mass: the residues of the pair are R = Ψ B = Φ Φ_dᵀ, Φ = Ψ T, and T Tᵀ
follows from the rows Ψ_d of the driving points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.common.stabilisation import PoleSet
from ringtrue.identification.frf.confidence import CandidatePoles
from ringtrue.identification.frf.lines import Lines, resonances, without
from ringtrue.identification.frf.refinement import Refined, refine
from ringtrue.identification.frf.residues import DrivingPoints, solve_shapes


@dataclass(frozen=True, slots=True)
class AddedModeLimits:
    """When two poles are one, and when a peak of the error is a missed mode.

    Attributes
    ----------
    deviations : float
        Standard deviations of the distance of two poles that are separated.
    least, most : float
        Half bandwidths within which two poles are one in any case, and may be.
    flat : float
        Third over second singular value of a plane of real vectors.
    above : float
        Error at a peak over that in its surroundings.
    share : float
        Amplitude of the error against the data: measured FRFs agree no better.
    worse : float
        Times the error at the peak of a typical mode, on the flank of one.
    """

    deviations: float = 3.0
    least: float = 2e-3
    most: float = 0.3
    flat: float = 0.2
    above: float = 1.3
    share: float = 0.03
    worse: float = 3.0


ADDED = AddedModeLimits()


def twins(poles: Complex) -> list[tuple[int, int]]:
    """Positions of the modes that share a pole."""
    i, j = np.nonzero(np.triu(poles[:, None] == poles, 1))
    return list(zip(i.tolist(), j.tolist(), strict=True))


def united(lines: Lines, fit: Refined, points: DrivingPoints) -> Refined:
    """The fit with one pole and two orthogonal real shapes for each two modes that the data do not
    separate.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    points : DrivingPoints
    """
    if fit.participation.shape[1] < 2:
        return fit
    poles = fit.poles.copy()
    part = fit.participation.copy()
    for i, j in _inseparable(fit):
        basis = _plane(part[[i, j]] * lines.input)
        if basis is None:
            continue
        poles[[i, j]] = poles[[i, j]].mean()
        part[[i, j]] = basis / lines.input
        shapes = solve_shapes(lines, poles, part)[:, [i, j]]
        part[[i, j]] = _orthogonal(shapes, part[[i, j]], points, lines.response)
    if not twins(poles):
        return fit
    new = refine(lines, poles, part, iterations=0)
    return replace(new, outcome=fit.outcome) if new.cost < 1.01 * fit.cost else fit


def _inseparable(fit: Refined) -> list[tuple[int, int]]:
    """Pairs of poles nearer to each other than the data tell, each pole in one pair at most."""
    p = fit.poles
    half = np.abs(p.real)
    std = (
        2
        * np.pi
        * np.hypot(fit.std_frequency, np.abs(p) / (2 * np.pi) * fit.std_damping)
    )
    far = np.abs(p[:, None] - p)
    width = np.minimum(half[:, None], half)
    near = far < np.clip(
        ADDED.deviations * np.hypot(std[:, None], std),
        ADDED.least * width,
        ADDED.most * width,
    )
    rank = [
        (float(far[i, j]), int(i), int(j)) for i, j in np.argwhere(np.triu(near, 1))
    ]
    out: list[tuple[int, int]] = []
    for _, i, j in sorted(rank):
        if all(i not in known and j not in known for known in out):
            out.append((i, j))
    return out


def _plane(part: Complex) -> Float | None:
    """(2, in) orthonormal real basis of two participation vectors; None if they lie in no plane of
    real ones.
    """
    v = part / np.linalg.norm(part, axis=1, keepdims=True)
    size, basis = np.linalg.svd(np.concatenate([v.real, v.imag]), full_matrices=False)[
        1:
    ]
    flat = size.size < 3 or size[2] < ADDED.flat * size[1]
    return np.asarray(basis[:2]) if flat and size[1] > 1e-3 * size[0] else None


def _orthogonal(
    psi: Complex, basis: Complex, points: DrivingPoints, response: Float
) -> Complex:
    """(2, in) participation vectors in the plane `basis` whose shapes are orthogonal.

    `psi` (out, 2) are the shapes of the vectors of the basis. With two driving points they are
    orthogonal to the mass as well; with fewer, the vectors are orthogonal to each other.
    """
    x = np.eye(2)
    if len(points) > 1:
        full = basis[:, points.input] @ np.linalg.pinv(points.shapes(psi).T)
        full = full * np.exp(-1j * np.angle(np.trace(full)))
        sym = 0.5 * (full + full.T).real
        x = sym if np.linalg.eigvalsh(sym)[0] > 1e-3 * np.trace(sym) else x
    t = np.linalg.cholesky(x)
    phi = (psi @ t) * response[:, None]
    turn = np.linalg.eigh((phi.conj().T @ phi).real)[1]
    return np.asarray(np.linalg.solve(t @ turn, basis))


def missed(
    lines: Lines, fit: Refined, sets: Sequence[PoleSet], decay: float, most: int
) -> CandidatePoles:
    """Candidates at the highest peaks of the error, one for each.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    sets : sequence of PoleSet
        The poles of all orders, to count the orders that hold a candidate.
    decay : float, 1/s
        Exponential window still in `sets`.
    most : int
    """
    rest = fit.known.rest
    at = _peaks(rest, lines, fit)[:most]
    omega = lines.s.imag[at]
    zeta = np.median(fit.damping)
    pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    part = np.empty((at.size, rest.shape[0]), dtype=np.complex128)
    for row, k in enumerate(at.tolist()):
        # the participation vector that carries most of the error there
        a = rest[:, max(k - 1, 0) : k + 2].reshape(rest.shape[0], -1)
        part[row] = np.linalg.eigh(a @ a.conj().T)[1][:, -1] / lines.input
    return CandidatePoles(
        pole, part, support(pole, part, sets, decay), np.zeros(at.size)
    )


def _peaks(rest: Complex, lines: Lines, fit: Refined) -> Int:
    """Lines of the peaks, highest first, at least half a bandwidth from each other."""
    power = uniform_filter1d((np.abs(rest) ** 2).mean(axis=(0, 2)), 3, mode="nearest")
    total = (np.abs(lines.y * lines.response) ** 2).mean(axis=(0, 2))
    step = np.median(np.diff(lines.s.imag))
    half = int(np.ceil(np.median(fit.damping) * np.median(lines.s.imag) / step)) + 2
    floor = median_filter(power, size=min(20 * half + 1, power.size), mode="mirror")
    top = power >= maximum_filter1d(power, 2 * half + 1, mode="nearest")
    share = power / uniform_filter1d(total, 3, mode="nearest")
    seen = top & (power > ADDED.above * floor) & (share > _usual(share, lines, fit))
    at = np.flatnonzero(seen)
    return at[np.argsort(-(power / floor)[at], kind="stable")]


def _usual(share: Float, lines: Lines, fit: Refined) -> Float:
    """Squared share of the error in the data that is no sign of a missed mode: measured FRFs
    disagree by some.

    On the flank of a mode an error well above that at the peaks of the others is one: two modes
    taken for one.
    """
    usual = np.full(share.size, ADDED.share**2)
    if fit.poles.size > 1:
        far = np.abs(lines.s.imag[:, None] - fit.poles.imag)
        flank = (far < 2 * np.abs(fit.poles.real)).any(axis=1)
        usual[flank] = min(
            ADDED.share**2, ADDED.worse**2 * np.median(share[far.argmin(axis=0)])
        )
    return usual


def support(
    pole: Complex, part: Complex, sets: Sequence[PoleSet], decay: float
) -> Float:
    """Share of the orders that hold each pole, in the band that knows it best."""
    best = np.zeros(pole.size)
    for s in sets:  # a few bands
        if not len(s):
            continue
        width = np.abs(pole.real) + 0.2 * decay + 1e-4 * np.abs(pole)
        near = np.abs(s.pole[:, None] + decay - pole) < width
        v = s.shape / np.linalg.norm(s.shape, axis=0)
        u = part.T / np.linalg.norm(part.T, axis=0)
        similarity = np.abs(v.conj().T @ u) ** 2
        for i, j in twins(pole):  # any vector in the plane of both
            q = np.linalg.qr(u[:, [i, j]])[0]
            similarity[:, [i, j]] = (np.abs(v.conj().T @ q) ** 2).sum(
                axis=1, keepdims=True
            )
        near &= similarity > 0.6
        upper = s.order >= np.median(s.orders)
        held = np.array([np.unique(s.order[upper & n]).size for n in near.T])
        best = np.maximum(best, held / max(np.unique(s.order[upper]).size, 1))
    return best


@dataclass(frozen=True, slots=True)
class SplitLimits:
    """When neighbouring modes may be one, and how its pole in each response is found.

    Attributes
    ----------
    near : float
        Half bandwidths between neighbours among the poles of a split mode.
    band : float
        Half bandwidths on each side that are looked at.
    lines : int
        And lines at least.
    smooth : float
        Length, in the band, of smooth terms that the fit has there.
    responses : int
        Least number of responses.
    turns : int
        Most steps.
    converged : float
        Share of the squares left that a step still takes away.
    damping : float
        Least damping, in half bandwidths.
    """

    near: float = 2.0
    band: float = 6.0
    lines: int = 12
    smooth: float = 0.5
    responses: int = 6
    turns: int = 12
    converged: float = 1e-4
    damping: float = 0.1


SPLIT = SplitLimits()


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
    if fit.shapes.shape[0] < SPLIT.responses:
        return []
    order = np.argsort(fit.poles.imag, kind="stable")
    poles = fit.poles[order]
    half = np.abs(poles.real)
    ends = (
        np.flatnonzero(
            np.diff(poles.imag) > SPLIT.near * np.maximum(half[1:], half[:-1])
        )
        + 1
    )
    return [
        m
        for run in np.split(order, ends)
        for m in _split(lines, fit, tuple(run.tolist()))
    ]


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


def joined(
    lines: Lines, candidates: CandidatePoles, split: Sequence[SplitMode]
) -> CandidatePoles:
    """The candidates with one in place of each split mode, these last."""
    c = candidates
    parts = [m for s in split for m in s.at]
    whole = CandidatePoles(
        np.array([_mean(s.mode)[0] for s in split]),
        np.array([s.mode.participation / lines.input for s in split]),
        np.array([c.support[list(s.at)].max() for s in split]),
        np.array([c.scatter[list(s.at)].min() for s in split]),
    )
    return c.take(np.setdiff1d(np.arange(c.pole.size), parts)).joined(whole)


def levelled(lines: Lines, split: Sequence[SplitMode]) -> Lines:
    """The lines as if each response had the mean pole of the split modes; residues of one modal
    mass go with 1/ω.
    """
    y = lines.y.copy()
    for mode in (s.mode for s in split):
        pole = _mean(mode)[0]
        mean = resonances(lines, np.array([pole]))[0] * (mode.poles.imag / pole.imag)
        change = (
            lines.weight[:, None]
            * (resonances(lines, mode.poles)[0] - mean)
            * mode.residues
        )
        change = without(lines.terms, without(lines.smooth, change))
        # all inputs at once would not fit
        for i, part in enumerate(mode.participation):
            y[i] -= part * change
    return replace(lines, y=y, power=_squares(y).sum(axis=0))


def scattered(
    lines: Lines, fit: Refined, new: Refined, split: Sequence[SplitMode]
) -> Refined:
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


def split_note(fit: Refined, count: int) -> str:
    """Says which the last `count` modes are, and how far the responses disagree."""
    f = fit.frequencies[-count:]
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
    return (
        mean * complex(-damping, np.sqrt(1 - damping**2)),
        spread / (2 * np.pi),
        damping_spread,
    )


def _random_effects(x: Float, variance: Float) -> tuple[float, float]:
    """Mean of values that differ by more than their variances tell, and the deviation of one.

    The variance between the values is what their scatter has over their own (DerSimonian, Kacker
    2007), by turns with the weights.
    """
    between = float(np.var(x))
    mean = float(x.mean())
    w = np.ones(x.size)
    for _ in range(10):
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
    for _ in range(SPLIT.turns):
        slope = band.slopes(p, q, r)
        step = (slope.conj() * (z - q * r)).sum(axis=0) / np.maximum(
            _squares(slope), 1e-300
        )
        away = p + step - centre
        new = centre + away * np.minimum(1, reach / np.maximum(np.abs(away), 1e-300))
        new = np.minimum(new.real, -SPLIT.damping * half) + 1j * new.imag
        trial = band.residues(new)
        better = trial[2] < cost
        gain = (cost - trial[2])[better].sum()
        p, q, r, cost = (
            np.where(better, x, y)
            for x, y in zip((new, *trial), (p, q, r, cost), strict=True)
        )
        if gain <= SPLIT.converged * cost.sum():
            break
    # of each response, to one participation vector
    free = z.shape[0] - band.neighbours.shape[1]
    variance = (
        0.5
        * cost
        / max(free - 2, 1)
        / np.maximum(_squares(band.slopes(p, q, r)), 1e-300)
    )
    values = free * band.part.size
    left = (band.across + cost.sum()) / max(values - 2, 1)
    share = left * max(values - len(at), 1) / band.left
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
        q = without(
            self.neighbours, self.lines.weight[:, None] * resonances(self.lines, p)[0]
        )
        r = (q.conj() * self.along).sum(axis=0) / _squares(q)
        return q, r, _squares(self.along - q * r)

    def slopes(self, p: Complex, q: Complex, r: Complex) -> Complex:
        """Derivatives of the fit by the poles, without their part along the functions."""
        slope = without(
            self.neighbours,
            self.lines.weight[:, None] * resonances(self.lines, p)[1] * r,
        )
        return np.asarray(slope - q * ((q.conj() * slope).sum(axis=0) / _squares(q)))


def _band(lines: Lines, fit: Refined, at: list[int]) -> _Band:
    poles = fit.poles[at]
    part = fit.known.state.part[at]
    half = np.abs(poles.real).max()
    reach = (
        max(SPLIT.band * half, SPLIT.lines * np.diff(lines.s.imag).mean())
        + np.ptp(poles.imag) / 2
    )
    near = np.abs(lines.s.imag - poles.imag.mean()) < reach
    band = replace(lines, s=lines.s[near], weight=lines.weight[near])
    far = np.abs(fit.poles.imag[:, None] - poles.imag).min(axis=1)
    others = fit.poles[
        (far > SPLIT.near * np.maximum(half, np.abs(fit.poles.real)))
        & (far < 2 * reach)
    ]
    flat, size, _ = np.linalg.svd(lines.smooth[near], full_matrices=False)
    columns = [
        *(band.weight[:, None] * x for x in resonances(band, others)),
        flat[:, size > SPLIT.smooth],
    ]
    basis = np.linalg.qr(np.concatenate(columns, axis=1))[0]
    shapes = fit.shapes[:, at] * lines.response[:, None]
    left = without(basis, fit.known.rest[:, near])
    own = band.weight[:, None] * resonances(band, poles)[0]
    y = left + without(basis, own) @ (part.T[:, :, None] * shapes.T)
    vector = np.linalg.svd(
        part.T * np.linalg.norm(shapes, axis=0), full_matrices=False
    )[0][:, 0]
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
