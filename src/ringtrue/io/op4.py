"""Nastran OUTPUT4: ascii and binary, either byte order, dense, sparse and BIGMAT, real and
complex.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.errors import DataError
from ringtrue.io.files import atomic_write

BIG = 65536  # rows from which strings carry their length and row in two words
MOST = 100_000_000  # rows and columns of all matrices of a file: 0.8 GB of pointers
_LINE = 1024  # characters of the numbers of a line
_FORMAT = re.compile(r"(?:1P,?)?(\d+)[ED](\d+)\.")


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
        return dict(_matrices(_Binary(raw) if binary else _Text(raw)))
    except (ValueError, IndexError, OverflowError) as e:
        raise DataError(f"{path}: not an OUTPUT4 file, or cut short: {e}") from e


def write_op4(path: Path, matrices: Mapping[str, Float]) -> None:
    """Real symmetric matrices (n, n) by name as an ascii OUTPUT4 file, in full double precision."""
    lines = []
    for name, matrix in matrices.items():
        n = len(matrix)
        lines.append(f"{n:8d}{n:8d}{6:8d}{2:8d}{name:<8s}1P,3E23.16")
        for j, column in enumerate(matrix.T.tolist(), 1):
            lines.append(f"{j:8d}{1:8d}{n:8d}")
            numbers = [f"{x:23.16E}" for x in column]
            lines += ["".join(numbers[i : i + 3]) for i in range(0, n, 3)]
        lines += [f"{n + 1:8d}{1:8d}{1:8d}", f"{1.0:23.16E}"]
    with atomic_write(path) as part:
        part.write_text("\n".join(lines) + "\n")


def fixed_numbers(
    lines: Sequence[str], at: int, count: int, per_line: int, width: int
) -> tuple[Float, int]:
    """Numbers (count,) of fixed width, Fortran's D for E, from line `at`; and the line after them.

    Raises
    ------
    ValueError
        If the lines end before, one is no number, or the form has lines of none or too many.
    """
    if count < 0 or per_line < 1 or not 0 < width <= per_line * width <= _LINE:
        raise ValueError(f"{count} numbers, {per_line} a line, of {width} characters")
    end = at - (-count // per_line)
    if end > len(lines):
        raise ValueError(f"{count} numbers pass the end of the file, line {len(lines)}")
    size = min(per_line, count) * width
    joined = "".join(line[:size].ljust(size) for line in lines[at:end])
    joined = joined.upper().replace("D", "E")
    parts = [joined[i : i + width] for i in range(0, count * width, width)]
    return np.array(parts, dtype=np.float64), end


class _Text:
    """Ascii: a line for the head of a matrix, column or string, then lines of numbers."""

    def __init__(self, raw: bytes) -> None:
        self.lines = raw.decode("ascii").splitlines()
        self.at = 0

    def _line(self) -> str:
        self.at += 1
        return self.lines[self.at - 1]

    def more(self) -> bool:
        return self.at < len(self.lines) and bool(self.lines[self.at].strip())

    def header(self) -> tuple[list[int], str]:
        line = self._line()
        # columns and rows take sixteen characters where eight are too few
        cuts = (0, 16, 32, 40, 48, 56) if line.rstrip().endswith("|I16") else (0, 8, 16, 24, 32, 40)
        given = _FORMAT.match(line[cuts[-1] :].strip().upper())
        self.per_line, self.width = (int(given[1]), int(given[2])) if given else (5, 16)
        cells = [line[a:b] for a, b in pairwise(cuts)]
        return [int(x) for x in cells[:4]], cells[4]

    def column(self) -> list[int]:
        line = self._line()
        return [int(line[i : i + 8]) for i in range(0, 24, 8)]

    def integers(self, count: int) -> list[int]:
        """The numbers of a line; those of eight digits stand side by side without a blank."""
        line = self._line()
        cells = line.split()
        if len(cells) < count:
            cells = [line[8 * k : 8 * k + 8] for k in range(count)]
        return [int(x) for x in cells[:count]]

    def reals(self, words: int, size: int, dense: bool) -> Float:
        count = words if dense else words // size
        values, self.at = fixed_numbers(self.lines, self.at, count, self.per_line, self.width)
        return values

    def close(self) -> None:
        self.at += 1  # the closing column has one number


class _Binary:
    """Fortran records: one for the head of a matrix, one for each column."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.order = "<" if raw[0] else ">"
        self.wide = 0x30 in (raw[0], raw[3])
        self.integer = np.dtype(f"{self.order}i{8 if self.wide else 4}")
        self.at = 0

    def _record(self) -> None:
        (length,) = np.frombuffer(self.raw, f"{self.order}i4", 1, offset=self.at).tolist()
        end = self.at + 4 + length
        if length < 0 or end + 4 > len(self.raw):
            why = f"a record of {length} bytes at byte {self.at} passes the end of the file"
            raise ValueError(why)
        self.record = self.raw[self.at + 4 : end]
        self.place = 0
        self.at = end + 4

    def _take(self, kind: Any, count: int) -> Any_:
        out = np.frombuffer(self.record, kind, count, offset=self.place)
        self.place += out.nbytes
        return out

    def more(self) -> bool:
        return self.at < len(self.raw)

    def header(self) -> tuple[list[int], str]:
        self._record()
        head = self.integers(4)
        name = self.record[self.place :]
        if self.wide:  # four characters in a word of eight bytes
            name = b"".join(name[i : i + 4] for i in range(0, len(name), 8))
        return head, name.decode("ascii")

    def column(self) -> list[int]:
        self._record()
        return self.integers(3)

    def integers(self, count: int) -> list[int]:
        numbers: list[int] = self._take(self.integer, count).tolist()
        return numbers

    def reals(self, words: int, size: int, dense: bool) -> Float:
        if self.wide:
            return self._take(f"{self.order}f8", words).astype(np.float64)
        return self._take(f"{self.order}f{4 * size}", words // size).astype(np.float64)

    def close(self) -> None:
        return


def _matrices(source: _Text | _Binary) -> Iterator[tuple[str, sparse.csr_array]]:
    room = MOST
    while source.more():
        (columns, rows, _, kind), name = source.header()
        big = rows < 0 or rows >= BIG
        rows = abs(rows)
        if kind not in (1, 2, 3, 4) or columns < 0 or rows + columns > room:
            raise ValueError(
                f"a matrix of type {kind}, {rows} x {columns}; allowed are types 1 to 4, {MOST} "
                "in all"
            )
        room -= rows + columns
        size = 1 if kind in (1, 3) else 2  # 32-bit words of a real number
        runs: list[tuple[int, int, Any_]] = []  # column, first row, values
        while True:
            column, row, words = source.column()
            if column > columns:
                break
            if column < 1 or words < 0:
                raise ValueError(f"column {column} of {words} words")
            if row > 0:
                runs.append((column, row, source.reals(words, size, True)))
                continue
            while words > 0:  # each string says where the next one stands
                if big:
                    length, row = source.integers(2)
                    words -= 1
                else:
                    (mark,) = source.integers(1)
                    length, row = mark >> 16, mark & 0xFFFF
                if length < 2:
                    raise ValueError(f"a string of {length - 1} words in column {column}")
                runs.append((column, row, source.reals(length - 1, size, False)))
                words -= length
        source.close()
        yield name.replace("\0", "").strip().upper(), _matrix((rows, columns), kind > 2, runs)


def _matrix(
    shape: tuple[int, int], is_complex: bool, runs: Sequence[tuple[int, int, Any_]]
) -> sparse.csr_array:
    if not runs:
        return sparse.csr_array(shape)
    columns, rows, parts = zip(*runs, strict=True)
    if is_complex:
        parts = tuple(part.view(np.complex128) for part in parts)
    size = np.array([part.size for part in parts])
    first = np.repeat(np.array(rows) - np.cumsum(size) + size, size)
    row = first + np.arange(size.sum()) - 1
    column = np.repeat(np.array(columns) - 1, size)
    made = sparse.csr_array((np.concatenate(parts), (row, column)), shape=shape)
    made.eliminate_zeros()
    return made
