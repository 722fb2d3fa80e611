"""Rigid-body tuning: springs, mass, centre of gravity and inertia from rigid-body modes whose
pairing is uncertain.

Neighbouring rigid-body modes turn into each other as springs change, so which test mode is which
model mode is itself unknown. Every assignment is a hypothesis h with a best point of its own;
hypotheses weigh by their evidence

    p(h | data) ∝ exp(−J_h/2) det(GᵀG + W_p)^(−1/2)        (Laplace; MacKay 1992, eq. 2.6)

and the posterior is their mixture. What the weights do not settle is reported, not hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations
from math import perm

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.iterate import Outcome, Progress, iterate, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import InputError, NotConverged, NumericalError, SolverError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.shapes import close_groups, mac
from ringtrue.updating.problem import data_used_up
from ringtrue.updating.target import Target, shape_residual


@dataclass(frozen=True, slots=True)
class AssignmentSearch:
    """How assignments of rigid-body modes are ranked.

    Attributes
    ----------
    most : int
        Assignments that are ranked.
    kept : int
        Of these refined at most.
    margin : float
        In −2 ln p: an assignment this far behind the best is not refined.
    cap : float
        −2 ln p that a shape alone may cost before refinement: shapes change where modes cross.
    certain : float
        Weight of the best assignment from which the pairing is unambiguous.
    same : float
        Prior standard deviations between two ends that are one.
    steps : int
        Steps of a refinement, at most.
    small : float
        Step at which it ends.
    """

    most: int = 50_000
    kept: int = 24
    margin: float = 60.0
    cap: float = 20.0
    certain: float = 0.95
    same: float = 1e-3
    steps: int = 60
    small: float = 1e-6


ASSIGNMENTS = AssignmentSearch()


@dataclass(frozen=True, slots=True, eq=False)
class Assignment(FrozenArrays):
    """One pairing of all test modes, tuned.

    Attributes
    ----------
    pairs : (m, 2) int64
        Test mode and model mode, in the order of frequency at the end.
    first : (m,) int64
        The same model modes in the order of frequency at the start: what distinguishes two
        assignments that end with equal cost.
    x : (p,) float64
    covariance : (p, p) float64
    cost : float
        J.
    weight : float
        Probability among all assignments.
    frequencies : (m,) float64, Hz
        Of the model for each test mode.
    mac : (m,) float64
    """

    pairs: Int
    first: Int
    x: Float
    covariance: Float
    cost: float
    weight: float
    frequencies: Float
    mac: Float


@dataclass(frozen=True, slots=True, eq=False)
class Suspended:
    """A tuned suspension.

    Attributes
    ----------
    parameters : ParameterSet
    assignments : tuple of Assignment
        The most probable first.
    """

    parameters: ParameterSet
    assignments: tuple[Assignment, ...]

    @property
    def best(self) -> Assignment:
        """The most probable one."""
        return self.assignments[0]

    @property
    def certain(self) -> bool:
        """Whether the pairing is unambiguous."""
        return self.best.weight >= ASSIGNMENTS.certain

    @property
    def covariance(self) -> Float:
        """Of x about the best point, over all assignments: their spread is part of it, (p, p)."""
        w = np.array([a.weight for a in self.assignments])
        away = np.array([a.x - self.best.x for a in self.assignments])
        within = np.tensordot(
            w, np.array([a.covariance for a in self.assignments]), axes=1
        )
        return np.asarray(within + np.einsum("a,ap,aq->pq", w, away, away))

    @property
    def std(self) -> Float:
        """Of x, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    def ambiguity(self) -> tuple[str, ...]:
        """In words, which test modes could be another model mode and what would change; empty if it
        is certain.
        """
        if self.certain:
            return ()
        sentences = []
        covered = 0.0
        for a in self.assignments:
            if covered >= ASSIGNMENTS.certain:
                break
            covered += a.weight
            both = zip(a.pairs[:, 0].tolist(), a.first.tolist(), strict=True)
            pairs = ", ".join(f"{t + 1}:{f + 1}" for t, f in both)
            factors = self.parameters.factors(a.x)
            names = zip(self.parameters.names, factors.tolist(), strict=True)
            sentences.append(
                f"{100 * a.weight:.0f} %: test:model before tuning {pairs}; "
                + ", ".join(f"{n} {v:.3g}" for n, v in names)
            )
        return tuple(sentences)


@dataclass(frozen=True, slots=True, eq=False)
class _At:
    """A point with the model modes under their labels (l,), residuals and slopes at fixed pairs of
    labels.
    """

    x: Float
    now: Linearisation
    modes: Int
    value: Float
    slope: Float
    cost: float
    damping: float
    still: bool = False


def tune(
    model: ObservedModel,
    target: Target,
    *,
    start: Float | None = None,
    progress: Progress = quiet,
) -> Suspended:
    """Tune the suspension under every pairing that the data leave open.

    Parameters
    ----------
    model : ObservedModel
    target : Target
        Rigid-body test modes; those not `used` take no part. Its gates are not asked, but
        `pairing.close` says which model modes are rotated towards the test.
    start : (p,) float64, optional
        0 by default.

    Raises
    ------
    InputError
        If there are more test modes than model modes, or too many assignments to rank.
    NotConverged
        If no assignment can be refined.
    """
    x = (
        np.zeros(len(model.parameters))
        if start is None
        else np.array(start, dtype=np.float64)
    )
    tests = np.flatnonzero(target.used)
    now = model.linearise(x)
    # the lowest six, or as many as the test has
    labels = np.arange(min(max(6, tests.size), now.frequencies.size))
    labels = labels[now.frequencies[labels] > 0]
    order = _ranked(model, target, now, tests, labels)
    std = model.parameters.std()
    found: list[tuple[_At, Int]] = []
    for i, choice in enumerate(order):
        try:
            rules = _Refinement(
                model=model,
                target=target,
                first=now,
                tests=tests,
                labels=labels,
                choice=choice,
            )
            end = iterate(rules, limit=ASSIGNMENTS.steps).last
        except (NumericalError, SolverError):
            continue
        pairs = end.modes[choice]
        twins = [e for e, c in found if np.array_equal(e.modes[c], pairs)]
        far = [
            np.abs((end.x - e.x) / std).max(initial=0.0) >= ASSIGNMENTS.same
            for e in twins
        ]
        if all(far):
            found.append((end, choice))
        progress((i + 1) / len(order), f"assignment {i + 1} of the rigid-body modes")
    if not found:
        raise NotConverged(
            "no assignment of rigid-body modes can be solved: look at bounds and start"
        )
    return Suspended(model.parameters, _weighed(model, target, tests, labels, found))


def _ranked(
    model: ObservedModel, target: Target, now: Linearisation, tests: Int, labels: Int
) -> Int:
    """Assignments (a, m) of positions in `labels` to be refined, the most probable by the
    linearised model first.

    Frequencies by the prior predictive distribution N(−G x₀, S + G W_p⁻¹Gᵀ) about the point x₀;
    shapes by 1 − MAC, cut.
    """
    if tests.size > labels.size or not tests.size:
        raise InputError(
            f"{tests.size} rigid-body test modes for {labels.size} of the model: leave test "
            "modes out"
        )
    count = perm(labels.size, tests.size)
    if count > ASSIGNMENTS.most:
        raise InputError(
            f"{count} assignments (at most {ASSIGNMENTS.most}): name fewer model modes"
        )
    choices = np.array(list(permutations(range(labels.size), tests.size)))
    std = model.parameters.std()
    w = target.weights
    # in ln f the model is close to linear in log stiffness, so it holds over a wide prior
    slope = (
        now.d_lambda[labels]
        / (8 * np.pi**2 * now.frequencies[labels] ** 2)[:, None]
        * std
    )
    miss = np.log(target.frequencies[tests, None] / now.frequencies[labels]) + slope @ (
        now.x / std
    )
    r = miss[np.arange(tests.size), choices]
    inner = slope @ slope.T
    own = np.diag(w.frequency**2 + target.std[tests] ** 2)
    cov = inner[choices[:, :, None], choices[:, None, :]] + own
    cost = np.einsum("am,am->a", r, np.linalg.solve(cov, r[..., None])[..., 0])
    cost += np.linalg.slogdet(cov)[1]
    if w.shape:
        likeness = mac(target.shapes[:, tests], now.shapes[:, labels])
        shape = np.minimum(w.shape / w.mac * (1 - likeness), ASSIGNMENTS.cap)
        cost += shape[np.arange(tests.size), choices].sum(axis=1)
    order = np.argsort(cost, kind="stable")[: ASSIGNMENTS.kept]
    return np.asarray(choices[order[cost[order] <= cost.min() + ASSIGNMENTS.margin]])


def _evaluate(
    target: Target, now: Linearisation, tests: Int, chosen: Int, *, std: Float, x: Float
) -> tuple[Float, Float, float]:
    """Residuals, slopes and J with test mode tests[i] paired with model mode chosen[i]."""
    w = target.weights
    root = 0.5 / np.hypot(w.frequency, target.std[tests])
    lam_test = (2 * np.pi * target.frequencies[tests]) ** 2
    lam = (2 * np.pi * now.frequencies[chosen]) ** 2 * np.sign(now.frequencies[chosen])
    value = [root * (1 - lam / lam_test)]
    slope = [(root / lam_test)[:, None] * now.d_lambda[chosen]]
    if w.shape > 0:
        limits = (target.pairing.close, target.pairing.largest_group)
        group = {j: g for g in close_groups(now.frequencies, *limits) for j in g}
        near = {t: g for g in close_groups(target.frequencies, *limits) for t in g}
        for t, j in zip(tests.tolist(), chosen.tolist(), strict=True):
            alone = len(near[t]) == 1 or j not in group
            r, g = shape_residual(
                target.shapes, now, t, np.array((j,) if alone else group[j])
            )
            value.append(np.sqrt(w.shape / w.mac) * r)
            slope.append(np.sqrt(w.shape / w.mac) * g)
    v = np.concatenate(value)
    s = np.concatenate(slope)
    return v, s, float(v @ v + (x / std) @ (x / std))


@dataclass(frozen=True, slots=True, eq=False)
class _Refinement:
    """Levenberg-Marquardt in the bounds with the pairs fixed, run by `core.iterate`.

    Modes keep their labels through crossings.
    """

    model: ObservedModel
    target: Target
    first: Linearisation
    tests: Int
    labels: Int
    choice: Int

    def _at(self, x: Float, now: Linearisation, modes: Int, damping: float) -> _At:
        std = self.model.parameters.std()
        value, slope, cost = _evaluate(
            self.target, now, self.tests, modes[self.choice], std=std, x=x
        )
        return _At(
            x=x,
            now=now,
            modes=modes,
            value=value,
            slope=slope,
            cost=cost,
            damping=damping,
        )

    def init(self) -> _At:
        """The start, inside the bounds."""
        low, high = self.model.parameters.bounds()
        return self._at(np.clip(self.first.x, low, high), self.first, self.labels, 1e-3)

    def step(self, at: _At) -> _At:
        """The next point, or the same with more damping."""
        std = self.model.parameters.std()
        low, high = self.model.parameters.bounds()
        gradient = at.x / std**2 - at.slope.T @ at.value
        stuck = ((at.x <= low) & (gradient > 0)) | ((at.x >= high) & (gradient < 0))
        free = np.flatnonzero(~stuck)
        normal = (at.slope.T @ at.slope + np.diag(1 / std**2))[np.ix_(free, free)]
        damped = normal + at.damping * np.diag(np.diag(normal))
        dx = np.zeros_like(at.x)
        dx[free] = -np.linalg.solve(damped, gradient[free])
        dx *= min(1.0, 0.5 / max(np.abs(dx).max(initial=0.0), 1e-300))
        trial = np.clip(at.x + dx, low, high)
        small = ASSIGNMENTS.small * min(1.0, float(std.min()))
        if float(np.abs(trial - at.x).max(initial=0.0)) < small:
            return replace(at, still=True)
        now = self.model.linearise(trial)
        # the modes of `now` that continue `modes` of `before`, by one assignment over MAC
        rows, columns = linear_sum_assignment(
            -mac(at.now.shapes[:, at.modes], now.shapes)
        )
        follow = np.asarray(columns[np.argsort(rows)])
        new = self._at(trial, now, follow, max(at.damping / 5, 1e-9))
        return new if new.cost < at.cost else replace(at, damping=8 * at.damping)

    def terminate(self, at: _At) -> Outcome | None:
        """A step too small to matter, or damping that no step survives."""
        if at.still:
            return Outcome.CONVERGED
        return Outcome.STALLED if at.damping > 1e8 else None

    def merit(self, at: _At) -> float:
        """J."""
        return at.cost


def _weighed(
    model: ObservedModel,
    target: Target,
    tests: Int,
    labels: Int,
    ends: list[tuple[_At, Int]],
) -> tuple[Assignment, ...]:
    """Assignments by their evidence, residuals larger than foreseen taken as model discrepancy of
    all of them.
    """
    w = np.diag(1 / model.parameters.std() ** 2)
    inner = [e.slope.T @ e.slope for e, _ in ends]
    i = int(np.argmin([e.cost for e, _ in ends]))
    data = target.weights.data * tests.size
    spent = data_used_up(inner[i], w)
    s2 = max(1.0, float(ends[i][0].value @ ends[i][0].value) / max(data - spent, 1.0))
    normal = [n / s2 + w for n in inner]
    fit = np.array([e.value @ e.value / s2 + e.x @ w @ e.x for e, _ in ends])
    log = -0.5 * fit - 0.5 * np.array([np.linalg.slogdet(n)[1] for n in normal])
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    out = []
    for (e, choice), n, share in zip(ends, normal, weight.tolist(), strict=True):
        chosen = e.modes[choice]
        likeness = mac(target.shapes[:, tests], e.now.shapes[:, chosen]).diagonal()
        out.append(
            Assignment(
                pairs=np.stack([tests, chosen], axis=1),
                first=labels[choice],
                x=e.x,
                covariance=linalg.inv(n),
                cost=e.cost,
                weight=share,
                frequencies=e.now.frequencies[chosen],
                mac=likeness,
            )
        )
    return tuple(sorted(out, key=lambda a: -a.weight))
