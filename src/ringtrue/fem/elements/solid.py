"""What the solid elements share: stiffness and mass from shape functions at integration points.

CHEXA: 8 nodes with enhanced strains (Andelfinger and Ramm 1993), as in Nastran; 9 to 20
serendipity.

CPENTA: 6 nodes as in Nastran (`wedge`), or under PARAM,RESBEND,NO with incompatible modes 1 - ζ²
and the three edge bubbles of the triangle; 7 to 15 serendipity.

CPYRAM with 5 nodes, or 6 to 13: the pyramid as a hexahedron with a face drawn together
(Bedrosian 1992).

On the natural pyramid with base [-1, 1]² and apex (0, 0, 1), ξ = a (1 - ζ) and η = b (1 - ζ). In
(a, b, ζ) the rational shape functions are polynomials, and the quadrature is a product that keeps
off the apex.

CTETRA with 4 nodes (constant strain) or 5 to 10 (isoparametric, four points).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.special import roots_jacobi

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.fem.elements import wedge
from ringtrue.fem.elements.elasticity import (
    Anisotropic,
    anisotropic,
    between,
    bulk,
    by_normal,
    determinants,
    elastic,
    elasticity_matrix,
    gram,
    in_cartesian,
    incompatible,
    is_anisotropic,
    jacobian,
    moduli,
    nearest,
    solid,
)
from ringtrue.fem.elements.shape_functions import (
    SolidRule,
    cube,
    folded,
    kept,
    line,
    triangle,
)
from ringtrue.fem.mesh import (
    CardRows,
    ElementMatrices,
    Isotropic,
    condense,
    node_dofs,
    scaled,
    taken,
)
from ringtrue.model.cards import HEXAHEDRON, QUADRILATERAL, TETRAHEDRON, TRIANGLE, WEDGE
from ringtrue.model.model import Model, Table

# numbers in the matrices of a slice: with its temporaries it stays in the cache of one core
_CACHED = 2**16
# of a tensor in the order of PAIRS
_ENTRY = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
FLAT = 1e-12  # of the cube on the longest extent: less volume is none


@dataclass(frozen=True, slots=True, eq=False)
class EnhancedStrains:
    """Strains that an element has besides those of its shape functions; they are condensed out.

    Attributes
    ----------
    values : (gp, m) float64
        Each is of mean zero.
    pair : (m,) int
        Which entry of PAIRS it stands in, in natural coordinates.
    """

    values: Float
    pair: Int


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """An element with corner nodes only.

    Attributes
    ----------
    stiffness, mass : Rule
    bubbles : (gp, m, 3) float64
        Natural derivatives of incompatible modes, which are condensed out.
    centre : (1, n, 3) float64
        Derivatives of the shape functions where those modes, or the enhanced strains, take their
        Jacobian.
    pressure : (gp, k) float64
        What the dilatation is projected on, for an element without bubbles.
    enhanced : EnhancedStrains, optional
        In place of incompatible modes.
    as_nastran : callable, optional
        Stiffness (e, 3n, 3n) from places (e, n, 3) and material, in place of all this but under
        PARAM,RESBEND,NO.
    """

    stiffness: SolidRule
    mass: SolidRule
    bubbles: Float | None = None
    centre: Float | None = None
    pressure: Float | None = None
    enhanced: EnhancedStrains | None = None
    as_nastran: Callable[[Any_, Isotropic | Anisotropic], Any_] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Quadratic:
    """An element with all its midside nodes.

    Attributes
    ----------
    stiffness, mass : Rule
    pressure : (gp, k) float64
        What the dilatation is projected on; as many columns as points leave it as it is.
    shares : callable
        Of the lumped mass, by node (e, n), from the places (e, n, 3) of all nodes; None where the
        consistent matrix says them.
    """

    stiffness: SolidRule
    mass: SolidRule
    pressure: Float
    shares: Callable[[Any_], Any_] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SolidShape:
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

    def present(self, t: Table, at: Int) -> Bool:
        """Which nodes rows `at` (e,) of its table have, (e, n)."""
        count = self.corners + len(self.edges)
        out = np.ones((at.size, count), dtype=bool)
        for k in range(self.corners, count):
            name = f"G{k + 1}"
            out[:, k] = t[name][at] > 0 if name in t.columns else False
        return out

    def kinds(self, model: Model, at: Int) -> Int:
        """Midside nodes and kind of material of rows `at` (e,), (e, k): rows that differ in these
        need calls of `build` of their own.
        """
        t = model[self.card]
        other = is_anisotropic(model, t["PID"][at])
        return np.column_stack([self.present(t, at), other]).astype(np.int64)

    def build(self, t: CardRows) -> ElementMatrices:
        """Matrices of rows that have the same midside nodes and kind of material (see `kinds`).

        Raises
        ------
        DeckError
            If an element is inside out or has no volume.
        UnsupportedCard
            If a property is that of a fluid.
        """
        m = t.mesh
        present = self.present(t.table, t.at[:1])[0]
        nodes = t.nodes(*(f"G{k + 1}" for k in np.flatnonzero(present)))
        x = m.xyz[nodes]
        t.refuse(self._flat(x.real), "it has no volume; check its nodes")
        p = t.named("PSOLID")
        fluid = np.char.startswith(p["FCTN"].astype(str), "PFLUID")
        p.refuse_unsupported(
            fluid, "is a fluid (FCTN PFLUID); allowed is SMECH or blank"
        )
        material: Isotropic | Anisotropic
        if is_anisotropic(m.model, t["PID"][:1])[0]:
            material = anisotropic(p, x, self.axes(x))
        else:
            material = moduli(p)
        t.refuse(
            self._inside_out(x.real, present),
            "inside out or too distorted (its Jacobian is not positive); check its node order: the "
            "corners go round one face, then round the opposite one, not row by row",
        )
        refined = m.model.param("RESBEND", 1.0) <= 0
        K, rule = self._stiffness(x, material, present, refined)
        return ElementMatrices(
            dofs=node_dofs(nodes, 3),
            stiffness=K,
            mass=mass(x, material.rho, rule, m.coupled_mass, self._shares(x, present)),
            loss=material.loss,
        )

    def _shares(self, x: Any_, present: Bool) -> Any_ | None:
        """Of the lumped mass, by node that is there (e, n) from their places (e, n, 3); an absent
        midside node leaves its own to its corners.
        """
        if self.quadratic.shares is None or not present[self.corners :].any():
            return None
        fold = folded(self.edges, present)
        return self.quadratic.shares(fold @ x) @ fold

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
        self, x: Any_, material: Isotropic | Anisotropic, present: Bool, refined: bool
    ) -> tuple[Any_, SolidRule]:
        """Stiffness and the rule for the mass; in slices that stay in the cache."""
        size = max(1, _CACHED // (3 * present.sum()) ** 2)
        lin = self.linear
        linear = not present[self.corners :].any()
        rule, pressure, of_mass = lin.stiffness, lin.pressure, lin.mass
        if not linear:
            rule, of_mass = (
                kept(r, self.edges, present)
                for r in (self.quadratic.stiffness, self.quadratic.mass)
            )
            pressure = self.quadratic.pressure
        parts = []
        for first in range(0, len(x), size):
            at = slice(first, first + size)
            some = taken(material, at)
            if linear and lin.as_nastran is not None and not refined:
                parts.append(lin.as_nastran(x[at], some))
            elif linear and lin.enhanced is not None:
                assert lin.centre is not None
                parts.append(enhanced(x[at], some, rule, lin.enhanced, lin.centre))
            elif pressure is not None:
                parts.append(projected(x[at], some, rule, pressure))
            else:
                parts.append(
                    kernel(x[at], some, rule, bubbles=lin.bubbles, centre=lin.centre)
                )
        return np.concatenate(parts), of_mass


def kernel(
    x: Any_,
    material: Isotropic | Anisotropic,
    rule: SolidRule,
    bubbles: Float | None = None,
    centre: Float | None = None,
) -> Any_:
    """Stiffness (e, 3n, 3n)."""
    _, det, g = jacobian(rule.derivatives, x)
    w = det * rule.weights
    n = g.shape[2]
    if bubbles is not None and centre is not None:
        J0, det0, _ = jacobian(centre, x)
        soft = incompatible(bubbles, J0[:, 0], det0[:, 0], det=det, weights=w)
        g = np.concatenate([g, soft], axis=2)
    A = gram(g, w)
    if isinstance(material, Anisotropic):
        K = general(A, material.tensor)
    else:
        K = elastic(A, *solid(material.E, material.nu), material.shear)
    return condense(K, slice(3 * n), slice(3 * n, None)) if bubbles is not None else K


def enhanced(
    x: Any_,
    material: Isotropic | Anisotropic,
    rule: SolidRule,
    strains: EnhancedStrains,
    centre: Float,
) -> Any_:
    """As `kernel`, with enhanced strains (Simo and Rifai 1990), in the natural axes at the centre:
    constant strains are untouched on any distortion.
    """
    _, det, g = jacobian(rule.derivatives, x)
    e, points, n, _ = g.shape
    m = strains.pair.size
    J0 = jacobian(centre, x)[0][:, 0]
    # rows: gradients of the natural coordinates
    natural = np.linalg.inv(J0).swapaxes(1, 2)
    length = np.sqrt((natural * natural).sum(axis=2, keepdims=True))
    natural = natural / length  # else those of thin cells differ by decades
    shape = strains.values / det[:, :, None]
    # (e, gp, 6, m)
    soft = in_cartesian(natural)[:, None, :, strains.pair] * shape[:, :, None]
    stress = (
        elasticity_matrix(material)[:, None]
        @ soft
        * (det * rule.weights)[:, :, None, None]
    )
    full = stress[:, :, _ENTRY].transpose(0, 1, 3, 2, 4).reshape(e, points * 3, 3 * m)
    coupling = g.transpose(0, 2, 1, 3).reshape(e, n, points * 3) @ full
    rows = (e, points * 6, m)
    K = np.zeros((e, 3 * n + m, 3 * n + m), dtype=coupling.dtype)
    K[:, : 3 * n, : 3 * n] = kernel(x, material, rule)
    K[:, : 3 * n, 3 * n :] = coupling.reshape(e, 3 * n, m)
    K[:, 3 * n :, : 3 * n] = K[:, : 3 * n, 3 * n :].swapaxes(1, 2)
    K[:, 3 * n :, 3 * n :] = soft.reshape(rows).swapaxes(1, 2) @ stress.reshape(rows)
    return condense(K, slice(3 * n), slice(3 * n, None))


def projected(
    x: Any_, material: Isotropic | Anisotropic, rule: SolidRule, pressure: Float
) -> Any_:
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
    moment = np.einsum("eg,gk,egna->ekna", w, pressure, g).reshape(
        len(g), pressure.shape[1], -1
    )
    H = np.einsum("eg,gk,gl->ekl", w, pressure, pressure)
    return K + scaled(kappa, moment.swapaxes(1, 2) @ np.linalg.solve(H, moment))


def general(A: Any_, C: Any_) -> Any_:
    """Stiffness (e, 3n, 3n), K[i,p,j,q] = C[p,a,q,b] ∫ ∂aNi ∂bNj, from the Gram matrix (e, n, 3, n,
    3).
    """
    e, n = A.shape[:2]
    flat = A.transpose(0, 1, 3, 2, 4).reshape(e, n * n, 9)
    K = flat @ C.transpose(0, 2, 4, 1, 3).reshape(e, 9, 9)
    return K.reshape(e, n, n, 3, 3).transpose(0, 1, 3, 2, 4).reshape(e, 3 * n, 3 * n)


def mass(
    x: Any_, rho: Any_, rule: SolidRule, coupled: bool, shares: Any_ | None = None
) -> Any_:
    """Consistent (e, 3n, 3n); or lumped (e, 3n) by `shares` (e, n), without them by the scaled
    diagonal (Hinton, Rock and Zienkiewicz 1976).
    """
    w = determinants(rule.derivatives, x) * rule.weights
    if coupled:
        points, n = rule.values.shape
        products = rule.values[:, :, None] * rule.values[:, None, :]
        scalar = (rho[:, None] * w) @ products.reshape(points, n * n)
        out = np.zeros((len(x), n, 3, n, 3), dtype=scalar.dtype)
        for a in range(3):
            out[:, :, a, :, a] = scalar.reshape(-1, n, n)
        return out.reshape(len(x), 3 * n, 3 * n)
    diagonal = shares
    if shares is None:
        diagonal = np.einsum("eg,gi->ei", w, rule.values**2)
        diagonal = diagonal / diagonal.sum(1)[:, None]
    share = diagonal * w.sum(1)[:, None]
    return np.asarray(rho[:, None] * np.repeat(share, 3, axis=1))


def _hexa_axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the centres of opposite faces (Quick Reference
    Guide, CHEXA).
    """
    R = between(x, [0, 3, 4, 7], [1, 2, 5, 6])
    S = between(x, [0, 1, 4, 5], [2, 3, 6, 7])
    T = between(x, [0, 1, 2, 3], [4, 5, 6, 7])
    return nearest(np.stack([R, S, T], axis=1))


def _hexa_strains(p: Float) -> EnhancedStrains:
    """At points p (gp, 3): what direct strains and shears lack of complete linear functions, and
    its products with the other coordinates.
    """
    x, y, z = p.T
    by_pair = (
        (x, x * y, x * z),
        (y, y * z, y * x),
        (z, z * x, z * y),
        (x, y, x * z, y * z),
        (y, z, y * x, z * x),
        (z, x, z * y, x * y),
    )
    pair = np.repeat(np.arange(6), [len(values) for values in by_pair])
    return EnhancedStrains(
        np.column_stack([v for values in by_pair for v in values]), pair
    )


_HEXA_POINTS = HEXAHEDRON.nodes(1) / np.sqrt(3)
_HEXA_RULE = SolidRule(*HEXAHEDRON.functions(1, _HEXA_POINTS), np.ones(8))
_HEXA_P, _HEXA_W = cube(3)
_HEXA_FULL = SolidRule(*HEXAHEDRON.functions(2, _HEXA_P), _HEXA_W)
HEXA = SolidShape(
    card="CHEXA",
    linear=Linear(
        _HEXA_RULE,
        _HEXA_RULE,
        centre=HEXAHEDRON.functions(1, np.zeros((1, 3)))[1],
        enhanced=_hexa_strains(_HEXA_POINTS),
    ),
    quadratic=Quadratic(_HEXA_FULL, _HEXA_FULL, HEXAHEDRON.functions(1, _HEXA_P)[0]),
    edges=HEXAHEDRON.edges,
    axes=_hexa_axes,
)


def _penta_bubbles(p: Float) -> Float:
    """Derivatives (gp, 4, 3) of 1 - ζ² and of the three edge bubbles of the triangle."""
    d = np.zeros((len(p), 4, 3))
    d[:, 0, 2] = -2 * p[:, 2]
    d[:, 1:, :2] = TRIANGLE.functions(2, p[:, :2])[1][:, 3:] / 4
    return d


def _penta_axes(x: Any_) -> Any_:
    """x and y in the middle surface, x from the middle of G1-G4 to that of G2-G5 (Quick Reference
    Guide, CPENTA).
    """
    return by_normal(between(x, [0, 3], [1, 4]), between(x, [0, 3], [2, 5]))


_PENTA_FINE, _PENTA_FINE_W = wedge.product(triangle(5), line(3))
_PENTA_FULL = SolidRule(*WEDGE.functions(2, _PENTA_FINE), _PENTA_FINE_W)
PENTA = SolidShape(
    card="CPENTA",
    linear=Linear(
        wedge.RULE,
        wedge.RULE,
        bubbles=_penta_bubbles(wedge.POINTS),
        centre=wedge.CENTRE,
        as_nastran=wedge.kernel,
    ),
    quadratic=Quadratic(
        _PENTA_FULL,
        _PENTA_FULL,
        np.column_stack([np.ones(len(_PENTA_FINE)), _PENTA_FINE]),
    ),
    edges=WEDGE.edges,
    axes=_penta_axes,
)


_PYRAMID_SIGNS = QUADRILATERAL.nodes(1)
_PYRAMID_MIDDLES = QUADRILATERAL.nodes(2)[4:]
PYRAMID_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))


def _pyramid_faces(p: Float, signs: Float) -> tuple[Float, Float]:
    """Products over a and b of 1 + s a, or of 1 - a² where s is 0: (gp, 4), and derivatives (gp, 4,
    2).
    """
    q = p[:, None, :2]
    f = np.where(signs == 0, 1 - q**2, 1 + q * signs)
    df = np.where(signs == 0, -2 * q, np.broadcast_to(signs, f.shape))
    return f.prod(axis=2), np.stack(
        [df[..., 0] * f[..., 1], df[..., 1] * f[..., 0]], axis=2
    )


def _pyramid_times(
    base: tuple[Float, Float], h: Float, dh: Float
) -> tuple[Float, Float]:
    """Functions of (a, b) times h(ζ) (gp,): values (gp, 4), derivatives (gp, 4, 3) by (a, b, ζ)."""
    f, df = base
    return f * h[:, None], np.concatenate(
        [df * h[:, None, None], (f * dh[:, None])[..., None]], axis=2
    )


def _pyramid_linear(p: Float) -> tuple[Float, Float]:
    """Values (gp, 5) and derivatives (gp, 5, 3) at points (a, b, ζ)."""
    z = p[:, 2]
    value, d = _pyramid_times(
        _pyramid_faces(p, _PYRAMID_SIGNS), (1 - z) / 4, np.full(len(p), -0.25)
    )
    apex = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(p), 1, 3))
    return np.concatenate([value, z[:, None]], axis=1), np.concatenate(
        [d, apex], axis=1
    )


def pyramid_quadratic(p: Float) -> tuple[Float, Float]:
    """Values (gp, 13) and derivatives (gp, 13, 3) by (a, b, ζ) at points (a, b, ζ)."""
    z = p[:, 2]
    base, d_base = _pyramid_times(
        _pyramid_faces(p, _PYRAMID_MIDDLES), (1 - z) ** 2 / 2, z - 1
    )
    rise, d_rise = _pyramid_times(
        _pyramid_faces(p, _PYRAMID_SIGNS), z * (1 - z), 1 - 2 * z
    )
    middle = np.concatenate([base, rise], axis=1)
    d_middle = np.concatenate([d_base, d_rise], axis=1)
    half = np.zeros((len(PYRAMID_EDGES), 5))
    half[np.arange(len(PYRAMID_EDGES))[:, None], np.array(PYRAMID_EDGES)] = 0.5
    corner, d_corner = _pyramid_linear(p)  # made zero at the midside nodes
    corner = corner - middle @ half
    d_corner = d_corner - np.einsum("gmr,mn->gnr", d_middle, half)
    return np.concatenate([corner, middle], axis=1), np.concatenate(
        [d_corner, d_middle], axis=1
    )


def _pyramid_conical(n: int) -> tuple[Float, Float]:
    """Gauss points (a, b, ζ) and weights on the pyramid; the factor (1 - ζ)² is left to the
    Jacobian.
    """
    x, w = line(n)
    t, v = roots_jacobi(n, 2, 0)
    z = (t + 1) / 2
    points = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.einsum("i,j,k->ijk", w, w, v / 8 / (1 - z) ** 2).ravel()


def _pyramid_axes(x: Any_) -> Any_:
    """z from the middle of the base to the apex, y normal to it and to the line from edge G1-G4 to
    G2-G3.
    """
    z = between(x, [0, 1, 2, 3], [4])
    r = between(x, [0, 3], [1, 2])
    y = np.cross(z, r)
    rows = np.stack([np.cross(y, z), y, z], axis=1)
    return np.asarray(rows / np.sqrt((rows * rows).sum(axis=2, keepdims=True)))


_PYRAMID_P, _PYRAMID_W = _pyramid_conical(2)
PYRAMID_RULE = SolidRule(*_pyramid_linear(_PYRAMID_P), _PYRAMID_W)
_PYRAMID_FINE, _PYRAMID_FINE_W = _pyramid_conical(3)
PYRAMID_FULL = SolidRule(*pyramid_quadratic(_PYRAMID_FINE), _PYRAMID_FINE_W)
_PYRAMID_RISE = 1 - _PYRAMID_FINE[:, 2]
PYRAMID = SolidShape(
    card="CPYRAM",
    linear=Linear(PYRAMID_RULE, PYRAMID_RULE, pressure=np.ones((len(_PYRAMID_P), 1))),
    quadratic=Quadratic(
        PYRAMID_FULL,
        PYRAMID_FULL,
        np.column_stack(
            [
                np.ones(len(_PYRAMID_RISE)),
                _PYRAMID_FINE[:, 0] * _PYRAMID_RISE,
                _PYRAMID_FINE[:, 1] * _PYRAMID_RISE,
                _PYRAMID_FINE[:, 2],
            ]
        ),
    ),
    edges=PYRAMID_EDGES,
    axes=_pyramid_axes,
)


def _tetra_conical(n: int) -> tuple[Float, Float]:
    """Gauss-Jacobi product rule on the unit tetrahedron, exact to degree 2n - 1 (Stroud 1971)."""
    x, wx = roots_jacobi(n, 2, 0)
    y, wy = roots_jacobi(n, 1, 0)
    z, wz = roots_jacobi(n, 0, 0)
    a, b, c = (
        g.ravel()
        for g in np.meshgrid((x + 1) / 2, (y + 1) / 2, (z + 1) / 2, indexing="ij")
    )
    w = np.einsum("i,j,k->ijk", wx / 8, wy / 4, wz / 2).ravel()
    return np.stack([a, b * (1 - a), c * (1 - a) * (1 - b)], axis=1), w


def _tetra_axes(x: Any_) -> Any_:
    """As near as can be to the lines that join the middles of opposite edges (Quick Reference
    Guide, CTETRA).
    """
    lines = (([0, 1], [2, 3]), ([0, 2], [1, 3]), ([0, 3], [1, 2]))
    return nearest(np.stack([between(x, a, b) for a, b in lines], axis=1))


_TETRA_A = (5 - np.sqrt(5)) / 20
_TETRA_B = (5 + 3 * np.sqrt(5)) / 20
_TETRA_FOUR = np.full((4, 3), _TETRA_A) + (_TETRA_B - _TETRA_A) * np.eye(4)[:, :3]
_TETRA_FOUR_W = np.full(4, 1 / 24)
_TETRA_ONE = np.full((1, 3), 0.25)
_TETRA_FINE, _TETRA_FINE_W = _tetra_conical(3)


def _tetra_shares(x: Any_) -> Any_:
    """Of the lumped mass, by node (e, 10) at x (e, 10, 3), as recorded of MSC Nastran.

    None at the corners. A tenth at each midside node, with which the second moments are right; the
    rest by the distance from the midside node of the opposite edge to the power -3/2, found from
    recorded frequencies. Opposite edges have equal shares, so that the centre of gravity is right.
    """
    # midside nodes less those of the opposite edges
    across = x[:, 4:] - x[:, [9, 7, 8, 5, 6, 4]]
    near = (across * across).sum(axis=2) ** -0.75
    out = np.zeros(x.shape[:2], dtype=near.dtype)
    out[:, 4:] = 0.1 + 0.4 * near / near.sum(axis=1, keepdims=True)
    return out


TETRA = SolidShape(
    card="CTETRA",
    linear=Linear(
        SolidRule(*TETRAHEDRON.functions(1, _TETRA_ONE), np.array([1 / 6])),
        SolidRule(*TETRAHEDRON.functions(1, _TETRA_FOUR), _TETRA_FOUR_W),
    ),
    quadratic=Quadratic(
        SolidRule(*TETRAHEDRON.functions(2, _TETRA_FOUR), _TETRA_FOUR_W),
        SolidRule(*TETRAHEDRON.functions(2, _TETRA_FINE), _TETRA_FINE_W),
        np.eye(4),
        _tetra_shares,
    ),
    edges=TETRAHEDRON.edges,
    axes=_tetra_axes,
)
