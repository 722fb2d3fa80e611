"""Records of National Instruments: LabVIEW measurement text (.lvm) and TDMS.

A .lvm has segments, decimal commas, and no, one or several columns of time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.delimited import numbers
from ringtrue.io.files import read_text
from ringtrue.io.foreign.parsers import open_tdms
from ringtrue.io.record_table import RawTable, is_time, named_rate, time_grid
from ringtrue.io.record_texts import read_csv
from ringtrue.io.times import known

_END = "***End_of_Header***"
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
    if not read_text(path).lstrip().startswith("LabVIEW"):  # written without any header
        return read_csv(path)
    parts = read_lvm_segments(path)
    first = parts[0][1]
    if len(parts) == 1:
        return first
    starts = np.array([start for start, _ in parts])
    lengths = np.array([t.data.shape[1] for _, t in parts])
    rate = first.rate or 0.0
    off = np.abs((np.diff(starts)) * rate - lengths[:-1])
    same = all(
        t.names == first.names and abs((t.rate or 0.0) - rate) <= 1e-3 * rate for _, t in parts
    )
    # 0.5: samples that a segment may begin off the end of the one before
    if not same or not (off <= 0.5).all():
        raise DataError(
            f"{path}: {len(parts)} segments that do not follow each other; read them one by one "
            "with read_lvm_segments"
        )
    data = np.concatenate([t.data for _, t in parts], axis=1)
    return RawTable(data, first.rate, first.names, first.units, first.quantities)


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
    comma_separated = any(x.startswith("Separator,") for x in lines[: ends[0]])
    head = _table(lines[: ends[0]], "," if comma_separated else "\t")
    separator = "," if (head.get("Separator") or [""])[0].lower() == "comma" else "\t"
    bounds = [_segment_start(lines, e) for e in ends[1:]] + [len(lines)]
    return tuple(
        _segment(lines[ends[k] + 1 if k == 0 else bounds[k] : bounds[k + 1]], head, separator, path)
        for k in range(len(ends) - 1)
    )


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
    while at > 0 and not lines[at].startswith("Channels") and not lines[at - 1].startswith(_END):
        at -= 1
    return at


def _table(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    rows = (x.rstrip().split(separator) for x in lines)
    return {r[0]: [v.strip() for v in r[1:]] for r in rows if r and r[0]}


def _one_each(values: list[str]) -> list[str]:
    """Values without the empty cells between them that stand over columns of time, one a
    channel.
    """
    return values[::2] if len(values) > 2 and not any(values[1::2]) else values


def _segment(
    lines: Sequence[str], head: Mapping[str, Sequence[str]], separator: str, path: Path
) -> tuple[float, RawTable]:
    end = next(i for i, x in enumerate(lines) if x.startswith(_END))
    table = _table(lines[:end], separator)
    if (head.get("X_Columns") or [""])[0].lower() == "multi":
        table = {k: _one_each(v) for k, v in table.items()}
    comma = list(head.get("Decimal_Separator", ())[:1]) == [","]
    try:
        n = int(table["Channels"][0])
        steps = [float(x.replace(",", ".")) for x in table.get("Delta_X", [])[:n]]
        start = float((table.get("X0") or ["0"])[0].replace(",", ".") or 0) + _clock(
            (table.get("Time") or [""])[0]
        )
    except (KeyError, IndexError, ValueError) as exc:
        raise DataError(
            f"{path}: header of a segment without Channels, or with a number that is none ({exc})"
        ) from exc
    if (
        not 0 < n <= 100_000
        or len(steps) != n
        or not np.isfinite(steps).all()
        or max(steps) != min(steps)
    ):
        raise DataError(
            f"{path}: {n} channels with steps of time Delta_X {steps[:8]}: as many equal ones "
            "are needed"
        )
    # samples stand after one column of x, which may be empty, or after one for each channel
    one_x_each = (head.get("X_Columns") or ["One"])[0].lower() == "multi"
    columns = list(range(1, 2 * n, 2)) if one_x_each else list(range(1, n + 1))
    title = lines[end + 1].split(separator) if end + 1 < len(lines) else []
    names = [title[c].strip() if c < len(title) else "" for c in columns]
    names = [x or f"ch{i + 1}" for i, x in enumerate(names)]
    data = _data(list(_rows(lines[end + 2 :], columns, separator)), comma, path)
    units = (*table.get("Y_Unit_Label", [])[:n], *("",) * n)[:n]
    rate = _rate(steps[0], lines[end + 2 :], separator, comma)
    return start, RawTable(data, rate, tuple(names), units, ("",) * n)


def _rate(step: float, lines: Sequence[str], separator: str, comma: bool) -> float:
    """That of the step of the header, which may have three digits, by the ends of the column of
    times if they agree.
    """
    cells = [x.split(separator)[0].strip() for x in lines if x.strip() and not x.startswith("***")]
    try:
        first, last = (float(x.replace(",", ".") if comma else x) for x in (cells[0], cells[-1]))
    except (ValueError, IndexError):
        first = last = 0.0
    mean = (last - first) / max(len(cells) - 1, 1)
    # 0.05: relative, as a step of one or two digits may be off
    step = mean if step and abs(mean / step - 1) < 0.05 else step
    return 1 / step if step else 0.0


def _rows(lines: Sequence[str], columns: Sequence[int], separator: str) -> Iterator[str]:
    for line in lines:
        cells = line.split(separator)
        if line.strip() and not line.startswith("***"):
            yield " ".join(
                cells[c] if c < len(cells) and cells[c].strip() else "x" for c in columns
            )


def _data(rows: Sequence[str], comma: bool, path: Path) -> Float:
    try:
        return numbers(rows, " ", comma, path)
    except DataError as exc:
        raise DataError(
            f"{path}: a row of samples is not complete or not a number ({exc})"
        ) from exc


def _clock(text: str) -> float:
    """Seconds of the day; 0 where there is no clock."""
    whole, _, part = text.replace(",", ".").partition(".")
    try:
        t = datetime.strptime(whole.strip(), "%H:%M:%S")
    except ValueError:
        return 0.0
    return (
        3600.0 * t.hour
        + 60.0 * t.minute
        + t.second
        + (float(f"0.{part}") if part.isdigit() else 0.0)
    )


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
        found = _signals(file, path)
        stated = named_rate(file.properties)
        if group:
            names = list(dict.fromkeys(c.group_name for c in found))
            if group not in names:
                raise DataError(f"{path}: no group {group!r}{did_you_mean(group, names)}")
            found = [c for c in found if c.group_name == group]
        stated = next(
            (r for c in found if (r := named_rate(file[c.group_name].properties)) is not None),
            stated,
        )
        table = _tdms_table(found, path)
        return table if table.rate is not None else replace(table, rate=stated)


def read_tdms_runs(path: Path) -> tuple[RawTable, ...]:
    """A table for each group where all hold the same channels of one rate: triggered blows; else
    one table of all.
    """
    with open_tdms(path) as file:
        found = _signals(file, path)
        groups = [
            [c for c in found if c.group_name == g]
            for g in dict.fromkeys(c.group_name for c in found)
        ]
        shown = {(tuple(c.name for c in g), _tdms_rate(g[0])) for g in groups}
        return tuple(
            _tdms_table(g, path)
            for g in (groups if len(shown) == 1 and len(groups[0]) > 1 else [found])
        )


def read_tdms_pieces(path: Path) -> tuple[tuple[float, RawTable], ...]:
    """Each group with its start (s), where all have one (`wf_start_time`); else none."""
    with open_tdms(path) as file:
        found = _signals(file, path)
        groups = [
            [c for c in found if c.group_name == g]
            for g in dict.fromkeys(c.group_name for c in found)
        ]
        starts = [_start(g[0]) for g in groups]
        even = all(len({(len(c), _tdms_rate(c), _start(c)) for c in g}) == 1 for g in groups)
        if len(groups) < 2 or not even or not np.isfinite(starts).all():
            return ()
        return tuple((start, _tdms_table(g, path)) for start, g in zip(starts, groups, strict=True))


def _start(channel: Any) -> float:
    """Seconds since 1970; NaN where there is no start."""
    start = channel.properties.get("wf_start_time")
    if not isinstance(start, np.datetime64):
        return float("nan")
    return float(
        start.astype("datetime64[us]").astype(np.int64) * 1e-6
        + channel.properties.get("wf_start_offset", 0.0)
    )


def _signals(file: Any, path: Path) -> list[Any]:
    found = [c for g in file.groups() for c in g.channels() if len(c) and c.dtype.kind in "fiu"]
    if not found:
        raise DataError(f"{path}: no channel with numbers in the file")
    return found


def _tdms_table(found: list[Any], path: Path) -> RawTable:
    _check_equal(found, path)
    rate = next((r for c in found if (r := _tdms_rate(c)) is not None), None)
    rows = None
    if (times := [c for c in found if is_time(c.name)]) and len(times) < len(found):
        rate, rows = time_grid({"time": _values(times[0])}, len(times[0]), path, rate)
        found = [c for c in found if not is_time(c.name)]
    data = np.stack([_values(c) for c in found])
    units = tuple(_unit(c.properties) for c in found)
    return RawTable(
        data=data,
        rate=rate,
        names=_names(found),
        units=units,
        quantities=("",) * len(found),
        rows=rows,
    )


def _check_equal(found: list[Any], path: Path) -> None:
    """Refuse rates or lengths that differ; where they do from group to group, say which group has
    which.
    """
    lengths = sorted({len(c) for c in found})
    known = [r for c in found if (r := _tdms_rate(c)) is not None]
    rates_differ = known and max(known) - min(known) > 1e-6 * max(known)
    if not rates_differ and len(lengths) == 1:
        return
    by_group = {
        g: [c for c in found if c.group_name == g]
        for g in dict.fromkeys(c.group_name for c in found)
    }
    one_each = all(len({(len(c), _tdms_rate(c)) for c in g}) == 1 for g in by_group.values())
    if len(by_group) > 1 and one_each:
        held = "; ".join(
            f"{name}: {len(g)} channels, {len(g[0])} samples"
            + (f", {r:g} Hz" if (r := _tdms_rate(g[0])) else "")
            for name, g in by_group.items()
        )
        raise DataError(
            f"{path}: the groups differ in rate or length ({held}): choose one with group "
            "(--group NAME)"
        )
    if len(lengths) > 1:
        raise DataError(
            f"{path}: channels of {lengths[0]} to {lengths[-1]} samples; they must be equal: "
            "split the file"
        )
    raise DataError(f"{path}: rates from {min(known):g} to {max(known):g} Hz; split the file")


def _values(channel: Any) -> Float:
    with np.errstate(all="ignore"):  # a damaged scale; values that are not finite are refused later
        return np.asarray(channel[:], dtype=np.float64)


def _tdms_rate(channel: Any) -> float | None:
    step = channel.properties.get("wf_increment")
    if step is None:
        return named_rate(channel.properties)
    return 1 / float(step) if float(step) else 0.0


def _unit(properties: dict[str, Any]) -> str:
    return known(next((str(properties[k]) for k in _UNIT if properties.get(k)), ""))


def _names(channels: list[Any]) -> tuple[str, ...]:
    names = [c.name for c in channels]
    if len(set(names)) == len(names):
        return tuple(names)
    return tuple(f"{c.group_name}/{c.name}" for c in channels)
