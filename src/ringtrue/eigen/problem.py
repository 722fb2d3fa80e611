"""What an eigensolution returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, freeze_fields


@dataclass(frozen=True, slots=True, eq=False)
class EigenModes:
    """Lowest solutions of K φ = λ M φ, ascending.

    Attributes
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass, largest component positive
    residuals : (m,) float64
        ‖Kφ − λMφ‖ / ‖Kφ‖; relative to ‖|K| |φ|‖ for modes with λ below the noise of K.
    orthogonality : float
        max |ΦᵀMΦ − I|.
    complete : bool
        The inertia counts agree with the number of modes found.
    proof : str
        What was counted, in words.
    shift : float
        Where K − σM is factorised.
    """

    values: Float
    vectors: Float
    residuals: Float
    orthogonality: float
    complete: bool
    proof: str
    shift: float

    def __post_init__(self) -> None:
        freeze_fields(self, values=np.float64, vectors=np.float64, residuals=np.float64)

    @property
    def frequencies(self) -> Float:
        """(m,) Hz, sign(λ)·sqrt|λ|/2π."""
        return frequencies(self.values)


def frequencies(values: Float) -> Float:
    """Hz of eigenvalues (rad/s)², sign kept."""
    return np.asarray(np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi))


def eigenvalue(frequency: float) -> float:
    """(rad/s)² of a frequency in Hz, sign kept."""
    return float(np.sign(frequency) * (2 * np.pi * frequency) ** 2)


def polish(
    stiffness: sparse.csr_array, mass: sparse.csr_array, values: Float, vectors: Float
) -> tuple[Float, Float, Float, float]:
    """Ascending order, exact unit modal mass, largest component positive; residuals and orthogonality.

    The values become Rayleigh quotients, whose error is quadratic: far from the shift, 1/θ has lost digits.

    Returns
    -------
    values (m,), vectors (f, m), residuals (m,), orthogonality
    """
    order = np.argsort(values, kind="stable")
    vectors = vectors[:, order]
    top = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)[0]
    mv = mass @ vectors
    scale = np.where(top < 0, -1.0, 1.0) / np.sqrt(np.einsum("ij,ij->j", vectors, mv))
    vectors, mv = vectors * scale, mv * scale
    kv = stiffness @ vectors
    values = np.einsum("ij,ij->j", vectors, kv)
    order = np.argsort(values, kind="stable")
    values, vectors, mv, kv = values[order], vectors[:, order], mv[:, order], kv[:, order]
    size = np.linalg.norm(kv, axis=0)
    floor = 1e-8 * np.linalg.norm(abs(stiffness) @ np.abs(vectors), axis=0)
    rest = np.linalg.norm(kv - mv * values, axis=0)
    residuals = rest / np.where(size > floor, size, np.maximum(floor * 1e8, np.finfo(float).tiny))
    gram = vectors.T @ mv - np.eye(values.size)
    return values, vectors, residuals, float(np.abs(gram).max(initial=0.0))
