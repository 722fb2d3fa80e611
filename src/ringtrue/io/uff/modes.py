"""Mode shapes at nodes: read from data sets 55 or 2414, written as 55."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import DataError, about
from ringtrue.io.atomic import atomic_write
from ringtrue.io.contents import sets_held
from ringtrue.io.foreign.universal import write_sets
from ringtrue.io.uff.functions import label
from ringtrue.io.uff.scan import scan
from ringtrue.io.uff.shapes import COMPLEX, NORMAL, Shape, read_shape55, read_shape2414


def read_shapes(path: str | Path) -> tuple[Shape, ...]:
    """All shapes at nodes (55, 2414) of a universal file, as stored.

    Raises
    ------
    DataError
        If the file is not a universal file, holds no shapes, or one is damaged.
    """
    with about(path):
        blocks = scan(path)
        found = [
            read_shape55(b) if b.kind == 55 else read_shape2414(b)
            for b in blocks
            if b.kind in (55, 2414)
        ]
        shapes = tuple(s for s in found if s is not None)
        if not shapes:
            held = sets_held(b.kind for b in blocks)
            raise DataError(
                f"{path}: no mode shapes (data set 55 or 2414 with values at nodes); {held}"
            )
        return shapes


def read_mode_sets(path: str | Path) -> ModeSet:
    """Modes of a universal file; rows are `node+direction` of every node of the first mode.

    Raises
    ------
    DataError
        If there are no modes or they are given at different nodes.
    """
    sets = [s for s in read_shapes(path) if s.analysis in (NORMAL, COMPLEX)]
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
    frequency, damping = np.array([_pole(s) for s in sets]).T
    order = np.argsort(frequency, kind="stable")
    norm = Norm.MASS if all(s.mass == 1 for s in sets) else Norm.UNSCALED
    return ModeSet(frequency[order], damping[order], shapes[:, order], labels, norm, str(path))


def _pole(s: Shape) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio; an absent or zero damping is unknown."""
    if s.analysis == COMPLEX:
        size = abs(s.pole)
        return size / (2 * np.pi), -s.pole.real / size if size else float("nan")
    return s.frequency, s.viscous or s.hysteretic / 2 or float("nan")


def write_mode_sets(path: str | Path, modes: ModeSet) -> None:
    """Write the modes as data sets 55, three translations a node; directions without a channel are
    0.

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
    with atomic_write(path) as part:
        write_sets(part, (_set55(modes, k, nodes, full[:, :, k]) for k in range(len(modes))))


def _set55(modes: ModeSet, k: int, nodes: Any_, shape: Any_) -> dict[str, Any]:
    f, zeta = float(modes.frequencies[k]), float(np.nan_to_num(modes.damping[k]))
    is_complex = np.iscomplexobj(shape)
    omega = 2 * np.pi * f
    common = {
        "type": 55,
        "id1": "ringtrue",
        "model_type": 1,
        "analysis_type": COMPLEX if is_complex else NORMAL,
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
