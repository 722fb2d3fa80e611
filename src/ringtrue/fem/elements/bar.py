"""CBAR and CBEAM: the exact Timoshenko beam with offsets, releases and an eccentric neutral axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.algebra import arm, condense, congruent, nodal, rotation, scaled, scatter
from ringtrue.fem.mesh import Isotropic, Matrices, Mesh, error, isotropic, lookup
from ringtrue.fem.place import components, node_dofs, orientation, segment, triad

PLANE1, PLANE2 = [1, 5, 7, 11], [2, 4, 8, 10]  # (v, θz) and (w, θy) at both ends
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])
_SIGN = np.array([1.0, -1.0, 1.0, -1.0])  # the slope of w is -θy


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Beam sections (e,): area, second moments, torsion constant, shear factors (0: no shear flexibility).

    `neutral`, `nsm_at` (e, 2): y, z of the neutral axis and of the non-structural mass from the shear centre.
    """

    A: Any_
    I1: Any_
    I2: Any_
    I12: Any_
    J: Any_
    k1: Any_
    k2: Any_
    nsm: Any_
    neutral: Float
    nsm_at: Float


def _curvature(L: Float) -> tuple[Float, Float]:
    """Constant and linear part of the curvature of (v1, θ1, v2, θ2), (e, 4) each."""
    o = np.zeros_like(L)
    b0 = np.stack([o, -1 / L, o, 1 / L], axis=1)
    b1 = np.stack([6 / L**2, 3 / L, -6 / L**2, 3 / L], axis=1)
    return b0, b1


def kernel(L: Float, iso: Isotropic, s: Section) -> Any_:
    """Local stiffness (e, 12, 12), exact for end loads (Przemieniecki 1968, eq. 5.116; I12 without shear)."""
    b0, b1 = _curvature(L)
    uniform, linear = (np.einsum("e,ei,ej->eij", c, b, b) for c, b in ((L, b0), (L / 3, b1)))
    soft = [1 / (1 + _shear(iso, s.A, I, k, L)) for I, k in ((s.I1, s.k1), (s.I2, s.k2))]
    EI1 = scaled(iso.E * s.I1, uniform) + scaled(iso.E * s.I1 * soft[0], linear)
    EI2 = scaled(iso.E * s.I2, uniform) + scaled(iso.E * s.I2 * soft[1], linear)
    pair = np.broadcast_to(_PAIR, (len(L), 2, 2))
    blocks = [
        ([0, 6], scaled(iso.E * s.A / L, pair)),
        ([3, 9], scaled(iso.G * s.J / L, pair)),
        (PLANE1, EI1),
        (PLANE2, EI2 * _SIGN[:, None] * _SIGN),
    ]
    K = scatter(len(L), 12, *blocks)
    if np.any(s.I12 != 0):
        EI12 = (scaled(iso.E * s.I12, uniform) + scaled(iso.E * s.I12 * soft[0] * soft[1], linear)) * _SIGN
        K = K.astype(np.result_type(K, EI12))
        K[:, np.array(PLANE1)[:, None], PLANE2] += EI12
        K[:, np.array(PLANE2)[:, None], PLANE1] += EI12.swapaxes(1, 2)
    return K


def _shear(iso: Isotropic, A: Any_, I: Any_, k: Any_, L: Float) -> Any_:
    """Φ = 12 EI/(kGA L²), 0 where the beam is rigid in shear."""
    rigid = (k == 0) | (A == 0) | (iso.G == 0)
    return np.where(rigid, 0.0, 12 * iso.E * I / np.where(rigid, 1.0, k * iso.G * A * L**2))


def consistent(L: Float, per_length: Any_, polar: Any_) -> Any_:
    """Coupled local mass (e, 12, 12); axial as for a rod; `polar` = ρ(I1 + I2) turns about the axis."""
    e = len(L)
    m = per_length * L
    axial = np.broadcast_to(np.array([[5.0, 1.0], [1.0, 5.0]]) / 12, (e, 2, 2))
    o = np.ones_like(L)
    rows = [
        [156 * o, 22 * L, 54 * o, -13 * L],
        [22 * L, 4 * L**2, 13 * L, -3 * L**2],
        [54 * o, 13 * L, 156 * o, -22 * L],
        [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
    ]
    plane = np.stack([np.stack(r, axis=1) for r in rows], axis=1) / 420
    twist = np.broadcast_to(np.array([[2.0, 1.0], [1.0, 2.0]]) / 6, (e, 2, 2))
    blocks = [([0, 6], scaled(m, axial)), (PLANE1, scaled(m, plane))]
    blocks += [(PLANE2, scaled(m, plane * _SIGN[:, None] * _SIGN)), ([3, 9], scaled(polar * L, twist))]
    return scatter(e, 12, *blocks)


def lumped(L: Float, per_length: Any_, polar: Any_) -> Any_:
    """Half the mass at each end, local (e, 12, 12)."""
    ends = np.zeros((len(L), 2, 6), dtype=np.result_type(per_length, polar))
    ends[..., :3] = (per_length * L / 2)[:, None, None]
    ends[..., 3] = (polar * L / 2)[:, None]
    return ends.reshape(-1, 12)[:, :, None] * np.eye(12)


def release(K: Any_, pins: Any_) -> Any_:
    """Remove the released local DOFs: pins (e, 12) bool."""
    if not pins.any():
        return K
    out = K.copy()
    patterns, which = np.unique(pins, axis=0, return_inverse=True)
    for i, p in enumerate(patterns):  # a handful of patterns in a deck
        if p.any():
            keep, drop, rows = np.flatnonzero(~p), np.flatnonzero(p), np.flatnonzero(which.reshape(-1) == i)
            out[rows] = 0.0
            out[rows[:, None, None], keep[:, None], keep] = condense(_stiff(K[rows], drop), keep, drop)
    return out


def _stiff(K: Any_, drop: Int) -> Any_:
    """K with a unit on the diagonal of released DOFs that carry no stiffness (a torsion release where J = 0)."""
    out = K.copy()
    out[:, drop, drop] += np.where(out[:, drop, drop] == 0, 1.0, 0.0)
    return out


def _section(m: Mesh, card: str, at: Int) -> tuple[Isotropic, Section]:
    t = m.model[card]
    beam = "PBEAM" in m.model and card == "CBEAM"
    name = "PBEAM" if beam else "PBAR"
    row = lookup(m.model, name if card == "CBAR" else "PBEAM", t["PID"][at], t, at)
    p = m.model[name]
    iso = isotropic(m.model, p["MID"][row], p, row)
    k1, k2 = (np.where(np.isnan(p[k][row]), 0.0, p[k][row]) for k in ("K1", "K2"))
    o = np.zeros(at.size)
    if not beam:
        A, I1, I2, I12, J, nsm = (p[c][row] for c in ("A", "I1", "I2", "I12", "J", "NSM"))
        none = np.stack([o, o], axis=1)
        return iso, Section(A, I1, I2, I12, J, k1, k2, nsm, none, none)
    pairs = [("A", "AB"), ("I1", "I1B"), ("I2", "I2B"), ("I12", "I12B"), ("J", "JB"), ("NSM", "NSMB")]
    A, I1, I2, I12, J, nsm = ((p[a][row] + p[b][row]) / 2 for a, b in pairs)
    neutral = (p.stack("N1A", "N2A")[row] + p.stack("N1B", "N2B")[row]) / 2
    nsm_at = (p.stack("M1A", "M2A")[row] + p.stack("M1B", "M2B")[row]) / 2
    return iso, Section(A, I1, I2, I12, J, k1, k2, nsm, neutral, nsm_at)


def _offsets(m: Mesh, card: str, at: Int, nodes: Int) -> Float:
    """Arms (e, 2, 3) in basic from the nodes to the ends.

    Raises
    ------
    UnsupportedCard
        On OFFT with offsets in the element frame.
    """
    t = m.model[card]
    w = t.stack("W1A", "W2A", "W3A", "W1B", "W2B", "W3B")[at].reshape(-1, 2, 3)
    frame = np.char.ljust(t["OFFT"][at].astype(str), 3)
    used = (w != 0).any(axis=(1, 2))
    other = used & ~np.isin(frame, ["GGG", "BGG", "   "])
    if other.any():
        raise UnsupportedCard(card, why=f"{t.ids[at[other][0]]} has OFFT {frame[other][0]}; allowed are GGG, BGG")
    return np.asarray(np.einsum("eki,ekij->ekj", w, m.cd[nodes]))


def _eccentric(y: Float, z: Float) -> Float:
    """Translations (6) at (y, z) of the section by those at the shear centre: (e, 6, 6)."""
    return arm(np.stack([np.zeros_like(y), y, z], axis=1))


def _axial_at(neutral: Float) -> Float:
    """Only the axial displacement is taken at the neutral axis; (e, 12, 12)."""
    full = _eccentric(neutral[:, 0], neutral[:, 1])
    full[:, 1:, :] = np.eye(6)[1:]
    return nodal(np.stack([full, full], axis=1))


def _mass(L: Float, iso: Isotropic, s: Section, coupled: bool, beam: bool) -> Any_:
    polar = iso.rho * (s.I1 + s.I2) if beam else np.zeros_like(L)
    form = consistent if coupled else lumped
    M = form(L, iso.rho * s.A, polar)
    own, extra = (nodal(np.stack([_eccentric(*p.T)] * 2, axis=1)) for p in (s.neutral, s.nsm_at))
    return congruent(own, M) + congruent(extra, form(L, s.nsm, np.zeros_like(L)))


def build(m: Mesh, card: str, at: Int) -> Matrices:
    """Matrices of the rows `at` (e,) of CBAR or CBEAM.

    Raises
    ------
    DeckError
        If an end, orientation or property is absent or an element has no length.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack("GA", "GB")[at], t, at)
    iso, s = _section(m, card, at)
    arms = _offsets(m, card, at, nodes)
    x = m.xyz[nodes] + arms
    short = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == 0
    if short.any():
        raise error(m.model, t, int(at[short][0]), "its two ends are at one place")
    L, axis = segment(x)
    R = triad(m, axis, orientation(m, t, at, nodes[:, 0]), t, at)
    to_local = rotation(R, 2)
    to_ends = nodal(arm(arms))
    pins = np.concatenate([components(t["PA"][at]), components(t["PB"][at])], axis=1)
    K = release(congruent(_axial_at(s.neutral), kernel(L, iso, s)), pins)
    M = _mass(L, iso, s, m.model.param("COUPMASS", -1) > 0, card == "CBEAM")
    local = to_local @ to_ends
    return Matrices(node_dofs(nodes), congruent(local, K), congruent(local, M), iso.loss, np.empty((0, 12, 12)))
