"""CBAR and CBEAM: the exact Timoshenko beam with taper, offsets, releases and an eccentric neutral
axis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    Isotropic,
    arm,
    components,
    condense,
    congruent,
    isotropic,
    matrix,
    nodal,
    node_dofs,
    orientation,
    rotation,
    scaled,
    scatter,
    segment,
    taken,
    triad,
    unit,
)

# (v, θz) and (w, θy) at both ends
PLANE1 = [1, 5, 7, 11]
PLANE2 = [2, 4, 8, 10]
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])
_SIGN = np.array([1.0, -1.0, 1.0, -1.0])  # the slope of w is -θy
# Points on (-½, ½) of each part between two stations. Sixteen: I 10:1 to nine digits. Four: cubic
# shapes and a linear mass exactly.
_FLEXIBILITY, _MASS = (
    np.stack(np.polynomial.legendre.leggauss(n), axis=1) / 2 for n in (16, 4)
)
OFFSETS = (
    "GGG",
    "BGG",
    "GGO",
    "BGO",
    "GOG",
    "BOG",
    "GOO",
    "BOO",
)  # OFFT: orientation, offset A, offset B


@dataclass(frozen=True, slots=True, eq=False)
class BeamSection:
    """Beam sections at stations, (e, s): area, second moments, torsion constant, masses; linear
    between.

    `x` (e, s): place over the length, from 0 at end A to 1 at end B, ascending. `k1`, `k2` (e,):
    shear factors, 0 for no shear flexibility. `nsm`, `nsm_polar`: non-structural mass a length and
    its inertia about its own centre. `neutral`, `nsm_at` (e, 2, 2): y, z of the neutral axis and of
    the non-structural mass from the shear centre, at each end.
    """

    x: Float
    A: Any_
    I1: Any_
    I2: Any_
    I12: Any_
    J: Any_
    k1: Any_
    k2: Any_
    nsm: Any_
    nsm_polar: Any_
    neutral: Any_
    nsm_at: Any_

    def integrated(self) -> Bool:
        """Which beams (e,) need the flexibility integral: tapered, or I12 together with shear
        flexibility.
        """
        every = np.stack([self.A, self.I1, self.I2, self.I12, self.J], axis=-1)
        taper = (every != every[:, :1]).any(axis=(1, 2))
        coupled = (self.I12 != 0).any(axis=1) & ((self.k1 != 0) | (self.k2 != 0))
        return np.asarray(taper | coupled)


def kernel(L: Float, iso: Isotropic, s: BeamSection) -> Any_:
    """Local stiffness (e, 12, 12), exact for end loads."""
    K = uniform(L, iso, s)
    at = np.flatnonzero(s.integrated())
    if at.size:
        inner = flexible(L[at], iso.E[at], iso.G[at], taken(s, at))
        K = K.astype(np.result_type(K, inner))
        K[at] = inner
    return K


def uniform(L: Float, iso: Isotropic, s: BeamSection) -> Any_:
    """Stiffness with the mean of the stations (Przemieniecki 1968, eq. 5.116; I12 without
    shear).
    """
    A, I1, I2, I12, J = (v.mean(axis=1) for v in (s.A, s.I1, s.I2, s.I12, s.J))
    # constant and linear part of the curvature of (v1, θ1, v2, θ2)
    o = np.zeros_like(L)
    b0 = np.stack([o, -1 / L, o, 1 / L], axis=1)
    b1 = np.stack([6 / L**2, 3 / L, -6 / L**2, 3 / L], axis=1)
    constant, linear = (
        np.einsum("e,ei,ej->eij", c, b, b) for c, b in ((L, b0), (L / 3, b1))
    )
    soft = [1 / (1 + _shear(iso, A, I, k=k, L=L)) for I, k in ((I1, s.k1), (I2, s.k2))]
    EI1 = scaled(iso.E * I1, constant) + scaled(iso.E * I1 * soft[0], linear)
    EI2 = scaled(iso.E * I2, constant) + scaled(iso.E * I2 * soft[1], linear)
    pair = np.broadcast_to(_PAIR, (len(L), 2, 2))
    blocks = [
        ([0, 6], scaled(iso.E * A / L, pair)),
        ([3, 9], scaled(iso.G * J / L, pair)),
        (PLANE1, EI1),
        (PLANE2, EI2 * _SIGN[:, None] * _SIGN),
    ]
    K = scatter(len(L), 12, *blocks)
    if np.any(I12 != 0):
        EI12 = scaled(iso.E * I12, constant + linear) * _SIGN
        K = K.astype(np.result_type(K, EI12))
        K[:, np.array(PLANE1)[:, None], PLANE2] += EI12
        K[:, np.array(PLANE2)[:, None], PLANE1] += EI12.swapaxes(1, 2)
    return K


def _shear(iso: Isotropic, A: Any_, I: Any_, k: Any_, L: Float) -> Any_:
    """Φ = 12 EI/(kGA L²), 0 where the beam is rigid in shear."""
    rigid = (k == 0) | (A == 0) | (iso.G == 0)
    return np.where(
        rigid, 0.0, 12 * iso.E * I / np.where(rigid, 1.0, k * iso.G * A * L**2)
    )


def flexible(L: Float, E: Any_, G: Any_, s: BeamSection) -> Any_:
    """Stiffness (e, 12, 12) of beams whose sections vary linearly from station to station, from the
    flexibility.

    End B moves by F f under its end forces f, F = ∫ bᵀ(x) C(x) b(x) dx with b from equilibrium and
    C the compliance of the section (Przemieniecki 1968, section 5.6; force-based, so exact for end
    loads whatever the taper).
    """
    dtype = np.result_type(float, E, G, s.A, s.I1, s.I2, s.I12, s.J, s.k1, s.k2)
    axial = np.zeros(len(L), dtype=dtype)
    twist = np.zeros(len(L), dtype=dtype)
    F = np.zeros((len(L), 4, 4), dtype=dtype)  # of (Fy, Mz/L, Fz, -My/L)
    none = [
        np.asarray((v == 0).all(axis=1) | (c == 0))
        for v, c in ((s.A, E), (s.J, G), (s.I1, E), (s.I2, E))
    ]
    E = np.where(E == 0, 1.0, E)
    for x, w, value in _along(s.x, _FLEXIBILITY):
        A, I1, I2, I12, J = (value(v) for v in (s.A, s.I1, s.I2, s.I12, s.J))
        axial += w * L / np.where(none[0], 1.0, E * A)
        twist += w * L / np.where(none[1], 1.0, G * J)
        I1 = np.where(none[2], 1.0, I1)
        I2 = np.where(none[3], 1.0, I2)
        C = scaled(w * L**3 / (E * (I1 * I2 - I12**2)), matrix((I2, -I12), (-I12, I1)))
        # bending moment at x by end force and end moment, over L
        b = np.stack([1 - x, np.ones_like(x)], axis=1)
        F += np.einsum("epq,ei,ej->epiqj", C, b, b).reshape(-1, 4, 4)
        for plane, k in enumerate((s.k1, s.k2)):
            rigid = (k == 0) | (A == 0) | (G == 0)
            F[:, 2 * plane, 2 * plane] += np.where(
                rigid, 0.0, w * L / np.where(rigid, 1.0, k * G * A)
            )
    # scaled by the length
    bending = np.linalg.solve(F, np.broadcast_to(np.eye(4), F.shape))
    for plane, absent in enumerate(none[2:]):
        at = slice(2 * plane, 2 * plane + 2)
        bending[absent, at, :] = 0.0
        bending[absent, :, at] = 0.0
    K = np.zeros((len(L), 6, 6), dtype=dtype)
    K[:, 0, 0] = np.where(none[0], 0.0, 1 / axial)
    K[:, 3, 3] = np.where(none[1], 0.0, 1 / twist)
    rows = np.array([1, 5, 2, 4])
    scale = np.stack([L**0, L, L**0, -L], axis=1)
    K[:, rows[:, None], rows] = bending * scale[:, :, None] * scale[:, None, :]
    o = np.zeros_like(L)
    from_a = arm(np.stack([L, o, o], axis=1))
    relative = np.concatenate(
        [-from_a, np.broadcast_to(np.eye(6), from_a.shape)], axis=2
    )
    return congruent(relative, K)


def _along(
    x: Float, rule: Float
) -> Iterator[tuple[Float, Float, Callable[[Any_], Any_]]]:
    """Points of integration over the length: place (e,), weight (e,) and what gives values (e, s)
    there.
    """
    # over the parts between stations, of a length of nothing where a beam has fewer
    for k in range(x.shape[1] - 1):
        part = x[:, k + 1] - x[:, k]
        for p, w in rule.tolist():  # a fixed number of points

            def value(v: Any_, k: int = k, p: float = p) -> Any_:
                return (0.5 - p) * v[:, k] + (0.5 + p) * v[:, k + 1]

            yield x[:, k] + part * (0.5 + p), part * w, value


def consistent(L: Float, per_length: Any_, polar: Any_, x: Float) -> Any_:
    """Coupled local mass (e, 12, 12) of mass a length and polar inertia a length at the stations x,
    (e, s) each.

    Cubic transverse and linear torsional shapes; axial the mean of lumped and consistent, as for a
    rod.
    """
    plane = _moments(L, per_length, x, _hermite)
    linear = _moments(L, per_length, x, _linear)
    axial = (linear + linear.sum(axis=2)[:, :, None] * np.eye(2)) / 2
    blocks = [
        ([0, 6], axial),
        (PLANE1, plane),
        (PLANE2, plane * _SIGN[:, None] * _SIGN),
    ]
    return scatter(len(L), 12, *blocks, ([3, 9], _moments(L, polar, x, _linear)))


def _moments(
    L: Float, v: Any_, x: Float, shapes: Callable[[Float, Float], Float]
) -> Any_:
    """∫ v NᵀN dx of v (e, s) at the stations and of shapes (e, n) at a place."""
    total = []
    for place, w, at in _along(x, _MASS):
        N = shapes(place, L)
        total.append(np.einsum("e,ei,ej->eij", w * L * at(v), N, N))
    return np.asarray(sum(total))


def _linear(x: Float, L: Float) -> Float:
    return np.stack([1 - x, x], axis=1)


def _hermite(x: Float, L: Float) -> Float:
    """The cubic shapes (e, 4) of (v1, θ1, v2, θ2)."""
    return np.stack(
        [
            1 - 3 * x**2 + 2 * x**3,
            L * (x - 2 * x**2 + x**3),
            3 * x**2 - 2 * x**3,
            L * (x**3 - x**2),
        ],
        axis=1,
    )


def lumped(L: Float, per_length: Any_, polar: Any_, x: Float) -> Any_:
    """The mass at the two ends that keeps mass and centre, local (e, 12, 12); values (e, s) at the
    stations x.
    """
    ends = np.zeros((len(L), 2, 6), dtype=np.result_type(per_length, polar))
    ends[..., :3] = _moments(L, per_length, x, _linear).sum(axis=2)[..., None]
    ends[..., 3] = _moments(L, polar, x, _linear).sum(axis=2)
    return ends.reshape(-1, 12)[:, :, None] * np.eye(12)


def release(K: Any_, pins: Bool) -> Any_:
    """Remove the released local DOFs: pins (e, 12)."""
    out = K.copy()
    patterns, which = np.unique(pins, axis=0, return_inverse=True)
    for i, p in enumerate(patterns):  # a handful of patterns in a deck
        if p.any():
            keep = np.flatnonzero(~p)
            drop = np.flatnonzero(p)
            rows = np.flatnonzero(which.reshape(-1) == i)
            part = K[rows]
            # one that carries no stiffness: a torsion release where J = 0
            part[:, drop, drop] += part[:, drop, drop] == 0
            out[rows] = 0.0
            out[rows[:, None, None], keep[:, None], keep] = condense(part, keep, drop)
    return out


def section(t: CardRows) -> tuple[Isotropic, BeamSection]:
    """Material and section of rows of CBAR or CBEAM.

    The shear factors of a PBAR are ignored where I12 is given, as in Nastran.
    """
    beam = t.card == "CBEAM"
    p = t.named("PBEAM" if beam else "PBAR")
    x, entry = _stations(p)
    A, I1, I2, I12, J, nsm = (
        _at_stations(p, name, x, entry) for name in ("A", "I1", "I2", "I12", "J", "NSM")
    )
    k1, k2 = (np.where(np.isnan(p[k]), 0.0, p[k]) for k in ("K1", "K2"))
    polar = np.zeros(x.shape)
    neutral = nsm_at = np.zeros((len(t), 2, 2))
    if beam:
        warping = t.stack("SA", "SB").any(axis=1) & (p.stack("CWA", "CWB") != 0).any(
            axis=1
        )
        why = "has warping points SA, SB and a section that resists warping; leave SA and SB out"
        t.refuse_unsupported(warping, why)
        polar = _between(p["NSIA"], p["NSIB"], x)
        neutral, nsm_at = (
            p.stack(f"{c}1A", f"{c}2A", f"{c}1B", f"{c}2B").reshape(-1, 2, 2)
            for c in "NM"
        )
    else:
        k1, k2 = (np.where(I12[:, 0].real == 0, k, 0.0) for k in (k1, k2))
    return isotropic(p.named("MAT1", "MID")), BeamSection(
        x=x,
        A=A,
        I1=I1,
        I2=I2,
        I12=I12,
        J=J,
        k1=k1,
        k2=k2,
        nsm=nsm + t.listed_mass[:, None],
        nsm_polar=polar,
        neutral=neutral,
        nsm_at=nsm_at,
    )


def _stations(p: CardRows) -> tuple[Float, Int]:
    """Places (e, s) of the stations of PBAR or PBEAM, ends included, and which entry each is, -1
    for an end.

    A beam with fewer stations than others has end B several times.
    """
    end = np.ones((len(p), 1))
    if "X" not in p or not p.ragged("X").values.size:
        return np.hstack([0 * end, end]), np.full((len(p), 2), -1)
    every = p.ragged("X")
    k = np.arange(every.sizes.max())
    entry = np.where(k < every.sizes[:, None], every.offsets[:-1, None] + k, -1)
    x = np.where(entry < 0, 1.0, every.values[entry])
    order = np.argsort(x, axis=1, kind="stable")
    entry = np.take_along_axis(entry, order, axis=1)
    x = np.hstack([0 * end, np.take_along_axis(x, order, axis=1), end])
    return x, np.hstack([-end, entry, -end]).astype(np.int64)


def _at_stations(p: CardRows, name: str, x: Float, entry: Int) -> Any_:
    """A field of PBAR or PBEAM at the stations (e, s); a blank one is on the straight line between
    the ends.
    """
    other_end = f"{name}B" if f"{name}B" in p else name
    line = _between(p[name], p[other_end], x)
    if (entry < 0).all():
        return line
    given = p.ragged(f"{name}X").values[entry]
    return np.where((entry < 0) | np.isnan(given), line, given)


def _between(a: Any_, b: Any_, x: Float) -> Any_:
    return a[:, None] + (b - a)[:, None] * x


def offsets(t: CardRows, nodes: Int) -> Float:
    """Arms (e, 2, 3) in basic from the nodes to the ends: W in the CD frames or, by OFFT, in the
    element's frame.

    Raises
    ------
    UnsupportedCard
        On any other OFFT.
    """
    m = t.mesh
    w = t.stack("W1A", "W2A", "W3A", "W1B", "W2B", "W3B").reshape(-1, 2, 3)
    used = (w != 0).any(axis=2)
    offt = np.char.upper(t["OFFT"].astype(str))
    offt = np.where(offt == "", OFFSETS[0], offt)
    other = used.any(axis=1) & ~np.isin(offt, OFFSETS)
    t.refuse_unsupported(other, f"has OFFT {{}}; allowed are {OFFSETS}", offt)
    frame = m.cd[nodes]
    letters = np.char.ljust(offt, 3).astype("U3").view("U1").reshape(-1, 3)
    own = (letters[:, 1:] == "O") & used
    rows = np.flatnonzero(own.any(axis=1))
    some = t.take(rows)
    axis = unit(m.xyz[nodes[rows, 1]] - m.xyz[nodes[rows, 0]])
    R = triad(some, axis, orientation(some, nodes[rows, 0]))
    frame[rows] = np.where(own[rows][:, :, None, None], R[:, None], frame[rows])
    return np.asarray(np.einsum("eki,ekij->ekj", w, frame))


def _eccentric(at: Any_) -> Any_:
    """Motion at y, z (e, 2, 2) of the ends of the section by that at the shear centres: (e, 12,
    12).
    """
    return nodal(arm(np.pad(at, ((0, 0), (0, 0), (1, 0)))))


def _axial_at(neutral: Any_, L: Float) -> Any_:
    """Only the axial displacement is taken at the neutral axis, and along it; (e, 12, 12)."""
    tilt = (neutral[:, 1] - neutral[:, 0]) / L[:, None]
    moved = _eccentric(neutral)
    out = np.broadcast_to(np.eye(12), moved.shape).astype(moved.dtype)
    for first in (0, 6):
        across = np.einsum("ei,eij->ej", tilt, moved[:, first + 1 : first + 3])
        out[:, first] = moved[:, first] + across
    return out


def _mass(L: Float, iso: Isotropic, s: BeamSection, coupled: bool, beam: bool) -> Any_:
    rho = iso.rho[:, None]
    polar = rho * (s.I1 + s.I2) if beam else np.zeros_like(s.A)
    form = consistent if coupled else lumped
    M = form(L, rho * s.A, polar, s.x)
    if np.any(s.neutral):
        M = congruent(_eccentric(s.neutral), M)
    if np.any(s.nsm) or np.any(s.nsm_polar):
        M = M + congruent(_eccentric(s.nsm_at), form(L, s.nsm, s.nsm_polar, s.x))
    return M


def measure(t: CardRows) -> Float:
    """Lengths (e,) between the offset ends."""
    nodes = t.nodes("GA", "GB")
    return segment(t.mesh.xyz[nodes] + offsets(t, nodes))[0]


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Beams where they stand: node rows (e, 2), lengths (e,), axes (e, 3, 3) as rows, `local` (e,
    12, 12).

    `local` gives the motions of the ends, offsets included, in the axes from those of the nodes in
    basic. `released` (e, 12) are the pin flags.
    """

    nodes: Int
    L: Float
    axes: Float
    local: Float
    released: Bool


def place(t: CardRows) -> Placed:
    """Where rows of CBAR or CBEAM stand.

    Raises
    ------
    DeckError
        If an end or the orientation is absent or an element has no length.
    """
    nodes = t.nodes("GA", "GB")
    arms = offsets(t, nodes)
    x = t.mesh.xyz[nodes] + arms
    t.refuse((x[:, 0] == x[:, 1]).all(axis=1), "its two ends are at one place")
    L, axis = segment(x)
    R = triad(t, axis, orientation(t, nodes[:, 0]))
    local = rotation(R, 2)
    if arms.any():
        local = local @ nodal(arm(arms))
    released = np.concatenate([components(t["PA"]), components(t["PB"])], axis=1)
    return Placed(nodes=nodes, L=L, axes=R, local=local, released=released)


def stiffness(L: Float, iso: Isotropic, s: BeamSection) -> Any_:
    """Local stiffness (e, 12, 12) at the shear centres of the ends, whose neutral axis may be
    elsewhere.
    """
    K = kernel(L, iso, s)
    return congruent(_axial_at(s.neutral, L), K) if np.any(s.neutral) else K


def build(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CBAR or CBEAM.

    Raises
    ------
    DeckError
        If an end, orientation or property is absent or an element has no length.
    """
    p = place(t)
    iso, s = section(t)
    K = release(stiffness(p.L, iso, s), p.released)
    M = _mass(p.L, iso, s, coupled=t.mesh.coupled_mass, beam=t.card == "CBEAM")
    return ElementMatrices(
        dofs=node_dofs(p.nodes),
        stiffness=congruent(p.local, K),
        mass=congruent(p.local, M),
        loss=iso.loss,
    )
