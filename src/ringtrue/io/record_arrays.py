"""Records as arrays: .npy, HDF5 files of others, MATLAB (v4 to v7.3) and WAVE."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import sparse

from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.foreign.door import PACKED, read_apart
from ringtrue.io.foreign.parsers import is_hdf5, open_hdf5, read_wave
from ringtrue.io.foreign.parsers import read_npy as read_array
from ringtrue.io.record_table import (
    SAME_RATE,
    RawTable,
    columns_first,
    is_time,
    named_rate,
    numbered,
    time_grid,
    without_time,
)
from ringtrue.io.times import LONG, known

_CHECKED = 1 << 26  # bytes up to which a size is believed


def read_npy(path: Path) -> RawTable:
    """A NumPy array (sample, channel), or (sample,); more channels than samples are taken for
    (channel, sample).
    """
    a = read_array(path)
    if a.ndim not in (1, 2) or a.dtype.kind not in "fiu":
        raise DataError(
            f"{path}: array {a.shape} {a.dtype}; it must be (sample, channel) and real"
        )
    a = a.T if a.ndim == 2 and a.shape[1] > a.shape[0] > 0 else a
    data = np.array(
        np.atleast_2d(a.T),
        dtype=a.dtype if a.dtype.kind == "f" else np.float64,
        order="C",
    )
    return without_time(numbered(data, None), path)


def read_h5_table(file: h5py.File, path: Path, group: str = "") -> RawTable:
    """The 2-D data set of samples of an HDF5 file of others, or all vectors of one length if there
    is none.

    With `group`, the path of a group or of a data set, what stands there alone.

    Raises
    ------
    DataError
        If there is none, there are several long ones, or it announces far more than the file holds.
    """
    part = file.get(group.strip("/")) if group else file
    if part is None:
        named: list[str] = []
        file.visit(named.append)
        raise DataError(f"{path}: no group {group!r}{did_you_mean(group, named)}")
    if isinstance(part, h5py.Dataset):
        check_stored(part, path)
        rate = named_rate(_attributes(file, part.parent, part))
        return without_time(numbered(columns_first(part[()], path), rate), path)
    every: dict[str, h5py.Dataset] = {}
    part.visititems(
        lambda name, item: (
            every.update({name: item}) if isinstance(item, h5py.Dataset) else None
        )
    )
    tables = [d for d in every.values() if d.ndim == 2]
    scalars = {
        k.lower(): v[()] for k, v in every.items() if v.size == 1 and "/" not in k
    }
    if not tables:
        return _h5_vectors(part, every, scalars, path)
    long = [d for d in tables if d.dtype.kind in "fiu"]
    long = [d for d in long if max(d.shape) >= max(LONG, 4 * min(d.shape))]
    if len(long) > 1:
        shapes = "; ".join(f"{d.name.lstrip('/')} {d.shape}" for d in long[:8])
        raise DataError(
            f"{path}: several tables of samples ({shapes}): choose one with group (--group NAME)"
        )
    data = (long or tables)[0]
    check_stored(data, path)
    samples = max(data.shape)
    attributes = _attributes(file, part, data.parent, data)
    times = {
        k: v[()]
        for k, v in data.parent.items()
        if isinstance(v, h5py.Dataset)
        and v.name != data.name
        and v.size == samples
        and is_time(k)
    }
    rate, rows = time_grid(times, samples, path, named_rate({**scalars, **attributes}))
    return without_time(
        replace(numbered(columns_first(data[()], path), rate), rows=rows), path
    )


def _h5_vectors(
    group: h5py.Group,
    every: Mapping[str, h5py.Dataset],
    scalars: Mapping[str, Any],
    path: Path,
) -> RawTable:
    """The vectors of one length, a channel each."""
    one = {
        k: v
        for k, v in every.items()
        if v.ndim == 1 and v.dtype.kind in "fiu" and v.size > 1
    }
    for vector in one.values():
        check_stored(vector, path)
    samples = max((v.size for v in one.values()), default=0)
    one = {k: v for k, v in one.items() if v.size == samples}
    signals = {k: v for k, v in one.items() if not is_time(k.rpartition("/")[2])}
    if not signals:
        raise DataError(f"{path}: no 2-D data set in the file")
    attributes = [_attributes(v.parent, v) for v in one.values()]
    rates = [rate for each in attributes if (rate := named_rate(each))]
    if rates and max(rates) > (1 + SAME_RATE) * min(rates):
        raise DataError(
            f"{path}: {min(rates):g} to {max(rates):g} Hz: choose one of the groups (--group NAME)"
        )
    stated = dict(scalars) | _attributes(group)
    for each in attributes:
        stated |= each
    times = {k.rpartition("/")[2]: v[()] for k, v in one.items()}
    rate, rows = time_grid(times, samples, path, named_rate(stated))
    alone = len({v.parent.name for v in signals.values()}) == 1
    units = []
    for v in signals.values():
        attributes_of_v = _attributes(v)
        stored = attributes_of_v.get("unit", attributes_of_v.get("units", ""))
        text = np.ravel(stored)[0] if np.size(stored) == 1 else ""
        units.append(
            known(
                text.decode("utf-8", "replace")
                if isinstance(text, bytes)
                else str(text)
            )
        )
    return RawTable(
        data=np.stack([v[()].astype(np.float64) for v in signals.values()]),
        rate=rate,
        names=tuple(
            k.rpartition("/")[2] if alone else k.replace("/", ".") for k in signals
        ),
        units=tuple(units),
        quantities=("",) * len(signals),
        rows=rows,
    )


def _attributes(*objects: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Attributes by their names in lower case, the last counts."""
    return {k.lower(): v for o in objects for k, v in o.attrs.items()}


def h5_values(path: Path, value: Callable[[str, h5py.Dataset], Any]) -> dict[str, Any]:
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

    with open_hdf5(path) as file:
        file.visititems(keep)
    return found


def check_stored(data: h5py.Dataset, path: str | Path) -> None:
    """Refuse a data set that announces far more samples than the file stores: its chunks are
    missing or damaged.
    """
    size = int(data.size) * data.dtype.itemsize
    stored = data.id.get_storage_size()
    if size > _CHECKED and size > PACKED * stored:
        raise DataError(
            f"{path}: {data.name} announces {size} bytes, {stored} are stored: the file is cut "
            "or damaged"
        )


_PEEK = 1 << 16
_OBJECTS = np.dtype(object)
_NAMES = ("channels", "names", "labels", "channel_names", "ids", "name")
_UNITS = ("units", "unit")
# of one channel
_NAME = ("name", "signalname", "channelname")
_UNIT = ("unit", "unit_string", "label")


def read_mat(path: Path) -> RawTable:
    """The largest real 2-D variable of a MATLAB file, also within a structure, or all vectors if
    that is one.

    The rate comes from `fs`, `rate` or `dt`, a vector `t` or `time`, or a first column that rises
    in equal steps; names and units from cell arrays `channels` (or `names`, `labels`) and `units`
    of as many texts as there are channels.

    Raises
    ------
    DataError
        If the file is damaged or holds no such variable.
    """
    values = mat_values(path)
    every = {k: v for k, v in values.items() if isinstance(v, np.ndarray)}
    real = {k: v for k, v in every.items() if v.dtype.kind in "fiu"}
    arrays = {k: v for k, v in real.items() if v.ndim == 2}
    place = max(arrays, key=lambda k: arrays[k].size, default="")
    if not place or arrays[place].size < 2:
        raise DataError(
            f"{path}: no real 2-D variable; there are {', '.join(values) or 'none'}"
        )
    largest = arrays[place]
    short = {k.rpartition(".")[2]: v for k, v in values.items()}
    samples = max(largest.shape)
    rate, rows = time_grid(short, samples, path, named_rate(short))
    vectors = {
        k: v
        for k, v in real.items()
        if v.size == samples and not is_time(k.rpartition(".")[2])
    }
    if min(largest.shape) == 1 and len(vectors) > 1:
        table = numbered(
            np.stack([np.ravel(v).astype(np.float64) for v in vectors.values()]), rate
        )
        titles = tuple(_text_of_channel(values, k, _NAME) or k for k in vectors)
        if len(set(titles)) < len(titles):
            titles = tuple(vectors)
        units = tuple(_text_of_channel(values, k, _UNIT) for k in vectors)
        table = replace(table, rows=rows, names=titles, units=units)
    else:
        table = without_time(
            replace(numbered(columns_first(largest, path), rate), rows=rows), path
        )
        table = replace(
            table, units=(_text_of_channel(values, place, _UNIT),) * len(table.units)
        )
    count = table.data.shape[0]
    units = tuple(known(u) for u in texts(values, _UNITS, count) or table.units)
    return replace(
        table, names=texts(values, _NAMES, count) or table.names, units=units
    )


def mat_values(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB file, fields of structures as `name.field`.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    if is_hdf5(path):
        return _singly(h5_values(path, _value_73))
    found = read_apart("matlab", path, "MATLAB file")
    dense = {name: value for name, value in found.items() if not sparse.issparse(value)}
    return _singly(_flat(dense))


def _singly(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of an array of structures that holds numbers, each by itself: `ch_1.data`,
    `ch_2.data`.
    """
    split = {
        k.rpartition(".")[0]
        for k, v in values.items()
        if getattr(v, "dtype", None) == _OBJECTS
        and any(isinstance(x, np.ndarray) for x in v.flat)
    }
    out: dict[str, Any] = {}
    for key, value in values.items():
        stem, dot, field = key.rpartition(".")
        if dot and stem in split and getattr(value, "dtype", None) == _OBJECTS:
            each = {
                f"{stem}_{i}.{field}": x
                for i, x in enumerate(value.flat, 1)
                if x is not None
            }
            out |= _flat(each)
        else:
            out[key] = value
    return out


def _text_of_channel(
    values: Mapping[str, Any], key: str, names: tuple[str, ...]
) -> str:
    """The text of such a name in the structure of a channel, or in its header:
    `Channel_1_Data`, `_Header.Unit`.
    """
    stem = key.partition(".")[0] if "." in key else key.rpartition("_")[0]
    found = {
        v.strip()
        for k, v in values.items()
        if stem and isinstance(v, str) and k.rpartition(".")[2].lower() in names
        if k.startswith((f"{stem}.", f"{stem}_")) and "x_values" not in k
    }
    return found.pop() if len(found) == 1 else ""


def _value_73(name: str, item: h5py.Dataset) -> Any:
    """Numbers, a text or a cell array of texts of a MATLAB 7.3 file; None for all else."""
    if name.startswith("#"):
        return None
    if item.dtype.kind in "fiu":
        if item.attrs.get("MATLAB_class") == b"char" and item.size < _PEEK:
            return "".join(map(chr, np.ravel(item[()]).tolist()))
        return item[()]
    if item.dtype.names == ("real", "imag"):
        return (item["real"] + 1j * item["imag"]).T  # MATLAB's order of axes
    # a cell array, or a field of an array of structures
    if h5py.check_ref_dtype(item.dtype) and item.size < _PEEK:
        cells = [item.file[r] for r in np.ravel(item[()])]
        out = np.empty(len(cells), dtype=object)
        out[:] = [
            _value_73("", c)
            if isinstance(c, h5py.Dataset) and c.dtype.kind in "fiu"
            else None
            for c in cells
        ]
        return out if any(x is not None for x in out) else None
    return None


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Fields of structures as `name.field`."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= (
            _flat(value, f"{prefix}{key}.")
            if isinstance(value, dict)
            else {prefix + key: value}
        )
    return out


def texts(
    values: Mapping[str, Any], names: tuple[str, ...], count: int
) -> tuple[str, ...] | None:
    """A cell array or char matrix of `count` texts under one of the names, given in small
    letters.
    """
    for key, value in values.items():
        name = key.rpartition(".")[2].lower()
        if name in names and isinstance(value, np.ndarray) and value.size == count:
            texts = tuple(
                v.strip() if isinstance(v, str) else "" for v in value.ravel().tolist()
            )
            if name in _UNITS or (all(texts) and len(set(texts)) == count):
                return texts
    return None


def read_wav(path: Path) -> RawTable:
    """The samples of a WAVE file, (channel, sample).

    Raises
    ------
    DataError
        If it is no WAVE file, compressed or damaged.
    """
    rate, samples = read_wave(path)
    if samples.dtype.kind == "f":
        values = samples.astype(samples.dtype.newbyteorder("="), copy=False)
    elif samples.dtype.kind == "u":  # 8 bits: 128 is zero
        values = (samples.astype(np.float64) - 128) / 128
    else:
        values = samples / 2.0 ** (8 * samples.dtype.itemsize - 1)
    return numbered(np.ascontiguousarray(values.T), rate)
