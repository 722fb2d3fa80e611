"""One sparsity pattern for several symmetric matrices."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Int


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
        self.indices, self.indptr = union.indices.astype(np.int32), union.indptr.astype(np.int64)
        if self.indptr[-1] < np.iinfo(np.int32).max:
            self.indptr = self.indptr.astype(np.int32)

    def _keys(self, indices: Any_, indptr: Any_) -> Int:
        row = np.repeat(np.arange(self.size, dtype=np.int64), np.diff(indptr))
        return np.asarray(row * self.size + indices)

    def entries(self, a: sparse.csr_array) -> tuple[Int | slice, Any_]:
        """Where the upper triangle of `a` stands in this pattern, and its values."""
        u = upper(a)
        if u.indices.size == self.indices.size:
            return slice(None), u.data
        at = np.searchsorted(self._keys(self.indices, self.indptr), self._keys(u.indices, u.indptr))
        return at.astype(
            np.int32 if self.indices.size < np.iinfo(np.int32).max else np.int64
        ), u.data

    def values(self, a: sparse.csr_array) -> Any_:
        """The entries of `a` on this pattern."""
        at, data = self.entries(a)
        out = np.zeros(self.indices.size, dtype=np.result_type(data.dtype, np.float64))
        out[at] = data
        return out

    def matrix(self, values: Any_) -> sparse.csr_array:
        """Upper triangle with these entries."""
        return sparse.csr_array((values, self.indices, self.indptr), shape=(self.size, self.size))
