"""One click as one small edit of a sensor sheet in CSV: a sensor flipped, turned, swapped, moved.

A row keeps the name of its channel when its direction changes: the record knows it by that.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import ConfigError
from ringtrue.io.sheets import SensorSheet
from ringtrue.studio.edits import Change

AXES = ("X", "Y", "Z")
QUARTER = {  # turns by 90° about an axis: columns are where X, Y, Z go
    "X": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "Y": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    "Z": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
ALONG = 1 - 1e-9  # of a unit vector: it lies along an axis


@dataclass(frozen=True, slots=True)
class SheetTable:
    """The table in the text of a sheet.

    Attributes
    ----------
    lines : tuple of str
        All of the text, with their ends.
    delimiter : str
    head : int
        The line with the names of the columns.
    names : tuple of str
    rows : tuple of int
        The line of each row.
    """

    lines: tuple[str, ...]
    delimiter: str
    head: int
    names: tuple[str, ...]
    rows: tuple[int, ...]

    def cells(self, line: int) -> list[str]:
        """The cells of a line, one for each column."""
        row = next(csv.reader([self.lines[line]], delimiter=self.delimiter), [])
        return row + [""] * (len(self.names) - len(row))

    def get(self, line: int, column: str) -> str:
        """A cell; empty where the sheet has no such column."""
        if column not in self.names:
            return ""
        return self.cells(line)[self.names.index(column)].strip()

    def channels(self) -> list[int]:
        """The line of each channel, in the order of `SensorSheet.channels`."""
        given = ("direction", "azimuth", "elevation")
        return [i for i in self.rows if any(self.get(i, c) for c in given)]

    def text(self, cells: Mapping[int, Mapping[str, str]]) -> str:
        """The text with other cells in some lines; columns that are missing are added."""
        lines = list(self.lines)
        new = [c for row in cells.values() for c, v in row.items() if v and c not in self.names]
        names = (*self.names, *dict.fromkeys(new))
        if len(names) > len(self.names):
            lines[self.head] = self._line(
                self.head, [*self.cells(self.head), *names[len(self.names) :]]
            )
        for line, row in cells.items():
            values = self.cells(line)
            values += [""] * (len(names) - len(values))
            for column, value in row.items():
                if column in names:
                    values[names.index(column)] = value
            lines[line] = self._line(line, values)
        return "".join(lines)

    def _line(self, line: int, values: Sequence[str]) -> str:
        out = StringIO()
        csv.writer(out, delimiter=self.delimiter, lineterminator="").writerow(values)
        old = self.lines[line]
        return out.getvalue() + old[len(old.rstrip("\r\n")) :]


def sheet_table(text: str) -> SheetTable:
    """The table of a sheet, as `read_sensor_sheet` finds it.

    Raises
    ------
    ConfigError
        If there is none.
    """
    lines = tuple(text.splitlines(keepends=True))
    first = next((x for x in lines if x.strip() and x[0] != "#"), "")
    delimiter = max(";\t,", key=first.count)
    used = []
    for i, line in enumerate(lines):
        row = [c.strip() for c in next(csv.reader([line], delimiter=delimiter), [])]
        if any(row) and row[0][:1] != "#":
            used.append(i)
    if len(used) < 2:
        raise ConfigError("the sensor sheet has no rows")
    head = [c.strip().lower() for c in next(csv.reader([lines[used[0]]], delimiter=delimiter))]
    return SheetTable(lines, delimiter, used[0], tuple(head), tuple(used[1:]))


def flip(sheet: SensorSheet, channels: Sequence[str]) -> Change:
    """The directions of some channels reversed."""
    return _redirected(sheet, channels, lambda axis: -axis)


def turn(sheet: SensorSheet, point: int, about: str) -> Change:
    """All channels of a point turned by 90° about an axis of the sheet."""
    here = [c.id for c in sheet.channels if c.point == point]
    return _redirected(sheet, here, lambda axis: QUARTER[about] @ axis)


def remap(sheet: SensorSheet, channels: Sequence[str], reads: Mapping[str, str]) -> Change:
    """Channels along an axis get the direction that they read, such as {"X": "-Z"}."""
    to = np.eye(3)
    for axis, read in reads.items():
        sign = -1.0 if read[0] == "-" else 1.0
        to[:, AXES.index(axis)] = sign * np.eye(3)[AXES.index(read[-1])]
    return _redirected(sheet, channels, lambda axis: to @ axis)


def swap(sheet: SensorSheet, one: str, other: str) -> Change:
    """Two channels exchanged, as cables are: each has the name of the other."""
    return reread(sheet, {one: other, other: one})


def reread(sheet: SensorSheet, reads: Mapping[str, str]) -> Change:
    """Channels that read what others should: the row of each of these gets its name.

    Parameters
    ----------
    sheet : SensorSheet
    reads : mapping of str to str
        Channel -> the channel whose motion it reads; those that are read are read once.
    """

    def change(text: str) -> str:
        table = sheet_table(text)
        line = _lines(sheet, table)
        return table.text({line[at]: {"channel": name} for name, at in reads.items()})

    return change


def relocate(sheet: SensorSheet, point: int, xyz: Float) -> Change:
    """A point at another place, (3,) m, in the frame of the sheet."""

    def change(text: str) -> str:
        table = sheet_table(text)
        place = dict(
            zip("xyz", (f"{x:.6g}" for x in (np.round(xyz, 9) + 0.0).tolist()), strict=True)
        )
        here = [i for i in table.rows if float(table.get(i, "point")) == point]
        given = [i for i in here if any(table.get(i, c) for c in "xyz")]
        return table.text(dict.fromkeys(given or here[:1], place))

    return change


def _redirected(
    sheet: SensorSheet, channels: Sequence[str], other: Callable[[Float], Float]
) -> Change:
    """The directions of some channels by what they are now."""
    motions = dict(zip(sheet.model.channels, sheet.model.axes, strict=True))

    def change(text: str) -> str:
        table = sheet_table(text)
        line = _lines(sheet, table)
        cells = {}
        for name in channels:
            if name in motions:  # a force stays
                axis = other(motions[name])
                k = int(np.abs(axis).argmax())
                words = f"{'+' if axis[k] > 0 else '-'}{AXES[k]}"
                if abs(axis[k]) < ALONG:
                    words = " ".join(f"{x:.9g}" for x in (np.round(axis, 9) + 0.0).tolist())
                cells[line[name]] = {
                    "direction": words,
                    "azimuth": "",
                    "elevation": "",
                    "channel": name,
                }
        return table.text(cells)

    return change


def _lines(sheet: SensorSheet, table: SheetTable) -> dict[str, int]:
    """The line of each channel of a sheet.

    Raises
    ------
    ConfigError
        If the text is not that of the sheet any more.
    """
    lines = table.channels()
    if len(lines) != len(sheet.channels):
        raise ConfigError("the sensor sheet was edited outside of the studio since: try again")
    return {c.id: i for c, i in zip(sheet.channels, lines, strict=True)}
