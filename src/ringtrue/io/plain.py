"""Readers of plain tables of samples: .npy and HDF5 files of others; times that are even."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.foreign.arrays import read_npy as read_array
from ringtrue.io.foreign.hdf5 import open_hdf5
from ringtrue.io.si import known
from ringtrue.io.times import LONG, THIN, even_grid, in_seconds, uneven

_RATE_NAMES = (
    "rate",
    "fs",
    "samplingrate",
    "samplerate",
    "fsamp",
    "fsample",
    "sr",
)  # in letters and digits
_RATE_WORDS = ("samplefrequency", "samplingfrequency", "samplefreq", "samplingfreq")
_STEP_NAMES = ("dt", "increment", "samplinginterval", "sampleinterval", "deltat", "timestep", "ts")
TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
_SAME_RATE = 1e-3  # relative, of a rate that is named and that of the times
_CHECKED, _PACKED = (
    1 << 26,
    1000,
)  # bytes above which, and the compression up to which, a size is believed


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """Samples as a foreign file holds them.

    Attributes
    ----------
    data : (channel, sample)
    rate : float or None, Hz
    names, units, quantities : tuple of str, one for each channel
    rows : (sample,) int64 or None
        Where rows are missing by the times: the place of each on the even grid.
    """

    data: Any_
    rate: float | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    quantities: tuple[str, ...]
    rows: Int | None = None

    def evened(self) -> RawTable:
        """The table with NaN in the rows that are missing."""
        if self.rows is None:
            return self
        data = np.full(
            (len(self.data), int(self.rows[-1]) + 1),
            np.nan,
            dtype=np.result_type(self.data, np.float32),
        )
        data[:, self.rows] = self.data
        return replace(self, data=data, rows=None)

    def check_whole(self, path: Path) -> None:
        """Refuse missing rows.

        Raises
        ------
        DataError
        """
        if self.rows is not None and self.rate is not None:
            raise DataError(f"{path}: {uneven(np.diff(self.rows) / self.rate)}")


def joined(pieces: Sequence[tuple[float, RawTable]]) -> RawTable | None:
    """One table of the acquisitions of a file, one after the other, each with its start, s; `rows`
    tells their places.

    None where they are no parts of one record: of other channels or rates, at one time, or half of
    it between them.
    """
    pieces = sorted(pieces, key=lambda x: x[0])
    first, rate = pieces[0][1], pieces[0][1].rate
    alike = all(
        (t.names, t.units, t.rate, t.rows) == (first.names, first.units, rate, None)
        for _, t in pieces
    )
    if rate is None or not alike or not np.isfinite([start for start, _ in pieces]).all():
        return None
    size = np.array([t.data.shape[1] for _, t in pieces])
    begin = np.round((np.array([start for start, _ in pieces]) - pieces[0][0]) * rate).astype(
        np.int64
    )
    late = np.diff(begin) - size[:-1]
    if (late < -1).any() or begin[-1] + size[-1] > size.sum() / THIN:
        return None
    begin[1:] += np.cumsum(late == -1)  # rounding
    rows = np.concatenate([a + np.arange(n) for a, n in zip(begin, size, strict=True)])
    whole = np.concatenate([t.data for _, t in pieces], axis=1)
    return replace(first, data=whole, rows=rows if rows[-1] >= rows.size else None)


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
    """A NumPy array (sample, channel), or (sample,); more channels than samples are taken for
    (channel, sample).
    """
    a = read_array(path)
    if a.ndim not in (1, 2) or a.dtype.kind not in "fiu":
        raise DataError(f"{path}: array {a.shape} {a.dtype}; it must be (sample, channel) and real")
    a = a.T if a.ndim == 2 and a.shape[1] > a.shape[0] > 0 else a
    data = np.array(
        np.atleast_2d(a.T), dtype=a.dtype if a.dtype.kind == "f" else np.float64, order="C"
    )
    return without_time(numbered(data, None), path)


def is_time(name: str) -> bool:
    """Whether a variable or channel of this name holds times: `t`, `Time [s]`,
    `Data1_time_AI_1`.
    """
    return (
        name.strip().lower() in TIME_NAMES or re.search(r"(^|_)time(_|$)", name.lower()) is not None
    )


def h5_table(file: h5py.Group, path: Path) -> tuple[h5py.Dataset, float | None, Int | None]:
    """The 2-D data set of samples of an HDF5 file of others, unread, the rate, and places as of
    `even_grid`.

    It is the only long one, or the first where none is long.

    Raises
    ------
    DataError
        If there is none, there are several long ones, or it announces far more than the file holds.
    """
    found: list[h5py.Dataset] = []
    file.visititems(
        lambda _, o: found.append(o) if isinstance(o, h5py.Dataset) and o.ndim == 2 else None
    )
    if not found:
        raise DataError(f"{path}: no 2-D data set in the file")
    long = [
        d for d in found if d.dtype.kind in "fiu" and max(d.shape) >= max(LONG, 4 * min(d.shape))
    ]
    if len(long) > 1:
        told = "; ".join(f"{d.name.lstrip('/')} {d.shape}" for d in long[:8])
        raise DataError(
            f"{path}: several tables of samples ({told}): choose one with group (--group NAME)"
        )
    data = (long or found)[0]
    check_stored(data, path)
    attrs = _attributes(file.file, file, data.parent, data)
    scalars = {
        k.lower(): v[()] for k, v in file.items() if isinstance(v, h5py.Dataset) and v.size == 1
    }
    beside = {
        k: v for k, v in data.parent.items() if isinstance(v, h5py.Dataset) and v.name != data.name
    }
    times = {k: v[()] for k, v in beside.items() if v.size == max(data.shape) and is_time(k)}
    return data, *time_grid(times, max(data.shape), path, named_rate({**scalars, **attrs}))


def read_h5_table(file: h5py.Group, path: Path, group: str = "") -> RawTable:
    """The 2-D data set of samples of an HDF5 file of others, or all vectors of one length if there
    is none.

    With `group`, the path of a group or of a data set, what stands there alone.
    """
    if group:
        return _h5_part(file, path, group)
    if (table := _h5_vectors(file, path)) is not None:
        return table
    data, rate, rows = h5_table(file, path)
    return without_time(replace(numbered(columns_first(data[()], path), rate), rows=rows), path)


def _h5_part(file: h5py.Group, path: Path, group: str) -> RawTable:
    part = file.get(group.strip("/"))
    if part is None:
        every: list[str] = []
        file.visit(every.append)
        raise DataError(f"{path}: no group {group!r}{did_you_mean(group, every)}")
    if isinstance(part, h5py.Group):
        return read_h5_table(part, path)
    check_stored(part, path)
    rate = named_rate(_attributes(file, part.parent, part))
    return without_time(numbered(columns_first(part[()], path), rate), path)


def _h5_vectors(file: h5py.Group, path: Path) -> RawTable | None:
    """A file of one vector a channel; None if it has a 2-D data set or no vectors."""
    every: dict[str, h5py.Dataset] = {}
    file.visititems(
        lambda name, o: every.update({name: o}) if isinstance(o, h5py.Dataset) and o.ndim else None
    )
    one = {k: v for k, v in every.items() if v.ndim == 1 and v.dtype.kind in "fiu" and v.size > 1}
    if not one or any(v.ndim == 2 for v in every.values()):
        return None
    for v in one.values():
        check_stored(v, path)
    samples = max(v.size for v in one.values())
    short = {k.rpartition("/")[2]: v[()] for k, v in one.items() if v.size == samples}
    told = [_attributes(v.parent, v) for v in one.values() if v.size == samples]
    rates = [rate for each in told if (rate := named_rate(each))]
    if rates and max(rates) > (1 + _SAME_RATE) * min(rates):
        raise DataError(
            f"{path}: {min(rates):g} to {max(rates):g} Hz: choose one of the groups (--group NAME)"
        )
    attrs = {k: v for each in (_attributes(file), *told) for k, v in each.items()}
    scalars = {k.lower(): v[()] for k, v in every.items() if v.size == 1}
    rate, rows = time_grid(short, samples, path, named_rate({**scalars, **attrs}))
    signals = {
        k: v for k, v in one.items() if v.size == samples and not is_time(k.rpartition("/")[2])
    }
    if not signals:
        return None
    table = numbered(np.stack([v[()].astype(np.float64) for v in signals.values()]), rate)
    alone = len({v.parent.name for v in signals.values()}) == 1
    names = tuple(k.rpartition("/")[2] if alone else k.replace("/", ".") for k in signals)
    return replace(table, names=names, units=tuple(_unit(v) for v in signals.values()), rows=rows)


def _attributes(*objects: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Attributes by their names in lower case, the last counts."""
    return {k.lower(): v for o in objects for k, v in o.attrs.items()}


def _unit(data: h5py.Dataset) -> str:
    """Of an attribute `unit` or `units`; empty where there is none, or free text."""
    told = next((v for k, v in data.attrs.items() if k.lower() in ("unit", "units")), "")
    text = np.ravel(told)[0] if np.size(told) == 1 else ""
    return known(text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text))


def h5_values(
    path: Path, value: Callable[[str, h5py.Dataset], Any], kind: str = "HDF5"
) -> dict[str, Any]:
    """What `value(name, data set)` makes of the data sets of a file, by `group.name`; None is left
    out.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    found: dict[str, Any] = {}

    def keep(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and (kept := value(name, item)) is not None:
            found[name.replace("/", ".")] = kept

    with open_hdf5(path, f"{kind} file") as file:
        file.visititems(keep)
    return found


def check_stored(data: h5py.Dataset, path: str | Path) -> None:
    """Refuse a data set that announces far more samples than the file stores: its chunks are
    missing or damaged.
    """
    size, stored = int(data.size) * data.dtype.itemsize, data.id.get_storage_size()
    if size > _CHECKED and size > _PACKED * stored:
        raise DataError(
            f"{path}: {data.name} announces {size} bytes, {stored} are stored: the file is cut "
            "or damaged"
        )


def named_rate(values: Mapping[str, Any]) -> float | None:
    """The sampling rate (Hz) among named scalars: `fs`, `rate`, ... or a step of time such as
    `dt`.
    """
    real = {k: float(np.ravel(v)[0]) for k, v in values.items() if _is_real(v) and np.size(v) == 1}
    lower = {re.sub("[^a-z0-9]", "", k.lower()).removesuffix("hz"): x for k, x in real.items()}
    for name in (*_RATE_NAMES, *_RATE_WORDS):
        if name in lower:
            return lower[name]
    step = next((lower[name] for name in _STEP_NAMES if name in lower), None)
    return None if step is None else 1 / step if step else 0.0


def _is_real(value: Any) -> bool:
    return (
        getattr(
            value, "dtype", np.asarray(value).dtype if np.isscalar(value) else np.dtype(object)
        ).kind
        in "fiu"
    )


def without_time(table: RawTable, path: Path) -> RawTable:
    """A table without names whose first row is a time (it rises in equal steps): the rate in its
    place.
    """
    rate, rows = (
        even_grid(in_seconds(table.data[0]), False, path)
        if table.data.shape[0] > 1
        else (None, None)
    )
    if (
        rate is None or rate <= 1 or table.data.shape[1] < 10
    ):  # 1 Hz: the column may as well number the samples
        return table
    rest = replace(numbered(table.data[1:], rate), rows=rows)
    if table.rate is not None and abs(table.rate / rate - 1) > _SAME_RATE:
        raise DataError(
            f"{path}: a rate of {table.rate:g} Hz is named, but the first column, a time, says "
            f"{rate:g} Hz"
        )
    return rest


def time_grid(
    values: Mapping[str, Any], samples: int, path: Path, told: float | None = None
) -> tuple[float | None, Int | None]:
    """`even_grid` of a vector of so many times among named arrays (`t`, `time`); None, None if
    there is none.

    A rate that is `told` beside them stands; of times in other units, or uneven ones, nothing is
    asked then.
    """
    times = [
        np.ravel(v)
        for k, v in values.items()
        if is_time(k) and _is_real(v) and np.size(v) == samples
    ]
    if not times:
        return told, None
    rate, rows = even_grid(in_seconds(times[0].astype(np.float64)), told is None, path)
    if told is None:
        return rate, rows
    return told, rows if rate is not None and abs(rate / told - 1) < _SAME_RATE else None
