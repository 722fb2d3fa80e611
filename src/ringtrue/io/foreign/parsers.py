"""Parsers of others: HDF5, JSON, TOML, Excel, TDMS, WAVE, and universal files that are written.

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
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError, InputError, did_you_mean
from ringtrue.io.files import existing, read_text
from ringtrue.io.foreign.door import EXPORT_AGAIN, MEGABYTE, door, need_not_try, tried_apart

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


def toml_value(text: str, path: str | Path, error: type[InputError] = DataError) -> dict[str, Any]:
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
    parse: Callable[[str], Any], kind: str, text: str, path: str | Path, error: type[InputError]
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
            raise DataError(f"{path}: no sheet {sheet!r}{did_you_mean(sheet, book.sheetnames)}")
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
                if part.filename.lower().endswith((".xml", ".rels")) and part.file_size > _UNPACKED:
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
