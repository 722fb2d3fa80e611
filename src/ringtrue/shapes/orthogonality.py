"""Orthogonality of shapes over a mass matrix (modes as columns)."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.errors import InputError

Mass = Any_ | sparse.csr_array
RANK = 1e-8  # relative singular value below which the shapes at the channels count as dependent


def _weighted(mass: Mass, shapes: Any_) -> Any_:
    if shapes.ndim != 2 or mass.shape != (shapes.shape[0], shapes.shape[0]):
        raise InputError(
            f"mass {mass.shape} for shapes {shapes.shape}: it must be square over the rows of "
            "the shapes"
        )
    return np.asarray(mass @ shapes)


def modal_mass(shapes: Any_, mass: Mass) -> Float:
    """φᴴMφ of each column, (m,).

    Parameters
    ----------
    shapes : (n, m) float64 or complex128
    mass : (n, n) float64, dense or sparse, symmetric
    """
    shapes = np.asarray(shapes)
    return np.asarray((shapes.conj() * _weighted(mass, shapes)).sum(axis=0).real, dtype=np.float64)


def mass_normalised(shapes: Any_, mass: Mass) -> Any_:
    """Columns scaled to unit modal mass; columns without mass become zero."""
    shapes = np.asarray(shapes)
    m = modal_mass(shapes, mass)
    return np.asarray(shapes * np.where(m > 0, 1 / np.sqrt(np.where(m > 0, m, 1.0)), 0.0))


def cross_orthogonality(a: Any_, b: Any_, mass: Mass) -> Float:
    """|aᴴMb| of shapes of unit modal mass, (ma, mb) float64, 0..1: 1 for equal shapes, 0 for
    different modes.

    Parameters
    ----------
    a : (n, ma) float64 or complex128
    b : (n, mb) float64 or complex128
    mass : (n, n) float64, dense or sparse
        Of the structure at the rows of the shapes: of a test-analysis model (`reduction.static`).

    Raises
    ------
    InputError
        If the sizes do not fit.
    """
    a = np.asarray(a)
    b = np.asarray(b)
    right = _weighted(mass, mass_normalised(b, mass))
    return np.asarray(
        np.abs(mass_normalised(a, mass).conj().T @ right).clip(0.0, 1.0), dtype=np.float64
    )


def read_orthogonality(
    shapes: Any_, mass: Mass, error: Float, reading: Any_ | None = None
) -> Float:
    """Cross-orthogonality (m, m) to expect of shapes with the same ones read with random errors
    (columns).

    √(E|φ_iᴴM(φ_j + e)|² / E[(φ_j + e)ᴴM(φ_j + e)]), the errors e of the readings being independent.
    A mass that weighs patterns which no mode has makes much of them.

    Parameters
    ----------
    shapes : (k, m) float64 or complex128
        Coordinates that the mass is over.
    mass : (k, k) float64
    error : (m,) float64
        Standard deviation of a reading of each shape.
    reading : (k, n) float64, optional
        Coordinates of unit readings; the readings are the coordinates if not given.
    """
    phi = mass_normalised(shapes, mass)
    weighed = _weighted(mass, phi)
    if reading is None:
        seen = weighed
        own = mass.diagonal().sum()
    else:
        seen = reading.T @ weighed
        own = (reading * _weighted(mass, reading)).sum()
    scale = modal_mass(shapes, mass)
    relative = error**2 / np.where(scale > 0, scale, np.inf)
    square = (
        np.abs(phi.conj().T @ weighed) ** 2 + (np.abs(seen) ** 2).sum(axis=0)[:, None] * relative
    )
    return np.asarray(np.sqrt(square / (1 + own * relative)).clip(0.0, 1.0))


def self_orthogonality(a: Any_, mass: Mass) -> Float:
    """Cross-orthogonality of a set with itself, (m, m), ones on the diagonal."""
    return cross_orthogonality(a, a, mass)


def mass_mac(a: Any_, b: Any_, mass: Mass) -> Float:
    """MAC over the mass, (ma, mb): the square of the cross-orthogonality."""
    return np.asarray(cross_orthogonality(a, b, mass) ** 2)


def serep_mass(shapes: Any_) -> Float:
    """Mass Φ⁺ᵀΦ⁺ (n, n), at the channels, of a SEREP test-analysis model (O'Callahan, Avitabile and
    Riemer, 1989).

    Parameters
    ----------
    shapes : (n, m) float64
        Mass-normalised shapes of the model at the channels, m <= n. They are exactly orthonormal
        over this mass, whose rank is m: what of a test shape lies outside their span has no mass.

    Raises
    ------
    InputError
        If the channels cannot distinguish the shapes, or the shapes are complex.
    """
    back = pseudo_inverse(shapes)
    return np.asarray(back.T @ back)


def pseudo_inverse(shapes: Any_) -> Float:
    """Φ⁺ (m, n) of real shapes of full column rank; Φ⁺y are the modal coordinates of readings y.

    Raises
    ------
    InputError
        If the channels cannot distinguish the shapes, or the shapes are complex.
    """
    phi = np.asarray(shapes)
    if np.iscomplexobj(phi):
        raise InputError(
            "the shapes of the model are complex; make them real first (shapes.scale.realise)"
        )
    q, r = linalg.qr(phi, mode="economic") if phi.size else (phi, phi[:0])
    s = linalg.svdvals(r) if r.size else np.zeros(0)
    if phi.shape[1] > phi.shape[0] or (s.size and s[-1] <= RANK * s[0]):
        rank = int((s > RANK * s[0]).sum()) if s.size and s[0] > 0 else 0
        raise InputError(
            f"{phi.shape[0]} channels tell {rank} of {phi.shape[1]} shapes apart; take fewer "
            "modes or more channels"
        )
    return np.asarray(linalg.solve_triangular(r, q.T)) if phi.size else np.zeros(phi.shape[::-1])
