"""MATLAB v5 files: numbers, text, cells and structures. Every length is checked against the bytes that are there.

Source: MATLAB MAT-File Format, The MathWorks (2020), chapter 1, level 5.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBER = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXT = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_CLASS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_COMPLEX = 0x0800
_LARGEST = 1 << 34  # bytes that a compressed variable may unfold to
_DEEPEST = 20  # cells within structures within cells


@dataclass(slots=True)
class _Bytes:
    """A place in the bytes of an element: reading moves it and never passes their end."""

    raw: memoryview
    order: str
    at: int = 0

    def take(self, count: int) -> memoryview:
        if count < 0 or self.at + count > len(self.raw):
            raise DataError(
                f"{count} bytes are announced, {len(self.raw) - self.at} are left: the file is cut or damaged"
            )
        part = self.raw[self.at : self.at + count]
        self.at += count
        return part

    def element(self) -> tuple[int, memoryview]:
        """Type and bytes of the next element; short ones have both in one word."""
        kind, count = struct.unpack(f"{self.order}II", self.take(8))
        if kind >> 16:
            self.at -= 4
            part = self.take(min(kind >> 16, 5))  # 5 is refused: short elements have 4 bytes at most
            self.at += 4 - len(part)
            if kind >> 16 > 4:
                raise DataError(f"a short element of {kind >> 16} bytes: the file is damaged")
            return kind & 0xFFFF, part
        part = self.take(count)
        if kind != _COMPRESSED:
            self.at = min(self.at + (-count) % 8, len(self.raw))
        return kind, part

    @property
    def left(self) -> int:
        return len(self.raw) - self.at


def is_mat5(raw: bytes) -> bool:
    """Has the file the header of level 5?"""
    return len(raw) >= _HEADER and raw[126:128] in (b"IM", b"MI")


def read_mat5(path: Path) -> dict[str, Any]:
    """The variables of a file by name: arrays, texts (str), cells (object arrays), structures (dict).

    A field of an array of structures is an object array of its values. Sparse matrices and objects are left out.

    Raises
    ------
    DataError
        If the file is cut or damaged.
    """
    raw = path.read_bytes()
    order = "<" if raw[126:128] == b"IM" else ">"
    file = _Bytes(memoryview(raw), order, _HEADER)
    found: dict[str, Any] = {}
    try:
        while file.left >= 8:
            kind, part = file.element()
            if kind == _COMPRESSED:
                inner = _Bytes(memoryview(_unfold(part)), order)
                kind, part = inner.element()
            if kind == _MATRIX and len(part):
                name, value = _matrix(_Bytes(part, order), 0)
                found[name] = value
    except DataError as exc:
        raise DataError(f"{path}: not a readable MATLAB file: {exc}") from exc
    return {k: v for k, v in found.items() if k and v is not None and not k.startswith("__")}


def _unfold(part: memoryview) -> bytes:
    try:
        tool = zlib.decompressobj()
        out = tool.decompress(part, _LARGEST)
    except (zlib.error, MemoryError) as exc:
        raise DataError(f"a compressed variable is damaged ({exc})") from exc
    if tool.unconsumed_tail:
        raise DataError(f"a compressed variable is larger than {_LARGEST} bytes")
    return out


def _matrix(body: _Bytes, depth: int) -> tuple[str, Any]:
    """Name and value of a variable; None for what is left out."""
    if depth > _DEEPEST:
        raise DataError(f"cells and structures are nested more than {_DEEPEST} deep: the file is damaged")
    flags, shape, name = _integers(body), _integers(body), _text(body)
    if flags.size < 1 or shape.size < 1 or (shape < 0).any():
        raise DataError("a variable without class or shape: the file is damaged")
    kind, is_complex = int(flags[0]) & 0xFF, bool(int(flags[0]) & _COMPLEX)
    size = 1
    for n in shape.tolist():
        size *= n
    if kind == _CELL:
        return name, _cells(body, tuple(shape.tolist()), size, depth)
    if kind == _STRUCT:
        return name, _fields(body, size, depth)
    if kind not in _CLASS and kind != _CHAR:
        return name, None
    real = _values(body)
    if real.size != size:
        raise DataError(f"variable {name!r}: {real.size} values for shape {shape.tolist()}: the file is damaged")
    if kind == _CHAR:
        rows = real.reshape(shape.tolist(), order="F").reshape(shape[0], -1) if size else np.zeros((1, 0))
        return name, "\n".join("".join(map(_character, r)) for r in rows.tolist())
    with np.errstate(invalid="ignore", over="ignore"):
        value = real.astype(_CLASS[kind]).reshape(shape.tolist(), order="F")
    if is_complex:
        imaginary = _values(body)
        if imaginary.size != size:
            raise DataError(f"variable {name!r}: {imaginary.size} imaginary values for {size}: the file is damaged")
        value = value + 1j * imaginary.reshape(shape.tolist(), order="F")
    return name, value


def _character(code: float) -> str:
    return chr(int(code)) if 0 <= code < 0x110000 else "?"


def _integers(body: _Bytes) -> Any_:
    return _values(body).astype(np.int64, casting="unsafe")


def _values(body: _Bytes) -> Any_:
    kind, part = body.element()
    if kind in _TEXT:
        text = bytes(part).decode(_TEXT[kind], "replace")
        return np.array([ord(c) for c in text], dtype=np.int64)
    if kind not in _NUMBER:
        raise DataError(f"values of type {kind}: the file is damaged")
    dtype = np.dtype(body.order + _NUMBER[kind])
    return np.frombuffer(part, dtype, len(part) // dtype.itemsize).astype(dtype.newbyteorder("="))


def _text(body: _Bytes) -> str:
    return bytes(body.element()[1]).split(b"\x00")[0].decode("latin-1")


def _nested(body: _Bytes, depth: int) -> Any:
    kind, part = body.element()
    if kind != _MATRIX:
        raise DataError(f"an element of type {kind} within a cell or structure: the file is damaged")
    return _matrix(_Bytes(part, body.order), depth + 1)[1] if len(part) else None


def _cells(body: _Bytes, shape: tuple[int, ...], size: int, depth: int) -> Any_:
    if size * 8 > body.left:
        raise DataError(f"a cell array of {size} in {body.left} bytes: the file is damaged")
    out = np.empty(size, dtype=object)
    for i in range(size):
        out[i] = _nested(body, depth)
    return out.reshape(shape, order="F")


def _fields(body: _Bytes, size: int, depth: int) -> dict[str, Any] | None:
    """Fields of a structure, or of an array of several."""
    length, names = _integers(body), bytes(body.element()[1])
    width = int(length[0]) if length.size else 0
    if not 0 < width <= 1024:
        raise DataError(f"names of fields of {width} bytes: the file is damaged")
    fields = [names[a : a + width].split(b"\x00")[0].decode("latin-1") for a in range(0, len(names), width)]
    if size == 1:
        return {f: _nested(body, depth) for f in fields}
    if not size or size * len(fields) * 8 > body.left:
        return None
    out = {f: np.empty(size, dtype=object) for f in fields}
    for i in range(size):
        for f in fields:
            out[f][i] = _nested(body, depth)
    return dict(out)
