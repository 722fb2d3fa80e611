"""Readers of plain tables of samples: .npy, .csv and HDF5 files of others."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write

_RATE_NAMES = ("rate", "fs", "sampling_rate", "sample_rate", "fsamp", "sr")
_TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
_BAD_HEADER = (SyntaxError, TokenError, RecursionError)  # of the Python text in a .npy file
_CHECKED, _PACKED = 1 << 26, 1000  # bytes above which, and the compression up to which, a size is believed
_UNIT = re.compile(r"^(.*?)\s*[\[(]([^\])]*)[\])]\s*$")


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """Samples as a foreign file holds them.

    Attributes
    ----------
    data : (channel, sample)
    rate : float or None, Hz
    names, units, quantities : tuple of str, one for each channel
    """

    data: Any_
    rate: float | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    quantities: tuple[str, ...]


def numbered(data: Any_, rate: float | None) -> RawTable:
    """A table without names and units: `ch1`, `ch2`, ..."""
    n = data.shape[0]
    blank = ("",) * n
    return RawTable(data, rate, tuple(f"ch{i + 1}" for i in range(n)), blank, blank)


def columns_first(a: Any_, path: Path) -> Any_:
    """(channel, sample), the longer axis taken as time."""
    if a.ndim == 1:
        a = a[None]
    if a.ndim != 2 or a.dtype.kind not in "fiu":
        raise DataError(f"{path}: array {a.shape} {a.dtype}; it must be 2-D and real")
    a = a if a.shape[1] >= a.shape[0] else a.T
    return np.ascontiguousarray(a if a.dtype.kind == "f" else a.astype(np.float64))


def read_npy(path: Path) -> RawTable:
    """A NumPy array (sample, channel), or (sample,)."""
    try:
        a = np.load(path, mmap_mode="r", allow_pickle=False)  # a damaged shape cannot ask for memory
    except (ValueError, EOFError, OSError, TypeError, OverflowError, MemoryError, *_BAD_HEADER) as exc:
        raise DataError(f"{path}: not a readable .npy file ({exc})") from exc
    if a.ndim not in (1, 2) or a.dtype.kind not in "fiu":
        raise DataError(f"{path}: array {a.shape} {a.dtype}; it must be (sample, channel) and real")
    data = np.array(np.atleast_2d(a.T), dtype=a.dtype if a.dtype.kind == "f" else np.float64, order="C")
    return numbered(data, None)


def h5_table(file: h5py.File, path: Path) -> tuple[h5py.Dataset, float | None]:
    """The first 2-D data set of numbers of an HDF5 file of others, unread, and the rate.

    Raises
    ------
    DataError
        If there is none, or it announces far more than the file holds.
    """
    found: list[h5py.Dataset] = []
    file.visititems(lambda _, o: found.append(o) if isinstance(o, h5py.Dataset) and o.ndim == 2 else None)
    if not found:
        raise DataError(f"{path}: no 2-D data set in the file")
    check_stored(found[0], path)
    attrs = {k.lower(): v for o in (file, found[0].parent, found[0]) for k, v in o.attrs.items()}
    scalars = {k.lower(): v[()] for k, v in file.items() if isinstance(v, h5py.Dataset) and v.size == 1}
    return found[0], named_rate({**scalars, **attrs})


def read_h5_table(file: h5py.File, path: Path) -> RawTable:
    """The first 2-D data set of an HDF5 file of others."""
    data, rate = h5_table(file, path)
    return numbered(columns_first(data[()], path), rate)


def check_stored(data: h5py.Dataset, path: str | Path) -> None:
    """Refuse a data set that announces far more samples than the file stores: its chunks are missing or damaged."""
    size, stored = int(data.size) * data.dtype.itemsize, data.id.get_storage_size()
    if size > _CHECKED and size > _PACKED * stored:
        raise DataError(f"{path}: {data.name} announces {size} bytes, {stored} are stored: the file is cut or damaged")


def named_rate(values: Mapping[str, Any]) -> float | None:
    """The sampling rate (Hz) among named scalars: `fs`, `rate`, ... or `dt`."""
    lower = {k.lower(): float(np.ravel(v)[0]) for k, v in values.items() if _is_real(v) and np.size(v) == 1}
    for name in _RATE_NAMES:
        if name in lower:
            return lower[name]
    if "dt" in lower:
        return 1 / lower["dt"] if lower["dt"] else 0.0
    return None


def _is_real(value: Any) -> bool:
    return getattr(value, "dtype", np.asarray(value).dtype if np.isscalar(value) else np.dtype(object)).kind in "fiu"


def read_csv(path: Path) -> RawTable:
    """Delimited text, a column for each channel; a first column `time` or of equal steps gives the rate.

    A header such as `101+Z [m/s^2]` gives name and unit. Delimiters `, ; tab space`; decimal commas are understood.
    """
    lines = [x for x in read_text(path).splitlines() if x.strip() and not x.startswith("#")]
    if not lines:
        raise DataError(f"{path}: empty, there are no samples")
    delimiter, comma = _dialect(lines[-1])
    header = not _is_numbers(_cells(lines[0], delimiter), comma)
    names = [x.strip() for x in _cells(lines[0], delimiter)] if header else []
    data = numbers(lines[header:], delimiter, comma, path)
    if names and len(names) != data.shape[0]:
        raise DataError(f"{path}: {len(names)} names in the header, {data.shape[0]} columns")
    return _with_time(data, names, path)


def read_text(path: Path) -> str:
    """Text in UTF-8, UTF-16 with its mark, or Latin-1, as instruments write it.

    Raises
    ------
    DataError
        If there are zero bytes: a binary file.
    """
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace")
    if b"\x00" in raw:
        raise DataError(f"{path}: has zero bytes; this is not a text file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _dialect(line: str) -> tuple[str, bool]:
    for delimiter in (";", "\t"):
        if delimiter in line:
            return delimiter, "," in line
    return ("," if "," in line else " "), False


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def _is_numbers(cells: Sequence[str], comma: bool) -> bool:
    try:
        [float(x.replace(",", ".") if comma else x) for x in cells if x.strip()]
    except ValueError:
        return False
    return True


def numbers(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
    """(column, row) float64 numbers of delimited lines, with decimal commas if `comma`."""
    if not lines:
        raise DataError(f"{path}: empty, there are no samples")
    text = (x.replace(",", ".") for x in lines) if comma else iter(lines)
    try:
        a = np.loadtxt(text, delimiter=None if delimiter == " " else delimiter, ndmin=2, dtype=np.float64)
    except ValueError as exc:
        raise DataError(f"{path}: {exc}") from exc
    return np.ascontiguousarray(a.T)


def _with_time(data: Float, names: Sequence[str], path: Path) -> RawTable:
    named = bool(names) and names[0].lower() in _TIME_NAMES
    rate = _time_rate(data[0], named, path) if data.shape[0] > 1 or named else None
    if rate is not None:
        data, names = data[1:], names[1:]
    if not names:
        return numbered(data, rate)
    pairs = [_UNIT.match(n) for n in names]
    return RawTable(
        data,
        rate,
        tuple(p[1] if p else n for p, n in zip(pairs, names, strict=True)),
        tuple(p[2] if p else "" for p in pairs),
        ("",) * len(names),
    )


def _time_rate(t: Float, named: bool, path: Path) -> float | None:
    """The rate of a time column; None if an unnamed column is not one."""
    step = np.diff(t)
    if not step.size or not np.isfinite(step).all() or (step <= 0).any():
        if named:
            raise DataError(f"{path}: the time column does not rise, or has fewer than 2 rows")
        return None
    mean = float(step.mean())
    if np.abs(step - mean).max() > 0.05 * mean + 1e-6 * np.abs(t).max():
        if named:
            at = int(np.abs(step - mean).argmax())
            raise DataError(
                f"{path}: the time column has uneven steps: {step[at]:g} s at row {at + 1}, mean {mean:g} s"
            )
        return None
    return 1 / mean


def write_csv(path: str | Path, history: TimeHistory) -> None:
    """Write a record as CSV: a column `time` (s), then one a channel with a header `101+Z [m/s^2]`, 9 digits."""
    head = ["time", *(f"{c.id} [{c.unit}]" if c.unit else c.id for c in history.channels)]
    block = 1 << 14
    with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        for at in range(0, history.data.shape[1], block):  # so that the text is never whole in memory
            part_data = np.asarray(history.data[:, at : at + block], dtype=np.float64)
            t = (at + np.arange(part_data.shape[1])) / history.rate
            np.savetxt(file, np.vstack([t, part_data]).T, fmt=["%.12g", *["%.9g"] * len(part_data)], delimiter=",")
