"""Where elements stand: their DOFs, directions and local axes."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.algebra import unit
from ringtrue.fem.mesh import Mesh, error
from ringtrue.model.frames import axes
from ringtrue.model.model import Table


def node_dofs(nodes: Int, count: int = 6) -> Int:
    """The first `count` full DOFs of nodes (e, k) -> (e, k count)."""
    return np.asarray(
        (6 * nodes[..., None] + np.arange(count)).reshape(len(nodes), count * nodes.shape[1])
    )


def segment(x: Float) -> tuple[Float, Float]:
    """Length (e,) and unit vector (e, 3) from the first to the second of two points (e, 2, 3)."""
    d = x[:, 1] - x[:, 0]
    L = np.linalg.norm(d, axis=1)
    return L, d / L[:, None]


def orientation(m: Mesh, table: Table, at: Int, origin: Int) -> Float:
    """The vector (e, 3) in basic from G0, or from X1-X3 in the CD frame of the node rows `origin`
    (e,).

    An OFFT that begins with B takes X1-X3 in basic.
    """
    v = table.stack("X1", "X2", "X3")[at]
    g0 = table["G0"][at]
    local = np.einsum("ei,eij->ej", v, m.cd[origin])
    if "OFFT" in table.columns:
        basic = np.char.startswith(table["OFFT"][at].astype(str), "B")
        local = np.where(basic[:, None], v, local)
    by_node = g0 > 0
    local[by_node] = m.xyz[m.nodes(g0[by_node], table, at[by_node])] - m.xyz[origin[by_node]]
    return np.asarray(local)


def triad(m: Mesh, axis: Float, v: Float, table: Table, at: Int) -> Float:
    """Local axes (e, 3, 3) as rows: x along `axis`, v in the xy plane.

    Raises
    ------
    DeckError
        If v is along the axis.
    """
    z = np.cross(axis, v)
    flat = np.linalg.norm(z, axis=1) <= 1e-8 * np.maximum(np.linalg.norm(v, axis=1), 1e-300)
    if flat.any():
        i = int(at[np.flatnonzero(flat)[0]])
        raise error(
            m.model, table, i, "the orientation vector is zero or along the element; give another"
        )
    z = unit(z)
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def any_triad(axis: Float) -> Float:
    """Local axes (e, 3, 3) with x along `axis` and some y."""
    v = np.zeros_like(axis)
    v[np.arange(len(axis)), np.abs(axis).argmin(axis=1)] = 1.0
    z = unit(np.cross(axis, v))
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def frame(m: Mesh, cid: Int, at: Float) -> Float:
    """Axes (e, 3, 3) of frames `cid` (e,) at points (e, 3)."""
    return axes(m.model, cid, at)


def components(text: Any_) -> Bool:
    """Component lists such as "1246" (e,) as flags (e, 6)."""
    as_text = text.astype(str)
    return np.stack([np.char.find(as_text, str(c)) >= 0 for c in range(1, 7)], axis=1)
