"""Whether the files of a record are of one setup: whether they move in the same shapes at the same
frequencies.

Where one mode is most of the motion, the first singular vector of the spectral matrix is its shape
(Brincker, Zhang and Andersen 2001), in each file anew. Sensors that were moved between two files
see another part of it, and the files as one record would have each mode twice. Of close modes the
forces of the day tell which is stronger: the shape of one file is sought in the plane of the first
two vectors of the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.identification.whittle import SpectralBins

MOVED = 0.9  # likeness: of one setup 0.99 and more, of moved sensors 0.3 to 0.8
AVERAGES = 2  # of the spectra, over the number of channels
CLEAR = 10.0  # times the second singular value
FEWEST = 3  # channels: any shape lies in a plane of two


def likeness(first: Sequence[SpectralBins], other: Sequence[SpectralBins]) -> float:
    """Mean share of the shapes that both records have in common, by the power of the lines; 1 where
    nothing is clear.

    Parameters
    ----------
    first, other : sequence of SpectralBins
        The bands of two records, of the same channels.
    """
    shares, weights = [np.ones(1)], [np.full(1, np.finfo(np.float64).tiny)]
    for a, b in zip(first, other, strict=True):
        if a.freqs.shape != b.freqs.shape or not a.freqs.size or a.cross.shape[1] < FEWEST:
            continue
        groups = np.cumsum(b.count) // (AVERAGES * a.cross.shape[1])
        starts = np.unique(groups, return_index=True)[1]
        one, two = (_shapes(x, starts) for x in (a, b))
        clear = one[2] & two[2]
        share = np.maximum(_within(one[0], two[0]), _within(two[0], one[0]))
        power = np.sqrt(one[1] * two[1])
        shares.append(share[clear])
        weights.append(power[clear])
    return float(np.average(np.concatenate(shares), weights=np.concatenate(weights)))


def _shapes(bins: SpectralBins, starts: Any_) -> tuple[Any_, Float, Any_]:
    """First two singular vectors (line, ch, 2), the share of each line in the power, and which
    lines are clear.
    """
    cross = np.add.reduceat(bins.cross * bins.count[:, None, None], starts).astype(np.complex128)
    values, vectors = np.linalg.eigh(cross)
    power = values[:, -1] / max(float(values.sum()), np.finfo(np.float64).tiny)
    return vectors[:, :, -2:], power, values[:, -1] > CLEAR * values[:, -2]


def _within(plane: Any_, shapes: Any_) -> Float:
    """(line,) share of the first vectors of `shapes` in the planes (line, ch, 2)."""
    inside = np.einsum("lcp,lc->lp", plane.conj(), shapes[:, :, -1])
    return np.asarray((np.abs(inside) ** 2).sum(axis=1))
