"""Times of samples: clocks as loggers write them, the rate of a column of times, and its faults.

Units of measured channels: the factor to SI and the quantity each unit belongs to.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np
from scipy.constants import g, inch, lbf

from ringtrue.core.arrays import Float, Int
from ringtrue.core.channels import UNIT
from ringtrue.core.signals import Quantity
from ringtrue.errors import DataError, did_you_mean

_DEGREE = float(np.pi / 180)
_FACTORS: dict[Quantity, dict[str, float]] = {  # to SI
    "acceleration": {
        "m/s^2": 1.0,
        "mm/s^2": 1e-3,
        "g": g,
        "mg": 1e-3 * g,
        "ug": 1e-6 * g,
        "in/s^2": inch,
        "ft/s^2": 12 * inch,
        "cm/s^2": 1e-2,
        "gal": 1e-2,
    },
    "velocity": {
        "m/s": 1.0,
        "cm/s": 1e-2,
        "mm/s": 1e-3,
        "um/s": 1e-6,
        "nm/s": 1e-9,
        "in/s": inch,
        "ft/s": 12 * inch,
    },
    "displacement": {
        "m": 1.0,
        "cm": 1e-2,
        "in": inch,
        "ft": 12 * inch,
        "mil": 1e-3 * inch,
        "mm": 1e-3,
        "um": 1e-6,
        "nm": 1e-9,
    },
    "force": {"n": 1.0, "kn": 1e3, "lbf": lbf},
    "rotation": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6},
    "angular velocity": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE},
    "angular acceleration": {"rad/s^2": 1.0, "deg/s^2": _DEGREE},
    "moment": {
        "n*m": 1.0,
        "kn*m": 1e3,
        "n*mm": 1e-3,
        "lbf*in": lbf * inch,
        "lbf*ft": lbf * 12 * inch,
    },
    "strain": {"strain": 1.0, "ustrain": 1e-6},
    "unknown": {"v": 1.0, "mv": 1e-3, "pa": 1.0},
}
_UNITS = {
    unit: (quantity, factor)
    for quantity, factors in _FACTORS.items()
    for unit, factor in factors.items()
}
# of a quantity or a unit
_SI = {**UNIT, "strain": "strain", "v": "V", "mv": "V", "pa": "Pa"}
_MOMENTS = {  # as they are also written
    f"{a}{by}{b}": moment
    for moment, *ways in (
        ("n*m", "n m"),
        ("kn*m", "kn m"),
        ("n*mm", "n mm"),
        ("lbf*in", "lbf in", "lb in", "in lbf", "in lb"),
        ("lbf*ft", "lbf ft", "lb ft", "ft lbf", "ft lb"),
    )
    for a, b in map(str.split, ways)
    for by in ("-", " ", ".", "*", "")
    if f"{a}{by}{b}" != "nm"  # a billionth of a metre
}
_SAME = {
    **_MOMENTS,
    "lb": "lbf",
    "lbs": "lbf",
    "g's": "g",
    "gs": "g",
    "gn": "g",
    "newton": "n",
    "newtons": "n",
    "volt": "v",
    "volts": "v",
    "m/s**2": "m/s^2",
    "inch": "in",
    "inches": "in",
    "mils": "mil",
    "micron": "um",
    "m/m": "strain",
    "°/s": "deg/s",
    "dps": "deg/s",
    **dict.fromkeys(("um/m", "uε", "ue", "ustr", "uepsilon", "microstrain"), "ustrain"),
}
_PLAIN = str.maketrans({"·": "*", "²": "^2", "µ": "u", "μ": "u"})
_AXES = {  # to Hz or s
    **dict.fromkeys(("rad/s", "rad/sec", "rads/s", "rad/second"), 0.5 / np.pi),
    **dict.fromkeys(("rpm", "1/min", "cpm"), 1 / 60),
    "khz": 1e3,
    "ms": 1e-3,
    "msec": 1e-3,
    "us": 1e-6,
    "min": 60.0,
}

_OF_LINES = re.compile(
    r"(?<![A-Za-z])(k?hz|rad/s(ec)?|rpm|cpm|1/min|omega)(?![A-Za-z])", re.IGNORECASE
)


def to_si(unit: str, quantity: str = "") -> tuple[Quantity, float, str]:
    """Quantity, factor and SI unit of a unit as written on a sensor sheet.

    An empty unit is taken as SI of the given quantity.

    Raises
    ------
    DataError
        On an unknown unit or quantity, or one that contradicts the other.
    """
    allowed = get_args(Quantity)
    if quantity and quantity not in allowed:
        raise DataError(f"quantity {quantity!r}{did_you_mean(quantity, allowed)}")
    text = unit.strip()
    text = "n*m" if text in ("Nm", "NM") else text.lower().translate(_PLAIN)
    if not text:
        return quantity or "unknown", 1.0, UNIT.get(quantity, "")  # type: ignore[return-value]
    text = text.replace("/sec", "/s").replace("/s/s", "/s^2")
    text = _SAME.get(text, text[:-1] + "^2" if text.endswith("/s2") else text)
    if text not in _UNITS:
        raise DataError(f"unit {unit!r}{did_you_mean(text, _UNITS)}")
    kind, factor = _UNITS[text]
    if kind == "unknown":  # as volts, of any quantity
        return quantity or kind, factor, _SI[text]  # type: ignore[return-value]
    if quantity not in ("", "unknown", kind):
        raise DataError(f"unit {unit!r} is {kind}, the channel says {quantity}")
    return kind, factor, _SI[kind]


def known(unit: str) -> str:
    """The unit, or an empty text where `to_si` does not know it: free text of a foreign file."""
    try:
        to_si(unit)
    except DataError:
        return ""
    return unit


def axis_factor(unit: str) -> float:
    """To Hz of a unit of frequency, to s of one of time; 1 of any other text."""
    return _AXES.get(unit.strip().lower(), 1.0)


def hertz(title: str) -> float:
    """The factor to Hz of what is titled as frequencies, such as `f [kHz]` or `omega`."""
    found = _OF_LINES.search(title)
    unit = found[1].lower() if found else "Hz"
    return axis_factor("rad/s" if unit == "omega" else unit)


_DAY = r"(?P<a>\d{1,4})[-/.](?P<b>\d{1,2})[-/.](?P<c>\d{1,4})"
_HOUR = r"(?P<h>\d{1,2}):(?P<m>\d\d)(:(?P<s>\d\d)([.,:](?P<f>\d+))?)?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_CLOCK = re.compile(rf"\s*({_DAY})?\.?[ T,]*({_HOUR})?\s*(Z|UTC|[+-]\d\d:?\d\d)?\s*$")


def is_clock(text: str) -> bool:
    """Whether a text is a date, a time of day or both."""
    found = _CLOCK.match(text)
    return found is not None and (found["a"] is not None or found["h"] is not None)


def seconds(texts: Sequence[str]) -> Float:
    """Seconds (k,) since the first of such texts; a time of day that falls begins a new day.

    `01.05.2024` and `2024-05-01` are the first of May; of dates with strokes the number above 12 is
    the day, and the month stands first where none is.

    Raises
    ------
    ValueError
        If one is none.
    """
    for text in texts:
        if not is_clock(text):
            raise ValueError(f"{text!r} is no date or time")
    parts = [m for text in texts if (m := _CLOCK.match(text))]
    hours = np.array([second_of_day(text) for text in texts])
    night = np.concatenate([[0], np.cumsum(np.diff(hours) < -43200)])
    days = night if parts[0]["a"] is None else _days(parts)
    return np.asarray((days - days[0]) * 86400.0 + (hours - hours[0]))


def second_of_day(text: str) -> float:
    """Seconds of the day of a date or time of day; 0 where there is no clock."""
    m = _CLOCK.match(text)
    if m is None or m["h"] is None:
        return 0.0
    h = int(m["h"])
    if m["half"]:
        h = h % 12 + (12 if m["half"][0] in "Pp" else 0)
    return (
        3600.0 * h + 60.0 * int(m["m"]) + int(m["s"] or 0) + float(f"0.{m['f'] or 0}")
    )


def _days(parts: Sequence[re.Match[str]]) -> Float:
    a, b, c = (np.array([int(m[k] or 0) for m in parts]) for k in "abc")
    if a.max() > 31:
        year = a
        month = b
        day = c
    else:
        american = "/" in (parts[0][0]) and a.max() <= 12
        year = c
        month = a if american else b
        day = b if american else a
    year = np.where(year < 100, year + 2000, year)
    texts = [
        f"{y:04d}-{m:02d}-{d:02d}"
        for y, m, d in zip(year.tolist(), month.tolist(), day.tolist(), strict=True)
    ]
    return np.array(texts, dtype="datetime64[D]").astype(np.float64)


log = logging.getLogger(__name__)
_EPOCHS = (
    (1e17, 1e-9),
    (1e14, 1e-6),
    (1e11, 1e-3),
)  # since 1970: above this the unit is that of seconds
_DAYS = (
    (2e4, 8e4),
    (7e5, 8e5),
)  # since 1900 as spreadsheets count them, since the year 0 as MATLAB does
_SLOW_DAYS = 0.5 / 86400  # d: longer steps are no samples of vibration
THIN = 0.5  # share of the rows that must be there, where some are missing
LONG = 64  # samples: a shorter table is no record


def in_seconds(t: Float) -> Float:
    """Times (row,), s, of ones that are s, or ms, us or ns since 1970, or days as Excel and MATLAB
    count them.
    """
    if not t.size:
        return t
    first = float(t[0])
    step = float(t[-1] - t[0]) / max(t.size - 1, 1)
    unit = next((u for above, u in _EPOCHS if first > above), 1.0)
    if any(low < first < high for low, high in _DAYS) and 0 < step < _SLOW_DAYS:
        unit = 86400.0
    return t if unit == 1.0 else np.asarray((t - t[0]) * unit)


def even_rate(t: Float, path: Path) -> float | None:
    """The rate of a column of times (row,); None where they are not even, of which `uneven` says
    how.
    """
    step = np.diff(t)
    rises = step.any() and np.isfinite(step).all() and (step >= 0).all()
    if not rises or not ((step > 0).all() or _rounded(t)):
        return None
    mean = float(step.mean())
    if np.abs(step - mean).max() > 0.05 * mean + 1e-6 * np.abs(
        t
    ).max() and not _rounded(t):
        off = float(np.abs(t - _line(t)).max()) / mean
        # 0.5: of a step: each time still has a place of its own on the even grid
        if t.size < LONG or off >= 0.5:
            return None
        log.warning(
            "%s: times jitter by up to %.2g of a step: taken for the stamps of even samples",
            path,
            off,
        )
    return _shortest_rate(t, mean)


def _line(t: Float) -> Float:
    """Even times through those of a column (row,), by least squares."""
    k = np.arange(t.size)
    return np.polynomial.Polynomial.fit(k, t, 1)(k)


def even_grid(t: Float, named: bool, path: Path) -> tuple[float | None, Int | None]:
    """The rate of a time column as `even_rate`, and where rows are missing the place of each,
    (row,) int64.
    """
    rate = even_rate(t, path)
    if rate is not None:
        return rate, None
    if (found := _with_missing(t, path)) is not None:
        return found
    if named:
        raise DataError(f"{path}: {uneven(t)}")
    return None, None


def _with_missing(t: Float, path: Path) -> tuple[float, Int] | None:
    """Rate and place of each row of times that are even but for jumps over missing rows; None where
    they are not.
    """
    step = np.diff(t)
    if step.size < 2 or not np.isfinite(step).all() or not (step > 0).all():
        return None
    parts = np.split(t, np.flatnonzero(step > 1.5 * np.median(step)) + 1)
    rate = even_rate(max(parts, key=len), path)
    if rate is None or len(parts) == 1:
        return None
    first = np.round((np.array([x[0] for x in parts]) - t[0]) * rate).astype(np.int64)
    rows = np.concatenate(
        [a + np.arange(x.size) for a, x in zip(first, parts, strict=True)]
    )
    if (
        not (np.diff(rows) > 0).all()
        or np.abs((t - t[0]) * rate - rows).max() > 1
        or rows[-1] + 1 > t.size / THIN
    ):
        return None
    return rate, rows


def _shortest_rate(t: Float, step: float) -> float:
    """The rate with the fewest digits that the times, written with so many decimals, allow: 1024,
    not 1023.99997.
    """
    k = np.arange(t.size)
    off = 2 * float(np.abs(t - t[0] - k * step).max())
    rates = (float(f"{1 / step:.{digits}g}") for digits in range(1, 16))
    return next((r for r in rates if abs(k[-1] / r - (t[-1] - t[0])) <= off), 1 / step)


def uneven(t: Float) -> str:
    """What is wrong with a column of times: it does not rise, or its steps are uneven, with gaps
    between stretches of even ones or without.
    """
    if t.size < 2:
        return "the time column has fewer than 2 rows"
    if not np.isfinite(t).all():
        return (
            f"the time column has no number at row {int(np.isfinite(t).argmin()) + 1}"
        )
    step = np.diff(t)
    falls = step <= 0
    if falls.any() and not ((step >= 0).all() and step.any() and _rounded(t)):
        at = int(falls.argmax())
        what = f"goes back by {-step[at]:g} s" if step[at] < 0 else "stands still"
        return (
            f"the time column does not rise: it {what} behind row {at + 1}, "
            f"{np.count_nonzero(falls)} times in all"
        )
    usual = float(np.median(step))
    odd = np.abs(step - usual) > 0.05 * usual
    gaps = np.flatnonzero(odd & (step > 1.5 * usual))
    if 0 < gaps.size == odd.sum():
        rows = ", ".join(f"{step[k]:g} s behind row {k + 1}" for k in gaps[:3].tolist())
        more = f" and {gaps.size - 3} more" if gaps.size > 3 else ""
        return (
            f"samples are missing: {rows}{more}, where a step is {usual:g} s. Cut the file there, "
            "each part with its header: the parts are records of their own. An ambient record may "
            "lack up to half of its rows (gaps=True)"
        )
    at = int(np.abs(step - step.mean()).argmax())
    return (
        f"the time column has uneven steps: {step[at]:g} s at row {at + 1}, "
        f"mean {step.mean():g} s"
    )


def _rounded(t: Float) -> bool:
    """Whether the times are even ones, written with few decimals."""
    line = _line(t)
    top = max(float(np.abs(t).max()), 1e-300)
    decade = np.floor(np.log10(np.maximum(np.abs(t), 1e-12 * top) * (1 + 1e-12)))
    decimals = [np.full(t.size, 10.0**-k) for k in range(1, 7)]
    digits = [10.0 ** (decade + 1 - k) for k in range(3, 10)]
    for unit in (*decimals, *digits):
        written = np.abs(np.round(t / unit) * unit - t).max() < 1e-9 * top
        if written and np.abs(t - line).max() <= 0.75 * unit.max():
            return True
    return False
