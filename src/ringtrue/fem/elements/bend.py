"""CBEND: a beam or pipe along a circular arc, from its exact flexibility.

Loaded at its ends the arc carries forces that equilibrium alone gives; with the compliance c of the
section end B moves against end A by F f, F = ∫ b c bᵀ ds, and the stiffness is Dᵀ F⁻¹ D, as for
straight beams. The section is that of Winkler and Bach (Timoshenko, Strength of Materials II, 1956,
article 16): with the neutral axis e nearer to the centre than the centroid, ε = N/EA + e M/EI1 and
κ = M/EI1 + e N/EI1; exact for e = I1/(A R).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.fem.mesh import (
    ElementMatrices,
    Mesh,
    arm,
    congruent,
    isotropic,
    lookup,
    node_dofs,
    orientation,
    scaled,
    scatter,
    unit,
)
from ringtrue.model.model import Table, card_error

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LINE = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """Arcs of the nodes (e,); the line of centroids is concentric.

    Attributes
    ----------
    middle : (e, 3)
        Half way between the nodes.
    out, along : (e, 3) float64
        Unit vectors in the plane of the arc: from the chord to the arc, and from A to B.
    radius, angle : (e,)
        Through the nodes; angle from A to B, radian.
    """

    middle: Float
    out: Float
    along: Float
    radius: Any_
    angle: Any_

    def axes(self, share: float) -> Any_:
        """Axes (e, 3, 3) as rows, R outward, θ along the arc and Z, at -1 (A) to 1 (B) of the
        arc.
        """
        phi = (share / 2 * self.angle)[:, None]
        R = np.cos(phi) * self.out + np.sin(phi) * self.along
        theta = np.cos(phi) * self.along - np.sin(phi) * self.out
        return np.stack([R, theta, np.cross(R, theta)], axis=1)

    def place(self, share: float, radius: Any_, height: Any_) -> Any_:
        """Points (e, 3) on the concentric arc of that radius, at `height` along Z."""
        frame = self.axes(share)
        centre = self.middle - (self.radius * np.cos(self.angle / 2))[:, None] * self.out
        return np.asarray(centre + radius[:, None] * frame[:, 0] + height[:, None] * frame[:, 2])


def _arc(m: Mesh, t: Table, at: Int, nodes: Int, p: dict[str, Any_]) -> Arc:
    """Arcs by GEOM: 1 the centre is on v, 2 v is the tangent at A, 3 the radius is given, 4 the
    angle is.

    In 2 to 4 the arc is on that side of the chord to which v points. Source: MSC Nastran Quick
    Reference Guide, CBEND.
    """
    x = m.xyz[nodes]
    geom = t["GEOM"][at]
    v = orientation(m, t, at, nodes[:, 0])
    d = x[:, 1] - x[:, 0]
    chord = np.linalg.norm(d, axis=1)
    _refuse(m, t, at, bad=(geom < 1) | (geom > 4), why="GEOM must be 1 to 4")
    _refuse(m, t, at, bad=chord == 0, why="its two ends are at one place")
    along = d / chord[:, None]
    forward = np.einsum("ei,ei->e", v, along)
    side = v - forward[:, None] * along
    height = np.linalg.norm(side, axis=1)
    _refuse(
        m,
        t,
        at,
        bad=height <= 1e-8 * np.linalg.norm(v, axis=1),
        why="the vector v is zero or along the chord",
    )
    _refuse(
        m,
        t,
        at,
        bad=(geom == 1) & (np.abs(forward) <= 1e-12 * height),
        why="the centre on v is at infinity",
    )
    # of half the angle where v leads to the centre
    sine = np.abs(forward) / np.hypot(forward, height)
    half = np.where(geom == 1, np.arcsin(sine), np.arctan2(height, forward))
    radius = p["RB"] - p["RC"]
    _refuse(
        m,
        t,
        at,
        bad=(geom == 3) & (np.real(radius) < chord / 2 * (1 - 1e-9)),
        why="RB is less than half the chord",
    )
    ratio = chord / 2 / np.where(geom == 3, radius, chord)
    half = np.where(geom == 3, np.arcsin(np.where(np.real(ratio) > 1, 1.0, ratio)), half)
    half = np.where(geom == 4, p["THETAB"] * (np.pi / 360), half)
    _refuse(
        m,
        t,
        at,
        bad=(np.real(half) <= 0) | (np.real(half) >= np.pi),
        why="the angle of the arc must be in 0 to 360 degrees",
    )
    away = np.where((geom == 1) & (forward > 0), -1.0, 1.0)
    return Arc(
        middle=x.mean(axis=1),
        out=unit(side) * away[:, None],
        along=along,
        radius=chord / 2 / np.sin(half),
        angle=2 * half,
    )


def _refuse(m: Mesh, t: Table, at: Int, bad: Any_, why: str) -> None:
    if bad.any():
        raise card_error(m.model, t, int(at[np.flatnonzero(bad)[0]]), why)


def pipe(middle: Any_, wall: Any_, radius: Any_) -> tuple[Any_, Any_, Any_]:
    """Area, second moment and offset e of the neutral axis of a pipe bent to `radius`; a wall of 0
    is a solid rod.

    e = R − A / ∫ dA/r, exact for a ring (Timoshenko 1956, article 17).
    """
    solid = np.real(wall) == 0
    outer = np.where(solid, middle, middle + wall / 2)
    inner = np.where(solid, 0.0, middle - wall / 2)
    area = np.pi * (outer**2 - inner**2)
    mean = 2 * np.pi * (np.sqrt(radius**2 - inner**2) - np.sqrt(radius**2 - outer**2))
    return area, np.pi / 4 * (outer**4 - inner**4), radius - area / mean


def _section(m: Mesh, p: dict[str, Any_], radius: Any_, t: Table, row: Int) -> dict[str, Any_]:
    """A, I1, I2, J and the offset e of the neutral axis, of either form of PBEND."""
    tube = p["FSI"] > 0
    room = ~tube | (np.real(p["RM"] + p["T"] / 2) < np.real(radius))
    _refuse(m, t, row, bad=~room, why="RM + T/2 must be less than the radius of the arc")
    area, second, e = pipe(
        np.where(tube, p["RM"], 0.1), np.where(tube, p["T"], 0.0), np.where(tube, radius, 1.0)
    )
    out = {"A": np.where(tube, area, p["A"])}
    out |= {n: np.where(tube, c * second, p[n]) for n, c in (("I1", 1), ("I2", 1), ("J", 2))}
    for name in ("A", "I1", "I2", "J"):
        _refuse(m, t, row, bad=np.real(out[name]) <= 0, why=f"{name} must be greater than 0")
    thin = out["I1"] / (out["A"] * radius)
    given = np.where(np.isnan(p["DELTAN"]), thin, p["DELTAN"])
    return out | {"e": np.where(tube, e, given)}


def _compliance(s: dict[str, Any_], E: Any_, G: Any_, shear: tuple[Any_, Any_]) -> Any_:
    """Section's compliance (e, 6, 6) for forces and moments along and about R, θ, Z; K1, K2 of 0
    are rigid.
    """
    terms = [E * s["A"], E * s["I1"], E * s["I2"], G * s["J"]]
    c = np.zeros((len(s["A"]), 6, 6), dtype=np.result_type(*terms, *shear, s["e"]))
    for axis, k in zip((0, 2), shear, strict=True):
        stiff = k * s["A"] * G
        c[:, axis, axis] = np.where(stiff == 0, 0.0, 1 / np.where(stiff == 0, 1.0, stiff))
    c[:, 1, 1], c[:, 5, 5], c[:, 3, 3], c[:, 4, 4] = (1 / x for x in terms)
    c[:, 1, 5] = c[:, 5, 1] = s["e"] / terms[1]
    return c


def flexibility(arc: Arc, radius: Any_, height: Any_, compliance: Any_, to: float = 1.0) -> Any_:
    """Motion at `to` (1 is end B) of the line of centroids against end A by the forces on B, (e, 6,
    6) in basic.
    """
    end, here = (arc.place(share, radius, height) for share in (1.0, to))
    reach = (to + 1) / 2  # of the arc
    F: Any_ = np.zeros((len(end), 6, 6))
    for point, w in zip(_POINTS.tolist(), _WEIGHTS.tolist(), strict=True):
        there = reach * (point + 1) - 1
        R = arc.axes(there)
        place = arc.place(there, radius, height)
        turn = scatter(len(R), 6, ([0, 1, 2], R), ([3, 4, 5], R))
        force, moved = (turn @ arm(x - place).swapaxes(1, 2) for x in (end, here))
        F = F + scaled(
            w / 2 * reach * arc.angle * radius, moved.swapaxes(1, 2) @ compliance @ force
        )
    return F


def _coupled(
    arc: Arc, radius: Any_, height: Any_, compliance: Any_, first: Any_, forces: Any_
) -> Any_:
    """∫ NᵀN ds of the motions N that loads at the ends make: (e, 12, 12).

    `first` (e, 6, 6) is the motion of end A by that of its node, `forces` (e, 6, 12) are those on
    end B.
    """
    start = arc.place(-1.0, radius, height)
    M: Any_ = np.zeros((len(start), 12, 12))
    for to, w in zip(*(v.tolist() for v in _LINE), strict=True):
        N = flexibility(arc, radius, height, compliance=compliance, to=to) @ forces
        N = N + np.concatenate(
            [arm(arc.place(to, radius, height) - start) @ first, np.zeros_like(first)], axis=2
        )
        M = M + scaled(w / 2 * arc.angle * radius, N[:, :3].swapaxes(1, 2) @ N[:, :3])
    return M


def build(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CBEND; half the mass at each end of the line of centroids,
    or coupled.

    Raises
    ------
    DeckError
        If the arc or the section is not determined, or a node, property or material is absent.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("GA", "GB")[at], t, at)
    row = lookup(m.model, "PBEND", t["PID"][at], table=t, at=at)
    table = m.model["PBEND"]
    p = {name: table[name][row] for name in table.columns}
    arc = _arc(m, t, at, nodes=nodes, p=p)
    radius = arc.radius + p["RC"]
    iso = isotropic(m.model, p["MID"], table, row)
    _refuse(
        m,
        table,
        row,
        bad=np.real(iso.G) == 0,
        why="its MAT1 has no G, which a bend needs in torsion",
    )
    s = _section(m, p, radius, t=table, row=row)
    c = _compliance(s, iso.E, iso.G, (p["K1"], p["K2"]))
    ends = [arc.place(share, radius, p["ZC"]) for share in (-1.0, 1.0)]
    arms = [arm(x - m.xyz[nodes[:, k]]) for k, x in enumerate(ends)]
    D = np.concatenate([-arm(ends[1] - ends[0]) @ arms[0], arms[1]], axis=2)
    forces = np.linalg.solve(flexibility(arc, radius, p["ZC"], c), D)
    K = D.swapaxes(1, 2) @ forces
    line = iso.rho * s["A"] + p["NSM"]
    if m.model.param("COUPMASS", -1) > 0:
        M = scaled(line, _coupled(arc, radius, p["ZC"], compliance=c, first=arms[0], forces=forces))
    else:
        half = line * radius * arc.angle / 2
        body = scaled(half, np.broadcast_to(np.diag([1.0, 1, 1, 0, 0, 0]), (at.size, 6, 6)))
        M = scatter(
            at.size,
            12,
            *((list(range(6 * k, 6 * k + 6)), congruent(A, body)) for k, A in enumerate(arms)),
        )
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=(K + K.swapaxes(1, 2)) / 2,
        mass=M,
        loss=iso.loss,
    )
