"""CDAMP1-4: a dashpot between two components or scalar points; CVISC: one along and about a
line.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Int
from ringtrue.fem.algebra import scaled
from ringtrue.fem.elements import rod, spring
from ringtrue.fem.mesh import Matrices, Mesh, error, lookup
from ringtrue.fem.place import node_dofs, segment


def _only_viscous(dofs: Int, B: Any_) -> Matrices:
    e, d = dofs.shape
    return Matrices(dofs, np.zeros((e, d, d)), np.zeros((e, d)), np.zeros(e), B)


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CDAMP1 to CDAMP4."""
    dofs, way = spring.along(m, card, at)
    return _only_viscous(dofs, scaled(spring.value(m, card, at, "PDAMP", "B"), way))


def build_line(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CVISC: CE along the line, CR about it.

    Raises
    ------
    DeckError
        If a node or the property is absent or the ends are at one place.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2")[at], t, at)
    x = m.xyz[nodes]
    short = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == 0
    if short.any():
        raise error(m.model, t, int(at[short][0]), "its two ends are at one place")
    row = lookup(m.model, "PVISC", t["PID"][at], t, at)
    p, L = m.model["PVISC"], segment(x)[0]
    return _only_viscous(node_dofs(nodes), rod.kernel(x, p["CE"][row] * L, p["CR"][row] * L))
