"""Dates and times of day as loggers write them, turned to seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float

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
    found = [_CLOCK.match(x) for x in texts]
    if bad := [
        x
        for x, m in zip(texts, found, strict=True)
        if m is None or (m["a"] is None and m["h"] is None)
    ]:
        raise ValueError(f"{bad[0]!r} is no date or time")
    parts = [m for m in found if m is not None]
    hours = np.array([_hour(m) for m in parts])
    night = np.concatenate([[0], np.cumsum(np.diff(hours) < -43200)])
    days = night if parts[0]["a"] is None else _days(parts)
    return np.asarray((days - days[0]) * 86400.0 + (hours - hours[0]))


def _hour(m: re.Match[str]) -> float:
    """Seconds of the day."""
    if m["h"] is None:
        return 0.0
    h = int(m["h"])
    if m["half"]:
        h = h % 12 + (12 if m["half"][0] in "Pp" else 0)
    return 3600.0 * h + 60.0 * int(m["m"]) + int(m["s"] or 0) + float(f"0.{m['f'] or 0}")


def _days(parts: Sequence[re.Match[str]]) -> Float:
    a, b, c = (np.array([int(m[k] or 0) for m in parts]) for k in "abc")
    if a.max() > 31:
        year, month, day = a, b, c
    else:
        american = "/" in (parts[0][0]) and a.max() <= 12
        year, month, day = c, (a if american else b), (b if american else a)
    year = np.where(year < 100, year + 2000, year)
    texts = [
        f"{y:04d}-{m:02d}-{d:02d}"
        for y, m, d in zip(year.tolist(), month.tolist(), day.tolist(), strict=True)
    ]
    return np.asarray(np.array(texts, dtype="datetime64[D]").astype(np.float64))
