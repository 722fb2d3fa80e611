"""Parsers of others: HDF5, JSON, TOML, Excel, TDMS, WAVE, NumPy's files, sparse matrices made of
indices that a file gives, and universal files that are written.

Links and storage outside of an HDF5 file are refused, unless `RINGTRUE_HDF5_OUTSIDE=1` is set. JSON
and TOML are read from any text of an editor, no deeper or larger than such files are. TDMS is
opened by nptdms once its segments are known to lie in the file. pyuff only writes:
`ringtrue.io.uff` reads universal files, and knows what vendors make of the standard. Parsers that
take long to import are imported where they are used.
"""

from __future__ import annotations

import json
import logging
import os
import struct
import sys
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError, InputError, did_you_mean
from ringtrue.io.files import existing, read_text
from ringtrue.io.foreign.door import (
    EXPORT_AGAIN,
    MEGABYTE,
    door,
    need_not_try,
    tried_apart,
)

if TYPE_CHECKING:
    from nptdms import TdmsFile


log = logging.getLogger(__name__)

OUTSIDE = "RINGTRUE_HDF5_OUTSIDE"  # environment variable
_PARSER = "hdf5"


@contextmanager
def open_hdf5(
    path: str | Path, kind: str = "HDF5 file", advice: str = EXPORT_AGAIN
) -> Iterator[h5py.File]:
    """The file for reading; all that HDF5 raises on damage within the block names it.

    Raises
    ------
    DataError
        If the file is missing, damaged, or has data in other files: one that was sent could else
        show what stands in any file that its reader may open.
    """
    path = existing(path)
    with door(path, kind, advice=advice):
        outside = tried_apart(_PARSER, path, kind, advice)
        if outside and os.environ.get(OUTSIDE) != "1":
            raise DataError(
                f"{path}: {outside}, outside of the file; if you trust it, set {OUTSIDE}=1"
            )
        with h5py.File(path, "r") as file:
            yield file


def trust_hdf5(path: str | Path) -> None:
    """Note that this process has written the file as it stands: it is not tried before it is
    opened.
    """
    need_not_try(_PARSER, Path(path), "")


def is_hdf5(path: str | Path) -> bool:
    """Whether a file begins as HDF5 files do."""
    return bool(h5py.is_hdf5(path))


LARGEST = 256 * MEGABYTE  # shapes of 100,000 channels and 100 modes
DEEPEST = 50  # tables within tables; ringtrue's own have 6
_WIDEST = 1 << 63  # of integers: 64 bits


def read_json(path: str | Path, error: type[InputError] = DataError) -> Any:
    """The value in a JSON file of UTF-8, UTF-16 with its mark, or Latin-1.

    Raises
    ------
    InputError
        Of the class `error`: the file is missing or not JSON, its lists are nested more than
        `DEEPEST` deep, or an integer has more than 64 bits.
    """
    return json_value(_limited_text(path, error), path, error)


def json_value(text: str, path: str | Path, error: type[InputError] = DataError) -> Any:
    """The value of a JSON text; `path` names it in errors, as `read_json` has them."""
    return _value(json.loads, "JSON", text, path, error)


def read_toml(path: str | Path, error: type[InputError] = DataError) -> dict[str, Any]:
    """The tables of a TOML file; limits and errors as `read_json` has them."""
    return toml_value(_limited_text(path, error), path, error)


def toml_value(
    text: str, path: str | Path, error: type[InputError] = DataError
) -> dict[str, Any]:
    """The tables of a TOML text; `path` names it in errors, as `read_json` has them."""
    table: dict[str, Any] = _value(tomllib.loads, "TOML", text, path, error)
    return table


def _limited_text(path: str | Path, error: type[InputError]) -> str:
    path = existing(path)
    if (size := path.stat().st_size) > LARGEST:
        raise error(
            f"{path}: {size / MEGABYTE:.0f} MB; a file of settings or modes may have "
            f"{LARGEST / MEGABYTE:.0f} MB"
        )
    return read_text(path)


def _value(
    parse: Callable[[str], Any],
    kind: str,
    text: str,
    path: str | Path,
    error: type[InputError],
) -> Any:
    """What a parser makes of a text, if it is not too deep and its integers are not too wide."""
    deep = error(
        f"{path}: lists or tables nested more than {DEEPEST} deep: this is no file of settings "
        "or modes"
    )
    with door(path, f"{kind} text", error, "open it in an editor"):
        try:
            value = parse(text)
        except (json.JSONDecodeError, tomllib.TOMLDecodeError) as exc:
            line = f":{exc.lineno}" if isinstance(exc, json.JSONDecodeError) else ""
            raise error(f"{path}{line}: not {kind}: {exc}") from exc
        except RecursionError as exc:
            raise deep from exc
    level = [value]
    for _ in range(DEEPEST):
        inside: list[Any] = []
        for part in level:
            if isinstance(part, dict):
                inside += part.values()
            elif isinstance(part, list):
                inside += part
            elif isinstance(part, int) and not -_WIDEST <= part < _WIDEST:
                raise error(
                    f"{path}: an integer of {len(str(abs(part)))} digits; it must have 64 bits "
                    "or less"
                )
        if not inside:
            return value
        level = inside
    raise deep


MOST_CELLS = 1_000_000  # of a sheet: 1,000 channels and 1,000 modes; 5 s
_UNPACKED = 64 * MEGABYTE  # of a part of the workbook: a cell takes some 30 bytes
_SAVE_AGAIN = "open it in Excel and save it again, or save the sheet as .csv"


def sheet_names(path: str | Path) -> list[str]:
    """The sheets of a workbook.

    Raises
    ------
    DataError
        If it is none, damaged, or too large.
    """
    with _opened(path) as book:
        return list(book.sheetnames)


def read_sheet(path: str | Path, sheet: str | None = None) -> list[list[object]]:
    """The rows of a sheet, the first if none is named, without empty cells at their ends.

    Raises
    ------
    DataError
        If the workbook is none, damaged or too large, or has no such sheet.
    """
    with _opened(path) as book:
        if sheet is not None and sheet not in book.sheetnames:
            raise DataError(
                f"{path}: no sheet {sheet!r}{did_you_mean(sheet, book.sheetnames)}"
            )
        if not book.worksheets:
            raise DataError(f"{path}: a workbook without a sheet of cells")
        page = book[sheet] if sheet is not None else book.worksheets[0]
        page.reset_dimensions()  # a stated size may be any
        rows: list[list[object]] = []
        cells = 0
        for row in page.iter_rows(values_only=True):
            cells += len(row) + 1
            if cells > MOST_CELLS:
                raise DataError(
                    f"{path}: sheet {page.title!r} has more than {MOST_CELLS} cells: {_SAVE_AGAIN}"
                )
            values = list(row)
            while values and values[-1] is None:
                values.pop()
            rows.append(values)
        return rows


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    from openpyxl import load_workbook

    path = existing(path)
    with door(path, "Excel workbook", advice=_SAVE_AGAIN):
        with zipfile.ZipFile(path) as archive:
            for part in archive.infolist():
                if (
                    part.filename.lower().endswith((".xml", ".rels"))
                    and part.file_size > _UNPACKED
                ):
                    raise DataError(
                        f"{path}: {part.filename} unfolds to {part.file_size / MEGABYTE:.0f} MB, "
                        f"the file {path.stat().st_size / MEGABYTE:.1f} MB: {_SAVE_AGAIN}"
                    )
        # openpyxl refuses other names of files, not other names of streams
        with (
            path.open("rb") as file,
            closing(load_workbook(file, read_only=True, data_only=True)) as book,
        ):
            yield book


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
    from nptdms import TdmsFile

    path = existing(path)
    raw = path.read_bytes()
    _check_segments(raw, path)
    # in memory a damaged length cannot ask for more than there is
    with door(path, "TDMS file"), TdmsFile.open(BytesIO(raw)) as file:
        yield file


def _check_segments(raw: bytes, path: Path) -> None:
    """The chain of segments and their counts of objects, before nptdms believes them."""
    at = 0
    seen = 0
    while at + _LEAD_IN.size <= len(raw) and raw[at : at + 4] in _TAGS:
        seen += 1
        mask = int.from_bytes(raw[at + 4 : at + 8], "little")
        order = ">" if mask & 64 else "<"
        after, data_at = struct.unpack_from(f"{order}QQ", raw, at + 12)
        begin = at + _LEAD_IN.size
        if after == _OPEN_END:
            after = len(raw)
        elif data_at > after or begin + data_at > len(raw):
            raise DataError(
                f"{path}: segment {seen} has its samples {data_at} bytes on, past its end: the "
                "file is cut"
            )
        if mask & 2 and begin + 4 <= len(raw):
            (objects,) = struct.unpack_from(f"{order}I", raw, begin)
            if objects > min(_TOO_MANY, len(raw)):
                raise DataError(
                    f"{path}: segment {seen} announces {objects} objects: the file is damaged"
                )
        at = begin + after
    if not seen:
        raise DataError(f"{path}: not a TDMS file")


def read_wave(path: str | Path) -> tuple[float, Any_]:
    """Rate (Hz) and samples (sample, channel), as scipy gives them: 24 bits stand in the upper
    bytes of 32.

    Raises
    ------
    DataError
        If it is no WAVE file, compressed or damaged.
    """
    from scipy.io import wavfile

    path = existing(path)
    # in memory a damaged length cannot ask for more than there is
    raw = bytearray(path.read_bytes())
    with door(path, "WAVE file of PCM or floats"):
        if raw[:4] == b"RIFF" and struct.unpack("<I", raw[4:8])[0] in (
            0,
            0xFFFFFFFF,
        ):  # its recorder did not close it
            raw[4:8] = struct.pack("<I", min(len(raw) - 8, 0xFFFFFFFE))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            rate, samples = wavfile.read(BytesIO(raw))
        for warning in caught:
            if "EOF" in str(warning.message):
                log.warning("%s: the file is cut: %s", path, warning.message)
        return float(rate), np.atleast_2d(samples.T).T


def write_sets(path: Path, sets: Iterable[Mapping[str, Any]]) -> None:
    """Write data sets, as pyuff names their parts, one after the other."""
    import pyuff

    file = pyuff.UFF(str(path))
    for one in sets:
        file.write_sets(dict(one), "add")


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
        arrays = {
            name: part for name, part in parts.items() if isinstance(part, np.ndarray)
        }
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
        made[kind](
            (data, indices.astype(np.int64), starts.astype(np.int64)), shape=shape
        )
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
        raise DataError(
            f"the starts of rows or columns do not rise from 0 to {data.size}"
        )
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
        raise DataError(
            f"{rows.size} rows, {columns.size} columns and {data.size} values"
        )
    shape = shape or (int(rows.max()) + 1, int(columns.max()) + 1)
    _check_parts(data, (rows, columns), shape)
    _check_rows(shape, data.size)
    _check_range(rows, shape[0], shape)
    _check_range(columns, shape[1], shape)
    return sparse.csr_array(
        (data, (rows.astype(np.int64), columns.astype(np.int64))), shape=shape
    )


def _check_parts(
    data: Any_, indices: tuple[Any_, Any_], shape: tuple[int, int]
) -> None:
    if data.dtype.kind not in "fciub" or any(
        part.dtype.kind not in "iu" for part in indices
    ):
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
