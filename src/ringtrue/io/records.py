"""Time records of any format that is read or written; ringtrue's own layout block by block too
(docs/formats.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.files import atomic_write, existing, refuse_twice
from ringtrue.io.foreign.parsers import open_hdf5
from ringtrue.io.frfs import holds_frfs
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.io.record_arrays import (
    check_stored,
    read_h5_table,
    read_mat,
    read_npy,
    read_wav,
)
from ringtrue.io.record_table import (
    FORMAT,
    TABLE,
    RawTable,
    RecordChannel,
    RecordInfo,
    channel_positions,
    find_record,
    joined,
    record_group,
    stored_info,
    stored_samples,
)
from ringtrue.io.record_texts import (
    read_csv,
    read_lvm,
    read_lvm_pieces,
    read_lvm_segments,
    read_tdms,
    read_tdms_pieces,
    read_tdms_runs,
)
from ringtrue.io.times import to_si
from ringtrue.io.uff.functions import read_time, read_time_runs

_READERS = {
    Format.NPY: read_npy,
    Format.TEXT: read_csv,
    Format.LVM: read_lvm,
    Format.MATLAB: read_mat,
    Format.WAVE: read_wav,
    Format.UFF: read_time,
}
_GROUPED = (Format.HDF5, Format.TDMS)
# Hz: a sample a day, and what no recorder of vibration reaches
_SLOWEST = 1e-5
_FASTEST = 1e9
_LARGEST = 1e70  # fourth powers stay finite
# universal files say what they hold where they are read
_MAY_HOLD_FRFS = (Format.TEXT, Format.LVM, Format.MATLAB, Format.HDF5)


def write_record(
    path: str | Path,
    volts: Any_ | Iterable[Any_],
    rate: float,
    channels: Sequence[RecordChannel],
    *,
    source: str = "",
) -> None:
    """Write a record in ringtrue's HDF5 layout.

    Parameters
    ----------
    path : path
    volts : (channel, sample) float, V; or an iterable of such blocks, written one after the other
    rate : float, Hz
    channels : sequence of RecordChannel
    source : str
    """
    if not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: rate {rate} Hz must be positive")
    n = len(channels)
    blocks = [np.asarray(volts)] if isinstance(volts, np.ndarray) else volts
    with atomic_write(path) as part, h5py.File(part, "w") as file:
        group = file.create_group("record")
        group.attrs.update(
            {"format": FORMAT, "version": 1, "rate": float(rate), "source": source}
        )
        data = group.create_dataset(
            "data", (n, 0), np.float32, maxshape=(n, None), chunks=(1, 1 << 16)
        )
        data.attrs["unit"] = "V"
        for block in blocks:
            if block.ndim != 2 or block.shape[0] != n:
                raise DataError(
                    f"{path}: block {block.shape} must be (channel, sample) with {n} channels"
                )
            at = data.shape[1]
            data.resize(at + block.shape[1], axis=1)
            data[:, at:] = block
        for name, kind in TABLE.items():
            dtype = h5py.string_dtype() if kind is str else kind
            values = [getattr(c, name) for c in channels]
            group.create_dataset(f"channels/{name}", data=values, dtype=dtype)


def record_info(path: str | Path) -> RecordInfo:
    """Channel table, rate and length of a record in ringtrue's layout; no samples are read.

    Raises
    ------
    DataError
        If the file has another layout, or its table or rate is wrong.
    """
    with open_hdf5(path) as file:
        return stored_info(record_group(file, path), path)


def read_record(
    path: str | Path,
    rate: float | None = None,
    *,
    channels: Sequence[str] | None = None,
    start: int = 0,
    stop: int | None = None,
    check: bool = True,
    group: str = "",
    gaps: bool = False,
) -> TimeHistory:
    """Read a time record, SI.

    Parameters
    ----------
    path : path
        By its content: HDF5 in ringtrue's layout or with a 2-D data set; NumPy (sample, channel);
        delimited or LabVIEW text; MATLAB; universal file; TDMS; WAVE.
    rate : float, Hz, optional
        Needed where the file has none; where it has one, the two must agree.
    channels : sequence of str, optional
        The channels to keep, in this order; by default all.
    start, stop : int
        Samples to keep.
    check : bool
        Refuse channels that are constant or not finite; without it they stay, for
        `signal.channel_checks`
        to tell.
    group : str
        The group of a `.tdms`, or the group or data set of an HDF5 file of others, that is meant
        where there are several of unlike rates.
    gaps : bool
        Let samples be missing, as an ambient test may: rows that the times show to be missing
        become NaN, and these and others stay. Acquisitions one after the other, segments of a
        `.lvm` or groups of a `.tdms` with the same channels, are one record by their starts.

    Raises
    ------
    DataError
        If the file is empty, a channel has NaN or is constant, rows are missing, or the rate is
        missing or odd.
    """
    path = existing(path)
    _check_rate_given(path, rate)
    history = _read(path, rate, channels, slice(start, stop), group, gaps)
    refuse_bad_samples(history, path, check, gaps)
    return history


def read_runs(
    path: str | Path, rate: float | None = None, *, group: str = ""
) -> tuple[TimeHistory, ...]:
    """The acquisitions of one file, each a record: triggered blows that were stored one after the
    other.

    Functions of a universal file that recur, segments of a `.lvm`, groups of a `.tdms` with the
    same channels; any other file is one record. Channels that are constant or not finite stay.

    Raises
    ------
    DataError
        As `read_record` does.
    """
    path = existing(path)
    reader = _RUNS.get(format_of(path))
    if reader is None or group:
        return (read_record(path, rate, check=False, group=group),)
    _check_rate_given(path, rate)
    found = tuple(_from_table(t, path, rate) for t in reader(path))
    for history in found:
        refuse_bad_samples(history, path, False)
    return found


def _lvm_runs(path: Path) -> tuple[RawTable, ...]:
    try:
        return (read_lvm(path),)
    except DataError:
        return tuple(t for _, t in read_lvm_segments(path))


_PIECES = {Format.LVM: read_lvm_pieces, Format.TDMS: read_tdms_pieces}
_RUNS = {Format.LVM: _lvm_runs, Format.TDMS: read_tdms_runs, Format.UFF: read_time_runs}


def _check_rate_given(path: Path, rate: float | None) -> None:
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise DataError(f"{path}: rate {rate} Hz must be positive")


def record_blocks(path: str | Path, samples: int) -> Iterator[TimeHistory]:
    """The record in ringtrue's layout, block by block, SI; the file may be larger than the memory.

    Parameters
    ----------
    path : path
    samples : int
        Samples of a block; the last one may be shorter.

    Raises
    ------
    DataError
        If the layout is another one.
    """
    if samples < 1:
        raise DataError(f"{path}: blocks of {samples} samples: 1 or more")
    with open_hdf5(path) as file:
        group = record_group(file, path)
        info = stored_info(group, path)
        at = channel_positions(info, None, path)
        for start in range(0, max(info.samples, 1), samples):
            yield stored_samples(group, info, at, slice(start, start + samples))


def record_parts(
    path: str | Path, channels: Sequence[str], spans: Iterable[tuple[int, int]]
) -> Iterator[TimeHistory]:
    """Parts of a record in ringtrue's layout, first sample and end each, SI; it is opened once.

    Raises
    ------
    DataError
        If the layout is another one, or there is no such channel.
    """
    with open_hdf5(path) as file:
        group = record_group(file, path)
        info = stored_info(group, path)
        at = channel_positions(info, channels, path)
        for start, stop in spans:
            yield stored_samples(group, info, at, slice(start, stop))


def _read(
    path: Path,
    rate: float | None,
    channels: Sequence[str] | None,
    samples: slice,
    group: str,
    gaps: bool,
) -> TimeHistory:
    kind = format_of(path)
    if group and kind not in _GROUPED:
        raise DataError(
            f"{path}: group {group!r}: only .tdms and HDF5 files have groups"
        )
    if kind is Format.HDF5:
        with open_hdf5(path) as file:
            own = find_record(file)
            if own is not None and not group:
                info = stored_info(own, path)
                _agree(rate, info.rate, path, "the file")
                check_stored(own["data"], path)
                at = channel_positions(info, channels, path)
                return stored_samples(own, info, at, samples)
    if kind in _MAY_HOLD_FRFS and not group and holds_frfs(path):
        raise DataError(
            f"{path}: holds FRFs, no time record; `ringtrue ema` takes FRFs"
        )
    table = None
    if gaps and not group and kind in _PIECES:
        table = joined(_PIECES[kind](path))
    if table is None:
        table = raw_record(path, group)
    history = _from_table(table.evened() if gaps else table, path, rate)
    history = history if channels is None else history.pick(channels)
    return replace(history, data=history.data[:, samples])


def raw_record(path: Path, group: str = "") -> RawTable:
    """The samples of a file of others, in its units and with its rate where it has one.

    Raises
    ------
    DataError
        If it holds no record, is empty or damaged.
    """
    kind = format_of(path)
    if kind is Format.HDF5:
        with open_hdf5(path) as file:
            return read_h5_table(file, path, group)
    if kind is Format.TDMS:
        return read_tdms(path, group)
    if kind in _READERS:
        return _READERS[kind](path)
    refuse_format(path, "record", [*_GROUPED, *_READERS])


def _agree(asked: float | None, found: float, path: Path, where: str) -> None:
    if asked is not None and abs(asked / found - 1) > 1e-3:
        raise DataError(
            f"{path}: rate {asked:g} Hz was given, but {where} says {found:g} Hz"
        )


def _from_table(table: RawTable, path: Path, rate: float | None) -> TimeHistory:
    if table.data.size == 0:
        raise DataError(f"{path}: empty, there are no samples")
    if table.rate is None and rate is None:
        raise DataError(
            f"{path}: the file has no sampling rate; give it in Hz: --rate, `rate_hz` of a log, "
            "rate="
        )
    if table.rate is not None:
        if not (np.isfinite(table.rate) and table.rate > 0):
            raise DataError(f"{path}: rate {table.rate} Hz must be positive")
        _agree(rate, table.rate, path, "its time column or header")
    table.check_whole(path)
    refuse_twice(table.names, "channel", path)
    rows = [
        to_si(u or "", q) for u, q in zip(table.units, table.quantities, strict=True)
    ]
    channels = tuple(
        Channel(n, row[0], row[2]) for n, row in zip(table.names, rows, strict=True)
    )
    factor: Float = np.array([f for _, f, _ in rows])
    with np.errstate(over="ignore"):  # what is infinite then is refused
        data = table.data if (factor == 1).all() else table.data * factor[:, None]
    return TimeHistory(data, float(table.rate or rate or 0.0), channels, str(path))


def refuse_bad_samples(
    history: TimeHistory, path: Path, check: bool = True, gaps: bool = False
) -> None:
    """Refuse an odd rate, a record of less than two samples and, if `check`, channels that are
    constant or not finite.

    With `gaps`, only those without a finite sample.

    Raises
    ------
    DataError
    """
    if not _SLOWEST <= history.rate <= _FASTEST:
        raise DataError(
            f"{path}: rate {history.rate:g} Hz cannot be right; allowed are {_SLOWEST:g} to "
            f"{_FASTEST:g}"
        )
    if history.data.shape[1] < 2:
        raise DataError(
            f"{path}: {history.data.shape[1]} samples; a record needs at least 2"
        )
    if not check:
        return
    data = history.data
    low, high = (x.astype(np.float64) for x in (data.min(axis=1), data.max(axis=1)))
    bad = ~(np.isfinite(low) & np.isfinite(high))
    size = np.where(bad, 0.0, np.maximum(-low, high))
    if size.max() > _LARGEST:
        i = int((size > _LARGEST).argmax())
        raise DataError(
            f"{path}: channel {history.channels[i].id} reaches {size[i]:.2g}: no unit makes that"
        )
    if gaps:
        for i in np.flatnonzero(bad).tolist():
            known = data[i, np.isfinite(data[i])]
            if known.size:
                bad[i] = False
                low[i] = known.min()
                high[i] = known.max()
    if bad.any():
        lost = (~np.isfinite(data)).sum(axis=1).tolist()
        counts = [
            f"{history.channels[i].id} ({lost[i]})" for i in np.flatnonzero(bad)[:8]
        ]
        raise DataError(
            f"{path}: NaN or infinite samples in {', '.join(counts)} of {data.shape[1]} samples "
            "each; leave these channels out, or fill single samples in the file by interpolation"
        )
    if (low == high).any():
        names = [c.id for c, b in zip(history.channels, low == high, strict=True) if b]
        raise DataError(
            f"{path}: channel {' '.join(names[:8])} is constant: a dead sensor; leave it out"
        )
