"""What a file is, by its first bytes and lines: the one recogniser of all readers.

The name of a file counts only where its content leaves two answers: a text that says nothing of
itself and is called .bdf or .nas is a deck.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

from ringtrue.errors import DataError
from ringtrue.io.files import existing
from ringtrue.io.foreign.parsers import is_hdf5, open_hdf5
from ringtrue.model.cards import CARDS, SPECIAL


class Format(StrEnum):
    """The formats that readers know; the values are the words for users."""

    EMPTY = "an empty file"
    DECK = "a Nastran deck"
    OP2 = "OP2 of Nastran"
    OP4 = "OUTPUT4 of Nastran"
    F06 = "printed results (F06)"
    PUNCH = "a punch file of results"
    UFF = "a universal file"
    HDF5 = "HDF5"
    MATLAB = "a MATLAB file"
    NPY = "a NumPy array"
    NPZ = "an archive of NumPy arrays"
    XLSX = "an Excel workbook"
    WAVE = "WAVE sound"
    TDMS = "TDMS of National Instruments"
    LVM = "LabVIEW measurement text"
    JSON = "JSON"
    TOML = "TOML"
    MATRIX_MARKET = "a MatrixMarket file"
    HARWELL_BOEING = "a Harwell-Boeing file"
    TEXT = "text"


SOLVER_RESULTS = (Format.OP2, Format.F06, Format.PUNCH)

_HEAD = 1 << 16  # bytes that tell a format
_SIGNATURES = {
    b"\x93NUMPY": Format.NPY,
    b"\x89HDF\r\n\x1a\n": Format.HDF5,
    b"TDSm": Format.TDMS,
    b"TDSh": Format.TDMS,
    b"RIFF": Format.WAVE,
    b"RIFX": Format.WAVE,
    b"RF64": Format.WAVE,
}
_TAKERS = {  # of formats that hold one thing
    Format.DECK: "a deck; `ringtrue check` takes decks",
    **dict.fromkeys(
        SOLVER_RESULTS, "results of a solver; `ringtrue convert` takes them"
    ),
    Format.JSON: "modes or a log; `ringtrue correlate` takes modes",
    Format.TOML: "a study or a choice; `ringtrue run` takes studies",
    Format.NPZ: "arrays of NumPy, as FRFs; `ringtrue ema` takes FRFs",
}


def format_of(path: str | Path) -> Format:
    """The format of a file; at most 64 KB are read, and of HDF5 its first attributes.

    Raises
    ------
    DataError
        If there is no such file, or it is binary and of no format that is known.
    """
    path = existing(path)
    state = path.stat()
    return _format(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _format(path: Path, changed: int, size: int) -> Format:
    """The format of a file as it was when it was last `changed`: several readers ask for it."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        return Format.EMPTY
    found = _binary(head, path)
    if found is Format.HDF5 and _matlab_attributes(path):
        return Format.MATLAB
    if found is not None:
        return found
    if b"\x00" in head and head[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        looked_for = ", ".join(f for f in Format if f is not Format.EMPTY)
        raise DataError(
            f"{path}: has zero bytes; this is not a text file, and it begins with {head[:8]!r} as "
            f"no binary format that is known; looked for: {looked_for}"
        )
    text = head.decode(
        "utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1", "replace"
    )
    lines = text.removeprefix("\u00ef\u00bb\u00bf").splitlines()
    lines = lines if len(head) < _HEAD else lines[:-1]
    return _text(lines, path)


def refuse_format(path: Path, what: str, allowed: Sequence[Format]) -> NoReturn:
    """Say that a file holds something else than `what`, what it is, and which command takes it.

    Raises
    ------
    DataError
    """
    found = format_of(path)
    if found is Format.EMPTY:
        raise DataError(f"{path}: empty, no {what} in it")
    said = _TAKERS.get(found, f"this is {found}")
    raise DataError(f"{path}: no {what}: {said}; allowed are {', '.join(allowed)}")


def _binary(head: bytes, path: Path) -> Format | None:
    for start, kind in _SIGNATURES.items():
        if head.startswith(start):
            return kind
    if head.startswith(b"MATLAB") and b"MAT-file" in head[:40]:
        return Format.MATLAB
    if head.startswith(b"PK\x03\x04"):
        return _zipped(head)
    if _UFF.search(head):
        return Format.UFF
    for order in "<>":
        if (kind_of_record := _fortran(head, order)) is not None:
            return kind_of_record
        if _is_matlab_4(head, order):
            return Format.MATLAB
    return Format.HDF5 if is_hdf5(path) else None  # behind a block of the user


# a mark that opens a data set, its number, and more than the whole numbers of a column
_UFF = re.compile(
    rb"(?:^|[\r\n]) {0,5}-1[ \t\x00]*[\r\n]+ {0,6}\d{1,6}[bB]?(?:[ \t\x00][^\r\n]*)?(?:[\r\n]+|\Z)"
    rb"(?!(?:[ \t]*[-+]?\d+[ \t]*[\r\n]+){2})"
)


def _zipped(head: bytes) -> Format | None:
    """By the name of the first part."""
    size = int.from_bytes(head[26:28], "little")
    name = head[30 : 30 + size]
    if name.endswith(b".npy"):
        return Format.NPZ
    parts = (b"[Content_Types].xml", b"_rels/", b"docProps/", b"xl/")
    return Format.XLSX if name.startswith(parts) else None


def _fortran(head: bytes, order: str) -> Format | None:
    """By the length of the first Fortran record: a key of an OP2, or the head of a matrix."""
    (size,) = struct.unpack_from(f"{order}i", head.ljust(4, b"\0"))
    closing = head[4 + size : 8 + size] if size in (4, 8, 24, 48) else b""
    if closing != head[:4]:
        return None
    return Format.OP2 if size < 24 else Format.OP4


def _is_matlab_4(head: bytes, order: str) -> bool:
    """By the header of its first variable: type, rows, columns, complex, length of the name."""
    if len(head) < 21:
        return False
    kind, rows, columns, is_complex, name = struct.unpack_from(f"{order}5i", head)
    machine, rest = divmod(kind, 1000)
    types = range(60)  # precision and class: PT of MOPT, O being 0
    sizes = rows >= 0 and columns >= 0 and is_complex in (0, 1) and 1 < name <= 64
    text = head[20 : 19 + name] if sizes else b""
    return (
        0 <= machine <= 4
        and rest in types
        and sizes
        and re.fullmatch(rb"\w+", text) is not None
    )


def _matlab_attributes(path: Path) -> bool:
    """Whether MATLAB's attributes stand in an HDF5 file without its header."""
    try:
        with open_hdf5(path) as file:
            names = [name for item in file.values() for name in item.attrs]
    except DataError:
        return False  # its reader says what is damaged
    return "MATLAB_class" in names


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?")
_TABLE = re.compile(r"\[\[?\s*[\w\"'.\- ]+\s*\]?\]\s*(#.*)?$")
_KEY = re.compile(r"[\w\"'.\-]+\s*=\s*([\"'\[{+\-\d]|true\b|false\b|inf\b|nan\b)")
_JSON = re.compile(r"\{|\[[\s\[]*([{\"\d\-\]]|$|true\b|false\b|null\b)")
_MARKS = {  # of the text as a whole
    Format.LVM: re.compile(r"\A\s*LabVIEW"),
    Format.MATRIX_MARKET: re.compile(r"\A%%Matri"),
    # titles that are numbered in columns 73 to 80
    Format.PUNCH: re.compile(
        r"^\$(?:TITLE|SUBTITLE|LABEL|EIGENVALUE|EIGENVECTOR|DISPLACEMENTS)\b.{55,}\d[ ]*$",
        re.M,
    ),
    Format.F06: re.compile(
        r"^(?!\$).*(?:N A S T R A N|R E A L   E I G E N|D E S I G N   S E N S I|>> MYSTRAN"
        r"|C A S E    C O N T R O L|OUTPUT FOR EIGENVECTOR|MYSTRAN Version"
        r"|-----   DESIGN VARIABLES   -----)",
        re.M,
    ),
    Format.OP4: re.compile(
        r"\A[ \d-]{32}(?:[ \d-]{16})?[A-Za-z]\w{0,7} *(?:1P,?)?(?:\d+[ED]\d+\.\d+(?:\|I16)?)? *$",
        re.M,
    ),
    Format.HARWELL_BOEING: re.compile(
        r"\A.*\n(?: +\d+){4,5} *\n[RCPI][SUHZR][AE] +\d+ +\d+", re.IGNORECASE
    ),
}
_STATEMENT = re.compile(
    r"(SOL\s+\w+\s*$|CEND\s*$|BEGIN\s+(BULK|SUPER)|BEGIN\s*$|ENDDATA|INCLUDE\s+['\"])",
    re.IGNORECASE,
)
_CARD = re.compile(r"([A-Z][A-Z0-9]{2,7})\s?\*?(?=[\s,]|$)", re.IGNORECASE)


def _text(lines: Sequence[str], path: Path) -> Format:
    """The format of a text of which these are the first lines."""
    whole = "\n".join(lines)
    given = [x.strip() for x in lines if x.strip() and not x.lstrip().startswith("#")]
    first = given[0] if given else ""
    if not _has_samples(given):
        if _TABLE.match(first) or _KEY.match(first):
            return Format.TOML
        if _JSON.match(first):
            return Format.JSON
    for kind, mark in _MARKS.items():
        if mark.search(whole):
            return kind
    if _is_deck(lines) or path.suffix.lower() in (".bdf", ".nas"):
        return Format.DECK
    return Format.TEXT


def _has_samples(lines: Sequence[str]) -> bool:
    """Whether a line outside of brackets has two or more numbers and nothing else."""
    depth = 0
    for line in lines:
        words = re.split(r"[\s;,]+", line.strip("\t ;,"))
        if depth <= 0 and len(words) > 1 and all(map(_NUMBER.fullmatch, words)):
            return True
        depth += line.count("[") - line.count("]")
    return False


def _is_deck(lines: Sequence[str]) -> bool:
    """A statement of the executive control, or a card that is known and every second line named as
    one.
    """
    given = [x.strip() for x in lines if x.strip() and not x.startswith("$")][:200]
    if any(map(_STATEMENT.match, given)):
        return True
    begins = [x for x in given if not x.startswith(("+", "*", ",", "$"))]
    names = [found[1].upper() for x in begins if (found := _CARD.match(x))]
    known = any(name in CARDS or name in SPECIAL for name in names)
    return known and 2 * len(names) >= len(begins)
