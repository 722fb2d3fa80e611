"""AUTOSPC: directions in which nothing stiffens a node."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.element_cards import SHELLS
from ringtrue.fem.mesh import Matrices

EPZERO = (
    1e-8  # PARAM,EPZERO: share of a node's largest stiffness below which a direction is examined
)
# of the terms of an element's stiffness at a node: what its own arithmetic may leave in a direction
ROUNDING = 1e-12
GIVEN_IN_DIGITS = (
    *SHELLS,
    "CSHEAR",
    "GENEL",
)  # their zeros are as good as the digits of coordinates or entries
_AT_ONCE = 512  # elements whose nodes are judged at once

Part = tuple[str, Int, Matrices]


def singular_dofs(
    K: sparse.csr_array,
    free: Int,
    nodes: int,
    T: sparse.csr_array,
    parts: Iterator[Part],
    direct: sparse.csr_array | None = None,
    tolerance: float = EPZERO,
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
    parts : iterator of (card, rows, Matrices)
        The elements, in basic; taken from only where a block is weak.
    direct : (n, n) csr, optional
        Stiffness that is given as a matrix (K2GG), in basic.
    tolerance : float
        PARAM,EPZERO.
    """
    group = np.where(free < 6 * nodes, free // 3, free - 4 * nodes)
    place = np.where(free < 6 * nodes, free % 3, 0)
    count = int(group.max(initial=-1)) + 1
    blocks = _blocks(K, group, place, count)
    there = np.zeros((count, 3), dtype=bool)
    there[group, place] = True
    size = np.abs(blocks).max(axis=(1, 2), initial=0.0)
    empty = there & (size == 0)[:, None]
    held = _weak(blocks / np.where(size == 0, 1.0, size)[:, None, None], there & ~empty, tolerance)
    doubtful = np.flatnonzero(held.any(axis=1))
    if doubtful.size:
        columns = np.flatnonzero(np.isin(group, doubtful))
        stiffened = _stiffened(
            sparse.csr_array(T[:, columns]),
            np.searchsorted(doubtful, group[columns]),
            place[columns],
            count=doubtful.size,
            parts=parts,
            direct=direct,
            tolerance=tolerance,
        )
        stiff = stiffened.any(axis=(1, 2))
        held[doubtful[stiff]] = _weak(stiffened[stiff], there[doubtful[stiff]], tolerance)
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
        weak = np.flatnonzero((np.abs(values[at, least]) < tolerance) & live.any(axis=1))
        if not weak.size:
            break
        out[weak, np.abs(vectors[weak, :, least[weak]]).argmax(axis=1)] = True
    return out


def _stiffened(
    S: sparse.csr_array,
    group: Int,
    place: Int,
    count: int,
    parts: Iterator[Part],
    direct: sparse.csr_array | None,
    tolerance: float,
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
    out = np.zeros((count, 3, 3))
    moved = np.diff(S.indptr) > 0
    for card, _, part in parts:
        used = (part.dofs >= 0) & moved[part.dofs]
        touching = np.flatnonzero(used.any(axis=1) & part.stiffness.any(axis=(1, 2)))
        share = tolerance if card in GIVEN_IN_DIGITS else ROUNDING
        for first in range(0, touching.size, _AT_ONCE):
            at = touching[first : first + _AT_ONCE]
            owner, of, G = _motions(S, group, place, np.where(used[at], part.dofs[at], -1))
            k = part.stiffness[at[of]]
            A = np.einsum("pia,pij,pjb->pab", G, k, G, optimize=True)
            terms = np.einsum("pia,pij,pja->pa", np.abs(G), np.abs(k), np.abs(G), optimize=True)
            np.add.at(out, owner, _projectors(A, terms.max(axis=1), share))
    if direct is not None:
        A = _blocks(sparse.csr_array(S.T @ direct @ S), group, place, count)
        terms = _blocks(sparse.csr_array(abs(S).T @ abs(direct) @ abs(S)), group, place, count)
        out += _projectors(A, np.einsum("gaa->ga", terms).max(axis=1), tolerance)
    return out


def _motions(S: sparse.csr_array, group: Int, place: Int, dofs: Int) -> tuple[Int, Int, Float]:
    """The groups that touch elements of `dofs` (e, d): group (p,), element (p,), motion of its DOFs
    by it (p, d, 3).
    """
    element, i = np.nonzero(dofs >= 0)
    rows = S[dofs[element, i]].tocoo()
    many = np.int64(group.max(initial=0) + 1)
    pairs, pair = np.unique(element[rows.row] * many + group[rows.col], return_inverse=True)
    G = np.zeros((pairs.size, dofs.shape[1], 3))
    G[pair, i[rows.row], place[rows.col]] = rows.data
    return pairs % many, pairs // many, G


def _projectors(A: Any_, size: Float, share: float) -> Float:
    """Projectors (p, 3, 3) on the directions in which blocks A (p, 3, 3) exceed a share of their
    terms' size (p,).
    """
    values, vectors = np.linalg.eigh(A)
    firm = np.abs(values) > share * size[:, None]
    return np.asarray(np.einsum("pak,pk,pbk->pab", vectors, firm.astype(np.float64), vectors))
