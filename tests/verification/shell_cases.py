"""Meshes of every shell card over a mapped unit square, and static answers, for the tests of the
shells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from fem_cases import cards, ragged

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.model.model import Model, Table
from ringtrue.solvers.embedded import EmbeddedSolver

SHELLS = ("CQUAD4", "CTRIA3", "CQUAD8", "CTRIA6")
SECOND = ("CQUAD8", "CTRIA6")


def net(
    card: str, n: int, m: int, place: Callable[[Float, Float], Float]
) -> tuple[Float, Int, Float]:
    """Nodes (., 3), elements (., k) by 1-based nodes, and the nodes (u, v) in the unit square, of n
    x m cells.

    A cell is a quadrilateral or two triangles.
    """
    q = 2 if card in SECOND else 1
    a, b = np.meshgrid(np.arange(q * n + 1), np.arange(q * m + 1), indexing="ij")
    ids = np.arange(a.size).reshape(a.shape)
    i, j = (
        v.ravel()
        for v in np.meshgrid(q * np.arange(n), q * np.arange(m), indexing="ij")
    )
    cell = {(r, s): ids[i + r, j + s] for r in range(q + 1) for s in range(q + 1)}
    c = [cell[0, 0], cell[q, 0], cell[q, q], cell[0, q]]
    low, high = c[:3], [c[0], c[2], c[3]]
    if card == "CQUAD8":
        parts = [[*c, cell[1, 0], cell[2, 1], cell[1, 2], cell[0, 1]]]
    elif card == "CTRIA6":
        parts = [
            [*low, cell[1, 0], cell[2, 1], cell[1, 1]],
            [*high, cell[1, 1], cell[1, 2], cell[0, 1]],
        ]
    else:
        parts = [c] if card == "CQUAD4" else [low, high]
    elements = np.concatenate([np.stack(p, axis=1) for p in parts])
    used, at = np.unique(elements, return_inverse=True)
    uv = np.stack([a.ravel() / (q * n), b.ravel() / (q * m)], axis=1)[used]
    return place(uv[:, 0], uv[:, 1]), at.reshape(elements.shape) + 1, uv


def shell(card: str, elements: Int, **columns: object) -> Table:
    """Cards 1.. of property 1."""
    g = {f"G{i + 1}": elements[:, i] for i in range(elements.shape[1])}
    return cards(card, EID=np.arange(1, len(elements) + 1), PID=1, **g, **columns)


def rectangle(a: float = 1.0, b: float = 1.0) -> Callable[[Float, Float], Float]:
    """A flat a x b plate."""
    return lambda u, v: np.stack([a * u, b * v, 0 * u], axis=1)


def held(*sets: tuple[Bool, str]) -> Table:
    """SPC1 of flagged nodes, all in set 1."""
    nodes = ragged(*[np.flatnonzero(flags) + 1 for flags, _ in sets])
    return cards("SPC1", SID=[1] * len(sets), C=[c for _, c in sets], G=nodes)


def nearest(uv: Float, u: float, v: float) -> int:
    """The node at (u, v)."""
    return int(np.hypot(uv[:, 0] - u, uv[:, 1] - v).argmin()) + 1


def displacement(
    m: Model, loads: list[tuple[int, int, float]], node: int, component: int
) -> float:
    """Static displacement under loads (node, component, force)."""
    with EmbeddedSolver().open(m) as analysis:
        node_, component_, value = (np.array(v) for v in zip(*loads, strict=True))
        F = np.zeros((len(analysis.dofs), 1))
        np.add.at(F[:, 0], analysis.dofs.find(node_, component_), value)
        u = analysis.static(F)
        return float(
            u[analysis.dofs.find(np.array([node]), np.array([component]))[0], 0]
        )
