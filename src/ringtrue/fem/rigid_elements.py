"""Rigid elements, RBE3, RSPLINE, and the nodes that pierce the patches of welds and fasteners.

Equations between displacements: dependent ones by others, and those of rigid bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.fem.elements import fasteners
from ringtrue.fem.elements.fasteners import End
from ringtrue.fem.mesh import Mesh, arm, components, node_dofs, rotation, segment
from ringtrue.model.model import Table, card_error, refuse_rows

Owner = tuple[Table, int]
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
    owner : tuple of (Table, int)
        The card behind each row: its table and row there.
    """

    dependent: Int
    row: Int
    column: Int
    value: Float
    owner: tuple[Owner, ...]


def owners(t: Table, at: Int) -> tuple[Owner, ...]:
    """The cards of rows `at`, for messages."""
    return tuple((t, i) for i in at.tolist())


Ends = tuple[Int, Int, Bool]  # owner (k,), node id (k,), components (k, 6)


def rigid(m: Mesh, t: Table, independent: Ends, dependent: Ends) -> Equations:
    """u_m = Φ_m Φ_n⁻¹ u_n with Φ the rigid motions at the independent (n, six an element) and
    dependent DOFs.
    """
    of, g, c = listed(m, t, independent)
    count = np.bincount(of, minlength=len(t))
    if (count != 6).any():
        i = int(np.flatnonzero(count != 6)[0])
        raise card_error(
            m.model,
            t,
            i,
            f"it has {count[i]} independent components; allowed are 6 that hold a rigid body",
        )
    order = np.argsort(of, kind="stable")
    g = g[order].reshape(-1, 6)
    c = c[order].reshape(-1, 6)
    origin, size = _extent(m, g)
    own = np.arange(len(t))[:, None]
    phi_n = _motion(m, g, c, origin=origin[own], size=size[own])
    values = np.linalg.svd(phi_n, compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    refuse_rows(
        m.model,
        t,
        np.flatnonzero(loose),
        "its independent components leave a rigid motion free; choose six that hold it",
    )
    at, h, d = listed(m, t, dependent)
    phi_m = _motion(m, h, d, origin=origin[at], size=size[at])
    X = np.linalg.solve(phi_n.swapaxes(1, 2)[at], phi_m[:, :, None])[:, :, 0]
    column = (6 * g + c)[at]
    if (column == (6 * h + d)[:, None]).any():
        i = int(at[np.flatnonzero((column == (6 * h + d)[:, None]).any(axis=1))[0]])
        raise card_error(m.model, t, i, "a component is both independent and dependent")
    row = np.repeat(np.arange(at.size), 6)
    keep = np.abs(X.reshape(-1)) > ROUNDING * np.abs(X).max(initial=0.0)
    return Equations(
        dependent=6 * h + d,
        row=row[keep],
        column=column.reshape(-1)[keep],
        value=X.reshape(-1)[keep],
        owner=owners(t, at),
    )


def listed(m: Mesh, t: Table, ends: Ends) -> tuple[Int, Int, Int]:
    """Owner, row of the node and component (0..5) of each component, in order."""
    of, ids, flags = ends
    entry, c = np.nonzero(flags)
    used = np.unique(entry)
    node = np.full(ids.shape, -1)
    node[used] = m.nodes(ids[used], t, of[used])
    return of[entry], node[entry], c


def _motion(m: Mesh, node: Int, component: Int, origin: Float, size: Float) -> Float:
    """Motion of components (...) by that of a rigid body about `origin`, turns in units of 1/size:
    (..., 6).
    """
    A = arm(m.xyz[node] - origin)
    A[..., 3:] /= size[..., None, None]
    axis = np.take_along_axis(m.cd[node], (component % 3)[..., None, None], axis=-2)[..., 0, :]
    kind = np.where((component < 3)[..., None, None], A[..., :3, :], A[..., 3:, :])
    return np.asarray(np.einsum("...i,...ij->...j", axis, kind))


def rigid_motion(m: Mesh, node: Int, component: Int) -> Float:
    """Motion of components (e, k) of nodes (rows, e, k) by that of a rigid body about their centre,
    (e, k, 6).
    """
    origin, size = _extent(m, node)
    return _motion(m, node, component, origin=origin[:, None], size=size[:, None])


def _extent(m: Mesh, node: Int) -> tuple[Float, Float]:
    """Centre (e, 3) of nodes (rows, e, k), and their largest distance from it along an axis (e,), 1
    for one place.
    """
    origin = m.xyz[node].mean(axis=1)
    size = np.abs(m.xyz[node] - origin[:, None]).max(axis=(1, 2))
    return origin, np.where(size > 1e-9 * np.abs(m.xyz).max(), size, 1.0)


def rbe3(m: Mesh) -> Equations:
    """u_ref = (Σ SᵀWS)⁻¹ Σ SᵀWu, rotations weighted by the square of a length; solved for UM where
    it is given.

    As in MSC Nastran since version 70.7 the length is the mean distance of the nodes, each counted
    once, from REFGRID.
    """
    t = m.model["RBE3"]
    G = t.ragged("G")
    of = G.owner
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
    inverse = _normal_inverse(m, t, normal, 1 / scale)
    X = rotation(m.cd[ref[of]], 1) @ inverse[of] @ S.swapaxes(1, 2) * W[:, None, :]
    eq = _spread(m, t, X, of=of, g=g, ref=ref)
    given = "GM" in t.columns and t.ragged("GM").values.size
    return _resolved(m, t, eq, np.nonzero(components(t["REFC"]))[0]) if given else eq


def _mean_arm(of: Int, g: Int, arms: Float, count: int) -> Float:
    """Mean length of the arms (k, 3) of each element (count,), a node in several groups once; 1
    without any.
    """
    once = np.unique(np.stack([of, g]), axis=1, return_index=True)[1]
    total = np.bincount(of[once], np.linalg.norm(arms[once], axis=1), count)
    return np.where(total == 0, 1.0, total / np.maximum(np.bincount(of[once], minlength=count), 1))


def _normal_inverse(m: Mesh, t: Table, normal: Float, scale: Float) -> Float:
    """Inverse of the normal matrices; a motion that the nodes do not determine must not be asked
    for.
    """
    A = normal * scale[:, :, None] * scale[:, None, :]
    plus = np.linalg.pinv(A, rcond=1e-10, hermitian=True)
    lost = np.abs(np.einsum("eij,eji->ei", plus, A) - 1) > 1e-6
    bad = (lost & components(t["REFC"])).any(axis=1)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise card_error(
            m.model,
            t,
            i,
            f"its nodes do not determine REFC {t['REFC'][i]}; add nodes or components",
        )
    return np.asarray(plus * scale[:, :, None] * scale[:, None, :])


def _spread(m: Mesh, t: Table, X: Float, of: Int, g: Int, ref: Int) -> Equations:
    """Rows for the components in REFC from X (entry, 6, 6)."""
    element, c = np.nonzero(components(t["REFC"]))
    number = np.full((len(t), 6), -1)
    number[element, c] = np.arange(element.size)
    row = np.broadcast_to(number[of][:, :, None], X.shape).reshape(-1)
    column = np.broadcast_to(node_dofs(g[:, None])[:, None, :], X.shape).reshape(-1)
    keep = (row >= 0) & (X.reshape(-1) != 0)
    return Equations(
        dependent=6 * ref[element] + c,
        row=row[keep],
        column=column[keep],
        value=X.reshape(-1)[keep],
        owner=owners(t, element),
    )


def _resolved(m: Mesh, t: Table, eq: Equations, of: Int) -> Equations:
    """The equations (owner `of` (k,)) of cards with UM, solved for the DOFs that UM names."""
    gm = t.ragged("GM")
    at, node, c = listed(m, t, (gm.owner, gm.values, components(t.ragged("CM").values)))
    wanted = np.bincount(at, minlength=len(t))
    there = np.bincount(of, minlength=len(t))
    wrong = (wanted > 0) & (wanted != there)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise card_error(
            m.model,
            t,
            i,
            f"UM names {wanted[i]} components; allowed are as many as REFC has, {there[i]}",
        )
    rows = np.flatnonzero(wanted[of] > 0)
    chosen = 6 * node + c
    k = rows.size
    whole = sparse.csr_array((-eq.value, (eq.row, eq.column)), shape=(of.size, m.size))[rows]
    whole = sparse.csr_array(
        whole
        + sparse.csr_array((np.ones(k), (np.arange(k), eq.dependent[rows])), shape=whole.shape)
    )
    solved = sparse.coo_array(_block_inverse(m, t, whole[:, chosen], at) @ whole)
    rest = ~np.isin(solved.col, chosen) & (
        np.abs(solved.data) > ROUNDING * np.abs(solved.data).max(initial=0.0)
    )
    keep = np.isin(eq.row, rows, invert=True)
    dependent = eq.dependent.copy()
    dependent[rows] = chosen
    return Equations(
        dependent=dependent,
        row=np.concatenate([eq.row[keep], rows[solved.row[rest]]]),
        column=np.concatenate([eq.column[keep], solved.col[rest]]),
        value=np.concatenate([eq.value[keep], -solved.data[rest]]),
        owner=eq.owner,
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
        raise card_error(
            m.model, t, i, "the components in UM are not determined by the others; choose others"
        )
    inverse = np.linalg.solve(blocks, np.broadcast_to(np.eye(6), blocks.shape))
    row, column = _pairs(number, first)
    return sparse.csr_array(
        (inverse[number[row], place[row], place[column]], (row, column)), shape=A.shape
    )


def _pairs(number: Int, first: Int) -> tuple[Int, Int]:
    """All (row, column) within a block."""
    size = np.bincount(number)
    row = np.repeat(np.arange(number.size), size[number])
    start = np.concatenate([[0], np.cumsum(size[number])[:-1]])
    return row, first[number[row]] + np.arange(row.size) - start[row]


ALONG = 1e-3  # least part of the dependent component along a rod


def rbe2(m: Mesh) -> Equations:
    t = m.model["RBE2"]
    of = t.ragged("GM").owner
    gn = m.nodes(t["GN"][of], t, of)
    gm = m.nodes(t.ragged("GM").values, t, of)
    same = gn == gm
    if same.any():
        raise card_error(
            m.model, t, int(of[same][0]), f"GRID {t['GN'][of[same][0]]} is its own dependent node"
        )
    moved = components(t["CM"])
    if (idle := ~moved.any(axis=1)).any():
        raise card_error(
            m.model, t, int(idle.argmax()), "CM names no component; allowed are the digits 1 to 6"
        )
    A = rotation(m.cd[gm], 1) @ arm(m.xyz[gm] - m.xyz[gn]) @ rotation(m.cd[gn], 1).swapaxes(1, 2)
    pair, c = np.nonzero(moved[of])
    row = np.repeat(np.arange(pair.size), 6)
    column = node_dofs(gn[pair][:, None]).reshape(-1)
    return Equations(
        dependent=6 * gm[pair] + c,
        row=row,
        column=column,
        value=A[pair, c].reshape(-1),
        owner=owners(t, of[pair]),
    )


def rbe1(m: Mesh) -> Equations:
    t = m.model["RBE1"]
    n = t.ragged("GN")
    k = t.ragged("GM")
    independent = n.owner, n.values, components(t.ragged("CN").values)
    return rigid(m, t, independent, (k.owner, k.values, components(t.ragged("CM").values)))


def rrod(m: Mesh) -> Equations:
    """a·(u_B − u_A) = 0 along the line, solved for the one translation that CMA or CMB names."""
    t = m.model["RROD"]
    every = np.arange(len(t))
    node = np.stack([m.nodes(t[g], t, every) for g in ("GA", "GB")], axis=1)
    named = np.concatenate([components(t["CMA"]), components(t["CMB"])], axis=1)
    one = (named.sum(axis=1) == 1) & ~named[:, [3, 4, 5, 9, 10, 11]].any(axis=1)
    if not one.all():
        i = int(np.flatnonzero(~one)[0])
        raise card_error(
            m.model, t, i, "CMA or CMB must name one translation, 1 to 3, and the other be blank"
        )
    x = m.xyz[node]
    short = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == 0
    if short.any():
        raise card_error(m.model, t, int(np.flatnonzero(short)[0]), "its two ends are at one place")
    axis = segment(x)[1]
    along = np.einsum("nkij,nj->nki", m.cd[node], axis) * np.array([-1.0, 1.0])[:, None]
    at = named.argmax(axis=1)
    end = at // 6
    c = at % 6
    lead = along[every, end, c]
    if (np.abs(lead) < ALONG).any():
        i = int(np.flatnonzero(np.abs(lead) < ALONG)[0])
        raise card_error(
            m.model, t, i, f"component {c[i] + 1} is across the rod; name one along it"
        )
    value = -(along / lead[:, None, None]).reshape(-1)
    column = (6 * node[:, :, None] + np.arange(3)).reshape(-1)
    dependent = 6 * node[every, end] + c
    row = np.repeat(every, 6)
    rest = (column != dependent[row]) & (value != 0)
    return Equations(
        dependent=dependent,
        row=row[rest],
        column=column[rest],
        value=value[rest],
        owner=owners(t, every),
    )


def _nodes(
    m: Mesh, card: str, ends: tuple[str, ...], free: tuple[str, ...], bound: tuple[str, ...]
) -> Equations:
    """A rigid body on nodes `ends`, components independent by the fields `free`, dependent by
    `bound`.

    Without `free` all six of the first node are; where all of `bound` are blank, the rest is
    dependent.
    """
    t = m.model[card]
    of = np.repeat(np.arange(len(t)), len(ends))
    ids = t.stack(*ends).reshape(-1)
    independent = np.zeros((len(t), len(ends), 6), dtype=bool)
    for k, name in enumerate(free):
        independent[:, k] = components(t[name])
    independent[~independent.any(axis=(1, 2)), 0] = True
    dependent = np.zeros_like(independent)
    for k, name in enumerate(bound, len(ends) - len(bound)):
        dependent[:, k] = components(t[name])
    if free:
        blank = ~dependent.any(axis=(1, 2))
        dependent[blank] = ~independent[blank]
    else:  # each blank field stands for all six
        dependent[:, 1:][~dependent[:, 1:].any(axis=2)] = True
    return rigid(m, t, (of, ids, independent.reshape(-1, 6)), (of, ids, dependent.reshape(-1, 6)))


def rbar(m: Mesh) -> Equations:
    """A rigid bar; without components GA is independent and GB dependent."""
    return _nodes(m, "RBAR", ("GA", "GB"), free=("CNA", "CNB"), bound=("CMA", "CMB"))


def rbar1(m: Mesh) -> Equations:
    """All six of GA are independent, CB of GB dependent, all six where it is blank."""
    return _nodes(m, "RBAR1", ("GA", "GB"), free=(), bound=("CB",))


def rjoint(m: Mesh) -> Equations:
    """As RBAR1; its ends stand at one place, and what CB leaves out is the joint."""
    return _nodes(m, "RJOINT", ("GA", "GB"), free=(), bound=("CB",))


def rtrplt(m: Mesh) -> Equations:
    """A rigid triangle: six independent components, the others dependent where CMA, CMB, CMC are
    blank.
    """
    return _nodes(
        m, "RTRPLT", ("GA", "GB", "GC"), free=("CNA", "CNB", "CNC"), bound=("CMA", "CMB", "CMC")
    )


def rtrplt1(m: Mesh) -> Equations:
    """A rigid triangle: all six of GA are independent, CMB and CMC dependent, all six where
    blank.
    """
    return _nodes(m, "RTRPLT1", ("GA", "GB", "GC"), free=(), bound=("CMB", "CMC"))


def rspline(m: Mesh) -> Equations:
    """Nodes interpolated by a chain of straight beams between two that are independent.

    The chain is a thin tube of diameter D, DL times the length of the whole spline: EI = GJ = 1, EA
    = 8/D² (as in NASTRAN-95, CRSPLINE). Its flexibility between the ends 1 and N, added up from 1
    in the basic frame, is C_N; that up to node i is C_i: u_i = R_i [u_1 + C_i C_N⁻¹ (R_N⁻¹ u_N −
    u_1)], R the rigid motion by that of node 1. Components that are not dependent at a node between
    do not count for the others.
    """
    t = m.model["RSPLINE"]
    G = t.ragged("G")
    flags = components(t.ragged("C").values)
    of = G.owner
    node = m.nodes(G.values, t, of)
    end = np.asarray(~flags.any(axis=1))
    _refuse_splines(m, t, of, end)
    first = np.flatnonzero(end & (np.r_[of[1:], -1] == of))  # of the section that begins there
    # a node that ends one belongs to the next, if any
    section = np.cumsum(np.isin(np.arange(of.size), first)) - 1
    last = np.flatnonzero(end & (np.r_[-1, of[:-1]] == of))
    x = m.xyz[node]
    link = np.flatnonzero(of[1:] == of[:-1])
    C = np.zeros((of.size, 6, 6))  # flexibility of the section's beams up to this node
    start = section[link]  # the section of each link is that of its first node
    C[link + 1] = _tubes(m, t, x, of=of, link=link, origin=x[first[start]])
    total = np.cumsum(C, axis=0)
    inner = np.flatnonzero(~end)
    a = first[section[inner]]
    b = last[section[inner]]
    part = total[inner] - total[a]
    whole = total[b] - total[a]
    share = np.swapaxes(np.linalg.solve(whole, np.swapaxes(part, 1, 2)), 1, 2)
    R = arm(x[inner] - x[a])
    by_last = R @ share @ arm(x[a] - x[b])
    by_first = R @ (np.eye(6) - share)
    return _interpolated(
        m,
        t,
        node[inner],
        flags=flags[inner],
        of=of[inner],
        by=((node[a], by_first), (node[b], by_last)),
    )


def _refuse_splines(m: Mesh, t: Table, of: Int, end: Bool) -> None:
    outer = np.zeros(of.size, dtype=bool)
    outer[np.unique(of, return_index=True)[1]] = True
    outer[np.flatnonzero(np.r_[of[1:] != of[:-1], True])] = True
    wrong = outer & ~end
    if wrong.any() or len(t) != np.unique(of).size:
        i = int(of[wrong][0]) if wrong.any() else int(np.setdiff1d(np.arange(len(t)), of)[0])
        raise card_error(
            m.model, t, i, "its first and last nodes are independent: give them no components"
        )


def _tubes(m: Mesh, t: Table, x: Float, of: Int, link: Int, origin: Float) -> Float:
    """Flexibility (k, 6, 6) of the beams from node `link` (k,) to the next, moved to `origin` (k,
    3).
    """
    ends = np.stack([x[link], x[link + 1]], axis=1)
    d = ends[:, 1] - ends[:, 0]
    L = np.linalg.norm(d, axis=1)
    if (L == 0).any():
        raise card_error(
            m.model,
            t,
            int(of[link[L == 0][0]]),
            "two nodes that follow each other are at one place",
        )
    D = (t["DL"] * np.bincount(of[link], L, len(t)))[of[link]]
    I = np.eye(3)
    along = np.einsum("ki,kj->kij", d, d)
    f = np.zeros((link.size, 6, 6))
    f[:, 3:, 3:] = L[:, None, None] * I
    f[:, :3, :3] = (L**3 / 12)[:, None, None] * I + ((D**2 / (8 * L)) - L / 12)[
        :, None, None
    ] * along
    A = arm(origin - ends.mean(axis=1))
    return np.asarray(A @ f @ A.swapaxes(1, 2))


def _interpolated(
    m: Mesh, t: Table, node: Int, flags: Bool, of: Int, by: Sequence[tuple[Int, Float]]
) -> Equations:
    """Components `flags` (k, 6) of nodes (k,) by the motions of others, each (node (k,), matrix (k,
    6, 6)) in basic.
    """
    entry, c = np.nonzero(flags)
    mine = rotation(m.cd[node], 1)
    columns = []
    values = []
    for other, A in by:
        local = mine @ A @ rotation(m.cd[other], 1).swapaxes(1, 2)
        columns.append(6 * other[entry][:, None] + np.arange(6))
        values.append(local[entry, c])
    column = np.concatenate(columns, axis=1)
    value = np.concatenate(values, axis=1)
    row = np.repeat(np.arange(entry.size), column.shape[1])
    keep = np.abs(value.reshape(-1)) > ROUNDING * np.abs(value).max(initial=0.0)
    dependent = 6 * node[entry] + c
    return Equations(
        dependent=dependent,
        row=row[keep],
        column=column.reshape(-1)[keep],
        value=value.reshape(-1)[keep],
        owner=owners(t, of[entry]),
    )


def cweld(m: Mesh) -> Equations:
    """GA and GB of welds on patches, which follow their patch."""
    return _piercing(m, "CWELD", fasteners.weld_ends, m.model["CWELD"]["TYPE"] != "ALIGN")


def cfast(m: Mesh) -> Equations:
    """GA and GB of fasteners, which follow their surface."""
    return _piercing(
        m, "CFAST", fasteners.fastener_ends, np.ones(len(m.model["CFAST"]), dtype=bool)
    )


def _piercing(
    m: Mesh, card: str, ends: Callable[[Mesh, str, Int], Sequence[End]], on_patch: Bool
) -> Equations:
    """Nodes GA and GB that are given; one that is itself a corner is left alone."""
    t = m.model[card]
    rows = np.flatnonzero(on_patch & ((t["GA"] > 0) | (t["GB"] > 0)))
    if not rows.size:
        none: Int = np.empty(0, dtype=np.int64)
        return Equations(dependent=none, row=none, column=none, value=np.empty(0), owner=())
    made = []
    for side, end in zip("AB", ends(m, card, rows), strict=True):
        given = np.flatnonzero(t[f"G{side}"][rows] > 0)
        at = rows[given]
        node = m.nodes(t[f"G{side}"][at], t, at)
        free = ~(end.nodes[given] == node[:, None]).any(axis=1)
        made.append((node[free], at[free], end.nodes[given[free]], end.follow[given[free]]))
    node, of, corners, follow = (np.concatenate(x) for x in zip(*made, strict=True))
    parts = []
    for k in range(corners.shape[1]):
        there = (corners[:, k] >= 0)[:, None, None]
        corner = np.where(corners[:, k] >= 0, corners[:, k], corners[:, 0])
        parts.append((corner, np.where(there, follow[:, :, 6 * k : 6 * k + 6], 0.0)))
    return _interpolated(m, t, node, flags=np.ones((node.size, 6), dtype=bool), of=of, by=parts)


RIGID: Mapping[str, Callable[[Mesh], Equations]] = {
    "RBAR": rbar,
    "RBE1": rbe1,
    "RBE2": rbe2,
    "RBE3": rbe3,
    "RROD": rrod,
    "RBAR1": rbar1,
    "RJOINT": rjoint,
    "RTRPLT": rtrplt,
    "RTRPLT1": rtrplt1,
    "RSPLINE": rspline,
    "CWELD": cweld,
    "CFAST": cfast,
}
