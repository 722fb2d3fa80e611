"""Records in delimited text, with the rate, the clock and the count that loggers write."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DataError
from ringtrue.io.delimited import (
    BRACKETED_UNIT,
    SECONDS_PER,
    column_titles,
    commented_titles,
    header_rows,
    numbers,
    read_lines,
    split_cells,
    without_headers,
)
from ringtrue.io.record_table import TIME_NAMES, RawTable, numbered
from ringtrue.io.times import even_grid, in_seconds, is_clock, known, seconds

log = logging.getLogger(__name__)
_TIMES = {
    *TIME_NAMES,
    "timestamp",
    "datetime",
    "date",
    "datum",
    "uhrzeit",
    "elapsed",
    "elapsed time",
    "relative time",
    "unix",
    "epoch",
    "time stamp",
    "date time",
    "date/time",
    "datum uhrzeit",
    "temps",
    "tempo",
    "tiempo",
}
_COUNTS = {
    "sample",
    "samples",
    "index",
    "idx",
    "nr",
    "no",
    "no.",
    "n",
    "#",
    "scan",
    "record",
    "point",
    "count",
}
_NUMBER = r"(?P<x>\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
_RATE = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:rate|freq\w*)|abtast(?:rate|frequenz)|scan[\s_-]*rate|\bfs\b|^\W*rate\b)[^\d]{{0,24}}?{_NUMBER}\s*(?P<k>k)?",
    re.IGNORECASE,
)
_STEP = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:interval|period)|abtastintervall|\bdelta[\s_-]?t\b|\bdt\b)[^\d]{{0,24}}?{_NUMBER}\W*(?P<u>ms|us|µs|s)?\b",
    re.IGNORECASE,
)


def read_csv(path: Path) -> RawTable:
    """Delimited text, a column for each channel; a column of times or a line above the samples
    gives the rate.

    A header such as `101+Z [m/s^2]` gives name and unit. Delimiters `, ; tab space`; decimal
    commas, dates, quotes, D exponents and empty cells (not a number) are understood.
    """
    comments, lines, delimiter, comma = read_lines(path)
    width = len(split_cells(lines[-1], delimiter))
    top = header_rows(lines, delimiter, comma, width)
    head = [split_cells(x, delimiter) for x in lines[:top]]
    rows = without_headers(lines[top:], lines[:top], path)
    body, clock, stamps = _clocked(rows, delimiter, path)
    data = np.empty((0, len(body)))
    if body and width > clock:
        data = numbers(body, delimiter, comma, path)
    names = commented_titles(comments, delimiter, width)
    if head:
        names = column_titles(head, width, path)
    if names and len(names) - clock != len(data):
        raise DataError(f"{path}: {len(names) - clock} names in the header, {len(data)} columns")
    rate = _stated_rate([*comments, *lines[:top]])
    if not clock:
        return _with_time(data, names, rate, path)
    try:
        t = seconds(stamps)
    except ValueError as exc:
        raise DataError(f"{path}: {exc}") from exc
    by_clock, places = _rate_of(t, path)
    names = names[clock:]
    # 0.9: share of the lines that go on from the one before, from one on or from where the logger
    # was
    numbered_lines = len(data) > 1 and names and names[0].lower() in _COUNTS
    if numbered_lines and np.mean(np.diff(data[0]) == 1) > 0.9:
        data = data[1:]
        names = names[1:]
    return replace(_named(data, names, by_clock or rate), rows=places)


def _clocked(
    lines: Sequence[str], delimiter: str, path: Path
) -> tuple[Sequence[str], int, list[str]]:
    """The lines without the dates and times of day that stand first, how many columns these take,
    and these.
    """
    cells = split_cells(lines[0], delimiter) if lines else []
    clock = next((k for k, x in enumerate(cells[:3]) if not is_clock(x)), len(cells))
    if not 0 < clock < 3:
        return lines, 0, []
    body = []
    stamps = []
    for k, line in enumerate(lines):
        *stamp, rest = line.split(None if delimiter == " " else delimiter, clock)
        if len(stamp) < clock:
            count = len(stamp) + 1
            raise DataError(f"{path}: row {k} of the samples has {count} cells: {line[:60]!r}")
        body.append(rest)
        stamps.append(" ".join(stamp).replace('"', ""))
    return body, clock, stamps


def _rate_of(t: Float, path: Path) -> tuple[float | None, Int | None]:
    """The rate of times that are even but for their rounding to whole seconds or less; as
    `even_grid`.
    """
    step = np.diff(t)
    whole = t.size > 2 and (step >= 0).all() and (step == 0).any() and (np.round(t) == t).all()
    if whole:
        mean = float(np.polyfit(np.arange(t.size) / t.size, t, 1)[0]) / t.size
        even = np.abs(t - t[0] - mean * np.arange(t.size)).max() < 1.5
        # 1e-3: relative deviation of a rate from times written with few digits
        fine = even and mean > 0 and 1 / (t.size**1.5 * mean) < 1e-3
        return (1 / mean if fine else None), None
    return even_grid(t, True, path)


def _stated_rate(lines: Sequence[str]) -> float | None:
    """The rate that a line above the samples gives, Hz."""
    for line in lines:
        if found := _RATE.search(line):
            return float(found["x"].replace(",", ".")) * (1e3 if found["k"] else 1.0) or None
        if (found := _STEP.search(line)) and (step := float(found["x"].replace(",", "."))) > 0:
            return 1 / (step * SECONDS_PER[(found["u"] or "s").lower()])
    return None


def _with_time(data: Float, names: Sequence[str], stated: float | None, path: Path) -> RawTable:
    """The table without columns of times and counts, with the rate that they or the lines above
    tell.
    """
    keep = np.asarray(~np.isnan(data).all(axis=1))
    data = data[keep]
    names = [n for n, k in zip(names, keep, strict=True) if k] if names else []
    if not len(data):
        raise DataError(f"{path}: empty, there are no samples")
    first = names[0].lower() if names else ""
    title = BRACKETED_UNIT.match(first) or re.match(r"^(.*?)[\s_](ms|us|µs|ns|s)$", first)
    named = first in _TIMES or (title is not None and title[1].strip() in _TIMES)
    count = (
        not named and len(data) > 1 and data.shape[1] > 2 and bool((np.diff(data[0]) == 1).all())
    )
    if first in _COUNTS or (count and data[0, 0] in (0, 1)):
        return (
            _with_time(data[1:], names[1:], stated, path) if count else _named(data, names, stated)
        )
    if len(data) < 2 and not named:
        return _named(data, names, stated)
    t = in_seconds(data[0] * SECONDS_PER.get(title[2].strip(), 1.0) if title else data[0])
    rate, rows = _rate_of(t, path) if named else even_grid(t, False, path)
    if rate is None and not named:
        return _named(data, names, stated)
    again = np.array([bool((row == data[0]).all()) for row in data])  # a time for each channel
    rest = [n for n, a in zip(names, again, strict=True) if not a] if names else []
    return replace(_named(data[~again], rest, rate or stated), rows=rows)


def _named(data: Float, names: Sequence[str], rate: float | None) -> RawTable:
    """A table with names and units from titles such as `101+Z [m/s^2]`; brackets that hold no unit
    stay in the name.
    """
    if not names:
        return numbered(data, rate)
    titles = []
    units = []
    for name in names:
        found = BRACKETED_UNIT.match(name)
        is_unit = found is not None and (known(found[2]) or not found[2].strip())
        titles.append(found[1] if found and is_unit else name)
        units.append(found[2] if found and is_unit else "")
    return RawTable(data, rate, tuple(titles), tuple(units), ("",) * len(names))
