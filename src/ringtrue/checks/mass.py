"""Mass properties, masses that no body has, the ground check, and what AUTOSPC holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.checks import Finding, Severity, at_rows
from ringtrue.core.arrays import Float, freeze_fields
from ringtrue.core.dofs import DofSet
from ringtrue.errors import NumericalError
from ringtrue.fem.assembly import System, assemble
from ringtrue.model.frames import extent
from ringtrue.model.model import Model, Table

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


_ZERO = 1e-9  # of the largest entry: rounding of what is written in eight characters
WIDE = 2.0  # a radius of gyration over the size of the model
_PAIRS = tuple((i, j) for i in range(1, 7) for j in range(1, i + 1))


def body_findings(model: Model) -> Iterator[Finding]:
    """CONM2 of negative mass or principal inertia, CONM1 with a negative eigenvalue."""
    for card, matrices in (("CONM2", _conm2_matrices), ("CONM1", _conm1_matrices)):
        if card in model:
            lowest = [
                np.linalg.eigvalsh(m)[:, 0] + _ZERO * np.abs(m).max(axis=(1, 2))
                for m in matrices(model[card])
            ]
            rows = np.flatnonzero((np.stack(lowest) < 0).any(axis=0))
            if rows.size:
                what = (
                    "no body has this mass or inertia: it is negative in some direction; "
                    "check its signs"
                )
                yield at_rows(model, card, rows, "warning", what)


def wide_findings(model: Model) -> Iterator[Finding]:
    """CONM2 whose radius of gyration is far over the size of the model, as with M and I in
    different units.
    """
    if "CONM2" not in model or "GRID" not in model or not (size := extent(model)):
        return
    mass, inertia = (np.asarray(v) for v in _conm2_matrices(model["CONM2"]))
    m, largest = mass[:, 0, 0], np.abs(inertia).max(axis=(1, 2))
    rows = np.flatnonzero((m > 0) & (largest > (WIDE * size) ** 2 * m))
    if rows.size:
        radius = np.sqrt(largest[rows[0]] / m[rows[0]])
        what = (
            f"its radius of gyration is {radius:.3g}, the model {size:.3g} in size: are M and "
            "I in one unit system?"
        )
        yield at_rows(model, "CONM2", rows, "warning", what)


def _conm2_matrices(t: Table) -> tuple[Float, Float]:
    """Mass (e, 1, 1) and inertia about the centre (e, 3, 3)."""
    return np.asarray(t["M"], dtype=np.float64)[:, None, None], _symmetric(t, "I", 3, -1)


def _conm1_matrices(t: Table) -> tuple[Float]:
    return (_symmetric(t, "M", 6, 1),)


def _symmetric(t: Table, letter: str, n: int, sign: int) -> Float:
    """The matrix (e, n, n) of fields such as I21, those off the diagonal times `sign`."""
    out = np.zeros((len(t), n, n))
    for i, j in (p for p in _PAIRS if p[0] <= n):
        out[:, i - 1, j - 1] = out[:, j - 1, i - 1] = t[f"{letter}{i}{j}"] * (1 if i == j else sign)
    return out


DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
LIMIT = 1e-9  # relative energy that is round-off or the sixth digit of coordinates
ROUNDING = 1e-15  # of the largest stiffness, left where elements have none
_WORST_NAMED = 3


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
    order = np.argsort(-abs(share), kind="stable")[:_WORST_NAMED]
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


_NAMED = 5


def autospc_findings(system: System) -> Iterator[Finding]:
    """Components that are held as nothing stiffens them: a warning for translations of nodes that
    move otherwise.
    """
    loose = system.loose()
    if len(loose):
        text = f"AUTOSPC holds translations of nodes that move otherwise: {_in_words(loose)}"
        yield Finding("warning", f"{text}; nothing stiffens them")
    every = system.autospc
    others = loose.find(every.node, every.direction) < 0
    if others.any():
        rest = DofSet(every.node[others], every.direction[others])
        yield Finding("info", f"AUTOSPC holds {_in_words(rest)}; nothing stiffens them")


def _in_words(dofs: DofSet) -> str:
    """`component 6 of node 3, components 123 of 7 nodes (1, 2, 4, 5, 8, ...)`."""
    return ", ".join(
        _component_words(components, nodes) for components, nodes in dofs.by_components().items()
    )


def _component_words(components: str, nodes: list[int]) -> str:
    more = ", ..." if len(nodes) > _NAMED else ""
    names = ", ".join(map(str, nodes[:_NAMED])) + more
    where = f"node {names}" if len(nodes) == 1 else f"{len(nodes)} nodes ({names})"
    if components == "0":
        return where.replace("node", "scalar point", 1)
    return f"component{'s' if len(components) > 1 else ''} {components} of {where}"
