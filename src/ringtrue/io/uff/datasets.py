"""Universal files: their data sets, and the fields of fixed width in a line."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DataError
from ringtrue.io.files import existing

_D = bytes.maketrans(b"Dd", b"Ee")
_TOUCHING = re.compile(rb"(?<=\d)(?=[+-]\d?\.)")
# 1.00000-101: Fortran drops the letter before 3 digits
_NO_LETTER = re.compile(r"^([+-]?[\d.]+)([+-]\d+)$")


def parse_real(text: str) -> float:
    """A Fortran real; an empty field is 0.

    Raises
    ------
    DataError
        If it is no number.
    """
    text = text.strip().replace("D", "E").replace("d", "e")
    try:
        return float(_NO_LETTER.sub(r"\1E\2", text)) if text else 0.0
    except ValueError as exc:
        raise DataError(f"{text!r} is not a number") from exc


def parse_int(text: str) -> int:
    """A Fortran integer; an empty field is 0."""
    value = parse_real(text)
    if not abs(value) < 2**62:
        raise DataError(f"{text.strip()!r} is not an integer")
    return int(value)


def reals(text: bytes, widths: Sequence[int], count: int) -> Float:
    """(count,) float64 numbers of a body of lines.

    Parameters
    ----------
    text : bytes
    widths : sequence of int
        Columns of the fields of a line, used where the numbers touch each other.
    count : int
        Numbers expected; more are cut off (vendors fill the last line).

    Raises
    ------
    DataError
        If there are fewer, or a field is no number.
    """
    text = text.replace(b"\x00", b" ").translate(_D)
    per_line = len(widths)
    for tried in (text, _TOUCHING.sub(b" ", text)):
        values = _free(tried)
        if values is not None and count <= values.size <= count + per_line:
            return values[:count]
    lines = text.decode("latin-1").splitlines()
    # a loop over fields: only files whose columns touch come here, 1 µs a field
    values = np.array(
        [parse_real(x) for line in lines for x in words(line, widths) if x], float
    )
    if values.size < count:
        raise DataError(
            f"{values.size} numbers where {count} are announced; the file is cut or damaged"
        )
    return values[:count]


def _free(text: bytes) -> Float | None:
    with warnings.catch_warnings():
        # NumPy's way to say that it stopped before the end
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def numbers(line: str, widths: Sequence[int]) -> list[float]:
    """The numbers of one line by its columns, or by blanks where there are as many words as
    columns.
    """
    free = line.split()
    return [
        parse_real(x)
        for x in (free if len(free) == len(widths) else words(line, widths))
    ]


def integers(lines: Sequence[str], width: int = 10) -> Int:
    """(n,) int64 integers of lines of equal columns, or divided by blanks."""
    words = " ".join(lines).split()
    if any(len(w.lstrip("+-")) > width - 1 for w in words):
        words = [
            x[a : a + width] for x in lines for a in range(0, len(x.rstrip()), width)
        ]
    return np.array([parse_int(w) for w in words], dtype=np.int64)


def words(line: str, widths: Sequence[int]) -> list[str]:
    """The columns of a line, stripped."""
    ends = np.cumsum(widths).tolist()
    return [line[a:b].strip() for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def row(lines: Sequence[str], at: int) -> str:
    """Line `at`.

    Raises
    ------
    DataError
        If the data set ends before it.
    """
    if not 0 <= at < len(lines):
        raise DataError(
            f"ends after {len(lines)} lines; line {at + 1} is missing: the file is cut or damaged"
        )
    return lines[at]


_USUAL = b"    -1"
_MARK = re.compile(rb"(?:^|(?<=[\r\n])) {0,5}-1[ \t\x00]*(?=[\r\n]|\Z)")
_END = re.compile(rb"[\r\n]{0,2} {4}-1[ \t]*(?=[\r\n]|\Z)")
LINE = re.compile(rb"\r\n|\n|\r")
_FORM = 6  # the line of it with type of ordinates, points, spacing


@dataclass(frozen=True, slots=True)
class DataSet:
    """One data set.

    Attributes
    ----------
    kind : int
        Number of the data set; 58 for 58b too.
    text : bytes
        The lines after the one with the number; of a 58b those of its header.
    binary : bytes or None
        Samples of a 58b.
    big_endian : bool
        Byte order of `binary`.
    at : int
        First byte in the file.
    """

    kind: int
    text: bytes
    binary: bytes | None = None
    big_endian: bool = False
    at: int = 0

    def lines(self) -> list[str]:
        """The lines of the text, without their ends; empty ones at the end are dropped."""
        rows = [x.rstrip(b"\x00").decode("latin-1") for x in LINE.split(self.text)]
        while rows and not rows[-1].strip():
            rows.pop()
        return rows


def scan(path: str | Path) -> tuple[DataSet, ...]:
    """All data sets of a universal file, in its order.

    Raises
    ------
    DataError
        If there is no such file or no data set in it, or a binary one has a form that IEEE machines
        do not write.
    """
    path = existing(path)
    blocks = tuple(_blocks(path.read_bytes(), path))
    if not blocks:
        raise DataError(
            f"{path}: not a readable universal file: no data set between lines of `    -1`"
        )
    return blocks


def _blocks(raw: bytes, path: Path) -> Iterator[DataSet]:
    at = 0
    usual = _find(raw, 0, True) is not None
    while mark := _find(raw, at, usual):
        start = _next_line(raw, mark.end())
        end = _next_line(raw, start)
        first = raw[start:end].split()
        kind = re.fullmatch(rb"(\d{1,6})([bB]?)", first[0]) if first else None
        if kind is None:
            at = mark.end()  # two marks in a row, or text between the data sets
            continue
        binary = bool(kind[2]) or (len(first) > 1 and first[1] in (b"b", b"B"))
        if binary:
            block, at = _binary(raw, start, end, path)
            yield block
            continue
        close = _find(raw, end, usual)
        stop = close.start() if close else len(raw)
        yield DataSet(int(kind[1]), raw[end:stop], at=start)
        at = close.end() if close else len(raw)


def _find(raw: bytes, at: int, usual: bool) -> re.Match[bytes] | None:
    """The next line that is a mark; the search for its usual form is 20 times as fast as that for
    any.
    """
    if not usual:
        return _MARK.search(raw, at)
    while (at := raw.find(_USUAL, at)) >= 0:
        start = at - 1 if raw[at - 1 : at] == b" " else at
        if mark := _MARK.match(raw, start):
            return mark
        at += len(_USUAL)
    return None


def _next_line(raw: bytes, at: int) -> int:
    end = LINE.search(raw, at)
    return end.end() if end else len(raw)


def _binary(raw: bytes, start: int, end: int, path: Path) -> tuple[DataSet, int]:
    """A 58b and the place after it; a wrong count of bytes is replaced by that of its points, or
    the next mark.
    """
    fields = re.findall(
        rb"\d{1,18}", raw[start:end].replace(b"b", b" ").replace(b"B", b" ")
    )
    order, form = (int(x) for x in (*fields[1:3], b"1", b"2")[:2])
    if form != 2:
        raise DataError(
            f"{path}: binary data set 58 in floating point format {form}; only IEEE (2) can be read"
        )
    body = end
    for _ in range(11):  # of the header of data set 58
        body = _next_line(raw, body)
    counts = [int(fields[4]) if len(fields) > 4 else 0, *_counts(raw[end:body])]
    closings = (
        (n, _END.match(raw, body + n)) for n in counts if 0 < n <= len(raw) - body
    )
    count, close = next(((n, m) for n, m in closings if m), (0, None))
    if close is None:
        close = next(
            (m for m in _END.finditer(raw, body) if _opens(raw, m.end())), None
        )
        count = (close.start() if close else len(raw)) - body
    block = DataSet(58, raw[end:body], raw[body : body + count], order == 2, start)
    return block, close.end() if close else len(raw)


def _counts(header: bytes) -> list[int]:
    """Bytes of samples that the header announces; an uneven abscissa is single or double."""
    rows = header.splitlines()
    form = rows[_FORM].split()[:3] if len(rows) > _FORM else []
    if len(form) < 3 or not all(f.isdigit() and len(f) < 19 for f in form):
        return []
    ordinate, points, even = (int(f) for f in form)
    size = 8 if ordinate in (4, 6) else 4  # double
    per_point = 2 if ordinate in (5, 6) else 1  # complex
    return [points * (per_point * size + x) for x in ([0] if even else [4, 8])]


def _opens(raw: bytes, at: int) -> bool:
    """After a closing mark there is nothing, or the next opening one."""
    rest = raw[at : at + 200].lstrip(b"\r\n\t\x00")
    return not rest.strip() or _MARK.match(rest) is not None
