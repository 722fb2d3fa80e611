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

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.mesh import (
    FLAT_SHELLS,
    CardRows,
    ElementMatrices,
    Mesh,
    any_triad,
    arm,
    congruent,
    frame,
    isotropic,
    merged,
    node_dofs,
    rotation,
    skew,
    unit,
)
from ringtrue.model.cards import QUADRILATERAL, TRIANGLE
from ringtrue.model.model import table


@dataclass(frozen=True, slots=True)
class FootSearch:
    """The foot of a point on a patch, by Newton steps in natural coordinates.

    Attributes
    ----------
    steps : int
        Two suffice on a flat patch.
    slack : float
        By which a foot may lie outside of its patch (SWLDPRM, PROJTOL).
    far : float
        Beyond which a foot is not followed.
    nearest : int
        Shells that are tried, by the distance of their centres.
    """

    steps: int = 12
    slack: float = 0.02
    far: float = 5.0
    nearest: int = 16


FOOT = FootSearch()


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
    for _ in range(FOOT.steps):
        N, dN = _shapes(r, s, triangle)
        tangent = dN @ x
        off = point - np.einsum("ei,eij->ej", N, x)
        metric = tangent @ tangent.swapaxes(1, 2)
        # a collapsed shell near by
        metric += 1e-14 * np.trace(metric, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        step = np.linalg.solve(
            metric, np.einsum("ekj,ej->ek", tangent, off)[..., None]
        )[..., 0]
        r, s = (
            np.clip(x_ + step[:, i], -FOOT.far, FOOT.far) for i, x_ in enumerate((r, s))
        )
    return r, s, *_shapes(r, s, triangle)


def _margin(r: Float, s: Float, triangle: Bool) -> Float:
    """How far inside of its patch a place is, (e,), in natural coordinates; negative outside."""
    return np.where(
        triangle,
        np.minimum(np.minimum(r, s), 1 - r - s),
        1 - np.maximum(np.abs(r), np.abs(s)),
    )


def on_patch(t: CardRows, nodes: Int, point: Float) -> End:
    """Ends on patches of corner nodes (e, 4), the fourth -1 for triangles, at the feet of points
    (e, 3).
    """
    triangle = nodes[:, 3] < 0
    x = t.mesh.xyz[nodes]
    x[triangle, 3] = 0.0
    area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    t.refuse((area == 0).all(axis=1), "the corners of a patch lie on one line")
    r, s, N, dN = _foot(x, point, triangle)
    outside = _margin(r, s, triangle) < -FOOT.slack
    t.refuse(outside, "the foot of its point lies outside of a patch")
    tangent = dN @ x
    n = unit(np.cross(tangent[:, 0], tangent[:, 1]))
    g = np.linalg.solve(tangent @ tangent.swapaxes(1, 2), dN).swapaxes(1, 2) @ tangent
    turn = np.einsum("eni,ej->enij", np.cross(g, n[:, None]), n)
    turn += 0.5 * np.einsum("ei,ek,enkj->enij", n, n, skew(g))
    follow = np.zeros((len(t), 6, 4, 6))
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


def _joined(size: int, parts: list[tuple[Int, End]]) -> End:
    """Ends (size,) from those of some rows each; parts without rows do not count."""
    parts = [(rows, end) for rows, end in parts if rows.size]
    k = max(end.nodes.shape[1] for _, end in parts)
    padded = []
    for rows, end in parts:
        more = k - end.nodes.shape[1]
        nodes = np.pad(end.nodes, ((0, 0), (0, more)), constant_values=-1)
        follow = np.pad(end.follow, ((0, 0), (0, 0), (0, 6 * more)))
        padded.append((rows, replace(end, nodes=nodes, follow=follow)))
    return merged(size, padded)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """All flat shells of a mesh: ids, properties (s,), and corner nodes (s, 4), -1 for none."""

    mesh: Mesh
    ids: Int
    pid: Int
    corners: Int

    @classmethod
    def of(cls, m: Mesh) -> Skin:
        none: Int = np.zeros(0, dtype=np.int64)
        ids = [none]
        pids = [none]
        corners = [none.reshape(0, 4)]
        for card, count in FLAT_SHELLS.items():
            if card in m.model:
                t = m.rows(card)
                rows = np.full((len(t), 4), -1)
                rows[:, :count] = t.nodes(*(f"G{i + 1}" for i in range(count)))
                ids.append(t["EID"])
                pids.append(t["PID"])
                corners.append(rows)
        return cls(
            m, np.concatenate(ids), np.concatenate(pids), np.concatenate(corners)
        )

    def find(self, t: CardRows, ids: Int) -> Int:
        """Rows (e,) of the shells `ids` (e,) that `t` names."""
        row = table("shells", EID=self.ids).find(ids)
        t.refuse(row < 0, "{} is no shell with three or four corners", ids)
        return row

    def of_property(self, pid: Int, point: Float) -> Int:
        """The shells (e, k) of the property `pid` (e,) with the centres nearest to a point (e, 3),
        -1 for none.
        """
        out = np.full((pid.size, FOOT.nearest), -1)
        for one in np.unique(pid).tolist():
            mine = np.flatnonzero(self.pid == one)
            rows = np.flatnonzero(pid == one)
            if mine.size:
                corners = self.corners[mine]
                there = (corners >= 0)[:, :, None]
                total = np.where(there, self.mesh.xyz[corners], 0.0).sum(axis=1)
                nearby = cKDTree(total / there.sum(axis=1))
                k = min(FOOT.nearest, mine.size)
                out[rows, :k] = mine[nearby.query(point[rows], k)[1].reshape(-1, k)]
        return out

    def around(self, shell: Int) -> Int:
        """Each shell (e,) first and behind it those that share a node with it (e, k), -1 for
        none.
        """
        there = self.corners >= 0
        row = np.nonzero(there)[0]
        node = self.corners[there]
        on = sp.csr_array(
            (np.ones(row.size), (row, node)), shape=(self.ids.size, node.max() + 1)
        )
        touching = sp.coo_array(on[shell] @ on.T)
        pairs = np.unique(np.stack(touching.coords, axis=1), axis=0)
        i, j = pairs[pairs[:, 1] != shell[pairs[:, 0]]].T
        slot = np.arange(i.size) - np.searchsorted(i, i)
        out = np.full((shell.size, 2 + slot.max(initial=-1)), -1)
        out[:, 0] = shell
        out[i, slot + 1] = j
        return out

    def foot(self, found: Int, point: Float, own: bool) -> Int:
        """The one of the shells `found` (e, k) on which the foot of a point (e, 3) is nearest, -1
        for none.

        If `own`, the first of them comes before the others.
        """
        k = found.shape[1]
        corners = self.corners[found].reshape(-1, 4)
        triangle = corners[:, 3] < 0
        x = self.mesh.xyz[corners]
        x[triangle, 3] = 0.0
        every = np.repeat(point, k, axis=0)
        r, s, N, _ = _foot(x, every, triangle)
        away = np.linalg.norm(np.einsum("ei,eij->ej", N, x) - every, axis=1)
        on = (_margin(r, s, triangle) >= -FOOT.slack) & (found.ravel() >= 0)
        away = np.where(on, away, np.inf).reshape(-1, k)
        if own:
            away[np.isfinite(away[:, 0]), 0] = -1.0
        best = away.argmin(axis=1)
        row = np.arange(len(point))
        return np.where(np.isfinite(away[row, best]), found[row, best], -1)


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

    def foot(self, point: Float) -> Int:
        """The shell (e,) on which the foot of a point (e, 3) is, -1 for none."""
        skin = self.skin
        out = np.full(self.pid.size, -1)
        named = self.shell >= 0
        if named.any():
            found = skin.around(self.shell[named])
            out[named] = skin.foot(found, point[named], own=True)
        if not named.all():
            found = skin.of_property(self.pid[~named], point[~named])
            out[~named] = skin.foot(found, point[~named], own=False)
        return out

    def about(self, shell: Int, count: int) -> _Surface:
        """That of points around the places of the ends on `shell` (e,), `count` for each."""
        near = np.where(self.shell >= 0, shell, -1)
        return _Surface(self.skin, np.repeat(self.pid, count), np.repeat(near, count))


def _on_square(t: CardRows, on: _Surface, point: Float, diameter: Float) -> End:
    """Ends on a surface: the mean motion of the corners of a square as large as the circle (e,).

    The corners follow the shells that they stand on; the end follows them as an RBE3 of equal
    weights does (MSC Nastran Quick Reference Guide, CWELD PARTPAT and CFAST).
    """
    skin = on.skin
    named = on.shell >= 0
    what = np.where(named, "shell", "property")
    which = np.where(named, skin.ids[on.shell], on.pid) if skin.ids.size else on.pid
    shell = on.foot(point)
    t.refuse(shell < 0, "its point has no foot on the shells of {} {}", what, which)
    centre = on_patch(t, skin.corners[shell], point)
    axes = any_triad(centre.normal)[:, 1:]
    side = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corner = centre.place[:, None] + (np.sqrt(np.pi) / 4 * diameter)[:, None, None] * (
        side @ axes
    )
    flat = corner.reshape(-1, 3)
    under = on.about(shell, 4).foot(flat)
    lost = (under < 0).reshape(-1, 4).any(axis=1)
    t.refuse(lost, "D is too large: its square leaves the shells of {} {}", what, which)
    feet = on_patch(t.take(np.repeat(np.arange(len(t)), 4)), skin.corners[under], flat)
    S = np.zeros((len(t), 4, 3, 6))
    S[..., :3] = np.eye(3)
    S[..., 3:] = -skew(feet.place.reshape(-1, 4, 3) - centre.place[:, None])
    size = np.repeat([np.ones(len(t)), diameter], 3, axis=0).T
    scaled = S.reshape(-1, 12, 6) / size[:, None]  # turns in units of a diameter
    mean = (
        np.linalg.solve(scaled.swapaxes(1, 2) @ scaled, scaled.swapaxes(1, 2))
        / size[:, :, None]
    )
    shift = feet.follow[:, :3].reshape(-1, 4, 3, 24)
    follow = np.einsum("eijk,ejkl->eijl", mean.reshape(-1, 6, 4, 3), shift).reshape(
        -1, 6, 96
    )
    return End(feet.nodes.reshape(-1, 16), centre.place, centre.normal, follow)


def on_square(
    t: CardRows, side: str, fields: tuple[str, str], by_shell: Bool, diameter: Float
) -> End:
    """Ends A or B on the shells of the property that the card names, or on the shell that it names
    (`by_shell`), in the two `fields`.

    Their foot is that of GA or GB, else of GS, else of XS, YS, ZS.
    """
    own = t[f"G{side}"]
    own = np.where(own > 0, own, t["GS"])
    used = own > 0
    point = t.stack("XS", "YS", "ZS")
    bare = ~used & np.isnan(point).any(axis=1)
    t.refuse(bare, f"GS, G{side} or XS, YS and ZS must say where it is")
    point[used] = t.mesh.xyz[t.take(used).nodes_of(own[used])]
    skin = Skin.of(t.mesh)
    property_, shell = (t[name] for name in fields)
    row = np.full(len(t), -1)
    row[by_shell] = skin.find(t.take(by_shell), shell[by_shell])
    return _on_square(t, _Surface(skin, property_, row), point=point, diameter=diameter)


WIDE = ("PARTPAT", "ELPAT")
SHEAR = 0.9  # shear area of a round section over its area


def patches(t: CardRows, side: str) -> Int:
    """Corner nodes (e, 4) of patch A or B by GRIDID or ELEMID, -1 for none."""
    ids = t.stack(*(f"G{side}{i}" for i in range(1, 5)))
    used = ids > 0
    out = np.full(ids.shape, -1)
    out[used] = t.take(np.nonzero(used)[0]).nodes_of(ids[used])
    shell = t[f"SHID{side}"]
    by_shell = shell > 0
    if by_shell.any():
        skin = Skin.of(t.mesh)
        out[by_shell] = skin.corners[skin.find(t.take(by_shell), shell[by_shell])]
    return out


def weld_ends(t: CardRows) -> tuple[End, End]:
    """Both ends of CWELD: on a patch below GS (or GA, GB), else at GS; by ALIGN at GA and GB.

    PARTPAT and ELPAT take squares over several shells.
    """
    wide = np.isin(t["TYPE"], WIDE)
    return _weld_end(t, "A", wide), _weld_end(t, "B", wide)


def _weld_end(t: CardRows, side: str, wide: Bool) -> End:
    parts = []
    if wide.any():
        some = t.take(wide)
        fields = (f"PID{side}", f"SHID{side}")
        by_shell = some["TYPE"] == "ELPAT"
        diameter = some.named("PWELD")["D"].real
        square = on_square(
            some, side, fields=fields, by_shell=by_shell, diameter=diameter
        )
        parts.append((np.flatnonzero(wide), square))
    narrow = np.flatnonzero(~wide)
    some = t.take(narrow)
    corners = patches(some, side)
    there = corners[:, 0] >= 0
    given = some[f"G{side}"]
    own = np.where(some["TYPE"] == "ALIGN", given, some["GS"])
    some.refuse(~there & (own == 0), f"end {side} has neither a patch nor a node")
    point = np.where(there & (given > 0), given, own)
    some.refuse(point == 0, f"no GS or G{side} says where it pierces patch {side}")
    node = some.nodes_of(point)
    on = on_patch(some.take(there), corners[there], t.mesh.xyz[node[there]])
    parts += [(narrow[there], on), (narrow[~there], on_node(t.mesh, node[~there]))]
    return _joined(len(t), parts)


def lengths(L: Float, D: Any_, least: Float, most: Float) -> Any_:
    """Effective lengths (e,): L, not less and not more than so many diameters."""
    low = least * D
    high = most * D
    return np.where(np.real(low) > L, low, np.where(np.real(high) < L, high, L))


def _sheets(t: CardRows) -> Any_:
    """Half the thickness of both sheets (e,): the effective length of a spot weld."""
    skin = Skin.of(t.mesh)
    total: Any_ = np.zeros(len(t))
    for side in "AB":
        shell = t[f"SHID{side}"]
        named = shell > 0
        pid = t[f"PID{side}"].copy()
        pid[named] = skin.pid[skin.find(t.take(named), shell[named])]
        known = t.mesh.model["PSHELL"].ids if "PSHELL" in t.mesh.model else pid[:0]
        why = f"its sheet {side} is no PSHELL, whose thickness is the length of a weld of TYPE SPOT"
        t.refuse(~np.isin(pid, known), why)
        total = total + t.find("PSHELL", pid)["T"] / 2
    return total


def springs(L: Float, length: Any_, D: Any_, E: Any_, G: Any_) -> Any_:
    """Stiffness (e, 6) about the middle: along, across twice, of torsion, of bending twice."""
    area = np.pi / 4 * D**2
    second = np.pi / 64 * D**4
    across = 1 / (length / (SHEAR * G * area) + L**2 * length / (12 * E * second))
    bending = E * second / length
    return np.stack(
        [E * area / length, across, across, 2 * G * second / length, bending, bending],
        axis=1,
    )


def between(a: End, b: End) -> tuple[Float, Float]:
    """Length (e,) and axis (e, 3) from A to B; the normal of A where they are at one place."""
    d = b.place - a.place
    L = np.linalg.norm(d, axis=1)
    return L, np.where((L > 0)[:, None], d / np.where(L > 0, L, 1.0)[:, None], a.normal)


def joined(
    a: End, b: End, axes: Float, springs: Any_, half: Any_, loss: Any_
) -> ElementMatrices:
    """Matrices by springs (e, 6) half way between the ends, along and about `axes` (e, 3, 3); half
    the mass at each.
    """
    middle = (a.place + b.place) / 2
    local = rotation(axes, 1)
    move = [local @ arm(middle - end.place) @ end.follow for end in (a, b)]
    K = congruent(
        np.concatenate([-move[0], move[1]], axis=2), springs[:, :, None] * np.eye(6)
    )
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


def build_weld(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CWELD; half the mass at each end.

    Raises
    ------
    DeckError
        If an end is not determined, a foot lies outside of its patch, or a node, property or
        material is absent.
    """
    p = t.named("PWELD")
    iso = isotropic(p.named("MAT1", "MID"))
    D = p["D"]
    bad = (np.real(D) <= 0) | (np.real(iso.G) == 0)
    p.refuse(bad, "D must be greater than 0, and its MAT1 have a shear modulus")
    a, b = weld_ends(t)
    L, axis = between(a, b)
    length = lengths(L, D, p["LDMIN"], p["LDMAX"])
    both = (t.stack("SHIDA", "SHIDB") > 0).all(axis=1) | (t["TYPE"] == "PARTPAT")
    spot = both & (p["TYPE"] == "SPOT")
    if spot.any():
        sheets = _sheets(t.take(spot))
        length = length.astype(np.result_type(length, sheets))
        length[spot] = sheets
    k = springs(L, length, D, E=iso.E, G=iso.G)
    half = iso.rho * np.pi / 8 * D**2 * L
    return joined(a, b, any_triad(axis), springs=k, half=half, loss=iso.loss)


_STIFFNESS = ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3")


def _axes(axis: Float) -> Float:
    """Frames (e, 3, 3) of MCID -1: x along the axis, y in the plane of it and the axis of basic
    most across it.

    Of two that are equally across the first is taken (MSC Nastran Quick Reference Guide, PFAST).
    """
    b = np.eye(3)[np.round(np.abs(axis), 6).argmin(axis=1)]
    y = unit(b - np.einsum("ei,ei->e", b, axis)[:, None] * axis)
    return np.stack([axis, y, np.cross(axis, y)], axis=1)


def fastener_ends(t: CardRows) -> tuple[End, End]:
    """Both ends of rows of CFAST."""
    kind = t["TYPE"]
    t.refuse(
        ~np.isin(kind, ("PROP", "ELEM")), "type {!r}: allowed are PROP, ELEM", kind
    )
    D = t.named("PFAST")["D"].real
    a, b = (
        on_square(
            t, side, fields=(f"ID{side}",) * 2, by_shell=kind == "ELEM", diameter=D
        )
        for side in "AB"
    )
    return a, b


def build_fastener(t: CardRows) -> ElementMatrices:
    """Matrices of rows of CFAST: KT, KR half way between the ends, half of MASS at each.

    Raises
    ------
    DeckError
        If an end or its frame is not determined, or a node or property is absent.
    """
    p = t.named("PFAST")
    k = p.stack(*_STIFFNESS)
    a, b = fastener_ends(t)
    axis = between(a, b)[1]
    cid = p["MCID"]
    absolute = p["MFLAG"] > 0
    relative = (cid >= 0) & ~absolute & ((k[:, 1] != k[:, 2]) | (k[:, 4] != k[:, 5]))
    why = "MFLAG = 0 with a frame and KT2, KT3 or KR2, KR3 that differ; give MFLAG = 1"
    p.refuse(relative, why)
    fixed = (cid >= 0) & absolute
    own = frame(t.mesh, np.where(fixed, cid, 0), (a.place + b.place) / 2)
    axes = np.where(fixed[:, None, None], own, _axes(axis))
    return joined(a, b, axes, springs=k, half=p["MASS"] / 2, loss=p["GE"])
