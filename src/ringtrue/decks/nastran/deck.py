"""The lines of a deck with those that it includes; decks of other programs are refused."""

from __future__ import annotations

import itertools
import logging
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.errors import DeckError
from ringtrue.io.files import absence, reads

log = logging.getLogger(__name__)
_INCLUDE = re.compile(
    rb"(?i)[ \t]*INCLUDE(?=[ \t'\"])[ \t]*(?:'([^']*)'|\"([^\"]*)\"|([^\s$'\"][^\r\n$]*))[^\n]*\n?"
)
_BEGIN = re.compile(rb"(?i)[ \t]*BEGIN\w*[^\r\n$]*")
_SUPER = re.compile(rb"\bSUPER[ \t]*=?[ \t]*(\d{1,9})[ \t]*$")
_CEND = re.compile(rb"(?i)[ \t]*CEND\b")
WIDTH = 80


@dataclass(frozen=True, slots=True)
class IncludeLimits:
    """How far files may include others.

    Attributes
    ----------
    depth : int
        Files that include each other.
    count : int
        Of a deck; files that each include the next one twice are 2 ** depth.
    again : int
        Bytes of files that were included before.
    """

    depth: int = 64
    count: int = 10_000
    again: int = 100_000_000


LIMITS = IncludeLimits()


@dataclass(frozen=True, slots=True)
class _Piece:
    file: int
    first_line: int
    data: memoryview


@dataclass(frozen=True, slots=True, eq=False)
class Deck:
    """The joined lines of a deck.

    Attributes
    ----------
    files : tuple of str
        Absolute paths in reading order, the main deck first.
    top : tuple of str
        Executive and case control lines.
    raw : bytes
        Everything read, every line ended by a newline, `WIDTH` blanks at the end.
    start, stop : (n,) int64
        Range in `raw` of the bulk data lines, comments and line ends left out.
    file, line : (n,) int64
        Where each line stands; lines count from 1.
    parts : mapping of int to Deck
        The bulk data behind each BEGIN SUPER=n, by n.
    unread : (file, line) of the first BEGIN AUXMODEL, or BEGIN SUPER without a number, None without
        one
    """

    files: tuple[str, ...]
    top: tuple[str, ...]
    raw: bytes
    start: Int
    stop: Int
    file: Int
    line: Int
    parts: Mapping[int, Deck] = field(default_factory=dict)
    unread: tuple[int, int] | None = None

    def joined(self) -> Deck:
        """All bulk data lines as one in the order of the files; `parts` stay as they are."""
        every = [self, *self.parts.values()]
        lines = {
            name: np.concatenate([getattr(d, name) for d in every])
            for name in ("start", "stop", "file", "line")
        }
        order = np.argsort(lines["start"], kind="stable")
        return replace(self, **{n: v[order] for n, v in lines.items()})  # type: ignore[arg-type]


class _Reading:
    """Files met while includes are followed."""

    def __init__(self, main: Path) -> None:
        self.main = main.resolve()
        self.files: dict[Path, int] = {}
        self.pieces: list[_Piece] = []
        self.left_out: list[
            str
        ] = []  # why, for each include of the executive control that is not there
        self.includes = 0
        self.again = 0  # bytes of files that are read another time

    def read(self, path: Path, chain: tuple[Path, ...] = ()) -> bool:
        """Append the pieces of a file; True once ENDDATA is met."""
        data = _text(path)
        number = self.files.setdefault(path, len(self.files))
        upper = data.upper()
        # Ctrl-Z ended files of DOS
        limit = next(_lines_of(upper, b"ENDDATA"), len(data.rstrip(b"\x1a")))
        at = 0
        for begin in _lines_of(upper, b"INCLUDE", limit):
            found = _INCLUDE.match(data, begin, limit)
            if begin < at or not found:
                continue
            self._add(number, data, at, begin)
            line = data.count(b"\n", 0, begin) + 1
            at = found.end()
            try:
                child = self._locate(
                    next(g for g in found.groups() if g is not None), path, line
                )
            except DeckError as wrong:
                if not any(_lines_of(upper, b"CEND", after=at)):
                    raise
                self.left_out.append(str(wrong))
                continue
            self._bound(child, (*chain, path), line)
            if self.read(child, (*chain, path)):
                return True
        self._add(number, data, at, limit)
        return limit < len(data.rstrip(b"\x1a"))

    def _bound(self, child: Path, chain: tuple[Path, ...], line: int) -> None:
        """Refuse a file that includes itself, and includes that would never end or fill the
        memory.
        """
        path = chain[-1]
        self.includes += 1
        if child in self.files:
            self.again += child.stat().st_size
        why = ""
        if child in chain:
            why = f"{child} includes itself"
        elif len(chain) > LIMITS.depth:
            why = f"files include each other more than {LIMITS.depth} deep"
        elif self.includes > LIMITS.count:
            why = (
                f"the deck has more than {LIMITS.count} INCLUDEs: do its files include each other "
                "again and again?"
            )
        elif self.again > LIMITS.again:
            why = (
                f"files that were included before make more than {LIMITS.again / 1e6:g} MB: "
                "include each once"
            )
        if why:
            raise DeckError(why, path=path, line=line, card="INCLUDE")

    def _add(self, number: int, data: bytes, a: int, b: int) -> None:
        if b > a:
            line = data.count(b"\n", 0, a) + 1
            self.pieces.append(_Piece(number, line, memoryview(data)[a:b]))
            if data[b - 1] != 10:
                self.pieces.append(
                    _Piece(number, line + data.count(b"\n", a, b), memoryview(b"\n"))
                )

    def _locate(self, quoted: bytes, path: Path, line: int) -> Path:
        names = [Path(n) for n in _spellings(quoted)]
        tried = [
            folder / name
            for name in names
            for folder in (path.parent, self.main.parent)
        ]
        in_any_case = (there for t in tried if (there := any_case(t)))
        for candidate in itertools.chain(tried, in_any_case):
            if candidate.is_file():
                return candidate.resolve()
        places = ", ".join(dict.fromkeys(str(t) for t in tried))
        raise DeckError(
            f"the included file is not there; looked for {places}",
            path=path,
            line=line,
            card="INCLUDE",
        )


def any_case(path: Path) -> Path | None:
    """The one file of this name in any case, as decks of Windows may name it; None without one or
    with several.
    """
    found = [Path(path.anchor or ".")]
    for part in path.parts[bool(path.anchor) :]:
        inside = [f / part for f in found] if part == ".." else []
        found = inside or [
            e
            for f in found
            if f.is_dir()
            for e in f.iterdir()
            if e.name.lower() == part.lower()
        ]
    return found[0] if len(found) == 1 else None


def _spellings(quoted: bytes) -> list[str]:
    """What a name may be that is broken over lines: put together as it is, or with one blank where
    it was broken.
    """
    parts = [
        part.strip().decode("utf-8", "surrogateescape") for part in quoted.splitlines()
    ]
    names = [glue.join(parts).strip().replace("\\", "/") for glue in ("", " ")]
    return list(
        dict.fromkeys(
            spelling for name in names for spelling in (name, *_by_logical_name(name))
        )
    )


def _by_logical_name(name: str) -> list[str]:
    """`SYMBOL:file` by the environment variable SYMBOL, as Nastran takes it, and the file next to
    the deck.
    """
    symbol, colon, rest = name.partition(":")
    if not colon or not re.fullmatch(r"[A-Za-z_]\w+", symbol):  # one letter is a drive
        return []
    folder = os.environ.get(symbol) or os.environ.get(symbol.upper())
    return [*([f"{folder}/{rest}"] if folder else []), rest]


def _text(path: Path) -> bytes:
    """The bytes of a file, without the mark that some editors put before UTF-8."""
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise DeckError("the file is UTF-16; save it as plain text", path=path)
    if b"\n" not in data and b"\r" in data.rstrip(b"\r"):
        raise DeckError(
            "its lines end with CR alone; save it with LF or CR LF", path=path
        )
    return data.removeprefix(b"\xef\xbb\xbf")


def load(path: str | Path) -> Deck:
    """Read a deck with all its includes.

    Raises
    ------
    DeckError
        If the deck or an included file is not there, no plain text or of another program, or a file
        includes itself.
    """
    path = Path(path)
    if not path.is_file():
        raise DeckError(absence(path), path=path)
    with path.open("rb") as opened:
        program = other_program(opened.read(65_536))  # its first lines say it
    if program:
        raise DeckError(
            f"this is a deck of {program}; ringtrue reads decks of Nastran: convert it",
            path=path,
        )
    reading = _Reading(path)
    reading.read(reading.main)
    reads(*reading.files)
    if lost := reading.left_out:
        more = f" ({len(lost) - 1} more like it)" if len(lost) > 1 else ""
        log.warning(
            "%s%s; left out, as the executive control above CEND changes no model",
            lost[0],
            more,
        )
    raw = b"".join([*(p.data for p in reading.pieces), b" " * WIDTH])
    start, stop, file, line = _lines(reading.pieces, raw)
    sections = _sections(raw, start, path)
    first = sections[0].first
    top = (
        tuple(
            raw[a:b].decode("latin-1")
            for a, b in zip(start[:first], stop[:first], strict=True)
        )
        if first
        else ()
    )
    stop = _without_comments(raw, start, stop)
    unread = next((s.first - 1 for s in sections if s.number < 0), None)
    lines = np.arange(start.size)
    parts: dict[int, Deck] = {}
    for section in sections:
        used = lines[section.first : section.last]
        made = Deck(
            files=tuple(str(f) for f in reading.files),
            top=top[:-1],
            raw=raw,
            start=start[used],
            stop=stop[used],
            file=file[used],
            line=line[used],
        )
        if section.number in parts:
            raise DeckError(
                f"superelement {section.number} begins twice",
                path=reading.main,
                line=int(line[section.first - 1]),
                card="BEGIN SUPER",
            )
        parts[section.number] = made
    main = parts.pop(0)
    parts.pop(-1, None)
    place = None if unread is None else (int(file[unread]), int(line[unread]))
    return replace(main, parts=parts, unread=place)


def _lines_of(
    upper: bytes, word: bytes, stop: int | None = None, after: int = 0
) -> Iterator[int]:
    """Where the lines begin that have nothing but blanks before `word`; a plain search is fast in
    large decks.
    """
    at = upper.find(word, after, stop)
    while at >= 0:
        begin = upper.rfind(b"\n", 0, at) + 1
        if not upper[begin:at].strip(b" \t"):
            yield begin
        at = upper.find(word, at + len(word), stop)


def _lines(pieces: list[_Piece], raw: bytes) -> tuple[Int, Int, Int, Int]:
    ends = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) == 10).astype(np.int64)
    start = (
        np.concatenate([[0], ends[:-1] + 1])
        if ends.size
        else np.empty(0, dtype=np.int64)
    )
    edges = np.cumsum([0, *(len(p.data) for p in pieces)])
    count = np.diff(np.searchsorted(ends, edges))
    file = np.repeat(np.array([p.file for p in pieces], dtype=np.int64), count)
    line = np.repeat(
        np.array([p.first_line for p in pieces], dtype=np.int64)
        - (np.cumsum(count) - count),
        count,
    )
    line = line + np.arange(ends.size)
    data = np.frombuffer(raw, dtype=np.uint8)
    return start, ends - ((ends > start) & (data[ends - 1] == 13)), file, line


@dataclass(frozen=True, slots=True)
class _Section:
    """Bulk data lines of the main deck (0), of a superelement, or of what is not read (-1)."""

    number: int
    first: int
    last: int


def _sections(raw: bytes, start: Int, path: Path) -> list[_Section]:
    """The sections of bulk data, the main one first."""
    upper = raw.upper()
    found = ((at, _BEGIN.match(upper, at)) for at in _lines_of(upper, b"BEGIN"))
    begins = [
        (int(np.searchsorted(start, at)), m.group().rstrip()) for at, m in found if m
    ]
    others = [(at, text) for at, text in begins if re.search(rb"\bSUPER|\bAUX", text)]
    mains = [at for at, text in begins if re.search(rb"\bBULK\b|BEGIN\s*$", text)]
    mains = [at for at in mains if at not in dict(others)]
    if not mains and any(_CEND.match(upper, at) for at in _lines_of(upper, b"CEND")):
        raise DeckError("the deck has CEND but no BEGIN BULK", path=path)
    first = mains[0] + 1 if mains else 0
    ends = [*(at for at, _ in others), start.size]
    out = [_Section(0, first, ends[0])]
    for (at, text), end in zip(others, ends[1:], strict=True):
        number = _SUPER.search(text)
        out.append(_Section(int(number[1]) if number else -1, at + 1, end))
        if out[-1].number < 0:  # what stands behind it belongs to nothing that is read
            break
    return out


def _without_comments(raw: bytes, start: Int, stop: Int) -> Int:
    dollars = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) == 36).astype(np.int64)
    if not dollars.size:
        return stop
    row, first = np.unique(
        np.searchsorted(start, dollars, side="right") - 1, return_index=True
    )
    out = stop.copy()
    out[row] = np.minimum(out[row], dollars[first])
    return out


_KEYWORD = re.compile(rb"\*([A-Z][A-Z0-9_ ]*)")
_ABAQUS = frozenset(
    b"AMPLITUDE ASSEMBLY BEAM BOUNDARY DENSITY ELASTIC ELEMENT ELSET END HEADING INCLUDE "
    b"INSTANCE MATERIAL NODE NSET "
    b"ORIENTATION PARAMETER PART PREPRINT RESTART SHELL SOLID STEP SURFACE SYSTEM".split()
)
_ANSYS = re.compile(
    rb"(/(BATCH|CLEAR|CLE|COM|CONFIG|FILNAME|FILNAM|GO|GOPR|INPUT|NERR|NOPR|OUTPUT|PREP7|SOLU|TITLE|UIS|UNITS)\b"
    rb"|FINI(SH)?\b|(ANTYPE|ET|EBLOCK|MP|MPTEMP|NBLOCK|SECTYPE)\s*,)"
)


def other_program(data: bytes) -> str:
    """The program that a deck, of which these are the first bytes, is of; "" where it may be
    Nastran's.

    A line that begins with an asterisk continues a card of Nastran, so that none can come first.

    >>> other_program(b"** a frame\\n*Heading\\n*Node\\n1, 0., 0., 0.\\n")
    'Abaqus or CalculiX'
    >>> other_program(b"*KEYWORD\\n*NODE\\n")
    'LS-Dyna'
    >>> other_program(b"! a frame\\n/PREP7\\nET,1,SHELL181\\n")
    'Ansys'
    >>> other_program(b"SOL 103\\nCEND\\nBEGIN BULK\\n")
    ''
    """
    lines = [line.strip() for line in data.upper().splitlines()]
    lines = [
        line for line in lines if line and not line.startswith((b"$", b"**", b"!"))
    ]
    if not lines:
        return ""
    keywords = [found[1].strip() for line in lines if (found := _KEYWORD.match(line))]
    if lines[0].startswith(b"*") and keywords:
        if b"KEYWORD" in keywords or any(b"_" in k for k in keywords):
            return "LS-Dyna"
        return "Abaqus or CalculiX" if keywords[0].split()[0] in _ABAQUS else ""
    return "Ansys" if _ANSYS.match(lines[0]) else ""
