"""Real normal modes from measured complex modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import InputError
from ringtrue.shapes.complexity import mean_phase


def rotated(modes: ModeSet) -> ModeSet:
    """Each shape turned by its mean phase and its imaginary part dropped.

    The modulus of the whole shape is kept; right for small complexity that is scatter, not damping.
    """
    turned = modes.shapes * np.exp(-1j * mean_phase(modes.shapes))
    return replace(
        modes, shapes=_as_long(turned.real, np.asarray(modes.shapes, dtype=np.complex128))
    )


def niedbal(modes: ModeSet) -> ModeSet:
    """Real shapes Re Ψ + Im Ψ (Re Ψᵀ Re Ψ)⁻¹ Re Ψᵀ Im Ψ (Niedbal 1984, IMAC II).

    The shapes are turned by their mean phase first. The real combination of all complex shapes that
    stands closest to each: what damping couples between the modes of the set is taken out to second
    order.

    Raises
    ------
    InputError
        If there are fewer channels than modes.
    """
    _enough(modes.shapes)
    turned = modes.shapes * np.exp(-1j * mean_phase(modes.shapes))
    real, imag = turned.real, turned.imag
    shapes = real + imag @ np.linalg.lstsq(real, imag, rcond=None)[0]
    return replace(modes, shapes=_as_long(shapes, np.asarray(modes.shapes, dtype=np.complex128)))


def normal_modes(model: ModalModel, source: str = "") -> ModeSet:
    """Undamped frequencies and real shapes from M⁻¹K and M⁻¹C of the measured poles and shapes
    (Ibrahim 1983).

    The complex shapes span a real space of as many dimensions as there are modes; there ΨΛ² + M⁻¹C
    ΨΛ + M⁻¹K Ψ = 0 with its conjugate fixes both matrices. Exact if the modes outside the set do
    not couple with it by damping.

    Returns
    -------
    ModeSet
        Ascending; frequencies √eig(M⁻¹K)/2π, damping the diagonal of M⁻¹C in normal coordinates
        over 2ω. Unit modal mass if the model is of unit modal A, else the length of the complex
        shape.

    Raises
    ------
    InputError
        If there are fewer channels than modes.
    """
    _enough(model.shapes)
    m = model.poles.size
    scale = np.linalg.norm(model.shapes, axis=0)
    psi = model.shapes / scale * np.exp(-1j * mean_phase(model.shapes))
    basis = np.linalg.svd(np.concatenate([psi.real, psi.imag], axis=1), full_matrices=False)[0][
        :, :m
    ]
    q = basis.T @ psi
    w = np.abs(model.poles).max()
    p = model.poles / w
    both = np.concatenate(
        [np.concatenate([q, q.conj()], 1), np.concatenate([q * p, (q * p).conj()], 1)]
    )
    right = np.concatenate([q * p**2, (q * p**2).conj()], axis=1)
    kc = -np.linalg.solve(both.T, right.T).T.real
    values, vectors = np.linalg.eig(kc[:, :m])
    order = np.argsort(values.real)
    omega = np.sqrt(np.maximum(values.real[order], 0))
    v = vectors.real[:, order]
    damping = np.diag(np.linalg.solve(v, kc[:, m:] @ v)) / (2 * np.maximum(omega, 1e-300))
    shapes, norm = _scaled(model, basis @ v)
    return ModeSet(
        omega * w / (2 * np.pi), damping, shapes, tuple(c.id for c in model.outputs), norm, source
    )


def _scaled(model: ModalModel, shapes: Float) -> tuple[Float, Norm]:
    """Columns with length and sign of the complex shape most alike; unit modal mass from unit modal
    A.
    """
    mass = model.norm is Norm.MODAL_A
    psi = model.shapes * (
        np.sqrt(2j * model.poles.imag) if mass else np.exp(-1j * mean_phase(model.shapes))
    )
    unit = shapes / np.linalg.norm(shapes, axis=0)
    like = unit.T @ psi
    at = (np.abs(like) / np.linalg.norm(psi, axis=0)).argmax(axis=1)
    factor = like[np.arange(at.size), at].real
    return unit * factor, Norm.MASS if mass else Norm.UNSCALED


def _as_long(shapes: Float, like: Complex) -> Float:
    size = np.linalg.norm(shapes, axis=0)
    return np.asarray(shapes * np.linalg.norm(like, axis=0) / np.where(size > 0, size, 1.0))


def _enough(shapes: Complex) -> None:
    n, m = shapes.shape
    if n < m:
        raise InputError(
            f"{n} channels for {m} modes: real normal modes need as many channels as modes; take "
            "a band"
        )
