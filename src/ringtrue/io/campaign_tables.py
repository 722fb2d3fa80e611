"""Tables that come with a test: the wiring of tests in several setups, and static tests.

A wiring table says which channel of which file measures which point, a row a channel of each file:
`file, channel, point, direction, reference`. A table of static tests says what was pulled at, and
how far points moved.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.files import existing, read_text, refuse_large, refuse_twice
from ringtrue.io.foreign.door import door
from ringtrue.io.sheets import cells

WIRING = {  # each with the other words that stand for it
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
            named[self._place(wired.column, ids)] = (
                f"F:{name}" if wired.reference else name
            )
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
            found.setdefault(row["file"], []).append(
                _channel(row, f"{path} row {number}")
            )
    if not found:
        raise DataError(f"{path}: no row has a file and a point")
    for name, channels in found.items():
        refuse_twice([c.column for c in channels], "channel", f"{path}: {name}")
    return tuple(
        WiredFile(path.parent / f, tuple(channels)) for f, channels in found.items()
    )


def _columns(head: Sequence[str], path: Path) -> dict[str, int]:
    """Position of each column."""
    known = {word: name for name, others in WIRING.items() for word in (name, *others)}
    at = {}
    for k, text in enumerate(head):
        word = text.strip().lower()
        if word and word not in known:
            raise DataError(
                f"{path}: unknown column {text!r}{did_you_mean(word, tuple(known))}"
            )
        if word:
            at[known[word]] = k
    if lost := [name for name in WIRING if name not in at and name != "reference"]:
        raise DataError(
            f"{path}: columns {', '.join(lost)} are missing; the header must be "
            f"{','.join(WIRING)}, such as `setup1.npy,3,101,+Z,yes` below it"
        )
    return at


def _channel(row: dict[str, str], where: str) -> WiredChannel:
    direction = _DIRECTION.fullmatch(row["direction"].upper())
    if direction is None:
        raise DataError(
            f"{where}: direction {row['direction']!r}; allowed are X, -Y, +Z, RX"
        )
    if not row["point"].isdigit():
        raise DataError(
            f"{where}: point {row['point']!r} must be a whole number, such as 101"
        )
    mark = row.get("reference", "").lower()
    if mark not in (*_YES, *_NO):
        raise DataError(
            f"{where}: reference {row['reference']!r}; allowed are yes, no or empty"
        )
    sign = -1.0 if direction[1] == "-" else 1.0
    return WiredChannel(
        row["channel"],
        f"{int(row['point'])}+{direction[2]}",
        sign,
        reference=mark in _YES,
    )


STATICS = ("case", "channel", "load", "deflection")


@dataclass(frozen=True, slots=True, eq=False)
class StaticTests(FrozenArrays):
    """Static tests.

    Attributes
    ----------
    cases : tuple of str
    channels : tuple of str
    loads : (channel, case) float64, N along the channel
    deflections : (channel, case) float64, m along the channel
        NaN where not measured.
    """

    cases: tuple[str, ...]
    channels: tuple[str, ...]
    loads: Float
    deflections: Float


def read_statics(path: str | Path) -> StaticTests:
    """Read a table with the columns `case channel load deflection`, one row a channel and case.

    Parameters
    ----------
    path : path
        `.csv`. `load` in N, empty where none acts; `deflection` in m, empty where none was
        measured.

    Raises
    ------
    DataError
        On a missing or unknown column, a value that is not a number, a channel given twice in a
        case, a case without a load or without a deflection; file and line are named.
    """
    path = existing(path)
    with door(path, "CSV table"):
        table = csv.reader(StringIO(read_text(path), newline=""))
        heads = [h.strip().lower() for h in next(table, [])]
        for h in heads:
            if h not in STATICS:
                raise DataError(f"{path}: column {h!r}{did_you_mean(h, STATICS)}")
        refuse_twice(heads, "column", path)
        if lost := [c for c in STATICS if c not in heads]:
            raise DataError(
                f"{path}: no column {lost[0]!r}; a table of static tests has {', '.join(STATICS)}"
            )
        rows = []
        for cells in table:
            row = dict.fromkeys(heads, "") | dict(
                zip(heads, map(str.strip, cells), strict=False)
            )
            if any(row.values()):
                rows.append((table.line_num, row))
    return _tests(path, rows)


def _tests(path: Path, rows: list[tuple[int, dict[str, str]]]) -> StaticTests:
    cases = tuple(dict.fromkeys(r["case"] for _, r in rows))
    channels = tuple(dict.fromkeys(r["channel"] for _, r in rows))
    loads = np.zeros((len(channels), len(cases)))
    moved = np.full((len(channels), len(cases)), np.nan)
    seen: set[tuple[str, str]] = set()
    for line, r in rows:
        if (key := (r["channel"], r["case"])) in seen:
            raise DataError(
                f"{path}:{line}: channel {key[0]} is given twice in case {key[1]!r}"
            )
        seen.add(key)
        at = channels.index(r["channel"]), cases.index(r["case"])
        loads[at] = _number(path, line, "load", r["load"], 0.0)
        moved[at] = _number(path, line, "deflection", r["deflection"], np.nan)
    for j, case in enumerate(cases):
        if not loads[:, j].any() or not np.isfinite(moved[:, j]).any():
            raise DataError(
                f"{path}: case {case!r} needs at least one load that is not 0 and one deflection"
            )
    if not cases:
        raise DataError(f"{path}: no static test in it")
    return StaticTests(cases, channels, loads, moved)


def _number(path: Path, line: int, name: str, text: str, empty: float) -> float:
    try:
        value = float(text) if text else empty
    except ValueError:
        value = np.inf
    if np.isinf(value):
        raise DataError(f"{path}:{line}: {name} {text!r} is not a number")
    refuse_large(np.array(value), f"{path}:{line}: {name}")
    return value
