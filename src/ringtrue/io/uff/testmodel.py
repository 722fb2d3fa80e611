"""The geometry of a test as universal file: units (164), points (15) and lines (82)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.foreign.universal import write_sets

_MOST = 9_999_999_999  # ten columns
_UNITS = {
    "type": 164,
    "units_code": 1,
    "units_description": "SI",
    "temp_mode": 1,
    "length": 1.0,
    "force": 1.0,
    "temp": 1.0,
    "temp_offset": 273.15,
}


def write_test_model(path: str | Path, test: TestModel) -> None:
    """Write points and lines, global frame, m.

    The format carries six digits of a coordinate, and no channels: those stand in the sensor sheet.

    Raises
    ------
    DataError
        If there are no points, or a number has more than ten digits.
    """
    if not test.points.size or test.points.max() > _MOST or test.points.min() < 1:
        raise DataError(f"{path}: {test.points.size} points; their numbers must be 1 to {_MOST}")
    x, y, z = test.xyz.T
    sets: list[dict[str, object]] = [
        _UNITS,
        {"type": 15, "node_nums": test.points, "x": x, "y": y, "z": z},
    ]
    if len(test.lines):
        trace = np.column_stack(
            [test.lines, np.zeros(len(test.lines), dtype=np.int64)]
        ).ravel()  # 0 lifts the pen
        sets.append({"type": 82, "trace_num": 1, "id": "measuring points", "nodes": trace})
    with atomic_write(path) as part:
        write_sets(part, sets)
