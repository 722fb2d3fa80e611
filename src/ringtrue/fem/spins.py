"""Spins: lines of bars and rods that turn about themselves with neither stiffness nor mass.

A straight chain of CBARs has torsional stiffness and no inertia about its line (MSC Nastran Quick Reference Guide,
CBAR), so that K - σM is singular wherever nothing holds the chain against turning. One degree of freedom of such a
chain may be held: it takes away no mode, and no mode can tell at which angle the chain stands.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.fem.assembly import System
from ringtrue.model.model import Model

log = logging.getLogger(__name__)
LINES = {"CBAR": ("GA", "GB"), "CROD": ("G1", "G2"), "CONROD": ("G1", "G2"), "CTUBE": ("G1", "G2")}
NOTHING = 1e-10  # share of the turns' whole energy, and of their whole inertia


def spins(model: Model, system: System) -> Int:
    """Free DOFs (k,), rows of the system, one a spin: the one that turns most with it.

    Turned together about one axis, the nodes of a chain that are joined by rotational stiffness take no energy and
    have no inertia.
    """
    ends = [model[card][name] for card, names in LINES.items() if card in model for name in names]
    none: Int = np.empty(0, dtype=np.int64)
    turning = np.abs(system.free.direction) >= 4
    at = np.flatnonzero(turning & np.isin(system.free.node, np.concatenate([none, *ends])))
    if not at.size:
        return none
    K, M = (A[at][:, at] for A in (system.stiffness, system.mass))
    count, label = connected_components(K, directed=False)
    chain: Int = label.astype(np.int64)
    R = _turns(system, at)
    energy, inertia = (_shares(R, A, chain, count) for A in (K, M))
    values, axes = np.linalg.eigh(energy + inertia)
    moved = np.abs(np.einsum("ia,iab->ib", R, axes[chain]))
    found = []
    for k in range(3):  # the three axes of a chain
        free = np.flatnonzero((values[chain, k] < NOTHING) & (moved[:, k] > 0))
        order = free[np.lexsort((free, -moved[free, k], chain[free]))]
        found.append(order[np.unique(chain[order], return_index=True)[1]])
    return at[np.unique(np.concatenate(found))]


def _turns(system: System, at: Int) -> Float:
    """Unit turns of all nodes about the axes of basic, without shifts, in rows `at` of the free DOFs: (k, 3)."""
    full = np.zeros((len(system.dofs), 3))
    for a in range(3):
        full[3 + a : 6 * len(system.xyz) : 6, a] = 1.0
    return np.asarray(system.local[at] @ full)


def _shares(R: Float, A: sparse.csr_array, chain: Int, count: int) -> Float:
    """RᵀAR of each chain, (count, 3, 3), in shares of what its terms would be without their signs."""
    AR, whole = np.asarray(A @ R), np.einsum("ia,ia->i", np.abs(R), np.asarray(abs(A) @ np.abs(R)))
    size = np.bincount(chain, whole, count)
    out = np.zeros((count, 3, 3))
    np.add.at(out, chain, R[:, :, None] * AR[:, None, :])
    return np.asarray(out / np.where(size > 0, size, 1.0)[:, None, None])


def without_spins(model: Model, system: System) -> tuple[System, DofSet]:
    """The system with its spins held, and the DOFs that hold them; not so under PARAM,AUTOSPC,NO."""
    rows = np.empty(0, dtype=np.int64)
    if str(model.params.get("AUTOSPC", "YES")).upper() != "NO":
        rows = spins(model, system)
    held = DofSet(system.free.node[rows], system.free.direction[rows])
    if not rows.size:
        return system, held
    log.info("held against spinning without stiffness and mass: %s", " ".join(held.labels()))
    keep = np.setdiff1d(np.arange(len(system.free)), rows)
    made = replace(
        system,
        **{n: getattr(system, n)[keep][:, keep] for n in ("stiffness", "mass", "viscous", "structural")},
        transform=system.transform[:, keep],
        local=system.local[keep],
        free=DofSet(system.free.node[keep], system.free.direction[keep]),
    )
    return made, held
