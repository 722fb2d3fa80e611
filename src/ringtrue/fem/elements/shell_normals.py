"""Normals at the nodes of flat shells on a curved surface: the mean of the elements around, as
PARAM,SNORM has it.

Between flat elements at an angle a twist turns into a rotation about the normal of the next one,
which only the drilling stiffness holds (Raasch's hook: refinement makes it worse; MacNeal, Wilson,
Harder and Hoff 1998). Elements that share one normal at a node have no such mechanism.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.fem.algebra import unit
from ringtrue.fem.mesh import Mesh
from ringtrue.fem.rows import Rows, union
from ringtrue.model.model import Model

SNORM = 20.0  # degrees
SAME = 1e-10  # a normal so near to the element's own is its own
FLAT = {"CQUAD4": 4, "CQUADR": 4, "CTRIA3": 3, "CTRIAR": 3}  # corners
_SPAN = {4: (0, 2, 1, 3), 3: (0, 1, 0, 2)}  # the normal is ab x cd


def node_normals(m: Mesh, nodes: Int, own: Any_) -> Any_:
    """Normals (e, k, 3) at the nodes (e, k) of elements with normals `own` (e, 3).

    The mean of the unit normals of all flat shells at the node, if each of them is within
    PARAM,SNORM degrees of it (20 unless given; 0 is off); else the element's own.
    """
    out = np.broadcast_to(own[:, None], (*nodes.shape, 3))
    limit = m.model.param("SNORM", SNORM)
    if limit <= 0:
        return out
    total = np.zeros((len(m.xyz), 3), dtype=m.xyz.dtype)
    around = list(_around(m, nodes))
    for corners, n in around:
        for c in corners.T:
            np.add.at(total, c, n)
    used = np.unique(nodes)
    total[used] = unit(total[used])
    sharp = np.zeros(len(m.xyz), dtype=bool)
    for corners, n in around:
        apart = np.einsum("eka,ea->ek", total[corners], n).real < np.cos(np.radians(limit))
        sharp[corners[apart]] = True
    mean = total[nodes]
    keep: Any_ = sharp[nodes]
    if not np.iscomplexobj(mean):  # a complex step is small, but not nothing
        keep = keep | (np.abs(mean - out).max(axis=2) < SAME)
    return np.where(keep[..., None], out, mean)


def _around(m: Mesh, nodes: Int) -> Iterable[tuple[Int, Any_]]:
    """Corner nodes (., k) and unit normals (., 3) of the flat shells that share one of the
    nodes.
    """
    mine = np.unique(m.model["GRID"].ids[np.unique(nodes)])
    for card, k in FLAT.items():
        if card not in m.model:
            continue
        ids = _corners(m.model, card, k)
        near = ids[np.isin(ids, mine).any(axis=1)]
        corners = m.model["GRID"].find(near)
        corners = corners[
            (corners >= 0).all(axis=1)
        ]  # a node that is absent is told by the element's own builder
        x, (a, b, c, d) = m.xyz[corners], _SPAN[k]
        n = np.cross(x[:, b] - x[:, a], x[:, d] - x[:, c])
        there = (n != 0).any(axis=1)
        yield corners[there], unit(n[there])


def _corners(model: Model, card: str, k: int) -> Int:
    return np.asarray(model[card].stack(*(f"G{i + 1}" for i in range(k))))


def with_neighbours(model: Model, rows: Rows) -> Rows:
    """Rows of element cards, and the quadrilaterals whose node normals depend on the flat shells
    among them.
    """
    if model.param("SNORM", SNORM) <= 0 or not any(c in rows for c in FLAT):
        return rows
    touched = np.unique(
        np.concatenate(
            [_corners(model, c, FLAT[c])[at].ravel() for c, at in rows.items() if c in FLAT]
        )
    )
    found = [rows]
    for card in ("CQUAD4", "CQUADR"):
        if card in model:
            also = np.flatnonzero(np.isin(_corners(model, card, 4), touched).any(axis=1))
            found.append({card: also})
    return union(found)
