"""A deck with fields changed or cards added, and not a character more."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ringtrue.core.parameters import CardField, ParameterSet, is_matrix
from ringtrue.decks.nastran.cards import Cards, cards
from ringtrue.decks.nastran.deck import load
from ringtrue.decks.nastran.lexer import LineFields, real, split_line
from ringtrue.decks.nastran.special import bush_flag, field_place, inherited
from ringtrue.decks.nastran.writer import format_card, format_field
from ringtrue.errors import DeckError, InputError
from ringtrue.io.files import atomic_write, one_run, reads, writes
from ringtrue.model.cards import CARDS, columns
from ringtrue.model.edit import (
    BOTH_ENDS,
    FieldChange,
    field_value,
    ply_field,
    resolve_target,
)
from ringtrue.model.model import Model

Place = tuple[int, int]  # file number, line from 1


def edit_fields(
    model: Model, changes: Sequence[FieldChange], out_dir: str | Path
) -> list[Path]:
    """Copy a deck with all its includes, changing only the characters of the given fields.

    A field keeps the format of its line (small, large, free); the value is written with the digits
    that fit. Of a matrix (`FieldChange("DMIG", 1, "A", 0.8)`) each term is multiplied. A blank
    field is filled; a field behind the end of its card gets the continuation
    lines it needs. A CONM2 of the model that stands in none of the files is added to the main deck
    with its mass.

    Returns
    -------
    list of Path
        The written files in the order of `model.files`, the main deck first.

    Raises
    ------
    InputError, DeckError
        If a change names what is not in the deck, or a field that is no single field of its card.
        Nothing is written then.
    """
    found, files, contents = _loaded(model)
    groups: dict[int, list[FieldChange]] = {}
    find = _finder(model, found)
    new = [c for c in changes if is_new(model, c)]
    for change in changes:
        if change not in new:
            groups.setdefault(find(change), []).append(change)
    for card, mine in groups.items():
        _edit(found, contents, _CardChanges(card, tuple(mine)))
    data = [b"".join(lines) for lines in contents]
    if new:
        masses = []
        for change in new:
            node = int(model["CONM2"]["G"][resolve_target(model, change)[0]])
            masses.append(
                format_card("CONM2", [change.id, node, None, float(change.value)])
            )
        data[0] = _inserted(data[0], "".join(masses))
    return _write(files, data, Path(out_dir))


def is_new(model: Model, change: FieldChange) -> bool:
    """Whether it is the mass of a CONM2 that stands in no file."""
    lump = (change.card, change.field) == ("CONM2", "M")
    return lump and int(model["CONM2"].file[resolve_target(model, change)[0]]) < 0


def unwritable(model: Model, targets: Sequence[CardField]) -> dict[CardField, str]:
    """Which fields `edit_fields` cannot change, and why not: replicated cards, sections made of
    another card.

    Raises
    ------
    InputError
        If the model was not read from a deck.
    """
    found, _, contents = _loaded(model)
    find = _finder(model, found)
    why: dict[CardField, str] = {}
    for t in targets:
        try:
            change = FieldChange(t.card, t.id, t.field, field_value(model, t))
            _edit(found, contents, _CardChanges(find(change), (change,)))
        except InputError as e:
            why[t] = str(e)
    return why


def refuse_unwritable(model: Model, parameters: ParameterSet) -> None:
    """Candidates of a study that could not be delivered are refused before any work.

    Raises
    ------
    InputError
        With the first of them and why not.
    """
    whole = [t for p in parameters.parameters for t in p.targets if not t.elements]
    for why in unwritable(model, whole).values():
        raise InputError(f"[[candidate]] {why}")


def _loaded(model: Model) -> tuple[Cards, list[Path], list[list[bytes]]]:
    """The cards of the deck, its files, and what is in them."""
    found = cards(load(_files(model)[0]).joined())
    files = [Path(f) for f in found.deck.files]
    return found, files, [_lines_of(f.read_bytes()) for f in files]


def _files(model: Model) -> tuple[str, ...]:
    if not model.files:
        raise InputError(
            "this model was not read from a deck, so there is none to edit"
        )
    return model.files


def add_cards(
    model: Model, file: str | Path, text: str, out_dir: str | Path
) -> list[Path]:
    """Copy a deck with cards added: before ENDDATA of `file` (one of `model.files`), at its end if
    it has none.

    Returns
    -------
    list of Path
        The written files in the order of `model.files`.

    Raises
    ------
    InputError
        If `file` is none of the deck's files.
    """
    files = [Path(f) for f in _files(model)]
    wanted = Path(file)
    candidates = (wanted.resolve(), (files[0].parent / wanted).resolve())
    number = next((i for i, f in enumerate(files) if f in candidates), -1)
    if number < 0:
        raise InputError(
            f"{file} is not a file of the deck; its files are {', '.join(model.files)}"
        )
    data = [f.read_bytes() for f in files]
    data[number] = _inserted(data[number], text)
    return _write(files, data, Path(out_dir))


def unified_diff(old: Sequence[str | Path], new: Sequence[str | Path]) -> str:
    """The differences between files pair by pair, in the form of `diff -u`; "" if there are
    none.
    """
    parts: list[str] = []
    for a, b in zip(map(Path, old), map(Path, new), strict=True):
        before = a.read_bytes()
        after = b.read_bytes()
        if before != after:
            old_lines, new_lines = (
                x.decode("latin-1").splitlines() for x in (before, after)
            )
            parts += difflib.unified_diff(
                old_lines, new_lines, a.name, b.name, lineterm=""
            )
    return "\n".join(parts) + ("\n" if parts else "")


def _inserted(data: bytes, text: str) -> bytes:
    newline = b"\r\n" if b"\r\n" in data else b"\n"
    lines = newline.join(line.encode() for line in text.splitlines()) + newline
    end = re.search(rb"(?im)^[ \t]*(ENDDATA|BEGIN[^\n]*SUPER)", data)
    at = end.start() if end else len(data)
    gap = newline if at and not data[:at].endswith(b"\n") else b""
    return data[:at] + gap + lines + data[at:]


def refuse_copy(model: Model, out_dir: str | Path) -> None:
    """A deck that cannot be delivered into a folder is refused before any work.

    Raises
    ------
    InputError
        If a file of the copy would replace one of the deck, or another input of the run.
    DeckError
        If the copy would include files of the deck itself: an INCLUDE has an absolute path.
    """
    _, files, contents = _loaded(model)
    _copies(files, [b"".join(lines) for lines in contents], Path(out_dir))


def _write(files: Sequence[Path], data: Sequence[bytes], out_dir: Path) -> list[Path]:
    """Write the files in their layout; the main deck stands in `out_dir` unless an include lies
    elsewhere.
    """
    targets = _copies(files, data, out_dir)
    for target, content in zip(targets, data, strict=True):
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(target) as part:
            part.write_bytes(content)
    return targets


def _copies(files: Sequence[Path], data: Sequence[bytes], out_dir: Path) -> list[Path]:
    """Where the copies of the files go; refused before any is written if they would not stand by
    themselves.
    """
    root = Path(os.path.commonpath([f.parent for f in files]))
    with one_run(), TemporaryDirectory(prefix="ringtrue-") as trial:
        home = Path(trial).resolve()
        for file, content in zip(files, data, strict=True):
            copy = home / file.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(content)
        try:
            found = load(home / files[0].relative_to(root)).files
        except DeckError as e:
            raise DeckError(
                f"a copy of the deck would not find its INCLUDE files: {e}",
                path=files[0],
            ) from e
        strangers = [f for f in found if not Path(f).is_relative_to(home)]
    if strangers:
        raise DeckError(
            f"a copy of the deck would still include {strangers[0]}: make the path of that "
            "INCLUDE relative",
            path=files[0],
        )
    targets = [out_dir / f.relative_to(root) for f in files]
    with one_run():  # of a deck and its copy, whoever asks for it
        reads(*files)
        writes(*targets)
    writes(*targets)
    return targets


def _lines_of(data: bytes) -> list[bytes]:
    """The lines of a file, each with its line ending."""
    if b"\n" in data:
        return re.findall(rb"[^\n]*\n|[^\n]+", data)
    return data.splitlines(keepends=True)


@dataclass(frozen=True, slots=True)
class _CardChanges:
    """All changes of one card of the deck."""

    card: int
    changes: tuple[FieldChange, ...]


def _finder(model: Model, found: Cards) -> Callable[[FieldChange], int]:
    """Which card of the deck holds a change."""
    every = np.arange(found.head.size)
    file, line = found.places(every)
    order = np.lexsort((line, file))
    key = np.stack([file[order], line[order]], axis=1)

    def find(change: FieldChange) -> int:
        rows = resolve_target(model, change)
        table = model[change.card]
        if len(rows) > 1:
            raise InputError(
                f"{change.card} {change.id} stands {len(rows)} times in the deck: which one is "
                "meant?"
            )
        if other := _taken(model, change, int(rows[0])):
            raise InputError(
                f"{change.card} {change.id} has no {change.field}: it stands where the card "
                f"names {other}"
            )
        at = (int(table.file[rows[0]]), int(table.line[rows[0]]))
        if at[0] < 0 and is_matrix(change.card, change.field):
            raise InputError(
                f"DMIG {change.id} A ({table['NAME'][rows[0]]}) stands in an OUTPUT4 file, which "
                "is not edited: give the part with its matrices as DMIG (EXTSEOUT DMIGPCH, or "
                "`ringtrue reduce` without --op4)"
            )
        hit = np.flatnonzero((key[:, 0] == at[0]) & (key[:, 1] == at[1]))
        if not hit.size:
            raise InputError(
                f"{change.card} {change.id} is not where it was read: the deck has changed since"
            )
        card = int(order[hit[0]])
        if hit.size > 1 or found.style[found.head[card]] == 4 or card in found.copied:
            why = (
                "it is written by replication (=), or a replicated card repeats it; write the "
                "cards out first"
            )
            raise _refused(found, card, change, why)
        return card

    return find


def _refused(found: Cards, card: int, change: FieldChange, why: str) -> DeckError:
    """The error of a change that a card of the deck cannot take."""
    path, line = found.place(card)
    named = f"{change.card} {change.id}"
    return DeckError(why, path=path, line=line, card=named, field=change.field)


def _taken(model: Model, change: FieldChange, row: int) -> str:
    """The frame or node that a card names in the field of this change, such as `MCID 4` for THETA;
    "" for none.
    """
    specs = columns(change.card) if change.card in CARDS else ()
    other = next((s for s in specs if s.other and s.name == change.field), None)
    number = int(model[change.card][other.other][row]) if other else 0
    return f"{other.other} {number}" if other and number > other.other_default else ""


def _edit(found: Cards, contents: Sequence[list[bytes]], group: _CardChanges) -> None:
    """Make the changes of a card; those of a matrix are made on all its cards."""
    for change in group.changes:
        if is_matrix(change.card, change.field):
            _scale_matrix(found, contents, group.card, change)
            return
    _edit_card(found, contents, group)


def _scale_matrix(
    found: Cards, contents: Sequence[list[bytes]], header: int, change: FieldChange
) -> None:
    """Multiply the terms of a DMIG, those of the section of bulk data that its header is in."""
    every = found.named("DMIG")
    begins = np.sort([d.start[0] for d in found.deck.parts.values() if d.start.size])
    section = np.searchsorted(
        begins, found.deck.start[found.raw_of[found.head]], side="right"
    )
    name = found.fields(header)[0]
    for card in every[section[every] == section[header]].tolist():
        fields = found.fields(card)
        if fields[0] != name or fields[1] == b"0":
            continue
        if found.style[found.head[card]] == 4 or card in found.copied:
            raise _refused(
                found, card, change, "it is written by replication (=): write it out"
            )
        rows = found.raw_of[found.head[card] + np.arange(found.count[card])].tolist()
        at: list[Place] = [
            (int(found.deck.file[r]), int(found.deck.line[r])) for r in rows
        ]
        lines = [CardLine(contents[f][n - 1]) for f, n in at]
        for start, line, (f, n) in zip(starts_of(lines), lines, at, strict=False):
            for k in range(line.size):
                # terms are points, components and two parts of the value
                place = start + k
                if place >= 6 and place % 4 == 2 and fields[place]:
                    line.write(k, real(fields[place].decode()) * float(change.value))
            contents[f][n - 1] = line.whole


def _edit_card(
    found: Cards, contents: Sequence[list[bytes]], group: _CardChanges
) -> None:
    name = found.name[group.card].decode()
    rows = found.raw_of[found.head[group.card] + np.arange(found.count[group.card])]
    at: list[Place] = [(int(found.deck.file[r]), int(found.deck.line[r])) for r in rows]
    lines = [CardLine(contents[f][n - 1]) for f, n in at]
    given = {(c.id, c.field): c.value for c in group.changes}
    for change in group.changes:
        if change.card != name:
            why = f"it was made from a {name}; change that card's own fields"
            raise _refused(found, group.card, change, why)
        place = field_place(name, texts_of(lines), change.id, change.field)
        if _inherits(change, place, lines, given):
            continue
        if place is None and name == "PBUSH":
            # the place of a field on a new line of a PBUSH, which gets the line's flag
            write_value(
                lines, -(-starts_of(lines)[-1] // 8) * 8 + 1, bush_flag(change.field)
            )
            place = field_place("PBUSH", texts_of(lines), change.id, change.field)
        if place is None:
            raise _refused(found, group.card, change, "the card has no place for it")
        follower = inherited(name, texts_of(lines), change.field)
        if follower and follower[1]:  # the next ply keeps what it has
            at_next, text = follower
            write_value(
                lines, at_next, real(text) if change.field.startswith("T") else text
            )
        write_value(lines, place, _typed(change))
    for i, (f, n) in enumerate(at):
        contents[f][n - 1] = lines[i].whole
    f, n = at[-1]
    contents[f][n - 1] += b"".join(x.whole for x in lines[len(at) :])


def _inherits(
    change: FieldChange,
    place: int | None,
    lines: Sequence[CardLine],
    given: Mapping[tuple[int, str], object],
) -> bool:
    """Whether a blank field of end B of a PBEAM follows end A, which gets the same value."""
    partner = next((a for a, b in BOTH_ENDS.items() if b == change.field), None)
    if (
        change.card != "PBEAM"
        or partner is None
        or given.get((change.id, partner)) != change.value
    ):
        return False
    return place is None or not texts_of(lines)[place]


def _typed(change: FieldChange) -> int | float | str:
    kinds = {s.name: s.kind for s in columns(change.card)}
    kind = kinds.get(change.field) or kinds.get(
        (ply_field(change.field) or ("",))[0], "i"
    )
    if kind == "f":
        return float(change.value)
    if kind == "i" and not isinstance(change.value, int | np.integer):
        raise InputError(
            f"{change.card} {change.id} {change.field} must be an integer, got {change.value!r}"
        )
    return change.value


# a line is looked at some six times for each value
_fields = lru_cache(maxsize=64)(split_line)


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
        return b"*" in (
            self.text.split(b",")[0] if self.fields.style == "free" else self.text[:8]
        )

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
    new = (
        new.ljust(width) if old[:1].strip() and old[-1:].isspace() else new.rjust(width)
    )
    # columns that the line has before a comment
    reached = len(text[: fields.end].expandtabs(8))
    pad = b" " * max(8 + k * width - reached, 0)
    rest = text[b:]
    return text[:a] + pad + (new + rest if rest else new.rstrip())
