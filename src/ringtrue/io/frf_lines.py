"""What readers of FRFs share: the lines that have values, and what is said where nothing tells the
motion.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.errors import DataError

log = logging.getLogger(__name__)


def known_lines(
    h: Complex, freqs: Float, outputs: Sequence[str], inputs: Sequence[str], path: str | Path
) -> slice | Bool:
    """(f,) bool: lines with values; those where no FRF has one are left out, and 0 Hz where one
    lacks it (0/0).

    Parameters
    ----------
    h : (f, out, in) complex128
    freqs : (f,) float64, Hz
    outputs, inputs : sequence of str
        Their names.
    path : path
        Of the file, for the message.

    Raises
    ------
    DataError
        If an FRF has no value where others do, or none has any.
    """
    lost = ~np.isfinite(h)
    if not lost.any():
        return slice(None)
    none = np.asarray(np.where(freqs > 0, lost.all(axis=(1, 2)), lost.any(axis=(1, 2))))
    if (rest := lost & ~none[:, None, None]).any() or none.all():
        f, o, i = np.argwhere(rest if rest.any() else lost)[0]
        told = (
            f"{int(lost.sum())} values are not finite, the first of {outputs[o]}/{inputs[i]} "
            f"at {freqs[f]:g} Hz"
        )
        raise DataError(f"{path}: {told}")
    if (bare := freqs[none & (freqs > 0)]).size:
        log.warning(
            "%s: lines at which no FRF has a value are left out: %d, from %g Hz",
            path,
            bare.size,
            bare[0],
        )
    return ~none


def say_accelerances(path: str | Path) -> None:
    """Say that FRFs of no known kind are taken as accelerances."""
    log.warning(
        "%s: nothing tells what the responses measure: the FRFs are taken as accelerances, m/s^2/N",
        path,
    )
