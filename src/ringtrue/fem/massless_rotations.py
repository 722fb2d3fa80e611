"""Spins: chains of bars, rods and springs that turn with neither stiffness nor mass.

A straight chain of CBARs has torsional stiffness and no inertia about its line (MSC Nastran Quick
Reference Guide, CBAR), as have point masses on bushes, so that K - σM is singular wherever nothing
holds the chain against turning. One degree of freedom of such a chain may be held: it takes away no
mode, and no mode can tell at which angle the chain stands.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.fem.assembly import WHOLE, Share, System
from ringtrue.model.model import Model

log = logging.getLogger(__name__)
JOINTS = {  # cards with rotational stiffness and no inertia of their own, and their nodes
    **dict.fromkeys(("CBAR", "CBEND", "CBUSH", "RBAR", "RBAR1", "RJOINT"), ("GA", "GB")),
    "RBE2": ("GN",),
    **dict.fromkeys(("CROD", "CONROD", "CTUBE", "CELAS1", "CELAS2"), ("G1", "G2")),
}
TURNS = 1e-3  # of a unit turn, that a row must move to hold it
NOTHING = 1e-10  # share of the turns' whole energy, and of their whole inertia


def massless_rotations(model: Model, system: System, share: Share = WHOLE) -> Int:
    """Free DOFs (k,), rows of the system, one a spin: the one that turns most with it.

    Turned together about one axis, the nodes of a chain that are joined by rotational stiffness
    take no energy and have no inertia.
    """
    ends = [model[card][name] for card, names in JOINTS.items() if card in model for name in names]
    none: Int = np.empty(0, dtype=np.int64)
    turning = np.abs(system.free.direction) >= 4
    at = np.flatnonzero(turning & np.isin(system.free.node, np.concatenate([none, *ends])))
    if not at.size:
        return none
    K, M = (share.total(A[at][:, at]) for A in (system.stiffness, system.mass))
    count, label = connected_components(abs(K) + abs(M), directed=False)
    chain: Int = label.astype(np.int64)
    R = _turns(system, at)
    energy, inertia = (_shares(R, A, chain, count) for A in (K, M))
    return at[_pivots(R, chain, *np.linalg.eigh(energy + inertia))]


def _pivots(R: Float, chain: Int, values: Float, axes: Float) -> Int:
    """Rows of R that hold the axes (count, 3, 3), in columns, whose values (count, 3) are nothing;
    ascending.
    """
    found = []
    for k in range(3):
        moved = np.abs(np.einsum("ia,ia->i", R, axes[chain, :, k]))
        rows = np.flatnonzero((values[chain, k] < NOTHING) & (moved > TURNS))
        rows = rows[np.lexsort((rows, -moved[rows], chain[rows]))]
        rows = rows[np.unique(chain[rows], return_index=True)[1]]
        found.append(rows)
        held = R[rows] / np.einsum("ia,ia->i", R[rows], axes[chain[rows], :, k])[:, None]
        for later in range(k + 1, 3):  # these rows stand still under the other axes then
            share = np.einsum("ia,ia->i", held, axes[chain[rows], :, later])
            axes[chain[rows], :, later] -= share[:, None] * axes[chain[rows], :, k]
    return np.sort(np.concatenate(found))


def _turns(system: System, at: Int) -> Float:
    """Unit turns of all nodes about the axes of basic, without shifts, in rows `at` of the free
    DOFs: (k, 3).
    """
    full = np.zeros((len(system.dofs), 3))
    for a in range(3):
        full[3 + a : 6 * len(system.xyz) : 6, a] = 1.0
    return system.local[at] @ full


def _shares(R: Float, A: sparse.csr_array, chain: Int, count: int) -> Float:
    """RᵀAR of each chain, (count, 3, 3), in shares of what its terms would be without their signs.

    No entry of A joins two chains.
    """
    AR = np.asarray(A @ R)
    whole = np.einsum("ia,ia->i", np.abs(R), np.asarray(abs(A) @ np.abs(R)))
    size = np.bincount(chain, whole, count)
    out = np.zeros((count, 3, 3))
    np.add.at(out, chain, R[:, :, None] * AR[:, None, :])
    return out / np.where(size > 0, size, 1.0)[:, None, None]


def without_massless_rotations(
    model: Model, system: System, share: Share = WHOLE
) -> tuple[System, DofSet]:
    """The system with its spins held, and the DOFs that hold them.

    Under PARAM,AUTOSPC,NO only DOFs that nothing uses are held, among those of `system.autospc`;
    PARAM,ASING,-1 leaves them, too, so that they are an error (MSC Nastran Quick Reference Guide,
    ASING). Of a system that is a share of the elements, by all shares together.
    """
    none: Int = np.empty(0, dtype=np.int64)
    if str(model.params.get("AUTOSPC", "YES")).upper() == "NO":
        rows = _unused(system, share) if model.param("ASING", 0.0) != -1 else none
        held = system.autospc.joined(system.free.take(rows))
        return replace(_held(system, rows), autospc=held), DofSet(none, none)
    rows = massless_rotations(model, system, share)
    held = system.free.take(rows)
    if rows.size:
        log.info("held against spinning without stiffness and mass: %s", " ".join(held.labels()))
    return _held(system, rows), held


def _unused(system: System, share: Share) -> Int:
    """Rows of the system without stiffness and mass: scalar points, components that no element
    uses.
    """
    both = (system.stiffness, system.mass)
    k, m = (share.summed(A.diagonal()) for A in both)
    rows = np.flatnonzero((k == 0) & (m == 0))
    sizes = (np.asarray(abs(A[rows]).sum(axis=1), dtype=np.float64).ravel() for A in both)
    k, m = (share.summed(size) for size in sizes)
    return np.asarray(rows[(k == 0) & (m == 0)])


def _held(system: System, rows: Int) -> System:
    """The system without the free DOFs `rows` (k,)."""
    if not rows.size:
        return system
    keep = np.setdiff1d(np.arange(len(system.free)), rows)
    return replace(
        system,
        **{
            n: getattr(system, n)[keep][:, keep]
            for n in ("stiffness", "mass", "viscous", "structural")
        },
        transform=system.transform[:, keep],
        local=system.local[keep],
        free=system.free.take(keep),
    )
