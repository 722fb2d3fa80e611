"""Wiring tables of tests in several setups: which channel of which file measures which point.

A row a channel of each file: `file, channel, point, direction, reference`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.files import refuse_twice
from ringtrue.io.sheets import cells

COLUMNS = {  # each with the other words that stand for it
    "file": ("record", "filename", "file name", "setup file"),
    "channel": ("ch", "ch.", "column", "input", "channel name", "channel number"),
    "point": ("node", "location", "position", "measurement point", "measuring point"),
    "direction": ("dir", "dir.", "axis", "dof"),
    "reference": ("ref", "ref.", "fixed"),
}
_YES = ("1", "x", "yes", "y", "true", "ref", "reference", "fixed")
_NO = ("", "0", "no", "n", "false", "-", "rov", "roving", "moved")
_DIRECTION = re.compile(r"([+-]?)(R?[XYZ])")


@dataclass(frozen=True, slots=True)
class WiredChannel:
    """A channel of a file, its name at the structure such as `101+Z`, and the sign of it."""

    column: str
    name: str
    sign: float
    reference: bool


@dataclass(frozen=True, slots=True)
class WiredFile:
    """A file of a setup and its channels."""

    path: Path
    channels: tuple[WiredChannel, ...]

    def force_names(self, ids: Sequence[str]) -> tuple[str, ...]:
        """Names of the channels `ids` of the file, empty for those that the table does not have,
        the force as `F:3-Z`: the reference of a test with forces.

        Raises
        ------
        DataError
            If the file does not have one reference, or lacks a channel of the table.
        """
        if len(self.references) != 1:
            raise DataError(
                f"{self.path}: {len(self.references)} references; one row of each file, the "
                "force, must have reference yes, with the point and direction that it acts at"
            )
        named = [""] * len(ids)
        for wired in self.channels:
            name = wired.name if wired.sign > 0 else wired.name.replace("+", "-")
            named[self._place(wired.column, ids)] = f"F:{name}" if wired.reference else name
        return tuple(named)

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the reference channels."""
        return tuple(c.name for c in self.channels if c.reference)

    def wired(self, history: TimeHistory) -> TimeHistory:
        """The channels of the table by their names at the structure, in positive directions.

        Raises
        ------
        DataError
            If two rows have one point and direction, or the file lacks a channel of the table.
        """
        refuse_twice([c.name for c in self.channels], "point and direction", self.path)
        ids = [c.id for c in history.channels]
        at = [self._place(c.column, ids) for c in self.channels]
        signs = np.array([c.sign for c in self.channels], dtype=history.data.dtype)
        channels = (
            replace(history.channels[k], id=wired.name)
            for k, wired in zip(at, self.channels, strict=True)
        )
        return replace(
            history,
            data=history.data[at] * signs[:, None],
            channels=tuple(channels),
            source=self.path.name,
        )

    def _place(self, column: str, ids: Sequence[str]) -> int:
        """Of a channel by its name, else by its number from 1."""
        if column in ids:
            return ids.index(column)
        if column.isdigit() and 1 <= int(column) <= len(ids):
            return int(column) - 1
        raise DataError(
            f"{self.path}: no channel {column!r}{did_you_mean(column, ids)}; by number they are 1 "
            f"to {len(ids)}"
        )


def read_setup_table(path: str | Path) -> tuple[WiredFile, ...]:
    """The files of a wiring table in their order.

    Files stand relative to the folder of the table. A channel is a name or a number from 1. What
    has no point is not used. Without marks in `reference` all channels that setups share are
    references.

    Raises
    ------
    DataError
        If a column is missing, a cell is not allowed, or a channel occurs twice; with the row.
    """
    path = Path(path)
    table = [r for r in cells(path) if any(r) and not r[0].startswith("#")]
    head = _columns(table[0] if table else [], path)
    found: dict[str, list[WiredChannel]] = {}
    for number, cells_of_row in enumerate(table[1:], start=2):
        padded = [*cells_of_row, *[""] * len(table[0])]
        row = {name: padded[k].strip() for name, k in head.items()}
        if not row["file"]:
            raise DataError(f"{path} row {number}: no file")
        if row["point"]:
            found.setdefault(row["file"], []).append(_channel(row, f"{path} row {number}"))
    if not found:
        raise DataError(f"{path}: no row has a file and a point")
    for name, channels in found.items():
        refuse_twice([c.column for c in channels], "channel", f"{path}: {name}")
    return tuple(WiredFile(path.parent / f, tuple(channels)) for f, channels in found.items())


def _columns(head: Sequence[str], path: Path) -> dict[str, int]:
    """Position of each column."""
    known = {word: name for name, others in COLUMNS.items() for word in (name, *others)}
    at = {}
    for k, text in enumerate(head):
        word = text.strip().lower()
        if word and word not in known:
            raise DataError(f"{path}: unknown column {text!r}{did_you_mean(word, tuple(known))}")
        if word:
            at[known[word]] = k
    if lost := [name for name in COLUMNS if name not in at and name != "reference"]:
        raise DataError(
            f"{path}: columns {', '.join(lost)} are missing; the header must be "
            f"{','.join(COLUMNS)}, such as `setup1.npy,3,101,+Z,yes` below it"
        )
    return at


def _channel(row: dict[str, str], where: str) -> WiredChannel:
    direction = _DIRECTION.fullmatch(row["direction"].upper())
    if direction is None:
        raise DataError(f"{where}: direction {row['direction']!r}; allowed are X, -Y, +Z, RX")
    if not row["point"].isdigit():
        raise DataError(f"{where}: point {row['point']!r} must be a whole number, such as 101")
    mark = row.get("reference", "").lower()
    if mark not in (*_YES, *_NO):
        raise DataError(f"{where}: reference {row['reference']!r}; allowed are yes, no or empty")
    sign = -1.0 if direction[1] == "-" else 1.0
    return WiredChannel(
        row["channel"], f"{int(row['point'])}+{direction[2]}", sign, reference=mark in _YES
    )
