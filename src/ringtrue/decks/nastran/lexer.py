"""Fields of a deck: their places in a line of any format; their values, whole columns at once."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.decks.nastran.deck import WIDTH, Deck
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.cards import columns
from ringtrue.model.model import Ragged, Table

_POWERS = 10.0 ** np.arange(23)
_BLOCK = 65_536
_REAL = re.compile(
    r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[ED]?([+-]\d+)|[ED](\d+))?", re.I | re.A
)
_TOKEN = re.compile(rb"[^ \t]+")
_PLUS, _MINUS, _DOT, _E, _D = b"+-.ED"


def characters(cells: NDArray[np.bytes_]) -> NDArray[np.uint8]:
    """Byte codes (n, width) of byte strings (n,), zero-padded."""
    flat = np.ascontiguousarray(cells)
    return flat.view(np.uint8).reshape(flat.size, flat.dtype.itemsize)


def _decimal(c: NDArray[np.uint8], use: Bool) -> Int:
    """The integer spelled by the digits chosen in each column of (width, n), (n,)."""
    value = np.zeros(c.shape[1], dtype=np.int64)
    # over the 8 or 16 characters of a field
    for digit, chosen in zip(c, use, strict=True):
        value = np.where(chosen, value * 10 + (digit - np.uint8(48)), value)
    return value


def _blocks(cells: NDArray[np.bytes_]) -> Iterator[tuple[slice, NDArray[np.uint8]]]:
    """Character codes (width, n), character by character as reductions are fast then, in blocks
    that fit the cache.
    """
    c = characters(cells)
    for a in range(0, len(c), _BLOCK):
        block = np.ascontiguousarray(c[a : a + _BLOCK].T)
        longest = int(np.flatnonzero(block.any(axis=1)).max(initial=0)) + 1
        yield slice(a, a + block.shape[1]), block[:longest]


def integers(cells: NDArray[np.bytes_]) -> tuple[Int, Bool]:
    """Integers of stripped cells (n,) and which of them are well formed, each (n,)."""
    value = np.empty(cells.size, dtype=np.int64)
    good = np.empty(cells.size, dtype=bool)
    for at, c in _blocks(cells):
        digit = (c - np.uint8(48)) <= 9
        other = ~digit & (c != 0)
        other[0] &= (c[0] != _PLUS) & (c[0] != _MINUS)
        count = digit.sum(axis=0)
        number = _decimal(c, digit & (count <= 18))
        value[at] = np.where(c[0] == _MINUS, -number, number)
        good[at] = ~other.any(axis=0) & (count > 0) & (count <= 18)
    return value, good


def reals(cells: NDArray[np.bytes_]) -> tuple[Float, Bool]:
    """Nastran reals (`7.`, `.5`, `1.5-3`, `1.D+3`, also integers) of stripped upper-case cells
    (n,).

    Exactly rounded: up to 15 digits and |exponent| <= 22 by one multiplication or division
    (Clinger, 1990), the rest by `float`.

    Returns
    -------
    values : (n,) float64
    well_formed : (n,) bool
    """
    value = np.empty(cells.size)
    good = np.empty(cells.size, dtype=bool)
    for at, c in _blocks(cells):
        value[at], good[at] = _reals(cells[at], c)
    return value, good


def _reals(cells: NDArray[np.bytes_], c: NDArray[np.uint8]) -> tuple[Float, Bool]:
    digit = (c - np.uint8(48)) <= 9
    sign = (c == _PLUS) | (c == _MINUS)
    letter = (c == _E) | (c == _D)
    dot = c == _DOT
    # where the exponent begins: a letter, or a sign that no letter precedes
    mark = letter.copy()
    mark[1:] |= sign[1:] & ~letter[:-1]
    tail = np.logical_or.accumulate(mark, axis=0)
    head = ~tail
    count = (digit & head).sum(axis=0)
    wild = ~(digit | sign | letter | dot | (c == 0))
    good = (
        ~wild.any(axis=0)
        & (count > 0)
        & (mark.sum(axis=0) <= 1)
        & (dot.sum(axis=0) <= 1)
    )
    good &= ~(dot & tail).any(axis=0) & ((digit & tail).any(axis=0) == mark.any(axis=0))
    fraction = (digit & head & np.logical_or.accumulate(dot, axis=0)).sum(axis=0)
    power = np.zeros(count.size, dtype=np.int64)
    if mark.any():
        power = _decimal(c, digit & tail & good & (tail.cumsum(axis=0) < 7))
        power = np.where((tail & (c == _MINUS)).any(axis=0), -power, power)
    power -= fraction
    exact = good & (count <= 15) & (abs(power) <= 22)
    value = _decimal(c, digit & head & exact).astype(np.float64)
    scale = _POWERS[abs(np.where(exact, power, 0))]
    value = np.where(power < 0, value / scale, value * scale)
    value = np.where(c[0] == _MINUS, -value, value)
    # rare: more digits than a double holds
    for i in np.flatnonzero(good & ~exact).tolist():
        try:
            value[i] = real(cells[i].decode("latin-1"))
        except ValueError:  # a zero byte among the digits
            good[i] = False
    return value, good & np.isfinite(value)


def real(text: str) -> float:
    """One Nastran real; `ValueError` if malformed."""
    found = _REAL.fullmatch(text.strip())
    value = float(f"{found[1]}E{found[2] or found[3] or 0}") if found else np.inf
    if not np.isfinite(value):
        raise ValueError(f"not a number: {text!r}")
    return value


def is_real(cells: NDArray[np.bytes_]) -> Bool:
    """Which cells are spelled as a real rather than as an integer, (n,)."""
    out = np.zeros(cells.size, dtype=bool)
    given = np.flatnonzero(cells != b"")
    for at, c in _blocks(cells[given]):
        inner = (c[1:] == _PLUS) | (c[1:] == _MINUS)
        out[given[at]] = ((c == _DOT) | (c == _E) | (c == _D)).any(axis=0) | inner.any(
            axis=0
        )
    return out


def strip(cells: Any_) -> NDArray[np.bytes_]:
    """Cells without blanks and tabs around them."""
    return np.asarray(np.strings.strip(cells))


@dataclass(frozen=True, slots=True)
class LineFields:
    """Where the fields of one line stand.

    Attributes
    ----------
    style : {"small", "large", "free"}
    name : str
        Field 1 without `*`, upper case; "" on a continuation.
    spans : tuple of (int, int)
        Byte range of each data field (8 for small, 4 for large; as many as there are for free), in
        the line.
    end : int
        Where the data of the line end: the comment or the end of the line.
    """

    style: str
    name: str
    spans: tuple[tuple[int, int], ...]
    end: int


def split_line(line: bytes) -> LineFields:
    """Fields of one bulk data line (without its line ending)."""
    end = line.find(b"$") if b"$" in line else len(line)
    data = line[:end]
    if b"," in data:
        parts = [(a + 1, b) for a, b in pairwise([-1, *cuts(data), len(data)])]
        first = data[parts[0][0] : parts[0][1]].strip().upper()
        large = b"*" in first
        return LineFields(
            "free", _name(first), tuple(parts[1 : 5 if large else 9]), end
        )
    columns = _columns(data)
    first = (
        bytes(b for b, at in zip(data, columns, strict=True) if at < 8).strip().upper()
    )
    width = 16 if b"*" in first else 8
    edges = [bisect_left(columns, 8 + k * width) for k in range(64 // width + 1)]
    spans = tuple(pairwise(edges))
    return LineFields("large" if width == 16 else "small", _name(first), spans, end)


def cuts(line: bytes) -> list[int]:
    """Where a free-format line is cut: at its commas, and at blanks between its name and field
    2.
    """
    commas = [i for i, b in enumerate(line) if b == 44]
    begins = (
        [found.start() for found in _TOKEN.finditer(line[: commas[0]])]
        if commas
        else []
    )
    if len(begins) != 2 or line[begins[0]] in b"+*":
        return commas
    return [begins[1] - 1, *commas]


def _name(first: bytes) -> str:
    text = first.decode("latin-1")
    return "" if text[:1] in ("", "+", "*") else text.rstrip("*").rstrip()


def _columns(data: bytes) -> list[int]:
    """Column of each byte, tabs going to the next multiple of 8."""
    columns = []
    at = 0
    for b in data:
        columns.append(at)
        at = (at // 8 + 1) * 8 if b == 9 else at + 1
    return columns


Files = Sequence[str]
_WHOLE = re.compile(r"[+-]?\d{1,18}", re.A)


@dataclass(frozen=True, slots=True)
class Card:
    """One card: its name, data fields as text, and where its first line stands."""

    name: str
    fields: list[str]
    file: int
    line: int


def whole(text: str) -> int:
    """One integer; `ValueError` if malformed."""
    if not _WHOLE.fullmatch(text):
        raise ValueError(text)
    return int(text)


class Reader:
    """Reads fields of one card, blaming the right place."""

    def __init__(self, card: Card, files: Files) -> None:
        self.card = card
        self.files = files

    def text(self, i: int) -> str:
        return self.card.fields[i] if 0 <= i < len(self.card.fields) else ""

    def fail(self, name: str, why: str) -> DeckError:
        c = self.card
        return DeckError(
            why, path=self.files[c.file], line=c.line, card=c.name, field=name
        )

    def unsupported(self, why: str) -> UnsupportedCard:
        c = self.card
        return UnsupportedCard(c.name, path=self.files[c.file], line=c.line, why=why)

    def whole(self, i: int, name: str, default: int | None = None) -> int:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return whole(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not an integer") from None

    def integers(self, start: int, name: str, there: Int | None = None) -> list[int]:
        """Integers from field `start` on, `1 THRU 9 BY 2` written out, of `there` if given; the
        list ends at a real.
        """
        at = [i for i in range(start, len(self.card.fields)) if self.text(i)]
        out: list[int] = []
        while at and "." not in self.text(at[0]):
            first = self.whole(at.pop(0), name)
            if not at or self.text(at[0]) != "THRU":
                out.append(first)
                continue
            last = self.whole(at[1] if at[1:] else -1, name)
            at = at[2:]
            step = 1
            if at and self.text(at[0]) == "BY":
                step = self.whole(at[1] if at[1:] else -1, name)
                at = at[2:]
            if last < first or step < 1:
                got = f"{first} THRU {last} BY {step}"
                raise self.fail(
                    name, f"a THRU b BY c needs a <= b and c >= 1, got {got}"
                )
            if there is None:
                out += range(first, last + 1, step)
            else:
                inside = (
                    (there >= first) & (there <= last) & ((there - first) % step == 0)
                )
                out += there[inside].tolist()
        return out

    def real(self, i: int, name: str, default: float | None = None) -> float:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return real(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not a real") from None


# values by the names of `model.cards`, lists for ragged columns
Row = Mapping[str, Any]
_DTYPES: Mapping[str, Any] = {
    "i": np.int64,
    "f": np.float64,
    "s": np.str_,
    "c": np.str_,
}


def table_of_rows(card: str, rows: Sequence[tuple[Card, Row]]) -> Table:
    """A table of its rows, each with the card that it stands on; what a row leaves out has its
    default.
    """
    made: dict[str, NDArray[Any] | Ragged] = {}
    for spec in columns(card):
        name = spec.name
        dtype = _DTYPES[spec.kind]
        if spec.tail:
            made[name] = ragged([row.get(name, []) for _, row in rows], dtype)
        elif not spec.blank:
            values = [row.get(name, spec.default) for _, row in rows]
            made[name] = np.array(values, dtype=dtype)
    file = np.array([c.file for c, _ in rows], dtype=np.int64)
    line = np.array([c.line for c, _ in rows], dtype=np.int64)
    return Table(card, made, file, line)


def ragged(rows: Sequence[Sequence[Any]], dtype: Any) -> Ragged:
    values = [v for r in rows for v in r]
    return Ragged(
        np.array(values, dtype=dtype), np.cumsum([0, *map(len, rows)]).astype(np.int64)
    )


BLOCK = 65_536  # lines at a time: the temporaries stay in the cache
_LINE = 8  # data fields of a line


@dataclass(frozen=True, slots=True, eq=False)
class FreeLines:
    """Commas of the lines of a deck.

    Attributes
    ----------
    deck : Deck
    comma : (c,) int64
        Places in `deck.raw`, comments left out; also those of blanks that stand for a comma behind
        the name.
    first : (n,) int64
        The first of each line in `comma`.
    count : (n,) int64
        How many each line has; 0 for a line in fixed format.
    """

    deck: Deck
    comma: Int
    first: Int
    count: Int

    def span(self, rows: Int, k: int) -> tuple[Int, Int]:
        """Range in `deck.raw` of field k (0 the name) of lines (n,); empty where a line has
        fewer.
        """
        last = max(self.comma.size - 1, 0)
        count = self.count[rows]
        first = self.first[rows]
        stop = self.deck.stop[rows]
        begin = (
            self.deck.start[rows]
            if k == 0
            else self.comma[np.minimum(first + k - 1, last)] + 1
        )
        end = np.where(k < count, self.comma[np.minimum(first + k, last)], stop)
        there = k <= count
        return np.where(there, begin, stop), np.where(there, end, stop)

    def field(self, rows: Int, k: int) -> NDArray[np.bytes_]:
        """Field k of lines (n,), stripped and in upper case; at most 80 characters of it."""
        raw = np.frombuffer(self.deck.raw, dtype=np.uint8)
        begin, end = self.span(rows, k)
        width = min(int((end - begin).max(initial=1)), WIDTH)
        if not (end > begin).any():
            return np.zeros(rows.size, dtype="S1")
        cut = upper_slices(raw, begin, end, width, 0)
        return np.strings.strip(cut.view(f"S{width}")[:, 0])

    def regular(self, rows: Int) -> Bool:
        """Lines with at most ten fields, each of at most 80 characters; the others are read one by
        one.
        """
        length = self.deck.stop[rows] - self.deck.start[rows]
        return (self.count[rows] <= _LINE + 1) & (length <= WIDTH)

    def cells(self, rows: Int) -> NDArray[np.bytes_]:
        """Data fields 1 to 8 of regular lines (n,): (n, 8)."""
        blocks = []
        for a in range(0, rows.size, BLOCK):
            at = rows[a : a + BLOCK]
            blocks.append(
                np.stack([self.field(at, k) for k in range(1, _LINE + 1)], axis=1)
            )
        return np.concatenate(blocks)


def free_lines(deck: Deck) -> FreeLines:
    """The commas of a deck, line by line."""
    found = np.flatnonzero(np.frombuffer(deck.raw, dtype=np.uint8) == 44)
    if not (found.size and deck.start.size):
        none = np.zeros(deck.start.size, dtype=np.int64)
        return FreeLines(deck, np.zeros(0, dtype=np.int64), none, none)
    row = np.searchsorted(deck.start, found, side="right") - 1
    used = (row >= 0) & (found < deck.stop[row])
    lines = _counted(deck, found[used], row[used])
    behind = _blanks(lines)
    if not behind:
        return lines
    at = np.sort(np.concatenate([lines.comma, np.array(behind, dtype=np.int64)]))
    return _counted(deck, at, np.searchsorted(deck.start, at, side="right") - 1)


def _counted(deck: Deck, comma: Int, row: Int) -> FreeLines:
    count = np.bincount(row, minlength=deck.start.size)
    return FreeLines(deck, comma, np.cumsum(count) - count, count)


def _blanks(lines: FreeLines) -> list[int]:
    """Places of blanks that stand for a comma behind the name: `CBUSH   11, 2, 3`."""
    out: list[int] = []
    rows = np.flatnonzero(lines.count > 0)
    for a in range(0, rows.size, BLOCK):
        at = rows[a : a + BLOCK]
        first = lines.field(at, 0)
        inside = (np.strings.find(first, b" ") >= 0) | (
            np.strings.find(first, b"\t") >= 0
        )
        for row in at[inside].tolist():  # rare
            begin = int(lines.deck.start[row])
            line = lines.deck.raw[begin : int(lines.deck.stop[row])]
            out += [begin + cut for cut in cuts(line) if line[cut] != 44]
    return out


def upper_slices(
    raw: NDArray[np.uint8], begin: Int, end: Int, width: int, pad: int
) -> NDArray[np.uint8]:
    """Upper-case bytes raw[begin:end], cut or padded to `width`: (n, width)."""
    block = sliding_window_view(raw, width)[begin]
    np.putmask(block, np.arange(width) >= (end - begin)[:, None], pad)
    if block.size and block.max() >= 97:
        block = _UPPER[block]
    return block


_UPPER = np.arange(256, dtype=np.uint8)


_UPPER[97:123] -= 32
