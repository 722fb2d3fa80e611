"""Candidate points and the lines between measuring points: nodes by sets, boxes and surfaces; lines
that follow the FE mesh, and how well they show the modes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import factorized

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import InputError
from ringtrue.shapes import paired_mac

CHUNK = 20_000_000  # comparisons at once


def in_boxes(xyz: Float, boxes: Sequence[Sequence[float]] | Float) -> Bool:
    """Points (n,) inside at least one box, borders included.

    Parameters
    ----------
    xyz : (n, 3) float64, m
    boxes : (b, 6) float64, m
        x0 y0 z0 x1 y1 z1 of opposite corners, in any order.

    Raises
    ------
    InputError
        If a box is not six numbers.
    """
    if any(len(b) != 6 for b in boxes):
        raise InputError(
            f"boxes: {[list(b) for b in boxes]} must be x0 y0 z0 x1 y1 z1 each"
        )
    corner = np.asarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    low = corner.min(axis=1)
    high = corner.max(axis=1)
    inside = (xyz[:, None] >= low) & (xyz[:, None] <= high)
    return np.asarray(inside.all(axis=2).any(axis=1))


def select_candidates(
    nodes: Int,
    xyz: Float,
    *,
    boxes: Sequence[Sequence[float]] = (),
    exclude: Sequence[int] = (),
    keep_out: Sequence[Sequence[float]] = (),
) -> Bool:
    """Nodes (n,) that can carry a sensor: in a box (all, where none is given), and not
    excluded.

    Parameters
    ----------
    nodes : (n,) int64
    xyz : (n, 3) float64, m
    boxes, keep_out : sequence of x0 y0 z0 x1 y1 z1, m
    exclude : sequence of int
        Node numbers.

    Raises
    ------
    InputError
        If a node is not there, or none is left.
    """
    lost = np.setdiff1d(np.array(exclude, dtype=np.int64), nodes)
    if lost.size:
        raise InputError(
            f"{lost.size} nodes of the exclusions are not there: {lost[:8].tolist()}"
        )
    keep = in_boxes(xyz, boxes) if len(boxes) else np.ones(nodes.size, dtype=np.bool_)
    keep &= ~np.isin(nodes, np.array(exclude, dtype=np.int64))
    keep &= ~in_boxes(xyz, keep_out) if len(keep_out) else True
    if not keep.any():
        raise InputError(
            f"none of {nodes.size} nodes is a candidate: widen the boxes or exclude less"
        )
    return keep


def spacing_of_points(xyz: Float, count: int) -> float:
    """Half of the spacing that `count` points can keep, m: as least distance it parts clusters and
    is always possible.

    The spacing is that of points each of which is chosen farthest from all before it (Gonzalez
    1985). However the points are chosen then, in any set that none can be added to at least `count`
    have this distance.

    Parameters
    ----------
    xyz : (n, k) float64
    count : int
    """
    if not 1 < count <= len(xyz):
        return 0.0
    far = np.sum((xyz - xyz.mean(axis=0)) ** 2, axis=1)
    far = np.sum((xyz - xyz[np.argmax(far)]) ** 2, axis=1)
    for _ in range(count - 2):  # over points to choose
        far = np.minimum(far, np.sum((xyz - xyz[np.argmax(far)]) ** 2, axis=1))
    # 0.47: less than a half, so that two rounded digits cannot bring it above
    return float(f"{0.47 * np.sqrt(far.max()):.2g}")


def surface_normals(xyz: Float, triangles: Int) -> Float:
    """Unit normals (n, 3) of the nodes of a surface, weighted by area; 0 where there is no surface.

    The direction of a uniaxial sensor or an impact on the skin.

    Parameters
    ----------
    xyz : (n, 3) float64, m
    triangles : (t, 3) int64
        Positions in `xyz`, outward by the right-hand rule.
    """
    a, b, c = (xyz[triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    normal = np.zeros_like(xyz, dtype=np.float64)
    np.add.at(normal, triangles.ravel(), np.repeat(area, 3, axis=0))
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(
        np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    )


def along(shapes: Float, axes: Float) -> Float:
    """Shapes (n, d, m) along d directions a point.

    Parameters
    ----------
    shapes : (n, 3, m) float64
        Translations along x, y, z.
    axes : (n, d, 3) float64
        Unit vectors: the identity for a triaxial sensor, the normal for a uniaxial one.
    """
    return np.asarray(np.einsum("ndi,nim->ndm", axes, shapes))


def mesh_edges(triangles: Int, lines: Int) -> Int:
    """Edges (e, 2) int64 of triangles (t, 3) and lines (l, 2), each once, ends ascending."""
    t = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    every = np.concatenate(
        [
            t[:, [0, 1]],
            t[:, [1, 2]],
            t[:, [2, 0]],
            np.asarray(lines, dtype=np.int64).reshape(-1, 2),
        ]
    )
    every = np.sort(every[every[:, 0] != every[:, 1]], axis=1)
    return np.unique(every, axis=0)


# ratios of lengths: the way round to a line that is left out, the way along the mesh to the
# straight line between two points
DETOUR = 1.6
BEND = 1.3


def wireframe(xyz: Float, edges: Int, chosen: Int) -> Int:
    """Lines between measuring points whose neighbourhoods on the mesh touch.

    Each node belongs to the point that is nearest along the mesh; two points are neighbours where
    an edge joins their nodes (the dual of a Voronoi diagram, Erwig 2000). A line that is the
    longest of a triangle is left out where the two others are not much longer, and so is one that
    cuts through the air; the least spanning tree always stays.

    Parameters
    ----------
    xyz : (n, 3) float64, m
    edges : (e, 2) int64
        Positions in `xyz`.
    chosen : (c,) int64

    Returns
    -------
    (l, 2) int64
        Positions in `chosen`, ascending.

    Raises
    ------
    InputError
        If a point is not there or given twice.
    """
    n = len(xyz)
    c = np.asarray(chosen, dtype=np.int64)
    if np.unique(c).size != c.size or (c.size and not 0 <= c.min() <= c.max() < n):
        raise InputError(
            f"measuring points: {c.size} positions, {np.unique(c).size} different; must be 0 to "
            f"{n - 1}"
        )
    length = np.linalg.norm(xyz[edges[:, 0]] - xyz[edges[:, 1]], axis=1)
    graph = _graph(edges, np.maximum(length, 1e-12), n)
    far, _, owner = csgraph.dijkstra(
        graph, directed=False, indices=c, return_predecessors=True, min_only=True
    )
    seat = np.full(n, -1, dtype=np.int64)
    seat[c] = np.arange(c.size)
    # -1 on a part of the mesh without a point
    home = np.where(owner >= 0, seat[np.maximum(owner, 0)], -1)
    a, b = home[edges].T
    touch = (a != b) & (a >= 0) & (b >= 0)
    pair = np.sort(np.stack([a, b], axis=1)[touch], axis=1)
    way = (far[edges[:, 0]] + length + far[edges[:, 1]])[touch]
    pair, way = _thinned_lines(pair, way, c.size, DETOUR)
    straight = np.linalg.norm(xyz[c[pair[:, 0]]] - xyz[c[pair[:, 1]]], axis=1)
    # (l,) True for the lines of a least spanning tree
    tree = csgraph.minimum_spanning_tree(
        _graph(pair, np.maximum(way, 1e-12), c.size)
    ).tocoo()
    in_tree = np.isin(
        pair[:, 0] * c.size + pair[:, 1], tree.row.astype(np.int64) * c.size + tree.col
    )
    return np.asarray(pair[(way <= BEND * straight) | in_tree])


def relative_neighbours(xyz: Float, groups: Sequence[str]) -> Int:
    """Lines between points where there is no mesh: the relative neighbours (Toussaint 1980) within
    each group.

    Two points are joined unless a third is nearer to both than they are to each other; the least
    spanning tree of each group is among the lines.

    Parameters
    ----------
    xyz : (n, 3) float64, m
    groups : (n,) sequence of str

    Returns
    -------
    (l, 2) int64
        Positions in `xyz`, ascending.
    """
    out = [np.zeros((0, 2), dtype=np.int64)]
    for name in dict.fromkeys(groups):  # a handful
        at = np.flatnonzero([g == name for g in groups])
        gap = np.linalg.norm(xyz[at][:, None] - xyz[at][None], axis=-1)
        i, j = np.triu_indices(at.size, 1)
        order = np.argsort(gap[i, j], kind="stable")
        keep = np.zeros(i.size, dtype=np.bool_)
        # to bound the memory
        for part in np.array_split(order, -(-order.size * at.size // CHUNK) or 1):
            nearer = np.maximum(gap[i[part]], gap[j[part]]) < gap[i[part], j[part]][
                :, None
            ] * (1 - 1e-9)
            keep[part] = ~nearer.any(axis=1)
        out.append(np.stack([at[i[keep]], at[j[keep]]], axis=1))
    every = np.concatenate(out)
    return every[np.lexsort((every[:, 1], every[:, 0]))]


def _graph(pair: Int, weight: Float, n: int) -> sparse.csr_array:
    at = pair.astype(np.int32).T  # as csgraph of SciPy before 1.17 takes them
    return sparse.coo_array((weight, (at[0], at[1])), shape=(n, n)).tocsr()


def _thinned_lines(pair: Int, way: Float, n: int, detour: float) -> tuple[Int, Float]:
    """The shortest way of each pair, less those that are the longest of a triangle and cheap to go
    round.
    """
    order = np.lexsort((way, pair[:, 1], pair[:, 0]))
    pair, first = np.unique(pair[order], axis=0, return_index=True)
    if not len(pair):
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    way = way[order][first]
    full = np.full((n, n), np.inf)
    full[pair[:, 0], pair[:, 1]] = full[pair[:, 1], pair[:, 0]] = way
    legs = full[pair[:, 0]], full[pair[:, 1]]
    shorter = np.maximum(*legs) < way[:, None] * (1 - 1e-9)
    round_it = np.where(shorter, legs[0] + legs[1], np.inf).min(axis=1)
    keep = ~np.isfinite(round_it) | (round_it > detour * way)
    return np.asarray(pair[keep]), np.asarray(way[keep])


def drawn_mac(
    xyz: Float, edges: Int, chosen: Int, shapes: Float, seen: Float | None = None
) -> Float:
    """MAC (m,) of each mode with its own drawing: the motion of the points, spread over the mesh as
    a net would be.

    The nodes in between take the mean of their neighbours weighted by 1/length (harmonic
    interpolation on the graph); a low value means that the points do not show the mode: it swings
    between them.

    Parameters
    ----------
    xyz : (n, 3) float64, m
    edges : (e, 2) int64
    chosen : (c,) int64
    shapes : (n, d, m) float64
        At all nodes of the mesh; parts of the mesh that hold no point do not count.
    seen : (c, d, d) float64, optional
        Projector on the directions that are measured at each point; all if not given.
    """
    n, d, m = shapes.shape
    length = np.linalg.norm(xyz[edges[:, 0]] - xyz[edges[:, 1]], axis=1)
    half = _graph(edges, 1 / np.maximum(length, 1e-9 * length.max(initial=1.0)), n)
    weights = sparse.csr_array(half + half.T)
    _, part = csgraph.connected_components(weights, directed=False)
    here = np.isin(part, part[chosen])
    free = np.flatnonzero(here & ~np.isin(np.arange(n), chosen))
    drawn = np.array(shapes, dtype=np.float64)
    if seen is not None:
        drawn[chosen] = seen @ drawn[chosen]
    drawn = drawn.reshape(n, d * m)
    if free.size:
        laplace = sparse.csr_array(sparse.diags_array(weights.sum(axis=1)) - weights)
        solve = factorized(laplace[free][:, free].tocsc())
        pull = weights[free][:, chosen] @ drawn[chosen]
        drawn[free] = np.column_stack([solve(pull[:, k]) for k in range(d * m)])
    both = (
        x.reshape(n, d, m)[here].reshape(-1, m)
        for x in (drawn, np.asarray(shapes, dtype=np.float64))
    )
    return paired_mac(*both)
