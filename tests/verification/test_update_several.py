"""The problem and the driver: methods, limits, links, stages, losses, several configurations,
failure and resumption.

Model: a row of masses on springs in groups, one stiffness factor a group; a second configuration
carries a known mass at its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from ringtrue.core.iterate import Outcome
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import ConfigError, DataError, InputError, NumericalError
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.dense_models import DenseModel
from ringtrue.updating.problem import (
    Configuration,
    Huber,
    Problem,
    Squares,
    comparable_criteria,
    held_to,
    joined,
    least_distance,
    residual_at,
    single,
)
from ringtrue.updating.residuals.modal import Eigenvalues, Frequencies, Mac, Shapes
from ringtrue.updating.solver import Kind, Method, solve, staged
from ringtrue.updating.target import LOST, Target, Weights

TRUTH = np.array([0.4, -0.3, 0.2, -0.25])
EXACT = 1e-4  # noise-free recovery; the weak prior pulls by this much at most


def row(
    n: int = 15, groups: int = 4, *, added: float = 0.0, seen: int = 0, **more: object
) -> DenseModel:
    parts = np.zeros((groups, n, n))
    for i in range(n):
        v = np.zeros(n)
        v[i] = 1
        if i:
            v[i - 1] = -1
        parts[i * groups // n] += 4e4 * np.outer(v, v)
    mass = np.diag(1 + 0.05 * np.arange(n))
    mass[-1, -1] += added
    settings = {"std": 100.0, "lower": 0.1, "upper": 10.0} | more
    names = ParameterSet(tuple(Parameter(f"p{i}", **settings) for i in range(groups)))  # type: ignore[arg-type]
    return DenseModel.springs(parts.sum(axis=0), mass, parts, names, range(seen or n))


def aim_at(model: DenseModel, x: np.ndarray, m: int, **more: object) -> Target:
    at = model.modes(x)
    return Target(
        at.frequencies[:m],
        at.shapes[:, :m],
        np.zeros(m),
        np.ones(m, dtype=bool),
        **more,
    )  # type: ignore[arg-type]


def noisy(
    model: DenseModel,
    m: int = 8,
    *,
    frequency: float = 0.02,
    shape: float = 0.05,
    **more: object,
) -> Target:
    rng = np.random.default_rng(7)
    aim = aim_at(model, TRUTH, m, **more)
    shapes = aim.shapes + shape * np.abs(aim.shapes).max() * rng.standard_normal(
        aim.shapes.shape
    )
    return replace(
        aim,
        frequencies=aim.frequencies * (1 + frequency * rng.standard_normal(m)),
        shapes=shapes,
    )


def one(model: DenseModel, target: Target, **more: object) -> Problem:
    return Problem((Configuration(model, target),), **more)  # type: ignore[arg-type]


def slope_of_j(problem: Problem, y: np.ndarray, h: float = 1e-5) -> np.ndarray:
    at = problem.evaluate(y)
    return np.array(
        [
            (problem.cost(y + e, at) - problem.cost(y - e, at)) / (2 * h)
            for e in h * np.eye(y.size)
        ]
    )


@pytest.mark.parametrize("kind", get_args(Kind))
def test_every_method_recovers_the_truth(kind: str) -> None:
    model = row()
    done = solve(one(model, aim_at(model, TRUTH, 8)), Method(kind))  # type: ignore[arg-type]
    assert done.outcome is Outcome.CONVERGED, done.why
    np.testing.assert_allclose(done.x, TRUTH, atol=EXACT)
    assert len(done.history) <= 15


def test_methods_end_at_the_same_stationary_point() -> None:
    model = row(std=0.1)  # a prior that matters
    problem = one(model, noisy(model))
    start = np.linalg.norm(slope_of_j(problem, np.zeros(4)))
    ends = {k: solve(problem, Method(k)) for k in get_args(Kind)}  # type: ignore[arg-type]
    for done in ends.values():
        slope = np.linalg.norm(slope_of_j(problem, done.y))
        assert done.outcome is Outcome.CONVERGED, done.why
        assert slope < 1e-5 * start
        np.testing.assert_allclose(done.x, ends["trust-region"].x, atol=1e-5)


def test_gradient_of_the_objective_is_its_derivative_with_every_part_in_it() -> None:
    model = row(std=0.5)
    target = noisy(model, frequency=0.05)
    terms = (Frequencies(0.02), Shapes(), Mac(0.1), Eigenvalues(0.03))
    for loss in (Squares(), Huber(0.5)):
        problem = Problem(
            (Configuration(model, target, terms),),
            loss=loss,
            link=np.eye(4)[:, :3] + np.eye(4, 3, k=-3),
        )
        y = np.array([0.1, -0.1, 0.05])
        at = problem.evaluate(y)
        got = slope_of_j(problem, y)
        np.testing.assert_allclose(
            2 * problem.gradient(at), got, atol=1e-5 * np.abs(got).max()
        )
        assert at.cost == pytest.approx(problem.cost(y), rel=1e-12)


def test_bounds_and_linear_constraints_hold_and_the_rest_is_stationary() -> None:
    model = row(lower=0.8, upper=1.25)
    rows, limits = np.array([[0.0, 1.0, 1.0, 0.0]]), np.array([-0.3])  # x1 + x2 <= -0.3
    problem = one(
        model,
        aim_at(model, np.array([0.5, -0.1, 0.05, -0.1]), 8),
        rows=rows,
        limits=limits,
    )
    done = solve(problem, start=np.array([0.0, -0.16, -0.16, 0.0]))
    assert done.outcome is Outcome.CONVERGED
    assert "constraints are reached" in done.why
    low, high = model.parameters.bounds()
    assert (done.x >= low - 1e-9).all()
    assert (done.x <= high + 1e-9).all()
    assert done.x[0] == pytest.approx(high[0], abs=1e-9)
    assert float(rows[0] @ done.x) == pytest.approx(-0.3, abs=1e-7)
    slope, start = (
        2 * problem.gradient(done.end),
        np.linalg.norm(slope_of_j(problem, np.zeros(4))),
    )
    assert slope[0] < 0  # J would fall further outside
    assert abs(slope[1] - slope[2]) < 1e-4 * start  # along the constraint
    assert done.x[3] == pytest.approx(high[3], abs=1e-9)
    assert slope[3] < 0


def test_a_start_outside_of_the_constraints_is_taken_inside() -> None:
    """The first two tied to each other, a band with no inside; the start is far outside of it and
    of the bounds.
    """
    model = row(lower=0.5, upper=2.0)
    aim = aim_at(model, np.array([0.3, -0.1, 0.05, -0.1]), 8)
    tie = np.array([[1.0, -1.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0]])
    problem = one(model, aim, rows=tie, limits=np.zeros(2))
    low, high = model.parameters.bounds()
    ends = [
        solve(problem, start=y) for y in (np.zeros(4), np.array([3.0, -0.4, 0.3, -5.0]))
    ]
    for done in ends:
        assert done.outcome is Outcome.CONVERGED
        assert done.x[0] == pytest.approx(done.x[1], abs=1e-7)
        assert (done.x >= low - 1e-9).all()
        assert (done.x <= high + 1e-9).all()
    np.testing.assert_allclose(ends[1].x, ends[0].x, atol=1e-4)
    inside = np.array([0.2, 0.2, 0.0, 0.0])
    np.testing.assert_array_equal(problem.nearest(inside), inside)
    np.testing.assert_allclose(
        problem.nearest(np.array([0.4, 0.0, 0.1, 0.0])),
        [0.2, 0.2, 0.1, 0.0],
        atol=1e-12,
    )
    heavy = one(
        model,
        aim,
        rows=1e9 * np.array([[0.3, 0.1, 0.7, 0.9], [-0.3, -0.1, -0.7, -0.9]]),
        limits=np.zeros(2),
    )
    for y in np.random.default_rng(2).uniform(
        -0.6, 0.6, (20, 4)
    ):  # terms in kg, say: the rounding of these is large
        assert (
            abs(heavy.rows[0] @ heavy.nearest(y)) < 1e-9 * np.abs(heavy.rows[0]).sum()
        )
    with pytest.raises(ConfigError, match="no point fulfils"):
        solve(one(model, aim, rows=tie, limits=np.array([-0.1, -0.1])))


def test_a_constraint_on_parameters_that_are_held_does_not_stop_the_others() -> None:
    """x1 >= 0.2, which no set without x1 can keep: such sets are looked at in proposals and
    stages.
    """
    model = row(lower=0.5, upper=2.0)
    aim = aim_at(model, np.array([0.1, 0.3, 0.05, 0.1]), 8)
    problem = one(
        model, aim, rows=np.array([[0.0, -1.0, 0.0, 0.0]]), limits=np.array([-0.2])
    )
    done = solve(held_to(problem, ["p0"]))
    assert done.outcome is Outcome.CONVERGED
    assert done.x[1] == 0.0
    last = staged(problem, [["p0"], ["p0", "p1"]])[-1]
    assert last.x[1] >= 0.2 - 1e-9


def test_least_distance_meets_the_conditions_of_karush_kuhn_and_tucker() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        q, c = 6, 15
        a = rng.standard_normal((q, q))
        h, g = (
            a @ a.T + 0.1 * np.eye(q),
            10 ** rng.uniform(-6, 6) * rng.standard_normal(q),
        )
        rows, limits = rng.standard_normal((c, q)), rng.uniform(0, 1, c)
        d = least_distance(h, g, rows, limits)
        assert (rows @ d <= limits + 1e-8).all()
        active = rows @ d > limits - 1e-7
        force = -(h @ d + g)
        multipliers = np.linalg.lstsq(rows[active].T, force)[0]
        size = np.linalg.norm(g)
        assert np.linalg.norm(rows[active].T @ multipliers - force) < 1e-6 * size
        assert (multipliers > -1e-6 * size).all()


def test_no_unknown_moves_more_than_the_limit_in_a_step() -> None:
    model = row()
    done = solve(
        one(model, aim_at(model, np.array([0.9, -0.8, 0.7, -0.8]), 8)),
        Method(move=0.2),
    )
    steps = np.array(
        [
            np.abs(b.y - a.y).max()
            for a, b in zip(done.history, done.history[1:], strict=False)
        ]
    )
    assert steps.max() <= 0.2 + 1e-9
    np.testing.assert_allclose(done.x, [0.9, -0.8, 0.7, -0.8], atol=EXACT)


def test_linked_parameters_are_equal_and_half_as_many() -> None:
    model = row()
    truth = np.array([0.3, -0.2, 0.3, -0.2])
    link = np.vstack([np.eye(2), np.eye(2)])
    done = solve(one(model, aim_at(model, truth, 8), link=link))
    assert done.y.size == 2
    np.testing.assert_allclose(done.x, truth, atol=EXACT)
    assert done.covariance.shape == (2, 2)


def test_stages_go_on_from_one_another() -> None:
    model = row()
    problem = one(model, aim_at(model, TRUTH, 8))
    first, second = staged(problem, [("p0", "p1"), ("p0", "p1", "p2", "p3")])
    assert first.x[2:].tolist() == [0, 0]
    assert second.history[0].x.tolist() == first.x.tolist()
    np.testing.assert_allclose(second.x, TRUTH, atol=EXACT)
    with pytest.raises(InputError, match="parameters that stay"):
        staged(problem, [("p0",), ("p1",)])
    with pytest.raises(InputError, match="no parameter 'p9'"):
        held_to(problem, ["p9"])


def test_a_robust_loss_withstands_a_wrong_mode() -> None:
    model = row()
    aim = aim_at(model, TRUTH, 8)
    f = aim.frequencies * np.where(
        np.arange(8) == 4, 1.15, 1.0
    )  # mode 5 is 15 % off: fifteen standard deviations
    aim = replace(aim, frequencies=f)
    plain = solve(one(model, aim))
    robust = solve(one(model, aim, loss=Huber(1.5)), start=plain.y)
    assert np.abs(plain.x - TRUTH).max() > 0.1
    assert np.abs(robust.x - TRUTH).max() < 0.05


def test_two_configurations_tell_what_one_cannot() -> None:
    """Two frequencies without shapes for four stiffnesses: only with the added mass there are
    enough.
    """
    bare, loaded = row(), row(added=5.0)
    only = Weights(shape=0.0)
    sets = [Configuration(m, aim_at(m, TRUTH, 3, weights=only)) for m in (bare, loaded)]
    alone, both = solve(Problem((sets[0],))), solve(Problem(tuple(sets)))
    assert alone.cost < 1e-2  # it fits its own test
    assert np.abs(alone.x - TRUTH).max() > 0.05
    np.testing.assert_allclose(both.x, TRUTH, atol=5e-3)
    assert both.end.mode.size == 6
    assert np.unique(both.end.mode).size == 6


def test_configurations_share_parameters_by_name() -> None:
    first, second = row(), row(added=5.0)
    part = second.with_parameters([3, 1])
    problem = Problem(
        (
            Configuration(first, aim_at(first, TRUTH, 5)),
            Configuration(part, aim_at(part, TRUTH[[3, 1]], 5)),
        )
    )
    assert problem.parameters.names == ("p0", "p1", "p2", "p3")
    at = problem.evaluate(np.zeros(4))
    own = at.slope[at.mode >= 1_000_000]
    assert not own[:, [0, 2]].any()
    assert own[:, [1, 3]].any()
    y = np.array([0.1, 0.2, -0.1, 0.15])
    got = slope_of_j(problem, y)
    np.testing.assert_allclose(
        2 * problem.gradient(problem.evaluate(y)), got, atol=1e-5 * np.abs(got).max()
    )
    other = ParameterSet((Parameter("p1", std=3.0),))
    with pytest.raises(InputError, match="different bounds"):
        joined([first.parameters, other])


@dataclass(frozen=True, eq=False)
class Fragile:
    """A model whose solver fails beyond a stiffness factor, and that can be stopped after a number
    of calls.
    """

    inner: DenseModel
    highest: float
    calls: list[int]
    stop: int = 10**6

    @property
    def parameters(self) -> ParameterSet:
        return self.inner.parameters

    def linearise(self, x: np.ndarray) -> Linearisation:
        self.calls.append(1)
        if len(self.calls) == self.stop:
            raise KeyboardInterrupt
        if float(np.max(x)) > self.highest:
            raise NumericalError("no convergence of the eigensolver")
        return self.inner.linearise(x)

    def modes(self, x: np.ndarray) -> Linearisation:
        return self.inner.modes(x)


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_point_that_cannot_be_solved_is_a_rejected_step(kind: str) -> None:
    inner = row()
    truth = np.array([0.6, 0.3, 0.2, -0.3])
    aim = aim_at(inner, truth, 8)
    model = Fragile(inner, 0.65, [])
    done = solve(
        Problem((Configuration(model, aim),)),
        Method(kind, radius=5.0, move=5.0, damping=1e-8),
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(done.x, truth, atol=EXACT)
    walled = solve(
        Problem((Configuration(Fragile(inner, 0.3, []), aim),)), Method(kind)
    )  # type: ignore[arg-type]
    assert walled.x.max() <= 0.3
    assert walled.outcome in (
        Outcome.STALLED,
        Outcome.MAX_ITERATIONS,
    )  # it may creep along the wall
    assert solve(single(Fragile(inner, 0.3, []), aim)).x.max() <= 0.3
    with pytest.raises(NumericalError, match="no convergence"):
        solve(Problem((Configuration(model, aim),)), start=np.ones(4))


def test_an_interrupted_run_goes_on_from_its_last_point(tmp_path: Path) -> None:
    inner = row()
    aim, file = (
        aim_at(inner, np.array([0.9, -0.8, 0.7, -0.8]), 8),
        tmp_path / "point.json",
    )
    whole = solve(one(inner, aim))
    with pytest.raises(KeyboardInterrupt):
        solve(
            Problem((Configuration(Fragile(inner, 9.0, [], stop=5), aim),)),
            checkpoint=file,
        )
    resumed = solve(one(inner, aim), checkpoint=file)
    assert whole.history[-1].cost < resumed.history[0].cost < whole.history[0].cost
    assert resumed.evaluations < whole.evaluations
    np.testing.assert_allclose(resumed.x, whole.x, atol=1e-6)
    assert (
        solve(one(inner, aim), checkpoint=file).evaluations == 1
    )  # finished: nothing is left to do
    with pytest.raises(DataError, match="other parameters"):
        solve(
            one(row(groups=3), aim_at(row(groups=3), np.zeros(3), 8)), checkpoint=file
        )
    file.write_text("{")
    with pytest.raises(DataError, match="not a checkpoint"):
        solve(one(inner, aim), checkpoint=file)


def test_limits_are_reached_and_said() -> None:
    model = row()
    done = solve(
        one(model, aim_at(model, np.array([0.9, -0.8, 0.7, -0.8]), 8)), iterations=1
    )
    assert done.outcome is Outcome.MAX_ITERATIONS
    with pytest.raises(ConfigError, match="did you mean 'trust-region'"):
        Method("trust region")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="got precision"):
        one(model, aim_at(model, TRUTH, 4), precision=np.eye(3))


def along(aim: Target, model: DenseModel, points: int = 151) -> np.ndarray:
    """J on a line that carries the model from far on one side of the truth to far on the other."""
    line = np.linspace(-3.0, 2.0, points)[:, None] * np.array([1.0, -0.8, 0.9, -0.7])
    return np.array([single(model, aim).cost(x) for x in line])


def test_pairs_of_least_cost_make_j_continuous_where_gates_make_it_jump() -> None:
    model = row(seen=4)
    gated = aim_at(model, TRUTH, 6)
    cheapest = replace(gated, rule="cost")
    jump = [np.abs(np.diff(along(a, model))).max() for a in (gated, cheapest)]
    fine = np.abs(np.diff(along(cheapest, model, 601))).max()
    assert jump[0] > 50  # a lost mode costs 100
    assert jump[1] < 0.5 * jump[0]
    assert fine == pytest.approx(
        jump[1] / 4, rel=0.5
    )  # differences shrink with the step: no jump is left


def test_no_pair_costs_more_than_a_lost_mode_and_used_modes_choose_first() -> None:
    model = row()
    aim = replace(aim_at(model, TRUTH, 8), rule="cost", used=np.arange(8) != 2)
    far = residual_at(single(model, aim), np.array([1.5, -1.5, 1.5, -1.5]))
    assert 0 < far.used.sum() < 7
    problem = one(model, aim)
    at = problem.evaluate(np.array([1.5, -1.5, 1.5, -1.5]))
    assert at.data + at.lost <= 7 * LOST
    assert at.lost == LOST * (7 - far.used.sum())
    done = solve(problem)
    np.testing.assert_allclose(done.x, TRUTH, atol=EXACT)
    assert (
        np.abs(done.end.points[0].mac - 1).max() < 1e-6
    )  # the mode left out has found its partner, too


def test_criterion_counts_the_same_modes_in_every_set() -> None:
    """A set that loses a mode which it fits badly must not look better than the set that keeps
    it.
    """
    model = row()
    aim = noisy(model)
    x = solve(one(model, aim)).x
    full = residual_at(single(model, aim), x)
    worst = int(np.argmax(np.abs(full.frequency_error)))
    few = replace(aim, used=np.arange(8) != worst)
    lost = residual_at(single(model, few), x)
    std = model.parameters.std()
    a, b = comparable_criteria(aim, [full, lost], [x, x], [std, std])
    assert b > a
    same = comparable_criteria(aim, [full, full], [x, x[:2]], [std, std[:2]])
    assert same[1] < same[0]  # two parameters fewer for the same fit
