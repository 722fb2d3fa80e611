"""RBE3: the weighted mean motion of nodes."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.algebra import arm, rotation
from ringtrue.fem.equations import ROUNDING, Equations, listed, owners
from ringtrue.fem.mesh import Mesh, error
from ringtrue.fem.place import components, node_dofs
from ringtrue.model.model import Table


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
    inverse = _inverse(m, t, normal, 1 / scale)
    X = rotation(m.cd[ref[of]], 1) @ inverse[of] @ S.swapaxes(1, 2) * W[:, None, :]
    eq = _spread(m, t, X, of, g, ref)
    given = "GM" in t.columns and t.ragged("GM").values.size
    return _resolved(m, t, eq, np.nonzero(components(t["REFC"]))[0]) if given else eq


def _mean_arm(of: Int, g: Int, arms: Float, count: int) -> Float:
    """Mean length of the arms (k, 3) of each element (count,), a node in several groups once; 1
    without any.
    """
    once = np.unique(np.stack([of, g]), axis=1, return_index=True)[1]
    total = np.bincount(of[once], np.linalg.norm(arms[once], axis=1), count)
    return np.where(total == 0, 1.0, total / np.maximum(np.bincount(of[once], minlength=count), 1))


def _inverse(m: Mesh, t: Table, normal: Float, scale: Float) -> Float:
    """Inverse of the normal matrices; a motion that the nodes do not determine must not be asked
    for.
    """
    A = normal * scale[:, :, None] * scale[:, None, :]
    plus = np.linalg.pinv(A, rcond=1e-10, hermitian=True)
    lost = np.abs(np.einsum("eij,eji->ei", plus, A) - 1) > 1e-6
    bad = (lost & components(t["REFC"])).any(axis=1)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise error(
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
        6 * ref[element] + c, row[keep], column[keep], X.reshape(-1)[keep], owners(t, element)
    )


def _resolved(m: Mesh, t: Table, eq: Equations, of: Int) -> Equations:
    """The equations (owner `of` (k,)) of cards with UM, solved for the DOFs that UM names."""
    gm = t.ragged("GM")
    at, node, c = listed(m, t, (gm.owner, gm.values, components(t.ragged("CM").values)))
    wanted, there = np.bincount(at, minlength=len(t)), np.bincount(of, minlength=len(t))
    wrong = (wanted > 0) & (wanted != there)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise error(
            m.model,
            t,
            i,
            f"UM names {wanted[i]} components; allowed are as many as REFC has, {there[i]}",
        )
    rows = np.flatnonzero(wanted[of] > 0)
    chosen, k = 6 * node + c, rows.size
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
        raise error(
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
