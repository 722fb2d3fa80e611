"""Titles for the columns of text exports of FRFs: rows of names, parts and units above the numbers,
in any order, or keys such as `X axis unit: Hz` and no titles at all.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.io.delimited import (
    OF_FREQUENCY,
    column_titles,
    header_rows,
    is_unit,
    numbers,
    read_lines,
    split_cells,
    unbracketed,
    with_unit,
)
from ringtrue.io.record_texts import lvm_spectra

FREQUENCY = re.compile(
    r"^\W*((linear|angular)\s+)?(fr[eé]q\w*|f|k?hz|omega|x)(?![A-Za-z])", re.IGNORECASE
)
_PARTS = {
    "re": r"real([\s_]*part|teil)?|(partie\s+)?r[eé]elle|re",
    "im": r"imaginary([\s_]*part)?|imag([\s_]*part)?|imagin[aä]rteil|(partie\s+)?imaginaire|im",
    "size": r"magnitude|mag|amplitude|ampl|amp|abs|modulus|module|gain|betrag",
    "phase": r"phase(nwinkel)?|phi|arg|angle|winkel",
    "coherence": r"coh[eé]rence|coh|gamma2|koh[aä]renz",
}
PART = {
    k: re.compile(rf"(?<![A-Za-z])({v})(?![A-Za-z])", re.IGNORECASE)
    for k, v in _PARTS.items()
}
_HEAD = 1 << 20  # bytes that show the titles
_COUNT = re.compile(
    r"(no|nr|line|index|idx|row|sample|point|bin|#)?\W*$", re.IGNORECASE
)
_OF_FRF = re.compile(
    r"\b(FRF|H[12v]|frequency response|transfer function|accelerance|inertance|mobility|receptance"
    r"|compliance|frequenzgang|übertragungsfunktion)\b",
    re.IGNORECASE,
)
_X_UNIT = re.compile(
    r"\b(x|abscissa|freq\w*)\b.*?(?<![a-z])(k?Hz|rad/s|rpm)\b", re.IGNORECASE
)
_Y_UNIT = re.compile(
    r"\b(y|ordinate|amplitude)\b[\s\w-]*\bunits?\b\W*?[:=;,\t]\W*?(\S.*)", re.IGNORECASE
)
_END = r"[\w\s.]*?[\s\"']*[:=;\t][\s\"':=;]*([\w.:+-]+)"
_RESPONSE = re.compile(rf"\W*(?:response|output){_END}", re.IGNORECASE)
_REFERENCE = re.compile(rf"\W*(?:reference|input|excitation){_END}", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Layout:
    """The titles of the columns, how many columns of counts stand before them, and the rest."""

    titles: list[str]
    counts: int
    rows: list[str]
    delimiter: str
    comma: bool


def frf_titles(path: Path) -> list[str]:
    """Titles of the columns as `read_frf_columns` gives them, from the beginning of the file.

    Raises
    ------
    DataError
        If the file is empty or binary.
    """
    if (spectra := lvm_spectra(path)) is not None:
        return spectra[0]
    return _layout(path, _HEAD).titles


def read_frf_columns(path: Path) -> tuple[list[str], Float]:
    """Titles of the columns of a text, each with name, part and unit, and numbers (column, row).

    The rows above the numbers are known by what they hold: units, parts (`Real`, `Phase`) and
    names of FRFs, which count for the empty cells to their right. A column of counts is left out.
    Without a row of parts, a header that names an FRF, the unit of its axis and the parts gives the
    titles of one FRF. Titles are empty where there are none.

    Raises
    ------
    DataError
        If the file is empty, binary or has a cell that is no number.
    """
    if (spectra := lvm_spectra(path)) is not None:
        return spectra
    found = _layout(path, None)
    data = numbers(found.rows, found.delimiter, found.comma, path)
    return found.titles, np.ascontiguousarray(data[found.counts :])


def _layout(path: Path, most: int | None) -> _Layout:
    comments, lines, delimiter, comma = read_lines(path, most)
    width = len(split_cells(lines[-1], delimiter))
    top = header_rows(lines, delimiter, comma, width)
    head = lines[:top]
    above = [*(x.lstrip("#%/ ") for x in comments), *head]
    titles = _joined([_cells(x, delimiter, width) for x in above])
    if not _names_parts(titles):
        titles = _by_keys(above, lines[top:], delimiter) or titles
    if not titles:
        titles = column_titles([split_cells(x, delimiter) for x in head], width, path)
    counted = len(titles) > 1 and _COUNT.match(titles[0]) and FREQUENCY.match(titles[1])
    counts = 1 if counted else 0
    titles = _with_ends(titles[counts:], above)
    return _Layout(titles, counts, lines[top:], delimiter, comma)


def _names_parts(cells: Sequence[str]) -> bool:
    return any(pattern.search(c) for c in cells[1:] for pattern in PART.values())


def _cells(line: str, delimiter: str, width: int) -> list[str]:
    """The cells of a line of the header; none where they are not those of the columns."""
    ways = [split_cells(line, delimiter)]
    if delimiter == " ":
        ways = [re.split(r"\s{2,}|\t", line.strip()), line.split()]
    for cells in ways:
        found = [c.strip(' "') for c in cells]
        while len(found) > width and not found[-1]:
            found.pop()
        if len(found) > 2 and "" in found:  # names of groups may end with the last name
            found += [""] * (width - len(found))
        if len(found) == width > 2:
            return found
    return []


def _joined(rows: Sequence[list[str]]) -> list[str]:
    """A title for each column, of the last rows that fit: names, part, unit."""
    names: list[list[str]] = []
    units: list[str] = []
    for row in reversed(rows):
        if not row or (names and _names_parts(names[0]) and len(names) > 1):
            break
        bare = [unbracketed(c) for c in row]
        of_axis = bare[0].lower() in OF_FREQUENCY
        if not units and (of_axis or (any(bare[1:]) and all(map(_measures, bare[1:])))):
            units = bare
        elif _named(row, names):
            names.insert(0, row)
        else:
            break
    if not names:
        return []
    words = [
        _spread(row) if len(names) > 1 and not _names_parts(row) else row
        for row in names
    ]
    axis = next((row[0] for row in reversed(names) if FREQUENCY.match(row[0])), "")
    titles = [
        " ".join(dict.fromkeys(filter(None, column)))
        for column in zip(*words, strict=True)
    ]
    titles[0] = axis or names[-1][0] or ("Frequency" if units else "")
    if axis:  # each FRF may have its own
        own = [any(row[k] == axis for row in names) for k in range(len(titles))]
        titles = [
            axis if again else title for again, title in zip(own, titles, strict=True)
        ]
    if not units:
        return titles
    return [with_unit(title, unit) for title, unit in zip(titles, units, strict=True)]


def _measures(cell: str) -> bool:
    return is_unit(cell) or cell.lower().startswith("db")


def _named(row: Sequence[str], below: Sequence[Sequence[str]]) -> bool:
    """Whether a row of the header has titles: the lowest one, or one that distinguishes columns
    which the one below it does not.
    """
    if not below:
        return any(row)
    lowest = below[-1][1:]
    return any(row[1:]) and (len(set(lowest)) < len(lowest) or _names_parts(row))


def _spread(row: Sequence[str]) -> list[str]:
    """The name of each column: that of the last cell that is not empty."""
    out = ["" if row[1] else row[0]]
    for cell in row[1:]:
        out.append(cell or out[-1])
    return out


def _by_keys(head: Sequence[str], rows: Sequence[str], delimiter: str) -> list[str]:
    """The titles of one FRF whose header has keys alone; none where it does not say that it is
    one.
    """
    text = "\n".join(head)
    axis = next((m[2] for x in head if (m := _X_UNIT.search(x))), "")
    held = [
        k for k, pattern in PART.items() if k != "coherence" and pattern.search(text)
    ]
    parts = next(
        (p for p in (["re", "im"], ["size", "phase"]) if set(p) <= set(held)), []
    )
    if "complex" in text.lower():
        parts = ["re", "im"]
    width = len(split_cells(rows[-1], delimiter)) if rows else 0
    if not axis or not parts or not _OF_FRF.search(text) or width not in (3, 4):
        return []
    given = next((m[2].strip(' "\t;,') for x in head if (m := _Y_UNIT.search(x))), "")
    unit = f" [{unbracketed(given)}]" if given else ""
    words = {"re": "real", "im": "imag", "size": "magnitude", "phase": "phase"}
    first = words[parts[0]] + unit
    return [*["No"] * (width - 3), f"Frequency [{axis}]", first, words[parts[1]]]


def _with_ends(titles: list[str], head: Sequence[str]) -> list[str]:
    """The titles of one FRF without a name, with the response and reference that the header
    names.
    """
    parts = [t for t in titles[1:] if not FREQUENCY.match(t)]
    bare = [unbracketed(re.sub(r"[\[(].*", "", t)).lower() for t in parts]
    one = 0 < len(parts) < 4 and all(
        any(pattern.fullmatch(b) for pattern in PART.values()) for b in bare
    )
    response = next((m[1] for x in head if (m := _RESPONSE.match(x))), "")
    reference = next((m[1] for x in head if (m := _REFERENCE.match(x))), "")
    if not (one and response):
        return titles
    pair = f"{response}/{reference}" if reference else response
    return [
        titles[0],
        *(t if FREQUENCY.match(t) else f"{pair} {t}" for t in titles[1:]),
    ]
