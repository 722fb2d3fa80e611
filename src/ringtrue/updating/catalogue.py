"""What is tried as a candidate parameter: fields of cards, how far each may be off, and units for
the names.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

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
        "section": (0.1, 1.5),  # all dimensions; a second moment of area is their fourth power
        "modulus": (0.3, 3.0),
        "density": (0.1, 1.5),
        "stiffness": (1.0, 20.0),
        "torsion": (1.0, 20.0),
        "mass": (0.2, 2.0),
        "line": (0.3, 3.0),
    }
)
# card -> field, what it is, quantity; fields joined by + have one factor
Catalogue = Mapping[str, tuple[tuple[str, str, str], ...]]
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
    "MAT2": (("G11+G12+G13+G22+G23+G33", "moduli", "modulus"), ("RHO", "density", "density")),
    "MAT8": (
        ("E1", "modulus along the fibres", "modulus"),
        ("E2", "modulus across the fibres", "modulus"),
        ("G12", "shear modulus in the plane", "modulus"),
        ("G1Z+G2Z", "transverse shear moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
    "MAT9": (
        ("+".join(f"G{i}{j}" for i in range(1, 7) for j in range(i, 7)), "moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
}
_TRANSLATION = tuple((f"K{i}", f"stiffness along axis {i}", "stiffness") for i in (1, 2, 3))
_ROTATION = tuple((f"K{i + 3}", f"stiffness about axis {i}", "torsion") for i in (1, 2, 3))
SPRINGS = {
    "PBUSH": (
        ("K1+K2+K3+K4+K5+K6", "stiffness in all directions", "stiffness"),
        *_TRANSLATION,
        *_ROTATION,
    ),
    **dict.fromkeys(("PBUSH1D", "PELAS", "CELAS2", "CELAS4"), (("K", "stiffness", "stiffness"),)),
}
MASSES = {
    "CONM2": (("M+I11+I21+I22+I31+I32+I33", "mass and inertia", "mass"),),
    **dict.fromkeys(("PMASS", "CMASS2", "CMASS4"), (("M", "mass", "mass"),)),
}
