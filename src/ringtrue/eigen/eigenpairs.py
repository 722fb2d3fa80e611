"""What an eigensolution returns.

Residual vectors: the static answer of the modes that are left out, as pseudo-modes behind the
modes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.eigen.pencil import Pencil


@dataclass(frozen=True, slots=True)
class ResidualLimits:
    """What is next to zero among eigenvalues.

    Attributes
    ----------
    shift : float
        Share of the shift.
    highest : float
        Share of the highest λ.
    """

    shift: float = 0.1
    highest: float = 1e-6


NEAR_ZERO = ResidualLimits()

# modes, and rows of a matrix, treated together
PIECE = 8
ROWS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class EigenModes(FrozenArrays):
    """Lowest solutions of K φ = λ M φ, ascending.

    Attributes
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass, largest component positive
    residuals : (m,) float64
        ‖Kφ − λMφ‖ / ‖Kφ‖; relative to ‖|K| |φ|‖ for modes with λ below the noise of K.
    orthogonality : float
        max |ΦᵀMΦ − I|.
    complete : bool
        The inertia counts agree with the number of modes found.
    proof : str
        What was counted, in words.
    shift : float
        Where K − σM is factorised.
    """

    values: Float
    vectors: Float
    residuals: Float
    orthogonality: float
    complete: bool
    proof: str
    shift: float

    @property
    def frequencies(self) -> Float:
        """(m,) Hz, sign(λ)·sqrt|λ|/2π."""
        return frequencies(self.values)


def rounding(
    stiffness: sparse.csr_array, modes: EigenModes, highest: float = 0.0
) -> tuple[float, int, int]:
    """How far the rounding of K may move a mode: what is far stiffer than the rest leaves
    no digits for that.

    The entries of K are taken to be off by independent errors of ε of their size. A mode of a λ
    that is small against the shift, as of a rigid body, is judged by the shift; one that is nothing
    but rounding is left out.

    Parameters
    ----------
    stiffness : (f, f) csr_array float64
    modes : EigenModes
    highest : float, Hz
        Up to where modes were asked for: their scale where all are of rigid bodies.

    Returns
    -------
    share : float
        Of λ, the largest of all modes.
    mode, row : int
        The mode, and the row of K that moves it most.
    """
    if not modes.values.size:
        return 0.0, 0, 0
    size = np.abs(modes.values)
    diagonal = stiffness.diagonal()
    energies = (
        diagonal * v**2 for v in modes.vectors.T
    )  # one at a time: vectors of large models fill the memory
    off = np.finfo(np.float64).eps * np.array([np.linalg.norm(e) for e in energies])
    top = float(size.max())
    wanted = eigenvalue(highest)
    top = wanted if top < NEAR_ZERO.highest * wanted < np.inf else top
    share = off / np.maximum(
        size, max(NEAR_ZERO.shift * abs(modes.shift), NEAR_ZERO.highest * top)
    )
    share = np.where(share < 1, share, 0.0)
    mode = int(share.argmax())
    return (
        float(share[mode]),
        mode,
        int(np.abs(diagonal * modes.vectors[:, mode] ** 2).argmax()),
    )


def frequencies(values: Float) -> Float:
    """Hz of eigenvalues (rad/s)², sign kept."""
    return np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)


def eigenvalue(frequency: float) -> float:
    """(rad/s)² of a frequency in Hz, sign kept."""
    return float(np.sign(frequency) * (2 * np.pi * frequency) ** 2)


def polish(
    stiffness: sparse.csr_array, mass: sparse.csr_array, values: Float, vectors: Float
) -> tuple[Float, Float, Float, float]:
    """Ascending order, exact unit modal mass, largest component positive; residuals and
    orthogonality.

    The values become Rayleigh quotients, whose error is quadratic: far from the shift, 1/θ has lost
    digits.

    Returns
    -------
    values (m,), vectors (f, m), residuals (m,), orthogonality
    """
    vectors = vectors[:, np.argsort(values, kind="stable")]
    for cut in _pieces(values.size):
        v = vectors[:, cut]
        top = np.take_along_axis(v, np.abs(v).argmax(axis=0)[None], axis=0)[0]
        v *= np.where(top < 0, -1.0, 1.0) / np.sqrt(np.einsum("ij,ij->j", v, mass @ v))
    values, residuals = np.empty(values.size), np.empty(values.size)
    gram = np.empty((values.size, values.size))
    for cut in _pieces(values.size):
        values[cut], residuals[cut], gram[:, cut] = _judged(
            stiffness, mass, vectors, cut
        )
    order = np.argsort(values, kind="stable")
    if (np.diff(order) < 0).any():
        values = values[order]
        vectors = vectors[:, order]
        residuals = residuals[order]
    gram[np.diag_indices(values.size)] -= 1
    return values, vectors, residuals, float(np.abs(gram).max(initial=0.0))


def _pieces(count: int) -> Iterator[slice]:
    """A few modes at a time: what is computed of each is as large as the mode."""
    for first in range(0, count, PIECE):
        yield slice(first, first + PIECE)


def _largest(a: sparse.csr_array, v: Float) -> Float:
    """‖|A| v‖ of each column of v, some rows of A at a time: |A| is as large as A."""
    total = np.zeros(v.shape[1])
    for first in range(0, a.shape[0], ROWS):
        ends = a.indptr[first : first + ROWS + 1]
        cut = slice(ends[0], ends[-1])
        part = sparse.csr_array(
            (np.abs(a.data[cut]), a.indices[cut], ends - ends[0]),
            shape=(ends.size - 1, a.shape[1]),
        )
        total += ((part @ v) ** 2).sum(axis=0)
    return np.sqrt(total)


def _judged(
    stiffness: sparse.csr_array, mass: sparse.csr_array, vectors: Float, cut: slice
) -> tuple[Float, Float, Float]:
    """Rayleigh quotients and residuals of some of the vectors, and ΦᵀM times them."""
    v = vectors[:, cut]
    kv = stiffness @ v
    mv = mass @ v
    values = np.einsum("ij,ij->j", v, kv)
    size = np.linalg.norm(kv, axis=0)
    floor = 1e-8 * _largest(stiffness, np.abs(v))
    rest = np.linalg.norm(kv - mv * values, axis=0)
    residuals = rest / np.where(
        size > floor, size, np.maximum(floor * 1e8, np.finfo(float).tiny)
    )
    return values, residuals, vectors.T @ mv


RANK = 1e-10  # relative size under which a direction adds nothing


def residual_vectors(
    pencil: Pencil, modes: EigenModes, loads: Float
) -> tuple[Float, Float]:
    """The modes, and one pseudo-mode for each independent load, M- and K-orthogonal to them and to
    each other.

    The space of (K − σM)⁻¹F without its part in the modes (Dickens, Nakagawa and Wittbrodt 1997; σ
    is the shift of the modes, so that free structures need no inertia relief).

    Parameters
    ----------
    pencil : Pencil
    modes : EigenModes
        All modes from the lowest up.
    loads : (f, k) float64

    Returns
    -------
    values (n,), vectors (f, n) float64, mass-normalised
        The m modes first, then the pseudo-modes in ascending order.
    """
    phi = modes.vectors
    x = pencil.at(modes.shift).solve(np.ascontiguousarray(loads, dtype=np.float64))
    whole = np.sqrt(np.abs(np.einsum("ij,ij->j", x, pencil.mass @ x)))
    loaded = pencil.mass @ phi
    for _ in range(2):  # twice is enough
        x = x - phi @ (loaded.T @ x)
    left = np.sqrt(np.abs(np.einsum("ij,ij->j", x, pencil.mass @ x)))
    x = x[:, left > RANK * whole] / left[left > RANK * whole]
    k = x.T @ (pencil.stiffness @ x)
    m = x.T @ (pencil.mass @ x)
    share, turn = linalg.eigh((m + m.T) / 2)
    keep = share > RANK * share.max(initial=0.0)
    basis = turn[:, keep] / np.sqrt(share[keep])
    k = basis.T @ k @ basis
    values, y = linalg.eigh((k + k.T) / 2)
    return np.concatenate([modes.values, values]), np.hstack([phi, x @ (basis @ y)])
