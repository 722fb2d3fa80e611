"""The facility as a mesh: foundation, frame, vessel, drive, and what stands on the site."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float, Int
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.spec import Spec

Value = int | float | str | None
_GRAIN = 1e-4  # m: nodes closer than this are one


@dataclass
class Mesh:
    """Cards in the making; the only mutable thing of the worked example."""

    nodes: dict[tuple[int, int, int], int] = field(default_factory=dict)
    xyz: list[tuple[float, float, float]] = field(default_factory=list)
    cards: list[tuple[str, str, tuple[Value, ...]]] = field(
        default_factory=list
    )  # (part, card, fields)
    next_element: dict[str, int] = field(default_factory=dict)
    part: str = "main"
    part_of_node: list[str] = field(default_factory=list)
    bases: dict[str, int] = field(default_factory=dict)
    ids: list[int] = field(default_factory=list)
    count: dict[str, int] = field(default_factory=dict)

    def node(self, x: float, y: float, z: float, *, new: bool = False) -> int:
        """The node at a place; `new` makes a coincident one."""
        key = (round(x / _GRAIN), round(y / _GRAIN), round(z / _GRAIN))
        if not new and key in self.nodes:
            return self.nodes[key]
        n = self.count.get(self.part, 0) + 1
        self.count[self.part] = n
        number = self.bases.get(self.part, 0) + n
        self.xyz.append((x, y, z))
        self.ids.append(number)
        self.part_of_node.append(self.part)
        if not new:
            self.nodes[key] = number
        return number

    def lattice(self, points: Float) -> Int:
        """Nodes at points (..., 3), the same shape without the last axis."""
        flat = [self.node(*p) for p in points.reshape(-1, 3).tolist()]
        return np.array(flat).reshape(points.shape[:-1])

    def add(self, card: str, *fields: Value) -> None:
        """A card of the current part."""
        self.cards.append((self.part, card, fields))

    def element(self, card: str, *fields: Value) -> int:
        """An element card numbered next in the current part; `fields` follow the number."""
        n = self.next_element.get(self.part, 0) + 1
        self.next_element[self.part] = n
        eid = self.bases.get(self.part, 0) + n
        self.add(card, eid, *fields)
        return eid

    def rows(self, card: str, pid: int, nodes: NDArray[np.int64]) -> None:
        """Elements with nodes (e, k)."""
        for row in nodes.tolist():
            self.element(card, pid, *row)

    def nearest(self, part: str, point: Sequence[float], k: int = 1) -> list[int]:
        """The k nodes of a part that are nearest to a point."""
        at = [i for i, p in enumerate(self.part_of_node) if p == part]
        d = np.linalg.norm(np.array([self.xyz[i] for i in at]) - np.array(point), axis=1)
        return [self.ids[at[j]] for j in np.argsort(d, kind="stable")[:k].tolist()]


BASES = {
    "foundation": 100_000,
    "springs": 180_000,
    "frame": 200_000,
    "vessel": 300_000,
    "drive": 400_000,
    "site": 600_000,
}
_OUT = (1.0, 0.0, 0.0)  # radial, in the cylindrical analysis frame of the vessel's nodes
VARIANTS = 5  # materials a region with scatter is split into


class Builder:
    """The mesh in the making with the choice of property for each element and bush."""

    def __init__(self, spec: Spec) -> None:
        self.spec, self.mesh, self.rng = spec, Mesh(bases=dict(BASES)), spec.rng
        self.bushes: list[tuple[str, int, float]] = []  # region, PID, factor

    def property(self, region: str) -> int:
        """A property number of the region: one of its variants where the stiffness scatters."""
        base = {**S.CONCRETE, **S.STEEL}[region]
        return base + (1000 * int(self.rng.integers(VARIANTS)) if self.spec.scatter else 0)

    def properties(self, region: str, n: int) -> Int:
        """The same for n elements."""
        return np.array([self.property(region) for _ in range(n)], dtype=np.int64)

    def bush(self, region: str, a: int, b: int | None, cid: int | None = 0) -> None:
        """A CBUSH; its own property where bushes differ."""
        base = S.BUSHES[region]
        if self.spec.bush_scatter:
            pid = base * 100 + 1 + sum(r == region for r, _, _ in self.bushes)
            factor = float(np.exp(self.spec.bush_scatter * self.rng.standard_normal()))
        else:
            pid, factor = base, 1.0
        self.bushes.append((region, pid, factor))
        self.mesh.element("CBUSH", pid, a, b, None, None, None, cid)

    def beams(
        self,
        card: str,
        region: str,
        nodes: Int,
        v: tuple[float, float, float],
        *tail: float | str | None,
    ) -> None:
        """Beam elements along a line of nodes (n,) with orientation v."""
        for a, b in zip(nodes[:-1].tolist(), nodes[1:].tolist(), strict=True):
            self.mesh.element(card, self.property(region), a, b, *v, *tail)


def _line(a: Float | tuple[float, ...], b: Float | tuple[float, ...], n: int) -> Float:
    return np.linspace(np.asarray(a), np.asarray(b), n + 1)


def _ticks(stops: tuple[float, ...], counts: tuple[int, ...]) -> Float:
    parts = [
        np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(stops[:-1], stops[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, stops[-1:]])


def foundation(b: Builder) -> None:
    """Slab, long walls, end walls as hexahedra; haunches as pentahedra."""
    m, n = b.mesh, b.spec.mesh
    m.part = "foundation"
    x = np.linspace(0, S.LENGTH, n.nx + 1)
    x[np.argmin(np.abs(x - S.END_WALL))] = S.END_WALL
    x[np.argmin(np.abs(x - (S.LENGTH - S.END_WALL)))] = S.LENGTH - S.END_WALL
    y = _ticks((0.0, S.WALL, S.WIDTH - S.WALL, S.WIDTH), (n.ny_wall, n.ny, n.ny_wall))
    z = _ticks((0.0, S.SLAB, S.WALL_TOP), (n.nz_slab, n.nz_wall))
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    cx, cy, cz = (0.5 * (t[:-1] + t[1:]) for t in (x, y, z))
    long_wall = (cy < S.WALL) | (cy > S.WIDTH - S.WALL)
    end_wall = (cx < S.END_WALL) | (cx > S.LENGTH - S.END_WALL)
    region = np.zeros((cx.size, cy.size, cz.size), dtype=np.int64)
    region[:, :, cz < S.SLAB] = 1
    region[np.ix_(end_wall, np.ones(cy.size, bool), cz > S.SLAB)] = 3
    region[np.ix_(np.ones(cx.size, bool), long_wall, cz > S.SLAB)] = 2
    if b.spec.site:
        cross = np.abs(cx - 9.0) < 0.6 * (x[1] - x[0])
        region[np.ix_(cross, ~long_wall, (cz > S.SLAB) & (cz < 2.2))] = PARTITION
    used = np.zeros(grid.shape[:3], dtype=bool)
    i, j, k = np.nonzero(region)
    for di, dj, dk in np.ndindex(2, 2, 2):
        used[i + di, j + dj, k + dk] = True
    number = np.zeros(used.shape, dtype=np.int64)
    number[used] = m.lattice(grid[used])
    corner = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    nodes = np.stack([number[i + a, j + c, k + d] for a, c, d in corner], axis=1)
    name = {v: r for r, v in S.CONCRETE.items()}
    for value in (1, 2, 3):
        pick = region[i, j, k] == value
        for pid, row in zip(
            b.properties(name[value], int(pick.sum())).tolist(), nodes[pick].tolist(), strict=True
        ):
            m.element("CHEXA", pid, *row)
    for row in nodes[region[i, j, k] == PARTITION].tolist():
        m.element("CHEXA", PARTITION, *row)
    _haunches(b, number, x=x, j0=n.ny_wall, j1=y.size - 1 - n.ny_wall, k=n.nz_slab)


def _haunches(b: Builder, number: Int, x: Float, j0: int, j1: int, k: int) -> None:
    inside = np.flatnonzero((x[:-1] > S.END_WALL - 1e-6) & (x[1:] < S.LENGTH - S.END_WALL + 1e-6))
    for i in inside.tolist():
        for j, dj in ((j0, 1), (j1, -1)):
            a = [number[i, j, k], number[i, j + dj, k], number[i, j, k + 1]]
            c = [number[i + 1, j, k], number[i + 1, j + dj, k], number[i + 1, j, k + 1]]
            first, second = (a, c) if dj > 0 else (c, a)
            b.mesh.element("CPENTA", b.property("haunches"), *map(int, first), *map(int, second))


def springs(b: Builder) -> None:
    """32 air springs under the slab, to ground."""
    m = b.mesh
    for x in np.linspace(3.0, S.LENGTH - 3.0, 8).tolist():
        for y in (0.9, 3.5, 6.5, 9.1):
            (node,) = m.nearest("foundation", (x, y, 0.0))
            m.part = "springs"
            b.bush("air springs", node, None)


def frame(b: Builder) -> None:
    """Six portals on anchors, girders, roof and side braces, brackets for the vessel."""
    m, n = b.mesh, b.spec.mesh
    m.part = "frame"
    for i, x in enumerate(S.PORTALS):
        group = "anchors front" if i < 2 else "anchors middle" if i < 4 else "anchors rear"
        for y in S.SIDES:
            column = np.concatenate(
                [
                    _line((x, y, S.BASE), (x, y, S.MID), n.column[0])[:-1],
                    _line((x, y, S.MID), (x, y, S.TOP), n.column[1]),
                ]
            )
            nodes = m.lattice(column)
            b.beams("CBEAM", "columns", nodes, (1.0, 0.0, 0.0))
            foot = m.node(x, y, S.BASE, new=True)
            near = m.nearest("foundation", (x, y, S.WALL_TOP), 9 if n.nx < 80 else 15)
            m.element("RBE3", None, foot, "123456", 1.0, "123", *near)
            b.bush(group, int(nodes[0]), foot)
        stops = (S.SIDES[0], S.DECK_Y[0], S.DECK_Y[1], S.SIDES[1])
        counts = (n.span, n.deck_y, n.span)
        across = _ticks(stops, counts)
        b.beams(
            "CBEAM",
            "cross beams",
            m.lattice(
                np.stack([np.full_like(across, x), across, np.full_like(across, S.TOP)], axis=1)
            ),
            (0.0, 0.0, 1.0),
        )
    for z in (S.MID, S.TOP):
        for y in S.SIDES:
            for a, c in zip(S.PORTALS[:-1], S.PORTALS[1:], strict=True):
                b.beams(
                    "CBAR",
                    "girders",
                    m.lattice(_line((a, y, z), (c, y, z), n.span)),
                    (0.0, 0.0, 1.0),
                )
    _braces(b)
    for x in S.MOUNT_X:
        for y, inner in ((S.SIDES[0], S.AXIS_Y - S.RADIUS), (S.SIDES[1], S.AXIS_Y + S.RADIUS)):
            b.beams(
                "CBEAM",
                "brackets",
                m.lattice(_line((x, y, S.MID), (x, inner, S.MID), 3)),
                (0.0, 0.0, 1.0),
            )


def _braces(b: Builder) -> None:
    bays = list(zip(S.PORTALS[:-1], S.PORTALS[1:], strict=True))
    b.mesh.part = "frame"
    storeys = [(i, S.BASE, S.MID) for i in (0, 2, 4)] + [(i, S.MID, S.TOP) for i in (0, 2, 4)]
    if b.spec.extra_braces:
        storeys += [(i, S.MID, S.TOP) for i in S.BAYS_LEFT_OUT]
    for y in S.SIDES:
        for i, low, high in storeys:
            a, c = bays[i]
            ends = b.mesh.lattice(np.array([(a, y, low), (c, y, high)]))
            b.mesh.element(
                "CBAR", b.property("braces"), *ends.tolist(), 0.0, 1.0, 0.0, None, "56", "56"
            )
    for i in (0, 4):
        a, c = bays[i]
        for one, two in ((0, 1), (1, 0)):
            ends = b.mesh.lattice(np.array([(a, S.SIDES[one], S.TOP), (c, S.SIDES[two], S.TOP)]))
            b.mesh.element(
                "CBAR", b.property("braces"), *ends.tolist(), 0.0, 0.0, 1.0, None, "56", "56"
            )


def vessel(b: Builder) -> None:
    """A cylinder of shells with stiffening rings and dished heads, held by its mounts."""
    m, n = b.mesh, b.spec.mesh
    m.part = "vessel"
    x = _ticks(S.VESSEL_X, n.along)
    t = 2 * np.pi * np.arange(n.around) / n.around
    ring = np.stack([S.AXIS_Y + S.RADIUS * np.cos(t), S.MID + S.RADIUS * np.sin(t)], axis=1)
    points = np.concatenate(
        [
            np.broadcast_to(x[:, None, None], (x.size, t.size, 1)),
            np.broadcast_to(ring, (x.size, t.size, 2)),
        ],
        axis=2,
    )
    g = m.lattice(points)
    right = np.roll(g, -1, axis=1)
    quads = np.stack([g[:-1], right[:-1], right[1:], g[1:]], axis=-1).reshape(-1, 4)
    for pid, row in zip(
        b.properties("vessel shell", len(quads)).tolist(), quads.tolist(), strict=True
    ):
        m.element("CQUAD4", pid, *row)
    outward = (0.43, 0.0, 0.0)  # the rings stand outside the shell
    for stop in S.VESSEL_X:
        at = int(np.argmin(np.abs(x - stop)))
        loop = np.append(g[at], g[at, 0])
        for a, c in zip(loop[:-1].tolist(), loop[1:].tolist(), strict=True):
            m.element(
                "CBAR",
                b.property("vessel rings"),
                a,
                c,
                *_OUT,
                None,
                None,
                None,
                *outward,
                *outward,
            )
    for end, sign in ((0, -1.0), (x.size - 1, 1.0)):
        _head(b, g[end], float(x[end]), t, sign)
    spread = 9 if n.around <= 48 else 21  # nodes that share a mount
    for mx in S.MOUNT_X:
        region = "vessel mounts front" if mx < 12.5 else "vessel mounts rear"
        for side in (-1.0, 1.0):
            place = (mx, S.AXIS_Y + side * S.RADIUS, S.MID)
            m.part = "vessel"
            pad = m.node(*place, new=True)
            near = [i for i in m.nearest("vessel", place, spread + 1) if i != pad][:spread]
            m.element("RBE3", None, pad, "123456", 1.0, "123", *near)
            b.bush(region, m.nearest("frame", place)[0], pad)


def _head(b: Builder, rim: Int, x: float, t: Float, sign: float) -> None:
    m, layers = b.mesh, b.spec.mesh.head
    outer = rim
    for i in range(1, layers):
        r = S.RADIUS * (1 - i / layers)
        bulge = S.DISH * (1 - (r / S.RADIUS) ** 2)
        pts = np.stack(
            [np.full_like(t, x + sign * bulge), S.AXIS_Y + r * np.cos(t), S.MID + r * np.sin(t)],
            axis=1,
        )
        inner = m.lattice(pts)
        for j in range(t.size):
            k = (j + 1) % t.size
            quad = [outer[j], outer[k], inner[k], inner[j]]
            m.element(
                "CQUAD4", b.property("vessel heads"), *map(int, quad if sign < 0 else quad[::-1])
            )
        outer = inner
    pole = m.node(x + sign * S.DISH, S.AXIS_Y, S.MID)
    for j in range(t.size):
        k = (j + 1) % t.size
        tri = [int(outer[j]), int(outer[k]), pole]
        m.element("CTRIA3", b.property("vessel heads"), *(tri if sign < 0 else tri[::-1]))


def drive(b: Builder) -> None:
    """Drive deck on the frame; motor, gearbox, bearings, shaft and rotor."""
    m, n = b.mesh, b.spec.mesh
    m.part = "drive"
    stops = tuple(p for p in S.PORTALS if S.DECK_X[0] <= p <= S.DECK_X[1])
    x = _ticks(stops, (n.deck_x,) * (len(stops) - 1))
    y = np.linspace(*S.DECK_Y, n.deck_y + 1)
    g = m.lattice(np.stack(np.meshgrid(x, y, [S.TOP], indexing="ij"), axis=-1)[:, :, 0])
    quads = np.stack([g[:-1, :-1], g[1:, :-1], g[1:, 1:], g[:-1, 1:]], axis=-1).reshape(-1, 4)
    for pid, row in zip(
        b.properties("drive deck", len(quads)).tolist(), quads.tolist(), strict=True
    ):
        m.element("CQUAD4", pid, *row)
    for j in (0, n.deck_y // 4, n.deck_y // 2, n.deck_y - n.deck_y // 4, n.deck_y):
        b.beams(
            "CBEAM",
            "deck beams",
            g[:, j],
            (0.0, 0.0, 1.0),
            None,
            None,
            None,
            0.0,
            0.0,
            -0.33,
            0.0,
            0.0,
            -0.33,
        )
    motor = _machine(
        b, "motor mounts", x=S.MOTOR, mass=20_000.0, inertia=(9000.0, 26000.0, 28000.0), half=0.8
    )
    gear = _machine(
        b, "gearbox mounts", x=S.GEARBOX, mass=9_000.0, inertia=(3500.0, 4200.0, 5000.0), half=0.6
    )
    _shaft(b, motor, gear)


def _deck_node(m: Mesh, x: float, y: float) -> int:
    at = [
        (abs(m.xyz[i][0] - x) + abs(m.xyz[i][1] - y), m.ids[i])
        for i in range(len(m.ids))
        if abs(m.xyz[i][2] - S.TOP) < 1e-6
        and S.DECK_Y[0] - 1e-6 <= m.xyz[i][1] <= S.DECK_Y[1] + 1e-6
    ]
    return min(at)[1]


def _machine(
    b: Builder, region: str, x: float, mass: float, inertia: tuple[float, float, float], half: float
) -> int:
    """A rigid machine on four mounts; returns the node of its centre."""
    m = b.mesh
    centre = m.node(x, S.AXIS_Y, S.SHAFT_Z)
    m.element(
        "CONM2",
        centre,
        None,
        mass,
        None,
        None,
        None,
        None,
        inertia[0],
        None,
        inertia[1],
        None,
        None,
        inertia[2],
    )
    feet = []
    for dx in (-half, half):
        for dy in (-0.9, 0.9):
            plate = _deck_node(m, x + dx, S.AXIS_Y + dy)
            px, py, pz = m.xyz[m.ids.index(plate)]
            foot = m.node(px, py, pz, new=True)
            feet.append(foot)
            b.bush(region, foot, plate, 10 if region == "motor mounts" else 0)
    m.element("RBE2", centre, "123456", *feet)
    return centre


def _shaft(b: Builder, motor: int, gear: int) -> None:
    m = b.mesh
    stations = _ticks((S.MOTOR, S.BEARINGS[0], S.GEARBOX, S.BEARINGS[1], S.ROTOR), (3, 3, 4, 2))
    nodes = m.lattice(
        np.stack(
            [stations, np.full_like(stations, S.AXIS_Y), np.full_like(stations, S.SHAFT_Z)], axis=1
        )
    )
    b.beams("CBAR", "shaft", nodes, (0.0, 0.0, 1.0))
    m.element(
        "CONM2",
        int(nodes[-1]),
        None,
        2_500.0,
        None,
        None,
        None,
        None,
        400.0,
        None,
        250.0,
        None,
        None,
        250.0,
    )
    for x in S.BEARINGS:
        foot = _deck_node(m, x, S.AXIS_Y)
        fx, fy, fz = m.xyz[m.ids.index(foot)]
        top = m.node(x, S.AXIS_Y, S.SHAFT_Z, new=True)
        column = np.array([foot, m.node(fx, fy, 0.5 * (fz + S.SHAFT_Z)), top])
        b.beams("CBEAM", "pedestals", column, (0.0, 1.0, 0.0))
        b.bush("bearing mounts", m.node(x, S.AXIS_Y, S.SHAFT_Z), top)


def build(spec: Spec) -> Builder:
    """The whole facility."""
    b = Builder(spec)
    foundation(b)
    frame(b)
    vessel(b)
    drive(b)
    springs(b)
    if spec.site:
        site(b)
    return b


# property number -> what it is made of; see `deck.properties`
PARTITION, PLATFORM, PIPE, HOSE_LINK, CRANE_LINK, PIPE_CLAMP = 5, 71, 72, 73, 74, 75
HOSE_BRIDGE, CRANE = 9_000.0, 12_000.0  # kg, hung so softly that they move alone
CABINETS = ((4.0, 0.45, S.TOP, 1500.0), (21.0, 9.55, S.MID, 2500.0), (14.2, 9.55, S.TOP, 1200.0))


def site(b: Builder) -> None:
    """Adds the parts that the analyst left out."""
    _platform(b)
    _piping(b)
    _hung(b)
    for x, y, z, mass in CABINETS:
        b.mesh.element("CONM2", b.mesh.node(x, y, z), None, mass)


def _platform(b: Builder) -> None:
    """A service platform along one side of the frame, cantilevered from the lower girder."""
    m, n = b.mesh, b.spec.mesh
    m.part = "site"
    spans = [np.linspace(a, c, n.span + 1)[:-1] for a, c in pairwise(S.PORTALS)]
    x = np.concatenate([*spans, S.PORTALS[-1:]])
    y = S.SIDES[0] - np.array([0.0, 0.4, 0.8])
    g = m.lattice(np.stack(np.meshgrid(x, y, [S.MID], indexing="ij"), axis=-1)[:, :, 0])
    for i in range(x.size - 1):
        for j in range(y.size - 1):
            m.element(
                "CQUAD4", PLATFORM, *map(int, (g[i, j], g[i + 1, j], g[i + 1, j + 1], g[i, j + 1]))
            )


def _piping(b: Builder) -> None:
    m = b.mesh
    m.part = "site"
    x = np.concatenate(
        [np.linspace(a, c, 5)[:-1] for a, c in zip(S.PORTALS[:-1], S.PORTALS[1:], strict=True)]
    )
    x = np.append(x, S.PORTALS[-1])
    y, z = S.SIDES[1] - 0.6, S.MID + 0.5
    nodes = m.lattice(np.stack([x, np.full_like(x, y), np.full_like(x, z)], axis=1))
    for a, c in pairwise(nodes.tolist()):
        m.element("CBEAM", PIPE, a, c, 0.0, 0.0, 1.0)
    for i in range(0, len(nodes), 4):
        girder = m.nearest("frame", (float(x[i]), S.SIDES[1], S.MID))[0]
        m.element("CBUSH", PIPE_CLAMP, int(nodes[i]), girder, None, None, None, 0, 0.0)


def _hung(b: Builder) -> None:
    m = b.mesh
    m.part = "site"
    for point, place, mass, pid in (
        (
            m.nearest("foundation", (25.0, 5.0, S.WALL_TOP))[0],
            (25.0, 5.0, S.WALL_TOP),
            HOSE_BRIDGE,
            HOSE_LINK,
        ),
        (
            m.nearest("foundation", (0.0, 5.0, S.WALL_TOP))[0],
            (0.0, 5.0, S.WALL_TOP),
            CRANE,
            CRANE_LINK,
        ),
    ):
        hung = m.node(*place, new=True)
        m.element("CONM2", hung, None, mass)
        m.element("CBUSH", pid, hung, point, None, None, None, 0)
