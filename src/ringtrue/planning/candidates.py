"""Candidate points: nodes by sets, boxes and surfaces, less what is out of reach; nodes next to
given places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.errors import InputError

HALF = 0.47  # less than a half, so that two rounded digits cannot bring it above


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
        raise InputError(f"boxes: {[list(b) for b in boxes]} must be x0 y0 z0 x1 y1 z1 each")
    corner = np.asarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    low, high = corner.min(axis=1), corner.max(axis=1)
    inside = (xyz[:, None] >= low) & (xyz[:, None] <= high)
    return np.asarray(inside.all(axis=2).any(axis=1))


def select_candidates(
    nodes: Int,
    xyz: Float,
    *,
    sets: Sequence[Sequence[int]] = (),
    boxes: Sequence[Sequence[float]] = (),
    exclude: Sequence[int] = (),
    keep_out: Sequence[Sequence[float]] = (),
) -> Bool:
    """Nodes (n,) that can carry a sensor: in a node set or box (all, where neither is given), and
    not excluded.

    Parameters
    ----------
    nodes : (n,) int64
    xyz : (n, 3) float64, m
    sets : sequence of node sets
    boxes, keep_out : sequence of x0 y0 z0 x1 y1 z1, m
    exclude : sequence of int
        Node numbers.

    Raises
    ------
    InputError
        If a node is not there, or none is left.
    """
    wanted = np.array([n for group in sets for n in group], dtype=np.int64)
    lost = np.setdiff1d(np.concatenate([wanted, np.array(exclude, dtype=np.int64)]), nodes)
    if lost.size:
        raise InputError(
            f"{lost.size} nodes of the candidates or exclusions are not there: {lost[:8].tolist()}"
        )
    keep = np.full(nodes.size, not (wanted.size or len(boxes)))
    keep |= np.isin(nodes, wanted)
    keep |= in_boxes(xyz, boxes) if len(boxes) else False
    keep &= ~np.isin(nodes, np.array(exclude, dtype=np.int64))
    keep &= ~in_boxes(xyz, keep_out) if len(keep_out) else True
    if not keep.any():
        raise InputError(
            f"none of {nodes.size} nodes is a candidate: widen the boxes or exclude less"
        )
    return np.asarray(keep)


def even_distance(xyz: Float, count: int) -> float:
    """Half of the spacing that `count` points can keep, m: as least distance it parts clusters and
    is always possible.

    The spacing is that of points each of which is chosen farthest from all before it (Gonzalez
    1985). However the points are chosen then, in any set that none can be added to at least `count`
    are this far apart.

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
    return float(f"{HALF * np.sqrt(far.max()):.2g}")


def surface_normals(xyz: Float, triangles: Int) -> Float:
    """Unit normals (n, 3) of the nodes of a surface, weighted by area; 0 where there is no surface.

    The direction of a uniaxial sensor or a hammer blow on the skin.

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
    return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))


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


def nearest_nodes(places: Float, xyz: Float, tolerance: float = np.inf) -> tuple[Int, Float]:
    """Node next to each place and its distance: sensors that sit on FE nodes need no interpolation.

    Parameters
    ----------
    places : (k, 3) float64, m
    xyz : (n, 3) float64, m
    tolerance : float, m

    Returns
    -------
    at : (k,) int64, positions in `xyz`
    distance : (k,) float64, m

    Raises
    ------
    InputError
        If a place is farther than `tolerance` from any node, or two places share their node.
    """
    distance, at = cKDTree(xyz).query(np.asarray(places, dtype=np.float64).reshape(-1, 3))
    distance, at = np.asarray(distance, dtype=np.float64), np.asarray(at, dtype=np.int64)
    far = np.flatnonzero(distance > tolerance)
    if far.size:
        k = int(far[0])
        raise InputError(
            f"place {np.asarray(places)[k].tolist()} is {distance[k]:.3g} m from the nearest "
            f"node, {tolerance:g} m are "
            f"allowed ({far.size} such places): move it or refine the mesh"
        )
    values, count = np.unique(at, return_counts=True)
    if (count > 1).any():
        twice = np.flatnonzero(at == values[count > 1][0])
        raise InputError(
            f"places {twice.tolist()} have the same nearest node: part them or refine the mesh"
        )
    return at, distance
