"""Whether moduli, densities and lengths are plausible in the unit system that the deck is said to
be in.
"""

from __future__ import annotations

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Bool, Float
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.errors import InputError, did_you_mean
from ringtrue.model.frames import extent
from ringtrue.model.model import Model

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
    return [*_materials(model, units), *(_size(model, units) if units else [])]


def _materials(model: Model, units: str) -> list[Finding]:
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
