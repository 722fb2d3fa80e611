"""Numbers as a reader may trust them: an error has two significant digits, and its value ends at
the same place.
"""

from __future__ import annotations

import math

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
        raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return f"{mantissa.replace('-', '−')} × 10{raised}"
    text = f"{value:.{max(digits - 1 - power, 0)}f}"
    if abs(value) >= 10000:
        text = f"{value:,.0f}".replace(",", "\u202f")
    return text.replace("-", "−")


def _power(value: float, digits: int) -> int:
    """Power of ten of the first digit, once the value is rounded to `digits`."""
    return math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))


def with_error(value: float | None, std: float | None, digits: int = 4) -> tuple[str, str]:
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
