"""The modal assurance criterion on arrays of shapes (modes as columns).

Groups of close modes: only the space they span is well defined, not the single shapes.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

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
    """Shapes (n, m) with those columns at zero that are rounding against the others.

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
    a = np.asarray(a)
    b = np.asarray(b)
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
    a = np.asarray(a)
    b = np.asarray(b)
    _same_rows(a, b)
    return np.asarray(
        np.minimum(np.abs((unit(a).conj() * unit(b)).sum(axis=0)) ** 2, 1.0), dtype=np.float64
    )


RANK = 1e-10  # relative singular value below which columns count as dependent
NIL = 1e-12  # Hz; what is relative to a rigid-body mode at 0 stays finite
FADE = 1.5  # times a limit, where what holds below the limit has faded away


def basis(b: Any_) -> Any_:
    """Orthonormal basis (n, r) of the columns of `b` (n, k), r <= k."""
    u, s, _ = linalg.svd(unit(np.asarray(b)), full_matrices=False)
    return np.asarray(u[:, s > RANK * max(s.max(initial=0.0), RANK)])


def principal_angles(a: Any_, b: Any_) -> Float:
    """Principal angles between the spans of `a` (n, ka) and `b` (n, kb), rad, ascending, (min(ra,
    rb),).

    Source: Björck and Golub (1973); sine form for small angles (Knyazev and Argentati, 2002).
    """
    qa = basis(a)
    qb = basis(b)
    if qa.shape[1] < qb.shape[1]:
        qa, qb = qb, qa
    cross = qa.conj().T @ qb
    cosine = linalg.svdvals(cross).clip(0.0, 1.0)
    sine = linalg.svdvals(qb - qa @ cross)[::-1].clip(0.0, 1.0)
    return np.asarray(np.where(cosine**2 < 0.5, np.arccos(cosine), np.arcsin(sine)))


def subspace_mac(a: Any_, b: Any_) -> Float:
    """Share of each shape of `a` (n, ka) that lies in the span of `b` (n, kb): (ka,) float64, 0..1.

    Equal to the MAC where `b` is one shape.
    """
    return share_in(unit(np.asarray(a)), b)


def share_in(a: Any_, b: Any_) -> Float:
    """The same of shapes `a` (n, ka) of unit length."""
    share = np.abs(basis(b).conj().T @ a) ** 2
    return np.asarray(share.sum(axis=0).clip(0.0, 1.0), dtype=np.float64)


def rotation(a: Any_, b: Any_) -> Any_:
    """The matrix T (kb, ka), TᴴT = 1, that turns mass-normalised shapes `b` towards `a`: compare `b
    @ T` with `a`.

    Close mass-normalised modes are defined up to such a T. The scale of `a` is free: `b⁺a` is
    scaled by column before its polar factor is taken.

    Parameters
    ----------
    a : (n, ka) float64 or complex128
    b : (n, kb) float64 or complex128, kb >= ka
    """
    raw = np.linalg.lstsq(np.asarray(b), unit(np.asarray(a)), rcond=None)[0]
    u, _, vh = np.linalg.svd(unit(raw), full_matrices=False)
    return np.asarray(u @ vh)


def fade(ratio: Float) -> tuple[Float, Float]:
    """How far what holds up to a limit still holds, 1 up to ratio 1 and 0 from `FADE` on, and its
    derivative.

    Smooth, so that what rests on closeness does not jump where modes separate.
    """
    t = np.clip((FADE - np.asarray(ratio)) / (FADE - 1), 0.0, 1.0)
    return t * t * (3 - 2 * t), 6 * t * (t - 1) / (FADE - 1)


def gaps(ascending: Float) -> Float:
    """Relative distance of each of (m,) ascending frequencies, Hz, from the one before it, (m -
    1,).
    """
    return np.asarray(np.diff(ascending) / np.maximum(np.abs(ascending[1:]), NIL))


def close_groups(frequencies: Float, close: float, largest: int = 4) -> tuple[tuple[int, ...], ...]:
    """Positions of modes closer than `close` (relative) to their neighbour, as groups of at most
    `largest`.

    Parameters
    ----------
    frequencies : (m,) float64, Hz, in any order
    close : float
        Relative distance of neighbours.
    largest : int
        A longer chain is split at its widest gaps: a dense band is not one subspace.

    Returns
    -------
    tuple of tuple of int
        Every mode is in exactly one group; most groups hold one mode.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    order = np.argsort(f, kind="stable")
    chains = np.split(order, np.flatnonzero(gaps(f[order]) >= close) + 1) if f.size else []
    return tuple(g for chain in chains for g in _split(tuple(chain.tolist()), f, largest))


def _split(chain: tuple[int, ...], f: Float, largest: int) -> list[tuple[int, ...]]:
    if len(chain) <= largest:
        return [chain]
    cut = int(np.argmax(np.diff(f[list(chain)]))) + 1
    return _split(chain[:cut], f, largest) + _split(chain[cut:], f, largest)
