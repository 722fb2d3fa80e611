"""CBUSH1D: a spring and dashpot along one axis; CGAP: the springs of a gap as a linear solution
takes them.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.mesh import Matrices, Mesh, error, lookup
from ringtrue.fem.place import frame, node_dofs

OPEN = 1e-14  # KB over KA where KB is blank or 0
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


def _ends(m: Mesh, card: str, at: Int) -> tuple[Int, Float, Bool]:
    """Nodes (e, 2), the axis (e, 3) along T1 of CID, else from GA to GB, and which have a blank
    GB.
    """
    t = m.model[card]
    ga, gb, cid = t["GA"][at], t["GB"][at], t["CID"][at]
    if (ga == 0).any():
        raise error(m.model, t, int(at[ga == 0][0]), "GA is blank; a grounded element has GB blank")
    grounded = gb == 0
    nodes = np.stack([m.nodes(ga, t, at), m.nodes(np.where(grounded, ga, gb), t, at)], axis=1)
    x = m.xyz[nodes]
    d = x[:, 1] - x[:, 0]
    L = np.linalg.norm(d, axis=1)
    lost = (cid < 0) & (L == 0)
    if lost.any():
        raise error(
            m.model,
            t,
            int(at[lost][0]),
            "its ends are at one place, or GB is blank; give CID, whose T1 it takes",
        )
    along = d / np.where(L == 0, 1.0, L)[:, None]
    return (
        nodes,
        np.where((cid >= 0)[:, None], frame(m, np.maximum(cid, 0), x[:, 0])[:, 0], along),
        grounded,
    )


def _pair(block: Any_) -> Any_:
    """Stiffness (e, 6, 6) between the translations of two nodes, by that of the spring (e, 3,
    3).
    """
    return np.asarray(np.einsum("kl,eij->ekilj", _PAIR, block).reshape(-1, 6, 6))


def _dofs(nodes: Int, grounded: Bool) -> Int:
    dofs = node_dofs(nodes, 3)
    dofs[grounded, 3:] = -1
    return dofs


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CBUSH1D: K, C and M of PBUSH1D, half the mass at each end.

    The lines of PBUSH1D behind these are for nonlinear solutions.

    Raises
    ------
    DeckError
        If there is no axis, GA is blank, or the property is absent.
    """
    t = m.model[card]
    nodes, axis, grounded = _ends(m, card, at)
    row = lookup(m.model, "PBUSH1D", t["PID"][at], t, at)
    p = m.model["PBUSH1D"]
    way = np.einsum("ei,ej->eij", axis, axis)
    K, B = (_pair(p[c][row][:, None, None] * way) for c in "KC")
    half = np.repeat(p["M"][row] / 2, 6).reshape(-1, 6)
    return Matrices(_dofs(nodes, grounded), K, half, np.zeros(at.size), B)


def build_gap(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CGAP: closed (U0 <= 0) KA along and KT across, open KB
    along.

    A blank KB is 10⁻¹⁴ KA, a blank KT is MU1 KA (MSC Nastran Quick Reference Guide, PGAP).

    Raises
    ------
    DeckError
        If there is no axis, a node is blank, or the property is absent.
    """
    t = m.model[card]
    nodes, axis, grounded = _ends(m, card, at)
    if grounded.any():
        raise error(m.model, t, int(at[grounded][0]), "GB is blank; a gap has two nodes")
    row = lookup(m.model, "PGAP", t["PID"][at], t, at)
    p = m.model["PGAP"]
    KA, KB, KT, mu = (p[c][row] for c in ("KA", "KB", "KT", "MU1"))
    KB = np.where(np.isnan(KB) | (KB == 0), OPEN * KA, KB)
    KT = np.where(np.isnan(KT), mu * KA, KT)
    closed = np.real(p["U0"][row]) <= 0
    along, across = np.where(closed, KA, KB), np.where(closed, KT, 0.0)
    way = np.einsum("ei,ej->eij", axis, axis)
    K = _pair(along[:, None, None] * way + across[:, None, None] * (np.eye(3) - way))
    return Matrices(
        _dofs(nodes, grounded), K, np.zeros((at.size, 6)), np.zeros(at.size), np.empty((0, 6, 6))
    )
