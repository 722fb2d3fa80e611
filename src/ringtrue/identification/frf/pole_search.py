"""Candidate poles of FRFs band by band: the choice of bands, stable poles, all bands merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.channels import POWER
from ringtrue.core.signals import FrfSet
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.identification.frf.confidence import CandidatePoles
from ringtrue.identification.frf.lines import Noise, count_peaks
from ringtrue.identification.frf.plscf import (
    Clusters,
    Plscf,
    cluster_poles,
    half_bandwidths,
    order_range,
    plscf,
    pole_shapes,
)
from ringtrue.shapes import mac


@dataclass(frozen=True, slots=True)
class BandLimits:
    """Bands of the pole search, and what the estimator sees of them.

    Attributes
    ----------
    ratio : float
        Upper to lower edge, at most.
    lines : int
        At least.
    peaks : int
        Of the CMIF, at most, unless more than `bands` bands would be needed.
    bands : int
    responses, inputs : int
        Combinations of responses and of inputs that are kept, at most. All inputs share the orders
        of the polynomials.
    """

    ratio: float = 1.8
    lines: int = 64
    peaks: int = 5
    bands: int = 40
    responses: int = 40
    inputs: int = 12


LIMITS = BandLimits()


def choose_bands(freqs: Float, curve: Float) -> tuple[tuple[float, float], ...]:
    """Overlapping bands of all lines, Hz: none spans more than a ratio, holds too few lines or too
    many peaks of the CMIF.
    """
    low = float(freqs[0])
    number = np.arange(freqs.size, dtype=np.float64)

    def lines_below(edge: float, lines: float) -> float:
        return float(np.interp(np.interp(edge, freqs, number) - lines, number, freqs))

    all_peaks = np.sort(freqs[count_peaks(curve)])
    most = max(LIMITS.peaks, all_peaks.size // LIMITS.bands)
    edges = [float(freqs[-1])]
    while edges[-1] > low * 1.05:
        lower = min(edges[-1] / LIMITS.ratio, lines_below(edges[-1], LIMITS.lines))
        inside = all_peaks[(all_peaks < edges[-1]) & (all_peaks > lower)]
        if inside.size > most:
            cut = 0.5 * (inside[-most] + inside[-most - 1])
            lower = max(lower, min(float(cut), lines_below(edges[-1], LIMITS.lines)))
        edges.append(lower if lines_below(lower, LIMITS.lines / 2) > low else low)
    bands = []
    for a, b in pairwise(edges[::-1]):
        more = 0.15 * (b - a)  # so that neighbours overlap
        bands.append((max(a - more, low), min(b + more, edges[0])))
    return tuple(bands)


def line_steps(freqs: Float, at: Complex) -> Float:
    """(k,) distance of the lines, Hz, around poles `at` (k,), rad/s."""
    step = np.diff(freqs)
    below = np.searchsorted(freqs, at.imag / (2 * np.pi)) - 1
    return step[np.clip(below, 0, step.size - 1)]


def band_candidates(
    frfs: FrfSet, sigma: Noise, curve: Float, band: tuple[float, float], damping_max: float
) -> tuple[Clusters, StableDiagram]:
    """Poles of a band (Hz) that stay in place over the orders, damped up to a ratio, and the
    diagram of all poles.
    """
    at = (frfs.freqs >= band[0]) & (frfs.freqs <= band[1])
    most = damping_max + frfs.window_decay / (2 * np.pi * band[0])
    white = frfs.data[at] / (np.median(sigma.line[at]) * sigma.response[:, None] * sigma.input)
    strong, driven = few_inputs(white)
    strong = principal(strong)
    lowest, highest = order_range(strong.shape[2], count_peaks(curve[at]).size, int(at.sum()))
    poles = plscf(strong, frfs.freqs[at], Plscf(lowest, highest, most))
    poles = replace(poles, shape=driven @ poles.shape)
    poles, clusters = grouped(poles, strong, sigma=sigma, frfs=frfs, at=at)
    db = 20 * np.log10(np.maximum(curve[at, :3].T, np.finfo(float).tiny))
    return clusters, StableDiagram(
        poles=poles,
        stable=clusters.label >= 0,
        cluster=clusters.label,
        freqs=frfs.freqs[at],
        level=db,
    )


def grouped(
    poles: PoleSet, white: Complex, sigma: Noise, frfs: FrfSet, at: Bool
) -> tuple[PoleSet, Clusters]:
    """Poles of whitened lines `at` in the units of the inputs, and those that stay in place over
    the orders.

    With one input the responses separate the modes.
    """
    alone = white.shape[2] == 1 and white.shape[1] > 1 and len(poles) > 0
    responses = pole_shapes(poles, white, frfs.freqs[at], POWER[frfs.kind]) if alone else None
    poles = replace(poles, shape=poles.shape * sigma.input[:, None])
    return poles, cluster_poles(poles, line_steps(frfs.freqs, poles.pole), responses=responses)


def few_inputs(data: Complex) -> tuple[Complex, Float]:
    """(freq, out, r) the strongest combinations of many inputs, and the real orthonormal
    combinations (in, r).

    The participation vectors of a band lie in their span, but for noise; few inputs are left as
    they are.
    """
    n_in = data.shape[2]
    if n_in <= LIMITS.inputs:
        return data, np.eye(n_in)
    few = _directions(_stacked(data.transpose(0, 2, 1)), LIMITS.inputs)
    return np.ascontiguousarray(data @ few), few


def principal(data: Complex) -> Complex:
    """(freq, r, in) responses combined along the directions that stand out of the noise; `data` has
    noise of 1.

    The combination is real, for the response space of real modes, and leaves r/out of the noise.
    """
    rows = _stacked(data)
    few = (_directions(rows, LIMITS.responses).T @ rows).view(np.complex128)
    return np.ascontiguousarray(few.reshape(len(few), len(data), -1).transpose(1, 0, 2))


def _stacked(data: Complex) -> Float:
    """(n, 2k) real and imaginary parts of `data` (freq, n, m), side by side."""
    return np.ascontiguousarray(data.transpose(1, 0, 2)).view(np.float64).reshape(data.shape[1], -1)


def _directions(rows: Float, most: int) -> Float:
    """(n, r) orthonormal combinations of `rows` (n, k) that stand out of noise of 1: four at least,
    `most` at most.
    """
    n, k = rows.shape
    values, vectors = np.linalg.eigh(rows @ rows.T)
    # Marchenko, Pastur (1967): the largest eigenvalue of noise alone
    edge = k * (1 + np.sqrt(n / k)) ** 2
    r = int(np.clip((values > 1.5 * edge).sum(), min(n, 4), most))
    return vectors[:, -r:]


def merged(found: Sequence[Clusters], freqs: Float, decay: float) -> CandidatePoles:
    """Candidates of all bands, the window out of the poles; of those seen twice, the one with less
    scatter.
    """
    found = [c for c in found if c.pole.size]
    if not found:
        return CandidatePoles(
            np.zeros(0, complex), np.zeros((0, 1), complex), np.zeros(0), np.zeros(0)
        )
    pole = np.concatenate([c.pole for c in found])
    part = np.concatenate([c.participation.T for c in found])
    support = np.concatenate([c.support for c in found])
    scatter = np.concatenate([c.scatter for c in found])
    band = np.repeat(np.arange(len(found)), [c.pole.size for c in found])
    keep = np.ones(pole.size, dtype=bool)
    rank = scatter + (1 - support)
    far = half_bandwidths(pole, line_steps(freqs, pole))
    if part.shape[1] > 1:
        far += (1 - mac(part.T, part.T)) / 0.3
    for i, j in np.argwhere(np.triu(far < 1.5, 1)):  # a few pairs in the overlaps
        if band[i] != band[j] and keep[i] and keep[j]:
            keep[j if rank[i] <= rank[j] else i] = False
    order = np.flatnonzero(keep)[np.argsort(np.abs(pole[keep]), kind="stable")]
    true = np.minimum(pole.real + decay, -1e-4 * np.abs(pole)) + 1j * pole.imag
    return CandidatePoles(true, part, support, scatter).take(order)
