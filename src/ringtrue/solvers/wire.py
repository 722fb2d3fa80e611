"""Arrays between two Pythons, of which one has no ringtrue and perhaps an older numpy: over a pipe,
and in files of which each process writes some columns. Nothing of ringtrue is imported here.

A message is a line of JSON, with the types and shapes of the arrays, and their bytes behind it.
"""

from __future__ import annotations

import json
from typing import Any, BinaryIO

import numpy as np


def send(stream: BinaryIO, values: dict[str, Any], arrays: tuple[Any, ...]) -> None:
    """Write a message.

    Parameters
    ----------
    values : dict
        Numbers and texts by name.
    arrays : tuple of ndarray
    """
    contiguous = [np.ascontiguousarray(a) for a in arrays]
    head = {"values": values, "arrays": [(a.dtype.str, a.shape) for a in contiguous]}
    stream.write(json.dumps(head).encode() + b"\n")
    for a in contiguous:
        stream.write(a.data.cast("B") if a.size else b"")
    stream.flush()


def receive(stream: BinaryIO) -> tuple[dict[str, Any], list[Any]] | None:
    """Values and arrays of the next message; None where the other end is gone."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    head = json.loads(line)
    arrays = []
    for dtype, shape in head["arrays"]:
        a = np.empty(shape, dtype=np.dtype(dtype))
        if a.size and stream.readinto(a.data.cast("B")) != a.nbytes:  # type: ignore[attr-defined]
            return None
        arrays.append(a)
    return head["values"], arrays


def make_file(path: str, shape: tuple[int, ...]) -> None:
    """A .npy file of float64, filled with zeros."""
    if 0 in shape:  # cannot be mapped
        np.save(path, np.empty(shape))
    else:
        np.lib.format.open_memmap(path, mode="w+", dtype=np.float64, shape=shape)


def write_columns(path: str, first: int, columns: Any) -> None:
    """Write the columns (k, c) from `first` on of a file (k, n) that `make_file` has made.

    By plain writes: a network's file system may write whole pages of what is mapped, and with them
    old columns of others.
    """
    if not columns.size:
        return
    there = np.load(path, mmap_mode="r")
    with open(path, "r+b") as file:
        for k, row in enumerate(columns):
            file.seek(there.offset + 8 * (k * there.shape[1] + first))
            file.write(np.ascontiguousarray(row, dtype=np.float64).data)
