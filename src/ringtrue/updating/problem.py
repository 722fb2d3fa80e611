"""The objective of an updating, over one or several configurations (decks with their tests).

J(x) = Σ ρ(Δzᵀ W Δz) over all configurations + xᵀ W_p x + the cost of unpaired modes.
Configurations share parameters by name.

The weighted residuals of all tests at one point, and criteria that compare parameter sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import ConfigError, InputError, did_you_mean
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.updating.residuals.modal import (
    NO_MODE,
    Point,
    Quantity,
    Term,
    Whole,
    default_terms,
    point,
)
from ringtrue.updating.target import Target, Weights

MODE_STRIDE = 1_000_000  # test modes of configuration i are numbered from i times this


class RobustLoss(Protocol):
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
        if not self.limit > 0:
            raise InputError(
                f"limit of a robust loss {self.limit}: must be > 0 standard deviations"
            )

    def cost(self, s: Float) -> Float:
        """s, beyond the limit 2k√s − k²."""
        r = np.sqrt(s)
        return np.where(r <= self.limit, s, 2 * self.limit * r - self.limit**2)

    def weight(self, s: Float) -> Float:
        """min(1, k/√s)."""
        return np.minimum(1.0, self.limit / np.sqrt(np.maximum(s, 1e-300)))


def squares(value: Float, datum: Int) -> Float:
    """Squared weighted residual of each datum (n,) from rows (r,) numbered 0 to n − 1."""
    return np.asarray(
        np.bincount(datum, value**2, minlength=int(datum.max(initial=-1)) + 1)
    )


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
        object.__setattr__(
            self, "terms", tuple(self.terms) or default_terms(self.target)
        )

    def weighed(
        self, frequency: float, mac: float, independent: float = 1.0
    ) -> Configuration:
        """The same with other model discrepancies of a frequency (relative) and of 1 − MAC, in
        target and terms.

        `independent` is the number of independent errors in a shape.
        """
        weights = replace(
            self.target.weights,
            frequency=frequency,
            mac=mac,
            independent=independent,
        )
        terms = tuple(t.reweighed(frequency, mac, independent) for t in self.terms)
        return replace(self, target=replace(self.target, weights=weights), terms=terms)

    def at(self, x: Float, held: Int | None = None, *, slopes: bool = True) -> Point:
        """The modes at x, paired; all modes of the model where a kind of residuals reads them."""
        whole = None
        model = self.model
        if any(t.whole for t in self.terms) and isinstance(model, WithAllModes):
            whole = model.whole()
            model = whole.model
        now = model.linearise(x) if slopes else _without_slopes(model.modes(x), x)
        part = now if whole is None else whole.part(now)
        return point(self.model, part, self.target, held, now)

    def cost_of_unpaired(self, at: Point) -> float:
        """Cost of all used test modes that have no partner at a point."""
        return self.target.lost * (int(self.target.used.sum()) - len(at.pairs))


@runtime_checkable
class WithAllModes(Protocol):
    """An `ObservedModel` that can give more modes and channels than the test has."""

    def whole(self) -> Whole:
        """All modes at all channels."""
        ...


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
    loss : RobustLoss
    link : (p, q) float64
        x = link y ties parameters; the identity if not given.
    rows, limits : (c, p), (c,) float64
        Linear constraints rows x <= limits.
    """

    configurations: tuple[Configuration, ...]
    parameters: ParameterSet = field(default_factory=lambda: ParameterSet(()))
    precision: Float = field(default_factory=lambda: np.zeros((0, 0)))
    loss: RobustLoss = field(default_factory=Squares)
    link: Float = field(default_factory=lambda: np.zeros((0, 0)))
    rows: Float = field(default_factory=lambda: np.zeros((0, 0)))
    limits: Float = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "configurations", tuple(self.configurations))
        if not self.configurations:
            raise InputError("a problem of updating needs at least one configuration")
        if not len(self.parameters):
            put(
                self,
                "parameters",
                joined([c.model.parameters for c in self.configurations]),
            )
        p = len(self.parameters)
        if not self.precision.size:
            put(self, "precision", np.diag(1 / self.parameters.std() ** 2))
        if not self.link.size:
            put(self, "link", np.eye(p))
        if not self.rows.size:
            put(self, "rows", np.zeros((0, p)))
        shapes = self.precision.shape, self.link.shape[0], self.rows.shape
        if shapes != ((p, p), p, (self.limits.size, p)):
            raise InputError(
                f"{p} parameters: got precision, rows of link, constraints {shapes}"
            )
        for c in self.configurations:
            self.positions(c)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.link.shape[1])

    @property
    def linked_precision(self) -> Float:
        """W_p of the unknowns, (q, q)."""
        return self.link.T @ self.precision @ self.link

    def positions(self, c: Configuration) -> list[int]:
        """Positions of the parameters of a configuration among all."""
        at = {n: i for i, n in enumerate(self.parameters.names)}
        unknown = [n for n in c.model.parameters.names if n not in at]
        if unknown:
            raise InputError(
                f"configuration {c.name}: no parameter {unknown[0]!r}"
                f"{did_you_mean(unknown[0], at)}"
            )
        return [at[n] for n in c.model.parameters.names]

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
        # 1e-9: violation of a limit that is rounding, in units of the unknowns
        at_most = limits + 1e-9 * np.linalg.norm(rows, axis=1)
        if (rows @ y <= at_most).all():
            return y
        out = y + least_distance(
            np.eye(y.size), np.zeros(y.size), rows, limits - rows @ y
        )
        if (rows @ out > at_most).any():
            raise ConfigError(
                "no point fulfils the bounds of the parameters and all constraints: widen one of "
                "them"
            )
        return out

    def evaluate(
        self, y: Float, before: Evaluated | None = None, *, slopes: bool = True
    ) -> Evaluated:
        """J and its parts at y (q,); pairs of `before` are held on to.

        Without `slopes` only modes are computed, and the slopes are zeros.
        """
        y = np.asarray(y, dtype=np.float64)
        x = self.link @ y
        points = []
        blocks = []
        lost = 0.0
        for i, c in enumerate(self.configurations):
            at = self.positions(c)
            held = None if before is None else before.points[i].pairs[:, 0]
            here = c.at(x[at], held, slopes=slopes)
            points.append(here)
            lost += c.cost_of_unpaired(here)
            link = self.link[at] if slopes else np.zeros((0, self.size))
            for term in c.terms:
                block = term(here)
                mode = np.where(
                    block.mode == NO_MODE, NO_MODE, block.mode + i * MODE_STRIDE
                )
                blocks.append(replace(block, slope=block.slope @ link, mode=mode))
        value = np.concatenate([b.value for b in blocks])
        counts = [int(b.datum.max(initial=-1)) + 1 for b in blocks]
        first = np.cumsum([0, *counts[:-1]])
        datum = np.concatenate(
            [b.datum + f for b, f in zip(blocks, first, strict=True)]
        )
        return Evaluated(
            y=y,
            x=x,
            value=value,
            slope=np.concatenate([b.slope for b in blocks]),
            datum=datum,
            mode=np.concatenate([b.mode for b in blocks]),
            kind=np.repeat(np.arange(len(blocks)), [b.value.size for b in blocks]),
            points=tuple(points),
            data=float(self.loss.cost(squares(value, datum)).sum()),
            prior=float(x @ self.precision @ x),
            lost=lost,
        )

    def cost(self, y: Float, before: Evaluated | None = None) -> float:
        """J at y (q,), modes only."""
        return self.evaluate(y, before, slopes=False).cost

    def weighted(self, at: Evaluated) -> tuple[Float, Float]:
        """√ρ' r (r,) and √ρ' G (r, q): their least-squares gradient is that of the robust data
        part.
        """
        root = np.sqrt(self.loss.weight(squares(at.value, at.datum)))[at.datum]
        return at.value * root, at.slope * root[:, None]

    def gradient(self, at: Evaluated) -> Float:
        """½ ∂J/∂y (q,), pairs fixed."""
        r, g = self.weighted(at)
        return self.linked_precision @ at.y - g.T @ r

    def shared(self, at: Evaluated, other: Evaluated) -> float | None:
        """J over the test modes that `other` has paired; None if `at` has lost one of them.

        Configurations in which no pair costs more than an unpaired mode count whole.
        """
        gated = np.array([c.target.rule == "gates" for c in self.configurations])
        unpaired = 0.0
        for c, gates, a, b in zip(
            self.configurations, gated, at.points, other.points, strict=True
        ):
            if not gates:
                unpaired += c.cost_of_unpaired(a)
            elif not np.isin(b.pairs[:, 0], a.pairs[:, 0]).all():
                return None
        free = ~gated[at.mode // MODE_STRIDE] | (at.mode == NO_MODE)
        keep = free | np.isin(at.mode, other.mode)
        cost = self.loss.cost(squares(at.value[keep], at.datum[keep]))
        return float(cost.sum()) + at.prior + unpaired


def single(model: ObservedModel, target: Target) -> Problem:
    """The problem of one deck and its test, with eigenvalues and shapes as residuals."""
    return Problem((Configuration(model, target),))


def _without_slopes(now: Linearisation, x: Float) -> Linearisation:
    """Modes without sensitivities, x kept."""
    m = now.frequencies.size
    none = np.zeros((*now.shapes.shape, 0))
    return Linearisation(x, now.frequencies, now.shapes, np.zeros((m, 0)), none)


def joined(sets: Sequence[ParameterSet]) -> ParameterSet:
    """The parameters of all sets, each name once.

    Raises
    ------
    InputError
        If two with the same name have different bounds, scale or prior: they would not be one
        parameter.
    """
    found: dict[str, Parameter] = {}
    for p in (p for s in sets for p in s.parameters):
        same = found.setdefault(p.name, p)
        if (p.lower, p.upper, p.scale, p.std) != (
            same.lower,
            same.upper,
            same.scale,
            same.std,
        ):
            raise InputError(
                f"parameter {p.name!r} has different bounds, scale or prior in two configurations"
            )
    return ParameterSet(tuple(found.values()))


def held_to(
    problem: Problem, names: Sequence[str], base: Float | None = None
) -> Problem:
    """The problem with only some parameters free; the others stay at 0, without constraints on
    them.

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
    if tied or (
        base is not None and np.abs(np.asarray(base)[~free]).max(initial=0.0) > 0
    ):
        raise InputError(
            "parameters that stay must be at 0 and not be linked to free ones"
        )
    link = problem.link[:, keep]
    limited = (problem.rows @ link).any(axis=1)
    return replace(
        problem,
        link=link,
        rows=problem.rows[limited],
        limits=problem.limits[limited],
    )


def weighed(problem: Problem, found: Weights) -> Problem:
    """With discrepancies of frequencies and shapes as found."""
    errors = (found.frequency, found.mac, found.independent)
    every = tuple(c.weighed(*errors) for c in problem.configurations)
    return replace(problem, configurations=every)


def doubting(problem: Problem, spread: float = 1.0) -> Problem:
    """The same with no pair that costs more than a lost mode (`Target.doubting`)."""
    every = (
        replace(c, target=c.target.doubting(spread)) for c in problem.configurations
    )
    return replace(problem, configurations=tuple(every))


def least_distance(
    hessian: Float, gradient: Float, rows: Float, limits: Float
) -> Float:
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
        return plain
    length = np.linalg.norm(rows * size, axis=1)
    keep = length > 0
    a = linalg.solve_triangular(
        r, (rows[keep] * size / length[keep, None]).T, trans="T"
    ).T
    b = limits[keep] / length[keep] + a @ free
    scale = max(np.abs(b).max(), 1e-300)  # the dual is solved at unit size
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
    return linalg.solve_triangular(r, e - free) * size


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Weighted residuals and their sensitivities at one point, pairs fixed.

    Attributes
    ----------
    value : (r,) float64
        √W Δz with Δz = z_test − z_model.
    slope : (r, p) float64
        √W ∂z_model/∂x.
    pairs : (k, 2) int64
        Test mode and FE mode; test modes of configuration i count from i times `MODE_STRIDE`.
    mac : (k,) float64
        Of the pair, or of its subspace.
    frequency_error : (k,) float64
        (f_FE − f_test)/f_test, of all pairs.
    used : (k,) bool
        Pairs that the residual holds.
    quantity : (r,) int64
        `Quantity` of each row.
    other_data : float
        Number of data besides the modes.
    """

    value: Float
    slope: Float
    pairs: Int
    mac: Float
    frequency_error: Float
    used: Bool
    quantity: Int
    other_data: float = 0.0


def residual_at(problem: Problem, x: Float, *, slopes: bool = True) -> Residual:
    """All residuals at x (p,), weighted; without `slopes` these are zeros."""
    at = problem.evaluate(x, slopes=slopes)
    value, slope = problem.weighted(at)
    pairs = []
    error = []
    used = []
    for i, (c, p) in enumerate(zip(problem.configurations, at.points, strict=True)):
        test, fe = p.every.T
        pairs.append(np.stack([test + i * MODE_STRIDE, fe], axis=1))
        error.append(p.now.frequencies[fe] / c.target.frequencies[test] - 1)
        used.append(c.target.used[test])
    terms = [t for c in problem.configurations for t in c.terms]
    rows = np.bincount(at.kind, minlength=len(terms)).tolist()
    other = [
        t.weight * n
        for t, n in zip(terms, rows, strict=True)
        if t.quantity is Quantity.OTHER
    ]
    quantity = np.array([t.quantity.value for t in terms], dtype=np.int64)
    return Residual(
        value=value,
        slope=slope,
        pairs=np.concatenate(pairs),
        mac=np.concatenate([p.mac for p in at.points]),
        frequency_error=np.concatenate(error),
        used=np.concatenate(used),
        quantity=quantity[at.kind],
        other_data=float(sum(other)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class KnownPoint:
    """An `ObservedModel` of which one point is known: its modes and sensitivities there."""

    parameters: ParameterSet
    point: Linearisation

    def linearise(self, x: Float) -> Linearisation:
        """The point, whatever x."""
        return self.point

    def modes(self, x: Float) -> Linearisation:
        """The point, whatever x."""
        return self.point


def data_used_up(normal: Float, precision: Float) -> float:
    """How many data the parameters use up: the trace of the hat matrix.

    Parameters
    ----------
    normal, precision : (p, p) float64
        GᵀWG of the data and W_p of the prior.
    """
    return float(np.trace(np.linalg.solve(normal + precision, normal)))


def aicc(value: float, n: float, parameters: int) -> float:
    """n ln(J/n) with a penalty on the parameters and the scale of J, J over `n` data; Burnham,
    Anderson, eq. 7.
    """
    k = parameters + 1
    return float(
        n * np.log(max(value, 1e-300) / n) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 1)
    )


def comparable_criteria(
    target: Target,
    residuals: Sequence[Residual],
    points: Sequence[Float],
    priors: Sequence[Float],
) -> Float:
    """AICc (k,) of parameter sets that may have paired different modes: the same modes are counted
    in all.

    Counted are the used modes that at least one set has paired; a set that has no partner for one
    of them pays `target.lost`. So losing a mode never pays, and a mode that no set explains does
    not decide. Burnham and Anderson (2002), eq. 7.

    Parameters
    ----------
    residuals : sequence (k) of Residual
    points, priors : sequences (k) of (p,) float64
        x and the prior standard deviations of each set.
    """
    counted = np.unique(np.concatenate([r.pairs[r.used, 0] for r in residuals]))
    n = target.weights.data * max(counted.size, 1) + residuals[0].other_data
    out = []
    for r, x, prior in zip(residuals, points, priors, strict=True):
        missing = counted.size - int(r.used.sum())
        scaled = x / prior
        value = float(r.value @ r.value + scaled @ scaled) + target.lost * missing
        out.append(aicc(value, n, x.size))
    return np.array(out)
