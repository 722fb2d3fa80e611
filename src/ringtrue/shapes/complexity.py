"""How far a complex mode shape is from a real one.

Scaling of shapes against each other, and the explicit step from complex to real shapes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import ConfigError, did_you_mean


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
        np.abs((p * p).sum(axis=0)) ** 2 / np.where(energy > 0, energy, 1.0) ** 2, dtype=np.float64
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
    return np.array(
        [_hull_area(z[:, k]) / np.pi for k in range(z.shape[1])]
    )  # hulls do not vectorise over modes


def _hull_area(z: Any_) -> float:
    """Area of the convex hull of complex points: monotone chain (Andrew, 1979)."""
    points = np.unique(_outside(z))  # sorts by real, then imaginary part
    ring = _chain(points)[:-1] + _chain(points[::-1])[:-1]
    v = np.array(ring)
    return float(abs((v.conj() * np.roll(v, -1)).imag.sum()) / 2) if v.size > 2 else 0.0


def _outside(z: Any_) -> Any_:
    """The points not strictly inside the polygon of those farthest in 32 directions (Akl and
    Toussaint, 1978).
    """
    ways = np.exp(2j * np.pi * np.arange(32) / 32)
    corner = z[(z[:, None] * ways.conj()).real.argmax(axis=0)]
    edge = np.roll(corner, -1) - corner
    inside = ((edge.conj() * (z[:, None] - corner)).imag > 0) | (edge == 0)
    return z[~inside.all(axis=1)] if (edge != 0).any() else z


def _chain(points: Any_) -> list[complex]:
    out: list[complex] = []
    for p in points.tolist():
        while len(out) > 1 and ((out[-1] - out[-2]).conjugate() * (p - out[-1])).imag <= 0:
            out.pop()
        out.append(p)
    return out


Realisation = Literal["rotate", "amplitude"]


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


def realise(shapes: Any_, method: Realisation = "rotate") -> Float:
    """Real shapes (n, m) from complex ones.

    Parameters
    ----------
    shapes : (n, m) complex128 or float64
    method : {"rotate", "amplitude"}
        "rotate" turns each shape by its mean phase and keeps the real part (least change);
        "amplitude" keeps the modulus and takes the sign of that real part.

    Raises
    ------
    ConfigError
        On another method.
    """
    turned = np.asarray(shapes) * np.exp(-1j * mean_phase(shapes))
    if method == "rotate":
        return np.ascontiguousarray(turned.real, dtype=np.float64)
    if method == "amplitude":
        return np.asarray(np.where(turned.real < 0, -1.0, 1.0) * np.abs(turned), dtype=np.float64)
    raise ConfigError(f"no realisation {method!r}{did_you_mean(method, ('rotate', 'amplitude'))}")


def realise_modes(modes: ModeSet) -> ModeSet:
    """The modes with real shapes, rotated; a unit-modal-A scale has no meaning for them and becomes
    UNSCALED.
    """
    if not np.iscomplexobj(modes.shapes):
        return modes
    norm = modes.norm if modes.norm is Norm.MASS else Norm.UNSCALED
    return replace(modes, shapes=realise(modes.shapes), norm=norm)
