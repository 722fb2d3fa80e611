"""What elements need of a model: nodes, displacement frames, local axes, properties, materials; and
sets of elements as rows of their tables.

Algebra of small matrices, batched over elements and generic in dtype (a complex step passes).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, Table, card_error


def skew(r: Any_) -> Any_:
    """[r]x with [r]x v = r x v; (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*r.shape, 3), dtype=r.dtype)
    out[..., 0, 1] = -r[..., 2]
    out[..., 0, 2] = r[..., 1]
    out[..., 1, 2] = -r[..., 0]
    out[..., 1, 0] = r[..., 2]
    out[..., 2, 0] = -r[..., 1]
    out[..., 2, 1] = r[..., 0]
    return out


def unit(v: Any_) -> Any_:
    """Vectors (..., 3) divided by their length, analytic; one without length stays 0."""
    length = np.sqrt((v * v).sum(axis=-1, keepdims=True))
    return np.asarray(v / np.where(length == 0, 1.0, length))


def arm(r: Any_) -> Any_:
    """Motion (6) of a point at r from a node, by that of the node: (..., 3) -> (..., 6, 6)."""
    out = np.zeros((*r.shape[:-1], 6, 6), dtype=r.dtype)
    out[...] = np.eye(6)
    out[..., :3, 3:] = -skew(r)
    return out


def congruent(A: Any_, K: Any_) -> Any_:
    """AᵀKA for A (e, i, j) and K (e, i, i)."""
    return A.swapaxes(-1, -2) @ K @ A


def nodal(blocks: Any_) -> Any_:
    """Block-diagonal matrices of nodal blocks (e, k, 6, 6) -> (e, 6k, 6k)."""
    e, k = blocks.shape[:2]
    out = np.zeros((e, k, 6, k, 6), dtype=blocks.dtype)
    at = np.arange(k)
    out[:, at, :, at, :] = blocks.swapaxes(0, 1)
    return out.reshape(e, 6 * k, 6 * k)


def rotation(R: Any_, k: int) -> Any_:
    """Basic motion (6k) to local: local axes R (e, 3, 3) as rows -> (e, 6k, 6k)."""
    e = len(R)
    out = np.zeros((e, 2 * k, 3, 2 * k, 3), dtype=R.dtype)
    at = np.arange(2 * k)
    out[:, at, :, at, :] = R
    return out.reshape(e, 6 * k, 6 * k)


def condense(K: Any_, keep: Int | slice, drop: Int | slice) -> Any_:
    """Static condensation K_kk - K_kd K_dd⁻¹ K_dk, (e, d, d) -> (e, k, k); without it where K_dd is
    zero.
    """
    rows = K[:, keep]
    Kkk = rows[:, :, keep]
    Kkd = rows[:, :, drop]
    Kdd = K[:, drop][:, :, drop]
    live = np.abs(Kdd).max(axis=(1, 2), initial=0) > 0
    if live.all():
        return Kkk - Kkd @ np.linalg.solve(Kdd, Kkd.swapaxes(1, 2))
    out = np.array(Kkk)
    out[live] -= Kkd[live] @ np.linalg.solve(Kdd[live], Kkd[live].swapaxes(1, 2))
    return out


def scaled(c: Any_, K: Any_) -> Any_:
    """c (e,) times K (e, ...)."""
    return np.asarray(c.reshape(-1, *(1,) * (K.ndim - 1)) * K)


def applied(A: Any_, x: Any_) -> Any_:
    """Matrices (e, d, d), or diagonals (e, d), times motions (e, d, m)."""
    return A[:, :, None] * x if A.ndim == 2 else A @ x


def add_at(out: Any_, dofs: Int, values: Any_) -> None:
    """Add what elements have at their DOFs, (e, d) each, -1 for none, to that of all, (dof,)."""
    np.add.at(out, dofs[dofs >= 0], values[dofs >= 0])


def scatter(e: int, d: int, *blocks: tuple[list[int], Any_]) -> Any_:
    """The sum of blocks (rows, (e, r, r)) placed into (e, d, d)."""
    out = np.zeros((e, d, d), dtype=np.result_type(float, *(b.dtype for _, b in blocks)))
    for rows, block in blocks:
        out[:, np.array(rows)[:, None], rows] += block
    return out


SCALAR_CARDS = (
    "CELAS3",
    "CELAS4",
    "CMASS3",
    "CMASS4",
    "CDAMP3",
    "CDAMP4",
)  # they define the points that they name


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A model with its nodes resolved to the basic frame.

    Attributes
    ----------
    model : Model
    xyz : (n, 3) float64
        Basic coordinates, in the order of the GRID rows.
    cd : (n, 3, 3) float64
        Displacement (CD) frame of each node, unit vectors as rows.
    scalar : (s,) int64
        Ids of the scalar points, ascending.
    added : mapping of str to (rows,)
        Non-structural mass a length or area of the lists that case control chooses, by element
        card.
    """

    model: Model
    xyz: Float
    cd: Float
    scalar: Int
    added: Mapping[str, Any_] = field(default_factory=dict)

    def nsm(self, card: str, at: Int) -> Any_:
        """What chosen lists add to the non-structural mass a length or area of rows `at` (e,)."""
        return self.added[card][at] if card in self.added else np.zeros(at.size)

    @property
    def size(self) -> int:
        """Number of full DOFs: six a node, then one a scalar point."""
        return 6 * len(self.xyz) + self.scalar.size

    @property
    def dofs(self) -> DofSet:
        """Labels of the full DOFs."""
        ids = self.model["GRID"].ids
        node = np.concatenate([np.repeat(ids, 6), self.scalar])
        direction = np.concatenate(
            [np.tile(np.arange(1, 7), ids.size), np.zeros(self.scalar.size, dtype=np.int64)]
        )
        return DofSet(node, direction.astype(np.int8))

    def nodes(self, ids: Any_, table: Table, at: Int) -> Int:
        """Rows of GRID for node ids (e, ...) used by rows `at` (e,) of `table`.

        Raises
        ------
        DeckError
            If a node is absent.
        """
        found = self.model["GRID"].find(ids)
        if (found < 0).any():
            first = np.argwhere(found < 0)[0]
            raise card_error(
                self.model,
                table,
                int(at[first[0]]),
                f"GRID {np.asarray(ids)[tuple(first)]} is not in the deck",
            )
        return found

    def dof(self, ids: Int, component: Int, table: Table, at: Int) -> Int:
        """Full DOF of component 1..6 of a node, or of a scalar point (component 0 or 1); (k,)
        int64.
        """
        point = np.searchsorted(self.scalar, ids).clip(max=max(self.scalar.size - 1, 0))
        scalar = np.zeros(ids.shape, dtype=bool)
        if self.scalar.size:
            scalar = self.scalar[point] == ids
        out = 6 * len(self.xyz) + point
        out[~scalar] = 6 * self.nodes(ids[~scalar], table, at[~scalar]) + component[~scalar] - 1
        bad = ~scalar & ((component < 1) | (component > 6))
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise card_error(
                self.model,
                table,
                int(at[i]),
                f"component {component[i]} of GRID {ids[i]}: allowed are 1 to 6",
            )
        return out


def nodes_of(model: Model) -> Mesh:
    """Resolve the nodes of a model; `element_cards.mesh` adds its lists of non-structural mass.

    Raises
    ------
    DeckError
        If there is neither GRID nor scalar point, an id occurs twice, or a frame is absent.
    """
    if "GRID" not in model or not (len(model["GRID"]) or scalar_points(model).size):
        raise DeckError("the deck has no GRID")
    ids, count = np.unique(model["GRID"].ids, return_counts=True)
    if (count > 1).any():
        raise DeckError(f"GRID {ids[count > 1][0]} occurs twice")
    xyz = positions(model)
    return Mesh(model, xyz, axes(model, model["GRID"]["CD"], xyz), scalar_points(model))


def scalar_points(model: Model) -> Int:
    """Ids of the scalar points, ascending: those of SPOINT, and those that only a scalar element
    names.
    """
    ids = [np.empty(0, dtype=np.int64)]
    if "SPOINT" in model:
        ids.append(model["SPOINT"].ragged("ID").values.astype(np.int64))
    ids += [model[card][end] for card in SCALAR_CARDS if card in model for end in ("S1", "S2")]
    every = np.unique(np.concatenate(ids))
    return every[every > 0]


def lookup(model: Model, card: str, ids: Int, table: Table, at: Int) -> Int:
    """Rows of `card` with these ids (e,), which rows `at` (e,) of `table` refer to.

    Raises
    ------
    DeckError, UnsupportedCard
        If one is absent; the second where it may be a card that was read but is not supported.
    """
    found = model[card].find(ids) if card in model else np.full(ids.shape, -1)
    if (found < 0).any():
        i = int(np.flatnonzero(found < 0)[0])
        other = [c for c in model.kept if c[:3] == card[:3] and c != card]
        if other:
            raise UnsupportedCard(
                other[0], why=f"{table.card} {table.ids[at[i]]} refers to {card} {ids[i]}"
            )
        raise card_error(model, table, int(at[i]), f"{card} {ids[i]} is not in the deck")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Isotropic:
    """MAT1 rows, one an element: `E, G, nu, rho, loss` (e,), real or complex."""

    E: Any_
    G: Any_
    nu: Any_
    rho: Any_
    loss: Any_

    @property
    def shear(self) -> Any_:
        """E / (2 (1 + ν)) (e,): shear in the plane of shells and in solids, which do not use G
        (MAT1, usage table).
        """
        return np.asarray(self.E / (2 * (1 + self.nu)))


def isotropic(model: Model, mid: Int, table: Table, at: Int) -> Isotropic:
    """MAT1 properties of each element, the one of E, G, NU that is blank completed from the others.

    Where NU and one of E and G are blank, both are 0, as in Nastran (Quick Reference Guide, MAT1):
    E alone makes rods and bars without torsion and shells without transverse shear, G alone makes
    no shell or solid.

    Raises
    ------
    DeckError
        If a material is absent, or neither E nor G is given.
    """
    row = lookup(model, "MAT1", mid, table=table, at=at)
    mat = model["MAT1"]
    E, G, nu, rho, loss = (mat[c][row] for c in ("E", "G", "NU", "RHO", "GE"))
    no_E = np.isnan(E)
    no_G = np.isnan(G)
    no_nu = np.isnan(nu)
    if (no_E & no_G).any():
        raise card_error(
            model, mat, int(row[np.flatnonzero(no_E & no_G)[0]]), "neither E nor G is given"
        )
    three = ~no_E & ~no_G & (G != 0)
    nu = np.where(no_nu, np.where(three, E / np.where(three, 2 * G, 1.0) - 1, 0.0), nu)
    E, G = (
        np.where(no_E, np.where(no_nu, 0.0, 2 * (1 + nu) * G), E),
        np.where(no_G, np.where(no_nu, 0.0, E / (2 * (1 + nu))), G),
    )
    return Isotropic(E=E, G=G, nu=nu, rho=rho, loss=loss)


def check_ratio(model: Model, mid: Int, nu: Any_, most: float) -> None:
    """Poisson's ratios nu (e,) of MAT1 mid (e,) that make no positive elasticity.

    Raises
    ------
    DeckError
        If one is not between -1 and `most`: 0.5 for solids, 1 for plane stress.
    """
    if (bad := (nu.real <= -1) | (nu.real >= most)).any():
        mat = model["MAT1"]
        i = int(np.flatnonzero(bad)[0])
        why = f"Poisson's ratio {nu.real[i]:g} must be between -1 and {most:g} here"
        raise card_error(model, mat, int(mat.find(mid[i : i + 1])[0]), why)


@dataclass(frozen=True, slots=True, eq=False)
class ElementMatrices:
    """Element matrices over full basic-frame DOFs.

    Attributes
    ----------
    dofs : (e, d) int64
        -1 where an element has no such DOF (a grounded end).
    stiffness : (e, d, d), real or complex
    mass : (e, d) or (e, d, d)
        Diagonal (lumped) or full.
    loss : (e,), or (0,) where the elements have none
        Structural damping factor g of the element, K (1 + i g).
    viscous : (e, d, d), or without entries where the elements have none
    lossy : (e, d, d), optional
        Structural damping that is no one factor times the stiffness, in its place.
    """

    dofs: Int
    stiffness: Any_
    mass: Any_
    loss: Any_ = field(default_factory=lambda: np.zeros(0))
    viscous: Any_ = field(default_factory=lambda: np.zeros((0, 0, 0)))
    lossy: Any_ | None = None

    @property
    def structural(self) -> Any_:
        """Structural damping (e, d, d), or without entries where the elements have none."""
        if self.lossy is not None:
            return self.lossy
        return self.loss[:, None, None] * self.stiffness if self.loss.any() else self.viscous[:0]


def node_dofs(nodes: Int, count: int = 6) -> Int:
    """The first `count` full DOFs of nodes (e, k) -> (e, k count)."""
    return np.asarray(
        (6 * nodes[..., None] + np.arange(count)).reshape(len(nodes), count * nodes.shape[1])
    )


def segment(x: Float) -> tuple[Float, Float]:
    """Length (e,) and unit vector (e, 3) from the first to the second of two points (e, 2, 3)."""
    d = x[:, 1] - x[:, 0]
    L = np.linalg.norm(d, axis=1)
    return L, d / L[:, None]


def orientation(m: Mesh, table: Table, at: Int, origin: Int) -> Float:
    """The vector (e, 3) in basic from G0, or from X1-X3 in the CD frame of the node rows `origin`
    (e,).

    An OFFT that begins with B takes X1-X3 in basic.
    """
    v = table.stack("X1", "X2", "X3")[at]
    g0 = table["G0"][at]
    local = np.einsum("ei,eij->ej", v, m.cd[origin])
    if "OFFT" in table.columns:
        basic = np.char.startswith(table["OFFT"][at].astype(str), "B")
        local = np.where(basic[:, None], v, local)
    by_node = g0 > 0
    local[by_node] = m.xyz[m.nodes(g0[by_node], table, at[by_node])] - m.xyz[origin[by_node]]
    return np.asarray(local)


def triad(m: Mesh, axis: Float, v: Float, table: Table, at: Int) -> Float:
    """Local axes (e, 3, 3) as rows: x along `axis`, v in the xy plane.

    Raises
    ------
    DeckError
        If v is along the axis.
    """
    z = np.cross(axis, v)
    flat = np.linalg.norm(z, axis=1) <= 1e-8 * np.maximum(np.linalg.norm(v, axis=1), 1e-300)
    if flat.any():
        i = int(at[np.flatnonzero(flat)[0]])
        raise card_error(
            m.model, table, i, "the orientation vector is zero or along the element; give another"
        )
    z = unit(z)
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def any_triad(axis: Float) -> Float:
    """Local axes (e, 3, 3) with x along `axis` and some y."""
    v = np.zeros_like(axis)
    v[np.arange(len(axis)), np.abs(axis).argmin(axis=1)] = 1.0
    z = unit(np.cross(axis, v))
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def frame(m: Mesh, cid: Int, at: Float) -> Float:
    """Axes (e, 3, 3) of frames `cid` (e,) at points (e, 3)."""
    return axes(m.model, cid, at)


def components(text: Any_) -> Bool:
    """Component lists such as "1246" (e,) as flags (e, 6)."""
    as_text = text.astype(str)
    return np.stack([np.char.find(as_text, str(c)) >= 0 for c in range(1, 7)], axis=1)


Rows = dict[str, Int]  # card -> (r,) rows of its table


def union(parts: Iterable[Rows]) -> Rows:
    """Rows that are in any of the parts."""
    out: Rows = {}
    for rows in parts:
        for card, at in rows.items():
            out[card] = np.union1d(out[card], at) if card in out else at
    return out


def common(a: Rows, b: Rows) -> Rows:
    """Rows that are in both."""
    both = {card: np.intersect1d(at, b[card]) for card, at in a.items() if card in b}
    return {card: at for card, at in both.items() if at.size}


def without(a: Rows, b: Rows) -> Rows:
    """Rows of the first that are not in the second."""
    rest = {card: np.setdiff1d(at, b.get(card, at[:0])) for card, at in a.items()}
    return {card: at for card, at in rest.items() if at.size}
