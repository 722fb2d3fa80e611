"""Results show themselves: a table with units, in print and in a notebook, and a figure.

Numbers are written as a reader may trust them: an error has two significant digits, and its value
ends at the same place.

`plot` is the one door upward of the project: `ringtrue.plots.results` registers the drawings. It is
imported when a result is drawn for the first time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from html import escape
from importlib import import_module
from typing import Any, ClassVar, TypeVar

import numpy as np

from ringtrue.errors import UnsupportedError

MISSING = "–"


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits, plain where that is readable; `–` where
    unknown.
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    power = _power(value, digits)
    if power < -4 or power > 6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        raised = str(int(exponent)).translate(
            str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
        )
        return f"{mantissa.replace('-', '−')} × 10{raised}"
    text = f"{value:.{max(digits - 1 - power, 0)}f}"
    if abs(value) >= 10000:
        text = f"{value:,.0f}".replace(",", "\u202f")
    return text.replace("-", "−")


def _power(value: float, digits: int) -> int:
    """Power of ten of the first digit, once the value is rounded to `digits`."""
    return math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))


def with_error(
    value: float | None, std: float | None, digits: int = 4
) -> tuple[str, str]:
    """A value and its standard deviation, the two to the same place.

    Two digits of the standard deviation are kept (JCGM 100:2008, 7.2.6): a third one says nothing
    with less than some thousand repetitions.

    Parameters
    ----------
    value, std : float or None
        In one unit.
    digits : int
        Significant digits of a value without a standard deviation.

    Returns
    -------
    tuple of str
        `–` where unknown.
    """
    if value is None or not math.isfinite(value) or not std or not math.isfinite(std):
        return number(value, digits), number(std, 2)
    last = _power(std, 2) - 1  # power of ten of the last place
    error = number(round(std, -last), 2)
    rounded = round(value, -last)
    if rounded == 0:
        return "0", error
    return number(rounded, max(_power(rounded, 15) - last + 1, 1)), error


def plus_minus(value: float | None, std: float | None, digits: int = 4) -> str:
    """`1.327 ± 0.023`; the value alone where its standard deviation is unknown."""
    shown, error = with_error(value, std, digits)
    return shown if error == MISSING else f"{shown} ± {error}"


def standard_deviations(ratio: float) -> str:
    """A deviation in standard deviations; beyond 100 its size says nothing that a reader can
    use.
    """
    if ratio > 100:
        return "> 100"
    return number(ratio, 2)


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
    raise UnsupportedError(
        f"{type(result).__name__}: there is no drawing of it; see its fields"
    )


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
    rows = [
        [str(i + 1), *(_cell(c[i]) for c in columns.values())] for i in range(shown)
    ]
    more = f"and {length - shown} more rows" if length > shown else ""
    return _Table(single, ["#", *(_head(name, units) for name in columns)], rows, more)


def _html(result: Displayed) -> str:
    table = _table(result)
    lines = [
        f"<div>{escape(f'{name}: {value}')}</div>"
        for name, value in table.single.items()
    ]
    head = "".join(f"<th>{escape(name)}</th>" for name in table.heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in table.rows
    )
    title = f"<b>{escape(type(result).__name__)}</b>"
    more = f"<div>{table.more}</div>" if table.more else ""
    return f"{title}{''.join(lines)}<table><tr>{head}</tr>{body}</table>{more}"


def _text(result: Displayed) -> str:
    table = _table(result)
    lines = [
        type(result).__name__,
        *(f"{name}: {value}" for name, value in table.single.items()),
    ]
    if table.rows:
        widths = [
            max(map(len, column))
            for column in zip(table.heads, *table.rows, strict=True)
        ]
        for row in (table.heads, *table.rows):
            cells = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
            lines.append("  ".join(cells))
    return "\n".join([*lines, table.more] if table.more else lines)


def _is_column(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 1
    plain = (str, int, float)
    return (
        isinstance(value, tuple)
        and bool(value)
        and all(isinstance(v, plain) for v in value)
    )


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
