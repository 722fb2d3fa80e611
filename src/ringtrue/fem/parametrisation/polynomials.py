"""Scalar functions of the parameters' factors that are 0 at the nominal model: products of powers,
or any other.

Parameters of which K and M are polynomials: products of powers of their factors, times fixed
matrices.

They are decomposed at the nominal model (an anchored decomposition; Rabitz and Alış 1999, sec. 3):
what each parameter does by itself, and, where several act on the same elements, what they do
together beyond that, as E and T of a shell. Three and more are looked at where any two of them do
something together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from math import prod
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.core.progress import Progress, part
from ringtrue.errors import UnsupportedError
from ringtrue.fem.assembly import System, full_matrices, reduced
from ringtrue.fem.element_cards import batches
from ringtrue.fem.mesh import Matrices, Mesh, Rows, common, union
from ringtrue.fem.parametrisation.parameter_groups import (
    CHECK,
    INVALID,
    Group,
    Pair,
    built,
    cubic,
    few,
    largest_entry,
)
from ringtrue.model.model import Model


class Function(Protocol):
    """A function of the factors a (P,) of all parameters.

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
        """See `Function`."""
        return prod(float(a[i]) ** p - 1.0 for i, p in zip(self.which, self.exponents, strict=True))

    def derivative(self, a: Float, i: int) -> float:
        """See `Function`."""
        own = {j: (float(a[j]), p) for j, p in zip(self.which, self.exponents, strict=True)}
        x, p = own.pop(i, (0.0, 0))
        return p * x ** (p - 1) * prod(y**q - 1.0 for y, q in own.values()) if p else 0.0


def power(which: int, exponent: int = 1) -> Product:
    """a^exponent - 1 of the factor of one parameter."""
    return Product((which,), (exponent,))


@dataclass(frozen=True, slots=True, eq=False)
class AffineTerm:
    """A part of K and M, (f, f) csr float64, and the function that it goes with."""

    function: Function
    stiffness: sparse.csr_array
    mass: sparse.csr_array


NODES = (2.0, 0.5, 3.0)  # factors at which powers are distinguished
SAMPLE = 40  # elements of a kind that tell what several do together
AT_ONCE = 16  # sets whose samples are evaluated together
HELD = 200_000  # element matrices of samples that are kept
KEPT = 5000  # elements of which the matrices at all points fit into memory
# relative: error allowed, no such part below
HOLDS = 1e-9
NOISE = 1e-12
Exponents = tuple[int, ...]
Member = tuple[int, Group, Exponents]  # its number, and the exponents that it has by itself
Set = tuple[Sequence[Member], Rows]  # groups that act on the same elements, and the rows of these
At = Callable[
    [tuple[float, ...]], Any
]  # factors of the groups -> K and M of elements, as arrays or sparse


def products(
    m: Mesh,
    groups: Mapping[int, Group],
    linear: Collection[int],
    system: System,
    progress: Progress,
) -> tuple[list[AffineTerm], set[int]]:
    """The terms of groups, by their numbers; where some are no polynomials, by themselves or
    together, only which.

    `linear` are those of which a sample of elements is.
    """
    every = list[Member]()
    sums = dict[tuple[int, int], list[Pair]]()
    lost = set[int]()
    for k, g in groups.items():
        progress(0.7 * len(every) / len(groups), f"derivatives: {g.parameter.name}")
        try:
            parts = _alone(m, g, linear=k in linear)
        except UnsupportedError:
            lost.add(k)
            continue
        every.append((k, g, tuple(parts) or (1,)))
        for exponent, pair in parts.items():
            sums.setdefault((g.which, exponent), []).append(pair)
    if lost:
        return [], lost
    out = [_term(power(*which), _total(pairs), system) for which, pairs in sorted(sums.items())]
    pairs = list(_pairs(every))
    two = _joint(m, [s for _, s in pairs], system, part(progress, 0.7, 0.85))
    met = [at for (at, _), found in zip(pairs, two, strict=True) if found]
    larger = list(_larger(every, met))
    more = _joint(m, larger, system, part(progress, 0.85, 1.0))
    for (some, _), found in zip([*(s for _, s in pairs), *larger], [*two, *more], strict=True):
        if found is None:  # without one of them the others may be polynomials
            lost.add(min(some, key=lambda one: sum(at.size for at in one[1].rows.values()))[0])
    return [*out, *(t for found in (*two, *more) for t in found or ())], lost


def _alone(m: Mesh, g: Group, *, linear: bool) -> dict[int, Pair]:
    """The parts of a polynomial."""
    if linear:
        with suppress(UnsupportedError):  # other elements may have higher powers
            return cubic(m, g, linear=True)
    return cubic(m, g)


def _total(pairs: Sequence[Pair]) -> Pair:
    K, M = pairs[0]
    for k, mass in pairs[1:]:
        K = sparse.csr_array(K + k)
        M = sparse.csr_array(M + mass)
    return K, M


def _term(function: Product, pair: Pair, system: System) -> AffineTerm:
    return AffineTerm(
        function, reduced(system.transform, pair[0]), reduced(system.transform, pair[1])
    )


def _pairs(every: Sequence[Member]) -> Iterator[tuple[tuple[int, int], Set]]:
    """Groups of two parameters that act on the same elements, and which they are."""
    near = _overlap([g for _, g, _ in every])
    for i, j in np.argwhere(np.triu(near, 1)).tolist():
        first = every[i][1]
        second = every[j][1]
        if first.which != second.which and (both := common(first.rows, second.rows)):
            yield (i, j), ([every[i], every[j]], both)


def _larger(every: Sequence[Member], pairs: Sequence[tuple[int, int]]) -> Iterator[Set]:
    """Groups of three and more, any two of which do something together: `pairs`."""
    near = np.zeros((len(every), len(every)), dtype=np.bool_)
    for i, j in pairs:
        near[i, j] = near[j, i] = True
    sets = [((i, j), common(every[i][1].rows, every[j][1].rows)) for i, j in pairs]
    while sets:
        larger: list[tuple[tuple[int, ...], Rows]] = []
        for at, rows in sets:
            for j in np.flatnonzero(near[list(at)].all(axis=0)).tolist():
                if j > at[-1] and (both := common(rows, every[j][1].rows)):
                    larger.append(((*at, j), both))
                    yield [every[i] for i in (*at, j)], both
        sets = larger  # type: ignore[assignment]


def _overlap(groups: Sequence[Group]) -> Bool:
    """Which groups have elements in common, (g, g)."""
    cards = {card: i for i, card in enumerate(sorted({card for g in groups for card in g.rows}))}
    wide = 1 + max((int(at.max(initial=0)) for g in groups for at in g.rows.values()), default=0)
    of, at = np.hstack(
        [np.empty((2, 0), dtype=np.int64)]
        + [
            np.stack([np.full(at.size, i), cards[c] * wide + at])
            for i, g in enumerate(groups)
            for c, at in g.rows.items()
        ]
    )
    member = sparse.csr_array((np.ones(of.size), (of, at)), shape=(len(groups), len(cards) * wide))
    return np.asarray((member @ member.T).toarray() > 0.0)


def _joint(
    m: Mesh, sets: Sequence[Set], system: System, progress: Progress
) -> list[list[AffineTerm] | None]:
    """What the groups of each set do together, beyond what fewer of them do: empty where that is
    nothing.

    None where it is no polynomial of their own powers.
    """
    found: dict[int, list[AffineTerm] | None] = {}
    for some in _apart(m.model, sets):
        progress(len(found) / len(sets), "derivatives: parameters on the same elements")
        for i, sample in zip(some, _samples(m, [sets[i] for i in some]), strict=True):
            try:
                found[i] = _terms(m, *sets[i], sample, system)
            except INVALID:
                found[i] = None
    return [found[i] for i in range(len(sets))]


def _apart(model: Model, sets: Sequence[Set]) -> Iterator[list[int]]:
    """Sets at whose factors the kernels can be called once: of like powers, and none feels the
    fields of another.
    """
    made: dict[object, list[tuple[list[int], dict[str, Bool]]]] = {}
    for i, (some, _) in enumerate(sets):
        like = made.setdefault(
            tuple((powers, g.parameter.upper, g.matrix) for _, g, powers in some), []
        )
        reach = [(c, at) for _, g, _ in some for c, at in g.reach.items()]
        scaled = any(
            g.matrix for _, g, _ in some
        )  # a factor on matrices holds for all that are built
        for batch, taken in [] if scaled else like:
            if len(batch) < AT_ONCE and not any(
                taken[c][at].any() for c, at in reach if c in taken
            ):
                break
        else:
            batch = list[int]()
            taken = dict[str, Bool]()
            like.append((batch, taken))
        batch.append(i)
        for c, at in reach:
            taken.setdefault(c, np.zeros(len(model[c]), dtype=bool))[at] = True
    yield from (batch for like in made.values() for batch, _ in like)


def _samples(m: Mesh, sets: Sequence[Set]) -> list[At]:
    """K and M of a few elements of each set, end to end, as functions of the factors of its
    groups.
    """
    sampled = [few(rows, SAMPLE) for _, rows in sets]
    rows = union(sampled)
    places = [
        [np.isin(there, some.get(c, ())) for c, _, there in batches(m.model, rows)]
        for some in sampled
    ]
    side_by_side = zip(*([g for _, g, _ in some] for some, _ in sets), strict=True)
    groups = [
        replace(like[0], targets=tuple(t for g in like for t in g.targets)) for like in side_by_side
    ]

    @lru_cache(maxsize=HELD // max(sum(at.size for at in rows.values()), 1))
    def every(a: tuple[float, ...]) -> list[list[Float]]:
        made = built(m, groups, rows, a)
        return [[_ends(made, name, pick) for name in ("stiffness", "mass")] for pick in places]

    def sample(k: int, a: tuple[float, ...]) -> list[Float]:
        try:
            return every(a)[k]
        except INVALID:
            if len(sets) == 1:
                raise
        found: list[Float] = _samples(m, [sets[k]])[0](
            a
        )  # it may be another set that does not allow them
        return found

    return [partial(sample, k) for k in range(len(sets))]


def _ends(parts: Sequence[Matrices], name: str, picks: Sequence[Bool]) -> Float:
    """Matrices of some elements end to end."""
    return np.concatenate(
        [getattr(p, name)[pick].ravel() for p, pick in zip(parts, picks, strict=True)]
    )


def _terms(
    m: Mesh, some: Sequence[Member], rows: Rows, sample: At, system: System
) -> list[AffineTerm] | None:
    """What the groups do together, beyond what fewer of them do; `sample` is of a few of the
    rows.
    """
    groups = [g for _, g, _ in some]
    every = list(itertools.product(*(powers for _, _, powers in some)))
    noise = [NOISE * largest_entry(x) for x in sample((1.0,) * len(some))]
    beyond = _together(sample, tuple(g.parameter.upper**0.4 for g in groups))
    if all(largest_entry(x) <= least for x, least in zip(beyond, noise, strict=True)):
        return []

    def full(a: tuple[float, ...]) -> Pair:
        return full_matrices(m, built(m, groups, rows, a))

    whole = cache(full) if sum(at.size for at in rows.values()) < KEPT else full
    with np.errstate(all="ignore"):  # a pole is found by what does not hold
        there = dict(_parts(sample, some, every, noise))
        if not all(_holds(sample, there, a) for a in _checks(len(some))):
            return None
        parts = dict(_parts(whole, some, list(there), noise))
        if not _holds(whole, parts, _checks(len(some))[0]):
            return None
    which = tuple(g.which for g in groups)
    return [_term(Product(which, exponents), pair, system) for exponents, pair in parts.items()]


def _parts(
    at: At, some: Sequence[Member], wanted: Sequence[Exponents], noise: Sequence[float]
) -> Iterator[tuple[Exponents, Any]]:
    """K and M that go with each of the wanted products, where they are above `noise`."""
    nodes = [NODES[: len(powers)] for _, _, powers in some]
    values = [
        np.array([[a**p - 1.0 for a in n] for p in powers]).T
        for n, (_, _, powers) in zip(nodes, some, strict=True)
    ]
    shares: Float = np.ones((1, 1))
    for v in values:
        shares = np.asarray(np.kron(shares, np.linalg.inv(v)))  # up to 3 by 3
    found = [_together(at, a) for a in itertools.product(*nodes)]
    for exponents, row in zip(
        itertools.product(*(powers for _, _, powers in some)), shares.tolist(), strict=True
    ):
        if exponents in wanted:
            pair = [
                sum(c * x for c, x in zip(row, each, strict=True))
                for each in zip(*found, strict=True)
            ]
            if any(largest_entry(x) > least for x, least in zip(pair, noise, strict=True)):
                yield (
                    exponents,
                    tuple(
                        x if largest_entry(x) > least else x * 0
                        for x, least in zip(pair, noise, strict=True)
                    ),
                )


def _checks(n: int) -> list[tuple[float, ...]]:
    """Factors of n groups at which products must hold, other than those that distinguish them."""
    return [tuple(CHECK + abs(share - 0.07 * i) for i in range(n)) for share in (0.41, 0.13, 0.87)]


def _holds(at: At, parts: Mapping[Exponents, Any], a: tuple[float, ...]) -> bool:
    """Whether the products are all that the groups do together, relative to the largest entry of K
    or M there.
    """
    factors = np.array(a)
    own = tuple(range(len(a)))
    for i, (true, there) in enumerate(zip(_together(at, a), at(a), strict=True)):
        rest = true - sum(Product(own, e).value(factors) * pair[i] for e, pair in parts.items())
        if not largest_entry(rest) <= HOLDS * largest_entry(there):
            return False
    return True


def _together(at: At, a: tuple[float, ...]) -> list[Any_]:
    """Mixed difference of K and M: the sum over each factor at its value and, with the other sign,
    at 1.
    """
    total: list[Any_] = []
    for on in itertools.product((True, False), repeat=len(a)):
        sign = (-1.0) ** (len(on) - sum(on))
        parts = [sign * x for x in at(tuple(x if o else 1.0 for x, o in zip(a, on, strict=True)))]
        total = [x + y for x, y in zip(total, parts, strict=True)] if total else parts
    return total
