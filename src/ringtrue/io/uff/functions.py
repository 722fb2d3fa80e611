"""Data set 58 read: time records and frequency response functions.

Units of universal files, and the points and lines of a test as one.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.channels import (
    ANGULAR,
    FORCES,
    FRF_KIND,
    LINEAR,
    SI_UNIT,
    UNIT,
    as_motion,
    base_motion,
    channel,
)
from ringtrue.core.dofs import NAMES
from ringtrue.core.signals import Channel, FrfSet, Quantity, shared_lines
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import atomic_write, functions_held, sets_held
from ringtrue.io.foreign.parsers import write_sets
from ringtrue.io.frf_tables import known_lines, say_accelerances
from ringtrue.io.record_table import RawTable
from ringtrue.io.times import even_rate, known, to_si
from ringtrue.io.uff.datasets import DataSet, parse_real, row, scan
from ringtrue.io.uff.function58 import (
    COHERENCE,
    FRF,
    TIME,
    TIME_AXIS,
    TRANSMISSIBILITY,
    Axis,
    UffFunction,
    read_function,
)


@dataclass(frozen=True, slots=True)
class Units:
    """Data set 164: file units per SI unit; SI = file value / factor."""

    length: float
    force: float


def read_units(block: DataSet) -> Units:
    """Data set 164; the vendors count from any column and leave the temperature out."""
    lines = block.lines()
    row(lines, 0)
    values = [parse_real(w) for w in " ".join(lines[1:3]).split()]
    length, force = ([*values, 1.0, 1.0])[:2]
    if not (length > 0 and force > 0):
        raise DataError(f"data set 164: factors of length {length} and force {force} must be > 0")
    return Units(length, force)


def write_test_model(path: str | Path, test: TestModel) -> None:
    """Write points and lines, global frame, m.

    The format carries six digits of a coordinate, and no channels: those stand in the sensor sheet.

    Raises
    ------
    DataError
        If there are no points, or a number has more than ten digits.
    """
    largest = 9_999_999_999  # ten columns
    if not test.points.size or test.points.max() > largest or test.points.min() < 1:
        raise DataError(f"{path}: {test.points.size} points; their numbers must be 1 to {largest}")
    x, y, z = test.xyz.T
    units: dict[str, object] = {
        "type": 164,
        "units_code": 1,
        "units_description": "SI",
        "temp_mode": 1,
        "length": 1.0,
        "force": 1.0,
        "temp": 1.0,
        "temp_offset": 273.15,
    }
    sets = [units, {"type": 15, "node_nums": test.points, "x": x, "y": y, "z": z}]
    if len(test.lines):
        # 0 lifts the pen
        trace = np.column_stack([test.lines, np.zeros(len(test.lines), dtype=np.int64)]).ravel()
        sets.append({"type": 82, "trace_num": 1, "id": "measuring points", "nodes": trace})
    with atomic_write(path) as part:
        write_sets(part, sets)


log = logging.getLogger(__name__)
_QUANTITY: dict[int, Quantity] = {
    3: "strain",
    8: "displacement",
    9: "force",
    11: "velocity",
    12: "acceleration",
    13: "force",
}
_DIGITS = 5  # after the first, of a step
_UNNAMED = ("", "NONE")
_SKEWED = re.compile(r"\d+[+-][XYZ]s\d*")
_NO_REFERENCE = "in1"


def read_functions(path: str | Path) -> tuple[UffFunction, ...]:
    """All functions (58, 58b) of a universal file, as stored.

    Raises
    ------
    DataError
        If the file is not a universal file, holds no function, or one is damaged.
    """
    return _functions(path)[0]


def _functions(path: str | Path) -> tuple[tuple[UffFunction, ...], Units | None]:
    blocks = scan(path)
    sets = [b for b in blocks if b.kind == 58]
    if not sets:
        raise DataError(
            f"{path}: no records and no FRFs (data set 58); {sets_held(b.kind for b in blocks)}"
        )
    with about(path):
        units = [read_units(b) for b in blocks if b.kind == 164]
        return tuple(read_function(b) for b in sets), units[0] if units else None


def label(node: int, direction: int) -> str:
    """`101+Z` of a point and a direction code (0 scalar, ±1..±3 translations, ±4..±6 rotations)."""
    if direction == 0 or abs(direction) > 6:
        return str(node)
    return f"{node}{'+' if direction > 0 else '-'}{NAMES[abs(direction)]}"


def read_time(path: Path) -> RawTable:
    """The time functions of a universal file as (channel, sample); all must have one rate and
    length.
    """
    functions, units = _functions(path)
    return _time_table(_time_functions(functions, path), units, path)


def read_time_runs(path: Path) -> tuple[RawTable, ...]:
    """A table for each acquisition where every channel comes as often: triggered blows, one after
    the other.
    """
    functions, units = _functions(path)
    found = _time_functions(functions, path)
    keys = [(*f.response, _signal(f, units)[0]) for f in found]
    times = {keys.count(k) for k in dict.fromkeys(keys)}
    if len(set(keys)) < 2 or len(times) > 1 or times == {1} or _titles(found):
        return (_time_table(found, units, path),)
    seen: dict[object, int] = {}
    runs: list[list[UffFunction]] = [[] for _ in range(times.pop())]
    for key, f in zip(keys, found, strict=True):
        seen[key] = seen.get(key, -1) + 1
        runs[seen[key]].append(f)
    return tuple(_time_table(r, units, path) for r in runs)


def _time_functions(functions: Sequence[UffFunction], path: Path) -> list[UffFunction]:
    found = [
        f for f in functions if f.kind == TIME or (f.kind, f.axes[0].data_type) == (0, TIME_AXIS)
    ]
    if not found:
        raise DataError(f"{path}: no time records; {functions_held(f.kind for f in functions)}")
    return found


def _time_table(found: Sequence[UffFunction], units: Units | None, path: Path) -> RawTable:
    rates = [_rate(f, path) for f in found]
    if max(rates) - min(rates) > 1e-4 * max(rates):
        raise DataError(
            f"{path}: different rates, {min(rates):g} to {max(rates):g} Hz; split the file"
        )
    length = min(f.y.size for f in found)
    kinds, factors = zip(*(_signal(f, units) for f in found), strict=True)
    data = np.stack([np.real(f.y[:length]) * x for f, x in zip(found, factors, strict=True)])
    return RawTable(
        data, rates[0], _names(found, kinds), tuple(UNIT.get(k, "") for k in kinds), tuple(kinds)
    )


def _rate(f: UffFunction, path: Path) -> float:
    if not f.even:
        return even_rate(f.x, True, path) or 0.0
    step = float(f.x[-1] - f.x[0]) / (f.x.size - 1) if f.x.size > 1 else 0.0
    if not (np.isfinite(step) and step > 0):
        raise DataError(f"{path}: step of time {step}; it must be positive")
    return _plain_rate(step)


def _plain_rate(step: float) -> float:
    """The rate of fewest digits whose step is the given one to the six digits that data set 58
    holds.
    """
    unit = 10.0 ** (np.floor(np.log10(step)) - _DIGITS)
    rates = (float(f"{1 / step:.{k}e}") for k in range(_DIGITS + 1))
    return next((r for r in rates if abs(1 / r - step) <= 0.5001 * unit), 1 / step)


def _factor(quantity: str, units: Units | None) -> float:
    """To SI: data set 164 holds file units per SI unit."""
    if units is None:
        return 1.0
    bare = ("strain", "unknown", *(ANGULAR[motion] for motion in SI_UNIT))
    one: dict[str, float] = {
        "force": units.force,
        "moment": units.force * units.length,
        **dict.fromkeys(bare, 1.0),
    }
    return 1 / one.get(quantity, units.length)


def _names(functions: Sequence[UffFunction], kinds: Sequence[str]) -> tuple[str, ...]:
    """Point and direction of each; a force at the point of a response is `F:101+Z`."""
    if titles := _titles(functions):
        return tuple(titles)
    names = [_name(f) for f in functions]
    if len(set(names)) == len(names):
        return tuple(names)
    named = [f"F:{n}" if k in FORCES else n for n, k in zip(names, kinds, strict=True)]
    if len(set(named)) == len(named):
        return tuple(named)
    return tuple(f"{n}#{i + 1}" for i, n in enumerate(names))


def _name(function: UffFunction) -> str:
    """Of a skewed sensor, for which there is no code, the name that `write_time` keeps as first
    line of text.
    """
    return function.ids[0] if _SKEWED.fullmatch(function.ids[0]) else label(*function.response)


def _titles(functions: Sequence[UffFunction]) -> list[str]:
    """Where no response has a point, what else names each: its entity, the label of its axis, its
    first text.
    """
    if any(f.response[0] for f in functions):
        return []
    for texts in zip(*((f.names[0], f.axes[1].label, f.ids[0]) for f in functions), strict=True):
        if len(set(texts)) == len(texts) and not set(_UNNAMED) & {t.upper() for t in texts}:
            return list(texts)
    return []


def frf_ends(path: str | Path) -> tuple[str, ...]:
    """Ids of all responses and references of the FRFs of a universal file, sound or not."""
    frfs = [f for f in read_functions(path) if f.kind in (FRF, TRANSMISSIBILITY)]
    return tuple(dict.fromkeys(name for ends in _ends(frfs) for name in ends))


def read_frf_sets(path: str | Path, leave_out: Sequence[str] = ()) -> FrfSet:
    """Frequency response functions of a universal file, SI (by data set 164 where it is there);
    repeated ones averaged.

    Those of the responses and references to `leave_out` are not looked at.

    Raises
    ------
    DataError
        If there are none, several references have no name, they share no more than half of their
        lines, one lacks values, or so many pairs of response and reference are absent that most
        functions are of no use; where few are, their response or reference is left out, and said.
    """
    functions, units = _functions(path)
    frfs = [f for f in functions if f.kind in (FRF, TRANSMISSIBILITY)]
    if not frfs:
        raise DataError(
            f"{path}: no FRFs (58, function type 4 or 5); "
            f"{functions_held(f.kind for f in functions)}"
        )
    ends = _ends(frfs)
    kept = [k for k, both in enumerate(ends) if not set(both) & set(leave_out)]
    if not kept:
        raise DataError(f"{path}: without {' '.join(leave_out)} no function is left")
    frfs = [frfs[k] for k in kept]
    ends = [ends[k] for k in kept]
    if all(f.reference[0] == 0 for f in frfs) and len(set(ends)) < len(frfs):
        raise DataError(
            f"{path}: the functions name no reference point; its node is 0 in all {len(frfs)}"
        )
    frfs = _on_shared_lines(frfs, ends, path)
    freqs = frfs[0].x
    motions, factors = zip(*(_si(f, units) for f in frfs), strict=True)
    kind = _one_kind(motions, ends, path)
    if kind == "unknown":
        say_accelerances(path)
    outputs, inputs = _channels(ends, kind)
    scaled = (
        as_motion(np.where(np.isfinite(f.y), f.y, np.nan) * x, freqs, m, kind)
        for f, m, x in zip(frfs, motions, factors, strict=True)
    )
    data = _place(
        [replace(f, y=y) for f, y in zip(frfs, scaled, strict=True)], ends, freqs, outputs, inputs
    )
    absent = np.asarray(np.isnan(data).all(axis=0))
    if absent.any():
        rows, columns = _whole(absent)
        _warn_left_out(absent, (rows, columns), (outputs, inputs), path)
        data = data[:, rows][:, :, columns]
        outputs = tuple(outputs[k] for k in rows)
        inputs = tuple(inputs[k] for k in columns)
    coherences = list(filter(None, (_on_lines(f, freqs) for f in functions if f.kind == COHERENCE)))
    coherence = _place(coherences, _ends(coherences), freqs, outputs, inputs).real
    based = {ref for (_, ref), f in zip(ends, frfs, strict=True) if _on_base(f)}
    at = known_lines(data, freqs, [c.id for c in outputs], [c.id for c in inputs], path)
    return FrfSet(
        data=data[at],
        freqs=freqs[at],
        outputs=outputs,
        inputs=tuple(base_motion(c.id) if c.id in based else c for c in inputs),
        coherence=np.ascontiguousarray(coherence[at]),
        averages=np.full(len(inputs), np.nan),
        kind="receptance" if kind == "strain" else FRF_KIND.get(kind, "accelerance"),
        source=str(path),
    )


def _whole(absent: Bool) -> tuple[Int, Int]:
    """Responses and references that are left when the one that lacks most of its pairs goes, until
    none is absent.
    """
    rows = np.arange(absent.shape[0])
    columns = np.arange(absent.shape[1])
    while (part := absent[np.ix_(rows, columns)]).any():
        a = part.mean(axis=1)
        b = part.mean(axis=0)
        if a.max() >= b.max():
            rows = np.delete(rows, int(a.argmax()))
        else:
            columns = np.delete(columns, int(b.argmax()))
    return rows, columns


def _warn_left_out(
    absent: Bool,
    kept: tuple[Int, Int],
    channels: tuple[Sequence[Channel], Sequence[Channel]],
    path: str | Path,
) -> None:
    rows, columns = kept
    outputs, inputs = channels
    o, i = (int(k) for k in np.argwhere(absent)[0])
    why = (
        f"{path}: no values from {inputs[i].id} to {outputs[o].id} ({int(absent.sum())} pairs "
        "are absent)"
    )
    left = [c.id for k, c in enumerate(outputs) if k not in rows]
    without = [c.id for k, c in enumerate(inputs) if k not in columns]
    # 0.6: of the functions, that must be left where some pairs are absent
    if rows.size * columns.size < 0.6 * int((~absent).sum()):
        raise DataError(
            f"{why}; without gaps {rows.size} responses and {columns.size} references are left"
        )
    lost = [
        f"{what} {' '.join(ids)}"
        for what, ids in (("response", left), ("reference", without))
        if ids
    ]
    log.warning("%s; left out: %s", why, ", ".join(lost))


def _one_kind(
    motions: Sequence[Quantity], ends: Sequence[tuple[str, str]], path: str | Path
) -> Quantity:
    """The quantity of most functions; a force is none."""
    if wrong := dict.fromkeys(
        out for m, (out, _) in zip(motions, ends, strict=True) if m == "force"
    ):
        raise DataError(
            f"{path}: the response {' '.join([*wrong][:8])} is a force; an FRF here is motion "
            "over force"
        )
    return max(dict.fromkeys(motions), key=motions.count)


def _si(f: UffFunction, units: Units | None) -> tuple[Quantity, float]:
    """Quantity of the response of an FRF and the factor to SI: by the units on its axes, else by
    data set 164.

    A motion over the same motion of a base is taken as an acceleration: the base is what forces of
    inertia act for. Motions about an axis are those along it by name; their unit is radian.
    """
    over = f.axes[1]
    under = f.axes[2]
    about, turned = (abs(end[1]) > 3 for end in (f.response, f.reference))
    text = over.unit.strip()
    tail = under.unit.strip()
    base = _QUANTITY.get(under.data_type, "unknown")
    if _on_base(f):
        (what, size), (_, moved) = (
            _motion(over, text, units, about),
            _motion(under, tail, units, turned),
        )
        what = LINEAR.get(what, what)
        return "acceleration" if what in (
            "unknown",
            base,
        ) or base == "unknown" else what, size / moved
    if not _acts(tail) and _acts(text.rpartition("/")[2]):
        text, _, tail = text.rpartition("/")
    quantity, motion = _motion(over, text, units, about)
    force = (
        to_si(tail.strip("() "))[1]
        if _acts(tail)
        else _factor("moment" if turned else "force", units)
    )
    return LINEAR.get(quantity, quantity), motion / force


def _on_base(f: UffFunction) -> bool:
    """Whether it is a motion over the motion of a base."""
    return f.kind == TRANSMISSIBILITY or _QUANTITY.get(f.axes[2].data_type, "unknown") in FRF_KIND


def _motion(axis: Axis, unit: str, units: Units | None, about: bool) -> tuple[Quantity, float]:
    """Quantity of an axis and its factor to SI; the unit counts where it is known and not another
    quantity's.
    """
    quantity = _QUANTITY.get(axis.data_type, "unknown")
    unit = unit.strip("() ")
    if unit and known(unit):
        measured, factor, _ = to_si(unit)
        if quantity in ("unknown", LINEAR.get(measured, measured)):
            return measured, factor
    quantity = ANGULAR.get(quantity, quantity) if about else quantity
    return quantity, _factor(quantity, units)


def _signal(f: UffFunction, units: Units | None) -> tuple[Quantity, float]:
    """Quantity of a time function and its factor to SI."""
    return _motion(f.axes[1], f.axes[1].unit, units, abs(f.response[1]) > 3)


def _acts(unit: str) -> bool:
    """Whether a unit is one of forces or moments."""
    unit = unit.strip("() ")
    return bool(unit and known(unit)) and to_si(unit)[0] in FORCES


def _ends(functions: Sequence[UffFunction]) -> list[tuple[str, str]]:
    """Names of the response and the reference of each function."""
    responses = _titles(functions) or [label(*f.response) for f in functions]
    return list(zip(responses, _references(functions, responses), strict=True))


def _references(functions: Sequence[UffFunction], responses: Sequence[str]) -> list[str]:
    """The point of each reference; where none has one, what else distinguishes them: the entity, or
    the direction.
    """
    if any(f.reference[0] for f in functions):
        return [label(*f.reference) for f in functions]
    entities = [f.names[1] for f in functions]
    directions = [f"{_NO_REFERENCE}{label(*f.reference)[1:]}" for f in functions]
    alone = len(set(responses)) == len(functions)
    for names in (entities, directions):
        pairs = set(zip(responses, names, strict=True))
        if (
            not alone
            and len(pairs) == len(functions)
            and not set(_UNNAMED) & {n.upper() for n in names}
        ):
            return names
    return [_NO_REFERENCE] * len(functions)


def _on_shared_lines(
    frfs: list[UffFunction], ends: Sequence[tuple[str, str]], path: str | Path
) -> list[UffFunction]:
    """The functions at the lines that all have."""
    at = shared_lines([f.x for f in frfs])
    if at is None:
        sizes = [f.x.size for f in frfs]
        usual = frfs[sizes.index(max(dict.fromkeys(sizes), key=sizes.count))]
        other = (k for k, f in enumerate(frfs) if shared_lines([f.x, usual.x]) is None)
        odd = next(other, sizes.index(min(sizes)))
        raise DataError(f"{path}: function {'/'.join(ends[odd])} has other frequency lines")
    if all(a.size == f.x.size for a, f in zip(at, frfs, strict=True)):
        return frfs
    out = [replace(f, x=f.x[a], y=f.y[a]) for f, a in zip(frfs, at, strict=True)]
    counts = out[0].x.size, min(f.x.size for f in frfs), max(f.x.size for f in frfs)
    log.warning("%s: the functions share %d lines of %d to %d, which are used", path, *counts)
    return out


def _on_lines(f: UffFunction, freqs: Float) -> UffFunction | None:
    """The function at some lines; None where it lacks one of them."""
    at = shared_lines([f.x, freqs])
    return replace(f, x=freqs, y=f.y[at[0]]) if at and at[0].size == freqs.size else None


def _channels(
    ends: Sequence[tuple[str, str]], kind: Quantity
) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    outputs, inputs = (dict.fromkeys(both[k] for both in ends) for k in (0, 1))
    return tuple(channel(n, kind) for n in outputs), tuple(channel(n, "force") for n in inputs)


def _place(
    functions: Sequence[UffFunction],
    ends: Sequence[tuple[str, str]],
    freqs: Float,
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
) -> Complex:
    row = {c.id: i for i, c in enumerate(outputs)}
    column = {c.id: i for i, c in enumerate(inputs)}
    data = np.full((freqs.size, len(outputs), len(inputs)), np.nan, dtype=np.complex128)
    times = np.zeros(data.shape[1:])
    # a pair measured several times is averaged
    for f, (out, ref) in zip(functions, ends, strict=True):
        if out in row and ref in column:
            at = row[out], column[ref]
            data[:, *at] = (
                f.y if not times[at] else data[:, *at] + (f.y - data[:, *at]) / (times[at] + 1)
            )
            times[at] += 1
    return data
