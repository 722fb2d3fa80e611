"""Results show themselves: a table with units in a notebook, and a figure.

`plot` is the one door upward of the project: `ringtrue.plots.results` registers the drawings. It is
imported when a result is drawn for the first time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from importlib import import_module
from typing import Any, ClassVar, TypeVar

import numpy as np

from ringtrue.errors import UnsupportedError

MOST_ROWS = 60  # of a table in a notebook
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

    def _repr_html_(self) -> str:
        return html_table(self, type(self).UNITS)


def html_table(result: Any, units: Mapping[str, str]) -> str:
    """A result as HTML, made from the names and units of its fields."""
    assert is_dataclass(result)
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    columns = {k: v for k, v in values.items() if _is_column(v)}
    sizes = [len(v) for v in columns.values()]
    length = max(set(sizes), key=sizes.count, default=0)
    columns = {k: v for k, v in columns.items() if len(v) == length}
    lines = [
        f"<div>{_head(name, units)}: {_cell(value)}</div>"
        for name, value in values.items()
        if name not in columns and _is_shown(value)
    ]
    head = "".join(f"<th>{_head(name, units)}</th>" for name in columns)
    body = "".join(
        f"<tr><td>{i + 1}</td>"
        + "".join(f"<td>{_cell(c[i])}</td>" for c in columns.values())
        + "</tr>"
        for i in range(min(length, MOST_ROWS))
    )
    more = f"<div>and {length - MOST_ROWS} more rows</div>" if length > MOST_ROWS else ""
    title = f"<b>{escape(type(result).__name__)}</b>"
    return f"{title}{''.join(lines)}<table><tr><th>#</th>{head}</tr>{body}</table>{more}"


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
    unit = f" [{units[name]}]" if units.get(name) else ""
    return escape(name.replace("_", " ") + unit)


def _cell(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, Enum):
        return escape(str(value.value))
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.5g}"
    return escape(str(value))
