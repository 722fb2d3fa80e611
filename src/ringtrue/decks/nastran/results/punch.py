"""Punch (.pch): real eigenvectors in SORT1 order, two lines of 80 columns a point."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.decks.nastran.results.recorded import RecordedModes, gathered
from ringtrue.errors import DataError
from ringtrue.io.files import existing

_EIGENVALUE = re.compile(r"\$EIGENVALUE *= *(\S+) +MODE *= *(\d+)")
_SECTION = re.compile(
    r"\$(EIGENVECTOR|DISPLACEMENTS|SPCF|MPCF|OLOADS|ELEMENT|VELOCITY|ACCELERATION)", re.I
)


def read_punch(path: str | Path) -> RecordedModes:
    """Modes of a punch file; it does not say the modal masses.

    Raises
    ------
    DataError
        If the file is missing, cut off or holds no real modes.
    """
    path = existing(path)
    try:
        with path.open(encoding="latin-1") as lines:
            found = list(_modes(lines))
        values = np.array([value for _, value, _ in found])
        return gathered(
            values, np.full(values.size, np.nan), [_points(rows) for _, _, rows in found]
        )
    except ValueError as e:
        raise DataError(f"{path}: {e}") from e


def _modes(lines: Iterator[str]) -> Iterator[tuple[int, float, list[str]]]:
    """Number, eigenvalue and data lines of each mode of the first subcase."""
    rows: list[str] = []
    mode, value, inside = 0, 0.0, False
    for line in lines:
        if not line.startswith("$"):
            if inside and mode:
                rows.append(line[:72])
            continue
        section = _SECTION.match(line)
        if section:
            inside = section[1].upper() == "EIGENVECTOR"
        if inside and line.startswith("$REAL-IMAG"):
            raise DataError("complex modes; only real ones are read")
        here = _EIGENVALUE.match(line)
        if section or here:
            if rows:
                yield mode, value, rows
            rows = []
        if here and inside:
            if int(here[2]) <= mode:  # the next subcase
                return
            mode, value = int(here[2]), float(here[1])
    if rows:
        yield mode, value, rows


def _points(rows: list[str]) -> tuple[Int, Bool, Float]:
    first, second = rows[::2], rows[1::2]
    if len(first) != len(second) or any(r[:6] != "-CONT-" for r in second):
        raise DataError("a point without its second line: the file is cut off?")
    head = np.array([(r[:10], r[10:18].strip()) for r in first])
    motion = np.array(
        [[_cell(r, k) for r in pair for k in range(3)] for pair in zip(first, second, strict=True)]
    )
    scalar = head[:, 1] == "S"
    motion[scalar, 1:] = 0.0
    keep = scalar | (head[:, 1] == "G")
    return head[keep, 0].astype(np.int64), scalar[keep], motion[keep]


def _cell(row: str, k: int) -> float:
    text = row[18 * (k + 1) : 18 * (k + 2)].strip()
    return float(text) if text else 0.0
