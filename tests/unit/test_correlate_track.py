"""Modes followed through crossing and veering of two coupled oscillators, and significance of
deviations.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from ringtrue.correlation.table import significance
from ringtrue.correlation.tracking import follow, track, track_along
from ringtrue.errors import ConfigError, InputError

MASS = np.diag([1.0, 2.0, 3.0])


def oscillators(x: float, coupling: float) -> tuple[np.ndarray, np.ndarray]:
    """Two frequencies that meet at x = 0.5, coupled by a spring, and a third far above."""
    K = np.diag([100 * (0.5 + x), 200.0, 3000.0])
    K[:2, :2] += coupling * np.array([[1, -1], [-1, 1]])
    lam, phi = linalg.eigh(K, MASS)
    return np.sqrt(lam) / (2 * np.pi), phi


def test_crossing_is_followed_with_two_solves() -> None:
    t = track_along(
        lambda x: oscillators(float(x[0]), 0.0), np.array([0.0]), np.array([1.0]), 2, mass=MASS
    )
    assert t.solves == 2
    assert t.index.tolist() == [[0, 1], [1, 0]]
    np.testing.assert_allclose(t.frequencies[-1], np.sqrt([150, 100]) / (2 * np.pi))


def test_veering_is_resolved_by_smaller_steps_and_keeps_the_branch() -> None:
    """With coupling the branches never cross: the lower stays the lower, though its shape becomes
    the other's.
    """

    def solve(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return oscillators(float(x[0]), 8.0)

    t = track_along(solve, np.array([0.0]), np.array([1.0]), 2, mass=MASS, least=0.99)
    assert t.index[-1].tolist() == [0, 1]
    assert t.worst.min() >= 0.99
    assert 4 < t.solves < 40
    assert (np.diff(t.points[:, 0]) > 0).all()
    across = track_along(solve, np.array([0.0]), np.array([1.0]), 2, mass=MASS)
    assert across.index[-1].tolist() == [1, 0]  # a step across a narrow veering follows the shapes


def test_limit_of_solves_is_told_by_the_overlap() -> None:
    t = track_along(
        lambda x: oscillators(float(x[0]), 3.0),
        np.array([0.0]),
        np.array([0.52]),
        2,
        mass=MASS,
        most_solves=2,
    )
    assert t.solves == 2
    assert t.worst.min() < 0.8
    assert (
        not follow(oscillators(0.0, 3.0)[1][:, :2], oscillators(0.52, 3.0)[1], MASS).sure(0.8).all()
    )


def test_track_of_a_given_sequence() -> None:
    found = [oscillators(x, 0.2) for x in np.linspace(0, 1, 5)]
    t = track([f for f, _ in found], [p for _, p in found], MASS, count=2)
    assert t.index[-1].tolist() == [1, 0]
    assert t.frequencies.shape == (5, 2)
    with pytest.raises(InputError, match="compute more"):
        follow(np.eye(3), np.eye(3)[:, :2])


def test_significance_at_the_stated_rate() -> None:
    s = significance(np.array([10.0, 20.0, 30.0]), np.array([10.3, 20.1, 33.0]), 0.3, 0.4)
    np.testing.assert_allclose(s.std, 0.5)
    np.testing.assert_allclose(s.z, [0.6, 0.2, 6.0], atol=1e-12)
    assert s.significant.tolist() == [False, False, True]
    total, count, p = s.chi_square
    assert (total, count) == (pytest.approx(36.4), 3)
    assert p < 1e-6
    with_model = significance(np.array([30.0]), np.array([33.0]), 0.3, model=0.1)
    assert with_model.std[0] == pytest.approx(np.hypot(0.3, 3.0))
    assert not with_model.significant.any()


def test_false_discoveries_are_rare_and_unknown_is_never_significant() -> None:
    rng = np.random.default_rng(0)
    f = np.full(20, 50.0)
    any_found = [
        significance(f, f + 0.1 * rng.standard_normal(20), 0.1).significant.any()
        for _ in range(400)
    ]
    assert 0.02 < np.mean(any_found) < 0.09
    unknown = significance(f, f + 5, np.nan)
    assert not unknown.significant.any()
    assert np.isnan(unknown.z).all()
    assert unknown.chi_square[1] == 0
    with pytest.raises(ConfigError, match="rate"):
        significance(f, f, rate=2)
    with pytest.raises(InputError, match="negative"):
        significance(f, f, -1.0)
