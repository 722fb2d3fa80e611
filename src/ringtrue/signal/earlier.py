"""Impulse and time of each blow in a record, and the blows before it: what `core.blows.Blows` keeps
of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.blows import Blows, padded
from ringtrue.signal.hits import pulse_width

_LINES = 128  # that the noise is kept at


def blows_of(
    force: Float, rate: float, hits: Int, used: Int, pulses: Sequence[Float], quiet: Sequence[float]
) -> Blows:
    """Blows of one record; the weights (blow, 1, 1) are their squared impulses.

    Parameters
    ----------
    force : (sample,) float64, N, without offset
    rate : float, Hz
    hits, used : (h,), (u,) int64
        Samples of the peaks of all hits, and of those in the FRFs.
    pulses : u of (freq,) float64
        Power spectra of the pulses, up to half the rate.
    quiet : u of float
        Power of the noise at a line of each.
    """
    impulse, time = np.transpose([_impulse(force, h) for h in hits.tolist()])
    time = time / rate
    at = np.searchsorted(hits, used).tolist()
    step = max(1, pulses[0].size // _LINES)
    noise = np.array(
        [q / np.maximum(p[::step], max(q, 1e-300)) for p, q in zip(pulses, quiet, strict=True)]
    )
    return Blows(
        padded([time[k] - time[:k] for k in at]),
        padded([impulse[:k] / impulse[k] for k in at]),
        (impulse[at] ** 2)[:, None, None],
        0.5 * rate * np.arange(0, pulses[0].size, step) / (pulses[0].size - 1),
        noise,
    )


def _impulse(force: Float, hit: int) -> tuple[float, float]:
    """Sum of the samples of a pulse and where its centre is, in samples."""
    half = 2 * pulse_width(force, hit) + 2
    first = max(hit - half, 0)
    pulse = force[first : hit + half + 1]
    impulse = float(pulse.sum())
    return impulse, first + float(np.arange(pulse.size) @ pulse) / impulse
