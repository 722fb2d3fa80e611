"""Numbers of the text of universal files: free columns, fixed columns without blanks, D
exponents.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DataError

_D = bytes.maketrans(b"Dd", b"Ee")
_TOUCHING = re.compile(rb"(?<=\d)(?=[+-]\d?\.)")
_NO_LETTER = re.compile(
    r"^([+-]?[\d.]+)([+-]\d+)$"
)  # 1.00000-101: Fortran drops the letter before 3 digits


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
    values = _free(text)
    if values is None or not _fits(values.size, count, len(widths)):
        values = _free(_TOUCHING.sub(b" ", text))
    if values is None or not _fits(values.size, count, len(widths)):
        values = _fixed(text, widths)
    if values.size < count:
        raise DataError(
            f"{values.size} numbers where {count} are announced; the file is cut or damaged"
        )
    return values[:count]


def _fits(size: int, count: int, per_line: int) -> bool:
    return count <= size <= count + per_line


def _free(text: bytes) -> Float | None:
    with warnings.catch_warnings():
        warnings.simplefilter(
            "error", DeprecationWarning
        )  # NumPy's way to say that it stopped before the end
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def _fixed(text: bytes, widths: Sequence[int]) -> Float:
    ends = np.cumsum(widths).tolist()
    bounds = list(zip([0, *ends[:-1]], ends, strict=True))
    lines = text.decode("latin-1").splitlines()
    # a loop over fields: only files whose columns touch come here, 1 µs a field
    return np.array(
        [parse_real(x[a:b]) for x in lines for a, b in bounds if x[a:b].strip()], dtype=np.float64
    )


def numbers(line: str, widths: Sequence[int]) -> list[float]:
    """The numbers of one line by its columns, or by blanks where there are as many words as
    columns.
    """
    words = line.split()
    if len(words) == len(widths):
        return [parse_real(x) for x in words]
    ends = np.cumsum(widths).tolist()
    return [parse_real(line[a:b]) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def integers(lines: Sequence[str], width: int = 10) -> Int:
    """(n,) int64 integers of lines of equal columns, or divided by blanks."""
    words = " ".join(lines).split()
    if any(len(w.lstrip("+-")) > width - 1 for w in words):
        words = [x[a : a + width] for x in lines for a in range(0, len(x.rstrip()), width)]
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
