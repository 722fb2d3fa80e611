"""Springs, dashpots and masses: CELAS1-4, CMASS1-4, CDAMP1-4, CVISC, CONM1, CONM2, CBUSH, CBUSH1D,
CGAP; and what a deck gives as matrices: GENEL, DMIG.

GENEL is stiffness or flexibility between listed components, with the rigid motion that others give
them. With the components u_i of UI and u_d of UD: u_i = Z f_i + S u_d and f_d = −Sᵀ f_i (MSC
Nastran Quick Reference Guide, GENEL), so that K = [I −S]ᵀ Z⁻¹ [I −S]. Where S is not given, six
components of UD hold a rigid body, and S is that body's motion.

DMIG is stiffness, mass and damping, chosen by K2GG, M2GG and B2GG in case control.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.elements import rod
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    Mesh,
    any_triad,
    arm,
    congruent,
    frame,
    matrix,
    node_dofs,
    orientation,
    rotation,
    scaled,
    scatter,
    segment,
    triad,
)
from ringtrue.fem.rigid_elements import rigid_motion
from ringtrue.model.model import Model


def spread(t: CardRows, ids: Int, component: Int) -> tuple[Int, Float]:
    """Three full DOFs (e, 3) of components of nodes or scalar points (e,), -1 for none, and their
    direction in them.
    """
    m = t.mesh
    dof = t.dof(ids, component)
    node = dof < 6 * len(m.xyz)
    first = np.where(node, dof - dof % 3, dof)
    dofs = np.where(node[:, None], first[:, None] + np.arange(3), -1)
    dofs[:, 0] = first
    way = np.tile([1.0, 0.0, 0.0], (dof.size, 1))
    way[node] = m.cd[dof[node] // 6, dof[node] % 3]
    return dofs, way


def along(t: CardRows) -> tuple[Int, Float]:
    """DOFs (e, 6), -1 where grounded, and the outer product (e, 6, 6) of the relative motion of the
    ends.
    """
    dofs = np.full((len(t), 6), -1)
    g = np.zeros((len(t), 6))
    for end, columns, sign in ((1, slice(3), 1.0), (2, slice(3, 6), -1.0)):
        scalar = f"S{end}" in t
        ids = t[f"S{end}" if scalar else f"G{end}"]
        component = np.zeros_like(ids) if scalar else t[f"C{end}"]
        used = ids > 0
        dofs[used, columns], way = spread(t.take(used), ids[used], component[used])
        g[used, columns] = sign * way
    return dofs, g[:, :, None] * g[:, None, :]


def _values(t: CardRows, card: str) -> CardRows:
    """The cards with the values of elements: their properties, or they themselves."""
    return t.named(card) if "PID" in t else t


def build_spring(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CELAS1 to CELAS4."""
    dofs, way = along(t)
    p = _values(t, "PELAS")
    return ElementMatrices(
        dofs=dofs,
        stiffness=scaled(p["K"], way),
        mass=np.zeros(dofs.shape),
        loss=p["GE"] if "GE" in p else np.zeros(len(t)),
    )


def build_scalar_mass(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CMASS1 to CMASS4."""
    dofs, way = along(t)
    M = scaled(_values(t, "PMASS")["M"], way)
    return ElementMatrices(dofs=dofs, stiffness=np.zeros(way.shape), mass=M)


def build_damper(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CDAMP1 to CDAMP4."""
    dofs, way = along(t)
    return _only_viscous(dofs, scaled(_values(t, "PDAMP")["B"], way))


def build_line_damper(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CVISC: CE along the line, CR about it.

    Raises
    ------
    DeckError
        If a node or the property is absent or the ends are at one place.
    """
    nodes, x = rod.ends(t)
    p = t.named("PVISC")
    L = segment(x)[0]
    return _only_viscous(node_dofs(nodes), rod.kernel(x, p["CE"] * L, p["CR"] * L))


def _only_viscous(dofs: Int, B: Any_) -> ElementMatrices:
    return ElementMatrices(
        dofs=dofs,
        stiffness=np.zeros(B.shape),
        mass=np.zeros(dofs.shape),
        viscous=B,
    )


def build_point_mass(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CONM2: mass at X1-X3 in CID (-1: a place in basic), inertia about it."""
    nodes = t.nodes("G")
    place = t.mesh.xyz[nodes[:, 0]]
    cid = t["CID"]
    x = t.stack("X1", "X2", "X3")
    R = frame(t.mesh, cid, place)
    r = np.where(cid[:, None] < 0, x - place, np.einsum("ei,eij->ej", x, R))
    # the card holds ∫xy dm, the tensor -∫xy dm
    I11, I21, I22, I31, I32, I33 = (t[f"I{i}"] for i in (11, 21, 22, 31, 32, 33))
    inertia = matrix((I11, -I21, -I31), (-I21, I22, -I32), (-I31, -I32, I33))
    body = scatter(
        len(t),
        6,
        ([0, 1, 2], t["M"][:, None, None] * np.eye(3)),
        ([3, 4, 5], congruent(R, inertia)),
    )
    return _at_node(nodes, congruent(arm(r), body))


def build_mass_matrix(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CONM1: the mass matrix of its node in CID."""
    nodes = t.nodes("G")
    i, j = np.tril_indices(6)
    values = t.stack(*(f"M{a}{b}" for a, b in zip(i + 1, j + 1, strict=True)))
    own = np.zeros((len(t), 6, 6), dtype=values.dtype)
    own[:, i, j] = own[:, j, i] = values
    R = frame(t.mesh, t["CID"], t.mesh.xyz[nodes[:, 0]])
    return _at_node(nodes, congruent(rotation(R, 1), own))


def _at_node(nodes: Int, M: Any_) -> ElementMatrices:
    return ElementMatrices(dofs=node_dofs(nodes), stiffness=np.zeros(M.shape), mass=M)


def _ends(t: CardRows) -> tuple[Int, Bool]:
    """Nodes (e, 2) at GA and GB, GA twice where GB is blank, and where it is."""
    ga = t["GA"]
    gb = t["GB"]
    grounded = gb == 0
    t.refuse(ga == 0, "GA is blank; a grounded element has GB blank")
    return t.nodes_of(np.stack([ga, np.where(grounded, ga, gb)], axis=1)), grounded


def _dofs(nodes: Int, grounded: Bool, count: int) -> Int:
    """The first `count` DOFs of both nodes (e, 2 count), -1 at a grounded end."""
    dofs = node_dofs(nodes, count)
    dofs[grounded, count:] = -1
    return dofs


def build_bush(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CBUSH.

    Raises
    ------
    DeckError
        If GA is blank or the property is absent.
    """
    nodes, grounded = _ends(t)
    x = t.mesh.xyz[nodes]
    p = t.named("PBUSH")
    stiffness = p.stack(*(f"K{i}" for i in range(1, 7)))
    viscous = p.stack(*(f"B{i}" for i in range(1, 7)))
    loss = losses(p)
    # relative motion (6) of the ends of the springs by that of the nodes
    R = rotation(_bush_axes(t, nodes, x, grounded), 1)
    ends = R[:, None] @ arm(_spring_point(t, x)[:, None] - x)
    ends[grounded, 1] = 0.0
    motion = np.concatenate([-ends[:, 0], ends[:, 1]], axis=2)
    K, H, B = (
        congruent(motion, values[:, :, None] * np.eye(6))
        for values in (stiffness, loss * stiffness, viscous)
    )
    half = np.tile([0.5, 0.5, 0.5, 0.0, 0.0, 0.0], (len(t), 2))
    half[grounded, 6:] = 0.0
    same = (loss == loss[:, :1]).all()
    return ElementMatrices(
        dofs=_dofs(nodes, grounded, 6),
        stiffness=K,
        mass=p["M"][:, None] * half,
        loss=loss[:, 0],
        viscous=B,
        lossy=None if same else H,
    )


def _bush_axes(t: CardRows, nodes: Int, x: Float, grounded: Bool) -> Float:
    """Element frames (e, 3, 3): CID, or x along the ends; basic where they coincide."""
    cid = t["CID"]
    R = frame(t.mesh, cid, x[:, 0])
    free = np.flatnonzero((cid < 0) & ~grounded & (x[:, 0] != x[:, 1]).any(axis=1))
    axis = segment(x[free])[1]
    v = orientation(t.take(free), nodes[free, 0])
    given = (v != 0).any(axis=1)
    local = any_triad(axis)
    local[given] = triad(t.take(free[given]), axis[given], v[given])
    R = R.copy()
    R[free] = local
    return R


def _spring_point(t: CardRows, x: Float) -> Float:
    """Where the spring stands, (e, 3) in basic: S of the way from A to B, or S1-S3 from A in
    OCID.
    """
    s = t["S"][:, None]
    ocid = t["OCID"]
    own = np.einsum(
        "ei,eij->ej", t.stack("S1", "S2", "S3"), frame(t.mesh, ocid, x[:, 0])
    )
    return np.where(ocid[:, None] >= 0, x[:, 0] + own, (1 - s) * x[:, 0] + s * x[:, 1])


def losses(p: CardRows) -> Any_:
    """Loss factors (n, 6) of rows of PBUSH: GE1 for all directions where GE2 to GE6 are blank, else
    blanks are 0.
    """
    out = np.repeat(p["GE"][:, None], 6, axis=1)
    if "GE2" in p:
        rest = p.stack(*(f"GE{i}" for i in range(2, 7)))
        alone = np.isnan(rest).all(axis=1, keepdims=True)
        out[:, 1:] = np.where(alone, out[:, 1:], np.nan_to_num(rest))
    return out


OPEN = 1e-14  # KB over KA where KB is blank or 0
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


def _axis(t: CardRows, nodes: Int) -> Float:
    """The axis (e, 3) along T1 of CID, else from GA to GB."""
    x = t.mesh.xyz[nodes]
    own = t["CID"] < 0
    lost = own & (x[:, 0] == x[:, 1]).all(axis=1)
    t.refuse(
        lost, "its ends are at one place, or GB is blank; give CID, whose T1 it takes"
    )
    axis = frame(t.mesh, t["CID"], x[:, 0])[:, 0].copy()
    axis[own] = segment(x[own])[1]
    return axis


def _pair(block: Any_) -> Any_:
    """Stiffness (e, 6, 6) between the translations of two nodes, by that of the spring (e, 3,
    3).
    """
    return np.kron(_PAIR, block)


def build_bush1d(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CBUSH1D: K, C and M of PBUSH1D, half the mass at each end.

    The lines of PBUSH1D behind these are for nonlinear solutions.

    Raises
    ------
    DeckError
        If there is no axis, GA is blank, or the property is absent.
    """
    nodes, grounded = _ends(t)
    axis = _axis(t, nodes)
    p = t.named("PBUSH1D")
    way = np.einsum("ei,ej->eij", axis, axis)
    return ElementMatrices(
        dofs=_dofs(nodes, grounded, 3),
        stiffness=_pair(scaled(p["K"], way)),
        mass=np.repeat(p["M"][:, None] / 2, 6, axis=1),
        viscous=_pair(scaled(p["C"], way)),
    )


def build_gap(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CGAP: closed (U0 <= 0) KA along and KT across, open KB along.

    A blank KB is 10⁻¹⁴ KA, a blank KT is MU1 KA (MSC Nastran Quick Reference Guide, PGAP).

    Raises
    ------
    DeckError
        If there is no axis, a node is blank, or the property is absent.
    """
    nodes, grounded = _ends(t)
    axis = _axis(t, nodes)
    t.refuse(grounded, "GB is blank; a gap has two nodes")
    p = t.named("PGAP")
    KA, KB, KT, mu = (p[c] for c in ("KA", "KB", "KT", "MU1"))
    KB = np.where(np.isnan(KB) | (KB == 0), OPEN * KA, KB)
    KT = np.where(np.isnan(KT), mu * KA, KT)
    closed = np.real(p["U0"]) <= 0
    along = np.where(closed, KA, KB)
    across = np.where(closed, KT, 0.0)
    way = np.einsum("ei,ej->eij", axis, axis)
    dofs = _dofs(nodes, grounded, 3)
    return ElementMatrices(
        dofs=dofs,
        stiffness=_pair(scaled(along, way) + scaled(across, np.eye(3) - way)),
        mass=np.zeros(dofs.shape),
    )


def sizes(model: Model, at: Int) -> Int:
    """How many UI and UD rows `at` of GENEL have, (e, 2): one call of `build_general` takes those
    with as many.
    """
    t = model["GENEL"]
    return np.stack([t.ragged(c).sizes[at] for c in ("UI", "UD")], axis=1)


def _listed(t: CardRows, name: str) -> Any_:
    """A column of lists of one length, (e, n)."""
    return t.ragged(name).values.reshape(len(t), -1)


def _components(t: CardRows, kind: str) -> tuple[Int, Float]:
    """Full DOFs (e, n, 3) of the components in UI or UD, -1 for none, and their directions in
    them.
    """
    ids = _listed(t, f"U{kind}")
    c = _listed(t, f"C{kind}")
    each = t.take(np.repeat(np.arange(len(t)), ids.shape[1]))
    dofs, way = spread(each, ids.reshape(-1), c.reshape(-1))
    return dofs.reshape(*ids.shape, 3), way.reshape(*ids.shape, 3)


def _symmetric(values: Any_, n: int) -> Any_:
    """Symmetric matrices (e, n, n) from their lower triangles column by column (e, n(n + 1)/2)."""
    j, i = np.triu_indices(n)
    out = np.zeros((len(values), n, n), dtype=values.dtype)
    out[:, i, j] = out[:, j, i] = values
    return out


def _motion(t: CardRows, n: int, d: int) -> Any_:
    """S (e, n, d): as given, else that of a rigid body."""
    column = t.ragged("S")
    given = column.sizes > 0
    S = np.zeros((len(t), n, d), dtype=column.values.dtype)
    if given.any():
        S[given] = _listed(t.take(given), "S").reshape(-1, n, d)
    if not d or given.all():
        return S
    rest = t.take(~given)
    why = f"UD has {d} components and S is missing; give S, or six that hold a body"
    rest.refuse(np.full(len(rest), d != 6), why)
    ids, components = (
        np.concatenate([_listed(rest, f"{c}I"), _listed(rest, f"{c}D")], axis=1)
        for c in "UC"
    )
    phi = rigid_motion(t.mesh, rest.nodes_of(ids), components - 1)
    values = np.linalg.svd(phi[:, n:], compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    rest.refuse(loose, "UD leaves a rigid motion free; give S, or other components")
    S[~given] = np.linalg.solve(
        phi[:, n:].swapaxes(1, 2), phi[:, :n].swapaxes(1, 2)
    ).swapaxes(1, 2)
    return S


def build_general(t: CardRows) -> ElementMatrices:
    """Matrices of rows of GENEL, which have as many UI and UD each (`sizes`).

    Raises
    ------
    DeckError
        If Z cannot be inverted, S is missing and cannot be found, or a node is absent.
    """
    parts = [_components(t, kind) for kind in "ID"]
    n, d = (dofs.shape[1] for dofs, _ in parts)
    K = _symmetric(_listed(t, "KZ"), n)
    flexible = t["FORM"] == "Z"
    values = np.abs(np.linalg.eigvalsh(K.real))
    singular = flexible & (values.min(axis=1) <= 1e-13 * values.max(axis=1))
    t.refuse(singular, "Z cannot be inverted")
    K[flexible] = np.linalg.inv(K[flexible])
    unit = np.broadcast_to(np.eye(n), (len(t), n, n))
    K = congruent(np.concatenate([unit, -_motion(t, n, d)], axis=2), K)
    dofs, way = (np.concatenate(x, axis=1) for x in zip(*parts, strict=True))
    k = 3 * (n + d)
    full = np.einsum("eia,eij,ejb->eiajb", way, K, way, optimize=True).reshape(-1, k, k)
    return ElementMatrices(
        dofs=dofs.reshape(-1, k),
        stiffness=full,
        mass=np.zeros((len(t), k)),
    )


SYMMETRIC = 6
SQUARE = 1
GivenMatrices = tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]


def given_matrices(m: Mesh) -> GivenMatrices | None:
    """The chosen stiffness, mass and damping, (n, n) csr each, in the displacement frames; None if
    none is chosen.

    PARAM CK2, CM2 and CB2 scale them; PARAM,WTMASS does not (the mass is entered as mass).

    Raises
    ------
    DeckError
        If a matrix that is chosen is not in the deck, or is not symmetric, or PARAM CK1, CM1 or CB1
        scale the elements.
    UnsupportedCard
        If one is rectangular or complex.
    """
    case = m.model.case
    chosen = case.k2gg, case.m2gg, case.b2gg
    if not any(chosen):
        return None
    made = []
    for letter, names in zip("KMB", chosen, strict=True):
        if names and m.model.param(f"C{letter}1", 1.0) != 1:
            raise DeckError(
                f"PARAM,C{letter}1 scales all elements: give the factor to their materials and "
                "properties instead"
            )
        total = sparse.csr_array((m.size, m.size))
        for factor, name in names:
            total = total + factor * named_matrix(m, name)
        made.append(sparse.csr_array(total * m.model.param(f"C{letter}2", 1.0)))
    K, M, B = made
    return K, M, B


def named_matrix(m: Mesh, name: str) -> sparse.csr_array:
    """The DMIG matrix of this name over the full DOFs, (n, n) csr in the displacement frames, both
    triangles.
    """
    have = (
        m.model["DMIG"]["NAME"].astype(str)
        if "DMIG" in m.model
        else np.empty(0, dtype=str)
    )
    found = np.flatnonzero(np.char.upper(have) == name.upper())
    if not found.size:
        raise DeckError(
            f"case control asks for DMIG {name}, which is not in the deck; it has "
            f"{', '.join(have) or 'none'}"
        )
    t = m.rows("DMIG", found[:1])
    form = int(t["IFO"][0])
    allowed = "; allowed are real matrices of form 1 and 6"
    other = np.array([form not in (SYMMETRIC, SQUARE)])
    t.refuse_unsupported(other, f"{name} is of form {form}{allowed}")
    is_complex = np.array([t.ragged("B").values.any()])
    t.refuse_unsupported(is_complex, f"{name} is complex{allowed}")
    value = t.ragged("A").values
    each = m.rows("DMIG", np.repeat(found[0], value.size))
    row, column = (
        each.dof(
            t.ragged(f"G{end}").values, t.ragged(f"C{end}").values.astype(np.int64)
        )
        for end in "IJ"
    )
    if form == SYMMETRIC:  # one triangle is given, or both equal: each pair counts once
        row, column = np.maximum(row, column), np.minimum(row, column)
        _, once = np.unique(row * m.size + column, return_index=True)
        row = row[once]
        column = column[once]
        value = value[once]
    A = sparse.coo_array((value, (row, column)), shape=(m.size, m.size)).tocsr()
    if form == SYMMETRIC:
        return sparse.csr_array(A + sparse.tril(A, -1).T)
    t.refuse(
        np.array([abs(A - A.T).max() > 1e-9 * abs(A).max()]), f"{name} is not symmetric"
    )
    return A
