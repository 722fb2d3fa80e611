"""Sensor sheets: a CSV or Excel table of measuring points and channels becomes the test model."""

from __future__ import annotations

import csv
import math
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ringtrue.core.arrays import Float, Int
from ringtrue.core.channels import LINEAR, input_id, other_names
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about, did_you_mean
from ringtrue.io.files import LARGEST, existing, read_text, refuse_large, refuse_twice
from ringtrue.io.foreign.door import door
from ringtrue.io.foreign.parsers import read_sheet, sheet_names
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.times import to_si
from ringtrue.io.uff.points import read_geometry

REQUIRED = ("point", "x", "y", "z")
COLUMNS = (
    *REQUIRED,
    "direction",
    "azimuth",
    "elevation",
    "channel",
    "group",
    "quantity",
    "unit",
    "sensitivity",
    "range",
    "sensor",
    "calibration",
)
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
_LAST_POINT = 9_999_999_999  # ten columns of a universal file

Row = dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class SensorSheet:
    """What a sensor sheet says.

    Attributes
    ----------
    model : TestModel
    channels : tuple of RecordChannel
        Those of `model.channels` in their order, and forces.
    notes : tuple of str
        Doubts about orientations; empty when there are none.
    """

    model: TestModel
    channels: tuple[RecordChannel, ...]
    notes: tuple[str, ...]

    @property
    def strain(self) -> tuple[str, ...]:
        """Channels that measure strain: what a model moves there says nothing of them."""
        return tuple(c.id for c in self.channels if c.quantity == "strain")

    def scaled(self, history: TimeHistory) -> tuple[TimeHistory, tuple[str, ...]]:
        """A record with what it does not tell itself taken from the sheet, and what is to be said
        of it.

        A channel has the name of the sheet; where this is that of the opposite sign, its samples
        change sign. A channel without a unit, or in volts, is divided by its sensitivity and
        becomes SI of its unit; units of the record stand. The type of a sensor is that of the
        sheet where the record has none. A record without names, of as many channels as the sheet
        has motions, has those in their order.
        """
        ids = [c.id for c in history.channels]
        said: tuple[str, ...] = ()
        if names := self._in_order(ids):
            said = (
                "channels without names are the motions of the sensor sheet in its order: "
                f"{_some(names)}",
            )
            ids = list(names)
        named, sign = self.model.named(ids)
        said += other_names(ids, named, sign)
        rows = {c.id: c for c in self.channels}
        channels = list[Channel]()
        changed = []
        lost = []
        factors = np.array(sign, dtype=np.float64)
        for k, (c, name) in enumerate(zip(history.channels, named, strict=True)):
            row = rows.get(name)
            sensor = c.sensor or (row.sensor if row else "")
            if c.quantity == "unknown" and row is not None and row.has_scale:
                factors[k] *= row.to_si
                c = row.channel()
                if c.quantity != "unknown":
                    changed.append(name)
            elif c.quantity == "unknown" and row is None:
                lost.append(name)
            channels.append(replace(c, id=name, sensor=sensor))
        if changed:
            said += (
                f"{len(changed)} channels without a unit taken as the sensor sheet says: "
                f"{_some(changed)}",
            )
        if lost:
            said += (f"without a unit, and not on the sensor sheet: {_some(lost)}",)
        if tuple(channels) == history.channels:
            return history, said
        data = history.data
        if (np.abs(factors) != 1).any():
            data = data * factors[:, None]
        elif (factors < 0).any():
            data = data * factors[:, None].astype(data.dtype)
        return replace(history, data=data, channels=tuple(channels)), said

    def _in_order(self, ids: Sequence[str]) -> tuple[str, ...]:
        """The motions for a record without names; empty where it has names or another number of
        channels.

        Of a sheet with `ch01` to `ch12` the last three look like names of the record, and stand at
        their places.
        """
        rows = self.model.channels
        bare = list(ids) == [f"ch{i + 1}" for i in range(len(rows))] and set(
            ids
        ) != set(rows)
        there = bare and all(
            a == b for a, b in zip(ids, rows, strict=True) if a in rows
        )
        return rows if there else ()


def read_sensor_sheet(path: str | Path, lines: str | Path | None = None) -> SensorSheet:
    """Read a sensor sheet, or the geometry of a universal file as one.

    Columns: `point x y z` and `direction` (`X`, `-Y`, `+Z`; a vector `0.5 0 0.87`; empty for a
    point without a channel) or `azimuth` and `elevation` (degrees from +X towards +Y, and from the
    XY plane towards +Z). Optional: `channel` (id, default `101+Z`), `group quantity unit
    sensitivity range sensor calibration`.

    Parameters
    ----------
    path : path
        Text or a workbook, of which the first sheet counts, and a sheet `lines` if there is one; or
        a universal file with nodes (`read_geometry`), whose channels have no units.
    lines : path, optional
        `.csv` or `.xlsx` with two columns of point numbers to draw lines between.

    Raises
    ------
    DataError
        On an unknown or missing column, a value that is not a number, a point given at two places,
        a channel given twice or a direction that is none; the row is named.
    """
    path = Path(path)
    if lines is None and format_of(path) is Format.UFF:
        model = read_geometry(path)
        places = zip(model.channels, model.at.tolist(), strict=True)
        unknown = tuple(RecordChannel(name, point) for name, point in places)
        return SensorSheet(model, unknown, orientation_notes(model))
    rows = _rows(path)
    points, xyz, groups = _points(rows, path)
    axes = []
    channels = []
    for i, row in enumerate(rows, start=2):
        if any(row.get(d) for d in ("direction", "azimuth", "elevation")):
            where = f"{path} row {i}"
            axes.append(_axis(row, where))
            channels.append(_channel(row, axes[-1], where))
    ids = [c.id for c in channels]
    refuse_twice(ids, "channel", path)
    pairs = _line_rows(path, lines)
    if lost := sorted({p for pair in pairs for p in pair} - set(points.tolist())):
        raise DataError(f"{path}: lines name points that are not there: {lost[:8]}")
    at = np.array([c.point for c in channels], dtype=np.int64)
    every_axis = np.array(axes).reshape(-1, 3)
    forces = np.array([c.quantity == "force" for c in channels], dtype=np.bool_)
    model = TestModel(
        points=points,
        xyz=xyz,
        channels=tuple(c.id for c in channels if c.quantity != "force"),
        at=at[~forces],
        axes=every_axis[~forces],
        lines=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        groups=groups,
        forces=tuple(input_id(c.id) for c in channels if c.quantity == "force"),
        force_at=at[forces],
        force_axes=every_axis[forces],
    )
    return SensorSheet(model, tuple(channels), orientation_notes(model))


def _some(ids: Sequence[str]) -> str:
    return " ".join(ids[:8]) + (" ..." if len(ids) > 8 else "")


def orientation_notes(model: TestModel) -> tuple[str, ...]:
    """Doubts about the directions of the channels at one point: parallel, left-handed, not
    square.
    """
    order = np.argsort(model.at, kind="stable")
    cuts = np.flatnonzero(np.diff(model.at[order])) + 1
    notes = []
    parallel = np.cos(np.radians(1.0))
    not_square = np.sin(np.radians(2.0))
    # few sensors share a point; a report line for each
    for group in np.split(order, cuts):
        if group.size < 2:
            continue
        point = int(model.at[group[0]])
        names = [model.channels[i] for i in group]
        axes = model.axes[group]
        cosine = np.triu(axes @ axes.T, 1)
        of_point = []
        for i, j in np.argwhere(np.abs(cosine) > not_square).tolist():
            what = "agree" if cosine[i, j] > 0 else "oppose each other"
            if abs(cosine[i, j]) <= parallel:
                what = "are not at right angles"
            of_point.append(f"point {point}: {names[i]} and {names[j]} {what}")
        if group.size == 3 and not of_point and np.linalg.det(axes) < 0:
            of_point = [
                f"point {point}: {' '.join(names)} is a left-handed frame in this order"
            ]
        notes += of_point
    return tuple(notes)


def _rows(path: Path) -> list[Row]:
    table = [r for r in cells(path) if any(r) and not r[0].startswith("#")]
    if len(table) < 2:
        raise DataError(f"{path}: no rows below the header")
    head = [x.lower() for x in table[0]]
    for name in filter(None, head):
        if name not in COLUMNS:
            raise DataError(
                f"{path}: unknown column {name!r}{did_you_mean(name, COLUMNS)}"
            )
    if lost := [c for c in REQUIRED if c not in head]:
        raise DataError(
            f"{path}: the columns {', '.join(lost)} are missing; there are "
            f"{', '.join(filter(None, head))}"
        )
    return [dict(zip_longest(head, r[: len(head)], fillvalue="")) for r in table[1:]]


def cells(path: Path, sheet: str | None = None) -> list[list[str]]:
    """The texts of a CSV file or a sheet of an Excel workbook, the first if none is named.

    Raises
    ------
    DataError
        If the file is missing or of another kind.
    """
    path = existing(path)
    held = format_of(path)
    if held is Format.XLSX:
        return [[_text(v) for v in row] for row in read_sheet(path, sheet)]
    if held not in (Format.TEXT, Format.EMPTY):
        refuse_format(path, "table", (Format.TEXT, Format.XLSX))
    lines = read_text(path).splitlines()
    first = next((x for x in lines if x.strip() and not x.startswith("#")), "")
    # commas may be decimal: not more of them than of others
    delimiter = max(";\t,", key=first.count)
    with door(path, "CSV table"):
        return [
            [c.strip() for c in row] for row in csv.reader(lines, delimiter=delimiter)
        ]


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime):
        return str(value.date())
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def _number(row: Row, name: str, where: str, default: float | None = None) -> float:
    text = row.get(name, "")
    if not text and default is not None:
        return default
    try:
        value = float(
            text if text.count(",") != 1 or "." in text else text.replace(",", ".")
        )
    except ValueError as exc:
        raise DataError(f"{where}: {name} is {text!r}; it must be a number") from exc
    if not math.isfinite(value):
        raise DataError(f"{where}: {name} is {text!r}; it must be finite")
    if abs(value) > LARGEST:  # a sheet has thousands of numbers
        refuse_large(np.array(value), f"{where}: {name}")
    return value


def _point(row: Row, where: str) -> int:
    value = _number(row, "point", where)
    if value != int(value) or not 0 <= value <= _LAST_POINT:
        raise DataError(
            f"{where}: point {row['point']!r} must be a whole number from 0 to {_LAST_POINT}"
        )
    return int(value)


def _points(rows: Sequence[Row], path: Path) -> tuple[Int, Float, tuple[str, ...]]:
    """Points in order of appearance; coordinates may be left empty where the point was given
    before.
    """
    place: dict[int, tuple[float, ...]] = {}
    group: dict[int, str] = {}
    for i, row in enumerate(rows, start=2):
        where = f"{path} row {i}"
        p = _point(row, where)
        if p not in place or any(row[c] for c in "xyz"):
            xyz = tuple(_number(row, c, where) for c in "xyz")
            before = place.setdefault(p, xyz)
            if np.abs(np.subtract(xyz, before)).max() > 1e-9:
                raise DataError(
                    f"{where}: point {p} stands at {xyz}, before it stood at {before}"
                )
            place[p] = xyz
        group[p] = group.get(p, "") or row.get("group", "")
    points = np.array(list(place), dtype=np.int64)
    return points, np.array(list(place.values())), tuple(group.values())


def _axis(row: Row, where: str) -> Float:
    """Unit vector of a row, (3,)."""
    if not row.get("direction"):
        return _angles([_number(row, c, where, 0.0) for c in ("azimuth", "elevation")])
    text = row["direction"].strip().upper()
    if re.fullmatch(r"[+-]?[XYZ]", text):
        return np.array(_AXES[text[-1]]) * (-1.0 if text[0] == "-" else 1.0)
    try:
        vector = np.array(
            [float(x) for x in re.sub(r"[,;]", " ", text.strip("()[]")).split()]
        )
    except ValueError:
        vector = np.zeros(0)
    if vector.size == 2:
        return _angles(vector)
    length = float(np.linalg.norm(vector))
    if vector.size != 3 or not np.isfinite(length) or length == 0:
        raise DataError(
            f"{where}: direction {row['direction']!r}; allowed are X, -Y, +Z, a vector `0.5 0 "
            "0.87`, or azimuth and elevation in degrees"
        )
    return vector / length


def _angles(degrees: ArrayLike) -> Float:
    azimuth, elevation = np.radians(degrees)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _channel(row: Row, axis: Float, where: str) -> RecordChannel:
    point = _point(row, where)
    get = defaultdict(str, row)
    sensitivity = _number(row, "sensitivity", where, 1.0)
    full_scale = _number(row, "range", where, float("inf"))
    # 101+Z; a skewed sensor is named after its nearest axis, with an s for skewed: 101+Zs
    k = int(np.abs(axis).argmax())
    skewed = "" if abs(axis[k]) > 1 - 1e-9 else "s"
    default_id = f"{point}{'+' if axis[k] > 0 else '-'}{'XYZ'[k]}{skewed}"
    with about(where):
        quantity = to_si(get["unit"], get["quantity"])[0]
        if quantity in LINEAR:
            raise DataError(
                f"{quantity}: a sheet is of translations; name rotations 101+RX, without a sheet"
            )
        if quantity == "force":
            default_id = f"F:{default_id}"
        return RecordChannel(
            id=get["channel"] or default_id,
            point=point,
            quantity=quantity,
            unit=get["unit"],
            sensitivity=sensitivity,
            range=full_scale,
            sensor=get["sensor"],
            calibration=get["calibration"],
        )


def _line_rows(path: Path, lines: str | Path | None) -> list[tuple[int, int]]:
    table: list[list[str]] = []
    if lines is not None:
        table = cells(Path(lines))
    elif format_of(path) is Format.XLSX and "lines" in sheet_names(path):
        table = cells(path, "lines")
    pairs = []
    for i, row in enumerate(table, start=1):
        if len(row) < 2 or not any(row) or (i == 1 and not row[0].isdigit()):
            continue
        if not (row[0].isdigit() and row[1].isdigit()):
            raise DataError(
                f"{lines or path} lines row {i}: {row[:2]} must be two point numbers"
            )
        pairs.append((int(row[0]), int(row[1])))
    return pairs
