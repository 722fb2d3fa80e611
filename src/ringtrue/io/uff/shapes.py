"""Mode shapes of universal files: data sets 55 and 2414."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError, about
from ringtrue.io.files import atomic_write, sets_held
from ringtrue.io.foreign.parsers import write_sets
from ringtrue.io.uff.datasets import DataSet, integers, parse_real, reals, row, scan
from ringtrue.io.uff.functions import label, test_model_sets

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
    return list(reals("\n".join(lines).encode("latin-1", "replace"), (13,) * 6, count).tolist())


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
    text = "\n".join(x for i, x in enumerate(lines) if i % size).encode("latin-1", "replace")
    values = reals(text, (13,) * 6, nodes.size * count).reshape(nodes.size, count)
    return nodes, (values[:, ::2] + 1j * values[:, 1::2] if is_complex else values)


def read_shape2414(block: DataSet) -> StoredShape | None:
    """Data set 2414 at nodes; None where it is at elements or points."""
    lines = block.lines()
    if not _NODE.match(row(lines, 0)):
        raise DataError(f"data set 2414: {row(lines, 0).strip()[:40]!r} must be its label")
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
        raise DataError(f"{path}: no normal or complex modes (analysis type 2 or 3) in the file")
    first = sets[0]
    for s in sets:
        if not np.array_equal(s.nodes, first.nodes) or s.values.shape != first.values.shape:
            raise DataError(f"{path}: mode {s.number} is given at other nodes than the first one")
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


def write_mode_sets(path: str | Path, modes: ModeSet, geometry: TestModel | None = None) -> None:
    """Write the modes as data sets 55, three translations a node; directions without a channel are
    0.

    Behind the points and lines of a `geometry`, where one is given.

    Raises
    ------
    DataError
        If a row is not a translation of a point such as `101+Z`.
    """
    dofs = modes.labels if isinstance(modes.labels, DofSet) else DofSet.parse(modes.labels)
    if ((np.abs(dofs.direction) > 3) | (dofs.direction == 0)).any():
        raise DataError("only translations such as 101+Z can be written to data set 55")
    nodes, row = np.unique(dofs.node, return_inverse=True)
    full = np.zeros((nodes.size, 3, len(modes)), dtype=modes.shapes.dtype)
    full[row, np.abs(dofs.direction) - 1] = modes.shapes * np.sign(dofs.direction)[:, None]
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
    return common | {"freq": f, "modal_m": mass, "modal_damp_vis": zeta, "modal_damp_his": 0.0}
