"""What the elements need of a model: node positions, displacement frames, and rows of properties
and materials.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, Table
from ringtrue.model.places import error as error
from ringtrue.model.places import unsupported as unsupported

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
    added: Mapping[str, Any_] = field(init=False)

    def __post_init__(self) -> None:
        from ringtrue.fem.added_mass import added_mass  # the elements behind it import this module

        object.__setattr__(self, "added", added_mass(self) if self.model.case.nsm else {})

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
            raise error(
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
            raise error(
                self.model,
                table,
                int(at[i]),
                f"component {component[i]} of GRID {ids[i]}: allowed are 1 to 6",
            )
        return out


def mesh(model: Model) -> Mesh:
    """Resolve the nodes of a model.

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
        raise error(model, table, int(at[i]), f"{card} {ids[i]} is not in the deck")
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
    row = lookup(model, "MAT1", mid, table, at)
    mat = model["MAT1"]
    E, G, nu, rho, loss = (mat[c][row] for c in ("E", "G", "NU", "RHO", "GE"))
    no_E, no_G, no_nu = np.isnan(E), np.isnan(G), np.isnan(nu)
    if (no_E & no_G).any():
        raise error(
            model, mat, int(row[np.flatnonzero(no_E & no_G)[0]]), "neither E nor G is given"
        )
    three = ~no_E & ~no_G & (G != 0)
    nu = np.where(no_nu, np.where(three, E / np.where(three, 2 * G, 1.0) - 1, 0.0), nu)
    E, G = (
        np.where(no_E, np.where(no_nu, 0.0, 2 * (1 + nu) * G), E),
        np.where(no_G, np.where(no_nu, 0.0, E / (2 * (1 + nu))), G),
    )
    return Isotropic(E, G, nu, rho, loss)


def check_ratio(model: Model, mid: Int, nu: Any_, most: float) -> None:
    """Poisson's ratios nu (e,) of MAT1 mid (e,) that make no positive elasticity.

    Raises
    ------
    DeckError
        If one is not between -1 and `most`: 0.5 for solids, 1 for plane stress.
    """
    if (bad := (nu.real <= -1) | (nu.real >= most)).any():
        mat, i = model["MAT1"], int(np.flatnonzero(bad)[0])
        why = f"Poisson's ratio {nu.real[i]:g} must be between -1 and {most:g} here"
        raise error(model, mat, int(mat.find(mid[i : i + 1])[0]), why)


@dataclass(frozen=True, slots=True, eq=False)
class Matrices:
    """Element matrices over full basic-frame DOFs.

    Attributes
    ----------
    dofs : (e, d) int64
        -1 where an element has no such DOF (a grounded end).
    stiffness : (e, d, d), real or complex
    mass : (e, d) or (e, d, d)
        Diagonal (lumped) or full.
    loss : (e,)
        Structural damping factor g of the element, K (1 + i g).
    viscous : (e, d, d), or (0, d, d) where the element has none
    lossy : (e, d, d), optional
        Structural damping that is no one factor times the stiffness, in its place.
    """

    dofs: Int
    stiffness: Any_
    mass: Any_
    loss: Any_
    viscous: Any_
    lossy: Any_ | None = None

    @property
    def structural(self) -> Any_:
        """Structural damping (e, d, d), or (0, d, d) where the elements have none."""
        if self.lossy is not None:
            return self.lossy
        return self.loss[:, None, None] * self.stiffness if self.loss.any() else self.viscous[:0]
