"""OP2: Fortran records of tables and matrices, either byte order, words of 4 or 8 bytes.

Layout: MSC Nastran DMAP Programmer's Guide, OUTPUT2; each record is [length] data [length], each
item is announced by a key, a record of one integer word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DataError
from ringtrue.io.files import existing

_PIECE = 100_000  # numbers that are text at once


@dataclass(frozen=True, slots=True)
class LogicalRecord:
    """A logical record: its blocks, and flag 0 for a table, else the column of a matrix."""

    flag: int
    blocks: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Op2Table:
    """A data block of the file.

    Attributes
    ----------
    name : str
    trailer : (7,) int64
    records : tuple of LogicalRecord
        The first is the header.
    order : {"<", ">"}
        Byte order.
    word : {4, 8}
        Bytes in a word.
    """

    name: str
    trailer: Int
    records: tuple[LogicalRecord, ...]
    order: str
    word: int

    def _words(self, data: bytes, kind: str, size: int) -> NDArray[Any]:
        return np.frombuffer(
            data[: len(data) // size * size], f"{self.order}{kind}{size}"
        )

    def ints(self, data: bytes) -> Int:
        """The words as integers, (k,) int64."""
        return self._words(data, "i", self.word).astype(np.int64)

    def floats(self, data: bytes) -> Float:
        """The words as reals, (k,) float64."""
        return self._words(data, "f", self.word).astype(np.float64)

    def decimals(self, values: Float) -> Float:
        """Reals of the file, (k,) float64, each the shortest decimal that names it: 0.3 and not
        0.30000001192.
        """
        if self.word == 8:
            return values
        out = np.empty_like(values)
        for start in range(0, values.size, _PIECE):  # as text a number takes 128 bytes
            part = values[start : start + _PIECE].astype(np.float32)
            out[start : start + _PIECE] = part.astype(np.str_).astype(np.float64)
        return out

    def doubles(self, data: bytes) -> Float:
        """Double-precision reals, (k,) float64."""
        return self._words(data, "f", 8).astype(np.float64)

    def bodies(self) -> list[bytes]:
        """The data of the records behind the header."""
        return [b"".join(record.blocks) for record in self.records[1:]]


class _Op2File:
    """The bytes of a file and a place in them; every step is checked against the end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.at = 0
        self.data: NDArray[np.uint8] = (
            np.memmap(path, dtype=np.uint8, mode="r")
            if path.stat().st_size
            else np.empty(0, dtype=np.uint8)
        )
        head = self.data[:4].tobytes()
        found = [
            (order, word)
            for order in "<>"
            for word in (4, 8)
            if head == np.array(word, f"{order}i4").tobytes()
        ]
        if not found:
            raise DataError(
                f"{path}: not an OP2 file (it begins with {head!r}; expected is a record of 4 or "
                "8 bytes)"
            )
        self.order, self.word = found[0]

    def fail(self, why: str) -> DataError:
        return DataError(
            f"{self.path}: {why} at byte {self.at} of {self.data.size}: the file is cut off or "
            "damaged"
        )

    def block(self, read: bool = True) -> bytes:
        """The data of one Fortran record; nothing of one that is passed over."""
        n = self._length(self.at)
        end = self.at + 4 + n
        if n < 0 or end + 4 > self.data.size or self._length(end) != n:
            raise self.fail("a record without its end")
        out = self.data[self.at + 4 : end].tobytes() if read else b""
        self.at = end + 4
        return out

    def _length(self, at: int) -> int:
        if at + 4 > self.data.size:
            raise self.fail("a record without its length")
        return int(self.data[at : at + 4].view(f"{self.order}i4")[0])

    def key(self) -> int:
        return int(self.integers(1)[0])

    def integers(self, count: int) -> Int:
        """A record of so many words."""
        data = self.block()
        if len(data) != count * self.word:
            raise self.fail(f"a record of {len(data)} bytes for {count} integers")
        return np.frombuffer(data, f"{self.order}i{self.word}").astype(np.int64)

    def expect(self, *keys: int) -> None:
        """Pass over keys that the format has here."""
        for wanted in keys:
            if (key := self.key()) != wanted:
                raise self.fail(f"key {key} in place of {wanted}")

    def text(self, data: bytes) -> str:
        if self.word == 8:  # four characters in a word of eight bytes
            data = b"".join(data[i : i + 4] for i in range(0, len(data), 8))
        return data.decode("latin-1").strip("\x00 ")


def read_tables(
    path: str | Path, wanted: Callable[[str], bool] | None = None
) -> Iterator[Op2Table]:
    """The tables and matrices of an OP2 file in their order.

    Parameters
    ----------
    path : path
    wanted : callable, optional
        Whether a table of that name is read; those that are not have no records.

    Raises
    ------
    DataError
        If the file is missing, not an OP2, cut off or damaged.
    """
    file = _Op2File(existing(path))
    key = file.key()
    if key == 3:  # the date, the tape code and a label come first
        file.block()
        file.expect(7)
        file.block()
        file.expect(2)
        _name(file)
        file.expect(0)
        key = file.key() if file.at < file.data.size else 0
    while key:
        if key != 2:
            raise file.fail(f"a table name of {key} words")
        yield _table(file, wanted)
        key = file.key() if file.at < file.data.size else 0


def _name(file: _Op2File) -> str:
    """The label of the file or the name of a table, up to its closing key -1.

    The enhanced format of MSC Nastran (PARAM,POST,1) adds a block of six words: its version and
    qualifiers.
    """
    name = file.text(file.block())
    while (key := file.key()) > 0:
        file.block()
    if key != -1:
        raise file.fail(f"the name {name!r} has no end")
    return name


def _table(file: _Op2File, wanted: Callable[[str], bool] | None) -> Op2Table:
    name = _name(file)
    read = wanted is None or wanted(name)
    file.expect(7)
    trailer = file.integers(7)
    records = []
    key = file.key()
    while key:
        if key > 0:
            raise file.fail(f"table {name}: a broken record key")
        file.expect(1)
        flag = file.key()
        blocks = []
        while (key := file.key()) > 0:
            blocks.append(file.block(read))
        if blocks and read:
            records.append(LogicalRecord(flag, tuple(blocks)))
    return Op2Table(name, trailer, tuple(records), file.order, file.word)


@dataclass(frozen=True, slots=True)
class GridPointWeight:
    """Mass and centre of gravity (x, y, z) that a run recorded, in the units of its deck."""

    mass: float
    centre: tuple[float, float, float]


def read_grid_point_weight(path: str | Path) -> GridPointWeight | None:
    """OGPWG of an OP2 file (PARAM,GRDPNT); None of a file without.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    for table in read_tables(path, lambda name: name.startswith("OGPWG")):
        values = table.floats(b"".join(table.bodies()[1:2]))
        if values.size >= 57:  # M0 (36), S (9), and three masses with their centres
            mass, _, y, z, _, x = values[45:51]
            centre = values[36:45].reshape(3, 3) @ [x, y, z]
            return GridPointWeight(float(mass), tuple(centre.tolist()))
    return None


def matrix(table: Op2Table) -> NDArray[Any]:
    """A real matrix (rows, columns) float64; trailer: columns, rows, form, type (1 single, 2
    double).

    Raises
    ------
    DataError
        If it is complex or a string of numbers leaves the matrix.
    """
    columns, rows, _, kind = (int(x) for x in table.trailer[1:5])
    if kind not in (1, 2) or not (
        0 < rows < 10**8 and 0 < columns < 10**8 and rows * columns < 10**9
    ):
        raise DataError(
            f"matrix {table.name} of type {kind}, {rows} x {columns}: allowed is a real one"
        )
    out = np.zeros((rows, columns))
    for j, record in enumerate(r for r in table.records if r.flag):
        for block in record.blocks:
            first = int(table.ints(block[: table.word])[0]) - 1
            read = table.doubles if kind == 2 else table.floats
            values = read(block[table.word :])
            if j >= columns or first < 0 or first + values.size > rows:
                raise DataError(
                    f"matrix {table.name}: column {j + 1} leaves the matrix of {rows} x {columns}"
                )
            out[first : first + values.size, j] = values
    return out
