"""Edges of the shells: free ones, and those whose two elements point to opposite sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ringtrue.checks.findings import Finding
from ringtrue.core.arrays import Int, freeze_fields
from ringtrue.model.model import Model

CORNERS = {"CTRIA3": 3, "CTRIAR": 3, "CTRIA6": 3, "CQUAD4": 4, "CQUADR": 4, "CQUAD8": 4}
_NAMED = 4


@dataclass(frozen=True, slots=True, eq=False)
class ShellEdges:
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

    def __post_init__(self) -> None:
        freeze_fields(self, free=np.int64, part=np.int64, flipped=np.int64)


def shell_edges(model: Model) -> ShellEdges:
    """The edges of all shell elements."""
    found = [np.empty((0, 2), dtype=np.int64)]
    for card, corners in CORNERS.items():
        if card in model:
            ids = model[card].stack(*(f"G{i + 1}" for i in range(corners)))
            found.append(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2))
    directed = np.concatenate(found)
    directed = directed[directed[:, 0] != directed[:, 1]]
    edges, which, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    forward = np.bincount(
        which.reshape(-1), weights=directed[:, 0] < directed[:, 1], minlength=len(edges)
    )
    free = edges[count == 1]
    return ShellEdges(len(edges), free, _parts(free), edges[(count == 2) & (forward != 1)])


def _parts(edges: Int) -> Int:
    nodes, at = np.unique(edges, return_inverse=True)
    at = at.reshape(-1, 2)
    graph = coo_array((np.ones(len(at)), (at[:, 0], at[:, 1])), shape=(nodes.size, nodes.size))
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
    text = (
        f"{len(edges.free)} of {edges.number} shell edges are free, in {_many(size.size, 'chain')}"
    )
    return f"{text}; the shortest has {size.min()}, at nodes {_some(short)}"


def edge_findings(model: Model) -> list[Finding]:
    """Neighbours with opposite normals: offsets, Z0 and the order of plies then change sides
    between them.
    """
    flipped = shell_edges(model).flipped
    if not len(flipped):
        return []
    text = f"{_many(len(flipped), 'shell edge')} between elements of opposite normals"
    return [Finding("info", f"{text}, at nodes {_some(flipped)}")]


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count != 1 else ''}"


def _some(edges: Int) -> str:
    nodes = np.unique(edges)
    return " ".join(map(str, nodes[:_NAMED].tolist())) + (" ..." if nodes.size > _NAMED else "")
