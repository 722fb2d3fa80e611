"""The facility as a mesh: foundation, frame, vessel, drive, and what stands on the site."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.spec import DRIVE, FOUNDATION, FRAME, SITE, VESSEL, Spec

Value = int | float | str | None
Vector = tuple[float, float, float]
# orientation vectors of beams
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# part -> number before that of its first node and element
BASES = {
    "foundation": 100_000,
    "springs": 180_000,
    "frame": 200_000,
    "vessel": 300_000,
    "drive": 400_000,
    "site": 600_000,
}
VARIANTS = 5  # materials a region with scatter is split into
ZONE = 10_000  # between the property numbers of zones of a region


@dataclass(eq=False)
class Builder:
    """Nodes and cards in the making; the only mutable thing of the worked example.

    Attributes
    ----------
    spec : Spec
    part : str
        Where new nodes and elements go.
    xyz, ids, part_of_node : list
        Of the nodes, in the order in which they were made.
    cards : list of (part, card, fields)
    bushes : list of (region, property number, factor on its stiffness)
    """

    spec: Spec
    part: str = "foundation"
    xyz: list[Vector] = field(default_factory=list)
    ids: list[int] = field(default_factory=list)
    part_of_node: list[str] = field(default_factory=list)
    cards: list[tuple[str, str, tuple[Value, ...]]] = field(default_factory=list)
    bushes: list[tuple[str, int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = self.spec.rng
        self._node_at: dict[tuple[int, ...], int] = {}
        self._position: dict[int, int] = {}
        self._last_node = dict(BASES)
        self._last_element = dict(BASES)

    def node(self, x: float, y: float, z: float, *, new: bool = False) -> int:
        """The node at a place, to 0.1 mm; `new` makes a coincident one."""
        key = tuple(round(v / 1e-4) for v in (x, y, z))
        if not new and key in self._node_at:
            return self._node_at[key]
        self._last_node[self.part] += 1
        number = self._last_node[self.part]
        self.xyz.append((x, y, z))
        self._position[number] = len(self.ids)
        self.ids.append(number)
        self.part_of_node.append(self.part)
        if not new:
            self._node_at[key] = number
        return number

    def nodes(self, points: Float) -> Int:
        """Nodes at points (..., 3), the same shape without the last axis."""
        flat = [self.node(*p) for p in points.reshape(-1, 3).tolist()]
        return np.array(flat).reshape(points.shape[:-1])

    def place(self, node: int) -> Vector:
        """Where a node is."""
        return self.xyz[self._position[node]]

    def nearest(self, part: str, point: Sequence[float], k: int = 1) -> list[int]:
        """The k nodes of a part that are nearest to a point."""
        at = [i for i, p in enumerate(self.part_of_node) if p == part]
        d = np.linalg.norm(
            np.array([self.xyz[i] for i in at]) - np.array(point), axis=1
        )
        return [self.ids[at[j]] for j in np.argsort(d, kind="stable")[:k].tolist()]

    def element(self, card: str, *fields: Value) -> None:
        """An element card numbered next in the current part; `fields` follow the number."""
        self._last_element[self.part] += 1
        self.cards.append((self.part, card, (self._last_element[self.part], *fields)))

    def property(self, region: str, nodes: Sequence[int]) -> int:
        """A property number of the region where these nodes are: one of its variants where the
        stiffness scatters.
        """
        base = {**S.CONCRETE, **S.STEEL}[region] + ZONE * self._zone(region, nodes)
        if not self.spec.scatter:
            return base
        return base + 1000 * int(self.rng.integers(VARIANTS))

    def _zone(self, region: str, nodes: Sequence[int]) -> int:
        """Where the middle of some nodes is."""
        if self.spec.zones == 1:
            return 0
        x, y, z = np.mean([self.place(n) for n in nodes], axis=0).tolist()
        return self.spec.zone(region, (x, y, z))

    def elements(self, card: str, region: str, nodes: Int) -> None:
        """Elements of a region with nodes (..., k)."""
        for row in nodes.reshape(-1, nodes.shape[-1]).tolist():
            self.element(card, self.property(region, row), *row)

    def beams(
        self, card: str, region: str, nodes: Int, v: Vector, tail: Sequence[Value] = ()
    ) -> None:
        """Beam elements along a line of nodes (n,), with orientation v and further fields."""
        for ends in pairwise(nodes.tolist()):
            self.element(card, self.property(region, ends), *ends, *v, *tail)

    def bush(self, region: str, a: int, b: int | None, cid: int | None = 0) -> None:
        """A CBUSH; its own property where bushes differ."""
        pid = S.BUSHES[region] + ZONE * self._zone(region, [a])
        factor = 1.0
        if self.spec.bush_scatter:
            pid = (
                S.BUSHES[region] * 100 + 1 + sum(r == region for r, _, _ in self.bushes)
            )
            factor = float(np.exp(self.spec.bush_scatter * self.rng.standard_normal()))
        self.bushes.append((region, pid, factor))
        self.connect(pid, (a, b), cid)

    def connect(self, pid: int, ends: tuple[int, int | None], *frame: Value) -> None:
        """A CBUSH of a given property; `frame` is its CID and what follows."""
        blank = (None, None, None)
        self.element("CBUSH", pid, *ends, *blank, *frame)

    def mass(self, node: int, mass: float, inertia: Vector | None = None) -> None:
        """A CONM2 at its node."""
        tail: tuple[Value, ...] = ()
        if inertia is not None:
            i11, i22, i33 = inertia
            offset = (None, None, None)
            tail = (*offset, None, i11, None, i22, None, None, i33)
        self.element("CONM2", node, None, mass, *tail)

    def follow(self, node: int, others: Sequence[int]) -> None:
        """An RBE3: the node moves with the mean translation and rotation of the others."""
        weighted: tuple[Value, ...] = (1.0, "123", *others)
        self.element("RBE3", None, node, "123456", *weighted)


def _points(x: Any_ | float, y: Any_ | float, z: Any_ | float) -> Float:
    """Points (..., 3) of coordinates that are broadcast."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def _ticks(stops: Sequence[float], counts: Sequence[int]) -> Float:
    """Coordinates from stop to stop, with so many elements between each two."""
    spans = zip(pairwise(stops), counts, strict=True)
    parts = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in spans]
    return np.concatenate([*parts, stops[-1:]])


def _grid(nodes: Int) -> Int:
    """Corners (e, 4) of the quadrilaterals between a grid of nodes (i, j)."""
    corners = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
    return np.stack(corners, axis=-1).reshape(-1, 4)


def build(spec: Spec) -> Builder:
    """The whole facility."""
    b = Builder(spec)
    _foundation(b)
    _frame(b)
    _vessel(b)
    _drive(b)
    _springs(b)
    if spec.site:
        _platform(b)
        _piping(b)
        _hung(b)
        _cabinets(b)
    return b


def _foundation(b: Builder) -> None:
    """Slab, long walls, end walls as hexahedra; haunches as pentahedra."""
    b.part = "foundation"
    n = b.spec.mesh
    at = FOUNDATION
    x = np.linspace(0, at.length, n.nx + 1)
    for inner in (at.end_wall, at.length - at.end_wall):
        x[np.argmin(np.abs(x - inner))] = inner
    y = _ticks(
        (0.0, at.wall, at.width - at.wall, at.width), (n.ny_wall, n.ny, n.ny_wall)
    )
    z = _ticks((0.0, at.slab, at.wall_top), (n.nz_slab, n.nz_wall))
    cx, cy, cz = (0.5 * (t[:-1] + t[1:]) for t in (x, y, z))
    cx = cx[:, None, None]
    cy = cy[:, None]
    above = cz > at.slab
    long_wall = (cy < at.wall) | (cy > at.width - at.wall)
    end_wall = (cx < at.end_wall) | (cx > at.length - at.end_wall)
    region = np.zeros((x.size - 1, y.size - 1, z.size - 1), dtype=np.int64)
    region[:, :, ~above] = S.CONCRETE["slab"]
    region[end_wall & (cy > 0) & above] = S.CONCRETE["end walls"]
    region[(cx > 0) & long_wall & above] = S.CONCRETE["long walls"]
    if b.spec.site:
        cross = np.abs(cx - 9.0) < 0.6 * (x[1] - x[0])
        region[cross & ~long_wall & above & (cz < 2.2)] = SITE.partition
    used = np.zeros((x.size, y.size, z.size), dtype=bool)
    i, j, k = np.nonzero(region)
    for di, dj, dk in np.ndindex(2, 2, 2):
        used[i + di, j + dj, k + dk] = True
    number = np.zeros(used.shape, dtype=np.int64)
    number[used] = b.nodes(_points(x[:, None, None], y[:, None], z)[used])
    round_a_face = ((0, 0), (1, 0), (1, 1), (0, 1))
    corner = [
        number[i + di, j + dj, k + dk] for dk in (0, 1) for di, dj in round_a_face
    ]
    nodes = np.stack(corner, axis=1)
    what = region[i, j, k]
    for name in ("slab", "long walls", "end walls"):
        b.elements("CHEXA", name, nodes[what == S.CONCRETE[name]])
    for row in nodes[what == SITE.partition].tolist():
        b.element("CHEXA", SITE.partition, *row)
    first = n.ny_wall
    last = y.size - 1 - n.ny_wall
    inside = (x[:-1] > at.end_wall - 1e-6) & (x[1:] < at.length - at.end_wall + 1e-6)
    _haunches(b, number[:, :, n.nz_slab :], np.flatnonzero(inside), walls=(first, last))


def _haunches(b: Builder, number: Int, inside: Int, walls: tuple[int, int]) -> None:
    """Wedges between the slab and the long walls; `number` are the nodes from the slab upwards."""
    for i in inside.tolist():
        for j, inwards in zip(walls, (1, -1), strict=True):
            faces = [
                [number[at, j, 0], number[at, j + inwards, 0], number[at, j, 1]]
                for at in (i, i + 1)[::inwards]
            ]
            b.elements("CPENTA", "haunches", np.ravel(faces))


def _springs(b: Builder) -> None:
    """32 air springs under the slab, to ground."""
    for x in np.linspace(3.0, FOUNDATION.length - 3.0, 8).tolist():
        for y in (0.9, 3.5, 6.5, 9.1):
            (node,) = b.nearest("foundation", (x, y, 0.0))
            b.part = "springs"
            b.bush("air springs", node, None)


def _frame(b: Builder) -> None:
    """Six portals on anchors, girders, roof and side braces, brackets for the vessel."""
    b.part = "frame"
    n = b.spec.mesh
    groups = ("anchors front", "anchors middle", "anchors rear")
    stops = (FRAME.sides[0], *DRIVE.deck_y, FRAME.sides[1])
    across = _ticks(stops, (n.span, n.deck_y, n.span))
    upwards = _ticks((FRAME.base, FRAME.mid, FRAME.top), n.column)
    for i, x in enumerate(FRAME.portals):
        for y in FRAME.sides:
            nodes = b.nodes(_points(x, y, upwards))
            b.beams("CBEAM", "columns", nodes, X)
            foot = b.node(x, y, FRAME.base, new=True)
            near = 9 if n.nx < 80 else 15
            b.follow(foot, b.nearest("foundation", (x, y, FOUNDATION.wall_top), near))
            b.bush(groups[i // 2], int(nodes[0]), foot)
        b.beams("CBEAM", "cross beams", b.nodes(_points(x, across, FRAME.top)), Z)
    for z in (FRAME.mid, FRAME.top):
        for y in FRAME.sides:
            for a, c in pairwise(FRAME.portals):
                along = np.linspace(a, c, n.span + 1)
                b.beams("CBAR", "girders", b.nodes(_points(along, y, z)), Z)
    _braces(b)
    for x in VESSEL.mounts:
        for y, side in zip(FRAME.sides, (-1.0, 1.0), strict=True):
            inwards = np.linspace(y, VESSEL.y + side * VESSEL.radius, 4)
            b.beams("CBEAM", "brackets", b.nodes(_points(x, inwards, FRAME.mid)), Z)


def _braces(b: Builder) -> None:
    """Diagonals of the sides and of the roof, hinged at both ends."""
    bays = list(pairwise(FRAME.portals))
    hinged = (None, "56", "56")
    storeys = [(i, FRAME.base, FRAME.mid) for i in (0, 2, 4)]
    storeys += [(i, FRAME.mid, FRAME.top) for i in (0, 2, 4)]
    if b.spec.extra_braces:
        storeys += [(i, FRAME.mid, FRAME.top) for i in FRAME.bays_left_out]
    for y in FRAME.sides:
        for i, low, high in storeys:
            ends = b.nodes(_points(np.array(bays[i]), y, np.array([low, high])))
            b.beams("CBAR", "braces", ends, Y, hinged)
    for i in (0, 4):
        for sides in (FRAME.sides, FRAME.sides[::-1]):
            ends = b.nodes(_points(np.array(bays[i]), np.array(sides), FRAME.top))
            b.beams("CBAR", "braces", ends, Z, hinged)


def _vessel(b: Builder) -> None:
    """A cylinder of shells with stiffening rings and dished heads, held by its mounts."""
    b.part = "vessel"
    n = b.spec.mesh
    x = _ticks(VESSEL.rings, n.along)
    angle = 2 * np.pi * np.arange(n.around) / n.around
    round_y = np.cos(angle)
    round_z = np.sin(angle)
    y = VESSEL.y + VESSEL.radius * round_y
    z = FRAME.mid + VESSEL.radius * round_z
    loops = b.nodes(_points(x[:, None], y, z))
    closed = np.concatenate([loops, loops[:, :1]], axis=1)
    low = closed[:-1]
    high = closed[1:]
    quads = np.stack([low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]], axis=-1)
    b.elements("CQUAD4", "vessel shell", quads)
    # in the cylindrical frame of the nodes: outside the shell
    outward = (0.43, 0.0, 0.0)
    for stop in VESSEL.rings:
        loop = closed[np.argmin(np.abs(x - stop))]
        b.beams("CBAR", "vessel rings", loop, X, (None, None, None, *outward, *outward))
    for end, outwards in ((0, -1.0), (-1, 1.0)):
        rim = loops[end]
        for i in range(1, n.head):
            r = VESSEL.radius * (1 - i / n.head)
            bulge = VESSEL.dish * (1 - (r / VESSEL.radius) ** 2)
            y = VESSEL.y + r * round_y
            z = FRAME.mid + r * round_z
            inner = b.nodes(_points(x[end] + outwards * bulge, y, z))
            quads = np.stack([rim, np.roll(rim, -1), np.roll(inner, -1), inner], axis=1)
            b.elements(
                "CQUAD4", "vessel heads", quads if outwards < 0 else quads[:, ::-1]
            )
            rim = inner
        pole = b.node(float(x[end]) + outwards * VESSEL.dish, VESSEL.y, FRAME.mid)
        triangles = np.stack([rim, np.roll(rim, -1), np.full_like(rim, pole)], axis=1)
        b.elements(
            "CTRIA3", "vessel heads", triangles if outwards < 0 else triangles[:, ::-1]
        )
    _vessel_mounts(b, 9 if n.around <= 48 else 21)


def _vessel_mounts(b: Builder, shared: int) -> None:
    """Bushes between the brackets and pads, each moving with `shared` nodes of the shell."""
    for x in VESSEL.mounts:
        region = "vessel mounts front" if x < 12.5 else "vessel mounts rear"
        for side in (-1.0, 1.0):
            place = (x, VESSEL.y + side * VESSEL.radius, FRAME.mid)
            pad = b.node(*place, new=True)
            near = [i for i in b.nearest("vessel", place, shared + 1) if i != pad]
            b.follow(pad, near[:shared])
            b.bush(region, b.nearest("frame", place)[0], pad)


def _drive(b: Builder) -> None:
    """Drive deck on the frame; motor, gearbox, bearings, shaft and rotor."""
    b.part = "drive"
    n = b.spec.mesh
    stops = [p for p in FRAME.portals if DRIVE.deck_x[0] <= p <= DRIVE.deck_x[1]]
    x = _ticks(stops, (n.deck_x,) * (len(stops) - 1))
    y = np.linspace(*DRIVE.deck_y, n.deck_y + 1)
    deck = b.nodes(_points(x[:, None], y, FRAME.top))
    b.elements("CQUAD4", "drive deck", _grid(deck))
    quarter = n.deck_y // 4
    under = (0.0, 0.0, -0.33)
    for j in (0, quarter, n.deck_y // 2, n.deck_y - quarter, n.deck_y):
        b.beams(
            "CBEAM", "deck beams", deck[:, j], Z, (None, None, None, *under, *under)
        )
    motor = b.node(DRIVE.motor, DRIVE.y, DRIVE.z)
    b.mass(motor, 20_000.0, (9000.0, 26000.0, 28000.0))
    _mount(b, motor, "motor mounts", half=0.8)
    gearbox = b.node(DRIVE.gearbox, DRIVE.y, DRIVE.z)
    b.mass(gearbox, 9_000.0, (3500.0, 4200.0, 5000.0))
    _mount(b, gearbox, "gearbox mounts", half=0.6)
    _shaft(b)


def _deck_node(b: Builder, x: float, y: float) -> int:
    """The node of the drive deck or its cross beams that is nearest, by the sum of both ways."""
    low, high = DRIVE.deck_y
    distance = {
        number: abs(px - x) + abs(py - y)
        for number, (px, py, pz) in zip(b.ids, b.xyz, strict=True)
        if abs(pz - FRAME.top) < 1e-6 and low - 1e-6 <= py <= high + 1e-6
    }
    return min(distance, key=lambda number: (distance[number], number))


def _mount(b: Builder, machine: int, region: str, half: float) -> None:
    """Four mounts under a rigid machine, up to `half` before and behind its centre."""
    x, y, _ = b.place(machine)
    feet = []
    for dx in (-half, half):
        for dy in (-0.9, 0.9):
            plate = _deck_node(b, x + dx, y + dy)
            foot = b.node(*b.place(plate), new=True)
            feet.append(foot)
            b.bush(region, foot, plate, 10 if region == "motor mounts" else 0)
    b.element("RBE2", machine, "123456", *feet)


def _shaft(b: Builder) -> None:
    """The shaft from motor to rotor, and its two bearings on pedestals."""
    first, second = DRIVE.bearings
    stops = (DRIVE.motor, first, DRIVE.gearbox, second, DRIVE.rotor)
    nodes = b.nodes(_points(_ticks(stops, (3, 3, 4, 2)), DRIVE.y, DRIVE.z))
    b.beams("CBAR", "shaft", nodes, Z)
    b.mass(int(nodes[-1]), 2_500.0, (400.0, 250.0, 250.0))
    for x in DRIVE.bearings:
        foot = _deck_node(b, x, DRIVE.y)
        fx, fy, fz = b.place(foot)
        top = b.node(x, DRIVE.y, DRIVE.z, new=True)
        middle = b.node(fx, fy, 0.5 * (fz + DRIVE.z))
        b.beams("CBEAM", "pedestals", np.array([foot, middle, top]), Y)
        b.bush("bearing mounts", b.node(x, DRIVE.y, DRIVE.z), top)


def _platform(b: Builder) -> None:
    """A service platform along one side of the frame, cantilevered from the lower girder."""
    b.part = "site"
    bays = len(FRAME.portals) - 1
    x = _ticks(FRAME.portals, (b.spec.mesh.span,) * bays)
    y = FRAME.sides[0] - np.array([0.0, 0.4, 0.8])
    for row in _grid(b.nodes(_points(x[:, None], y, FRAME.mid))).tolist():
        b.element("CQUAD4", SITE.platform, *row)


def _piping(b: Builder) -> None:
    """A pipe along the frame, clamped to the lower girder at the portals."""
    bays = len(FRAME.portals) - 1
    x = _ticks(FRAME.portals, (4,) * bays)
    nodes = b.nodes(_points(x, FRAME.sides[1] - 0.6, FRAME.mid + 0.5)).tolist()
    for ends in pairwise(nodes):
        b.element("CBEAM", SITE.pipe, *ends, *Z)
    for node, at in list(zip(nodes, x.tolist(), strict=True))[::4]:
        girder = b.nearest("frame", (at, FRAME.sides[1], FRAME.mid))[0]
        b.connect(SITE.pipe_clamp, (node, girder), 0, 0.0)


def _hung(b: Builder) -> None:
    """A hose bridge and a crane, hung at the ends of the foundation."""
    for x, mass, link in (
        (FOUNDATION.length, SITE.hose_bridge, SITE.hose_link),
        (0.0, SITE.crane, SITE.crane_link),
    ):
        place = (x, 0.5 * FOUNDATION.width, FOUNDATION.wall_top)
        hung = b.node(*place, new=True)
        b.mass(hung, mass)
        b.connect(link, (hung, b.nearest("foundation", place)[0]), 0)


def _cabinets(b: Builder) -> None:
    """Switch cabinets on the girders."""
    near, far = FRAME.sides
    b.mass(b.node(4.0, near, FRAME.top), 1500.0)
    b.mass(b.node(21.0, far, FRAME.mid), 2500.0)
    b.mass(b.node(14.2, far, FRAME.top), 1200.0)
