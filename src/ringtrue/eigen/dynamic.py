"""The dynamic stiffness Q(s) = s²M + sD + K + iH, factorised at any complex s on one analysis."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.eigen.engines import Engine, Method, choose, factorise
from ringtrue.eigen.pattern import Pattern
from ringtrue.errors import InputError, SingularModel

RESIDUAL_LIMIT = 1e-6  # of a solve; what a factor in double precision exceeds only on a pole


class DynamicStiffness:
    """K, M, viscous D and structural H on one sparsity pattern; holds one factorisation, which
    moves with s.

    Parameters
    ----------
    stiffness, mass : (f, f) csr_array float64
        Symmetric, both triangles.
    viscous, structural : (f, f) csr_array float64, optional
    method : str
        A factorisation of `engines`.
    limit : int, optional
        Bytes that the factor may take; what is free if not given.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: sparse.csr_array,
        viscous: sparse.csr_array | None = None,
        structural: sparse.csr_array | None = None,
        *,
        method: Method = "auto",
        limit: int | None = None,
    ) -> None:
        none = sparse.csr_array(stiffness.shape, dtype=np.float64)
        self.stiffness, self.mass = stiffness, mass
        self.viscous: sparse.csr_array = none if viscous is None else viscous
        self.structural: sparse.csr_array = none if structural is None else structural
        parts = (stiffness, mass, self.viscous, self.structural)
        if len({a.shape for a in parts}) > 1:
            raise InputError(
                f"K, M, D and H differ in size: {', '.join(str(a.shape) for a in parts)}"
            )
        self.method, self._limit = choose(method, self.size), limit
        self._pattern = Pattern(*(a for a in parts if a.nnz))
        self._entries = [self._pattern.entries(a) for a in parts]
        self._engine: Engine | None = None
        self._at = complex(np.nan)

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.stiffness.shape[0])

    def matrix(self, s: complex) -> sparse.csr_array:
        """Q(s), (f, f) complex128."""
        made = self.stiffness + self.mass * s**2 + self.viscous * s + self.structural * 1j
        return sparse.csr_array(made.astype(np.complex128))

    def product(self, s: complex | Complex, x: Any_) -> Complex:
        """Q(s) x for x (f, k) and one s, or one s a column (k,)."""
        made = self.stiffness @ x + (self.mass @ x) * s**2 + (self.viscous @ x) * s
        return np.asarray(made + 1j * (self.structural @ x), dtype=np.complex128)

    def residuals(self, poles: Complex, shapes: Complex) -> Float:
        """‖Q(s)φ‖ / (‖Kφ‖ + |s|‖Dφ‖ + |s|²‖Mφ‖ + ‖Hφ‖) of poles (m,) with shapes (f, m)."""
        terms = (
            (self.stiffness, np.ones(poles.size)),
            (self.viscous, np.abs(poles)),
            (self.mass, np.abs(poles) ** 2),
            (self.structural, np.ones(poles.size)),
        )
        size = sum(np.linalg.norm(np.asarray(a @ shapes), axis=0) * f for a, f in terms)
        return np.asarray(
            np.linalg.norm(self.product(poles, shapes), axis=0)
            / np.maximum(size, np.finfo(float).tiny)
        )

    def solve(self, s: complex, rhs: Any_) -> Complex:
        """Q(s)⁻¹ rhs, (f, k) complex128, refined once.

        Raises
        ------
        SingularModel
            If s is a pole, or the model a mechanism without mass.
        OutOfMemory
        """
        factor = self._factor(s)
        rhs = np.asarray(rhs, dtype=np.complex128)
        x = factor.solve(rhs)
        x = x + factor.solve(rhs - self.product(s, x))
        rest = np.abs(rhs - self.product(s, x)).max(initial=0.0)
        if not rest <= RESIDUAL_LIMIT * np.abs(rhs).max(initial=np.finfo(float).tiny):
            raise SingularModel(
                (), f"the dynamic stiffness at s = {s:.6g} rad/s leaves a residual of {rest:.1e}"
            )
        return np.asarray(x)

    def _factor(self, s: complex) -> Engine:
        if self._engine is not None and s == self._at:
            return self._engine
        values = np.zeros(self._pattern.indices.size, dtype=np.complex128)
        for (at, data), factor in zip(self._entries, (1.0, s**2, s, 1j), strict=True):
            values[at] += factor * data
        if self._engine is None:
            self._engine = factorise(self.method, self._pattern, values, self._limit)
        else:
            self._engine.refactor(values)
        self._at = s
        if self._engine.singular:
            raise SingularModel(
                (), f"the dynamic stiffness at s = {s:.6g} rad/s cannot be factorised"
            )
        return self._engine

    def close(self) -> None:
        """Free the factorisation."""
        if self._engine is not None:
            self._engine.close()
        self._engine, self._at = None, complex(np.nan)
