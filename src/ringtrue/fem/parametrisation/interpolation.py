"""Functions of one factor as Chebyshev series in its logarithm, in place of a call of the kernels
at each point.

Analytic functions have series that converge geometrically: Trefethen (2013), Approximation Theory
and Approximation Practice, ch. 8.

Matrices that are no polynomials of the factors, as sums of what they are at chosen factors:
empirical interpolation.

Elements on which the same parameters act, whatever their number, span few matrices between the
bounds. Some of these are kept, K(a) = K(1) + Σ c_j(a) (K(a_j) - K(1)), M likewise, and as many
entries of a few elements tell the c_j: the kernels of these are called at any a, by a complex step
for the slopes. Barrault, Maday, Nguyen and Patera (2004), An empirical interpolation method, C. R.
Acad. Sci. Paris 339, 667-672.

Where matrices are kept, and the entries that tell their shares at other factors: what an
interpolation learns.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.iterate import Progress, part
from ringtrue.core.parameters import Parameter
from ringtrue.errors import NumericalError, UnsupportedError
from ringtrue.fem.assembly import Share, full_matrices, reduced
from ringtrue.fem.mesh import Mesh, Rows, union
from ringtrue.fem.parametrisation.element_derivatives import COMPLEX_STEP
from ringtrue.fem.parametrisation.parameter_groups import (
    INVALID,
    Pair,
    ParameterGroup,
    Region,
    Together,
    built,
    ends,
    entries,
    few,
    independent_batches,
    owners,
    picked,
    regions,
    roots,
)
from ringtrue.fem.parametrisation.polynomials import AffineTerm


@dataclass(frozen=True, slots=True)
class NodeSearch:
    """How the points of an interpolation are chosen.

    Attributes
    ----------
    block : int
        Points that are looked at first, then twice as many,
    blocks : int
        and how often.
    most : int
        Matrices of a region, at most.
    fitted : float
        What the points seen may leave, relative to the roots of diagonal entries.
    holds : float
        What is allowed at other points.
    margin : float
        By which the range exceeds the bounds.
    """

    block: int = 16
    blocks: int = 7
    most: int = 320
    fitted: float = 1e-10
    holds: float = 1e-8
    margin: float = 1.05


SEARCH = NodeSearch()
Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


Found = Sequence[Float | None]


@dataclass(frozen=True, slots=True, eq=False)
class InterpolationNodes:
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
        return self.weights * (found[self.places] - self.start)

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
        parameters: int,
        most: int,
    ) -> None:
        self.region = region
        self.start = start
        self.weights = weights
        self.most = most
        self.factors = np.empty((0, parameters))
        self.changes = np.empty((0, start.size))
        self.places = list[int]()

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
        if np.abs(rest).max(initial=0.0) < SEARCH.holds:
            return some[-1][0]
        # chosen anew among all: what stood out by 1e-9 alone at few points is a poor node once
        # others are seen
        self.factors = np.vstack([self.factors, *(a for a, _ in some)])
        self.changes = np.vstack([self.changes, changes])
        size = np.abs(self.changes + self.weights * self.start).max(
            axis=1, initial=1e-300
        )
        nodes, self.places = _pivots(self.changes / size[:, None], self.most + 1)
        self.factors = self.factors[nodes]
        self.changes = self.changes[nodes]
        return None

    def nodes(self, m: Mesh, check: Float) -> InterpolationNodes:
        """The result, that held at `check`."""
        element = owners(m, self.region)
        used = np.unique(element[self.places])
        places = np.cumsum(np.isin(element, used))[self.places] - 1
        return InterpolationNodes(
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
    `SEARCH.fitted` is left.
    """
    rows = list[int]()
    columns = list[int]()
    live = np.flatnonzero(np.abs(rest).max(axis=0) > SEARCH.fitted)
    rest = rest[:, live]
    while rest.size and len(rows) < most:
        i, j = divmod(int(np.abs(rest).argmax()), live.size)
        if not abs(rest[i, j]) > SEARCH.fitted:
            break
        rows.append(i)
        columns.append(int(live[j]))
        rest -= np.outer(rest[:, j] / rest[i, j], rest[i])
    return rows, columns


def learn(
    m: Mesh, some: Sequence[Region], most: int = SEARCH.most
) -> list[InterpolationNodes]:
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
        some,
        entries(m, some, one),
        entries(m, some, one, roots),
        _at(m, some, axes),
        strict=True,
    )
    learners = list[_Learner]()
    out = dict[int, InterpolationNodes]()
    for region, start, weights, found in given:
        if any(f is None for f in found):
            raise UnsupportedError(rough(region.groups))
        learner = _Learner(region, start, weights, one.size, most)
        learner.learn(axes, found)
        learners.append(learner)
    count = SEARCH.block
    for _ in range(SEARCH.blocks):
        waiting = [k for k in range(len(some)) if k not in out]
        if not waiting:
            break
        # denser towards the bounds
        shares = (1 - np.cos(np.pi * rng.random((count, one.size)))) / 2
        points = list(low * (high / low) ** shares)
        for k, found in zip(
            waiting, _at(m, [some[k] for k in waiting], points), strict=True
        ):
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
    low = p.lower / SEARCH.margin
    high = p.upper * SEARCH.margin
    return low, high, low**0.5, high**0.5


def _box(some: Sequence[Region]) -> tuple[list[Float], Float, Float]:
    """Factors on the axes, and all lower and upper bounds (P,), a little widened."""
    parameters = {g.which: g.parameter for r in some for g in r.groups}
    low, high = np.ones((2, 1 + max(parameters)))
    for i, p in parameters.items():
        low[i], high[i] = on_axis(p)[:2]
    each = np.arange(low.size)
    return (
        [
            np.where(each == i, x, 1.0)
            for i in sorted(parameters)
            for x in on_axis(parameters[i])
        ],
        low,
        high,
    )


def _at(
    m: Mesh, some: Sequence[Region], points: Sequence[Float]
) -> list[list[Float | None]]:
    """Entries of each region at each of the points; None where a section does not allow these."""
    # a pole between the bounds is found by what does not hold
    with np.errstate(all="ignore"):
        if found := _tried(Together.of(m, some), points):
            return found
        # it may be one region, and one point, that does not allow the factors
        each = [Together.of(m, [r]) for r in some]
        return [[(_tried(one, [a]) or [[None]])[0][0] for a in points] for one in each]


def _tried(regions: Together, points: Sequence[Float]) -> list[list[Float | None]]:
    """The entries of each region at each point; nothing where a section does not allow one."""
    try:
        found = regions.entries(points)
    except INVALID:
        return []
    return [[f if np.isfinite(f).all() else None for f in each] for each in found]


def rough(groups: Sequence[ParameterGroup]) -> str:
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


# relative to the largest, at the points that the next degree adds; that one's error is about the
# square
SERIES_HOLDS = 1e-9
ROUNDING = 1e-12  # by which a factor may pass its bounds


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Functions (r,) of one factor between two bounds.

    Attributes
    ----------
    lower, upper : float
        Bounds of the factor.
    terms : (n, r) float64
        Of the Chebyshev polynomials in ln a, put to -1 and 1 at the bounds.
    """

    lower: float
    upper: float
    terms: Float

    def holds(self, a: float) -> bool:
        """Whether a factor is between the bounds."""
        return self.lower * (1 - ROUNDING) <= a <= self.upper * (1 + ROUNDING)

    def value(self, a: float) -> Float:
        """The functions (r,)."""
        return np.asarray(chebval(self._at(a), self.terms))

    def derivative(self, a: float) -> Float:
        """Their derivatives (r,)."""
        inner = 2 / (a * np.log(self.upper / self.lower))
        return np.asarray(inner * chebval(self._at(a), chebder(self.terms)))

    def _at(self, a: float) -> float:
        return float(2 * np.log(a / self.lower) / np.log(self.upper / self.lower) - 1)


def fitted(
    bounds: Float, values: Callable[[Float], list[Float]]
) -> list[Series | None]:
    """Series of several functions (r,), each of a factor of its own; None where it does not
    converge.

    Parameters
    ----------
    bounds : (k, 2) float64
        Lower and upper of each factor.
    values : callable (k,) -> k arrays (r,)
        All functions, each at its own factor.
    """
    low, high = bounds.T
    known: dict[float, list[Float]] = {}
    found: list[Series | None] = [None] * len(bounds)
    before: list[Float] = []
    for n in (4, 8, 16, 32, 64, 128):  # each takes the points of the one before
        shares = (1 - np.round(np.cos(np.pi * np.arange(n + 1) / n), 15)) / 2
        known |= {
            s: values(low * (high / low) ** s)
            for s in shares.tolist()
            if s not in known
        }
        basis = chebvander(2 * shares - 1, n)
        every = [np.array([known[s][k] for s in shares]) for k in range(len(low))]
        for k, c in enumerate(every):
            if before and found[k] is None:
                miss = np.abs(basis[:, : len(before[k])] @ before[k] - c).max(
                    initial=0.0
                )
                if miss <= SERIES_HOLDS * np.abs(c).max(initial=0.0):
                    found[k] = Series(
                        float(low[k]), float(high[k]), np.linalg.solve(basis, c)
                    )
        if all(found):
            break
        before = [np.linalg.solve(basis, c) for c in every]
    return found


@dataclass(frozen=True, slots=True)
class SampleSettings:
    """Elements that show the functions of a region.

    Attributes
    ----------
    elements : int
        Elements of a kind.
    worst : int
        Elements that join them.
    rounds : int
        How often.
    kept : int
        Sets of coefficients that are kept.
    """

    elements: int = 24
    worst: int = 12
    rounds: int = 8
    kept: int = 4096


SAMPLES = SampleSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Interpolation:
    """The coefficients of several regions, at any factors.

    Attributes
    ----------
    mesh : Mesh
    regions : tuple of Region
        With the elements whose entries are used.
    nodes : tuple of InterpolationNodes
    colours : dict
        A number for each parameter: those of one act on no region together, and are stepped
        together.
    series : dict
        Of regions of one parameter, by their numbers: the coefficients without a call of the
        kernels.
    """

    mesh: Mesh
    regions: tuple[Region, ...]
    nodes: tuple[InterpolationNodes, ...]
    colours: dict[int, int]
    series: dict[int, Series]
    _values: dict[bytes, dict[int, Float]] = field(default_factory=dict)
    _slopes: dict[bytes, dict[int, dict[int, Float]]] = field(default_factory=dict)
    _some: dict[tuple[int, ...], Together] = field(default_factory=dict)

    def at(self, a: Float) -> dict[int, Float]:
        """c (r,) at the factors a (P,) of all parameters, of the regions that do not stay nominal.

        Raises
        ------
        NumericalError
            If a section does not allow the factors.
        """
        return _kept(self._values, a.tobytes(), lambda: self._values_at(a))

    def derivatives(self, a: Float, i: int) -> dict[int, Float]:
        """∂c/∂a_i (r,) of the regions that depend on a_i, and some of others."""
        return _kept(self._slopes, a.tobytes(), lambda: self._slopes_at(a))[
            self.colours[i]
        ]

    def _values_at(self, a: Float) -> dict[int, Float]:
        by_series = {k for k, _, _ in self._by_series(a)}
        some = [
            k
            for k in range(len(self.regions))
            if k not in by_series and self._changed(k, a)
        ]
        return self._values_of(a, self._entries(a, some, [a]))

    def _values_of(self, a: Float, found: Mapping[int, Any_]) -> dict[int, Float]:
        """By series, and of regions whose entries were found at a, or by a complex step from it."""
        out = {k: s.value(x) for k, s, x in self._by_series(a) if x != 1}
        for k, f in found.items():
            if self._changed(k, a):
                out[k] = self.nodes[k].coefficients(f[0].real)
        return out

    def _changed(self, k: int, a: Float) -> bool:
        """Whether a region does not stay nominal."""
        return bool((a[list(self.regions[k].which)] != 1).any())

    def _slopes_at(self, a: Float) -> dict[int, dict[int, Float]]:
        """Of each colour, all from one call of the kernels, which gives the values as well."""
        out: dict[int, dict[int, Float]] = {c: {} for c in self.colours.values()}
        by_series = {k: s.derivative(x) for k, s, x in self._by_series(a)}
        for k, slope in by_series.items():
            out[self.colours[self.regions[k].which[0]]][k] = slope
        some = [k for k in range(len(self.regions)) if k not in by_series]
        wanted = sorted({self.colours[i] for k in some for i in self.regions[k].which})
        steps = [
            np.array([self.colours.get(i) == c for i in range(a.size)]) for c in wanted
        ]
        found = self._entries(a, some, [a + 1j * COMPLEX_STEP * on for on in steps])
        for k, f in found.items():
            for c, slope in zip(wanted, f.imag / COMPLEX_STEP, strict=True):
                out[c][k] = self.nodes[k].derivatives(slope)
        _kept(self._values, a.tobytes(), lambda: self._values_of(a, found))
        return out

    def _by_series(self, a: Float) -> Iterator[tuple[int, Series, float]]:
        """Regions of one parameter whose factor has a series, and the factor."""
        for k, series in self.series.items():
            x = float(a[self.regions[k].which[0]])
            if series.holds(x):
                yield k, series, x

    def _entries(
        self, a: Float, some: Sequence[int], points: Sequence[Any_]
    ) -> dict[int, Any_]:
        """Of the regions with these numbers at points near a, (points, entries) each."""
        if not some:
            return {}
        key = tuple(some)
        together = _kept(
            self._some,
            key,
            lambda: Together.of(self.mesh, [self.regions[k] for k in key]),
        )
        try:
            return dict(zip(some, together.entries(points), strict=True))
        except INVALID as e:
            raise NumericalError(
                f"a section does not allow the factors {np.round(a, 4).tolist()}: {e}"
            ) from e


def _kept(known: dict[Key, Value], key: Key, made: Callable[[], Value]) -> Value:
    """What is known of a key, made if it is not; all is forgotten when it gets too much."""
    if key not in known:
        if len(known) >= SAMPLES.kept:
            known.clear()
        known[key] = made()
    return known[key]


@dataclass(frozen=True, slots=True, eq=False)
class Coefficient:
    """c_j of a region of an interpolation: a `ParameterFunction`."""

    which: tuple[int, ...]
    of: Interpolation
    region: int
    j: int

    def value(self, a: Float) -> float:
        """See `ParameterFunction`."""
        found = self.of.at(a)
        return float(found[self.region][self.j]) if self.region in found else 0.0

    def derivative(self, a: Float, i: int) -> float:
        """See `ParameterFunction`."""
        return (
            float(self.of.derivatives(a, i)[self.region][self.j])
            if i in self.which
            else 0.0
        )


def interpolated(
    m: Mesh,
    groups: Sequence[ParameterGroup],
    rows: Rows,
    *,
    transform: sparse.csr_array,
    share: Share,
    progress: Progress,
) -> list[AffineTerm]:
    """The terms of the rows, as all groups that act on them change these together; of a share, its
    part of them.

    Raises
    ------
    UnsupportedError
        If the matrices of a region are no smooth functions of its parameters between their bounds.
    """
    batches = independent_batches(regions(groups, rows))
    out = list[AffineTerm]()
    for k, batch in enumerate(batches):
        here = part(progress, k / len(batches), (k + 1) / len(batches))
        out += _terms(m, batch, transform, share, here)
    return out


def _terms(
    m: Mesh,
    batch: Sequence[Region],
    transform: sparse.csr_array,
    share: Share,
    progress: Progress,
) -> list[AffineTerm]:
    """Of regions whose kernels can be called at once; elements whose sums do not hold join those
    that these rest on.
    """
    sampled = {k: few(r.rows, SAMPLES.elements) for k, r in enumerate(batch)}
    found: dict[int, tuple[InterpolationNodes, list[Pair]]] = {}
    for _ in range(SAMPLES.rounds):
        progress(
            len(found) / len(batch), "derivatives: parameters on the same elements"
        )
        waiting = [k for k in sampled if k not in found]
        for k, nodes in zip(
            waiting,
            learn(m, [replace(batch[k], rows=sampled[k]) for k in waiting]),
            strict=True,
        ):
            own = replace(batch[k], rows=share.own(m.model, batch[k].rows))
            parts, worst = _whole(m, own, nodes, transform, share)
            if worst := share.joined(worst, batch[k].rows):
                sampled[k] = union([sampled[k], worst])
            else:
                found[k] = nodes, parts
        if len(found) == len(batch):
            of = _interpolation(m, batch, [found[k][0] for k in sampled])
            return [
                AffineTerm(Coefficient(batch[k].which, of, k, j), *pair)
                for k in sampled
                for j, pair in enumerate(found[k][1])
            ]
    raise UnsupportedError(
        rough(batch[next(k for k in sampled if k not in found)].groups)
    )


def _interpolation(
    m: Mesh, batch: Sequence[Region], nodes: Sequence[InterpolationNodes]
) -> Interpolation:
    colours: dict[int, int] = {}
    for i in sorted({i for r in batch for i in r.which}):
        taken = {colours.get(j) for r in batch if i in r.which for j in r.which}
        colours[i] = next(c for c in range(len(colours) + 1) if c not in taken)
    used = tuple(replace(r, rows=n.rows) for r, n in zip(batch, nodes, strict=True))
    return Interpolation(
        mesh=m,
        regions=used,
        nodes=tuple(nodes),
        colours=colours,
        series=_series(m, used, nodes),
    )


def _series(
    m: Mesh, used: Sequence[Region], nodes: Sequence[InterpolationNodes]
) -> dict[int, Series]:
    """Of the regions of one parameter; none where a section does not allow all factors between the
    bounds.
    """
    single = [k for k, r in enumerate(used) if len(r.which) == 1]
    which = [used[k].which[0] for k in single]
    bounds = [(p.lower, p.upper) for p in (used[k].groups[0].parameter for k in single)]
    a = np.ones(1 + max(which, default=0))
    together = Together.of(m, [used[k] for k in single])

    def values(factors: Float) -> list[Float]:
        a[which] = factors
        found = together.entries([a])
        return [nodes[k].scaled(f[0]) for k, f in zip(single, found, strict=True)]

    try:
        found = fitted(np.array(bounds), values) if single else []
    except INVALID:
        return {}
    return {
        k: replace(s, terms=nodes[k].solved(s.terms.T).T)
        for k, s in zip(single, found, strict=True)
        if s is not None
    }


def _whole(
    m: Mesh,
    region: Region,
    nodes: InterpolationNodes,
    transform: sparse.csr_array,
    share: Share,
) -> tuple[list[Pair], Rows]:
    """K and M at the nodes, less those at nominal, of all elements; some of these whose sum does
    not hold, if any.
    """

    def at(a: Float) -> tuple[Pair, Float]:
        made = built(m, region.groups, region.rows, [a[g.which] for g in region.groups])
        K, M = full_matrices(m, made)
        both = reduced(transform, K), reduced(transform, M)
        return both, ends([(p.stiffness, p.mass) for p in made])[0]

    (K, M), nominal = at(np.ones_like(nodes.check))
    (weights,) = entries(m, [region], np.ones_like(nodes.check), roots)
    (found,) = entries(m, [replace(region, rows=nodes.rows)], nodes.check)
    (there,) = entries(m, [region], nodes.check)
    miss = there - nominal
    parts = list[Pair]()
    for c, a in zip(nodes.coefficients(found).tolist(), nodes.factors, strict=True):
        (stiffness, mass), each = at(a)
        parts.append((sparse.csr_array(stiffness - K), sparse.csr_array(mass - M)))
        miss -= c * (each - nominal)
    miss = np.abs(weights * miss)
    largest = np.abs(weights * there).max(initial=0.0)
    bad = miss > SEARCH.holds * share.gathered(np.array([largest])).max()
    element = owners(m, region)
    order = np.argsort(-miss[bad], kind="stable")
    _, first = np.unique(element[bad][order], return_index=True)
    worst = np.sort(element[bad][order][np.sort(first)[: SAMPLES.worst]])
    return parts, picked(m, region.rows, worst)
