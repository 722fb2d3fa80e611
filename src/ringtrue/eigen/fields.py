"""Motions as the mass sees them: restricted to the rows that have mass, with their inertia forces.

Long columns are summed in tiles of rows, which stay in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int

TILE = 2048
Sum = Sequence[tuple[Float, Float]]  # pairs (rows, k), (k, c): the sum of their products


def tiles(rows: int) -> Iterator[slice]:
    """Slices that cover the rows."""
    for start in range(0, rows, TILE):
        yield slice(start, start + TILE)


def add(c: Float, terms: Sum) -> Float:
    """c + Σ a b, into c; column-major."""
    for t in tiles(len(c)):
        for a, b in terms:
            c.T[:, t] += b.T @ a.T[:, t]
    return c


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Columns (r, k), column-major, as two arrays with xᵀMy = x.plainᵀ y.loaded.

    One and the same array, scaled by the root of the mass, where the mass is diagonal.
    """

    plain: Float
    loaded: Float

    @property
    def count(self) -> int:
        """Number of columns."""
        return int(self.plain.shape[1])

    def dot(self, other: Fields) -> Float:
        """xᵀMy (k, l)."""
        return np.asarray(self.plain.T @ other.loaded)

    def less(self, other: Fields, c: Float) -> Fields:
        """x − other c; x is overwritten."""
        plain = add(self.plain, [(other.plain, -c)])
        return Fields(plain, plain if self.loaded is self.plain else add(self.loaded, [(other.loaded, -c)]))


def summed(terms: Sequence[tuple[Fields, Float]]) -> Fields:
    """Σ x c."""
    rows, columns = len(terms[0][0].plain), terms[0][1].shape[1]
    plain = add(np.zeros((columns, rows)).T, [(x.plain, c) for x, c in terms])
    if all(x.loaded is x.plain for x, _ in terms):
        return Fields(plain, plain)
    return Fields(plain, add(np.zeros((columns, rows)).T, [(x.loaded, c) for x, c in terms]))


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

    def fields(self, x: Float) -> Fields:
        """Of motions (f, k)."""
        plain = np.take(x.T, self._rows, axis=1).T
        if self._root is None:
            return Fields(plain, np.asfortranarray(self._mass @ plain))
        plain.T[:] *= self._root
        return Fields(plain, plain)

    def spread(self, x: Fields) -> Float:
        """M x on all rows (f, k), column-major."""
        out = np.zeros((x.count, self._size))
        out[:, self._rows] = x.loaded.T if self._root is None else x.loaded.T * self._root
        return out.T

    def gram(self, x: Fields, at: Int, factor: Float, terms: Sequence[tuple[Fields, Float]]) -> Float:
        """(Ms)ᵀ(Ms) of s = some columns of x, each times a factor, + Σ y c; its diagonal is ‖Ms‖² (2-norm)."""
        out = np.zeros((at.size, at.size))
        for t in tiles(self._rows.size):
            forces = x.loaded.T[:, t][at] * factor[:, None]
            for y, c in terms:
                forces += c.T @ y.loaded.T[:, t]
            if self._root is not None:
                forces *= self._root[t]
            out += forces @ forces.T
        return out
