"""Sections of shells, integrated over the thickness: PSHELL, PCOMP, PCOMPG, thickness at the
corners, offset.

What the shell elements share: placing of blocks, drilling, offsets, mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements.shell_material import RIGID_SHEAR, laminates, layers, turned
from ringtrue.fem.mesh import (
    ElementMatrices,
    Mesh,
    arm,
    condense,
    congruent,
    frame,
    lookup,
    nodal,
    node_dofs,
    rotation,
    scaled,
    unit,
)
from ringtrue.model.model import Table, card_error

DRILL = 1e-6  # what PARAM,K6ROT multiplies
LAMINATES = ("PCOMP", "PCOMPG")


@dataclass(frozen=True, slots=True, eq=False)
class ShellSection:
    """Sections of shells (e,): N = A ε + B κ, M = B ε + D κ, Q = S γ, z up along the normal.

    Attributes
    ----------
    membrane, coupling, bending : (e, 3, 3)
    shear : (e, 2, 2)
    drill : (e,)
        G t K6ROT 1e-6.
    density, nsm : (e,)
        Mass per area that goes with the thickness, and that which does not.
    loss, offset : (e,)
    flexible : (e,) bool
        A triangle must follow the transverse shear: laminates, and PSHELL with a shear material of
        its own.
    profile : (e, k)
        Thickness of the corners over the mean.
    """

    membrane: Any_
    coupling: Any_
    bending: Any_
    shear: Any_
    drill: Any_
    density: Any_
    nsm: Any_
    loss: Any_
    offset: Any_
    flexible: Bool
    profile: Any_

    def take(self, rows: Any_ | slice) -> ShellSection:
        """The sections of some elements: rows, flags or a slice."""
        return ShellSection(*(getattr(self, f.name)[rows] for f in fields(ShellSection)))

    def weights(self, w: Any_, N: Float, power: int) -> Any_:
        """Integration weights w (e, gp) times the relative thickness to a power; corner shapes N
        (gp, k).
        """
        if (self.profile == 1).all():
            return w
        return np.asarray(w * (self.profile @ N.T) ** power)

    def masses(self, w: Any_, N: Float) -> Any_:
        """Mass (e, gp) at the integration points."""
        return np.asarray(self.density[:, None] * self.weights(w, N, 1) + self.nsm[:, None] * w)


def section(m: Mesh, card: str, at: Int, corners: int) -> ShellSection:
    """The sections of rows `at` (e,) in their material axes.

    Raises
    ------
    DeckError, UnsupportedCard
        If a property or material is absent or of an unknown kind.
    """
    t = m.model[card]
    pid = t["PID"][at]
    found = {c: m.model[c].find(pid) for c in LAMINATES if c in m.model}
    shell = np.logical_and.reduce(
        [np.ones(at.size, dtype=bool), *(rows < 0 for rows in found.values())]
    )
    parts = [(shell, _pshell(m, t, at[shell], corners))] if shell.any() else []
    parts += [
        (rows >= 0, _laminate(m, c, rows[rows >= 0], t=t, at=at[rows >= 0], corners=corners))
        for c, rows in found.items()
    ]
    parts = [p for p in parts if p[0].any()]
    if len(parts) == 1:
        return parts[0][1]
    made = {}
    for f in (f.name for f in fields(ShellSection)):
        values = [(where, getattr(s, f)) for where, s in parts]
        made[f] = np.zeros(
            (at.size, *values[0][1].shape[1:]), dtype=np.result_type(*(v.dtype for _, v in values))
        )
        for where, v in values:
            made[f][where] = v
    return ShellSection(**made)


def in_axes(s: ShellSection, turn: Any_) -> ShellSection:
    """The sections in axes in which their material axis has the direction `turn` (e, 2); isotropic
    ones stay as is.
    """
    some = directed(s)
    if not some.any():
        return s
    c = turn[some, 0]
    n = turn[some, 1]
    new: dict[str, Any_] = {}
    for name in ("membrane", "coupling", "bending"):
        old = getattr(s, name)
        plane, through = turned(old[some], s.shear[some], c, n)
        new[name] = old.astype(np.result_type(old, plane))
        new[name][some] = plane
    new["shear"] = s.shear.astype(np.result_type(s.shear, through))
    new["shear"][some] = through
    return replace(s, **new)


def directed(s: ShellSection) -> Bool:
    """Which sections depend on their direction."""
    some = (s.shear[:, 0, 1] != 0) | (s.shear[:, 0, 0] != s.shear[:, 1, 1])
    for C in (s.membrane, s.coupling, s.bending):
        some |= (C[:, :2, 2] != 0).any(axis=1) | (C[:, 0, 0] != C[:, 1, 1])
        some |= np.abs(C[:, 0, 0] - C[:, 0, 1] - 2 * C[:, 2, 2]) > 1e-12 * np.abs(C[:, 0, 0])
    return np.asarray(some)


def oriented(m: Mesh, card: str, at: Int, s: ShellSection, axes: Any_, x: Any_) -> ShellSection:
    """The sections in the element axes (e, 3, 3) of flat elements with nodes x (e, k, 3).

    THETA is measured from the side G1-G2.
    """
    turned = directed(s)
    if not turned.any():
        return s
    side = x[:, 1] - x[:, 0]
    side = unit(side - (side * axes[:, 2]).sum(axis=1)[:, None] * axes[:, 2])
    middle = SurfacePoints(x.mean(axis=1), tangent=side, normal=axes[:, 2])
    axis = material_axis(m, card, at, middle, turned)
    return in_axes(s, np.einsum("eij,ej->ei", axes[:, :2], axis))


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points x (..., 3) of shells, a tangent there and the normal."""

    x: Any_
    tangent: Any_
    normal: Any_


def material_axis(m: Mesh, card: str, at: Int, points: SurfacePoints, turned: Bool) -> Any_:
    """Direction (e, 3) of the material axis in the plane of the normal at each point.

    THETA turns it from the tangent, in the plane; MCID projects the x axis of that frame.
    Sections that do not depend on their direction, others than `turned` (e,), may have it along the
    normal.

    Raises
    ------
    DeckError
        If the x axis of the frame is along the normal.
    """
    t = m.model[card]
    angle = np.radians(1.0) * t["THETA"][at]
    cid = t["MCID"][at]
    c = np.cos(angle)[:, None]
    s = np.sin(angle)[:, None]
    x, normal = points.x, points.normal
    out = c * points.tangent + s * np.cross(normal, points.tangent)
    named = np.flatnonzero(cid >= 0)
    if named.size:
        axis = frame(m, cid[named], x[named].real)[:, 0]
        n = normal[named]
        flat = axis - (axis * n).sum(axis=1)[:, None] * n
        along = named[np.abs(flat).max(axis=1) < 1e-6]
        if turned[along].any():
            bad = int(at[along[turned[along]][0]])
            raise card_error(
                m.model,
                t,
                bad,
                "the x axis of its frame MCID is along the normal; name another frame",
            )
        out = out.astype(np.result_type(out, flat))
        use = ~np.isin(at[named], at[along])
        out[named[use]] = unit(flat[use])
    return np.asarray(out)


def thickness(t: Table, at: Int, corners: int, T: Any_) -> tuple[Any_, Any_]:
    """Mean thickness (e,) and that of the corners over it (e, k): Ti where given (times T for TFLAG
    1), else T.
    """
    own = t.stack(*(f"T{i}" for i in range(1, corners + 1)))[at]
    if np.isnan(own).all():
        return T, np.ones(own.shape)
    own = np.where((t["TFLAG"][at] == 1)[:, None], own * T[:, None], own)
    own = np.where(np.isnan(own), T[:, None], own)
    mean = own.mean(axis=1)
    return mean, own / np.where(mean == 0, 1.0, mean)[:, None]


def _offset(t: Table, at: Int) -> Any_:
    z = t["ZOFFS"][at]
    return np.where(np.isnan(z), 0.0, z)


def _pshell(m: Mesh, t: Table, at: Int, corners: int) -> ShellSection:
    """PSHELL. MID4 couples by -T² G4: its G4 is 1/T² ∫ -z G dz (MSC Nastran)."""
    row = lookup(m.model, "PSHELL", t["PID"][at], table=t, at=at)
    p = m.model["PSHELL"]
    mid1, mid2, mid3, mid4 = (p[c][row] for c in ("MID1", "MID2", "MID3", "MID4"))
    T, profile = thickness(t, at, corners, p["T"][row])
    if (lost := (T == 0) & ((mid1 > 0) | (mid2 > 0))).any():
        i = int(np.flatnonzero(lost)[0])
        raise card_error(
            m.model, p, int(row[i]), f"{t.card} {t.ids[at[i]]} has no thickness: T is blank or 0"
        )
    stretch = layers(m.model, mid1, p, row, confined=mid2 < 0)
    bend = layers(m.model, mid2, p, row)
    own = (mid2 > 0) & (mid3 > 0)
    core = (
        layers(m.model, np.where(own, mid3, 0), p, row, core=True).through
        * p["TST"][row][:, None, None]
    )
    rigid = (bend.plane[:, 2, 2] * RIGID_SHEAR * 5 / 6)[:, None, None] * np.eye(2)
    couple = layers(m.model, mid4, p, row).plane
    first = mid1 > 0
    turning = np.where(first, stretch.plane[:, 2, 2], bend.plane[:, 2, 2])
    t1 = T[:, None, None]
    inertia = (p["I12T3"][row] * T**3 / 12)[:, None, None]
    return ShellSection(
        membrane=stretch.plane * t1,
        coupling=-couple * t1 * t1,
        bending=bend.plane * inertia,
        shear=np.where(own[:, None, None], core, rigid) * t1,
        drill=turning * T * m.model.param("K6ROT", 100.0) * DRILL,
        density=np.where(first, stretch.density, bend.density) * T,
        nsm=p["NSM"][row] + m.nsm(t.card, at),
        loss=np.where(first, stretch.loss, bend.loss),
        offset=_offset(t, at),
        flexible=own & (mid3 != mid2),
        profile=profile,
    )


def _laminate(m: Mesh, card: str, row: Int, t: Table, at: Int, corners: int) -> ShellSection:
    """PCOMP, PCOMPG; T1.. of the element do not change it, and its loss is the GE of the
    property.
    """
    rows, inverse = np.unique(row, return_inverse=True)
    L = laminates(m.model, card, rows)
    p = m.model[card]
    return ShellSection(
        membrane=L.membrane[inverse],
        coupling=L.coupling[inverse],
        bending=L.bending[inverse],
        shear=L.shear[inverse],
        drill=L.turning[inverse] * m.model.param("K6ROT", 100.0) * DRILL,
        density=L.density[inverse],
        nsm=p["NSM"][row] + m.nsm(t.card, at),
        loss=p["GE"][row],
        offset=_offset(t, at),
        flexible=np.ones(at.size, dtype=bool),
        profile=np.ones((at.size, corners)),
    )


SPAN = 2048
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # slopes (βx, βy) = (θy, -θx)


def in_spans(e: int, kernel: Callable[[slice], Any_]) -> Any_:
    """What `kernel` gives for spans of e elements, one after the other: bounds the memory of the
    strain rows.
    """
    return np.concatenate([kernel(slice(i, i + SPAN)) for i in range(0, max(e, 1), SPAN)])


def condensed(K: Any_, inner: int) -> Any_:
    """Condense the last `inner` parameters out; elements in which they have no stiffness are left
    as they are.
    """
    n = K.shape[1] - inner
    return condense(K, slice(n), slice(n, None))


def place(K: Any_, rows: list[int], block: Any_, columns: list[int] | None = None) -> None:
    """Add a block (e, k r, k c) of DOFs `rows` (r) and `columns` (c, or as the rows) a node into K
    (e, k, 6, k, 6).
    """
    k = K.shape[1]
    columns = columns or rows
    block = block.reshape(-1, k, len(rows), k, len(columns))
    for i, a in enumerate(rows):
        for j, b in enumerate(columns):
            K[:, :, a, :, b] += block[:, :, i, :, j]


def of_rotations(slopes: Any_) -> Any_:
    """Columns over slopes (..., k 2) to columns over (θx, θy), the same shape."""
    parts = slopes.reshape(*slopes.shape[:-1], -1, 2) @ TURN
    return np.asarray(parts.reshape(slopes.shape))


def drilling(N: Float, gradients: Any_, w: Any_) -> Any_:
    """∫ (θz - (∂v/∂x - ∂u/∂y)/2)² over (u, v, θz) of each node: (e, 3k, 3k); N (gp, k), w (e,
    gp).
    """
    e, g, k = gradients.shape[:3]
    row = np.empty((e, g, k, 3), dtype=gradients.dtype)
    row[..., 0] = gradients[..., 1] / 2
    row[..., 1] = -gradients[..., 0] / 2
    row[..., 2] = N
    flat = row.reshape(e, g, 3 * k)
    return np.asarray((flat * w[:, :, None]).swapaxes(1, 2) @ flat)


def to_nodes(K: Any_, section: ShellSection, axes: Any_, heights: Any_) -> Any_:
    """Local stiffness (e, k, 6, k, 6) of corners to that of the nodes in basic, (e, 6k, 6k).

    `heights` (e, k) are the nodes above the mean plane: each is joined to its projection by a rigid
    arm along the normal, so that a warped element has no energy in a rigid motion.
    """
    e, k = heights.shape
    arms = np.zeros((e, k, 3), dtype=np.result_type(section.offset, heights))
    arms[..., 2] = section.offset[:, None] - heights
    local = nodal(arm(arms) @ rotation(axes, 1)[:, None])
    return congruent(local, K.reshape(e, 6 * k, 6 * k))


def finish(
    m: Mesh, nodes: Int, K: Any_, section: ShellSection, axes: Any_, mass: Any_
) -> ElementMatrices:
    """Matrices of stiffness K (e, 6k, 6k) and nodal masses (e, k) of corners."""
    e, k = nodes.shape
    offset = section.offset[:, None, None] * axes[:, None, 2]
    M = masses(m, np.broadcast_to(offset, (e, k, 3)), mass, np.asarray(_PATTERN[k]))
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=K,
        mass=M,
        loss=section.loss,
    )


def masses(m: Mesh, arms: Any_, mass: Any_, pattern: Any_) -> Any_:
    """Lumped (e, 6k) or full (e, 6k, 6k) mass of nodal masses (e, k) at arms (e, k, 3) from the
    nodes.

    PARAM,COUPMASS takes `pattern` (k, k) or (e, k, k), which sums to one, times the whole mass.
    """
    e, k = mass.shape
    ends = np.array([1.0, 1, 1, 0, 0, 0])
    lumped = mass[..., None] * ends
    coupled = m.model.param("COUPMASS", -1) > 0
    if not coupled and not np.any(arms):
        return np.asarray(lumped.reshape(e, 6 * k))
    M = lumped.reshape(e, -1)[:, :, None] * np.eye(6 * k)
    if coupled:
        full = np.einsum("...ij,ab->...iajb", pattern, np.diag(ends)).reshape(
            *pattern.shape[:-2], 6 * k, 6 * k
        )
        M = scaled(mass.sum(1), np.broadcast_to(full, (e, 6 * k, 6 * k)))
    return congruent(nodal(arm(arms)), M) if np.any(arms) else M


_PATTERN = {  # consistent mass of a triangle and a parallelogram
    3: (1 + np.eye(3)) / 12,
    4: np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 36,
}
