"""Tables of static tests: what was pulled at, and how far points moved."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.files import existing, read_text, refuse_large, refuse_twice
from ringtrue.io.foreign.door import door

COLUMNS = ("case", "channel", "load", "deflection")


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
            if h not in COLUMNS:
                raise DataError(f"{path}: column {h!r}{did_you_mean(h, COLUMNS)}")
        refuse_twice(heads, "column", path)
        if lost := [c for c in COLUMNS if c not in heads]:
            raise DataError(
                f"{path}: no column {lost[0]!r}; a table of static tests has {', '.join(COLUMNS)}"
            )
        rows = []
        for cells in table:
            row = dict.fromkeys(heads, "") | dict(zip(heads, map(str.strip, cells), strict=False))
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
            raise DataError(f"{path}:{line}: channel {key[0]} is given twice in case {key[1]!r}")
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
