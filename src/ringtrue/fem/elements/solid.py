"""What the solid elements share: stiffness and mass from shape functions at integration points."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.errors import InputError
from ringtrue.fem.algebra import condense, scaled
from ringtrue.fem.elements.elasticity import (
    Anisotropic,
    anisotropic,
    bulk,
    determinants,
    elastic,
    gram,
    incompatible,
    is_anisotropic,
    jacobian,
    moduli,
    solid,
)
from ringtrue.fem.elements.shape_functions import SolidRule, kept
from ringtrue.fem.mesh import Isotropic, Matrices, Mesh, lookup, node_dofs
from ringtrue.model.model import Model, card_error, unsupported_card

_CACHED = (
    2**16
)  # numbers in the matrices of a slice: with its temporaries it stays in the cache of one core
FLAT = 1e-12  # of the cube on the longest extent: less volume is none


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """An element with corner nodes only.

    Attributes
    ----------
    stiffness, mass : Rule
    bubbles : (gp, m, 3) float64
        Natural derivatives of incompatible modes, which are condensed out.
    centre : (1, n, 3) float64
        Derivatives of the shape functions where those modes take their Jacobian.
    pressure : (gp, k) float64
        What the dilatation is projected on, for an element without bubbles.
    """

    stiffness: SolidRule
    mass: SolidRule
    bubbles: Float | None = None
    centre: Float | None = None
    pressure: Float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Quadratic:
    """An element with all its midside nodes.

    Attributes
    ----------
    stiffness, mass : Rule
    pressure : (gp, k) float64
        What the dilatation is projected on; as many columns as points leave it as it is.
    """

    stiffness: SolidRule
    mass: SolidRule
    pressure: Float


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A solid element card.

    Attributes
    ----------
    edges : tuple of (int, int)
        The corners that each midside node lies between, in the order of the card.
    axes : callable
        The element frame (e, 3, 3), unit vectors as rows, from the nodes (e, n, 3).
    """

    card: str
    linear: Linear
    quadratic: Quadratic
    edges: tuple[tuple[int, int], ...]
    axes: Callable[[Any_], Any_] = field(repr=False)

    @property
    def corners(self) -> int:
        """Number of corner nodes."""
        return int(self.linear.stiffness.values.shape[1])

    def present(self, model: Model, at: Int) -> Bool:
        """Which nodes rows `at` (e,) have, (e, n)."""
        t = model[self.card]
        count = self.corners + len(self.edges)
        out = np.zeros((at.size, count), dtype=bool)
        out[:, : self.corners] = True
        for k in range(self.corners, count):
            if f"G{k + 1}" in t.columns:
                out[:, k] = t[f"G{k + 1}"][at] > 0
        return out

    def build(self, m: Mesh, card: str, at: Int) -> Matrices:
        """Matrices of rows `at` (e,), which have the same midside nodes and kind of material (see
        `same_midsides`).

        Raises
        ------
        InputError
            If their midside nodes differ.
        DeckError
            If an element is inside out or has no volume.
        UnsupportedCard
            If a property is that of a fluid.
        """
        present = self.present(m.model, at)
        if (present != present[0]).any():
            raise InputError(
                f"{card}: rows with different midside nodes in one batch; split them by "
                "solid.same_midsides"
            )
        t = m.model[card]
        names = [f"G{k + 1}" for k in np.flatnonzero(present[0])]
        nodes = m.nodes(np.stack([t[name][at] for name in names], axis=1), t, at)
        x = m.xyz[nodes]
        if (flat := self._flat(x.real)).any():
            raise card_error(m.model, t, int(at[flat][0]), "it has no volume; check its nodes")
        row = lookup(m.model, "PSOLID", t["PID"][at], table=t, at=at)
        _refuse_fluid(m.model, row)
        material: Isotropic | Anisotropic
        if is_anisotropic(m.model, t["PID"][at[:1]])[0]:
            material = anisotropic(m, row, x, self.axes(x))
        else:
            material = moduli(m, row)
        if (bad := self._inside_out(x.real, present[0])).any():
            why = (
                "inside out or too distorted (its Jacobian is not positive); check its node "
                "order: the corners go "
                "round one face, then round the opposite one, not row by row"
            )
            raise card_error(m.model, t, int(at[bad][0]), why)
        K, _, rule = self._stiffness(x, material, present[0])
        M = mass(x, material.rho, rule, m.model.param("COUPMASS", -1) > 0)
        return Matrices(
            dofs=node_dofs(nodes, 3),
            stiffness=K,
            mass=M,
            loss=material.loss,
            viscous=np.empty((0, K.shape[1], K.shape[1])),
        )

    def _flat(self, x: Float) -> Bool:
        """Which elements (e,) with nodes x (e, n, 3) are collapsed to a plane, a line or a
        point.
        """
        det = determinants(self.linear.stiffness.derivatives, x[:, : self.corners])
        return np.asarray(
            (abs(det) <= FLAT * np.ptp(x, axis=1).max(axis=1)[:, None] ** 3).any(axis=1)
        )

    def _inside_out(self, x: Float, present: Bool) -> Bool:
        """Which elements (e,) with nodes x (e, n, 3) have a Jacobian that is not positive at a
        point of their rules.
        """
        if present[self.corners :].any():
            points = [kept(self.quadratic.stiffness, self.edges, present).derivatives]
        else:
            points = [self.linear.stiffness.derivatives]
            points += [] if self.linear.centre is None else [self.linear.centre]
        return np.asarray((determinants(np.concatenate(points), x) <= 0).any(axis=1))

    def _stiffness(
        self, x: Any_, material: Isotropic | Anisotropic, present: Bool
    ) -> tuple[Any_, Any_, SolidRule]:
        """Stiffness, determinants, and the rule for the mass; in slices that stay in the cache."""
        size = max(1, _CACHED // (3 * present.sum()) ** 2)
        parts = [
            self._slice(x[k : k + size], _part(material, k, size), present)
            for k in range(0, len(x), size)
        ]
        return (
            np.concatenate([p[0] for p in parts]),
            np.concatenate([p[1] for p in parts]),
            parts[0][2],
        )

    def _slice(
        self, x: Any_, material: Isotropic | Anisotropic, present: Bool
    ) -> tuple[Any_, Any_, SolidRule]:
        if not present[self.corners :].any():
            lin = self.linear
            if lin.pressure is not None:
                return *projected(x, material, lin.stiffness, lin.pressure), lin.mass
            return *kernel(
                x, material, lin.stiffness, bubbles=lin.bubbles, centre=lin.centre
            ), lin.mass
        rules = [
            kept(r, self.edges, present) for r in (self.quadratic.stiffness, self.quadratic.mass)
        ]
        return *projected(x, material, rules[0], self.quadratic.pressure), rules[1]


def _refuse_fluid(model: Model, row: Int) -> None:
    p = model["PSOLID"]
    fluid = np.char.startswith(p["FCTN"][row].astype(str), "PFLUID")
    if fluid.any():
        raise unsupported_card(
            model, p, int(row[fluid][0]), "is a fluid (FCTN PFLUID); allowed is SMECH or blank"
        )


def _part(material: Isotropic | Anisotropic, first: int, size: int) -> Isotropic | Anisotropic:
    """Elements first..first + size - 1 of a material."""
    return type(material)(
        *(getattr(material, f.name)[first : first + size] for f in fields(material))
    )


def same_midsides(shape: Shape, model: Model, at: Int) -> Iterable[Int]:
    """The rows `at` (e,) in groups with the same midside nodes and kind of material."""
    present = shape.present(model, at)
    other = is_anisotropic(model, model[shape.card]["PID"][at])
    code = np.column_stack([present[:, shape.corners :], other]) @ (
        1 << np.arange(len(shape.edges) + 1)
    )
    for c in np.unique(code):
        yield at[code == c]


def kernel(
    x: Any_,
    material: Isotropic | Anisotropic,
    rule: SolidRule,
    bubbles: Float | None = None,
    centre: Float | None = None,
) -> tuple[Any_, Any_]:
    """Stiffness (e, 3n, 3n) and the determinants (e, gp) of the map."""
    _, det, g = jacobian(rule.derivatives, x)
    w = det * rule.weights
    n = g.shape[2]
    if bubbles is not None and centre is not None:
        J0, det0, _ = jacobian(centre, x)
        g = np.concatenate(
            [g, incompatible(bubbles, J0[:, 0], det0[:, 0], det=det, weights=w)], axis=2
        )
    A = gram(g, w)
    if isinstance(material, Anisotropic):
        K = general(A, material.tensor)
    else:
        K = elastic(A, *solid(material.E, material.nu), material.shear)
    if bubbles is not None:
        K = condense(K, np.arange(3 * n), np.arange(3 * n, K.shape[1]))
    return K, det


def projected(
    x: Any_, material: Isotropic | Anisotropic, rule: SolidRule, pressure: Float
) -> tuple[Any_, Any_]:
    """As `kernel`, with the dilatation of an isotropic body projected on `pressure` (gp, k),
    against locking.

    The B-bar method (Hughes 1980) with the least squares fit over the element: constant strains are
    untouched.
    """
    if isinstance(material, Anisotropic) or pressure.shape[0] == pressure.shape[1]:
        return kernel(x, material, rule)
    _, det, g = jacobian(rule.derivatives, x)
    w = det * rule.weights
    kappa, c11, c12 = bulk(material)
    K = elastic(gram(g, w), c11, c12, material.shear)
    moment = np.einsum("eg,gk,egna->ekna", w, pressure, g).reshape(len(g), pressure.shape[1], -1)
    H = np.einsum("eg,gk,gl->ekl", w, pressure, pressure)
    return K + scaled(kappa, moment.swapaxes(1, 2) @ np.linalg.solve(H, moment)), det


def general(A: Any_, C: Any_) -> Any_:
    """Stiffness (e, 3n, 3n), K[i,p,j,q] = C[p,a,q,b] ∫ ∂aNi ∂bNj, from the Gram matrix (e, n, 3, n,
    3).
    """
    e, n = A.shape[:2]
    flat = A.transpose(0, 1, 3, 2, 4).reshape(e, n * n, 9)
    K = flat @ C.transpose(0, 2, 4, 1, 3).reshape(e, 9, 9)
    return K.reshape(e, n, n, 3, 3).transpose(0, 1, 3, 2, 4).reshape(e, 3 * n, 3 * n)


def mass(x: Any_, rho: Any_, rule: SolidRule, coupled: bool) -> Any_:
    """Consistent (e, 3n, 3n), or lumped by its scaled diagonal (e, 3n) (Hinton, Rock and
    Zienkiewicz 1976).
    """
    w = determinants(rule.derivatives, x) * rule.weights
    n = rule.values.shape[1]
    if coupled:
        scalar = np.einsum("eg,gi,gj->eij", w, rule.values, rule.values)
        return scaled(rho, np.einsum("eij,ab->eiajb", scalar, np.eye(3)).reshape(-1, 3 * n, 3 * n))
    diagonal = np.einsum("eg,gi->ei", w, rule.values**2)
    share = diagonal * (w.sum(1) / diagonal.sum(1))[:, None]
    return scaled(rho, np.repeat(share, 3, axis=1))
