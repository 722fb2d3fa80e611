"""Nastran OUTPUT4: ascii and binary, either byte order, dense, sparse and BIGMAT, real and
complex.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Int
from ringtrue.errors import DataError

BIG = 65536  # rows from which strings carry their length and row in two words
MOST = 100_000_000  # rows and columns of all matrices of a file: 0.8 GB of pointers
_LINE = 1024  # characters of the numbers of a line
_FORMAT = re.compile(r"(?:1P,?)?(\d+)[ED](\d+)\.")


@dataclass(frozen=True, slots=True)
class _Header:
    columns: int
    rows: int
    big: bool
    kind: int  # 1 real single, 2 real double, 3 and 4 complex
    name: str

    @property
    def words(self) -> int:
        """32-bit words of one real number."""
        return 1 if self.kind in (1, 3) else 2


def read_op4(path: Path) -> dict[str, sparse.csr_array]:
    """All matrices of an OUTPUT4 file by upper-case name.

    Raises
    ------
    DataError
        If it is not one, or it ends early.
    """
    raw = path.read_bytes()
    if not raw:
        raise DataError(f"{path}: the file is empty")
    try:
        binary = raw[:4] in (b"\x18\0\0\0", b"\0\0\0\x18", b"\x30\0\0\0", b"\0\0\0\x30")
        return dict(_binary(raw) if binary else _ascii(raw.decode("ascii")))
    except (ValueError, IndexError, OverflowError) as e:
        raise DataError(f"{path}: not an OUTPUT4 file, or cut short: {e}") from e


class _Strings:
    """Runs of numbers of one matrix: column, first row, values."""

    def __init__(self, header: _Header) -> None:
        self.header = header
        self.columns: list[int] = []
        self.rows: list[int] = []
        self.values: list[Any_] = []

    def add(self, column: int, row: int, values: Any_) -> None:
        self.columns.append(column)
        self.rows.append(row)
        self.values.append(values.view(np.complex128) if self.header.kind > 2 else values)

    def matrix(self) -> sparse.csr_array:
        shape = (self.header.rows, self.header.columns)
        if not self.values:
            return sparse.csr_array(shape)
        size = np.array([v.size for v in self.values])
        first = np.repeat(np.array(self.rows) - np.cumsum(size) + size, size)
        row = first + np.arange(size.sum()) - 1
        column = np.repeat(np.array(self.columns) - 1, size)
        made = sparse.csr_array((np.concatenate(self.values), (row, column)), shape=shape)
        made.eliminate_zeros()
        return made


class _Source(Protocol):
    """Where the numbers of one column stand."""

    def integers(self, count: int) -> Int: ...
    def reals(self, words: int) -> Any_: ...


@dataclass(slots=True)
class _TextColumn:
    """Ascii: `per` numbers of `width` characters a line, from line `at`; a word is `share` of a
    number.
    """

    lines: list[str]
    at: int
    per: int
    width: int
    share: int

    def integers(self, count: int) -> Int:
        self.at += 1
        return np.array(self.lines[self.at - 1].split()[:count], dtype=np.int64)

    def reals(self, words: int) -> Any_:
        count = words // self.share
        used = -(-count // self.per)
        if self.at + used > len(self.lines):
            raise ValueError(f"{count} numbers pass the end of the file")
        row = self.per * self.width
        joined = (
            "".join(x[:row].ljust(row) for x in self.lines[self.at : self.at + used])
            .upper()
            .replace("D", "E")
        )
        self.at += used
        return np.array(
            [joined[i : i + self.width] for i in range(0, count * self.width, self.width)],
            dtype=float,
        )


@dataclass(slots=True)
class _BinaryColumn:
    """Binary: one record from byte `at`; a number is `share` words."""

    raw: bytes
    at: int
    integer: np.dtype[Any]
    number: np.dtype[Any]
    share: int

    def _take(self, kind: np.dtype[Any], count: int) -> Any_:
        out = np.frombuffer(self.raw, kind, count, offset=self.at)
        self.at += count * kind.itemsize
        return out

    def integers(self, count: int) -> Int:
        return self._take(self.integer, count).astype(np.int64)

    def reals(self, words: int) -> Any_:
        return self._take(self.number, words // self.share).astype(np.float64)


def _column(
    header: _Header, found: _Strings, column: int, row: int, words: int, source: _Source
) -> None:
    """The runs of one column: dense from `row` on, or strings if `row` is 0 (a loop: each string
    says where the next one stands).
    """
    if column < 1 or words < 0:
        raise ValueError(f"column {column} of {words} words")
    if row > 0:
        found.add(column, row, source.reals(words))
        return
    while words > 0:
        if header.big:
            length, first = (int(x) for x in source.integers(2))
            length, used = length - 1, length + 1
        else:
            mark = int(source.integers(1)[0])
            length = (mark >> 16) - 1
            first = mark & 0xFFFF
            used = length + 1
        if length < 1:
            raise ValueError(f"a string of {length} words in column {column}")
        found.add(column, first, source.reals(length))
        words -= used


def _header(columns: int, rows: int, kind: int, name: str, room: int) -> _Header:
    """The header of a matrix; `room` is how many rows and columns are left of `MOST`."""
    if kind not in (1, 2, 3, 4) or columns < 0 or abs(rows) + columns > room:
        raise ValueError(
            f"a matrix of type {kind}, {abs(rows)} x {columns}; allowed are types 1 to 4, {MOST} "
            "in all"
        )
    return _Header(
        columns, abs(rows), rows < 0 or rows >= BIG, kind, name.replace("\0", "").strip().upper()
    )


def _ascii(text: str) -> Iterator[tuple[str, sparse.csr_array]]:
    lines = text.splitlines()
    at = 0
    room = MOST
    while at < len(lines) and lines[at].strip():
        head = lines[at]
        columns, rows, _, kind = (int(head[i : i + 8]) for i in range(0, 32, 8))
        header = _header(columns, rows, kind, head[32:40], room)
        room -= header.rows + header.columns
        given = _FORMAT.match(head[40:].strip().upper())
        per, width = (int(given[1]), int(given[2])) if given else (5, 16)
        if not 0 < per * width <= _LINE:
            raise ValueError(f"{per} numbers of {width} characters a line")
        found = _Strings(header)
        at = at + 1
        while True:
            column, row, words = (int(lines[at][i : i + 8]) for i in range(0, 24, 8))
            if column > columns:
                break
            source = _TextColumn(lines, at + 1, per, width, 1 if row > 0 else header.words)
            _column(header, found, column, row, words, source)
            at = source.at
        at += 2  # the closing column and its one number
        yield header.name, found.matrix()


def _binary(raw: bytes) -> Iterator[tuple[str, sparse.csr_array]]:
    order = "<" if raw[0] else ">"
    wide = 0x30 in (raw[0], raw[3])
    integer = np.dtype(f"{order}i{8 if wide else 4}")
    at = 0
    room = MOST
    while at < len(raw):
        record, at = _record(raw, at, order)
        columns, rows, _, kind = np.frombuffer(record, integer, 4).tolist()
        header = _header(columns, rows, kind, record[4 * integer.itemsize :].decode("ascii"), room)
        room -= header.rows + header.columns
        number = np.dtype(f"{order}f{8 if wide else 4 * header.words}")
        found = _Strings(header)
        while True:
            record, at = _record(raw, at, order)
            column, row, words = np.frombuffer(record, integer, 3).tolist()
            if column > columns:
                break
            share = 1 if wide else header.words
            _column(
                header,
                found,
                column,
                row,
                words,
                _BinaryColumn(record, 3 * integer.itemsize, integer, number, share),
            )
        yield header.name, found.matrix()


def _record(raw: bytes, at: int, order: str) -> tuple[bytes, int]:
    (length,) = np.frombuffer(raw, f"{order}i4", 1, offset=at).tolist()
    end = at + 4 + length
    if length < 0 or end + 4 > len(raw):
        raise ValueError(f"a record of {length} bytes at byte {at} passes the end of the file")
    return raw[at + 4 : end], end + 4
