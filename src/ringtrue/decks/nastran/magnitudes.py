"""Numbers of a deck that no product of a few of them leaves within the range of doubles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ringtrue.errors import DeckError
from ringtrue.model.cards import columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.model import Ragged, Table

# of any unit: the product of six fields stays below 1.8e308, the largest double; 1/LARGEST the
# smallest
LARGEST = 1e50
_ALLOWED = (
    f"is beyond what can be computed with; allowed are 0 and {1 / LARGEST:g} to {LARGEST:g} in size"
)
_LIMITS = {  # allowable stresses, in which a large number stands for none; no matrix uses them
    "MAT1": ("ST", "SC", "SS"),
    "MAT2": ("ST", "SC", "SS"),
    "MAT8": ("XT", "XC", "YT", "YC", "S"),
}


def refuse_magnitudes(tables: Iterable[Table], files: tuple[str, ...]) -> None:
    """Refuse reals above `LARGEST` or, but for 0, below its inverse.

    Raises
    ------
    DeckError
        With file, line, card and field.
    """
    for table in tables:
        if table.card in METHODS:  # a large limit of the band stands for none
            continue
        for spec in columns(table.card):
            if (
                spec.kind != "f"
                or spec.name not in table.columns
                or spec.name in _LIMITS.get(table.card, ())
            ):
                continue
            column = table.columns[spec.name]
            values = column.values if isinstance(column, Ragged) else column
            size = np.abs(values)
            wild = np.flatnonzero((size > LARGEST) | ((size < 1 / LARGEST) & (size > 0)))
            if not wild.size:
                continue
            row = int(column.owner[wild[0]] if isinstance(column, Ragged) else wild[0])
            raise DeckError(
                f"{values[wild[0]]:g} {_ALLOWED}",
                path=files[table.file[row]],
                line=int(table.line[row]),
                card=f"{table.card} {table.ids[row]}",
                field=spec.name,
            )


def refuse_parameter(name: str, value: object, path: str, line: int) -> None:
    """Refuse a real PARAM beyond `LARGEST`, as `refuse_magnitudes` does."""
    if isinstance(value, float) and value and not 1 / LARGEST <= abs(value) <= LARGEST:
        raise DeckError(
            f"{value:g} {_ALLOWED}",
            path=path,
            line=line,
            card=f"PARAM {name}",
        )
