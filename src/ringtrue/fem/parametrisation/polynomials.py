"""K and M as polynomials of the factors of the parameters: products of powers times fixed matrices.

On the elements of a region the same parameters act. Their matrices are an anchored decomposition
(Rabitz and Alış 1999, sec. 3): what each parameter does by itself, and what several do together
beyond that, as E and T of a shell. The coefficients follow from the kernels at as many factors as
there are products, and a further point proves them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.fem.assembly import WHOLE, Share, Sum, reduced
from ringtrue.fem.element_cards import batches
from ringtrue.fem.mesh import Mesh, Rows
from ringtrue.fem.parametrisation.element_derivatives import SPAN
from ringtrue.fem.parametrisation.parameter_groups import (
    INVALID,
    ParameterGroup,
    Region,
    built,
    few,
)


class ParameterFunction(Protocol):
    """A function of the factors a (P,) of all parameters that is 0 at the nominal model.

    Attributes
    ----------
    which : tuple of int
        Positions of those that it depends on.
    """

    @property
    def which(self) -> tuple[int, ...]: ...

    def value(self, a: Float) -> float:
        """At the factors."""

    def derivative(self, a: Float, i: int) -> float:
        """The derivative to a_i."""


@dataclass(frozen=True, slots=True)
class Product:
    """Π (a_i^p_i - 1): 0 wherever one of its factors is 1.

    Attributes
    ----------
    which, exponents : tuple of int
        Positions of the parameters, and the exponent of each.
    """

    which: tuple[int, ...]
    exponents: tuple[int, ...]

    def value(self, a: Float) -> float:
        """See `ParameterFunction`."""
        return prod(
            float(a[i]) ** p - 1.0
            for i, p in zip(self.which, self.exponents, strict=True)
        )

    def derivative(self, a: Float, i: int) -> float:
        """See `ParameterFunction`."""
        own = {
            j: (float(a[j]), p) for j, p in zip(self.which, self.exponents, strict=True)
        }
        if i not in own:
            return 0.0
        x, p = own.pop(i)
        return p * x ** (p - 1) * prod(y**q - 1.0 for y, q in own.values())


def power(which: int, exponent: int = 1) -> Product:
    """a^exponent - 1 of the factor of one parameter."""
    return Product((which,), (exponent,))


@dataclass(frozen=True, slots=True, eq=False)
class AffineTerm:
    """A part of K and M, (f, f) csr float64, and the function that it goes with."""

    function: ParameterFunction
    stiffness: sparse.csr_array
    mass: sparse.csr_array


SAMPLE = 40  # elements of a kind whose matrices show the powers
MOST_PRODUCTS = 1024  # of a region; one of more is interpolated
NODES = np.array([1.0, 2.0, 0.5, 3.0])  # factors at which powers are distinguished
CUBIC = (1, 2, 3)
# of the factor of each group, 0 where it does not take part
Exponents = tuple[int, ...]


def own_powers(m: Mesh, g: ParameterGroup) -> tuple[int, ...] | None:
    """The powers of its factor that a group's matrices hold; None if they are no cubic of it.

    They are seen in a sample of its elements: values at 1, -1 and i give the coefficients of a
    cubic without loss of digits, a further point proves it.
    """
    if g.matrix:
        return (1,)
    check = 1.37
    rows = few(g.rows, SAMPLE)
    try:
        # a rational dependence may have its pole at a point
        with np.errstate(all="ignore"):
            at = {a: _entries(m, (g,), rows, (a,)) for a in (1, -1, 1j, check)}
    except INVALID:  # a section that has a limit, such as the thickness of a laminate
        return None
    found = set[int]()
    for k in range(2):
        one, other, turned, there = (at[a][k] for a in (1, -1, 1j, check))
        even = (one + other) / 2
        odd = (one - other) / 2
        c = np.stack(
            [
                even + turned.real,
                odd + turned.imag,
                even - turned.real,
                odd - turned.imag,
            ]
        )
        c = c / 2
        if not largest(check ** np.arange(4) @ c - there) <= 1e-10 * largest(there):
            return None
        found |= {p for p in CUBIC if largest(c[p]) > 1e-13 * largest(one)}
    return tuple(sorted(found))


def largest(a: Any_) -> float:
    """The largest absolute entry."""
    return float(np.abs(a).max(initial=0.0))


def _entries(
    m: Mesh,
    groups: Sequence[ParameterGroup],
    rows: Rows,
    factors: Sequence[float | complex],
) -> tuple[Any_, Any_]:
    """All entries of the elements' K, and of their M, end to end."""
    made = built(m, groups, rows, factors)
    stiffness = np.concatenate([np.empty(0), *(p.stiffness.ravel() for p in made)])
    mass = np.concatenate([np.empty(0), *(p.mass.ravel() for p in made)])
    return stiffness, mass


class PolynomialTerms:
    """The sum of the polynomials of all elements, by parameters and exponents.

    Parameters
    ----------
    m : Mesh
    powers : mapping of ParameterGroup to tuple of int
        Those of its factor by itself.
    share : Share
        Whose elements are summed.
    """

    def __init__(
        self,
        m: Mesh,
        powers: Mapping[ParameterGroup, tuple[int, ...]],
        share: Share = WHOLE,
    ) -> None:
        self._mesh = m
        self._powers = powers
        self._share = share
        self._sums: dict[Product, tuple[Sum, Sum]] = {}

    def add(self, region: Region) -> Rows:
        """Add the elements of a region; those of all shares that are no polynomials are left and
        returned.
        """
        powers = [self._powers[g] for g in region.groups]
        if prod(1 + len(p) for p in powers) > MOST_PRODUCTS:
            return region.rows
        products = self._products(region, powers)
        left: Rows = {}
        own = self._share.own(self._mesh.model, region.rows)
        for card, every in batches(self._mesh.model, own):
            for first in range(0, every.size, SPAN):
                at = every[first : first + SPAN]
                if not self._added(region, {card: at}, products):
                    left[card] = np.union1d(left.get(card, at[:0]), at)
        return self._share.joined(left, region.rows)

    def _products(
        self, region: Region, powers: Sequence[tuple[int, ...]]
    ) -> list[Exponents]:
        """The products that the matrices of a sample hold, and all that these are multiples of."""
        every = list(itertools.product(*((0, *p) for p in powers)))
        if len(powers) == 1:
            return every
        rows = few(region.rows, SAMPLE)
        points = NODES[np.array(every)]
        try:
            with np.errstate(all="ignore"):
                values = [
                    _entries(self._mesh, region.groups, rows, a)
                    for a in points.tolist()
                ]
        except INVALID:
            return every
        shares = np.linalg.inv(_basis(every, points))
        held = np.zeros(len(every), dtype=bool)
        for k in range(2):
            matrices = np.stack([v[k] for v in values])
            noise = 1e-12 * largest(matrices[0])
            held |= np.abs(shares @ matrices).max(axis=1, initial=0.0) > noise
        exponents = np.array(every)
        divides = np.all(exponents[:, None] <= exponents[held], axis=2)
        return [
            p for p, multiples in zip(every, divides, strict=True) if multiples.any()
        ]

    def _added(self, region: Region, rows: Rows, products: Sequence[Exponents]) -> bool:
        """Add elements of one kind; False where they are no polynomials."""
        if self._fitted(region, rows, products):
            return True
        # others than those of the sample may have further powers
        whole = [self._powers[g] if g.matrix else CUBIC for g in region.groups]
        every = list(itertools.product(*((0, *p) for p in whole)))
        return len(every) <= MOST_PRODUCTS and self._fitted(region, rows, every)

    def _fitted(
        self, region: Region, rows: Rows, products: Sequence[Exponents]
    ) -> bool:
        check = np.array([1.78 + 0.07 * i for i in range(len(region.groups))])
        points = NODES[np.array(products)]
        factors = [*points.tolist(), check.tolist()]
        try:
            with np.errstate(all="ignore"):  # a pole is found by what does not hold
                made = [built(self._mesh, region.groups, rows, a)[0] for a in factors]
        except INVALID:
            return False
        basis = _basis(products, points)
        there = _basis(products, check[None])[0]
        coefficients = []
        for matrices in ([p.stiffness for p in made], [p.mass for p in made]):
            values = np.stack(matrices[:-1])
            c = np.linalg.solve(basis, values.reshape(len(points), -1))
            if not largest(there @ c - matrices[-1].ravel()) <= 1e-9 * largest(
                matrices[-1]
            ):
                return False
            c[np.abs(c).max(axis=1, initial=0.0) <= 1e-12 * largest(values[0])] = 0.0
            coefficients.append(c.reshape(values.shape))
        size = self._mesh.size
        for exponents, K, M in zip(products, *coefficients, strict=True):
            each = zip(region.groups, exponents, strict=True)
            taking_part = sorted((g.which, p) for g, p in each if p)
            if taking_part and (K.any() or M.any()):
                product = Product(*zip(*taking_part, strict=True))
                stiffness, mass = self._sums.setdefault(product, (Sum(size), Sum(size)))
                stiffness.add(made[0].dofs, K)
                mass.add(made[0].dofs, M)
        return True

    def terms(self, transform: sparse.csr_array) -> list[AffineTerm]:
        """The sums in the free degrees of freedom, fewer parameters first; the same ones in all
        shares.
        """
        wtmass = self._mesh.model.param("WTMASS", 1.0)
        every = {*self._sums, *self._of_all_shares()}
        size = self._mesh.size
        out = []
        for product in sorted(
            every, key=lambda p: (len(p.which), p.which, p.exponents)
        ):
            K, M = self._sums.get(product) or (Sum(size), Sum(size))
            mass = sparse.csr_array(M.total() * wtmass)
            stiffness = reduced(transform, K.total())
            out.append(AffineTerm(product, stiffness, reduced(transform, mass)))
        return out

    def _of_all_shares(self) -> Iterator[Product]:
        """The products that any share has sums of."""
        own = [np.array([len(p.which), *p.which, *p.exponents]) for p in self._sums]
        every = self._share.gathered(
            np.concatenate([np.empty(0, dtype=np.int64), *own])
        ).tolist()
        while every:
            n = every[0]
            yield Product(tuple(every[1 : 1 + n]), tuple(every[1 + n : 1 + 2 * n]))
            every = every[1 + 2 * n :]


def _basis(products: Sequence[Exponents], points: Float) -> Float:
    """The products (second axis) at the points (k, groups)."""
    p = np.array(products)
    return np.asarray(np.where(p > 0, points[:, None] ** p - 1.0, 1.0).prod(axis=2))
