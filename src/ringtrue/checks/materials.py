"""Materials and masses of a deck.

Materials: negative strain energy, blanks that stand for 0, plausible units. Mass properties, masses
that no body has, the ground check, and what AUTOSPC holds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.checks import Finding, Severity, at_rows
from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.errors import InputError, NumericalError, did_you_mean
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.element_cards import MATERIALS
from ringtrue.fem.negative_stiffness import (
    asks_for_negative_stiffness,
    negative_springs,
    negative_stiffness,
)
from ringtrue.model.frames import extent
from ringtrue.model.model import Model, Table
from ringtrue.model.references import unused


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties(FrozenArrays):
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

    @property
    def even(self) -> bool:
        """The same mass along all three axes."""
        return bool(np.ptp(self.directional) <= 1e-6 * abs(self.mass))


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
        raise NumericalError(
            f"the model has no mass: {mass:g}; is RHO, NSM or a CONM2 missing?"
        )
    moment = rigid[:3, 3:]
    cg = np.array(
        [
            moment[1, 2] - moment[2, 1],
            moment[2, 0] - moment[0, 2],
            moment[0, 1] - moment[1, 0],
        ]
    ) / (2 * mass)
    inertia = rigid[3:, 3:] - mass * (cg @ cg * np.eye(3) - np.outer(cg, cg))
    return MassProperties(mass, directional, cg, (inertia + inertia.T) / 2)


def unconstrained(model: Model) -> Model:
    """The model without its single-point constraints; rigid elements and MPCs stay."""
    tables = {
        name: t
        for name, t in model.tables.items()
        if name not in ("SPC", "SPC1", "SPCADD")
    }
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


def body_findings(model: Model) -> Iterator[Finding]:
    """CONM2 of negative mass or principal inertia, CONM1 with a negative eigenvalue."""
    what = "no body has this mass or inertia: it is negative in some direction; check its signs"
    for card in ("CONM2", "CONM1"):
        if card not in model:
            continue
        table = model[card]
        negative = np.zeros(len(table), dtype=bool)
        for m in (
            _conm2_matrices(table)
            if card == "CONM2"
            else [_symmetric(table, "M", 6, 1)]
        ):
            # 1e-9: rounding of what is written in eight characters
            negative |= np.linalg.eigvalsh(m)[:, 0] < -1e-9 * np.abs(m).max(axis=(1, 2))
        yield from at_rows(model, card, np.flatnonzero(negative), "warning", what)


def wide_findings(model: Model) -> Iterator[Finding]:
    """CONM2 whose radius of gyration is far over the size of the model, as with M and I in
    different units.
    """
    if "CONM2" not in model or "GRID" not in model or not (size := extent(model)):
        return
    mass, inertia = (np.asarray(v) for v in _conm2_matrices(model["CONM2"]))
    m = mass[:, 0, 0]
    largest = np.abs(inertia).max(axis=(1, 2))
    rows = np.flatnonzero((m > 0) & (largest > (2 * size) ** 2 * m))
    if rows.size:
        radius = np.sqrt(largest[rows[0]] / m[rows[0]])
        what = (
            f"its radius of gyration is {radius:.3g}, the model {size:.3g} in size: are M and "
            "I in one unit system?"
        )
        yield from at_rows(model, "CONM2", rows, "warning", what)


def _conm2_matrices(t: Table) -> tuple[Float, Float]:
    """Mass (e, 1, 1) and inertia about the centre (e, 3, 3)."""
    return np.asarray(t["M"], dtype=np.float64)[:, None, None], _symmetric(
        t, "I", 3, -1
    )


def _symmetric(t: Table, letter: str, n: int, sign: int) -> Float:
    """The matrix (e, n, n) of fields such as I21, those off the diagonal times `sign`."""
    out = np.zeros((len(t), n, n))
    for i in range(n):
        for j in range(i + 1):
            entry = t[f"{letter}{i + 1}{j + 1}"]
            out[:, i, j] = out[:, j, i] = entry if i == j else sign * entry
    return out


DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
LIMIT = 1e-9  # relative energy that is round-off or the sixth digit of coordinates


@dataclass(frozen=True, slots=True, eq=False)
class GroundCheck(FrozenArrays):
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
    whole = (
        np.einsum("ij,ij->j", abs(motions), abs(system.stiffness) @ abs(motions)) / 2
    )
    # a direction that nothing stiffens holds only the rounding of the others
    if system.stiffness.nnz:
        rounding = 1e-15 * abs(system.stiffness).max() * (motions**2).sum(axis=0)
        whole = np.maximum(whole, rounding / LIMIT)
    relative = energy / np.where(whole > 0, whole, 1.0)
    names: list[tuple[str, ...]] = []
    for k in range(len(DIRECTIONS)):
        share = abs(force[:, k] * motions[:, k])
        worst = np.argsort(-share, kind="stable")[:3]
        worst = worst[share[worst] > 0]
        dofs = system.free.take(worst)
        names.append(dofs.labels() if abs(relative[k]) > LIMIT else ())
    return GroundCheck(energy, relative, tuple(names))


def _centred(system: System) -> Float:
    """Rigid-body motions (f, 6) about the centre of the nodes: far from the origin turns would
    drown in shifts.
    """
    motions = system.rigid_body().copy()
    motions[:, 3:] -= motions[:, :3] @ np.cross(np.eye(3), system.xyz.mean(axis=0)).T
    return motions


def ground_findings(model: Model, check: GroundCheck) -> list[Finding]:
    """A remark for each motion that takes energy; a warning if no element is grounded on
    purpose.
    """
    severity: Severity = "info" if _grounded(model) else "warning"
    found = []
    for k, name in enumerate(DIRECTIONS):
        if check.worst[k]:
            text = (
                f"rigid-body motion {name} has strain energy {check.energy[k]:.3g} "
                f"({check.relative[k]:.1e} of the uncancelled), most of it at "
                f"{' '.join(check.worst[k])}: grounded or misaligned springs, or an MPC?"
            )
            found.append(Finding(severity, text))
    return found


def _grounded(model: Model) -> bool:
    """Whether a spring or bush has a blank end."""
    ends = {
        **dict.fromkeys(("CELAS1", "CELAS2"), ("G1", "G2")),
        **dict.fromkeys(("CELAS3", "CELAS4"), ("S1", "S2")),
        **dict.fromkeys(("CBUSH", "CBUSH1D"), ("GA", "GB")),
    }
    return any(
        bool((model[card].stack(*names) == 0).any())
        for card, names in ends.items()
        if card in model
    )


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
        rest = every.take(others)
        yield Finding("info", f"AUTOSPC holds {_in_words(rest)}; nothing stiffens them")


def _in_words(dofs: DofSet) -> str:
    """`component 6 of node 3, components 123 of 7 nodes (1, 2, 4, 5, 8, ...)`."""
    words = []
    for components, nodes in dofs.by_components().items():
        names = ", ".join([*map(str, nodes[:5]), *["..."] * (len(nodes) > 5)])
        where = f"node {names}" if len(nodes) == 1 else f"{len(nodes)} nodes ({names})"
        if components == "0":
            words.append(where.replace("node", "scalar point", 1))
        else:
            plural = "s" if len(components) > 1 else ""
            words.append(f"component{plural} {components} of {where}")
    return ", ".join(words)


def check_materials(model: Model) -> list[Finding]:
    """Poisson's ratio of MAT1, E1, E2 and NU12 of MAT8, the matrices of MAT2 and MAT9, shells that
    do not bend, and moduli, densities and sizes of sections below 0.
    """
    found = [*_poisson(model), *_orthotropic(model)]
    if "PSHELL" in model:
        membranes = np.flatnonzero(model["PSHELL"]["MID2"] == 0)
        what = "MID2 is blank: a membrane, without stiffness in bending"
        found += at_rows(model, "PSHELL", membranes, "info", what)
    if "PBAR" in model:
        straight = np.flatnonzero(~model["PBAR"].stack("I1", "I2").any(axis=1))
        what = "I1 and I2 are 0: no stiffness in bending"
        found += at_rows(model, "PBAR", straight, "info", what)
    return [*found, *_negative(model)]


def _negative(model: Model) -> Iterator[Finding]:
    severity: Severity = "warning" if asks_for_negative_stiffness(model) else "error"
    for found in negative_stiffness(model):
        yield from at_rows(model, found.table.card, found.rows, severity, found.text)
    for found in negative_springs(model):
        what = f"{found.text}: taken as a negative stiffness"
        yield from at_rows(model, found.table.card, found.rows, "warning", what)
    for card in (c for c in MATERIALS if c in model):
        density = model[card]["RHO"]
        rows = np.flatnonzero(density < 0)
        if rows.size:
            what = f"RHO is {density[rows[0]]:g}, below 0"
            yield from at_rows(model, card, rows, "warning", what)


def _poisson(model: Model) -> Iterator[Finding]:
    """Poisson's ratio, given or from E and G, must lie between -1 and 0.5 where shells or solids
    take it; bars and rods take E and G.
    """
    if "MAT1" not in model:
        return
    table = model["MAT1"]
    # a blank or zero G gives no ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        implied = table["E"] / (2 * table["G"]) - 1
    ratio = np.where(np.isnan(table["NU"]), implied, table["NU"])
    rows = np.flatnonzero((ratio <= -1) | (ratio > 0.5))
    if rows.size:
        taken = np.isin(table.ids[rows], _continua(model))
        made_of = ~np.isin(rows, unused(model).get("MAT1", ()))
        # G has no value then
        taken |= made_of & np.isnan(table["G"][rows]) & (ratio[rows] <= -1)
        wrong = rows[taken]
        harmless = rows[~taken]
        if wrong.size:
            what = f"Poisson's ratio {ratio[wrong[0]]:g}"
            yield from at_rows(model, "MAT1", wrong, "error", what)
        if harmless.size:
            what = (
                f"Poisson's ratio {ratio[harmless[0]]:g}, which no shell or solid takes"
            )
            yield from at_rows(model, "MAT1", harmless, "warning", what)
    one = np.flatnonzero(
        np.isnan(table["NU"]) & (np.isnan(table["E"]) ^ np.isnan(table["G"]))
    )
    what = "NU and one of E and G are blank: both are 0 then, as in Nastran"
    yield from at_rows(model, "MAT1", one, "info", what)
    # E, G and NU are given and do not fit, by the limit of Nastran's warning
    with np.errstate(divide="ignore", invalid="ignore"):  # NU = -1 is named above
        fit = (1 + implied) / (1 + table["NU"])
    rows = np.flatnonzero(np.abs(fit - 1) > 0.01)  # never where one is blank
    if rows.size:
        what = (
            f"E / (2 (1 + NU) G) is {fit[rows[0]]:.3g}, not 1: "
            "solids and the membrane and bending of shells take E and NU, torsion and transverse "
            "shear take G"
        )
        yield from at_rows(model, "MAT1", rows, "warning", what)


def _continua(model: Model) -> Int:
    """Ids of the materials that shells and solids are of, (n,) int64."""
    fields = {
        "PSHELL": ("MID1", "MID2", "MID4"),
        **dict.fromkeys(("PCOMP", "PCOMPG", "PSOLID"), ("MID",)),
    }
    idle = unused(model)
    named = [np.empty(0, dtype=np.int64)]
    for card in fields.keys() & model.tables.keys():
        used = np.setdiff1d(np.arange(len(model[card])), idle.get(card, ()))
        for name in fields[card]:
            ids, row = model[card].entries(name)
            named.append(ids[np.isin(row, used)])
    return np.unique(np.concatenate(named))


def _orthotropic(model: Model) -> Iterator[Finding]:
    """E1, E2 > 0 and NU12² < E1 / E2 (Jones, Mechanics of Composite Materials, eq. 2.46)."""
    if "MAT8" not in model:
        return
    t = model["MAT8"]
    soft = np.flatnonzero((t["E1"] == 0) | (t["E2"] == 0))
    wrong = np.flatnonzero(
        (t["E1"] > 0) & (t["E2"] > 0) & (t["NU12"] ** 2 * t["E2"] >= t["E1"])
    )
    yield from at_rows(model, "MAT8", soft, "error", "E1 and E2 must not be 0")
    if wrong.size:
        limit = np.sqrt(t["E1"][wrong[0]] / t["E2"][wrong[0]])
        what = f"NU12 {t['NU12'][wrong[0]]:g} is not below sqrt(E1/E2) = {limit:g}"
        yield from at_rows(model, "MAT8", wrong, "error", what)


_MODULUS = {"MAT1": "E", "MAT2": "G11", "MAT8": "E1", "MAT9": "G11"}


def check_units(model: Model, units: str = "") -> list[Finding]:
    """Findings on the materials and on the size of the model.

    Parameters
    ----------
    units : str
        One of `UNIT_SYSTEMS`; "" looks only for materials that fit none of them, or not the same
        one.

    Raises
    ------
    InputError
        If the unit system is not known.
    """
    if units and units not in UNIT_SYSTEMS:
        raise InputError(
            f"unit system {units!r} is not known{did_you_mean(units, UNIT_SYSTEMS)}"
        )
    return [*_material_units(model, units), *(_size(model, units) if units else [])]


def _material_units(model: Model, units: str) -> list[Finding]:
    """What is not plausible of each material, and whether all of them fit one system."""
    found = list[Finding]()
    common = set(UNIT_SYSTEMS)  # systems that all materials fit
    first: dict[str, str] = {}  # of each set of systems a material
    for card, name in _MODULUS.items():
        if card not in model:
            continue
        table = model[card]
        weight = model.param("WTMASS", 1.0) / model.time**2
        modulus = table[name]
        density = table["RHO"] * weight
        fits = {
            system: _fits(modulus, density, s) for system, s in UNIT_SYSTEMS.items()
        }
        for row, number in enumerate(table.ids.tolist()):  # few next to the elements
            mine = {system for system, f in fits.items() if f[row]}
            if not mine or (units and units not in mine):
                hint = "they are so in no unit system"
                if mine:
                    hint = f"they would be in {_words(mine)}"
                values = f"{name} {modulus[row]:g} with RHO {density[row]:g} (WTMASS applied)"
                where = f" in {units}" if units else ""
                what = f"{values} are not plausible{where}; {hint}"
                found += at_rows(model, card, np.array([row]), "warning", what)
            if mine:
                first.setdefault(_words(mine), f"{card} {number}")
                common &= mine
    if not common:
        each = "; ".join(
            f"{material} fits {systems}" for systems, material in first.items()
        )
        text = f"the deck mixes unit systems, its materials fit no one of them: {each}"
        found.append(Finding("warning", text))
    return found


def _words(systems: set[str]) -> str:
    return " or ".join(s for s in UNIT_SYSTEMS if s in systems)


def _fits(modulus: Float, density: Float, system: UnitSystem) -> Bool:
    """Moduli from soft rubber to diamond, densities from foam to osmium."""
    pascal = modulus * system.modulus
    si_density = density * system.density
    stiff = np.isnan(modulus) | ((pascal >= 1e6) & (pascal <= 1.3e12))
    heavy = (density == 0) | ((si_density >= 10.0) & (si_density <= 2.3e4))
    return np.asarray(stiff & heavy)


def _size(model: Model, units: str) -> list[Finding]:
    if "GRID" not in model or len(model["GRID"]) < 2:
        return []
    size = extent(model)
    metres = size * UNIT_SYSTEMS[units].length
    if 1e-3 <= metres <= 2e3:
        return []
    text = f"the model is {size:g} long in {units}, that is {metres:g} m: is that its unit system?"
    return [Finding("warning", text)]
