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
    CardRows,
    ElementMatrices,
    arm,
    congruent,
    isotropic,
    nodal,
    node_dofs,
    orientation,
    rotation,
    scaled,
    unit,
)

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
        centre = (
            self.middle - (self.radius * np.cos(self.angle / 2))[:, None] * self.out
        )
        return np.asarray(
            centre + radius[:, None] * frame[:, 0] + height[:, None] * frame[:, 2]
        )


def _arc(t: CardRows, nodes: Int, p: CardRows) -> Arc:
    """Arcs by GEOM: 1 the centre is on v, 2 v is the tangent at A, 3 the radius is given, 4 the
    angle is.

    In 2 to 4 the arc is on that side of the chord to which v points. Source: MSC Nastran Quick
    Reference Guide, CBEND.
    """
    x = t.mesh.xyz[nodes]
    geom = t["GEOM"]
    v = orientation(t, nodes[:, 0])
    d = x[:, 1] - x[:, 0]
    chord = np.linalg.norm(d, axis=1)
    t.refuse((geom < 1) | (geom > 4), "GEOM must be 1 to 4")
    t.refuse(chord == 0, "its two ends are at one place")
    along = d / chord[:, None]
    forward = np.einsum("ei,ei->e", v, along)
    side = v - forward[:, None] * along
    height = np.linalg.norm(side, axis=1)
    flat = height <= 1e-8 * np.linalg.norm(v, axis=1)
    t.refuse(flat, "the vector v is zero or along the chord")
    far = (geom == 1) & (np.abs(forward) <= 1e-12 * height)
    t.refuse(far, "the centre on v is at infinity")
    # of half the angle where v leads to the centre
    sine = np.abs(forward) / np.hypot(forward, height)
    half = np.where(geom == 1, np.arcsin(sine), np.arctan2(height, forward))
    radius = p["RB"] - p["RC"]
    small = (geom == 3) & (np.real(radius) < chord / 2 * (1 - 1e-9))
    t.refuse(small, "RB is less than half the chord")
    ratio = chord / 2 / np.where(geom == 3, radius, chord)
    half = np.where(
        geom == 3, np.arcsin(np.where(np.real(ratio) > 1, 1.0, ratio)), half
    )
    half = np.where(geom == 4, p["THETAB"] * (np.pi / 360), half)
    wide = (np.real(half) <= 0) | (np.real(half) >= np.pi)
    t.refuse(wide, "the angle of the arc must be in 0 to 360 degrees")
    away = np.where((geom == 1) & (forward > 0), -1.0, 1.0)
    return Arc(
        middle=x.mean(axis=1),
        out=unit(side) * away[:, None],
        along=along,
        radius=chord / 2 / np.sin(half),
        angle=2 * half,
    )


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


def _section(p: CardRows, radius: Any_) -> dict[str, Any_]:
    """A, I1, I2, J and the offset e of the neutral axis, of either form of PBEND."""
    tube = p["FSI"] > 0
    tight = tube & (np.real(p["RM"] + p["T"] / 2) >= np.real(radius))
    p.refuse(tight, "RM + T/2 must be less than the radius of the arc")
    area, second, e = pipe(
        np.where(tube, p["RM"], 0.1),
        np.where(tube, p["T"], 0.0),
        np.where(tube, radius, 1.0),
    )
    out = {}
    for name, value in (("A", area), ("I1", second), ("I2", second), ("J", 2 * second)):
        out[name] = np.where(tube, value, p[name])
        p.refuse(np.real(out[name]) <= 0, f"{name} must be greater than 0")
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
        c[:, axis, axis] = np.where(
            stiff == 0, 0.0, 1 / np.where(stiff == 0, 1.0, stiff)
        )
    c[:, 1, 1], c[:, 5, 5], c[:, 3, 3], c[:, 4, 4] = (1 / x for x in terms)
    c[:, 1, 5] = c[:, 5, 1] = s["e"] / terms[1]
    return c


def flexibility(
    arc: Arc, radius: Any_, height: Any_, compliance: Any_, to: float = 1.0
) -> Any_:
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
        turn = rotation(R, 1)
        force, moved = (turn @ arm(x - place).swapaxes(1, 2) for x in (end, here))
        F = F + scaled(
            w / 2 * reach * arc.angle * radius,
            moved.swapaxes(1, 2) @ compliance @ force,
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
            [arm(arc.place(to, radius, height) - start) @ first, np.zeros_like(first)],
            axis=2,
        )
        M = M + scaled(w / 2 * arc.angle * radius, N[:, :3].swapaxes(1, 2) @ N[:, :3])
    return M


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CBEND; half the mass at each end of the line of centroids, or coupled.

    Raises
    ------
    DeckError
        If the arc or the section is not determined, or a node, property or material is absent.
    """
    nodes = t.nodes("GA", "GB")
    x = t.mesh.xyz[nodes]
    p = t.named("PBEND")
    arc = _arc(t, nodes, p)
    radius = arc.radius + p["RC"]
    height = p["ZC"]
    iso = isotropic(p.named("MAT1", "MID"))
    p.refuse(np.real(iso.G) == 0, "its MAT1 has no G, which a bend needs in torsion")
    s = _section(p, radius)
    c = _compliance(s, iso.E, iso.G, (p["K1"], p["K2"]))
    ends = [arc.place(share, radius, height) for share in (-1.0, 1.0)]
    arms = [arm(end - x[:, k]) for k, end in enumerate(ends)]
    D = np.concatenate([-arm(ends[1] - ends[0]) @ arms[0], arms[1]], axis=2)
    forces = np.linalg.solve(flexibility(arc, radius, height, c), D)
    K = D.swapaxes(1, 2) @ forces
    line = iso.rho * s["A"] + p["NSM"]
    if t.mesh.coupled_mass:
        M = scaled(
            line,
            _coupled(arc, radius, height, compliance=c, first=arms[0], forces=forces),
        )
    else:
        half = line * radius * arc.angle / 2
        body = scaled(
            half, np.broadcast_to(np.diag([1.0, 1, 1, 0, 0, 0]), (len(t), 6, 6))
        )
        M = nodal(np.stack([congruent(A, body) for A in arms], axis=1))
    return ElementMatrices(
        dofs=node_dofs(nodes),
        stiffness=(K + K.swapaxes(1, 2)) / 2,
        mass=M,
        loss=iso.loss,
    )
