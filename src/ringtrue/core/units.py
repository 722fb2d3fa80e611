"""The consistent unit systems that a deck may be in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from scipy.constants import inch, lbf

UnitName = Literal["SI", "mm-t-s", "mm-kg-s", "mm-kg-ms", "in-lbf-s", "ft-lbf-s"]


@dataclass(frozen=True, slots=True)
class UnitSystem:
    """A consistent system: one unit of each base quantity, in SI.

    Attributes
    ----------
    length : float, m
    mass : float, kg
        As it stands in the mass matrix, that is with PARAM,WTMASS applied.
    time : float, s
    """

    length: float
    mass: float
    time: float = 1.0

    @property
    def force(self) -> float:
        """Newtons a unit of force."""
        return self.mass * self.length / self.time**2

    @property
    def modulus(self) -> float:
        """Pascals a unit of stress."""
        return self.force / self.length**2

    @property
    def density(self) -> float:
        """Kilograms a cubic metre a unit of density."""
        return self.mass / self.length**3

    @property
    def kilograms(self) -> float:
        """Kilograms a unit of the mass matrix of a model whose time is in seconds
        (`model.seconds.in_seconds`).
        """
        return self.mass / self.time**2


UNIT_SYSTEMS: Mapping[str, UnitSystem] = MappingProxyType(
    {
        "SI": UnitSystem(1.0, 1.0),
        "mm-t-s": UnitSystem(1e-3, 1e3),
        "mm-kg-s": UnitSystem(1e-3, 1.0),  # mN and kPa, as Siemens NX writes decks
        "mm-kg-ms": UnitSystem(1e-3, 1.0, 1e-3),
        "in-lbf-s": UnitSystem(inch, lbf / inch),
        "ft-lbf-s": UnitSystem(12 * inch, lbf / (12 * inch)),
    }
)
