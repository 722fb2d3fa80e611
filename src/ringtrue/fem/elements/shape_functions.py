"""Shape functions, sampling and integration of the shells with assumed strains: CQUAD8, CTRIA6, and
of CQUAD4 and CTRIA3 on a curve.

Each covariant strain is sampled as a directional strain at tying points, from which a polynomial
carries it to the integration points:

* CQUAD8: transverse shear after MITC8 (Bathe and Dvorkin 1986), of which e_rt is in span{1, r, s,
  rs, s²} from r = ±1/√3, s = ±1, and the mean of r = ±1/√3 on s = 0, which is blind to what eight
  nodes lack of a quadratic w; in the plane e_rr from r = ±1/√3, s = 0, ±√0.6, e_rs from 2 x 2
  points (Huang and Hinton 1986).
* CTRIA6: MITC6 (Lee and Bathe 2004): e_rr, e_ss, e_qq and the shear are linear, the shear from two
  points a side.

Shape functions at the points of a quadrature, and what becomes of them when midside nodes are
left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.model.cards import QUADRILATERAL, TRIANGLE, ElementShape

_A = 1 / np.sqrt(3)
_B = np.sqrt(0.6)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Directional strains at points (k, 2) along `direction` (k, 2) in (r, s), and the way to the
    integration points.

    `carry` (gp, c, k) gives the covariant components: (e_rr, e_ss, 2 e_rs), or (γ_r, γ_s).
    """

    points: Float
    direction: Float
    carry: Float


@dataclass(frozen=True, slots=True, eq=False)
class ShellRule:
    """A shell of the first or second order: points (gp, 2), weights (gp,) and assumed strains."""

    shape: ElementShape
    order: int
    points: Float
    weights: Float
    plane: Samples
    shear: Samples

    @property
    def corners(self) -> int:
        """Number of corners."""
        return len(self.shape.corners)

    @property
    def nodes(self) -> Float:
        """Natural coordinates (k, 2) of the nodes."""
        return self.shape.nodes(self.order)

    @property
    def sides(self) -> Int:
        """The corners (s, 2) that each midside node lies between."""
        return np.array(self.shape.edges)

    def shapes(self, p: Float) -> tuple[Float, Float]:
        """Shape functions (p, k) and natural derivatives (p, k, 2)."""
        return self.shape.functions(self.order, p)

    def corner_shapes(self, p: Float) -> Float:
        """The linear shapes of the corners (p, corners)."""
        return self.shape.functions(1, p)[0]


def _grid(r: Float, s: Float) -> Float:
    a, b = np.meshgrid(r, s, indexing="ij")
    return np.stack([a.ravel(), b.ravel()], axis=1)


def _lagrange(nodes: Float, x: Float) -> Float:
    """Lagrange polynomials (x, nodes)."""
    return np.asarray(np.linalg.solve(np.vander(nodes).T, np.vander(x, nodes.size).T).T)


def _outer(a: Float, b: Float) -> Float:
    return np.asarray(np.einsum("gi,gj->gij", a, b).reshape(len(a), -1))


def _quad_plane(p: Float) -> Samples:
    two = np.array([-_A, _A])
    three = np.array([-_B, 0.0, _B])
    r, s = p.T
    points = np.vstack(
        [_grid(two, three), _grid(three, two), _grid(two, two), _grid(two, two)]
    )
    direction = np.repeat(
        [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]], [6, 6, 4, 4], axis=0
    )
    carry = np.zeros((len(p), 3, 20))
    carry[:, 0, :6] = _outer(_lagrange(two, r), _lagrange(three, s))
    carry[:, 1, 6:12] = _outer(_lagrange(three, r), _lagrange(two, s))
    # 2 e_rs = (e along r + s less e along r - s)/2
    both = _outer(_lagrange(two, r), _lagrange(two, s)) / 2
    carry[:, 2, 12:16] = both
    carry[:, 2, 16:] = -both
    return Samples(points, direction, carry)


def _quad_shear(p: Float) -> Samples:
    two = np.array([-_A, _A])
    three = np.array([-1.0, 0.0, 1.0])

    def along(r: Float, s: Float) -> Float:
        """γ_r from points (r, s) of two x three: on s = 0 only the mean."""
        across = _lagrange(three, s)
        slope = np.stack([(1 - s) / 2, 0 * s, (1 + s) / 2], axis=1)
        both = [across / 2 + sign * (r / (2 * _A))[:, None] * slope for sign in (-1, 1)]
        return np.concatenate(both, axis=1)

    points = np.vstack([_grid(two, three), _grid(two, three)[:, ::-1]])
    carry = np.zeros((len(p), 2, 12))
    carry[:, 0, :6] = along(p[:, 0], p[:, 1])
    carry[:, 1, 6:] = along(p[:, 1], p[:, 0])
    return Samples(points, np.repeat([[1.0, 0.0], [0.0, 1.0]], 6, axis=0), carry)


def _linear(points: Float, p: Float) -> Float:
    """The linear function of three values, (p, 3)."""
    one = np.ones((len(p), 1))
    return np.linalg.solve(
        np.hstack([np.ones((3, 1)), points]).T, np.hstack([one, p]).T
    ).T


def _triangle_plane(p: Float) -> Samples:
    near = (1 - _A) / 2
    far = (1 + _A) / 2
    rr = np.array([[near, 0.0], [far, 0.0], [near, _A]])
    qq = np.array([[near, far], [far, near], [near, near]])
    direction = np.repeat([[1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]], 3, axis=0)
    carry = np.zeros((len(p), 3, 9))
    carry[:, 0, :3] = _linear(rr, p)
    carry[:, 1, 3:6] = _linear(rr[:, ::-1], p)
    carry[:, 2, :3], carry[:, 2, 3:6] = carry[:, 0, :3], carry[:, 1, 3:6]
    carry[:, 2, 6:] = -_linear(qq, p)  # e_qq = e_rr + e_ss - 2 e_rs
    return Samples(np.vstack([rr, rr[:, ::-1], qq]), direction, carry)


def _triangle_shear(p: Float) -> Samples:
    """(γ_r, γ_s) in P1 x P1 + (s, -r) span{r, s}: two points a side and both components at the
    centre.
    """

    def basis(x: Float) -> Float:
        r, s = x.T
        one = np.ones(len(x))
        zero = np.zeros(len(x))
        first = np.stack([one, r, s, zero, zero, zero, r * s, s * s], axis=1)
        return np.stack(
            [first, np.stack([zero, zero, zero, one, r, s, -r * r, -r * s], axis=1)],
            axis=1,
        )

    near = (1 - _A) / 2
    far = (1 + _A) / 2
    points = np.array(
        [
            [near, 0],
            [far, 0],
            [0, near],
            [0, far],
            [near, far],
            [far, near],
            [1 / 3, 1 / 3],
            [1 / 3, 1 / 3],
        ]
    )
    direction = np.repeat([[1.0, 0.0], [0.0, 1.0], [-1.0, 1.0], [1.0, 0.0]], 2, axis=0)
    direction[7] = 0.0, 1.0
    fit = np.linalg.inv(np.einsum("kc,kcj->kj", direction, basis(points)))
    return Samples(points, direction, np.einsum("pcj,jk->pck", basis(p), fit))


def _flat_triangle_rule() -> ShellRule:
    """Three nodes: constant strains, one transverse shear a side."""
    first, second = np.array(TRIANGLE.edges).T
    corners = TRIANGLE.nodes(1)
    middle = (corners[first] + corners[second]) / 2
    direction = corners[second] - corners[first]
    p = np.array([[1, 1], [4, 1], [1, 4]]) / 6
    # of e along r, along s - r and along s: 2 e_rs = e_rr + e_ss - e along s - r
    strains = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, -1.0, 1.0]])
    plane = Samples(middle, direction, np.tile(strains, (3, 1, 1)))
    shear = Samples(middle, direction, np.zeros((3, 2, 3)))
    return ShellRule(
        TRIANGLE, 1, points=p, weights=np.full(3, 1 / 6), plane=plane, shear=shear
    )


def _flat_rule() -> ShellRule:
    """Four nodes: strains of the displacements, transverse shear of the MITC4 (Dvorkin and Bathe
    1984).
    """
    p = QUADRILATERAL.nodes(1) * _A
    w = np.ones(4)
    k = np.arange(4)
    carry = np.zeros((4, 3, 16))
    carry[k, 0, k] = 1.0
    carry[k, 1, 4 + k] = 1.0
    carry[k, 2, 8 + k] = 0.5
    carry[k, 2, 12 + k] = -0.5
    direction = np.repeat([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]], 4, axis=0)
    plane = Samples(np.tile(p, (4, 1)), direction, carry)
    r, s = p.T
    zero = 0 * r
    low = np.stack([(1 - s) / 2, (1 + s) / 2, zero, zero], axis=1)
    side = np.stack([zero, zero, (1 - r) / 2, (1 + r) / 2], axis=1)
    middle = np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]])
    shear = Samples(
        middle,
        np.repeat([[1.0, 0.0], [0.0, 1.0]], 2, axis=0),
        np.stack([low, side], axis=1),
    )
    return ShellRule(QUADRILATERAL, 1, points=p, weights=w, plane=plane, shear=shear)


def _quad_rule() -> ShellRule:
    x, w = np.polynomial.legendre.leggauss(3)
    p = _grid(x, x)
    weights = np.outer(w, w).ravel()
    plane = _quad_plane(p)
    shear = _quad_shear(p)
    return ShellRule(
        QUADRILATERAL, 2, points=p, weights=weights, plane=plane, shear=shear
    )


def _triangle_rule() -> ShellRule:
    # six points, degree four (Dunavant 1985)
    a = 0.445948490915965
    b = 0.091576213509771
    dense = np.array(
        [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a], [b, b], [1 - 2 * b, b], [b, 1 - 2 * b]]
    )
    wide = np.repeat([0.223381589678011, 0.109951743655322], 3) / 2
    plane = _triangle_plane(dense)
    shear = _triangle_shear(dense)
    return ShellRule(TRIANGLE, 2, points=dense, weights=wide, plane=plane, shear=shear)


QUAD4 = _flat_rule()
TRIA3 = _flat_triangle_rule()
QUAD8 = _quad_rule()
TRIA6 = _triangle_rule()


@dataclass(frozen=True, slots=True, eq=False)
class SolidRule:
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


def folded(ends: Sequence[tuple[int, int]], present: Bool) -> Float:
    """What each node of the whole element is of those that are there, (n, present) float64; see
    `kept`.
    """
    absent = np.flatnonzero(~present)
    fold = np.eye(present.size)
    fold[absent, absent] = 0.0
    fold[absent[:, None], np.asarray(ends)[absent - (present.size - len(ends))]] = 0.5
    return fold[:, present]


def kept(rule: SolidRule, ends: Sequence[tuple[int, int]], present: Bool) -> SolidRule:
    """The rule of an element of which only the nodes `present` (n,) exist; the corners come first.

    Midside node k, on the edge from corner ends[k][0] to ends[k][1], is the mean of these two where
    it is absent, in place and in motion: the edge is straight and linear, and meets the linear edge
    of a neighbour.
    """
    fold = folded(ends, present)
    return SolidRule(
        rule.values @ fold,
        np.einsum("gnr,nk->gkr", rule.derivatives, fold),
        rule.weights,
    )


def triangle(degree: int) -> tuple[Float, Float]:
    """Points (gp, 2) and weights (gp,) on the unit triangle, exact to degree 2 or 5 (Hammer and
    Stroud 1956).
    """
    if degree <= 2:
        return np.array([[1, 1], [4, 1], [1, 4]]) / 6, np.full(3, 1 / 6)
    root = np.sqrt(15)
    a = (6 - root) / 21
    b = (6 + root) / 21
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
