"""RIFF WAVE files as records: integers are divided by their full scale, so that ±1 is the range."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.io.foreign.wave import read_wave
from ringtrue.io.plain import RawTable, numbered


def read_wav(path: Path) -> RawTable:
    """The samples of a WAVE file, (channel, sample).

    Raises
    ------
    DataError
        If it is no WAVE file, compressed or damaged.
    """
    rate, samples = read_wave(path)
    if samples.dtype.kind == "f":
        values = samples.astype(samples.dtype.newbyteorder("="), copy=False)
    elif samples.dtype.kind == "u":  # 8 bits: 128 is zero
        values = (samples.astype(np.float64) - 128) / 128
    else:
        values = samples / 2.0 ** (8 * samples.dtype.itemsize - 1)
    return numbered(np.ascontiguousarray(values.T), rate)
