"""A deck as lines: its files and includes joined, sections told apart, lines gathered into logical cards."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Int
from ringtrue.errors import DeckError

log = logging.getLogger(__name__)
_INCLUDE = re.compile(rb"(?im)^[ \t]*INCLUDE(?=[ \t'\"])[ \t]*(?:'([^']*)'|\"([^\"]*)\"|([^\s$'\"][^\r\n$]*))[^\n]*\n?")
_ENDDATA = re.compile(rb"(?im)^[ \t]*ENDDATA[^\r\n]*")
_BEGIN = re.compile(rb"(?im)^[ \t]*BEGIN\b[^\r\n$]*")
_CEND = re.compile(rb"(?im)^[ \t]*CEND\b")
_WIDTH = 80


@dataclass(frozen=True, slots=True)
class _Piece:
    file: int
    first_line: int
    data: bytes


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
        Everything read, every line ended by a newline, `_WIDTH` blanks at the end.
    start, stop : (n,) int64
        Range in `raw` of the bulk data lines, comments and line ends left out.
    file, line : (n,) int64
        Where each line stands; lines count from 1.
    superelements : (file, line) of the first BEGIN SUPER or BEGIN AUXMODEL, None without one
    """

    files: tuple[str, ...]
    top: tuple[str, ...]
    raw: bytes
    start: Int
    stop: Int
    file: Int
    line: Int
    superelements: tuple[int, int] | None


class _Reading:
    """Files met while includes are followed."""

    def __init__(self, main: Path) -> None:
        self.main = main.resolve()
        self.files: dict[Path, int] = {}
        self.pieces: list[_Piece] = []

    def read(self, path: Path, chain: tuple[Path, ...] = ()) -> bool:
        """Append the pieces of a file; True once ENDDATA is met."""
        data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")  # the mark that some editors put before UTF-8
        number = self.files.setdefault(path, len(self.files))
        end = _ENDDATA.search(data)
        limit = end.start() if end else len(data)
        at = 0
        for found in _INCLUDE.finditer(data, 0, limit):
            self._add(number, data, at, found.start())
            line = data.count(b"\n", 0, found.start()) + 1
            child = self._locate(next(g for g in found.groups() if g is not None), path, line)
            if child in (*chain, path):
                raise DeckError(f"{child} includes itself", path=path, line=line, card="INCLUDE")
            if self.read(child, (*chain, path)):
                return True
            at = found.end()
        self._add(number, data, at, limit)
        return end is not None

    def _add(self, number: int, data: bytes, a: int, b: int) -> None:
        if b > a:
            piece = data[a:b]
            self.pieces.append(
                _Piece(number, data.count(b"\n", 0, a) + 1, piece if piece.endswith(b"\n") else piece + b"\n")
            )

    def _locate(self, quoted: bytes, path: Path, line: int) -> Path:
        text = b"".join(part.strip() for part in quoted.splitlines()).decode("utf-8", "surrogateescape")
        name = Path(text.strip().replace("\\", "/"))
        tried = [path.parent / name, self.main.parent / name]
        for candidate in tried:
            if candidate.is_file():
                return candidate.resolve()
        places = ", ".join(dict.fromkeys(str(t) for t in tried))
        raise DeckError(f"the included file is not there; looked for {places}", path=path, line=line, card="INCLUDE")


def load(path: str | Path) -> Deck:
    """Read a deck with all its includes.

    Raises
    ------
    DeckError
        If the deck or an included file is not there, or a file includes itself.
    """
    path = Path(path)
    if not path.is_file():
        raise DeckError("no such deck", path=path)
    reading = _Reading(path)
    reading.read(reading.main)
    raw = b"".join(p.data for p in reading.pieces)
    start, stop, file, line = _lines(reading.pieces, raw)
    first, last, supers = _bulk_range(raw, start, path)
    top = tuple(raw[a:b].decode("latin-1") for a, b in zip(start[:first], stop[:first], strict=True)) if first else ()
    used = slice(first, last)
    stop = _without_comments(raw, start, stop)
    return Deck(
        files=tuple(str(f) for f in reading.files),
        top=top[:-1],
        raw=raw + b" " * _WIDTH,
        start=start[used],
        stop=stop[used],
        file=file[used],
        line=line[used],
        superelements=None if supers is None else (int(file[supers]), int(line[supers])),
    )


def _lines(pieces: list[_Piece], raw: bytes) -> tuple[Int, Int, Int, Int]:
    ends = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) == 10).astype(np.int64)
    start = np.concatenate([[0], ends[:-1] + 1]) if ends.size else np.empty(0, dtype=np.int64)
    count = np.array([p.data.count(b"\n") for p in pieces], dtype=np.int64)
    file = np.repeat(np.array([p.file for p in pieces], dtype=np.int64), count)
    line = np.repeat(np.array([p.first_line for p in pieces], dtype=np.int64) - (np.cumsum(count) - count), count)
    line = line + np.arange(ends.size)
    data = np.frombuffer(raw, dtype=np.uint8)
    return start, ends - ((ends > start) & (data[ends - 1] == 13)), file, line


def _bulk_range(raw: bytes, start: Int, path: Path) -> tuple[int, int, int | None]:
    """First and last+1 bulk line, and the line of BEGIN SUPER if there is one."""
    begins = [(int(np.searchsorted(start, m.start())), m.group().upper()) for m in _BEGIN.finditer(raw)]
    begins = [(at, text) for at, text in begins if re.search(rb"\bBULK\b|\bSUPER\b|\bAUX|BEGIN\s*$", text)]
    other = next((at for at, text in begins if re.search(rb"SUPER|AUX", text)), None)
    main = next((at for at, text in begins if not re.search(rb"SUPER|AUX", text)), None)
    if main is None:
        if _CEND.search(raw):
            raise DeckError("the deck has CEND but no BEGIN BULK", path=path)
        return 0, start.size if other is None else other, other
    return main + 1, start.size if other is None else other, other


def _without_comments(raw: bytes, start: Int, stop: Int) -> Int:
    dollars = np.flatnonzero(np.frombuffer(raw, dtype=np.uint8) == 36).astype(np.int64)
    if not dollars.size:
        return stop
    row, first = np.unique(np.searchsorted(start, dollars, side="right") - 1, return_index=True)
    out = stop.copy()
    out[row] = np.minimum(out[row], dollars[first])
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Cards:
    """Logical cards in reading order.

    Attributes
    ----------
    text : (line, 80) uint8
        Upper-case columns; a free-format line holds only its first field and its continuation name.
    style : (line,) int8
        0 small, 1 large, 2 free format, 3 free format with large fields.
    raw_of : (line,) int64
        Row of each line in `deck`.
    head, count : (card,) int64
        First line and number of lines of each card.
    name : (card,) bytes
    """

    deck: Deck
    text: NDArray[np.uint8]
    style: NDArray[np.int8]
    raw_of: Int
    head: Int
    count: Int
    name: NDArray[np.bytes_]

    def place(self, card: int) -> tuple[str, int]:
        """Path and line of a card."""
        at = self.raw_of[self.head[card]]
        return self.deck.files[self.deck.file[at]], int(self.deck.line[at])

    def places(self, card: Int) -> tuple[Int, Int]:
        """File numbers and lines of cards (n,)."""
        at = self.raw_of[self.head[card]]
        return self.deck.file[at], self.deck.line[at]

    def cells(self, name: str) -> Iterator[tuple[Int, NDArray[np.bytes_]]]:
        """Cards of one name in groups of equal layout: card numbers (n,) and stripped data fields (n, k)."""
        mine = np.flatnonzero(self.name == name.encode())
        for lines in np.unique(self.count[mine]).tolist():
            group = mine[self.count[mine] == lines]
            style = self.style[self.head[group][:, None] + np.arange(lines)]
            for wanted, width in ((0, 8), (1, 16)):
                pure = group[(style == wanted).all(axis=1)]
                if pure.size:
                    yield pure, self._fixed(pure, lines, width)
            mixed = group[~((style == 0).all(axis=1) | (style == 1).all(axis=1))]
            if mixed.size:
                yield mixed, self._mixed(mixed, lines)

    def _fixed(self, cards: Int, lines: int, width: int) -> NDArray[np.bytes_]:
        block = np.ascontiguousarray(self.text[self.head[cards][:, None] + np.arange(lines), 8:72])
        return np.asarray(np.strings.strip(block.reshape(cards.size, -1).view(f"S{width}")))

    def _mixed(self, cards: Int, lines: int) -> NDArray[np.bytes_]:
        rows = []
        for card in cards.tolist():  # free format has no columns to slice: measured 4 us a line
            row: list[bytes] = []
            for at in range(self.head[card], self.head[card] + lines):
                fields = self._line(at)
                if len(fields) == 8 and len(row) % 8:  # a small line after half a large one
                    row.extend([b""] * 4)
                row.extend(fields)
            rows.append(row)
        widest = max(len(r) for r in rows)
        return np.array([r + [b""] * (widest - len(r)) for r in rows], dtype=np.bytes_)

    def _line(self, at: int) -> list[bytes]:
        style = self.style[at]
        if style < 2:
            text, width = self.text[at].tobytes(), 16 if style else 8
            return [text[i : i + width].strip() for i in range(8, 72, width)]
        row = self.raw_of[at]
        parts = [p.strip() for p in self.deck.raw[self.deck.start[row] : self.deck.stop[row]].upper().split(b",")]
        size = 4 if style == 3 else 8
        if any(parts[size + 2 :]):
            raise DeckError(
                f"a free-format line has at most {size} data fields and a continuation name, this one has "
                f"{len(parts) - 1}; put the rest on a continuation line",
                path=self.deck.files[self.deck.file[row]],
                line=int(self.deck.line[row]),
            )
        fields = parts[1 : size + 1]
        return fields + [b""] * (size - len(fields))


def cards(deck: Deck) -> Cards:
    """Gather the bulk lines of a deck into logical cards.

    Raises
    ------
    DeckError
        On a continuation without a parent or a first field that is no card name.
    """
    text, free = _columns(deck)
    keep = np.flatnonzero((text != 32).any(axis=1) | free)
    text, free = text[keep], free[keep]
    first = np.ascontiguousarray(text[:, :8]).view("S8")[:, 0]
    blank = (text[:, :8] == 32).all(axis=1)
    follows = blank | (text[:, 0] == 43) | (text[:, 0] == 42)
    star = (text[:, :8] == 42).any(axis=1)
    style = (star + 2 * free).astype(np.int8)
    order = _continuation_order(deck, text, follows, keep)
    if order is not None:
        text, style, keep, first, follows = text[order], style[order], keep[order], first[order], follows[order]
    if follows.size and follows[0]:
        raise _at(deck, int(keep[0]), "a continuation line has no card before it")
    head = np.flatnonzero(~follows).astype(np.int64)
    count = np.diff(np.append(head, follows.size))
    names, which = np.unique(first[head], return_inverse=True)
    plain = np.strings.strip(np.strings.rstrip(np.strings.strip(names), b"*"))
    for i, name in enumerate(plain.tolist()):
        if not re.fullmatch(rb"[A-Z][A-Z0-9]*|=.*|/", name):
            at = int(keep[head[np.flatnonzero(which == i)[0]]])
            raise _at(deck, at, f"{name.decode('latin-1')!r} in columns 1-8 is not a card name")
    return Cards(deck, text, style, keep, head, count, plain[which])


def _at(deck: Deck, row: int, message: str) -> DeckError:
    return DeckError(message, path=deck.files[deck.file[row]], line=int(deck.line[row]))


def _columns(deck: Deck) -> tuple[NDArray[np.uint8], Bool]:
    """Upper-case columns (line, 80) and which lines are in free format."""
    raw = np.frombuffer(deck.raw, dtype=np.uint8)
    n = deck.start.size
    text = np.empty((n, _WIDTH), dtype=np.uint8)
    column = np.arange(_WIDTH)
    for a in range(0, n, 100_000):  # in blocks, to bound the index array
        b = min(a + 100_000, n)
        block = raw[deck.start[a:b, None] + column]
        block[column >= (deck.stop[a:b] - deck.start[a:b])[:, None]] = 32
        text[a:b] = np.where((block >= 97) & (block <= 122), block - 32, block)
    free = _lines_with(raw, 44, deck)
    for row in np.flatnonzero(_lines_with(raw, 9, deck) & ~free).tolist():
        line = deck.raw[deck.start[row] : deck.stop[row]].upper().expandtabs(8)
        text[row] = np.frombuffer(line[:_WIDTH].ljust(_WIDTH), dtype=np.uint8)
    for row in np.flatnonzero(free).tolist():
        parts = [p.strip() for p in deck.raw[deck.start[row] : deck.stop[row]].upper().split(b",")]
        last = parts[9] if len(parts) > 9 and b"*" not in parts[0] else b""
        line = parts[0][:8].ljust(72) + last[:8].ljust(8)
        text[row] = np.frombuffer(line, dtype=np.uint8)
    return text, free


def _lines_with(raw: NDArray[np.uint8], code: int, deck: Deck) -> Bool:
    """Lines that hold a byte before their comment."""
    out = np.zeros(deck.start.size, dtype=bool)
    if out.size:
        found = np.flatnonzero(raw == code)
        row = np.searchsorted(deck.start, found, side="right") - 1
        ok = (row >= 0) & (found < deck.stop[row])
        out[row[ok]] = True
    return out


def _continuation_order(deck: Deck, text: NDArray[np.uint8], follows: Bool, keep: Int) -> Int | None:
    """A reordering that puts named continuations behind the line that calls them, None if all are in order."""
    mine = _tags(text[:, :8])
    before = np.roll(_tags(text[:, 72:80]), 1)
    named = follows & (mine != b"")
    astray = np.flatnonzero(named & (mine != before))
    if not astray.size:
        return None
    calls = _tags(text[:, 72:80])
    unclaimed = np.ones(len(text), dtype=bool)
    unclaimed[np.flatnonzero(named & (mine == before)) - 1] = False
    parents: dict[bytes, list[int]] = {}
    for i in np.flatnonzero((calls != b"") & unclaimed).tolist():
        parents.setdefault(bytes(calls[i]), []).append(i)
    after: dict[int, int] = {}
    for i in astray.tolist():
        found = parents.get(bytes(mine[i]), [])
        if len(found) == 1:
            after[found[0]] = i
        elif i and calls[i - 1] == b"":
            log.debug("continuation %r taken for the line before it", bytes(mine[i]))
        else:
            why = "no line calls it" if not found else f"{len(found)} lines call it"
            raise _at(deck, int(keep[i]), f"continuation {mine[i].decode('latin-1')!r} has no parent: {why}")
    return _chain(len(text), follows, after) if after else None


def _chain(n: int, follows: Bool, after: dict[int, int]) -> Int:
    """Order of the lines once the block that begins at `after[i]` stands behind the block that holds line i."""
    begins = ~follows
    begins[list(after.values())] = True
    starts = np.flatnonzero(begins)
    block = np.cumsum(begins) - 1
    blocks = np.split(np.arange(n, dtype=np.int64), starts[1:])
    following = {int(block[i]): int(block[j]) for i, j in after.items()}
    moved = set(following.values())
    out = []
    for first in range(len(blocks)):
        at: int | None = None if first in moved else first
        while at is not None:
            out.append(blocks[at])
            at = following.get(at)
    return np.concatenate(out)


def _tags(columns: NDArray[np.uint8]) -> NDArray[np.bytes_]:
    """Continuation names (n,) of columns (n, 8): without the leading `+` or `*`."""
    cells = np.ascontiguousarray(columns).view("S8")[:, 0]
    return np.asarray(np.strings.strip(np.strings.lstrip(np.strings.strip(cells), b"+*")))
