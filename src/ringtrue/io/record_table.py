"""Samples as a file of any format holds them; their rate from names or times."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.errors import DataError
from ringtrue.io.times import THIN, even_grid, in_seconds, uneven

_RATE_NAMES = (
    "rate",
    "fs",
    "samplingrate",
    "samplerate",
    "fsamp",
    "fsample",
    "sr",
)  # in letters and digits
_RATE_WORDS = ("samplefrequency", "samplingfrequency", "samplefreq", "samplingfreq")
_STEP_NAMES = ("dt", "increment", "samplinginterval", "sampleinterval", "deltat", "timestep", "ts")
TIME_NAMES = ("t", "time", "time [s]", "time (s)", "x_value", "zeit", "sec", "seconds")
SAME_RATE = 1e-3  # relative, of a rate that is named and that of the times


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """Samples as a foreign file holds them.

    Attributes
    ----------
    data : (channel, sample)
    rate : float or None, Hz
    names, units, quantities : tuple of str, one for each channel
    rows : (sample,) int64 or None
        Where rows are missing by the times: the place of each on the even grid.
    """

    data: Any_
    rate: float | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    quantities: tuple[str, ...]
    rows: Int | None = None

    def evened(self) -> RawTable:
        """The table with NaN in the rows that are missing."""
        if self.rows is None:
            return self
        data = np.full(
            (len(self.data), int(self.rows[-1]) + 1),
            np.nan,
            dtype=np.result_type(self.data, np.float32),
        )
        data[:, self.rows] = self.data
        return replace(self, data=data, rows=None)

    def check_whole(self, path: Path) -> None:
        """Refuse missing rows.

        Raises
        ------
        DataError
        """
        if self.rows is not None and self.rate is not None:
            raise DataError(f"{path}: {uneven(np.diff(self.rows) / self.rate)}")


def joined(pieces: Sequence[tuple[float, RawTable]]) -> RawTable | None:
    """One table of the acquisitions of a file, one after the other, each with its start, s; `rows`
    tells their places.

    None where they are no parts of one record: of other channels or rates, at one time, or half of
    it between them.
    """
    pieces = sorted(pieces, key=lambda x: x[0])
    first, rate = pieces[0][1], pieces[0][1].rate
    alike = all(
        (t.names, t.units, t.rate, t.rows) == (first.names, first.units, rate, None)
        for _, t in pieces
    )
    if rate is None or not alike or not np.isfinite([start for start, _ in pieces]).all():
        return None
    size = np.array([t.data.shape[1] for _, t in pieces])
    begin = np.round((np.array([start for start, _ in pieces]) - pieces[0][0]) * rate).astype(
        np.int64
    )
    late = np.diff(begin) - size[:-1]
    if (late < -1).any() or begin[-1] + size[-1] > size.sum() / THIN:
        return None
    begin[1:] += np.cumsum(late == -1)  # rounding
    rows = np.concatenate([a + np.arange(n) for a, n in zip(begin, size, strict=True)])
    whole = np.concatenate([t.data for _, t in pieces], axis=1)
    return replace(first, data=whole, rows=rows if rows[-1] >= rows.size else None)


def numbered(data: Any_, rate: float | None) -> RawTable:
    """A table without names and units: `ch1`, `ch2`, ..."""
    n = data.shape[0]
    blank = ("",) * n
    return RawTable(data, rate, tuple(f"ch{i + 1}" for i in range(n)), blank, blank)


def columns_first(a: Any_, path: Path) -> Any_:
    """(channel, sample), the longer axis taken as time."""
    if a.ndim == 1:
        a = a[None]
    if a.ndim != 2 or a.dtype.kind not in "fiu":
        raise DataError(f"{path}: array {a.shape} {a.dtype}; it must be 2-D and real")
    a = a if a.shape[1] >= a.shape[0] else a.T
    return np.ascontiguousarray(a if a.dtype.kind == "f" else a.astype(np.float64))


def is_time(name: str) -> bool:
    """Whether a variable or channel of this name holds times: `t`, `Time [s]`,
    `Data1_time_AI_1`.
    """
    return (
        name.strip().lower() in TIME_NAMES or re.search(r"(^|_)time(_|$)", name.lower()) is not None
    )


def named_rate(values: Mapping[str, Any]) -> float | None:
    """The sampling rate (Hz) among named scalars: `fs`, `rate`, ... or a step of time such as
    `dt`.
    """
    real = {k: float(np.ravel(v)[0]) for k, v in values.items() if _is_real(v) and np.size(v) == 1}
    lower = {re.sub("[^a-z0-9]", "", k.lower()).removesuffix("hz"): x for k, x in real.items()}
    for name in (*_RATE_NAMES, *_RATE_WORDS):
        if name in lower:
            return lower[name]
    step = next((lower[name] for name in _STEP_NAMES if name in lower), None)
    return None if step is None else 1 / step if step else 0.0


def _is_real(value: Any) -> bool:
    return (
        getattr(
            value, "dtype", np.asarray(value).dtype if np.isscalar(value) else np.dtype(object)
        ).kind
        in "fiu"
    )


def without_time(table: RawTable, path: Path) -> RawTable:
    """A table without names whose first row is a time (it rises in equal steps): the rate in its
    place.
    """
    rate, rows = (
        even_grid(in_seconds(table.data[0]), False, path)
        if table.data.shape[0] > 1
        else (None, None)
    )
    if (
        rate is None or rate <= 1 or table.data.shape[1] < 10
    ):  # 1 Hz: the column may as well number the samples
        return table
    rest = replace(numbered(table.data[1:], rate), rows=rows)
    if table.rate is not None and abs(table.rate / rate - 1) > SAME_RATE:
        raise DataError(
            f"{path}: a rate of {table.rate:g} Hz is named, but the first column, a time, says "
            f"{rate:g} Hz"
        )
    return rest


def time_grid(
    values: Mapping[str, Any], samples: int, path: Path, told: float | None = None
) -> tuple[float | None, Int | None]:
    """`even_grid` of a vector of so many times among named arrays (`t`, `time`); None, None if
    there is none.

    A rate that is `told` beside them stands; of times in other units, or uneven ones, nothing is
    asked then.
    """
    times = [
        np.ravel(v)
        for k, v in values.items()
        if is_time(k) and _is_real(v) and np.size(v) == samples
    ]
    if not times:
        return told, None
    rate, rows = even_grid(in_seconds(times[0].astype(np.float64)), told is None, path)
    if told is None:
        return rate, rows
    return told, rows if rate is not None and abs(rate / told - 1) < SAME_RATE else None
