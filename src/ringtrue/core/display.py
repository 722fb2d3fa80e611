"""Results show themselves: a table with units, in print and in a notebook, and a figure.

`plot` is the one door upward of the project: `ringtrue.plots.results` registers the drawings. It is
imported when a result is drawn for the first time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from html import escape
from importlib import import_module
from typing import Any, ClassVar, TypeVar

import numpy as np

from ringtrue.errors import UnsupportedError

MOST_ROWS = 60  # of a table
DRAWINGS = "ringtrue.plots.results"  # the module that registers the drawings
T = TypeVar("T")
_DRAWINGS: dict[type, Callable[[Any], Any]] = {}


def drawing(kind: type[T]) -> Callable[[Callable[[T], Any]], Callable[[T], Any]]:
    """Register a function as the drawing of a type: result in, plotly figure out."""

    def register(draw: Callable[[T], Any]) -> Callable[[T], Any]:
        _DRAWINGS[kind] = draw
        return draw

    return register


def plot(result: object) -> Any:
    """The plotly figure of a result.

    Raises
    ------
    UnsupportedError
        If results of this type have no drawing.
    """
    import_module(DRAWINGS)
    for kind in type(result).__mro__:
        if kind in _DRAWINGS:
            return _DRAWINGS[kind](result)
    raise UnsupportedError(f"{type(result).__name__}: there is no drawing of it; see its fields")


class Displayed:
    """A frozen dataclass that shows and draws itself.

    Columns of equal length make one table, a row a mode (a pair, a parameter); single values stand
    above it, and larger arrays by their shape. `UNITS` has the unit of each field.
    """

    __slots__ = ()
    UNITS: ClassVar[Mapping[str, str]] = {}

    def plot(self) -> Any:
        """The plotly figure of this result."""
        return plot(self)

    def displayed(self) -> Mapping[str, Any]:
        """What is shown, by name: all fields."""
        assert is_dataclass(self)
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def _repr_html_(self) -> str:
        return _html(self)

    def __str__(self) -> str:
        return _text(self)


@dataclass(frozen=True, slots=True)
class _Table:
    """Fields of a result in print: single values by name, then columns under their heads."""

    single: dict[str, str]
    heads: list[str]
    rows: list[list[str]]
    more: str


def _table(result: Displayed) -> _Table:
    values = result.displayed()
    units = type(result).UNITS
    columns = {k: v for k, v in values.items() if _is_column(v)}
    sizes = [len(v) for v in columns.values()]
    length = max(set(sizes), key=sizes.count, default=0)
    columns = {k: v for k, v in columns.items() if len(v) == length}
    single = {
        _head(name, units): _cell(value)
        for name, value in values.items()
        if name not in columns and _is_shown(value)
    }
    shown = min(length, MOST_ROWS)
    rows = [[str(i + 1), *(_cell(c[i]) for c in columns.values())] for i in range(shown)]
    more = f"and {length - shown} more rows" if length > shown else ""
    return _Table(single, ["#", *(_head(name, units) for name in columns)], rows, more)


def _html(result: Displayed) -> str:
    table = _table(result)
    lines = [f"<div>{escape(f'{name}: {value}')}</div>" for name, value in table.single.items()]
    head = "".join(f"<th>{escape(name)}</th>" for name in table.heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    title = f"<b>{escape(type(result).__name__)}</b>"
    more = f"<div>{table.more}</div>" if table.more else ""
    return f"{title}{''.join(lines)}<table><tr>{head}</tr>{body}</table>{more}"


def _text(result: Displayed) -> str:
    table = _table(result)
    lines = [type(result).__name__, *(f"{name}: {value}" for name, value in table.single.items())]
    if table.rows:
        widths = [max(map(len, column)) for column in zip(table.heads, *table.rows, strict=True)]
        for row in (table.heads, *table.rows):
            cells = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
            lines.append("  ".join(cells))
    return "\n".join([*lines, table.more] if table.more else lines)


def _is_column(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 1
    plain = (str, int, float)
    return isinstance(value, tuple) and bool(value) and all(isinstance(v, plain) for v in value)


def _is_shown(value: Any) -> bool:
    if isinstance(value, str):
        return bool(value)
    return isinstance(value, int | float | Enum | np.ndarray)


def _head(name: str, units: Mapping[str, str]) -> str:
    unit = units.get(name)
    if not unit:
        return name.replace("_", " ")
    plain = name.removesuffix("_hz").removesuffix("_percent")
    return f"{plain.replace('_', ' ')} [{unit}]"


def _cell(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.5g}"
    return str(value)
