"""NumPy's files, and sparse matrices made of indices that a file gives."""

from __future__ import annotations

import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError
from ringtrue.io.files import existing
from ringtrue.io.foreign.door import MEGABYTE, door


@dataclass(frozen=True, slots=True)
class ArrayLimits:
    """Beyond which a file is damaged, or would fill the memory.

    Attributes
    ----------
    checked : int
        Bytes from which on the packing of an archive is looked at.
    packed : int
        Times that an archive of numbers is smaller than they: noise 1, meshes and zeros 10.
    rows : int
        Of a sparse matrix: the starts alone are 0.4 GB.
    empty_rows : int
        Of a matrix with next to no values, as a mass at single nodes.
    rows_a_value : int
        Of a larger one: in a damaged shape most rows are empty.
    """

    checked: int = 64 * MEGABYTE
    packed: int = 100
    rows: int = 50_000_000
    empty_rows: int = 2_000_000
    rows_a_value: int = 100


LIMITS = ArrayLimits()


def read_npy(path: str | Path) -> Any_:
    """The array of a .npy file, in the file: a damaged shape cannot ask for memory.

    Raises
    ------
    DataError
        If it is none, or damaged.
    """
    path = existing(path)
    with door(path, ".npy file"):
        array: Any_ = np.load(path, mmap_mode="r", allow_pickle=False)
        return array


def read_npz(path: str | Path) -> dict[str, Any_]:
    """The arrays of a .npz file by name.

    Raises
    ------
    DataError
        If it is none, damaged, or unfolds to far more than it is.
    """
    path = existing(path)
    with door(path, ".npz file"):
        with zipfile.ZipFile(path) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > LIMITS.checked and size > LIMITS.packed * path.stat().st_size:
            raise DataError(
                f"{path}: {path.stat().st_size} bytes unfold to {size}: the file is damaged"
            )
        with np.load(path, allow_pickle=False) as found:
            parts = {name: found[name] for name in found.files}
        arrays = {name: part for name, part in parts.items() if isinstance(part, np.ndarray)}
        for part in arrays.values():
            if part.dtype.kind == "U":
                # Python ends in a SystemError on characters that there are not, wherever shown
                codes = np.frombuffer(
                    part.tobytes(), np.dtype("u4").newbyteorder(part.dtype.byteorder)
                )
                if (codes > sys.maxunicode).any():
                    raise ValueError("a text with characters that there are not")
        return arrays


def compressed_matrix(
    kind: str, data: Any_, indices: Any_, starts: Any_, shape: tuple[int, int]
) -> sparse.csr_array:
    """A matrix of compressed rows (`csr`) or columns (`csc`).

    Raises
    ------
    DataError
        As `check_compressed` does.
    """
    data, indices, starts = (np.ravel(part) for part in (data, indices, starts))
    check_compressed(kind, data, indices, starts, shape)
    _check_rows(shape, data.size)
    made: dict[str, Any] = {"csr": sparse.csr_array, "csc": sparse.csc_array}
    return sparse.csr_array(
        made[kind]((data, indices.astype(np.int64), starts.astype(np.int64)), shape=shape)
    )


def check_compressed(
    kind: str, data: Any_, indices: Any_, starts: Any_, shape: tuple[int, int]
) -> None:
    """Refuse indices that are none of the matrix: scipy's C code believes them, and ends the
    process.

    Raises
    ------
    DataError
        If an index leaves the matrix, or the starts of the rows (columns) do not rise to the number
        of values.
    """
    _check_parts(data, (indices, starts), shape)
    lines, across = shape if kind == "csr" else shape[::-1]
    if starts.size != lines + 1 or indices.size != data.size:
        raise DataError(
            f"{starts.size} starts, {indices.size} indices and {data.size} values for {shape}"
        )
    if starts[0] != 0 or starts[-1] != data.size or (starts[1:] < starts[:-1]).any():
        raise DataError(f"the starts of rows or columns do not rise from 0 to {data.size}")
    _check_range(indices, across, shape)


def triplet_matrix(
    data: Any_, rows: Any_, columns: Any_, shape: tuple[int, int] | None = None
) -> sparse.csr_array:
    """A matrix of values with their rows and columns; of a shape that holds them if none is given.

    Raises
    ------
    DataError
        If an index leaves the matrix, or there are not as many of each.
    """
    data, rows, columns = (np.ravel(part) for part in (data, rows, columns))
    if not rows.size == columns.size == data.size or (shape is None and not data.size):
        raise DataError(f"{rows.size} rows, {columns.size} columns and {data.size} values")
    shape = shape or (int(rows.max()) + 1, int(columns.max()) + 1)
    _check_parts(data, (rows, columns), shape)
    _check_rows(shape, data.size)
    _check_range(rows, shape[0], shape)
    _check_range(columns, shape[1], shape)
    return sparse.csr_array((data, (rows.astype(np.int64), columns.astype(np.int64))), shape=shape)


def _check_parts(data: Any_, indices: tuple[Any_, Any_], shape: tuple[int, int]) -> None:
    if data.dtype.kind not in "fciub" or any(part.dtype.kind not in "iu" for part in indices):
        raise DataError(
            f"indices of {indices[0].dtype}, values of {data.dtype}: a sparse matrix has integers "
            "and numbers"
        )
    if len(shape) != 2 or not all(0 <= n < LIMITS.rows for n in shape):
        raise DataError(
            f"a matrix of {' x '.join(map(str, shape))}; it must have less than {LIMITS.rows} rows "
            "and columns"
        )


def _check_range(indices: Any_, size: int, shape: tuple[int, int]) -> None:
    if indices.size and not (indices.min() >= 0 and indices.max() < size):
        raise DataError(
            f"indices {indices.min()} to {indices.max()} for a matrix of {shape[0]} x {shape[1]}"
        )


def _check_rows(shape: tuple[int, int], values: int) -> None:
    if max(shape) > max(LIMITS.empty_rows, LIMITS.rows_a_value * values):
        raise DataError(
            f"a matrix of {shape[0]} x {shape[1]} with {values} values: its shape is damaged"
        )
