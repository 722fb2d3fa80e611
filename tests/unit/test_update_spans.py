"""Close modes in the updating: J has no jump and no kink where modes of the model pass the limit of
closeness.

Structure: six storeys with two degrees of freedom each, springs along x and y and weak skew ones
that mix them, so that each x mode has a y mode beside it. What is measured is 0.6 % apart; the
model is taken to any distance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.iterate import Outcome
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.correlation.assignment import WORTH, PairingSettings
from ringtrue.reduction.dense_models import DenseModel
from ringtrue.shapes import FADE
from ringtrue.updating.problem import Configuration, Problem, single
from ringtrue.updating.residuals.modal import Eigenvalues, Mac, Shapes
from ringtrue.updating.solver import Method, solve
from ringtrue.updating.target import Target, Weights, match, spans

N, MODES = 6, 4
CLOSE = PairingSettings().close


def spring(i: int, axis: tuple[float, float]) -> np.ndarray:
    v = np.zeros(2 * N)
    v[2 * i : 2 * i + 2] = axis
    if i:
        v[2 * i - 2 : 2 * i] = -np.array(axis)
    return np.asarray(1e4 * np.outer(v, v))


def tower(skew: float = 0.004, along: np.ndarray | None = None) -> DenseModel:
    """Four parameters: springs along x and y of the lower and of the upper half."""
    scale = np.ones((2, N)) if along is None else along
    half = N // 2
    parts = [
        sum(scale[d, i] * spring(i, axis) for i in range(*span))
        for d, axis in enumerate([(1.0, 0.0), (0.0, 1.0)])
        for span in ((0, half), (half, N))
    ]
    rest = sum(skew * spring(i, (0.7, 0.7 if i % 2 else 0.65)) for i in range(N))
    names = ParameterSet(
        tuple(Parameter(n, (), 0.3, 3.0, "log", 0.5) for n in ("x1", "x2", "y1", "y2"))
    )
    K = np.array(parts)
    M = np.diag(np.repeat(1 + 0.05 * np.arange(N), 2))
    return DenseModel(
        K.sum(axis=0) + rest, M, K, np.zeros_like(K), np.eye(2 * N), names, MODES + 2
    )


def aim(seed: int = 0, rule: str = "capped") -> Target:
    """Measured on springs each of which is off by itself; the two directions nearly alike."""
    rng = np.random.default_rng(seed)
    there = tower(0.01, np.exp(0.03 * rng.standard_normal((2, N)))).modes(
        np.array([0.1, -0.15, 0.11, -0.15])
    )
    shapes = there.shapes[:, :MODES] + 0.01 * rng.standard_normal((2 * N, MODES))
    f = there.frequencies[:MODES]
    used = np.ones(MODES, dtype=bool)
    return Target(f, shapes, np.full(MODES, 1e-3), used, Weights(), rule=rule, lost=1e3)  # type: ignore[arg-type]


def at(gap: float) -> np.ndarray:
    """Parameters that put y modes above x modes by about `gap`."""
    return np.array([0.1, -0.15, 0.1 + 2 * gap, -0.15 + 2 * gap])


def test_j_and_its_gradient_are_steady_across_all_limits() -> None:
    problem = Problem((Configuration(tower(), aim()),))
    gaps = np.arange(0.004, 1.1 * FADE * WORTH.close * CLOSE, 2e-4)
    cost = np.array([problem.cost(at(g)) for g in gaps])
    np.testing.assert_array_less(np.abs(np.diff(cost)), 0.02 * np.ptp(cost))
    for gap in (
        0.8 * CLOSE,
        1.2 * CLOSE,
        1.1 * WORTH.close * CLOSE,
        1.3 * WORTH.close * CLOSE,
    ):
        y = at(gap)
        got = [
            (problem.cost(y + e) - problem.cost(y - e)) / 2e-5 for e in 1e-5 * np.eye(4)
        ]
        told = 2 * problem.gradient(problem.evaluate(y))
        # of the differences
        np.testing.assert_allclose(told, got, atol=1e-5 * np.abs(got).max())


def test_the_limits_are_passed_by_sets_that_fade() -> None:
    """Partners of close test modes stand for each other up to `WORTH.close` times the limit; further off
    a mode is alone.
    """
    model, target = tower(), aim()
    sizes = []
    for gap in (0.004, 1.2 * WORTH.close * CLOSE, 1.1 * FADE * WORTH.close * CLOSE):
        now = model.linearise(at(gap))
        pairs = np.stack([np.arange(2), np.arange(2)], axis=1)
        sizes.append(
            spans(target.frequencies, target.used, pairs, now, target.pairing)[0]
        )
    assert [s.sets[-1].size for s in sizes] == [2, 2, 1]
    assert 1 < sizes[1].size < 2
    assert sizes[1].weight.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(sizes[1].slope.sum(axis=0), 0.0, atol=1e-12)
    assert sizes[1].held().slope.shape[1] == 0
    loose = replace(
        now, frequencies=np.append(-1e-4, now.frequencies[1:])
    )  # locked to a mode that nothing holds
    assert [
        s.size
        for s in spans(target.frequencies, target.used, pairs, loose, target.pairing)
    ] == [1, 1]


@pytest.mark.parametrize(
    "term", [Mac(), Mac(form="ratio"), Shapes()], ids=["mac", "ratio", "shapes"]
)
def test_slopes_between_the_limits_are_those_of_the_values(term: Mac | Shapes) -> None:
    problem = Problem((Configuration(tower(), aim(), (Eigenvalues(), term)),))
    y = at(1.2 * WORTH.close * CLOSE)
    got = [
        (
            problem.evaluate(y - e, slopes=False).value
            - problem.evaluate(y + e, slopes=False).value
        )
        / 2e-5
        for e in 1e-5 * np.eye(4)
    ]
    told = problem.evaluate(y).slope
    np.testing.assert_allclose(told, np.transpose(got), atol=1e-6 * np.abs(got).max())


@pytest.mark.parametrize("kind", ["levenberg-marquardt", "trust-region"])
def test_every_method_ends_where_modes_stand_at_the_limit(kind: str) -> None:
    """The springs that the model ties together hold its modes at any distance; each end is a
    minimum.
    """
    for gap in (0.6 * CLOSE, 0.5 * WORTH.close * CLOSE, 0.6 * WORTH.close * CLOSE):
        tie = np.array(
            [[-1.0, 0, 1, 0], [1.0, 0, -1, 0], [0, -1.0, 0, 1], [0, 1.0, 0, -1]]
        )
        limits = np.array([2 * gap, -2 * gap + 1e-3, 2 * gap, -2 * gap + 1e-3])
        tied = Problem((Configuration(tower(), aim()),), rows=tie, limits=limits)
        done = solve(tied, Method(kind), start=at(gap - 1e-4))  # type: ignore[arg-type]
        assert done.outcome is Outcome.CONVERGED, (gap, done.why)
    assert len(match(aim(), tower().linearise(done.x))[0]) == MODES


def test_the_choice_of_parameters_ends_there_too() -> None:
    assert solve(single(tower(), aim())).outcome is Outcome.CONVERGED
