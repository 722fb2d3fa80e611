"""Assembly: a model to sparse matrices over its free degrees of freedom."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.fem.algebra import arm
from ringtrue.fem.constraints import eliminate, singular_dofs
from ringtrue.fem.kinds import batches, refuse
from ringtrue.fem.mesh import Matrices, Mesh, mesh
from ringtrue.model.model import Model

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """K (1 + ...) x + i S x + B ẋ + M ẍ over the free DOFs; nothing is added to hold a DOF, it is eliminated.

    Attributes
    ----------
    stiffness, mass, viscous : (f, f) csr float64, symmetric, both halves stored
    structural : (f, f) csr float64
        Imaginary part of the stiffness: Σ g_e K_e + PARAM,G K.
    transform : (full, f) csr float64
        Motion of every node in the basic frame from that of the free DOFs.
    local : (f, full) csr float64
        Picks the free DOFs, in their displacement frames, from a full motion in basic; `local @ transform` = 1.
    dofs : DofSet
        The full DOFs: six a GRID in the order of the cards, basic frame, then the scalar points.
    free : DofSet
        The free DOFs; directions are those of the node's displacement frame (CD).
    autospc : DofSet
        DOFs that were held because they have no stiffness, in the displacement frames.
    xyz : (node, 3) float64
        Basic coordinates in the order of the GRID cards.
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    viscous: sparse.csr_array
    structural: sparse.csr_array
    transform: sparse.csr_array
    local: sparse.csr_array
    dofs: DofSet
    free: DofSet
    autospc: DofSet
    xyz: Float

    def expand(self, x: Any_) -> Any_:
        """Motion of all nodes in basic, (full, ...), from that of the free DOFs (f, ...)."""
        return np.asarray(self.transform @ x)

    def rigid_body(self) -> Float:
        """Unit motions along and about the axes of basic, (f, 6) float64."""
        full = np.zeros((len(self.dofs), 6))
        full[: 6 * len(self.xyz)] = arm(self.xyz).reshape(-1, 6)
        return np.asarray(self.local @ full)


def sum_up(n: int, parts: Iterable[tuple[Int, Any_]]) -> sparse.csr_array:
    """Add element matrices: dofs (e, d), -1 for none, with values (e, d) or (e, d, d), into (n, n) csr."""
    rows, columns, values = [], [], []
    for dofs, block in parts:
        i = np.asarray(dofs, dtype=np.int32)
        j = i
        if block.ndim == 3:
            i, j = np.broadcast_arrays(i[:, :, None], i[:, None, :])
        keep = block != 0
        if dofs.min(initial=0) < 0:
            keep &= (i >= 0) & (j >= 0)
        rows.append(i[keep])
        columns.append(j[keep])
        values.append(block[keep])
    if not values:
        return sparse.csr_array((n, n))
    at = (np.concatenate(rows), np.concatenate(columns))
    return sparse.coo_array((np.concatenate(values), at), shape=(n, n)).tocsr()


def reduced(T: sparse.csr_array, A: sparse.csr_array) -> sparse.csr_array:
    """TᵀAT, exactly symmetric."""
    B = sparse.csr_array(T.T.tocsr() @ A @ T)
    return sparse.csr_array((B + B.T) * 0.5)


def full_matrices(m: Mesh, parts: list[Matrices]) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Stiffness and mass (n, n) over the full basic DOFs; PARAM,WTMASS is in the mass."""
    K = sum_up(m.size, ((p.dofs, p.stiffness) for p in parts))
    M = sum_up(m.size, ((p.dofs, p.mass) for p in parts))
    return K, sparse.csr_array(M * m.model.param("WTMASS", 1.0))


def turn(m: Mesh) -> sparse.csr_array:
    """Basic motion by motion in the displacement frames, (n, n)."""
    blocks = np.repeat(m.cd.swapaxes(1, 2), 2, axis=0)
    at = np.arange(len(blocks))
    grid = sparse.bsr_array((blocks, at, np.arange(len(blocks) + 1)), shape=(3 * len(blocks), 3 * len(blocks)))
    return sparse.csr_array(sparse.block_diag([grid, sparse.eye_array(m.scalar.size)], format="csr"))


def assemble(model: Model) -> System:
    """Assemble a model.

    Raises
    ------
    DeckError
        On a card that refers to one that is absent, a distorted element, or contradictory constraints.
    UnsupportedCard
        On a card with stiffness, mass or constraint that is not assembled.
    """
    refuse(model)
    m = mesh(model)
    parts = [build(m, card, at) for card, build, at in batches(model)]
    K, M = full_matrices(m, parts)
    T_local, free = eliminate(m)
    rotation = turn(m)
    T = sparse.csr_array(rotation @ T_local)
    stiffness = reduced(T, K)
    drop = np.zeros(free.size, dtype=bool)
    if str(model.params.get("AUTOSPC", "YES")).upper() != "NO":
        drop = singular_dofs(stiffness, free, len(m.xyz))
    keep = np.flatnonzero(~drop)
    T, stiffness = T[:, keep], stiffness[keep][:, keep]
    names = m.dofs
    held = DofSet(names.node[free[drop]], names.direction[free[drop]])
    if len(held):
        log.info("AUTOSPC: %d DOFs without stiffness are held", len(held))
    return System(
        stiffness,
        reduced(T, M),
        reduced(T, sum_up(m.size, ((p.dofs, p.viscous) for p in parts if len(p.viscous)))),
        _structural(m, T, stiffness, parts),
        T,
        sparse.csr_array(rotation.T.tocsr()[free[keep]]),
        names,
        DofSet(names.node[free[keep]], names.direction[free[keep]]),
        held,
        m.xyz,
    )


def _structural(m: Mesh, T: sparse.csr_array, stiffness: sparse.csr_array, parts: list[Matrices]) -> sparse.csr_array:
    own = []
    for p in parts:
        at = np.flatnonzero(p.loss)
        if at.size:
            own.append((p.dofs[at], p.loss[at][:, None, None] * p.stiffness[at]))
    S = reduced(T, sum_up(m.size, own))
    return sparse.csr_array(S + stiffness * m.model.param("G", 0.0))
