"""Chebyshev series of functions of one factor each, against the functions and their derivatives."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.fem.parametrisation.interpolation import fitted

BOUNDS = np.array([[0.5, 2.0], [0.1, 10.0], [0.5, 1.5]])
EXACT = 1e-11  # relative to the largest value, or slope


def rational(a: Float) -> list[Float]:
    """As a beam's stiffness of its shear, and a solid's of Poisson's ratio 0.3."""
    first, wide, ratio = a.tolist()
    return [
        np.array([first / (1 + 3 * first), first**2]),
        np.array([wide / (1 + wide)]),
        np.array([1 / (1 - 0.6 * ratio)]),
    ]


def test_values_and_slopes_of_rational_functions() -> None:
    made = fitted(BOUNDS, rational)
    for share in (0.0, 0.13, 0.5, 0.77, 1.0):
        a = BOUNDS[:, 0] * (BOUNDS[:, 1] / BOUNDS[:, 0]) ** share
        first, wide, ratio = a.tolist()
        slopes = [
            [1 / (1 + 3 * first) ** 2, 2 * first],
            [1 / (1 + wide) ** 2],
            [0.6 / (1 - 0.6 * ratio) ** 2],
        ]
        for s, x, true, slope in zip(
            made, a.tolist(), rational(a), slopes, strict=True
        ):
            assert s is not None
            assert s.holds(x)
            np.testing.assert_allclose(s.value(x), true, rtol=0, atol=EXACT * 5)
            np.testing.assert_allclose(s.derivative(x), slope, rtol=0, atol=EXACT * 100)


def test_none_where_it_does_not_converge() -> None:
    bent, smooth = fitted(
        BOUNDS[:2], lambda a: [np.array([abs(a[0] - 1.1)]), np.array([np.log(a[1])])]
    )
    assert bent is None
    assert smooth is not None


def test_holds_between_the_bounds_only() -> None:
    (s,) = fitted(BOUNDS[:1], lambda a: [a[:1]])
    assert s is not None
    assert [s.holds(a) for a in (0.49, 0.5, 2.0, 2.1)] == [False, True, True, False]
