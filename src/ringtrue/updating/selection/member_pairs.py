"""Pairs of nodes between which a deck may lack a member, a joint or a support.

Braces: across the corners of frames, where two members meet at an angle. Links: between parts that
are near each other and that no element connects but springs. Supports: at the level of those that
the deck has.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import arm
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.model import Model
from ringtrue.updating.selection.generation import connectivity, spread_out

LINES = ("CROD", "CONROD", "CTUBE", "CBAR", "CBEAM", "CBEND")
SPRINGS = ("CBUSH", "CBUSH1D", "CGAP", "CELAS1", "CELAS2", "CELAS3", "CELAS4")
LOOSE = (
    "CVISC",
    *(f"C{kind}{i}" for kind in ("DAMP", "MASS") for i in range(1, 5)),
    "GENEL",
)
AXIAL = "axial"


@dataclass(frozen=True, slots=True)
class MemberSearch:
    """Where missing members are looked for.

    Attributes
    ----------
    straight : float
        |cosine| of two members from which on they are one line and no corner.
    near : float
        Largest gap between two parts that a link may bridge, in units of the size of the
        smaller one.
    links : int
        Places of links between two parts at most.
    supports : int
        Places of supports at most.
    level : float
        Height that a level has, in units of the size of the structure.
    """

    straight: float = 0.95
    near: float = 0.25
    links: int = 8
    supports: int = 24
    level: float = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class PossibleMembers(FrozenArrays):
    """Springs that a deck may lack, each of one stiffness.

    Attributes
    ----------
    forms : tuple (p,) of {"brace", "link", "support"}
    components : tuple (p,) of str
        "axial", along the line between the nodes; else directions in the basic frame as Nastran
        numbers them, such as "3" or "123456".
    nodes : (p, 2) int64
        Ids of GRID; the second is 0 for the ground.
    rows : (p, 2) int64
        Their rows; -1 for the ground.
    strains : (p, 6, 12) float64
        Extensions of its springs by the motions of both nodes (six each, basic frame); rows that
        it does not have are 0. Rotations are taken times `arms`.
    along : (p, 3) float64
        From the first node to the second, rounded to 1e-3 of its length; 0 to the ground.
    arms : (p,) float64
        Length: the stiffness about an axis is that along it times its square.
    """

    forms: tuple[str, ...]
    components: tuple[str, ...]
    nodes: Int
    rows: Int
    strains: Float
    along: Float
    arms: Float

    def __len__(self) -> int:
        return len(self.forms)

    def extensions(self, system: System, vectors: Float) -> Float:
        """Extensions of the springs in each mode, (p, 6, m).

        Parameters
        ----------
        vectors : (f, m) float64
        """
        used, place = np.unique(self.rows, return_inverse=True)
        at = (6 * used[:, None] + np.arange(6)).ravel()
        held = np.repeat(used < 0, 6)
        motion = np.asarray(system.transform[np.where(held, 0, at)] @ vectors)
        motion[held] = 0.0
        ends = motion.reshape(used.size, 6, -1)[place.reshape(self.rows.shape)]
        ends = ends.reshape(len(self), 12, -1)
        return np.asarray(np.einsum("prd,pdm->prm", self.strains, ends))


def possible_members(
    model: Model, system: System, search: MemberSearch | None = None
) -> PossibleMembers:
    """All braces, links and supports that a deck may lack.

    Parameters
    ----------
    model : Model
    system : System
        Its matrices: which nodes move, and which rigid elements tie.
    search : MemberSearch, optional
    """
    s = search or MemberSearch()
    net = _Network.of(model, system)
    return _joined(
        model, net, [*_braces(net, s), *_links(net, s), *_supports(net, model, s)]
    )


Drafts = list[tuple[str, str, int, int]]  # form, components, rows of the nodes


@dataclass(frozen=True, slots=True, eq=False)
class _Network:
    """The deck as nodes and what connects them.

    Attributes
    ----------
    xyz : (n, 3) float64
        Basic frame.
    lines : (n, n) csr
        Ends of line elements.
    solid : (n, n) csr
        What elements other than springs, and rigid elements, connect.
    every : (n, n) csr
        What any element connects.
    moves, turns : (n,) bool
        Nodes with a free translation, with a free rotation.
    """

    xyz: Float
    lines: sparse.csr_array
    solid: sparse.csr_array
    every: sparse.csr_array
    moves: Bool
    turns: Bool

    @classmethod
    def of(cls, model: Model, system: System) -> _Network:
        cards = [c for c in affected_cards(model) if c not in LOOSE]
        nodes = {c: connectivity(model, [c]) for c in cards}
        n = len(system.xyz)
        none = sparse.csr_array((n, n))
        every = sum((_pairs(x) for x in nodes.values()), none)
        lines = sum((_pairs(x) for c, x in nodes.items() if c in LINES), none)
        solid = sum((_pairs(x) for c, x in nodes.items() if c not in SPRINGS), none)
        transform = sparse.csr_array(system.transform[: 6 * n])
        free: Bool = np.diff(transform.indptr).reshape(n, 6) > 0
        order = np.argsort(model["GRID"].ids)
        ids = model["GRID"].ids[order]
        place = np.searchsorted(ids, system.free.node).clip(max=n - 1)
        known = ids[place] == system.free.node
        entry = sparse.coo_array(transform)
        keep = known[entry.col]
        rigid = (entry.row[keep] // 6, order[place[entry.col[keep]]])
        tied = sparse.csr_array(
            sparse.coo_array((np.ones(keep.sum()), rigid), shape=(n, n))
        )
        return cls(
            xyz=system.xyz,
            lines=lines,
            solid=_apart(solid + tied + tied.T),
            every=sparse.csr_array(every),
            moves=np.asarray(free[:, :3].any(axis=1)),
            turns=np.asarray(free[:, 3:].any(axis=1)),
        )

    def edge_lengths(self) -> Float:
        """Mean length of the edges at each node, (n,)."""
        i, j = sparse.coo_array(self.solid).coords
        length = np.linalg.norm(self.xyz[j] - self.xyz[i], axis=1)
        count = np.bincount(i, minlength=len(self.xyz))
        return np.bincount(i, length, len(self.xyz)) / np.maximum(count, 1)


def _pairs(nodes: sparse.csr_array) -> sparse.csr_array:
    """1 where an element has both nodes, (n, n)."""
    return _apart(nodes.T @ nodes)


def _apart(graph: sparse.csr_array) -> sparse.csr_array:
    """1 where two different nodes are connected, (n, n)."""
    out = sparse.coo_array(graph)
    distinct = out.row != out.col
    entries = (np.ones(distinct.sum()), (out.row[distinct], out.col[distinct]))
    return sparse.csr_array(sparse.coo_array(entries, shape=out.shape))


def _edges(graph: sparse.csr_array) -> Int:
    """Pairs of nodes (e, 2), in the order of the first and then of the second."""
    return np.stack(sparse.coo_array(graph).coords, axis=1).astype(np.int64)


def _directions(net: _Network, edges: Int) -> Float:
    """Unit vectors (e, 3) from the first to the second node of each pair."""
    d = net.xyz[edges[:, 1]] - net.xyz[edges[:, 0]]
    return np.asarray(d / np.maximum(np.linalg.norm(d, axis=1), 1e-300)[:, None])


def _members(net: _Network, s: MemberSearch) -> Int:
    """Members from one joint of a frame to the next, both ways (e, 2).

    A joint is a node where other than two line elements meet, two at an angle, or a line element
    and one of another kind.
    """
    edges = _edges(net.lines)
    count = np.diff(net.lines.indptr)
    total = np.zeros((len(net.xyz), 3))
    np.add.at(total, edges[:, 0], _directions(net, edges))
    # two unit vectors away from a node of a straight line cancel
    bent = np.linalg.norm(total, axis=1) > np.sqrt(2 * (1 - s.straight))
    other = np.diff(net.every.indptr) > count
    joint = (count > 0) & ((count != 2) | bent | other)
    inner = ~joint[edges]
    direct = edges[~inner.any(axis=1)]
    chain = edges[inner.all(axis=1)]
    n = len(net.xyz)
    chains = sparse.coo_array(
        (np.ones(len(chain)), (chain[:, 0], chain[:, 1])), shape=(n, n)
    )
    _, label = sparse.csgraph.connected_components(chains, directed=False)
    ends = edges[~inner[:, 0] & inner[:, 1]]
    order = np.argsort(label[ends[:, 1]], kind="stable")
    of = label[ends[order, 1]]
    two = np.flatnonzero(of[1:] == of[:-1])
    through = np.stack([ends[order[two], 0], ends[order[two + 1], 0]], axis=1)
    through = through[through[:, 0] != through[:, 1]]
    return np.unique(np.concatenate([direct, through, through[:, ::-1]]), axis=0)


def _braces(net: _Network, s: MemberSearch) -> Drafts:
    """Across each corner of two members, where no member is yet and none is crossed."""
    members = _members(net, s)
    n = len(net.xyz)
    first = np.searchsorted(members[:, 0], np.arange(n + 1))
    away = _directions(net, members)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for corner in np.unique(members[:, 0]).tolist():  # over joints of frames
        at = slice(first[corner], first[corner + 1])
        i, j = np.triu_indices(at.stop - at.start, 1)
        cosine = np.abs((away[at] @ away[at].T)[i, j])
        far = members[at, 1]
        found.append(np.stack([far[i], far[j]], axis=1)[cosine < s.straight])
    pairs = np.unique(np.sort(np.concatenate(found), axis=1), axis=0)
    there = np.unique(np.sort(members, axis=1), axis=0)
    key = pairs @ np.array([n, 1])
    new = ~np.isin(key, there @ np.array([n, 1])) & (net.moves[pairs]).any(axis=1)
    pairs = pairs[new]
    edges = _edges(sparse.triu(net.lines))
    crossed = np.array(
        [_crosses(net.xyz, pair, edges) for pair in pairs], dtype=np.bool_
    )
    return [("brace", AXIAL, a, b) for a, b in pairs[~crossed].tolist()]


def _crosses(xyz: Float, pair: Int, edges: Int) -> bool:
    """Whether the line between two nodes meets a line element inside: the bay is not open.

    The points of least distance of two lines: Ericson (2005), Real-Time Collision Detection,
    sec. 5.1.
    """
    u = xyz[pair[1]] - xyz[pair[0]]
    v = xyz[edges[:, 1]] - xyz[edges[:, 0]]
    w = xyz[pair[0]] - xyz[edges[:, 0]]
    a = u @ u
    b = v @ u
    c = np.einsum("ei,ei->e", v, v)
    rest = a * c - b**2
    parallel = rest <= 1e-6 * a * c
    s = np.where(
        parallel,
        0.5,
        (b * np.einsum("ei,ei->e", v, w) - c * (w @ u)) / np.where(parallel, 1.0, rest),
    )
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((np.einsum("ei,ei->e", v, w) + s * b) / c, 0.0, 1.0)
    gap = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    inside = (s > 0.01) & (s < 0.99)
    return bool((inside & (gap < 0.01 * np.sqrt(a))).any())


def _links(net: _Network, s: MemberSearch) -> Drafts:
    """Between parts that are near each other, over the shortest ways that no spring takes."""
    _, label = sparse.csgraph.connected_components(net.solid, directed=False)
    standing = np.flatnonzero(np.diff(net.solid.indptr) > 0)
    parts = [standing[label[standing] == k] for k in np.unique(label[standing])]
    sizes = [float(np.linalg.norm(np.ptp(net.xyz[p], axis=0))) for p in parts]
    trees = [cKDTree(net.xyz[p]) for p in parts]
    joined = _edges(net.every)
    out: Drafts = []
    for one, two in combinations(range(len(parts)), 2):
        few, many = sorted((one, two), key=lambda k: len(parts[k]))
        ends = joined[label[joined[:, 1]] == label[parts[many][0]]][:, 0]
        nodes = np.setdiff1d(parts[few], ends)
        reach = s.near * min(sizes[one], sizes[two])
        found = trees[many].query(
            net.xyz[nodes], distance_upper_bound=reach * (1 + 1e-9)
        )
        gap, place = (np.asarray(x) for x in found)
        near = np.isfinite(gap)
        near &= gap <= 2 * gap.min(initial=np.inf)
        pairs = np.stack([nodes[near], parts[many][place[near]]], axis=1)
        pairs = pairs[net.moves[pairs].any(axis=1)]
        for a, b in pairs[_corners_first(net.xyz[pairs[:, 0]], s.links)].tolist():
            out.append(("link", _between(net, a, b), a, b))
    return out


def _corners_first(xyz: Float, most: int, taken: Float | None = None) -> Int:
    """Up to `most` of the points (n, 3): those farthest along the axes and the diagonals between
    them, then such that all are covered, as `spread_out` does from points that are `taken`.
    """
    if not len(xyz):
        return np.zeros(0, dtype=np.int64)
    ways = np.array(
        [w for w in product((-1, 0, 1), repeat=3) if any(w)], dtype=np.float64
    )
    ways = ways[np.argsort(-np.abs(ways).sum(axis=1), kind="stable")]
    corners = np.array(list(dict.fromkeys(np.argmax(xyz @ ways.T, axis=0).tolist())))[
        :most
    ]
    covered = xyz[corners]
    if taken is not None:
        covered = np.concatenate([taken, covered])
    more = spread_out(xyz, most - corners.size, covered)
    return np.concatenate([corners, more]).astype(np.int64)


def _between(net: _Network, a: int, b: int) -> str:
    """What a joint between two nodes may hold: a spring across a gap must not hold a rigid-body
    motion.
    """
    if net.turns[[a, b]].all():
        return "123456"
    return AXIAL if np.linalg.norm(net.xyz[a] - net.xyz[b]) > 0 else "123"


def _supports(net: _Network, model: Model, s: MemberSearch) -> Drafts:
    """At the level of the supports that there are: all translations, and each by itself."""
    standing = np.diff(net.every.indptr) > 0
    held = standing & ~net.moves
    sprung = _sprung(net, model, held)
    supports = np.flatnonzero(held | sprung)
    if not supports.size:
        return []
    size = float(np.linalg.norm(np.ptp(net.xyz[standing], axis=0)))
    height = s.level * size
    carried = np.flatnonzero(held if not sprung.any() else sprung)
    flat = np.ptp(net.xyz[carried], axis=0) <= height
    thick = np.ptp(net.xyz[standing], axis=0) > height
    if (flat & thick).any():  # a level of its own, not the plane of a flat structure
        flat &= thick
    near = np.abs(net.xyz - net.xyz[carried[0]]) <= height
    free = net.moves & (np.diff(net.solid.indptr) > 0) & ~sprung
    at = np.flatnonzero(free & (near & flat).any(axis=1))
    nodes = at[_corners_first(net.xyz[at], s.supports, net.xyz[carried])]
    return [
        ("support", c, a, -1) for c in ("3", "2", "1", "123") for a in nodes.tolist()
    ]


def _sprung(net: _Network, model: Model, held: Bool) -> Bool:
    """Nodes (n,) that a spring carries: to the ground, or to a node that is held."""
    out = np.zeros(held.size, dtype=np.bool_)
    for card in SPRINGS:
        if card not in model:
            continue
        nodes = connectivity(model, [card])
        ends = np.diff(nodes.indptr)
        ground = (ends == 1) | (np.asarray(nodes @ held.astype(np.float64)) > 0)
        out[nodes[np.flatnonzero(ground)].indices] = True
    return out & net.moves


def _joined(model: Model, net: _Network, drafts: Drafts) -> PossibleMembers:
    rows = np.array([d[2:] for d in drafts], dtype=np.int64).reshape(-1, 2)
    ground = rows[:, 1] < 0
    ends = net.xyz[np.where(ground[:, None], rows[:, :1], rows)]
    middle = ends.mean(axis=1, keepdims=True)
    arms = np.where(ground, 1.0, net.edge_lengths()[rows].mean(axis=1))
    to_middle = arm(middle - ends)
    strains = np.concatenate([-to_middle[:, 0], to_middle[:, 1]], axis=2)
    strains[ground, :, 6:] = 0.0
    line = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(line, axis=1)
    along = line / np.maximum(length, 1e-300)[:, None]
    step = 1e-3 * 10.0 ** np.ceil(np.log10(np.maximum(length, 1e-300)))[:, None]
    components = tuple(d[1] for d in drafts)
    axial = np.array([c == AXIAL for c in components], dtype=np.bool_)
    kept = np.array(
        [str(k) in c for c in components for k in range(1, 7)], dtype=np.bool_
    )
    strains[axial, 0] = np.einsum("pi,pij->pj", along, strains[:, :3])[axial]
    kept = kept.reshape(-1, 6)
    kept[axial, 0] = True
    strains[axial, 0, 3:6] = 0.0  # a line between its nodes has no arm
    strains[axial, 0, 9:] = 0.0
    strains[:, 3:] *= arms[:, None, None]
    strains[~kept] = 0.0
    ids = np.where(ground[:, None] & [False, True], 0, model["GRID"].ids[rows])
    return PossibleMembers(
        forms=tuple(d[0] for d in drafts),
        components=components,
        nodes=ids,
        rows=rows,
        strains=strains,
        along=np.round(line / step) * step + 0.0,
        arms=arms,
    )
