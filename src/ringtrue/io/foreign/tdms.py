"""National Instruments TDMS files, opened by nptdms once their segments are known to lie in the
file.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from nptdms import TdmsFile

from ringtrue.errors import DataError
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import door

_TAGS = (b"TDSm", b"TDSh")
_LEAD_IN = struct.Struct("<4sIIQQ")
_TOO_MANY = 1 << 20  # objects or properties: a damaged count, not a file
_OPEN_END = 2**64 - 1  # length of a segment that its recorder did not close


@contextmanager
def open_tdms(path: str | Path) -> Iterator[TdmsFile]:
    """The file for reading; all that nptdms raises on damage within the block names it.

    Raises
    ------
    DataError
        If the file is missing, none of TDMS, cut or damaged.
    """
    path = existing(path)
    raw = path.read_bytes()
    _check_segments(raw, path)
    # in memory a damaged length cannot ask for more than there is
    with door(path, "TDMS file"), TdmsFile.open(BytesIO(raw)) as file:
        yield file


def _check_segments(raw: bytes, path: Path) -> None:
    """The chain of segments and their counts of objects, before nptdms believes them."""
    at, seen = 0, 0
    while at + _LEAD_IN.size <= len(raw):
        tag, mask, _, after, data_at = _LEAD_IN.unpack_from(raw, at)
        if tag not in _TAGS:
            break
        seen += 1
        order = ">" if mask & 64 else "<"
        if order == ">":
            after, data_at = struct.unpack_from(">QQ", raw, at + 12)
        if after != _OPEN_END and (data_at > after or at + _LEAD_IN.size + data_at > len(raw)):
            raise DataError(
                f"{path}: segment {seen} has its samples {data_at} bytes on, past its end: the "
                "file is cut"
            )
        if mask & 2 and at + _LEAD_IN.size + 4 <= len(raw):
            (objects,) = struct.unpack_from(f"{order}I", raw, at + _LEAD_IN.size)
            if objects > min(_TOO_MANY, len(raw)):
                raise DataError(
                    f"{path}: segment {seen} announces {objects} objects: the file is damaged"
                )
        at = at + _LEAD_IN.size + after if after != _OPEN_END else len(raw)
    if not seen:
        raise DataError(f"{path}: not a TDMS file")
