"""Geometry of universal files: nodes (15, 2411), their frames (18, 2420), trace lines (82) and
elements (2412).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import refuse_large, sets_held
from ringtrue.io.foreign.door import door
from ringtrue.io.uff.datasets import DataSet, integers, numbers, reals, row, scan
from ringtrue.io.uff.function58 import FunctionType, read_function
from ringtrue.io.uff.functions import label, read_units

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
            raise DataError(f"{path}: no nodes (data set 15 or 2411), so no geometry; {held}")
        scale = next((1 / read_units(b).length for b in blocks if b.kind == 164), 1.0)
        frames = dict(pair for b in blocks if b.kind in (18, 2420) for pair in _frames(b))
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
            n, definition, displacement, _, *place = numbers(line, (10,) * 4 + (13,) * 3)
            yield int(n), _Node(int(definition), int(displacement), np.array(place))
        return
    for at in range(0, len(lines), 2):
        head = integers([lines[at]]).tolist()
        if len(head) < 3:
            raise DataError(f"data set 2411: {lines[at].strip()[:40]!r} must be a node")
        xyz = reals(row(lines, at + 1).encode("latin-1", "replace"), (25,) * 3, 3)
        yield head[0], _Node(0, head[2], xyz)  # coordinates of 2411 are those of the part


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
            raise DataError(f"data set 18: the three points of frame {number} are on one line")
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


def _axis(node: _Node, direction: int, frames: Mapping[int, _Frame], number: int) -> Float:
    frame = _frame(node.displacement, frames, f"the motion of point {number}")
    axis = frame.axes[abs(direction) - 1]
    return np.asarray(np.sign(direction) * axis / np.linalg.norm(axis))


def _lines(blocks: Sequence[DataSet], nodes: Mapping[int, _Node]) -> list[tuple[int, int]]:
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
            raise DataError(f"data set 2412: {lines[at].strip()[:40]!r} must be an element")
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


def _ends(blocks: Sequence[DataSet], nodes: Mapping[int, _Node]) -> tuple[list[End], list[End]]:
    """Responses of the functions and references of the FRFs that are translations of the nodes."""
    functions = [read_function(b) for b in blocks if b.kind == 58]
    sides = (
        (f.response for f in functions),
        (f.reference for f in functions if f.kind == FunctionType.FRF),
    )
    responses, references = (
        [e for e in dict.fromkeys(side) if e[0] in nodes and 1 <= abs(e[1]) <= 3] for side in sides
    )
    return responses, references
