"""Materials: negative strain energy, blanks that stand for 0, plausible units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks import Finding, Severity, at_rows
from ringtrue.core.arrays import Bool, Float
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.errors import InputError, did_you_mean
from ringtrue.fem.negative_stiffness import (
    asks_for_negative_stiffness,
    negative_springs,
    negative_stiffness,
)
from ringtrue.model.frames import extent
from ringtrue.model.model import Model, Table

_FIT = 0.01  # of E / (2 (1 + NU) G)
_DENSITIES = ("MAT1", "MAT2", "MAT8", "MAT9")


def check_materials(model: Model) -> list[Finding]:
    """Poisson's ratio of MAT1, E1, E2 and NU12 of MAT8, the matrices of MAT2 and MAT9, shells that
    do not bend, and moduli, densities and sizes of sections below 0.
    """
    doubtful = [*_poisson(model), *_orthotropic(model), *_membranes(model), *_straight(model)]
    return [*doubtful, *_negative(model)]


def _negative(model: Model) -> Iterator[Finding]:
    severity: Severity = "warning" if asks_for_negative_stiffness(model) else "error"
    for found in negative_stiffness(model):
        yield at_rows(model, found.table.card, found.rows, severity, found.text)
    for found in negative_springs(model):
        yield at_rows(
            model,
            found.table.card,
            found.rows,
            "warning",
            f"{found.text}: taken as a negative stiffness",
        )
    for card in (c for c in _DENSITIES if c in model):
        if (rows := np.flatnonzero(model[card]["RHO"] < 0)).size:
            yield at_rows(
                model, card, rows, "warning", f"RHO is {model[card]['RHO'][rows[0]]:g}, below 0"
            )


def _membranes(model: Model) -> list[Finding]:
    rows = (
        np.flatnonzero(model["PSHELL"]["MID2"] == 0)
        if "PSHELL" in model
        else np.empty(0, dtype=np.int64)
    )
    what = "MID2 is blank: a membrane, without stiffness in bending"
    return [at_rows(model, "PSHELL", rows, "info", what)] if rows.size else []


def _straight(model: Model) -> list[Finding]:
    if "PBAR" not in model:
        return []
    rows = np.flatnonzero(~model["PBAR"].stack("I1", "I2").any(axis=1))
    return (
        [at_rows(model, "PBAR", rows, "info", "I1 and I2 are 0: no stiffness in bending")]
        if rows.size
        else []
    )


def _poisson(model: Model) -> list[Finding]:
    """Poisson's ratio, given or from E and G, must lie between -1 and 0.5."""
    if "MAT1" not in model:
        return []
    table = model["MAT1"]
    with np.errstate(divide="ignore", invalid="ignore"):  # a blank or zero G gives no ratio
        implied = table["E"] / (2 * table["G"]) - 1
    ratio = np.where(np.isnan(table["NU"]), implied, table["NU"])
    rows = np.flatnonzero((ratio <= -1) | (ratio > 0.5))
    found = (
        [at_rows(model, "MAT1", rows, "error", f"Poisson's ratio {ratio[rows[0]]:g}")]
        if rows.size
        else []
    )
    alone = np.flatnonzero(np.isnan(table["NU"]) & (np.isnan(table["E"]) ^ np.isnan(table["G"])))
    if alone.size:
        what = "NU and one of E and G are blank: both are 0 then, as in Nastran"
        found.append(at_rows(model, "MAT1", alone, "info", what))
    return found + _three_moduli(table, implied, model)


def _three_moduli(table: Table, implied: Float, model: Model) -> list[Finding]:
    """MAT1 whose E, G and NU are given and do not fit (the limit of Nastran's warning)."""
    with np.errstate(divide="ignore", invalid="ignore"):  # NU = -1 is told above
        fit = (1 + implied) / (1 + table["NU"])
    rows = np.flatnonzero(np.abs(fit - 1) > _FIT)  # never where one is blank
    if not rows.size:
        return []
    what = (
        f"E / (2 (1 + NU) G) is {fit[rows[0]]:.3g}, not 1: "
        "solids and the membrane and bending of shells take E and NU, torsion and transverse "
        "shear take G"
    )
    return [at_rows(model, "MAT1", rows, "warning", what)]


def _orthotropic(model: Model) -> list[Finding]:
    """E1, E2 > 0 and NU12² < E1 / E2 (Jones, Mechanics of Composite Materials, eq. 2.46)."""
    if "MAT8" not in model:
        return []
    t = model["MAT8"]
    soft = np.flatnonzero((t["E1"] == 0) | (t["E2"] == 0))
    wrong = np.flatnonzero((t["E1"] > 0) & (t["E2"] > 0) & (t["NU12"] ** 2 * t["E2"] >= t["E1"]))
    found = [at_rows(model, "MAT8", soft, "error", "E1 and E2 must not be 0")] if soft.size else []
    if wrong.size:
        limit = np.sqrt(t["E1"][wrong[0]] / t["E2"][wrong[0]])
        what = f"NU12 {t['NU12'][wrong[0]]:g} is not below sqrt(E1/E2) = {limit:g}"
        found.append(at_rows(model, "MAT8", wrong, "error", what))
    return found


MODULI = (1e6, 1.3e12)  # Pa: soft rubber to diamond
DENSITIES = (10.0, 2.3e4)  # kg/m3: foam to osmium
_MODULUS = {"MAT1": "E", "MAT2": "G11", "MAT8": "E1", "MAT9": "G11"}
SIZES = (1e-3, 2e3)  # m


def _inside(x: Float, limits: tuple[float, float]) -> Bool:
    return np.asarray((x >= limits[0]) & (x <= limits[1]))


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
        raise InputError(f"unit system {units!r} is not known{did_you_mean(units, UNIT_SYSTEMS)}")
    return [*_material_units(model, units), *(_size(model, units) if units else [])]


def _material_units(model: Model, units: str) -> list[Finding]:
    """What is not plausible of each material, and whether all of them fit one system."""
    found = list[Finding]()
    common, first = (
        set(UNIT_SYSTEMS),
        dict[str, str](),
    )  # systems that all fit; of each set of systems a material
    for card, name in _MODULUS.items():
        if card not in model:
            continue
        table = model[card]
        modulus, density = table[name], table["RHO"] * _weight(model)
        fits = {system: _fits(modulus, density, s) for system, s in UNIT_SYSTEMS.items()}
        for row, number in enumerate(table.ids.tolist()):  # few beside the elements
            mine = {system for system, f in fits.items() if f[row]}
            if not mine or (units and units not in mine):
                what = _not_plausible(name, modulus[row], density[row], units, mine)
                found.append(at_rows(model, card, np.array([row]), "warning", what))
            if mine:
                first.setdefault(_words(mine), f"{card} {number}")
                common &= mine
    if not common:
        each = "; ".join(f"{material} fits {systems}" for systems, material in first.items())
        found.append(
            Finding(
                "warning", f"the deck mixes unit systems, its materials fit no one of them: {each}"
            )
        )
    return found


def _weight(model: Model) -> float:
    """PARAM,WTMASS of the deck, without its unit of time."""
    return model.param("WTMASS", 1.0) / model.time**2


def _words(systems: set[str]) -> str:
    return " or ".join(s for s in UNIT_SYSTEMS if s in systems)


def _not_plausible(name: str, modulus: float, density: float, units: str, systems: set[str]) -> str:
    hint = f"they would be in {_words(systems)}" if systems else "they are so in no unit system"
    where = f" in {units}" if units else ""
    return (
        f"{name} {modulus:g} with RHO {density:g} (WTMASS applied) are not plausible{where}; {hint}"
    )


def _fits(modulus: Float, density: Float, system: UnitSystem) -> Bool:
    ok = np.isnan(modulus) | _inside(modulus * system.modulus, MODULI)
    return np.asarray(ok & ((density == 0) | _inside(density * system.density, DENSITIES)))


def _size(model: Model, units: str) -> list[Finding]:
    if "GRID" not in model or len(model["GRID"]) < 2:
        return []
    size = extent(model)
    metres = size * UNIT_SYSTEMS[units].length
    if SIZES[0] <= metres <= SIZES[1]:
        return []
    return [
        Finding(
            "warning",
            f"the model is {size:g} long in {units}, that is {metres:g} m: is that its unit "
            "system?",
        )
    ]
