"""Meshes of a box in every solid element, and a mapping of the box to bend it."""

from __future__ import annotations

import numpy as np
from fem_cases import cards

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.element_cards import SOLIDS
from ringtrue.model.model import Table

ELEMENTS = (
    "CHEXA8",
    "CHEXA20",
    "CPENTA6",
    "CPENTA15",
    "CTETRA4",
    "CTETRA10",
    "CPYRAM5",
    "CPYRAM13",
)
SECOND = ("CHEXA20", "CPENTA15", "CTETRA10", "CPYRAM13")
# a cube, corners numbered as CHEXA's, cut into others; node 8 is its middle
_CUTS = {
    "CHEXA": [[0, 1, 2, 3, 4, 5, 6, 7]],
    "CPENTA": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]],
    "CTETRA": [
        [0, 1, 2, 6],
        [0, 2, 3, 6],
        [0, 3, 7, 6],
        [0, 7, 4, 6],
        [0, 4, 5, 6],
        [0, 5, 1, 6],
    ],
    "CPYRAM": [
        [0, 1, 2, 3, 8],
        [4, 7, 6, 5, 8],
        [0, 4, 5, 1, 8],
        [1, 5, 6, 2, 8],
        [2, 6, 7, 3, 8],
        [3, 7, 4, 0, 8],
    ],
}


def kind(name: str) -> tuple[str, bool]:
    """Card, and whether it has midside nodes."""
    return name.rstrip("0123456789"), name in SECOND


def box(
    nx: int, ny: int, nz: int, size: tuple[float, float, float]
) -> tuple[Float, Int]:
    """Nodes (., 3) and hexahedra (., 8), 0-based."""
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, (nx, ny, nz), strict=True)]
    xyz = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    i = np.arange(xyz[..., 0].size).reshape(xyz.shape[:3])
    a, b = slice(None, -1), slice(1, None)
    corner = [i[x, y, z] for z in (a, b) for x, y in ((a, a), (b, a), (b, b), (a, b))]
    return xyz.reshape(-1, 3), np.stack(corner, axis=-1).reshape(-1, 8)


def cut(name: str, xyz: Float, hexas: Int) -> tuple[Float, Int]:
    """Nodes (., 3) and elements (e, n), 0-based; edges that are shared share their midside node,
    which is midway.
    """
    card, second = kind(name)
    if card == "CPYRAM":
        hexas = np.column_stack([hexas, len(xyz) + np.arange(len(hexas))])
        xyz = np.vstack([xyz, xyz[hexas[:, :8]].mean(axis=1)])
    elements = np.concatenate([hexas[:, c] for c in _CUTS[card]])
    if not second:
        return xyz, elements
    edges = np.sort(elements[:, SOLIDS[card].edges], axis=2)
    unique, at = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    middle = xyz[unique].mean(axis=1)
    return np.vstack([xyz, middle]), np.column_stack(
        [elements, len(xyz) + at.reshape(len(elements), -1)]
    )


def elements(card: str, nodes: Int, first: int = 1, pid: int = 1) -> Table:
    """A table of the card; nodes (e, n) 0-based, -1 for one that is left out."""
    g = {f"G{k + 1}": nodes[:, k] + 1 for k in range(nodes.shape[1])}
    return cards(card, EID=np.arange(len(nodes)) + first, PID=pid, **g)


def psolid(mid: int = 1, cordm: int = 0) -> Table:
    """PSOLID 1."""
    return cards("PSOLID", PID=[1], MID=mid, CORDM=cordm)


def distorted(xyz: Float, size: float, seed: int = 0) -> Float:
    """Nodes inside the unit cube moved by up to `size`."""
    inside = ((xyz > 1e-9) & (xyz < 1 - 1e-9)).all(axis=1)
    move = np.random.default_rng(seed).uniform(-size, size, xyz.shape)
    return xyz + inside[:, None] * move
