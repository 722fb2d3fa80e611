"""RIFF WAVE files, read by scipy: PCM of 8 to 64 bits, float of 32 and 64, RF64."""

from __future__ import annotations

import io
import logging
import struct
import warnings
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from ringtrue.core.arrays import Any_
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import door

log = logging.getLogger(__name__)
_OPEN_ENDS = (0, 0xFFFFFFFF)  # lengths of a file that its recorder did not close


def read_wave(path: str | Path) -> tuple[float, Any_]:
    """Rate (Hz) and samples (sample, channel), as scipy gives them: 24 bits stand in the upper
    bytes of 32.

    Raises
    ------
    DataError
        If it is no WAVE file, compressed or damaged.
    """
    path = existing(path)
    raw = bytearray(
        path.read_bytes()
    )  # in memory a damaged length cannot ask for more than there is
    with door(path, "WAVE file of PCM or floats"):
        if raw[:4] == b"RIFF" and struct.unpack("<I", raw[4:8])[0] in _OPEN_ENDS:
            raw[4:8] = struct.pack("<I", min(len(raw) - 8, 0xFFFFFFFE))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            rate, samples = wavfile.read(io.BytesIO(raw))
        for warning in told:
            if "EOF" in str(warning.message):
                log.warning("%s: the file is cut: %s", path, warning.message)
        return float(rate), np.atleast_2d(samples.T).T
