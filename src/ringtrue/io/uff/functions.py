"""Data set 58 read: time records and frequency response functions.

Units of universal files, and the points and lines of a test as one.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import (
    ANGULAR,
    FORCES,
    FRF_KIND,
    LINEAR,
    SI_UNIT,
    UNIT,
    as_motion,
)
from ringtrue.core.dofs import NAMES
from ringtrue.core.signals import FrfSet, Quantity, shared_lines
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import atomic_write, functions_held, sets_held
from ringtrue.io.foreign.parsers import write_sets
from ringtrue.io.frf_tables import frf_set, references, say_accelerances
from ringtrue.io.record_table import RawTable
from ringtrue.io.times import even_rate, known, to_si, uneven
from ringtrue.io.uff.datasets import DataSet, parse_real, row, scan
from ringtrue.io.uff.function58 import (
    FRF_TYPES,
    Axis,
    AxisType,
    FunctionType,
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
        raise DataError(
            f"data set 164: factors of length {length} and force {force} must be > 0"
        )
    return Units(length, force)


def write_test_model(path: str | Path, test: TestModel) -> None:
    """Write points and lines, global frame, m.

    The format carries six digits of a coordinate, and no channels: those stand in the sensor sheet.

    Raises
    ------
    DataError
        If there are no points, or a number has more than ten digits.
    """
    sets = test_model_sets(path, test)
    with atomic_write(path) as part:
        write_sets(part, sets)


def test_model_sets(path: str | Path, test: TestModel) -> list[dict[str, object]]:
    """The data sets of units, points and lines that `write_test_model` writes."""
    largest = 9_999_999_999  # ten columns
    if not test.points.size or test.points.max() > largest or test.points.min() < 1:
        raise DataError(
            f"{path}: {test.points.size} points; their numbers must be 1 to {largest}"
        )
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
    sets: list[dict[str, object]] = [
        units,
        {"type": 15, "node_nums": test.points, "x": x, "y": y, "z": z},
    ]
    if len(test.lines):
        # 0 lifts the pen
        trace = np.column_stack(
            [test.lines, np.zeros(len(test.lines), dtype=np.int64)]
        ).ravel()
        sets.append(
            {"type": 82, "trace_num": 1, "id": "measuring points", "nodes": trace}
        )
    return sets


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
_SKEWED = re.compile(r"\d+[+-][XYZ]s\d*")
_NO_REFERENCE = "in1"
_WITHOUT_LENGTH = ("strain", "unknown", *(ANGULAR[motion] for motion in SI_UNIT))


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
        held = sets_held(b.kind for b in blocks)
        raise DataError(f"{path}: no records and no FRFs (data set 58); {held}")
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
    return _time_table(*_time_functions(path), path)


def read_time_runs(path: Path) -> tuple[RawTable, ...]:
    """A table for each acquisition where every channel comes as often: triggered blows, one after
    the other.
    """
    found, units = _time_functions(path)
    channels: dict[object, list[UffFunction]] = {}
    for f in found:
        channels.setdefault((*f.response, _signal(f, units)[0]), []).append(f)
    times = {len(each) for each in channels.values()}
    if len(channels) < 2 or len(times) > 1 or times == {1} or _titles(found):
        return (_time_table(found, units, path),)
    runs = zip(*channels.values(), strict=True)
    return tuple(_time_table(run, units, path) for run in runs)


def _time_functions(path: Path) -> tuple[list[UffFunction], Units | None]:
    functions, units = _functions(path)
    unstated = (0, AxisType.TIME)
    found = [
        f
        for f in functions
        if f.kind == FunctionType.TIME or (f.kind, f.axes[0].data_type) == unstated
    ]
    if not found:
        raise DataError(
            f"{path}: no time records; {functions_held(f.kind for f in functions)}"
        )
    return found, units


def _time_table(
    found: Sequence[UffFunction], units: Units | None, path: Path
) -> RawTable:
    rates = [_rate(f, path) for f in found]
    low = min(rates)
    high = max(rates)
    if high - low > 1e-4 * high:
        raise DataError(
            f"{path}: different rates, {low:g} to {high:g} Hz; split the file"
        )
    length = min(f.y.size for f in found)
    kinds, factors = zip(*(_signal(f, units) for f in found), strict=True)
    data = np.stack(
        [np.real(f.y[:length]) * x for f, x in zip(found, factors, strict=True)]
    )
    names = _names(found, kinds)
    return RawTable(data, rates[0], names, tuple(UNIT.get(k, "") for k in kinds), kinds)


def _rate(f: UffFunction, path: Path) -> float:
    if not f.even:
        rate = even_rate(f.x, path)
        if rate is None:
            raise DataError(f"{path}: {uneven(f.x)}")
        return rate
    step = float(f.x[-1] - f.x[0]) / (f.x.size - 1) if f.x.size > 1 else 0.0
    if not (np.isfinite(step) and step > 0):
        raise DataError(f"{path}: step of time {step}; it must be positive")
    # of fewest digits whose step is the given one to the six digits that data set 58 holds
    unit = 10.0 ** (np.floor(np.log10(step)) - _DIGITS)
    rates = (float(f"{1 / step:.{k}e}") for k in range(_DIGITS + 1))
    return next((r for r in rates if abs(1 / r - step) <= 0.5001 * unit), 1 / step)


def _factor(quantity: str, units: Units | None) -> float:
    """To SI: data set 164 holds file units per SI unit."""
    if units is None or quantity in _WITHOUT_LENGTH:
        return 1.0
    if quantity == "force":
        return 1 / units.force
    if quantity == "moment":
        return 1 / (units.force * units.length)
    return 1 / units.length


def _names(functions: Sequence[UffFunction], kinds: Sequence[str]) -> tuple[str, ...]:
    """Point and direction of each; a force at the point of a response is `F:101+Z`."""
    if titles := _titles(functions):
        return tuple(titles)
    # a skewed sensor, for which there is no code, has its name as first line of text
    names = [
        f.ids[0] if _SKEWED.fullmatch(f.ids[0]) else label(*f.response)
        for f in functions
    ]
    marked = [f"F:{n}" if k in FORCES else n for n, k in zip(names, kinds, strict=True)]
    for tried in (names, marked):
        if len(set(tried)) == len(tried):
            return tuple(tried)
    return tuple(f"{n}#{i + 1}" for i, n in enumerate(names))


def _titles(functions: Sequence[UffFunction]) -> list[str]:
    """Where no response has a point, what else names each: its entity, the label of its axis, its
    first text.
    """
    if any(f.response[0] for f in functions):
        return []
    for texts in zip(
        *((f.names[0], f.axes[1].label, f.ids[0]) for f in functions), strict=True
    ):
        if len(set(texts)) == len(texts) and not _unnamed(texts):
            return list(texts)
    return []


def frf_ends(path: str | Path) -> tuple[str, ...]:
    """Ids of all responses and references of the FRFs of a universal file, sound or not."""
    frfs = [f for f in read_functions(path) if f.kind in FRF_TYPES]
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
    frfs = [f for f in functions if f.kind in FRF_TYPES]
    if not frfs:
        held = functions_held(f.kind for f in functions)
        raise DataError(f"{path}: no FRFs (58, function type 4 or 5); {held}")
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
    for motion, (out, _) in zip(motions, ends, strict=True):
        if motion == "force":
            raise DataError(
                f"{path}: the response {out} is a force; an FRF here is motion over force"
            )
    kind = max(dict.fromkeys(motions), key=motions.count)
    if kind == "unknown":
        say_accelerances(path)
    outputs, inputs = (list(dict.fromkeys(names)) for names in zip(*ends, strict=True))
    values = [
        as_motion(np.where(np.isfinite(f.y), f.y, np.nan) * x, freqs, m, kind)
        for f, m, x in zip(frfs, motions, factors, strict=True)
    ]
    data = _place(values, ends, outputs, inputs, freqs)
    absent = np.asarray(np.isnan(data).all(axis=0))
    if absent.any():
        rows, columns = _whole(absent)
        _warn_left_out(absent, (rows, columns), (outputs, inputs), path)
        data = data[:, rows][:, :, columns]
        outputs = [outputs[k] for k in rows]
        inputs = [inputs[k] for k in columns]
    coherences = [f for f in functions if f.kind == FunctionType.COHERENCE]
    at_lines = [shared_lines([f.x, freqs]) for f in coherences]
    usable = [
        (f, at[0])
        for f, at in zip(coherences, at_lines, strict=True)
        if at and at[0].size == freqs.size
    ]
    both = _ends([f for f, _ in usable])
    coherence = _place([f.y[at] for f, at in usable], both, outputs, inputs, freqs).real
    based = {ref for (_, ref), f in zip(ends, frfs, strict=True) if _on_base(f)}
    named = outputs, references(inputs, based)
    return frf_set(data, freqs, named, kind, path, coherence=coherence)


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
    names: tuple[Sequence[str], Sequence[str]],
    path: str | Path,
) -> None:
    o, i = np.argwhere(absent)[0].tolist()
    why = (
        f"{path}: no values from {names[1][i]} to {names[0][o]} ({int(absent.sum())} pairs are "
        "absent)"
    )
    # 0.6: of the functions, that must be left where some pairs are absent
    if kept[0].size * kept[1].size < 0.6 * int((~absent).sum()):
        left = f"{kept[0].size} responses and {kept[1].size} references"
        raise DataError(f"{why}; without gaps {left} are left")
    lost = [
        f"{what} {' '.join(np.delete(np.array(ids), rows).tolist())}"
        for what, ids, rows in zip(("response", "reference"), names, kept, strict=True)
        if rows.size < len(ids)
    ]
    log.warning("%s; left out: %s", why, ", ".join(lost))


def _si(f: UffFunction, units: Units | None) -> tuple[Quantity, float]:
    """Quantity of the response of an FRF and the factor to SI: by the units on its axes, else by
    data set 164.

    A motion over the same motion of a base is taken as an acceleration: the base is what forces of
    inertia act for. Motions about an axis are those along it by name; their unit is radian.
    """
    over = f.axes[1]
    under = f.axes[2]
    about, turned = (abs(end[1]) > 3 for end in (f.response, f.reference))
    if _on_base(f):
        base = _QUANTITY.get(under.data_type, "unknown")
        what, size = _motion(over, over.unit, units, about)
        _, moved = _motion(under, under.unit, units, turned)
        what = LINEAR.get(what, what)
        same = base == "unknown" or what in ("unknown", base)
        return "acceleration" if same else what, size / moved
    text = over.unit.strip()
    tail = under.unit.strip()
    if not _acts(tail) and _acts(text.rpartition("/")[2]):
        text, _, tail = text.rpartition("/")
    quantity, motion = _motion(over, text, units, about)
    force = _factor("moment" if turned else "force", units)
    if _acts(tail):
        force = to_si(tail.strip("() "))[1]
    return LINEAR.get(quantity, quantity), motion / force


def _on_base(f: UffFunction) -> bool:
    """Whether it is a motion over the motion of a base."""
    reference = _QUANTITY.get(f.axes[2].data_type, "unknown")
    return f.kind == FunctionType.TRANSMISSIBILITY or reference in FRF_KIND


def _motion(
    axis: Axis, unit: str, units: Units | None, about: bool
) -> tuple[Quantity, float]:
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


def _references(
    functions: Sequence[UffFunction], responses: Sequence[str]
) -> list[str]:
    """The point of each reference; where none has one, what else distinguishes them: the entity, or
    the direction.
    """
    if any(f.reference[0] for f in functions):
        return [label(*f.reference) for f in functions]
    entities = [f.names[1] for f in functions]
    directions = [f"{_NO_REFERENCE}{label(*f.reference)[1:]}" for f in functions]
    if len(set(responses)) < len(functions):
        for names in (entities, directions):
            pairs = set(zip(responses, names, strict=True))
            if len(pairs) == len(functions) and not _unnamed(names):
                return names
    return [_NO_REFERENCE] * len(functions)


def _unnamed(texts: Iterable[str]) -> bool:
    return bool({"", "NONE"} & {text.upper() for text in texts})


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
        raise DataError(
            f"{path}: function {'/'.join(ends[odd])} has other frequency lines"
        )
    if all(a.size == f.x.size for a, f in zip(at, frfs, strict=True)):
        return frfs
    out = [replace(f, x=f.x[a], y=f.y[a]) for f, a in zip(frfs, at, strict=True)]
    counts = out[0].x.size, min(f.x.size for f in frfs), max(f.x.size for f in frfs)
    log.warning(
        "%s: the functions share %d lines of %d to %d, which are used", path, *counts
    )
    return out


def _place(
    values: Sequence[Any_],
    ends: Sequence[tuple[str, str]],
    outputs: Sequence[str],
    inputs: Sequence[str],
    freqs: Float,
) -> Complex:
    """Functions (f,) by response and reference, (f, out, in); those of one pair are averaged, NaN
    where there is none.
    """
    data = np.full((freqs.size, len(outputs), len(inputs)), np.nan, dtype=np.complex128)
    times = np.zeros(data.shape[1:])
    for y, (out, ref) in zip(values, ends, strict=True):
        if out in outputs and ref in inputs:
            at = outputs.index(out), inputs.index(ref)
            mean = data[:, *at] if times[at] else 0.0
            times[at] += 1
            data[:, *at] = mean + (y - mean) / times[at]
    return data
