"""Systems condensed as a deck asks for it: static condensation of Guyan (1965) and component modes
of Craig and Bampton (1968), component by component.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Int
from ringtrue.core.dofs import DofSet
from ringtrue.fem.assembly import System, assemble, reduced
from ringtrue.fem.massless_rotations import without_massless_rotations
from ringtrue.model.model import ComponentModes, Model
from ringtrue.model.superelements import (
    KEPT,
    OMITTED,
    component_modes,
    condenses,
    listed_dofs,
)
from ringtrue.reduction.static import craig_bampton

log = logging.getLogger(__name__)


def free_system(model: Model) -> tuple[System, DofSet]:
    """The assembled system of the whole mesh with its spins held, and the DOFs that hold them."""
    return without_massless_rotations(model, assemble(model))


def condensed(model: Model, system: System) -> System:
    """The system as Nastran solves it for modes: superelements first, then the residual structure.

    Raises
    ------
    SingularModel
        If the omitted DOFs of a component can move while the others are held.
    """
    if not condenses(model):
        return system
    seid = model["GRID"]["SEID"]
    parts = {part.number: part for part in model.superelements}
    for number in np.unique(seid[seid > 0]).tolist():
        inner = np.isin(system.free.node, model["GRID"].ids[seid == number])
        modes = parts[number].modes if number in parts else ComponentModes()
        system = _without(system, inner, modes, f"superelement {number}")
    modes = component_modes(model)
    inner = _omitted(model, system.free, modes.modal)
    return _without(system, inner, modes, "the residual structure")


def _omitted(model: Model, free: DofSet, modal: DofSet) -> Bool:
    """Free DOFs (f,) of the residual structure that are condensed: all that ASET does not name
    where it is given, else those of OMIT.
    """
    kept = listed_dofs(model, KEPT)
    if len(kept) or len(modal):
        named = np.concatenate([kept.key, modal.key])
        return ~np.isin(free.key, named)
    return np.isin(free.key, listed_dofs(model, OMITTED).key)


def _without(system: System, inner: Bool, modes: ComponentModes, name: str) -> System:
    """The system with the inner DOFs (f,) of a component condensed onto the DOFs around them."""
    inside = np.flatnonzero(inner)
    if not inside.size:
        return system
    kept = np.flatnonzero(~inner)
    touched = np.zeros(inner.size, dtype=bool)
    for A in (system.stiffness, system.mass):
        touched[A[inside].indices] = True
    around = kept[touched[kept]]
    block = np.concatenate([inside, around])
    K, M = (A[block][:, block] for A in (system.stiffness, system.mass))
    boundary = np.arange(inside.size, block.size)
    labels = system.free.take(block).named
    part = craig_bampton(K, M, boundary, modes.count, labels=labels)
    found = int((part.frequencies <= modes.highest).sum())
    log.info(
        "%s: %d DOFs condensed onto %d and %d component modes",
        name,
        inside.size,
        around.size,
        found,
    )
    columns = np.concatenate([np.searchsorted(kept, around), kept.size + np.arange(found)])
    select = sparse.coo_array(
        (np.ones(kept.size), (kept, np.arange(kept.size))),
        shape=(inner.size, kept.size + found),
    )
    inner_rows = sparse.coo_array(part.transform[: inside.size, : around.size + found])
    motion = sparse.coo_array(
        (inner_rows.data, (inside[inner_rows.row], columns[inner_rows.col])), shape=select.shape
    )
    T = sparse.csr_array(select + motion)
    return _projected(system, T, kept, modes.modal.take(np.arange(found)))


def _projected(system: System, T: sparse.csr_array, kept: Int, modal: DofSet) -> System:
    """The system on other coordinates x = T y: kept ones and, behind them, modal ones."""
    rows = system.dofs.find(modal.node, modal.direction)
    size = len(system.dofs)
    place = (rows, kept.size + np.arange(len(modal)))
    at_points = sparse.coo_array((np.ones(len(modal)), place), shape=(size, T.shape[1]))
    pick = sparse.coo_array(
        (np.ones(len(modal)), (np.arange(len(modal)), rows)), shape=(len(modal), size)
    )
    held = ~np.isin(system.autospc.key, modal.key)
    return replace(
        system,
        stiffness=reduced(T, system.stiffness),
        mass=reduced(T, system.mass),
        viscous=reduced(T, system.viscous),
        structural=reduced(T, system.structural),
        transform=sparse.csr_array(system.transform @ T + at_points),
        local=sparse.csr_array(sparse.vstack([system.local[kept], pick])),
        free=system.free.take(kept).joined(modal),
        autospc=system.autospc.take(held),
    )
