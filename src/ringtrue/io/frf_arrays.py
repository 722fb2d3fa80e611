"""FRFs as arrays beside a vector of frequencies, in MATLAB and HDF5 files of others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.motions import FRF_KIND, OF_KIND, Motion, channel
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.io.frf_lines import known_lines, say_accelerances
from ringtrue.io.matfile import mat_values, texts
from ringtrue.io.plain import check_stored, h5_values
from ringtrue.io.uff.functions import label

_HERTZ = (
    "f",
    "freq",
    "freqs",
    "frequency",
    "frequencies",
    "fvec",
    "f_hz",
    "freq_hz",
    "freq_vec",
    "freqvec",
    "hz",
    "fs_axis",
)
_RADIANS = ("omega", "omegas", "w_rad")
_OUTPUTS = ("outputs", "output", "responses", "response", "out", "out_dof", "outdof", "rsp")
_INPUTS = ("inputs", "input", "references", "reference", "refs", "in", "in_dof", "indof", "ref")
_CALLED: dict[str, Motion] = OF_KIND | {"compliance": "displacement", "inertance": "acceleration"}
_LEAST, _LONGEST = 8, 1 << 22  # lines
_DIRECTIONS = (0, 1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -6)  # of SDT's DOFs 1.01 .. 1.12


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    name: str
    data: Complex
    axis: int
    freqs: Float


def holds_frf_arrays(path: Path) -> bool:
    """Whether a MATLAB or HDF5 file has complex numbers over a vector of frequencies."""
    try:
        return _find(_values(path)) is not None
    except DataError:
        return False


def read_frf_arrays(path: Path) -> FrfSet:
    """The largest complex array with an axis as long as a vector `f`, `freq`, `frequency` (Hz) or
    `omega` (rad/s).

    Axes are (f, response, reference), (response, reference, f), (f, response) or (response, f);
    SDT's structure of `w` (Hz), `xf` and `dof` as well. Names come from cell arrays `outputs` and
    `inputs`; the kind from a text `kind` or the name of the array, else responses are
    accelerations. SI.

    Raises
    ------
    DataError
        If there is no such array, or it lacks a value.
    """
    values = _values(path)
    found = _find(values)
    if found is None:
        told = ", ".join(f"{k} {np.shape(v)}" for k, v in list(values.items())[:12])
        raise DataError(
            f"{path}: no complex array over a vector of frequencies f (Hz) or omega; there are "
            f"{told}"
        )
    h = np.moveaxis(found.data, found.axis, 0)
    h = h.reshape(h.shape[0], -1, 1) if h.ndim == 2 else h
    outputs, inputs = (
        _names(values, _OUTPUTS, h.shape[1], "out"),
        _names(values, _INPUTS, h.shape[2], "in"),
    )
    pairs = _sdt_pairs(values, h.shape[1]) if h.shape[2] == 1 else None
    if pairs is not None:
        outputs, inputs, h = _by_pairs(pairs, h[:, :, 0], path)
    text = " ".join(
        [
            found.name,
            *(str(v) for k, v in values.items() if _short(k) in ("kind", "type", "frf_type")),
        ]
    )
    called = [m for k, m in _CALLED.items() if k in text.lower()]
    if not called:
        say_accelerances(path)
    motion: Motion = called[0] if called else "acceleration"
    order = np.argsort(found.freqs, kind="stable")
    order = order[known_lines(h[order], found.freqs[order], outputs, inputs, path)]
    return FrfSet(
        np.ascontiguousarray(h[order], dtype=np.complex128),
        found.freqs[order],
        tuple(channel(n, motion) for n in outputs),
        tuple(channel(n, "force") for n in inputs),
        np.full((order.size, *h.shape[1:]), np.nan),
        np.full(len(inputs), np.nan),
        FRF_KIND[motion],
        source=str(path),
    )


def _values(path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".mat":
        return mat_values(path)

    def value(_: str, item: h5py.Dataset) -> Any:
        vector = item.dtype.kind in "fiu" and 0 < item.size == max(item.shape, default=0) < _LONGEST
        if item.dtype.kind != "c" and not vector:  # samples stay unread
            return None
        check_stored(item, path)
        return item[()]

    return h5_values(path, value)


def _short(name: str) -> str:
    return name.rpartition(".")[2].lower()


def _find(values: Mapping[str, Any]) -> _Found | None:
    arrays = {
        k: v for k, v in values.items() if getattr(v, "ndim", 0) in (2, 3) and v.dtype.kind == "c"
    }
    for name in sorted(arrays, key=lambda k: -arrays[k].size):
        for key, v in values.items():
            freqs = _frequencies(key, v, sdt=_short(name) == "xf")
            if freqs is not None and freqs.size in arrays[name].shape:
                return _Found(name, arrays[name], arrays[name].shape.index(freqs.size), freqs)
    return None


def _frequencies(name: str, value: Any, *, sdt: bool) -> Float | None:
    """Hz, of a vector that is named so and has no value twice."""
    short = _short(name)
    if short not in (*_HERTZ, *_RADIANS) and not (sdt and short == "w"):
        return None
    if (
        getattr(value, "dtype", np.dtype(object)).kind not in "fiu"
        or value.size < _LEAST
        or value.size != max(value.shape)
    ):
        return None
    f = np.ravel(value).astype(np.float64)
    if not np.isfinite(f).all() or np.unique(f).size != f.size or f.min() < 0:
        return None
    return f / (2 * np.pi) if short in _RADIANS else f


def _names(
    values: Mapping[str, Any], keys: tuple[str, ...], count: int, prefix: str
) -> Sequence[str]:
    return texts(values, keys, count) or [f"{prefix}{i + 1}" for i in range(count)]


def _sdt_pairs(values: Mapping[str, Any], count: int) -> list[tuple[str, str]] | None:
    """Response and reference of each column by SDT's `dof`, 12.03 for 12+Z."""
    table: Any_ = next(
        (v for k, v in values.items() if _short(k) == "dof" and np.shape(v)[:1] == (count,)),
        np.zeros(0),
    )
    if table.ndim != 2 or table.shape[1] < 2 or table.dtype.kind != "f":
        return None
    node = np.floor(table[:, :2] + 1e-6).astype(np.int64)
    code = np.rint(100 * (table[:, :2] - node)).astype(np.int64)
    if node.min() < 1 or code.min() < 0 or code.max() > 12:
        return None
    names = [
        [label(n, _DIRECTIONS[c]) for n, c in zip(*row, strict=True)]
        for row in zip(node.tolist(), code.tolist(), strict=True)
    ]
    return [(a, b) for a, b in names]


def _by_pairs(
    pairs: Sequence[tuple[str, str]], h: Complex, path: Path
) -> tuple[Sequence[str], Sequence[str], Complex]:
    outputs, inputs = (list(dict.fromkeys(p[k] for p in pairs)) for k in (0, 1))
    if len(set(pairs)) != len(pairs) or len(pairs) != len(outputs) * len(inputs):
        raise DataError(
            f"{path}: {len(set(pairs))} pairs of {len(outputs)} responses and {len(inputs)} "
            "references"
        )
    out = np.empty((h.shape[0], len(outputs), len(inputs)), dtype=np.complex128)
    out[:, [outputs.index(a) for a, _ in pairs], [inputs.index(b) for _, b in pairs]] = h
    return outputs, inputs, out
