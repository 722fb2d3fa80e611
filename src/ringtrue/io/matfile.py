"""Tables of samples in MATLAB files, v4 to v7.3."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import sparse
from scipy.io import savemat

from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.foreign.hdf5 import is_hdf5
from ringtrue.io.foreign.process import read_apart
from ringtrue.io.plain import (
    RawTable,
    columns_first,
    h5_values,
    is_time,
    named_rate,
    numbered,
    time_grid,
    without_time,
)
from ringtrue.io.si import known

_PEEK = 1 << 16
_NAMES = ("channels", "names", "labels", "channel_names", "ids", "name")
_UNITS = ("units", "unit")
_NAME, _UNIT = (
    ("name", "signalname", "channelname"),
    ("unit", "unit_string", "label"),
)  # of one channel


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
    arrays = [
        v
        for v in values.values()
        if isinstance(v, np.ndarray) and v.ndim == 2 and v.dtype.kind in "fiu"
    ]
    if not arrays or max(a.size for a in arrays) < 2:
        raise DataError(f"{path}: no real 2-D variable; there are {', '.join(values) or 'none'}")
    short = {k.rpartition(".")[2]: v for k, v in values.items()}
    largest = max(arrays, key=lambda a: a.size)
    place = next(k for k, v in values.items() if v is largest)
    samples = max(largest.shape)
    rate, rows = time_grid(short, samples, path, named_rate(short))
    if min(largest.shape) == 1 and len(vectors := _vectors(values, samples)) > 1:
        table = numbered(np.stack([np.ravel(v).astype(np.float64) for v in vectors.values()]), rate)
        table = replace(table, rows=rows)
        told = tuple(_beside(values, k, _NAME) or k for k in vectors)
        table = replace(table, names=told if len(set(told)) == len(told) else tuple(vectors))
        table = replace(table, units=tuple(_beside(values, k, _UNIT) for k in vectors))
    else:
        table = without_time(replace(numbered(columns_first(largest, path), rate), rows=rows), path)
        table = replace(table, units=(_beside(values, place, _UNIT),) * len(table.units))
    names = texts(values, _NAMES, table.data.shape[0]) or table.names
    units = tuple(known(u) for u in texts(values, _UNITS, table.data.shape[0]) or table.units)
    return replace(table, names=names, units=units)


def mat_values(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB file, fields of structures as `name.field`.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return _singly(
        h5_values(path, _value_73, "MATLAB 7.3") if is_hdf5(path) else _flat(_read_5(path))
    )


def _singly(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of an array of structures that holds numbers, each by itself: `ch_1.data`,
    `ch_2.data`.
    """
    many = {k: v for k, v in values.items() if isinstance(v, np.ndarray) and v.dtype == object}
    split = {
        k.rpartition(".")[0]
        for k, v in many.items()
        if any(isinstance(x, np.ndarray) for x in v.flat)
    }
    out: dict[str, Any] = {}
    for key, value in values.items():
        stem, dot, field = key.rpartition(".")
        if key not in many or not dot or stem not in split:
            out[key] = value
            continue
        each = {f"{stem}_{i + 1}.{field}": x for i, x in enumerate(value.flat) if x is not None}
        out |= _flat(each)
    return out


def _vectors(values: Mapping[str, Any], samples: int) -> dict[str, Any]:
    """Variables that hold a channel each: vectors of so many samples, times left out."""
    found = {
        k: v
        for k, v in values.items()
        if getattr(v, "size", 0) == samples and v.dtype.kind in "fiu"
    }
    return {k: v for k, v in found.items() if not is_time(k.rpartition(".")[2])}


def _beside(values: Mapping[str, Any], key: str, names: tuple[str, ...]) -> str:
    """The text of such a name in the structure of a channel, or in that beside it:
    `Channel_1_Data`, `_Header.Unit`.
    """
    stem = key.partition(".")[0] if "." in key else key.rpartition("_")[0]
    found = [
        v.strip()
        for k, v in values.items()
        if stem
        and isinstance(v, str)
        and re.match(rf"{re.escape(stem)}[._]", k)
        and "x_values" not in k
        if k.rpartition(".")[2].lower() in names
    ]
    return found[0] if len(set(found)) == 1 else ""


def _value_73(name: str, item: h5py.Dataset) -> Any:
    """Numbers, a text or a cell array of texts of a MATLAB 7.3 file; None for all else."""
    if name.startswith("#"):
        return None
    if item.dtype.kind in "fiu":
        return (
            _text_73(item)
            if item.attrs.get("MATLAB_class") == b"char" and item.size < _PEEK
            else item[()]
        )
    if item.dtype.names == ("real", "imag"):
        return (item["real"] + 1j * item["imag"]).T  # MATLAB's order of axes
    if (
        h5py.check_ref_dtype(item.dtype) and item.size < _PEEK
    ):  # a cell array, or a field of an array of structures
        cells = [item.file[r] for r in np.ravel(item[()])]
        out = np.empty(len(cells), dtype=object)
        out[:] = [
            _value_73("", c) if isinstance(c, h5py.Dataset) and c.dtype.kind in "fiu" else None
            for c in cells
        ]
        return out if any(x is not None for x in out) else None
    return None


def _text_73(item: h5py.Dataset) -> str:
    return "".join(map(chr, np.ravel(item[()]).tolist()))


def _read_5(path: Path) -> dict[str, Any]:
    """Variables of levels 4 and 5; sparse matrices are no samples."""
    found = read_apart("matlab", path, "MATLAB file")
    return {name: value for name, value in found.items() if not sparse.issparse(value)}


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Fields of structures as `name.field`."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def texts(values: Mapping[str, Any], names: tuple[str, ...], count: int) -> tuple[str, ...] | None:
    """A cell array or char matrix of `count` texts under one of the names, given in small
    letters.
    """
    for key, value in values.items():
        if (
            key.rpartition(".")[2].lower() in names
            and isinstance(value, np.ndarray)
            and value.size == count
        ):
            texts = [v if isinstance(v, str) else "" for v in value.ravel().tolist()]
            if (all(texts) and len(set(texts)) == count) or key.rpartition(".")[
                2
            ].lower() in _UNITS:
                return tuple(t.strip() for t in texts)
    return None


def write_mat(path: str | Path, history: TimeHistory) -> None:
    """Write a record as MATLAB v5: `data` (sample, channel), `fs`, cell arrays `channels` and
    `units`, `source`.

    Raises
    ------
    DataError
        If the record is longer than the format allows (2 GB).
    """
    if history.data.nbytes >= 2**31:
        raise DataError(
            f"{path}: {history.data.nbytes / 2**30:.3g} GB; MATLAB v5 holds 2 GB: write .h5"
        )
    content = {
        "data": np.asarray(history.data).T,
        "fs": history.rate,
        "channels": np.array([c.id for c in history.channels], dtype=object),
        "units": np.array([c.unit for c in history.channels], dtype=object),
        "source": history.source,
    }
    with atomic_write(path) as part:
        savemat(str(part), content, appendmat=False)
