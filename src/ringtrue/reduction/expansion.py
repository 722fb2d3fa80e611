"""Expansion of test shapes to all degrees of freedom of a model.

Sources: O'Callahan, Avitabile and Riemer (1989) for SEREP; Balmès (2000) for the minimum of dynamic
residual and test error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from ringtrue.core.arrays import Any_, Float, FrozenArrays
from ringtrue.eigen.pencil import Labels
from ringtrue.errors import ConfigError, InputError
from ringtrue.reduction.static import StaticShapes
from ringtrue.shapes import pseudo_inverse


@dataclass(frozen=True, slots=True, eq=False)
class Expanded(FrozenArrays):
    """Test shapes on all degrees of freedom.

    Attributes
    ----------
    method : str
    shapes : (f, m) float64 or complex128
        In the scale of the test shapes.
    misfit : (m,) float64
        ‖C u − y‖/‖y‖: what of the readings the expanded shape does not reproduce.
    weight : (m,) float64
        Of the model against the readings, of the hybrid expansion; 0 for the others.
    """

    method: str
    shapes: Any_
    misfit: Float
    weight: Float


@dataclass(frozen=True, slots=True, eq=False)
class ShapeReadings:
    """What is expanded.

    Attributes
    ----------
    observe : (channel, f) csr_array or (channel, r) float64
        The channels by the coordinates of the model; they may depend on each other.
    shapes : (channel, m) float64 or complex128
    frequencies : (m,) float64, Hz
    noise : float
        Relative error of the readings, ‖e‖/‖y‖, > 0.
    """

    observe: sparse.csr_array | Float
    shapes: Any_
    frequencies: Float
    noise: float

    def __post_init__(self) -> None:
        channels, count = self.observe.shape[0], np.size(self.frequencies)
        if np.shape(self.shapes) != (channels, count):
            raise InputError(
                f"test shapes {np.shape(self.shapes)} for {channels} channels, {count} frequencies"
            )
        if not self.noise > 0:
            raise ConfigError(f"expansion: noise {self.noise} must be above 0")


def _result(
    method: str,
    u: Any_,
    y: Any_,
    observe: sparse.csr_array | Float,
    weight: Float | None = None,
) -> Expanded:
    size = np.linalg.norm(y, axis=0)
    misfit = np.linalg.norm(observe @ u - y, axis=0) / np.where(size > 0, size, 1.0)
    return Expanded(
        method, u, misfit, np.zeros(y.shape[1]) if weight is None else weight
    )


def expand_serep(modes: Float, observe: sparse.csr_array, shapes: Any_) -> Expanded:
    """u = Φ(CΦ)⁺y: the combination of the model's modes that fits the readings best.

    Parameters
    ----------
    modes : (f, k) float64
        k <= channels; few enough that noise is not fitted.
    observe : (channel, f) scipy.sparse.csr_array float64
    shapes : (channel, m) float64 or complex128

    Raises
    ------
    InputError
        If the modes are not independent at the channels.
    """
    y = np.asarray(shapes)
    if y.ndim != 2 or y.shape[0] != observe.shape[0]:
        raise InputError(f"test shapes {y.shape} for {observe.shape[0]} channels")
    return _result("serep", modes @ (pseudo_inverse(observe @ modes) @ y), y, observe)


def expand_hybrid(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    readings: ShapeReadings,
    modes: Float,
    *,
    labels: Labels | None = None,
) -> Expanded:
    """The motion that balances the readings against the equation of motion of the model.

    min ‖Cu − y‖² + γ β rᵀA⁻¹r with r = (K − ω²M)u and A = K + αCᵀC, over u in the span of the modes
    and of the static shapes of the sensors: a Tikhonov problem a mode. β makes the two terms equal
    in size over that span, γ the misfit as large as the error of the readings (Morozov 1966).

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    readings : ShapeReadings
    modes : (f, k) float64
        Of the model; they may be more than the channels.
    """
    basis = _Basis.of(
        stiffness, mass, sparse.csr_array(readings.observe), modes, labels
    )
    q, weights = basis.fitted(readings)
    return _result(
        "hybrid", basis.vectors @ q, readings.shapes, readings.observe, weights
    )


def expand_reduced(
    stiffness: Float, mass: Float, energy: Float, readings: ShapeReadings
) -> Expanded:
    """`expand_hybrid` over all motions of a reduced model: coordinates of its basis, (r, m).

    Parameters
    ----------
    stiffness, mass : (r, r) float64
    energy : (r, r) float64
        Positive definite, K − σM with σ < 0 say: A of the residual's norm.
    readings : ShapeReadings
        By the coordinates of the basis.
    """
    factor = linalg.cho_factor(energy)
    k = linalg.cho_solve(factor, stiffness)
    m = linalg.cho_solve(factor, mass)
    seen = np.asarray(readings.observe)
    basis = _Basis(np.eye(len(mass)), seen, stiffness @ k, stiffness @ m, mass @ m)
    q, weights = basis.fitted(readings)
    return _result("hybrid", q, readings.shapes, seen, weights)


@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """Orthonormal vectors; what the sensors see of them; products of the residual in A⁻¹."""

    vectors: Float
    seen: Float
    kk: Float
    km: Float
    mm: Float

    @classmethod
    def of(
        cls,
        stiffness: sparse.csr_array,
        mass: sparse.csr_array,
        observe: sparse.csr_array,
        modes: Float,
        labels: Labels | None,
    ) -> _Basis:
        static = StaticShapes(stiffness, observe, labels=labels)
        try:
            raw = np.concatenate([modes, static.transform], axis=1)
            raw = raw / np.linalg.norm(raw, axis=0)
            q, r, _ = linalg.qr(raw, mode="economic", pivoting=True)
            size = np.abs(np.diag(r))
            vectors = np.asarray(q[:, size > 1e-7 * size[0]])  # the independent ones
            K = stiffness @ vectors
            M = mass @ vectors
            k = static.solve(K)
            m = static.solve(M)
        finally:
            static.close()
        return cls(vectors, observe @ vectors, K.T @ k, K.T @ m, M.T @ m)

    def fitted(self, readings: ShapeReadings) -> tuple[Any_, Float]:
        """Coordinates (r, m) of the expanded shapes, and γ (m,)."""
        y = np.asarray(readings.shapes)
        lam = (2 * np.pi * np.asarray(readings.frequencies)) ** 2
        q = np.zeros((self.vectors.shape[1], y.shape[1]), dtype=y.dtype)
        weights = np.zeros(y.shape[1])
        for k in range(y.shape[1]):  # a small problem a mode
            weights[k], q[:, k] = self.solve(y[:, k], float(lam[k]), readings.noise)
        return q, weights

    def solve(self, y: Any_, lam: float, noise: float) -> tuple[float, Any_]:
        """γ and the coordinates of the minimum, from D and R made diagonal together."""
        residual = self.kk - lam * (self.km + self.km.T) + lam**2 * self.mm
        data = self.seen.T @ self.seen
        s, u = linalg.eigh(data + residual * (np.trace(data) / np.trace(residual)))
        keep = s > 1e-13 * s[-1]
        u = u[:, keep] / np.sqrt(s[keep])
        share, v = linalg.eigh(u.T @ data @ u)
        share = share.clip(0.0, 1.0)
        v = u @ v
        load = v.T @ (self.seen.T @ y)

        def at(gamma: float) -> Any_:
            return np.asarray(
                v @ (load / np.maximum(share + gamma * (1 - share), 1e-14))
            )

        def excess(log: float) -> float:
            miss = np.linalg.norm(self.seen @ at(float(np.exp(log))) - y)
            return float(miss / np.linalg.norm(y)) - noise

        gamma = _root(excess)
        return gamma, at(gamma)


def _root(excess: Callable[[float], float]) -> float:
    """exp of the zero of a rising function, or of the end of the range nearest to it."""
    low = -25.0
    high = 25.0
    if excess(low) >= 0:
        return float(np.exp(low))
    if excess(high) <= 0:
        return float(np.exp(high))
    return float(np.exp(optimize.brentq(excess, low, high, xtol=1e-3)))
