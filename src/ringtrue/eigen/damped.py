"""Complex modes of a damped structure, projected on its real modes.

s²M + sD + K + iH with viscous damping D and structural damping H; first-order form of Foss (1958).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Complex, Float, freeze_fields
from ringtrue.errors import InputError

REPEATED = 1e-8  # poles closer than this are made A-orthogonal as a group


@dataclass(frozen=True, slots=True, eq=False)
class ComplexModes:
    """Poles with Im > 0, ascending modulus.

    Attributes
    ----------
    poles : (m,) complex128, rad/s
    shapes : (n, m) complex128
        In the basis that the matrices were given in, scaled to unit modal A: φᵀ(2sM + D)φ = 1.
    """

    poles: Complex
    shapes: Complex

    def __post_init__(self) -> None:
        freeze_fields(self, poles=np.complex128, shapes=np.complex128)

    @property
    def frequencies(self) -> Float:
        """(m,) |s|/2π, Hz."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> Float:
        """(m,) −Re(s)/|s|."""
        return -self.poles.real / np.abs(self.poles)


def project(phi: Float, viscous: sparse.csr_array | None, structural: sparse.csr_array | None) -> tuple[Float, Float]:
    """ΦᵀDΦ and ΦᵀHΦ, (n, n) each; zeros for None."""
    n = phi.shape[1]
    made = [np.zeros((n, n)) if a is None else np.asarray(phi.T @ (a @ phi)) for a in (viscous, structural)]
    return (made[0] + made[0].T) / 2, (made[1] + made[1].T) / 2


def complex_modes(values: Float, viscous: Float, structural: Float | None = None) -> ComplexModes:
    """Complex modes in the basis of n mass-normalised real modes.

    Parameters
    ----------
    values : (n,) float64, λ, (rad/s)²
    viscous : (n, n) float64, ΦᵀDΦ
    structural : (n, n) float64, ΦᵀHΦ, optional

    Raises
    ------
    InputError
        If the sizes differ.
    """
    n = values.size
    structural = np.zeros((n, n)) if structural is None else structural
    if viscous.shape != (n, n) or structural.shape != (n, n):
        raise InputError(f"{n} modes, viscous {viscous.shape}, structural {structural.shape}: sizes differ")
    stiffness = np.diag(values) + (1j * structural if structural.any() else 0.0)
    zero, eye = np.zeros((n, n)), np.eye(n)
    s, y = linalg.eig(np.block([[zero, eye], [-stiffness, -viscous]]))
    scale = np.sqrt(np.abs(values).max(initial=0.0))
    at = np.flatnonzero(s.imag > 1e-10 * max(scale, np.finfo(float).tiny))
    at = at[np.argsort(np.abs(s[at]), kind="stable")]
    return ComplexModes(s[at], _unit_modal_a(s[at], y[:n, at], viscous))


def _unit_modal_a(s: Complex, phi: Complex, viscous: Float) -> Complex:
    """Scale each group of equal poles so that Yᵀ A Y = I; the symmetric root keeps the phase convention."""
    gram = phi.T @ viscous @ phi + (s[:, None] + s) * (phi.T @ phi)
    gap = np.abs(np.diff(s)) > REPEATED * np.abs(s[1:])
    edges = np.concatenate([[0], np.flatnonzero(gap) + 1, [s.size]])
    out = phi.astype(np.complex128)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):  # over groups of modes
        block = gram[a:b, a:b]
        root = np.sqrt(block) if b - a == 1 else linalg.sqrtm((block + block.T) / 2)
        out[:, a:b] = np.linalg.solve(np.asarray(root).T, phi[:, a:b].T).T
    return out
