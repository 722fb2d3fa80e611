"""CWELD: a short round beam between two patches or surfaces of shells, a patch and a node, or two
nodes.

The end on a patch follows its corners: u = Σ N u_I, and the rotation is that of the surface, θ = Σ
(∇N × n)(n·u_I) + n (n·(∇N × u_I))/2 (MSC Nastran Linear Static Analysis User's Guide, connector
elements: Kirchhoff shell, only the translations of the patch). About its middle a uniform beam is
six springs: EA/Le, GJ/Le, EI/Le, and across 1/(Le/kGA + L² Le/12EI), which holds for a length of 0,
too. Le is the length, not less than LDMIN and not more than LDMAX diameters (PWELD); for TYPE SPOT
between two sheets it is half the sum of their thicknesses.

CFAST: six springs between two surfaces of shells, each end on a square as large as the
fastener.

Ends of welds and fasteners: at a node, on the patch of one shell, or on a square over several
shells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.mesh import (
    ElementMatrices,
    Mesh,
    any_triad,
    arm,
    congruent,
    frame,
    isotropic,
    lookup,
    node_dofs,
    rotation,
    skew,
    unit,
)
from ringtrue.model.cards import QUADRILATERAL, TRIANGLE
from ringtrue.model.model import Table, card_error, refuse_rows

SHELLS = {"CQUAD4": 4, "CQUADR": 4, "CTRIA3": 3, "CTRIAR": 3}
_STEPS = 12  # Newton steps to the foot of a point on a patch; two suffice on a flat one
# by which a foot may lie outside of its patch, in natural coordinates (SWLDPRM, PROJTOL)
_SLACK = 0.02
_FAR = 5.0  # natural coordinates beyond which a foot is not followed
_NEAREST = 16  # shells that are tried, by the distance of their centres


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """One end of the welds.

    Attributes
    ----------
    nodes : (e, k) int64
        Rows of GRID, -1 for none.
    place, normal : (e, 3) float64
    follow : (e, 6, 6k) float64
        Motion of the end by that of the nodes, in basic.
    """

    nodes: Int
    place: Float
    normal: Float
    follow: Float


def _shapes(r: Float, s: Float, triangle: Bool) -> tuple[Float, Float]:
    """Shape functions (e, 4) and their derivatives (e, 2, 4) of quadrilaterals (-1 to 1) and
    triangles (0 to 1).
    """
    places = np.stack([r, s], axis=1)
    N, dN = QUADRILATERAL.functions(1, places)
    N[triangle, 3] = 0.0
    dN[triangle, 3] = 0.0
    N[triangle, :3], dN[triangle, :3] = TRIANGLE.functions(1, places[triangle])
    return N, dN.swapaxes(1, 2)


def _foot(x: Float, point: Float, triangle: Bool) -> tuple[Float, Float, Float, Float]:
    """Natural coordinates (e,) of the feet of points (e, 3) on patches (e, 4, 3), with shapes and
    derivatives there.
    """
    r = np.where(triangle, 1 / 3, 0.0)
    s = r.copy()
    for _ in range(_STEPS):
        N, dN = _shapes(r, s, triangle)
        tangent = dN @ x
        off = point - np.einsum("ei,eij->ej", N, x)
        metric = tangent @ tangent.swapaxes(1, 2)
        # a collapsed shell near by
        metric += 1e-14 * np.trace(metric, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        step = np.linalg.solve(metric, np.einsum("ekj,ej->ek", tangent, off)[..., None])[..., 0]
        r, s = (np.clip(x_ + step[:, i], -_FAR, _FAR) for i, x_ in enumerate((r, s)))
    return r, s, *_shapes(r, s, triangle)


def _margin(r: Float, s: Float, triangle: Bool) -> Float:
    """How far inside of its patch a place is, (e,), in natural coordinates; negative outside."""
    return np.where(
        triangle, np.minimum(np.minimum(r, s), 1 - r - s), 1 - np.maximum(np.abs(r), np.abs(s))
    )


def on_patch(m: Mesh, card: str, at: Int, nodes: Int, point: Float) -> End:
    """Ends on patches of corner nodes (e, 4), the fourth -1 for triangles, at the feet of points
    (e, 3).
    """
    t = m.model[card]
    triangle = nodes[:, 3] < 0
    x = m.xyz[nodes]
    x[triangle, 3] = 0.0
    area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    flat = (area == 0).all(axis=1)
    refuse_rows(m.model, t, at[flat], "the corners of a patch lie on one line")
    r, s, N, dN = _foot(x, point, triangle)
    outside = _margin(r, s, triangle) < -_SLACK
    refuse_rows(m.model, t, at[outside], "the foot of its point lies outside of a patch")
    tangent = dN @ x
    n = unit(np.cross(tangent[:, 0], tangent[:, 1]))
    g = np.linalg.solve(tangent @ tangent.swapaxes(1, 2), dN).swapaxes(1, 2) @ tangent
    turn = np.einsum("eni,ej->enij", np.cross(g, n[:, None]), n)
    turn += 0.5 * np.einsum("ei,ek,enkj->enij", n, n, skew(g))
    follow = np.zeros((at.size, 6, 4, 6))
    follow[:, :3, :, :3] = np.einsum("en,ij->einj", N, np.eye(3))
    follow[:, 3:, :, :3] = turn.swapaxes(1, 2)
    return End(nodes, np.einsum("ei,eij->ej", N, x), n, follow.reshape(-1, 6, 24))


def on_node(m: Mesh, node: Int) -> End:
    """Ends that are nodes (e,)."""
    nodes = np.full((node.size, 4), -1)
    nodes[:, 0] = node
    follow = np.zeros((node.size, 6, 24))
    follow[:, :, :6] = np.eye(6)
    return End(nodes, m.xyz[node], np.tile([0.0, 0.0, 1.0], (node.size, 1)), follow)


def merged(size: int, parts: list[tuple[Int, End]]) -> End:
    """Ends (size,) from those of some rows each."""
    k = max(part.nodes.shape[1] for _, part in parts)
    out = End(
        np.full((size, k), -1), np.zeros((size, 3)), np.zeros((size, 3)), np.zeros((size, 6, 6 * k))
    )
    for rows, part in parts:
        own = part.nodes.shape[1]
        out.nodes[rows, :own] = part.nodes
        out.follow[rows, :, : 6 * own] = part.follow
        out.place[rows] = part.place
        out.normal[rows] = part.normal
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """All shells of the model: ids, properties (s,), and corner nodes (s, 4), -1 for none."""

    ids: Int
    pid: Int
    corners: Int

    @classmethod
    def of(cls, m: Mesh) -> Skin:
        none: Int = np.zeros(0, dtype=np.int64)
        ids = [none]
        pids = [none]
        corners = [none.reshape(0, 4)]
        for card, count in SHELLS.items():
            if card in m.model:
                t = m.model[card]
                rows = np.full((len(t), 4), -1)
                rows[:, :count] = m.nodes(
                    t.stack(*(f"G{i}" for i in range(1, count + 1))), t, np.arange(len(t))
                )
                ids.append(t.ids)
                pids.append(t["PID"])
                corners.append(rows)
        return cls(np.concatenate(ids), np.concatenate(pids), np.concatenate(corners))

    def of_property(self, m: Mesh, pid: Int, point: Float) -> Int:
        """The shells (e, k) of the property `pid` (e,) with the centres nearest to a point (e, 3),
        -1 for none.
        """
        out = np.full((pid.size, _NEAREST), -1)
        for one in np.unique(pid).tolist():
            mine = np.flatnonzero(self.pid == one)
            rows = np.flatnonzero(pid == one)
            if mine.size:
                there = (self.corners[mine] >= 0)[:, :, None]
                centre = np.where(there, m.xyz[self.corners[mine]], 0.0).sum(axis=1) / there.sum(
                    axis=1
                )
                k = min(_NEAREST, mine.size)
                out[rows, :k] = mine[cKDTree(centre).query(point[rows], k)[1].reshape(-1, k)]
        return out

    def around(self, shell: Int) -> Int:
        """Each shell (e,) first and behind it those that share a node with it (e, k), -1 for
        none.
        """
        there = self.corners >= 0
        row = np.nonzero(there)[0]
        node = self.corners[there]
        on = sp.csr_array((np.ones(row.size), (row, node)), shape=(self.ids.size, node.max() + 1))
        touching = sp.coo_array(on[shell] @ on.T)
        i, j = touching.coords
        i, j = i[j != shell[i]], j[j != shell[i]]
        order = np.lexsort((j, i))
        i = i[order]
        j = j[order]
        slot = np.arange(i.size) - np.searchsorted(i, i)
        out = np.full((shell.size, 2 + slot.max(initial=-1)), -1)
        out[:, 0] = shell
        out[i, slot + 1] = j
        return out

    def foot(self, m: Mesh, found: Int, point: Float, own: Bool) -> Int:
        """The one of the shells `found` (e, k) on which the foot of a point (e, 3) is nearest, -1
        for none.

        The first of them comes before the others where `own` (e,).
        """
        k = found.shape[1]
        corners = self.corners[found].reshape(-1, 4)
        triangle = corners[:, 3] < 0
        x = m.xyz[corners]
        x[triangle, 3] = 0.0
        every = np.repeat(point, k, axis=0)
        r, s, N, _ = _foot(x, every, triangle)
        away = np.linalg.norm(np.einsum("ei,eij->ej", N, x) - every, axis=1)
        on = (_margin(r, s, triangle) >= -_SLACK) & (found.ravel() >= 0)
        away = np.where(on, away, np.inf).reshape(-1, k)
        away[own & np.isfinite(away[:, 0]), 0] = -1.0
        best = away.argmin(axis=1)
        row = np.arange(len(point))
        return np.asarray(np.where(np.isfinite(away[row, best]), found[row, best], -1))


def _place(m: Mesh, t: Table, at: Int, side: str) -> Float:
    """The point (e, 3) whose foot is end A or B: GA or GB, else GS, else XS, YS, ZS."""
    own = t[f"G{side}"][at]
    own = np.where(own > 0, own, t["GS"][at])
    out = t.stack("XS", "YS", "ZS")[at]
    if (bare := (own == 0) & np.isnan(out).any(axis=1)).any():
        raise card_error(
            m.model, t, int(at[bare][0]), f"GS, G{side} or XS, YS and ZS must say where it is"
        )
    used = own > 0
    out[used] = m.xyz[m.nodes(own[used], t, at[used])]
    return out


def _row(m: Mesh, t: Table, at: Int, skin: Skin, ids: Int) -> Int:
    """Rows (e,) of `skin` of the shells `ids` (e,)."""
    order = np.argsort(skin.ids, kind="stable")
    found = np.searchsorted(skin.ids[order], ids).clip(max=max(skin.ids.size - 1, 0))
    row = order[found] if skin.ids.size else np.full(ids.shape, -1)
    if (
        lost := (row < 0) | (skin.ids[row] != ids)
        if skin.ids.size
        else np.ones(ids.shape, dtype=bool)
    ).any():
        raise card_error(
            m.model, t, int(at[lost][0]), f"{ids[lost][0]} is no shell with three or four corners"
        )
    return np.asarray(row)


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The shells on which the ends (e,) may stand: of a property, or of a shell and its neighbours
    where `shell` >= 0.

    Two sheets of one property are distinguished by their shells (MSC Nastran: up to 3 x 3 shells
    around SHIDA).
    """

    skin: Skin
    pid: Int
    shell: Int

    def foot(self, m: Mesh, point: Float) -> Int:
        """The shell (e,) on which the foot of a point (e, 3) is, -1 for none."""
        out = np.full(self.pid.size, -1)
        named = self.shell >= 0
        if named.any():
            found = self.skin.around(self.shell[named])
            out[named] = self.skin.foot(m, found, point[named], np.ones(len(found), dtype=bool))
        if not named.all():
            found = self.skin.of_property(m, self.pid[~named], point[~named])
            out[~named] = self.skin.foot(m, found, point[~named], np.zeros(len(found), dtype=bool))
        return out

    def about(self, shell: Int, count: int) -> _Surface:
        """That of points around the places of the ends on `shell` (e,), `count` for each."""
        near = np.where(self.shell >= 0, shell, -1)
        return _Surface(self.skin, np.repeat(self.pid, count), np.repeat(near, count))

    def name(self, i: int) -> str:
        """What the surface of an end is, for messages."""
        if self.shell[i] >= 0:
            return f"shell {self.skin.ids[self.shell[i]]} and those around it"
        return f"the shells of property {self.pid[i]}"


def _on_square(m: Mesh, t: Table, at: Int, on: _Surface, point: Float, diameter: Float) -> End:
    """Ends on a surface: the mean motion of the corners of a square as large as the circle (e,).

    The corners follow the shells that they stand on; the end follows them as an RBE3 of equal
    weights does (MSC Nastran Quick Reference Guide, CWELD PARTPAT and CFAST).
    """
    shell = on.foot(m, point)
    if (bad := np.flatnonzero(shell < 0)).size:
        raise card_error(
            m.model, t, int(at[bad[0]]), f"its point has no foot on {on.name(int(bad[0]))}"
        )
    centre = on_patch(m, t.card, at, nodes=on.skin.corners[shell], point=point)
    axes = any_triad(centre.normal)[:, 1:]
    side = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corner = centre.place[:, None] + (np.sqrt(np.pi) / 4 * diameter)[:, None, None] * (side @ axes)
    flat = corner.reshape(-1, 3)
    under = on.about(shell, 4).foot(m, flat)
    if (bad := np.flatnonzero(under < 0)).size:
        why = f"D is too large: its square leaves {on.name(int(bad[0]) // 4)}"
        raise card_error(m.model, t, int(at[bad[0] // 4]), why)
    feet = on_patch(m, t.card, np.repeat(at, 4), nodes=on.skin.corners[under], point=flat)
    S = np.zeros((at.size, 4, 3, 6))
    S[..., :3] = np.eye(3)
    S[..., 3:] = -skew(feet.place.reshape(-1, 4, 3) - centre.place[:, None])
    flatter = S.reshape(-1, 12, 6)
    size = np.concatenate([np.ones((at.size, 3)), np.repeat(diameter[:, None], 3, axis=1)], axis=1)
    scaled = flatter / size[:, None]  # turns in units of a diameter
    mean = np.linalg.solve(scaled.swapaxes(1, 2) @ scaled, scaled.swapaxes(1, 2)) / size[:, :, None]
    shift = feet.follow[:, :3].reshape(-1, 4, 3, 24)
    follow = np.einsum("eijk,ejkl->eijl", mean.reshape(-1, 6, 4, 3), shift).reshape(-1, 6, 96)
    return End(feet.nodes.reshape(-1, 16), centre.place, centre.normal, follow)


def on_squares(
    m: Mesh,
    t: Table,
    at: Int,
    diameter: Float,
    by_shell: Bool,
    fields: Sequence[tuple[str, str]],
) -> tuple[End, End]:
    """Ends A and B on the shells of the property that the card names, or on the shell that it names
    (`by_shell`), in the two `fields` of each end.
    """
    skin = Skin.of(m)
    made = []
    for side, (own, shell) in zip("AB", fields, strict=True):
        row = np.full(at.size, -1)
        row[by_shell] = _row(m, t, at[by_shell], skin=skin, ids=t[shell][at[by_shell]])
        on = _Surface(skin, t[own][at], row)
        made.append(_on_square(m, t, at, on=on, point=_place(m, t, at, side), diameter=diameter))
    return made[0], made[1]


WIDE = ("PARTPAT", "ELPAT")
SHEAR = 0.9  # shear area of a round section over its area


def patches(m: Mesh, card: str, at: Int, side: str) -> tuple[Int, Bool]:
    """Corner nodes (e, 4) of patch A or B by GRIDID or ELEMID, -1 for none, and which rows have
    such a patch.
    """
    t = m.model[card]
    ids = t.stack(*(f"G{side}{i}" for i in range(1, 5)))[at]
    shell = t[f"SHID{side}"][at]
    left = shell > 0
    for name, count in SHELLS.items():
        if name in m.model:
            row = m.model[name].find(shell)
            hit = left & (row >= 0)
            ids[hit, :count] = m.model[name].stack(*(f"G{i}" for i in range(1, count + 1)))[
                row[hit]
            ]
            left = left & ~hit
    if left.any():
        why = f"SHID{side} {shell[left][0]} is none of {', '.join(SHELLS)}"
        raise card_error(m.model, t, int(at[left][0]), why)
    there = ids[:, 0] > 0
    out = np.full(ids.shape, -1)
    used = ids > 0
    out[used] = m.nodes(ids[used], t, np.broadcast_to(at[:, None], ids.shape)[used])
    return out, there


def _wide(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Ends on surfaces of several shells, of a property (PARTPAT) or that of a shell (ELPAT)."""
    t = m.model[card]
    D = m.model["PWELD"]["D"][lookup(m.model, "PWELD", t["PID"][at], table=t, at=at)].real
    return on_squares(
        m,
        t,
        at,
        diameter=D,
        by_shell=t["TYPE"][at] == "ELPAT",
        fields=(("PIDA", "SHIDA"), ("PIDB", "SHIDB")),
    )


def weld_ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,): on a patch below GS (or GA, GB), else at GS; by ALIGN at GA
    and GB.

    PARTPAT and ELPAT take squares over several shells.
    """
    t = m.model[card]
    wide = np.isin(t["TYPE"][at], WIDE)
    if wide.any():
        both = [(np.flatnonzero(wide), _wide(m, card, at[wide]))]
        both += [(np.flatnonzero(~wide), weld_ends(m, card, at[~wide]))] if not wide.all() else []
        return merged(at.size, [(r, pair[0]) for r, pair in both]), merged(
            at.size, [(r, pair[1]) for r, pair in both]
        )
    align = t["TYPE"][at] == "ALIGN"
    made = []
    for side in "AB":
        corners, there = patches(m, card, at, side)
        given = t[f"G{side}"][at]
        own = np.where(align, given, t["GS"][at])
        if (bare := ~there & (own == 0)).any():
            raise card_error(
                m.model, t, int(at[bare][0]), f"end {side} has neither a patch nor a node"
            )
        point = np.where(there & (given > 0), given, own)
        if (bare := point == 0).any():
            raise card_error(
                m.model, t, int(at[bare][0]), f"no GS or G{side} says where it pierces patch {side}"
            )
        node = m.nodes(point, t, at)
        p = np.flatnonzero(there)
        q = np.flatnonzero(~there)
        parts = (
            [(p, on_patch(m, card, at[p], nodes=corners[p], point=m.xyz[node[p]]))]
            if p.size
            else []
        )
        made.append(merged(at.size, [*parts, *([(q, on_node(m, node[q]))] if q.size else [])]))
    return made[0], made[1]


def lengths(L: Float, D: Any_, least: Float, most: Float) -> Any_:
    """Effective lengths (e,): L, not less and not more than so many diameters."""
    low = least * D
    high = most * D
    return np.where(np.real(low) > L, low, np.where(np.real(high) < L, high, L))


def _sheets(m: Mesh, t: Table, at: Int) -> Any_:
    """Half the thickness of both sheets (e,) of the rows `at` (e,): the effective length of a spot
    weld.
    """
    skin = Skin.of(m)
    order = np.argsort(skin.ids, kind="stable")
    total: Any_ = np.zeros(at.size)
    for side in "AB":
        shell = t[f"SHID{side}"][at]
        named = order[np.searchsorted(skin.ids[order], shell).clip(max=skin.ids.size - 1)]
        pid = np.where(shell > 0, skin.pid[named], t[f"PID{side}"][at])
        row = m.model["PSHELL"].find(pid) if "PSHELL" in m.model else np.full(pid.shape, -1)
        if (bad := row < 0).any():
            why = (
                f"its sheet {side} is no PSHELL, whose thickness is the length of a weld of "
                "TYPE SPOT"
            )
            raise card_error(m.model, t, int(at[bad][0]), why)
        total = total + m.model["PSHELL"]["T"][row] / 2
    return total


def springs(L: Float, length: Any_, D: Any_, E: Any_, G: Any_) -> Any_:
    """Stiffness (e, 6) about the middle: along, across twice, of torsion, of bending twice."""
    area = np.pi / 4 * D**2
    second = np.pi / 64 * D**4
    across = 1 / (length / (SHEAR * G * area) + L**2 * length / (12 * E * second))
    bending = E * second / length
    return np.stack(
        [E * area / length, across, across, 2 * G * second / length, bending, bending], axis=1
    )


def between(a: End, b: End) -> tuple[Float, Float]:
    """Length (e,) and axis (e, 3) from A to B; the normal of A where they are at one place."""
    d = b.place - a.place
    L = np.linalg.norm(d, axis=1)
    return L, np.where((L > 0)[:, None], d / np.where(L > 0, L, 1.0)[:, None], a.normal)


def joined(a: End, b: End, axes: Float, springs: Any_, half: Any_, loss: Any_) -> ElementMatrices:
    """Matrices by springs (e, 6) half way between the ends, along and about `axes` (e, 3, 3); half
    the mass at each.
    """
    middle = (a.place + b.place) / 2
    local = rotation(axes, 1)
    move = [local @ arm(middle - end.place) @ end.follow for end in (a, b)]
    K = congruent(np.concatenate([-move[0], move[1]], axis=2), springs[:, :, None] * np.eye(6))
    d = K.shape[1]
    M = np.zeros((len(K), d, d), dtype=half.dtype)
    first = 0
    for end in (a, b):
        shift = end.follow[:, :3]
        size = end.follow.shape[2]
        M[:, first : first + size, first : first + size] = half[:, None, None] * (
            shift.swapaxes(1, 2) @ shift
        )
        first += size
    nodes = np.concatenate([a.nodes, b.nodes], axis=1)
    dofs = np.where(np.repeat(nodes, 6, axis=1) >= 0, node_dofs(nodes), -1)
    return ElementMatrices(dofs=dofs, stiffness=K, mass=M, loss=loss)


def build_weld(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CWELD; half the mass at each end.

    Raises
    ------
    DeckError
        If an end is not determined, a foot lies outside of its patch, or a node, property or
        material is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PWELD", t["PID"][at], table=t, at=at)
    p = m.model["PWELD"]
    iso = isotropic(m.model, p["MID"][row], p, row)
    D = p["D"][row]
    bad = (np.real(D) <= 0) | (np.real(iso.G) == 0)
    refuse_rows(m.model, p, row[bad], "D must be greater than 0, and its MAT1 have a shear modulus")
    a, b = weld_ends(m, card, at)
    L, axis = between(a, b)
    length = lengths(L, D, p["LDMIN"][row], p["LDMAX"][row])
    both = (t.stack("SHIDA", "SHIDB")[at] > 0).all(axis=1) | (t["TYPE"][at] == "PARTPAT")
    if (spot := both & (p["TYPE"][row] == "SPOT")).any():
        sheets = _sheets(m, t, at[spot])
        length = length.astype(np.result_type(length, sheets))
        length[spot] = sheets
    k = springs(L, length, D, E=iso.E, G=iso.G)
    return joined(
        a, b, any_triad(axis), springs=k, half=iso.rho * np.pi / 8 * D**2 * L, loss=iso.loss
    )


_STIFFNESS = ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3")


def _axes(axis: Float) -> Float:
    """Frames (e, 3, 3) of MCID -1: x along the axis, y in the plane of it and the axis of basic
    most across it.

    Of two that are equally across the first is taken (MSC Nastran Quick Reference Guide, PFAST).
    """
    b = np.eye(3)[np.round(np.abs(axis), 6).argmin(axis=1)]
    y = unit(b - np.einsum("ei,ei->e", b, axis)[:, None] * axis)
    return np.stack([axis, y, np.cross(axis, y)], axis=1)


def fastener_ends(m: Mesh, card: str, at: Int) -> tuple[End, End]:
    """Both ends of the rows `at` (e,) of CFAST."""
    t = m.model[card]
    kind = t["TYPE"][at]
    if (bad := ~np.isin(kind, ("PROP", "ELEM"))).any():
        raise card_error(
            m.model, t, int(at[bad][0]), f"type {kind[bad][0]!r}: allowed are PROP, ELEM"
        )
    D = m.model["PFAST"]["D"][lookup(m.model, "PFAST", t["PID"][at], table=t, at=at)].real
    return on_squares(
        m,
        t,
        at,
        diameter=D,
        by_shell=kind == "ELEM",
        fields=(("IDA", "IDA"), ("IDB", "IDB")),
    )


def build_fastener(m: Mesh, card: str, at: Int) -> ElementMatrices:
    """Matrices of the rows `at` (e,) of CFAST: KT, KR half way between the ends, half of MASS at
    each.

    Raises
    ------
    DeckError
        If an end or its frame is not determined, or a node or property is absent.
    """
    t = m.model[card]
    row = lookup(m.model, "PFAST", t["PID"][at], table=t, at=at)
    p = m.model["PFAST"]
    k = p.stack(*_STIFFNESS)[row]
    a, b = fastener_ends(m, card, at)
    axis = between(a, b)[1]
    cid = p["MCID"][row]
    absolute = p["MFLAG"][row] > 0
    relative = (cid >= 0) & ~absolute & ((k[:, 1] != k[:, 2]) | (k[:, 4] != k[:, 5]))
    refuse_rows(
        m.model,
        p,
        row[relative],
        "MFLAG = 0 with a frame and KT2, KT3 or KR2, KR3 that differ; give MFLAG = 1",
    )
    fixed = (cid >= 0) & absolute
    own = frame(m, np.where(fixed, cid, 0), (a.place + b.place) / 2)
    axes = np.where(fixed[:, None, None], own, _axes(axis))
    return joined(a, b, axes, springs=k, half=p["MASS"][row] / 2, loss=p["GE"][row])
