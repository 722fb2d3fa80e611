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
from ringtrue.io.si import known

_RATE_NAMES = ("rate", "fs", "sampling_rate", "sample_rate", "fsamp", "sr")
TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
_BAD_HEADER = (SyntaxError, TokenError, RecursionError)  # of the Python text in a .npy file
_CHECKED, _PACKED = 1 << 26, 1000  # bytes above which, and the compression up to which, a size is believed
_CLOCK = re.compile(r"(\d{4}[-/]\d\d?[-/]\d\d?[ T])?\d\d?:\d\d:\d\d([.,]\d*)?Z?$")
_SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "h": 3600.0}
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
    return without_time(numbered(data, None), path)


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
    rate = named_rate({**scalars, **attrs})
    if rate is None:
        beside = {k: v for k, v in found[0].parent.items() if isinstance(v, h5py.Dataset) and v.name != found[0].name}
        times = {k: v[()] for k, v in beside.items() if v.size == max(found[0].shape) and k.lower() in TIME_NAMES}
        rate = time_rate(times, max(found[0].shape), path)
    return found[0], rate


def read_h5_table(file: h5py.File, path: Path) -> RawTable:
    """The first 2-D data set of an HDF5 file of others."""
    data, rate = h5_table(file, path)
    return without_time(numbered(columns_first(data[()], path), rate), path)


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
    if delimiter != " " and lines[-1].rstrip(" ").endswith(delimiter):  # each line ends in a delimiter
        lines = [x.rstrip(" ").removesuffix(delimiter) for x in lines]
        if not lines[-1].strip(f" {delimiter}"):
            raise DataError(f"{path}: the last line has no number: the file is empty or cut")
    width = len(_cells(lines[-1], delimiter))
    head = [_cells(x, delimiter) for x in lines[: _head_rows(lines, delimiter, comma, width)]]
    data = numbers(_clocked(lines[len(head) :], delimiter), delimiter, comma, path)
    return _with_time(data, _titles(head, data.shape[0], path), path)


def _head_rows(lines: Sequence[str], delimiter: str, comma: bool, width: int) -> int:
    """How many lines stand above the samples: other numbers of cells than below, or not one number."""
    for at, line in enumerate(lines):
        cells = _cells(line, delimiter)
        if len(cells) == width and any(_is_numbers([x], comma) for x in cells if x.strip()):
            return at
        if at and len(cells) > 1 and len(cells) != width and _is_numbers(cells, comma):
            return at  # a line of samples that lacks some
    return min(1, len(lines))


def _titles(head: Sequence[Sequence[str]], width: int, path: Path) -> list[str]:
    """Names of the columns from the lines above them; a line of units under the names is joined to them."""
    if not head:
        return []
    rows = [[x.strip() for x in cells] for cells in head]
    if len(head) == 1 and len(rows[0]) != width:
        raise DataError(f"{path}: {len(rows[0])} names in the header, {width} columns")
    fit = [r for r in rows if len(r) == width and width > 1] or [r for r in rows[-1:] if len(r) == width]
    if len(fit) < 2 or not all(_is_unit(u.strip("[]()")) for u in fit[-1]):
        return fit[-1] if fit else []
    units = [u.strip("[]()").strip("-") for u in fit[-1]]
    return [n if _UNIT.match(n) or not u else f"{n} [{u}]" for n, u in zip(fit[-2], units, strict=True)]


def _is_unit(text: str) -> bool:
    return text.lower() in ("", "-", *_SECONDS) or bool(known(text))


def _clocked(lines: Sequence[str], delimiter: str) -> Sequence[str]:
    """Lines whose first cells are dates or times of day, with seconds from the first one in their place."""
    if not lines or delimiter == " " or not _CLOCK.match(lines[0].partition(delimiter)[0].strip(' "')):
        return lines
    cut = [x.partition(delimiter) for x in lines]
    texts = [x[0].strip(' "').replace("/", "-").replace(",", ".").removesuffix("Z") for x in cut]
    day = "" if "-" in texts[0] else "2000-01-01T"
    try:
        t = np.array([day + x for x in texts], dtype="datetime64[ns]")
    except ValueError:
        return lines  # what is wrong is said where the numbers are read
    seconds = (t - t[0]) / np.timedelta64(1, "s")
    point = "," if delimiter != "," and "," in lines[-1] else "."
    return [f"{s:.9f}".replace(".", point) + x[1] + x[2] for s, x in zip(seconds.tolist(), cut, strict=True)]


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
    title = _UNIT.match(names[0]) if names else None
    named = bool(names) and (names[0].lower() in TIME_NAMES or (title is not None and title[1].lower() in TIME_NAMES))
    unit = _SECONDS.get(title[2].strip().lower(), 1.0) if title else 1.0
    rate = _time_rate(data[0] * unit, named, path) if data.shape[0] > 1 or named else None
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
    if not step.size or not np.isfinite(step).all() or (step < 0).any() or not ((step > 0).all() or _rounded(t)):
        if named:
            raise DataError(f"{path}: the time column does not rise, or has fewer than 2 rows")
        return None
    mean = float(step.mean())
    if np.abs(step - mean).max() > 0.05 * mean + 1e-6 * np.abs(t).max() and not _rounded(t):
        if named:
            at = int(np.abs(step - mean).argmax())
            raise DataError(
                f"{path}: the time column has uneven steps: {step[at]:g} s at row {at + 1}, mean {mean:g} s"
            )
        return None
    return 1 / mean


def _rounded(t: Float) -> bool:
    """Whether the times are even ones, written with few decimals."""
    line = np.polynomial.Polynomial.fit(np.arange(t.size), t, 1)(np.arange(t.size))
    top = max(float(np.abs(t).max()), 1e-300)
    decade = np.floor(np.log10(np.maximum(np.abs(t), 1e-12 * top) * (1 + 1e-12)))
    units = [np.full(t.size, 10.0**-k) for k in range(1, 7)] + [10.0 ** (decade + 1 - k) for k in range(3, 10)]
    for unit in units:  # so many decimals, or so many digits
        if np.abs(np.round(t / unit) * unit - t).max() < 1e-9 * top and np.abs(t - line).max() <= 0.75 * unit.max():
            return True
    return False


def without_time(table: RawTable, path: Path) -> RawTable:
    """A table without names whose first row is a time (it rises in equal steps): the rate in its place."""
    rate = _time_rate(table.data[0], False, path) if table.data.shape[0] > 1 else None
    if rate is None or rate <= 1 or table.data.shape[1] < 10:  # 1 Hz: the column may as well number the samples
        return table
    rest = numbered(table.data[1:], rate)
    if table.rate is not None and abs(table.rate / rate - 1) > 1e-3:
        raise DataError(f"{path}: a rate of {table.rate:g} Hz is named, but the first column, a time, says {rate:g} Hz")
    return rest


def time_rate(values: Mapping[str, Any], samples: int, path: Path) -> float | None:
    """The rate (Hz) by a vector of so many times among named arrays (`t`, `time`), None if there is none."""
    for name, v in values.items():
        if name.lower() in TIME_NAMES and _is_real(v) and np.size(v) == samples:
            return _time_rate(np.ravel(v).astype(np.float64), True, path)
    return None


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
