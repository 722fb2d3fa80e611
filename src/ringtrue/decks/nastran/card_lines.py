"""The physical lines of one card: their fields, read and replaced in the format of each line."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from ringtrue.decks.nastran.lexer import LineFields, split_line
from ringtrue.decks.nastran.writer import format_field

_fields = lru_cache(maxsize=64)(split_line)  # a line is looked at some six times for each value


class CardLine:
    """One physical line: its bytes without and with the line ending, and its fields."""

    def __init__(self, whole: bytes) -> None:
        self.text = whole.rstrip(b"\r\n")
        self.ending = whole[len(self.text) :]

    @property
    def whole(self) -> bytes:
        return self.text + self.ending

    @property
    def fields(self) -> LineFields:
        return _fields(self.text)

    @property
    def size(self) -> int:
        """Number of data fields."""
        return 4 if self.is_large else 8

    @property
    def is_large(self) -> bool:
        return b"*" in (self.text.split(b",")[0] if self.fields.style == "free" else self.text[:8])

    def write(self, k: int, value: int | float | str) -> None:
        """Write a value into data field `k` (from 0), with the digits that fit."""
        width = 16 if self.is_large else 8
        put = _set_free if self.fields.style == "free" else _set_fixed
        self.text = put(self, k, value, width)


def starts_of(lines: Sequence[CardLine]) -> list[int]:
    """Number of the first data field of each line, and of the one behind the card."""
    out = []
    at = 0
    for line in lines:
        if line.size == 8 and at % 8:
            at += 4
        out.append(at)
        at += line.size
    return [*out, at]


def texts_of(lines: Sequence[CardLine]) -> list[str]:
    """All data fields of a card, upper case."""
    starts = starts_of(lines)
    out = [""] * starts[-1]
    for start, line in zip(starts, lines, strict=False):
        for k, (a, b) in enumerate(line.fields.spans):
            out[start + k] = line.text[a:b].strip().upper().decode("latin-1")
    return out


def write_value(lines: list[CardLine], place: int, value: int | float | str) -> None:
    """Write a value into data field `place` (from 0) of a card, with new lines where there are too
    few.
    """
    while place >= starts_of(lines)[-1]:
        lines.append(_continuation(lines[-1]))
    starts = starts_of(lines)
    at = max(i for i, s in enumerate(starts[:-1]) if s <= place)
    lines[at].write(place - starts[at], value)


def _continuation(last: CardLine) -> CardLine:
    """An empty line to continue the card, in the style of its last line (which gets a line ending
    if need be).
    """
    ending = last.ending or b"\n"
    last.ending = ending
    if last.fields.style == "free":
        return CardLine((b"*," if last.is_large else b"+,") + ending)
    # column 73 is no part of the name
    tag = last.text.expandtabs(8)[73:80].strip() if last.fields.end >= 72 else b""
    return CardLine((b"*" if last.is_large else b"+") + tag + ending)


def _set_free(line: CardLine, k: int, value: int | float | str, width: int) -> bytes:
    fields = line.fields
    text = line.text
    if k >= len(fields.spans):
        end = len(text[: fields.end].rstrip())
        new = format_field(value, width).encode()
        return text[:end] + b"," * (k + 1 - len(fields.spans)) + new + text[end:]
    a, b = fields.spans[k]
    old = text[a:b]
    core = old.strip()
    new = format_field(value, max(width, min(len(core), 16))).encode()
    if not core:
        return text[:a] + new + text[b:]
    lead = len(old) - len(old.lstrip())
    return text[: a + lead] + new + text[a + lead + len(core) :]


def _set_fixed(line: CardLine, k: int, value: int | float | str, width: int) -> bytes:
    fields = line.fields
    text = line.text
    new = format_field(value, width).encode()
    a, b = fields.spans[k]
    old = text[a:b]
    new = new.ljust(width) if old[:1].strip() and old[-1:].isspace() else new.rjust(width)
    reached = len(text[: fields.end].expandtabs(8))  # columns that the line has before a comment
    pad = b" " * max(8 + k * width - reached, 0)
    rest = text[b:]
    return text[:a] + pad + (new + rest if rest else new.rstrip())
