"""The pencil K − σM: one sparsity pattern, one factorisation with inertia that moves with the
shift.

PARDISO's LDLᵀ is the engine, rslab's where there is no MKL; a dense one serves small matrices;
SuperLU is the last resort. `engines` holds them.
"""

from __future__ import annotations

import logging
from typing import Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.eigen import memory
from ringtrue.eigen.dense import HINT, LOOSE, MASSLESS, NO_ENERGY, named_rows, usual_mass
from ringtrue.eigen.dense import Labels as Labels
from ringtrue.eigen.engines import Engine, Method, Pattern, choose
from ringtrue.eigen.engines import factorise as engine
from ringtrue.errors import InputError, SingularModel

RESIDUAL_LIMIT = (
    1e-4  # of a probing solve (LDLᵀ without full pivoting reaches 1e-8 on ill-scaled shells)
)
LOST = 0.1  # error of a probing solve (solution of order 1) on perturbed pivots: they were zero
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
    limit : int, optional
        Bytes of memory that a step may take; what is free on the machine if not given.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: sparse.csr_array,
        *,
        method: Method = "auto",
        labels: Labels | None = None,
        limit: int | None = None,
    ) -> None:
        self.stiffness = _symmetric(stiffness, "the stiffness")
        self.mass = _symmetric(mass, "the mass")
        if self.mass.shape != self.stiffness.shape:
            raise InputError(
                f"stiffness {self.stiffness.shape} and mass {self.mass.shape} differ in size"
            )
        self.method = choose(method, self.size)
        self._limit = limit
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
        values = self._pattern.values(
            self.stiffness
        )  # anew for each shift: they take as much room as the matrix
        values[self._m[0]] -= shift * self._m[1]
        factor = self._make(values)
        self._factor = factor
        self.shift = shift
        error, moved = self._probe(factor, shift)
        if not (error < RESIDUAL_LIMIT and factor.negatives >= 0) and factor.strengthen(values):
            self._strengthened = True
            error, moved = self._probe(factor, shift)
        if not error < RESIDUAL_LIMIT or (factor.negatives < 0 and moved.max(initial=0.0) > LOST):
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

    def _make(self, values: Float) -> Engine:
        if self._strengthened:  # for one shift alone: a factor must not depend on those before it
            self.close()
        if self._factor is None:
            return engine(self.method, self._pattern, values, self._limit)
        self._factor.refactor(values)
        return self._factor

    @property
    def factor_bytes(self) -> int:
        """Memory of the factor, as predicted by the analysis; 0 before the first one or if
        unknown.
        """
        return 0 if self._factor is None else self._factor.bytes

    def reserve(self, columns: int) -> None:
        """Foresee the memory of so many vectors.

        Raises
        ------
        OutOfMemory
        """
        memory.require(
            8 * self.size * columns,
            f"the basis of {columns} vectors of {self.size} DOFs",
            self._limit,
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
