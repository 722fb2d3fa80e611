"""Modes that the pole search missed: peaks in what a fit leaves of the FRFs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.identification.judge import Candidates
from ringtrue.identification.lsfd import Lines
from ringtrue.identification.poles import PoleSet
from ringtrue.identification.refine import Refined
from ringtrue.identification.repeated_hammer import twins

ABOVE = 1.3  # times the error in its surroundings
SHARE = 0.03  # amplitude of the error against the data, where the data agree no better than that
WORSE = 3.0  # times the error at the peak of a typical mode


def missed(
    lines: Lines, fit: Refined, sets: Sequence[PoleSet], decay: float, most: int
) -> Candidates:
    """Candidates at the highest peaks of the error, one for each.

    Parameters
    ----------
    lines : Lines
    fit : Refined
    sets : sequence of PoleSet
        The poles of all orders, to count the orders that hold a candidate.
    decay : float, 1/s
        Exponential window still in `sets`.
    most : int
    """
    rest = fit.known.rest
    at = _peaks(rest, lines, fit)[:most]
    omega = lines.s.imag[at]
    zeta = np.median(-fit.poles.real / np.abs(fit.poles)) if fit.poles.size else 0.01
    pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    part = np.array([_direction(rest[:, max(k - 1, 0) : k + 2]) / lines.input for k in at]).reshape(
        at.size, rest.shape[0]
    )
    return Candidates(pole, part, support(pole, part, sets, decay), np.zeros(at.size))


def _peaks(rest: Complex, lines: Lines, fit: Refined) -> Int:
    """Lines of the peaks, highest first, half a bandwidth apart at least."""
    power = uniform_filter1d((np.abs(rest) ** 2).mean(axis=(0, 2)), 3, mode="nearest")
    total = (np.abs(lines.y * lines.response) ** 2).mean(axis=(0, 2))
    step = np.median(np.diff(lines.s.imag))
    zeta = np.median(-fit.poles.real / np.abs(fit.poles)) if fit.poles.size else 0.01
    half = int(np.ceil(zeta * np.median(lines.s.imag) / step)) + 2
    floor = median_filter(power, size=min(20 * half + 1, power.size), mode="mirror")
    top = power >= maximum_filter1d(power, 2 * half + 1, mode="nearest")
    share = power / uniform_filter1d(total, 3, mode="nearest")
    seen = top & (power > ABOVE * floor) & (share > _usual(share, lines, fit))
    at = np.flatnonzero(seen)
    return at[np.argsort(-(power / floor)[at], kind="stable")]


def _usual(share: Float, lines: Lines, fit: Refined) -> Float:
    """Squared share of the error in the data that is no sign of a missed mode: measured FRFs
    disagree by some.

    On the flank of a mode an error well above that at the peaks of the others is one: two modes
    taken for one.
    """
    usual = np.full(share.size, SHARE**2)
    if fit.poles.size > 1:
        far = np.abs(lines.s.imag[:, None] - fit.poles.imag)
        flank = (far < 2 * np.abs(fit.poles.real)).any(axis=1)
        usual[flank] = min(SHARE**2, WORSE**2 * np.median(share[far.argmin(axis=0)]))
    return usual


def _direction(rest: Complex) -> Complex:
    """Participation vector (in,) that carries most of the error at a few lines (in, freq, out)."""
    a = rest.reshape(rest.shape[0], -1)
    return np.asarray(np.linalg.eigh(a @ a.conj().T)[1][:, -1], dtype=np.complex128)


def support(pole: Complex, part: Complex, sets: Sequence[PoleSet], decay: float) -> Float:
    """Share of the orders that hold each pole, in the band that knows it best."""
    best = np.zeros(pole.size)
    for s in sets:  # a few bands
        if not len(s):
            continue
        width = np.abs(pole.real) + 0.2 * decay + 1e-4 * np.abs(pole)
        near = np.abs(s.pole[:, None] + decay - pole) < width
        v = s.shape / np.linalg.norm(s.shape, axis=0)
        u = part.T / np.linalg.norm(part.T, axis=0)
        alike = np.abs(v.conj().T @ u) ** 2
        for i, j in twins(pole):  # any vector in the plane of both
            q = np.linalg.qr(u[:, [i, j]])[0]
            alike[:, [i, j]] = (np.abs(v.conj().T @ q) ** 2).sum(axis=1, keepdims=True)
        near &= alike > 0.6
        upper = s.order >= np.median(s.orders)
        held = np.array([np.unique(s.order[upper & n]).size for n in near.T])
        best = np.maximum(best, held / max(np.unique(s.order[upper]).size, 1))
    return best
