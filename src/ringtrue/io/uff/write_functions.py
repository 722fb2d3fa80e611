"""Data set 58 written: time records and frequency response functions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.core.dofs import DofSet
from ringtrue.core.motions import FORCES, LINEAR
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import InputError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.uff.function58 import (
    COHERENCE,
    FREQUENCY_AXIS,
    FRF,
    TIME,
    TIME_AXIS,
    write_function,
)

_CODE = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}


def write_frf_sets(path: str | Path, frfs: FrfSet, *, binary: bool = False) -> None:
    """Write the FRFs (and coherence where known) as data sets 58, or 58b, double precision.

    Raises
    ------
    DataError
        If a channel id is not a point and direction such as `101+Z`.
    """
    out, inp = DofSet.parse(c.id for c in frfs.outputs), DofSet.parse(c.id for c in frfs.inputs)
    with atomic_write(path) as part, part.open("wb") as file:
        for j in range(len(frfs.inputs)):
            for i, channel in enumerate(frfs.outputs):
                rsp, ref = _pair(out, i), _pair(inp, j)
                codes = (FREQUENCY_AXIS, _code(channel), _CODE["force"])
                h, coherence = frfs.data[:, i, j], frfs.coherence[:, i, j]
                file.write(
                    write_function(
                        FRF, frfs.freqs, h, rsp, ref, codes=codes, text="FRF", binary=binary
                    )
                )
                if np.isfinite(coherence).all():
                    codes = (FREQUENCY_AXIS, 0, 0)
                    block = write_function(
                        COHERENCE,
                        frfs.freqs,
                        coherence,
                        rsp,
                        ref,
                        codes=codes,
                        text="Coherence",
                        binary=binary,
                    )
                    file.write(block)


def _code(channel: Channel) -> int:
    """Of a motion or force; about an axis that of those along it: the direction, 4 to 6, tells them
    apart.
    """
    return _CODE.get(LINEAR.get(channel.quantity, channel.quantity), 0)


def _pair(dofs: DofSet, i: int) -> tuple[int, int]:
    return int(dofs.node[i]), int(dofs.direction[i])


def write_time(path: str | Path, history: TimeHistory, *, binary: bool = True) -> None:
    """Write a time record as data sets 58b (or 58), double precision.

    A force channel `F:101+Z` is written at the point that was struck. A channel whose id is no
    point and direction (`101+Z`) gets its number as point and no direction; its id is kept as the
    first line of text.
    """
    t = np.arange(history.data.shape[1]) / history.rate
    with atomic_write(path) as part, part.open("wb") as file:
        for i, channel in enumerate(history.channels):
            code = (TIME_AXIS, _code(channel), 0)
            here = _point(
                channel.id.removeprefix("F:") if channel.quantity in FORCES else channel.id, i
            )
            y = np.asarray(history.data[i], dtype=np.float64)
            file.write(
                write_function(TIME, t, y, here, (0, 0), codes=code, text=channel.id, binary=binary)
            )


def _point(name: str, i: int) -> tuple[int, int]:
    try:
        return _pair(DofSet.parse([name]), 0)
    except InputError:
        return i + 1, 0
