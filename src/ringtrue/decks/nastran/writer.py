"""Bulk data cards as text, in the best precision that a field allows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from ringtrue.errors import InputError

Value = int | float | str | None


def format_real(value: float, width: int = 8) -> str:
    """A real in Nastran's shortest forms, at most `width` characters, as near to `value` as they
    allow.

    Exact where the shortest decimal that names the double fits; `-1.234-5`, `12346.+7` and
    `.12346-9` else.

    Raises
    ------
    InputError
        If the value is not finite.
    """
    if not math.isfinite(value):
        raise InputError(f"{value} cannot stand in a bulk data field")
    if value == 0:
        return "0.0"
    digits, exponent = _digits(repr(float(value)))
    for text in _forms(digits, exponent):
        if len(text) <= width:
            return text
    for count in range(min(len(digits.lstrip("-")), width), 0, -1):
        digits, exponent = _digits(f"{value:.{count - 1}e}")
        for text in _forms(digits, exponent):
            if len(text) <= width:
                return text
    raise InputError(f"{value} does not fit into a field of {width} characters")


def _digits(text: str) -> tuple[str, int]:
    """Signed significant digits and the exponent of the first: -0.0125 -> ("-125", -2)."""
    mantissa, _, power = text.partition("e")
    sign = "-" if mantissa.startswith("-") else ""
    whole, _, fraction = mantissa.lstrip("-").partition(".")
    digits = (whole + fraction).lstrip("0")
    lead = len(whole) if whole.strip("0") else len(fraction.lstrip("0")) - len(fraction)
    return sign + (digits.rstrip("0") or "0"), int(power or 0) + lead - 1


def _forms(digits: str, exponent: int) -> Iterator[str]:
    """Spellings, the pleasant ones first."""
    sign, d = ("-", digits[1:]) if digits.startswith("-") else ("", digits)
    if 0 <= exponent < 16:
        whole, fraction = d[: exponent + 1].ljust(exponent + 1, "0"), d[exponent + 1 :]
        yield f"{sign}{whole}.{fraction or '0'}"
        yield f"{sign}{whole}.{fraction}"
    elif -16 < exponent < 0:
        fraction = "0" * (-exponent - 1) + d
        yield f"{sign}0.{fraction}"
        yield f"{sign}.{fraction}"
    for point in (1, *range(2, 8), 0):
        power = exponent + 1 - point
        yield f"{sign}{d[:point].ljust(point, '0')}.{d[point:]}{f'{power:+d}' if power else ''}"


def format_field(value: Value, width: int = 8) -> str:
    """One field, not padded.

    Raises
    ------
    InputError
        If an integer or text does not fit, or a real is not finite.
    """
    if value is None:
        return ""
    text = format_real(value, width) if isinstance(value, float) else str(value)
    if len(text) > width:
        raise InputError(f"{text!r} does not fit into a field of {width} characters")
    return text


def format_card(name: str, fields: Sequence[Value], *, large: bool = False) -> str:
    """A card with its continuation lines, small (8) or large (16) fields.

    Parameters
    ----------
    name : str
    fields : sequence of int, float, str or None
        Field 2 onward, eight to a small line; None is blank.

    Raises
    ------
    InputError
        If a value does not fit into its field.
    """
    values = list(fields)
    while values and values[-1] is None:
        values.pop()
    width, per_line = (16, 4) if large else (8, 8)
    lines = []
    for start in range(0, max(len(values), 1), per_line):
        head = (f"{name}*" if large else name) if start == 0 else ("*" if large else "")
        body = "".join(
            format_field(v, width).rjust(width) for v in values[start : start + per_line]
        )
        lines.append((head.ljust(8) + body).rstrip() or "+")
    return "\n".join(lines) + "\n"
