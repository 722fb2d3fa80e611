"""A sparse symmetric factorisation with inertia, behind one small port.

PARDISO's LDLᵀ is the engine; a dense LDLᵀ serves small matrices; SuperLU is the last resort (no inertia).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Literal, Protocol

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import InputError, SingularModel

Method = Literal["auto", "pardiso", "superlu", "dense"]
Labels = Callable[[Int], list[str]]
DENSE_LIMIT = 300  # rows up to which a dense LDLᵀ is as fast as a sparse one
RESIDUAL_LIMIT = 1e-4  # of a probing solve (LDLᵀ without full pivoting reaches 1e-8 on ill-scaled shells)
LOST = 0.1  # error of a probing solve (solution of order 1) on perturbed pivots: they were zero
# METIS; perturb pivots below 1e-13; no scaling or matching, so that one analysis serves every shift; Bunch-Kaufman
_IPARM = {1: 2, 9: 13, 10: 0, 12: 0, 20: 1}
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


class _Dense:
    def __init__(self, pattern: _Pattern, values: Float) -> None:
        upper = pattern.matrix(values).toarray()
        full = upper + np.triu(upper, 1).T
        size = np.sqrt(np.abs(full).max(axis=1))  # scaled first: rotations and translations differ by decades
        self._scale = 1 / np.where(size > 0, size, 1.0)
        scaled = full * self._scale * self._scale[:, None]
        spectrum = linalg.eigvalsh(scaled)
        self.negatives = int((spectrum < 0).sum())
        self.singular = bool(np.abs(spectrum).min() <= 1e-15 * np.abs(spectrum).max())
        self._lu = linalg.lu_factor(scaled, check_finite=False) if not self.singular else None

    def solve(self, rhs: Any_) -> Float:
        d = self._scale if rhs.ndim == 1 else self._scale[:, None]
        assert self._lu is not None
        return np.asarray(d * linalg.lu_solve(self._lu, d * rhs))

    def close(self) -> None:
        self._lu = None


class _SuperLu:
    negatives = -1
    singular = False

    def __init__(self, pattern: _Pattern, values: Float) -> None:
        upper = pattern.matrix(values)
        full = sparse.csc_array(upper + sparse.triu(upper, 1).T)
        try:
            self._lu = splu(full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options={"SymmetricMode": True})
        except RuntimeError:  # "Factor is exactly singular"
            self.singular = True

    def solve(self, rhs: Any_) -> Float:
        return np.asarray(self._lu.solve(np.ascontiguousarray(rhs, dtype=np.float64)))

    def close(self) -> None:
        del self._lu


class _Pardiso:
    singular = False

    def __init__(self, pattern: _Pattern, values: Float) -> None:
        from pymklpardiso import MTYPE_REAL_SYM_INDEF, PardisoSolver

        self._solver = PardisoSolver(pattern.matrix(values), MTYPE_REAL_SYM_INDEF, iparms=_IPARM)

    @property
    def negatives(self) -> int:
        return int(self._solver.get_iparm_value(22)) if not self._solver.get_iparm_value(13) else -1

    def refactor(self, values: Float) -> None:
        self._solver.refactor(values)

    def strengthen(self, values: Float) -> None:
        """Once more with scaling and weighted matching: slower, for matrices that plain pivoting cannot treat."""
        self._solver.set_iparm(10, 1)
        self._solver.set_iparm(12, 1)
        self._solver.factor(values)

    def solve(self, rhs: Any_) -> Float:
        return np.asarray(self._solver.solve(np.asfortranarray(rhs, dtype=np.float64)))

    def close(self) -> None:
        self._solver.release()


class _Pattern:
    """The upper triangle, with a full diagonal, of the union of the patterns of some symmetric matrices."""

    def __init__(self, *matrices: sparse.csr_array) -> None:
        self.size = int(matrices[0].shape[0])
        union = sparse.eye_array(self.size, format="csr")
        for a in matrices:
            upper = sparse.csr_array(sparse.triu(a, format="csr"))
            union = union + sparse.csr_array((np.ones(upper.data.size), upper.indices, upper.indptr), shape=a.shape)
        union.sort_indices()
        self.indices, self.indptr = union.indices.astype(np.int32), union.indptr.astype(np.int32)
        row = np.repeat(np.arange(self.size), np.diff(self.indptr))
        self._all = row * self.size + self.indices

    def values(self, a: sparse.csr_array) -> Float:
        """The entries of `a` on this pattern."""
        coo = sparse.triu(a, format="coo")
        coo.sum_duplicates()
        out = np.zeros(self._all.size)
        out[np.searchsorted(self._all, coo.row.astype(np.int64) * self.size + coo.col)] = coo.data
        return out

    def matrix(self, values: Float) -> sparse.csr_array:
        """Upper triangle with these entries."""
        return sparse.csr_array((values, self.indices, self.indptr), shape=(self.size, self.size))


def _symmetric(a: sparse.csr_array, name: str) -> sparse.csr_array:
    a = sparse.csr_array(a).astype(np.float64)
    if a.shape[0] != a.shape[1]:
        raise InputError(f"{name} is {a.shape}: it must be square")
    if not np.isfinite(a.data).all():
        raise InputError(f"{name} has {int((~np.isfinite(a.data)).sum())} entries that are not finite")
    return a


class Pencil:
    """K and M on one sparsity pattern; holds one factorisation of K − σM, which moves with the shift.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
        Symmetric, both triangles; the mass may be singular.
    method : {"auto", "pardiso", "superlu", "dense"}
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
        self.stiffness, self.mass = _symmetric(stiffness, "the stiffness"), _symmetric(mass, "the mass")
        if self.mass.shape != self.stiffness.shape:
            raise InputError(f"stiffness {self.stiffness.shape} and mass {self.mass.shape} differ in size")
        self.method = _choose(method, self.size)
        self.labels: Labels = labels or (lambda rows: [f"row {i}" for i in rows.tolist()])
        self._pattern = _Pattern(self.stiffness, self.mass)
        self._k, self._m = self._pattern.values(self.stiffness), self._pattern.values(self.mass)
        self._factor: _Dense | _SuperLu | _Pardiso | None = None
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
        values = self._k - shift * self._m
        factor = self._make(values)
        self._factor, self.shift = factor, shift
        error, moved = self._probe(factor, shift)
        if isinstance(factor, _Pardiso) and not (error < RESIDUAL_LIMIT and factor.negatives >= 0):
            factor.strengthen(values)
            error, moved = self._probe(factor, shift)
        lost = not error < RESIDUAL_LIMIT or (factor.negatives < 0 and moved.max(initial=0.0) > LOST)
        if lost:
            self._factor = None
            raise SingularModel(
                self.labels(np.argsort(-moved)[:6]),
                f"a solve with K - ({shift:.3g}) M left a residual of {error:.1e}, an error of {moved.max():.1e}; "
                "look for a mechanism without mass, or a DOF without stiffness",
            )
        return factor

    def _make(self, values: Float) -> _Dense | _SuperLu | _Pardiso:
        if isinstance(self._factor, _Pardiso):
            self._factor.refactor(values)
            return self._factor
        if self.method == "dense":
            return _Dense(self._pattern, values)
        return _Pardiso(self._pattern, values) if self.method == "pardiso" else _SuperLu(self._pattern, values)

    def _probe(self, factor: _Dense | _SuperLu | _Pardiso, shift: float) -> tuple[float, Float]:
        """The residual of a solve with a known random solution, relative, and its error (f,)."""
        if factor.singular:
            rows, self._factor = self._empty_rows(), None
            raise SingularModel(self.labels(rows), f"K - ({shift:.3g}) M cannot be factorised")
        x = np.random.default_rng(0).standard_normal(self.size)
        rhs = self.stiffness @ x - shift * (self.mass @ x)
        y = factor.solve(rhs)
        rest = self.stiffness @ y - shift * (self.mass @ y) - rhs
        size = np.abs(rhs).max(initial=np.finfo(float).tiny)
        return float(np.abs(rest).max(initial=0.0) / size), np.abs(np.nan_to_num(y - x))

    def _empty_rows(self) -> Int:
        k = abs(self.stiffness).sum(axis=1)
        return np.flatnonzero(k <= 1e-14 * k.max())

    def close(self) -> None:
        """Free the factorisation."""
        if self._factor is not None:
            self._factor.close()
        self._factor, self.shift = None, np.nan


def _choose(method: Method, size: int) -> Method:
    allowed = ("auto", "pardiso", "superlu", "dense")
    if method not in allowed:
        raise InputError(f"factorisation method {method!r}; allowed are {', '.join(allowed)}")
    if method != "auto":
        return method
    if size <= DENSE_LIMIT:
        return "dense"
    try:
        import pymklpardiso  # noqa: F401
    except ImportError:
        log.warning("pymklpardiso is not installed: SuperLU is slower and cannot prove completeness")
        return "superlu"
    return "pardiso"


def factorise(matrix: sparse.csr_array, *, method: Method = "auto") -> Factor:
    """Factorise a real symmetric (f, f) matrix given with both triangles.

    Raises
    ------
    SingularModel
        If the matrix is singular to working precision.
    """
    empty = sparse.csr_array(matrix.shape, dtype=np.float64)
    return Pencil(matrix, empty, method=method).at(0.0)
