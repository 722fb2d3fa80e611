"""Errors that name the file and line of a card."""

from __future__ import annotations

from ringtrue.errors import DeckError
from ringtrue.model.model import Model, Table


def error(model: Model, table: Table, row: int, message: str) -> DeckError:
    """A DeckError at the place of a row of a table."""
    file = int(table.file[row])
    path = model.files[file] if 0 <= file < len(model.files) else None
    line = int(table.line[row]) if path else None
    return DeckError(message, path=path, line=line, card=f"{table.card} {table.ids[row]}")
