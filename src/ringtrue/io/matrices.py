"""Sparse matrices from the files that solvers and scripts write.

MATLAB .mat (v5, v7.3), Nastran OUTPUT4, MatrixMarket, HDF5, Abaqus *MATRIX GENERATE, Harwell-Boeing
(Ansys HBMAT), scipy .npz.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import DataError, about, did_you_mean
from ringtrue.io.files import atomic_write, existing
from ringtrue.io.foreign.door import door, read_apart
from ringtrue.io.foreign.parsers import (
    compressed_matrix,
    is_hdf5,
    open_hdf5,
    read_npz,
    triplet_matrix,
)
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.io.record_arrays import check_stored

_FORTRAN = re.compile(
    r"\((?:\d*P,?)?(\d*)\s*[IEDFG](\d+)(?:\.\d+)?(?:E\d+)?\)", re.IGNORECASE
)


@dataclass(frozen=True, slots=True, eq=False)
class MatrixFile:
    """What a file holds.

    Attributes
    ----------
    matrices : mapping of str to csr_array
        By the name in the file, or the file's own name where it has none.
    arrays : mapping of str to ndarray
        Vectors and scalars (MATLAB, HDF5).
    dofs : DofSet or None
        Names of the rows, where the file has them (Abaqus).
    """

    matrices: Mapping[str, sparse.csr_array]
    arrays: Mapping[str, Any_]
    dofs: DofSet | None = None

    def __getitem__(self, name: str) -> sparse.csr_array:
        """A matrix by name.

        Raises
        ------
        DataError
            If there is none of that name.
        """
        if name not in self.matrices:
            raise DataError(f"no matrix {name!r}{did_you_mean(name, self.matrices)}")
        return self.matrices[name]

    def over(self, rows: DofSet | int, name: str = "") -> sparse.csr_array:
        """A matrix over the rows of another, zero where it has none, as a mass whose file leaves
        out massless DOFs.

        Parameters
        ----------
        rows : DofSet or int
            The names of the rows, or their number where the file has no names.
        name : str
            May be left out where there is one matrix.

        Raises
        ------
        DataError
            If the file has rows that are not among `rows`, or several matrices and no name is
            given.
        """
        if not name and len(self.matrices) != 1:
            raise DataError(
                f"which of the matrices {', '.join(self.matrices) or 'none'}?"
            )
        a = self[name or next(iter(self.matrices))].tocoo()
        if isinstance(rows, DofSet):
            if self.dofs is None:
                raise DataError("this file has no names of rows; give their number")
            at = rows.find(self.dofs.node, self.dofs.direction)
            n = len(rows)
        else:
            at = np.arange(max(a.shape))
            n = rows
        if (lost := (at < 0) | (at >= n)).any():
            raise DataError(
                f"{int(lost.sum())} of its {at.size} rows are not among the {n} of the other matrix"
            )
        return sparse.csr_array((a.data, (at[a.row], at[a.col])), shape=(n, n))


def read_matrices(path: str | Path) -> MatrixFile:
    """Read a file of matrices; its content shows the kind.

    Raises
    ------
    DataError
        If the file is absent, of no known kind, or broken.
    """
    path = existing(path)
    held = format_of(path)
    if held is Format.HDF5 or (held is Format.MATLAB and is_hdf5(path)):
        return _hdf5(path, of_matlab=held is Format.MATLAB)
    readers: dict[Format, Callable[[Path], MatrixFile]] = {
        Format.MATLAB: _matlab,
        Format.OP4: lambda p: MatrixFile(read_op4(p), {}),
        Format.TEXT: _abaqus,
        Format.NPZ: _scipy,
        Format.HARWELL_BOEING: _harwell_boeing,
        Format.MATRIX_MARKET: lambda path: _one(
            path, read_apart("matrix market", path, "MatrixMarket file")
        ),
    }
    if held not in readers:
        refuse_format(path, "matrices", (Format.HDF5, *readers))
    found = readers[held](path)
    if not (found.matrices or found.arrays):
        raise DataError(f"{path}: no matrix in it")
    return found


def _one(
    path: Path, matrix: sparse.csr_array, dofs: DofSet | None = None
) -> MatrixFile:
    return MatrixFile({path.stem: matrix}, {}, dofs)


def _matlab(path: Path) -> MatrixFile:
    matrices: dict[str, sparse.csr_array] = {}
    arrays: dict[str, Any_] = {}
    todo = list(read_apart("matlab", path, "MATLAB file").items())
    while todo:
        name, value = todo.pop(0)
        if isinstance(value, sparse.csr_array):
            matrices[name] = value
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fciu":
            _sort(name, value, matrices, arrays)
        elif isinstance(value, dict):  # a structure
            todo += [(f"{name}.{key}", part) for key, part in value.items()]
    return MatrixFile(matrices, arrays)


def _scipy(path: Path) -> MatrixFile:
    """What `scipy.sparse.save_npz` writes."""
    parts = read_npz(path)
    with about(path), door(path, "sparse matrix of scipy"):
        kind = parts["format"].item()
        kind = kind.decode("ascii") if isinstance(kind, bytes) else str(kind)
        shape = _two(parts["shape"])
        if kind == "coo":
            return _one(
                path, triplet_matrix(parts["data"], parts["row"], parts["col"], shape)
            )
        if kind in ("csr", "csc"):
            data, indices, starts = (
                parts[name] for name in ("data", "indices", "indptr")
            )
            return _one(path, compressed_matrix(kind, data, indices, starts, shape))
        allowed = did_you_mean(kind, ("csr", "csc", "coo"))
        raise DataError(f"a sparse matrix of kind {kind!r}{allowed}")


def _two(shape: Any_) -> tuple[int, int]:
    rows, columns = (int(n) for n in np.ravel(shape))
    return rows, columns


def _sort(
    name: str,
    value: Any_,
    matrices: dict[str, sparse.csr_array],
    arrays: dict[str, Any_],
) -> None:
    """Square arrays of more than one row are matrices."""
    if value.ndim == 2 and value.shape[0] == value.shape[1] > 1:
        matrices[name] = sparse.csr_array(value)
    else:
        arrays[name] = value


def _hdf5(path: Path, of_matlab: bool) -> MatrixFile:
    matrices: dict[str, sparse.csr_array] = {}
    arrays: dict[str, Any_] = {}
    with open_hdf5(path) as f, about(path):

        def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Group):
                if (made := _sparse_group(item)) is not None:
                    matrices[name] = made
            elif item.dtype.kind in "fciu" and _sparse_group(item.parent) is None:
                value = _stored(item)
                if of_matlab and value.ndim == 2:
                    value = value.T  # MATLAB stores columns first
                _sort(name, np.asarray(value), matrices, arrays)

        f.visititems(visit)
    return MatrixFile(matrices, arrays)


def _sparse_group(g: h5py.Group) -> sparse.csr_array | None:
    """MATLAB's data, ir, jc; scipy's and AnnData's data, indices, indptr; triplets data, row,
    col.
    """
    if {"data", "ir", "jc"} <= set(g) and "MATLAB_sparse" in g.attrs:
        starts = _stored(g["jc"])
        size = (int(g.attrs["MATLAB_sparse"]), starts.size - 1)
        return compressed_matrix(
            "csc", _stored(g["data"]), _stored(g["ir"]), starts, size
        )
    stated = g.attrs.get("shape", g["shape"][()] if "shape" in g else None)
    if {"data", "indices", "indptr"} <= set(g):
        text = g.attrs.get("encoding-type", g.attrs.get("format", "csr"))
        kind = "csc" if "csc" in str(text) else "csr"
        data, indices, starts = (
            _stored(g[name]) for name in ("data", "indices", "indptr")
        )
        shape = starts.size - 1, int(indices.max(initial=-1)) + 1
        shape = shape if kind == "csr" else shape[::-1]
        shape = shape if stated is None else _two(stated)
        return compressed_matrix(kind, data, indices, starts, shape)
    if {"data", "row", "col"} <= set(g):
        data, row, column = (_stored(g[name]) for name in ("data", "row", "col"))
        return triplet_matrix(
            data, row, column, None if stated is None else _two(stated)
        )
    return None


def _stored(data: h5py.Dataset) -> Any_:
    """The numbers of a data set; MATLAB's complex ones have two fields."""
    check_stored(data, data.file.filename)
    values: Any_ = data[()]
    return (
        values["real"] + 1j * values["imag"]
        if values.dtype.names == ("real", "imag")
        else values
    )


def _abaqus(path: Path) -> MatrixFile:
    """Lines `node, dof, node, dof, value` (MATRIX INPUT, LABELS) or `row, column, value`
    (COORDINATE).
    """
    try:
        text = path.read_text(encoding="ascii").replace(",", " ")
        rows = np.array(
            [
                x.split()
                for x in text.splitlines()
                if x.strip() and x.strip()[0] not in "*#%"
            ]
        )
        if rows.ndim != 2 or rows.shape[1] not in (3, 5):
            raise ValueError(f"lines of {rows.shape[-1]} numbers; 3 or 5 are known")
        numbers = np.char.replace(np.char.upper(rows), "D", "E").astype(np.float64)
        places = _whole_numbers(numbers[:, :-1])
    except ValueError as e:
        raise DataError(f"{path}: not a matrix of Abaqus: {e}") from e
    if numbers.shape[1] == 3:
        i, j = (places - 1).T
        with about(path):
            return _one(
                path, _whole(numbers[:, 2], i, j, int(max(i.max(), j.max())) + 1)
            )
    ends = places
    if ends[:, 1::2].min() < 0 or ends[:, 1::2].max() > 6:
        raise DataError(
            f"{path}: degree of freedom {ends[:, 1::2].max()}; known are 1 to 6"
        )
    every, place = np.unique(
        np.concatenate([ends[:, :2], ends[:, 2:]]), axis=0, return_inverse=True
    )
    i, j = place.reshape(2, -1)
    dofs = DofSet(every[:, 0], every[:, 1].astype(np.int8))
    return _one(path, _whole(numbers[:, 4], i, j, len(every)), dofs)


def _whole(values: Any_, i: Any_, j: Any_, n: int) -> sparse.csr_array:
    """The matrix; if only one triangle is there, the other one too."""
    a = triplet_matrix(values, i, j, (n, n))
    return _mirrored(a) if (i >= j).all() or (i <= j).all() else a


def _mirrored(a: sparse.csr_array) -> sparse.csr_array:
    return sparse.csr_array(a + a.T - sparse.diags_array(a.diagonal(), format="csr"))


def _harwell_boeing(path: Path) -> MatrixFile:
    """Assembled Harwell-Boeing or Rutherford-Boeing, as Ansys HBMAT writes (its mapping file is not
    needed here).
    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        counts = [int(x) for x in lines[1].split()]
        kind = lines[2][:3].upper()
        n_rows, n_columns, nonzero = (int(x) for x in lines[2][3:].split()[:3])
        forms = [(int(n or 1), int(width)) for n, width in _FORTRAN.findall(lines[3])]
        at = 4 + (len(counts) > 4 and counts[4] > 0)
        pointer, index, *value = forms
        indptr, at = fixed_numbers(lines, at, n_columns + 1, *pointer)
        indices, at = fixed_numbers(lines, at, nonzero, *index)
        starts = _whole_numbers(indptr) - 1
        rows = _whole_numbers(indices) - 1
        data: Any_ = np.ones(nonzero)
        if kind[0] != "P":
            per = 2 if kind[0] == "C" else 1
            data, _ = fixed_numbers(lines, at, per * nonzero, *value[0])
    except (ValueError, IndexError, UnicodeDecodeError) as e:
        raise DataError(f"{path}: not a Harwell-Boeing file: {e}") from e
    if kind[2] != "A" or kind[1] not in "SUR":
        raise DataError(
            f"{path}: matrix type {kind}; known are assembled ones, symmetric or not (RSA, RUA)"
        )
    if kind[1] == "S" and n_rows != n_columns:
        raise DataError(
            f"{path}: matrix type {kind} is symmetric, but it has {n_rows} rows and {n_columns} "
            "columns"
        )
    if kind[0] == "C":
        data = data.view(np.complex128)
    with about(path):
        a = compressed_matrix("csc", data, rows, starts, (n_rows, n_columns))
    return _one(path, _mirrored(a) if kind[1] == "S" else a)


def _whole_numbers(values: Any_) -> Int:
    if not (np.abs(values) < 2.0**53).all() or (values != np.round(values)).any():
        raise ValueError("a pointer, index or number of a node is no integer")
    return values.astype(np.int64)


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
        cuts = (
            (0, 16, 32, 40, 48, 56)
            if line.rstrip().endswith("|I16")
            else (0, 8, 16, 24, 32, 40)
        )
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
        values, self.at = fixed_numbers(
            self.lines, self.at, count, self.per_line, self.width
        )
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
        (length,) = np.frombuffer(
            self.raw, f"{self.order}i4", 1, offset=self.at
        ).tolist()
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
                    raise ValueError(
                        f"a string of {length - 1} words in column {column}"
                    )
                runs.append((column, row, source.reals(length - 1, size, False)))
                words -= length
        source.close()
        yield (
            name.replace("\0", "").strip().upper(),
            _matrix((rows, columns), kind > 2, runs),
        )


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
