"""Data set 55: mode shapes at nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from ringtrue.core.arrays import Any_
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.uff.functions import label, read_sets

_NORMAL, _COMPLEX = 2, 3  # analysis types


def read_mode_sets(path: str | Path) -> ModeSet:
    """Modes of a universal file; rows are `node+direction` of every node of the first mode.

    Raises
    ------
    DataError
        If there are no modes or they are given at different nodes.
    """
    sets = [s for s in read_sets(path, 55) if s["analysis_type"] in (_NORMAL, _COMPLEX)]
    if not sets:
        raise DataError(f"{path}: no normal or complex modes (55, analysis type 2 or 3) in the file")
    nodes = np.asarray(sets[0]["node_nums"], dtype=np.int64)
    for s in sets:
        if not np.array_equal(np.asarray(s["node_nums"], dtype=np.int64), nodes):
            raise DataError(f"{path}: mode {s.get('mode_n')} is given at other nodes than the first one")
    n = int(sets[0]["n_data_per_node"])
    shapes = np.stack([np.stack([s[f"r{k + 1}"] for k in range(n)], axis=1).ravel() for s in sets], axis=1)
    labels = tuple(label(int(p), k + 1) for p in nodes for k in range(n))
    frequency, damping = np.array([_pole(s) for s in sets]).T
    order = np.argsort(frequency, kind="stable")
    norm = Norm.MASS if all(float(np.real(s.get("modal_m", 0))) == 1 for s in sets) else Norm.UNSCALED
    return ModeSet(frequency[order], damping[order], shapes[:, order], labels, norm, str(path))


def _pole(s: dict[str, Any]) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio; an absent or zero damping is unknown."""
    if s["analysis_type"] == _COMPLEX:
        pole = complex(s["eig"])
        return abs(pole) / (2 * np.pi), -pole.real / abs(pole)
    viscous, hysteretic = float(s.get("modal_damp_vis", 0)), float(s.get("modal_damp_his", 0))
    return float(s["freq"]), viscous or hysteretic / 2 or float("nan")


def write_mode_sets(path: str | Path, modes: ModeSet) -> None:
    """Write the modes as data sets 55, three translations a node; directions without a channel are 0.

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
        file = pyuff.UFF(str(part))
        for k in range(len(modes)):
            file.write_sets(_set55(modes, k, nodes, full[:, :, k]), "add")


def _set55(modes: ModeSet, k: int, nodes: Any_, shape: Any_) -> dict[str, Any]:
    f, zeta = float(modes.frequencies[k]), float(np.nan_to_num(modes.damping[k]))
    is_complex = np.iscomplexobj(shape)
    omega = 2 * np.pi * f
    common = {
        "type": 55,
        "id1": "ringtrue",
        "model_type": 1,
        "analysis_type": _COMPLEX if is_complex else _NORMAL,
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
