"""A model's tables as bulk data text, for programs that read decks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.bulk_special import SPECIAL
from ringtrue.decks.nastran.writer import format_card, format_real
from ringtrue.errors import UnsupportedError
from ringtrue.model.cards import CARDS, FieldSpec, columns
from ringtrue.model.case_control import METHODS
from ringtrue.model.dimensions import MADE
from ringtrue.model.model import Model, Table

TOO_LONG = 10**8  # an id of more than eight characters
NOT_MODEL = frozenset(METHODS)  # the caller's choice, not the model's
Text = NDArray[np.str_]


def write_bulk(model: Model, *, without: Collection[str] = NOT_MODEL) -> str:
    """The model as bulk data cards: small fields where they hold the values exactly, large ones
    elsewhere.

    Parameters
    ----------
    model : Model
    without : collection of str
        Cards and PARAMs that are left out.

    Returns
    -------
    str
        Cards only: no BEGIN BULK, no ENDDATA, no case control. Reals keep at least nine digits.

    Raises
    ------
    UnsupportedError
        If the model holds a card that this writer does not know.
    """
    params = [
        format_card("PARAM", (name, value if not isinstance(value, float) else _short(value)))
        for name, value in model.params.items()
        if name not in without
    ]
    return "".join(
        [
            *params,
            *(
                text
                for card, t in model.tables.items()
                if card not in without
                for text in _cards(t)
            ),
        ]
    )


def _short(value: float) -> str:
    return format_real(value, 8)


def _cards(table: Table) -> Iterator[str]:
    if not len(table) or table.card in MADE:  # the PBAR or PBEAM is written in its place
        return
    if table.card in SPECIAL:
        yield "".join(SPECIAL[table.card](table))
    elif table.card in CARDS:
        yield from _uniform(table)
    else:
        raise UnsupportedError(f"{table.card} cards cannot be written for another solver")


def _uniform(table: Table) -> Iterator[str]:
    """Cards of `model.cards`, all rows at once."""
    specs = columns(table.card)
    if any(s.tail for s in specs):
        yield "".join(_lists(table, specs))
        return
    small = _fields(table, specs, 8)
    if _exact(table, specs, small):
        yield _lines(table.card, small, 8)
    else:
        yield _lines(table.card, _fields(table, specs, 16), 16)


def _fields(table: Table, specs: Sequence[FieldSpec], width: int) -> Text:
    """All data fields as text, (row, field) str."""
    made = [_column(table, s, width) for s in specs]
    return np.stack(_either(table, specs, made), axis=1)


def _column(table: Table, spec: FieldSpec, width: int) -> Text:
    if spec.blank:
        return np.full(len(table), "", dtype=f"U{width}")
    values = table[spec.name]
    if spec.kind == "f":
        return _reals(values, width)
    text = values.astype(f"U{width}")
    return np.where(values == spec.default, "", text) if spec.default in (0, -1) else text


def _reals(values: Float, width: int) -> Text:
    """Reals as text, defaults too: MYSTRAN has 0 for a blank S of a CBUSH. Each different value is
    formatted once.
    """
    unique, at = np.unique(values, return_inverse=True)
    text = ["" if np.isnan(v) else format_real(v, width) for v in unique.tolist()]
    return np.array(text, dtype=f"U{width}")[at.reshape(-1)]


def _either(table: Table, specs: Sequence[FieldSpec], made: list[Text]) -> list[Text]:
    """Fields that hold a number of a node or frame, or a real: `G0|X1`, `MCID|THETA`."""
    for j, spec in enumerate(specs):
        if not spec.other:
            continue
        chosen = table[spec.other]
        vector = spec.other == "G0"  # the rest of the vector follows
        none = np.zeros(len(table), dtype=bool)
        if vector:
            none = ~np.any([table[f"X{k}"] for k in (1, 2, 3)], axis=0)
            for k in (1, 2):
                made[j + k] = np.where((chosen > 0) | none, "", made[j + k])
        real = np.where(none, "", made[j])
        made[j] = np.where(chosen > spec.other_default, chosen.astype(real.dtype), real)
    return made


def _exact(table: Table, specs: Sequence[FieldSpec], small: Text) -> bool:
    """Whether all numbers keep their value in eight characters."""
    for j, spec in enumerate(specs):
        if spec.kind == "i" and not spec.blank and table[spec.name].max(initial=0) >= TOO_LONG:
            return False
        if spec.kind == "f" and not spec.blank:
            text, first = np.unique(small[:, j], return_index=True)
            given = text != ""
            back = np.array([_value(t) for t in text[given].tolist()])
            if (back != table[spec.name][first[given]]).any() or np.unique(
                table[spec.name]
            ).size > text.size:
                return False
    return True


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # 1.2-8
        sign, body = text[0] if text[0] in "+-" else "", text.lstrip("+-")
        cut = max(body.rfind("+"), body.rfind("-"))
        return float(f"{sign}{body[:cut]}e{body[cut:]}") if cut > 0 else float("inf")


def _lines(card: str, cells: Text, width: int) -> str:
    """Cards of (row, field) text in fixed columns; blank lines at the end of a card are left
    out.
    """
    per_line = 64 // width
    n = -(-cells.shape[1] // per_line)
    padded = np.full((len(cells), n * per_line), "", dtype=cells.dtype)
    padded[:, : cells.shape[1]] = cells
    used = np.where(padded != "", np.arange(padded.shape[1]) // per_line + 1, 1).max(axis=1)
    if width == 16:
        used += used % 2  # large-field lines come in pairs
    head = [card.ljust(8) if width == 8 else f"{card}*".ljust(8)] + [
        ("" if width == 8 else "*").ljust(8)
    ] * n
    out = np.empty(len(cells), dtype=object)
    for k in np.unique(used).tolist():
        rows = np.flatnonzero(used == k)
        block = np.strings.rjust(padded[rows, : min(k, n) * per_line], width)
        text = "".join
        out[rows] = [
            "\n".join(
                (head[i] + text(row[i * per_line : (i + 1) * per_line])).rstrip() for i in range(k)
            )
            for row in block.tolist()
        ]
    return "\n".join(out.tolist()) + "\n"


def _lists(table: Table, specs: Sequence[FieldSpec]) -> Iterator[str]:
    """Cards that end in a list of integers, such as SPC1 and RBE2."""
    heads = [_column(table, s, 8).tolist() for s in specs[:-1]]
    tail = table.ragged(specs[-1].name)
    if len(specs) == 1:  # SPOINT: points in lines of eight
        for a in range(0, tail.values.size, 8):
            yield format_card(table.card, tail.values[a : a + 8].tolist())
        return
    for i, head in enumerate(zip(*heads, strict=True)):
        if tail.row(i).size:
            yield format_card(table.card, [t or None for t in head] + tail.row(i).tolist())
