"""CROD, CONROD, CTUBE: axial force and torsion along a straight line."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    isotropic,
    node_dofs,
    scaled,
    segment,
)

_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


def kernel(x: Float, EA: Any_, GJ: Any_) -> Any_:
    """Stiffness in basic: x (e, 2, 3), EA and GJ (e,) -> (e, 12, 12)."""
    L, axis = segment(x)
    direction = np.einsum("ei,ej->eij", axis, axis)
    # node, kind, axis, twice
    K = np.zeros((len(x), 2, 2, 3, 2, 2, 3), dtype=np.result_type(EA, GJ))
    for kind, c in enumerate((EA / L, GJ / L)):
        K[:, :, kind, :, :, kind, :] = np.einsum("e,kl,eij->ekilj", c, _PAIR, direction)
    return K.reshape(-1, 12, 12)


def mass(x: Float, per_length: Any_, coupled: bool) -> Any_:
    """Half the mass at each end (e, 12), or the coupled matrix (e, 12, 12).

    Coupled is, along the axis, the mean of lumped and consistent: 5/12 and 1/12 of the mass (fourth
    order).
    """
    L, axis = segment(x)
    ends = np.tile([0.5, 0.5, 0.5, 0.0, 0.0, 0.0], 2)
    if not coupled:
        return np.asarray((per_length * L)[:, None] * ends)
    along = np.einsum("kl,ei,ej->ekilj", _PAIR / 12, axis, axis)
    M = np.broadcast_to(np.diag(ends), (len(x), 12, 12)).copy().reshape(-1, 2, 6, 2, 6)
    M[:, :, :3, :, :3] -= along
    return scaled(per_length * L, M.reshape(-1, 12, 12))


def tube(outer: Any_, wall: Any_) -> tuple[Any_, Any_]:
    """Area and torsion constant of a tube; a wall of 0 is a solid rod."""
    inner = np.where(wall == 0, 0.0, outer - 2 * wall)
    return np.pi / 4 * (outer**2 - inner**2), np.pi / 32 * (outer**4 - inner**4)


def _section(t: CardRows) -> tuple[CardRows, Any_, Any_]:
    """The cards of the sections, areas and torsion constants (e,)."""
    if t.card == "CTUBE":
        p = t.named("PTUBE")
        end = np.where(p["OD2"] == 0, p["OD"], p["OD2"])
        return p, *tube((p["OD"] + end) / 2, p["T"])
    p = t if t.card == "CONROD" else t.named("PROD")
    return p, p["A"], p["J"]


def ends(t: CardRows) -> tuple[Int, Float]:
    """Nodes (e, 2) at G1 and G2 and their places (e, 2, 3), which differ."""
    nodes = t.nodes("G1", "G2")
    x = t.mesh.xyz[nodes]
    t.refuse((x[:, 0] == x[:, 1]).all(axis=1), "its two ends are at one place")
    return nodes, x


def measure(t: CardRows) -> Float:
    """Lengths (e,)."""
    return segment(ends(t)[1])[0]


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CROD, CONROD or CTUBE.

    Raises
    ------
    DeckError
        If an element has no length.
    """
    nodes, x = ends(t)
    p, A, J = _section(t)
    iso = isotropic(p.named("MAT1", "MID"))
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=kernel(x, iso.E * A, iso.G * J),
        mass=mass(x, iso.rho * A + p["NSM"] + t.listed_mass, t.mesh.coupled_mass),
        loss=iso.loss,
    )
