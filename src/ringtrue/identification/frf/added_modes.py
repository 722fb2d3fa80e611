"""Modes that the pole search missed, and repeated roots.

Missed modes are peaks in what a fit leaves of the FRFs. Poles that the data do not separate may
have any mixture of the two shapes. Where the participation vectors of several references span a
plane, the pair is given one pole and two real shapes, orthogonal to each other and, with two
driving points, to the mass: the residues of the pair are R = Ψ B = Φ Φ_dᵀ, Φ = Ψ T, and T Tᵀ
follows from the rows Ψ_d of the driving points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.common.poles import PoleSet
from ringtrue.identification.frf.confidence import CandidatePoles
from ringtrue.identification.frf.lines import Lines
from ringtrue.identification.frf.refinement import Refined, refine
from ringtrue.identification.frf.residues import Pairs, solve_shapes

SEPARATE = 3.0  # standard deviations of the distance of two poles that are separated
FLAT = 0.2  # third over second singular value of a plane of real vectors
NEAR = 0.3  # half bandwidths within which two poles may be one
ONE = 2e-3  # half bandwidths within which they are, whatever the stated deviations
ABOVE = 1.3  # times the error in its surroundings
SHARE = 0.03  # amplitude of the error against the data, where the data agree no better than that
WORSE = 3.0  # times the error at the peak of a typical mode


def twins(poles: Complex) -> list[tuple[int, int]]:
    """Positions of the modes that share a pole."""
    i, j = np.nonzero(np.triu(poles[:, None] == poles, 1))
    return list(zip(i.tolist(), j.tolist(), strict=True))


def united(lines: Lines, fit: Refined, pairs: Pairs) -> Refined:
    """The fit with one pole and two orthogonal real shapes for each two modes that the data do not
    separate.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    pairs : sequence of (output, input, sign)
        Driving points.
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
        part[[i, j]] = _orthogonal(shapes, part[[i, j]], pairs, lines.response)
    if not twins(poles):
        return fit
    new = refine(lines, poles, part, iterations=0)
    return replace(new, outcome=fit.outcome) if new.cost < 1.01 * fit.cost else fit


def _inseparable(fit: Refined) -> list[tuple[int, int]]:
    """Pairs of poles nearer to each other than the data tell, each pole in one pair at most."""
    p = fit.poles
    half = np.abs(p.real)
    std = 2 * np.pi * np.hypot(fit.std_frequency, np.abs(p) / (2 * np.pi) * fit.std_damping)
    far = np.abs(p[:, None] - p)
    width = np.minimum(half[:, None], half)
    near = far < np.clip(SEPARATE * np.hypot(std[:, None], std), ONE * width, NEAR * width)
    rank = [(float(far[i, j]), int(i), int(j)) for i, j in np.argwhere(np.triu(near, 1))]
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
    size, basis = np.linalg.svd(np.concatenate([v.real, v.imag]), full_matrices=False)[1:]
    flat = size.size < 3 or size[2] < FLAT * size[1]
    return np.asarray(basis[:2]) if flat and size[1] > 1e-3 * size[0] else None


def _orthogonal(psi: Complex, basis: Complex, pairs: Pairs, response: Float) -> Complex:
    """(2, in) participation vectors in the plane `basis` whose shapes are orthogonal.

    `psi` (out, 2) are the shapes of the vectors of the basis. With two driving points they are
    orthogonal to the mass as well; with fewer, the vectors are orthogonal to each other.
    """
    x = np.eye(2)
    if len(pairs) > 1:
        o, i, sign = (np.array(k) for k in zip(*pairs, strict=True))
        d = (psi[o] * sign[:, None]).T
        b = basis[:, i]
        full = b @ np.linalg.pinv(d)
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
    zeta = np.median(-fit.poles.real / np.abs(fit.poles)) if fit.poles.size else 0.01
    pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    part = np.array([_direction(rest[:, max(k - 1, 0) : k + 2]) / lines.input for k in at]).reshape(
        at.size, rest.shape[0]
    )
    return CandidatePoles(pole, part, support(pole, part, sets, decay), np.zeros(at.size))


def _peaks(rest: Complex, lines: Lines, fit: Refined) -> Int:
    """Lines of the peaks, highest first, at least half a bandwidth from each other."""
    power = uniform_filter1d((np.abs(rest) ** 2).mean(axis=(0, 2)), 3, mode="nearest")
    total = (np.abs(lines.y * lines.response) ** 2).mean(axis=(0, 2))
    step = np.median(np.diff(lines.s.imag))
    zeta = np.median(-fit.poles.real / np.abs(fit.poles)) if fit.poles.size else 0.01
    half = int(np.ceil(zeta * np.median(lines.s.imag) / step)) + 2
    floor = median_filter(power, size=min(20 * half + 1, power.size), mode="mirror")
    top = power >= maximum_filter1d(power, 2 * half + 1, mode="nearest")
    share = power / uniform_filter1d(total, 3, mode="nearest")
    seen = top & (power > ABOVE * floor) & (share > _usual(share, lines, fit))
    at = np.flatnonzero(seen)
    return at[np.argsort(-(power / floor)[at], kind="stable")]


def _usual(share: Float, lines: Lines, fit: Refined) -> Float:
    """Squared share of the error in the data that is no sign of a missed mode: measured FRFs
    disagree by some.

    On the flank of a mode an error well above that at the peaks of the others is one: two modes
    taken for one.
    """
    usual = np.full(share.size, SHARE**2)
    if fit.poles.size > 1:
        far = np.abs(lines.s.imag[:, None] - fit.poles.imag)
        flank = (far < 2 * np.abs(fit.poles.real)).any(axis=1)
        usual[flank] = min(SHARE**2, WORSE**2 * np.median(share[far.argmin(axis=0)]))
    return usual


def _direction(rest: Complex) -> Complex:
    """Participation vector (in,) that carries most of the error at a few lines (in, freq, out)."""
    a = rest.reshape(rest.shape[0], -1)
    return np.asarray(np.linalg.eigh(a @ a.conj().T)[1][:, -1], dtype=np.complex128)


def support(pole: Complex, part: Complex, sets: Sequence[PoleSet], decay: float) -> Float:
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
            similarity[:, [i, j]] = (np.abs(v.conj().T @ q) ** 2).sum(axis=1, keepdims=True)
        near &= similarity > 0.6
        upper = s.order >= np.median(s.orders)
        held = np.array([np.unique(s.order[upper & n]).size for n in near.T])
        best = np.maximum(best, held / max(np.unique(s.order[upper]).size, 1))
    return best
