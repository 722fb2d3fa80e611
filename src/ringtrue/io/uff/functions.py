"""Data set 58: time records and frequency response functions."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.dofs import NAMES
from ringtrue.core.signals import Channel, FrfKind, FrfSet, Quantity
from ringtrue.errors import DataError
from ringtrue.io.plain import RawTable

Sets = list[dict[str, Any]]
_QUANTITY: dict[int, Quantity] = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
_SI = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N"}
_KIND: dict[str, FrfKind] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
_CODE = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
TIME, FRF, COHERENCE = 1, 4, 6  # function types


def read_sets(path: str | Path, kind: int) -> Sets:
    """All data sets of one kind, as pyuff's dictionaries.

    Raises
    ------
    DataError
        If the file is not a universal file or holds no such data set.
    """
    if not Path(path).is_file():
        raise DataError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pyuff: chatter on optional fields
            file = pyuff.UFF(str(path))
            found = [i for i, t in enumerate(file.get_set_types()) if int(t) == kind]
            sets = [file.read_sets(i) for i in found]
    except (ValueError, IndexError, KeyError, UnicodeError, OSError, TypeError, struct.error) as exc:
        raise DataError(f"{path}: not a readable universal file ({type(exc).__name__}: {exc})") from exc
    except Exception as exc:
        # pyuff wraps every failure of its own in a bare Exception
        raise DataError(f"{path}: not a readable universal file ({exc})") from exc
    if not sets:
        raise DataError(f"{path}: no data set {kind} in the file")
    return sets


def label(node: int, direction: int) -> str:
    """`101+Z` of a point and a direction code (0 scalar, ±1..±3 translations, ±4..±6 rotations)."""
    if direction == 0 or abs(direction) > 6:
        return str(node)
    return f"{node}{'+' if direction > 0 else '-'}{NAMES[abs(direction)]}"


def read_time(path: Path) -> RawTable:
    """The time functions of a universal file as (channel, sample); all must have one rate and length."""
    sets = [s for s in read_sets(path, 58) if s["func_type"] == TIME]
    if not sets:
        raise DataError(f"{path}: no time functions (58, function type 1) in the file")
    rates = [_rate(s, path) for s in sets]
    if max(rates) - min(rates) > 1e-4 * max(rates):
        raise DataError(f"{path}: different rates, {min(rates):g} to {max(rates):g} Hz; split the file")
    length = min(len(s["data"]) for s in sets)
    data = np.stack([np.real(s["data"][:length]) for s in sets])
    kinds = [_QUANTITY.get(int(s["ordinate_spec_data_type"]), "unknown") for s in sets]
    return RawTable(data, rates[0], _names(sets), tuple(_SI.get(k, "") for k in kinds), tuple(kinds))


def _rate(s: dict[str, Any], path: Path) -> float:
    step = float(s["abscissa_inc"]) if s["abscissa_spacing"] else float(np.median(np.diff(s["x"])))
    if not (np.isfinite(step) and step > 0):
        raise DataError(f"{path}: step of time {step}; it must be positive")
    return 1 / step


def _names(sets: Sets) -> tuple[str, ...]:
    names = [label(int(s["rsp_node"]), int(s["rsp_dir"])) for s in sets]
    if len(set(names)) == len(names):
        return tuple(names)
    return tuple(f"{n}#{i + 1}" for i, n in enumerate(names))


def read_frf_sets(path: str | Path) -> FrfSet:
    """Frequency response functions of a universal file, SI as stored.

    Raises
    ------
    DataError
        If there are none, references are missing, the lines differ, or a pair of response and reference is absent.
    """
    sets = [s for s in read_sets(path, 58) if s["func_type"] in (FRF, COHERENCE)]
    frfs = [s for s in sets if s["func_type"] == FRF]
    if not frfs:
        raise DataError(f"{path}: no frequency response functions (58, function type 4) in the file")
    if all(int(s["ref_node"]) == 0 for s in frfs):
        raise DataError(f"{path}: the functions name no reference point; ref_node is 0 in all {len(frfs)}")
    freqs = np.asarray(frfs[0]["x"], dtype=np.float64)
    outputs, inputs = _channels(frfs)
    data = _place(frfs, freqs, outputs, inputs, path)
    lost = np.argwhere(np.isnan(data[0]))
    if lost.size:
        o, i = lost[0]
        raise DataError(f"{path}: no function from {inputs[i].id} to {outputs[o].id} ({len(lost)} pairs are absent)")
    coherence = _place([s for s in sets if s["func_type"] == COHERENCE], freqs, outputs, inputs, path).real
    quantity = outputs[0].quantity
    return FrfSet(
        data,
        freqs,
        outputs,
        inputs,
        np.ascontiguousarray(coherence),
        np.full(len(inputs), np.nan),
        _KIND.get(quantity, "accelerance"),
        source=str(path),
    )


def _channels(frfs: Sets) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    out = {_response(s): _QUANTITY.get(int(s["ordinate_spec_data_type"]), "unknown") for s in frfs}
    outputs = tuple(Channel(name, q, _SI.get(q, "")) for name, q in out.items())
    inputs = tuple(Channel(name, "force", "N") for name in dict.fromkeys(_reference(s) for s in frfs))
    return outputs, inputs


def _response(s: dict[str, Any]) -> str:
    return label(int(s["rsp_node"]), int(s["rsp_dir"]))


def _reference(s: dict[str, Any]) -> str:
    return label(int(s["ref_node"]), int(s["ref_dir"]))


def _place(
    sets: Sets, freqs: Float, outputs: Sequence[Channel], inputs: Sequence[Channel], path: str | Path
) -> Complex:
    row = {c.id: i for i, c in enumerate(outputs)}
    column = {c.id: i for i, c in enumerate(inputs)}
    data = np.full((freqs.size, len(outputs), len(inputs)), np.nan, dtype=np.complex128)
    for s in sets:
        if len(s["x"]) != freqs.size or np.abs(s["x"] - freqs).max() > 1e-6 * max(freqs[-1], 1):
            raise DataError(f"{path}: function {_response(s)}/{_reference(s)} has other frequency lines")
        if _response(s) in row and _reference(s) in column:
            data[:, row[_response(s)], column[_reference(s)]] = s["data"]
    return data


def write_frf_sets(path: str | Path, frfs: FrfSet) -> None:
    """Write the FRFs (and coherence where known) as ascii data sets 58, double precision.

    Raises
    ------
    DataError
        If a channel id is not a point and direction such as `101+Z`.
    """
    from ringtrue.core.dofs import DofSet
    from ringtrue.io.atomic import atomic_write

    out, inp = DofSet.parse(c.id for c in frfs.outputs), DofSet.parse(c.id for c in frfs.inputs)
    with atomic_write(path) as part:
        file = pyuff.UFF(str(part))
        for j in range(len(frfs.inputs)):
            for i, channel in enumerate(frfs.outputs):
                place = (int(out.node[i]), int(out.direction[i]), int(inp.node[j]), int(inp.direction[j]))
                file.write_sets(_set58(FRF, frfs.freqs, frfs.data[:, i, j], place, channel), "add")
                if np.isfinite(frfs.coherence[:, i, j]).all():
                    file.write_sets(_set58(COHERENCE, frfs.freqs, frfs.coherence[:, i, j], place, channel), "add")


def _set58(kind: int, x: Float, y: Any, place: tuple[int, int, int, int], out: Channel) -> dict[str, Any]:
    rsp_node, rsp_dir, ref_node, ref_dir = place
    return {
        "type": 58,
        "func_type": kind,
        "rsp_node": rsp_node,
        "rsp_dir": rsp_dir,
        "ref_node": ref_node,
        "ref_dir": ref_dir,
        "data": np.asarray(y),
        "x": np.asarray(x),
        "id1": "FRF" if kind == FRF else "Coherence",
        "rsp_ent_name": "NONE",
        "ref_ent_name": "NONE",
        "abscissa_spacing": 1,
        "abscissa_min": float(x[0]),
        "abscissa_inc": float(x[1] - x[0]) if x.size > 1 else 1.0,
        "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": _CODE.get(out.quantity, 0) if kind == FRF else 0,
        "orddenom_spec_data_type": 13 if kind == FRF else 0,
    }
