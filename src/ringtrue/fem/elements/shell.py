"""What the shell elements share: PSHELL, drilling, offsets, mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.algebra import arm, congruent, nodal, rotation, scaled
from ringtrue.fem.isotropy import plane_stress
from ringtrue.fem.mesh import Matrices, Mesh, isotropic, lookup
from ringtrue.fem.place import node_dofs
from ringtrue.model.model import Table

RIGID_SHEAR = 1000.0  # MID3 blank: the shear modulus of MID2 times this, which bends as if rigid in shear
DRILL = 1e-6  # what PARAM,K6ROT multiplies


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """Sections of shells (e,), integrated over the thickness.

    `membrane` and `bending` are (c11, c12, G) times t and 12I/T³·t³/12; `shear` is κ G t; `drill` G t·K6ROT·1e-6.
    """

    membrane: tuple[Any_, Any_, Any_]
    bending: tuple[Any_, Any_, Any_]
    shear: Any_
    drill: Any_
    per_area: Any_
    loss: Any_
    offset: Any_


def thickness(t: Table, at: Int, corners: int, T: Any_) -> Any_:
    """Mean thickness (e,): T1.. where given (relative to T for TFLAG 1), else T."""
    own = t.stack(*(f"T{i}" for i in range(1, corners + 1)))[at]
    own = np.where((t["TFLAG"][at] == 1)[:, None], own * T[:, None], own)
    return np.asarray(np.where(np.isnan(own), T[:, None], own).mean(axis=1))


def _layer(m: Mesh, mid: Int, p: Table, row: Int) -> tuple[tuple[Any_, Any_, Any_], Any_, Any_]:
    """(c11, c12, G), density and loss (e,); zeros where no material is given (MID 0)."""
    used = mid > 0
    iso = isotropic(m.model, mid[used], p, row[used])
    kind = np.result_type(iso.E, iso.G, iso.nu, iso.rho, iso.loss)
    out = np.zeros((5, mid.size), dtype=kind)
    out[:, used] = [*plane_stress(iso.E, iso.nu), iso.G, iso.rho, iso.loss]
    return (out[0], out[1], out[2]), out[3], out[4]


def plate(m: Mesh, card: str, at: Int, corners: int) -> Plate:
    """The sections of rows `at` (e,).

    Raises
    ------
    DeckError, UnsupportedCard
        If the property is absent; on PSHELL with MID4 or plane strain.
    """
    t = m.model[card]
    row = lookup(m.model, "PSHELL", t["PID"][at], t, at)
    p = m.model["PSHELL"]
    mid1, mid2, mid3, mid4 = (p[c][row] for c in ("MID1", "MID2", "MID3", "MID4"))
    strange = (mid4 > 0) | (mid2 < 0)
    if strange.any():
        raise UnsupportedCard("PSHELL", why=f"{p.ids[row[strange][0]]} has MID4 or plane strain (MID2 -1)")
    T = thickness(t, at, corners, p["T"][row])
    stretch, rho, loss = _layer(m, mid1, p, row)
    bend, rho2, loss2 = _layer(m, mid2, p, row)
    inertia = p["I12T3"][row] * T**3 / 12
    sheared = _layer(m, np.where(mid2 > 0, mid3, 0), p, row)[0][2]
    shear = np.where(mid3 > 0, sheared * p["TST"][row], bend[2] * RIGID_SHEAR * 5 / 6) * T
    drill = np.where(mid1 > 0, stretch[2], bend[2]) * T * m.model.param("K6ROT", 100.0) * DRILL
    mass = np.where(mid1 > 0, rho, rho2) * T + p["NSM"][row]
    z = t["ZOFFS"][at]
    return Plate(
        (stretch[0] * T, stretch[1] * T, stretch[2] * T),
        (bend[0] * inertia, bend[1] * inertia, bend[2] * inertia),
        shear,
        drill,
        mass,
        np.where(mid1 > 0, loss, loss2),
        np.where(np.isnan(z), 0.0, z),
    )


def place(K: Any_, dofs: list[int], block: Any_) -> None:
    """Add a block (e, k r, k r) of `dofs` (r) a node into K (e, k, 6, k, 6)."""
    k, r = K.shape[1], len(dofs)
    block = block.reshape(-1, k, r, k, r)
    for i, a in enumerate(dofs):
        for j, b in enumerate(dofs):
            K[:, :, a, :, b] += block[:, :, i, :, j]


def drilling(N: Float, gradients: Float, w: Float) -> Any_:
    """∫ (θz - (∂v/∂x - ∂u/∂y)/2)² over (u, v, θz) of each node: (e, 3k, 3k); N (gp, k), w (e, gp)."""
    e, g, k = gradients.shape[:3]
    row = np.empty((e, g, k, 3))
    row[..., 0], row[..., 1] = gradients[..., 1] / 2, -gradients[..., 0] / 2
    row[..., 2] = N
    flat = row.reshape(e, g, 3 * k)
    return np.asarray((flat * w[:, :, None]).swapaxes(1, 2) @ flat)


def finish(m: Mesh, nodes: Int, K: Any_, section: Plate, axes: Float, heights: Float, share: Float) -> Matrices:
    """Local stiffness (e, k, 6, k, 6) and nodal areas `share` (e, k) to matrices of the nodes.

    `heights` (e, k) are the nodes above the mean plane: each is joined to its projection by a rigid arm along the
    normal, so that a warped element has no energy in a rigid motion.
    """
    e, k = nodes.shape
    arms = np.zeros((e, k, 3), dtype=section.offset.dtype)
    arms[..., 2] = section.offset[:, None] - heights
    local = nodal(arm(arms)) @ rotation(axes, k)
    K = congruent(local, K.reshape(e, 6 * k, 6 * k))
    M = _mass(m, section, axes, share)
    return Matrices(node_dofs(nodes), K, M, section.loss, np.empty((0, 6 * k, 6 * k)))


def _mass(m: Mesh, section: Plate, axes: Float, share: Float) -> Any_:
    e, k = share.shape
    ends = np.array([1.0, 1, 1, 0, 0, 0])
    lumped = (section.per_area[:, None] * share)[..., None] * ends
    coupled = m.model.param("COUPMASS", -1) > 0
    if not coupled and not np.any(section.offset):
        return np.asarray(lumped.reshape(e, 6 * k))
    M = lumped.reshape(e, -1)[:, :, None] * np.eye(6 * k)
    if coupled:  # the shape of a parallelogram
        same = (1 + np.eye(k)) / (k * (k + 1)) if k == 3 else np.array(_QUAD) / 36
        pattern = np.einsum("ij,ab->iajb", same, np.diag(ends)).reshape(6 * k, 6 * k)
        M = scaled(section.per_area * share.sum(1), np.broadcast_to(pattern, (e, 6 * k, 6 * k)))
    arms = np.zeros((e, k, 3), dtype=section.offset.dtype)
    arms[..., 2] = section.offset[:, None]
    return congruent(nodal(arm(arms)) @ rotation(axes, k), M)


_QUAD = ((4, 2, 1, 2), (2, 4, 2, 1), (1, 2, 4, 2), (2, 1, 2, 4))
