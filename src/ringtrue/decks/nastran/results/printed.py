"""Modes as text: F06 of Nastran-like programs and MYSTRAN, and punch files."""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.decks.nastran.results.recorded import RecordedModes, gathered
from ringtrue.errors import DataError
from ringtrue.io.files import existing

_NUMBER = rb"[-+]?\d+\.\d*(?:E?[-+]\d+)?"
_VALUES = re.compile(rb"R E A L   E I G E N V A L U E S")
_VALUE_ROWS = re.compile(
    rb"^[ 0]?[ ]*(\d+)[ ]+\d+((?:[ ]+" + _NUMBER + rb"[*]?){5})[ ]*(?:\d+\.?)?[ ]*\r?$",
    re.M,
)
_VECTOR = re.compile(
    rb"R E A L   E I G E N V E C T O R   N O \.[ ]+(\d+)"
    rb"|^[ ]*OUTPUT FOR EIGENVECTOR[ ]+(\d+)[ ]*\r?$",
    re.M,
)
_ROWS_BEGIN = re.compile(
    rb"POINT ID\.[ ]+TYPE[^\n]*\n|GRID[ ]+COORD[^\n]*\n[^\n]*SYS[^\n]*\n"
)
_ROWS = re.compile(
    rb"(?:^[ 0]?[ ]*\d+[ ]+[A-Z0-9]+(?:[ ]+" + _NUMBER + rb")+[ ]*\r?\n)+", re.M
)
_ROW = re.compile(rb"^[ 0]?[ ]*(\d+)[ ]+([A-Z0-9]+)[ ]+([^\r\n]*)", re.M)
_STURM = re.compile(
    rb"CYCLES *= *(" + _NUMBER + rb") +NUMBER OF EIGENVALUES BELOW THIS VALUE *= *(\d+)"
)
_COMPLEX = re.compile(rb"C O M P L E X   E I G E N V E C T O R")
_FATAL = re.compile(
    rb"^.*(?:(?:USER|SYSTEM) FATAL MESSAGE|\*ERROR +(?:\d+|:)|FATAL ERROR|PROCESSING TERMINATED)"
    rb".*(?:\n.*){0,3}",
    re.M | re.I,
)
Bytes = bytes | mmap.mmap
_FATAL_WORDS = (b"FATAL", b"*ERROR", b"PROCESSING TERMINATED")
_PIECE = 1 << 20  # bytes that are looked through at once
# bytes from a title of a page to its rows, and of the lines behind a message, at most
_HEAD = 4000


def read_f06(path: str | Path) -> RecordedModes:
    """Modes of a printed file: the first subcase's eigenvectors with their eigenvalue table.

    Raises
    ------
    DataError
        If the file is missing or holds no printed real modes, or a number cannot be read.
    """
    path = existing(path)
    try:
        return _read(_mapped(path))
    except (ValueError, OverflowError) as e:  # DataError, too
        raise DataError(f"{path}: {e}") from e


def _mapped(path: Path) -> Bytes:
    """The bytes of a file without reading it whole: printed files of hundreds of MB are common."""
    if not path.is_file() or not path.stat().st_size:
        return b""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _read(data: Bytes) -> RecordedModes:
    pages = [(int(m[1] or m[2]), m.end()) for m in _VECTOR.finditer(data)]
    if not pages:
        why = (
            "its modes are complex"
            if _COMPLEX.search(data)
            else "ask for DISPLACEMENT(PRINT) = ALL"
        )
        raise DataError(f"no printed real eigenvectors: {why}")
    ends = [at for _, at in pages[1:]] + [len(data)]
    parts: dict[int, list[tuple[Int, Bool, Float]]] = {}
    last = 0
    for (mode, start), end in zip(pages, ends, strict=True):
        if mode < last:  # the next subcase
            break
        found = _page(data, start, end)
        if found is not None:
            parts.setdefault(mode, []).append(found)
        last = mode
    table = _eigenvalues(data, pages[0][1])
    lost = sorted(set(parts) - set(table))
    if lost or not parts:
        raise DataError(
            f"the eigenvalue table has no mode {lost[0] if lost else 1}: the file is cut off?"
        )
    lam, mass = np.array([table[k] for k in parts]).T
    rows = []
    for found_pages in parts.values():
        nodes, scalar, motion = (
            np.concatenate([p[k] for p in found_pages]) for k in range(3)
        )
        rows.append((nodes, scalar, motion))
    return gathered(lam, mass, rows)


def _page(data: Bytes, start: int, end: int) -> tuple[Int, Bool, Float] | None:
    begin = _ROWS_BEGIN.search(data, start, min(start + _HEAD, end))
    if begin is None:
        return None
    rows = _ROWS.match(data, begin.end(), end)
    if rows is None:
        return None
    nodes: list[int] = []
    scalar: list[bool] = []
    words: list[list[bytes]] = []
    # pages hold some fifty rows
    for point, kind, text in _ROW.findall(data, rows.start(), rows.end()):
        values = text.split()
        if kind == b"S":  # consecutive scalar points side by side
            nodes += [int(point) + k for k in range(len(values))]
            scalar += [True] * len(values)
            words += [[v, *[b"0"] * 5] for v in values]
        elif len(values) == 6 and (kind == b"G" or kind.isdigit()):
            nodes.append(int(point))
            scalar.append(False)
            words.append(values)
    return (
        np.array(nodes, dtype=np.int64),
        np.array(scalar, dtype=np.bool_),
        _floats(words),
    )


def _floats(words: list[list[bytes]]) -> Float:
    text = np.array(words, dtype=np.bytes_).reshape(-1, 6)
    try:
        return text.astype(np.float64)
    except ValueError:
        return np.array([_real(word) for row in words for word in row]).reshape(-1, 6)


def _eigenvalues(data: Bytes, before: int) -> dict[int, tuple[float, float]]:
    """λ and modal mass by mode of the last table in front of the eigenvectors (continued over
    pages).
    """
    found: dict[int, tuple[float, float]] = {}
    heads = [m.end() for m in _VALUES.finditer(data, 0, before)]
    for start, end in zip(heads, heads[1:] + [before] * bool(heads), strict=True):
        rows: dict[int, tuple[float, float]] = {}
        for m in _VALUE_ROWS.finditer(data, start, end):
            if rows and int(m[1]) != max(rows) + 1:
                break
            numbers = [_real(x) for x in m[2].split()]
            rows[int(m[1])] = (numbers[0], numbers[3])
        found = {**found, **rows} if rows and min(rows) > 1 else rows or found
    return found


def _real(text: bytes) -> float:
    try:
        return float(text.rstrip(b"*"))  # MYSTRAN marks negative ones
    except ValueError:  # an exponent of three digits stands without its E
        return float(re.sub(rb"(?<=[\d.])([-+]\d)", rb"E\1", text))


def sturm_counts(path: str | Path) -> tuple[tuple[float, int], ...]:
    """Trial frequencies (Hz) and the number of modes below each, as Nastran's Lanczos method
    counted them; () if there is no file.
    """
    found = _STURM.finditer(_mapped(Path(path)))
    return tuple(sorted((_real(m[1]), int(m[2])) for m in found))


def fatal_messages(path: str | Path) -> tuple[str, ...]:
    """The first five fatal messages of a printed file, with the lines that follow each; () if there
    are none or no file.
    """
    data = _mapped(Path(path))
    out: list[str] = []
    start = 0
    while start < len(data) and len(out) < 5:
        end = data.find(b"\n", start + _PIECE) + 1 or len(data)
        piece = data[start : end + _HEAD]  # with the lines that follow the last one
        upper = piece.upper()
        # only pieces that hold one of the words are looked through line by line
        if any(word in upper for word in _FATAL_WORDS):
            for found in _FATAL.finditer(piece):
                if found.start() < end - start:
                    lines = map(str.strip, found[0].decode("latin-1").splitlines())
                    out.append("\n".join(filter(None, lines)))
        start = end
    return tuple(out[:5])


_EIGENVALUE = re.compile(r"\$EIGENVALUE *= *(\S+) +MODE *= *(\d+)")
_SECTION = re.compile(
    r"\$(EIGENVECTOR|DISPLACEMENTS|SPCF|MPCF|OLOADS|ELEMENT|VELOCITY|ACCELERATION)",
    re.I,
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
            values,
            np.full(values.size, np.nan),
            [_points(rows) for _, _, rows in found],
        )
    except ValueError as e:
        raise DataError(f"{path}: {e}") from e


def _modes(lines: Iterator[str]) -> Iterator[tuple[int, float, list[str]]]:
    """Number, eigenvalue and data lines of each mode of the first subcase."""
    rows: list[str] = []
    mode = 0
    value = 0.0
    inside = False
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
            mode = int(here[2])
            value = float(here[1])
    if rows:
        yield mode, value, rows


def _points(rows: list[str]) -> tuple[Int, Bool, Float]:
    first = rows[::2]
    second = rows[1::2]
    if len(first) != len(second) or any(r[:6] != "-CONT-" for r in second):
        raise DataError("a point without its second line: the file is cut off?")
    head = np.array([(r[:10], r[10:18].strip()) for r in first])
    cells = [
        line[at : at + 18].strip() or "0"
        for pair in zip(first, second, strict=True)
        for line in pair
        for at in (18, 36, 54)
    ]
    motion = np.array([float(cell) for cell in cells]).reshape(-1, 6)
    scalar = head[:, 1] == "S"
    motion[scalar, 1:] = 0.0
    keep = scalar | (head[:, 1] == "G")
    return head[keep, 0].astype(np.int64), scalar[keep], motion[keep]
