"""When sets with masses that a deck lacks are sought, and what a search keeps of its points.

A chain of ten masses between walls, five groups of two springs; a mass may be lacking at the third
and at the eighth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.reduction.dense_models import DenseModel
from ringtrue.updating.problem import residual_at, single
from ringtrue.updating.selection.proposal import with_masses
from ringtrue.updating.selection.selection_rules import FittedSet
from ringtrue.updating.selection.subset_search import (
    Search,
    SearchSettings,
    Subsets,
    subsets,
)
from ringtrue.updating.target import Target

N, TOTAL, PLACES = 10, 20.0, (2, 7)
LUMPS = [5, 6]
SETTINGS = SearchSettings(most=4, collinear=0.99)


def _chain() -> DenseModel:
    springs = np.zeros((N + 1, N, N))
    for i in range(N + 1):
        ends = [j for j in (i - 1, i) if 0 <= j < N]
        springs[i][np.ix_(ends, ends)] = (
            1e5 * (1 + 0.1 * i) * (2 * np.eye(len(ends)) - 1)
        )
    changes = np.zeros((7, N, N))
    for g in range(5):
        changes[g] = springs[2 * g] + springs[2 * g + 1]
    lumps = np.zeros((7, N, N))
    for i, place in zip(LUMPS, PLACES, strict=True):
        lumps[i, place, place] = TOTAL
    groups = [Parameter(f"springs {g}", (), 0.3, 3.0, "log", 0.3) for g in range(5)]
    places = [
        Parameter(
            f"mass at {i}",
            (CardField("CONM2", i, "M", (), TOTAL),),
            1 - 1e-7,
            1.4,
            "linear",
            0.05,
        )
        for i in PLACES
    ]
    return DenseModel(
        springs.sum(axis=0),
        np.eye(N) * TOTAL / N,
        changes,
        lumps,
        np.eye(N),
        ParameterSet((*groups, *places)),
        N,
    )


def _aim(truth: Sequence[float]) -> Target:
    rng, model = np.random.default_rng(4), _chain()
    modes = model.modes(
        np.where(np.arange(7) < 5, np.log(np.maximum(truth, 1e-9)), np.array(truth) - 1)
    )
    shapes = modes.shapes[:, :8] * (1 + 0.005 * rng.standard_normal((N, 8)))
    frequencies = modes.frequencies[:8] * (1 + 5e-4 * rng.standard_normal(8))
    return Target(frequencies, shapes, np.full(8, 5e-4), np.ones(8, dtype=bool))


@pytest.mark.parametrize(
    ("truth", "masses"),
    [((1, 0.75, 1, 1.3, 1, 1, 1), []), ((1, 0.75, 1, 1, 1, 1, 1.06), [LUMPS[1]])],
)
def test_sets_with_masses_are_sought_only_where_one_makes_a_set_better(
    truth: tuple[float, ...], masses: list[int]
) -> None:
    aim, asked = _aim(truth), list[int]()

    def search(
        barred: Sequence[int], known: Sequence[FittedSet], told: Progress
    ) -> Subsets:
        asked.append(len(barred))
        plain = Search.of(single(_chain(), aim), SETTINGS, barred=barred)
        return subsets(plain, told, known)

    own = search(LUMPS, (), quiet)
    found, barred = with_masses(search, own, LUMPS, quiet)
    best = found.path[-1].members.tolist()
    assert [i for i in LUMPS if i in best] == masses
    assert 1 in best
    assert asked == ([2, 0] if masses else [2])
    assert barred == ([] if masses else LUMPS)


def test_a_point_of_a_search_has_all_squares_and_products_in_few_rows() -> None:
    aim = _aim((1, 0.75, 1, 1, 1, 1, 1.06))
    search, x = (
        Search.of(single(_chain(), aim), SETTINGS),
        np.array([0.0, -0.2, 0.1, 0.0, 0.0, 0.0, 0.03]),
    )
    whole, few = residual_at(single(_chain(), aim), x), search.point(x)
    assert whole.value.size == 8 * (1 + N)
    assert few.value.size == 8 + 7 + 1
    of_frequency = slice(0, 8)
    np.testing.assert_array_equal(few.slope[of_frequency], whole.slope[of_frequency])
    for rows, same in (
        (few.quantity == 0, of_frequency),
        (few.quantity == 1, slice(8, None)),
    ):
        one = np.column_stack([few.slope[rows], few.value[rows]])
        other = np.column_stack([whole.slope[same], whole.value[same]])
        np.testing.assert_allclose(
            one.T @ one,
            other.T @ other,
            rtol=1e-9,
            atol=1e-9 * np.abs(other.T @ other).max(),
        )
    fresh = Search.of(single(_chain(), aim), SETTINGS)
    assert fresh.value(x).value @ fresh.value(x).value == pytest.approx(
        whole.value @ whole.value, rel=1e-9
    )
    np.testing.assert_allclose(
        fresh.point(x).slope.T @ fresh.point(x).slope,
        few.slope.T @ few.slope,
        rtol=1e-9,
    )
