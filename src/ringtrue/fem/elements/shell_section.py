"""Sections of shells, integrated over the thickness: PSHELL, PCOMP, PCOMPG, thickness at the
corners, offset.

What the shell elements share: placing of blocks, drilling, offsets, mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements.shell_material import RIGID_SHEAR, laminates, layers, turned
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    arm,
    condense,
    congruent,
    frame,
    merged,
    nodal,
    node_dofs,
    rotation,
    scaled,
    taken,
    unit,
)

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

    def weights(self, w: Any_, N: Float, power: int) -> Any_:
        """Integration weights w (e, gp) times the relative thickness to a power; corner shapes N
        (gp, k).
        """
        if (self.profile == 1).all():
            return w
        return w * (self.profile @ N.T) ** power

    def masses(self, w: Any_, N: Float) -> Any_:
        """Mass (e, gp) at the integration points."""
        return np.asarray(
            self.density[:, None] * self.weights(w, N, 1) + self.nsm[:, None] * w
        )


def section(t: CardRows, corners: int) -> ShellSection:
    """The sections of elements in their material axes.

    Raises
    ------
    DeckError, UnsupportedCard
        If a property or material is absent or of an unknown kind.
    """
    model = t.mesh.model
    parts = []
    shell = np.ones(len(t), dtype=bool)
    for card in LAMINATES:
        here = np.isin(t["PID"], model[card].ids) if card in model else ~shell & shell
        if here.any():
            parts.append((here, _laminate(t.take(here), card, corners)))
            shell &= ~here
    if shell.any():
        parts.append((shell, _pshell(t.take(shell), corners)))
    return merged(len(t), parts)


def in_axes(s: ShellSection, turn: Any_) -> ShellSection:
    """The sections in axes in which their material axis has the direction `turn` (e, 2); isotropic
    ones stay as is.
    """
    some = directed(s)
    if not some.any():
        return s
    turn = turn[some]
    new = {
        name: getattr(s, name) for name in ("membrane", "coupling", "bending", "shear")
    }
    for name in ("membrane", "coupling", "bending"):
        plane, through = turned(new[name][some], s.shear[some], turn[:, 0], turn[:, 1])
        new[name] = new[name].astype(np.result_type(new[name], plane))
        new[name][some] = plane
    new["shear"] = s.shear.astype(np.result_type(s.shear, through))
    new["shear"][some] = through
    return replace(s, **new)


def directed(s: ShellSection) -> Bool:
    """Which sections depend on their direction."""
    some = (s.shear[:, 0, 1] != 0) | (s.shear[:, 0, 0] != s.shear[:, 1, 1])
    for C in (s.membrane, s.coupling, s.bending):
        some |= (C[:, :2, 2] != 0).any(axis=1) | (C[:, 0, 0] != C[:, 1, 1])
        some |= np.abs(C[:, 0, 0] - C[:, 0, 1] - 2 * C[:, 2, 2]) > 1e-12 * np.abs(
            C[:, 0, 0]
        )
    return np.asarray(some)


def oriented(t: CardRows, s: ShellSection, axes: Any_, x: Any_) -> ShellSection:
    """The sections in the element axes (e, 3, 3) of flat elements with nodes x (e, k, 3).

    THETA is measured from the side G1-G2.
    """
    turned = directed(s)
    if not turned.any():
        return s
    side = x[:, 1] - x[:, 0]
    side = unit(side - (side * axes[:, 2]).sum(axis=1)[:, None] * axes[:, 2])
    middle = SurfacePoints(x.mean(axis=1), tangent=side, normal=axes[:, 2])
    axis = material_axis(t, middle, turned)
    return in_axes(s, np.einsum("eij,ej->ei", axes[:, :2], axis))


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points x (..., 3) of shells, a tangent there and the normal."""

    x: Any_
    tangent: Any_
    normal: Any_


def material_axis(t: CardRows, points: SurfacePoints, turned: Bool) -> Any_:
    """Direction (e, 3) of the material axis in the plane of the normal at each point.

    THETA turns it from the tangent, in the plane; MCID projects the x axis of that frame.
    Sections that do not depend on their direction, others than `turned` (e,), may have it along the
    normal.

    Raises
    ------
    DeckError
        If the x axis of the frame is along the normal.
    """
    angle = np.radians(1.0) * t["THETA"]
    c = np.cos(angle)[:, None]
    s = np.sin(angle)[:, None]
    x, normal = points.x, points.normal
    out = c * points.tangent + s * np.cross(normal, points.tangent)
    named = np.flatnonzero(t["MCID"] >= 0)
    if named.size:
        axis = frame(t.mesh, t["MCID"][named], x[named].real)[:, 0]
        n = normal[named]
        flat = axis - (axis * n).sum(axis=1)[:, None] * n
        along = np.abs(flat).max(axis=1) < 1e-6
        why = "the x axis of its frame MCID is along the normal; name another frame"
        t.take(named).refuse(along & turned[named], why)
        out = out.astype(np.result_type(out, flat))
        use = ~np.isin(t.at[named], t.at[named[along]])
        out[named[use]] = unit(flat[use])
    return np.asarray(out)


def thickness(t: CardRows, corners: int, T: Any_) -> tuple[Any_, Any_]:
    """Mean thickness (e,) and that of the corners over it (e, k): Ti where given (times T for TFLAG
    1), else T.
    """
    own = t.stack(*(f"T{i + 1}" for i in range(corners)))
    if np.isnan(own).all():
        return T, np.ones(own.shape)
    own = np.where((t["TFLAG"] == 1)[:, None], own * T[:, None], own)
    own = np.where(np.isnan(own), T[:, None], own)
    mean = own.mean(axis=1)
    return mean, own / np.where(mean == 0, 1.0, mean)[:, None]


def _pshell(t: CardRows, corners: int) -> ShellSection:
    """PSHELL. MID4 couples by -T² G4: its G4 is 1/T² ∫ -z G dz (MSC Nastran)."""
    p = t.named("PSHELL")
    mid1, mid2, mid3, mid4 = (p[f"MID{i}"] for i in (1, 2, 3, 4))
    T, profile = thickness(t, corners, p["T"])
    lost = (T == 0) & ((mid1 > 0) | (mid2 > 0))
    p.refuse(lost, f"{t.card} {{}} has no thickness: T is blank or 0", t["EID"])
    stretch = layers(p, mid1, confined=mid2 < 0)
    bend = layers(p, mid2)
    own = (mid2 > 0) & (mid3 > 0)
    core = layers(p, np.where(own, mid3, 0), core=True)
    rigid = scaled(bend.plane[:, 2, 2] * RIGID_SHEAR * 5 / 6, np.eye(2))
    across = np.where(own[:, None, None], scaled(p["TST"], core.through), rigid)
    couple = layers(p, mid4).plane
    first = mid1 > 0
    turning = np.where(first, stretch.plane[:, 2, 2], bend.plane[:, 2, 2])
    return ShellSection(
        membrane=scaled(T, stretch.plane),
        coupling=-scaled(T * T, couple),
        bending=scaled(p["I12T3"] * T**3 / 12, bend.plane),
        shear=scaled(T, across),
        drill=turning * T * t.mesh.model.param("K6ROT", 100.0) * DRILL,
        density=np.where(first, stretch.density, bend.density) * T,
        nsm=p["NSM"] + t.listed_mass,
        loss=np.where(first, stretch.loss, bend.loss),
        offset=np.nan_to_num(t["ZOFFS"]),
        flexible=own & (mid3 != mid2),
        profile=profile,
    )


def _laminate(t: CardRows, card: str, corners: int) -> ShellSection:
    """PCOMP, PCOMPG; T1.. of the element do not change it, and its loss is the GE of the
    property.
    """
    p = t.named(card)
    rows, inverse = np.unique(p.at, return_inverse=True)
    L = taken(laminates(t.mesh.rows(card, rows)), inverse)
    return ShellSection(
        membrane=L.membrane,
        coupling=L.coupling,
        bending=L.bending,
        shear=L.shear,
        drill=L.turning * t.mesh.model.param("K6ROT", 100.0) * DRILL,
        density=L.density,
        nsm=p["NSM"] + t.listed_mass,
        loss=p["GE"],
        offset=np.nan_to_num(t["ZOFFS"]),
        flexible=np.ones(len(t), dtype=bool),
        profile=np.ones((len(t), corners)),
    )


SPAN = 2048
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # slopes (βx, βy) = (θy, -θx)


def in_spans(e: int, kernel: Callable[[slice], Any_]) -> Any_:
    """What `kernel` gives for spans of e elements, one after the other: bounds the memory of the
    strain rows.
    """
    return np.concatenate(
        [kernel(slice(i, i + SPAN)) for i in range(0, max(e, 1), SPAN)]
    )


def condensed(K: Any_, inner: int) -> Any_:
    """Condense the last `inner` parameters out; elements in which they have no stiffness are left
    as they are.
    """
    n = K.shape[1] - inner
    return condense(K, slice(n), slice(n, None))


def neutral_bending(s: ShellSection) -> Any_:
    """Bending stiffness (e, 3, 3) about the neutral plane, wherever a laminate has it."""
    if not np.any(s.coupling):
        return s.bending
    both = np.block([[s.bending, s.coupling], [s.coupling, s.membrane]])
    return condense(both, slice(3), slice(3, 6))


def in_series(stiffness: Any_, soft: Any_) -> Any_:
    """A stiffness, which may be singular, in series with the flexibility `soft`: (e, n, n)."""
    n = stiffness.shape[1]
    K = np.linalg.solve(np.eye(n) + stiffness @ soft, stiffness)
    return (K + K.swapaxes(1, 2)) / 2


def place(
    K: Any_, rows: list[int], block: Any_, columns: list[int] | None = None
) -> None:
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
    return slopes @ np.kron(np.eye(slopes.shape[-1] // 2), TURN)


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
    return (flat * w[:, :, None]).swapaxes(1, 2) @ flat


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
    t: CardRows, nodes: Int, K: Any_, section: ShellSection, axes: Any_, mass: Any_
) -> ElementMatrices:
    """Matrices of stiffness K (e, 6k, 6k) and nodal masses (e, k) of corners."""
    e, k = nodes.shape
    arms = np.broadcast_to(section.offset[:, None, None] * axes[:, None, 2], (e, k, 3))
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=K,
        mass=masses(arms, mass, pattern=_PATTERN[k] if t.mesh.coupled_mass else None),
        loss=section.loss,
    )


def masses(arms: Any_, mass: Any_, pattern: Any_ | None) -> Any_:
    """Lumped (e, 6k) or full (e, 6k, 6k) mass of nodal masses (e, k) at arms (e, k, 3) from the
    nodes.

    A coupled mass is the `pattern` (k, k) or (e, k, k), which sums to one, times the whole mass.
    """
    e, k = mass.shape
    ends = np.array([1.0, 1, 1, 0, 0, 0])
    lumped = (mass[..., None] * ends).reshape(e, 6 * k)
    if pattern is None and not np.any(arms):
        return np.asarray(lumped)
    M = lumped[:, :, None] * np.eye(6 * k)
    if pattern is not None:
        M = scaled(mass.sum(1), np.kron(pattern, np.diag(ends)))
    return congruent(nodal(arm(arms)), M) if np.any(arms) else M


_PATTERN = {  # consistent mass of a triangle and a parallelogram
    3: (1 + np.eye(3)) / 12,
    4: np.array([[4, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 36,
}
