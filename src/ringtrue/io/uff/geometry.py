"""Geometry of universal files: nodes, elements, lines, coordinate systems, groups and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import atomic_write
from ringtrue.io.foreign.parsers import write_sets
from ringtrue.io.uff.datasets import (
    Block,
    integers,
    numbers,
    parse_int,
    parse_real,
    reals,
    row,
    scan,
    words,
)

_BEAMS = (11, 21, 22, 23, 24)  # FE descriptors with a line of orientation


@dataclass(frozen=True, slots=True)
class Units:
    """Data set 164: file units per SI unit; SI = file value / factor."""

    code: int
    name: str
    length: float
    force: float
    temperature: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Nodes: label (n,), definition and displacement systems (n,), place (n, 3) as stored."""

    label: Int
    definition: Int
    displacement: Int
    place: Float


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """An element of data set 2412: label, FE descriptor, property and material numbers, nodes
    (k,).
    """

    label: int
    descriptor: int
    physical: int
    material: int
    nodes: Int


@dataclass(frozen=True, slots=True, eq=False)
class TraceLine:
    """Data set 82: a line to draw; 0 in `nodes` lifts the pen."""

    label: int
    name: str
    nodes: Int


@dataclass(frozen=True, slots=True, eq=False)
class CoordinateSystem:
    """A coordinate system: type 0 cartesian, 1 cylindrical, 2 spherical; origin (3,) and rows of
    axes (3, 3).
    """

    label: int
    name: str
    kind: int
    origin: Float
    axes: Float


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Data set 2467: name and entities, (n, 2) type code (7 node, 8 element) and tag."""

    label: int
    name: str
    entities: Int


@dataclass(frozen=True, slots=True)
class Qualifier:
    """Data set 1858, about the function that follows."""

    window_type: int
    amplitude_units: int
    window_damping: float
    response_direction: str
    reference_direction: str


@dataclass(frozen=True, slots=True)
class ModelHeader:
    """Data sets 151 (lines of text) and 2400 (`uid` of the model; 0 in 151)."""

    name: str
    uid: int
    text: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Everything but functions and shapes that a universal file holds.

    Attributes
    ----------
    nodes : Nodes or None
        In m where the file has units (164), else as stored.
    elements, lines, systems, groups, qualifiers, headers : tuple
    units : Units or None
    kinds : tuple of int
        Numbers of all data sets of the file, in its order.
    """

    nodes: Nodes | None
    elements: tuple[Element, ...]
    lines: tuple[TraceLine, ...]
    systems: tuple[CoordinateSystem, ...]
    groups: tuple[Group, ...]
    qualifiers: tuple[Qualifier, ...]
    headers: tuple[ModelHeader, ...]
    units: Units | None
    kinds: tuple[int, ...]


def read_geometry(path: str | Path) -> Geometry:
    """Nodes, elements, lines, coordinate systems, groups, units and headers of a universal file.

    Raises
    ------
    DataError
        If it is no universal file or one of these data sets is damaged.
    """
    blocks = scan(path)
    with about(path):
        by = {
            k: [b for b in blocks if b.kind == k]
            for k in (15, 18, 82, 151, 164, 1858, 2400, 2411, 2412, 2420, 2467)
        }
        units = [read_units(b) for b in by[164]]
        nodes = [_nodes15(b) for b in by[15]] + [_nodes2411(b) for b in by[2411]]
        return Geometry(
            _joined(nodes, units[0].length if units else 1.0),
            tuple(e for b in by[2412] for e in _elements(b.lines())),
            tuple(_trace(b.lines()) for b in by[82]),
            tuple(s for b in by[18] for s in _systems18(b.lines()))
            + tuple(s for b in by[2420] for s in _systems2420(b.lines())),
            tuple(g for b in by[2467] for g in _groups(b.lines())),
            tuple(_qualifier(b.lines()) for b in by[1858]),
            tuple(_header151(b.lines()) for b in by[151])
            + tuple(_header2400(b.lines()) for b in by[2400]),
            units[0] if units else None,
            tuple(b.kind for b in blocks),
        )


def read_units(block: Block) -> Units:
    """Data set 164; the vendors count from any column and leave the temperature out."""
    lines = block.lines()
    head = row(lines, 0)
    values = [parse_real(w) for w in " ".join(lines[1:3]).split()]
    length, force, temperature, offset = ([*values, *(1.0, 1.0, 1.0, 0.0)[len(values) :]])[:4]
    if not (length > 0 and force > 0):
        raise DataError(f"data set 164: factors of length {length} and force {force} must be > 0")
    return Units(parse_int(head[:10]), head[10:30].strip(), length, force, temperature, offset)


def _joined(parts: Sequence[Nodes], factor: float) -> Nodes | None:
    """One table; a node that is given again keeps its last place."""
    if not parts:
        return None
    label = np.concatenate([p.label for p in parts])
    _, last = np.unique(label[::-1], return_index=True)
    at = np.sort(label.size - 1 - last)
    join = [
        np.concatenate([getattr(p, n) for p in parts])[at]
        for n in ("definition", "displacement", "place")
    ]
    return Nodes(label[at], join[0], join[1], join[2] / factor)


def _nodes15(block: Block) -> Nodes:
    table = np.array([numbers(x, (10, 10, 10, 10, 13, 13, 13)) for x in block.lines()]).reshape(
        -1, 7
    )
    whole = table[:, :3].astype(np.int64)
    return Nodes(whole[:, 0], whole[:, 1], whole[:, 2], table[:, 4:])


def _nodes2411(block: Block) -> Nodes:
    lines = block.lines()
    if len(lines) % 2:
        raise DataError(
            f"data set 2411 has {len(lines)} lines; a node has two: the file is cut or damaged"
        )
    whole = np.array([_integers(x, 4) for x in lines[::2]], dtype=np.int64).reshape(-1, 4)
    place = reals(
        "\n".join(lines[1::2]).encode("latin-1", "replace"), (25, 25, 25), 3 * whole.shape[0]
    )
    return Nodes(whole[:, 0], whole[:, 1], whole[:, 2], place.reshape(-1, 3))


def _integers(line: str, least: int) -> list[int]:
    found = integers([line])
    if found.size < least:
        raise DataError(f"line {line.strip()[:60]!r} has {found.size} integers; {least} are needed")
    return [int(i) for i in found[:least]]


def _take(lines: Sequence[str], at: int, count: int) -> tuple[Int, int]:
    """`count` integers from line `at` on, and the line after them."""
    if not 0 <= count <= 20 * len(lines):
        raise DataError(
            f"{count} integers are announced in {len(lines)} lines; the file is cut or damaged"
        )
    found: list[Int] = []
    while sum(f.size for f in found) < count:
        found.append(integers([row(lines, at)]))
        if not found[-1].size:
            raise DataError(f"line {at + 1} is empty where integers are announced")
        at += 1
    return (np.concatenate(found)[:count] if found else np.zeros(0, dtype=np.int64)), at


def _elements(lines: Sequence[str]) -> Iterator[Element]:
    at = 0
    while at < len(lines):
        label, descriptor, physical, material, _, count = _integers(lines[at], 6)
        nodes, at = _take(lines, at + (2 if descriptor in _BEAMS else 1), count)
        yield Element(label, descriptor, physical, material, nodes)


def _trace(lines: Sequence[str]) -> TraceLine:
    label, count = _integers(row(lines, 0), 2)
    nodes, _ = _take(lines, 2, count)
    return TraceLine(label, row(lines, 1).strip(), nodes)


def _systems18(lines: Sequence[str]) -> Iterator[CoordinateSystem]:
    """Origin, a point on x and a point in the xz plane."""
    at = 0
    while at < len(lines):
        label, kind = _integers(lines[at], 2)
        values = [parse_real(w) for w in f"{row(lines, at + 2)} {row(lines, at + 3)}".split()]
        if len(values) < 9:
            raise DataError(f"data set 18, system {label}: {len(values)} of 9 coordinates")
        origin, on_x, in_xz = np.array(values[:9]).reshape(3, 3)
        yield CoordinateSystem(
            label, lines[at + 1].strip(), kind, origin, _axes(on_x - origin, in_xz - origin, label)
        )
        at += 4


def _axes(x: Float, xz: Float, label: int) -> Float:
    y = np.cross(xz, x)
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    if not size > 0:
        raise DataError(f"data set 18, system {label}: its three points are on one line")
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def _systems2420(lines: Sequence[str]) -> Iterator[CoordinateSystem]:
    """Part number and name, then label, name and a 4 x 3 matrix: three rows of axes and the
    origin.
    """
    at = 2
    while at < len(lines):
        label, kind = _integers(lines[at], 2)
        text = "\n".join(row(lines, at + k) for k in range(2, 6)).encode("latin-1", "replace")
        matrix = reals(text, (25, 25, 25), 12).reshape(4, 3)
        yield CoordinateSystem(label, lines[at + 1].strip(), kind, matrix[3], matrix[:3])
        at += 6


def _groups(lines: Sequence[str]) -> Iterator[Group]:
    at = 0
    while at < len(lines):
        head = _integers(lines[at], 8)
        values, after = _take(lines, at + 2, 4 * head[7])
        yield Group(head[0], row(lines, at + 1).strip(), values.reshape(-1, 4)[:, :2])
        at = after


def _qualifier(lines: Sequence[str]) -> Qualifier:
    kinds = numbers(row(lines, 1), (6,) * 12)
    user = numbers(row(lines, 3), (15,) * 5)
    response, reference = (words(row(lines, 5), (4, 2, 4))[i] for i in (0, 2))
    return Qualifier(int(kinds[1]), int(kinds[2]), user[4], response, reference)


def _header151(lines: Sequence[str]) -> ModelHeader:
    return ModelHeader(row(lines, 0).strip(), 0, tuple(x.strip() for x in lines))


def _header2400(lines: Sequence[str]) -> ModelHeader:
    return ModelHeader(
        row(lines, 1).strip(), parse_int(row(lines, 0)[:12]), tuple(x.strip() for x in lines)
    )


_MOST = 9_999_999_999  # ten columns
_UNITS = {
    "type": 164,
    "units_code": 1,
    "units_description": "SI",
    "temp_mode": 1,
    "length": 1.0,
    "force": 1.0,
    "temp": 1.0,
    "temp_offset": 273.15,
}


def write_test_model(path: str | Path, test: TestModel) -> None:
    """Write points and lines, global frame, m.

    The format carries six digits of a coordinate, and no channels: those stand in the sensor sheet.

    Raises
    ------
    DataError
        If there are no points, or a number has more than ten digits.
    """
    if not test.points.size or test.points.max() > _MOST or test.points.min() < 1:
        raise DataError(f"{path}: {test.points.size} points; their numbers must be 1 to {_MOST}")
    x, y, z = test.xyz.T
    sets: list[dict[str, object]] = [
        _UNITS,
        {"type": 15, "node_nums": test.points, "x": x, "y": y, "z": z},
    ]
    if len(test.lines):
        trace = np.column_stack(
            [test.lines, np.zeros(len(test.lines), dtype=np.int64)]
        ).ravel()  # 0 lifts the pen
        sets.append({"type": 82, "trace_num": 1, "id": "measuring points", "nodes": trace})
    with atomic_write(path) as part:
        write_sets(part, sets)
