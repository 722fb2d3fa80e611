"""Rigid elements, multipoint equations and supports as one sparse elimination, in the displacement
frames.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import DeckError
from ringtrue.fem.constraint_equations import Equations, owners
from ringtrue.fem.mesh import Mesh, components
from ringtrue.fem.rigid_elements import RIGID
from ringtrue.model.case_control import taken_sets
from ringtrue.model.model import Table, called, card_error


def _mpc(m: Mesh) -> Equations:
    t = m.model["MPC"]
    rows = np.flatnonzero(np.isin(t["SID"], taken_sets(m.model, "MPC")))
    G, C, A = (t.ragged(c) for c in "GCA")
    of = G.owner
    use = np.isin(of, rows)
    dof = np.full(of.size, -1)
    dof[use] = m.dof(G.values[use], C.values[use].astype(np.int64), t, of[use])
    first = np.zeros(of.size, dtype=bool)
    first[G.offsets[:-1][G.sizes > 0]] = True
    lead = A.values[G.offsets[:-1]]
    if (lead[rows] == 0).any():
        raise card_error(
            m.model,
            t,
            int(rows[lead[rows] == 0][0]),
            "the first coefficient is 0; it names the dependent DOF",
        )
    number = np.full(len(t), -1)
    number[rows] = np.arange(rows.size)
    rest = use & ~first
    value = -A.values[rest] / lead[of[rest]]
    return Equations(
        dependent=dof[use & first],
        row=number[of[rest]],
        column=dof[rest],
        value=value,
        owner=owners(t, rows),
    )


def equations(m: Mesh) -> Equations:
    """All dependent DOFs of the chosen sets."""
    parts = [read(m) for card, read in RIGID.items() if card in m.model]
    parts += [_mpc(m)] if "MPC" in m.model and m.model.case.mpc else []
    shift = np.cumsum([0, *(p.dependent.size for p in parts)])
    none: Int = np.empty(0, dtype=np.int64)
    return Equations(
        dependent=np.concatenate([none, *(p.dependent for p in parts)]),
        row=np.concatenate([none, *(p.row + s for p, s in zip(parts, shift, strict=False))]),
        column=np.concatenate([none, *(p.column for p in parts)]),
        value=np.concatenate([np.empty(0), *(p.value for p in parts)]),
        owner=tuple(name for p in parts for name in p.owner),
    )


def supports(m: Mesh) -> Bool:
    """Which full DOFs are held, (n,): PS of GRID, and SPC, SPC1 of the chosen set."""
    held = np.zeros(m.size, dtype=bool)
    grid = m.model["GRID"]
    if "PS" in grid.columns:
        held[: 6 * len(grid)] |= components(grid["PS"]).reshape(-1)
    sids = taken_sets(m.model, "SPC")
    if "SPC" in m.model:
        t = m.model["SPC"]
        at = np.flatnonzero(np.isin(t["SID"], sids))
        _hold(m, held, t, at=at, nodes=t["G"][at], text=t["C"][at])
    if "SPC1" in m.model:
        t = m.model["SPC1"]
        of = t.ragged("G").owner
        at = np.flatnonzero(np.isin(t["SID"][of], sids))
        _hold(m, held, t, at=of[at], nodes=t.ragged("G").values[at], text=t["C"][of[at]])
    return held


def _hold(m: Mesh, held: Bool, t: Table, at: Int, nodes: Int, text: Float) -> None:
    scalar = np.isin(nodes, m.scalar)
    held[m.dof(nodes[scalar], np.zeros(int(scalar.sum()), dtype=np.int64), t, at[scalar])] = True
    rows = m.nodes(nodes[~scalar], t, at[~scalar])
    i, c = np.nonzero(components(text[~scalar]))
    held[6 * rows[i] + c] = True


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
