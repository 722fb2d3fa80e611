"""Repeated roots of FRFs: two modes of one frequency, of which only the plane of the shapes is
known.

Poles that the data do not separate may have any mixture of the two shapes, complex and oblique ones
too. Where the participation vectors of several references span a plane, the pair is given one pole
and two real shapes, orthogonal to each other and, where two driving points tell, to the mass: the
residues of the pair are R = Ψ B = Φ Φ_dᵀ, Φ = Ψ T, and T Tᵀ follows from the rows Ψ_d of the
driving points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.identification.lsfd import Lines, solve_shapes
from ringtrue.identification.refine import Refined, refine

SEPARATE = 3.0  # standard deviations of the distance of two poles that are told apart
FLAT = 0.2  # third over second singular value of a plane of real vectors
NEAR = 0.3  # half bandwidths within which two poles may be one
ONE = 2e-3  # half bandwidths within which they are, whatever the stated deviations

Pairs = Sequence[tuple[int, int, float]]


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
    poles, part = fit.poles.copy(), fit.participation.copy()
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
    half, std = (
        np.abs(p.real),
        2 * np.pi * np.hypot(fit.std_frequency, np.abs(p) / (2 * np.pi) * fit.std_damping),
    )
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
        d, b = (psi[o] * sign[:, None]).T, basis[:, i]
        full = b @ np.linalg.pinv(d)
        full = full * np.exp(-1j * np.angle(np.trace(full)))
        sym = 0.5 * (full + full.T).real
        x = sym if np.linalg.eigvalsh(sym)[0] > 1e-3 * np.trace(sym) else x
    t = np.linalg.cholesky(x)
    phi = (psi @ t) * response[:, None]
    turn = np.linalg.eigh((phi.conj().T @ phi).real)[1]
    return np.asarray(np.linalg.solve(t @ turn, basis))
