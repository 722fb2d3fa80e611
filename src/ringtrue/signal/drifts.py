"""Recorders whose clocks run apart: what a delay gains from one end of the record to the other.

The delay of `phases` is sought in eight parts of the record, J_p(τ), where it may grow along it by
g (clocks of quartz differ by 1 to 100 millionths):

    J(τ, g) = Σ_p J_p(τ + g u_p) / Σ_p Σ_f w_p(f),  u from -1/2 (first part) to 1/2 (last).
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft

from ringtrue.core.arrays import Any_, Complex, Float, Int

PARTS = 8
MOST = 3e-4  # drift of one clock against another
STEP = 0.25  # samples
FINE = 4  # values of J between those of the transform: eight to a sample
FARTHEST = 0.25  # of a segment
COHERENT = 0.4  # squared coherence, of the few segments of a part
LINES = 10.0  # sum of squared coherences, of a part
LOST = 0.03  # of J by one delay for the whole record, from where on a gain is looked for
CLEAR, EXPLAINED = 0.8, 0.5  # J with it, and what of the rest to 1 without it may be left
LEAST = 0.2  # samples


def gained(lines: Any_, root: int, order: Int, starts: Int) -> Float:
    """Samples that the delay of each channel after `root` gains from the first segment to the last,
    (ch,).

    Parameters
    ----------
    lines : (freq, segment, ch) complex64
        Transforms of segments.
    order : (ch,) int
        Derivatives of the displacement that each channel measures.
    starts : (segment,) int
        First samples of them.
    """
    length = 2 * (len(lines) - 1)
    turned, weight = _by_parts(lines, root, order)
    total = weight.sum(axis=(0, 1))
    out = np.zeros(lines.shape[2])
    middle = starts.reshape(PARTS, -1).mean(axis=1)
    u = np.asarray((middle - middle.mean()) / np.ptp(starts), dtype=np.float64)
    most = max(int(np.ceil(MOST * np.ptp(starts) / STEP)), 1)
    grid = STEP * np.arange(-most, most + 1, dtype=np.float64)
    for i in np.flatnonzero((total > PARTS * LINES) & (np.arange(out.size) != root)):
        j = _along(turned[:, :, i] * weight[:, :, i] / total[i], length)
        alone = float(j.sum(axis=0).max())
        if j.max(axis=1).sum() - alone > LOST:
            out[i] = _best(j, u, grid, alone)
    return out


def turned_back(lines: Any_, gain: Float, starts: Int) -> Any_:
    """The lines (freq, segment, ch) without delays that gain `gain` (ch,) samples along the
    record.
    """
    if not gain.any():
        return lines
    f = np.linspace(0, 0.5, len(lines))
    u = (starts - starts.mean()) / np.ptp(starts)
    out = lines.copy()
    for i in np.flatnonzero(gain):
        out[:, :, i] *= np.exp(2j * np.pi * f[:, None] * (gain[i] * u)).astype(np.complex64)
    return out


def shared(values: Float, near: float) -> Float:
    """Values within `near` of the next become their mean: channels of one recorder have one
    clock.
    """
    order = np.argsort(values)
    out = np.empty_like(values)
    for run in np.split(order, np.flatnonzero(np.diff(values[order]) > near) + 1):
        out[run] = 0.0 if (values[run] == 0).any() else values[run].mean()
    return out


def _by_parts(lines: Any_, root: int, order: Int) -> tuple[Complex, Float]:
    """Squared phase factors against the root, as of one motion, and weights, both (freq, part,
    ch).
    """
    x = lines.reshape(len(lines), PARTS, -1, lines.shape[2])
    y = x[:, :, :, root]
    cross = np.einsum("fpsc,fps->fpc", x, y.conj())
    power = summed_power(x)
    turned, coherence = in_one_motion(
        cross, power * power[:, :, [root]], x.shape[2], order - order[root]
    )
    return turned, np.where(coherence > COHERENT, coherence**2, 0.0)


def summed_power(x: Any_) -> Any_:
    """(..., ch) float32 squared moduli of complex64 (..., segment, ch), summed over the
    segments.
    """
    parts = x.view(np.float32)
    both = np.einsum("...sk,...sk->...k", parts, parts)
    return np.asarray(both[..., ::2] + both[..., 1::2])


def in_one_motion(cross: Any_, powers: Any_, segments: int, apart: Int) -> tuple[Any_, Any_]:
    """Squared phase factors as of one motion, and squared coherences less the bias of few segments,
    (freq, ...) each.

    Parameters
    ----------
    cross : (freq, ...) complex64
        Sums over so many segments.
    powers : (freq, ...) float32
        Products of both powers.
    apart : (...) int
        By how many derivatives the two motions are apart.
    """
    tiny = np.finfo(np.float32).tiny
    square = cross.real**2 + cross.imag**2
    coherence = np.clip(square / np.maximum(powers, tiny) - 2 / segments, 0, 1)
    coherence[:2] = coherence[-2:] = 0.0
    quarters = ((-1.0) ** apart).astype(np.float32)
    return cross * cross * (quarters / np.maximum(square, tiny)), coherence


def _along(z: Complex, length: int) -> Float:
    """J of each part (part, lag) from its weighted phases z (freq, part); the lags ascend, 2 `FINE`
    to a sample.
    """
    n = FINE * length
    j = np.fft.fftshift(irfft(z.T, n, axis=1) * (n / 2), axes=1)
    reach = int(2 * FINE * FARTHEST * length)
    return np.asarray(j[:, n // 2 - reach : n // 2 + reach + 1])


def _best(j: Float, u: Float, grid: Float, alone: float) -> float:
    """The gain with the largest J, 0 if that is not clearly more than `alone`."""
    shift = np.rint(2 * FINE * grid[:, None] * u).astype(np.int64)
    room = int(np.abs(shift).max())
    if 2 * room >= j.shape[1]:
        return 0.0
    width = j.shape[1] - 2 * room
    tops = np.array(
        [
            sum(x[room + k : room + k + width] for x, k in zip(j, row, strict=True)).max()
            for row in shift
        ]
    )
    k = int(tops.argmax())
    if not (0 < k < grid.size - 1 and tops[k] > CLEAR and 1 - tops[k] < EXPLAINED * (1 - alone)):
        return 0.0
    left, mid, right = tops[k - 1 : k + 2]
    gain = float(grid[k] + 0.5 * STEP * (left - right) / min(left - 2 * mid + right, -1e-12))
    return gain if abs(gain) > LEAST else 0.0
