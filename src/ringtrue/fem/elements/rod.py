"""CROD, CONROD, CTUBE: axial force and torsion along a straight line."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.mesh import (
    ElementMatrices,
    Isotropic,
    Mesh,
    isotropic,
    lookup,
    node_dofs,
    scaled,
    segment,
)
from ringtrue.model.model import refuse_rows

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


def _section(m: Mesh, card: str, at: Int) -> tuple[Isotropic, Any_, Any_, Any_]:
    t = m.model[card]
    if card == "CONROD":
        return isotropic(m.model, t["MID"][at], t, at), t["A"][at], t["J"][at], t["NSM"][at]
    name = "PROD" if card == "CROD" else "PTUBE"
    row = lookup(m.model, name, t["PID"][at], table=t, at=at)
    p = m.model[name]
    iso = isotropic(m.model, p["MID"][row], p, row)
    if name == "PROD":
        return iso, p["A"][row], p["J"][row], p["NSM"][row]
    end = np.where(p["OD2"][row] == 0, p["OD"][row], p["OD2"][row])
    return iso, *tube((p["OD"][row] + end) / 2, p["T"][row]), p["NSM"][row]


def measure(m: Mesh, card: str, at: Int) -> Float:
    """Lengths (e,) of the rows `at`."""
    t = m.model[card]
    return segment(m.xyz[m.nodes(t.stack("G1", "G2")[at], t, at)])[0]


def build(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CROD, CONROD or CTUBE.

    Raises
    ------
    DeckError
        If an element has no length.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("G1", "G2")[at], t, at)
    x = m.xyz[nodes]
    short = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == 0
    refuse_rows(m.model, t, at[short], "its two ends are at one place")
    iso, A, J, nsm = _section(m, card, at)
    M = mass(x, iso.rho * A + nsm + m.nsm(card, at), m.model.param("COUPMASS", -1) > 0)
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=kernel(x, iso.E * A, iso.G * J),
        mass=M,
        loss=iso.loss,
    )
