"""Delimited text: its dialect, its header and its numbers."""

from __future__ import annotations

import csv
import logging
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import DataError
from ringtrue.io.files import read_text
from ringtrue.io.times import is_clock, known

SECONDS_PER = {
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
OF_FREQUENCY = ("hz", "khz", "rad/s", "rpm")
_AXES = (*OF_FREQUENCY, "db", "deg", "°", "rad")  # of FRFs
BRACKETED_UNIT = re.compile(r"^(.*?)\s*[\[(]([^\])]*)[\])]\s*$")
_COMMA = re.compile(r"[-+]?\d*,\d+([eEdD][-+]?\d+)?$")
_COMMENT = ("#", "%", "//")


def read_lines(
    path: Path, most: int | None = None
) -> tuple[list[str], list[str], str, bool]:
    """Comments, the other lines without what ends them, the delimiter of the columns and whether
    commas are decimal.

    Parameters
    ----------
    path : path
    most : int, optional
        Bytes from the beginning of the file that are looked at, in whole lines.

    Raises
    ------
    DataError
        If the file is empty or binary.
    """
    text = read_text(path, most).splitlines()
    comments = [x for x in text[:200] if x.startswith(_COMMENT)]
    lines = [x for x in text if x.strip() and not x.startswith(_COMMENT)]
    if not lines:
        raise DataError(f"{path}: empty, there are no samples")
    lines = _without_cut_end(_without_footer(lines), path)
    delimiter, comma = _dialect(lines[-1])
    # each line ends in a delimiter
    if delimiter != " " and lines[-1].rstrip(" ").endswith(delimiter):
        if not lines[-1].strip(f" {delimiter}"):
            raise DataError(
                f"{path}: the last line has no number: the file is empty or cut"
            )
        if lines[len(lines) // 2].rstrip(" ").endswith(delimiter):
            lines = [x.rstrip(" ").removesuffix(delimiter) for x in lines]
    lines = parted(lines, delimiter, comma, lambda x: split_cells(x, delimiter))
    return comments, lines, delimiter, comma


def _without_footer(lines: list[str]) -> list[str]:
    """The lines without words at the end, such as `End of data`, and without empty rows of a
    spreadsheet.
    """
    while len(lines) > 1 and not lines[-1].strip(" ;,\t"):
        lines = lines[:-1]
    for k in range(len(lines) - 1, max(len(lines) - 21, 0), -1):
        words = lines[k].lower()
        if (
            "nan" in words
            or any(c.isdigit() for c in words)
            or not any(map(str.isalpha, words))
        ):
            return lines[: k + 1]
    return lines


def _without_cut_end(lines: list[str], path: Path) -> list[str]:
    """The lines without a last one of fewer cells than the two before it: the logger died or was
    still writing.
    """
    if len(lines) < 4:
        return lines
    delimiter = _dialect(lines[-2])[0]
    before, last, cut = (len(split_cells(x, delimiter)) for x in lines[-3:])
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
    quoted = any(_COMMA.match(x) for x in re.findall(r'"([^"]*)"', line))
    if "," in bare:
        words = bare.split()
        spaced = len(words) > 1 and all(
            _COMMA.match(w) or w.lstrip("+-").isdigit() for w in words
        )
        return (" ", True) if spaced else (",", quoted)
    return (",", True) if '"' in line and "," in line else (" ", False)


def split_cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split() or [""]
    try:
        return next(csv.reader([line], delimiter=delimiter)) or [""]
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def header_rows(lines: Sequence[str], delimiter: str, comma: bool, width: int) -> int:
    """How many lines stand above the samples: other cells than below, or a word where these begin
    with a number.
    """
    led = not _is_word(split_cells(lines[-1], delimiter)[0], comma)
    for at, line in enumerate(lines):
        cells = split_cells(line, delimiter)
        if led and _is_word(cells[0], comma):
            continue
        given = [x for x in cells if x.strip()]
        numbers = [_number(x, comma) is not None for x in given]
        if len(cells) == width:
            samples = any(numbers) or any(map(is_clock, given))
        else:  # a line of samples that lacks some
            samples = at > 0 and len(cells) > 1 and all(numbers)
        if samples:
            return at
    return min(1, len(lines))


def _is_word(cell: str, comma: bool) -> bool:
    given = bool(cell.strip()) and not (is_clock(cell) or is_no_value(cell))
    return given and _number(cell, comma) is None


def _number(cell: str, comma: bool) -> float | None:
    """The number in a cell; None where it is none."""
    text = cell.replace(",", ".") if comma else cell
    try:
        return float(text.strip(' "').replace("D", "E").replace("d", "e"))
    except ValueError:
        return None


def column_titles(head: Sequence[Sequence[str]], width: int, path: Path) -> list[str]:
    """Names of the columns from the lines above them; a line of units under the names is joined to
    them.
    """
    if not head:
        return []
    rows = header_cells(head)
    if len(head) == 1 and len(rows[0]) != width:
        raise DataError(f"{path}: {len(rows[0])} names in the header, {width} columns")
    fit = [r for r in (rows if width > 1 else rows[-1:]) if len(r) == width]
    if len(fit) < 2:
        return fit[-1] if fit else []
    units = [unbracketed(u) for u in fit[-1]]
    # a unit of frequency stands first, whatever follows: analysers and their users write many
    # units
    if units[0].lower() not in OF_FREQUENCY and not all(map(is_unit, units[1:])):
        return fit[-1]
    return [with_unit(name, unit) for name, unit in zip(fit[-2], units, strict=True)]


def with_unit(title: str, unit: str) -> str:
    """A title with its unit in brackets behind it, unless it has one already or `unit` is none."""
    own = BRACKETED_UNIT.match(title)
    bare = unit.strip("-")
    return f"{title} [{bare}]" if bare and not (own and is_unit(own[2])) else title


def unbracketed(cell: str) -> str:
    """A cell without brackets around all of it: `[g/N]`, `((m/s^2)/N)`."""
    text = cell.strip()
    while text[:1] in ("[", "(") and text[-1:] in ("]", ")"):
        inside = text[1:-1]
        depth = np.cumsum([(c in "[(") - (c in "])") for c in inside] or [0])
        if depth.min() < 0:  # two pairs: `(m/s^2)/(N)`
            break
        text = inside.strip()
    return text


def commented_titles(comments: Sequence[str], delimiter: str, width: int) -> list[str]:
    """Names of the columns in the last comment, as NumPy and MATLAB write them; else none."""
    last = comments[-1].lstrip("#%/ ") if comments else ""
    cells = [x.strip() for x in split_cells(last, delimiter)]
    return cells if len(cells) == width > 1 else []


def is_unit(text: str) -> bool:
    """Whether a text is a unit, a ratio of two, or nothing."""
    over, _, under = text.replace("(", "").replace(")", "").rpartition("/")
    return text.lower() in ("", "-", *SECONDS_PER, *_AXES) or bool(
        known(text) or (over and known(over) and known(under))
    )


def numbers(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
    """(column, row) float64 numbers of delimited lines, with decimal commas if `comma`; empty cells
    are NaN.
    """
    if not any(x.partition("#")[0].strip() for x in lines):
        raise DataError(f"{path}: empty, there are no samples")
    if comma and delimiter == ",":  # in quotes
        return np.ascontiguousarray(_by_cell(lines, delimiter, comma, path).T)
    try:
        a = _loaded(lines, delimiter, comma)
    except ValueError:
        lines = without_words(lines, delimiter)
        try:
            a = _loaded(lines, delimiter, comma)
        except ValueError:
            a = _by_cell(lines, delimiter, comma, path)
    return np.ascontiguousarray(a.T)


def _loaded(lines: Sequence[str], delimiter: str, comma: bool) -> Float:
    text = (x.replace(",", ".") for x in lines) if comma else iter(lines)
    at = None if delimiter == " " else delimiter
    return np.loadtxt(text, delimiter=at, ndmin=2, dtype=np.float64)


def _by_cell(lines: Sequence[str], delimiter: str, comma: bool, path: Path) -> Float:
    """Numbers (row, column) of lines with quotes, D exponents or empty cells; columns of words are
    not numbers.
    """
    first, last = (split_cells(lines[k], delimiter) for k in (0, -1))
    width = len(first)
    words = set()
    for c, ends in enumerate(zip(first, last, strict=False)):
        found = [_number(cell, comma) for cell in ends]
        finite = any(x is not None and math.isfinite(x) for x in found)
        if all(map(str.strip, ends)) and None in found and not finite:
            words.add(c)
    out = np.full((len(lines), width), np.nan)
    for r, line in enumerate(lines):  # such files are rare, and read cell by cell
        cells = split_cells(line, delimiter)
        if len(cells) != width:
            raise DataError(
                f"{path}: row {r} of the samples has {len(cells)} columns, the first one has "
                f"{width}"
            )
        for c, cell in enumerate(cells):
            if cell.strip() and c not in words:
                value = _number(cell, comma)
                if value is None:
                    raise DataError(
                        f"{path}: {cell.strip()[:40]!r} at row {r}, column {c} is no number"
                    )
                out[r, c] = value
    return out


def parted(
    lines: Sequence[str], delimiter: str, comma: bool, cells: Callable[[str], list[str]]
) -> list[str]:
    """The lines with two cells, `real` and `imag` before their titles, for each complex one; others
    as they are.

    Parameters
    ----------
    lines : sequence of str
        Titles and samples; the last one shows which columns are complex.
    delimiter : str
    comma : bool
        Commas are decimal.
    cells : callable
        Takes a line to its cells.
    """
    number = r"(?:\d+{0}?\d*|{0}\d+)(?:[eEdD][-+]?\d+)?".format("," if comma else r"\.")
    both = re.compile(
        rf"(?:\( *)?([-+]? *{number}) *([-+]) *({number}) *\*? *[ijIJ]\b(?: *\))?"
    )
    one = re.compile(rf"[-+\s(]*{number}[\s)]*$")
    if both.search(lines[-1]) is None:
        return list(lines)
    mark = "\x00"
    held = [
        both.sub(lambda m: (m[1] + mark + m[2] + m[3]).replace(" ", ""), x)
        for x in lines
    ]
    double = [mark in c for c in cells(held[-1])]
    out = []
    for line in held:
        row = cells(line)
        if len(row) != len(double):
            out.append(line)
            continue
        single: list[str] = []
        for cell, is_double in zip(row, double, strict=True):
            bare = cell.strip()
            if not is_double:
                single.append(cell)
            elif mark in cell:
                single += cell.split(mark)
            elif one.match(cell):
                single += [cell.strip(" ()"), "0"]
            else:
                single += [f"real_{bare}", f"imag_{bare}"] if bare else ["", ""]
        quoted = [f'"{c}"' if delimiter in c or '"' in c else c for c in single]
        out.append(delimiter.join(quoted))
    return out


log = logging.getLogger(__name__)
_LACKED = re.compile(
    r"#?n/?a|null|none|-+|overflow|ovfl|ovl|over|ol|err|error|invalid|bad|#+|\?+|\*+",
    re.IGNORECASE,
)
# Campbell's fourth line of a header
_PROCESSES = {"smp", "avg", "max", "min", "std", "tot", ""}


def is_no_value(cell: str) -> bool:
    """Whether a cell says in words that there is no value."""
    return _LACKED.fullmatch(cell.strip(' "')) is not None


def without_words(lines: Sequence[str], delimiter: str) -> list[str]:
    """The lines with `nan` in cells that are empty or say in words that there is no value."""
    if delimiter == " ":
        cell = re.compile(rf'(?<!\S)"?(?:{_LACKED.pattern})"?(?!\S)', re.IGNORECASE)
    else:
        d = re.escape(delimiter)
        cell = re.compile(
            rf'(?:^|(?<={d}))[ "]*(?:{_LACKED.pattern}|nan|)[ "]*(?={d}|$)',
            re.IGNORECASE,
        )
    return [cell.sub("nan", x) for x in lines]


def without_headers(lines: Sequence[str], head: Sequence[str], path: Path) -> list[str]:
    """The lines without those of the header, which some loggers write again when they start
    anew.
    """
    again = set(head)
    kept = [x for x in lines if x not in again]
    if len(kept) < len(lines):
        log.warning(
            "%s: the header stands among the samples again, %d lines, left out",
            path,
            len(lines) - len(kept),
        )
    return kept


def header_cells(head: Sequence[Sequence[str]]) -> list[list[str]]:
    """Cells of the lines of a header; in Campbell's TOA5 units stand above how each value was
    made.
    """
    rows = [[x.strip() for x in cells] for cells in head]
    words = {x.lower() for x in rows[-1]}
    if len(rows) < 3 or not words <= _PROCESSES or words == {""}:
        return rows
    units = ["" if x in ("TS", "RN") else x for x in rows[-2]]
    return [*rows[:-2], units]
