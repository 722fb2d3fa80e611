"""Fewer lines that tell as much: between resonances, the nodes of Gauss's rule for the weights of
the lines.

Away from all poles the functions 1/(s − λ) are polynomials to many digits, in stretches as long as
a pole is far. With the weights of its lines a stretch has orthogonal polynomials, and the zeros of
one of them are the nodes at which lines stand for it: products of functions with each other and
with the data are those of all lines (Golub, Welsch 1969, Calculation of Gauss quadrature rules).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.identification.lsfd import Lines

NODES = 12
# of a stretch, over its distance from the nearest pole: the functions are right to (2 + √3)^-NODES
LENGTH = 2.0
_FAR_FEWER = 0.8  # of the lines


def condensed(lines: Lines, poles: Complex, reach: Float) -> Lines:
    """The lines for fits of poles within `reach` of these; `power` stays that of all lines.

    Parameters
    ----------
    lines : Lines
    poles : (m,) complex128, rad/s
    reach : (m,) float64, rad/s

    Returns
    -------
    Lines
        The same ones where they are few, or hold a response that the block cuts off, or its window:
        that ripples from line to line.
    """
    if np.isfinite(lines.kept) or lines.hann:
        return lines
    x = lines.s.imag
    stretches = [(a, b, b - a > NODES) for a, b in _stretches(x, _room(lines, poles, reach))]
    if sum(NODES if long else b - a for a, b, long in stretches) > _FAR_FEWER * x.size:
        return lines
    parts = [_nodes(lines, a, b) if long else _as_they_are(lines, a, b) for a, b, long in stretches]
    s, weight, y, terms, smooth = zip(*parts, strict=True)
    nodes = np.concatenate(s)
    return replace(
        lines,
        s=nodes,
        kind=nodes**lines.order,
        weight=np.concatenate(weight),
        y=np.concatenate(y, axis=1),
        terms=np.concatenate(terms),
        smooth=np.concatenate(smooth),
    )


def _room(lines: Lines, poles: Complex, reach: Float) -> Float:
    """(freq,) length of the longest stretch, rad/s, that each line may be in."""
    x, decay = lines.s.imag, float(lines.s[0].real)
    far = np.abs(lines.s)  # conjugate poles and residual terms: no nearer than 0 Hz
    for pole, r in zip(
        poles.tolist(), reach.tolist(), strict=True
    ):  # (freq, pole) arrays are slower
        far = np.minimum(far, np.sqrt((x - pole.imag) ** 2 + (decay - pole.real) ** 2) - r)
    room = LENGTH * far
    if n := lines.smooth.shape[1]:  # a wavelength of the polynomial of most of them
        place = 2 * (x - x[0]) / np.ptp(x) - 1
        room = np.minimum(
            room, np.pi * np.ptp(x) * (np.sqrt(np.maximum(1 - place**2, 0)) + 1 / n) / n
        )
    return np.asarray(room)


def _stretches(x: Float, room: Float) -> Iterator[tuple[int, int]]:
    """First line and end of stretches, each as long as the `room` of all its lines allows."""
    start = 0
    while start < x.size:
        end = int(np.searchsorted(x, x[start] + room[start], side="right"))
        fits = x[start:end] - x[start] <= np.minimum.accumulate(room[start:end])
        length = max(int(fits.argmin()) if not fits.all() else fits.size, 1)
        yield start, start + length
        start += length


def _as_they_are(lines: Lines, a: int, b: int) -> tuple[Complex, Float, Complex, Complex, Float]:
    return lines.s[a:b], lines.weight[a:b], lines.y[:, a:b], lines.terms[a:b], lines.smooth[a:b]


def _nodes(lines: Lines, a: int, b: int) -> tuple[Complex, Float, Complex, Complex, Float]:
    """Places and weights of the nodes, and the data and residual terms there."""
    x, weight = lines.s.imag[a:b], lines.weight[a:b]
    middle, half = 0.5 * (x[0] + x[-1]), 0.5 * (x[-1] - x[0])
    place = (x - middle) / half
    polynomials = np.linalg.qr(
        weight[:, None] * np.polynomial.legendre.legvander(place, NODES - 1)
    )[0]
    nodes, turn = np.linalg.eigh(polynomials.T @ (place[:, None] * polynomials))
    basis = polynomials @ turn
    basis *= np.sign(weight @ basis)
    parts = np.ascontiguousarray(lines.y[:, a:b]).view(np.float64)
    y = (basis.T @ parts).view(np.complex128)
    s = lines.s[0].real + 1j * (middle + half * nodes)
    return s, weight @ basis, y, basis.T @ lines.terms[a:b], basis.T @ lines.smooth[a:b]
