"""Dense eigensolution of small matrices, in the inverted form that keeps the low modes exact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import NumericalError, SingularModel

Labels = Callable[[Int], list[str]]
HINT = (
    "look for a mechanism without mass or a DOF without stiffness there, and hold it or give "
    "it inertia"
)
LOOSE = f"a motion has neither stiffness nor mass (a mechanism): {HINT}"
MASSLESS = 1e-9  # share of the usual mass of a DOF under which a motion counts as without mass
NO_ENERGY = 1e-13  # of the energy that its DOFs would have alone: a motion is without stiffness
NEGATIVE = 1e-6  # share of the usual mass of a DOF beyond which less than nothing is not rounding
PIECE = 100_000  # rows looked at in one piece
DENSE_SIZE = 400  # rows up to which the dense solution is used
# it is faster for more of the modes of up to so many rows, in 500 MB (measured)
DENSE_SHARE = 0.25
DENSE_LIMIT = 2000


def named_rows(rows: Int) -> list[str]:
    """Names of rows that have no others."""
    return [f"row {i}" for i in rows.tolist()]


def spectrum(
    stiffness: sparse.csr_array, mass: sparse.csr_array, shift: float, labels: Labels = named_rows
) -> tuple[Float, Float]:
    """All finite eigenpairs of K φ = λ M φ from M φ = θ (K − σM) φ, λ = σ + 1/θ; M may be singular.

    Parameters
    ----------
    stiffness, mass : (f, f) csr_array float64
    shift : float
        σ below every λ, so that K − σM is positive definite.
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.

    Returns
    -------
    values : (k,) float64, ascending
    vectors : (f, k) float64, M-orthonormal

    Raises
    ------
    SingularModel
        If K − σM is not positive definite, or is so by rounding only; the rows that move most are
        named.
    NumericalError
        If that is so because the mass is negative.
    """
    k = stiffness.toarray()
    m = mass.toarray()
    a = k - shift * m
    d = 1 / np.sqrt(
        np.where(np.diag(a) > 0, np.diag(a), 1.0)
    )  # scaled first: units differ by decades
    scale = d * d[:, None]
    try:
        theta, y = linalg.eigh(m * scale, a * scale)
    except linalg.LinAlgError:
        refuse_negative_mass(mass, labels)
        refuse_negative_motion(mass, _least(m), labels)
        why = (
            f"K - ({shift:.3g}) M is not positive definite: a stiffness below 0 outweighs the "
            f"others, or {HINT}"
        )
        raise SingularModel(labels(_loose(a * scale, d)), why) from None
    moved = d[:, None] * y  # of unit energy: long where there is next to none
    refuse_negative_motion(mass, moved[:, 0], labels)
    loose = (y**2).sum(axis=0) * NO_ENERGY > 1
    loose &= np.abs(theta) <= MASSLESS * usual_mass(mass) * (moved**2).sum(axis=0)
    if loose.any():
        raise SingularModel(labels(_most(moved[:, np.argmax(loose)])), LOOSE)
    theta = theta[::-1]
    vectors = moved[:, ::-1]
    modal = np.einsum("ij,ij->j", vectors, m @ vectors)  # θ again, where θ is more than rounding
    finite = (theta > 1e-13 * theta[0]) & (np.abs(modal - theta) < 0.1 * theta)
    theta = theta[finite]
    vectors = vectors[:, finite]
    return shift + 1 / theta, vectors / np.sqrt(modal[finite])


def _least(m: Float) -> Float:
    """The motion (f,) of least mass, each row in the scale of its own mass."""
    own = np.abs(np.diag(m))
    d = 1 / np.sqrt(np.where(own > 0, own, 1.0))
    return np.asarray(d * linalg.eigh(m * d * d[:, None], subset_by_index=(0, 0))[1][:, 0])


def _loose(a: Float, d: Float) -> Int:
    """Rows that move most where the scaled matrix has its lowest eigenvalue; at most six."""
    return _most(d * linalg.eigh(a, subset_by_index=(0, 0))[1][:, 0])


def _most(motion: Float) -> Int:
    """Rows that move most; at most six."""
    moved = np.abs(motion)
    order = np.argsort(-moved, kind="stable")[:6]
    return np.asarray(order[moved[order] > 0.1 * moved.max()])


def usual_mass(mass: sparse.csr_array) -> float:
    """The median mass of the DOFs that have one; 0 if there are none."""
    m = mass.diagonal()
    return float(np.median(m[m > 0])) if (m > 0).any() else 0.0


def refuse_negative_mass(mass: sparse.csr_array, labels: Labels) -> None:
    """A mass matrix with a negative entry on its diagonal, or a negative minor of two rows, has no
    modes.

    In pieces of rows: what is made of all entries would be larger than the matrix.

    Raises
    ------
    NumericalError
        With the rows.
    """
    m = mass.diagonal()
    usual = NEGATIVE * usual_mass(mass)
    found = [np.flatnonzero(m < -usual)]
    size = np.clip(m, 0.0, None)
    for first in range(0, m.size, PIECE):
        block = mass[first : first + PIECE].tocoo()
        i = block.row + first
        j = block.col
        wrong = (i < j) & (block.data**2 > (1 + NEGATIVE) * size[i] * size[j] + usual**2)
        found += [i[wrong], j[wrong]]
    _refuse(np.unique(np.concatenate(found)).astype(np.int64), labels)


def refuse_negative_motion(mass: sparse.csr_array, motion: Float, labels: Labels) -> None:
    """A motion (f,) whose mass is negative by more than rounding, of however many rows, is refused
    as well.

    Raises
    ------
    NumericalError
        With the rows that make it so.
    """
    part = motion * (mass @ motion)
    size = np.abs(motion)
    usual = usual_mass(mass) * float((motion[mass.diagonal() != 0] ** 2).sum())
    if part.sum() < -NEGATIVE * (size @ (abs(mass) @ size) + usual):
        rows = np.argsort(part, kind="stable")[:6]
        _refuse(np.sort(rows[part[rows] < 0.1 * part.min()]), labels)


def _refuse(rows: Int, labels: Labels) -> None:
    if rows.size:
        names = " ".join(labels(rows[:6]))
        raise NumericalError(
            f"mass or inertia is negative in some direction at {names}: check its signs"
        )
