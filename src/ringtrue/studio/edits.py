"""One click as one small edit of a text: study.toml, a choice of modes, a sensor sheet.

Each function gives a `Change`, from the text as it is to the text as it will be. Comments and the
order of what stands there stay. On a sensor sheet a sensor is flipped, turned, swapped or moved: a
row keeps the name of its channel when its direction changes, as the record knows it by that.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import AoT, Array, Comment, String, Table

from ringtrue.core.arrays import Float
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.io.choices import NEW_CHOICE
from ringtrue.io.sheets import SensorSheet

Change = Callable[[str], str]


def put(where: Sequence[str], value: Any) -> Change:
    """Set a key, such as ("correlate", "mac_gate"); its tables are made if need be.

    Parameters
    ----------
    where : sequence of str
        Tables and the key. A table that stands several times is meant by its number, from 0, as
        in ("candidate", "0", "upper").
    value : bool, int, float, str, list or dict
        None takes the key out.
    """

    *tables, key = where
    return put_all(tables, {key: value})


def put_all(where: Sequence[str], values: Mapping[str, Any]) -> Change:
    """Set several keys of a table in one step, as `put` sets one."""

    def change(text: str) -> str:
        document = _parsed(text)
        here: Any = document
        for name in where:
            if isinstance(here, AoT):
                here = here[int(name)]
                continue
            if name not in here:
                here[name] = tomlkit.table()
            here = here[name]
        for key, value in values.items():
            if value is None:
                here.pop(key, None)
            else:
                here[key] = value
        return tomlkit.dumps(document)

    return change


def add_entry(name: str, entry: Mapping[str, Any]) -> Change:
    """Add one table to those of a name, such as `[[pick]]`: behind the last of them, or at the
    end.
    """

    def change(text: str) -> str:
        wanted = _parsed(text).unwrap()
        if not wanted.get(name):
            text = text if name not in wanted else put((name,), None)(text)
            wanted[name] = []
        wanted[name].append(dict(entry))
        lines = text.splitlines(keepends=True)
        body = tomlkit.dumps({name: [dict(entry)]}).splitlines(keepends=True)
        for _, end in reversed(_tables(lines, name)):
            made = "".join([*lines[:end], "\n", *body, *lines[end:]])
            if _parsed(made).unwrap() == wanted:
                return made
        lead = "" if not text or text.endswith("\n") else "\n"
        return text + lead + ("\n" if text else "") + "".join(body)

    return change


def remove_entry(name: str, number: int) -> Change:
    """Take out one of the tables of a name, by its number from 0."""

    def change(text: str) -> str:
        wanted = _parsed(text).unwrap()
        count = len(wanted.get(name, []))
        if not 0 <= number < count:
            raise ConfigError(f"[[{name}]] {number + 1}: there are {count}")
        lines = text.splitlines(keepends=True)
        tables = _tables(lines, name)
        if len(tables) != count:
            raise ConfigError(
                f"[[{name}]]: written as a list; take it out in an editor"
            )
        start, end = tables[number]
        if (
            start
            and end < len(lines)
            and not lines[start - 1].strip()
            and lines[end].strip()
        ):
            end -= 1  # an empty line stays
        while start and not lines[start - 1].strip():
            start -= 1
        return "".join([*lines[:start], *lines[end:]])

    return change


def _parsed(text: str) -> tomlkit.TOMLDocument:
    """The text as it will be written again, every byte.

    Raises
    ------
    ConfigError
        If tables of one name stand between others, where they could not be left.
    """
    document = tomlkit.parse(text)
    if tomlkit.dumps(document) != text:
        raise ConfigError(
            "tables of one name, such as [[candidate]], stand between others: bring them together "
            "in an editor, or edit there"
        )
    return document


def _tables(lines: Sequence[str], name: str) -> list[tuple[int, int]]:
    """First line and end of each `[[name]]`, without the comments above what follows."""
    heads = [i for i, line in enumerate(lines) if re.match(r"\s*\[", line)]
    found = []
    for i, after in pairwise([*heads, len(lines)]):
        if not re.match(rf"\s*\[\[\s*\"?{re.escape(name)}\"?\s*\]\]", lines[i]):
            continue
        end = after
        while end > i + 1 and (
            not lines[end - 1].strip() or lines[end - 1].lstrip()[0] == "#"
        ):
            end -= 1
        found.append((i, end))
    return found


def in_choice(change: Change) -> Change:
    """The same in a choice of modes, which is begun where there is none: the automatic modes
    stay.
    """
    return lambda text: change(text or NEW_CHOICE)


def decide_pair(decision: str, pair: str, reason: str) -> Change:
    """Lock or forbid a pair such as `3:7` under [correlate]; the reason is its comment.

    Raises
    ------
    ConfigError
        If there is no reason, or the pair is there already.
    """
    words = " ".join(reason.split())
    if not words:
        raise ConfigError(
            f"{decision} {pair}: needs a reason, which goes into study.toml with it"
        )

    def change(text: str) -> str:
        document = _parsed(text)
        if "correlate" not in document:
            document["correlate"] = tomlkit.table()
        section = document["correlate"]
        assert isinstance(section, Table)
        rows = _with_reasons(section.get(decision))
        if pair in rows:
            raise ConfigError(f"correlate.{decision}: holds {pair} already")
        section[decision] = _array(rows | {pair: words})
        return tomlkit.dumps(document)

    return change


def undecide_pair(decision: str, pair: str) -> Change:
    """Take a pair out of `lock` or `forbid`, with its reason."""

    def change(text: str) -> str:
        document = _parsed(text)
        section: Any = document.get("correlate", {})
        rows = _with_reasons(section.get(decision))
        if pair not in rows:
            raise ConfigError(
                f"correlate.{decision}: no pair {pair}{did_you_mean(pair, rows)}"
            )
        del rows[pair]
        if rows:
            section[decision] = _array(rows)
        else:
            section.pop(decision)
        return tomlkit.dumps(document)

    return change


def reasons(text: str, decision: str) -> dict[str, str]:
    """The pairs of `lock` or `forbid` with their reasons."""
    if decision not in text:  # reading all of a text with its comments takes long
        return {}
    section: Any = tomlkit.parse(text).get("correlate", {})
    return _with_reasons(section.get(decision))


def _with_reasons(array: Any) -> dict[str, str]:
    """Texts of an array and the comment that follows each."""
    found: dict[str, str] = {}
    if not isinstance(array, Array):
        return found
    last = ""
    for item in array._iter_items():
        if isinstance(item, Comment):
            found |= {last: item.as_string().strip(" #\t\n")} if last else {}
        elif isinstance(item, String):
            last = str(item)
            found[last] = ""
    return found


def _array(rows: Mapping[str, str]) -> Array:
    """A line for each text, with its comment."""
    array = tomlkit.array()
    for text, words in rows.items():
        array.add_line(text, indent="    ", comment=words or None)
    array.add_line(indent="")
    return array


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
        new = [
            c
            for row in cells.values()
            for c, v in row.items()
            if v and c not in self.names
        ]
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
    head = [
        c.strip().lower()
        for c in next(csv.reader([lines[used[0]]], delimiter=delimiter))
    ]
    return SheetTable(lines, delimiter, used[0], tuple(head), tuple(used[1:]))


def flip(sheet: SensorSheet, channels: Sequence[str]) -> Change:
    """The directions of some channels reversed."""
    return _redirected(sheet, channels, lambda axis: -axis)


def turn(sheet: SensorSheet, point: int, about: str) -> Change:
    """All channels of a point turned by 90° about an axis of the sheet."""
    here = [c.id for c in sheet.channels if c.point == point]
    return _redirected(sheet, here, lambda axis: QUARTER[about] @ axis)


def remap(
    sheet: SensorSheet, channels: Sequence[str], reads: Mapping[str, str]
) -> Change:
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
            zip(
                "xyz",
                (f"{x:.6g}" for x in (np.round(xyz, 9) + 0.0).tolist()),
                strict=True,
            )
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
                    words = " ".join(
                        f"{x:.9g}" for x in (np.round(axis, 9) + 0.0).tolist()
                    )
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
        raise ConfigError(
            "the sensor sheet was edited outside of the studio since: try again"
        )
    return {c.id: i for c, i in zip(sheet.channels, lines, strict=True)}
