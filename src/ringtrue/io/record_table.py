"""Samples as a file of any format holds them; their rate from names or times.

ringtrue's own HDF5 layout of a record (docs/formats.md): the channel table, and reading what is
stored.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.core.signals import Channel, Quantity, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.times import THIN, even_grid, in_seconds, to_si, uneven

FORMAT = "ringtrue-record"


@dataclass(frozen=True, slots=True)
class RecordChannel:
    """One row of the channel table of a record.

    Attributes
    ----------
    id : str
        Unique, for instance `101+Z`.
    point : int
        Point of the test model; 0 where unknown.
    quantity, unit : str
        What the sensor measures and the unit its sensitivity refers to.
    sensitivity : float, V per unit
    range : float, V
        Full scale of the recorder channel; inf where unknown.
    sensor : str
        Type or serial number.
    calibration : str
        ISO date; empty where unknown.
    """

    id: str
    point: int = 0
    quantity: Quantity = "unknown"
    unit: str = ""
    sensitivity: float = 1.0
    range: float = float("inf")
    sensor: str = ""
    calibration: str = ""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sensitivity) and self.sensitivity != 0):
            raise DataError(
                f"channel {self.id}: sensitivity {self.sensitivity} V/unit must be finite and not 0"
            )
        if not self.range > 0:
            raise DataError(f"channel {self.id}: range {self.range} V must be positive")
        to_si(self.unit, self.quantity)

    @property
    def has_scale(self) -> bool:
        """Whether it has a quantity or a sensitivity."""
        return self.quantity != "unknown" or self.sensitivity != 1.0

    @property
    def to_si(self) -> float:
        """SI units per volt."""
        return to_si(self.unit, self.quantity)[1] / self.sensitivity

    @property
    def full_scale(self) -> float:
        """Range in SI units."""
        return abs(self.range * self.to_si)

    def channel(self) -> Channel:
        """The channel after import, SI."""
        quantity, _, unit = to_si(self.unit, self.quantity)
        return Channel(self.id, quantity, unit, self.sensor)


@dataclass(frozen=True, slots=True)
class RecordInfo:
    """What a record in ringtrue's layout holds, without its samples."""

    channels: tuple[RecordChannel, ...]
    rate: float
    samples: int
    source: str

    def full_scale(self) -> dict[str, float]:
        """Full scale of each channel by id, SI; inf where unknown."""
        return {c.id: c.full_scale for c in self.channels}


TABLE = {
    "id": str,
    "point": np.int64,
    "quantity": str,
    "unit": str,
    "sensitivity": np.float64,
    "range": np.float64,
    "sensor": str,
    "calibration": str,
}


def find_record(file: h5py.File) -> h5py.Group | None:
    """The group of the record; None where the layout is another one."""
    for group in (file.get("record"), file):
        data = group.get("data") if isinstance(group, h5py.Group) else None
        if isinstance(data, h5py.Dataset) and (
            "channels" in group or "id" in data.attrs
        ):
            return group
    return None


def record_group(file: h5py.File, path: str | Path) -> h5py.Group:
    """The group of the record; `DataError` where the layout is another one."""
    group = find_record(file)
    if group is None:
        raise DataError(
            f"{path}: no record in ringtrue's layout (a data set `data` with a table `channels`)"
        )
    return group


def _column(group: h5py.Group, name: str, kind: type, path: str | Path) -> list[Any]:
    """A column of the channel table; empty where there is none."""
    data = group["data"]
    table = group.get("channels")
    in_table = isinstance(table, h5py.Group) and name in table
    raw = table[name][()] if in_table else data.attrs.get(name)
    if raw is None:
        return []
    values = np.atleast_1d(raw)
    n = data.shape[0]
    if values.shape != (n,):
        raise DataError(
            f"{path}: channel table {name} has {values.size} rows, the data {n} channels"
        )
    if kind is str:
        return [v.decode() if isinstance(v, bytes) else str(v) for v in values.tolist()]
    try:
        return list(np.asarray(values, dtype=kind).tolist())
    except ValueError as exc:
        raise DataError(
            f"{path}: channel table {name} must hold numbers ({exc})"
        ) from exc


def stored_info(group: h5py.Group, path: str | Path) -> RecordInfo:
    """Channel table, rate and length; `DataError` where one of them is wrong."""
    shape = group["data"].shape
    if len(shape) != 2 or 0 in shape:
        raise DataError(f"{path}: data {shape} must be (channel, sample) and not empty")
    rate = group.attrs.get("rate", group["data"].attrs.get("rate"))
    if rate is None or not (np.isfinite(rate) and rate > 0):
        raise DataError(
            f"{path}: attribute rate is {rate}; it must be a positive number, Hz"
        )
    rows: list[dict[str, Any]] = [{} for _ in range(shape[0])]
    for name, kind in TABLE.items():
        for row, value in zip(rows, _column(group, name, kind, path), strict=False):
            row[name] = value
    if "id" not in rows[0]:
        raise DataError(f"{path}: the channel table lacks `id`")
    channels = tuple(RecordChannel(**row) for row in rows)
    if len({c.id for c in channels}) != len(channels):
        raise DataError(f"{path}: a channel id occurs twice")
    source = str(group.attrs.get("source", "") or path)
    return RecordInfo(channels, float(rate), int(shape[1]), source)


def channel_positions(
    info: RecordInfo, channels: Sequence[str] | None, path: str | Path
) -> Int:
    """Rows of the channels by id, (c,) int64, in the order asked for; all by default."""
    here = {c.id: i for i, c in enumerate(info.channels)}
    wanted = list(here) if channels is None else channels
    if lost := [c for c in wanted if c not in here]:
        raise DataError(
            f"{path}: no channel {' '.join(lost[:8])}; there are {' '.join(list(here)[:40])}"
        )
    return np.array([here[c] for c in wanted], dtype=np.int64)


def stored_samples(
    group: h5py.Group, info: RecordInfo, at: Int, samples: slice
) -> TimeHistory:
    """These rows (c,) and samples, SI; float32 where they are stored so."""
    data = group["data"]
    order = np.unique(at)
    raw = data[:, samples] if order.size == data.shape[0] else data[order, samples]
    if not np.array_equal(order, at):
        raw = raw[np.searchsorted(order, at)]
    rows = [info.channels[i] for i in at]
    scale = float(data.attrs.get("scale", 1.0)) * np.array([c.to_si for c in rows])
    single = raw.dtype.itemsize <= 4 and raw.dtype.kind == "f"
    values = raw.astype(np.float32 if single else np.float64, copy=False)
    values *= scale[:, None].astype(values.dtype)
    return TimeHistory(values, info.rate, tuple(c.channel() for c in rows), info.source)


_RATE_NAMES = (  # in letters and digits
    "rate",
    "fs",
    "samplingrate",
    "samplerate",
    "fsamp",
    "fsample",
    "sr",
    "samplefrequency",
    "samplingfrequency",
    "samplefreq",
    "samplingfreq",
)
_STEP_NAMES = (
    "dt",
    "increment",
    "samplinginterval",
    "sampleinterval",
    "deltat",
    "timestep",
    "ts",
)
TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
SAME_RATE = 1e-3  # relative, of a rate that is named and that of the times


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
        shape = len(self.data), int(self.rows[-1]) + 1
        data = np.full(shape, np.nan, dtype=np.result_type(self.data, np.float32))
        data[:, self.rows] = self.data
        return replace(self, data=data, rows=None)

    def check_whole(self, path: Path) -> None:
        """Refuse missing rows.

        Raises
        ------
        DataError
        """
        if self.rows is not None and self.rate is not None:
            raise DataError(f"{path}: {uneven(self.rows / self.rate)}")


def joined(pieces: Sequence[tuple[float, RawTable]]) -> RawTable | None:
    """One table of the acquisitions of a file, one after the other, each with its start, s; `rows`
    holds their places.

    None where there is one, or they are no parts of one record: of other channels or rates, at one
    time, or half of it between them.
    """
    if len(pieces) < 2:
        return None
    pieces = sorted(pieces, key=lambda x: x[0])
    start = np.array([start for start, _ in pieces])
    first = pieces[0][1]
    same = all(
        (t.names, t.units, t.rate, t.rows)
        == (first.names, first.units, first.rate, None)
        for _, t in pieces
    )
    if first.rate is None or not same or not np.isfinite(start).all():
        return None
    size = np.array([t.data.shape[1] for _, t in pieces])
    begin = np.round((start - start[0]) * first.rate).astype(np.int64)
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


def is_time(name: str) -> bool:
    """Whether a variable or channel of this name holds times: `t`, `Time [s]`,
    `Data1_time_AI_1`.
    """
    return (
        name.strip().lower() in TIME_NAMES
        or re.search(r"(^|_)time(_|$)", name.lower()) is not None
    )


def named_rate(values: Mapping[str, Any]) -> float | None:
    """The sampling rate (Hz) among named scalars: `fs`, `rate`, ... or a step of time such as
    `dt`.
    """
    named = {}
    for key, value in values.items():
        if _is_real(value) and np.size(value) == 1:
            plain = re.sub("[^a-z0-9]", "", key.lower()).removesuffix("hz")
            named[plain] = float(np.ravel(value)[0])
    for name in _RATE_NAMES:
        if name in named:
            return named[name]
    step = next((named[name] for name in _STEP_NAMES if name in named), None)
    return 1 / step if step else step


def _is_real(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "fiu"


def without_time(table: RawTable, path: Path) -> RawTable:
    """A table without names whose first row is a time (it rises in equal steps): the rate in its
    place.
    """
    if table.data.shape[0] < 2:
        return table
    rate, rows = even_grid(in_seconds(table.data[0]), False, path)
    # 1 Hz: the column may as well number the samples
    if rate is None or rate <= 1 or table.data.shape[1] < 10:
        return table
    rest = replace(numbered(table.data[1:], rate), rows=rows)
    if table.rate is not None and abs(table.rate / rate - 1) > SAME_RATE:
        raise DataError(
            f"{path}: a rate of {table.rate:g} Hz is named, but the first column, a time, says "
            f"{rate:g} Hz"
        )
    return rest


def time_grid(
    values: Mapping[str, Any], samples: int, path: Path, stated: float | None = None
) -> tuple[float | None, Int | None]:
    """`even_grid` of a vector of so many times among named arrays (`t`, `time`); None, None if
    there is none.

    A `stated` rate stands; of times in other units, or uneven ones, nothing is
    asked then.
    """
    times = [
        np.ravel(v)
        for k, v in values.items()
        if is_time(k) and _is_real(v) and np.size(v) == samples
    ]
    if not times:
        return stated, None
    rate, rows = even_grid(
        in_seconds(times[0].astype(np.float64)), stated is None, path
    )
    if stated is None:
        return rate, rows
    return stated, rows if rate is not None and abs(
        rate / stated - 1
    ) < SAME_RATE else None
