"""Checks of decks. A finding says what is wrong, how badly, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ringtrue.core.arrays import Int
from ringtrue.model.model import Model

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding; `file` is "" and `line` 0 where it has no place in the deck.

    `card` and `ids` are the table and the numbers of the rows that are meant, where it is of some.
    """

    severity: Severity
    text: str
    file: str = ""
    line: int = 0
    card: str = ""
    ids: tuple[int, ...] = ()

    def __str__(self) -> str:
        """`warning: model.bdf:31: what`."""
        place = (
            f"{self.file}:{self.line}: "
            if self.line
            else f"{self.file}: "
            if self.file
            else ""
        )
        return f"{self.severity}: {place}{self.text}"


def at_rows(
    model: Model, card: str, rows: Int, severity: Severity, what: str
) -> list[Finding]:
    """One finding for rows (k,) of a table, at the place of the first: `CQUAD4 7 and 3 more: what`;
    none without rows.
    """
    if not rows.size:
        return []
    table = model[card]
    first = int(rows[0])
    file, line = model.place(table, first)
    more = f" and {rows.size - 1} more" if rows.size > 1 else ""
    text = f"{card} {table.ids[first]}{more}: {what}"
    ids = tuple(table.ids[rows].tolist())
    return [Finding(severity, text, file or "", line or 0, card=card, ids=ids)]
