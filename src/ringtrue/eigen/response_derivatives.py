"""Derivatives of what is made of modes: MAC, complex modes, frequency responses; and by adjoints
for many parameters.

Adjoint vectors: Lee (1999); complex modes by a bordered system (Lee, Kim, Jung 1999), whose matrix
is regular at a simple pole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ringtrue.core.arrays import Complex, Float
from ringtrue.eigen.complement import Complement
from ringtrue.eigen.damped import DynamicStiffness
from ringtrue.eigen.derivatives import MatrixDerivatives, groups
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError


def frequency_derivatives(values: Float, d_lambda: Float) -> Float:
    """∂f/∂a (m, p), Hz, from λ (m,) and ∂λ/∂a (m, p); NaN for a rigid-body mode, whose root is not
    smooth.
    """
    noise = 1e-9 * np.abs(values).max(initial=0.0)
    root = np.where(np.abs(values) > noise, np.sqrt(np.abs(values)), np.nan)
    return np.asarray(d_lambda / (4 * np.pi * root[:, None]))


def mac_gradient(reference: Float, seen: Float) -> tuple[Float, Float]:
    """MAC of pairs of real shapes, and its gradient to the second.

    Parameters
    ----------
    reference, seen : (channel, m) float64

    Returns
    -------
    mac : (m,) float64
    gradient : (channel, m) float64
    """
    ab, aa, bb = (
        np.einsum("cm,cm->m", x, y)
        for x, y in ((reference, seen), (reference, reference), (seen, seen))
    )
    mac = ab**2 / (aa * bb)
    return mac, np.asarray(2 * (reference * ab / (aa * bb) - seen * mac / bb))


@dataclass(frozen=True, slots=True, eq=False)
class Adjoint:
    """What turns ∂K/∂a and ∂M/∂a into the derivative of one quantity of each mode.

    ∂J_j/∂a = w_jᵀ(K' − λ_jM')φ_j + u_jᵀM'φ_j.

    Attributes
    ----------
    values : (m,) float64, λ
    shapes : (f, m) float64, φ
    force : (f, m) float64, w
    mass : (f, m) float64, u
    """

    values: Float
    shapes: Float
    force: Float
    mass: Float

    def contract(self, slopes: Sequence[MatrixDerivatives]) -> Float:
        """∂J/∂a (m, p) from sparse matrices; `fem.derivatives.bilinear` gives the same from
        elements.
        """
        out = np.empty((self.values.size, len(slopes)))
        for i, s in enumerate(slopes):  # over parameters
            dk = s.stiffness @ self.shapes
            dm = s.mass @ self.shapes
            out[:, i] = np.einsum("fm,fm->m", self.force, dk - dm * self.values)
            out[:, i] += np.einsum("fm,fm->m", self.mass, dm)
        return out

    def from_products(self, stiffness: Float, mass: Float) -> Float:
        """∂J/∂a (m, p) from wᵀK'φ (m, p) and (wᵀM'φ, uᵀM'φ) (2, m, p)."""
        return np.asarray(stiffness - self.values[:, None] * mass[0] + mass[1])


def adjoint(
    pencil: Pencil, modes: EigenModes, gradient: Float, *, tolerance: float = 1e-7
) -> Adjoint:
    """Adjoint vectors of one quantity J_j(φ_j) of each of the lowest m modes: m solves, however
    many parameters.

    Parameters
    ----------
    pencil : Pencil
    modes : EigenModes
        All from the lowest up, more than m.
    gradient : (f, m) float64
        ∂J_j/∂φ_j.
    tolerance : float
        Relative residual of the adjoint equations.

    Notes
    -----
    In a group of repeated roots J must be blind to rotation in the group, like a subspace MAC.
    """
    m = gradient.shape[1]
    if m > modes.values.size:
        raise InputError(f"gradients of {m} modes; {modes.values.size} are given")
    phi = modes.vectors
    lam = modes.values
    at = groups(modes.values)
    same = at[:, None] == at[:m]
    seen = phi.T @ gradient
    gap = np.where(same, 1.0, lam[:m] - lam[:, None])
    rest = Complement(pencil, modes, lam[:m], m).solve(gradient, lam[:m], tolerance)
    force = phi @ np.where(same, 0.0, seen / gap) - rest
    return Adjoint(lam[:m], phi[:, :m], force, phi @ np.where(same, -0.5 * seen, 0.0))


def pole_derivatives(
    poles: Complex, shapes: Complex, slopes: Sequence[MatrixDerivatives]
) -> Complex:
    """∂s/∂a (m, p), rad/s: −φᵀ(s²M' + sD' + K' + iH')φ for shapes (f, m) of unit modal A."""
    out = np.empty((poles.size, len(slopes)), dtype=np.complex128)
    for i, s in enumerate(slopes):  # over parameters
        out[:, i] = -np.einsum("fm,fm->m", shapes, _dynamic(s, shapes, poles))
    return out


def _dynamic(s: MatrixDerivatives, x: Complex, poles: Complex) -> Complex:
    """(s²M' + sD' + K' + iH')x, a pole for each column of x (f, m)."""
    out = (s.mass @ x) * poles**2 + s.stiffness @ x
    if s.viscous is not None:
        out = out + (s.viscous @ x) * poles
    if s.structural is not None:
        out = out + 1j * (s.structural @ x)
    return np.asarray(out)


def complex_mode_derivatives(
    system: DynamicStiffness, poles: Complex, shapes: Complex, slopes: Sequence[MatrixDerivatives]
) -> tuple[Complex, Complex]:
    """∂s/∂a (m, p) and ∂φ/∂a (f, m, p) of simple poles with shapes of unit modal A, φᵀ(2sM + D)φ =
    1.

    One sparse factorisation a mode, of the bordered matrix [Z, Z_sφ; φᵀZ_s, 0], serves all
    parameters.
    """
    f, m = shapes.shape
    d_poles = np.empty((m, len(slopes)), dtype=np.complex128)
    d_shapes = np.empty((f, m, len(slopes)), dtype=np.complex128)
    for j in range(m):  # over modes: each has its own matrix
        s = complex(poles[j])
        phi = shapes[:, j]
        zs = np.asarray(2 * s * (system.mass @ phi) + system.viscous @ phi)
        size = (
            np.abs(system.stiffness.diagonal()).max() / np.abs(zs).max()
        )  # of the border, for a balanced matrix
        edge = sparse.csc_array((zs * size)[:, None])
        bordered = sparse.block_array([[system.matrix(s), edge], [edge.T, None]], format="csc")
        load = np.stack([_dynamic(q, phi[:, None], poles[j : j + 1])[:, 0] for q in slopes], axis=1)
        norm = np.array([phi @ (2 * s * (q.mass @ phi) + _times(q.viscous, phi)) for q in slopes])
        inner = phi @ np.asarray(system.mass @ phi)
        # 2 φᵀZ_sφ' = −φᵀZ_s'φ − 2 s' φᵀMφ, with s' known: it is −φᵀZ'φ
        ds = -(phi @ load)
        rhs = np.vstack([-load, (-(norm / 2) - ds * inner)[None] * size])
        x = np.asarray(splu(bordered).solve(rhs.astype(np.complex128)))
        d_poles[j] = ds
        d_shapes[:, j] = x[:-1]
    return d_poles, d_shapes


def _times(a: sparse.csr_array | None, x: Complex) -> Complex:
    return np.zeros_like(x) if a is None else np.asarray(a @ x)


def frf_derivatives(
    system: DynamicStiffness,
    outputs: sparse.csr_array,
    inputs: sparse.csr_array,
    freqs: Float,
    slopes: Sequence[MatrixDerivatives],
) -> tuple[Complex, Complex]:
    """Receptances by direct solution, and their derivatives −(Z⁻¹Cᵀ)ᵀ Z' (Z⁻¹B).

    Parameters
    ----------
    outputs, inputs : (o, f), (i, f) csr_array
        Rows that pick an output or an input.
    freqs : (q,) float64, Hz

    Returns
    -------
    h : (q, o, i) complex128
    d_h : (q, o, i, p) complex128
    """
    o = outputs.shape[0]
    i = inputs.shape[0]
    h = np.empty((freqs.size, o, i), dtype=np.complex128)
    d_h = np.empty((*h.shape, len(slopes)), dtype=np.complex128)
    rhs = np.hstack([outputs.toarray().T, inputs.toarray().T])
    for q, f in enumerate(freqs.tolist()):  # over lines: each has its own factorisation
        s = 2j * np.pi * f
        x = system.solve(s, rhs)
        left = x[:, :o]
        right = x[:, o:]
        h[q] = np.asarray(outputs @ right)
        for k, slope in enumerate(slopes):
            d_h[q, :, :, k] = -left.T @ _dynamic(slope, right, np.full(i, s))
    return h, d_h


def modal_frf_derivatives(
    freqs: Float,
    values: Float,
    damping: Float,
    phi_out: Float,
    phi_in: Float,
    d_lambda: Float,
    d_out: Float,
    d_in: Float,
) -> Complex:
    """Derivatives (q, o, i, p) of receptances Σ φ_o φ_iᵀ/(λ − ω² + 2iζ√λ ω) of the modes; ζ stays.

    Parameters
    ----------
    freqs : (q,) float64, Hz
    values, damping : (m,) float64
    phi_out, phi_in : (o, m), (i, m) float64
    d_lambda : (m, p) float64
    d_out, d_in : (o, m, p), (i, m, p) float64
    """
    w = 2 * np.pi * freqs[:, None]
    root = np.sqrt(np.abs(values))
    g = 1 / (values - w**2 + 2j * damping * root * w)
    slope = -(g**2) * (1 + 1j * damping * w / np.where(root > 0, root, np.inf))
    parts = (("qm,omp,im->qoip", (g, d_out, phi_in)), ("qm,om,imp->qoip", (g, phi_out, d_in)))
    out = sum(np.einsum(rule, *arrays, optimize=True) for rule, arrays in parts)
    return np.asarray(
        out + np.einsum("qm,mp,om,im->qoip", slope, d_lambda, phi_out, phi_in, optimize=True)
    )
