"""A candidate parameter of a deck: a common factor on fields of the deck, with what it means and
what it changes.

`generation` makes candidates from the cards, `screening` holds them against the modes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import CardField, Parameter, ParameterSet, Substructure
from ringtrue.errors import InputError, did_you_mean
from ringtrue.fem.mesh import Rows
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.model import Model, Ragged, Table

Kind = Literal["property", "material", "region", "spring", "mass", "lump"]
KINDS: tuple[Kind, ...] = ("property", "material", "region", "spring", "mass", "lump")
QUANTITIES = ("length", "modulus", "density", "stiffness", "torsion", "mass")
UNITS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "SI": ("m", "Pa", "kg/m3", "N/m", "N m/rad", "kg"),
        "mm-t-s": ("mm", "MPa", "t/mm3", "N/mm", "N mm/rad", "t"),
        "mm-kg-s": ("mm", "kPa", "kg/mm3", "mN/mm", "mN mm/rad", "kg"),
        "mm-kg-ms": ("mm", "GPa", "kg/mm3", "kN/mm", "kN mm/rad", "kg"),
        "in-lbf-s": ("in", "psi", "lbf s2/in4", "lbf/in", "lbf in/rad", "lbf s2/in"),
        "ft-lbf-s": ("ft", "lbf/ft2", "slug/ft3", "lbf/ft", "lbf ft/rad", "slug"),
    }
)
# quantity -> prior standard deviation of ln(factor), largest factor
SPREAD: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "length": (0.2, 2.0),
        "area": (0.2, 2.0),
        "inertia": (0.3, 3.0),
        # all dimensions; a second moment of area is their fourth power
        "section": (0.1, 1.5),
        "modulus": (0.3, 3.0),
        "density": (0.1, 1.5),
        "stiffness": (1.0, 20.0),
        "torsion": (1.0, 20.0),
        "mass": (0.2, 2.0),
        "line": (0.3, 3.0),
    }
)
# fields (those joined by + have one factor), what they are in words, the quantity; by card
Entry = tuple[str, str, str]
Catalogue = Mapping[str, tuple[Entry, ...]]
SECTIONS = {
    "PSHELL": (("T", "thickness", "length"), ("NSM", "non-structural mass", "line")),
    "PSHEAR": (("T", "thickness", "length"), ("NSM", "non-structural mass", "line")),
    "PROD": (
        ("A", "area", "area"),
        ("J", "torsion constant", "inertia"),
        ("NSM", "non-structural mass", "line"),
    ),
    "CONROD": (("A", "area", "area"), ("J", "torsion constant", "inertia")),
    "PTUBE": (("OD", "outer diameter", "length"), ("T", "wall", "length")),
    "PBAR": (
        ("A", "area", "area"),
        ("I1", "bending in plane 1", "inertia"),
        ("I2", "bending in plane 2", "inertia"),
        ("J", "torsion constant", "inertia"),
        ("NSM", "non-structural mass", "line"),
    ),
}
SECTIONS["PBEAM"] = SECTIONS["PBEND"] = SECTIONS["PBAR"]
MATERIALS = {
    "MAT1": (("E+G", "Young's modulus", "modulus"), ("RHO", "density", "density")),
    "MAT2": (
        ("G11+G12+G13+G22+G23+G33", "moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
    "MAT8": (
        ("E1", "modulus along the fibres", "modulus"),
        ("E2", "modulus across the fibres", "modulus"),
        ("G12", "shear modulus in the plane", "modulus"),
        ("G1Z+G2Z", "transverse shear moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
    "MAT9": (
        (
            "+".join(f"G{i}{j}" for i in range(1, 7) for j in range(i, 7)),
            "moduli",
            "modulus",
        ),
        ("RHO", "density", "density"),
    ),
}
_TRANSLATION = tuple(
    (f"K{i}", f"stiffness along axis {i}", "stiffness") for i in (1, 2, 3)
)
_ROTATION = tuple(
    (f"K{i + 3}", f"stiffness about axis {i}", "torsion") for i in (1, 2, 3)
)
SPRINGS = {
    "PBUSH": (
        ("K1+K2+K3+K4+K5+K6", "stiffness in all directions", "stiffness"),
        *_TRANSLATION,
        *_ROTATION,
    ),
    **dict.fromkeys(
        ("PBUSH1D", "PELAS", "CELAS2", "CELAS4"), (("K", "stiffness", "stiffness"),)
    ),
}
MASSES = {
    "CONM2": (("M+I11+I21+I22+I31+I32+I33", "mass and inertia", "mass"),),
    **dict.fromkeys(("PMASS", "CMASS2", "CMASS4"), (("M", "mass", "mass"),)),
}
PLACES = 64  # nodes at most


@dataclass(frozen=True, slots=True)
class Candidate:
    """A parameter with what it means.

    Attributes
    ----------
    parameter : Parameter
    kind : {"property", "material", "region", "spring", "mass", "lump"}
    what : str
        In words, with the nominal value and its unit.
    elements : tuple of int
        Elements (EID) that it changes, ascending.
    """

    parameter: Parameter
    kind: Kind
    what: str
    elements: tuple[int, ...]

    @property
    def name(self) -> str:
        """Of the parameter."""
        return self.parameter.name


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """What is generated.

    Attributes
    ----------
    kinds : tuple of str
        Of `KINDS`.
    units : str
        A unit system (`UNITS`) for the names; "" names values without a unit.
    weighed : bool
        Masses and densities of the deck are scaled by PARAM,WTMASS: the system has no name for
        their unit.
    """

    kinds: tuple[Kind, ...] = KINDS
    units: str = ""
    weighed: bool = False

    def __post_init__(self) -> None:
        if unknown := set(self.kinds) - set(KINDS):
            kind = min(unknown)
            raise InputError(f"candidates: no kind {kind!r}{did_you_mean(kind, KINDS)}")
        if self.units and self.units not in UNITS:
            raise InputError(
                f"unit system {self.units!r} is not known{did_you_mean(self.units, UNITS)}"
            )

    def of(self, model: Model) -> CandidateSettings:
        """For the deck of a model."""
        return replace(self, weighed=model.param("WTMASS", 1.0) / model.time**2 != 1)

    def unit(self, quantity: str) -> str:
        """The unit of a quantity, "" where the system is not known."""
        if not self.units or (self.weighed and quantity in ("mass", "density")):
            return ""
        known = dict(zip(QUANTITIES, UNITS[self.units], strict=True))
        known |= {"area": f"{known['length']}2", "inertia": f"{known['length']}4"}
        return known.get(quantity, "")


def parameters(candidates: Sequence[Candidate]) -> ParameterSet:
    """The parameters of the candidates, in order."""
    return ParameterSet(tuple(c.parameter for c in candidates))


@dataclass(frozen=True, slots=True)
class Draft:
    """A candidate before it has a parameter.

    Attributes
    ----------
    kind : Kind
    name : str
        Card, id and field.
    what : str
        In words.
    quantity : str
        A key of `SPREAD`.
    elements : (e,) int64
    targets : sequence of CardField
    substructures : sequence of Substructure
    """

    kind: Kind
    name: str
    what: str
    quantity: str
    elements: Int
    targets: Sequence[CardField] = ()
    substructures: Sequence[Substructure] = ()

    def candidate(self) -> Candidate:
        """On a logarithmic scale, with the spread of its quantity."""
        std, most = SPREAD[self.quantity]
        p = Parameter(
            name=self.name,
            targets=tuple(self.targets),
            lower=1 / most,
            upper=most,
            scale="log",
            std=std,
            substructures=tuple(self.substructures),
        )
        return Candidate(
            p, self.kind, self.what, tuple(np.unique(self.elements).tolist())
        )


def amount(value: float, quantity: str, s: CandidateSettings) -> str:
    """A value with its unit, as it is named."""
    return f"{value:.4g} {s.unit(quantity)}".strip()


def given_fields(table: Table, row: int, fields: str) -> list[str]:
    """Those of the fields that hold a value other than 0."""
    columns = table.columns
    there = [
        f
        for f in fields.split("+")
        if f in columns and not isinstance(columns[f], Ragged)
    ]
    return [f for f in there if np.isfinite(table[f][row]) and table[f][row] != 0]


def counted(rows: Rows) -> str:
    """`12 CBAR and 4 CQUAD4`."""
    return " and ".join(f"{at.size} {card}" for card, at in sorted(rows.items()))


def listed(ids: Sequence[int] | Int) -> str:
    """`3`, `3-8`, or `3,5,9 (12 in all)`."""
    ids = np.sort(np.asarray(ids))
    if ids.size == 1:
        return str(ids[0])
    if ids[-1] - ids[0] == ids.size - 1:
        return f"{ids[0]}-{ids[-1]}"
    shown = ",".join(map(str, ids[:3].tolist()))
    return shown if ids.size <= 3 else f"{shown},... ({ids.size} in all, to {ids[-1]})"


def ids_of(model: Model, rows: Rows) -> Int:
    """Ids of the elements in these rows of their cards, (e,) int64."""
    return np.concatenate(
        [np.zeros(0, dtype=np.int64), *(model[c].ids[at] for c, at in rows.items())]
    )


def elements_of(model: Model) -> Int:
    """Ids of all elements that are assembled, in the order of their cards, (e,) int64."""
    return ids_of(model, {c: np.arange(len(model[c])) for c in affected_cards(model)})


def membership(model: Model, candidates: Sequence[Candidate]) -> sparse.csr_array:
    """1 where a candidate (p) changes an element (e, in the order of `elements_of`), csr (p, e).

    Elements that the model does not have, as those of added masses, do not count.
    """
    ids = elements_of(model)
    order = np.argsort(ids, kind="stable")
    wanted = np.array([e for c in candidates for e in c.elements], dtype=np.int64)
    rows = np.repeat(np.arange(len(candidates)), [len(c.elements) for c in candidates])
    at = order[np.searchsorted(ids[order], wanted).clip(max=ids.size - 1)]
    there = ids[at] == wanted
    entries = (np.ones(there.sum()), (rows[there], at[there]))
    return sparse.csr_array(
        sparse.coo_array(entries, shape=(len(candidates), ids.size))
    )
