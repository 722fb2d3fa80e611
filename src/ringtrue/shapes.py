"""Mode shapes against one another: MAC, orthogonality over a mass, complexity."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse
from scipy.spatial import ConvexHull, QhullError

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import InputError

Mass = Any_ | sparse.csr_array
# relative singular value below which the shapes at the channels count as dependent
RANK = 1e-8


def _weighted(mass: Mass, shapes: Any_) -> Any_:
    if shapes.ndim != 2 or mass.shape != (shapes.shape[0], shapes.shape[0]):
        raise InputError(
            f"mass {mass.shape} for shapes {shapes.shape}: it must be square over the rows of "
            "the shapes"
        )
    return mass @ shapes


def modal_mass(shapes: Any_, mass: Mass) -> Float:
    """φᴴMφ of each column, (m,).

    Parameters
    ----------
    shapes : (n, m) float64 or complex128
    mass : (n, n) float64, dense or sparse, symmetric
    """
    shapes = np.asarray(shapes)
    return np.asarray(
        (shapes.conj() * _weighted(mass, shapes)).sum(axis=0).real, dtype=np.float64
    )


def mass_normalised(shapes: Any_, mass: Mass) -> Any_:
    """Columns scaled to unit modal mass; columns without mass become zero."""
    shapes = np.asarray(shapes)
    m = modal_mass(shapes, mass)
    return shapes * np.where(m > 0, 1 / np.sqrt(np.where(m > 0, m, 1.0)), 0.0)


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
        np.abs(mass_normalised(a, mass).conj().T @ right).clip(0.0, 1.0),
        dtype=np.float64,
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
        np.abs(phi.conj().T @ weighed) ** 2
        + (np.abs(seen) ** 2).sum(axis=0)[:, None] * relative
    )
    return np.asarray(np.sqrt(square / (1 + own * relative)).clip(0.0, 1.0))


def self_orthogonality(a: Any_, mass: Mass) -> Float:
    """Cross-orthogonality of a set with itself, (m, m), ones on the diagonal."""
    return cross_orthogonality(a, a, mass)


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
            f"{phi.shape[0]} channels distinguish {rank} of {phi.shape[1]} shapes; take fewer "
            "modes or more channels"
        )
    return (
        np.asarray(linalg.solve_triangular(r, q.T))
        if phi.size
        else np.zeros(phi.shape[::-1])
    )


def mpc(shapes: Any_) -> Float:
    """Modal phase collinearity, (m,) float64: 1 for a shape that is real up to a phase.

    |φᵀφ|²/(φᴴφ)², equal to ((Sxx − Syy)² + 4 Sxy²)/(Sxx + Syy)² (Pappa, Elliott and Schenk, 1993).

    Parameters
    ----------
    shapes : (n, m) float64 or complex128
    """
    p = np.asarray(shapes)
    energy = (np.abs(p) ** 2).sum(axis=0)
    return np.asarray(
        np.abs((p * p).sum(axis=0)) ** 2 / np.where(energy > 0, energy, 1.0) ** 2,
        dtype=np.float64,
    )


def mean_phase(shapes: Any_) -> Float:
    """Angle (m,), rad in (−π/2, π/2], of the line through the origin that fits the components
    best.
    """
    p = np.asarray(shapes)
    return np.asarray(0.5 * np.angle((p * p).sum(axis=0)), dtype=np.float64)


def mpd(shapes: Any_) -> Float:
    """Mean phase deviation, (m,) rad: amplitude-weighted angle of the components from the mean
    (Reynders, 2012).
    """
    p = np.asarray(shapes) * np.exp(-1j * mean_phase(shapes))
    weight = np.abs(p)
    angle = np.arctan2(np.abs(p.imag), np.abs(p.real))
    total = weight.sum(axis=0)
    return np.asarray(
        (weight * angle).sum(axis=0) / np.where(total > 0, total, 1.0), dtype=np.float64
    )


def mcf(shapes: Any_) -> Float:
    """Modal complexity factor, (m,): area of the convex hull of the components over that of their
    circle.

    0 for a real shape, towards 1 for components of equal size at all phases (Imregun and Ewins,
    1995, MCF1).
    """
    if not np.iscomplexobj(shapes):
        return np.zeros(np.shape(shapes)[1])
    p = np.asarray(shapes, dtype=np.complex128)
    radius = np.abs(p).max(axis=0, initial=0.0)
    z = p / np.where(radius > 0, radius, 1.0)
    # hulls do not vectorise over modes
    return np.array([_hull_area(z[:, k]) / np.pi for k in range(z.shape[1])])


def _hull_area(z: Any_) -> float:
    """Area of the convex hull of complex points; 0 where they lie on a line."""
    try:
        return float(ConvexHull(np.column_stack([z.real, z.imag])).volume)
    except QhullError:
        return 0.0


def modal_scale_factor(a: Any_, b: Any_) -> Any_:
    """The factor (m,) on each column of `b` that brings it closest to the same column of `a`:
    bᴴa/(bᴴb).

    Parameters
    ----------
    a, b : (n, m) float64 or complex128
    """
    a = np.asarray(a)
    b = np.asarray(b)
    length = (np.abs(b) ** 2).sum(axis=0)
    return np.asarray((b.conj() * a).sum(axis=0) / np.where(length > 0, length, 1.0))


def realise(shapes: Any_) -> Float:
    """Real shapes (n, m) from complex ones: each turned by its mean phase (least change).

    Parameters
    ----------
    shapes : (n, m) complex128 or float64
    """
    turned = np.asarray(shapes) * np.exp(-1j * mean_phase(shapes))
    return np.ascontiguousarray(turned.real, dtype=np.float64)


def realise_modes(modes: ModeSet) -> ModeSet:
    """The modes with real shapes, rotated; a unit-modal-A scale has no meaning for them and becomes
    UNSCALED.
    """
    if not np.iscomplexobj(modes.shapes):
        return modes
    norm = modes.norm if modes.norm is Norm.MASS else Norm.UNSCALED
    return replace(modes, shapes=realise(modes.shapes), norm=norm)


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
    length = np.sqrt((shapes.conj() * shapes).real.sum(axis=0))
    return shapes / np.where(length > 0, length, 1.0)


def above_rounding(shapes: Any_) -> Any_:
    """Shapes (n, m) with those columns at zero that are rounding against the others.

    A mode that does not move the channels still has values of rounding there, and a MAC of these is
    chance. The eigenvector of an eigenvalue that is exact to rounding ε is exact to √ε, relative to
    the largest of the set.
    """
    peak = np.abs(shapes).max(axis=0, initial=0.0)
    visible = peak > np.sqrt(np.finfo(np.float64).eps) * peak.max(initial=0.0)
    return np.where(visible, shapes, 0.0)


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
    return np.asarray(
        np.minimum(np.abs(unit(a).conj().T @ unit(b)) ** 2, 1.0), dtype=np.float64
    )


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
        np.minimum(np.abs((unit(a).conj() * unit(b)).sum(axis=0)) ** 2, 1.0),
        dtype=np.float64,
    )


DEPENDENT = 1e-10  # relative singular value below which columns count as dependent
NIL = 1e-12  # Hz; what is relative to a rigid-body mode at 0 stays finite
FADE = 1.5  # times a limit, where what holds below the limit has faded away


def basis(b: Any_) -> Any_:
    """Orthonormal basis (n, r) of the columns of `b` (n, k), r <= k."""
    u, s, _ = np.linalg.svd(unit(np.asarray(b)), full_matrices=False)
    return u[:, s > DEPENDENT * max(s.max(initial=0.0), DEPENDENT)]


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
    return np.diff(ascending) / np.maximum(np.abs(ascending[1:]), NIL)


def close_groups(
    frequencies: Float, close: float, largest: int = 4
) -> tuple[tuple[int, ...], ...]:
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
    ends = [0, *(np.flatnonzero(gaps(f[order]) >= close) + 1).tolist(), f.size]
    modes = tuple(order.tolist())
    return tuple(
        g for a, b in pairwise(ends) if a < b for g in _split(modes[a:b], f, largest)
    )


def _split(chain: tuple[int, ...], f: Float, largest: int) -> list[tuple[int, ...]]:
    if len(chain) <= largest:
        return [chain]
    cut = int(np.argmax(np.diff(f[list(chain)]))) + 1
    return _split(chain[:cut], f, largest) + _split(chain[cut:], f, largest)
