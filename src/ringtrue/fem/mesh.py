"""What elements need of a model: nodes, displacement frames, local axes, properties, materials; and
sets of elements as rows of their tables.

Algebra of small matrices, batched over elements and generic in dtype (a complex step passes).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, Ragged, Table, card_error, unsupported_card


class _Fields(Protocol):
    """A dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


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
    return v / np.where(length == 0, 1.0, length)


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
    """c (e,) times matrices K, (e, i, j) or (i, j) for all."""
    return c[:, None, None] * K


def applied(A: Any_, x: Any_) -> Any_:
    """Matrices (e, d, d), or diagonals (e, d), times motions (e, d, m)."""
    return A[:, :, None] * x if A.ndim == 2 else A @ x


def scatter(e: int, d: int, *blocks: tuple[list[int], Any_]) -> Any_:
    """The sum of blocks (rows, (e, r, r)) placed into (e, d, d)."""
    out = np.zeros(
        (e, d, d), dtype=np.result_type(float, *(b.dtype for _, b in blocks))
    )
    for rows, block in blocks:
        out[:, np.array(rows)[:, None], rows] += block
    return out


FLAT_SHELLS = {"CQUAD4": 4, "CQUADR": 4, "CTRIA3": 3, "CTRIAR": 3}  # their corners
SCALAR_CARDS = (
    "CELAS3",
    "CELAS4",
    "CMASS3",
    "CMASS4",
    "CDAMP3",
    "CDAMP4",
)  # they define the points that they name


def matrix(*rows: Sequence[Any_]) -> Any_:
    """Matrices (..., i, j) from rows of entries (...), which are broadcast."""
    return np.stack(
        [np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2
    )


Arrays = TypeVar("Arrays", bound=_Fields)  # all of its fields are arrays (e, ...)


def taken(whole: Arrays, rows: Int | Bool | slice) -> Arrays:
    """A dataclass of arrays (e, ...) with some rows of each."""
    return type(whole)(*(getattr(whole, f.name)[rows] for f in fields(whole)))


def merged(size: int, parts: Sequence[tuple[Int | Bool | slice, Arrays]]) -> Arrays:
    """A dataclass of arrays (size, ...) from those of some rows each; 0 in rows that none has."""
    kind = type(parts[0][1])
    made = []
    for f in fields(kind):
        values = [(rows, getattr(part, f.name)) for rows, part in parts]
        dtype = np.result_type(*(v for _, v in values))
        out = np.zeros((size, *values[0][1].shape[1:]), dtype=dtype)
        for rows, v in values:
            out[rows] = v
        made.append(out)
    return kind(*made)


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

    @property
    def size(self) -> int:
        """Number of full DOFs: six a node, then one a scalar point."""
        return 6 * len(self.xyz) + self.scalar.size

    @property
    def coupled_mass(self) -> bool:
        """Whether PARAM,COUPMASS asks for coupled mass matrices."""
        return self.model.param("COUPMASS", -1) > 0

    @property
    def dofs(self) -> DofSet:
        """Labels of the full DOFs."""
        ids = self.model["GRID"].ids
        node = np.concatenate([np.repeat(ids, 6), self.scalar])
        direction = np.concatenate(
            [
                np.tile(np.arange(1, 7), ids.size),
                np.zeros(self.scalar.size, dtype=np.int64),
            ]
        )
        return DofSet(node, direction.astype(np.int8))

    def rows(self, card: str, at: Int | None = None) -> CardRows:
        """Rows `at` (e,) of the table of a card, or all of them."""
        table = self.model[card]
        return CardRows(self, table, np.arange(len(table)) if at is None else at)


@dataclass(frozen=True, slots=True, eq=False)
class CardRows:
    """Some rows of the table of a card: elements, or the properties of elements, one for each.

    Attributes
    ----------
    mesh : Mesh
    table : Table
    at : (e,) int64
    """

    mesh: Mesh
    table: Table
    at: Int

    @property
    def card(self) -> str:
        """The name of the card."""
        return self.table.card

    def __len__(self) -> int:
        return self.at.size

    def __getitem__(self, name: str) -> Any_:
        """A plain column of the rows, (e,)."""
        return self.table[name][self.at]

    def __contains__(self, name: str) -> bool:
        return name in self.table.columns

    @property
    def listed_mass(self) -> Any_:
        """What chosen lists add to the non-structural mass a length or area, (e,)."""
        added = self.mesh.added
        return added[self.card][self.at] if self.card in added else np.zeros(len(self))

    def stack(self, *names: str) -> Any_:
        """Plain columns side by side, (e, len(names))."""
        return self.table.stack(*names)[self.at]

    def ragged(self, name: str) -> Ragged:
        """A column of lists, those of the rows."""
        column = self.table.ragged(name)
        sizes = column.sizes[self.at]
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        first = np.repeat(column.offsets[self.at] - offsets[:-1], sizes)
        return Ragged(column.values[first + np.arange(first.size)], offsets)

    def take(self, which: Int | Bool | slice) -> CardRows:
        """Some of the rows, by position or flag."""
        return CardRows(self.mesh, self.table, self.at[which])

    def nodes(self, *names: str) -> Int:
        """Rows of GRID (e, k) for the node ids in these columns; see `nodes_of`."""
        return self.nodes_of(self.stack(*names))

    def nodes_of(self, ids: Any_) -> Int:
        """Rows of GRID for node ids (e, ...) that the rows name.

        Raises
        ------
        DeckError
            If a node is absent.
        """
        found = self.mesh.model["GRID"].find(ids)
        self.refuse(found < 0, "GRID {} is not in the deck", ids)
        return found

    def dof(self, ids: Int, component: Int) -> Int:
        """Full DOF (e,) of component 1..6 of a node, or of a scalar point (component 0 or 1)."""
        points = self.mesh.scalar
        point = np.searchsorted(points, ids)
        scalar = np.isin(ids, points)
        node = ~scalar
        bad = node & ((component < 1) | (component > 6))
        rows = self.take(node).nodes_of(ids[node])
        self.refuse(bad, "component {} of GRID {}: allowed are 1 to 6", component, ids)
        out = 6 * len(self.mesh.xyz) + point
        out[node] = 6 * rows + component[node] - 1
        return out

    def find(self, card: str, ids: Int) -> CardRows:
        """The rows of `card` with these ids (e,), which the rows refer to.

        Raises
        ------
        DeckError, UnsupportedCard
            If one is absent; the second where it may be a card that was read but is not supported.
        """
        model = self.mesh.model
        found = model[card].find(ids) if card in model else np.full(ids.shape, -1)
        lost = found < 0
        other = [c for c in model.kept if c[:3] == card[:3] and c != card]
        if lost.any() and other:
            i = int(lost.argmax())
            why = f"{self.card} {self.table.ids[self.at[i]]} refers to {card} {ids[i]}"
            raise UnsupportedCard(other[0], why=why)
        self.refuse(lost, card + " {} is not in the deck", ids)
        return CardRows(self.mesh, model[card], found)

    def named(self, card: str, column: str = "PID") -> CardRows:
        """The rows of `card` that a column names; see `find`."""
        return self.find(card, self[column])

    def refuse(self, bad: Any_ | np.bool_, why: str, *values: Any_) -> None:
        """Raise a DeckError at the first of the rows that is bad (e, ...).

        The entries there of `values`, of the same shape, stand for the {} of the message.
        """
        if bad.any():
            place = tuple(np.argwhere(bad)[0].tolist())
            message = why.format(*(v[place] for v in values))
            raise card_error(
                self.mesh.model, self.table, int(self.at[place[0]]), message
            )

    def refuse_unsupported(self, bad: Any_ | np.bool_, why: str, *values: Any_) -> None:
        """Raise an UnsupportedCard in the same way, for (e,)."""
        if bad.any():
            i = int(bad.argmax())
            message = why.format(*(v[i] for v in values))
            raise unsupported_card(
                self.mesh.model, self.table, int(self.at[i]), message
            )


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
    ids += [
        model[card][end]
        for card in SCALAR_CARDS
        if card in model
        for end in ("S1", "S2")
    ]
    every = np.unique(np.concatenate(ids))
    return every[every > 0]


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


def isotropic(mat: CardRows) -> Isotropic:
    """MAT1 properties of each element, the one of E, G, NU that is blank completed from the others.

    Where NU and one of E and G are blank, both are 0, as in Nastran (Quick Reference Guide, MAT1):
    E alone makes rods and bars without torsion and shells without transverse shear, G alone makes
    no shell or solid.

    Raises
    ------
    DeckError
        If neither E nor G is given.
    """
    E, G, nu = (mat[c] for c in ("E", "G", "NU"))
    no_E = np.isnan(E)
    no_G = np.isnan(G)
    no_nu = np.isnan(nu)
    mat.refuse(no_E & no_G, "neither E nor G is given")
    three = ~no_E & ~no_G & (G != 0)
    nu = np.where(no_nu, np.where(three, E / np.where(three, 2 * G, 1.0) - 1, 0.0), nu)
    both = 2 * (1 + nu)
    return Isotropic(
        E=np.where(no_E, np.where(no_nu, 0.0, both * G), E),
        G=np.where(no_G, np.where(no_nu, 0.0, E / both), G),
        nu=nu,
        rho=mat["RHO"],
        loss=mat["GE"],
    )


def check_ratio(mat: CardRows, nu: Any_, most: float) -> None:
    """Refuse rows of MAT1 whose Poisson's ratios nu (e,) make no positive elasticity.

    Raises
    ------
    DeckError
        If one is not between -1 and `most`: 0.5 for solids, 1 for plane stress.
    """
    bad = (nu.real <= -1) | (nu.real >= most)
    mat.refuse(
        bad, f"Poisson's ratio {{:g}} must be between -1 and {most:g} here", nu.real
    )


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
        return (
            self.loss[:, None, None] * self.stiffness
            if self.loss.any()
            else self.viscous[:0]
        )


def node_dofs(nodes: Int, count: int = 6) -> Int:
    """The first `count` full DOFs of nodes (e, k) -> (e, k count)."""
    return (6 * nodes[..., None] + np.arange(count)).reshape(
        len(nodes), count * nodes.shape[1]
    )


def segment(x: Float) -> tuple[Float, Float]:
    """Length (e,) and unit vector (e, 3) from the first to the second of two points (e, 2, 3)."""
    d = x[:, 1] - x[:, 0]
    L = np.linalg.norm(d, axis=1)
    return L, d / L[:, None]


def orientation(t: CardRows, origin: Int) -> Float:
    """The vector (e, 3) in basic from G0, or from X1-X3 in the CD frame of the node rows `origin`
    (e,).

    An OFFT that begins with B takes X1-X3 in basic.
    """
    m = t.mesh
    v = t.stack("X1", "X2", "X3")
    g0 = t["G0"]
    local = np.einsum("ei,eij->ej", v, m.cd[origin])
    if "OFFT" in t:
        basic = np.char.startswith(t["OFFT"].astype(str), "B")
        local = np.where(basic[:, None], v, local)
    by_node = g0 > 0
    node = t.take(by_node).nodes_of(g0[by_node])
    local[by_node] = m.xyz[node] - m.xyz[origin[by_node]]
    return np.asarray(local)


def triad(t: CardRows, axis: Float, v: Float) -> Float:
    """Local axes (e, 3, 3) as rows: x along `axis`, v in the xy plane.

    Raises
    ------
    DeckError
        If v is along the axis.
    """
    z = np.cross(axis, v)
    flat = np.linalg.norm(z, axis=1) <= 1e-8 * np.maximum(
        np.linalg.norm(v, axis=1), 1e-300
    )
    t.refuse(flat, "the orientation vector is zero or along the element; give another")
    z = unit(z)
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def any_triad(axis: Float) -> Float:
    """Local axes (e, 3, 3) with x along `axis` and some y."""
    v = np.zeros_like(axis)
    v[np.arange(len(axis)), np.abs(axis).argmin(axis=1)] = 1.0
    z = unit(np.cross(axis, v))
    return np.stack([axis, np.cross(z, axis), z], axis=1)


def frame(m: Mesh, cid: Int, at: Float) -> Float:
    """Axes (e, 3, 3) of frames `cid` (e,) at points (e, 3), of basic where it is negative."""
    return axes(m.model, np.maximum(cid, 0), at)


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
