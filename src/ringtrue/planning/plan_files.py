"""The test sheet: files that a crew takes on site."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.io.files import atomic_write
from ringtrue.io.uff.geometry import write_test_model
from ringtrue.planning.setups import Setups
from ringtrue.virtual.logbook import direction, write_lines, write_sheet
from ringtrue.virtual.sensors import Sensor

NAMES = (
    "sensors.csv",
    "lines.csv",
    "excitation.csv",
    "modes.csv",
    "geometry.uff",
    "setups.csv",
)  # of a test sheet


def write_test_sheet(
    folder: Path,
    test: TestModel,
    references: Sequence[str],
    *,
    frequencies: Float,
    reach: Float,
    sensor: Sensor | None = None,
    setups: Setups | None = None,
) -> tuple[Path, ...]:
    """Write the plan of a test.

    `sensors.csv` (points, directions, channels: what `study.toml` and `read_sensor_sheet` take,
    with columns for the crew to fill in), `lines.csv`, `excitation.csv` (where to strike and in
    which direction), `modes.csv` (targets and how well they are excited) and `geometry.uff`; with
    setups, `setups.csv` (which sensor is where in each).

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    test : TestModel
    references : sequence of str
        Channels of `test` that are struck.
    frequencies : (m,) float64, Hz
        Target modes.
    reach : (r, m) float64, 0..1
        Driving-point residue of each reference over the best of all channels.
    sensor : Sensor, optional
        Planned type.
    setups : Setups, optional

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    InputError
        If a reference is not a channel, or `reach` does not fit.
    """
    if reach.shape != (len(references), frequencies.size):
        raise InputError(
            f"reach {reach.shape}: must be (reference, mode) = "
            f"{(len(references), frequencies.size)}"
        )
    struck = test.pick(references)
    folder.mkdir(parents=True, exist_ok=True)
    sensors, lines, excitation, modes, geometry, roving = (folder / n for n in NAMES)
    write_sheet(sensors, test, test.channels, [sensor] * len(test.channels) if sensor else None)
    write_lines(lines, test)
    _table(
        excitation,
        ("order", "reference", "point", "x", "y", "z", "direction", "best_for_hz"),
        _blows(struck, frequencies, reach),
    )
    best = reach.max(axis=0, initial=0.0)
    owner = [references[i] for i in reach.argmax(axis=0).tolist()]
    rows = zip(range(1, best.size + 1), frequencies.tolist(), best.tolist(), owner, strict=True)
    _table(
        modes,
        ("target", "frequency_hz", "reach", "best_reference"),
        [(k, f"{f:.6g}", f"{b:.3f}", o) for k, f, b, o in rows],
    )
    write_test_model(geometry, test)
    files = sensors, lines, excitation, modes, geometry
    if setups is None:
        return files
    _table(roving, ("setup", "sensor", "point", "channels", "stays"), _places(test, setups))
    return *files, roving


def _places(test: TestModel, setups: Setups) -> list[tuple[object, ...]]:
    """A row for each sensor in each setup; those that stay come first and keep their numbers."""
    each = len(test.channels) // setups.setup.size
    out: list[tuple[object, ...]] = []
    for k in range(setups.count):
        there = [
            *((s, "yes") for s in setups.references.tolist()),
            *((s, "") for s in setups.roving(k).tolist()),
        ]
        for number, (s, stays) in enumerate(there, start=1):
            channels = " ".join(test.channels[s * each : (s + 1) * each])
            out.append((k + 1, number, int(test.at[s * each]), channels, stays))
    return out


def _blows(struck: TestModel, frequencies: Float, reach: Float) -> list[tuple[object, ...]]:
    """A row for each reference: where it is, and the target modes it excites best."""
    owner = reach.argmax(axis=0)
    place = zip(
        struck.channels, struck.at.tolist(), struck.channel_xyz().tolist(), struck.axes, strict=True
    )
    return [
        (
            k + 1,
            name,
            point,
            *(f"{v:.6g}" for v in xyz),
            direction(axis),
            " ".join(f"{f:.4g}" for f in frequencies[owner == k].tolist()),
        )
        for k, (name, point, xyz, axis) in enumerate(place)
    ]


def _table(path: Path, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with atomic_write(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)


def reach_of(shapes: Float, rows: Sequence[int]) -> Float:
    """Driving-point residue of each reference over the best of all channels, (r, m).

    Parameters
    ----------
    shapes : (channel, m) float64, mass-normalised
    rows : sequence of int
        Channels that are struck.
    """
    square = shapes**2
    return np.asarray(square[list(rows)] / np.maximum(square.max(axis=0), 1e-300))
