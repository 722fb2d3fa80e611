"""The large spinning facility in numbers: one frozen description, filled in differently by analyst
and builder.

SI throughout. x along the bay (25 m), y across (10 m), z up; the origin is a lower corner of the
foundation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True)
class Foundation:
    """The concrete foundation.

    Attributes
    ----------
    length, width : float, m
    slab, wall_top : float, m
        Heights of the top of the slab and of the walls.
    wall, end_wall : float, m
        Thickness of the long walls and of the end walls.
    """

    length: float = 25.0
    width: float = 10.0
    slab: float = 1.25
    wall_top: float = 3.2
    wall: float = 0.9
    end_wall: float = 0.8


@dataclass(frozen=True, slots=True)
class SteelFrame:
    """The steel frame.

    Attributes
    ----------
    portals : tuple of float, m
        x of the portals.
    sides : tuple of float, m
        y of the columns.
    base, mid, top : float, m
        z of the column feet, the lower and the upper girders.
    bays_left_out : tuple of int
        Bays whose braces the analyst left out.
    """

    portals: tuple[float, ...] = (4.0, 7.4, 10.8, 14.2, 17.6, 21.0)
    sides: tuple[float, float] = (0.45, 9.55)
    base: float = 3.25
    mid: float = 5.1
    top: float = 7.5
    bays_left_out: tuple[int, ...] = (1, 3)


@dataclass(frozen=True, slots=True)
class Vessel:
    """The vacuum vessel, whose axis is at z = `SteelFrame.mid`.

    Attributes
    ----------
    y, radius : float, m
    rings, mounts : tuple of float, m
        x of the stiffening rings and of the mounts.
    dish : float, m
        Height of the heads.
    """

    y: float = 5.0
    radius: float = 2.2
    rings: tuple[float, ...] = (5.6, 7.4, 10.8, 14.2, 17.6, 19.4)
    mounts: tuple[float, ...] = (7.4, 10.8, 14.2, 17.6)
    dish: float = 0.9


@dataclass(frozen=True, slots=True)
class Drive:
    """The drive on its deck, which lies at z = `SteelFrame.top`.

    Attributes
    ----------
    deck_x, deck_y : tuple of float, m
        First and last x and y of the deck.
    y, z : float, m
        Of the shaft.
    motor, gearbox, rotor : float, m
        x of each.
    bearings : tuple of float, m
        x of the bearings.
    """

    deck_x: tuple[float, float] = (7.4, 17.6)
    deck_y: tuple[float, float] = (3.2, 6.8)
    y: float = 5.0
    z: float = 8.6
    motor: float = 9.1
    gearbox: float = 12.5
    rotor: float = 16.4
    bearings: tuple[float, float] = (10.8, 15.4)


@dataclass(frozen=True, slots=True)
class Site:
    """What stands on the site: property numbers, see `deck.properties`; and masses, kg, hung so
    softly that they move by themselves.
    """

    partition: int = 5
    platform: int = 71
    pipe: int = 72
    hose_link: int = 73
    crane_link: int = 74
    pipe_clamp: int = 75
    hose_bridge: float = 9_000.0
    crane: float = 12_000.0


FOUNDATION = Foundation()
FRAME = SteelFrame()
VESSEL = Vessel()
SITE = Site()
DRIVE = Drive()


@dataclass(frozen=True, slots=True)
class SectionProperties:
    """A beam section.

    Attributes
    ----------
    area : float, m2
    i1, i2 : float, m4
        Second moments about element z and y.
    j : float, m4
        Torsion constant.
    k1, k2 : float
        Shear factors.
    """

    area: float
    i1: float
    i2: float
    j: float
    k1: float
    k2: float

    @classmethod
    def box(cls, height: float, width: float, t: float) -> SectionProperties:
        """A thin-walled box, height in the plane of bending 1."""
        hi = height - 2 * t
        wi = width - 2 * t
        hm = height - t
        wm = width - t
        area = height * width - hi * wi
        return cls(
            area=area,
            i1=(width * height**3 - wi * hi**3) / 12,
            i2=(height * width**3 - hi * wi**3) / 12,
            j=2 * t * (hm * wm) ** 2 / (hm + wm),
            k1=2 * height * t / area,
            k2=2 * width * t / area,
        )

    def times(self, factor: float) -> SectionProperties:
        """The section of plates thicker by `factor`."""
        f = factor
        return SectionProperties(
            area=f * self.area,
            i1=f * self.i1,
            i2=f * self.i2,
            j=f * self.j,
            k1=self.k1,
            k2=self.k2,
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
        default_factory=lambda: (
            dict.fromkeys(CONCRETE, 2475.0) | dict.fromkeys(STEEL, 7850.0)
        )
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
    # region -> factor on its beam section
    section: Mapping[str, float] = field(default_factory=dict)
    # region -> structural loss factor
    loss: Mapping[str, float] = field(default_factory=dict)
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

    @property
    def zones(self) -> int:
        """Zones that regions are divided into: each has properties of its own."""
        return 1

    def zone(self, region: str, place: tuple[float, float, float]) -> int:
        """The zone of a part of a region that is at a place, m."""
        return 0

    def zone_factor(self, region: str, zone: int) -> float:
        """On the stiffness of a region in a zone."""
        return 1.0


@dataclass(frozen=True, slots=True)
class Cut:
    """Where a region is divided.

    Attributes
    ----------
    axis : int
        0, 1, 2: along x, y, z.
    at : tuple of float, m
        Ascending.
    factors : tuple of float
        On the stiffness in each zone; none: 1 in all.
    """

    axis: int
    at: tuple[float, ...]
    factors: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ZonedSpec(Spec):
    """A facility some of whose regions are divided."""

    cuts: Mapping[str, Cut] = field(default_factory=dict)

    @property
    def zones(self) -> int:
        """Of the region with most of them."""
        return 1 + max((len(cut.at) for cut in self.cuts.values()), default=0)

    def zone(self, region: str, place: tuple[float, float, float]) -> int:
        """Counted along the axis."""
        cut = self.cuts.get(region)
        return sum(place[cut.axis] > x for x in cut.at) if cut else 0

    def zone_factor(self, region: str, zone: int) -> float:
        """As given."""
        cut = self.cuts.get(region)
        return cut.factors[zone] if cut and zone < len(cut.factors) else 1.0


SHELL = {"vessel shell": 0.060, "vessel heads": 0.090, "drive deck": 0.100}
SECTIONS = {
    "columns": SectionProperties.box(1.10, 1.00, 0.036),
    "girders": SectionProperties.box(0.90, 0.60, 0.028),
    "cross beams": SectionProperties.box(1.30, 0.90, 0.034),
    "braces": SectionProperties.box(0.60, 0.60, 0.030),
    "brackets": SectionProperties.box(1.40, 0.90, 0.050),
    "vessel rings": SectionProperties.box(0.80, 0.30, 0.040),
    "deck beams": SectionProperties.box(1.00, 0.50, 0.034),
    "pedestals": SectionProperties.box(1.40, 1.20, 0.050),
    "shaft": SectionProperties(
        area=0.1963,
        i1=3.07e-3,
        i2=3.07e-3,
        j=6.14e-3,
        k1=0.89,
        k2=0.89,
    ),
}
