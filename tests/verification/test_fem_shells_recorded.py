"""Entries of element matrices that MSC Nastran wrote (EXTSEOUT, DMIGPCH), as kept in the public
repository pyCAFE.

One CQUAD4, E 2e5, ν 0.3, t 0.1, K6ROT 100: the square (0, 0), (2, 0), (2, 2), (0, 2), and the
trapezoid with (1.5, 2) for its third corner.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import grid, model, pshell, shells, steel

from ringtrue.core.arrays import Float
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements.shell4 import build

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]])
TRAPEZOID = np.array([[0, 0, 0], [2, 0, 0], [1.5, 2, 0], [0, 2, 0.0]])
PRINTED = 2e-9  # of the largest entry: ten digits


def matrix(xyz: Float) -> Float:
    quads = np.array([[1, 2, 3, 4]])
    m = model(grid(xyz), shells(quads), pshell(0.1), steel(E=2e5, rho=7.8e-9))
    return np.asarray(build(mesh(m).rows("CQUAD4")).stiffness[0])


@pytest.mark.parametrize(
    ("xyz", "diagonal", "first", "drilling"),
    [
        (
            SQUARE,
            [9084.633700] * 8,
            [
                9084.633700,
                3571.236264,
                -5238.095238,
                -274.5329670,
                -5750.915751,
                -3571.236264,
                1904.377289,
                274.5329670,
            ],
            [3.076923077] * 4,
        ),
        (
            TRAPEZOID,
            [
                9902.928651,
                9523.451282,
                8941.294036,
                6776.198535,
                11011.62896,
                10337.00252,
                10049.99434,
                7589.749777,
            ],
            [
                9902.928651,
                3950.663566,
                -6056.390190,
                -653.9602695,
                -6576.827733,
                -4255.745282,
                2730.289271,
                959.0419850,
            ],
            [3.076923077, 3.076923077, 2.307692308, 2.307692308],
        ),
    ],
)
def test_membrane_and_drilling(
    xyz: Float, diagonal: list[float], first: list[float], drilling: list[float]
) -> None:
    """The diagonal and the first row of the membrane, and the drilling, which has no entry between
    two nodes.
    """
    K = matrix(xyz)
    plane = np.flatnonzero(np.tile([1, 1, 0, 0, 0, 0], 4))
    within = PRINTED * max(diagonal)
    np.testing.assert_allclose(K.diagonal()[plane], diagonal, atol=within)
    np.testing.assert_allclose(K[0, plane], first, atol=within)
    np.testing.assert_allclose(K[5::6, 5::6], np.diag(drilling), atol=2e-9)
    np.testing.assert_allclose(
        K[5, [0, 1, 6, 7]], [-0.7692307692, 0.7692307692, 0.0, -0.7692307692], atol=2e-9
    )
