"""The problem of updating: one parameter set, one or several configurations (decks with their
tests), one objective.

J(x) = Σ ρ(Δzᵀ W Δz) over all configurations + xᵀ W_p x + the cost of modes without a partner.
Parameters are found in the configurations by name, so that a part which two decks share is one
parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.updating.residuals.modal import (
    NO_MODE,
    Block,
    Point,
    Term,
    Whole,
    default_terms,
    point,
    reweighed,
)
from ringtrue.updating.target import Target, Weights

OUTSIDE = 1e-9  # of an unknown, that is none
APART = 1_000_000  # test modes of configuration i are numbered from i times this


class Loss(Protocol):
    """ρ and ρ' of squared weighted residuals s (n,)."""

    def cost(self, s: Float) -> Float:
        """ρ(s), equal to s for small s."""
        ...

    def weight(self, s: Float) -> Float:
        """ρ'(s), 0 to 1."""
        ...


@dataclass(frozen=True, slots=True)
class Squares:
    """Plain least squares."""

    def cost(self, s: Float) -> Float:
        """s."""
        return s

    def weight(self, s: Float) -> Float:
        """1."""
        return np.ones_like(s)


@dataclass(frozen=True, slots=True)
class Huber:
    """Squares up to `limit` standard deviations, linear beyond: convex, an outlier pulls with
    constant force.
    """

    limit: float = 2.0

    def __post_init__(self) -> None:
        _positive(self.limit)

    def cost(self, s: Float) -> Float:
        """s, beyond the limit 2k√s − k²."""
        r = np.sqrt(s)
        return np.where(r <= self.limit, s, 2 * self.limit * r - self.limit**2)

    def weight(self, s: Float) -> Float:
        """min(1, k/√s)."""
        return np.asarray(np.minimum(1.0, self.limit / np.sqrt(np.maximum(s, 1e-300))))


@dataclass(frozen=True, slots=True)
class Tukey:
    """Bisquare: a datum beyond `limit` standard deviations has no influence at all; not convex, so
    start near.
    """

    limit: float = 6.0

    def __post_init__(self) -> None:
        _positive(self.limit)

    def cost(self, s: Float) -> Float:
        """k²/3 (1 − (1 − s/k²)³), at most k²/3."""
        inside = np.minimum(s / self.limit**2, 1.0)
        return np.asarray(self.limit**2 / 3 * (1 - (1 - inside) ** 3))

    def weight(self, s: Float) -> Float:
        """(1 − s/k²)², 0 beyond."""
        return np.asarray((1 - np.minimum(s / self.limit**2, 1.0)) ** 2)


def _positive(limit: float) -> None:
    if not limit > 0:
        raise InputError(f"limit of a robust loss {limit}: must be > 0 standard deviations")


def squares(value: Float, datum: Int) -> Float:
    """Squared weighted residual of each datum (n,) from rows (r,) numbered 0 to n − 1."""
    return np.asarray(np.bincount(datum, value**2, minlength=int(datum.max(initial=-1)) + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Configuration:
    """A deck and its test.

    Attributes
    ----------
    model : ObservedModel
    target : Target
    terms : tuple of Term
        Kinds of residuals; eigenvalues and shapes with the weights of the target if not given.
    name : str
    """

    model: ObservedModel
    target: Target
    terms: tuple[Term, ...] = ()
    name: str = "model"

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms) or default_terms(self.target))

    def weighed(self, frequency: float, mac: float, independent: float = 1.0) -> Configuration:
        """The same with other model discrepancies of a frequency (relative) and of 1 − MAC, in
        target and terms.

        `independent` is the number of independent errors in a shape.
        """
        weights = replace(
            self.target.weights, frequency=frequency, mac=mac, independent=independent
        )
        terms = reweighed(self.terms, frequency, mac, independent)
        return replace(self, target=replace(self.target, weights=weights), terms=terms)

    def at(self, x: Float, held: Int | None = None, *, slopes: bool = True) -> Point:
        """The modes at x, paired; all that the model can give where a kind of residuals reads more
        than the test's.
        """
        give = getattr(self.model, "whole", None)
        whole: Whole | None = (
            give() if give and any(getattr(t, "whole", False) for t in self.terms) else None
        )
        model = self.model if whole is None else whole.model
        now = model.linearise(x) if slopes else _bare(model.modes(x), x)
        return point(self.model, now if whole is None else whole.part(now), self.target, held, now)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """The objective at one point of the unknowns y.

    Attributes
    ----------
    y : (q,) float64
    x : (p,) float64
    value : (r,) float64
        Weighted residuals, before any robust loss.
    slope : (r, q) float64
        ∂z_model/∂y, weighted.
    datum, mode : (r,) int64
        As in `Block`, numbered through all configurations and kinds.
    kind : (r,) int64
        Term that a row comes from, numbered through all configurations.
    points : tuple of Point
        Of each configuration.
    data, prior, lost : float
        The three parts of J.
    """

    y: Float
    x: Float
    value: Float
    slope: Float
    datum: Int
    mode: Int
    kind: Int
    points: tuple[Point, ...]
    data: float
    prior: float
    lost: float

    @property
    def cost(self) -> float:
        """J."""
        return self.data + self.prior + self.lost


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is minimised, over which unknowns, within which limits.

    Attributes
    ----------
    configurations : tuple of Configuration
    parameters : ParameterSet
        All of them; those of the configurations, joined by name, if not given.
    precision : (p, p) float64
        W_p; 1/std² of each parameter on the diagonal if not given.
    loss : Loss
    link : (p, q) float64
        x = link y ties parameters; the identity if not given.
    rows, limits : (c, p), (c,) float64
        Linear constraints rows x <= limits.
    """

    configurations: tuple[Configuration, ...]
    parameters: ParameterSet = field(default_factory=lambda: ParameterSet(()))
    precision: Float = field(default_factory=lambda: np.zeros((0, 0)))
    loss: Loss = field(default_factory=Squares)
    link: Float = field(default_factory=lambda: np.zeros((0, 0)))
    rows: Float = field(default_factory=lambda: np.zeros((0, 0)))
    limits: Float = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "configurations", tuple(self.configurations))
        if not self.configurations:
            raise InputError("a problem of updating needs at least one configuration")
        if not len(self.parameters):
            put(self, "parameters", joined([c.model.parameters for c in self.configurations]))
        p = len(self.parameters)
        put(
            self,
            "precision",
            self.precision if self.precision.size else np.diag(1 / self.parameters.std() ** 2),
        )
        put(self, "link", self.link if self.link.size else np.eye(p))
        put(self, "rows", self.rows if self.rows.size else np.zeros((0, p)))
        shapes = self.precision.shape, self.link.shape[0], self.rows.shape
        if shapes != ((p, p), p, (self.limits.size, p)):
            raise InputError(f"{p} parameters: got precision, rows of link, constraints {shapes}")
        for c in self.configurations:
            _places(self.parameters, c)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.link.shape[1])

    @property
    def linked_precision(self) -> Float:
        """W_p of the unknowns, (q, q)."""
        return np.asarray(self.link.T @ self.precision @ self.link)

    def inequalities(self) -> tuple[Float, Float]:
        """All limits as rows y <= limits: bounds of the parameters and linear constraints."""
        low, high = self.parameters.bounds()
        rows = np.concatenate([self.link, -self.link, self.rows @ self.link])
        return rows, np.concatenate([high, -low, self.limits])

    def nearest(self, y: Float) -> Float:
        """The point inside all limits that is nearest to y (q,).

        Raises
        ------
        ConfigError
            If there is none.
        """
        rows, limits = self.inequalities()
        at_most = limits + OUTSIDE * np.linalg.norm(rows, axis=1)
        if (rows @ y <= at_most).all():
            return y
        out = y + least_distance(np.eye(y.size), np.zeros(y.size), rows, limits - rows @ y)
        if (rows @ out > at_most).any():
            raise ConfigError(
                "no point fulfils the bounds of the parameters and all constraints: widen one of "
                "them"
            )
        return np.asarray(out)

    def evaluate(self, y: Float, before: Evaluated | None = None) -> Evaluated:
        """J and its parts at y (q,), with sensitivities; pairs of `before` are held on to."""
        return self._evaluate(np.asarray(y, dtype=np.float64), before, slopes=True)

    def cost(self, y: Float, before: Evaluated | None = None) -> float:
        """J at y (q,), modes only."""
        return self._evaluate(np.asarray(y, dtype=np.float64), before, slopes=False).cost

    def residuals(self, y: Float, before: Evaluated | None = None) -> Float:
        """Weighted residuals (r,) at y (q,), modes only; their number changes where pairs
        change.
        """
        return self._evaluate(np.asarray(y, dtype=np.float64), before, slopes=False).value

    def _evaluate(self, y: Float, before: Evaluated | None, *, slopes: bool) -> Evaluated:
        x = self.link @ y
        points, blocks, lost = [], [], 0.0
        for i, c in enumerate(self.configurations):
            at = _places(self.parameters, c)
            held = None if before is None else before.points[i].pairs[:, 0]
            points.append(here := c.at(x[at], held, slopes=slopes))
            lost += c.target.lost * (int(c.target.used.sum()) - len(here.pairs))
            wide = self.link[at] if slopes else np.zeros((0, self.size))
            blocks += [_shifted(t(here), wide, i) for t in c.terms]
        return self._joined(y, x, tuple(points), blocks, lost)

    def _joined(
        self, y: Float, x: Float, points: tuple[Point, ...], blocks: list[Block], lost: float
    ) -> Evaluated:
        value, slope = (
            np.concatenate([b.value for b in blocks]),
            np.concatenate([b.slope for b in blocks]),
        )
        counts = [int(b.datum.max(initial=-1)) + 1 for b in blocks]
        first = np.cumsum([0, *counts[:-1]])
        datum = np.concatenate([b.datum + f for b, f in zip(blocks, first, strict=True)])
        mode = np.concatenate([b.mode for b in blocks])
        kind = np.repeat(np.arange(len(blocks)), [b.value.size for b in blocks])
        data = float(self.loss.cost(squares(value, datum)).sum())
        return Evaluated(
            y, x, value, slope, datum, mode, kind, points, data, float(x @ self.precision @ x), lost
        )

    def weighted(self, at: Evaluated) -> tuple[Float, Float]:
        """√ρ' r (r,) and √ρ' G (r, q): their least-squares gradient is that of the robust data
        part.
        """
        root = np.sqrt(self.loss.weight(squares(at.value, at.datum)))[at.datum]
        return at.value * root, at.slope * root[:, None]

    def gradient(self, at: Evaluated) -> Float:
        """½ ∂J/∂y (q,), pairs fixed."""
        r, g = self.weighted(at)
        return np.asarray(self.linked_precision @ at.y - g.T @ r)

    def shared(self, at: Evaluated, other: Evaluated) -> float | None:
        """J without the cost of lost modes, over the test modes that `other` has paired; None if
        one is lost in `at`.

        Configurations in which no pair costs more than a lost mode count whole, lost modes too.
        """
        gated = np.array([c.target.rule == "gates" for c in self.configurations])
        for g, a, b in zip(gated, at.points, other.points, strict=True):
            if g and not np.isin(b.pairs[:, 0], a.pairs[:, 0]).all():
                return None
        free = ~gated[at.mode // APART] | (at.mode == NO_MODE)
        keep = free | np.isin(at.mode, other.mode)
        cost = self.loss.cost(squares(at.value[keep], at.datum[keep]))
        open_lost = sum(
            _lost(c, p)
            for c, p, g in zip(self.configurations, at.points, gated, strict=True)
            if not g
        )
        return float(cost.sum()) + at.prior + open_lost


def _lost(c: Configuration, at: Point) -> float:
    return c.target.lost * (int(c.target.used.sum()) - len(at.pairs))


def _bare(now: Linearisation, x: Float) -> Linearisation:
    """Modes without sensitivities, x kept."""
    m = now.frequencies.size
    return Linearisation(
        x, now.frequencies, now.shapes, np.zeros((m, 0)), np.zeros((*now.shapes.shape, 0))
    )


def _shifted(b: Block, wide: Float, i: int) -> Block:
    """Slopes to the unknowns, test modes numbered through all configurations."""
    return Block(
        b.value, b.slope @ wide, b.datum, np.where(b.mode == NO_MODE, NO_MODE, b.mode + i * APART)
    )


def _places(parameters: ParameterSet, c: Configuration) -> list[int]:
    """Where the parameters of a configuration are among all."""
    at = {n: i for i, n in enumerate(parameters.names)}
    lost = [n for n in c.model.parameters.names if n not in at]
    if lost:
        raise InputError(
            f"configuration {c.name}: no parameter {lost[0]!r}{did_you_mean(lost[0], at)}"
        )
    return [at[n] for n in c.model.parameters.names]


def joined(sets: Sequence[ParameterSet]) -> ParameterSet:
    """The parameters of all sets, each name once.

    Raises
    ------
    InputError
        If two with the same name have different bounds, scale or prior: they would not be one
        parameter.
    """
    found = {p.name: p for s in sets for p in s.parameters}
    for p in (p for s in sets for p in s.parameters):
        same = found[p.name]
        if (p.lower, p.upper, p.scale, p.std) != (same.lower, same.upper, same.scale, same.std):
            raise InputError(
                f"parameter {p.name!r} has different bounds, scale or prior in two configurations"
            )
    return ParameterSet(tuple(found.values()))


def link_equal(parameters: ParameterSet, groups: Sequence[Sequence[str]]) -> Float:
    """The link (p, q) that gives the parameters of each group one common x; the others stay free.

    Raises
    ------
    InputError
        If a name is not a parameter or is in two groups.
    """
    names, q = list(parameters.names), 0
    wrong = [n for g in groups for n in g if n not in names]
    if wrong:
        raise InputError(f"no parameter {wrong[0]!r}{did_you_mean(wrong[0], names)}")
    named = [n for g in groups for n in g]
    if len(set(named)) != len(named):
        raise InputError("a parameter is linked in two groups")
    column: dict[str, int] = {}
    for n in names:
        mine = next((g for g in groups if n in g), (n,))
        if n not in column:
            column |= dict.fromkeys(mine, q)
            q += 1
    out = np.zeros((len(names), q))
    out[np.arange(len(names)), [column[n] for n in names]] = 1.0
    return out


def held_to(problem: Problem, names: Sequence[str], base: Float | None = None) -> Problem:
    """The problem with only some parameters free; the others stay at 0, without constraints on
    these alone.

    Raises
    ------
    InputError
        If a name is not a parameter, or `base` is not 0 elsewhere.
    """
    every = list(problem.parameters.names)
    wrong = [n for n in names if n not in every]
    if wrong:
        raise InputError(f"no parameter {wrong[0]!r}{did_you_mean(wrong[0], every)}")
    free = np.isin(every, list(names))
    keep = np.abs(problem.link[free]).sum(axis=0) > 0
    tied = np.abs(problem.link[~free][:, keep]).sum() > 0
    if tied or (base is not None and np.abs(np.asarray(base)[~free]).max(initial=0.0) > 0):
        raise InputError("parameters that stay must be at 0 and not be linked to free ones")
    link = problem.link[:, keep]
    limited = (problem.rows @ link).any(axis=1)
    return replace(problem, link=link, rows=problem.rows[limited], limits=problem.limits[limited])


def weighed(problem: Problem, found: Weights) -> Problem:
    """With discrepancies of frequencies and shapes as found."""
    every = (
        c.weighed(found.frequency, found.mac, found.independent) for c in problem.configurations
    )
    return replace(problem, configurations=tuple(every))


def doubting(problem: Problem) -> Problem:
    """The same with no pair that costs more than a lost mode."""
    every = (replace(c, target=c.target.doubting()) for c in problem.configurations)
    return replace(problem, configurations=tuple(every))


def least_distance(hessian: Float, gradient: Float, rows: Float, limits: Float) -> Float:
    """d (q,) of least ½dᵀHd + gᵀd with rows d <= limits; 0 where no d fulfils them.

    H = RᵀR; with e = Rd + R⁻ᵀg the problem is least ‖e‖ inside inequalities, whose dual is a
    non-negative least-squares problem (Lawson and Hanson 1974, eq. 23.27).

    Parameters
    ----------
    hessian : (q, q) float64, positive definite
    gradient : (q,) float64
    rows, limits : (c, q), (c,) float64
    """
    size = 1 / np.sqrt(np.diag(hessian))
    r = linalg.cholesky(hessian * np.outer(size, size))
    free = linalg.solve_triangular(r, gradient * size, trans="T")
    plain = -linalg.solve_triangular(r, free) * size
    if (rows @ plain <= limits).all():
        return np.asarray(plain)
    length = np.linalg.norm(rows * size, axis=1)
    keep = length > 0
    a = linalg.solve_triangular(r, (rows[keep] * size / length[keep, None]).T, trans="T").T
    b = limits[keep] / length[keep] + a @ free
    scale = max(float(np.abs(b).max()), 1e-300)  # the dual is solved at unit size
    u, gap = nnls(
        np.vstack([-a.T, -b[None] / scale]),
        np.append(np.zeros(free.size), 1.0),
        maxiter=50 * b.size,
    )
    if gap == 0.0:
        return np.zeros_like(plain)
    # the constraints that hold as equations are known now, the point itself has lost digits to the
    # dual
    e = linalg.lstsq(a[u > 0], b[u > 0])[0]
    return np.asarray(linalg.solve_triangular(r, e - free) * size)
