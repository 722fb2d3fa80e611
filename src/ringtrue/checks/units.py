"""Whether moduli, densities and lengths are plausible in the unit system that the deck is said to be in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ringtrue.checks.findings import Finding, at_rows
from ringtrue.core.arrays import Bool, Float
from ringtrue.errors import InputError, did_you_mean
from ringtrue.model.frames import extent
from ringtrue.model.model import Model


@dataclass(frozen=True, slots=True)
class UnitSystem:
    """One modulus, density and length of a system, in SI."""

    modulus: float
    density: float
    length: float


UNIT_SYSTEMS: Mapping[str, UnitSystem] = MappingProxyType(
    {
        "SI": UnitSystem(1.0, 1.0, 1.0),
        "mm-t-s": UnitSystem(1e6, 1e12, 1e-3),
        "mm-kg-s": UnitSystem(1e3, 1e9, 1e-3),  # mN and kPa, as Siemens NX writes decks
        "mm-kg-ms": UnitSystem(1e9, 1e9, 1e-3),
        "in-lbf-s": UnitSystem(6894.757, 1.0686896e7, 0.0254),
        "ft-lbf-s": UnitSystem(47.880259, 515.37882, 0.3048),
    }
)
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
        One of `UNIT_SYSTEMS`; "" looks only for materials that fit none of them.

    Raises
    ------
    InputError
        If the unit system is not known.
    """
    if units and units not in UNIT_SYSTEMS:
        raise InputError(f"unit system {units!r} is not known{did_you_mean(units, UNIT_SYSTEMS)}")
    return [*_materials(model, units), *(_size(model, units) if units else [])]


def _materials(model: Model, units: str) -> list[Finding]:
    return [f for card, name in _MODULUS.items() if card in model for f in _of_card(model, card, name, units)]


def _of_card(model: Model, card: str, name: str, units: str) -> list[Finding]:
    table = model[card]
    modulus, density = table[name], table["RHO"] * model.param("WTMASS", 1.0)
    fits = {system: _fits(modulus, density, s) for system, s in UNIT_SYSTEMS.items()}
    nowhere = ~np.any(list(fits.values()), axis=0)
    wrong = ~fits[units] if units else nowhere
    found = []
    for row in np.flatnonzero(wrong):
        other = [system for system, f in fits.items() if f[row]]
        hint = f"they would be in {' or '.join(other)}" if other else "they are so in no unit system"
        what = (
            f"{name} {modulus[row]:g} with RHO {density[row]:g} (WTMASS applied) are not plausible"
            f"{f' in {units}' if units else ''}; {hint}"
        )
        found.append(at_rows(model, card, np.array([row]), "warning", what))
    return found


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
        Finding("warning", f"the model is {size:g} long in {units}, that is {metres:g} m: is that its unit system?")
    ]
