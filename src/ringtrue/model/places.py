"""Errors that name the file and line of a card."""

from __future__ import annotations

from collections.abc import Sequence

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.model import Model, Table

MOST = 6  # rows that a message names


def error(model: Model, table: Table, row: int, message: str) -> DeckError:
    """A DeckError at the place of a row of a table."""
    path, line = _place(model, table, row)
    return DeckError(message, path=path, line=line, card=f"{table.card} {table.ids[row]}")


def unsupported(model: Model, table: Table, row: int, why: str) -> UnsupportedCard:
    """An UnsupportedCard at the place of a row of a table."""
    path, line = _place(model, table, row)
    return UnsupportedCard(table.card, path=path, line=line, why=f"{table.ids[row]} {why}")


def called(model: Model, rows: Sequence[tuple[Table, int]]) -> str:
    """Rows of tables as a message calls them, with the lines of those that share a card and id."""
    names = [f"{t.card} {t.ids[i]}" for t, i in rows]
    told = [
        f"{name} of line {line}"
        if names.count(name) > 1 and (line := _place(model, *row)[1])
        else name
        for name, row in zip(names[:MOST], rows, strict=False)
    ]
    return ", ".join([*told, *(["..."] if len(rows) > MOST else [])])


def _place(model: Model, table: Table, row: int) -> tuple[str | None, int | None]:
    file = int(table.file[row])
    return (
        (model.files[file], int(table.line[row])) if 0 <= file < len(model.files) else (None, None)
    )
