"""Records in text, with the rate, the clock and the count that loggers write.

It has delimited columns, or is LabVIEW measurement text (.lvm), which has segments, decimal commas,
and no, one or several columns of time. TDMS, the other format of National Instruments, is read
here, too.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.delimited import (
    BRACKETED_UNIT,
    SECONDS_PER,
    column_titles,
    commented_titles,
    header_rows,
    numbers,
    read_lines,
    split_cells,
    without_headers,
)
from ringtrue.io.files import read_text
from ringtrue.io.foreign.parsers import open_tdms
from ringtrue.io.record_table import (
    TIME_NAMES,
    RawTable,
    is_time,
    named_rate,
    numbered,
    time_grid,
)
from ringtrue.io.times import (
    even_grid,
    in_seconds,
    is_clock,
    known,
    second_of_day,
    seconds,
)

log = logging.getLogger(__name__)
_TIMES = {
    *TIME_NAMES,
    "timestamp",
    "datetime",
    "date",
    "datum",
    "uhrzeit",
    "elapsed",
    "elapsed time",
    "relative time",
    "unix",
    "epoch",
    "time stamp",
    "date time",
    "date/time",
    "datum uhrzeit",
    "temps",
    "tempo",
    "tiempo",
}
_COUNTS = {
    "sample",
    "samples",
    "index",
    "idx",
    "nr",
    "no",
    "no.",
    "n",
    "#",
    "scan",
    "record",
    "point",
    "count",
}
_NUMBER = r"(?P<x>\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
_RATE = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:rate|freq\w*)|abtast(?:rate|frequenz)|scan[\s_-]*rate|\bfs\b|^\W*rate\b)[^\d]{{0,24}}?{_NUMBER}\s*(?P<k>k)?",
    re.IGNORECASE,
)
_STEP = re.compile(
    rf"(?:sampl\w*[\s_-]*(?:interval|period)|abtastintervall|\bdelta[\s_-]?t\b|\bdt\b)[^\d]{{0,24}}?{_NUMBER}\W*(?P<u>ms|us|µs|s)?\b",
    re.IGNORECASE,
)


def read_csv(path: Path) -> RawTable:
    """Delimited text, a column for each channel; a column of times or a line above the samples
    gives the rate.

    A header such as `101+Z [m/s^2]` gives name and unit. Delimiters `, ; tab space`; decimal
    commas, dates, quotes, D exponents and empty cells (not a number) are understood.
    """
    comments, lines, delimiter, comma = read_lines(path)
    width = len(split_cells(lines[-1], delimiter))
    top = header_rows(lines, delimiter, comma, width)
    head = [split_cells(x, delimiter) for x in lines[:top]]
    rows = without_headers(lines[top:], lines[:top], path)
    body, clock, stamps = _clocked(rows, delimiter, path)
    data = np.empty((0, len(body)))
    if body and width > clock:
        data = numbers(body, delimiter, comma, path)
    names = commented_titles(comments, delimiter, width)
    if head:
        names = column_titles(head, width, path)
    if names and len(names) - clock != len(data):
        raise DataError(
            f"{path}: {len(names) - clock} names in the header, {len(data)} columns"
        )
    rate = _stated_rate([*comments, *lines[:top]])
    if not clock:
        return _with_time(data, names, rate, path)
    try:
        t = seconds(stamps)
    except ValueError as exc:
        raise DataError(f"{path}: {exc}") from exc
    by_clock, places = _rate_of(t, path)
    names = names[clock:]
    # 0.9: share of the lines that go on from the one before, from one on or from where the logger
    # was
    numbered_lines = len(data) > 1 and names and names[0].lower() in _COUNTS
    if numbered_lines and np.mean(np.diff(data[0]) == 1) > 0.9:
        data = data[1:]
        names = names[1:]
    return replace(_named(data, names, by_clock or rate), rows=places)


def _clocked(
    lines: Sequence[str], delimiter: str, path: Path
) -> tuple[Sequence[str], int, list[str]]:
    """The lines without the dates and times of day that stand first, how many columns these take,
    and these.
    """
    cells = split_cells(lines[0], delimiter) if lines else []
    clock = next((k for k, x in enumerate(cells[:3]) if not is_clock(x)), len(cells))
    if not 0 < clock < 3:
        return lines, 0, []
    body = []
    stamps = []
    for k, line in enumerate(lines):
        *stamp, rest = line.split(None if delimiter == " " else delimiter, clock)
        if len(stamp) < clock:
            count = len(stamp) + 1
            raise DataError(
                f"{path}: row {k} of the samples has {count} cells: {line[:60]!r}"
            )
        body.append(rest)
        stamps.append(" ".join(stamp).replace('"', ""))
    return body, clock, stamps


def _rate_of(t: Float, path: Path) -> tuple[float | None, Int | None]:
    """The rate of times that are even but for their rounding to whole seconds or less; as
    `even_grid`.
    """
    step = np.diff(t)
    whole = (
        t.size > 2
        and (step >= 0).all()
        and (step == 0).any()
        and (np.round(t) == t).all()
    )
    if whole:
        mean = float(np.polyfit(np.arange(t.size) / t.size, t, 1)[0]) / t.size
        even = np.abs(t - t[0] - mean * np.arange(t.size)).max() < 1.5
        # 1e-3: relative deviation of a rate from times written with few digits
        fine = even and mean > 0 and 1 / (t.size**1.5 * mean) < 1e-3
        return (1 / mean if fine else None), None
    return even_grid(t, True, path)


def _stated_rate(lines: Sequence[str]) -> float | None:
    """The rate that a line above the samples gives, Hz."""
    for line in lines:
        if found := _RATE.search(line):
            return (
                float(found["x"].replace(",", ".")) * (1e3 if found["k"] else 1.0)
                or None
            )
        if (found := _STEP.search(line)) and (
            step := float(found["x"].replace(",", "."))
        ) > 0:
            return 1 / (step * SECONDS_PER[(found["u"] or "s").lower()])
    return None


def _with_time(
    data: Float, names: Sequence[str], stated: float | None, path: Path
) -> RawTable:
    """The table without columns of times and counts, with the rate that they or the lines above
    tell.
    """
    keep = np.asarray(~np.isnan(data).all(axis=1))
    data = data[keep]
    names = [n for n, k in zip(names, keep, strict=True) if k] if names else []
    if not len(data):
        raise DataError(f"{path}: empty, there are no samples")
    first = names[0].lower() if names else ""
    title = BRACKETED_UNIT.match(first) or re.match(
        r"^(.*?)[\s_](ms|us|µs|ns|s)$", first
    )
    named = first in _TIMES or (title is not None and title[1].strip() in _TIMES)
    count = (
        not named
        and len(data) > 1
        and data.shape[1] > 2
        and bool((np.diff(data[0]) == 1).all())
    )
    if first in _COUNTS or (count and data[0, 0] in (0, 1)):
        return (
            _with_time(data[1:], names[1:], stated, path)
            if count
            else _named(data, names, stated)
        )
    if len(data) < 2 and not named:
        return _named(data, names, stated)
    t = in_seconds(
        data[0] * SECONDS_PER.get(title[2].strip(), 1.0) if title else data[0]
    )
    rate, rows = _rate_of(t, path) if named else even_grid(t, False, path)
    if rate is None and not named:
        return _named(data, names, stated)
    # a time for each channel
    again = np.array([bool((row == data[0]).all()) for row in data])
    rest = [n for n, a in zip(names, again, strict=True) if not a] if names else []
    return replace(_named(data[~again], rest, rate or stated), rows=rows)


def _named(data: Float, names: Sequence[str], rate: float | None) -> RawTable:
    """A table with names and units from titles such as `101+Z [m/s^2]`; brackets that hold no unit
    stay in the name.
    """
    if not names:
        return numbered(data, rate)
    titles = []
    units = []
    for name in names:
        found = BRACKETED_UNIT.match(name)
        is_unit = found is not None and (known(found[2]) or not found[2].strip())
        titles.append(found[1] if found and is_unit else name)
        units.append(found[2] if found and is_unit else "")
    return RawTable(data, rate, tuple(titles), tuple(units), ("",) * len(names))


_END = "***End_of_Header***"
_OVER_FREQUENCY = re.compile(r"\A\s*LabVIEW[\s\S]*?^X_Dimension[,\t]Freq", re.MULTILINE)
_SPECIAL = ("***Start_of_Special***", "***End_of_Special***")


def read_lvm(path: Path) -> RawTable:
    """The record of a LabVIEW measurement file; segments that follow each other without a gap are
    joined.

    A file without headers is read as delimited text.

    Raises
    ------
    DataError
        If a header or the step of time is missing, or the segments have gaps: then take
        `read_lvm_segments`.
    """
    if not _has_headers(path):
        return read_csv(path)
    parts = read_lvm_segments(path)
    whole = parts[0][1]
    rate = whole.rate or 0.0
    for (start, before), (later, part) in pairwise(parts):
        like = (
            part.names == whole.names and abs((part.rate or 0.0) - rate) <= 1e-3 * rate
        )
        # 0.5: samples that a segment may begin off the end of the one before
        if not like or abs((later - start) * rate - before.data.shape[1]) > 0.5:
            raise DataError(
                f"{path}: {len(parts)} segments that do not follow each other; read them one by "
                "one with read_lvm_segments"
            )
    data = np.concatenate([part.data for _, part in parts], axis=1)
    return replace(whole, data=data)


def read_lvm_segments(path: Path) -> tuple[tuple[float, RawTable], ...]:
    """The start (s, of its header's clock and X0) and the samples of every segment.

    Raises
    ------
    DataError
        If a header, the step of time or samples are missing.
    """
    lines = _without_special(read_text(path).splitlines())
    ends = [i for i, x in enumerate(lines) if x.startswith(_END)]
    if not lines or not lines[0].startswith("LabVIEW") or len(ends) < 2:
        raise DataError(f"{path}: not a LabVIEW measurement file with both headers")
    top = lines[: ends[0]]
    head = _table(top, "," if any(x.startswith("Separator,") for x in top) else "\t")
    begins = [
        ends[0] + 1,
        *(_segment_start(lines, end) for end in ends[2:]),
        len(lines),
    ]
    return tuple(_segment(lines[a:b], head, path) for a, b in pairwise(begins))


def read_lvm_pieces(path: Path) -> tuple[tuple[float, RawTable], ...]:
    """As `read_lvm_segments`; none of a file without headers, which is text."""
    return read_lvm_segments(path) if _has_headers(path) else ()


def lvm_spectra(path: Path) -> tuple[list[str], Float] | None:
    """Titles and numbers (column, row) of a file over a frequency, of its last segment; None where
    it is none.
    """
    if not _OVER_FREQUENCY.search(read_text(path, 1 << 16)):
        return None
    lines = _without_special(read_text(path).splitlines())
    ends = [i for i, x in enumerate(lines) if x.startswith(_END)]
    if len(ends) < 2:
        return None
    separator = (
        "," if any(x.startswith("Separator,") for x in lines[: ends[0]]) else "\t"
    )
    head = _table(lines[: ends[0]], separator)
    table = _table(lines[_segment_start(lines, ends[-1]) : ends[-1]], separator)
    comma = _first(head, "Decimal_Separator") == ","
    named = "".join(lines[ends[-1] + 1 : ends[-1] + 2])
    titles = [x.strip() for x in named.split(separator)]
    titles = titles[: titles.index("Comment")] if "Comment" in titles else titles
    rows = [
        x.split(separator)[: len(titles)] for x in lines[ends[-1] + 2 :] if x.strip()
    ]
    data = numbers([" ".join(row) for row in rows], " ", comma, path)
    units = [*table.get("Y_Unit_Label", []), *[""] * len(titles)]
    parts = (f"{t} [{u}]" if u else t for t, u in zip(titles[1:], units, strict=False))
    return [f"Frequency [{_first(table, 'X_Unit_Label') or 'Hz'}]", *parts], data


def _has_headers(path: Path) -> bool:
    return read_text(path, 1000).lstrip().startswith("LabVIEW")


def _without_special(lines: Sequence[str]) -> list[str]:
    out = []
    inside = False
    for line in lines:
        inside = inside or line.startswith(_SPECIAL[0])
        if not inside:
            out.append(line)
        inside = inside and not line.startswith(_SPECIAL[1])
    return out


def _segment_start(lines: Sequence[str], end: int) -> int:
    """The first line of the header that ends at line `end`: the one that names the channels."""
    at = end
    while (
        at > 0
        and not lines[at].startswith("Channels")
        and not lines[at - 1].startswith(_END)
    ):
        at -= 1
    return at


def _table(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    rows = (x.rstrip().split(separator) for x in lines)
    return {r[0]: [v.strip() for v in r[1:]] for r in rows if r and r[0]}


def _segment(
    lines: Sequence[str], head: Mapping[str, Sequence[str]], path: Path
) -> tuple[float, RawTable]:
    separator = "," if _first(head, "Separator").lower() == "comma" else "\t"
    comma = _first(head, "Decimal_Separator") == ","
    one_x_each = _first(head, "X_Columns").lower() == "multi"
    end = next(i for i, x in enumerate(lines) if x.startswith(_END))
    table = _table(lines[:end], separator)
    if one_x_each:  # empty cells stand over the columns of time
        for key, values in table.items():
            if len(values) > 2 and not any(values[1::2]):
                table[key] = values[::2]
    try:
        n = int(table["Channels"][0])
        steps = [float(x.replace(",", ".")) for x in table.get("Delta_X", [])[:n]]
        start = float(_first(table, "X0").replace(",", ".") or 0)
    except (KeyError, IndexError, ValueError) as exc:
        raise DataError(
            f"{path}: header of a segment without Channels, or with a number that is none ({exc})"
        ) from exc
    equal = len(steps) == n and np.isfinite(steps).all() and len(set(steps)) == 1
    if not 0 < n <= 100_000 or not equal:
        raise DataError(
            f"{path}: {n} channels with steps of time Delta_X {steps[:8]}: as many equal ones "
            "are needed"
        )
    # samples stand after one column of x, which may be empty, or after one for each channel
    columns = range(1, 2 * n, 2) if one_x_each else range(1, n + 1)
    title = lines[end + 1].split(separator) if end + 1 < len(lines) else []
    titles = [title[c].strip() if c < len(title) else "" for c in columns]
    rows = [
        x.split(separator)
        for x in lines[end + 2 :]
        if x.strip() and not x.startswith("***")
    ]
    samples = [
        " ".join(
            cells[c] if c < len(cells) and cells[c].strip() else "x" for c in columns
        )
        for cells in rows
    ]
    try:
        data = numbers(samples, " ", comma, path)
    except DataError as exc:
        why = f"a row of samples is not complete or not a number ({exc})"
        raise DataError(f"{path}: {why}") from exc
    found = RawTable(
        data=data,
        rate=_rate(steps[0], [cells[0].strip() for cells in rows], comma),
        names=tuple(x or f"ch{i + 1}" for i, x in enumerate(titles)),
        units=(*table.get("Y_Unit_Label", [])[:n], *("",) * n)[:n],
        quantities=("",) * n,
    )
    return start + second_of_day(_first(table, "Time")), found


def _first(table: Mapping[str, Sequence[str]], key: str) -> str:
    return (table.get(key) or [""])[0]


def _rate(step: float, cells: Sequence[str], comma: bool) -> float:
    """That of the step of the header, which may have three digits, by the ends of the column of
    times if they agree.
    """
    try:
        first, last = (
            float(x.replace(",", ".") if comma else x) for x in (cells[0], cells[-1])
        )
    except (ValueError, IndexError):
        first = last = 0.0
    mean = (last - first) / max(len(cells) - 1, 1)
    # 0.05: relative, as a step of one or two digits may be off
    step = mean if step and abs(mean / step - 1) < 0.05 else step
    return 1 / step if step else 0.0


_UNIT = ("unit_string", "NI_UnitDescription", "Unit", "unit")


def read_tdms(path: Path, group: str = "") -> RawTable:
    """The channels of a TDMS file, (channel, sample); all must have one rate (`wf_increment`) and
    length.

    Ids are the names of the channels, `group/name` where a name occurs in several groups. Units
    that ringtrue does not know stay out. With `group` the channels of that group alone.

    Raises
    ------
    DataError
        If it is no TDMS file, it is damaged, holds no numbers or no such group, or rates or lengths
        differ.
    """
    with open_tdms(path) as file:
        groups = _groups(file, path)
        if group and group not in groups:
            raise DataError(f"{path}: no group {group!r}{did_you_mean(group, groups)}")
        if group:
            groups = {group: groups[group]}
        table = _tdms_table(groups, path)
        stated = [named_rate(file[name].properties) for name in groups]
        rate = next((r for r in (table.rate, *stated) if r is not None), None)
        return replace(
            table, rate=named_rate(file.properties) if rate is None else rate
        )


def read_tdms_runs(path: Path) -> tuple[RawTable, ...]:
    """A table for each group where all hold the same channels of one rate: triggered blows; else
    one table of all.
    """
    with open_tdms(path) as file:
        groups = _groups(file, path)
        held = {(tuple(c.name for c in g), _tdms_rate(g[0])) for g in groups.values()}
        if len(held) == 1 and len(next(iter(groups.values()))) > 1:
            return tuple(_tdms_table({name: g}, path) for name, g in groups.items())
        return (_tdms_table(groups, path),)


def read_tdms_pieces(path: Path) -> tuple[tuple[float, RawTable], ...]:
    """Each group with its start (s), where all have one (`wf_start_time`); else none."""
    with open_tdms(path) as file:
        groups = _groups(file, path)
        for g in groups.values():
            one_start = len({(len(c), _tdms_rate(c), _start(c)) for c in g}) == 1
            if len(groups) < 2 or not one_start or not np.isfinite(_start(g[0])):
                return ()
        return tuple(
            (_start(g[0]), _tdms_table({k: g}, path)) for k, g in groups.items()
        )


def _start(channel: Any) -> float:
    """Seconds since 1970; NaN where there is no start."""
    start = channel.properties.get("wf_start_time")
    if not isinstance(start, np.datetime64):
        return float("nan")
    return float(
        start.astype("datetime64[us]").astype(np.int64) * 1e-6
        + channel.properties.get("wf_start_offset", 0.0)
    )


def _groups(file: Any, path: Path) -> dict[str, list[Any]]:
    """The channels with numbers of each group that has some."""
    found: dict[str, list[Any]] = {}
    for group in file.groups():
        channels = [c for c in group.channels() if len(c) and c.dtype.kind in "fiu"]
        if channels:
            found[group.name] = channels
    if not found:
        raise DataError(f"{path}: no channel with numbers in the file")
    return found


def _tdms_table(groups: Mapping[str, Sequence[Any]], path: Path) -> RawTable:
    """The channels of groups that have one rate and length."""
    found = [c for g in groups.values() for c in g]
    rates = [r for c in found if (r := _tdms_rate(c)) is not None]
    one_rate = not rates or max(rates) - min(rates) <= 1e-6 * max(rates)
    if not one_rate or len({len(c) for c in found}) > 1:
        held = "; ".join(f"{name}: {_shown(g)}" for name, g in groups.items())
        raise DataError(
            f"{path}: rates or lengths differ ({held}): choose a group of one rate and length "
            "(--group NAME), or split the file"
        )
    rate = rates[0] if rates else None
    rows = None
    times = [c for c in found if is_time(c.name)]
    if times and len(times) < len(found):
        rate, rows = time_grid({"time": _values(times[0])}, len(times[0]), path, rate)
        found = [c for c in found if not is_time(c.name)]
    names = [c.name for c in found]
    if len(set(names)) < len(names):
        names = [f"{c.group_name}/{c.name}" for c in found]
    given = (
        next((str(c.properties[k]) for k in _UNIT if c.properties.get(k)), "")
        for c in found
    )
    return RawTable(
        data=np.stack([_values(c) for c in found]),
        rate=rate,
        names=tuple(names),
        units=tuple(known(unit) for unit in given),
        quantities=("",) * len(found),
        rows=rows,
    )


def _shown(channels: Sequence[Any]) -> str:
    """Lengths and rates of the channels of a group, in words."""
    kinds = dict.fromkeys((len(c), _tdms_rate(c)) for c in channels)
    lengths = " or ".join(
        f"{n} samples" + (f", {r:g} Hz" if r else "") for n, r in kinds
    )
    return f"{len(channels)} channels, {lengths}"


def _values(channel: Any) -> Float:
    # a damaged scale; values that are not finite are refused later
    with np.errstate(all="ignore"):
        return np.asarray(channel[:], dtype=np.float64)


def _tdms_rate(channel: Any) -> float | None:
    step = channel.properties.get("wf_increment")
    if step is None:
        return named_rate(channel.properties)
    return 1 / float(step) if float(step) else 0.0
