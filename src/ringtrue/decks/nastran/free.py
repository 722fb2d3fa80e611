"""Free-format lines cut at their commas, many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Int
from ringtrue.decks.nastran.deck import WIDTH, Deck
from ringtrue.decks.nastran.lexer import cuts

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
        count, first = self.count[rows], self.first[rows]
        stop = self.deck.stop[rows]
        begin = self.deck.start[rows] if k == 0 else self.comma[np.minimum(first + k - 1, last)] + 1
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
        return np.asarray(np.strings.strip(cut.view(f"S{width}")[:, 0]))

    def regular(self, rows: Int) -> Bool:
        """Lines with at most ten fields, each of at most 80 characters; the others are read one by
        one.
        """
        length = self.deck.stop[rows] - self.deck.start[rows]
        return np.asarray((self.count[rows] <= _LINE + 1) & (length <= WIDTH))

    def cells(self, rows: Int) -> NDArray[np.bytes_]:
        """Data fields 1 to 8 of regular lines (n,): (n, 8)."""
        blocks = []
        for a in range(0, rows.size, BLOCK):
            at = rows[a : a + BLOCK]
            blocks.append(np.stack([self.field(at, k) for k in range(1, _LINE + 1)], axis=1))
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
        inside = (np.strings.find(first, b" ") >= 0) | (np.strings.find(first, b"\t") >= 0)
        for row in at[inside].tolist():  # hardly ever
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
