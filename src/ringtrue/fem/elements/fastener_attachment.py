"""Ends of welds and fasteners: at a node, on the patch of one shell, or on a square over several
shells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.fem.algebra import skew, unit
from ringtrue.fem.elements.shape_functions import bilinear
from ringtrue.fem.mesh import Mesh, any_triad
from ringtrue.model.model import Table, card_error

SHELLS = {"CQUAD4": 4, "CQUADR": 4, "CTRIA3": 3, "CTRIAR": 3}
_STEPS = 12  # Newton steps to the foot of a point on a patch; two suffice on a flat one
_SLACK = (
    0.02  # by which a foot may lie outside of its patch, in natural coordinates (SWLDPRM, PROJTOL)
)
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
    one = np.ones_like(r)
    none = np.zeros_like(r)
    quad, dquad = bilinear(np.stack([r, s], axis=1))
    flat = np.stack([1 - r - s, r, s, none], axis=1)
    slope = np.stack(
        [np.stack([-one, one, none, none], 1), np.stack([-one, none, one, none], 1)], axis=1
    )
    pick = triangle[:, None]
    return np.where(pick, flat, quad), np.where(pick[:, None], slope, dquad.swapaxes(1, 2))


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
        metric += (
            1e-14 * np.trace(metric, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        )  # a collapsed shell near by
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
    if (flat := (area == 0).all(axis=1)).any():
        raise card_error(m.model, t, int(at[flat][0]), "the corners of a patch lie on one line")
    r, s, N, dN = _foot(x, point, triangle)
    if (outside := _margin(r, s, triangle) < -_SLACK).any():
        raise card_error(
            m.model, t, int(at[outside][0]), "the foot of its point lies outside of a patch"
        )
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
    properties: Sequence[str],
    shells: Sequence[str],
) -> tuple[End, End]:
    """Ends A and B on the shells of the property that the card names, or on the shell that it names
    (`by_shell`).
    """
    skin = Skin.of(m)
    made = []
    for side, own, shell in zip("AB", properties, shells, strict=True):
        row = np.full(at.size, -1)
        row[by_shell] = _row(m, t, at[by_shell], skin=skin, ids=t[shell][at[by_shell]])
        on = _Surface(skin, t[own][at], row)
        made.append(_on_square(m, t, at, on=on, point=_place(m, t, at, side), diameter=diameter))
    return made[0], made[1]
