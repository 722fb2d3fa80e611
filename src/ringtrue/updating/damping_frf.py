"""Damping of mechanisms from FRFs around the resonances.

In the basis of the updated model's mass-normalised modes, with the D and H of `update.damping`,

    (Λ(1 + δ) − ω² + iωD + iH) q = Φᵀf.

δ takes up what is left of the deviations of the eigenvalues, so that a shifted peak is not read as
damping. A linear least-squares solution (equation error) starts the bounded nonlinear one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ringtrue.core.arrays import Complex, Float, Int, freeze_fields
from ringtrue.errors import InputError
from ringtrue.updating.damping import (
    FAINT,
    DampingFit,
    Mechanism,
    assembled,
    check_mechanisms,
    refined,
)

SHIFT = 0.02  # prior standard deviation of δ


def near_resonances(freqs: Float, frequencies: Float, damping: Float, *, width: float = 4.0) -> Int:
    """Lines within `width` half-power half-bandwidths ζf of a resonance, (l,) int64."""
    reach = width * np.asarray(damping) * frequencies
    return np.flatnonzero((np.abs(freqs[:, None] - frequencies) <= reach).any(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class FrfData:
    """Receptances to fit, at lines around the resonances.

    Attributes
    ----------
    freqs : (l,) float64, Hz
    measured : (l, o, i) complex128
        Receptance; an accelerance over (iω)².
    phi_out, phi_in : (o, n), (i, n) float64
        Mass-normalised shapes of the basis there.
    std : float or (l, o, i) float64
        Of the real and of the imaginary part.
    residual : (o, i) float64
        Static flexibility of the modes that are not in the basis.
    """

    freqs: Float
    measured: Complex
    phi_out: Float
    phi_in: Float
    std: float | Float
    residual: Float | float = 0.0

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, freqs=f, measured=np.complex128, phi_out=f, phi_in=f)
        shape = (self.freqs.size, self.phi_out.shape[0], self.phi_in.shape[0])
        if (
            self.measured.shape != shape
            or not (np.asarray(self.std) > 0).all()
            or self.freqs.min(initial=1.0) <= 0
        ):
            raise InputError(
                f"FRFs {self.measured.shape} for {shape}; std must be > 0, lines above 0 Hz"
            )
        if self.phi_out.shape[1] != self.phi_in.shape[1]:
            raise InputError(
                f"shapes at outputs {self.phi_out.shape} and inputs {self.phi_in.shape}: modes "
                "differ"
            )


def fit_frfs(
    values: Float, mechanisms: Sequence[Mechanism], data: FrfData, *, shift: float = SHIFT
) -> DampingFit:
    """Coefficients from FRFs around the resonances.

    Parameters
    ----------
    values : (n,) float64, λ, (rad/s)²
    mechanisms : sequence (k)
    data : FrfData
    shift : float
        Prior standard deviation of the relative correction of each eigenvalue; 0 holds the model's.

    Raises
    ------
    InputError
        If the channels cannot tell the modes apart, or sizes differ.
    """
    check_mechanisms(mechanisms, values.size)
    if data.phi_out.shape[1] != values.size:
        raise InputError(f"shapes of {data.phi_out.shape[1]} modes for {values.size} eigenvalues")
    linear = _equation_error(values, mechanisms, data, shift)

    def residual(c: Float) -> tuple[Float, Float]:
        h, slope = _response(values, mechanisms, data, c, shift > 0)
        r = (h - data.measured) / data.std
        g = slope / np.asarray(data.std)[..., None] if np.ndim(data.std) else slope / data.std
        flat = g.reshape(r.size, -1)
        return np.concatenate([r.real.ravel(), r.imag.ravel()]), np.concatenate(
            [flat.real, flat.imag]
        )

    return refined(residual, linear, mechanisms, values.size, shift=shift, least=0.0)


def _equation_error(
    values: Float, mechanisms: Sequence[Mechanism], data: FrfData, shift: float
) -> Float:
    """Coefficients and δ by linear least squares on (Λ(1 + δ) − ω² + iωD + iH) q = Φᵀf, rows over
    the static λ.

    q comes from the measured responses by the pseudo-inverse of the shapes; noise in q biases it,
    so it only starts.
    """
    n, k = values.size, len(mechanisms)
    if np.linalg.matrix_rank(data.phi_out) < n:
        raise InputError(
            f"{data.phi_out.shape[0]} channels cannot tell {n} modes apart: keep fewer in the basis"
        )
    w = 2 * np.pi * data.freqs[:, None, None]
    q = np.linalg.pinv(data.phi_out) @ (data.measured - data.residual)  # (l, n, i)
    load = data.phi_in.T - (values[:, None] - w**2) * q
    columns = [(1j * w if m.kind == "viscous" else 1j) * (m.matrix @ q) for m in mechanisms]
    if shift > 0:
        columns += [values[:, None] * q * e[:, None] for e in np.eye(n)]
    g = np.stack(columns, axis=-1) / values[:, None, None]
    rows, rhs = g.reshape(-1, g.shape[-1]), (load / values[:, None]).ravel()
    both = np.concatenate([rows.real, rows.imag])
    low = np.array([m.lower for m in mechanisms] + [-np.inf] * (len(columns) - k))
    high = np.array([m.upper for m in mechanisms] + [np.inf] * (len(columns) - k))
    size = np.maximum(np.linalg.norm(both, axis=0), FAINT)
    found = lsq_linear(both / size, np.concatenate([rhs.real, rhs.imag]), (low * size, high * size))
    return np.asarray(found.x / size)


def _response(
    values: Float, mechanisms: Sequence[Mechanism], data: FrfData, c: Float, shifted: bool
) -> tuple[Complex, Complex]:
    """Receptances (l, o, i) and their derivatives (l, o, i, k + n) to coefficients and δ."""
    n, k = values.size, len(mechanisms)
    d, h = assembled(mechanisms, c[:k], n)
    lam = values * (1 + c[k:]) if shifted else values
    w = 2 * np.pi * data.freqs[:, None, None]
    z = np.diag(lam) - w**2 * np.eye(n) + 1j * w * d + 1j * h
    into = np.linalg.solve(z, np.broadcast_to(data.phi_in.T, (w.shape[0], *data.phi_in.T.shape)))
    out = np.linalg.solve(
        z, np.broadcast_to(data.phi_out.T, (w.shape[0], *data.phi_out.T.shape))
    ).swapaxes(1, 2)
    parts = [-(1j * w if m.kind == "viscous" else 1j) * (out @ m.matrix @ into) for m in mechanisms]
    if shifted:
        parts += [
            -lam_0 * out[:, :, [j]] * into[:, [j], :] for j, lam_0 in enumerate(values.tolist())
        ]
    return np.asarray(data.phi_out @ into + data.residual), np.stack(parts, axis=-1).astype(
        np.complex128
    )
