"""CONM1: a 6 x 6 mass in a frame; CONM2: a rigid body on a rigid arm."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.fem.algebra import arm, congruent, rotation, scatter
from ringtrue.fem.mesh import Matrices, Mesh
from ringtrue.fem.place import frame, node_dofs


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CONM2: mass at X1-X3 in CID (-1: a place in basic), inertia
    about it.
    """
    t = m.model[card]
    nodes = m.nodes(t["G"][at], t, at)
    cid, x = t["CID"][at], t.stack("X1", "X2", "X3")[at]
    R = frame(m, np.maximum(cid, 0), m.xyz[nodes])
    r = np.where(cid[:, None] < 0, x - m.xyz[nodes], np.einsum("ei,eij->ej", x, R))
    I11, I21, I22, I31, I32, I33 = (t[f"I{i}"][at] for i in (11, 21, 22, 31, 32, 33))
    rows = [
        [I11, -I21, -I31],
        [-I21, I22, -I32],
        [-I31, -I32, I33],
    ]  # the card holds ∫xy dm, the tensor -∫xy dm
    inertia = congruent(R, np.stack([np.stack(row, axis=1) for row in rows], axis=1))
    body = scatter(
        at.size, 6, ([0, 1, 2], t["M"][at][:, None, None] * np.eye(3)), ([3, 4, 5], inertia)
    )
    zero = np.zeros((at.size, 6, 6))
    return Matrices(
        node_dofs(nodes[:, None]),
        zero,
        congruent(arm(r), body),
        np.zeros(at.size),
        np.empty((0, 6, 6)),
    )


def build_matrix(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CONM1: the mass matrix of its node in CID."""
    t = m.model[card]
    nodes = m.nodes(t["G"][at], t, at)
    lower = [(i, j) for i in range(6) for j in range(i + 1)]
    values = t.stack(*(f"M{i + 1}{j + 1}" for i, j in lower))[at]
    own = np.zeros((at.size, 6, 6), dtype=values.dtype)
    i, j = np.array(lower).T
    own[:, i, j] = own[:, j, i] = values
    M = congruent(rotation(frame(m, t["CID"][at], m.xyz[nodes]), 1), own)
    zero = np.zeros((at.size, 6, 6))
    return Matrices(node_dofs(nodes[:, None]), zero, M, np.zeros(at.size), np.empty((0, 6, 6)))
