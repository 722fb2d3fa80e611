"""What a crew writes down: sensor sheets, lines to draw and the log of the campaign."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.testmodel import TestModel
from ringtrue.io.record_layout import RecordChannel
from ringtrue.virtual.sensors import Sensor

HEADER = (
    "point",
    "x",
    "y",
    "z",
    "direction",
    "channel",
    "group",
    "quantity",
    "unit",
    "sensitivity",
    "range",
    "sensor",
)


def record_channels(
    test: TestModel, channels: Sequence[str], sensors: Sequence[Sensor], date: str
) -> list[RecordChannel]:
    """The channel table of a record, with the sensitivities of the calibration sheets."""
    at = dict(zip(test.channels, test.at.tolist(), strict=True))
    return [
        RecordChannel(c, at[c], s.quantity, s.unit, s.sensitivity, s.range, s.name, date)
        for c, s in zip(channels, sensors, strict=True)
    ]


def write_sheet(
    path: Path, test: TestModel, channels: Sequence[str], sensors: Sequence[Sensor] | None = None
) -> None:
    """A sensor sheet; without `sensors` only places, directions and groups, and points without
    channels too.
    """
    place = dict(
        zip(test.points.tolist(), zip(test.xyz.tolist(), test.groups, strict=True), strict=True)
    )
    here = {c: i for i, c in enumerate(test.channels)}
    rows = []
    for k, c in enumerate(channels):
        point = int(test.at[here[c]])
        xyz, group = place[point]
        s = sensors[k] if sensors else None
        tail = [s.quantity, s.unit, f"{s.sensitivity:g}", f"{s.range:g}", s.name] if s else [""] * 5
        rows.append(
            [point, *(f"{v:.6g}" for v in xyz), direction(test.axes[here[c]]), c, group, *tail]
        )
    if sensors is None:
        used = {r[0] for r in rows}
        bare = [p for p in np.unique(test.lines).tolist() if p not in used]
        rows += [
            [p, *(f"{v:.6g}" for v in place[p][0]), "", "", place[p][1], *[""] * 5] for p in bare
        ]
    _table(path, HEADER, rows)


def direction(axis: Float) -> str:
    """`+Z` for a global axis, else the vector."""
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > 1 - 1e-9:
        return f"{'+' if axis[k] > 0 else '-'}{'XYZ'[k]}"
    return " ".join(f"{v:.9g}" for v in axis)


def write_lines(path: Path, test: TestModel) -> None:
    """Pairs of points to draw."""
    _table(path, ("from", "to"), test.lines.tolist())


def write_log(path: Path, tests: Sequence[Mapping[str, object]], sensors: Sequence[Sensor]) -> None:
    """campaign.json: tests with their records, and the data sheets of the sensor types."""
    sheets = {
        s.name: {
            "quantity": s.quantity,
            "corner_hz": s.corner,
            "damping": s.damping,
            "reaches_zero": s.corner == 0,
        }
        for s in dict.fromkeys(sensors)
    }
    log = {"format": "ringtrue-campaign", "version": 1, "sensors": sheets, "tests": list(tests)}
    path.write_text(json.dumps(log, indent=1) + "\n")


def _table(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
