"""Lines of a deck to cards: includes followed, fields split, continuations joined."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ringtrue.errors import DeckError, UnsupportedCard

_INCLUDE = re.compile(r"\s*INCLUDE\b\s*(.*)", re.IGNORECASE)
_DEPTH = 20


@dataclass(slots=True)
class Card:
    """One bulk data card: its name, fields 2 onward (stripped text), and where its first line stands."""

    name: str
    fields: list[str]
    file: int
    line: int


@dataclass(slots=True)
class Lexed:
    """A deck in pieces.

    Attributes
    ----------
    files : list of Path
        In reading order, the main file first.
    control : list of (file, line, text)
        Executive and case control lines.
    cards : list of Card
    """

    files: list[Path] = field(default_factory=list)
    control: list[tuple[int, int, str]] = field(default_factory=list)
    cards: list[Card] = field(default_factory=list)


def read_text(path: Path) -> str:
    """A deck file; every byte is a character (latin-1), so that nothing is lost in editing."""
    return path.read_bytes().decode("latin-1")


def _resolve(name: str, here: Path, main: Path) -> Path | None:
    places = [here.parent / name, main.parent / name, Path(name)]
    places += [p.parent / p.name.lower() for p in places[:1]]
    return next((p for p in places if p.is_file()), None)


def _lines(path: Path, main: Path, files: list[Path], depth: int = 0) -> Iterator[tuple[int, int, str]]:
    """Physical lines with file and line number; INCLUDE is replaced by what it names."""
    at = len(files)
    files.append(path)
    lines = read_text(path).splitlines()
    i = 0
    while i < len(lines):
        text, number = lines[i], i + 1
        i += 1
        found = _INCLUDE.match(text) if text[:1] not in "$" else None
        if not found:
            yield at, number, text
            continue
        name = found[1].split("$")[0].strip()
        quote = name[:1] if name[:1] in "'\"" else ""
        while quote and name.count(quote) < 2 and i < len(lines):
            name += lines[i].strip()
            i += 1
        name = name.strip("'\" ").replace("\\", "/")
        target = _resolve(name, path, main)
        if target is None:
            raise DeckError(f"no such file {name!r} beside {path.parent}", path=path, line=number, card="INCLUDE")
        if depth >= _DEPTH or target.resolve() == path.resolve():
            raise DeckError(f"{name!r} includes itself", path=path, line=number, card="INCLUDE")
        yield from _lines(target, main, files, depth + 1)


def _split(text: str) -> tuple[str, list[str], str, bool]:
    """Name (or continuation mark), data fields, trailing continuation mark, large."""
    text = text.split("$", 1)[0].rstrip()
    if "," in text:
        parts = [p.strip() for p in text.split(",")]
        large = parts[0].endswith("*")
        width = 4 if large else 8
        data = parts[1 : 1 + width] if len(parts) <= width + 2 else parts[1:]
        mark = parts[width + 1] if len(parts) == width + 2 else ""
        data += [""] * (-len(data) % width)
        return parts[0].rstrip("*").upper(), data, mark, large
    text = text.expandtabs(8)
    head = text[:8].strip().upper()
    if "*" in head:
        data = [text[a : a + 16].strip() for a in (8, 24, 40, 56)]
        return head.replace("*", "", 1) if not head.startswith("*") else "*", data, text[72:80].strip(), True
    data = [text[a : a + 8].strip() for a in range(8, 72, 8)]
    return head, data, text[72:80].strip(), False


def lex(path: Path) -> Lexed:
    """Split a deck into control lines and cards.

    Raises
    ------
    DeckError
        If the deck or one of its includes is not there, or a continuation continues nothing.
    """
    if not path.is_file():
        raise DeckError("no such file", path=path)
    out = Lexed()
    lines = list(_lines(path, path, out.files))
    bulk = next((i + 1 for i, (_, _, t) in enumerate(lines) if re.match(r"\s*BEGIN\b", t, re.I)), None)
    if bulk is None:
        control = any(re.match(r"\s*CEND\b", t, re.I) for _, _, t in lines)
        if control:
            raise DeckError("case control without BEGIN BULK", path=path)
        bulk = 0
    out.control = lines[:bulk]
    card: Card | None = None
    for at, number, text in lines[bulk:]:
        if not text or text[0] == "$" or not text.strip() or text.lstrip()[0] == "$":
            continue
        if text[:7].upper() == "ENDDATA":
            break
        name, data, _, _ = _split(text)
        if name == "" or name[0] in "+*":
            if card is None:
                raise DeckError("a continuation that continues nothing", path=out.files[at], line=number)
            card.fields += data
        elif name == "=" or name.startswith("=("):
            raise UnsupportedCard(name, path=out.files[at], line=number, why="replication of cards")
        else:
            card = Card(name, data, at, number)
            out.cards.append(card)
    return out
