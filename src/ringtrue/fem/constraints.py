"""Rigid elements, multipoint equations and supports as one sparse elimination, in the displacement
frames.

AUTOSPC: directions in which nothing stiffens a node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.element_cards import SHELLS
from ringtrue.fem.mesh import ElementMatrices, Mesh, components
from ringtrue.fem.rigid_elements import RIGID, Equations, joined, owners
from ringtrue.model.case_control import taken_sets
from ringtrue.model.model import called, card_error

# PARAM,EPZERO: share of a node's largest stiffness below which a direction is examined
EPZERO = 1e-8
# of the terms of an element's stiffness at a node: what its own arithmetic may leave in a direction
ROUNDING = 1e-12
# their zeros are as good as the digits of coordinates or entries
GIVEN_IN_DIGITS = (*SHELLS, "CSHEAR", "GENEL")
_AT_ONCE = 512  # elements whose nodes are judged at once

Part = tuple[str, Int, ElementMatrices]


@dataclass(frozen=True, slots=True, eq=False)
class Stiffening:
    """What stiffens the nodes.

    Attributes
    ----------
    parts : iterator of (card, rows, ElementMatrices)
        The elements, in basic.
    direct : (n, n) csr, optional
        Stiffness that is given as a matrix (K2GG), in basic.
    tolerance : float
        PARAM,EPZERO.
    summed : callable
        Of `share.Share`, where parts and K are a share of the elements.
    """

    parts: Iterator[Part]
    direct: sparse.csr_array | None = None
    tolerance: float = EPZERO
    summed: Callable[[Float], Float] = np.asarray


def singular_dofs(
    K: sparse.csr_array,
    free: Int,
    nodes: int,
    T: sparse.csr_array,
    stiffening: Stiffening,
) -> Bool:
    """DOFs (k,) of K (k, k) that have no stiffness.

    Each node's 3 x 3 block of translations, or of rotations, is examined; for each direction in
    which it is singular the DOF nearest to it is named. Where the block is weak against its largest
    term, the elements at the node are asked one by one: a direction is singular if no element
    stiffens it, each judged by its own stiffness there. A stiff spring in one direction thus says
    nothing of the others.

    Parameters
    ----------
    K : (k, k) csr
        Stiffness over the free DOFs.
    free : (k,) int64
        The full DOF of each.
    nodes : int
        How many GRID there are; six full DOFs each come before those of the scalar points.
    T : (n, k) csr
        Full motion in basic by that of the free DOFs.
    stiffening : Stiffening
        Asked only where a block is weak.
    """
    tolerance = stiffening.tolerance
    group = np.where(free < 6 * nodes, free // 3, free - 4 * nodes)
    place = np.where(free < 6 * nodes, free % 3, 0)
    count = int(group.max(initial=-1)) + 1
    blocks = stiffening.summed(_blocks(K, group, place, count))
    there = np.zeros((count, 3), dtype=bool)
    there[group, place] = True
    size = np.abs(blocks).max(axis=(1, 2), initial=0.0)
    empty = there & (size == 0)[:, None]
    held = _weak(
        blocks / np.where(size == 0, 1.0, size)[:, None, None],
        there & ~empty,
        tolerance,
    )
    doubtful = np.flatnonzero(held.any(axis=1))
    if doubtful.size:
        columns = np.flatnonzero(np.isin(group, doubtful))
        stiffened = _stiffened(
            sparse.csr_array(T[:, columns]),
            np.searchsorted(doubtful, group[columns]),
            place[columns],
            count=doubtful.size,
            stiffening=stiffening,
        )
        stiffened = stiffening.summed(stiffened)
        stiff = stiffened.any(axis=(1, 2))
        held[doubtful[stiff]] = _weak(
            stiffened[stiff], there[doubtful[stiff]], tolerance
        )
    return np.asarray((empty | held)[group, place])


def _blocks(A: sparse.csr_array, group: Int, place: Int, count: int) -> Float:
    """The 3 x 3 blocks (count, 3, 3) of groups of A's rows."""
    coo = A.tocoo()
    inside = group[coo.row] == group[coo.col]
    r = coo.row[inside]
    c = coo.col[inside]
    out = np.zeros((count, 3, 3))
    out[group[r], place[r], place[c]] = coo.data[inside]
    return out


def _weak(blocks: Float, there: Bool, tolerance: float) -> Bool:
    """Components (g, 3) nearest to the directions in which blocks (g, 3, 3), of size 1, are weak;
    of those there.
    """
    out = np.zeros_like(there)
    for _ in range(3):  # a block has three directions
        live = there & ~out
        A = np.where(live[:, :, None] & live[:, None, :], blocks, 0.0)
        A[~live[:, :, None] & np.eye(3, dtype=bool)] = 4.0
        values, vectors = np.linalg.eigh(A)
        least = np.abs(values).argmin(axis=1)
        at = np.arange(len(A))
        weak = np.flatnonzero(
            (np.abs(values[at, least]) < tolerance) & live.any(axis=1)
        )
        if not weak.size:
            break
        out[weak, np.abs(vectors[weak, :, least[weak]]).argmax(axis=1)] = True
    return out


def _stiffened(
    S: sparse.csr_array,
    group: Int,
    place: Int,
    count: int,
    stiffening: Stiffening,
) -> Float:
    """How often each direction of groups is stiffened, (count, 3, 3): the sum of the elements'
    projectors.

    Parameters
    ----------
    S : (n, c) csr
        Full motion by that of the DOFs of the groups.
    group, place : (c,) int64
        Where each of these DOFs stands.
    """
    direct, tolerance = stiffening.direct, stiffening.tolerance
    out = np.zeros((count, 3, 3))
    moved = np.diff(S.indptr) > 0
    for card, _, part in stiffening.parts:
        used = (part.dofs >= 0) & moved[part.dofs]
        touching = np.flatnonzero(used.any(axis=1) & part.stiffness.any(axis=(1, 2)))
        share = tolerance if card in GIVEN_IN_DIGITS else ROUNDING
        for first in range(0, touching.size, _AT_ONCE):
            at = touching[first : first + _AT_ONCE]
            owner, of, G = _motions(
                S, group, place, np.where(used[at], part.dofs[at], -1)
            )
            k = part.stiffness[at[of]]
            A = np.einsum("pia,pij,pjb->pab", G, k, G, optimize=True)
            terms = np.einsum(
                "pia,pij,pja->pa", np.abs(G), np.abs(k), np.abs(G), optimize=True
            )
            np.add.at(out, owner, _projectors(A, terms.max(axis=1), share))
    if direct is not None:
        A = _blocks(sparse.csr_array(S.T @ direct @ S), group, place, count)
        terms = _blocks(
            sparse.csr_array(abs(S).T @ abs(direct) @ abs(S)), group, place, count
        )
        out += _projectors(A, np.einsum("gaa->ga", terms).max(axis=1), tolerance)
    return out


def _motions(
    S: sparse.csr_array, group: Int, place: Int, dofs: Int
) -> tuple[Int, Int, Float]:
    """The groups that touch elements of `dofs` (e, d): group (p,), element (p,), motion of its DOFs
    by it (p, d, 3).
    """
    element, i = np.nonzero(dofs >= 0)
    rows = S[dofs[element, i]].tocoo()
    many = np.int64(group.max(initial=0) + 1)
    pairs, pair = np.unique(
        element[rows.row] * many + group[rows.col], return_inverse=True
    )
    G = np.zeros((pairs.size, dofs.shape[1], 3))
    G[pair, i[rows.row], place[rows.col]] = rows.data
    return pairs % many, pairs // many, G


def _projectors(A: Any_, size: Float, share: float) -> Float:
    """Projectors (p, 3, 3) on the directions in which blocks A (p, 3, 3) exceed a share of their
    terms' size (p,).
    """
    values, vectors = np.linalg.eigh(A)
    firm = np.abs(values) > share * size[:, None]
    return np.asarray(
        np.einsum("pak,pk,pbk->pab", vectors, firm.astype(np.float64), vectors)
    )


def _mpc(m: Mesh) -> Equations:
    """The equations of the chosen sets: the first term of each is the dependent one."""
    every = m.rows("MPC")
    t = every.take(np.isin(every["SID"], taken_sets(m.model, "MPC")))
    G, C, A = (t.ragged(c) for c in "GCA")
    of = G.owner
    dof = t.take(of).dof(G.values, C.values.astype(np.int64))
    first = G.offsets[:-1]
    lead = A.values[first]
    t.refuse(lead == 0, "the first coefficient is 0; it names the dependent DOF")
    rest = np.isin(np.arange(of.size), first, invert=True)
    return Equations(
        dependent=dof[first],
        row=of[rest],
        column=dof[rest],
        value=-A.values[rest] / lead[of[rest]],
        owner=owners(t),
    )


def equations(m: Mesh) -> Equations:
    """All dependent DOFs of the chosen sets."""
    parts = [read(m) for card, read in RIGID.items() if card in m.model]
    if "MPC" in m.model and m.model.case.mpc:
        parts.append(_mpc(m))
    return joined(parts)


def supports(m: Mesh) -> Bool:
    """Which full DOFs are held, (n,): PS of GRID, and SPC, SPC1 of the chosen set."""
    held = np.zeros(m.size, dtype=bool)
    grid = m.model["GRID"]
    if "PS" in grid.columns:
        held[: 6 * len(grid)] |= components(grid["PS"]).reshape(-1)
    sids = taken_sets(m.model, "SPC")
    for card in ("SPC", "SPC1"):
        if card not in m.model:
            continue
        ids, of = m.model[card].entries("G")
        t = m.rows(card, of)
        chosen = np.isin(t["SID"], sids)
        t = t.take(chosen)
        ids = ids[chosen]
        scalar = np.isin(ids, m.scalar)
        points = ids[scalar]
        held[t.take(scalar).dof(points, np.zeros_like(points))] = True
        node = t.take(~scalar).nodes_of(ids[~scalar])
        i, c = np.nonzero(components(t["C"][~scalar]))
        held[6 * node[i] + c] = True
    return held


def eliminate(m: Mesh) -> tuple[sparse.csr_array, Int]:
    """The map from independent DOFs that are not held to all full DOFs, both in the displacement
    frames.

    Returns
    -------
    T : (n, k) csr
    free : (k,) int64, full DOF of each column

    Raises
    ------
    DeckError
        If a DOF is dependent twice, or dependent and held, or if dependencies run in a circle.
    """
    eq = equations(m)
    held = supports(m)
    _check(m, eq, held)
    n = m.size
    k = eq.dependent.size
    dependent = np.full(n, -1)
    dependent[eq.dependent] = np.arange(k)
    free = np.flatnonzero((dependent < 0) & ~held)
    select = sparse.csr_array(
        (np.ones(free.size), (free, np.arange(free.size))), shape=(n, free.size)
    )
    if not k:
        return select, free
    full = sparse.csr_array((eq.value, (eq.row, eq.column)), shape=(k, n))
    chain = sparse.csr_array(full[:, eq.dependent])
    chain.eliminate_zeros()
    _, label = connected_components(chain, connection="strong")
    loop = np.flatnonzero((np.bincount(label)[label] > 1) | (chain.diagonal() != 0))
    if loop.size:
        raise _contradiction(
            m, eq, loop, "dependencies run in a circle: {}; make one end independent"
        )
    rows = total = sparse.csr_array(full[:, free])
    while rows.nnz and chain.nnz:  # as often as the longest chain is long
        rows = sparse.csr_array(chain @ rows)
        total = sparse.csr_array(total + rows)
    place = sparse.csr_array((np.ones(k), (eq.dependent, np.arange(k))), shape=(n, k))
    return sparse.csr_array(select + place @ total), free


def _check(m: Mesh, eq: Equations, held: Bool) -> None:
    twice = np.bincount(eq.dependent, minlength=m.size) > 1
    for bad, why in (
        (twice, "is dependent more than once"),
        (held, "is dependent and held by an SPC or PS"),
    ):
        at = np.flatnonzero(bad[eq.dependent])
        if at.size:
            label = m.dofs.labels()[eq.dependent[at[0]]]
            same = at[eq.dependent[at] == eq.dependent[at[0]]]
            raise _contradiction(m, eq, same, f"DOF {label} {why} ({{}}); release one")


def _contradiction(m: Mesh, eq: Equations, rows: Int, message: str) -> DeckError:
    """An error at the last card behind the rows (k,) of the equations, with all of them in the
    message.
    """
    cards = list(dict.fromkeys(eq.owner[i] for i in rows.tolist()))
    table, row = cards[-1]
    return card_error(m.model, table, row, message.format(called(m.model, cards)))
