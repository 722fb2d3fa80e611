"""A finite element model as tables: one per card, columns named as in the Quick Reference Guide.

Errors that name the file and line of a card.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Int, frozen
from ringtrue.core.dofs import NO_DOFS, DofSet
from ringtrue.errors import DeckError, InputError, UnsupportedCard


@dataclass(frozen=True, slots=True, eq=False)
class Ragged:
    """Rows of different length: row i is `values[offsets[i]:offsets[i + 1]]`."""

    values: NDArray[Any]
    offsets: Int

    def __len__(self) -> int:
        return int(self.offsets.size - 1)

    def row(self, i: int) -> NDArray[Any]:
        """Row i."""
        return self.values[self.offsets[i] : self.offsets[i + 1]]

    @property
    def sizes(self) -> Int:
        """Length of each row, (n,) int64."""
        return np.diff(self.offsets)

    @classmethod
    def of(cls, rows: Sequence[NDArray[Any]]) -> Ragged:
        """From its rows, one or more."""
        return cls(np.concatenate(rows), np.cumsum([0, *(r.size for r in rows)]))

    def take(self, rows: Int) -> Ragged:
        """Rows (k,) in this order."""
        if not rows.size:
            return Ragged(self.values[:0], np.zeros(1, dtype=np.int64))
        return Ragged.of([self.row(i) for i in rows.tolist()])

    @property
    def owner(self) -> Int:
        """The row that each value belongs to, (k,) int64."""
        return np.repeat(np.arange(len(self)), self.sizes)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All cards of one name.

    Attributes
    ----------
    card : str
    columns : mapping of str to (n,) array or Ragged
        Named and typed as in `model.cards`; the first column identifies the row.
    file : (n,) int64
        Index into `Model.files`, -1 for a card that was not read from a file.
    line : (n,) int64
        Line of the card's first line, 1-based.
    """

    card: str
    columns: Mapping[str, NDArray[Any] | Ragged]
    file: Int
    line: Int

    def __len__(self) -> int:
        return int(self.file.size)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A plain column, (n,)."""
        column = self.columns[name]
        if isinstance(column, Ragged):
            raise KeyError(f"{self.card}.{name} is ragged: use .ragged({name!r})")
        return column

    def ragged(self, name: str) -> Ragged:
        """A ragged column."""
        column = self.columns[name]
        if not isinstance(column, Ragged):
            raise KeyError(f"{self.card}.{name} is not ragged")
        return column

    def entries(self, name: str) -> tuple[NDArray[Any], Int]:
        """Values of a column, plain or ragged, and the row of each, (k,)."""
        column = self.columns[name]
        if isinstance(column, Ragged):
            return column.values, column.owner
        return column, np.arange(column.size)

    def stack(self, *names: str) -> NDArray[Any]:
        """Plain columns side by side, (n, len(names))."""
        return np.stack([self[n] for n in names], axis=1)

    @property
    def ids(self) -> Int:
        """The identifying column, (n,) int64."""
        return self[next(iter(self.columns))]

    def find(self, ids: NDArray[Any]) -> Int:
        """Row of each id, (k,) int64, -1 where absent."""
        mine = self.ids
        want = np.asarray(ids, dtype=np.int64)
        if not mine.size:
            return np.full(want.shape, -1, dtype=np.int64)
        order = np.argsort(mine, kind="stable")
        at = np.searchsorted(mine[order], want).clip(max=mine.size - 1)
        return np.where(mine[order[at]] == want, order[at], -1)

    def take(self, rows: Int) -> Table:
        """The rows (k,) of the table, in this order."""
        columns: dict[str, NDArray[Any] | Ragged] = {}
        for name, column in self.columns.items():
            columns[name] = (
                column.take(rows) if isinstance(column, Ragged) else column[rows]
            )
        return replace(
            self, columns=columns, file=self.file[rows], line=self.line[rows]
        )

    def with_column(self, name: str, values: NDArray[Any]) -> Table:
        """A copy with one column replaced."""
        return replace(self, columns={**self.columns, name: frozen(values)})

    def with_values(self, name: str, rows: Int, values: Any) -> Table:
        """A copy with the values of some rows of a plain column replaced."""
        column = self[name].copy()
        column[rows] = values
        return self.with_column(name, column)


_SWITCH = {"YES": 1.0, "NO": 0.0}


@dataclass(frozen=True, slots=True)
class CaseControl:
    """The choices of the (first) subcase; 0 where not made.

    `k2gg`, `m2gg` and `b2gg` are the DMIG names that are added to stiffness, mass and damping, each
    with its factor, `k2pp`, `m2pp` and `b2pp` those that are so in responses alone
    (`choices.responding`); `others` are further subcases that compute modes, of other sets, and are
    not taken; `unread` are commands that add matrices in other solutions, as they stand.
    """

    title: str = ""
    method: int = 0
    spc: int = 0
    mpc: int = 0
    nsm: int = 0
    k2gg: tuple[tuple[float, str], ...] = ()
    m2gg: tuple[tuple[float, str], ...] = ()
    b2gg: tuple[tuple[float, str], ...] = ()
    k2pp: tuple[tuple[float, str], ...] = ()
    m2pp: tuple[tuple[float, str], ...] = ()
    b2pp: tuple[tuple[float, str], ...] = ()
    others: tuple[int, ...] = ()
    unread: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ComponentModes:
    """Which modes of a component are taken; none is the condensation of Guyan.

    Attributes
    ----------
    modal : DofSet
        Their coordinates.
    count : int
        At most; not more than coordinates.
    highest : float, Hz
    """

    modal: DofSet = NO_DOFS
    count: int = 0
    highest: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Superelement:
    """A part of a model, condensed onto the points around it; SEID of GRID names its interior
    points.

    Attributes
    ----------
    number : int
    elements : (n,) int64
        EID of all its elements.
    modes : ComponentModes
    """

    number: int
    elements: Int
    modes: ComponentModes


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A finite element model in the units of its deck.

    Attributes
    ----------
    tables : mapping of str to Table
        Cards that ringtrue understands; see `model.cards`.
    params : mapping of str to int, float or str
        PARAM cards, upper case.
    case : CaseControl
    files : tuple of str
        The deck and its includes, in reading order.
    kept : mapping of str to int
        Cards kept verbatim in the deck but not used here, with their number.
    units : str
        Unit system that the user states, of `core.units`.
    time : float, s
        The unit of time of the deck, which `model.seconds.in_seconds` has put into PARAM,WTMASS; 1
        if it has not.
    superelements : tuple of Superelement
        Those with bulk data of their own (BEGIN SUPER).
    """

    tables: Mapping[str, Table]
    params: Mapping[str, int | float | str] = field(default_factory=dict)
    case: CaseControl = field(default_factory=CaseControl)
    files: tuple[str, ...] = ()
    kept: Mapping[str, int] = field(default_factory=dict)
    units: str = "SI"
    time: float = 1.0
    superelements: tuple[Superelement, ...] = ()

    def __contains__(self, card: str) -> bool:
        return card in self.tables

    def __getitem__(self, card: str) -> Table:
        return self.tables[card]

    def param(self, name: str, default: float) -> float:
        """A numeric PARAM, or the default; YES is 1 and NO is 0.

        Raises
        ------
        DeckError
            If its value is another word, or blank.
        """
        value = self.params.get(name, default)
        value = _SWITCH.get(value, value) if isinstance(value, str) else value
        if isinstance(value, str):
            where = self.files[0] if self.files else None
            raise DeckError(
                f"{value!r} is not a number", path=where, card="PARAM", field=name
            )
        return float(value)

    def with_values(
        self, card: str, field_name: str, ids: NDArray[Any], values: NDArray[Any]
    ) -> Model:
        """A copy with `field_name` of the rows with these ids replaced.

        Raises
        ------
        InputError
            If the card, field or an id is not in the model.
        """
        if card not in self.tables or field_name not in self.tables[card].columns:
            raise InputError(f"no field {field_name} on a {card} card in this model")
        table = self.tables[card]
        at = table.find(ids)
        if (at < 0).any():
            raise InputError(
                f"{card} {np.asarray(ids)[at < 0][:5].tolist()} not in the model"
            )
        changed = table.with_values(field_name, at, values)
        return replace(self, tables={**self.tables, card: changed})

    def place(self, table: Table, row: int) -> tuple[str | None, int | None]:
        """File and line of a row of a table; None where it was read from no file."""
        file = int(table.file[row])
        if not 0 <= file < len(self.files):
            return None, None
        return self.files[file], int(table.line[row])


def table(card: str, **columns: Any) -> Table:
    """A table from columns given in memory (no file behind it); lists become arrays."""
    made = {k: v if isinstance(v, Ragged) else frozen(v) for k, v in columns.items()}
    n = len(next(iter(made.values())))
    return Table(card, made, np.full(n, -1), np.zeros(n, dtype=np.int64))


def stacked(*tables: Table) -> Table:
    """The rows of tables of the same columns, one after the other."""
    first = tables[0]
    return replace(
        first,
        columns={k: _behind([t.columns[k] for t in tables]) for k in first.columns},
        file=np.concatenate([t.file for t in tables]),
        line=np.concatenate([t.line for t in tables]),
    )


def _behind(columns: Sequence[NDArray[Any] | Ragged]) -> NDArray[Any] | Ragged:
    ragged = [c for c in columns if isinstance(c, Ragged)]
    if not ragged:
        return np.concatenate([np.asarray(c) for c in columns])
    ends = np.cumsum(np.concatenate([c.sizes for c in ragged]))
    return Ragged(
        np.concatenate([c.values for c in ragged]), np.concatenate([[0], ends])
    )


MOST = 6  # rows that a message names


def card_error(model: Model, table: Table, row: int, message: str) -> DeckError:
    """A DeckError at the place of a row of a table."""
    path, line = model.place(table, row)
    return DeckError(
        message, path=path, line=line, card=f"{table.card} {table.ids[row]}"
    )


def refuse_rows(model: Model, table: Table, rows: Int, message: str) -> None:
    """Raise a DeckError at the first of some rows of a table; nothing where there are none."""
    if rows.size:
        raise card_error(model, table, int(rows[0]), message)


def unsupported_card(model: Model, table: Table, row: int, why: str) -> UnsupportedCard:
    """An UnsupportedCard at the place of a row of a table."""
    path, line = model.place(table, row)
    return UnsupportedCard(
        table.card, path=path, line=line, why=f"{table.ids[row]} {why}"
    )


def called(model: Model, rows: Sequence[tuple[Table, int]]) -> str:
    """Rows of tables as a message calls them, with the lines of those that share a card and id."""
    names = [f"{t.card} {t.ids[i]}" for t, i in rows]
    names_shown = [
        f"{name} of line {line}"
        if names.count(name) > 1 and (line := model.place(*row)[1])
        else name
        for name, row in zip(names[:MOST], rows, strict=False)
    ]
    return ", ".join([*names_shown, *(["..."] if len(rows) > MOST else [])])
