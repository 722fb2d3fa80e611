"""National Instruments TDMS files, read with nptdms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.foreign.tdms import open_tdms
from ringtrue.io.plain import RawTable, is_time, named_rate, time_grid
from ringtrue.io.si import known

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
        told = named_rate(file.properties)
        if group:
            names = list(dict.fromkeys(c.group_name for c in found))
            if group not in names:
                raise DataError(f"{path}: no group {group!r}{did_you_mean(group, names)}")
            found = [c for c in found if c.group_name == group]
        told = next(
            (r for c in found if (r := named_rate(file[c.group_name].properties)) is not None), told
        )
        table = _table(found, path)
        return table if table.rate is not None else replace(table, rate=told)


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
        shown = {(tuple(c.name for c in g), _rate(g[0])) for g in groups}
        return tuple(
            _table(g, path) for g in (groups if len(shown) == 1 and len(groups[0]) > 1 else [found])
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
        even = all(len({(len(c), _rate(c), _start(c)) for c in g}) == 1 for g in groups)
        if len(groups) < 2 or not even or not np.isfinite(starts).all():
            return ()
        return tuple((start, _table(g, path)) for start, g in zip(starts, groups, strict=True))


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


def _table(found: list[Any], path: Path) -> RawTable:
    _check_alike(found, path)
    rate, rows = next((r for c in found if (r := _rate(c)) is not None), None), None
    if (times := [c for c in found if is_time(c.name)]) and len(times) < len(found):
        rate, rows = time_grid({"time": _values(times[0])}, len(times[0]), path, rate)
        found = [c for c in found if not is_time(c.name)]
    data = np.stack([_values(c) for c in found])
    units = tuple(_unit(c.properties) for c in found)
    return RawTable(data, rate, _names(found), units, ("",) * len(found), rows)


def _check_alike(found: list[Any], path: Path) -> None:
    """Refuse rates or lengths that differ; where they do from group to group, say which group has
    which.
    """
    lengths = sorted({len(c) for c in found})
    known = [r for c in found if (r := _rate(c)) is not None]
    rates_differ = known and max(known) - min(known) > 1e-6 * max(known)
    if not rates_differ and len(lengths) == 1:
        return
    by_group = {
        g: [c for c in found if c.group_name == g]
        for g in dict.fromkeys(c.group_name for c in found)
    }
    one_each = all(len({(len(c), _rate(c)) for c in g}) == 1 for g in by_group.values())
    if len(by_group) > 1 and one_each:
        told = "; ".join(
            f"{name}: {len(g)} channels, {len(g[0])} samples"
            + (f", {r:g} Hz" if (r := _rate(g[0])) else "")
            for name, g in by_group.items()
        )
        raise DataError(
            f"{path}: the groups differ in rate or length ({told}): choose one with group "
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


def _rate(channel: Any) -> float | None:
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
