"""CELAS1-4 and CMASS1-4: a spring or mass between two components, in the CD frames, or two scalar
points.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.algebra import scaled
from ringtrue.fem.mesh import Matrices, Mesh, lookup
from ringtrue.model.model import Table


def spread(m: Mesh, ids: Int, component: Int, t: Table, at: Int) -> tuple[Int, Float]:
    """Three full DOFs (k, 3) of components of nodes or scalar points (k,), -1 for none, and their
    direction in them.
    """
    dof = m.dof(ids, component, t, at)
    node = dof < 6 * len(m.xyz)
    first = np.where(node, dof - dof % 3, dof)
    dofs = np.where(node[:, None], first[:, None] + np.arange(3), -1)
    dofs[:, 0] = first
    way = np.tile([1.0, 0.0, 0.0], (dof.size, 1))
    way[node] = m.cd[dof[node] // 6, dof[node] % 3]
    return dofs, way


def _end(m: Mesh, card: str, at: Int, end: int) -> tuple[Int, Float]:
    """Three full DOFs (e, 3) of an end, -1 where grounded, and the direction of the component in
    them.
    """
    t = m.model[card]
    scalar = f"S{end}" in t.columns
    ids = t[f"S{end}" if scalar else f"G{end}"][at]
    component = np.zeros_like(ids) if scalar else t[f"C{end}"][at]
    dofs, direction = np.full((at.size, 3), -1), np.zeros((at.size, 3))
    used = ids > 0
    dofs[used], direction[used] = spread(m, ids[used], component[used], t, at[used])
    return dofs, direction


def along(m: Mesh, card: str, at: Int) -> tuple[Int, Float]:
    """DOFs (e, 6) and the outer product (e, 6, 6) of the relative motion of the ends."""
    (d1, n1), (d2, n2) = _end(m, card, at, 1), _end(m, card, at, 2)
    g = np.concatenate([n1, -n2], axis=1)
    return np.concatenate([d1, d2], axis=1), g[:, :, None] * g[:, None, :]


def value(m: Mesh, card: str, at: Int, name: str, field: str) -> Any_:
    """A field of the element itself, or of its property `name`; 0 where neither has it."""
    t = m.model[card]
    if "PID" not in t.columns:
        return t[field][at] if field in t.columns else np.zeros(at.size)
    return m.model[name][field][lookup(m.model, name, t["PID"][at], t, at)]


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CELAS1 to CELAS4."""
    dofs, way = along(m, card, at)
    k, loss = (value(m, card, at, "PELAS", field) for field in ("K", "GE"))
    return Matrices(dofs, scaled(k, way), np.zeros((at.size, 6)), loss, np.empty((0, 6, 6)))


def build_mass(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CMASS1 to CMASS4."""
    dofs, way = along(m, card, at)
    M = scaled(value(m, card, at, "PMASS", "M"), way)
    return Matrices(dofs, np.zeros((at.size, 6, 6)), M, np.zeros(at.size), np.empty((0, 6, 6)))
