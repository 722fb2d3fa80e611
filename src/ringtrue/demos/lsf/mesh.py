"""A small mesh builder: nodes merged by place, elements collected card by card, tables or deck text
at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Float, Int

Value = int | float | str | None
_GRAIN = 1e-4  # m: nodes closer than this are one


@dataclass
class Mesh:
    """Cards in the making; the only mutable thing of the worked example."""

    nodes: dict[tuple[int, int, int], int] = field(default_factory=dict)
    xyz: list[tuple[float, float, float]] = field(default_factory=list)
    cards: list[tuple[str, str, tuple[Value, ...]]] = field(
        default_factory=list
    )  # (part, card, fields)
    next_element: dict[str, int] = field(default_factory=dict)
    part: str = "main"
    part_of_node: list[str] = field(default_factory=list)
    bases: dict[str, int] = field(default_factory=dict)
    ids: list[int] = field(default_factory=list)
    count: dict[str, int] = field(default_factory=dict)

    def node(self, x: float, y: float, z: float, *, new: bool = False) -> int:
        """The node at a place; `new` makes a coincident one."""
        key = (round(x / _GRAIN), round(y / _GRAIN), round(z / _GRAIN))
        if not new and key in self.nodes:
            return self.nodes[key]
        n = self.count.get(self.part, 0) + 1
        self.count[self.part] = n
        number = self.bases.get(self.part, 0) + n
        self.xyz.append((x, y, z))
        self.ids.append(number)
        self.part_of_node.append(self.part)
        if not new:
            self.nodes[key] = number
        return number

    def lattice(self, points: Float) -> Int:
        """Nodes at points (..., 3), the same shape without the last axis."""
        flat = [self.node(*p) for p in points.reshape(-1, 3).tolist()]
        return np.array(flat).reshape(points.shape[:-1])

    def add(self, card: str, *fields: Value) -> None:
        """A card of the current part."""
        self.cards.append((self.part, card, fields))

    def element(self, card: str, *fields: Value) -> int:
        """An element card numbered next in the current part; `fields` follow the number."""
        n = self.next_element.get(self.part, 0) + 1
        self.next_element[self.part] = n
        eid = self.bases.get(self.part, 0) + n
        self.add(card, eid, *fields)
        return eid

    def rows(self, card: str, pid: int, nodes: NDArray[np.int64]) -> None:
        """Elements with nodes (e, k)."""
        for row in nodes.tolist():
            self.element(card, pid, *row)

    def nearest(self, part: str, point: Sequence[float], k: int = 1) -> list[int]:
        """The k nodes of a part that are nearest to a point."""
        at = [i for i, p in enumerate(self.part_of_node) if p == part]
        d = np.linalg.norm(np.array([self.xyz[i] for i in at]) - np.array(point), axis=1)
        return [self.ids[at[j]] for j in np.argsort(d, kind="stable")[:k].tolist()]
