"""Many starts and a global search on a problem with several minima: a short row of masses,
frequencies only.

Two springs in a row between walls with equal masses: exchanging the outer springs leaves all
frequencies as they are, so J has two equal minima, mirror images of one another; shapes tell them
apart.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import ConfigError, InputError, NumericalError
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.dense_models import DenseModel
from ringtrue.reduction.parametric import reduced_model
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.objective import Minimisation
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.solver import StartSettings, latin_hypercube, multi_start, solve
from ringtrue.updating.strategy import solve_verified
from ringtrue.updating.target import Target, Weights

TRUTH = np.array([0.6, 0.1, -0.5])


def between_walls() -> DenseModel:
    springs = np.array([[[1.0, 0], [0, 0]], [[1, -1], [-1, 1]], [[0, 0], [0, 1]]]) * 1e4
    names = ParameterSet(
        tuple(
            Parameter(n, (), 0.3, 3.0, "log", 1e3) for n in ("left", "middle", "right")
        )
    )
    return DenseModel.springs(springs.sum(axis=0), np.eye(2), springs, names)


def problem(shape: float) -> Problem:
    model = between_walls()
    at = model.modes(TRUTH)
    target = Target(
        at.frequencies,
        at.shapes,
        np.zeros(2),
        np.ones(2, dtype=bool),
        Weights(shape=shape),
        rule="cost",
        lost=1e6,
    )
    return Problem((Configuration(model, target),), precision=1e-8 * np.eye(3))


def test_starts_find_both_mirror_images_and_shapes_leave_one() -> None:
    starts = latin_hypercube(between_walls().parameters, 16, np.random.default_rng(0))
    low, high = between_walls().parameters.bounds()
    assert (starts >= low).all()
    assert (starts <= high).all()
    linked = Problem(
        problem(0.0).configurations,
        precision=1e-8 * np.eye(3),
        rows=np.array([[0, 1.0, 0], [0, -1, 0]]),
        limits=np.array([0.1, -0.1]),
    )
    several = multi_start(linked, np.where([False, True, False], 0.1, starts))
    low_ends = several.ends[several.costs < 1e-3]
    assert {tuple(np.round(e, 2)) for e in low_ends} == {
        (0.6, 0.1, -0.5),
        (-0.5, 0.1, 0.6),
    }
    assert set(several.minimum[several.costs < 1e-3].tolist()) == {0, 1}
    one = multi_start(problem(1.0), starts, settings=StartSettings(10, 4))
    np.testing.assert_allclose(one.best.x, TRUTH, atol=1e-4)
    assert one.share > 0.5


def test_an_updating_goes_on_from_the_best_end_and_does_not_solve_it_again() -> None:
    u = UpdateSection(starts=4)
    done = Minimisation(u, 1).starting_point(problem(1.0), lambda _, __: None)
    np.testing.assert_allclose(done.x, TRUTH, atol=1e-4)
    assert done.evaluations > 1  # the way there, not a look at its end


class Broken:
    """A model that no start can solve."""

    parameters = between_walls().parameters

    def linearise(self, x: np.ndarray) -> Linearisation:
        raise NumericalError("singular")

    modes = linearise


def test_starts_that_cannot_be_solved_are_told() -> None:
    only = problem(1.0).configurations[0]
    with pytest.raises(
        NumericalError, match="none of 2 starts could be solved; singular"
    ):
        multi_start(Problem((Configuration(Broken(), only.target),)), np.zeros((2, 3)))
    with pytest.raises(ConfigError, match="0 starts"):
        latin_hypercube(Broken.parameters, 0, np.random.default_rng(0))


def test_verified_updating_ends_on_the_full_model() -> None:
    """Sixty masses, eight parameters changed by up to a factor of two, a small basis: exact at the
    end.
    """
    n, groups = 60, 8
    parts = np.zeros((groups, n, n))
    for i in range(n):
        v = np.zeros(n)
        v[i] = 1
        if i:
            v[i - 1] = -1
        parts[i * groups // n] += 4e4 * np.outer(v, v)
    names = ParameterSet(
        tuple(Parameter(f"k{g}", (), 0.2, 5.0, "log", 1e4) for g in range(groups))
    )
    empty = sparse.csr_array((n, n))
    terms = tuple(
        AffineTerm(power(i), sparse.csr_array(k), empty) for i, k in enumerate(parts)
    )
    eye = sparse.eye_array(n).tocsr()
    system = AffineSystem(
        sparse.csr_array(parts.sum(axis=0)), eye, names, terms, eye[::4]
    )
    rich = reduced_model(system, 8)
    model = rich.on(rich.basis.vectors[:, :16])  # hardly more than the modes
    full = DenseModel(
        parts.sum(axis=0),
        np.eye(n),
        parts,
        np.zeros_like(parts),
        np.eye(n)[::4],
        names,
        8,
    )
    truth = np.array([0.6, -0.5, 0.3, -0.6, 0.5, -0.2, 0.4, -0.4])
    at = full.modes(truth)
    target = Target(
        at.frequencies[:6], at.shapes[:, :6], np.zeros(6), np.ones(6, dtype=bool)
    )
    start = Problem((Configuration(model, target),))
    assert np.abs(solve(start).x - truth).max() > 1e-2
    done = solve_verified(start, tolerance=1e-8)
    assert done.full_solutions <= 4
    assert done.error < 1e-8
    np.testing.assert_allclose(done.solution.x, truth, atol=1e-3)
    with pytest.raises(InputError, match="needs one configuration"):
        solve_verified(Problem((Configuration(full, target),)))
