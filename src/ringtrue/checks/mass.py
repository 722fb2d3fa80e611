"""Mass, centre of gravity and inertia from the assembled mass matrix and the rigid-body motions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.errors import NumericalError
from ringtrue.fem.assembly import System, assemble
from ringtrue.model.model import Model

EVEN = 1e-6  # relative difference of the masses along the three axes that is round-off


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Rigid-body mass of a model, in its units (PARAM,WTMASS applied).

    Attributes
    ----------
    mass : float
        Mean of `directional`.
    directional : (3,) float64
        Mass that moves along x, y and z of basic; they differ where masses act in one direction or
        DOFs are held.
    cg : (3,) float64
        Centre of gravity, basic frame.
    inertia : (3, 3) float64
        Inertia tensor about the centre of gravity, basic axes: off the diagonal -∫xy dm.
    """

    mass: float
    directional: Float
    cg: Float
    inertia: Float

    def __post_init__(self) -> None:
        freeze_fields(self, directional=np.float64, cg=np.float64, inertia=np.float64)

    @property
    def even(self) -> bool:
        """The same mass along all three axes."""
        return bool(np.ptp(self.directional) <= EVEN * abs(self.mass))


def mass_properties(system: System) -> MassProperties:
    """Mass properties of what is free to move: RᵀMR with the rigid-body motions R at the free DOFs.

    Mass at held DOFs does not count; assemble `unconstrained(model)` for that of the whole
    structure.

    Raises
    ------
    NumericalError
        If nothing that is free has mass.
    """
    motions = system.rigid_body()
    return from_rigid_body_mass(motions.T @ (system.mass @ motions))


def from_rigid_body_mass(rigid: Float) -> MassProperties:
    """Mass properties from the rigid-body mass matrix (6, 6) about the origin of basic.

    Raises
    ------
    NumericalError
        If it has no mass.
    """
    directional = np.diag(rigid)[:3]
    mass = float(directional.mean())
    if not mass > 0:
        raise NumericalError(f"the model has no mass: {mass:g}; is RHO, NSM or a CONM2 missing?")
    moment = rigid[:3, 3:]
    cg = np.array(
        [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
    ) / (2 * mass)
    inertia = rigid[3:, 3:] - mass * (cg @ cg * np.eye(3) - np.outer(cg, cg))
    return MassProperties(mass, directional, cg, (inertia + inertia.T) / 2)


def unconstrained(model: Model) -> Model:
    """The model without its single-point constraints; rigid elements and MPCs stay."""
    tables = {name: t for name, t in model.tables.items() if name not in ("SPC", "SPC1", "SPCADD")}
    if "GRID" in tables and "PS" in tables["GRID"].columns:
        grid = tables["GRID"]
        tables["GRID"] = grid.with_column("PS", np.full(len(grid), ""))
    params = {**model.params, "AUTOSPC": "NO"}
    return replace(model, tables=tables, params=params, case=replace(model.case, spc=0))


def whole_mass(model: Model) -> MassProperties:
    """Mass properties of the whole structure, held or not.

    Raises
    ------
    NumericalError
        If it has no mass.
    """
    return mass_properties(assemble(unconstrained(model)))
