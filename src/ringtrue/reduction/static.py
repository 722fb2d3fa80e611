"""Static condensation of Guyan (1965) and component modes of Craig and Bampton (1968), over one
sparse factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int, freeze_fields
from ringtrue.core.progress import Progress
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Labels, Pencil
from ringtrue.errors import InputError

CHUNK = 64  # right-hand sides solved at once


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """K and M over kept DOFs and fixed-interface modes.

    Attributes
    ----------
    stiffness, mass : (r, r) float64, symmetric
        r = b + n: the kept DOFs in the order given, then the modal coordinates.
    transform : (f, r) float64
        All DOFs by the reduced ones.
    kept : (b,) int64
        Rows of the full matrices.
    frequencies : (n,) float64, Hz
        Of the modes with the kept DOFs held; empty for Guyan.
    """

    stiffness: Float
    mass: Float
    transform: Float
    kept: Int
    frequencies: Float

    def __post_init__(self) -> None:
        floats = ("stiffness", "mass", "transform", "frequencies")
        freeze_fields(self, kept=np.int64, **dict.fromkeys(floats, np.float64))


def guyan(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    master: Any_,
    *,
    labels: Labels | None = None,
) -> Condensed:
    """Condense onto the DOFs `master`; exact in statics, the other DOFs move without inertia of
    their own.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    master : (b,) int, rows to keep
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.

    Raises
    ------
    InputError
        If a row is named twice, or absent.
    SingularModel
        If the structure can move while `master` is held.
    """
    return craig_bampton(stiffness, mass, master, 0, labels=labels)


def craig_bampton(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    boundary: Any_,
    count: int,
    *,
    labels: Labels | None = None,
    progress: Progress | None = None,
) -> Condensed:
    """Condense onto the DOFs `boundary` and the `count` lowest modes with these held.

    Constraint modes Ψ = -K_ii⁻¹ K_ib and normal modes Φ of (K_ii, M_ii); u_i = Ψ u_b + Φ q.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    boundary : (b,) int, rows to keep
    count : int
        Modes, of unit modal mass; fewer where the mass has a lower rank.
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.
    progress : callable, optional
        Called with (share done, what) by the eigensolution.

    Raises
    ------
    InputError
        If a row is named twice, or absent, or the count is negative.
    SingularModel
        If the structure can move while `boundary` is held.
    """
    size = int(stiffness.shape[0])
    kept = _rows(boundary, size)
    if count < 0:
        raise InputError(f"{count} modes asked for; at least 0")
    inner = np.setdiff1d(np.arange(size), kept)
    transform = np.zeros((size, kept.size))
    transform[kept, np.arange(kept.size)] = 1.0
    frequencies = np.zeros(0)
    if inner.size:
        K, M = (sparse.csr_array(A)[inner][:, inner] for A in (stiffness, mass))
        names: Labels | None = (lambda rows: labels(inner[rows])) if labels is not None else None
        pencil = Pencil(K, M, labels=names)
        try:
            transform[inner] = _constraint_modes(
                pencil, sparse.csr_array(stiffness)[inner][:, kept]
            )
            if count:
                modes = solve_modes(pencil, count, progress=progress)
                frequencies = modes.frequencies
                normal = np.zeros((size, modes.values.size))
                normal[inner] = modes.vectors
                transform = np.concatenate([transform, normal], axis=1)
        finally:
            pencil.close()
    k, m = (_projected(transform, A) for A in (stiffness, mass))
    return Condensed(k, m, transform, kept, frequencies)


def _rows(rows: Any_, size: int) -> Int:
    out = np.atleast_1d(np.asarray(rows, dtype=np.int64))
    if out.size and (out.min() < 0 or out.max() >= size):
        raise InputError(
            f"row {out[(out < 0) | (out >= size)][0]} is to be kept; allowed are 0 to {size - 1}"
        )
    if np.unique(out).size != out.size:
        raise InputError("a row to be kept is named twice")
    return out


def _constraint_modes(pencil: Pencil, K_ib: sparse.csr_array) -> Float:
    """-K_ii⁻¹ K_ib, a few columns at a time (K_ib is sparse, its dense copy need not exist at
    once).
    """
    factor = pencil.at(0.0)
    out = np.zeros(K_ib.shape)
    columns = K_ib.tocsc()
    for first in range(0, K_ib.shape[1], CHUNK):  # of right-hand sides
        block = slice(first, first + CHUNK)
        out[:, block] = -factor.solve(columns[:, block].toarray()).reshape(K_ib.shape[0], -1)
    return out


def _projected(T: Float, A: sparse.csr_array) -> Float:
    B = T.T @ (A @ T)
    return np.asarray((B + B.T) / 2)
