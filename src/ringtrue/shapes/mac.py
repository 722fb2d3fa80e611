"""The modal assurance criterion on arrays of shapes (modes as columns)."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.errors import InputError


def _same_rows(a: Any_, b: Any_) -> None:
    if a.ndim != 2 or b.ndim != 2 or a.shape[0] != b.shape[0]:
        raise InputError(
            f"shapes {a.shape} and {b.shape} must be (channel, mode) with the same channels"
        )


def unit(shapes: Any_) -> Any_:
    """Columns scaled to unit Euclidean length; zero columns stay zero.

    Parameters
    ----------
    shapes : (n, m) float64 or complex128
    """
    length = np.linalg.norm(shapes, axis=0)
    return np.asarray(shapes / np.where(length > 0, length, 1.0))


def above_rounding(shapes: Any_) -> Any_:
    """Shapes (n, m) with those columns at zero that are rounding beside the others.

    A mode that does not move the channels still has values of rounding there, and a MAC of these is
    chance. The eigenvector of an eigenvalue that is exact to rounding ε is exact to √ε, relative to
    the largest of the set.
    """
    peak = np.abs(shapes).max(axis=0, initial=0.0)
    visible = peak > np.sqrt(np.finfo(np.float64).eps) * peak.max(initial=0.0)
    return np.asarray(np.where(visible, shapes, 0.0))


def mac(a: Any_, b: Any_) -> Float:
    """MAC = |aᴴb|² / (aᴴa · bᴴb) of each column of `a` with each of `b` (Allemang and Brown, 1982).

    Parameters
    ----------
    a : (n, ma) float64 or complex128
    b : (n, mb) float64 or complex128

    Returns
    -------
    (ma, mb) float64, 0..1; 0 where a shape is zero

    Raises
    ------
    InputError
        If the numbers of rows differ.
    """
    a, b = np.asarray(a), np.asarray(b)
    _same_rows(a, b)
    return np.asarray(np.minimum(np.abs(unit(a).conj().T @ unit(b)) ** 2, 1.0), dtype=np.float64)


def auto_mac(a: Any_) -> Float:
    """MAC of a set with itself, (m, m): off-diagonal terms tell which shapes the channels cannot
    separate.
    """
    return mac(a, a)


def worst_off_diagonal(auto: Float) -> float:
    """Largest off-diagonal term of a square auto-MAC; 0 for fewer than two modes."""
    off = np.array(auto, dtype=np.float64)
    np.fill_diagonal(off, 0.0)
    return float(off.max(initial=0.0))


def paired_mac(a: Any_, b: Any_) -> Float:
    """MAC of column k of `a` with column k of `b`, (m,)."""
    a, b = np.asarray(a), np.asarray(b)
    _same_rows(a, b)
    return np.asarray(
        np.minimum(np.abs((unit(a).conj() * unit(b)).sum(axis=0)) ** 2, 1.0), dtype=np.float64
    )
