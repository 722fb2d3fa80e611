"""Shape functions at the points of a quadrature, and what becomes of them when midside nodes are
left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """Shape functions at the points of a quadrature.

    Attributes
    ----------
    values : (gp, n) float64
    derivatives : (gp, n, 3) float64, natural
    weights : (gp,) float64
    """

    values: Float
    derivatives: Float
    weights: Float


def kept(rule: Rule, ends: Sequence[tuple[int, int]], present: Bool) -> Rule:
    """The rule of an element of which only the nodes `present` (n,) exist; the corners come first.

    Midside node k, on the edge from corner ends[k][0] to ends[k][1], is the mean of these two where
    it is absent, in place and in motion: the edge is straight and linear, and meets the linear edge
    of a neighbour.
    """
    corners = rule.values.shape[1] - len(ends)
    absent = np.flatnonzero(~present)
    fold = np.eye(present.size)
    fold[absent, absent] = 0.0
    fold[absent[:, None], np.asarray(ends)[absent - corners]] = 0.5
    fold = fold[:, present]
    return Rule(rule.values @ fold, np.einsum("gnr,nk->gkr", rule.derivatives, fold), rule.weights)


def triangle(degree: int) -> tuple[Float, Float]:
    """Points (gp, 2) and weights (gp,) on the unit triangle, exact to degree 2 or 5 (Hammer and
    Stroud 1956).
    """
    if degree <= 2:
        return np.array([[1, 1], [4, 1], [1, 4]]) / 6, np.full(3, 1 / 6)
    root = np.sqrt(15)
    a, b = (6 - root) / 21, (6 + root) / 21
    points = [[1 / 3, 1 / 3]] + [
        p for c in (a, b) for p in ([c, c], [1 - 2 * c, c], [c, 1 - 2 * c])
    ]
    weights = np.repeat([9 / 80, (155 - root) / 2400, (155 + root) / 2400], [1, 3, 3])
    return np.array(points), weights


def line(n: int) -> tuple[Float, Float]:
    """Gauss points (n,) and weights (n,) on [-1, 1]."""
    return np.polynomial.legendre.leggauss(n)


def cube(n: int) -> tuple[Float, Float]:
    """Gauss points (n³, 3) and weights (n³,) on the cube [-1, 1]³."""
    x, w = line(n)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.einsum("i,j,k->ijk", w, w, w).ravel()


def over(
    ends: Sequence[tuple[int, int]], corner: Float, d_corner: Float, middle: Float, d_middle: Float
) -> tuple[Float, Float]:
    """Values (gp, n) and derivatives (gp, n, 3): linear functions made zero at the midside nodes,
    then the latter's.
    """
    half = np.zeros((len(ends), corner.shape[1]))
    half[np.arange(len(ends))[:, None], np.asarray(ends)] = 0.5
    d = np.concatenate([d_corner - np.einsum("gmr,mn->gnr", d_middle, half), d_middle], axis=1)
    return np.concatenate([corner - middle @ half, middle], axis=1), d
