"""FRFs of any format."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.channels import OF_KIND, Motion
from ringtrue.core.signals import Channel, FrfKind, FrfSet
from ringtrue.errors import DataError, about, did_you_mean
from ringtrue.io import hdf5
from ringtrue.io.files import (
    atomic_write,
    existing,
    refuse_ending,
    refuse_large,
    refuse_twice,
)
from ringtrue.io.foreign.parsers import open_hdf5, read_npz
from ringtrue.io.frf_tables import (
    frf_set,
    is_frf_table,
    known_lines,
    read_frf_table,
    references,
    say_accelerances,
    write_frf_table,
)
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.io.record_arrays import check_stored, h5_values, mat_values, texts
from ringtrue.io.uff.function58 import FRF_TYPES, write_frf_sets
from ringtrue.io.uff.functions import frf_ends, read_frf_sets, read_functions

log = logging.getLogger(__name__)
GROUP = "frfs"
_ROUNDED = 1e-3  # that a coherence of three digits may be beyond 1
_UFF = (".uff", ".unv", ".58")
_HDF5 = (".h5", ".hdf5")
_READ = (
    Format.HDF5,
    Format.MATLAB,
    Format.NPZ,
    Format.UFF,
    Format.TEXT,
    Format.LVM,
)


def read_frfs(path: str | Path, leave_out: Sequence[str] = ()) -> FrfSet:
    """Read frequency response functions.

    Parameters
    ----------
    path : path
        By its content: HDF5 written by `write_frfs`; MATLAB and HDF5 of others
        (`read_frf_arrays`); an archive of NumPy with `freq (f,)` and `H1 (reference, response, f)`,
        optional `coherence` like H1, `outputs`, `inputs` (ids), `kind`; a universal file with data
        sets 58; text with columns of frequency, real and imaginary part or magnitude and phase
        (`read_frf_table`).
    leave_out : sequence of str
        Ids of responses and references that are not used, where the file has them; in a universal
        file they may be at fault.

    Raises
    ------
    DataError
        If the file has no FRFs, no references, repeated lines, or values that are not finite.
    """
    path = existing(path)
    held = format_of(path)
    if held is Format.MATLAB or (held is Format.HDF5 and not _own(path)):
        frfs = read_frf_arrays(path)
    elif held is Format.HDF5:
        with open_hdf5(path, "HDF5 file of FRFs") as file:
            frfs = hdf5.load(file.get(GROUP, file))
        if not isinstance(frfs, FrfSet):
            raise DataError(f"{path}: holds a {type(frfs).__name__}, not FRFs")
    elif held is Format.NPZ:
        frfs = _read_npz(path)
    elif held is Format.UFF:
        frfs = read_frf_sets(path, leave_out)
    elif held in (Format.TEXT, Format.LVM):
        frfs = read_frf_table(path)
    else:
        refuse_format(path, "FRFs", _READ)
    _check(frfs, path)
    frfs = _forward(frfs, path)
    there = {c.id for c in (*frfs.outputs, *frfs.inputs)} & set(leave_out)
    return frfs.without([c for c in leave_out if c in there]) if there else frfs


def frf_ids(path: str | Path) -> tuple[str, ...]:
    """Ids of all responses and references of a file of FRFs, of a universal file also of those at
    fault.
    """
    if format_of(path) is Format.UFF:
        return frf_ends(path)
    frfs = read_frfs(path)
    return tuple(dict.fromkeys(c.id for c in (*frfs.outputs, *frfs.inputs)))


def holds_frfs(path: str | Path) -> bool:
    """Whether a file holds FRFs; else it may be a time record.

    Raises
    ------
    DataError
        If there is no such file, or it is a damaged universal file.
    """
    path = existing(path)
    held = format_of(path)
    if held is Format.UFF:
        return any(f.kind in FRF_TYPES for f in read_functions(path))
    if held in (Format.TEXT, Format.LVM):
        return is_frf_table(path)
    if held is Format.HDF5:
        return _own(path) or holds_frf_arrays(path)
    if held is Format.MATLAB:
        return holds_frf_arrays(path)
    return held is Format.NPZ


def _own(path: Path) -> bool:
    """Whether an HDF5 file holds FRFs in ringtrue's layout."""
    try:
        with open_hdf5(path) as file:
            return GROUP in file or "averages" in file
    except DataError:
        return True  # `read_frfs` says what is wrong


def write_frfs(path: str | Path, frfs: FrfSet) -> None:
    """Write FRFs as `.h5` (everything), `.uff` (data sets 58) or `.csv` (those two without the
    origin).
    """
    path = Path(path)
    ext = path.suffix.lower()
    if ext == ".csv":
        write_frf_table(path, frfs)
    elif ext in _UFF:
        write_frf_sets(path, frfs)
    elif ext in _HDF5:
        with atomic_write(path) as part, h5py.File(part, "w") as file:
            hdf5.save(file.create_group(GROUP), frfs)
    else:
        refuse_ending(path, [*_HDF5, *_UFF, ".csv"])


def _check(frfs: FrfSet, path: Path) -> None:
    if not frfs.inputs:
        raise DataError(
            f"{path}: no references (inputs); an FRF needs a response and a reference"
        )
    if not frfs.outputs or frfs.freqs.size < 3:
        raise DataError(
            f"{path}: {len(frfs.outputs)} responses and {frfs.freqs.size} lines; there must be some"
        )
    refuse_twice([c.id for c in frfs.outputs], "response", path)
    refuse_twice([c.id for c in frfs.inputs], "reference", path)
    if frfs.kind not in (kinds := get_args(FrfKind)):
        raise DataError(f"{path}: kind {frfs.kind!r}{did_you_mean(frfs.kind, kinds)}")
    if frfs.freqs[0] < 0:
        raise DataError(
            f"{path}: the lines begin at {frfs.freqs[0]:g} Hz; they must be 0 or more"
        )
    with about(path):
        refuse_large(frfs.freqs, "frequency")
        refuse_large(frfs.data, "FRF")
    beyond = np.argwhere((frfs.coherence < -_ROUNDED) | (frfs.coherence > 1 + _ROUNDED))
    if beyond.size:
        f, o, i = beyond[0].tolist()
        where = f"{frfs.outputs[o].id}/{frfs.inputs[i].id} at {frfs.freqs[f]:g} Hz"
        raise DataError(
            f"{path}: coherence {frfs.coherence[f, o, i]:g} of {where}, and {len(beyond) - 1} more "
            "beyond 0 to 1: not a coherence, or in per cent; mend it or leave it out of the file"
        )
    step = np.diff(frfs.freqs)
    if not np.isfinite(step).all() or step.min() <= 0:
        raise DataError(
            f"{path}: the frequency lines must rise ({step.min():g} to {step.max():g} Hz from "
            "line to line)"
        )


def _forward(frfs: FrfSet, path: Path) -> FrfSet:
    """FRFs of e^{+iωt}, whose phase falls from line to line, as the impulse response comes after
    the impulse.
    """
    h = frfs.data
    turn = np.einsum("foi,foi->oi", h[1:], h[:-1].conj()).imag
    share = turn / np.maximum(
        np.einsum("foi,foi->oi", h, h.conj()).real, np.finfo(float).tiny
    )
    # 6.0: standard deviations, of noise, that a phase rises by; share of the FRFs in which it does
    if share.mean() < 6.0 / np.sqrt(2 * h.size) or (share > 0).mean() < 0.9:
        return frfs
    log.warning(
        "%s: the phase rises with the frequency, so FRFs of e^(-iωt): their conjugates are taken",
        path,
    )
    return replace(frfs, data=h.conj())


def _read_npz(path: Path) -> FrfSet:
    data = read_npz(path)
    if lost := [n for n in ("freq", "H1") if n not in data]:
        there = ", ".join(data) or "no arrays"
        raise DataError(f"{path}: {' and '.join(lost)} missing; there are {there}")
    freq = data["freq"]
    h = data["H1"]
    if h.ndim != 3 or freq.ndim != 1 or h.shape[2] != freq.size:
        raise DataError(
            f"{path}: H1 {h.shape} must be (reference, response, f) with f = {freq.size} lines "
            "of freq"
        )
    coherence = data.get("coherence", np.full(h.shape, np.nan))
    ids = []
    for name, count in (("outputs", h.shape[1]), ("inputs", h.shape[0])):
        default = [f"{name.removesuffix('puts')}{i + 1}" for i in range(count)]
        given = [str(x) for x in data.get(name, default)]
        if len(given) != count:
            raise DataError(f"{path}: {len(given)} ids of {name} for {count}")
        ids.append(given)
    h = h.transpose(2, 1, 0)
    keep = known_lines(h, freq, ids[0], ids[1], path)
    return FrfSet(
        data=np.ascontiguousarray(h[keep]),
        freqs=freq[keep],
        outputs=tuple(Channel(x, "acceleration", "m/s^2") for x in ids[0]),
        inputs=tuple(Channel(x, "force", "N") for x in ids[1]),
        coherence=np.ascontiguousarray(coherence.transpose(2, 1, 0)[keep]),
        averages=np.atleast_1d(data.get("averages", np.full(h.shape[2], np.nan))),
        kind=str(data.get("kind", "accelerance")),  # type: ignore[arg-type]
        window_decay=float(data.get("window_decay", 0.0)),
        source=str(path),
    )


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
_OUTPUTS = (
    "outputs",
    "output",
    "responses",
    "response",
    "out",
    "out_dof",
    "outdof",
    "rsp",
)
_INPUTS = (
    "inputs",
    "input",
    "references",
    "reference",
    "refs",
    "in",
    "in_dof",
    "indof",
    "ref",
)
_CALLED: dict[str, Motion] = OF_KIND | {
    "compliance": "displacement",
    "inertance": "acceleration",
}
_LONGEST = 1 << 22
_OBJECTS = np.dtype(object)


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

    Axes are (f, response, reference), (response, reference, f), (f, response) or (response, f).
    Names come from cell arrays `outputs` and `inputs`; the kind from a text `kind` or the name of
    the array, else responses are accelerations. SI.

    Raises
    ------
    DataError
        If there is no such array, or it lacks a value.
    """
    values = _values(path)
    found = _find(values)
    if found is None:
        held = ", ".join(f"{k} {np.shape(v)}" for k, v in list(values.items())[:12])
        raise DataError(
            f"{path}: no complex array over a vector of frequencies f (Hz) or omega; there are "
            f"{held}"
        )
    h = np.moveaxis(found.data, found.axis, 0)
    h = h.reshape(h.shape[0], -1, 1) if h.ndim == 2 else h
    outputs, inputs = (
        texts(values, keys, count) or [f"{prefix}{i + 1}" for i in range(count)]
        for keys, count, prefix in (
            (_OUTPUTS, h.shape[1], "out"),
            (_INPUTS, h.shape[2], "in"),
        )
    )
    kinds = [
        str(v) for k, v in values.items() if _short(k) in ("kind", "type", "frf_type")
    ]
    text = " ".join([found.name, *kinds]).lower()
    motion = next((m for name, m in _CALLED.items() if name in text), None)
    if motion is None:
        say_accelerances(path)
        motion = "acceleration"
    order = np.argsort(found.freqs, kind="stable")
    h = np.ascontiguousarray(h[order], dtype=np.complex128)
    return frf_set(h, found.freqs[order], (outputs, references(inputs)), motion, path)


def _values(path: Path) -> dict[str, Any]:
    if format_of(path) is Format.MATLAB:
        return mat_values(path)

    def value(_: str, item: h5py.Dataset) -> Any:
        vector = (
            item.dtype.kind in "fiu"
            and 0 < item.size == max(item.shape, default=0) < _LONGEST
        )
        if item.dtype.kind != "c" and not vector:  # samples stay unread
            return None
        check_stored(item, path)
        return item[()]

    return h5_values(path, value)


def _short(name: str) -> str:
    return name.rpartition(".")[2].lower()


def _find(values: Mapping[str, Any]) -> _Found | None:
    arrays = {
        k: v
        for k, v in values.items()
        if getattr(v, "ndim", 0) in (2, 3) and v.dtype.kind == "c"
    }
    for name in sorted(arrays, key=lambda k: -arrays[k].size):
        for key, v in values.items():
            freqs = _frequencies(key, v)
            if freqs is not None and freqs.size in arrays[name].shape:
                return _Found(
                    name, arrays[name], arrays[name].shape.index(freqs.size), freqs
                )
    return None


def _frequencies(name: str, value: Any) -> Float | None:
    """Hz, of a vector that is named so and has no value twice."""
    short = _short(name)
    if (
        short not in (*_HERTZ, *_RADIANS)
        or getattr(value, "dtype", _OBJECTS).kind not in "fiu"
    ):
        return None
    f = np.ravel(value).astype(np.float64)
    vector = 8 <= f.size == max(value.shape)  # lines
    if (
        not vector
        or not np.isfinite(f).all()
        or np.unique(f).size != f.size
        or f.min() < 0
    ):
        return None
    return f / (2 * np.pi) if short in _RADIANS else f
