"""Derivatives of eigenvalues and mass-normalised eigenvectors with respect to parameters.

(K − λM) φ' = −(K' − λM' − λ'M) φ with φᵀMφ = 1: the part in the computed modes is modal
superposition, the rest (in their M-orthogonal complement) is iterated with the factor of K − σM
that the modes came from. Sources: Fox, Kapoor (1968); Nelson (1976); Alvin (1997, iteration on the
complement); Dailey (1989, repeated roots).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.progress import Progress
from ringtrue.eigen.complement import Complement
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError

CLOSE = 1e-6  # relative distance under which eigenvalues are treated as one repeated root
COLUMNS = 320  # right-hand sides solved together: more save few solves and cost products
ROOM = 2**24  # numbers in an array of them, which lessens them in large models
BRANCHES = 1e-8  # residual of the derivatives of branches
STILL = 1e-9  # share of its terms under which the load of a rigid-body mode is rounding


@dataclass(frozen=True, slots=True, eq=False)
class MatrixDerivatives:
    """K' and M' of one parameter, and D' (viscous) and H' (structural damping) if there are any;
    (f, f) csr_array.

    `transform` is T', (full, f), of the motions u = T q of all DOFs, where the parameter moves
    nodes such that T moves.
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    viscous: sparse.csr_array | None = None
    structural: sparse.csr_array | None = None
    transform: sparse.csr_array | None = None


def groups(values: Float, scale: float | None = None) -> Int:
    """(m,) int64, equal for eigenvalues (ascending) that are repeated within `CLOSE`; rigid-body
    modes are one.

    Differences below 1e-9 of `scale`, the largest if not given, are noise.
    """
    noise = 1e-9 * (np.abs(values).max(initial=0.0) if scale is None else scale)
    separate = np.diff(values) > np.maximum(CLOSE * np.abs(values[1:]), noise)
    return np.concatenate([np.zeros(min(values.size, 1)), np.cumsum(separate)]).astype(np.int64)


def eigenvalue_derivatives(modes: EigenModes, slopes: Sequence[MatrixDerivatives]) -> Float:
    """∂λ/∂a (m, p) = φᵀ(K' − λM')φ, in the basis of the modes as given.

    In a group of repeated roots these are the diagonal of the group's block: their sum is that of
    the branches; `split_derivatives` gives the derivatives of the branches.
    """
    phi = np.ascontiguousarray(modes.vectors)
    lam = modes.values
    out = np.zeros((lam.size, len(slopes)))
    for i, s in enumerate(slopes):  # over parameters
        for a, factor in ((s.stiffness, 1.0), (s.mass, -lam)):
            rows, product = _product(a, phi)
            out[:, i] += np.einsum("rm,rm->m", phi[rows], product) * factor
    return out


def _product(a: sparse.csr_array, phi: Float) -> tuple[Int, Float]:
    """The rows of a that are not empty, and a times phi (f, m), row-major, on them."""
    rows = np.flatnonzero(np.diff(a.indptr))
    ends = np.append(a.indptr[rows], a.nnz).astype(a.indptr.dtype)
    full = sparse.csr_array((a.data, a.indices, ends), shape=(rows.size, a.shape[1]))
    return rows, np.asarray(full @ phi)


def split_derivatives(modes: EigenModes, slope: MatrixDerivatives) -> Float:
    """∂λ/∂a (m,) of the branches that leave each repeated root, ascending in the group."""
    phi = modes.vectors
    lam = modes.values
    at = groups(modes.values)
    block = phi.T @ (slope.stiffness @ phi) - (phi.T @ (slope.mass @ phi)) * lam
    block = np.where(at[:, None] == at, (block + block.T) / 2, 0.0)
    out = np.empty(lam.size)
    for g in range(int(at[-1]) + 1 if at.size else 0):  # over groups of modes
        pick = at == g
        out[pick] = np.linalg.eigvalsh(block[np.ix_(pick, pick)])
    return out


def modal_coefficients(stiffness: Float, mass: Float, values: Float, *, low: int = 0) -> Float:
    """Coefficients C of φ' = Φ C in a complete modal basis.

    Parameters
    ----------
    stiffness, mass : (..., n, m) float64
        Φᵀ K' Φ_m and Φᵀ M' Φ_m for all n modes and the m lowest of them.
    values : (n,) float64, ascending
    low : int
        Modes that must be distinct whatever is above them; 0: m.

    Returns
    -------
    c : (..., n, m) float64
        In a group of repeated roots −½ΦᵀM'Φ: normalisation is kept and the rotation inside the
        group is zero.
    """
    m = stiffness.shape[-1]
    scale = float(np.abs(values[: low or m]).max(initial=0.0))
    # motions almost without mass, as of a bearing's light node, must not set the noise of the low
    # modes
    at = groups(np.minimum(values, 1e4 * scale), scale)
    same = at[:, None] == at[:m]
    gap = np.where(same, 1.0, values[:m] - values[:, None])
    return np.where(same, -0.5 * mass, (stiffness - mass * values[:m]) / gap)


def eigenvector_derivatives(
    pencil: Pencil,
    modes: EigenModes,
    slopes: Sequence[MatrixDerivatives],
    *,
    count: int | None = None,
    tolerance: float = 1e-7,
    progress: Progress | None = None,
) -> Float:
    """∂φ/∂a (f, count, p) of the lowest `count` mass-normalised modes.

    Parameters
    ----------
    pencil : Pencil
        Of the modes.
    modes : EigenModes
        ALL modes from the lowest up; the more there are above `count`, the faster it converges.
    slopes : sequence of MatrixDerivatives
    count : int, optional
        All if not given.
    tolerance : float
        Relative residual ‖(K − λM)φ' + (K' − λM')φ − λ'Mφ‖ / ‖(K' − λM')φ‖.
    progress : callable, optional
        Called with (share done, what).

    Raises
    ------
    InputError
        If more modes are asked for than are given.
    NotConverged
        If a mode below the last one is not given, or one above lies too close. Give more modes.
    """
    n = modes.values.size
    m = n if count is None else count
    if m > n:
        raise InputError(f"derivatives of {m} modes asked for; {n} are given")
    phi = np.ascontiguousarray(modes.vectors)
    lam = modes.values
    space = Complement(pencil, modes, lam[:m], m * len(slopes))
    columns = min(max(ROOM // max(pencil.size, 1), 30), COLUMNS)
    runs = -(-len(slopes) // max(columns // max(m, 1), 1))
    per = (
        -(-len(slopes) // max(runs, 1)) or 1
    )  # of like size: a small last one costs as many products
    out = np.empty((len(slopes), m, pencil.size))
    rows = out.reshape(-1, pencil.size)
    for start in range(0, len(slopes), per):
        loads = [_Load.of(s, phi, lam, m) for s in slopes[start : start + per]]
        owner, mode = np.nonzero([load.live for load in loads])
        for first in range(0, owner.size, columns):
            of = owner[first : first + columns]
            j = mode[first : first + columns]
            place = (start + of) * m + j
            _write(
                space,
                loads,
                of,
                mode=j,
                tolerance=tolerance,
                out=rows[place[0] : place[0] + place.size],
            )
            _spread(rows, place)
        for i, load in enumerate(loads, start):
            still = np.flatnonzero(~load.live)
            out[i, still] = (phi @ load.along[:, still]).T
        if progress is not None:
            progress(min((start + per) / len(slopes), 1.0), "eigenvector derivatives")
    return out.transpose(2, 1, 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Load:
    """λM'φ − K'φ of the modes for one parameter, on the rows where it is not zero.

    Attributes
    ----------
    rows : (r,) int64
    force : (r, m) float64
    along : (n, m) float64
        The part of φ' in the modes.
    live : (m,) bool
        False where there is no load but rounding: rigid-body modes that stay such.
    """

    rows: Int
    force: Float
    along: Float
    live: Bool

    @classmethod
    def of(cls, s: MatrixDerivatives, phi: Float, lam: Float, m: int) -> _Load:
        """Of a slope; phi (f, n) row-major."""
        (rk, dk), (rm, dm) = (_product(a, phi[:, :m]) for a in (s.stiffness, s.mass))
        pk = phi[rk].T @ dk
        pm = phi[rm].T @ dm
        rows = np.union1d(rk, rm)
        force = np.zeros((rows.size, m))
        force[np.searchsorted(rows, rm)] = dm * lam[:m]
        force[np.searchsorted(rows, rk)] -= dk
        size = np.linalg.norm(force, axis=0)
        live = size > 0
        rigid = np.flatnonzero(np.abs(lam[:m]) <= STILL * np.abs(lam).max(initial=0.0))
        if rigid.size:
            terms = np.linalg.norm(_product(abs(s.stiffness), np.abs(phi[:, rigid]))[1], axis=0)
            terms += np.abs(lam).max() * np.linalg.norm(dm[:, rigid], axis=0)
            live[rigid] &= size[rigid] > STILL * terms
        return cls(rows, force, modal_coefficients(pk, pm, lam), live)


def _spread(rows: Float, at: Int) -> None:
    """Move what stands in rows from at[0] on, without gaps, to `at` (ascending)."""
    ends = np.flatnonzero(np.diff(at, append=-1) != 1) + 1
    for a, b in zip(
        np.append(0, ends[:-1])[::-1], ends[::-1], strict=True
    ):  # runs between gaps, the last one first
        if at[a] != at[0] + a:
            rows[at[a] : at[a] + b - a] = rows[at[0] + a : at[0] + b]


def _write(
    space: Complement, loads: Sequence[_Load], owner: Int, mode: Int, tolerance: float, out: Float
) -> None:
    """Write φ' (k, f) for pairs of a load and a mode; those of a load stand side by side."""
    pairs = list(zip(owner.tolist(), mode.tolist(), strict=True))
    along = np.stack([loads[i].along[:, j] for i, j in pairs], axis=1)
    size = np.array([np.linalg.norm(loads[i].force[:, j]) for i, j in pairs])

    def forces(c: slice) -> Float:
        r = np.zeros((owner[c].size, space.pencil.size))
        for i in np.unique(owner[c]).tolist():
            at = np.flatnonzero(owner[c] == i)
            r[at[0] : at[-1] + 1, loads[i].rows] += loads[i].force[:, mode[c][at]].T
        return r

    space.columns(forces, space.modes.values[mode], tolerance * size, out, along)


def branch_derivatives(
    pencil: Pencil,
    modes: EigenModes,
    slope: MatrixDerivatives,
    group: Sequence[int],
) -> tuple[Float, Float, Float]:
    """The vectors that leave a repeated root along one parameter, with their derivatives (Dailey
    1989).

    K and M are linear in the parameter: without K'' and M''.

    Parameters
    ----------
    pencil : Pencil
    modes : EigenModes
        All from the lowest up, some above the group.
    slope : MatrixDerivatives
    group : sequence of int
        Positions of the modes of the root.

    Returns
    -------
    vectors : (f, g) float64
        In the order of their derivatives, ascending.
    d_lambda : (g,) float64
    d_vectors : (f, g) float64
        Where two branches have equal derivatives, too, the rotation between them is set to zero.
    """
    at = np.asarray(group)
    phi = modes.vectors
    lam = float(modes.values[at].mean())
    own = phi[:, at]
    block = own.T @ (slope.stiffness @ own - (slope.mass @ own) * lam)
    d_lambda, turn = np.linalg.eigh((block + block.T) / 2)
    own = own @ turn
    dk = np.asarray(slope.stiffness @ own)
    dm = np.asarray(slope.mass @ own)
    load = dm * lam - dk
    others = np.delete(np.arange(modes.values.size), at)
    rest = phi[:, others] @ ((phi[:, others].T @ load) / (modes.values[others, None] - lam))
    root = np.full(at.size, lam)
    rest += Complement(pencil, modes, root, at.size).solve(load, root, BRANCHES)
    same = own.T @ dm
    mixed = -load.T @ rest - same * d_lambda
    gap = d_lambda - d_lambda[:, None]
    separate = np.abs(gap) > CLOSE * max(float(np.abs(d_lambda).max()), np.finfo(float).tiny)
    c = np.where(separate, mixed / np.where(separate, gap, 1.0), -0.5 * same)
    return own, d_lambda, np.asarray(rest + own @ c)
