"""Uncertain parameters of a model, in dimensionless form: x = 0 is the nominal model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.errors import InputError

Scale = Literal["log", "linear"]


@dataclass(frozen=True, slots=True)
class CardField:
    """A field of a card: `CardField("MAT1", 7, "E")`; `CardField("PCOMP", 2, "T3")` is ply 3,
    `CardField("DMIG", 1, "A")` all terms of the first matrix.

    Attributes
    ----------
    card : str
    id : int
    field : str
    elements : tuple of int
        Only as these elements (EID) see it; empty: all that use the card.
    step : float
        If not 0, the field is value + step·(a − 1) in place of value·a: for places, which may be 0.
    """

    card: str
    id: int
    field: str
    elements: tuple[int, ...] = ()
    step: float = 0.0


def is_matrix(card: str, field: str) -> bool:
    """Whether a field of a card means all terms of a matrix."""
    return (card, field) == ("DMIG", "A")


@dataclass(frozen=True, slots=True)
class Shape:
    """Nodes that move by (a − 1) times a vector each.

    Attributes
    ----------
    nodes : tuple of int
        Ids of GRID.
    vectors : tuple of (x, y, z)
        In the basic frame, length; one a node.
    """

    nodes: tuple[int, ...]
    vectors: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        if len(self.nodes) != len(self.vectors) or len(set(self.nodes)) != len(
            self.nodes
        ):
            raise InputError(
                f"shape: {len(self.vectors)} vectors for {len(set(self.nodes))} different nodes"
            )


@dataclass(frozen=True, slots=True)
class Substructure:
    """A common factor on one matrix of some elements (EID): `Substructure("stiffness", (4, 5,
    6))`.
    """

    matrix: Literal["stiffness", "mass"]
    elements: tuple[int, ...]

    def __post_init__(self) -> None:
        if self.matrix not in ("stiffness", "mass") or not self.elements:
            raise InputError(
                f"substructure of {len(self.elements)} elements, matrix {self.matrix!r}"
            )


@dataclass(frozen=True, slots=True)
class Parameter:
    """One uncertain quantity: a common factor on the fields it targets.

    The factor is a = exp(x) for scale "log" and a = 1 + x for "linear".

    Attributes
    ----------
    name : str
    targets : tuple of CardField
    lower, upper : float
        Bounds of the factor a, 0 < lower < 1 < upper.
    scale : {"log", "linear"}
    std : float
        Prior standard deviation of x.
    shapes : tuple of Shape
        Nodes that move with the factor.
    substructures : tuple of Substructure
        Element matrices that the factor multiplies.
    """

    name: str
    targets: tuple[CardField, ...] = ()
    lower: float = 0.1
    upper: float = 10.0
    scale: Scale = "log"
    std: float = 1.0
    shapes: tuple[Shape, ...] = ()
    substructures: tuple[Substructure, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.lower < 1 < self.upper:
            raise InputError(
                f"parameter {self.name}: bounds {self.lower}, {self.upper} must enclose 1 and be "
                "> 0"
            )
        if not self.std > 0:
            raise InputError(f"parameter {self.name}: std {self.std} must be > 0")

    @property
    def lump(self) -> float:
        """Of a mass that is added to what a CONM2 has, that of a factor of 2; 0 of every other
        parameter.
        """
        one = self.targets[0] if len(self.targets) == 1 else None
        return (
            one.step
            if one is not None and (one.card, one.field) == ("CONM2", "M")
            else 0.0
        )


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """An ordered set of parameters; the vector x (p,) is dimensionless, 0 = nominal."""

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        names = self.names
        if len(set(names)) != len(names):
            raise InputError("two parameters have the same name")

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(p.name for p in self.parameters)

    def take(self, at: Sequence[int]) -> ParameterSet:
        """The chosen parameters, in the given order."""
        return ParameterSet(tuple(self.parameters[i] for i in at))

    def _log(self) -> list[bool]:
        return [p.scale == "log" for p in self.parameters]

    def factors(self, x: Float) -> Float:
        """Factors a (p,) of the vector x (p,)."""
        x = np.asarray(x, dtype=np.float64)
        return np.where(self._log(), np.exp(np.where(self._log(), x, 0.0)), 1.0 + x)

    def derivative(self, x: Float) -> Float:
        """da/dx (p,)."""
        return np.where(self._log(), self.factors(x), 1.0)

    def at(self, names: Sequence[str]) -> list[int]:
        """Positions of the parameters of these names."""
        known = self.names
        return [known.index(name) for name in names]

    def vector(self, factors: Float | Mapping[str, float]) -> Float:
        """x (p,) of the factors a (p,), also where these are given by name."""
        if isinstance(factors, Mapping):
            factors = np.array([factors[name] for name in self.names])
        a = np.asarray(factors, dtype=np.float64)
        return np.where(self._log(), np.log(a), a - 1.0)

    def bounds(self) -> tuple[Float, Float]:
        """Lower and upper bound of x, each (p,)."""
        return (
            self.vector(np.array([p.lower for p in self.parameters])),
            self.vector(np.array([p.upper for p in self.parameters])),
        )

    def std(self) -> Float:
        """Prior standard deviation of x, (p,)."""
        return np.array([p.std for p in self.parameters])
