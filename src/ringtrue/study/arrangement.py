"""Where sensors can sit, and in which directions: on the candidate nodes, triaxial, in single axes,
or normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError
from ringtrue.planning.geometry import along, relative_neighbours, surface_normals
from ringtrue.study.results import Scene

AXES = ("X", "Y", "Z")
NORMAL = ("N",)  # along the outward normal of the skin


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Candidate sensors (s) with d directions each.

    Attributes
    ----------
    nodes : (n,) int64
        Candidate nodes.
    at : (s,) int64
        Position of each sensor's node among them.
    axes : (s, d, 3) float64
        Unit vectors.
    names : tuple (s) of tuple (d) of str
        Direction in the name of a channel.
    xyz : (s, 3) float64, m
    apart : (s, 3 or 4) float64, m
        Where the least distance is measured: sensors in different single axes do not keep each
        other away.
    region : tuple (s) of str
    """

    nodes: Int
    at: Int
    axes: Float
    names: tuple[tuple[str, ...], ...]
    xyz: Float
    apart: Float
    region: tuple[str, ...]

    @property
    def node(self) -> Int:
        """Node of each sensor, (s,)."""
        return np.asarray(self.nodes[self.at])

    @property
    def each(self) -> int:
        """Directions a sensor, d."""
        return int(self.axes.shape[1])

    def seen(self, shapes: Float) -> Float:
        """What the sensors read of translations (n, 3, m) at the candidate nodes, (s, d, m)."""
        return shapes if self.each == len(AXES) else along(shapes[self.at], self.axes)

    def labels(self, chosen: Int) -> tuple[str, ...]:
        """Channels of sensors (c,), sensor by sensor."""
        node = self.node
        return tuple(f"{node[i]}+{a}" for i in chosen.tolist() for a in self.names[i])

    def points(self, chosen: Int) -> tuple[Int, Int]:
        """Nodes (p,) that hold a sensor, in order, and which of them each sensor (c,) sits on."""
        node = self.node[chosen]
        kept, first, back = np.unique(node, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        rank = np.empty(kept.size, dtype=np.int64)
        rank[order] = np.arange(kept.size)
        return np.asarray(kept[order]), rank[back]

    def measured(self, chosen: Int) -> Float:
        """Projector on the directions that are measured at each point of `points`, (p, 3, 3)."""
        at, axes = self.points(chosen)[1], self.axes[chosen]
        out = np.zeros((at.max(initial=-1) + 1, 3, 3))
        np.add.at(out, at, np.einsum("cdi,cdj->cij", axes, axes))
        return out

    def test_model(self, chosen: Int) -> TestModel:
        """The sensors with lines between their points and the neighbours of the same region, for
        drawing.
        """
        points, back = self.points(chosen)
        first = np.array(
            [int(np.argmax(back == k)) for k in range(points.size)], dtype=np.int64
        )  # tens of points
        xyz, groups = self.xyz[chosen][first], [self.region[i] for i in chosen[first].tolist()]
        lines = points[relative_neighbours(xyz, groups)]
        axes = self.axes[chosen].reshape(-1, 3)
        return TestModel(
            points,
            xyz,
            self.labels(chosen),
            np.repeat(points[back], self.each),
            axes,
            lines,
            tuple(groups),
        )


def arranged(
    nodes: Int, region: Sequence[str], xyz: Float, directions: str, scene: Scene
) -> Arrangement:
    """All sensors that candidate nodes can hold.

    Parameters
    ----------
    nodes : (n,) int64
    region : sequence (n) of str
    xyz : (n, 3) float64, m
    directions : {"triaxial", "uniaxial", "normal"}
        One sensor a node along the global axes together, one for each of the axes, or one along the
        normal of the skin.

    Raises
    ------
    ConfigError
        If no candidate lies on a surface and normals are asked for.
    """
    n, eye = nodes.size, np.eye(3)
    names: tuple[tuple[str, ...], ...]
    if directions == "triaxial":
        at, axes, names = np.arange(n), np.broadcast_to(eye, (n, 3, 3)), (AXES,) * n
    elif directions == "uniaxial":
        at, axes = np.repeat(np.arange(n), 3), np.tile(eye, (n, 1))[:, None, :]
        names = tuple((a,) for a in AXES) * n
    else:
        at, axes = _normals(nodes, scene)
        names = (NORMAL,) * at.size
    place = xyz[at]
    apart = place
    if (
        directions == "uniaxial"
    ):  # a fourth coordinate keeps the axes farther apart than any two nodes are
        far = 10 * (1.0 + float(np.ptp(xyz, axis=0).max(initial=0.0)))
        apart = np.column_stack([place, far * np.tile(np.arange(3), n)])
    return Arrangement(nodes, at, axes, names, place, apart, tuple(region[i] for i in at.tolist()))


def _normals(nodes: Int, scene: Scene) -> tuple[Int, Float]:
    """Candidates that lie on surfaces, (s,), and their normals, (s, 1, 3)."""
    normal = surface_normals(scene.xyz, scene.triangles)
    seat = np.searchsorted(scene.node, nodes).clip(max=scene.node.size - 1)
    here: Bool = (scene.node[seat] == nodes) & (np.linalg.norm(normal[seat], axis=1) > 0)
    if not here.any():
        raise ConfigError(
            '[plan] directions = "normal": no candidate lies on a shell or on the skin of solids'
        )
    at = np.flatnonzero(here)
    return at, normal[seat[at]][:, None, :]
