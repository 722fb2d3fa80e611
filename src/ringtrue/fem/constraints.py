"""Rigid elements, multipoint equations and supports as one sparse elimination, in the displacement frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.algebra import arm, rotation
from ringtrue.fem.mesh import Mesh, error
from ringtrue.fem.place import components, node_dofs
from ringtrue.model.model import Ragged, Table

EPZERO = 1e-8  # AUTOSPC holds what is weaker than this share of its node's largest stiffness
ROUNDING = 1e-14  # of the largest coefficient of a card: what is smaller is a zero


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """x[dependent] = coefficients x, k rows in triplet form.

    Attributes
    ----------
    dependent : (k,) int64
    row, column : (t,) int64
        Positions in `dependent`; full DOFs.
    value : (t,) float64
    owner : tuple of str
        The card behind each row.
    """

    dependent: Int
    row: Int
    column: Int
    value: Float
    owner: tuple[str, ...]


def owners(ragged: Ragged) -> Int:
    """The row that each value of a ragged column belongs to."""
    return np.repeat(np.arange(len(ragged)), np.diff(ragged.offsets))


def _rbe2(m: Mesh) -> Equations:
    t = m.model["RBE2"]
    of = owners(t.ragged("GM"))
    gn, gm = m.nodes(t["GN"][of], t, of), m.nodes(t.ragged("GM").values, t, of)
    same = gn == gm
    if same.any():
        raise error(m.model, t, int(of[same][0]), f"GRID {t['GN'][of[same][0]]} is its own dependent node")
    A = rotation(m.cd[gm], 1) @ arm(m.xyz[gm] - m.xyz[gn]) @ rotation(m.cd[gn], 1).swapaxes(1, 2)
    pair, c = np.nonzero(components(t["CM"][of]))
    row = np.repeat(np.arange(pair.size), 6)
    column = node_dofs(gn[pair][:, None]).reshape(-1)
    return Equations(6 * gm[pair] + c, row, column, A[pair, c].reshape(-1), names(t, of[pair]))


def names(t: Table, at: Int) -> tuple[str, ...]:
    """The cards of rows `at`, as they are called in messages."""
    return tuple(f"{t.card} {i}" for i in t.ids[at].tolist())


def _rbar(m: Mesh) -> Equations:
    """A rigid bar; without components GA is independent and GB dependent."""
    t = m.model["RBAR"]
    of = np.repeat(np.arange(len(t)), 2)
    ids = t.stack("GA", "GB").reshape(-1)
    independent = np.stack([components(t["CNA"]), components(t["CNB"])], axis=1)
    independent[~independent.any(axis=(1, 2)), 0] = True
    dependent = np.stack([components(t["CMA"]), components(t["CMB"])], axis=1)
    blank = ~dependent.any(axis=(1, 2))
    dependent[blank] = ~independent[blank]
    return rigid(m, t, (of, ids, independent.reshape(-1, 6)), (of, ids, dependent.reshape(-1, 6)))


def _rbe1(m: Mesh) -> Equations:
    t = m.model["RBE1"]
    n, k = t.ragged("GN"), t.ragged("GM")
    independent = owners(n), n.values, components(t.ragged("CN").values)
    return rigid(m, t, independent, (owners(k), k.values, components(t.ragged("CM").values)))


Ends = tuple[Int, Int, Bool]  # owner (k,), node id (k,), components (k, 6)


def rigid(m: Mesh, t: Table, independent: Ends, dependent: Ends) -> Equations:
    """u_m = Φ_m Φ_n⁻¹ u_n with Φ the rigid motions at the independent (n, six an element) and dependent DOFs."""
    of, g, c = _listed(m, t, independent)
    count = np.bincount(of, minlength=len(t))
    if (count != 6).any():
        i = int(np.flatnonzero(count != 6)[0])
        raise error(m.model, t, i, f"it has {count[i]} independent components; allowed are 6 that hold a rigid body")
    order = np.argsort(of, kind="stable")
    g, c = g[order].reshape(-1, 6), c[order].reshape(-1, 6)
    origin = m.xyz[g].mean(axis=1)
    size = np.abs(m.xyz[g] - origin[:, None]).max(axis=(1, 2))
    size = np.where(size > 1e-9 * np.abs(m.xyz).max(), size, 1.0)  # six at one node
    own = np.arange(len(t))[:, None]
    phi_n = _motion(m, g, c, origin[own], size[own])
    values = np.linalg.svd(phi_n, compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    if loose.any():
        i = int(np.flatnonzero(loose)[0])
        raise error(m.model, t, i, "its independent components leave a rigid motion free; choose six that hold it")
    at, h, d = _listed(m, t, dependent)
    phi_m = _motion(m, h, d, origin[at], size[at])
    X = np.linalg.solve(phi_n.swapaxes(1, 2)[at], phi_m[:, :, None])[:, :, 0]
    column = (6 * g + c)[at]
    if (column == (6 * h + d)[:, None]).any():
        i = int(at[np.flatnonzero((column == (6 * h + d)[:, None]).any(axis=1))[0]])
        raise error(m.model, t, i, "a component is both independent and dependent")
    row = np.repeat(np.arange(at.size), 6)
    keep = np.abs(X.reshape(-1)) > ROUNDING * np.abs(X).max(initial=0.0)
    return Equations(6 * h + d, row[keep], column.reshape(-1)[keep], X.reshape(-1)[keep], names(t, at))


def _listed(m: Mesh, t: Table, ends: Ends) -> tuple[Int, Int, Int]:
    """Owner, row of the node and component (0..5) of each component, in order."""
    of, ids, flags = ends
    entry, c = np.nonzero(flags)
    used = np.unique(entry)
    node = np.full(ids.shape, -1)
    node[used] = m.nodes(ids[used], t, of[used])
    return of[entry], node[entry], c


def _motion(m: Mesh, node: Int, component: Int, origin: Float, size: Float) -> Float:
    """Motion of components (...) by that of a rigid body about `origin`, turns in units of 1/size: (..., 6)."""
    A = arm(m.xyz[node] - origin)
    A[..., 3:] /= size[..., None, None]
    axis = np.take_along_axis(m.cd[node], (component % 3)[..., None, None], axis=-2)[..., 0, :]
    kind = np.where((component < 3)[..., None, None], A[..., :3, :], A[..., 3:, :])
    return np.asarray(np.einsum("...i,...ij->...j", axis, kind))


def rigid_motion(m: Mesh, node: Int, component: Int) -> Float:
    """Motion of components (e, k) of nodes (rows, e, k) by that of a rigid body about their centre, (e, k, 6)."""
    origin = m.xyz[node].mean(axis=1, keepdims=True)
    size = np.abs(m.xyz[node] - origin).max(axis=(1, 2))
    size = np.where(size > 1e-9 * np.abs(m.xyz).max(), size, 1.0)
    return _motion(m, node, component, origin, size[:, None])


def _rbe3(m: Mesh) -> Equations:
    """u_ref = (Σ SᵀWS)⁻¹ Σ SᵀWu, rotations weighted by the square of a length; solved for UM where it is given.

    As in MSC Nastran since version 70.7 the length is the mean distance of the nodes, each counted once, from REFGRID.
    """
    t = m.model["RBE3"]
    G = t.ragged("G")
    of = owners(G)
    ref = m.nodes(t["REFGRID"], t, np.arange(len(t)))
    g = m.nodes(G.values, t, of)
    arms = m.xyz[g] - m.xyz[ref[of]]
    length = _mean_arm(of, g, arms, len(t))
    S = rotation(m.cd[g], 1) @ arm(arms)
    scale = np.ones((len(t), 6))
    scale[:, 3:] = length[:, None]
    W = components(t.ragged("C").values) * t.ragged("WT").values[:, None] * scale[of] ** 2
    normal = np.zeros((len(t), 6, 6))
    np.add.at(normal, of, S.swapaxes(1, 2) @ (W[:, :, None] * S))
    inverse = _inverse(m, t, normal, 1 / scale)
    X = rotation(m.cd[ref[of]], 1) @ inverse[of] @ S.swapaxes(1, 2) * W[:, None, :]
    eq = _spread(m, t, X, of, g, ref)
    given = "GM" in t.columns and t.ragged("GM").values.size
    return _resolved(m, t, eq, np.nonzero(components(t["REFC"]))[0]) if given else eq


def _mean_arm(of: Int, g: Int, arms: Float, count: int) -> Float:
    """Mean length of the arms (k, 3) of each element (count,), a node in several groups once; 1 without any."""
    once = np.unique(np.stack([of, g]), axis=1, return_index=True)[1]
    total = np.bincount(of[once], np.linalg.norm(arms[once], axis=1), count)
    return np.where(total == 0, 1.0, total / np.maximum(np.bincount(of[once], minlength=count), 1))


def _inverse(m: Mesh, t: Table, normal: Float, scale: Float) -> Float:
    """Inverse of the normal matrices; a motion that the nodes do not determine must not be asked for."""
    A = normal * scale[:, :, None] * scale[:, None, :]
    plus = np.linalg.pinv(A, rcond=1e-10, hermitian=True)
    lost = np.abs(np.einsum("eij,eji->ei", plus, A) - 1) > 1e-6
    bad = (lost & components(t["REFC"])).any(axis=1)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise error(m.model, t, i, f"its nodes do not determine REFC {t['REFC'][i]}; add nodes or components")
    return np.asarray(plus * scale[:, :, None] * scale[:, None, :])


def _spread(m: Mesh, t: Table, X: Float, of: Int, g: Int, ref: Int) -> Equations:
    """Rows for the components in REFC from X (entry, 6, 6)."""
    element, c = np.nonzero(components(t["REFC"]))
    number = np.full((len(t), 6), -1)
    number[element, c] = np.arange(element.size)
    row = np.broadcast_to(number[of][:, :, None], X.shape).reshape(-1)
    column = np.broadcast_to(node_dofs(g[:, None])[:, None, :], X.shape).reshape(-1)
    keep = (row >= 0) & (X.reshape(-1) != 0)
    return Equations(6 * ref[element] + c, row[keep], column[keep], X.reshape(-1)[keep], names(t, element))


def _resolved(m: Mesh, t: Table, eq: Equations, of: Int) -> Equations:
    """The equations (owner `of` (k,)) of cards with UM, solved for the DOFs that UM names."""
    gm = t.ragged("GM")
    at, node, c = _listed(m, t, (owners(gm), gm.values, components(t.ragged("CM").values)))
    wanted, there = np.bincount(at, minlength=len(t)), np.bincount(of, minlength=len(t))
    wrong = (wanted > 0) & (wanted != there)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise error(m.model, t, i, f"UM names {wanted[i]} components; allowed are as many as REFC has, {there[i]}")
    rows = np.flatnonzero(wanted[of] > 0)
    chosen, k = 6 * node + c, rows.size
    whole = sparse.csr_array((-eq.value, (eq.row, eq.column)), shape=(of.size, m.size))[rows]
    whole = sparse.csr_array(
        whole + sparse.csr_array((np.ones(k), (np.arange(k), eq.dependent[rows])), shape=whole.shape)
    )
    solved = sparse.coo_array(_block_inverse(m, t, whole[:, chosen], at) @ whole)
    rest = ~np.isin(solved.col, chosen) & (np.abs(solved.data) > ROUNDING * np.abs(solved.data).max(initial=0.0))
    keep = np.isin(eq.row, rows, invert=True)
    dependent = eq.dependent.copy()
    dependent[rows] = chosen
    return Equations(
        dependent,
        np.concatenate([eq.row[keep], rows[solved.row[rest]]]),
        np.concatenate([eq.column[keep], solved.col[rest]]),
        np.concatenate([eq.value[keep], -solved.data[rest]]),
        eq.owner,
    )


def _block_inverse(m: Mesh, t: Table, A: sparse.csr_array, of: Int) -> sparse.csr_array:
    """Inverse of A (k, k), block-diagonal with up to six rows an owner `of` (k,), ascending."""
    _, first, number = np.unique(of, return_index=True, return_inverse=True)
    place = np.arange(of.size) - first[number]
    coo = A.tocoo()
    blocks = np.tile(np.eye(6), (first.size, 1, 1))
    blocks[number, place, place] = 0.0
    blocks[number[coo.row], place[coo.row], place[coo.col]] += coo.data
    values = np.linalg.svd(blocks, compute_uv=False)
    bad = values[:, -1] < 1e-10 * values[:, 0]
    if bad.any():
        i = int(of[first[np.flatnonzero(bad)[0]]])
        raise error(m.model, t, i, "the components in UM are not determined by the others; choose others")
    inverse = np.linalg.solve(blocks, np.broadcast_to(np.eye(6), blocks.shape))
    row, column = _pairs(number, first)
    return sparse.csr_array((inverse[number[row], place[row], place[column]], (row, column)), shape=A.shape)


def _pairs(number: Int, first: Int) -> tuple[Int, Int]:
    """All (row, column) within a block."""
    size = np.bincount(number)
    row = np.repeat(np.arange(number.size), size[number])
    start = np.concatenate([[0], np.cumsum(size[number])[:-1]])
    return row, first[number[row]] + np.arange(row.size) - start[row]


def _mpc(m: Mesh) -> Equations:
    t = m.model["MPC"]
    rows = np.flatnonzero(np.isin(t["SID"], _sets(m, "MPCADD", m.model.case.mpc)))
    G, C, A = (t.ragged(c) for c in "GCA")
    of = owners(G)
    dof = m.dof(G.values, C.values.astype(np.int64), t, of)
    first = np.zeros(of.size, dtype=bool)
    first[G.offsets[:-1][np.diff(G.offsets) > 0]] = True
    use = np.isin(of, rows)
    lead = A.values[G.offsets[:-1]]
    if (lead[rows] == 0).any():
        raise error(m.model, t, int(rows[lead[rows] == 0][0]), "the first coefficient is 0; it names the dependent DOF")
    number = np.full(len(t), -1)
    number[rows] = np.arange(rows.size)
    rest = use & ~first
    value = -A.values[rest] / lead[of[rest]]
    return Equations(dof[use & first], number[of[rest]], dof[rest], value, names(t, rows))


def _sets(m: Mesh, add: str, sid: int) -> Int:
    """A set id, or those that an SPCADD or MPCADD of that id unites; it goes before a set of its own number."""
    rows = np.flatnonzero(m.model[add]["SID"] == sid) if add in m.model else np.empty(0, dtype=np.int64)
    united = [m.model[add].ragged("S").row(i) for i in rows.tolist()]
    return np.unique(np.concatenate(united) if united else [sid] if sid else np.empty(0, dtype=np.int64))


_RIGID = {"RBAR": _rbar, "RBE1": _rbe1, "RBE2": _rbe2, "RBE3": _rbe3}


def equations(m: Mesh) -> Equations:
    """All dependent DOFs of the chosen sets."""
    from ringtrue.fem.rigid import RIGID  # it builds on this module

    parts = [read(m) for card, read in (_RIGID | dict(RIGID)).items() if card in m.model]
    parts += [_mpc(m)] if "MPC" in m.model and m.model.case.mpc else []
    shift = np.cumsum([0, *(p.dependent.size for p in parts)])
    none: Int = np.empty(0, dtype=np.int64)
    return Equations(
        np.concatenate([none, *(p.dependent for p in parts)]),
        np.concatenate([none, *(p.row + s for p, s in zip(parts, shift, strict=False))]),
        np.concatenate([none, *(p.column for p in parts)]),
        np.concatenate([np.empty(0), *(p.value for p in parts)]),
        tuple(name for p in parts for name in p.owner),
    )


def supports(m: Mesh) -> Bool:
    """Which full DOFs are held, (n,): PS of GRID, and SPC, SPC1 of the chosen set."""
    held = np.zeros(m.size, dtype=bool)
    grid = m.model["GRID"]
    if "PS" in grid.columns:
        held[: 6 * len(grid)] |= components(grid["PS"]).reshape(-1)
    sids = _sets(m, "SPCADD", m.model.case.spc)
    if "SPC" in m.model:
        t = m.model["SPC"]
        at = np.flatnonzero(np.isin(t["SID"], sids))
        _hold(m, held, t, at, t["G"][at], t["C"][at])
    if "SPC1" in m.model:
        t = m.model["SPC1"]
        of = owners(t.ragged("G"))
        at = np.flatnonzero(np.isin(t["SID"][of], sids))
        _hold(m, held, t, of[at], t.ragged("G").values[at], t["C"][of[at]])
    return held


def _hold(m: Mesh, held: Bool, t: Table, at: Int, nodes: Int, text: Float) -> None:
    scalar = np.isin(nodes, m.scalar)
    held[m.dof(nodes[scalar], np.zeros(int(scalar.sum()), dtype=np.int64), t, at[scalar])] = True
    rows = m.nodes(nodes[~scalar], t, at[~scalar])
    i, c = np.nonzero(components(text[~scalar]))
    held[6 * rows[i] + c] = True


def eliminate(m: Mesh) -> tuple[sparse.csr_array, Int]:
    """The map from independent DOFs that are not held to all full DOFs, both in the displacement frames.

    Returns
    -------
    T : (n, k) csr
    free : (k,) int64, full DOF of each column

    Raises
    ------
    DeckError
        If a DOF is dependent twice, or dependent and held, or if dependencies run in a circle.
    """
    eq, held = equations(m), supports(m)
    _check(m, eq, held)
    n, k = m.size, eq.dependent.size
    dependent = np.full(n, -1)
    dependent[eq.dependent] = np.arange(k)
    free = np.flatnonzero((dependent < 0) & ~held)
    select = sparse.csr_array((np.ones(free.size), (free, np.arange(free.size))), shape=(n, free.size))
    if not k:
        return select, free
    full = sparse.csr_array((eq.value, (eq.row, eq.column)), shape=(k, n))
    chain = sparse.csr_array(full[:, eq.dependent])
    chain.eliminate_zeros()
    if connected_components(chain, connection="strong")[0] < k or chain.diagonal().any():
        _, label = connected_components(chain, connection="strong")
        loop = np.flatnonzero(np.bincount(label)[label] > 1)
        names = sorted({eq.owner[i] for i in loop.tolist()}) or [eq.owner[0]]
        raise DeckError(f"dependencies run in a circle: {', '.join(names[:6])}; make one end independent")
    rows = total = sparse.csr_array(full[:, free])
    while rows.nnz and chain.nnz:  # as often as the longest chain is long
        rows = sparse.csr_array(chain @ rows)
        total = sparse.csr_array(total + rows)
    place = sparse.csr_array((np.ones(k), (eq.dependent, np.arange(k))), shape=(n, k))
    return sparse.csr_array(select + place @ total), free


def _check(m: Mesh, eq: Equations, held: Bool) -> None:
    twice = np.bincount(eq.dependent, minlength=m.size) > 1
    for bad, why in ((twice, "is dependent more than once"), (held, "is dependent and held by an SPC or PS")):
        at = np.flatnonzero(bad[eq.dependent])
        if at.size:
            label = m.dofs.labels()[eq.dependent[at[0]]]
            names = [eq.owner[i] for i in at.tolist() if eq.dependent[i] == eq.dependent[at[0]]]
            raise DeckError(f"DOF {label} {why} ({', '.join(names)}); release one")


def singular_dofs(K: sparse.csr_array, free: Int, nodes: int, tolerance: float = EPZERO) -> Bool:
    """DOFs (k,) of K (k, k) that have no stiffness: AUTOSPC.

    Each node's 3 x 3 block of translations, or of rotations, is examined; for each direction in which it is
    singular (relative to its largest term) the DOF nearest to it is named.
    """
    group, place = np.where(free < 6 * nodes, free // 3, free - 4 * nodes), np.where(free < 6 * nodes, free % 3, 0)
    coo = K.tocoo()
    inside = group[coo.row] == group[coo.col]
    blocks = np.zeros((int(group.max(initial=-1)) + 1, 3, 3))
    r, c = coo.row[inside], coo.col[inside]
    blocks[group[r], place[r], place[c]] = coo.data[inside]
    there = np.zeros(blocks.shape[:2], dtype=bool)
    there[group, place] = True
    size = np.abs(blocks).max(axis=(1, 2), initial=0.0)
    out = there & (size == 0)[:, None]
    for _ in range(3):  # a block has three directions
        live = there & ~out
        A = np.where(live[:, :, None] & live[:, None, :], blocks, 0.0) / np.where(size == 0, 1.0, size)[:, None, None]
        A[~live[:, :, None] & np.eye(3, dtype=bool)] = 4.0
        values, vectors = np.linalg.eigh(A)
        weak = np.flatnonzero((values[:, 0] < tolerance) & live.any(axis=1))
        if not weak.size:
            break
        out[weak, np.abs(vectors[weak, :, 0]).argmax(axis=1)] = True
    return np.asarray(out[group, place])
