"""Modal damping as a table over frequency (TABDMP1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, freeze_fields


@dataclass(frozen=True, slots=True, eq=False)
class ModalDamping:
    """Damping ratios of modes by their frequencies.

    Attributes
    ----------
    frequencies : (k,) float64, Hz, ascending
    ratios : (k,) float64, fraction of critical
    flat : bool
        Beyond the ends the last ratio holds; else the line through the last two points goes on.
    structural : bool
        Twice the ratio is a loss factor (PARAM,KDAMP,-1); else the damping is viscous.
    """

    frequencies: Float
    ratios: Float
    flat: bool = False
    structural: bool = False

    def __post_init__(self) -> None:
        freeze_fields(self, frequencies=np.float64, ratios=np.float64)

    def at(self, frequencies: Float) -> Float:
        """Ratios (m,) of modes of these frequencies (m,), Hz."""
        f, z = self.frequencies, self.ratios
        out = np.interp(frequencies, f, z)
        if not self.flat and f.size > 1:
            for beyond, (a, b) in ((frequencies < f[0], (0, 1)), (frequencies > f[-1], (-2, -1))):
                slope = (z[b] - z[a]) / (f[b] - f[a]) if f[b] > f[a] else 0.0
                out = np.where(beyond, z[b] + slope * (frequencies - f[b]), out)
        return out
