"""Comparison of frequency response functions."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.errors import InputError


def _same(a: Complex, b: Complex) -> None:
    if a.shape != b.shape or a.ndim != 3:
        raise InputError(f"FRFs {a.shape} and {b.shape} must be (freq, out, in) on the same lines")


def frac(a: Complex, b: Complex) -> Float:
    """Frequency response assurance criterion, (out, in) 0..1: |Σ a* b|²/(Σ|a|² Σ|b|²) over lines (Heylen, 1996).

    Parameters
    ----------
    a, b : (freq, out, in) complex128
    """
    _same(a, b)
    below = (np.abs(a) ** 2).sum(axis=0) * (np.abs(b) ** 2).sum(axis=0)
    return np.asarray(np.abs((a.conj() * b).sum(axis=0)) ** 2 / np.where(below > 0, below, 1.0), dtype=np.float64)


def fdac(a: Complex, b: Complex) -> Float:
    """Frequency domain assurance criterion, (freq of a, freq of b) -1..1: cosine of the response shapes.

    Parameters
    ----------
    a, b : (freq, out) complex128, one input

    Notes
    -----
    Ridges off the diagonal show a frequency shift (Pascual, Golinval and Razeto, 1997).
    """
    left = np.linalg.norm(a, axis=1, keepdims=True)
    right = np.linalg.norm(b, axis=1, keepdims=True)
    cosine = (a / np.where(left > 0, left, 1.0)) @ (b / np.where(right > 0, right, 1.0)).conj().T
    return np.asarray(cosine.real, dtype=np.float64)


def magnitude_deviation(a: Complex, b: Complex) -> Float:
    """Root mean square of the level difference 20 log10|b/a| over the lines, (out, in) dB.

    Lines where either is below 1e-6 of its own peak are left out: there only noise is compared.
    """
    _same(a, b)
    size_a, size_b = np.abs(a), np.abs(b)
    use = (size_a > 1e-6 * size_a.max(axis=0)) & (size_b > 1e-6 * size_b.max(axis=0))
    ratio = np.where(use, size_b, 1.0) / np.where(use, size_a, 1.0)
    count = use.sum(axis=0)
    square = (20 * np.log10(ratio)) ** 2
    return np.asarray(np.sqrt(square.sum(axis=0) / np.where(count > 0, count, 1)), dtype=np.float64)


def relative_deviation(a: Complex, b: Complex) -> Float:
    """‖b − a‖/‖a‖ over the lines, (out, in): 0 is equal; magnitude and phase count."""
    _same(a, b)
    size = np.linalg.norm(a, axis=0)
    return np.asarray(np.linalg.norm(b - a, axis=0) / np.where(size > 0, size, 1.0), dtype=np.float64)
