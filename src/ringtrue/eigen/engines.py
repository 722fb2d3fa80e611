"""One sparsity pattern for several symmetric matrices.

Factorisations of symmetric matrices: PARDISO, rslab, SuperLU and a dense one, in one shape.

Real matrices and complex symmetric ones (A = Aᵀ). Each engine analyses the pattern once, says how
much memory the factor takes before it is made, and factorises again for other values on the same
pattern.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, Protocol

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from ringtrue.core.arrays import Any_, Int
from ringtrue.eigen import memory
from ringtrue.errors import InputError, NumericalError, OutOfMemory


def upper(a: sparse.csr_array) -> sparse.csr_array:
    """The upper triangle, the diagonal included, with sorted columns; `a` is left as it is."""
    if not a.has_canonical_format:
        a = a.copy()
        a.sum_duplicates()
    row = np.repeat(np.arange(a.shape[0], dtype=a.indices.dtype), np.diff(a.indptr))
    keep = a.indices >= row
    del row
    ends = np.zeros(keep.size + 1, dtype=a.indptr.dtype)
    np.cumsum(keep, out=ends[1:])
    ends = ends[a.indptr]
    return sparse.csr_array((a.data[keep], a.indices[keep], ends), shape=a.shape)


class Pattern:
    """The upper triangle, with a full diagonal, of the union of the patterns of some symmetric
    matrices.

    Attributes
    ----------
    size : int
        Rows.
    indices, indptr : int32
        Rows of the triangle, columns ascending (equally: columns of the lower triangle).
    """

    def __init__(self, *matrices: sparse.csr_array) -> None:
        self.size = int(matrices[0].shape[0])
        union = sparse.eye_array(self.size, format="csr", dtype=np.int8)
        for a in matrices:
            u = upper(a)
            ones = sparse.csr_array(
                (np.ones(u.data.size, np.int8), u.indices, u.indptr), shape=a.shape
            )
            union = sparse.csr_array(union + ones)
        union.sort_indices()
        self.indices = union.indices.astype(np.int32)
        self.indptr = union.indptr.astype(np.int64)
        if self.indptr[-1] < np.iinfo(np.int32).max:
            self.indptr = self.indptr.astype(np.int32)

    def _keys(self, indices: Any_, indptr: Any_) -> Int:
        row = np.repeat(np.arange(self.size, dtype=np.int64), np.diff(indptr))
        return row * self.size + indices

    def entries(self, a: sparse.csr_array) -> tuple[Int | slice, Any_]:
        """Where the upper triangle of `a` stands in this pattern, and its values."""
        u = upper(a)
        if u.indices.size == self.indices.size:
            return slice(None), u.data
        at = np.searchsorted(
            self._keys(self.indices, self.indptr), self._keys(u.indices, u.indptr)
        )
        return at.astype(
            np.int32 if self.indices.size < np.iinfo(np.int32).max else np.int64
        ), u.data

    def values(self, a: sparse.csr_array) -> Any_:
        """The entries of `a` on this pattern."""
        at, data = self.entries(a)
        if isinstance(at, slice) and data.dtype.kind in "fc":
            return data  # a copy of what the matrix holds
        out = np.zeros(self.indices.size, dtype=np.result_type(data.dtype, np.float64))
        out[at] = data
        return out

    def matrix(self, values: Any_) -> sparse.csr_array:
        """Upper triangle with these entries."""
        return sparse.csr_array(
            (values, self.indices, self.indptr), shape=(self.size, self.size)
        )


Method = Literal["auto", "pardiso", "rslab", "superlu", "dense"]
METHODS: tuple[Method, ...] = ("auto", "pardiso", "rslab", "superlu", "dense")
PACKAGES = {"pardiso": "pymklpardiso", "rslab": "rslab"}
DENSE_LIMIT = 300  # rows up to which a dense LDLᵀ is as fast as a sparse one
# Zero-based. METIS; perturb pivots below 1e-13; no scaling or matching, so that one analysis serves
# every shift; Bunch-Kaufman.
_IPARM = {1: 2, 9: 13, 10: 0, 12: 0, 20: 1}


@dataclass(frozen=True, slots=True)
class PardisoBlocks:
    """When PARDISO stores a pattern as dense blocks.

    Attributes
    ----------
    control : int
        Its control parameter; a negative value: blocks that are filled to the percentage below.
    filled : int
        Percentage to which a block is filled.
    entries : int
        Entries of the triangle from which on blocks pay.
    padding : float
        Memory that a factor by blocks takes while it is made, over what its analysis says
        (measured).
    """

    control: int = 36
    filled: int = 80
    entries: int = 300_000
    padding: float = 1.3


BLOCKS = PardisoBlocks()

# share of the largest of its column that a pivot of SuperLU on the diagonal must have
PIVOT = 1e-6
SAFE_PIVOT = 0.1
# PARDISO's matrix types: real and complex symmetric
_REAL = -2
_COMPLEX = 6


# makes the entries of the upper triangle: nobody holds them while a factor is made
Values = Callable[[], Any_]


class Engine(Protocol):
    """A factorised symmetric matrix whose values can be changed."""

    singular: bool
    # rows that move most in the singular direction, where the engine knows them
    weak: Int

    @property
    def negatives(self) -> int:
        """Number of negative eigenvalues, -1 where the method cannot tell."""
        ...

    @property
    def bytes(self) -> int:
        """Memory of the factor, as predicted before it was made; 0 if unknown."""
        ...

    def refactor(self, values: Values) -> None:
        """Other values on the same pattern."""
        ...

    def strengthen(self, values: Values) -> bool:
        """Factorise with stronger pivoting; False if there is none."""
        ...

    def solve(self, rhs: Any_) -> Any_:
        """A⁻¹ rhs for rhs (f,) or (f, k)."""
        ...

    def close(self) -> None:
        """Free the memory."""
        ...


def installed() -> tuple[Method, ...]:
    """The methods that can be used here, the preferred one first."""
    return tuple(
        m
        for m in METHODS[1:]
        if m not in PACKAGES or find_spec(PACKAGES[m]) is not None
    )


def choose(method: Method, size: int) -> Method:
    """The method that "auto" stands for.

    Raises
    ------
    InputError
        If the method is unknown or its package is not installed.
    """
    if method not in METHODS:
        raise InputError(
            f"factorisation method {method!r}; allowed are {', '.join(METHODS)}"
        )
    if method == "auto":
        return "dense" if size <= DENSE_LIMIT else installed()[0]
    if method not in installed():
        raise InputError(
            f"factorisation method {method!r} needs the package {PACKAGES[method]}; it is not "
            "installed"
        )
    return method


def factorise(method: Method, pattern: Pattern, values: Values) -> Engine:
    """A factor by a method that `choose` gave.

    Parameters
    ----------
    pattern : Pattern
    values : callable
        Makes the upper triangle, (nnz,) float64 or complex128.

    Raises
    ------
    OutOfMemory
        Before the factor is made.
    """
    if method == "pardiso":
        return Pardiso(pattern, values)
    if method == "rslab":
        return Rslab(pattern, values)
    return SuperLu(pattern, values) if method == "superlu" else Dense(pattern, values)


class Dense:
    """A full matrix; LU for the solves, the spectrum for the inertia."""

    def __init__(self, pattern: Pattern, values: Values) -> None:
        self._pattern = pattern
        self.refactor(values)

    def refactor(self, values: Values) -> None:
        """Other values on the same pattern."""
        entries = values()
        upper = self._pattern.matrix(entries).toarray()
        full = upper + np.triu(upper, 1).T
        # scaled first: rotations and translations differ by decades
        size = np.sqrt(np.abs(full).max(axis=1))
        self._scale = 1 / np.where(size > 0, size, 1.0)
        scaled = full * self._scale * self._scale[:, None]
        self.singular = False
        self.weak = np.empty(0, dtype=np.int64)
        hermitian = not np.iscomplexobj(entries)
        spectrum = linalg.eigvalsh(scaled) if hermitian else linalg.svdvals(scaled)
        self.negatives = int((spectrum < 0).sum()) if hermitian else -1
        self.singular = bool(np.abs(spectrum).min() <= 1e-15 * np.abs(spectrum).max())
        if self.singular and hermitian:
            motion = np.abs(
                linalg.eigh(scaled)[1][:, np.abs(spectrum).argmin()] * self._scale
            )
            self.weak = np.argsort(-motion)[
                : min(6, int((motion > 0.1 * motion.max()).sum()))
            ]
        self._lu = (
            None if self.singular else linalg.lu_factor(scaled, check_finite=False)
        )

    @property
    def bytes(self) -> int:
        """Memory of the factor."""
        return 8 * self._pattern.size**2

    def strengthen(self, values: Values) -> bool:
        """Full pivoting is in use already."""
        return False

    def solve(self, rhs: Any_) -> Any_:
        """A⁻¹ rhs."""
        d = self._scale if rhs.ndim == 1 else self._scale[:, None]
        assert self._lu is not None
        return d * linalg.lu_solve(self._lu, d * rhs)

    def close(self) -> None:
        """Free the memory."""
        self._lu = None


class SuperLu:
    """SciPy's own: slower and larger.

    Scaled, nearly all matrices are factorised without an exchange of rows; LU is then LDLᵀ with D
    the diagonal of U.
    """

    bytes = 0
    weak: Int = np.empty(0, dtype=np.int64)

    def __init__(self, pattern: Pattern, values: Values) -> None:
        self._pattern = pattern
        self._pivot = PIVOT
        self.refactor(values)

    def refactor(self, values: Values) -> None:
        """Other values on the same pattern."""
        upper = self._pattern.matrix(values())
        self._dtype = upper.dtype
        full = sparse.csc_array(upper + sparse.triu(upper, 1).T)
        size = np.sqrt(abs(full).max(axis=0).toarray().ravel())
        self._scale = 1 / np.where(size > 0, size, 1.0)
        scale = sparse.diags_array(self._scale)
        full = sparse.csc_array(scale @ full @ scale)
        # the old factor goes first
        self.singular = False
        self._lu = None
        self._negatives: int | None = None
        try:
            self._lu = splu(
                full,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=self._pivot,
                options={"SymmetricMode": True},
            )
        except RuntimeError:  # "Factor is exactly singular"
            self.singular = True
        except MemoryError as e:
            raise OutOfMemory(
                f"SuperLU of {self._pattern.size} rows: out of memory; install py-mkl-pardiso"
            ) from e

    @property
    def negatives(self) -> int:
        """Negative eigenvalues by inertia (Sylvester); -1 if rows were exchanged."""
        if self._negatives is None:
            lu = self._lu
            self._negatives = -1
            if (
                lu is not None
                and self._dtype.kind != "c"
                and np.array_equal(lu.perm_r, lu.perm_c)
            ):
                self._negatives = int((lu.U.diagonal() < 0).sum())
        return self._negatives

    def strengthen(self, values: Values) -> bool:
        """With larger pivots, for which more rows are exchanged."""
        self._pivot = SAFE_PIVOT
        self.refactor(values)
        return True

    def solve(self, rhs: Any_) -> Any_:
        """A⁻¹ rhs."""
        assert self._lu is not None
        d = self._scale if rhs.ndim == 1 else self._scale[:, None]
        return d * self._lu.solve(np.ascontiguousarray(d * rhs, dtype=self._dtype))

    def close(self) -> None:
        """Free the memory."""
        self._lu = None


class Pardiso:
    """LDLᵀ of MKL, in memory (out of core it gave a wrong factor once in some hundred times)."""

    singular = False
    weak: Int = np.empty(0, dtype=np.int64)

    def __init__(self, pattern: Pattern, values: Values) -> None:
        # the class below the public one, which walks through the rows in Python and cannot stop
        # after the analysis
        from pymklpardiso._mkl_pardiso import PardisoSolver

        entries = values()
        self._complex = np.iscomplexobj(entries)
        self._rows = pattern.size
        self._solver = PardisoSolver(_COMPLEX if self._complex else _REAL, 0)
        self._blocks = not self._complex and pattern.indices.size > BLOCKS.entries
        for i, value in (
            _IPARM | ({BLOCKS.control: -BLOCKS.filled} if self._blocks else {})
        ).items():
            self._solver.set_iparm(i, value)
        self._solver.set_pattern(
            ia=pattern.indptr.astype(np.int64),
            ja=pattern.indices.astype(np.int64),
            n=self._rows,
        )
        self._solver.set_values(entries)
        del entries  # the solver has a copy
        self._trim()
        with self._calls():
            self._solver.run_phase(11)
        memory.require(self.bytes, f"the factorisation of {self._rows} DOFs")
        self._factor()

    @contextmanager
    def _calls(self) -> Iterator[None]:
        """Errors of PARDISO become ours."""
        try:
            yield
        except RuntimeError as e:
            if "memory" in str(e):
                raise OutOfMemory(f"{self._rows} DOFs: {e}", needed=self.bytes) from e
            raise NumericalError(f"{self._rows} DOFs: {e}") from e

    def _trim(self) -> None:
        if self._blocks:  # it takes some milliseconds, as long as a small factorisation
            memory.trim()

    @property
    def bytes(self) -> int:
        """Memory of the factor, from the analysis: the peak of the analysis or the factor with its
        index lists.
        """
        peak, kept, numeric = (
            int(self._solver.get_iparm_value(i)) for i in (14, 15, 16)
        )
        return 1024 * max(
            peak, kept + int(numeric * (BLOCKS.padding if self._blocks else 1))
        )

    @property
    def negatives(self) -> int:
        """Negative eigenvalues by inertia; -1 if pivots were perturbed."""
        if self._complex or self._solver.get_iparm_value(13):
            return -1
        return int(self._solver.get_iparm_value(22))

    def refactor(self, values: Values) -> None:
        """Other values on the same pattern."""
        self._solver.set_values(values())
        self._factor()

    def _factor(self) -> None:
        self._trim()
        with self._calls():
            self._solver.refactor()
        self._trim()  # a fifth of a factor by blocks was needed to make it only

    def strengthen(self, values: Values) -> bool:
        """With scaling and weighted matching: slower, for matrices that plain pivoting cannot
        treat.
        """
        for i, value in ((10, 1), (12, 1), (BLOCKS.control, 0)):
            self._solver.set_iparm(i, value)
        with self._calls():
            self._solver.factor(values())
        return True

    def solve(self, rhs: Any_) -> Any_:
        """A⁻¹ rhs."""
        dtype = np.complex128 if self._complex else np.float64
        if not rhs.size:  # refused by MKL
            return np.zeros(rhs.shape, dtype)
        with self._calls():
            return np.asarray(self._solver.solve(np.asfortranarray(rhs, dtype=dtype)))

    def close(self) -> None:
        """Free the memory."""
        self._solver.release()


class Rslab:
    """LDLᵀ in Rust, where there is no MKL."""

    singular = False
    weak: Int = np.empty(0, dtype=np.int64)

    def __init__(self, pattern: Pattern, values: Values) -> None:
        import rslab

        rows = pattern.matrix(values())
        self._dtype = rows.dtype
        # CSC of the lower triangle: same arrays
        self._symbolic = rslab.analyze(sparse.csc_array(rows.T), path="ldlt")
        self.bytes = int(self._symbolic.memory_plan(self._dtype.name)["peak_bytes"])
        memory.require(self.bytes, f"the factorisation of {pattern.size} DOFs")
        self.refactor(values)

    @property
    def negatives(self) -> int:
        """Negative eigenvalues by inertia; -1 if pivots were perturbed."""
        if (
            self._factor is None
            or self._factor.n_perturbed
            or np.issubdtype(self._dtype, np.complexfloating)
        ):
            return -1
        return int(self._factor.inertia[1])

    def refactor(self, values: Values) -> None:
        """Other values on the same pattern."""
        # the old factor goes first
        self._factor = None
        self.singular = False
        try:
            self._factor = self._symbolic.factor(values())
        except (RuntimeError, ValueError):  # a zero pivot
            self.singular = True

    def strengthen(self, values: Values) -> bool:
        """There is no other pivoting."""
        return False

    def solve(self, rhs: Any_) -> Any_:
        """A⁻¹ rhs."""
        assert self._factor is not None
        rhs = np.ascontiguousarray(rhs, dtype=self._dtype)
        return np.asarray(
            self._factor.solve(rhs) if rhs.ndim == 1 else self._factor.solve_many(rhs)
        )

    def close(self) -> None:
        """Free the memory."""
        self._factor = None
