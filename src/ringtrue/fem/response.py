"""Frequency response by modal superposition, with coupled modes and residual vectors, and by direct
solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.channels import POWER
from ringtrue.core.iterate import Progress, quiet
from ringtrue.eigen.damped import DynamicStiffness
from ringtrue.errors import InputError, did_you_mean


def _power(kind: str) -> int:
    if kind not in POWER:
        raise InputError(f"kind {kind!r}{did_you_mean(kind, POWER)}")
    return POWER[kind]


def frf(
    freqs: Float,
    frequencies: Float,
    damping: Float,
    phi_out: Float,
    phi_in: Float,
    kind: str = "accelerance",
    *,
    residual: Float | None = None,
) -> Complex:
    """H(ω) = (iω)^n [Σ φ_out φ_inᵀ / (ω_k² − ω² + 2iζ_k ω_k ω) + residual].

    Parameters
    ----------
    freqs : (freq,) float64, Hz
    frequencies : (m,) float64, Hz
        Negative ones are unstable (λ < 0), zero ones rigid-body modes.
    damping : (m,) float64, fraction of critical
    phi_out, phi_in : (out, m), (in, m) float64
        Mass-normalised shapes at the outputs and inputs.
    kind : {"receptance", "mobility", "accelerance"}
    residual : (out, in) float64, optional
        Static flexibility of the modes that are left out, per unit force.

    Returns
    -------
    (freq, out, in) complex128

    Raises
    ------
    InputError
        On an unknown kind, or a rigid-body mode at 0 Hz in a receptance or mobility.
    """
    power = _power(kind)
    w = 2 * np.pi * np.asarray(freqs, dtype=np.float64)
    wk = 2 * np.pi * np.asarray(frequencies, dtype=np.float64)
    below = wk * np.abs(wk) - w[:, None] ** 2 + 2j * damping * np.abs(wk) * w[:, None]
    if power == 2 and (below == 0).any():
        numerator = np.broadcast_to(-(w[:, None] ** 2), below.shape)
        rigid = below == 0
        q = np.where(rigid, 1.0, numerator / np.where(rigid, 1.0, below))
    elif (below == 0).any():
        raise InputError(
            "a rigid-body mode has no receptance or mobility at 0 Hz; start above it"
        )
    else:
        q = (1j * w[:, None]) ** power / below
    H = (phi_out[None] * q[:, None, :]) @ phi_in.T
    if residual is not None:
        H = H + ((1j * w) ** power)[:, None, None] * residual
    return np.asarray(H, dtype=np.complex128)


@dataclass(frozen=True, slots=True, eq=False)
class CoupledModes:
    """Modes that the model's own damping couples.

    Attributes
    ----------
    values : (m,) float64, (rad/s)²
    viscous, structural : (m, m) float64
    """

    values: Float
    viscous: Float
    structural: Float


def coupled(
    freqs: Float,
    modes: CoupledModes,
    phi_out: Float,
    phi_in: Float,
    *,
    kind: str = "accelerance",
) -> Complex:
    """H(ω) = (iω)^n Φ_out (Λ − ω² + iωΦᵀDΦ + iΦᵀHΦ)⁻¹ Φ_inᵀ: modes coupled by the model's own
    damping.

    Parameters
    ----------
    freqs : (freq,) float64, Hz
    modes : CoupledModes
    phi_out, phi_in : (out, m), (in, m) float64
        Mass-normalised shapes and residual vectors at the outputs and inputs.
    kind : {"receptance", "mobility", "accelerance"}

    Returns
    -------
    (freq, out, in) complex128

    Raises
    ------
    InputError
        On an unknown kind, or a frequency at which an undamped mode stands.
    """
    power = _power(kind)
    w = 2 * np.pi * np.asarray(freqs, dtype=np.float64)[:, None, None]
    at_rest = np.diag(modes.values) + 1j * modes.structural
    q = at_rest - w**2 * np.eye(modes.values.size) + 1j * w * modes.viscous
    try:
        x = np.linalg.solve(q, np.broadcast_to(phi_in.T, (w.shape[0], *phi_in.T.shape)))
    except np.linalg.LinAlgError:
        raise InputError(
            "an undamped mode stands at one of the frequencies; leave it out or give damping"
        ) from None
    return np.asarray((1j * w) ** power * (phi_out @ x), dtype=np.complex128)


def direct(
    system: DynamicStiffness,
    freqs: Float,
    rows_out: sparse.csr_array,
    rows_in: sparse.csr_array,
    *,
    kind: str = "accelerance",
    progress: Progress = quiet,
) -> Complex:
    """H(ω) = (iω)^n C_out Q(iω)⁻¹ C_inᵀ, one factorisation a frequency on one analysis.

    Parameters
    ----------
    system : DynamicStiffness
    freqs : (freq,) float64, Hz
    rows_out, rows_in : (out, f), (in, f) csr_array
        Motions and loads in the DOFs of the system.
    kind : {"receptance", "mobility", "accelerance"}

    Returns
    -------
    (freq, out, in) complex128

    Raises
    ------
    InputError
        On an unknown kind.
    SingularModel
        If an undamped mode stands at one of the frequencies.
    """
    power = _power(kind)
    loads = rows_in.T.toarray()
    H = np.empty((len(freqs), rows_out.shape[0], rows_in.shape[0]), dtype=np.complex128)
    # each is a factorisation of its own
    for i, f in enumerate(np.asarray(freqs, dtype=np.float64).tolist()):
        s = 2j * np.pi * f
        H[i] = s**power * (rows_out @ system.solve(s, loads))
        progress((i + 1) / len(freqs), f"direct solution at {len(freqs)} lines")
    return H
