"""CELAS1 and CELAS2: a spring between two components, in the displacement frames of the nodes."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.mesh import Matrices, Mesh, lookup


def _end(m: Mesh, card: str, at: Int, end: int) -> tuple[Int, Float]:
    """Three full DOFs (e, 3) of an end, -1 where grounded, and the direction of the component in them."""
    t = m.model[card]
    ids, component = t[f"G{end}"][at], t[f"C{end}"][at]
    dofs, direction = np.full((at.size, 3), -1), np.zeros((at.size, 3))
    used = ids > 0
    dof = m.dof(ids[used], component[used], t, at[used])
    node = dof < 6 * len(m.xyz)
    first = np.where(node, dof - dof % 3, dof)
    spread = np.where(node[:, None], first[:, None] + np.arange(3), -1)
    spread[:, 0] = first
    way = np.tile([1.0, 0.0, 0.0], (dof.size, 1))
    way[node] = m.cd[dof[node] // 6, dof[node] % 3]
    dofs[used], direction[used] = spread, way
    return dofs, direction


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CELAS1 or CELAS2."""
    t = m.model[card]
    k, loss = t["K"][at] if card == "CELAS2" else None, t["GE"][at] if card == "CELAS2" else None
    if card == "CELAS1":
        row = lookup(m.model, "PELAS", t["PID"][at], t, at)
        k, loss = m.model["PELAS"]["K"][row], m.model["PELAS"]["GE"][row]
    (d1, n1), (d2, n2) = _end(m, card, at, 1), _end(m, card, at, 2)
    g = np.concatenate([n1, -n2], axis=1)
    K: Any_ = np.asarray(k)[:, None, None] * g[:, :, None] * g[:, None, :]
    none = np.empty((0, 6, 6))
    return Matrices(np.concatenate([d1, d2], axis=1), K, np.zeros((at.size, 6)), np.asarray(loss), none)
