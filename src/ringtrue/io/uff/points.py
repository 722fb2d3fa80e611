"""What universal files hold at points: their geometry (nodes 15 and 2411, frames 18 and 2420, trace
lines 82, elements 2412) and mode shapes (55 and 2414).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain, combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import atomic_write, refuse_large, sets_held
from ringtrue.io.foreign.door import door
from ringtrue.io.foreign.parsers import write_sets
from ringtrue.io.uff.datasets import (
    DataSet,
    integers,
    numbers,
    parse_real,
    reals,
    row,
    scan,
)
from ringtrue.io.uff.function58 import FunctionType, read_function
from ringtrue.io.uff.functions import label, read_units, test_model_sets

NODES = (15, 2411)
_BEAMS = (11, 21, 22, 23, 24)  # descriptors of elements with a line of orientation
_SOLIDS = range(101, 120)
_EDGES: dict[int, tuple[tuple[int, int], ...]] = {  # of solids by their number of nodes
    4: tuple(combinations(range(4), 2)),
    6: ((0, 1), (1, 2), (0, 2), (3, 4), (4, 5), (3, 5), (0, 3), (1, 4), (2, 5)),
    8: (
        *((0, 1), (1, 2), (2, 3), (0, 3), (4, 5), (5, 6), (6, 7), (4, 7)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}


@dataclass(frozen=True, slots=True)
class _Frame:
    """A coordinate system: 0 Cartesian, 1 cylindrical, 2 spherical; its axes are rows."""

    kind: int
    origin: Float
    axes: Float


@dataclass(frozen=True, slots=True)
class _Node:
    definition: int
    displacement: int
    xyz: Float


def read_geometry(path: str | Path) -> TestModel:
    """Points, trace lines and edges of elements of a universal file, global frame, m.

    Channels are the translations of the responses of its functions, along the displacement frames
    of their points, and forces the references of its FRFs; in a file without functions at its
    points each point has the three translations.

    Raises
    ------
    DataError
        If the file has no nodes, a frame that is needed is not Cartesian, or a line names a node
        that is not there.
    """
    with about(path), door(path, "geometry of a universal file"):
        blocks = scan(path)
        nodes: dict[int, _Node] = {}
        for block in blocks:
            if block.kind in NODES:
                nodes |= _nodes(block)
        if not nodes:
            held = sets_held(b.kind for b in blocks)
            raise DataError(
                f"{path}: no nodes (data set 15 or 2411), so no geometry; {held}"
            )
        scale = next((1 / read_units(b).length for b in blocks if b.kind == 164), 1.0)
        frames = dict(
            pair for b in blocks if b.kind in (18, 2420) for pair in _frames(b)
        )
        place = []
        for node in nodes.values():
            frame = _frame(node.definition, frames, f"the point {node.xyz.tolist()}")
            place.append(frame.origin + node.xyz @ frame.axes)
        xyz = np.array(place) * scale
        if not np.isfinite(xyz).all():
            raise DataError("a coordinate is not finite")
        refuse_large(xyz, "coordinate")
        lines = _lines(blocks, nodes)
        responses, references = _ends(blocks, nodes)
        if not responses:
            responses = [(n, d) for n in nodes for d in (1, 2, 3)]
        axes = [_axis(nodes[n], d, frames, n) for n, d in responses]
        force_axes = [_axis(nodes[n], d, frames, n) for n, d in references]
        return TestModel(
            points=np.array(list(nodes), dtype=np.int64),
            xyz=xyz,
            channels=tuple(label(*end) for end in responses),
            at=np.array([n for n, _ in responses], dtype=np.int64),
            axes=np.array(axes),
            lines=np.array(lines, dtype=np.int64).reshape(-1, 2),
            forces=tuple(label(*end) for end in references),
            force_at=np.array([n for n, _ in references], dtype=np.int64),
            force_axes=np.array(force_axes).reshape(-1, 3),
        )


def _nodes(block: DataSet) -> Iterator[tuple[int, _Node]]:
    """Number and node of each; a loop over lines: tests have hundreds."""
    lines = block.lines()
    if block.kind == 15:
        for line in lines:
            n, definition, displacement, _, *place = numbers(
                line, (10,) * 4 + (13,) * 3
            )
            yield int(n), _Node(int(definition), int(displacement), np.array(place))
        return
    for at in range(0, len(lines), 2):
        head = integers([lines[at]]).tolist()
        if len(head) < 3:
            raise DataError(f"data set 2411: {lines[at].strip()[:40]!r} must be a node")
        xyz = reals(row(lines, at + 1).encode("latin-1", "replace"), (25,) * 3, 3)
        # coordinates of 2411 are those of the part
        yield head[0], _Node(0, head[2], xyz)


def _frames(block: DataSet) -> Iterator[tuple[int, _Frame]]:
    lines = block.lines()
    first, size = (0, 4) if block.kind == 18 else (2, 6)
    for at in range(first, len(lines), size):
        number, kind = integers([lines[at]]).tolist()[:2]
        body = "\n".join(row(lines, k) for k in range(at + 2, at + size)).encode(
            "latin-1", "replace"
        )
        if block.kind == 2420:
            matrix = reals(body, (25,) * 3, 12).reshape(4, 3)
            yield number, _Frame(kind, matrix[3], matrix[:3])
            continue
        # origin, a point of the x axis and one of the plane of x and z
        origin, along, across = reals(body, (13,) * 6, 9).reshape(3, 3)
        x = along - origin
        y = np.cross(across - origin, x)
        if not (np.linalg.norm(x) > 0 and np.linalg.norm(y) > 0):
            raise DataError(
                f"data set 18: the three points of frame {number} are on one line"
            )
        x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
        yield number, _Frame(kind, origin, np.stack([x, y, np.cross(x, y)]))


def _frame(number: int, frames: Mapping[int, _Frame], what: str) -> _Frame:
    """A Cartesian frame; the global one where the file does not define it."""
    found = frames.get(number)
    if found is None:
        return _Frame(0, np.zeros(3), np.eye(3))
    if found.kind != 0:
        raise DataError(
            f"{what} is in frame {number}, which is {('cylindrical', 'spherical')[found.kind > 1]};"
            " only Cartesian ones are read: export the geometry in the global frame"
        )
    return found


def _axis(
    node: _Node, direction: int, frames: Mapping[int, _Frame], number: int
) -> Float:
    frame = _frame(node.displacement, frames, f"the motion of point {number}")
    axis = frame.axes[abs(direction) - 1]
    return np.asarray(np.sign(direction) * axis / np.linalg.norm(axis))


def _lines(
    blocks: Sequence[DataSet], nodes: Mapping[int, _Node]
) -> list[tuple[int, int]]:
    """Pairs of points to draw, each once."""
    pairs = [pair for b in blocks if b.kind == 82 for pair in _trace(b)]
    pairs += [pair for b in blocks if b.kind == 2412 for pair in _edges(b)]
    once = dict.fromkeys((min(p), max(p)) for p in pairs if p[0] != p[1])
    if lost := sorted({n for pair in once for n in pair} - nodes.keys()):
        raise DataError(f"lines or elements name nodes that are not there: {lost[:8]}")
    return list(once)


def _trace(block: DataSet) -> list[tuple[int, int]]:
    lines = block.lines()
    count = integers([row(lines, 0)]).tolist()[1]
    points = integers(lines[2:]).tolist()[:count]
    return [(a, b) for a, b in pairwise(points) if a and b]  # 0 lifts the pen


def _edges(block: DataSet) -> Iterator[tuple[int, int]]:
    lines = block.lines()
    at = 0
    while at < len(lines):
        head = integers([lines[at]]).tolist()
        if len(head) < 6 or head[5] < 1:
            raise DataError(
                f"data set 2412: {lines[at].strip()[:40]!r} must be an element"
            )
        descriptor, count = head[1], head[5]
        at += 2 if descriptor in _BEAMS else 1
        end = at - (-count // 8)
        row(lines, end - 1)
        ends = integers(lines[at:end]).tolist()
        at = end
        if descriptor in _SOLIDS:  # those of the second order have no edges here
            yield from ((ends[a], ends[b]) for a, b in _EDGES.get(count, ()))
        else:
            ring = [*ends, ends[0]] if count > 3 or descriptor > 40 else ends
            yield from pairwise(ring)


End = tuple[int, int]  # node and direction


def _ends(
    blocks: Sequence[DataSet], nodes: Mapping[int, _Node]
) -> tuple[list[End], list[End]]:
    """Responses of the functions and references of the FRFs that are translations of the nodes."""
    functions = [read_function(b) for b in blocks if b.kind == 58]
    sides = (
        (f.response for f in functions),
        (f.reference for f in functions if f.kind == FunctionType.FRF),
    )
    responses, references = (
        [e for e in dict.fromkeys(side) if e[0] in nodes and 1 <= abs(e[1]) <= 3]
        for side in sides
    )
    return responses, references


AT_NODES = 1  # location of data in 2414
_NODE = re.compile(r"^\s*\d+\s*$")


class AnalysisType(IntEnum):
    """Of data sets 55 and 2414, as far as they are modes."""

    NORMAL = 2
    COMPLEX = 3


@dataclass(frozen=True, slots=True, eq=False)
class StoredShape:
    """Values at nodes.

    Attributes
    ----------
    analysis : int
        0 unknown, 1 static, 2 normal mode, 3 complex mode, 4 transient, 5 frequency response, 7
        complex, 2nd order.
    number : int
        Of the mode; 0 where it is no mode.
    frequency : float, Hz
    mass, viscous, hysteretic : float
        Modal mass and damping.
    pole : complex, rad/s
        Of a complex mode, else 0.
    nodes : (n,) int64
    values : (n, k) float64 or complex128
    name : str
    """

    analysis: int
    number: int
    frequency: float
    mass: float
    viscous: float
    hysteretic: float
    pole: complex
    nodes: Int
    values: Any_
    name: str


def read_shape55(block: DataSet) -> StoredShape:
    """Data set 55."""
    lines = block.lines()
    head = integers([row(lines, 5)])
    if head.size < 6:
        raise DataError(f"data set 55: record 6 has {head.size} of 6 integers")
    _, analysis, _, _, kind, width = head[:6].tolist()
    # integers and reals of the analysis; both may go over several lines
    counts = integers([row(lines, 6)]).tolist()
    if len(counts) < 2 or not (0 <= counts[0] <= 80 and 0 <= counts[1] <= 80):
        raise DataError(
            f"data set 55: record 7 begins with {counts[:2]}, counts of integers and reals"
        )
    (n_int, n_real), whole = counts[:2], counts[2:]
    at = 7
    while len(whole) < n_int:
        more = integers([row(lines, at)]).tolist()
        if not more:
            raise DataError("data set 55: integers of record 7 are missing")
        whole += more
        at += 1
    end = at - (-n_real // 6)
    row(lines, end - 1)
    real = [*_line_reals(lines[at:end], n_real), *[0.0] * 4]
    is_complex = analysis == AnalysisType.COMPLEX
    frequency, mass, viscous, hysteretic = (0.0,) * 4 if is_complex else real[:4]
    nodes, values = _values(lines[end:], width, kind in (5, 6))
    return StoredShape(
        analysis=analysis,
        number=whole[1] if analysis in tuple(AnalysisType) and len(whole) > 1 else 0,
        frequency=frequency,
        mass=mass,
        viscous=viscous,
        hysteretic=hysteretic,
        pole=complex(*real[:2]) if is_complex and n_real > 1 else 0j,
        nodes=nodes,
        values=values,
        name=row(lines, 0).strip(),
    )


def _line_reals(lines: Sequence[str], count: int) -> list[float]:
    words = " ".join(lines).split()
    if len(words) == count:
        return [parse_real(w) for w in words]
    return list(
        reals("\n".join(lines).encode("latin-1", "replace"), (13,) * 6, count).tolist()
    )


def _values(lines: Sequence[str], width: int, is_complex: bool) -> tuple[Int, Any_]:
    """Node line and value lines, in turn."""
    count = width * (2 if is_complex else 1)
    if not 0 < width <= 1000:
        raise DataError(f"{width} values at a node; it must be 1 or more")
    size = 1 - (-count // 6)  # lines of a node
    if len(lines) % size:
        raise DataError(
            f"{len(lines)} lines of values, not a multiple of {size} a node: the file is cut or "
            "damaged"
        )
    numbers = [integers([line]) for line in lines[::size]]
    for line, found in zip(lines[::size], numbers, strict=True):
        if not found.size:
            raise DataError(f"line {line.strip()[:40]!r} must be the number of a node")
    nodes = np.array([found[0] for found in numbers], dtype=np.int64)
    text = "\n".join(x for i, x in enumerate(lines) if i % size).encode(
        "latin-1", "replace"
    )
    values = reals(text, (13,) * 6, nodes.size * count).reshape(nodes.size, count)
    return nodes, (values[:, ::2] + 1j * values[:, 1::2] if is_complex else values)


def read_shape2414(block: DataSet) -> StoredShape | None:
    """Data set 2414 at nodes; None where it is at elements or points."""
    lines = block.lines()
    if not _NODE.match(row(lines, 0)):
        raise DataError(
            f"data set 2414: {row(lines, 0).strip()[:40]!r} must be its label"
        )
    location = integers([row(lines, 2)])
    if location.size and location[0] != AT_NODES:
        return None
    head = integers([row(lines, 8)])
    if head.size < 6:
        raise DataError(f"data set 2414: record 9 has {head.size} of 6 integers")
    _, analysis, _, _, kind, width = head[:6].tolist()
    specific = integers([row(lines, 9)]).tolist()
    first = _line_reals([row(lines, 11)], 6)
    second = _line_reals([row(lines, 12)], 6)
    nodes, values = _values(lines[13:], width, kind in (5, 6))
    return StoredShape(
        analysis=analysis,
        number=specific[5] if len(specific) > 5 else 0,
        frequency=first[1],
        mass=first[3],
        viscous=first[4],
        hysteretic=first[5],
        pole=complex(second[0], second[1]) if analysis == AnalysisType.COMPLEX else 0j,
        nodes=nodes,
        values=values,
        name=row(lines, 1).strip(),
    )


def read_shapes(path: str | Path) -> tuple[StoredShape, ...]:
    """All shapes at nodes (55, 2414) of a universal file, as stored.

    Raises
    ------
    DataError
        If the file is not a universal file, holds no shapes, or one is damaged.
    """
    with about(path):
        blocks = scan(path)
        shapes = []
        for block in blocks:
            if block.kind == 55:
                shapes.append(read_shape55(block))
            elif block.kind == 2414 and (shape := read_shape2414(block)) is not None:
                shapes.append(shape)
        if not shapes:
            held = sets_held(b.kind for b in blocks)
            raise DataError(
                f"{path}: no mode shapes (data set 55 or 2414 with values at nodes); {held}"
            )
        return tuple(shapes)


def read_mode_sets(path: str | Path) -> ModeSet:
    """Modes of a universal file; rows are `node+direction` of every node of the first mode.

    Raises
    ------
    DataError
        If there are no modes or they are given at different nodes.
    """
    sets = [s for s in read_shapes(path) if s.analysis in tuple(AnalysisType)]
    if not sets:
        raise DataError(
            f"{path}: no normal or complex modes (analysis type 2 or 3) in the file"
        )
    first = sets[0]
    for s in sets:
        if (
            not np.array_equal(s.nodes, first.nodes)
            or s.values.shape != first.values.shape
        ):
            raise DataError(
                f"{path}: mode {s.number} is given at other nodes than the first one"
            )
    width = first.values.shape[1]
    if width > 6:
        raise DataError(f"{path}: {width} values at a node; modes have 1 to 6")
    shapes = np.stack([s.values.ravel() for s in sets], axis=1)
    labels = tuple(label(int(p), k + 1) for p in first.nodes for k in range(width))
    frequency = np.array([s.frequency for s in sets])
    # an absent or zero damping is unknown
    damping = np.array([s.viscous or s.hysteretic / 2 or np.nan for s in sets])
    for k, s in enumerate(sets):
        if s.analysis == AnalysisType.COMPLEX:
            frequency[k] = abs(s.pole) / (2 * np.pi)
            damping[k] = -s.pole.real / abs(s.pole) if s.pole else np.nan
    order = np.argsort(frequency, kind="stable")
    return ModeSet(
        frequencies=frequency[order],
        damping=damping[order],
        shapes=shapes[:, order],
        labels=labels,
        norm=Norm.MASS if all(s.mass == 1 for s in sets) else Norm.UNSCALED,
        source=str(path),
    )


def write_mode_sets(
    path: str | Path, modes: ModeSet, geometry: TestModel | None = None
) -> None:
    """Write the modes as data sets 55, three translations a node; directions without a channel are
    0.

    Behind the points and lines of a `geometry`, where one is given.

    Raises
    ------
    DataError
        If a row is not a translation of a point such as `101+Z`.
    """
    dofs = (
        modes.labels if isinstance(modes.labels, DofSet) else DofSet.parse(modes.labels)
    )
    if ((np.abs(dofs.direction) > 3) | (dofs.direction == 0)).any():
        raise DataError("only translations such as 101+Z can be written to data set 55")
    nodes, row = np.unique(dofs.node, return_inverse=True)
    full = np.zeros((nodes.size, 3, len(modes)), dtype=modes.shapes.dtype)
    full[row, np.abs(dofs.direction) - 1] = (
        modes.shapes * np.sign(dofs.direction)[:, None]
    )
    first = test_model_sets(path, geometry) if geometry is not None else []
    shapes = (_set55(modes, k, nodes, full[:, :, k]) for k in range(len(modes)))
    with atomic_write(path) as part:
        write_sets(part, chain(first, shapes))


def _set55(modes: ModeSet, k: int, nodes: Any_, shape: Any_) -> dict[str, Any]:
    f = float(modes.frequencies[k])
    zeta = float(np.nan_to_num(modes.damping[k]))
    is_complex = np.iscomplexobj(shape)
    omega = 2 * np.pi * f
    common = {
        "type": 55,
        "id1": "ringtrue",
        "model_type": 1,
        "analysis_type": AnalysisType.COMPLEX if is_complex else AnalysisType.NORMAL,
        "data_ch": 2,
        "spec_data_type": 8,
        "data_type": 5 if is_complex else 2,
        "n_data_per_node": 3,
        "load_case": 1,
        "mode_n": k + 1,
        "node_nums": nodes,
        "r1": shape[:, 0],
        "r2": shape[:, 1],
        "r3": shape[:, 2],
    }
    if is_complex:
        return common | {
            "eig": complex(-zeta * omega, omega * np.sqrt(1 - zeta**2)),
            "modal_a": 0j,
            "modal_b": 0j,
        }
    mass = 1.0 if modes.norm is Norm.MASS else 0.0
    return common | {
        "freq": f,
        "modal_m": mass,
        "modal_damp_vis": zeta,
        "modal_damp_his": 0.0,
    }
