"""Expansion of test shapes to all degrees of freedom of a model.

Sources: Guyan (1965); Kidder (1973) for the dynamic one; O'Callahan, Avitabile and Riemer (1989)
for SEREP; Balmès (2000) for the minimum of dynamic residual and test error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from ringtrue.core.arrays import Any_, Float, freeze_fields
from ringtrue.core.progress import Progress
from ringtrue.eigen.pencil import Labels
from ringtrue.errors import ConfigError, InputError
from ringtrue.reduction.static import StaticShapes
from ringtrue.shapes.orthogonality import pseudo_inverse

SPAN = 1e-7  # relative length below which a vector of the basis counts as dependent


@dataclass(frozen=True, slots=True, eq=False)
class Expanded:
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

    def __post_init__(self) -> None:
        freeze_fields(self, shapes=None, misfit=np.float64, weight=np.float64)


def _readings(shapes: Any_, observe: sparse.csr_array, frequencies: Float | None = None) -> Any_:
    y = np.asarray(shapes)
    if y.ndim != 2 or y.shape[0] != observe.shape[0]:
        raise InputError(f"test shapes {y.shape} for {observe.shape[0]} channels")
    if frequencies is not None and np.shape(frequencies) != (y.shape[1],):
        raise InputError(f"frequencies {np.shape(frequencies)} for {y.shape[1]} test shapes")
    return y


def _result(
    method: str, u: Any_, y: Any_, observe: sparse.csr_array, weight: Float | None = None
) -> Expanded:
    size = np.linalg.norm(y, axis=0)
    misfit = np.linalg.norm(observe @ u - y, axis=0) / np.where(size > 0, size, 1.0)
    return Expanded(method, u, misfit, np.zeros(y.shape[1]) if weight is None else weight)


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
        If the channels cannot tell the modes apart.
    """
    y = _readings(shapes, observe)
    return _result("serep", modes @ (pseudo_inverse(observe @ modes) @ y), y, observe)


def expand_static(
    stiffness: sparse.csr_array,
    observe: sparse.csr_array,
    shapes: Any_,
    *,
    labels: Labels | None = None,
) -> Expanded:
    """The motion of least strain energy that has the readings exactly (Guyan, for sensors
    anywhere).

    Parameters
    ----------
    stiffness : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
    shapes : (channel, m) float64 or complex128

    Raises
    ------
    SingularModel
        If the structure can move without a reading.
    """
    y = _readings(shapes, observe)
    static = StaticShapes(stiffness, observe, labels=labels)
    static.close()
    return _result("static", static.transform @ y, y, observe)


def expand_dynamic(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    observe: sparse.csr_array,
    shapes: Any_,
    frequencies: Float,
    *,
    labels: Labels | None = None,
    progress: Progress | None = None,
) -> Expanded:
    """The motion that has the readings exactly and needs no force but at the sensors, at each
    mode's own frequency.

    Exact for a model without error; one factorisation a mode. Fails near a frequency that the
    structure has with all readings held.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
    shapes : (channel, m) float64 or complex128
    frequencies : (m,) float64, Hz
    """
    y = _readings(shapes, observe, frequencies)
    u = np.zeros((stiffness.shape[0], y.shape[1]), dtype=y.dtype)
    for k, f in enumerate(np.asarray(frequencies).tolist()):  # a factorisation a mode
        Z = sparse.csr_array(stiffness - (2 * np.pi * f) ** 2 * mass)
        dynamic = StaticShapes(Z, observe, labels=labels)
        dynamic.close()
        u[:, k] = dynamic.transform @ y[:, k]
        if progress is not None:
            progress((k + 1) / y.shape[1], "dynamic expansion")
    return _result("dynamic", u, y, observe)


def expand_hybrid(
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    observe: sparse.csr_array,
    shapes: Any_,
    frequencies: Float,
    modes: Float,
    *,
    noise: float | None = None,
    weight: float | None = None,
    labels: Labels | None = None,
) -> Expanded:
    """The motion that balances the readings against the equation of motion of the model.

    min ‖Cu − y‖² + γ β rᵀA⁻¹r with r = (K − ω²M)u and A = K + αCᵀC, over u in the span of the modes
    and of the static shapes of the sensors: a Tikhonov problem a mode. β makes the two terms equal
    in size over that span.

    Parameters
    ----------
    stiffness, mass : (f, f) scipy.sparse.csr_array float64
    observe : (channel, f) scipy.sparse.csr_array float64
    shapes : (channel, m) float64 or complex128
    frequencies : (m,) float64, Hz
    modes : (f, k) float64
        Of the model; they may be more than the channels.
    noise : float, optional
        Relative error of the readings, ‖e‖/‖y‖; γ is chosen so that the misfit is as large
        (Morozov, 1966).
    weight : float, optional
        γ itself, > 0. One of the two must be given.

    Raises
    ------
    ConfigError
        Unless exactly one of `noise` and `weight` is given, above 0.
    """
    y = _readings(shapes, observe, frequencies)
    if (
        (noise is None) == (weight is None)
        or (noise or 0) < 0
        or (weight is not None and weight <= 0)
    ):
        raise ConfigError(
            f"hybrid expansion: noise {noise}, weight {weight}; give one of them, above 0"
        )
    basis = _Basis.of(stiffness, mass, observe, modes, labels)
    q = np.zeros((basis.vectors.shape[1], y.shape[1]), dtype=y.dtype)
    used = np.zeros(y.shape[1])
    for k, f in enumerate(np.asarray(frequencies).tolist()):  # a small problem a mode
        used[k], q[:, k] = basis.solve(y[:, k], (2 * np.pi * f) ** 2, noise, weight)
    return _result("hybrid", basis.vectors @ q, y, observe, used)


def expand_reduced(
    stiffness: Float,
    mass: Float,
    energy: Float,
    observe: Float,
    shapes: Any_,
    frequencies: Float,
    *,
    noise: float,
) -> Expanded:
    """`expand_hybrid` over all motions of a reduced model: coordinates of its basis, (r, m).

    Parameters
    ----------
    stiffness, mass : (r, r) float64
    energy : (r, r) float64
        Positive definite, K − σM with σ < 0 say: A of the residual's norm.
    observe : (channel, r) float64
        Channels may depend on each other.
    shapes : (channel, m) float64 or complex128
    frequencies : (m,) float64, Hz
    noise : float
        Relative error of the readings.
    """
    y = _readings(shapes, sparse.csr_array(observe), frequencies)
    if not noise > 0:
        raise ConfigError(f"expansion: noise {noise} must be above 0")
    factor = linalg.cho_factor(energy)
    k, m = linalg.cho_solve(factor, stiffness), linalg.cho_solve(factor, mass)
    basis = _Basis(np.eye(len(mass)), observe, stiffness @ k, stiffness @ m, mass @ m)
    found = [
        basis.solve(y[:, i], (2 * np.pi * f) ** 2, noise, None)
        for i, f in enumerate(frequencies.tolist())
    ]
    q = np.stack([c for _, c in found], axis=1) if found else np.zeros((len(mass), 0))
    return _result("hybrid", q, y, sparse.csr_array(observe), np.array([w for w, _ in found]))


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
            vectors = _orthonormal(raw)
            K, M = stiffness @ vectors, mass @ vectors
            k, m = static.solve(K), static.solve(M)
        finally:
            static.close()
        return cls(vectors, observe @ vectors, K.T @ k, K.T @ m, M.T @ m)

    def solve(
        self, y: Any_, lam: float, noise: float | None, weight: float | None
    ) -> tuple[float, Any_]:
        """γ and the coordinates of the minimum, from D and R made diagonal together."""
        residual = self.kk - lam * (self.km + self.km.T) + lam**2 * self.mm
        data = self.seen.T @ self.seen
        s, u = linalg.eigh(data + residual * (np.trace(data) / np.trace(residual)))
        keep = s > 1e-13 * s[-1]
        u = u[:, keep] / np.sqrt(s[keep])
        share, v = linalg.eigh(u.T @ data @ u)
        share, v = share.clip(0.0, 1.0), u @ v
        load = v.T @ (self.seen.T @ y)

        def at(gamma: float) -> Any_:
            return np.asarray(v @ (load / np.maximum(share + gamma * (1 - share), 1e-14)))

        def excess(log: float) -> float:
            return float(
                np.linalg.norm(self.seen @ at(float(np.exp(log))) - y) / np.linalg.norm(y)
            ) - (noise or 0.0)

        gamma = weight if weight is not None else _root(excess)
        return gamma, at(gamma)


def _root(excess: Callable[[float], float]) -> float:
    """exp of the zero of a rising function, or of the end of the range nearest to it."""
    low, high = -25.0, 25.0
    if excess(low) >= 0:
        return float(np.exp(low))
    if excess(high) <= 0:
        return float(np.exp(high))
    return float(np.exp(optimize.brentq(excess, low, high, xtol=1e-3)))


def _orthonormal(raw: Float) -> Float:
    """Orthonormal vectors of the same span; dependent ones fall away."""
    q, r, _ = linalg.qr(raw / np.linalg.norm(raw, axis=0), mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.asarray(q[:, size > SPAN * size[0]])
