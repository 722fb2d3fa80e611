"""Units of measured channels: the factor to SI and the quantity each unit belongs to."""

from __future__ import annotations

import re
from typing import get_args

import numpy as np

from ringtrue.core.motions import UNIT
from ringtrue.core.signals import Quantity
from ringtrue.errors import DataError, did_you_mean

G = 9.80665  # standard gravity, m/s^2
_INCH = 0.0254
_DEGREE = float(np.pi / 180)
_UNITS: dict[str, tuple[Quantity, float, str]] = {
    "m/s^2": ("acceleration", 1.0, "m/s^2"),
    "mm/s^2": ("acceleration", 1e-3, "m/s^2"),
    "g": ("acceleration", G, "m/s^2"),
    "mg": ("acceleration", 1e-3 * G, "m/s^2"),
    "ug": ("acceleration", 1e-6 * G, "m/s^2"),
    "in/s^2": ("acceleration", _INCH, "m/s^2"),
    "ft/s^2": ("acceleration", 12 * _INCH, "m/s^2"),
    "cm/s^2": ("acceleration", 1e-2, "m/s^2"),
    "gal": ("acceleration", 1e-2, "m/s^2"),
    "m/s": ("velocity", 1.0, "m/s"),
    "cm/s": ("velocity", 1e-2, "m/s"),
    "mm/s": ("velocity", 1e-3, "m/s"),
    "um/s": ("velocity", 1e-6, "m/s"),
    "nm/s": ("velocity", 1e-9, "m/s"),
    "in/s": ("velocity", _INCH, "m/s"),
    "ft/s": ("velocity", 12 * _INCH, "m/s"),
    "m": ("displacement", 1.0, "m"),
    "cm": ("displacement", 1e-2, "m"),
    "in": ("displacement", _INCH, "m"),
    "ft": ("displacement", 12 * _INCH, "m"),
    "mil": ("displacement", 1e-3 * _INCH, "m"),
    "mm": ("displacement", 1e-3, "m"),
    "um": ("displacement", 1e-6, "m"),
    "nm": ("displacement", 1e-9, "m"),
    "n": ("force", 1.0, "N"),
    "kn": ("force", 1e3, "N"),
    "lbf": ("force", 4.4482216152605, "N"),
    "rad": ("rotation", 1.0, "rad"),
    "mrad": ("rotation", 1e-3, "rad"),
    "urad": ("rotation", 1e-6, "rad"),
    "rad/s": ("angular velocity", 1.0, "rad/s"),
    "mrad/s": ("angular velocity", 1e-3, "rad/s"),
    "deg/s": ("angular velocity", _DEGREE, "rad/s"),
    "rad/s^2": ("angular acceleration", 1.0, "rad/s^2"),
    "deg/s^2": ("angular acceleration", _DEGREE, "rad/s^2"),
    "n*m": ("moment", 1.0, "N*m"),
    "kn*m": ("moment", 1e3, "N*m"),
    "n*mm": ("moment", 1e-3, "N*m"),
    "lbf*in": ("moment", 4.4482216152605 * _INCH, "N*m"),
    "lbf*ft": ("moment", 4.4482216152605 * 12 * _INCH, "N*m"),
    "strain": ("strain", 1.0, "strain"),
    "ustrain": ("strain", 1e-6, "strain"),
    "v": ("unknown", 1.0, "V"),
    "mv": ("unknown", 1e-3, "V"),
    "pa": ("unknown", 1.0, "Pa"),
}
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
    text = "N*m" if unit.strip() in ("Nm", "NM") else unit
    text = (
        text.strip()
        .lower()
        .replace("·", "*")
        .replace("²", "^2")
        .replace("µ", "u")
        .replace("μ", "u")
    )
    if not text:
        return quantity or "unknown", 1.0, UNIT.get(quantity, "")  # type: ignore[return-value]
    text = text.replace("/sec", "/s").replace("/s/s", "/s^2")
    text = _SAME.get(text, text[:-1] + "^2" if text.endswith("/s2") else text)
    if text not in _UNITS:
        raise DataError(f"unit {unit!r}{did_you_mean(text, _UNITS)}")
    kind, factor, si = _UNITS[text]
    if quantity not in ("", "unknown", kind) and kind != "unknown":
        raise DataError(f"unit {unit!r} is {kind}, the channel says {quantity}")
    return (kind if kind != "unknown" else quantity or "unknown"), factor, si  # type: ignore[return-value]


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
    unit = _OF_LINES.search(title)
    return axis_factor(
        "rad/s" if unit and unit[1].lower() == "omega" else unit[1] if unit else "Hz"
    )
