"""Logical cards of a deck: lines with their continuations, and replicated cards written out."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Bool, Int
from ringtrue.decks.nastran.deck import WIDTH, Deck
from ringtrue.decks.nastran.lexer import (
    BLOCK,
    FreeLines,
    cuts,
    free_lines,
    upper_slices,
)
from ringtrue.errors import DeckError
from ringtrue.model.cards import CARDS, SPECIAL, SYNONYMS

log = logging.getLogger(__name__)
Names = NDArray[np.bytes_]
_BLANKS = np.uint64(0x2020202020202020)  # eight blank columns


@dataclass(frozen=True, slots=True, eq=False)
class Cards:
    """Logical cards in reading order.

    Attributes
    ----------
    text : (line, 80) uint8
        Upper-case columns; a free-format line holds only its first field and its continuation name.
    style : (line,) int8
        0 small, 1 large, 2 free format, 3 free format with large fields, 4 a replicated card
        written out.
    raw_of : (line,) int64
        Row of each line in `deck`.
    head, count : (card,) int64
        First line and number of lines of each card.
    name : (card,) bytes
    free : FreeLines
    made : mapping of int to list of bytes
        Data fields of the lines of style 4.
    copied : frozenset of int
        Cards that a replicated card repeats.
    """

    deck: Deck
    text: NDArray[np.uint8]
    style: NDArray[np.int8]
    raw_of: Int
    head: Int
    count: Int
    name: NDArray[np.bytes_]
    free: FreeLines
    made: Mapping[int, list[bytes]] = field(default_factory=dict)
    copied: frozenset[int] = frozenset()

    def kinds(self) -> tuple[NDArray[np.bytes_], Int, Int]:
        """Names that occur, sorted, the first card of each and how many there are, each (k,)."""
        begin = _runs(self.name)
        names, first, which = np.unique(
            self.name[begin], return_index=True, return_inverse=True
        )
        count = np.diff(np.append(begin, self.name.size))
        return names, begin[first], np.bincount(which, weights=count).astype(np.int64)

    def named(self, name: str) -> Int:
        """Numbers of the cards of one name."""
        return np.flatnonzero(self.name == name.encode())

    def place(self, card: int) -> tuple[str, int]:
        """Path and line of a card."""
        at = self.raw_of[self.head[card]]
        return self.deck.files[self.deck.file[at]], int(self.deck.line[at])

    def places(self, card: Int) -> tuple[Int, Int]:
        """File numbers and lines of cards (n,)."""
        at = self.raw_of[self.head[card]]
        return self.deck.file[at], self.deck.line[at]

    def cells(self, name: str) -> Iterator[tuple[Int, NDArray[np.bytes_]]]:
        """Cards of one name in groups of equal layout: card numbers (n,) and stripped data fields
        (n, k).
        """
        mine = self.named(name)
        for lines in np.unique(self.count[mine]).tolist():
            group = mine[self.count[mine] == lines]
            style = self.style[self.head[group][:, None] + np.arange(lines)]
            for wanted, width in ((0, 8), (1, 16)):
                pure = group[(style == wanted).all(axis=1)]
                if pure.size:
                    yield pure, self._fixed(pure, lines, width)
            free = (style == 2).all(axis=1)
            if free.any():
                free[free] = self.free.regular(self._rows(group[free], lines)).all(
                    axis=1
                )
            if free.any():
                rows = self._rows(group[free], lines)
                yield (
                    group[free],
                    self.free.cells(rows.reshape(-1)).reshape(len(rows), -1),
                )
            mixed = group[~(free | (style == 0).all(axis=1) | (style == 1).all(axis=1))]
            if mixed.size:
                yield mixed, self._mixed(mixed, lines)

    def _rows(self, cards: Int, lines: int) -> Int:
        """Rows in `deck` of the lines of cards, (n, lines)."""
        return np.asarray(self.raw_of[self.head[cards][:, None] + np.arange(lines)])

    def _fixed(self, cards: Int, lines: int, width: int) -> NDArray[np.bytes_]:
        block = np.ascontiguousarray(
            self.text[self.head[cards][:, None] + np.arange(lines), 8:72]
        )
        return np.strings.strip(block.reshape(cards.size, -1).view(f"S{width}"))

    def _mixed(self, cards: Int, lines: int) -> NDArray[np.bytes_]:
        rows = [
            self.fields(card) for card in cards.tolist()
        ]  # free format has no columns: measured 4 us a line
        widest = max(len(r) for r in rows)
        return np.array([r + [b""] * (widest - len(r)) for r in rows], dtype=np.bytes_)

    def fields(self, card: int) -> list[bytes]:
        """The data fields of one card."""
        row: list[bytes] = []
        for at in range(self.head[card], self.head[card] + self.count[card]):
            fields = self._line(at)
            if len(fields) == 8 and len(row) % 8:  # a small line after half a large one
                row.extend([b""] * 4)
            row.extend(fields)
        return row

    def _line(self, at: int) -> list[bytes]:
        style = self.style[at]
        if style == 4:
            return self.made[at]
        if style < 2:
            text = self.text[at].tobytes()
            width = 16 if style else 8
            return [text[i : i + width].strip() for i in range(8, 72, width)]
        row = self.raw_of[at]
        line = self.deck.raw[self.deck.start[row] : self.deck.stop[row]].upper()
        parts = [
            line[a + 1 : b].strip() for a, b in pairwise([-1, *cuts(line), len(line)])
        ]
        size = 4 if style == 3 else 8
        if any(parts[size + 2 :]):
            raise DeckError(
                f"a free-format line has at most {size} data fields and a continuation name, "
                "this one has "
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
    lines = free_lines(deck)
    text, free = _columns(deck, lines)
    keep = np.flatnonzero((text.view(np.uint64) != _BLANKS).any(axis=1) | free)
    if keep.size < free.size:
        text = text[keep]
        free = free[keep]
    first = np.ascontiguousarray(text[:, :8])
    blank = first.view(np.uint64)[:, 0] == _BLANKS
    follows = blank | (first[:, 0] == 43) | (first[:, 0] == 42)
    # column 1 may be blank before the name, too
    indented = np.flatnonzero((first[:, 0] == 32) & ~blank)
    if indented.size:
        begins = np.strings.lstrip(first[indented].view("S8")[:, 0]).astype("S1")
        follows[indented] = (begins == b"+") | (begins == b"*")
    star = (first == 42).any(axis=1)
    field_1: Names = first.view("S8")[:, 0]
    style = (star + 2 * free).astype(np.int8)
    _warn_of_tenth(deck, text, np.flatnonzero(free), follows, keep)
    order = _continuation_order(deck, text, follows, keep)
    if order is not None:
        text = text[order]
        style = style[order]
        keep = keep[order]
        field_1 = field_1[order]
        follows = follows[order]
    if follows.size and follows[0]:
        raise _at(deck, int(keep[0]), "a continuation line has no card before it")
    head = np.flatnonzero(~follows).astype(np.int64)
    count = np.diff(np.append(head, follows.size))
    begin = _runs(field_1[head])
    names, which = np.unique(field_1[head[begin]], return_inverse=True)
    size = np.diff(np.append(begin, head.size))
    plain: Names = np.strings.strip(np.strings.rstrip(np.strings.strip(names), b"*"))
    for i, name in enumerate(plain.tolist()):
        if not re.fullmatch(rb"[A-Z][A-Z0-9]*|=.*|/", name):
            at = int(keep[head[begin[np.flatnonzero(which == i)[0]]]])
            raise _at(
                deck,
                at,
                f"{name.decode('latin-1')!r} in columns 1-8 is not a card name",
            )
        plain[i] = SYNONYMS.get(name, name)
    return _replicated(
        Cards(
            deck=deck,
            text=text,
            style=style,
            raw_of=keep,
            head=head,
            count=count,
            name=plain[np.repeat(which, size)],
            free=lines,
        )
    )


def _runs(name: NDArray[np.bytes_]) -> Int:
    """Where runs of equal names begin."""
    if not name.size:
        return np.empty(0, dtype=np.int64)
    return np.concatenate([[0], np.flatnonzero(name[1:] != name[:-1]) + 1])


def _replicated(cards: Cards) -> Cards:
    """The cards with those that repeat others written out, each on a line of its own."""
    raw = np.frombuffer(cards.deck.raw, dtype=np.uint8)
    marked = (_lines_with(raw, 61, cards.deck) | _lines_with(raw, 40, cards.deck))[
        cards.raw_of
    ]
    line_of = np.repeat(np.arange(cards.head.size), cards.count)
    suspect = np.unique(line_of[marked])
    suspect = suspect[_read_here(cards.name[suspect])]
    if not suspect.size:
        return cards
    pieces, made, names, copied = _expanded(cards, suspect)
    line = np.concatenate(pieces)
    at = np.flatnonzero(line < 0)
    source = np.where(line < 0, -1 - line, line)
    style = cards.style[source]
    style[at] = 4
    follows = np.ones(cards.style.size, dtype=bool)
    follows[cards.head] = False
    begins = ~follows[source] | (line < 0)
    head = np.flatnonzero(begins)
    name = cards.name[line_of[source[head]]].astype("S8")
    where = np.searchsorted(head, at)
    name[where] = names
    kept = np.flatnonzero(line[head] >= 0)
    again = frozenset(kept[np.isin(line_of[source[head[kept]]], list(copied))].tolist())
    count = np.diff(np.append(head, line.size))
    fields = dict(zip(at.tolist(), made, strict=True))
    return replace(
        cards,
        text=cards.text[source],
        style=style,
        raw_of=cards.raw_of[source],
        head=head,
        count=count,
        name=name,
        made=fields,
        copied=again,
    )


def _read_here(name: NDArray[np.bytes_]) -> Bool:
    """Names of cards that are read, and `=`."""
    known = np.array([n.encode() for n in (*CARDS, *SPECIAL, "PARAM")])
    return np.asarray(np.isin(name, known) | (np.strings.find(name, b"=") == 0))


def _expanded(
    cards: Cards, suspect: Int
) -> tuple[list[Int], list[list[bytes]], list[bytes], set[int]]:
    """Lines in order (-1 - line for one that is made), data fields and names of the made ones,
    cards repeated.
    """
    pieces: list[Int] = []
    made: list[list[bytes]] = []
    names: list[bytes] = []
    copied: set[int] = set()
    state = Replication()
    done = 0
    last = -1
    for card in suspect.tolist():  # over the replicated cards and the cards before them
        name = bytes(cards.name[card])
        fields = cards.fields(card)
        if not replicates(name, fields):
            continue
        if card - 1 != last and card:
            state.plain(bytes(cards.name[card - 1]), cards.fields(card - 1))
            copied.add(card - 1)
        try:
            new = state.expand(name, fields)
        except ValueError as e:
            path, line = cards.place(card)
            raise DeckError(
                str(e), path=path, line=line, card=name.decode("latin-1")
            ) from None
        start = int(cards.head[card])
        pieces += [np.arange(done, start), np.full(len(new), -1 - start)]
        done = start + int(cards.count[card])
        last = card
        made += [f + [b""] * (-len(f) % 8) for f in new]
        names += [state.name] * len(new)
    return [*pieces, np.arange(done, cards.style.size)], made, names, copied


def _at(deck: Deck, row: int, message: str) -> DeckError:
    return DeckError(message, path=deck.files[deck.file[row]], line=int(deck.line[row]))


def _columns(deck: Deck, lines: FreeLines) -> tuple[NDArray[np.uint8], Bool]:
    """Upper-case columns (line, 80) and which lines are in free format."""
    raw = np.frombuffer(deck.raw, dtype=np.uint8)
    n = deck.start.size
    text = np.empty((n, WIDTH), dtype=np.uint8)
    for a in range(0, n, BLOCK):  # in blocks, to bound the temporaries
        b = min(a + BLOCK, n)
        text[a:b] = upper_slices(raw, deck.start[a:b], deck.stop[a:b], WIDTH, 32)
    free = lines.count > 0
    for row in np.flatnonzero(_lines_with(raw, 9, deck) & ~free).tolist():
        line = deck.raw[deck.start[row] : deck.stop[row]].upper().expandtabs(8)
        text[row] = np.frombuffer(line[:WIDTH].ljust(WIDTH), dtype=np.uint8)
    _free_columns(text, np.flatnonzero(free), lines)
    return text, free


def _free_columns(text: NDArray[np.uint8], rows: Int, lines: FreeLines) -> None:
    """The first field and the continuation name of free-format lines, put where fixed-format lines
    have them.
    """
    for a in range(0, rows.size, BLOCK):
        at = rows[a : a + BLOCK]
        first = lines.field(at, 0)
        last = np.where(np.strings.find(first, b"*") >= 0, b"", lines.field(at, 9))
        text[at] = 32
        for cells, begin in ((first, 0), (last, 72)):
            c = np.ascontiguousarray(cells.astype("S8")).view(np.uint8).reshape(-1, 8)
            text[at, begin : begin + 8] = np.where(c == 0, 32, c)


def _lines_with(raw: NDArray[np.uint8], code: int, deck: Deck) -> Bool:
    """Lines that hold a byte before their comment."""
    out = np.zeros(deck.start.size, dtype=bool)
    if out.size:
        found = np.flatnonzero(raw == code)
        row = np.searchsorted(deck.start, found, side="right") - 1
        ok = (row >= 0) & (found < deck.stop[row])
        out[row[ok]] = True
    return out


def _continuation_order(
    deck: Deck, text: NDArray[np.uint8], follows: Bool, keep: Int
) -> Int | None:
    """A reordering that puts named continuations behind the line that calls them, None if all are
    in order.
    """
    if not follows.any():
        return None
    mine = np.zeros(len(text), dtype="S8")
    calls = np.zeros(len(text), dtype="S8")
    mine[follows] = _tags(text[follows, :8])
    called = np.ascontiguousarray(text[:, 72:80]).view(np.uint64)[:, 0] != _BLANKS
    calls[called] = _tags(text[called, 72:80])
    before = np.roll(calls, 1)
    named = mine != b""
    astray = np.flatnonzero(named & (mine != before))
    if not astray.size:
        return None
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
        elif i and (
            calls[i - 1] == b"" or text[i - 1, 73:80].tobytes().strip() == mine[i]
        ):  # column 73 is free
            log.debug("continuation %r taken for the line before it", bytes(mine[i]))
        else:
            why = "no line calls it" if not found else f"{len(found)} lines call it"
            raise _at(
                deck,
                int(keep[i]),
                f"continuation {mine[i].decode('latin-1')!r} has no parent: {why}",
            )
    return _chain(len(text), follows, after) if after else None


def _warn_of_tenth(
    deck: Deck, text: NDArray[np.uint8], free: Int, follows: Bool, keep: Int
) -> None:
    """Say where a free-format line has a number in the place of a continuation name, and no line of
    that name.
    """
    digit = (text[free, 72] - np.uint8(48) <= 9) | np.isin(text[free, 72], (45, 46))
    lines = free[digit]
    lines = lines[~np.isin(_tags(text[lines, 72:80]), _tags(text[follows, :8]))]
    if lines.size:
        row = int(keep[lines[0]])
        more = f" ({lines.size - 1} more like it)" if lines.size > 1 else ""
        tag = text[lines[0], 72:80].tobytes().decode("latin-1").strip()
        log.warning(
            "%s:%d: %r stands behind the eight data fields of its line, where a continuation is "
            "named: it is not read; "
            "put it on a line of its own that begins with a comma%s",
            *(deck.files[deck.file[row]], deck.line[row], tag, more),
        )


def _chain(n: int, follows: Bool, after: dict[int, int]) -> Int:
    """Order of the lines once the block that begins at `after[i]` stands behind the block that
    holds line i.
    """
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
    return np.strings.strip(np.strings.lstrip(np.strings.strip(cells), b"+*"))


MOST = 100_000  # cards that one repetition may make
_STEP = re.compile(rb"\*\(?([+-]?[\d.][\dEeDd.+-]*)\)?")
_COUNT = re.compile(rb"=\(?(\d{1,9})\)?")
_WHOLE = re.compile(rb"[+-]?\d{1,18}")
Fields = list[bytes]


def replicates(name: bytes, fields: Sequence[bytes]) -> bool:
    """Whether a card refers to the card before it."""
    return name[:1] == b"=" or any(f[:1] == b"=" or _STEP.fullmatch(f) for f in fields)


@dataclass(slots=True)
class Replication:
    """The card before, and the increments that made it (by field)."""

    name: bytes = b""
    fields: Fields = field(default_factory=list)
    steps: dict[int, bytes] = field(default_factory=dict)

    def plain(self, name: bytes, fields: Fields) -> None:
        """Take note of a card that is written out."""
        self.name = name
        self.fields = fields
        self.steps = {}

    def expand(self, name: bytes, fields: Fields) -> list[Fields]:
        """The cards that one replicated card stands for; their name is `self.name` then.

        Raises
        ------
        ValueError
            If there is no card before, or a field cannot be incremented.
        """
        if not self.name:
            raise ValueError("there is no card before it to replicate")
        count = _COUNT.fullmatch(name)
        if count:
            return self._repeat(int(count[1]))
        if name[:1] == b"=" and name not in (b"=", b"=="):
            raise ValueError(
                f"{name.decode('latin-1')!r} is no replication; allowed are =, =n and =(n)"
            )
        if name[:1] != b"=":
            self.name = name
        self.fields, self.steps = self._next([b"=="] if name == b"==" else fields)
        return [self.fields]

    def _repeat(self, count: int) -> list[Fields]:
        if count > MOST:
            raise ValueError(f"{count} repetitions; at most {MOST} are allowed")
        made = [self._raised(k) for k in range(1, count + 1)]
        self.fields = made[-1] if made else self.fields
        return made

    def _raised(self, times: int) -> Fields:
        return [
            _plus(f, self.steps[j], times) if j in self.steps else f
            for j, f in enumerate(self.fields)
        ]  # from the last card, so that sums do not drift

    def _next(self, fields: Fields) -> tuple[Fields, dict[int, bytes]]:
        before = [*self.fields, *[b""] * len(fields)]
        out: Fields = []
        steps: dict[int, bytes] = {}
        for line in range(0, len(fields), 8):
            for j in range(line, min(line + 8, len(fields))):
                f = fields[j]
                step = _STEP.fullmatch(fields[j])
                if f == b"==":
                    out += before[j : line + 8]
                    break
                if step:
                    steps[j] = step[1]
                out.append(
                    before[j]
                    if f == b"="
                    else _plus(before[j], step[1], 1)
                    if step
                    else f
                )
        return out, steps


def _plus(text: bytes, step: bytes, times: int) -> bytes:
    """A field plus `times` increments: an integer if both are, a real otherwise."""
    if _WHOLE.fullmatch(text) and _WHOLE.fullmatch(step):
        return b"%d" % (int(text) + times * int(step))
    return repr(_real(text) + times * _real(step)).upper().encode()


def _real(text: bytes) -> float:
    plain = re.sub(rb"(?<=[\d.])([+-]\d+)$", rb"E\1", text.upper().replace(b"D", b"E"))
    try:
        return float(plain)
    except ValueError:
        raise ValueError(f"{text.decode('latin-1')!r} cannot be incremented") from None
