"""The drawing of a model: the skin of its solids, its shells, its lines and springs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.fem.loads import FACES, SURFACES
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.study.results import Scene

_SURFACES = {
    card: ((0, 1, 2),) if "TRIA" in card else ((0, 1, 2, 3),) for card in SURFACES
}
_LINES = {
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
    "CBEND": ("GA", "GB"),
    "CROD": ("G1", "G2"),
    "CONROD": ("G1", "G2"),
    "CTUBE": ("G1", "G2"),
}
_JOINTS = {
    "CBUSH": ("GA", "GB"),
    "CBUSH1D": ("GA", "GB"),
    "CGAP": ("GA", "GB"),
    "CELAS1": ("G1", "G2"),
    "CELAS2": ("G1", "G2"),
    "CVISC": ("G1", "G2"),
}


def make_scene(
    model: Model, regions: Mapping[str, Sequence[int]], length: float = 1.0
) -> Scene:
    """The drawing of a model.

    Parameters
    ----------
    model : Model
    regions : mapping of str to sequence of int
        Names of property numbers.
    length : float
        Turns its unit to metres.
    """
    quads, quad_of = _faces(model)
    lines, line_of = _lines(model)
    names, group = _groups(np.r_[quad_of[:, 0], line_of[:, 0]], regions)
    triangle = quads[:, 2] == quads[:, 3]
    tris = np.concatenate([quads[:, [0, 1, 2]], quads[~triangle][:, [0, 2, 3]]])
    of_tri = np.r_[np.arange(len(quads)), np.flatnonzero(~triangle)]
    node, place = np.unique(np.r_[tris.ravel(), lines.ravel()], return_inverse=True)
    return Scene(
        node=node,
        xyz=positions(model)[model["GRID"].find(node)] * length,
        triangles=place[: tris.size].reshape(-1, 3),
        triangle_group=group[of_tri],
        lines=place[tris.size :].reshape(-1, 2),
        line_group=group[len(quads) :],
        groups=names,
        triangle_element=quad_of[of_tri, 1],
        line_element=line_of[:, 1],
    )


def connected(scene: Scene, elements: Sequence[int]) -> Int:
    """Elements (e,) of the same groups that nodes join to some elements, these among them.

    Parameters
    ----------
    scene : Scene
    elements : sequence of int
        Numbers of elements that are drawn.
    """
    faces, lines = scene.triangles, scene.lines
    element = np.r_[scene.triangle_element, scene.line_element]
    group = np.r_[scene.triangle_group, scene.line_group]
    # a node once for each group that it is of, so that groups do not join
    n = scene.node.size
    ends = np.r_[faces[:, [0, 1]], faces[:, [0, 2]], lines]
    of = np.r_[scene.triangle_group, scene.triangle_group, scene.line_group]
    at = ends + n * of[:, None]
    size = n * max(len(scene.groups), 1)
    joined = sparse.coo_array(
        (np.ones(len(at)), (at[:, 0], at[:, 1])), shape=(size, size)
    )
    label = connected_components(joined, directed=False)[1]
    first = np.r_[faces[:, 0], lines[:, 0]] + n * group
    part = label[first]
    wanted = np.unique(part[np.isin(element, np.asarray(elements))])
    return np.unique(element[np.isin(part, wanted)])


def translations(scene: Scene) -> DofSet:
    """X Y Z of the nodes of a drawing, node by node."""
    return DofSet(
        np.repeat(scene.node, 3), np.tile(np.array([1, 2, 3]), scene.node.size)
    )


def scene_modes(modes: ModeSet, scene: Scene) -> ModeSet:
    """The translations of the scene's nodes, rows ordered node by node, X Y Z; single precision is
    enough to draw.
    """
    labels = translations(scene)
    assert isinstance(modes.labels, DofSet)
    at, sign = modes.labels.align(labels)
    shapes: Float = (
        np.asarray(modes.shapes[at] * sign[:, None])
        .astype(np.float32)
        .astype(np.float64)
    )
    return replace(modes, shapes=shapes, labels=labels)


def _groups(
    pids: Int, regions: Mapping[str, Sequence[int]]
) -> tuple[tuple[str, ...], Int]:
    """Names of groups, the regions first, then properties as they come; the group of each entry."""
    named = {pid: name for name, members in regions.items() for pid in members}
    each, first, inverse = np.unique(pids, return_index=True, return_inverse=True)
    labels = [
        named.get(p, f"property {p}" if p else "no property") for p in each.tolist()
    ]
    names = tuple(dict.fromkeys([*regions, *(labels[k] for k in np.argsort(first))]))
    at = {n: i for i, n in enumerate(names)}
    return names, np.array([at[x] for x in labels], dtype=np.int64)[inverse]


def _faces(model: Model) -> tuple[Int, Int]:
    """Quads (q, 4) of node numbers with property and element (q, 2), inner faces of solids left
    out.
    """
    solid: list[Int] = []
    shell: list[Int] = []
    for card, faces in (FACES | _SURFACES).items():
        if card not in model:
            continue
        t = model[card]
        g = t.stack(*(f"G{i + 1}" for i in range(1 + max(max(f) for f in faces))))
        own = [t["PID"], t.ids]
        quads = np.concatenate(
            [np.column_stack([g[:, (*f, f[-1])[:4]], *own]) for f in faces]
        )
        (shell if len(faces) == 1 else solid).append(quads)
    kept = [_skin(np.concatenate(solid)), *shell] if solid else shell
    every = np.concatenate(kept) if kept else np.zeros((0, 6), dtype=np.int64)
    return every[:, :4], every[:, 4:]


def _skin(quads: Int) -> Int:
    """The rows whose face (four nodes, of a triangle the last twice) no other row has."""
    corners = quads[:, :4].copy()
    corners[corners[:, 2] == corners[:, 3], 3] = 0
    corners.sort(axis=1)
    order = np.lexsort(corners.T)
    same = np.all(np.diff(corners[order], axis=0) == 0, axis=1)
    single = ~(np.r_[False, same] | np.r_[same, False])
    kept: Int = quads[np.sort(order[single])]
    return kept


def _ends(model: Model, cards: Mapping[str, tuple[str, str]]) -> Int:
    """Ends, property (0 for what has none) and element (l, 4)."""
    tables = [(model[c], names) for c, names in cards.items() if c in model]
    rows = [
        np.column_stack(
            [t.stack(*names), t["PID"] if "PID" in t.columns else 0 * t.ids, t.ids]
        )
        for t, names in tables
    ]
    return np.concatenate(rows) if rows else np.zeros((0, 4), dtype=np.int64)


def _lines(model: Model) -> tuple[Int, Int]:
    """Lines (l, 2) with property and element (l, 2); of a joint of no length or to the ground its
    ends, as points.
    """
    lines = _ends(model, _LINES)
    joints = _ends(model, _JOINTS)
    xyz = positions(model)
    at = model["GRID"].find(joints[:, :2])
    length = np.linalg.norm(xyz[at[:, 0]] - xyz[at[:, 1]], axis=1)
    # 1e-9: of the size of the model: ends of a joint that are as near are at one place
    drawn = (at >= 0).all(axis=1) & (length > 1e-9 * diagonal(xyz))
    points = [joints[~drawn & (at[:, k] >= 0)][:, [k, k, 2, 3]] for k in (0, 1)]
    ends = np.concatenate(points)
    # several at one place are one
    _, first = np.unique(ends[:, :3], axis=0, return_index=True)
    every = np.concatenate([lines, joints[drawn], ends[first]])
    return every[:, :2], every[:, 2:]
