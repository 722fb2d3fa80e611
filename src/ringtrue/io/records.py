"""Time records: ringtrue's own HDF5 layout (docs/formats.md) and the dispatch to the other formats."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.signals import Channel, Quantity, TimeHistory
from ringtrue.errors import DataError, InputError, did_you_mean
from ringtrue.io.atomic import atomic_write
from ringtrue.io.files import existing
from ringtrue.io.lvm import read_lvm
from ringtrue.io.matfile import read_mat, write_mat
from ringtrue.io.plain import RawTable, check_stored, read_csv, read_h5_table, read_npy, write_csv
from ringtrue.io.si import to_si
from ringtrue.io.tdms import read_tdms
from ringtrue.io.uff.functions import read_time, write_time
from ringtrue.io.wav import read_wav

FORMAT = "ringtrue-record"
_READERS = {
    ".npy": read_npy,
    ".csv": read_csv,
    ".txt": read_csv,
    ".lvm": read_lvm,
    ".mat": read_mat,
    ".tdms": read_tdms,
    ".wav": read_wav,
}
_HDF5 = (".h5", ".hdf5")
_SLOWEST, _FASTEST = 1e-5, 1e9  # Hz: a sample a day, and what no recorder of vibration reaches
_UFF = (".uff", ".unv", ".58")
_WRITERS = {".csv": write_csv, ".mat": write_mat, ".uff": write_time, ".unv": write_time}
_DAMAGED = (
    OSError,
    RuntimeError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    MemoryError,
    OverflowError,
)  # what h5py raises on damage


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
            raise DataError(f"channel {self.id}: sensitivity {self.sensitivity} V/unit must be finite and not 0")
        if not self.range > 0:
            raise DataError(f"channel {self.id}: range {self.range} V must be positive")
        to_si(self.unit, self.quantity)

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


_TABLE = {
    "id": str,
    "point": np.int64,
    "quantity": str,
    "unit": str,
    "sensitivity": np.float64,
    "range": np.float64,
    "sensor": str,
    "calibration": str,
}


def write_record(
    path: str | Path,
    volts: Any_ | Iterable[Any_],
    rate: float,
    channels: Sequence[RecordChannel],
    *,
    source: str = "",
    extra: Mapping[str, Any_] | None = None,
) -> None:
    """Write a record in ringtrue's HDF5 layout.

    Parameters
    ----------
    path : path
    volts : (channel, sample) float, V; or an iterable of such blocks, written one after the other
    rate : float, Hz
    channels : sequence of RecordChannel
    source : str
    extra : mapping of str to array, optional
        Further data sets, kept beside the samples under `extra/`.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: rate {rate} Hz must be positive")
    n = len(channels)
    blocks = [np.asarray(volts)] if isinstance(volts, np.ndarray) else volts
    with atomic_write(path) as part, h5py.File(part, "w") as file:
        group = file.create_group("record")
        group.attrs.update({"format": FORMAT, "version": 1, "rate": float(rate), "source": source})
        data = group.create_dataset("data", (n, 0), np.float32, maxshape=(n, None), chunks=(1, 1 << 16))
        data.attrs["unit"] = "V"
        for block in blocks:
            if block.ndim != 2 or block.shape[0] != n:
                raise DataError(f"{path}: block {block.shape} must be (channel, sample) with {n} channels")
            at = data.shape[1]
            data.resize(at + block.shape[1], axis=1)
            data[:, at:] = block
        for name, kind in _TABLE.items():
            _put_column(group, name, [getattr(c, name) for c in channels], kind)
        for name, array in (extra or {}).items():
            group.create_dataset(f"extra/{name}", data=array)


def _put_column(group: h5py.Group, name: str, values: Sequence[object], kind: type) -> None:
    dtype = h5py.string_dtype() if kind is str else kind
    group.create_dataset(f"channels/{name}", data=np.array(values, dtype=object if kind is str else kind), dtype=dtype)


def write_history(path: str | Path, history: TimeHistory) -> None:
    """Write a record in SI, by its ending: `.h5` (ringtrue's layout, float32), `.csv`, `.mat` (v5), `.uff` (58b).

    Raises
    ------
    DataError
        If the ending is another one.
    """
    ext = Path(path).suffix.lower()
    if ext in _HDF5:
        rows = [RecordChannel(c.id, 0, c.quantity, c.unit, sensor=c.sensor) for c in history.channels]
        size = max(1, (1 << 24) // len(rows))
        blocks = (history.data[:, a : a + size] for a in range(0, history.data.shape[1], size))
        write_record(path, blocks, history.rate, rows, source=history.source)
    elif ext in _WRITERS:
        _WRITERS[ext](path, history)
    else:
        raise DataError(f"{path}: format {ext!r}{did_you_mean(ext, [*_HDF5, *_WRITERS])}")


def record_info(path: str | Path) -> RecordInfo:
    """Channel table, rate and length of a record in ringtrue's layout; no samples are read.

    Raises
    ------
    DataError
        If the file has another layout, or its table or rate is wrong.
    """
    with _open(path) as file, _intact(path):
        return _info(_record_group(file, path), path)


def read_record(
    path: str | Path,
    rate: float | None = None,
    *,
    channels: Sequence[str] | None = None,
    start: int = 0,
    stop: int | None = None,
    check: bool = True,
) -> TimeHistory:
    """Read a time record, SI.

    Parameters
    ----------
    path : path
        `.h5` in ringtrue's layout or with a 2-D data set; `.npy` (sample, channel); `.csv`; `.lvm`; `.mat`; `.uff`;
        `.tdms`; `.wav`.
    rate : float, Hz, optional
        Needed where the file has none; where it has one, the two must agree.
    channels : sequence of str, optional
        The channels to keep, in this order; by default all.
    start, stop : int
        Samples to keep.
    check : bool
        Refuse channels that are constant or not finite; without it they stay, for `signal.faults` to tell.

    Raises
    ------
    DataError
        If the file is empty, a channel has NaN or is constant, or the rate is missing or odd.
    """
    path = existing(path)
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: rate {rate} Hz must be positive")
    history = _read(path, rate, channels, start, stop)
    if not _SLOWEST <= history.rate <= _FASTEST:
        raise DataError(f"{path}: rate {history.rate:g} Hz cannot be right; allowed are {_SLOWEST:g} to {_FASTEST:g}")
    _check_samples(history, path, check)
    return history


def record_blocks(
    path: str | Path, samples: int, *, channels: Sequence[str] | None = None, overlap: int = 0
) -> Iterator[TimeHistory]:
    """The record in ringtrue's layout, block by block, SI; the file may be larger than the memory.

    Parameters
    ----------
    path : path
    samples : int
        Samples of a block; the last one may be shorter.
    channels : sequence of str, optional
        The channels to keep, in this order; by default all.
    overlap : int
        Samples that a block shares with the one before.

    Raises
    ------
    DataError
        If the layout is another one, a channel is not there, or `samples` does not exceed `overlap` >= 0.
    """
    if not samples > overlap >= 0:
        raise DataError(f"{path}: blocks of {samples} samples must be longer than their overlap {overlap} >= 0")
    with _open(path) as file:
        with _intact(path):
            group = _record_group(file, path)
            info = _info(group, path)
            at = _positions(info, channels, path)
        for start in range(0, max(info.samples - overlap, 1), samples - overlap):
            yield _slice(group, info, at, slice(start, start + samples))


def _read(path: Path, rate: float | None, channels: Sequence[str] | None, start: int, stop: int | None) -> TimeHistory:
    ext = path.suffix.lower()
    if ext in _HDF5:
        with _open(path) as file, _intact(path):
            if (group := _find_record(file)) is not None:
                return _read_own(group, path, rate, channels, slice(start, stop))
            table = read_h5_table(file, path)
    elif ext in _UFF:
        table = read_time(path)
    elif ext in _READERS:
        table = _READERS[ext](path)
    else:
        raise DataError(f"{path}: format {ext!r}{did_you_mean(ext, [*_HDF5, *_UFF, *_READERS])}")
    history = _from_table(table, path, rate)
    history = history if channels is None else history.pick(channels)
    return replace(history, data=history.data[:, start:stop])


def _open(path: str | Path) -> h5py.File:
    try:
        return h5py.File(path, "r")
    except OSError as exc:
        raise DataError(f"{path}: not a readable HDF5 file ({exc})") from exc


@contextmanager
def _intact(path: str | Path) -> Iterator[None]:
    try:
        yield
    except InputError:
        raise
    except _DAMAGED as exc:
        raise DataError(f"{path}: damaged ({type(exc).__name__}: {exc})") from exc


def _find_record(file: h5py.File) -> h5py.Group | None:
    for group in (file.get("record"), file):
        data = group.get("data") if isinstance(group, h5py.Group) else None
        if isinstance(data, h5py.Dataset) and ("channels" in group or "id" in data.attrs):
            return group
    return None


def _record_group(file: h5py.File, path: str | Path) -> h5py.Group:
    group = _find_record(file)
    if group is None:
        raise DataError(f"{path}: no record in ringtrue's layout (a data set `data` with a table `channels`)")
    return group


def _column(group: h5py.Group, name: str, kind: type, n: int, path: str | Path) -> list[object] | None:
    table = group.get("channels")
    raw = table[name] if isinstance(table, h5py.Group) and name in table else group["data"].attrs.get(name)
    if raw is None:
        return None
    values = np.atleast_1d(raw[()] if isinstance(raw, h5py.Dataset) else raw)
    if values.shape != (n,):
        raise DataError(f"{path}: channel table {name} has {values.size} rows, the data {n} channels")
    if kind is str:
        return [v.decode() if isinstance(v, bytes) else str(v) for v in values.tolist()]
    try:
        return list(np.asarray(values, dtype=kind).tolist())
    except ValueError as exc:
        raise DataError(f"{path}: channel table {name} must hold numbers ({exc})") from exc


def _info(group: h5py.Group, path: str | Path) -> RecordInfo:
    shape = group["data"].shape
    if len(shape) != 2 or 0 in shape:
        raise DataError(f"{path}: data {shape} must be (channel, sample) and not empty")
    rate = group.attrs.get("rate", group["data"].attrs.get("rate"))
    if rate is None or not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: attribute rate is {rate}; it must be a positive number, Hz")
    columns = {k: _column(group, k, kind, shape[0], path) for k, kind in _TABLE.items()}
    if columns["id"] is None:
        raise DataError(f"{path}: the channel table lacks `id`")
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*_filled(columns, shape[0]), strict=True)]
    channels = tuple(RecordChannel(**{k: v for k, v in row.items() if v is not None}) for row in rows)
    if len({c.id for c in channels}) != len(channels):
        raise DataError(f"{path}: a channel id occurs twice")
    return RecordInfo(channels, float(rate), int(shape[1]), str(group.attrs.get("source", "") or path))


def _filled(columns: Mapping[str, list[object] | None], n: int) -> list[list[object] | list[None]]:
    return [[None] * n if c is None else c for c in columns.values()]


def _read_own(
    group: h5py.Group, path: Path, rate: float | None, channels: Sequence[str] | None, samples: slice
) -> TimeHistory:
    info = _info(group, path)
    _agree(rate, info.rate, path, "the file")
    check_stored(group["data"], path)
    return _slice(group, info, _positions(info, channels, path), samples)


def _positions(info: RecordInfo, channels: Sequence[str] | None, path: str | Path) -> Int:
    here = {c.id: i for i, c in enumerate(info.channels)}
    wanted = list(here) if channels is None else channels
    if lost := [c for c in wanted if c not in here]:
        raise DataError(f"{path}: no channel {' '.join(lost[:8])}; there are {' '.join(list(here)[:40])}")
    return np.array([here[c] for c in wanted], dtype=np.int64)


def _slice(group: h5py.Group, info: RecordInfo, at: Int, samples: slice) -> TimeHistory:
    data = group["data"]
    order = np.unique(at)
    raw = data[:, samples] if order.size == data.shape[0] else data[order, samples]
    raw = raw[np.searchsorted(order, at)] if not np.array_equal(order, at) else raw
    rows = [info.channels[i] for i in at]
    scale = float(data.attrs.get("scale", 1.0)) * np.array([c.to_si for c in rows])
    values = raw.astype(np.float32 if raw.dtype.itemsize <= 4 and raw.dtype.kind == "f" else np.float64, copy=False)
    values *= scale[:, None].astype(values.dtype)
    return TimeHistory(values, info.rate, tuple(c.channel() for c in rows), info.source)


def _agree(asked: float | None, found: float, path: Path, where: str) -> None:
    if asked is not None and abs(asked / found - 1) > 1e-3:
        raise DataError(f"{path}: rate {asked:g} Hz was given, but {where} says {found:g} Hz")


def _from_table(table: RawTable, path: Path, rate: float | None) -> TimeHistory:
    if table.data.size == 0:
        raise DataError(f"{path}: empty, there are no samples")
    if table.rate is None and rate is None:
        raise DataError(f"{path}: the file has no sampling rate; give rate=, Hz")
    if table.rate is not None:
        if not (np.isfinite(table.rate) and table.rate > 0):
            raise DataError(f"{path}: rate {table.rate} Hz must be positive")
        _agree(rate, table.rate, path, "its time column or header")
    if twice := sorted({n for n in table.names if table.names.count(n) > 1}):
        raise DataError(f"{path}: channel {' '.join(twice[:8])} occurs twice")
    rows = [to_si(u if u else "", q) for u, q in zip(table.units, table.quantities, strict=True)]
    channels = tuple(Channel(name, quantity, unit) for name, (quantity, _, unit) in zip(table.names, rows, strict=True))
    factor: Float = np.array([f for _, f, _ in rows])
    data = table.data if (factor == 1).all() else table.data * factor[:, None]
    return TimeHistory(data, float(table.rate or rate or 0.0), channels, str(path))


def _check_samples(history: TimeHistory, path: Path, check: bool) -> None:
    if history.data.shape[1] < 2:
        raise DataError(f"{path}: {history.data.shape[1]} samples; a record needs at least 2")
    if not check:
        return
    low, high = history.data.min(axis=1), history.data.max(axis=1)
    bad = ~(np.isfinite(low) & np.isfinite(high))
    if bad.any():
        names = [c.id for c, b in zip(history.channels, bad, strict=True) if b]
        raise DataError(f"{path}: NaN or infinite samples in {' '.join(names[:8])}; leave these channels out")
    if (low == high).any():
        names = [c.id for c, b in zip(history.channels, low == high, strict=True) if b]
        raise DataError(f"{path}: channel {' '.join(names[:8])} is constant: a dead sensor; leave it out")
