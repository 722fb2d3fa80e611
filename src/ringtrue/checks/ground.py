"""Ground check: the strain energy of rigid-body motion, which a structure in free space does not
have.

Source: MSC Nastran Quick Reference Guide, case control GROUNDCHECK. Here the energy of each motion
is told relative to Σ |r_i| |K_ij| |r_j| / 2, the energy if no term cancelled, so that it does not
depend on units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.checks.findings import Finding, Severity
from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.dofs import DofSet
from ringtrue.fem.assembly import System
from ringtrue.model.model import Model

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
LIMIT = 1e-9  # relative energy that is round-off or the sixth digit of coordinates
ROUNDING = 1e-15  # of the largest stiffness, left where elements have none
_NAMED = 3


@dataclass(frozen=True, slots=True, eq=False)
class GroundCheck:
    """Strain energy of the unit rigid-body motions of an unconstrained model.

    Attributes
    ----------
    energy : (6,) float64
        rᵀKr / 2 for unit motions along and about the axes of basic through the centre of the nodes,
        model units.
    relative : (6,) float64
        The same over the energy if no term cancelled.
    worst : tuple of tuple of str
        For each motion over `LIMIT` the DOFs with the largest forces, as `101+Z`; empty for the
        others.
    """

    energy: Float
    relative: Float
    worst: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        freeze_fields(self, energy=np.float64, relative=np.float64)

    @property
    def ok(self) -> bool:
        """No motion takes energy."""
        return bool((abs(self.relative) <= LIMIT).all())


def ground_check(system: System) -> GroundCheck:
    """Strain energy of rigid-body motion; assemble `checks.mass.unconstrained(model)` for that of
    the structure.
    """
    motions = _centred(system)
    force = system.stiffness @ motions
    energy = np.einsum("ij,ij->j", motions, force) / 2
    whole = np.einsum("ij,ij->j", abs(motions), abs(system.stiffness) @ abs(motions)) / 2
    # a direction that nothing stiffens holds only the rounding of the others
    least = (
        ROUNDING / LIMIT * abs(system.stiffness).max() * (motions**2).sum(axis=0)
        if system.stiffness.nnz
        else 0.0
    )
    whole = np.maximum(whole, least)
    relative = energy / np.where(whole > 0, whole, 1.0)
    names = tuple(
        _largest(system, force[:, k] * motions[:, k]) if abs(relative[k]) > LIMIT else ()
        for k in range(len(DIRECTIONS))
    )
    return GroundCheck(energy, relative, names)


def _centred(system: System) -> Float:
    """Rigid-body motions (f, 6) about the centre of the nodes: far from the origin turns would
    drown in shifts.
    """
    motions = system.rigid_body().copy()
    motions[:, 3:] -= motions[:, :3] @ np.cross(np.eye(3), system.xyz.mean(axis=0)).T
    return motions


def _largest(system: System, share: Float) -> tuple[str, ...]:
    order = np.argsort(-abs(share), kind="stable")[:_NAMED]
    order = order[abs(share[order]) > 0]
    return DofSet(system.free.node[order], system.free.direction[order]).labels()


def ground_findings(model: Model, check: GroundCheck) -> list[Finding]:
    """A remark for each motion that takes energy; a warning if no element is grounded on
    purpose.
    """
    severity: Severity = "info" if _grounded(model) else "warning"
    return [
        Finding(
            severity,
            f"rigid-body motion {name} has strain energy {check.energy[k]:.3g} "
            f"({check.relative[k]:.1e} of the "
            f"uncancelled), most of it at {' '.join(check.worst[k])}: grounded or misaligned "
            "springs, or an MPC?",
        )
        for k, name in enumerate(DIRECTIONS)
        if check.worst[k]
    ]


def _grounded(model: Model) -> bool:
    """Whether a spring or bush has a blank end."""
    ends = {
        "CELAS1": ("G1", "G2"),
        "CELAS2": ("G1", "G2"),
        "CELAS3": ("S1", "S2"),
        "CELAS4": ("S1", "S2"),
    }
    ends |= {"CBUSH": ("GA", "GB"), "CBUSH1D": ("GA", "GB")}
    return any(
        bool((model[card].stack(*names) == 0).any())
        for card, names in ends.items()
        if card in model
    )
