"""Fields of one card as text, read one by one with errors that name their place."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.decks.nastran.lexer import real
from ringtrue.errors import DeckError
from ringtrue.model.model import Ragged

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
        self.card, self.files = card, files

    def text(self, i: int) -> str:
        return self.card.fields[i] if i < len(self.card.fields) else ""

    def fail(self, name: str, why: str) -> DeckError:
        c = self.card
        return DeckError(why, path=self.files[c.file], line=c.line, card=c.name, field=name)

    def whole(self, i: int, name: str, default: int | None = None) -> int:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return whole(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not an integer") from None

    def real(self, i: int, name: str, default: float | None = None) -> float:
        t = self.text(i)
        if not t and default is not None:
            return default
        try:
            return real(t)
        except ValueError:
            raise self.fail(name, f"{t!r} is not a real") from None


def places(rows: Sequence[Card]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.array([c.file for c in rows], dtype=np.int64), np.array(
        [c.line for c in rows], dtype=np.int64
    )


def ragged(rows: Sequence[Sequence[Any]], dtype: Any) -> Ragged:
    values = [v for r in rows for v in r]
    return Ragged(np.array(values, dtype=dtype), np.cumsum([0, *map(len, rows)]).astype(np.int64))
