"""RIFF WAVE files: integer (8, 16, 24, 32 bits) and float samples, extensible headers, RF64 for more than 4 GB."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError
from ringtrue.io.plain import RawTable, numbered

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_OPEN_END = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class _Format:
    tag: int
    channels: int
    rate: int
    bits: int


def read_wav(path: Path) -> RawTable:
    """The samples of a WAVE file; integers are divided by their full scale, so that ±1 is the range.

    Raises
    ------
    DataError
        If it is no WAVE file, compressed, or cut before its header ends.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if len(head) < 12 or head[:4] not in (b"RIFF", b"RF64", b"BW64") or head[8:] != b"WAVE":
            raise DataError(f"{path}: not a WAVE file")
        form, start, length = None, 0, 0
        while not length and len(chunk := file.read(8)) == 8:
            name, count = struct.unpack("<4sI", chunk)
            if name == b"fmt ":
                form = _format(file.read(min(count, 64)), path)
                file.seek(_next(file.tell() - min(count, 64), count))
            elif name == b"data":
                start = file.tell()
                length = min(count if count != _OPEN_END else size, size - start)
            else:
                file.seek(_next(file.tell(), count))
    if form is None or not length:
        raise DataError(f"{path}: no format or no samples in the file; it is cut or damaged")
    return numbered(_samples(path, form, start, length), float(form.rate))


def _next(at: int, count: int) -> int:
    """Chunks begin at even bytes."""
    return at + count + count % 2


def _format(raw: bytes, path: Path) -> _Format:
    if len(raw) < 16:
        raise DataError(f"{path}: the format chunk has {len(raw)} of 16 bytes")
    tag, channels, rate, _, _, bits = struct.unpack("<HHIIHH", raw[:16])
    if tag == _EXTENSIBLE and len(raw) >= 26:
        tag = struct.unpack("<H", raw[24:26])[0]
    allowed = {_PCM: (8, 16, 24, 32), _FLOAT: (32, 64)}
    if bits not in allowed.get(tag, ()) or not channels or not rate:
        raise DataError(
            f"{path}: format {tag}, {bits} bits, {channels} channels, {rate} Hz; only PCM of 8 to 32 and "
            "floats of 32 or 64 bits can be read"
        )
    return _Format(tag, channels, rate, bits)


def _samples(path: Path, form: _Format, start: int, length: int) -> Any_:
    """(channel, sample)."""
    width = form.bits // 8
    frames = length // (width * form.channels)
    raw = np.memmap(path, np.uint8, "r", start, (frames * width * form.channels,)) if frames else np.zeros(0, np.uint8)
    if form.tag == _FLOAT:
        return np.ascontiguousarray(raw.view(f"<f{width}").reshape(frames, form.channels).T)
    if form.bits == 24:
        wide = np.zeros((raw.size // 3, 4), dtype=np.uint8)
        wide[:, 1:] = raw.reshape(-1, 3)
        values = wide.view("<i4").ravel() / 2.0**31
    elif form.bits == 8:
        values = (raw.astype(np.float64) - 128) / 128
    else:
        values = raw.view(f"<i{width}") / 2.0 ** (form.bits - 1)
    return np.ascontiguousarray(values.reshape(frames, form.channels).T)
