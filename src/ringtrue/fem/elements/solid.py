"""What the solid elements share: stiffness and mass from shape functions at integration points."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.algebra import condense, scaled
from ringtrue.fem.isotropy import elastic, gram, incompatible, jacobian, solid
from ringtrue.fem.mesh import Isotropic, Matrices, Mesh, error, isotropic, lookup
from ringtrue.fem.place import node_dofs


class Rule:
    """Shape functions at the points of a quadrature.

    Attributes
    ----------
    values : (gp, n) float64
    derivatives : (gp, n, 3) float64, natural
    weights : (gp,) float64
    """

    __slots__ = ("derivatives", "values", "weights")

    def __init__(self, values: Float, derivatives: Float, weights: Float) -> None:
        self.values, self.derivatives, self.weights = values, derivatives, weights


def kernel(
    x: Float, iso: Isotropic, rule: Rule, bubbles: Float | None = None, centre: Float | None = None
) -> tuple[Any_, Float]:
    """Stiffness (e, 3n, 3n) and the determinants (e, gp) of the map.

    `bubbles` (gp, m, 3) are the natural derivatives of incompatible modes, condensed out; `centre` (1, n, 3) the
    derivatives of the shape functions where those modes take their Jacobian.
    """
    _, det, g = jacobian(rule.derivatives, x)
    w = det * rule.weights
    n = g.shape[2]
    if bubbles is not None and centre is not None:
        J0, det0, _ = jacobian(centre, x)
        g = np.concatenate([g, incompatible(bubbles, J0[:, 0], det0[:, 0], det, w)], axis=2)
    c11, c12 = solid(iso.E, iso.nu)
    K = elastic(gram(g, w), c11, c12, iso.G)
    if bubbles is not None:
        K = condense(K, np.arange(3 * n), np.arange(3 * n, K.shape[1]))
    return K, det


def mass(x: Float, rho: Any_, rule: Rule, coupled: bool) -> Any_:
    """Consistent (e, 3n, 3n), or lumped by its scaled diagonal (e, 3n) (Hinton, Rock and Zienkiewicz 1976)."""
    w = jacobian(rule.derivatives, x)[1] * rule.weights
    n = rule.values.shape[1]
    if coupled:
        scalar = np.einsum("eg,gi,gj->eij", w, rule.values, rule.values)
        return scaled(rho, np.einsum("eij,ab->eiajb", scalar, np.eye(3)).reshape(-1, 3 * n, 3 * n))
    diagonal = np.einsum("eg,gi->ei", w, rule.values**2)
    share = diagonal * (w.sum(1) / diagonal.sum(1))[:, None]
    return scaled(rho, np.repeat(share, 3, axis=1))


def assemble(m: Mesh, card: str, at: Int, names: list[str], rules: tuple[Rule, Rule], *extra: Float) -> Matrices:
    """Matrices of rows `at` of a solid card; rules for stiffness and mass; `extra` are bubbles and centre.

    Raises
    ------
    DeckError
        If an element is inside out.
    """
    t = m.model[card]
    nodes = m.nodes(t.stack(*names)[at], t, at)
    row = lookup(m.model, "PSOLID", t["PID"][at], t, at)
    p = m.model["PSOLID"]
    iso = isotropic(m.model, p["MID"][row], p, row)
    x = m.xyz[nodes]
    K, det = kernel(x, iso, rules[0], *extra)
    if (det <= 0).any():
        bad = int(at[np.flatnonzero((det <= 0).any(axis=1))[0]])
        raise error(m.model, t, bad, "inside out or too distorted (its Jacobian is not positive); check its node order")
    M = mass(x, iso.rho, rules[1], m.model.param("COUPMASS", -1) > 0)
    return Matrices(node_dofs(nodes, 3), K, M, iso.loss, np.empty((0, K.shape[1], K.shape[1])))


def refuse_midside(m: Mesh, card: str, at: Int, first: int, last: int) -> None:
    """Raise UnsupportedCard if a row has any of the nodes Gfirst..Glast."""
    t = m.model[card]
    names = [f"G{i}" for i in range(first, last + 1) if f"G{i}" in t.columns]
    if names and (used := (t.stack(*names)[at] > 0).any(axis=1)).any():
        raise UnsupportedCard(card, why=f"{t.ids[at[used][0]]} has {first - 1}+ nodes; only corner nodes are supported")
