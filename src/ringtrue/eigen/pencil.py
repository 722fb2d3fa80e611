"""The pencil K − σM: one sparsity pattern, one factorisation with inertia that moves with the
shift.

PARDISO's LDLᵀ is the engine, rslab's where there is no MKL; a dense one serves small matrices;
SuperLU is the last resort. `engines` holds them.

Dense eigensolution of small matrices, in the inverted form that keeps the low modes exact.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.eigen import memory
from ringtrue.eigen.engines import Engine, Method, Pattern, Values, choose
from ringtrue.eigen.engines import factorise as engine
from ringtrue.errors import InputError, NumericalError, SingularModel

Labels = Callable[[Int], list[str]]
HINT = (
    "look for a mechanism without mass or a DOF without stiffness there, and hold it or give "
    "it inertia"
)
LOOSE = f"a motion has neither stiffness nor mass (a mechanism): {HINT}"
# share of the usual mass of a DOF under which a motion counts as without mass
MASSLESS = 1e-9
# of the energy that its DOFs would have alone: a motion is without stiffness
NO_ENERGY = 1e-13
# share of the usual mass of a DOF beyond which less than nothing is not rounding
NEGATIVE = 1e-6
PIECE = 100_000  # rows looked at in one piece


@dataclass(frozen=True, slots=True)
class DenseSizes:
    """When the dense solution is used.

    Attributes
    ----------
    always : int
        Rows up to which it is used.
    share : float
        Share of the modes from which on it is faster
    limit : int
        up to so many rows, in 500 MB (measured).
    """

    always: int = 400
    share: float = 0.25
    limit: int = 2000


SIZES = DenseSizes()


def named_rows(rows: Int) -> list[str]:
    """Names of rows that have no others."""
    return [f"row {i}" for i in rows.tolist()]


def spectrum(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    shift: float,
    labels: Labels = named_rows,
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
    # scaled first: units differ by decades
    d = 1 / np.sqrt(np.where(np.diag(a) > 0, np.diag(a), 1.0))
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
    # θ again, where θ is more than rounding
    modal = np.einsum("ij,ij->j", vectors, m @ vectors)
    finite = (theta > 1e-13 * theta[0]) & (np.abs(modal - theta) < 0.1 * theta)
    theta = theta[finite]
    vectors = vectors[:, finite]
    return shift + 1 / theta, vectors / np.sqrt(modal[finite])


def _least(m: Float) -> Float:
    """The motion (f,) of least mass, each row in the scale of its own mass."""
    own = np.abs(np.diag(m))
    d = 1 / np.sqrt(np.where(own > 0, own, 1.0))
    return d * linalg.eigh(m * d * d[:, None], subset_by_index=(0, 0))[1][:, 0]


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
        wrong = (i < j) & (
            block.data**2 > (1 + NEGATIVE) * size[i] * size[j] + usual**2
        )
        found += [i[wrong], j[wrong]]
    _refuse(np.unique(np.concatenate(found)).astype(np.int64), labels)


def refuse_negative_motion(
    mass: sparse.csr_array, motion: Float, labels: Labels
) -> None:
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


# of a probing solve (LDLᵀ without full pivoting reaches 1e-8 on ill-scaled shells)
RESIDUAL_LIMIT = 1e-4
# error of a probing solve (solution of order 1) on perturbed pivots: they were zero
LOST = 0.1
log = logging.getLogger(__name__)


class Factor(Protocol):
    """A factorised real symmetric matrix."""

    @property
    def negatives(self) -> int:
        """Number of negative eigenvalues, -1 where the method cannot tell."""
        ...

    def solve(self, rhs: Any_) -> Float:
        """A⁻¹ rhs for rhs (f,) or (f, k) float64."""
        ...

    def close(self) -> None:
        """Free the memory."""
        ...


def _symmetric(a: sparse.csr_array, name: str) -> sparse.csr_array:
    a = sparse.csr_array(a).astype(np.float64, copy=False)
    if a.shape[0] != a.shape[1]:
        raise InputError(f"{name} is {a.shape}: it must be square")
    if not np.isfinite(a.data).all():
        raise InputError(
            f"{name} has {int((~np.isfinite(a.data)).sum())} entries that are not finite"
        )
    return a


class Pencil:
    """K and M on one sparsity pattern; holds one factorisation of K − σM, which moves with the
    shift.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
        Symmetric, both triangles; the mass may be singular.
    method : {"auto", "pardiso", "rslab", "superlu", "dense"}
    labels : callable, optional
        Names of rows for errors, (k,) int64 -> list of str.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: sparse.csr_array,
        *,
        method: Method = "auto",
        labels: Labels | None = None,
    ) -> None:
        self.stiffness = _symmetric(stiffness, "the stiffness")
        self.mass = _symmetric(mass, "the mass")
        if self.mass.shape != self.stiffness.shape:
            raise InputError(
                f"stiffness {self.stiffness.shape} and mass {self.mass.shape} differ in size"
            )
        self.method = choose(method, self.size)
        if self.method == "superlu":
            log.warning(
                "neither pymklpardiso nor rslab is used: SuperLU is slower and takes more memory"
            )
        self.labels: Labels = labels or named_rows
        self._pattern = Pattern(self.stiffness, self.mass)
        self._m = self._pattern.entries(self.mass)
        self._factor: Engine | None = None
        self._strengthened = False
        self.shift = np.nan

    def __getstate__(self) -> dict[str, object]:
        """Without the factor, which is of this process; another makes it anew."""
        return self.__dict__ | {
            "_factor": None,
            "_strengthened": False,
            "shift": np.nan,
        }

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.stiffness.shape[0])

    def at(self, shift: float) -> Factor:
        """The factorisation of K − shift·M; the one before it is gone.

        Raises
        ------
        SingularModel
            If a probing solve shows that the matrix is singular; the rows that move most are named.
        """
        if self._factor is not None and shift == self.shift:
            return self._factor

        def values() -> Float:
            out = self._pattern.values(self.stiffness)
            out[self._m[0]] -= shift * self._m[1]
            return out

        factor = self._make(values)
        self._factor = factor
        self.shift = shift
        error, moved = self._probe(factor, shift)
        if not (error < RESIDUAL_LIMIT and factor.negatives >= 0) and factor.strengthen(
            values
        ):
            self._strengthened = True
            error, moved = self._probe(factor, shift)
        if not error < RESIDUAL_LIMIT or (
            factor.negatives < 0 and moved.max(initial=0.0) > LOST
        ):
            self._factor = None
            raise SingularModel(
                self.labels(np.argsort(-moved)[:6]),
                f"a solve with K - ({shift:.3g}) M left a residual of {error:.1e}, an error of "
                f"{moved.max():.1e}; "
                f"{HINT}",
            )
        if (rows := self._mechanism(factor, shift)).size:
            self._factor = None
            raise SingularModel(self.labels(rows), LOOSE)
        return factor

    def _make(self, values: Values) -> Engine:
        # for one shift alone: a factor must not depend on those before it
        if self._strengthened:
            self.close()
        if self._factor is None:
            return engine(self.method, self._pattern, values)
        self._factor.refactor(values)
        return self._factor

    def reserve(self, columns: int) -> None:
        """Foresee the memory of so many vectors.

        Raises
        ------
        OutOfMemory
        """
        memory.require(
            8 * self.size * columns,
            f"the basis of {columns} vectors of {self.size} DOFs",
        )

    def _probe(self, factor: Engine, shift: float) -> tuple[float, Float]:
        """The residual of a solve with a known random solution, relative, and its error (f,)."""
        if factor.singular:
            rows = self._empty_rows()
            self._factor = None
            rows = rows if rows.size else factor.weak
            raise SingularModel(
                self.labels(rows), f"K - ({shift:.3g}) M cannot be factorised: {HINT}"
            )
        x = np.random.default_rng(0).standard_normal(self.size)
        rhs = self.stiffness @ x - shift * (self.mass @ x)
        y = factor.solve(rhs)
        rest = self.stiffness @ y - shift * (self.mass @ y) - rhs
        size = np.abs(rhs).max(initial=np.finfo(float).tiny)
        return float(np.abs(rest).max(initial=0.0) / size), np.abs(np.nan_to_num(y - x))

    def _mechanism(self, factor: Engine, shift: float) -> Int:
        """Rows of a motion without stiffness and mass, found by one inverse iteration; empty if
        there is none.

        Rounding may leave such a matrix a tiny pivot of either sign, which neither a residual nor
        the inertia shows.
        """
        x = factor.solve(np.random.default_rng(1).standard_normal(self.size))
        x = x / np.abs(x).max(initial=np.finfo(float).tiny)
        k = self.stiffness.diagonal()
        m = self.mass.diagonal()
        if x @ (self.mass @ x) > MASSLESS * usual_mass(self.mass) * (x @ x):
            return np.empty(0, dtype=np.int64)
        energy = abs(x @ (self.stiffness @ x)) + abs(shift) * (x @ (self.mass @ x))
        loose = energy <= NO_ENERGY * float(x**2 @ (np.abs(k) + abs(shift) * m))
        order = np.argsort(-np.abs(x), kind="stable")[:6]
        return order[np.abs(x[order]) > 0.1] if loose else order[:0]

    def _empty_rows(self) -> Int:
        k = abs(self.stiffness).sum(axis=1)
        return np.flatnonzero(k <= 1e-14 * k.max())

    def close(self) -> None:
        """Free the factorisation."""
        if self._factor is not None:
            self._factor.close()
        self._factor = None
        self.shift = np.nan
        self._strengthened = False


def factorise(matrix: sparse.csr_array, *, method: Method = "auto") -> Factor:
    """Factorise a real symmetric (f, f) matrix given with both triangles.

    Raises
    ------
    SingularModel
        If the matrix is singular to working precision.
    """
    empty = sparse.csr_array(matrix.shape, dtype=np.float64)
    return Pencil(matrix, empty, method=method).at(0.0)
