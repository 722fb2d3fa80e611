"""The band of FRFs that is identified: as given, or up to where they are noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.identification.lsfd import likeness

_USABLE = 0.5  # of coherence, or of likeness
_NOISE = 0.6  # of likeness, smoothed, that white noise of a single FRF does not reach
_TO_THE_END = 0.95


def band_limits(frfs: FrfSet, fmin: float | None, fmax: float | None) -> tuple[float, float]:
    """The reported band, Hz; where not given, up to where the coherence, or the likeness of next
    lines, ends.
    """
    f = frfs.freqs
    low = fmin if fmin is not None else float(f[f > 0][0])
    high = fmax if fmax is not None else _usable_to(frfs)
    if np.count_nonzero((f >= low) & (f <= high)) < 32:
        raise DataError(
            f"{frfs.source}: fewer than 32 lines between {low:g} and {high:g} Hz; widen fmin, fmax"
        )
    return max(low, float(f[0])), min(high, float(f[-1]))


def _usable_to(frfs: FrfSet) -> float:
    """Frequency, Hz, of the last line at which the coherence, or the likeness of next lines, is
    usable.
    """
    f = frfs.freqs
    known = bool(np.isfinite(frfs.coherence).all())
    good = np.median(frfs.coherence, axis=(1, 2)) if known else likeness(frfs.data, f)
    usable = f[_smoothed(good) > _USABLE]
    return float(usable[-1] if usable.size else f[-1])


def _smoothed(line: Float) -> Float:
    wide = max(5, line.size // 50) | 1
    return np.convolve(np.pad(line, wide // 2, mode="edge"), np.ones(wide) / wide, "valid")


def refuse_noise(frfs: FrfSet) -> None:
    """Raise where no line is like its neighbours, for methods that find modes in noise too."""
    if _smoothed(likeness(frfs.data, frfs.freqs)).max() < _NOISE:
        ends = f"{frfs.freqs[0]:g} and {frfs.freqs[-1]:g} Hz"
        raise DataError(
            f"{frfs.source}: the FRFs are noise: between {ends} no line is like those beside it"
        )


def end_note(frfs: FrfSet, fmax: float | None, high: float) -> str:
    """Says that the band ends before the lines do."""
    if fmax is not None or high > _TO_THE_END * frfs.freqs[-1]:
        return ""
    return f"the band ends at {high:.4g} Hz: beyond, the FRFs are noise (--fmax for more)"


def lines_between(frfs: FrfSet, low: float, high: float) -> FrfSet:
    """The FRFs of a band, Hz, without the line at 0 Hz."""
    at = (frfs.freqs >= low) & (frfs.freqs <= high) & (frfs.freqs > 0)
    return replace(frfs, data=frfs.data[at], freqs=frfs.freqs[at], coherence=frfs.coherence[at])
