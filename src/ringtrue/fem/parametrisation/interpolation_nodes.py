"""Where matrices are kept, and the entries that tell their shares at other factors: what an
interpolation learns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import Parameter
from ringtrue.errors import UnsupportedError
from ringtrue.fem.mesh import Mesh, Rows
from ringtrue.fem.parametrisation.parameter_groups import (
    INVALID,
    Group,
    Region,
    Together,
    entries,
    owners,
    picked,
    roots,
)

# points that are looked at first, then twice as many, and how often
BLOCK = 16
BLOCKS = 7
MOST = 320  # matrices of a region
# relative to the roots of diagonal entries: left by the points seen, allowed at others
FITTED = 1e-10
HOLDS = 1e-8
MARGIN = 1.05  # by which the range exceeds the bounds

Found = Sequence[Float | None]


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """What determines the functions of a region.

    Attributes
    ----------
    factors : (r, P) float64
        Of all parameters, where the matrices are kept.
    rows : dict
        The elements whose entries are used.
    places : (r,) int64
        Of these among their `entries`.
    start, weights : (r,) float64
        The entries at nominal, and what scales them.
    values : (r, r) float64
        The scaled entries (second axis) at the nodes, less those at nominal.
    check : (P,) float64
        Factors that had no part in this, at which it holds.
    """

    factors: Float
    rows: Rows
    places: Int
    start: Float
    weights: Float
    values: Float
    check: Float

    def coefficients(self, found: Float) -> Float:
        """c (r,) from the `entries` of its rows at some factors."""
        return self.solved(self.scaled(found))

    def derivatives(self, found: Float) -> Float:
        """∂c (r,) from derivatives of the `entries` of its rows."""
        return self.solved(self.weights * found[self.places])

    def scaled(self, found: Float) -> Float:
        """What determines c (r,): the scaled entries, less those at nominal, from the `entries` of
        its rows.
        """
        return np.asarray(self.weights * (found[self.places] - self.start))

    def solved(self, changes: Float) -> Float:
        """c (r, ...) from scaled entries (r, ...) less those at nominal, or both their
        derivatives.
        """
        return np.asarray(np.linalg.solve(self.values.T, changes))


class _Learner:
    """What is kept of a region: factors (r, P), scaled entries (r, e) less those at nominal, and
    which tell it.
    """

    def __init__(
        self,
        region: Region,
        start: Float,
        weights: Float,
        axes: Sequence[Float],
        found: Found,
        most: int,
    ) -> None:
        self.region = region
        self.start = start
        self.weights = weights
        self.most = most
        self.factors = np.empty((0, axes[0].size))
        self.changes = np.empty((0, start.size))
        self.places = list[int]()
        self.learn(axes, found)

    def learn(self, factors: Sequence[Float], found: Found) -> Float | None:
        """See more points: one of them if what is kept holds at all of them, else keep what
        determines all best.
        """
        which = list(self.region.which)
        some = [
            (a, f)
            for a, f in zip(factors, found, strict=True)
            if f is not None and (a[which] != 1).any()
        ]
        if not some:
            return None
        scaled = np.array([f for _, f in some]) * self.weights
        changes = scaled - self.weights * self.start
        size = np.abs(scaled).max(axis=1, initial=1e-300)
        c = np.linalg.solve(self.changes[:, self.places].T, changes[:, self.places].T)
        rest = (changes - c.T @ self.changes) / size[:, None]
        if np.abs(rest).max(initial=0.0) < HOLDS:
            return np.asarray(some[-1][0])
        # chosen anew among all: what stood out by 1e-9 alone at few points is a poor node once
        # others are seen
        self.factors = np.vstack([self.factors, *(a for a, _ in some)])
        self.changes = np.vstack([self.changes, changes])
        size = np.abs(self.changes + self.weights * self.start).max(axis=1, initial=1e-300)
        nodes, self.places = _pivots(self.changes / size[:, None], self.most + 1)
        self.factors = self.factors[nodes]
        self.changes = self.changes[nodes]
        return None

    def nodes(self, m: Mesh, check: Float) -> Nodes:
        """The result, that held at `check`."""
        element = owners(m, self.region)
        used = np.unique(element[self.places])
        places = np.cumsum(np.isin(element, used))[self.places] - 1
        return Nodes(
            factors=self.factors,
            rows=picked(m, self.region.rows, used),
            places=places,
            start=self.start[self.places],
            weights=self.weights[self.places],
            values=self.changes[:, self.places],
            check=check,
        )


def _pivots(rest: Float, most: int) -> tuple[list[int], list[int]]:
    """Rows and columns of an elimination with complete pivots, in order, until nothing above
    `FITTED` is left.
    """
    rows = list[int]()
    columns = list[int]()
    live = np.flatnonzero(np.abs(rest).max(axis=0) > FITTED)
    rest = rest[:, live]
    while rest.size and len(rows) < most:
        i, j = divmod(int(np.abs(rest).argmax()), live.size)
        if not abs(rest[i, j]) > FITTED:
            break
        rows.append(i)
        columns.append(int(live[j]))
        rest -= np.outer(rest[:, j] / rest[i, j], rest[i])
    return rows, columns


def learn(m: Mesh, some: Sequence[Region], most: int = MOST) -> list[Nodes]:
    """What determines the functions of each region.

    The points lie first on the axes, where only one parameter is not at nominal, then anywhere
    between the bounds. No region feels the fields of a group that acts on another only
    (`parameter_groups.independent_batches`).

    Raises
    ------
    UnsupportedError
        If the entries of a region are no smooth functions between the bounds, or take more than
        `most` matrices.
    """
    axes, low, high = _box(some)
    one = np.ones_like(low)
    rng = np.random.default_rng(0)
    given = zip(
        some, entries(m, some, one), entries(m, some, one, roots), _at(m, some, axes), strict=True
    )
    learners = list[_Learner]()
    out = dict[int, Nodes]()
    for region, start, weights, found in given:
        if any(f is None for f in found):
            raise UnsupportedError(rough(region.groups))
        learners.append(
            _Learner(region=region, start=start, weights=weights, axes=axes, found=found, most=most)
        )
    count = BLOCK
    for _ in range(BLOCKS):
        waiting = [k for k in range(len(some)) if k not in out]
        if not waiting:
            break
        shares = (
            1 - np.cos(np.pi * rng.random((count, one.size)))
        ) / 2  # denser towards the bounds
        points = list(low * (high / low) ** shares)
        for k, found in zip(waiting, _at(m, [some[k] for k in waiting], points), strict=True):
            check = learners[k].learn(points, found)
            if len(learners[k].places) > most:
                raise UnsupportedError(rough(some[k].groups))
            if check is not None:
                out[k] = learners[k].nodes(m, check)
        count *= 2
    for k, region in enumerate(some):
        if k not in out:
            raise UnsupportedError(rough(region.groups))
    return [out[k] for k in range(len(some))]


def on_axis(p: Parameter) -> tuple[float, ...]:
    """Factors of a parameter by itself at which matrices are kept: at its bounds, a little widened,
    and half-way.
    """
    low = p.lower / MARGIN
    high = p.upper * MARGIN
    return low, high, low**0.5, high**0.5


def _box(some: Sequence[Region]) -> tuple[list[Float], Float, Float]:
    """Factors on the axes, and all lower and upper bounds (P,), a little widened."""
    parameters = {g.which: g.parameter for r in some for g in r.groups}
    low, high = np.ones((2, 1 + max(parameters)))
    for i, p in parameters.items():
        low[i], high[i] = on_axis(p)[:2]
    each = np.arange(low.size)
    return (
        [np.where(each == i, x, 1.0) for i in sorted(parameters) for x in on_axis(parameters[i])],
        low,
        high,
    )


def _at(m: Mesh, some: Sequence[Region], points: Sequence[Float]) -> list[list[Float | None]]:
    """Entries of each region at each of the points; None where a section does not allow these."""
    every = Together.of(m, some)
    each = [Together.of(m, [r]) for r in some]
    with np.errstate(all="ignore"):  # a pole between the bounds is found by what does not hold
        # it may be one of them that does not allow the factors
        found = [
            _tried(every, a) or [(_tried(one, a) or [None])[0] for one in each] for a in points
        ]
    return [list(of) for of in zip(*found, strict=True)]


def _tried(regions: Together, a: Float) -> list[Float | None]:
    """The entries at the factors; nothing where a section does not allow these."""
    try:
        return [f if np.isfinite(f).all() else None for f in regions.entries(a)]
    except INVALID:
        return []


def rough(groups: Sequence[Group]) -> str:
    """What is said of parameters that have no smooth functions."""
    names = " and ".join(
        f"{g.parameter.name} ({g.fields}, {g.parameter.lower:g} to {g.parameter.upper:g})"
        for g in groups
    )
    return (
        f"parameter {names}: the matrices are no smooth function of it between its bounds; "
        "narrow the bounds, or "
        "update with a solver that is run anew at each point"
    )
