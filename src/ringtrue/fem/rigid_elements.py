"""Rigid elements, RBE3, RSPLINE, and the nodes that pierce the patches of welds and fasteners.

Equations between displacements: dependent ones by others, and those of rigid bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements import fasteners
from ringtrue.fem.elements.fasteners import End
from ringtrue.fem.mesh import (
    CardRows,
    Mesh,
    arm,
    components,
    congruent,
    node_dofs,
    rotation,
    scaled,
    scatter,
    segment,
)
from ringtrue.model.model import Table

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


def in_full(t: CardRows, dependent: Int, column: Int, value: Any_) -> Equations:
    """Equations (k,) of as many rows of a table, with the full DOFs `column` (k, c) and their
    coefficients (k, c), of which rounding is left out.
    """
    keep = np.abs(value) > ROUNDING * np.abs(value).max(initial=0.0)
    return Equations(
        dependent=dependent,
        row=np.nonzero(keep)[0],
        column=column[keep],
        value=value[keep],
        owner=owners(t),
    )


def owners(t: CardRows) -> tuple[Owner, ...]:
    """The cards of rows, for messages."""
    return tuple((t.table, i) for i in t.at.tolist())


def joined(parts: Sequence[Equations]) -> Equations:
    """All equations of the parts."""
    none: Int = np.empty(0, dtype=np.int64)
    shift = np.cumsum([0, *(p.dependent.size for p in parts)])
    return Equations(
        dependent=np.concatenate([none, *(p.dependent for p in parts)]),
        row=np.concatenate(
            [none, *(p.row + s for p, s in zip(parts, shift, strict=False))]
        ),
        column=np.concatenate([none, *(p.column for p in parts)]),
        value=np.concatenate([np.empty(0), *(p.value for p in parts)]),
        owner=tuple(name for p in parts for name in p.owner),
    )


Ends = tuple[Int, Int, Bool]  # row of the table (k,), node id (k,), components (k, 6)


def rigid(t: CardRows, independent: Ends, dependent: Ends) -> Equations:
    """u_m = Φ_m Φ_n⁻¹ u_n with Φ the rigid motions at the independent (n, six an element) and
    dependent DOFs.
    """
    m = t.mesh
    of, g, c = listed(t, independent)
    count = np.bincount(of, minlength=len(t))
    why = "it has {} independent components; allowed are 6 that hold a rigid body"
    t.refuse(count != 6, why, count)
    order = np.argsort(of, kind="stable")
    g = g[order].reshape(-1, 6)
    c = c[order].reshape(-1, 6)
    origin, size = _extent(m, g)
    phi_n = _motion(m, g, c, origin=origin[:, None], size=size[:, None])
    values = np.linalg.svd(phi_n, compute_uv=False)
    loose = values[:, -1] < 1e-9 * values[:, 0]
    why = (
        "its independent components leave a rigid motion free; choose six that hold it"
    )
    t.refuse(loose, why)
    at, h, d = listed(t, dependent)
    phi_m = _motion(m, h, d, origin=origin[at], size=size[at])
    X = np.linalg.solve(phi_n.swapaxes(1, 2)[at], phi_m[:, :, None])[:, :, 0]
    column = (6 * g + c)[at]
    both = (column == (6 * h + d)[:, None]).any(axis=1)
    t.take(at).refuse(both, "a component is both independent and dependent")
    return in_full(t.take(at), 6 * h + d, column, X)


def listed(t: CardRows, ends: Ends) -> tuple[Int, Int, Int]:
    """Row of the table, row of the node and component (0..5) of each component, in order."""
    of, ids, flags = ends
    entry, c = np.nonzero(flags)
    return of[entry], t.take(of[entry]).nodes_of(ids[entry]), c


def _motion(m: Mesh, node: Int, component: Int, origin: Float, size: Float) -> Float:
    """Motion of components (...) by that of a rigid body about `origin`, turns in units of 1/size:
    (..., 6).
    """
    A = arm(m.xyz[node] - origin)
    A[..., 3:] /= size[..., None, None]
    axis = np.take_along_axis(m.cd[node], (component % 3)[..., None, None], axis=-2)[
        ..., 0, :
    ]
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
    """
    t = m.rows("RBE3")
    solved = np.zeros(len(t), dtype=bool)
    if "GM" in t:
        solved = t.ragged("GM").sizes > 0
    # few cards have UM
    each = (_solved(t.take(np.array([i]))) for i in np.flatnonzero(solved))
    return joined([_weighted(t.take(~solved)), *each])


def _weighted(t: CardRows) -> Equations:
    """REFC by the components of the nodes.

    As in MSC Nastran since version 70.7 the length is the mean distance of the nodes, each counted
    once, from REFGRID.
    """
    m = t.mesh
    G = t.ragged("G")
    of = G.owner
    ref = t.nodes("REFGRID")[:, 0]
    g = t.take(of).nodes_of(G.values)
    arms = m.xyz[g] - m.xyz[ref[of]]
    once = np.unique(np.stack([of, g]), axis=1, return_index=True)[1]
    total = np.bincount(of[once], np.linalg.norm(arms[once], axis=1), len(t))
    length = total / np.maximum(np.bincount(of[once], minlength=len(t)), 1)
    S = rotation(m.cd[g], 1) @ arm(arms)
    scale = np.ones((len(t), 6))
    scale[:, 3:] = np.where(length == 0, 1.0, length)[:, None]
    W = (
        components(t.ragged("C").values)
        * t.ragged("WT").values[:, None]
        * scale[of] ** 2
    )
    normal = np.zeros((len(t), 6, 6))
    np.add.at(normal, of, S.swapaxes(1, 2) @ (W[:, :, None] * S))
    # a motion that the nodes do not determine must not be asked for
    both = scale[:, :, None] * scale[:, None, :]
    A = normal / both
    plus = np.linalg.pinv(A, rcond=1e-10, hermitian=True)
    asked = components(t["REFC"])
    lost = np.abs(np.einsum("eij,eji->ei", plus, A) - 1) > 1e-6
    why = "its nodes do not determine REFC {}; add nodes or components"
    t.refuse((lost & asked).any(axis=1), why, t["REFC"])
    X = (
        rotation(m.cd[ref[of]], 1)
        @ (plus / both)[of]
        @ S.swapaxes(1, 2)
        * W[:, None, :]
    )
    element, c = np.nonzero(asked)
    number = np.full((len(t), 6), -1)
    number[element, c] = np.arange(element.size)
    row = np.broadcast_to(number[of][:, :, None], X.shape)
    column = np.broadcast_to(node_dofs(g[:, None])[:, None, :], X.shape)
    keep = (row >= 0) & (X != 0)
    return Equations(
        dependent=6 * ref[element] + c,
        row=row[keep],
        column=column[keep],
        value=X[keep],
        owner=owners(t.take(element)),
    )


def _solved(t: CardRows) -> Equations:
    """The equations of one card with UM, solved for the DOFs that UM names."""
    eq = _weighted(t)
    gm = t.ragged("GM")
    _, node, c = listed(t, (gm.owner, gm.values, components(t.ragged("CM").values)))
    chosen = 6 * node + c
    count = eq.dependent.size
    why = f"UM names {chosen.size} components; allowed are as many as REFC has, {count}"
    t.refuse(np.array([chosen.size != count]), why)
    used = np.unique(np.concatenate([eq.column, eq.dependent, chosen]))
    A = np.zeros((count, used.size))
    A[eq.row, np.searchsorted(used, eq.column)] = -eq.value
    A[np.arange(count), np.searchsorted(used, eq.dependent)] += 1.0
    block = A[:, np.searchsorted(used, chosen)]
    values = np.linalg.svd(block, compute_uv=False)
    why = "the components in UM are not determined by the others; choose others"
    t.refuse(np.array([values[-1] <= 1e-10 * values[0]]), why)
    value = -np.linalg.solve(block, A)
    value[:, np.isin(used, chosen)] = 0.0
    column = np.broadcast_to(used, value.shape)
    return in_full(t.take(np.zeros(count, dtype=np.int64)), chosen, column, value)


ALONG = 1e-3  # least part of the dependent component along a rod


def rbe2(m: Mesh) -> Equations:
    t = m.rows("RBE2")
    moved = components(t["CM"])
    t.refuse(~moved.any(axis=1), "CM names no component; allowed are the digits 1 to 6")
    each = t.take(t.ragged("GM").owner)
    gn = each.nodes("GN")[:, 0]
    gm = each.nodes_of(t.ragged("GM").values)
    each.refuse(gn == gm, "GRID {} is its own dependent node", each["GN"])
    of = t.ragged("GM").owner
    rigid_arm = arm(m.xyz[gm] - m.xyz[gn])
    return _interpolated(each, gm, flags=moved[of], by=((gn, rigid_arm),))


def rbe1(m: Mesh) -> Equations:
    t = m.rows("RBE1")
    n, d = (
        (
            t.ragged(f"G{kind}").owner,
            t.ragged(f"G{kind}").values,
            t.ragged(f"C{kind}").values,
        )
        for kind in "NM"
    )
    return rigid(t, (*n[:2], components(n[2])), (*d[:2], components(d[2])))


def rrod(m: Mesh) -> Equations:
    """a·(u_B − u_A) = 0 along the line, solved for the one translation that CMA or CMB names."""
    t = m.rows("RROD")
    node = t.nodes("GA", "GB")
    named = np.stack([components(t["CMA"]), components(t["CMB"])], axis=1)
    one = (named.sum(axis=(1, 2)) == 1) & ~named[:, :, 3:].any(axis=(1, 2))
    t.refuse(
        ~one, "CMA or CMB must name one translation, 1 to 3, and the other be blank"
    )
    x = m.xyz[node]
    t.refuse((x[:, 0] == x[:, 1]).all(axis=1), "its two ends are at one place")
    axis = segment(x)[1]
    along = np.einsum("nkij,nj->nki", m.cd[node], axis) * np.array([-1.0, 1.0])[:, None]
    column = (6 * node[:, :, None] + np.arange(3)).reshape(-1, 6)
    along = along.reshape(-1, 6)
    chosen = named[:, :, :3].reshape(-1, 6)
    lead = along[chosen]
    component = np.nonzero(chosen)[1] % 3 + 1
    why = "component {} is across the rod; name one along it"
    t.refuse(np.abs(lead) < ALONG, why, component)
    value = np.where(chosen, 0.0, -along / lead[:, None])
    return in_full(t, column[chosen], column, value)


Fields = tuple[str, ...]
# Nodes, the fields of their independent components, and the fields of the dependent ones of the
# last of them. Without the first all six of the first node are independent, and each blank field
# stands for six that are dependent; else all that are not independent are, where all are blank.
BODIES: Mapping[str, tuple[Fields, Fields, Fields]] = {
    "RBAR": (("GA", "GB"), ("CNA", "CNB"), ("CMA", "CMB")),
    "RBAR1": (("GA", "GB"), (), ("CB",)),
    "RJOINT": (("GA", "GB"), (), ("CB",)),  # what CB leaves out is the joint
    "RTRPLT": (("GA", "GB", "GC"), ("CNA", "CNB", "CNC"), ("CMA", "CMB", "CMC")),
    "RTRPLT1": (("GA", "GB", "GC"), (), ("CMB", "CMC")),
}


def _body(m: Mesh, card: str) -> Equations:
    """A rigid body on two or three nodes."""
    ends, free, bound = BODIES[card]
    t = m.rows(card)
    of = np.repeat(np.arange(len(t)), len(ends))
    ids = t.stack(*ends).reshape(-1)
    independent = np.zeros((len(t), len(ends), 6), dtype=bool)
    dependent = np.zeros_like(independent)
    for k, name in enumerate(free):
        independent[:, k] = components(t[name])
    for k, name in enumerate(bound, len(ends) - len(bound)):
        dependent[:, k] = components(t[name])
    independent[~independent.any(axis=(1, 2)), 0] = True
    if free:
        blank = ~dependent.any(axis=(1, 2))
        dependent[blank] = ~independent[blank]
    else:
        dependent[:, 1:][~dependent[:, 1:].any(axis=2)] = True
    return rigid(
        t, (of, ids, independent.reshape(-1, 6)), (of, ids, dependent.reshape(-1, 6))
    )


def rspline(m: Mesh) -> Equations:
    """Nodes interpolated by a chain of straight beams between two that are independent.

    The chain is a thin tube of diameter D, DL times the length of the whole spline: EI = GJ = 1, EA
    = 8/D² (as in NASTRAN-95, CRSPLINE). Its flexibility between the ends 1 and N, added up from 1
    in the basic frame, is C_N; that up to node i is C_i: u_i = R_i [u_1 + C_i C_N⁻¹ (R_N⁻¹ u_N −
    u_1)], R the rigid motion by that of node 1. Components that are not dependent at a node between
    do not count for the others.
    """
    t = m.rows("RSPLINE")
    G = t.ragged("G")
    t.refuse(G.sizes < 2, "it must have two nodes or more")
    flags = components(t.ragged("C").values)
    of = G.owner
    each = t.take(of)
    node = each.nodes_of(G.values)
    end = np.asarray(~flags.any(axis=1))
    outer = end[G.offsets[:-1]] & end[G.offsets[1:] - 1]
    t.refuse(
        ~outer, "its first and last nodes are independent: give them no components"
    )
    # of the section that begins there
    first = np.flatnonzero(end & (np.r_[of[1:], -1] == of))
    # a node that ends one belongs to the next, if any
    section = np.cumsum(np.isin(np.arange(of.size), first)) - 1
    last = np.flatnonzero(end & (np.r_[-1, of[:-1]] == of))
    x = m.xyz[node]
    link = np.flatnonzero(of[1:] == of[:-1])
    C = np.zeros((of.size, 6, 6))  # flexibility of the section's beams up to this node
    # the section of each link is that of its first node
    C[link + 1] = _tubes(t, x, of=of, link=link, origin=x[first[section[link]]])
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
    by = ((node[a], by_first), (node[b], by_last))
    return _interpolated(each.take(inner), node[inner], flags=flags[inner], by=by)


def _tubes(t: CardRows, x: Float, of: Int, link: Int, origin: Float) -> Float:
    """Flexibility (k, 6, 6) of the beams from node `link` (k,) to the next, moved to `origin` (k,
    3).
    """
    ends = np.stack([x[link], x[link + 1]], axis=1)
    d = ends[:, 1] - ends[:, 0]
    L = np.linalg.norm(d, axis=1)
    t.take(of[link]).refuse(L == 0, "two nodes that follow each other are at one place")
    D = (t["DL"] * np.bincount(of[link], L, len(t)))[of[link]]
    turn = scaled(L, np.eye(3))
    shift = scaled(L**3 / 12, np.eye(3))
    shift = shift + scaled(D**2 / (8 * L) - L / 12, np.einsum("ki,kj->kij", d, d))
    f = scatter(link.size, 6, ([0, 1, 2], shift), ([3, 4, 5], turn))
    return congruent(arm(origin - ends.mean(axis=1)).swapaxes(1, 2), f)


def _interpolated(
    t: CardRows, node: Int, flags: Bool, by: Sequence[tuple[Int, Float]]
) -> Equations:
    """Components `flags` (k, 6) of nodes (k,) by the motions of others, each (node (k,), matrix (k,
    6, 6)) in basic.
    """
    m = t.mesh
    entry, c = np.nonzero(flags)
    mine = rotation(m.cd[node], 1)
    columns = []
    values = []
    for other, A in by:
        local = mine @ A @ rotation(m.cd[other], 1).swapaxes(1, 2)
        columns.append(node_dofs(other[entry][:, None]))
        values.append(local[entry, c])
    column = np.concatenate(columns, axis=1)
    value = np.concatenate(values, axis=1)
    return in_full(t.take(entry), 6 * node[entry] + c, column, value)


def _piercing(
    m: Mesh, card: str, ends: Callable[[CardRows], Sequence[End]]
) -> Equations:
    """GA and GB of welds on patches (CWELD) and of fasteners (CFAST), which follow their patch or
    surface; one that is itself a corner is left alone.
    """
    t = m.rows(card)
    t = t.take((t["TYPE"] != "ALIGN") & (t.stack("GA", "GB") > 0).any(axis=1))
    parts = []
    for name, end in zip(("GA", "GB"), ends(t) if len(t) else (), strict=False):
        given = np.flatnonzero(t[name] > 0)
        node = t.take(given).nodes(name)
        free = given[~(end.nodes[given] == node).any(axis=1)]
        corners = end.nodes[free]
        there = corners >= 0
        by = []
        for k in range(corners.shape[1]):
            follow = end.follow[free][:, :, 6 * k : 6 * k + 6]
            corner = np.where(there[:, k], corners[:, k], corners[:, 0])
            by.append((corner, np.where(there[:, k, None, None], follow, 0.0)))
        some = t.take(free)
        flags = np.ones((free.size, 6), dtype=bool)
        parts.append(_interpolated(some, some.nodes(name)[:, 0], flags=flags, by=by))
    return joined(parts)


RIGID: Mapping[str, Callable[[Mesh], Equations]] = {
    **{card: partial(_body, card=card) for card in BODIES},
    "RBE1": rbe1,
    "RBE2": rbe2,
    "RBE3": rbe3,
    "RROD": rrod,
    "RSPLINE": rspline,
    "CWELD": partial(_piercing, card="CWELD", ends=fasteners.weld_ends),
    "CFAST": partial(_piercing, card="CFAST", ends=fasteners.fastener_ends),
}
