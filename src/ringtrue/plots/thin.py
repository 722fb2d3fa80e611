"""A drawing with fewer nodes: meshes of some ten thousand nodes are finer than a page shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Bool, Int
from ringtrue.study.results import Scene

HALVINGS = 24  # of the size of a cell


def thinned(scene: Scene, most: int) -> Scene:
    """The scene with at most `most` of its nodes, itself where it has no more.

    Vertex clustering (Rossignac, Borrel 1993): the nodes of a cubic cell become the one nearest to
    their mean; triangles and lines that collapse or come twice go. Cells are as small as `most`
    allows.
    """
    if scene.node.size <= most:
        return scene
    cell = _cells(scene, most)
    count = int(cell.max()) + 1
    size = np.bincount(cell, minlength=count)
    mean = np.stack([np.bincount(cell, x, count) for x in scene.xyz.T], axis=1) / size[:, None]
    order = np.lexsort((np.linalg.norm(scene.xyz - mean[cell], axis=1), cell))
    first = np.sort(order[np.r_[True, np.diff(cell[order]) > 0]])
    at = np.empty(count, dtype=np.int64)
    at[cell[first]] = np.arange(count)
    seat = at[cell]
    triangles, lines = seat[scene.triangles], seat[scene.lines]
    t = _kept(triangles, np.zeros(len(triangles), dtype=np.bool_))
    k = _kept(lines, np.asarray(scene.lines[:, 0] == scene.lines[:, 1]))
    return replace(
        scene,
        node=scene.node[first],
        xyz=scene.xyz[first],
        triangles=triangles[t],
        triangle_group=scene.triangle_group[t],
        lines=lines[k],
        line_group=scene.line_group[k],
    )


def _cells(scene: Scene, most: int) -> Int:
    """The number (n,) of each node's cell, of the smallest cells that are at most `most`."""
    corner = scene.xyz.min(axis=0)
    large = float(np.ptp(scene.xyz, axis=0).max()) * (1 + 1e-9)
    best, small = np.zeros(scene.node.size, dtype=np.int64), 0.0
    for _ in range(HALVINGS):
        size = (small + large) / 2
        step = ((scene.xyz - corner) // size).astype(np.int64)
        top = step.max(axis=0) + 1
        _, cell = np.unique(
            (step[:, 0] * top[1] + step[:, 1]) * top[2] + step[:, 2], return_inverse=True
        )
        if int(cell.max()) < most:
            best, large = cell, size
        else:
            small = size
    return best


def _kept(corners: Int, point: Bool) -> Int:
    """Positions of what has not collapsed, or was a point from the start, each once."""
    key = np.sort(corners, axis=1)
    whole = np.all(np.diff(key, axis=1) > 0, axis=1) | point
    at = np.flatnonzero(whole)
    _, first = np.unique(key[at], axis=0, return_index=True)
    return np.asarray(at[np.sort(first)])
