"""Elements: shape, free and flipped edges, duplicates, hinges on solids, stiff kinds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ringtrue.checks import Finding, at_rows
from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.fem.element_cards import SOLIDS
from ringtrue.model.cards import HEXAHEDRON, QUADRILATERAL, TETRAHEDRON, TRIANGLE, WEDGE
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.model.references import NODES, REFERENCES, SHELLS, CardReference


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """Beyond which the shape of an element is noted.

    Attributes
    ----------
    warp : float
        Out-of-plane height of a corner over the mean side.
    aspect : float
        Longest over shortest side.
    jacobian : float
        Smallest over largest determinant at the corners.
    middle : float
        A mid-side node must project between this and 1 - this of its edge.
    flat : float
        Area or volume over that of the square or cube on the longest side.
    named : int
        Elements that are named.
    """

    warp: float = 0.05
    aspect: float = 20.0
    jacobian: float = 0.1
    middle: float = 0.25
    flat: float = 1e-8
    named: int = 4


QUALITY = QualityLimits()

_LINES = {
    "CROD": ("G1", "G2"),
    "CTUBE": ("G1", "G2"),
    "CONROD": ("G1", "G2"),
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
    "CBEND": ("GA", "GB"),
}
_SURFACES = {
    "CTRIA3": 3,
    "CTRIAR": 3,
    "CTRIA6": 3,
    "CQUAD4": 4,
    "CQUADR": 4,
    "CQUAD8": 4,
    "CSHEAR": 4,
}
_SOLIDS = {card: solid.corners for card, solid in SOLIDS.items()}
# the corners that edges join to each corner, right-handed; the apex of a pyramid has four: left out
_SPOKES = {
    "CTETRA": ((1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)),
    "CPYRAM": ((1, 3, 4), (2, 0, 4), (3, 1, 4), (0, 2, 4)),
    "CPENTA": ((1, 2, 3), (2, 0, 4), (0, 1, 5), (5, 4, 0), (3, 5, 1), (4, 3, 2)),
    "CHEXA": (
        (1, 3, 4),
        (2, 0, 5),
        (3, 1, 6),
        (0, 2, 7),
        (7, 5, 0),
        (4, 6, 1),
        (5, 7, 2),
        (6, 4, 3),
    ),
}
# corners that each mid-side node stands between, in the order of the nodes behind the corners
_MIDDLES = {
    "CTRIA6": TRIANGLE.edges,
    "CQUAD8": QUADRILATERAL.edges,
    "CTETRA": TETRAHEDRON.edges,
    "CPYRAM": (*QUADRILATERAL.edges, (0, 4), (1, 4), (2, 4), (3, 4)),
    "CPENTA": WEDGE.edges,
    "CHEXA": HEXAHEDRON.edges,
}


def check_geometry(model: Model) -> list[Finding]:
    """Findings on the shape of all elements whose nodes are in the model."""
    if "GRID" not in model or not len(model["GRID"]):
        return []
    xyz = positions(model)
    found: list[Finding] = []
    for card, names in _LINES.items():
        if card in model:
            x, rows = _points(model, xyz, card, names)
            length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
            found += at_rows(model, card, rows[length == 0], "error", "has no length")
    for card, count in (_SURFACES | _SOLIDS).items():
        if card in model:
            x, rows = _points(model, xyz, card, _corner_fields(count))
            check = _surface if card in _SURFACES else _solid
            found += check(model, card, x, rows)
            found += _middles(model, xyz, card, count) if card in _MIDDLES else []
    return found


def _corner_fields(count: int) -> tuple[str, ...]:
    return tuple(f"G{i + 1}" for i in range(count))


def _middles(model: Model, xyz: Float, card: str, corners: int) -> list[Finding]:
    """Mid-side nodes outside the middle half of their edge: the mapping folds over (Zienkiewicz,
    Taylor, 2000).
    """
    table = model[card]
    grid = model["GRID"]
    wrong = np.zeros(len(table), dtype=bool)
    for k, (a, b) in enumerate(_MIDDLES[card]):
        at = grid.find(table.stack(f"G{a + 1}", f"G{b + 1}", f"G{corners + k + 1}"))
        rows = np.flatnonzero((at >= 0).all(axis=1))
        p, q, mid = xyz[at[rows]].swapaxes(0, 1)
        edge = q - p
        length = np.einsum("ij,ij->i", edge, edge)
        along = np.einsum("ij,ij->i", mid - p, edge) / np.where(length > 0, length, 1.0)
        wrong[rows] |= (length > 0) & (
            (along < QUALITY.middle) | (along > 1 - QUALITY.middle)
        )
    return at_rows(
        model,
        card,
        np.flatnonzero(wrong),
        "error",
        "has a mid-side node outside the middle half of its edge",
    )


def _points(
    model: Model, xyz: Float, card: str, names: tuple[str, ...]
) -> tuple[Float, Int]:
    """Corners (e, k, 3) and rows (e,) of the elements with all their nodes present."""
    at = model["GRID"].find(model[card].stack(*names))
    rows = np.flatnonzero((at >= 0).all(axis=1))
    return xyz[at[rows]], rows


def _sides(x: Float) -> Float:
    """Lengths of the sides of polygons (e, k, 3): (e, k)."""
    return np.asarray(np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2))


def _surface(model: Model, card: str, x: Float, rows: Int) -> list[Finding]:
    sides = _sides(x)
    longest = sides.max(axis=1)
    shortest = sides.min(axis=1)
    if x.shape[1] == 4:
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    else:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    flat = (area <= QUALITY.flat * longest**2) | (shortest == 0)
    found = at_rows(
        model,
        card,
        rows[flat],
        "error",
        "is collapsed: no area, or two corners at one place",
    )
    good = ~flat
    slender = good & (longest > QUALITY.aspect * np.where(good, shortest, 1.0))
    found += at_rows(
        model,
        card,
        rows[slender],
        "warning",
        f"has an aspect ratio over {QUALITY.aspect:g}",
    )
    if x.shape[1] == 4:
        found += _quads(model, card, x=x, rows=rows, normal=normal, good=good)
    return found


def _quads(
    model: Model, card: str, x: Float, rows: Int, normal: Float, good: Bool
) -> list[Finding]:
    unit = normal / np.where(good, np.linalg.norm(normal, axis=1), 1.0)[:, None]
    height = abs(np.einsum("ij,ij->i", x[:, 1] - x[:, 0], unit)) / 2
    warped = good & (height > QUALITY.warp * _sides(x).mean(axis=1))
    found = at_rows(
        model,
        card,
        rows[warped],
        "warning",
        f"is warped by more than {QUALITY.warp:g} of its mean side",
    )
    before = np.roll(x, 1, axis=1) - x
    after = np.roll(x, -1, axis=1) - x
    # Jacobian at the corners, times 4
    turn = np.einsum("ekj,ej->ek", np.cross(after, before), unit)
    skew = (
        good
        & (turn > 0).all(axis=1)
        & (turn.min(axis=1) < QUALITY.jacobian * turn.max(axis=1))
    )
    found += at_rows(
        model,
        card,
        rows[skew],
        "warning",
        f"has corner Jacobians of a ratio under {QUALITY.jacobian:g}",
    )
    reentrant = good & (turn <= 0).any(axis=1)
    return found + at_rows(
        model, card, rows[reentrant], "error", "has a corner of 180 degrees or more"
    )


def _solid(model: Model, card: str, x: Float, rows: Int) -> list[Finding]:
    """Signed volume by the Jacobian in the middle, over the cube on the longest extent."""
    volume = np.linalg.det(_middle(x))
    size = np.ptp(x, axis=1).max(axis=1)
    flat = abs(volume) <= QUALITY.flat * size**3
    found = at_rows(model, card, rows[flat], "error", "is collapsed: no volume")
    good = ~flat & (volume > 0)
    found += at_rows(
        model,
        card,
        rows[~flat & (volume < 0)],
        "error",
        "is inside out: negative volume",
    )
    return found + _corners(model, card, x, rows, good)


def _corners(model: Model, card: str, x: Float, rows: Int, good: Bool) -> list[Finding]:
    """Jacobians at the corners, and the ratio of the edges."""
    spokes = np.array(_SPOKES[card])
    edges = x[:, spokes] - x[:, : len(spokes), None]
    corner = np.linalg.det(edges)
    size = np.ptp(x, axis=1).max(axis=1)
    folded = good & (corner.min(axis=1) <= QUALITY.flat * size**3)
    found = at_rows(
        model,
        card,
        rows[folded],
        "error",
        "is folded: no positive Jacobian at a corner",
    )
    skew = good & ~folded & (corner.min(axis=1) < QUALITY.jacobian * corner.max(axis=1))
    found += at_rows(
        model,
        card,
        rows[skew],
        "warning",
        f"has corner Jacobians of a ratio under {QUALITY.jacobian:g}",
    )
    length = np.linalg.norm(edges, axis=3).reshape(len(x), spokes.size)
    slender = good & (length.max(axis=1) > QUALITY.aspect * length.min(axis=1))
    return found + at_rows(
        model,
        card,
        rows[slender],
        "warning",
        f"has an aspect ratio over {QUALITY.aspect:g}",
    )


def _middle(x: Float) -> Float:
    """Three vectors (e, 3, 3) through the middle of solids, a right-handed set if the solid is
    valid.
    """
    if x.shape[1] == 4:
        return x[:, 1:] - x[:, :1]
    if x.shape[1] == 5:
        base = x[:, :4]
        return np.stack(
            [
                base[:, 1] - base[:, 3],
                base[:, 2] - base[:, 0],
                2 * (x[:, 4] - base.mean(axis=1)),
            ],
            axis=1,
        )
    if x.shape[1] == 6:
        low = x[:, :3]
        high = x[:, 3:]
        mid = (low + high) / 2
        return np.stack(
            [mid[:, 1] - mid[:, 0], mid[:, 2] - mid[:, 0], (high - low).mean(axis=1)],
            axis=1,
        )
    pairs = (
        ([1, 2, 5, 6], [0, 3, 4, 7]),
        ([2, 3, 6, 7], [0, 1, 4, 5]),
        ([4, 5, 6, 7], [0, 1, 2, 3]),
    )
    return np.stack(
        [x[:, a].mean(axis=1) - x[:, b].mean(axis=1) for a, b in pairs], axis=1
    )


CORNERS = {card: count for card, count in _SURFACES.items() if card != "CSHEAR"}


@dataclass(frozen=True, slots=True, eq=False)
class ShellEdges(FrozenArrays):
    """Edges between corner nodes of shell elements.

    Attributes
    ----------
    number : int
        Of different edges.
    free : (k, 2) int64
        Node ids of the edges with one element.
    part : (k,) int64
        The connected chain of free edges that each belongs to, from 0 on.
    flipped : (j, 2) int64
        Node ids of the edges with two elements that have opposite normals.
    """

    number: int
    free: Int
    part: Int
    flipped: Int


def shell_edges(model: Model) -> ShellEdges:
    """The edges of all shell elements."""
    found = [np.empty((0, 2), dtype=np.int64)]
    for card, corners in CORNERS.items():
        if card in model:
            ids = model[card].stack(*_corner_fields(corners))
            found.append(
                np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2)
            )
    directed = np.concatenate(found)
    directed = directed[directed[:, 0] != directed[:, 1]]
    edges, which, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    forward = np.bincount(
        which.reshape(-1), weights=directed[:, 0] < directed[:, 1], minlength=len(edges)
    )
    free = edges[count == 1]
    return ShellEdges(
        len(edges), free, _parts(free), edges[(count == 2) & (forward != 1)]
    )


def _parts(edges: Int) -> Int:
    nodes, at = np.unique(edges, return_inverse=True)
    at = at.reshape(-1, 2)
    graph = coo_array(
        (np.ones(len(at)), (at[:, 0], at[:, 1])), shape=(nodes.size, nodes.size)
    )
    label = (
        connected_components(graph, directed=False)[1]
        if nodes.size
        else np.empty(0, dtype=np.int64)
    )
    return np.asarray(label[at[:, 0]], dtype=np.int64)


def free_edges_in_words(edges: ShellEdges) -> str:
    """How many edges are free, in how many chains, and where the shortest is; "" without a free
    edge.
    """
    if not len(edges.free):
        return ""
    size = np.bincount(edges.part)
    short = edges.free[edges.part == size.argmin()]
    chains = _count_words(size.size, "chain")
    text = f"{len(edges.free)} of {edges.number} shell edges are free, in {chains}"
    return f"{text}; the shortest has {size.min()}, at nodes {_node_names(short)}"


_STRIP = (
    "one element between two free edges: the mesh does not resolve how such a strip bends across "
    "and twists; `ringtrue modes --mesh-error` estimates what it does to each frequency"
)


def edge_findings(model: Model) -> Iterator[Finding]:
    """Neighbours with opposite normals: offsets, Z0 and the order of plies then change sides
    between them. Strips of one element between free edges.
    """
    edges = shell_edges(model)
    if len(edges.flipped):
        count = _count_words(len(edges.flipped), "shell edge")
        where = _node_names(edges.flipped)
        yield Finding(
            "info", f"{count} between elements of opposite normals, at nodes {where}"
        )
    # an edge as one number
    many = int(edges.free.max(initial=0)) + 1
    free = edges.free @ [many, 1]
    for card in (c for c in ("CQUAD4", "CQUADR") if c in model):
        corners = model[card].stack(*_corner_fields(4))
        sides = np.sort(
            np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2
        )
        ends = np.isin(sides @ [many, 1], free) & (sides < many).all(axis=2)
        between = ends[:, :2] & ends[:, 2:]
        strips = np.flatnonzero(between.any(axis=1) & ~between.all(axis=1))
        yield from at_rows(model, card, strips, "info", _STRIP)


def _count_words(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count != 1 else ''}"


def _node_names(edges: Int) -> str:
    nodes = np.unique(edges)
    names = [str(n) for n in nodes[: QUALITY.named].tolist()]
    return " ".join(names + ["..."] * (nodes.size > QUALITY.named))


# skins and stiffeners may share nodes at offsets
_OFFSETS = ("ZOFFS", "W1A", "W2A", "W3A", "W1B", "W2B", "W3B")


def double_findings(model: Model) -> Iterator[Finding]:
    """Elements with the nodes, property and offsets of another of their card."""
    ends: dict[str, tuple[str, ...]] = {c: _LINES[c] for c in ("CROD", "CBAR", "CBEAM")}
    ends |= {card: _corner_fields(count) for card, count in (CORNERS | _SOLIDS).items()}
    for card in (c for c in ends if c in model):
        table = model[card]
        nodes = np.sort(table.stack(*ends[card]), axis=1)
        offsets = [
            np.nan_to_num(table[name]) for name in _OFFSETS if name in table.columns
        ]
        key = np.column_stack([table["PID"], nodes, *offsets])
        first = np.unique(key, axis=0, return_index=True)[1]
        rows = np.setdiff1d(np.arange(len(table)), first)
        what = "it has the nodes, the property and the offsets of another element; both count"
        yield from at_rows(model, card, rows, "warning", what)


# along themselves alone
_STRAIGHT = frozenset(("CROD", "CTUBE", "CONROD", "CVISC", "CBUSH1D"))
_MASSES = frozenset(("CONM1", "CONM2", "CMASS1", "CMASS2"))
_BEAMS = ("CBAR", "CBEAM", "CBEND")


def hinge_findings(model: Model) -> Iterator[Finding]:
    """Ends that nothing but solids holds: hinges of beams, bushes of some length that carry no
    force across.
    """
    if "GRID" not in model or not any(card in model for card in _SOLIDS):
        return
    free = _hinges(model)
    for card in (c for c in _BEAMS if c in model):
        rows = np.flatnonzero(
            free[_rows(model, card, "GA")] | free[_rows(model, card, "GB")]
        )
        what = (
            "hinged where it ends on a node of solids, which take no moment; RBE3 or a beam "
            "inside them would"
        )
        yield from at_rows(model, card, rows, "info", what)
    for card, rows in _edges_on_solids(model):
        what = (
            "hinged where an edge of it meets solids, whose nodes take no moment; shells over "
            "their faces would"
        )
        yield from at_rows(model, card, rows, "info", what)
    if "CBUSH" in model:
        rows = np.flatnonzero(_idle_bushes(model, free))
        what = (
            "between nodes of solids, which turn freely, it carries no force across its length; "
            "give it none"
        )
        yield from at_rows(model, "CBUSH", rows, "warning", what)


def _turning(model: Model) -> Iterator[CardReference]:
    """Fields that name nodes, of all cards but masses and those that act along themselves alone."""
    for r in REFERENCES:
        if r.of == NODES and r.card in model and r.card not in _STRAIGHT | _MASSES:
            yield r


def _hinges(model: Model) -> Bool:
    """Which nodes solids hold and one further card only, (node + 1,); the last row is that of no
    node.
    """
    solid, other = np.zeros((2, len(model["GRID"]) + 1), dtype=np.int64)
    for r in _turning(model):
        if r.field not in ("G0", "SA", "SB"):
            np.add.at(
                solid if r.card in _SOLIDS else other, _rows(model, r.card, r.field), 1
            )
    solid[-1] = 0
    return np.asarray((solid > 0) & (other == 1))


def _edges_on_solids(model: Model) -> Iterator[tuple[str, Int]]:
    """Shells with two corners or more on solids, where neither a shell over their faces nor another
    card turns them.
    """
    solid, turned = np.zeros((2, len(model["GRID"]) + 1), dtype=bool)
    for r in _turning(model):
        if r.card not in SHELLS:
            (solid if r.card in _SOLIDS else turned)[_rows(model, r.card, r.field)] = (
                True
            )
    solid[-1] = False
    corners = {}
    for card in (c for c in SHELLS if c in model):
        names = _corner_fields(4 if "QUAD" in card else 3)
        corners[card] = np.stack([_rows(model, card, name) for name in names], axis=1)
    for at in corners.values():
        turned[at[solid[at].all(axis=1)]] = True
    for card, at in corners.items():
        yield card, np.flatnonzero((solid & ~turned)[at].sum(axis=1) > 1)


def _rows(model: Model, card: str, field: str) -> Int:
    """Rows of GRID that a field names, -1 for none."""
    return model["GRID"].find(model[card].entries(field)[0])


def _idle_bushes(model: Model, free: Bool) -> Bool:
    """Bushes of some length and stiffness in two directions, both ends of which turn freely."""
    t = model["CBUSH"]
    x = positions(model)
    a = _rows(model, "CBUSH", "GA")
    b = _rows(model, "CBUSH", "GB")
    long = np.linalg.norm(x[a] - x[b], axis=1) > 1e-6 * diagonal(x)
    stiff = np.zeros(len(t), dtype=bool)
    if "PBUSH" in model:
        at = model["PBUSH"].find(t["PID"])
        stiff = (at >= 0) & (
            (model["PBUSH"].stack("K1", "K2", "K3")[at] != 0).sum(axis=1) > 1
        )
    return np.asarray(free[a] & free[b] & long & stiff & (a >= 0) & (b >= 0))


_LINEAR = (
    "has four nodes and constant strain, too stiff in bending: ten nodes bend well"
)


def stiff_findings(model: Model) -> Iterator[Finding]:
    """Tetrahedra of four nodes."""
    if "CTETRA" in model:
        rows = np.flatnonzero(model["CTETRA"]["G5"] == 0)
        yield from at_rows(model, "CTETRA", rows, "warning", _LINEAR)
