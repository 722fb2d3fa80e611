"""The large spinning facility in numbers: one frozen description, filled in differently by analyst
and builder.

SI throughout. x along the bay (25 m), y across (10 m), z up; the origin is a lower corner of the
foundation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

LENGTH, WIDTH, SLAB, WALL_TOP, WALL, END_WALL = 25.0, 10.0, 1.25, 3.2, 0.9, 0.8
PORTALS = (4.0, 7.4, 10.8, 14.2, 17.6, 21.0)
SIDES = (0.45, 9.55)
BAYS_LEFT_OUT = (1, 3)  # bays whose braces the analyst left out
BASE, MID, TOP = 3.25, 5.1, 7.5  # column feet, lower and upper girders
AXIS_Y, RADIUS, VESSEL_X = 5.0, 2.2, (5.6, 7.4, 10.8, 14.2, 17.6, 19.4)
DISH = 0.9  # m, height of the heads
MOUNT_X = (7.4, 10.8, 14.2, 17.6)
DECK_X, DECK_Y = (7.4, 17.6), (3.2, 6.8)
SHAFT_Z = 8.6
MOTOR, GEARBOX, ROTOR, BEARINGS = 9.1, 12.5, 16.4, (10.8, 15.4)


@dataclass(frozen=True, slots=True)
class Section:
    """A beam section: area, second moments about element z and y, torsion constant, shear
    factors.
    """

    area: float
    i1: float
    i2: float
    j: float
    k1: float
    k2: float

    @classmethod
    def box(cls, height: float, width: float, t: float) -> Section:
        """A thin-walled box, height in the plane of bending 1."""
        hi, wi = height - 2 * t, width - 2 * t
        hm, wm = height - t, width - t
        area = height * width - hi * wi
        return cls(
            area=area,
            i1=(width * height**3 - wi * hi**3) / 12,
            i2=(height * width**3 - hi * wi**3) / 12,
            j=2 * t * (hm * wm) ** 2 / (hm + wm),
            k1=2 * height * t / area,
            k2=2 * width * t / area,
        )

    def times(self, factor: float) -> Section:
        """The section of plates thicker by `factor`."""
        f = factor
        return Section(
            area=f * self.area, i1=f * self.i1, i2=f * self.i2, j=f * self.j, k1=self.k1, k2=self.k2
        )


# region -> (material kind, elastic modulus or stiffness as the analyst took it); a region is one
# thing that was poured, welded or bolted together, and one candidate for updating
CONCRETE = {"slab": 1, "long walls": 2, "end walls": 3, "haunches": 4}
STEEL = {
    "columns": 11,
    "girders": 12,
    "cross beams": 13,
    "braces": 14,
    "brackets": 15,
    "vessel shell": 21,
    "vessel heads": 22,
    "vessel rings": 23,
    "drive deck": 31,
    "deck beams": 32,
    "pedestals": 33,
    "shaft": 34,
}
JOINTED = (
    "columns",
    "girders",
    "cross beams",
    "brackets",
)  # modulus lowered by the analyst for bolted joints
BUSHES = {
    "anchors front": 51,
    "anchors middle": 52,
    "anchors rear": 53,
    "vessel mounts front": 54,
    "vessel mounts rear": 55,
    "motor mounts": 56,
    "gearbox mounts": 57,
    "bearing mounts": 58,
    "air springs": 60,
}


@dataclass(frozen=True, slots=True)
class Mesh3:
    """Numbers of elements."""

    nx: int = 58
    ny: int = 20
    nz_slab: int = 4
    nz_wall: int = 4
    ny_wall: int = 2
    around: int = 40
    along: tuple[int, ...] = (4, 7, 7, 7, 4)
    head: int = 4
    column: tuple[int, int] = (3, 4)
    span: int = 5
    deck_x: int = 6  # a portal spacing
    deck_y: int = 8


@dataclass(frozen=True, slots=True)
class Spec:
    """What is built: mesh, stiffness of each region, and what is there at all."""

    mesh: Mesh3 = field(default_factory=Mesh3)
    modulus: Mapping[str, float] = field(
        default_factory=lambda: (
            dict.fromkeys(CONCRETE, 17.0e9)
            | dict.fromkeys(STEEL, 2.06e11)
            | dict.fromkeys(JOINTED, 1.70e11)
        )
    )
    density: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(CONCRETE, 2475.0) | dict.fromkeys(STEEL, 7850.0)
    )
    bush: Mapping[str, tuple[float, ...]] = field(
        default_factory=lambda: {
            "anchors front": (2.85e8, 1.4e8, 7.5e8, 2.0e8, 2.0e8, 1.0e8),
            "anchors middle": (2.85e8, 1.4e8, 7.5e8, 2.0e8, 2.0e8, 1.0e8),
            "anchors rear": (2.85e8, 1.4e8, 7.5e8, 2.0e8, 2.0e8, 1.0e8),
            "vessel mounts front": (9.0e8, 1.1e9, 1.4e9, 0.0, 0.0, 0.0),
            "vessel mounts rear": (9.0e8, 1.1e9, 1.4e9, 0.0, 0.0, 0.0),
            "motor mounts": (3.0e9, 3.0e9, 5.0e9, 0.0, 0.0, 0.0),
            "gearbox mounts": (2.0e9, 2.0e9, 3.5e9, 0.0, 0.0, 0.0),
            "bearing mounts": (1.0e9, 4.0e9, 5.0e9, 0.0, 0.0, 0.0),
            "air springs": (7.45e5, 9.6e5, 2.6e6, 0.0, 0.0, 0.0),
        }
    )
    section: Mapping[str, float] = field(
        default_factory=dict
    )  # region -> factor on its beam section
    loss: Mapping[str, float] = field(default_factory=dict)  # region -> structural loss factor
    dashpot: tuple[float, float, float] = (0.0, 0.0, 0.0)  # N s/m at each air spring
    scatter: float = 0.0  # log standard deviation of stiffness within a region
    bush_scatter: float = 0.0  # from one bush to the next
    extra_braces: bool = False  # the two bays the analyst left out
    site: bool = False  # platforms, piping, partition wall, hung parts
    seed: int = 0

    @property
    def rng(self) -> np.random.Generator:
        """The generator of the scatter within regions."""
        return np.random.default_rng([self.seed, 77])


SHELL = {"vessel shell": 0.060, "vessel heads": 0.090, "drive deck": 0.100}
SECTIONS = {
    "columns": Section.box(1.10, 1.00, 0.036),
    "girders": Section.box(0.90, 0.60, 0.028),
    "cross beams": Section.box(1.30, 0.90, 0.034),
    "braces": Section.box(0.60, 0.60, 0.030),
    "brackets": Section.box(1.40, 0.90, 0.050),
    "vessel rings": Section.box(0.80, 0.30, 0.040),
    "deck beams": Section.box(1.00, 0.50, 0.034),
    "pedestals": Section.box(1.40, 1.20, 0.050),
    "shaft": Section(area=0.1963, i1=3.07e-3, i2=3.07e-3, j=6.14e-3, k1=0.89, k2=0.89),
}
