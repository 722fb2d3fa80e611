"""Derivatives of eigenvalues and mass-normalised eigenvectors with respect to parameters.

(K − λM) φ' = −(K' − λM' − λ'M) φ with φᵀMφ = 1: the part in the computed modes is modal superposition, the rest
(in their M-orthogonal complement) comes from conjugate gradients preconditioned by the factor of K − σM.
Sources: Fox, Kapoor (1968); Nelson (1976); Alvin (1997, preconditioned iteration on the complement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes
from ringtrue.errors import InputError, NotConverged

CLOSE = 1e-6  # relative distance under which eigenvalues are treated as one repeated root
CHUNK = 64  # right-hand sides solved together
MAX_ITERATIONS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """K' and M' of one parameter, (f, f) csr_array each."""

    stiffness: sparse.csr_array
    mass: sparse.csr_array


def groups(values: Float, close: float = CLOSE) -> Int:
    """(m,) int64, equal for eigenvalues (ascending) that are repeated within `close`; rigid-body modes are one."""
    noise = 1e-9 * np.abs(values).max(initial=0.0)
    apart = np.diff(values) > np.maximum(close * np.abs(values[1:]), noise)
    return np.concatenate([np.zeros(min(values.size, 1)), np.cumsum(apart)]).astype(np.int64)


def eigenvalue_derivatives(modes: EigenModes, slopes: Sequence[Slope]) -> Float:
    """∂λ/∂a (m, p) = φᵀ(K' − λM')φ, in the basis of the modes as given.

    In a group of repeated roots these are the diagonal of the group's block: their sum is that of the
    branches; `split_derivatives` gives the derivatives of the branches.
    """
    phi, lam = modes.vectors, modes.values
    out = np.empty((lam.size, len(slopes)))
    for i, s in enumerate(slopes):  # over parameters
        out[:, i] = np.einsum("fm,fm->m", phi, s.stiffness @ phi - (s.mass @ phi) * lam)
    return out


def split_derivatives(modes: EigenModes, slope: Slope, close: float = CLOSE) -> Float:
    """∂λ/∂a (m,) of the branches that leave each repeated root, ascending in the group."""
    phi, lam, at = modes.vectors, modes.values, groups(modes.values, close)
    block = phi.T @ (slope.stiffness @ phi) - (phi.T @ (slope.mass @ phi)) * lam
    block = np.where(at[:, None] == at, (block + block.T) / 2, 0.0)
    out = np.empty(lam.size)
    for g in range(int(at[-1]) + 1 if at.size else 0):  # over groups of modes
        pick = at == g
        out[pick] = np.linalg.eigvalsh(block[np.ix_(pick, pick)])
    return out


def modal_coefficients(stiffness: Float, mass: Float, values: Float, close: float = CLOSE) -> Float:
    """Coefficients C of φ' = Φ C in a complete modal basis.

    Parameters
    ----------
    stiffness, mass : (..., n, m) float64
        Φᵀ K' Φ_m and Φᵀ M' Φ_m for all n modes and the m lowest of them.
    values : (n,) float64, ascending

    Returns
    -------
    c : (..., n, m) float64
        In a group of repeated roots −½ΦᵀM'Φ: normalisation is kept and the rotation inside the group is zero.
    """
    m = stiffness.shape[-1]
    at = groups(values, close)
    same = at[:, None] == at[:m]
    gap = np.where(same, 1.0, values[:m] - values[:, None])
    return np.where(same, -0.5 * mass, (stiffness - mass * values[:m]) / gap)


def eigenvector_derivatives(
    pencil: Pencil,
    modes: EigenModes,
    slopes: Sequence[Slope],
    *,
    count: int | None = None,
    tolerance: float = 1e-8,
    close: float = CLOSE,
) -> Float:
    """∂φ/∂a (f, count, p) of the lowest `count` mass-normalised modes.

    Parameters
    ----------
    pencil : Pencil
        Of the modes.
    modes : EigenModes
        ALL modes from the lowest up; the more there are above `count`, the faster it converges.
    slopes : sequence of Slope
    count : int, optional
        All if not given.
    tolerance : float
        Relative residual in the norm of the preconditioner.

    Raises
    ------
    InputError
        If more modes are asked for than are given.
    NotConverged
        If conjugate gradients do not converge: a mode above the last one given lies too close. Give more modes.
    """
    n = modes.values.size
    m = n if count is None else count
    if m > n:
        raise InputError(f"derivatives of {m} modes asked for; {n} are given")
    phi, lam = modes.vectors, modes.values
    out = np.empty((phi.shape[0], m, len(slopes)))
    loads = []
    for i, s in enumerate(slopes):  # over parameters
        dk, dm = s.stiffness @ phi[:, :m], s.mass @ phi[:, :m]
        out[:, :, i] = phi @ modal_coefficients(phi.T @ dk, phi.T @ dm, lam, close)
        loads.append(dm * lam[:m] - dk)
    flat, mode = np.concatenate(loads, axis=1), np.tile(np.arange(m), len(slopes))
    rest = np.empty_like(flat)
    for start in range(0, flat.shape[1], CHUNK):  # bounds the memory
        cut = slice(start, start + CHUNK)
        rest[:, cut] = _complement(pencil, modes, flat[:, cut], lam[mode[cut]], tolerance)
    return np.asarray(out + rest.reshape(phi.shape[0], len(slopes), m).transpose(0, 2, 1))


def _complement(pencil: Pencil, modes: EigenModes, load: Float, lam: Float, tolerance: float) -> Float:
    """Solve (K − λ_j M) z_j = load_j in the M-orthogonal complement of the modes, where it is definite."""
    factor, phi = pencil.at(modes.shift), modes.vectors
    mphi = pencil.mass @ phi

    def precondition(r: Float) -> Float:
        z = factor.solve(r)
        return np.asarray(z - phi @ (mphi.T @ z))

    r = load - mphi @ (phi.T @ load)
    x = np.zeros_like(r)
    z = precondition(r)
    p, rz = z.copy(), np.einsum("ij,ij->j", r, z)
    target = tolerance**2 * np.maximum(rz, 0)
    for _ in range(MAX_ITERATIONS):
        on = rz > np.maximum(target, np.finfo(float).tiny)
        if not on.any():
            return x
        ap = pencil.stiffness @ p - (pencil.mass @ p) * lam
        ap -= mphi @ (phi.T @ ap)
        curvature = np.einsum("ij,ij->j", p, ap)
        if (curvature[on] <= 0).any():
            break
        alpha = np.where(on, rz / np.where(on, curvature, 1.0), 0.0)
        x += p * alpha
        r -= ap * alpha
        z = precondition(r)
        new = np.einsum("ij,ij->j", r, z)
        p = z + p * np.where(on, new / np.where(on, rz, 1.0), 0.0)
        rz = np.where(on, new, rz)
    raise NotConverged(
        f"eigenvector derivatives: {int(on.sum())} of {lam.size} right-hand sides did not converge; "
        "compute more modes above those whose derivatives are needed"
    )
