"""CBUSH: six springs and dashpots in a frame, at a point between the ends, on rigid arms."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.algebra import arm, congruent, rotation
from ringtrue.fem.mesh import Matrices, Mesh, error, lookup
from ringtrue.fem.place import any_triad, frame, node_dofs, orientation, segment, triad
from ringtrue.model.model import Table


def _axes(m: Mesh, card: str, at: Int, a: Int, x: Float, grounded: Any_) -> Float:
    """Element frames (e, 3, 3): CID, or x along the ends; basic where they coincide."""
    t = m.model[card]
    cid = t["CID"][at]
    R = frame(m, np.maximum(cid, 0), x[:, 0])
    free = (cid < 0) & ~grounded & (np.linalg.norm(x[:, 1] - x[:, 0], axis=1) > 0)
    if free.any():
        axis = segment(x[free])[1]
        v = orientation(m, t, at[free], a[free])
        given = (v != 0).any(axis=1)
        local = any_triad(axis)
        local[given] = triad(m, axis[given], v[given], t, at[free][given])
        R = R.copy()
        R[free] = local
    return R


def _spring_point(m: Mesh, card: str, at: Int, x: Float) -> Float:
    """Where the spring stands, (e, 3) in basic: S of the way from A to B, or S1-S3 from A in
    OCID.
    """
    t = m.model[card]
    s, ocid = t["S"][at][:, None], t["OCID"][at]
    own = np.einsum(
        "ei,eij->ej", t.stack("S1", "S2", "S3")[at], frame(m, np.maximum(ocid, 0), x[:, 0])
    )
    return np.where(ocid[:, None] >= 0, x[:, 0] + own, (1 - s) * x[:, 0] + s * x[:, 1])


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CBUSH.

    Raises
    ------
    DeckError
        If GA is blank or the property is absent.
    """
    t = m.model[card]
    ga, gb = t["GA"][at], t["GB"][at]
    if (ga == 0).any():
        raise error(m.model, t, int(at[ga == 0][0]), "GA is blank; a grounded bush has GB blank")
    a = m.nodes(ga, t, at)
    grounded = gb == 0
    b = m.nodes(np.where(grounded, ga, gb), t, at)
    x = m.xyz[np.stack([a, b], axis=1)]
    row = lookup(m.model, "PBUSH", t["PID"][at], t, at)
    p = m.model["PBUSH"]
    stiffness, loss = p.stack(*(f"K{i}" for i in range(1, 7)))[row], losses(p)[row]
    motion = _relative(
        _axes(m, card, at, a, x, grounded), _spring_point(m, card, at, x)[:, None] - x, grounded
    )
    K, H, B = (
        congruent(motion, values[:, :, None] * np.eye(6))
        for values in (stiffness, loss * stiffness, p.stack(*(f"B{i}" for i in range(1, 7)))[row])
    )
    ends = np.tile([0.5, 0.5, 0.5, 0.0, 0.0, 0.0], 2) * np.repeat(
        np.stack([~grounded | True, ~grounded], 1), 6, axis=1
    )
    dofs = node_dofs(np.stack([a, b], axis=1))
    dofs[grounded, 6:] = -1
    same = (loss == loss[:, :1]).all()
    return Matrices(dofs, K, p["M"][row][:, None] * ends, loss[:, 0], B, None if same else H)


def losses(p: Table) -> Any_:
    """Loss factors (n, 6) of rows of PBUSH: GE1 for all directions where GE2 to GE6 are blank, else
    blanks are 0.
    """
    first = p["GE"]
    if "GE2" not in p.columns:
        return np.repeat(first[:, None], 6, axis=1)
    rest = p.stack(*(f"GE{i}" for i in range(2, 7)))
    alone = np.isnan(rest).all(axis=1)[:, None]
    return np.concatenate(
        [first[:, None], np.where(alone, first[:, None], np.nan_to_num(rest))], axis=1
    )


def _relative(R: Float, arms: Float, grounded: Any_) -> Float:
    """Relative motion (6) of the ends of the springs by that of the nodes, (e, 6, 12)."""
    ends = rotation(R, 1)[:, None] @ arm(arms)
    ends[grounded, 1] = 0.0
    return np.concatenate([-ends[:, 0], ends[:, 1]], axis=2)
