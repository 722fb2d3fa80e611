"""Readers of plain tables of samples: .npy, .csv, .lvm, .mat and HDF5 files of others."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

from ringtrue.core.arrays import Any_, Float
from ringtrue.errors import DataError

_RATE_NAMES = ("rate", "fs", "sampling_rate", "sample_rate", "fsamp", "sr")
_TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
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


def _numbered(data: Any_, rate: float | None) -> RawTable:
    n = data.shape[0]
    blank = ("",) * n
    return RawTable(data, rate, tuple(f"ch{i + 1}" for i in range(n)), blank, blank)


def _columns_first(a: Any_, path: Path) -> Any_:
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
        a = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as exc:
        raise DataError(f"{path}: not a readable .npy file ({exc})") from exc
    if a.ndim not in (1, 2) or a.dtype.kind not in "fiu":
        raise DataError(f"{path}: array {a.shape} {a.dtype}; it must be (sample, channel) and real")
    return _numbered(np.ascontiguousarray(np.atleast_2d(a.T)) * (1.0 if a.dtype.kind != "f" else a.dtype.type(1)), None)


def read_h5_table(file: h5py.File, path: Path) -> RawTable:
    """The first 2-D data set of an HDF5 file of others."""
    found: list[h5py.Dataset] = []
    file.visititems(lambda _, o: found.append(o) if isinstance(o, h5py.Dataset) and o.ndim == 2 else None)
    if not found:
        raise DataError(f"{path}: no 2-D data set in the file")
    attrs = {k.lower(): v for o in (file, found[0].parent, found[0]) for k, v in o.attrs.items()}
    scalars = {k.lower(): v[()] for k, v in file.items() if isinstance(v, h5py.Dataset) and v.size == 1}
    return _numbered(_columns_first(found[0][()], path), _named_rate({**scalars, **attrs}))


def _named_rate(values: Mapping[str, Any]) -> float | None:
    lower = {k.lower(): float(np.ravel(v)[0]) for k, v in values.items() if np.size(v) == 1 and _is_real(v)}
    for name in _RATE_NAMES:
        if name in lower:
            return lower[name]
    if "dt" in lower:
        return 1 / lower["dt"] if lower["dt"] else 0.0
    return None


def _is_real(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "fiu"


def read_mat(path: Path) -> RawTable:
    """The largest real 2-D variable of a MATLAB file, v5 or v7.3; the rate from `fs`, `rate` or `dt`."""
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            values = {k: v[()] for k, v in file.items() if isinstance(v, h5py.Dataset)}
    else:
        try:
            values = {k: v for k, v in loadmat(path).items() if not k.startswith("__")}
        except (ValueError, NotImplementedError, OSError) as exc:
            raise DataError(f"{path}: not a readable MATLAB file ({exc})") from exc
    arrays = [v for v in values.values() if isinstance(v, np.ndarray) and v.ndim == 2 and v.dtype.kind in "fiu"]
    if not arrays or max(a.size for a in arrays) < 2:
        raise DataError(f"{path}: no real 2-D variable; there are {', '.join(values) or 'none'}")
    return _numbered(_columns_first(max(arrays, key=lambda a: a.size), path), _named_rate(values))


def read_csv(path: Path) -> RawTable:
    """Delimited text, a column for each channel; a first column `time` or of equal steps gives the rate.

    A header such as `101+Z [m/s^2]` gives name and unit. Delimiters `, ; tab space`; decimal commas are understood.
    """
    lines = [x for x in path.read_text(encoding="utf-8-sig").splitlines() if x.strip() and not x.startswith("#")]
    if not lines:
        raise DataError(f"{path}: empty, there are no samples")
    delimiter, comma = _dialect(lines[-1])
    header = not _is_numbers(_cells(lines[0], delimiter), comma)
    names = [x.strip() for x in _cells(lines[0], delimiter)] if header else []
    data = _numbers(lines[header:], delimiter, comma, path)
    if names and len(names) != data.shape[0]:
        raise DataError(f"{path}: {len(names)} names in the header, {data.shape[0]} columns")
    return _with_time(data, names, path)


def _dialect(line: str) -> tuple[str, bool]:
    for delimiter in (";", "\t"):
        if delimiter in line:
            return delimiter, "," in line
    return ("," if "," in line else " "), False


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter))


def _is_numbers(cells: Sequence[str], comma: bool) -> bool:
    try:
        [float(x.replace(",", ".") if comma else x) for x in cells if x.strip()]
    except ValueError:
        return False
    return True


def _numbers(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
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
        return _numbered(data, rate)
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


def read_lvm(path: Path) -> RawTable:
    """LabVIEW measurement text: two headers, one segment, decimal point or comma.

    Raises
    ------
    DataError
        If the headers or the step of time are missing.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    ends = [i for i, x in enumerate(lines) if x.startswith("***End_of_Header***")]
    if not lines or not lines[0].startswith("LabVIEW") or len(ends) < 2:
        raise DataError(f"{path}: not a LabVIEW measurement file with both headers")
    comma = any(x.startswith("Decimal_Separator") and x.split("\t")[1:2] == [","] for x in lines[: ends[0]])
    table = {x.split("\t")[0]: x.split("\t")[1:] for x in lines[ends[0] + 1 : ends[1]]}
    n = int(table["Channels"][0])
    dt = [float(x.replace(",", ".")) for x in table.get("Delta_X", [])[:n]]
    if len(dt) != n or max(dt) != min(dt):
        raise DataError(f"{path}: steps of time Delta_X {dt}: {n} equal ones are needed")
    names = lines[ends[1] + 1].split("\t")[1 : n + 1]
    rows = [x.split("\t") for x in lines[ends[1] + 2 : len(lines) if len(ends) == 2 else ends[2]] if x.strip()]
    text = [" ".join(r[1 : n + 1]) for r in rows]
    data = _numbers(text, " ", comma, path)
    units = tuple(table.get("Y_Unit_Label", [])[:n])
    return RawTable(data, 1 / dt[0] if dt[0] else 0.0, tuple(names), (*units, *("",) * (n - len(units))), ("",) * n)
