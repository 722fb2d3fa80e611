"""Records as files of several formats, for tests of what reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import savemat

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import InputError
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.records import write_record


def write_function(
    kind: int,
    x: Float,
    y: Any_,
    response: tuple[int, int],
    reference: tuple[int, int],
    *,
    codes: tuple[int, int, int],
    text: str = "NONE",
    binary: bool = False,
) -> bytes:
    """A data set 58, double precision; with an uneven abscissa as text, its abscissa of six digits.

    Parameters
    ----------
    kind : int
        Function type.
    x : (n,) float64
    y : (n,) float64 or complex128
    response, reference : (node, direction)
    codes : (abscissa, ordinate, denominator)
        Specific data types, 17 time, 18 frequency, 8 displacement, 11 velocity, 12 acceleration, 13
        force.
    text : str
        First line of text.
    binary : bool
        58b, little endian.
    """
    flat = np.ascontiguousarray(
        y, dtype=np.complex128 if np.iscomplexobj(y) else np.float64
    ).view(np.float64)
    ordinate = 6 if np.iscomplexobj(y) else 4  # double precision
    step = float(x[-1] - x[0]) / (x.size - 1) if x.size > 1 else 1.0
    even = x.size < 2 or bool(np.abs(np.diff(x) - step).max() < 1e-3 * abs(step))
    binary = binary and even
    names = (
        f"{'NONE':<10}{response[0]:10d}{response[1]:4d} "
        f"{'NONE':<10}{reference[0]:10d}{reference[1]:4d}"
    )
    head = [
        text[:80] or "NONE",
        *("NONE",) * 4,
        f"{kind:5d}{0:10d}{0:5d}{0:10d} {names}",
    ]
    head.append(
        f"{ordinate:10d}{x.size:10d}{int(even):10d}{float(x[0]):13.6E}{step:13.6E}{0.0:13.5E}"
    )
    head += [
        f"{c:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}" for c in (*codes, 0)
    ]
    number = f"{58:6d}"
    if binary:
        number += f"b{1:6d}{2:6d}{11:12d}{flat.nbytes:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    start = "\n".join(["    -1", number, *head, ""]).encode("latin-1", "replace")
    body = (
        flat.astype("<f8").tobytes()
        if binary
        else _even(flat)
        if even
        else _uneven(x, flat)
    )
    return start + body + b"\n    -1\n"


def _uneven(x: Float, flat: Float) -> bytes:
    """E13.5 and E20.12 or 2E20.12, two of the real pairs a line."""
    table = np.column_stack([x, flat.reshape(x.size, -1)])
    lines = [
        "".join(("%13.5E", *("%20.12E",) * (len(r) - 1))) % tuple(r)
        for r in table.tolist()
    ]
    a_line = 1 if table.shape[1] == 3 else 2
    return "\n".join(
        "".join(lines[k : k + a_line]) for k in range(0, len(lines), a_line)
    ).encode()


def _even(flat: Float) -> bytes:
    """4E20.12."""
    whole = flat.size // 4 * 4
    lines = [("%20.12E" * 4) % tuple(r) for r in flat[:whole].reshape(-1, 4).tolist()]
    rest = flat[whole:].tolist()
    return "\n".join(
        [*lines, *([("%20.12E" * len(rest)) % tuple(rest)] if rest else [])]
    ).encode()


_CODES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}


def write_history(path: str | Path, history: TimeHistory) -> None:
    """Write a record in SI by its ending: .h5 (float32), .csv (9 digits), .mat (v5), .uff (58b)."""
    path = Path(path)
    channels = history.channels
    if path.suffix == ".h5":
        rows = [
            RecordChannel(c.id, 0, c.quantity, c.unit, sensor=c.sensor)
            for c in channels
        ]
        write_record(path, history.data, history.rate, rows, source=history.source)
    elif path.suffix == ".mat":
        content = {
            "data": np.asarray(history.data).T,
            "fs": history.rate,
            "channels": np.array([c.id for c in channels], dtype=object),
            "units": np.array([c.unit for c in channels], dtype=object),
        }
        savemat(str(path), content, appendmat=False)
    elif path.suffix == ".uff":
        path.write_bytes(b"".join(_function(history, i) for i in range(len(channels))))
    else:
        head = ",".join(
            ["time", *(f"{c.id} [{c.unit}]" if c.unit else c.id for c in channels)]
        )
        t = np.arange(history.data.shape[1]) / history.rate
        table = np.vstack([t, history.data]).T
        form = ["%.12g", *["%.9g"] * len(channels)]
        np.savetxt(path, table, fmt=form, delimiter=",", header=head, comments="")


def _function(history: TimeHistory, i: int) -> bytes:
    channel = history.channels[i]
    t = np.arange(history.data.shape[1]) / history.rate
    try:
        dof = DofSet.parse([channel.id.removeprefix("F:")])
        place = int(dof.node[0]), int(dof.direction[0])
    except InputError:
        place = i + 1, 0
    codes = 17, _CODES.get(channel.quantity, 0), 0
    y = np.asarray(history.data[i], dtype=np.float64)
    return write_function(
        1, t, y, place, (0, 0), codes=codes, text=channel.id, binary=True
    )
