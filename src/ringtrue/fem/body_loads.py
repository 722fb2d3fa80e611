"""Loads of whole bodies at full DOFs, element by element: centrifugal forces."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.fem.algebra import add_at, applied
from ringtrue.fem.assembly import pieces
from ringtrue.fem.elements import lumped
from ringtrue.fem.mesh import Mesh


def spin_forces(m: Mesh, origin: Float, spin: Float) -> Float:
    """Centrifugal forces of all masses about an axis, as the mass matrix has them, PARAM,WTMASS
    applied.

    The body of a CONM2 is beside its node, at its own distance, and its tensor J gives the moment
    -ω × Jω.

    Parameters
    ----------
    origin, spin : (3,) float64
        A point of the axis, and the angular velocity, rad/s, basic frame.

    Returns
    -------
    (full,) float64
    """
    out = np.zeros(m.size)
    field = np.zeros(m.size)
    pull = spin @ spin * np.eye(3) - np.outer(spin, spin)  # -ω × (ω × r)
    field[: 6 * len(m.xyz)].reshape(-1, 6)[:, :3] = (m.xyz - origin) @ pull
    for _, _, p in pieces(m):
        add_at(out, p.dofs, applied(p.mass, field[p.dofs.clip(min=0), None])[:, :, 0])
    if "CONM2" in m.model:
        p = lumped.build_point_mass(m, "CONM2", np.arange(len(m.model["CONM2"])))
        moment, inertia = p.mass[:, :3, 3:], p.mass[:, 3:, 3:]  # the first is -[m d ×]
        arm = np.stack([moment[:, 1, 2], moment[:, 2, 0], moment[:, 0, 1]], axis=1)
        add_at(out, p.dofs, np.concatenate([arm @ pull, -np.cross(spin, inertia @ spin)], axis=1))
    return np.asarray(out * m.model.param("WTMASS", 1.0))
