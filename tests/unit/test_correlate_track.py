"""Modes followed through crossing and veering of two coupled oscillators, and significance of
deviations.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from ringtrue.correlation.pairing import track
from ringtrue.correlation.table import significance
from ringtrue.errors import InputError

MASS = np.diag([1.0, 2.0, 3.0])


def oscillators(x: float, coupling: float) -> tuple[np.ndarray, np.ndarray]:
    """Two frequencies that meet at x = 0.5, coupled by a spring, and a third far above."""
    K = np.diag([100 * (0.5 + x), 200.0, 3000.0])
    K[:2, :2] += coupling * np.array([[1, -1], [-1, 1]])
    lam, phi = linalg.eigh(K, MASS)
    return np.sqrt(lam) / (2 * np.pi), phi


def test_track_of_a_given_sequence() -> None:
    found = [oscillators(x, 0.2) for x in np.linspace(0, 1, 5)]
    t = track([f for f, _ in found], [p for _, p in found], count=2)
    assert t.index[-1].tolist() == [1, 0]
    assert t.frequencies.shape == (5, 2)
    with pytest.raises(InputError, match="compute more"):
        track([np.ones(3), np.ones(2)], [np.eye(3), np.eye(3)[:, :2]])


def test_significance_at_the_stated_rate() -> None:
    s = significance(
        np.array([10.0, 20.0, 30.0]), np.array([10.3, 20.1, 33.0]), 0.3, 0.4
    )
    np.testing.assert_allclose(s.std, 0.5)
    np.testing.assert_allclose(s.z, [0.6, 0.2, 6.0], atol=1e-12)
    assert s.significant.tolist() == [False, False, True]
    total, count, p = s.chi_square
    assert (total, count) == (pytest.approx(36.4), 3)
    assert p < 1e-6


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
    with pytest.raises(InputError, match="negative"):
        significance(f, f, -1.0)
