"""ringtrue's own HDF5 layout of a record (docs/formats.md): the channel table, and reading what is
stored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.signals import Channel, Quantity, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.si import to_si

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
    def tells(self) -> bool:
        """Whether it says more than a name and a place."""
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
        if isinstance(data, h5py.Dataset) and ("channels" in group or "id" in data.attrs):
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


def _column(
    group: h5py.Group, name: str, kind: type, n: int, path: str | Path
) -> list[object] | None:
    table = group.get("channels")
    raw = (
        table[name]
        if isinstance(table, h5py.Group) and name in table
        else group["data"].attrs.get(name)
    )
    if raw is None:
        return None
    values = np.atleast_1d(raw[()] if isinstance(raw, h5py.Dataset) else raw)
    if values.shape != (n,):
        raise DataError(
            f"{path}: channel table {name} has {values.size} rows, the data {n} channels"
        )
    if kind is str:
        return [v.decode() if isinstance(v, bytes) else str(v) for v in values.tolist()]
    try:
        return list(np.asarray(values, dtype=kind).tolist())
    except ValueError as exc:
        raise DataError(f"{path}: channel table {name} must hold numbers ({exc})") from exc


def stored_info(group: h5py.Group, path: str | Path) -> RecordInfo:
    """Channel table, rate and length; `DataError` where one of them is wrong."""
    shape = group["data"].shape
    if len(shape) != 2 or 0 in shape:
        raise DataError(f"{path}: data {shape} must be (channel, sample) and not empty")
    rate = group.attrs.get("rate", group["data"].attrs.get("rate"))
    if rate is None or not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: attribute rate is {rate}; it must be a positive number, Hz")
    columns = {k: _column(group, k, kind, shape[0], path) for k, kind in TABLE.items()}
    if columns["id"] is None:
        raise DataError(f"{path}: the channel table lacks `id`")
    rows = [
        dict(zip(columns, row, strict=True))
        for row in zip(*_filled(columns, shape[0]), strict=True)
    ]
    channels = tuple(
        RecordChannel(**{k: v for k, v in row.items() if v is not None}) for row in rows
    )
    if len({c.id for c in channels}) != len(channels):
        raise DataError(f"{path}: a channel id occurs twice")
    return RecordInfo(
        channels, float(rate), int(shape[1]), str(group.attrs.get("source", "") or path)
    )


def _filled(columns: Mapping[str, list[object] | None], n: int) -> list[list[object] | list[None]]:
    return [[None] * n if c is None else c for c in columns.values()]


def channel_positions(info: RecordInfo, channels: Sequence[str] | None, path: str | Path) -> Int:
    """Rows of the channels by id, (c,) int64, in the order asked for; all by default."""
    here = {c.id: i for i, c in enumerate(info.channels)}
    wanted = list(here) if channels is None else channels
    if lost := [c for c in wanted if c not in here]:
        raise DataError(
            f"{path}: no channel {' '.join(lost[:8])}; there are {' '.join(list(here)[:40])}"
        )
    return np.array([here[c] for c in wanted], dtype=np.int64)


def stored_samples(group: h5py.Group, info: RecordInfo, at: Int, samples: slice) -> TimeHistory:
    """These rows (c,) and samples, SI; float32 where they are stored so."""
    data = group["data"]
    order = np.unique(at)
    raw = data[:, samples] if order.size == data.shape[0] else data[order, samples]
    raw = raw[np.searchsorted(order, at)] if not np.array_equal(order, at) else raw
    rows = [info.channels[i] for i in at]
    scale = float(data.attrs.get("scale", 1.0)) * np.array([c.to_si for c in rows])
    values = raw.astype(
        np.float32 if raw.dtype.itemsize <= 4 and raw.dtype.kind == "f" else np.float64, copy=False
    )
    values *= scale[:, None].astype(values.dtype)
    return TimeHistory(values, info.rate, tuple(c.channel() for c in rows), info.source)
