"""Springs, dashpots and masses: CELAS1-4, CMASS1-4, CDAMP1-4, CVISC, CONM1, CONM2, CBUSH, CBUSH1D,
CGAP.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements import rod
from ringtrue.fem.mesh import (
    ElementMatrices,
    Mesh,
    any_triad,
    arm,
    congruent,
    frame,
    lookup,
    node_dofs,
    orientation,
    rotation,
    scaled,
    scatter,
    segment,
    triad,
)
from ringtrue.model.model import Table, refuse_rows


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
    dofs = np.full((at.size, 3), -1)
    direction = np.zeros((at.size, 3))
    used = ids > 0
    dofs[used], direction[used] = spread(m, ids[used], component[used], t=t, at=at[used])
    return dofs, direction


def along(m: Mesh, card: str, at: Int) -> tuple[Int, Float]:
    """DOFs (e, 6) and the outer product (e, 6, 6) of the relative motion of the ends."""
    (d1, n1), (d2, n2) = _end(m, card, at, 1), _end(m, card, at, 2)
    g = np.concatenate([n1, -n2], axis=1)
    return np.concatenate([d1, d2], axis=1), g[:, :, None] * g[:, None, :]


def scalar_value(m: Mesh, card: str, at: Int, name: str, field: str) -> Any_:
    """A field of the element itself, or of its property `name`; 0 where neither has it."""
    t = m.model[card]
    if "PID" not in t.columns:
        return t[field][at] if field in t.columns else np.zeros(at.size)
    return m.model[name][field][lookup(m.model, name, t["PID"][at], table=t, at=at)]


def build_spring(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CELAS1 to CELAS4."""
    dofs, way = along(m, card, at)
    k, loss = (scalar_value(m, card, at, name="PELAS", field=field) for field in ("K", "GE"))
    return ElementMatrices(
        dofs=dofs,
        stiffness=scaled(k, way),
        mass=np.zeros((at.size, 6)),
        loss=loss,
    )


def build_scalar_mass(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CMASS1 to CMASS4."""
    dofs, way = along(m, card, at)
    M = scaled(scalar_value(m, card, at, name="PMASS", field="M"), way)
    return ElementMatrices(
        dofs=dofs,
        stiffness=np.zeros((at.size, 6, 6)),
        mass=M,
    )


def _only_viscous(dofs: Int, B: Any_) -> ElementMatrices:
    e, d = dofs.shape
    return ElementMatrices(
        dofs=dofs, stiffness=np.zeros((e, d, d)), mass=np.zeros((e, d)), viscous=B
    )


def build_damper(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CDAMP1 to CDAMP4."""
    dofs, way = along(m, card, at)
    return _only_viscous(dofs, scaled(scalar_value(m, card, at, name="PDAMP", field="B"), way))


def build_line_damper(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CVISC: CE along the line, CR about it.

    Raises
    ------
    DeckError
        If a node or the property is absent or the ends are at one place.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2")[at], t, at)
    x = m.xyz[nodes]
    short = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == 0
    refuse_rows(m.model, t, at[short], "its two ends are at one place")
    row = lookup(m.model, "PVISC", t["PID"][at], table=t, at=at)
    p = m.model["PVISC"]
    L = segment(x)[0]
    return _only_viscous(node_dofs(nodes), rod.kernel(x, p["CE"][row] * L, p["CR"][row] * L))


def build_point_mass(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CONM2: mass at X1-X3 in CID (-1: a place in basic), inertia
    about it.
    """
    t = m.model[card]
    nodes = m.nodes(t["G"][at], t, at)
    cid = t["CID"][at]
    x = t.stack("X1", "X2", "X3")[at]
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
    return ElementMatrices(
        dofs=node_dofs(nodes[:, None]),
        stiffness=zero,
        mass=congruent(arm(r), body),
    )


def build_mass_matrix(m: Mesh, card: str, at: Int) -> ElementMatrices:
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
    return ElementMatrices(
        dofs=node_dofs(nodes[:, None]),
        stiffness=zero,
        mass=M,
    )


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
        local[given] = triad(m, axis[given], v[given], table=t, at=at[free][given])
        R = R.copy()
        R[free] = local
    return R


def _spring_point(m: Mesh, card: str, at: Int, x: Float) -> Float:
    """Where the spring stands, (e, 3) in basic: S of the way from A to B, or S1-S3 from A in
    OCID.
    """
    t = m.model[card]
    s = t["S"][at][:, None]
    ocid = t["OCID"][at]
    own = np.einsum(
        "ei,eij->ej", t.stack("S1", "S2", "S3")[at], frame(m, np.maximum(ocid, 0), x[:, 0])
    )
    return np.where(ocid[:, None] >= 0, x[:, 0] + own, (1 - s) * x[:, 0] + s * x[:, 1])


def build_bush(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CBUSH.

    Raises
    ------
    DeckError
        If GA is blank or the property is absent.
    """
    t = m.model[card]
    ga = t["GA"][at]
    gb = t["GB"][at]
    refuse_rows(m.model, t, at[ga == 0], "GA is blank; a grounded bush has GB blank")
    a = m.nodes(ga, t, at)
    grounded = gb == 0
    b = m.nodes(np.where(grounded, ga, gb), t, at)
    x = m.xyz[np.stack([a, b], axis=1)]
    row = lookup(m.model, "PBUSH", t["PID"][at], table=t, at=at)
    p = m.model["PBUSH"]
    stiffness = p.stack(*(f"K{i}" for i in range(1, 7)))[row]
    loss = losses(p)[row]
    motion = _relative(
        _axes(m, card, at, a=a, x=x, grounded=grounded),
        _spring_point(m, card, at, x)[:, None] - x,
        grounded,
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
    return ElementMatrices(
        dofs=dofs,
        stiffness=K,
        mass=p["M"][row][:, None] * ends,
        loss=loss[:, 0],
        viscous=B,
        lossy=None if same else H,
    )


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


OPEN = 1e-14  # KB over KA where KB is blank or 0
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


def _ends(m: Mesh, card: str, at: Int) -> tuple[Int, Float, Bool]:
    """Nodes (e, 2), the axis (e, 3) along T1 of CID, else from GA to GB, and which have a blank
    GB.
    """
    t = m.model[card]
    ga = t["GA"][at]
    gb = t["GB"][at]
    cid = t["CID"][at]
    refuse_rows(m.model, t, at[ga == 0], "GA is blank; a grounded element has GB blank")
    grounded = gb == 0
    nodes = np.stack([m.nodes(ga, t, at), m.nodes(np.where(grounded, ga, gb), t, at)], axis=1)
    x = m.xyz[nodes]
    d = x[:, 1] - x[:, 0]
    L = np.linalg.norm(d, axis=1)
    lost = (cid < 0) & (L == 0)
    refuse_rows(
        m.model,
        t,
        at[lost],
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


def build_bush1d(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CBUSH1D: K, C and M of PBUSH1D, half the mass at each end.

    The lines of PBUSH1D behind these are for nonlinear solutions.

    Raises
    ------
    DeckError
        If there is no axis, GA is blank, or the property is absent.
    """
    t = m.model[card]
    nodes, axis, grounded = _ends(m, card, at)
    row = lookup(m.model, "PBUSH1D", t["PID"][at], table=t, at=at)
    p = m.model["PBUSH1D"]
    way = np.einsum("ei,ej->eij", axis, axis)
    K, B = (_pair(p[c][row][:, None, None] * way) for c in "KC")
    half = np.repeat(p["M"][row] / 2, 6).reshape(-1, 6)
    return ElementMatrices(dofs=_dofs(nodes, grounded), stiffness=K, mass=half, viscous=B)


def build_gap(m: Mesh, card: str, at: Int) -> ElementMatrices:
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
    refuse_rows(m.model, t, at[grounded], "GB is blank; a gap has two nodes")
    row = lookup(m.model, "PGAP", t["PID"][at], table=t, at=at)
    p = m.model["PGAP"]
    KA, KB, KT, mu = (p[c][row] for c in ("KA", "KB", "KT", "MU1"))
    KB = np.where(np.isnan(KB) | (KB == 0), OPEN * KA, KB)
    KT = np.where(np.isnan(KT), mu * KA, KT)
    closed = np.real(p["U0"][row]) <= 0
    along = np.where(closed, KA, KB)
    across = np.where(closed, KT, 0.0)
    way = np.einsum("ei,ej->eij", axis, axis)
    K = _pair(along[:, None, None] * way + across[:, None, None] * (np.eye(3) - way))
    return ElementMatrices(
        dofs=_dofs(nodes, grounded),
        stiffness=K,
        mass=np.zeros((at.size, 6)),
    )
