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
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.errors import NumericalError, UnsupportedError
from ringtrue.fem.assembly import System, full_matrices, reduced
from ringtrue.fem.mesh import Mesh, Rows, union
from ringtrue.fem.parametrisation.interpolation_nodes import HOLDS, Nodes, learn, rough
from ringtrue.fem.parametrisation.parameter_groups import (
    INVALID,
    Group,
    Pair,
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

DEGREES = (4, 8, 16, 32, 64, 128)  # each takes the points of the one before
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


def fitted(bounds: Float, values: Callable[[Float], list[Float]]) -> list[Series | None]:
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
    for n in DEGREES:
        shares = (1 - np.round(np.cos(np.pi * np.arange(n + 1) / n), 15)) / 2
        known |= {s: values(low * (high / low) ** s) for s in shares.tolist() if s not in known}
        basis = chebvander(2 * shares - 1, n)
        every = [np.array([known[s][k] for s in shares]) for k in range(len(low))]
        for k, c in enumerate(every):
            if before and found[k] is None:
                miss = np.abs(basis[:, : len(before[k])] @ before[k] - c).max(initial=0.0)
                if miss <= SERIES_HOLDS * np.abs(c).max(initial=0.0):
                    found[k] = Series(float(low[k]), float(high[k]), np.linalg.solve(basis, c))
        if all(found):
            break
        before = [np.linalg.solve(basis, c) for c in every]
    return found


# elements of a kind that tell the functions; that join them; how often
SAMPLE = 24
WORST = 12
ROUNDS = 8
STEP = 1e-30
SEEN = 4096  # sets of coefficients that are kept


@dataclass(frozen=True, slots=True, eq=False)
class Interpolation:
    """The coefficients of several regions, at any factors.

    Attributes
    ----------
    mesh : Mesh
    regions : tuple of Region
        With the elements whose entries are used.
    nodes : tuple of Nodes
    colours : dict
        A number for each parameter: those of one act on no region together, and are stepped
        together.
    series : dict
        Of regions of one parameter, by their numbers: the coefficients without a call of the
        kernels.
    """

    mesh: Mesh
    regions: tuple[Region, ...]
    nodes: tuple[Nodes, ...]
    colours: dict[int, int]
    series: dict[int, Series]
    _seen: dict[tuple[bytes, int], dict[int, Float]] = field(default_factory=dict)
    _some: dict[tuple[int, ...], Together] = field(default_factory=dict)

    def at(self, a: Float) -> dict[int, Float]:
        """c (r,) at the factors a (P,) of all parameters, of the regions that do not stay nominal.

        Raises
        ------
        NumericalError
            If a section does not allow the factors.
        """
        return self._kept(a, -1)

    def derivatives(self, a: Float, i: int) -> dict[int, Float]:
        """∂c/∂a_i (r,) of the regions that depend on a_i, and some of others."""
        return self._kept(a, self.colours[i])

    def _kept(self, a: Float, colour: int) -> dict[int, Float]:
        key = (np.asarray(a, dtype=np.float64).tobytes(), colour)
        if key not in self._seen:
            if len(self._seen) >= SEEN:
                self._seen.clear()
            self._seen[key] = self._computed(np.asarray(a, dtype=np.float64), colour)
        return self._seen[key]

    def _together(self, some: tuple[int, ...]) -> Together:
        """Of the regions with these numbers."""
        if some not in self._some:
            if len(self._some) >= SEEN:
                self._some.clear()
            self._some[some] = Together.of(self.mesh, [self.regions[k] for k in some])
        return self._some[some]

    def _computed(self, a: Float, colour: int) -> dict[int, Float]:
        stepped = np.array([self.colours.get(i) == colour for i in range(a.size)])
        on = stepped if colour >= 0 else a != 1.0
        out = dict[int, Float]()
        for k, series in self.series.items():
            (i,) = self.regions[k].which
            if on[i] and series.holds(x := float(a[i])):
                out[k] = series.value(x) if colour < 0 else series.derivative(x)
        some = [k for k, r in enumerate(self.regions) if on[list(r.which)].any() and k not in out]
        if not some:
            return out
        try:
            found = self._together(tuple(some)).entries(
                a + 1j * STEP * stepped if colour >= 0 else a
            )
        except INVALID as e:
            raise NumericalError(
                f"a section does not allow the factors {np.round(a, 4).tolist()}: {e}"
            ) from e
        if colour < 0:
            return out | {
                k: self.nodes[k].coefficients(f) for k, f in zip(some, found, strict=True)
            }
        slopes = (
            self.nodes[k].derivatives(f.imag / STEP) for k, f in zip(some, found, strict=True)
        )
        return out | dict(zip(some, slopes, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Coefficient:
    """c_j of a region of an interpolation: a `Function`."""

    which: tuple[int, ...]
    of: Interpolation
    region: int
    j: int

    def value(self, a: Float) -> float:
        """See `Function`."""
        found = self.of.at(a)
        return float(found[self.region][self.j]) if self.region in found else 0.0

    def derivative(self, a: Float, i: int) -> float:
        """See `Function`."""
        return float(self.of.derivatives(a, i)[self.region][self.j]) if i in self.which else 0.0


def interpolated(
    m: Mesh, groups: Sequence[Group], rows: Rows, system: System, progress: Progress
) -> list[AffineTerm]:
    """The terms of the rows, as all groups that act on them change these together.

    Raises
    ------
    UnsupportedError
        If the matrices of a region are no smooth functions of its parameters between their bounds.
    """
    batches = independent_batches(regions(groups, rows))
    out = list[AffineTerm]()
    for k, batch in enumerate(batches):
        out += _terms(m, batch, system, part(progress, k / len(batches), (k + 1) / len(batches)))
    return out


def _terms(
    m: Mesh, batch: Sequence[Region], system: System, progress: Progress
) -> list[AffineTerm]:
    """Of regions whose kernels can be called at once; elements whose sums do not hold join those
    that these rest on.
    """
    sampled = {k: few(r.rows, SAMPLE) for k, r in enumerate(batch)}
    found: dict[int, tuple[Nodes, list[Pair]]] = {}
    for _ in range(ROUNDS):
        progress(len(found) / len(batch), "derivatives: parameters on the same elements")
        waiting = [k for k in sampled if k not in found]
        for k, nodes in zip(
            waiting, learn(m, [replace(batch[k], rows=sampled[k]) for k in waiting]), strict=True
        ):
            parts, worst = _whole(m, batch[k], nodes, system)
            if worst.size:
                sampled[k] = union([sampled[k], picked(m, batch[k].rows, worst)])
            else:
                found[k] = nodes, parts
        if len(found) == len(batch):
            of = _interpolation(m, batch, [found[k][0] for k in sampled])
            return [
                AffineTerm(Coefficient(batch[k].which, of, k, j), *pair)
                for k in sampled
                for j, pair in enumerate(found[k][1])
            ]
    raise UnsupportedError(rough(batch[next(k for k in sampled if k not in found)].groups))


def _interpolation(m: Mesh, batch: Sequence[Region], nodes: Sequence[Nodes]) -> Interpolation:
    colours: dict[int, int] = {}
    for i in sorted({i for r in batch for i in r.which}):
        taken = {colours.get(j) for r in batch if i in r.which for j in r.which}
        colours[i] = next(c for c in range(len(colours) + 1) if c not in taken)
    used = tuple(replace(r, rows=n.rows) for r, n in zip(batch, nodes, strict=True))
    return Interpolation(
        mesh=m, regions=used, nodes=tuple(nodes), colours=colours, series=_series(m, used, nodes)
    )


def _series(m: Mesh, used: Sequence[Region], nodes: Sequence[Nodes]) -> dict[int, Series]:
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
        return [nodes[k].scaled(f) for k, f in zip(single, together.entries(a), strict=True)]

    try:
        found = fitted(np.array(bounds), values) if single else []
    except INVALID:
        return {}
    return {
        k: replace(s, terms=nodes[k].solved(s.terms.T).T)
        for k, s in zip(single, found, strict=True)
        if s is not None
    }


def _whole(m: Mesh, region: Region, nodes: Nodes, system: System) -> tuple[list[Pair], Int]:
    """K and M at the nodes, less those at nominal, of all elements; some of these whose sum does
    not hold, if any.
    """

    def at(a: Float) -> tuple[Pair, Float]:
        made = built(m, region.groups, region.rows, [a[g.which] for g in region.groups])
        K, M = full_matrices(m, made)
        both = reduced(system.transform, K), reduced(system.transform, M)
        return both, ends([(p.stiffness, p.mass) for p in made])

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
    bad = miss > HOLDS * np.abs(weights * there).max(initial=0.0)
    element = owners(m, region)
    order = np.argsort(-miss[bad], kind="stable")
    _, first = np.unique(element[bad][order], return_index=True)
    return parts, np.sort(element[bad][order][np.sort(first)[:WORST]])
