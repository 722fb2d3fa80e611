"""Delimited text of loggers and spreadsheets: names, units and rates above the samples, times in
many forms.
"""

from __future__ import annotations

import csv
import logging
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.clock import is_clock, seconds
from ringtrue.io.complex_cells import parted
from ringtrue.io.files import read_text
from ringtrue.io.logger_lines import header_cells, is_lacking, without_headers, without_words
from ringtrue.io.plain import TIME_NAMES, RawTable, numbered
from ringtrue.io.si import known
from ringtrue.io.times import even_grid, in_seconds, without_repeated

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
}
_TIMES |= {
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
_SECONDS = {
    "s": 1.0,
    "sec": 1.0,
    "ms": 1e-3,
    "msec": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}
_OF_FREQUENCY = ("hz", "khz", "rad/s", "rpm")
_AXES = (*_OF_FREQUENCY, "db", "deg", "°", "rad")  # of FRFs
_UNIT = re.compile(r"^(.*?)\s*[\[(]([^\])]*)[\])]\s*$")
_NUMBER = r"(?P<x>\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
_RATE = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:rate|freq\w*)|abtast(?:rate|frequenz)|scan[\s_-]*rate|\bfs\b|^\W*rate\b)[^\d]{{0,24}}?{_NUMBER}\s*(?P<k>k)?",
    re.IGNORECASE,
)
_STEP = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:interval|period)|abtastintervall|\bdelta[\s_-]?t\b|\bdt\b)[^\d]{{0,24}}?{_NUMBER}\W*(?P<u>ms|us|µs|s)?\b",
    re.IGNORECASE,
)
_COMMA = re.compile(r"[-+]?\d*,\d+([eEdD][-+]?\d+)?$")
_COMMENT = ("#", "%", "//")
_MOST_FOOTER = 20  # lines
_COUNTED = 0.9  # share of the lines that go on from the one before
_COARSE = 1e-3  # relative deviation of a rate from times written with few digits


def read_csv(path: Path) -> RawTable:
    """Delimited text, a column for each channel; a column of times or a line above the samples
    gives the rate.

    A header such as `101+Z [m/s^2]` gives name and unit. Delimiters `, ; tab space`; decimal
    commas, dates, quotes, D exponents and empty cells (not a number) are understood.
    """
    told, lines, delimiter, comma = _opened(path)
    width = len(_cells(lines[-1], delimiter))
    top = _head_rows(lines, delimiter, comma, width)
    head = [_cells(x, delimiter) for x in lines[:top]]
    rows = without_headers(lines[top:], lines[:top], path)
    body, clock = _clocked(rows, delimiter, path)
    data = (
        numbers(body, delimiter, comma, path)
        if body and width > clock
        else np.empty((0, len(body)))
    )
    names = _titles(head, width, path) if head else _commented(told, delimiter, width)
    if names and len(names) - clock != len(data):
        raise DataError(f"{path}: {len(names) - clock} names in the header, {len(data)} columns")
    rate = _told_rate([*told, *lines[:top]])
    if clock:
        t, data = without_repeated(_clock_times(rows, delimiter, clock, path), data, path)
        by_clock, places = _rate_of(t, path)
        data, names = _without_count(data, names[clock:])
        return replace(_named(data, names, by_clock or rate), rows=places)
    return _with_time(data, names, rate, path)


def read_columns(path: Path) -> tuple[list[str], Float]:
    """Titles of the columns of a delimited text, empty where there are none, and numbers (column,
    row).

    Raises
    ------
    DataError
        If the file is empty, binary or has a cell that is no number.
    """
    names, rows, delimiter, comma = _titled(path)
    return names, numbers(rows, delimiter, comma, path)


def read_titles(path: Path) -> list[str]:
    """Titles of the columns of a delimited text, as `read_columns` gives them; the numbers are not
    read.
    """
    return _titled(path)[0]


def _titled(path: Path) -> tuple[list[str], list[str], str, bool]:
    """Titles, rows of numbers, the delimiter and whether commas are decimal."""
    _, lines, delimiter, comma = _opened(path)
    width = len(_cells(lines[-1], delimiter))
    top = _head_rows(lines, delimiter, comma, width)
    names = _titles([_cells(x, delimiter) for x in lines[:top]], width, path)
    return names, lines[top:], delimiter, comma


def _opened(path: Path) -> tuple[list[str], list[str], str, bool]:
    """Comments, the other lines without what ends them, the delimiter of the columns and whether
    commas are decimal.
    """
    text = read_text(path).splitlines()
    told = [x for x in text[:200] if x.startswith(_COMMENT)]
    lines = [x for x in text if x.strip() and not x.startswith(_COMMENT)]
    if not lines:
        raise DataError(f"{path}: empty, there are no samples")
    lines = _without_cut_end(_without_footer(lines), path)
    delimiter, comma = _dialect(lines[-1])
    if delimiter != " " and lines[-1].rstrip(" ").endswith(
        delimiter
    ):  # each line ends in a delimiter
        if not lines[-1].strip(f" {delimiter}"):
            raise DataError(f"{path}: the last line has no number: the file is empty or cut")
        if lines[len(lines) // 2].rstrip(" ").endswith(delimiter):
            lines = [x.rstrip(" ").removesuffix(delimiter) for x in lines]
    lines = parted(lines, delimiter, comma, lambda x: _cells(x, delimiter))
    return told, lines, delimiter, comma


def _without_footer(lines: list[str]) -> list[str]:
    """The lines without words at the end, such as `End of data`, and without empty rows of a
    spreadsheet.
    """
    while len(lines) > 1 and not lines[-1].strip(" ;,\t"):
        lines = lines[:-1]
    for k in range(min(_MOST_FOOTER, len(lines) - 1)):
        words = lines[len(lines) - 1 - k]
        if (
            any(c.isdigit() for c in words)
            or not any(c.isalpha() for c in words)
            or "nan" in words.lower()
        ):
            return lines[: len(lines) - k]
    return lines


def _without_cut_end(lines: list[str], path: Path) -> list[str]:
    """The lines without a last one of fewer cells than the two before it: the logger died or was
    still writing.
    """
    if len(lines) < 4:
        return lines
    delimiter = _dialect(lines[-2])[0]
    before, last, cut = (len(_cells(x, delimiter)) for x in lines[-3:])
    if not before == last > cut:
        return lines
    log.warning("%s: the last line is cut, and left out: %s", path, lines[-1][:60])
    return lines[:-1]


def _dialect(line: str) -> tuple[str, bool]:
    """Delimiter of the columns, and whether commas are decimal."""
    bare = re.sub(r'"[^"]*"', '""', line)  # what stands in quotes does not separate
    for delimiter in (";", "\t"):
        if delimiter in bare:
            return delimiter, "," in line
    if "," in bare:
        words = bare.split()
        spaced = len(words) > 1 and all(_COMMA.match(w) or w.lstrip("+-").isdigit() for w in words)
        return (
            (" ", True)
            if spaced
            else (",", any(_COMMA.match(x) for x in re.findall(r'"([^"]*)"', line)))
        )
    return (",", True) if '"' in line and "," in line else (" ", False)


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split() or [""]
    try:
        return next(csv.reader([line], delimiter=delimiter)) or [""]
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def _head_rows(lines: Sequence[str], delimiter: str, comma: bool, width: int) -> int:
    """How many lines stand above the samples: other cells than below, or a word where these begin
    with a number.
    """
    led = not _is_word(_cells(lines[-1], delimiter)[0], comma)
    for at, line in enumerate(lines):
        cells = _cells(line, delimiter)
        if led and _is_word(cells[0], comma):
            continue
        if len(cells) == width and any(
            _is_number(x, comma) or is_clock(x) for x in cells if x.strip()
        ):
            return at
        if (
            at
            and len(cells) > 1
            and len(cells) != width
            and all(_is_number(x, comma) for x in cells if x.strip())
        ):
            return at  # a line of samples that lacks some
    return min(1, len(lines))


def _is_word(cell: str, comma: bool) -> bool:
    return bool(cell.strip()) and not (
        _is_number(cell, comma) or is_clock(cell) or is_lacking(cell)
    )


def _is_number(cell: str, comma: bool) -> bool:
    try:
        float(_plain(cell, comma))
    except ValueError:
        return False
    return True


def _is_finite(cell: str, comma: bool) -> bool:
    return _is_number(cell, comma) and math.isfinite(float(_plain(cell, comma)))


def _plain(cell: str, comma: bool) -> str:
    """A number as Python reads it."""
    return (
        (cell.replace(",", ".") if comma else cell).strip(' "').replace("D", "E").replace("d", "e")
    )


def _titles(head: Sequence[Sequence[str]], width: int, path: Path) -> list[str]:
    """Names of the columns from the lines above them; a line of units under the names is joined to
    them.
    """
    if not head:
        return []
    rows = header_cells(head)
    if len(head) == 1 and len(rows[0]) != width:
        raise DataError(f"{path}: {len(rows[0])} names in the header, {width} columns")
    fit = [r for r in rows if len(r) == width and width > 1] or [
        r for r in rows[-1:] if len(r) == width
    ]
    units = [_unbracketed(u) for u in fit[-1]] if len(fit) > 1 else []
    # a unit of frequency stands first, whatever is beside it: analysers and their users write many
    # units
    if not units or not (units[0].lower() in _OF_FREQUENCY or all(_is_unit(u) for u in units[1:])):
        return fit[-1] if fit else []
    told = [(m := _UNIT.match(n)) is not None and _is_unit(m[2]) for n in fit[-2]]
    units = [u.strip("-") for u in units]
    return [n if t or not u else f"{n} [{u}]" for n, u, t in zip(fit[-2], units, told, strict=True)]


def _unbracketed(cell: str) -> str:
    """A cell without brackets around all of it: `[g/N]`, `((m/s^2)/N)`."""
    text = cell.strip()
    while text[:1] in ("[", "(") and text[-1:] in ("]", ")"):
        inside = text[1:-1]
        depth = np.cumsum([(c in "[(") - (c in "])") for c in inside] or [0])
        if depth.min() < 0:  # two pairs: `(m/s^2)/(N)`
            break
        text = inside.strip()
    return text


def _commented(told: Sequence[str], delimiter: str, width: int) -> list[str]:
    """Names of the columns in the last comment, as NumPy and MATLAB write them; else none."""
    cells = [x.strip() for x in _cells(told[-1].lstrip("#%/ "), delimiter)] if told else []
    return cells if len(cells) == width > 1 else []


def _is_unit(text: str) -> bool:
    over, _, under = text.replace("(", "").replace(")", "").rpartition("/")
    return text.lower() in ("", "-", *_SECONDS, *_AXES) or bool(
        known(text) or (over and known(over) and known(under))
    )


def _clocked(lines: Sequence[str], delimiter: str, path: Path) -> tuple[Sequence[str], int]:
    """The lines without the dates and times of day that stand first, and how many columns these
    take.
    """
    if not lines:
        return lines, 0
    cells = _cells(lines[0], delimiter)
    clock = next((k for k, x in enumerate(cells[:3]) if not is_clock(x)), min(len(cells), 3))
    if clock > 2 or not clock:
        return lines, 0
    out = []
    for k, line in enumerate(lines):
        rest = line.split(None if delimiter == " " else delimiter, clock)
        if len(rest) <= clock:
            raise DataError(f"{path}: row {k} of the samples has {len(rest)} cells: {line[:60]!r}")
        out.append(rest[clock])
    return out, clock


def _clock_times(lines: Sequence[str], delimiter: str, columns: int, path: Path) -> Float:
    """Seconds (row,) of lines that begin with dates and times of day."""
    texts = [
        " ".join(x.split(None if delimiter == " " else delimiter, columns)[:columns]) for x in lines
    ]
    try:
        return seconds([x.replace('"', "") for x in texts])
    except ValueError as exc:
        raise DataError(f"{path}: {exc}") from exc


def _rate_of(t: Float, path: Path) -> tuple[float | None, Int | None]:
    """The rate of times that are even but for their rounding to whole seconds or less; as
    `even_grid`.
    """
    if (
        t.size > 2
        and (np.diff(t) >= 0).all()
        and (np.diff(t) == 0).any()
        and (np.round(t) == t).all()
    ):
        step = float(np.polyfit(np.arange(t.size) / t.size, t, 1)[0]) / t.size
        even = np.abs(t - t[0] - step * np.arange(t.size)).max() < 1.5
        return (
            1 / step if even and step > 0 and 1 / (t.size**1.5 * step) < _COARSE else None
        ), None
    return even_grid(t, True, path)


def _told_rate(lines: Sequence[str]) -> float | None:
    """The rate that a line above the samples tells, Hz."""
    for line in lines:
        if found := _RATE.search(line):
            return float(found["x"].replace(",", ".")) * (1e3 if found["k"] else 1.0) or None
        if (found := _STEP.search(line)) and (step := float(found["x"].replace(",", "."))) > 0:
            return 1 / (step * _SECONDS[(found["u"] or "s").lower()])
    return None


def numbers(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
    """(column, row) float64 numbers of delimited lines, with decimal commas if `comma`; empty cells
    are NaN.
    """
    if not any(x.partition("#")[0].strip() for x in lines):
        raise DataError(f"{path}: empty, there are no samples")
    text = (x.replace(",", ".") for x in lines) if comma else iter(lines)
    if comma and delimiter == ",":  # in quotes
        return np.ascontiguousarray(_by_cell(lines, delimiter, comma, path).T)
    try:
        a = _loaded(text, delimiter)
    except ValueError:
        lines = without_words(lines, delimiter)
        try:
            a = _loaded((x.replace(",", ".") for x in lines) if comma else iter(lines), delimiter)
        except ValueError:
            a = _by_cell(lines, delimiter, comma, path)
    return np.ascontiguousarray(a.T)


def _loaded(lines: Iterable[str], delimiter: str) -> Float:
    return np.loadtxt(
        lines, delimiter=None if delimiter == " " else delimiter, ndmin=2, dtype=np.float64
    )


def _by_cell(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
    """Numbers (row, column) of lines with quotes, D exponents or empty cells; columns of words are
    not numbers.
    """
    first, last = _cells(lines[0], delimiter), _cells(lines[-1], delimiter)
    width = len(first)
    words = {
        c
        for c, x in enumerate(zip(first, last, strict=False))
        if all(y.strip() and not _is_finite(y, comma) for y in x)
        and not all(_is_number(y, comma) for y in x)
    }
    out = np.full((len(lines), width), np.nan)
    for r, line in enumerate(lines):  # such files are rare, and read cell by cell
        cells = _cells(line, delimiter)
        if len(cells) != width:
            raise DataError(
                f"{path}: row {r} of the samples has {len(cells)} columns, the first one has "
                f"{width}"
            )
        for c, cell in enumerate(cells):
            if cell.strip() and c not in words:
                try:
                    out[r, c] = float(_plain(cell, comma))
                except ValueError:
                    raise DataError(
                        f"{path}: {cell.strip()[:40]!r} at row {r}, column {c} is no number"
                    ) from None
    return out


def _without_count(data: Float, names: list[str]) -> tuple[Float, list[str]]:
    """Columns and names without a first one that numbers the lines, from one on or from where the
    logger was.
    """
    count = (
        len(data) > 1
        and bool(names)
        and names[0].lower() in _COUNTS
        and np.mean(np.diff(data[0]) == 1) > _COUNTED
    )
    return (data[1:], names[1:]) if count else (data, names)


def _with_time(data: Float, names: Sequence[str], told: float | None, path: Path) -> RawTable:
    """The table without columns of times and counts, with the rate that they or the lines above
    tell.
    """
    keep = np.asarray(~np.isnan(data).all(axis=1))
    data, names = data[keep], [n for n, k in zip(names, keep, strict=True) if k] if names else []
    if not len(data):
        raise DataError(f"{path}: empty, there are no samples")
    first = names[0].lower() if names else ""
    title = _UNIT.match(first) or re.match(r"^(.*?)[\s_](ms|us|µs|ns|s)$", first)
    named = first in _TIMES or (title is not None and title[1].strip() in _TIMES)
    count = (
        not named and len(data) > 1 and data.shape[1] > 2 and bool((np.diff(data[0]) == 1).all())
    )
    if first in _COUNTS or (count and data[0, 0] in (0, 1)):
        return _with_time(data[1:], names[1:], told, path) if count else _named(data, names, told)
    if len(data) < 2 and not named:
        return _named(data, names, told)
    t = in_seconds(data[0] * _SECONDS.get(title[2].strip(), 1.0) if title else data[0])
    t, data = without_repeated(t, data, path) if named else (t, data)
    rate, rows = _rate_of(t, path) if named else even_grid(t, False, path)
    if rate is None and not named:
        return _named(data, names, told)
    again = np.array([bool((row == data[0]).all()) for row in data])  # a time for each channel
    rest = [n for n, a in zip(names, again, strict=True) if not a] if names else []
    return replace(_named(data[~again], rest, rate or told), rows=rows)


def _named(data: Float, names: Sequence[str], rate: float | None) -> RawTable:
    """A table with names and units from titles such as `101+Z [m/s^2]`; brackets that hold no unit
    stay in the name.
    """
    if not names:
        return numbered(data, rate)
    pairs = [
        m if (m := _UNIT.match(n)) and (known(m[2]) or not m[2].strip()) else None for n in names
    ]
    return RawTable(
        data,
        rate,
        tuple(p[1] if p else n for p, n in zip(pairs, names, strict=True)),
        tuple(p[2] if p else "" for p in pairs),
        ("",) * len(names),
    )


def write_csv(path: str | Path, history: TimeHistory) -> None:
    """Write a record as CSV: a column `time` (s), then one a channel with a header `101+Z [m/s^2]`,
    9 digits.
    """
    head = ["time", *(f"{c.id} [{c.unit}]" if c.unit else c.id for c in history.channels)]
    block = 1 << 14
    with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        for at in range(
            0, history.data.shape[1], block
        ):  # so that the text is never whole in memory
            part_data = np.asarray(history.data[:, at : at + block], dtype=np.float64)
            t = (at + np.arange(part_data.shape[1])) / history.rate
            np.savetxt(
                file,
                np.vstack([t, part_data]).T,
                fmt=["%.12g", *["%.9g"] * len(part_data)],
                delimiter=",",
            )
