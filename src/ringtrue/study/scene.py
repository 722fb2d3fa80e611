"""What is drawn of a model: the skin of its solids, its shells, lines and joints, by region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.fem.loads import FACES, SURFACES
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.study.results import Scene

_SURFACES = {card: ((0, 1, 2),) if "TRIA" in card else ((0, 1, 2, 3),) for card in SURFACES}
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
NOWHERE = 1e-9  # of the size of the model: ends of a joint that are as near are at one place


def _faces(model: Model) -> tuple[Int, Int]:
    """Quads (q, 4) of node numbers and their property numbers, inner faces of solids left out."""
    solid: list[Int] = []
    shell: list[Int] = []
    for card, faces in (FACES | _SURFACES).items():
        if card not in model:
            continue
        t = model[card]
        g = t.stack(*(f"G{i + 1}" for i in range(1 + max(max(f) for f in faces))))
        quads = np.concatenate([np.column_stack([g[:, (*f, f[-1])[:4]], t["PID"]]) for f in faces])
        (shell if len(faces) == 1 else solid).append(quads)
    kept = shell
    if solid:
        q = np.concatenate(solid)
        key = np.sort(
            np.where(q[:, 3:4] == q[:, 2:3], q[:, [0, 1, 2, 4]] * [1, 1, 1, 0], q[:, :4]), axis=1
        )
        _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
        kept = [q[np.sort(first[count == 1])], *shell]
    every = np.concatenate(kept) if kept else np.zeros((0, 5), dtype=np.int64)
    return every[:, :4], every[:, 4]


def _ends(model: Model, cards: Mapping[str, tuple[str, str]]) -> Int:
    """Ends and property number (l, 3); 0 for what has no property."""
    tables = [(model[c], names) for c, names in cards.items() if c in model]
    rows = [
        np.column_stack([t.stack(*names), t["PID"] if "PID" in t.columns else 0 * t.ids])
        for t, names in tables
    ]
    return np.concatenate(rows) if rows else np.zeros((0, 3), dtype=np.int64)


def _lines(model: Model) -> tuple[Int, Int]:
    """Lines (l, 2) and property numbers; of a joint of no length or to the ground its ends, as
    points.
    """
    lines, joints = _ends(model, _LINES), _ends(model, _JOINTS)
    xyz, at = positions(model), model["GRID"].find(joints[:, :2])
    length = np.linalg.norm(xyz[at[:, 0]] - xyz[at[:, 1]], axis=1)
    apart = (at >= 0).all(axis=1) & (length > NOWHERE * diagonal(xyz))
    points = [joints[~apart & (at[:, k] >= 0)][:, [k, k, 2]] for k in (0, 1)]
    every = np.concatenate([lines, joints[apart], np.unique(np.concatenate(points), axis=0)])
    return every[:, :2], every[:, 2]


def _groups(pids: Int, regions: Mapping[str, Sequence[int]]) -> tuple[Int, tuple[str, ...]]:
    named = {pid: name for name, members in regions.items() for pid in members}
    labels = [named.get(p, f"property {p}" if p else "no property") for p in pids.tolist()]
    names = tuple(dict.fromkeys([*regions, *labels]))
    at = {n: i for i, n in enumerate(names)}
    return np.array([at[x] for x in labels], dtype=np.int64), names


def make_scene(model: Model, regions: Mapping[str, Sequence[int]], length: float = 1.0) -> Scene:
    """The drawing of a model; `regions` names property numbers, `length` turns its unit to
    metres.
    """
    quads, quad_pid = _faces(model)
    lines, line_pid = _lines(model)
    group, names = _groups(np.concatenate([quad_pid, line_pid]), regions)
    triangle = quads[:, 2] == quads[:, 3]
    tris = np.concatenate([quads[:, [0, 1, 2]], quads[~triangle][:, [0, 2, 3]]])
    tri_group = np.concatenate([group[: len(quads)], group[: len(quads)][~triangle]])
    node = np.unique(np.concatenate([tris.ravel(), lines.ravel()]))
    grid = model["GRID"]
    return Scene(
        node,
        positions(model)[grid.find(node)] * length,
        np.searchsorted(node, tris),
        tri_group,
        np.searchsorted(node, lines),
        group[len(quads) :],
        names,
    )


def scene_modes(modes: ModeSet, scene: Scene) -> ModeSet:
    """The translations of the scene's nodes, rows ordered node by node, X Y Z; single precision is
    enough to draw.
    """
    labels = DofSet(
        np.repeat(scene.node, 3), np.tile(np.array([1, 2, 3], dtype=np.int8), scene.node.size)
    )
    assert isinstance(modes.labels, DofSet)
    at, sign = modes.labels.align(labels)
    shapes: Float = (
        np.asarray(modes.shapes[at] * sign[:, None]).astype(np.float32).astype(np.float64)
    )
    return ModeSet(modes.frequencies, modes.damping, shapes, labels, modes.norm, modes.source)
