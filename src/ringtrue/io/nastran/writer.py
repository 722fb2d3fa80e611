"""Bulk data cards as text, in the best precision that a field allows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ringtrue.errors import InputError

Value = int | float | str | None


def format_real(value: float, width: int = 8) -> str:
    """A real in Nastran's shortest forms, at most `width` characters, as near to `value` as they allow.

    Raises
    ------
    InputError
        If the value is not finite.
    """
    if not math.isfinite(value):
        raise InputError(f"{value} cannot stand in a bulk data field")
    if value == 0:
        return "0.0"
    best, error = "", math.inf
    for text in _forms(value, width):
        if len(text) <= width:
            off = abs(parse_real(text) - value)
            if off < error or (off == error and len(text) < len(best)):
                best, error = text, off
    return best


def _forms(value: float, width: int) -> list[str]:
    forms = []
    for digits in range(width):
        fixed = f"{value:.{digits}f}"
        fixed = fixed if "." in fixed else fixed + "."
        head, tail = fixed.split(".")
        tail = tail.rstrip("0")
        if head in ("0", "-0") and tail:
            forms.append(f"{head[:-1]}.{tail}")
        forms.append(f"{head}.{tail}" if tail else f"{head}.")
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        mantissa = mantissa.rstrip("0") if "." in mantissa else mantissa + "."
        forms.append(f"{mantissa}{int(exponent):+d}")
    return forms


def parse_real(text: str) -> float:
    """A Nastran real: `1.5-3`, `1.D+3`, `7.`, `.5`.

    Raises
    ------
    ValueError
        If it is not one.
    """
    t = text.strip().upper().replace("D", "E")
    if "E" not in t:
        for i in range(len(t) - 1, 0, -1):
            if t[i] in "+-":
                t = f"{t[:i]}E{t[i:]}"
                break
    return float(t)


def format_field(value: Value, width: int = 8) -> str:
    """One field, not padded.

    Raises
    ------
    InputError
        If an integer or text does not fit.
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
    """
    values = list(fields)
    while values and values[-1] is None:
        values.pop()
    width, per_line = (16, 4) if large else (8, 8)
    lines = []
    for start in range(0, max(len(values), 1), per_line):
        head = (f"{name}*" if large else name) if start == 0 else ("*" if large else "")
        body = "".join(format_field(v, width).rjust(width) for v in values[start : start + per_line])
        lines.append((head.ljust(8) + body).rstrip() or "+")
    return "\n".join(lines) + "\n"
