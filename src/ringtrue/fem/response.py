"""Frequency response by modal superposition."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.errors import InputError, did_you_mean

_POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}


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
    if kind not in _POWER:
        raise InputError(f"kind {kind!r}{did_you_mean(kind, _POWER)}")
    w, wk = 2 * np.pi * np.asarray(freqs, dtype=np.float64), 2 * np.pi * np.asarray(frequencies, dtype=np.float64)
    below = wk * np.abs(wk) - w[:, None] ** 2 + 2j * damping * np.abs(wk) * w[:, None]
    power = _POWER[kind]
    if power == 2 and (below == 0).any():
        numerator = np.broadcast_to(-(w[:, None] ** 2), below.shape)
        rigid = below == 0
        q = np.where(rigid, 1.0, numerator / np.where(rigid, 1.0, below))
    elif (below == 0).any():
        raise InputError("a rigid-body mode has no receptance or mobility at 0 Hz; start above it")
    else:
        q = (1j * w[:, None]) ** power / below
    H = (phi_out[None] * q[:, None, :]) @ phi_in.T
    if residual is not None:
        H = H + ((1j * w) ** power)[:, None, None] * residual
    return np.asarray(H, dtype=np.complex128)
