"""The data sets of a universal file: where each begins and ends, text or binary (58b), whatever the
line ends are.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ringtrue.errors import DataError
from ringtrue.io.files import existing

_USUAL = b"    -1"
_MARK = re.compile(rb"(?:^|(?<=[\r\n])) {0,5}-1[ \t\x00]*(?=[\r\n]|\Z)")
_END = re.compile(rb"[\r\n]{0,2} {4}-1[ \t]*(?=[\r\n]|\Z)")
LINE = re.compile(rb"\r\n|\n|\r")
_ASCII_LINES = 11  # of the header of data set 58
_FORM = 6  # the line of it with type of ordinates, points, spacing
_DOUBLE, _COMPLEX = (4, 6), (5, 6)


@dataclass(frozen=True, slots=True)
class Block:
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


def scan(path: str | Path) -> tuple[Block, ...]:
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


def _blocks(raw: bytes, path: Path) -> Iterator[Block]:
    at, usual = 0, _find(raw, 0, True) is not None
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
        yield Block(int(kind[1]), raw[end:stop], at=start)
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


def _binary(raw: bytes, start: int, end: int, path: Path) -> tuple[Block, int]:
    """A 58b and the place after it; a wrong count of bytes is replaced by that of its points, or
    the next mark.
    """
    fields = re.findall(rb"\d{1,18}", raw[start:end].replace(b"b", b" ").replace(b"B", b" "))
    order, form = (int(x) for x in (*fields[1:3], b"1", b"2")[:2])
    if form != 2:
        raise DataError(
            f"{path}: binary data set 58 in floating point format {form}; only IEEE (2) can be read"
        )
    body = end
    for _ in range(_ASCII_LINES):
        body = _next_line(raw, body)
    counts = [int(fields[4]) if len(fields) > 4 else 0, *_counts(raw[end:body])]
    closings = ((n, _END.match(raw, body + n)) for n in counts if 0 < n <= len(raw) - body)
    count, close = next(((n, m) for n, m in closings if m), (0, None))
    if close is None:
        close = next((m for m in _END.finditer(raw, body) if _opens(raw, m.end())), None)
        count = (close.start() if close else len(raw)) - body
    block = Block(58, raw[end:body], raw[body : body + count], order == 2, start)
    return block, close.end() if close else len(raw)


def _counts(header: bytes) -> list[int]:
    """Bytes of samples that the header announces; an uneven abscissa is single or double."""
    rows = header.splitlines()
    form = rows[_FORM].split()[:3] if len(rows) > _FORM else []
    if len(form) < 3 or not all(f.isdigit() and len(f) < 19 for f in form):
        return []
    ordinate, points, even = (int(f) for f in form)
    size, per_point = 8 if ordinate in _DOUBLE else 4, 2 if ordinate in _COMPLEX else 1
    return [points * (per_point * size + x) for x in ([0] if even else [4, 8])]


def _opens(raw: bytes, at: int) -> bool:
    """After a closing mark there is nothing, or the next opening one."""
    rest = raw[at : at + 200].lstrip(b"\r\n\t\x00")
    return not rest.strip() or _MARK.match(rest) is not None
