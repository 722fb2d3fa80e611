"""Motions as the mass sees them: restricted to the rows that have mass, with their inertia forces.

A motion is a row here: that is the column-major layout of the solvers. Long rows are summed in
tiles, which stay in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.blas import dgemm

from ringtrue.core.arrays import Float, Int

TILE = 1024


def tiles(length: int) -> Iterator[slice]:
    """Slices that cover the length."""
    for start in range(0, length, TILE):
        yield slice(start, start + TILE)


def add(x: Float, *terms: tuple[Float, Float]) -> None:
    """Add to x (k, f) products cᵀy of pairs c (l, k), y (l, f); all of whole rows (contiguous)."""
    for c, y in terms:
        if c.size and x.size:
            x[:] = dgemm(
                1.0, y.T, c, 1.0, x.T, overwrite_c=True
            ).T  # in place: numpy skips the assignment to itself


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Motions (k, r) as two arrays with xMyᵀ = x.plain y.loadedᵀ.

    One and the same array, scaled by the root of the mass, where the mass is diagonal.
    """

    plain: Float
    loaded: Float

    @property
    def count(self) -> int:
        """Number of motions."""
        return len(self.plain)

    def dot(self, other: Fields) -> Float:
        """xMyᵀ (k, l)."""
        return np.asarray(self.plain @ other.loaded.T)

    def times(self, c: Float, out: Fields) -> None:
        """Write cᵀx (l, r) for c (k, l)."""
        np.matmul(c.T, self.plain, out=out.plain)
        if not self._one:
            np.matmul(c.T, self.loaded, out=out.loaded)

    def add(self, c: Float, other: Fields) -> None:
        """Add cᵀy to x."""
        add(self.plain, (c, other.plain))
        if not self._one:
            add(self.loaded, (c, other.loaded))

    def room(self, count: int) -> Fields:
        """So many like these, not filled: pages that are never written take no memory."""
        plain = np.empty((count, self.plain.shape[1]))
        return Fields(plain, plain if self._one else np.empty_like(plain))

    def cut(self, at: slice) -> Fields:
        """A view of some."""
        plain = self.plain[at]
        return Fields(plain, plain if self._one else self.loaded[at])

    @property
    def _one(self) -> bool:
        return self.loaded is self.plain


class Inertia:
    """The mass on the rows that have any.

    Parameters
    ----------
    mass : (f, f) csr_array
        Symmetric, positive semidefinite.
    """

    def __init__(self, mass: sparse.csr_array) -> None:
        self._size = int(mass.shape[0])
        self._rows = np.flatnonzero(abs(mass).sum(axis=1))
        m = mass.diagonal()[self._rows]
        diagonal = np.count_nonzero(mass.data) == self._rows.size and bool((m > 0).all())
        self._root = np.sqrt(m) if diagonal else None
        self._mass = sparse.csr_array(mass[self._rows][:, self._rows])
        self._weight = np.zeros(self._size)
        self._weight[self._rows] = 1.0 if self._root is None else self._root
        self._place = np.zeros(self._size, dtype=np.int64)  # of each row among those with mass
        self._place[self._rows] = np.arange(self._rows.size)
        self._signs = np.random.default_rng(0).choice([-1.0, 1.0], self._rows.size)

    def fields(self, x: Float, out: Fields | None = None) -> Fields:
        """Of motions (k, f), in `out` if it is given."""
        if out is None:
            plain = np.empty((len(x), self._rows.size))
            out = Fields(plain, plain if self._root is not None else np.empty_like(plain))
        np.take(x, self._rows, axis=1, out=out.plain, mode="clip")  # other modes go through a copy
        if self._root is None:
            out.loaded[:] = (self._mass @ out.plain.T).T
        else:
            out.plain[:] *= self._root
        return out

    def forces(self, x: Fields) -> Float:
        """xM on all rows (k, f)."""
        if not self._rows.size:
            return np.zeros((x.count, self._size))
        out = np.take(x.loaded, self._place, axis=1)
        out *= self._weight
        return out

    def sketch(self, x: Fields) -> Float:
        """Forces (k, TILE), folded with random signs: norms and products are kept within about
        √(2/TILE).

        (Charikar, Chen and Farach-Colton 2002: a count sketch; its buckets are strides here.)
        """
        out = np.zeros((x.count, TILE))
        weight = self._signs if self._root is None else self._signs * self._root
        for t in tiles(self._rows.size):
            part = x.loaded[:, t] * weight[t]
            out[:, : part.shape[1]] += part
        return out

    def gram(self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]) -> Float:
        """Products of the forces of some of x, each times a factor, + Σ cᵀy."""
        out = np.zeros((at.size, at.size))
        for forces in self._forces(x, at, factor, *terms):
            out += forces @ forces.T
        return out

    def squares(self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]) -> Float:
        """Squared 2-norms of the same, the diagonal of `gram`."""
        out = np.zeros(at.size)
        for forces in self._forces(x, at, factor, *terms):
            out += np.einsum("ij,ij->i", forces, forces)
        return out

    def _forces(
        self, x: Fields, at: Int, factor: Float, *terms: tuple[Float, Fields]
    ) -> Iterator[Float]:
        for t in tiles(self._rows.size):
            forces = x.loaded[:, t][at] * factor[:, None]
            for c, y in terms:
                forces += c.T @ y.loaded[:, t]
            if self._root is not None:
                forces *= self._root[t]
            yield forces
