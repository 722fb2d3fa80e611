"""What the shell elements share: placing of blocks, drilling, offsets, mass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.algebra import arm, condense, congruent, nodal, rotation, scaled
from ringtrue.fem.elements.shell_section import Section
from ringtrue.fem.mesh import Matrices, Mesh
from ringtrue.fem.place import node_dofs

SPAN = 2048
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # slopes (βx, βy) = (θy, -θx)


def in_spans(e: int, kernel: Callable[[slice], Any_]) -> Any_:
    """What `kernel` gives for spans of e elements, one after the other: bounds the memory of the
    strain rows.
    """
    return np.concatenate([kernel(slice(i, i + SPAN)) for i in range(0, max(e, 1), SPAN)])


def condensed(K: Any_, inner: int) -> Any_:
    """Condense the last `inner` parameters out; elements in which they have no stiffness are left
    as they are.
    """
    n = K.shape[1] - inner
    return condense(K, slice(n), slice(n, None))


def place(K: Any_, rows: list[int], block: Any_, columns: list[int] | None = None) -> None:
    """Add a block (e, k r, k c) of DOFs `rows` (r) and `columns` (c, or as the rows) a node into K
    (e, k, 6, k, 6).
    """
    k, columns = K.shape[1], columns or rows
    block = block.reshape(-1, k, len(rows), k, len(columns))
    for i, a in enumerate(rows):
        for j, b in enumerate(columns):
            K[:, :, a, :, b] += block[:, :, i, :, j]


def of_rotations(slopes: Any_) -> Any_:
    """Columns over slopes (..., k 2) to columns over (θx, θy), the same shape."""
    parts = slopes.reshape(*slopes.shape[:-1], -1, 2) @ TURN
    return np.asarray(parts.reshape(slopes.shape))


def drilling(N: Float, gradients: Any_, w: Any_) -> Any_:
    """∫ (θz - (∂v/∂x - ∂u/∂y)/2)² over (u, v, θz) of each node: (e, 3k, 3k); N (gp, k), w (e,
    gp).
    """
    e, g, k = gradients.shape[:3]
    row = np.empty((e, g, k, 3), dtype=gradients.dtype)
    row[..., 0], row[..., 1] = gradients[..., 1] / 2, -gradients[..., 0] / 2
    row[..., 2] = N
    flat = row.reshape(e, g, 3 * k)
    return np.asarray((flat * w[:, :, None]).swapaxes(1, 2) @ flat)


def to_nodes(K: Any_, section: Section, axes: Any_, heights: Any_) -> Any_:
    """Local stiffness (e, k, 6, k, 6) of corners to that of the nodes in basic, (e, 6k, 6k).

    `heights` (e, k) are the nodes above the mean plane: each is joined to its projection by a rigid
    arm along the normal, so that a warped element has no energy in a rigid motion.
    """
    e, k = heights.shape
    arms = np.zeros((e, k, 3), dtype=np.result_type(section.offset, heights))
    arms[..., 2] = section.offset[:, None] - heights
    local = nodal(arm(arms) @ rotation(axes, 1)[:, None])
    return congruent(local, K.reshape(e, 6 * k, 6 * k))


def finish(m: Mesh, nodes: Int, K: Any_, section: Section, axes: Any_, mass: Any_) -> Matrices:
    """Matrices of stiffness K (e, 6k, 6k) and nodal masses (e, k) of corners."""
    e, k = nodes.shape
    offset = section.offset[:, None, None] * axes[:, None, 2]
    M = masses(m, np.broadcast_to(offset, (e, k, 3)), mass, np.asarray(_PATTERN[k]))
    return Matrices(node_dofs(nodes), K, M, section.loss, np.empty((0, 6 * k, 6 * k)))


def masses(m: Mesh, arms: Any_, mass: Any_, pattern: Any_) -> Any_:
    """Lumped (e, 6k) or full (e, 6k, 6k) mass of nodal masses (e, k) at arms (e, k, 3) from the
    nodes.

    PARAM,COUPMASS takes `pattern` (k, k) or (e, k, k), which sums to one, times the whole mass.
    """
    e, k = mass.shape
    ends = np.array([1.0, 1, 1, 0, 0, 0])
    lumped = mass[..., None] * ends
    coupled = m.model.param("COUPMASS", -1) > 0
    if not coupled and not np.any(arms):
        return np.asarray(lumped.reshape(e, 6 * k))
    M = lumped.reshape(e, -1)[:, :, None] * np.eye(6 * k)
    if coupled:
        full = np.einsum("...ij,ab->...iajb", pattern, np.diag(ends)).reshape(
            *pattern.shape[:-2], 6 * k, 6 * k
        )
        M = scaled(mass.sum(1), np.broadcast_to(full, (e, 6 * k, 6 * k)))
    return congruent(nodal(arm(arms)), M) if np.any(arms) else M


_PATTERN = {  # consistent mass of a triangle and a parallelogram
    3: (1 + np.eye(3)) / 12,
    4: np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 36,
}
